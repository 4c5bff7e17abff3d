"""Where a free decay begins and ends within a record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from ..._common.checks import FloatArray
from ..rough_turning import rough_noise
from .convolution import convolve_inside
from .tracking import Track

ComplexArray = NDArray[np.complex128]
_LEVEL = 0.97
_QUIET = 0.5
_WINDOW = 0.65
_PLATEAU_FALL = 0.06
_GROWN, _SWUNG = 0.85, 0.9  # of its maximum, that the envelope and the swing were below before they grew
_AROUND = 1.3  # cycles over which a swing is seen
_PIECE = 1 << 18
_SPAN_OF_NOISE = 6.0  # standard deviations that the noise of a flat start spans at most


def envelope(values: FloatArray, sampling_rate: float, frequency: float, integrations: int = 0) -> FloatArray:
    """Return the amplitude of the fundamental over windows of two cycles, as long as the record.

    With ``integrations`` it is that of the displacement (up to a constant) behind a velocity or an acceleration: where
    the frequency rises as the amplitude falls, an acceleration may stay level while the displacement decays. Within one
    cycle of the ends it is held at its value there.
    """
    half = min(max(round(sampling_rate / frequency), 2), (values.size - 1) // 2)
    kernel = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]) / float(half) ** 2
    z = _demodulated(values, frequency / sampling_rate, kernel)
    inner = 2.0 * np.abs(z)
    if integrations:
        turns = np.gradient(np.unwrap(np.angle(z))) * sampling_rate / (2.0 * np.pi * frequency)
        rate = uniform_filter1d(np.clip(1.0 + turns, 0.6, 1.7), half, mode="nearest")
        inner = inner / rate**integrations
    return np.pad(inner, (half - 1, values.size - inner.size - half + 1), mode="edge")


def _demodulated(values: FloatArray, turns: float, kernel: FloatArray) -> ComplexArray:
    """Return ``values`` times a carrier of so many turns per sample, averaged over the kernel, without its ends.

    By pieces, for the carrier and the transforms of a long record are many times its size.
    """
    result = np.empty(values.size - kernel.size + 1, dtype=np.complex128)
    for first in range(0, result.size, _PIECE):
        last = min(first + _PIECE, result.size) + kernel.size - 1
        carrier = np.exp(-2j * np.pi * turns * np.arange(first, last))
        result[first : first + _PIECE] = convolve_inside(values[first:last] * carrier, kernel)
    return result


def leading_rest(values: FloatArray) -> int:
    """Return how many samples pass before the first excursion of a quarter of the largest one."""
    begin = values[: max(values.size // 50, 3)]
    excursion = np.abs(values - np.median(begin))
    return int(np.argmax(excursion > 0.25 * excursion.max()))


def end_of_rest(values: FloatArray, sampling_rate: float, frequency: float) -> int | None:
    """Return the first sample after the release or the impact, or None where the record begins in motion.

    Before a release or an impact the record hardly moves: over 0.65 of a cycle before it, it spans less than half
    the later amplitude, where a free oscillation spans at least its amplitude (1.45 times it, and 1.0 at ten samples
    per cycle). That places the release to a fraction of a cycle. A hold that began less than that before the release is
    seen by its flatness.
    """
    period = sampling_rate / frequency
    level = envelope(values, sampling_rate, frequency)
    top = int(np.argmax(level))
    first, _ = _plateau(level, top)
    quiet = _last_quiet(values, period, float(level[top]), int(first + period))
    if quiet is None:
        return _end_of_flat_start(values, period, float(level[top]))
    return quiet + 1 if quiet > first - 3.0 * period else None


def end_of_drive(values: FloatArray, sampling_rate: float, frequency: float, integrations: int) -> int | None:
    """Return a sample safely after the end of forcing, or None where the record is free from its start.

    Forcing is seen in the envelope: it has grown to its maximum, or stayed level there, for more than a cycle and a
    half. The decay begins one and a half cycles after the bend, for the envelope is that blunt. So must the swing have
    grown, or stayed: the fundamental of one frequency is less than the motion while a stop or a strong spring makes
    that swing at another.
    """
    period = sampling_rate / frequency
    level = envelope(values, sampling_rate, frequency, integrations)
    top = int(np.argmax(level))
    first, last = _plateau(level, top)
    swing = _swing(values, period)
    is_level = _is_level(level, first, last, period) and _is_level(swing, first, last, period)
    has_grown = (
        first > 1.6 * period
        and float(level[:first].min()) < _GROWN * float(level[top])
        and float(swing[:first].min()) < _SWUNG * float(swing[top])
    )
    if not (is_level or has_grown):
        return None
    bend = _bend(level, first, last) if is_level else top
    return min(int(bend + 1.5 * period), values.size - 1)


def _swing(values: FloatArray, period: float) -> FloatArray:
    """Return by how much a record moves to and fro within somewhat more than a cycle around each sample."""
    window = max(round(_AROUND * period), 3)
    swing: FloatArray = maximum_filter1d(values, window) - minimum_filter1d(values, window)
    return swing


def _plateau(level: FloatArray, top: int) -> tuple[int, int]:
    """Return the first and the last sample near the maximum, without leaving its neighbourhood."""
    low = np.flatnonzero(level < 0.7 * level[top])
    left = int(low[low < top].max(initial=-1)) + 1
    right = int(low[low > top].min(initial=level.size)) - 1
    near = np.flatnonzero(level[left : right + 1] >= _LEVEL * level[top]) + left
    return int(near[0]), int(near[-1])


def _is_level(level: FloatArray, first: int, last: int, period: float) -> bool:
    """Return whether the envelope stays level between two samples and falls clearly faster after them."""
    n = last - first
    lower = np.flatnonzero(level[last:] < 0.9 * level[last])
    if n < 3.0 * period or not lower.size:
        return False
    after = np.log(level[last] / level[last + lower[0]]) / lower[0]
    early = np.log(level[first : first + n // 4 + 1]).mean()
    late = np.log(level[last - n // 2 : last - n // 4 + 1]).mean()
    # over a plateau worth the name the later decay would have shown; a ripple of the envelope is none
    return bool(early - late < 0.25 * after * 0.5 * n and after * n > _PLATEAU_FALL)


def _bend(level: FloatArray, first: int, last: int) -> int:
    """Return where the line through the falling part of a log envelope meets its plateau."""
    plateau = float(np.median(level[first : last + 1]))
    falling = np.flatnonzero(level[last:] < 0.9 * plateau)
    lower = np.flatnonzero(level[last:] < 0.7 * plateau)
    if not falling.size or not lower.size or lower[0] - falling[0] < 3:
        return last
    at = np.arange(last + falling[0], last + lower[0])
    slope, intercept = np.polyfit(at, np.log(level[at] / plateau), 1)
    return int(np.clip(-intercept / slope, first, last + falling[0]))


def _last_quiet(values: FloatArray, period: float, highest: float, until: int) -> int | None:
    """Return the last sample before ``until`` up to which the record hardly moves; None if it always moves."""
    window = max(round(_WINDOW * period), 3)
    smooth = uniform_filter1d(values, max(int(period / 16.0), 1))
    # a window that ends at each sample
    shift = (window - 1) // 2
    span = maximum_filter1d(smooth, window, origin=shift) - minimum_filter1d(smooth, window, origin=shift)
    span = span[: max(until, 0)]
    span[: window - 1] = np.inf
    still = np.flatnonzero(span < _QUIET * highest)
    return int(still[-1]) if still.size else None


def _end_of_flat_start(values: FloatArray, period: float, highest: float) -> int | None:
    """Return the first sample after a hold too short to span a window, or None where the start is not flat for long.

    A cosine stays within a small span ``s`` of its amplitude for at most ``2 acos(1 - s / 2 A) / 2 pi`` of a cycle.
    """
    smoothing = max(int(period / 16.0), 1)
    begin = values[: max(int(2.0 * period), 8)]
    smooth = uniform_filter1d(begin, smoothing, mode="nearest")
    noise = rough_noise(values) / np.sqrt(smoothing)
    span = 0.02 * highest + _SPAN_OF_NOISE * noise
    if not span < 0.3 * highest:
        return None
    moved = np.maximum.accumulate(smooth) - np.minimum.accumulate(smooth) > span
    flat = int(np.argmax(moved)) if moved.any() else 0
    free = np.arccos(1.0 - span / highest) / np.pi * period
    return flat if flat > 1.4 * free + smoothing + 1.0 else None


def end_of_motion(track: Track, floor: float) -> float:
    """Return the last time at which the amplitude is above a floor, without returning from below it."""
    below = np.flatnonzero(track.amplitude < floor)
    # one grid point below the floor may be chance; half a cycle is not
    run = max(track.per_cycle // 2, 1)
    for index in below:
        if np.all(track.amplitude[index : index + run] < floor):
            return float(track.time[index])
    return float(track.time[-1])


def regrowth(path: Track, integrations: int, noise: float) -> tuple[float, float, float] | None:
    """Return time, low and high of the first clear growth of the amplitude (a second impact, beating), or None.

    Growth is judged on the displacement's amplitude, with ``noise`` the standard error of the measured one.
    """
    step = max(path.per_cycle // 2, 1)
    amplitude, time = path.amplitude[::step], path.time[::step]
    if time.size < 4:
        return None
    rate = np.gradient(path.phase[::step], time) / (2.0 * np.pi * path.frequency)
    factor = np.clip(rate, 0.6, 1.7) ** -integrations
    shown = amplitude * factor
    grown = shown > 1.25 * np.minimum.accumulate(shown) + 8.0 * noise * factor
    grown &= shown > 0.05 * shown[0]
    if not grown.any():
        return None
    at = int(np.argmax(grown))
    low = int(np.argmin(shown[: at + 1]))
    return float(time[low]), float(amplitude[low]), float(amplitude[low:].max())
