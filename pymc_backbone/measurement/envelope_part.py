"""Which part of an envelope is free decay: after the release, above the noise floor, before another release."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression

from .._common.checks import FloatArray, InputError
from .envelope_noise import RAYLEIGH, Floor, Scatter, floor_of, scatter_of, third_differences

ABOVE_FLOOR = 10.0
"""Power over that of the noise floor down to which an envelope is used: 10 dB."""
FEWEST_SAMPLES = 24
_BLOCKS = 400
_TOP = 0.9  # of the largest amplitude: where a drive that rises has arrived
_KINK = 0.1  # slope before the release over that after it
_EVIDENT = 25.0  # chi-square by which a release explains the beginning better than a decay from the first sample on
_AGAIN = 4.0  # rise of power that is another release
_AROUND = 4.0  # times the lowest amplitude from which samples say where a decay passes it
_MATCHES = 1.5
_UNKNOWN = 0.5


@dataclass(frozen=True, eq=False)
class FreeEnvelope:
    """The free decay of an envelope.

    Attributes
    ----------
    part : slice
        Of the samples.
    amplitude : (n,) array
        Rough, falling amplitude at the samples of the part, the floor taken out.
    scatter : Scatter
        Of single samples.
    floor : Floor
        Power that the noise adds, and how well it is known.
    notes : tuple of str
        What was found and cut.
    """

    part: slice
    amplitude: FloatArray
    scatter: Scatter
    floor: Floor
    notes: tuple[str, ...]


def free_envelope(
    time: FloatArray,
    values: FloatArray,
    *,
    start: float | None = None,
    stop: float | None = None,
    least: float | None = None,
    unit: str = "m",
    name: str = "record",
) -> FreeEnvelope:
    """Find the free decay in an envelope.

    Parameters
    ----------
    time, values : (n,) arrays
        Seconds, amplitude.
    start, stop : float, optional
        Part to use [s]; ``start`` replaces the search for the release.
    least : float, optional
        Amplitude at which the part to use ends.
    unit : str
        Of ``values``, for notes.
    name : str
        Of the record, for messages.

    Returns
    -------
    FreeEnvelope

    Raises
    ------
    InputError
        Where too few samples are left, or the envelope does not fall.
    """
    notes: list[str] = []
    held = np.ones(time.size, dtype=bool)
    if start is not None:
        held &= time >= start
    if stop is not None:
        held &= time <= stop
    index = np.flatnonzero(held)
    _check_count(index.size, name, "between `start` and `stop`")
    first, last = int(index[0]), int(index[-1]) + 1
    last = _before_rise(values, first, last, time, notes)
    floor = floor_of(time[first:last], values[first:last])
    if floor is not None:
        end = first + int(np.searchsorted(time[first:last], floor.begins))
    else:
        end = last
    if start is None:
        first = _release(time, values, first, end, notes)
    _check_count(end - first, name, "of free decay")
    rough = falling(values[first:end])
    _check_falls(time[first:end], values[first:end], unit, name)
    scatter = scatter_of(time[first:end], values[first:end], rough)
    told = floor if floor is not None else Floor(2.0 * scatter.constant, _UNKNOWN, np.inf, np.nan)
    if floor is not None and not _is_of_noise(floor, scatter):
        told = Floor(floor.power, max(floor.doubt, _UNKNOWN), floor.begins, floor.spread)
    lowest = max(float(np.sqrt(ABOVE_FLOOR * told.power)), least or 0.0)
    count = _above(time[first:end], values[first:end], rough, lowest, told.power)
    if floor is not None:
        share = 10.0 * np.log10(max(rough[0] ** 2 / floor.power, 1.0))
        how = (
            "it scatters as the envelope of noise does, so its power was subtracted"
            if told.doubt < _UNKNOWN
            else "whether it adds in power, as noise does, or is an offset of the detector cannot be seen: its power "
            "was subtracted, and half of that is in the standard errors"
        )
        notes.append(
            f"the envelope ends in a noise floor of {np.sqrt(floor.power):.3g} {unit}, {share:.0f} dB below its "
            f"beginning; {how}, and what is less than 10 dB above it was left out"
        )
    elif count < rough.size and lowest > (least or 0.0):
        notes.append(
            f"by its scatter the envelope has a noise floor of about {np.sqrt(told.power):.3g} {unit}; what is less "
            "than 10 dB above it was left out"
        )
    _check_count(count, name, "10 dB above its noise")
    part = slice(first, first + count)
    _check_falls(time[part], values[part], unit, name)
    return FreeEnvelope(part, rough[:count], scatter, told, tuple(notes))


def falling(values: FloatArray) -> FloatArray:
    """Return the amplitude that never rises and is nearest in the mean square; in power, where noise has no bias."""
    fitted = isotonic_regression(values**2, increasing=False).x
    return np.sqrt(np.maximum(fitted, 1e-300))


def _above(time: FloatArray, values: FloatArray, rough: FloatArray, lowest: float, noise: float) -> int:
    """Return how many samples lie before a decay falls below an amplitude.

    Where single samples cross it is a matter of their noise, and what was kept would be too high at the end. A curve
    through all samples around the crossing hardly follows the noise of those at the end.
    """
    below = np.flatnonzero(rough < lowest)
    if not below.size:
        return int(rough.size)
    cross = int(below[0])
    begin = int(np.argmax(rough < _AROUND * lowest))
    end = min(cross + max((cross - begin) // 3, 2), rough.size)
    if end - begin < 8:
        return cross
    x = (time[begin:end] - time[begin]) / (time[end - 1] - time[begin])
    near = values[begin:end] - noise / (4.0 * np.maximum(values[begin:end], lowest / 2.0))  # R exceeds A by that
    curve = np.polyval(np.polyfit(x, near, 3 if x.size > 15 else 2), x)
    under = np.flatnonzero(curve < lowest)
    return begin + int(under[0]) if under.size else end


def _check_count(count: int, name: str, what: str) -> None:
    if count < FEWEST_SAMPLES:
        raise InputError(
            f"the envelope of {name!r} must hold at least {FEWEST_SAMPLES} samples {what}, got {count}; record faster, "
            "longer or with less noise, or look at its unit."
        )


def _check_falls(time: FloatArray, values: FloatArray, unit: str, name: str) -> None:
    """Raise where an envelope does not fall by more than its noise makes it seem to."""
    parts = np.array_split(values, 8)
    means = np.array([part.mean() for part in parts])
    difference, _ = third_differences(time, values)
    error = float(np.sqrt(np.mean(difference**2) * 16.0 / values.size))
    if means[0] - means[-1] > max(6.0 * error, 0.1 * means[0]):
        return
    raise InputError(
        f"the envelope of {name!r} does not decay: its mean over the first eighth is {means[0]:.4g} {unit}, over the "
        f"last {means[-1]:.4g} {unit}; give a record of a free decay that is more than noise."
    )


def _blocks(values: FloatArray, first: int, last: int) -> tuple[FloatArray, FloatArray, int]:
    """Return mean power of equal blocks, its standard error, and how many samples a block has."""
    size = max((last - first) // _BLOCKS, 1)
    count = (last - first) // size
    cut = (values[first : first + count * size] ** 2).reshape(count, size)
    power = cut.mean(axis=1)
    difference, _ = third_differences(np.arange(count, dtype=np.float64), np.sqrt(power))
    return power, np.full(count, float(np.sqrt(np.mean(difference**2)))), size


def _before_rise(values: FloatArray, first: int, last: int, time: FloatArray, notes: list[str]) -> int:
    """Return where a decay ends because another release follows it."""
    power, error, size = _blocks(values, first, last)
    top = int(np.argmax(power))
    after = power[top:]
    lowest = np.minimum.accumulate(after)
    risen = np.sqrt(after) - np.sqrt(lowest) > 8.0 * error[0]
    again = np.flatnonzero(risen & (after > _AGAIN * lowest) & (after > 0.01 * power[top]))
    if not again.size:
        return last
    end = top + int(np.argmin(after[: again[0] + 1]))
    cut = first + end * size
    if cut - first < FEWEST_SAMPLES:
        return last
    notes.append(
        f"warning: the envelope rises again after {time[cut]:.6g} s, as after another release; what follows was left "
        "out"
    )
    return cut


def _release(time: FloatArray, values: FloatArray, first: int, end: int, notes: list[str]) -> int:
    """Return where the decay begins: behind a drive that rises or holds the amplitude."""
    power, error, size = _blocks(values, first, end)
    level = np.sqrt(power)
    begin = int(np.flatnonzero(level >= _TOP * level.max())[0])
    if begin and level[: begin + 1].min() > 0.5 * level.max():
        begin = 0  # no rise: noise
    after = int(np.argmax(level < 0.5 * level.max())) or level.size
    log = np.log(level[begin : max(after, begin + 12)])
    sd = error[0] / level.max() + 1e-9
    x = np.arange(log.size, dtype=np.float64)
    smooth = _misfit(np.vander(x, 4), log, sd)
    best: tuple[float, int] | None = None
    for k in range(4, log.size - 6):
        later = np.maximum(x - k, 0.0)
        misfit = _misfit(np.column_stack([np.ones_like(x), later, later**2, later**3]), log, sd)
        if best is None or misfit < best[0]:
            best = misfit, k
    if best is not None and smooth - best[0] > _EVIDENT:
        k = best[1]
        ahead = max(min(2 * k, log.size), k + 6)
        before, behind = np.polyfit(x[:k], log[:k], 1)[0], np.polyfit(x[k:ahead], log[k:ahead], 1)[0]
        is_flat = abs(before) < _KINK * abs(behind) or abs(before) * k < 3.0 * sd
        if behind < 0.0 and is_flat and -behind * k > 6.0 * sd:
            begin += k + 1
    if begin:
        at = first + begin * size
        notes.append(
            f"the amplitude is held or still rising up to about {time[at]:.6g} s: the decay was taken from there on"
        )
        return at
    return first


def _misfit(design: FloatArray, values: FloatArray, sd: float) -> float:
    residual = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return float(residual @ residual) / sd**2


def _is_of_noise(floor: Floor, scatter: Scatter) -> bool:
    """Return whether a floor has the size and the spread of the noise that the samples show above it."""
    from_scatter = 2.0 * scatter.constant
    is_size = from_scatter / _MATCHES < floor.power < _MATCHES * from_scatter
    return is_size or abs(floor.spread - RAYLEIGH) < 0.1
