"""The hand at the beginning of a record: a first swing that is none of the free decay."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..._common.checks import FloatArray, IntArray

_STRANGE = 0.14
"""Difference of the swings before and after the first turning point, in amplitudes, beyond that of later ones."""
_COMPARED = 4
_NEAR, _FAR = 0.1, 0.25
"""Part of a cycle on either side of a turning point that is compared."""
_SEARCHED = 2.6
"""Cycles from the start in which the release is looked for."""
_NOISY = 6.0
_LEAST = 4  # samples on either side, for coarser ones do not show where the turning point is


def end_of_lift(values: FloatArray, sampling_rate: float, frequency: float, noise: float) -> int | None:
    """Return the turning point at which a hand let go, or None where the record is free from its start.

    Parameters
    ----------
    values : (n,) array
        Displacement.
    sampling_rate : float
        Samples per second.
    frequency : float
        Dominant frequency [Hz].
    noise : float
        Standard deviation of the noise.

    Returns
    -------
    int or None
        Sample of the turning point.

    Notes
    -----
    Before and after a turning point a conservative oscillator moves alike, whatever its stiffness; damping makes a
    difference that changes slowly from one turning point to the next of the same side. A hand that lifts takes another
    time than the swing that follows. So the mean difference over a tenth to a quarter of a cycle on either side, in
    amplitudes, of the first turning points is compared with that of the next four.
    """
    period = sampling_rate / frequency
    smooth = uniform_filter1d(values, max(int(period / 16.0), 1))
    places = _turning_points(smooth, period)
    if places.size < 2 + 2 * _COMPARED:
        return None
    middle = 0.5 * (smooth[places[:-1]] + smooth[places[1:]])
    size = 0.5 * np.abs(np.diff(smooth[places]))
    strange = np.full(size.size, np.nan)
    for k in range(min(size.size, 2 * _COMPARED + 3)):
        local = 2.0 * float(places[k + 1] - places[k])
        at = _refined(smooth, int(places[k]), round(_NEAR * local))
        reach = np.arange(_NEAR * local, _FAR * local)
        if at < _FAR * local or reach.size < _LEAST or at + _FAR * local >= values.size:
            continue
        samples = np.arange(values.size)
        before, after = np.interp(at - reach, samples, values), np.interp(at + reach, samples, values)
        sign = np.sign(smooth[places[k]] - middle[k])
        strange[k] = sign * float(np.mean(before - after)) / size[k]
    limit = _STRANGE + _NOISY * noise / (float(size[0]) * np.sqrt(0.1 * period))
    found = None
    for k in range(min(3, size.size)):
        later = strange[k + 1 : k + 1 + _COMPARED]
        later = later[np.isfinite(later)]
        if places[k] > _SEARCHED * period or later.size < 3 or not np.isfinite(strange[k]):
            continue
        # the next ones must agree with each other: where all differ nothing is known
        if abs(strange[k] - np.median(later)) > limit + 4.0 * float(np.ptp(later)):
            found = int(places[k])
    return found


def _refined(values: FloatArray, place: int, half: int) -> float:
    """Return the place of an extreme between the samples, by a parabola over ``half`` samples on either side."""
    first, last = max(place - half, 0), min(place + half + 1, values.size)
    if last - first < 4:
        return float(place)
    bend, slope, _ = np.polyfit(np.arange(first - place, last - place), values[first:last], 2)
    shift = -0.5 * slope / bend if bend else 0.0
    return place + float(np.clip(shift, -half, half))


def _turning_points(values: FloatArray, period: float) -> IntArray:
    """Return the first extremes, each the largest or smallest until the record has come back by a third of it."""
    span = values[: int(7.0 * period) + 1]
    least = 0.15 * float(np.ptp(span))
    places: list[int] = []
    low = high = 0
    side = 0
    for i in range(1, span.size):
        if span[i] > span[high]:
            high = i
        if span[i] < span[low]:
            low = i
        if side >= 0 and span[high] - span[i] > least:
            places.append(high)
            side, low, high = -1, i, i
        elif side <= 0 and span[i] - span[low] > least:
            places.append(low)
            side, low, high = 1, i, i
    return np.array(places, dtype=np.int64)
