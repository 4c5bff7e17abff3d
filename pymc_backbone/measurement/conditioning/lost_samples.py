"""Samples that a logger lost or wrote twice without a trace in the times: the motion itself is the clock.

A free decay passes its cycles at intervals that change slowly. Where a sample is lost, everything after it comes one
sampling interval too early: the time at which the phase passes any value steps by a whole number of intervals, which no
force can do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ..._common.checks import FloatArray, IntArray
from .tracking import Track, track

MOST = 24
"""Jumps that are mended in one record; where there are more, the clock is not to be believed at all."""
_PER_CYCLE = 8
_REACHES = ((4, 4), (2, 4), (4, 2), (2, 2))
_FAR, _SHARPEST = 4.0, 0.4
"""What makes a step of the tracked phase worth a look: standard errors from zero, and intervals it is known to."""
_TRIES = 3
_GAIN = 20.0
"""Logarithm of the likelihood ratio over the best other number of samples."""
_WHOLE = 0.1
"""How far from a whole number the shift may be that fits best, beside three of its standard errors."""
_AS_GOOD = 1.6
"""What may be left with the jump mended, over the geometric mean of what is left on either side: where the motion
changes its course within a few cycles, as in a gap, one side is rougher than the other."""
_CONFIRM = 2.25
_HARMONICS = 3
_NORMAL = 1.4826


@dataclass(frozen=True)
class Jump:
    """Samples that are missing or too many.

    Attributes
    ----------
    index : int
        First sample after it.
    count : int
        Samples that are missing there; negative where so many are too many.
    uncertainty : int
        How many samples the place may be off, either way.
    """

    index: int
    count: int
    uncertainty: int


def find_jump(values: FloatArray, sampling_rate: float, frequency: float, interval: float) -> Jump | None:
    """Find the clearest jump of the clock in a free decay.

    Parameters
    ----------
    values : (n,) array
        Uniform samples of a free decay.
    sampling_rate, frequency : float
        Samples per second; frequency of the motion [Hz].
    interval : float
        Interval at which the logger sampled [s]: jumps are whole multiples of it.

    Returns
    -------
    Jump or None
        None where every cycle follows from its neighbours, or what disturbs them is no whole number of samples.

    Notes
    -----
    The times at which the tracked phase passes each eighth of a cycle are fitted, over four cycles before and after a
    place without the cycle on either side of it, by a cubic and a step. Where the step stands out, the samples
    themselves decide: with so many put in (or taken out) the cycles around must be as smooth as those beside them, much
    smoother than with another number or none, and smoothest with a whole number. This also finds the place.
    """
    path = track(values, sampling_rate, frequency)
    if path is None or path.cycles < 5.0:
        return None
    step, error, places = _steps(path)
    if not step.size:
        return None
    count = np.round(step / interval)
    clear = (np.abs(step) > _FAR * error) & (error < _SHARPEST * interval) & (count != 0)
    clear &= np.abs(count) * interval * frequency < 0.25
    order = np.flatnonzero(clear)
    order = order[np.argsort(-np.abs(step[order]) / error[order])]
    tried: list[float] = []
    for at in order.tolist():
        if any(abs(places[at] - other) * frequency < 2.0 for other in tried):
            continue
        if len(tried) == _TRIES:
            break
        tried.append(float(places[at]))
        # what is missing lets everything come too early
        shift = -float(count[at]) * interval
        jump = _confirmed(values, sampling_rate, path, float(places[at]), shift, interval)
        if jump is not None:
            return jump
    return None


def repeats(values: FloatArray, step: float, noise: float) -> IntArray:
    """Return the samples that repeat the one before although the motion goes on: frames or samples written twice.

    Parameters
    ----------
    values : (n,) array
        Samples.
    step, noise : float
        Step of the converter, and standard deviation of the noise.

    Returns
    -------
    (k,) array of int
        Indices. To repeat the last digit is no accident where the motion over a sample is six steps and eight standard
        deviations; at a turning point, in a hold and where a sensor clips, the motion stops or turns.
    """
    change = np.diff(values)
    before, after = change[:-2], change[2:]
    slope = np.abs(values[3:] - values[:-3]) / 3.0
    moves = (before * after > 0.0) & (np.minimum(np.abs(before), np.abs(after)) > 0.5 * slope)
    found = (change[1:-1] == 0.0) & moves & (slope > np.maximum(6.0 * step, 8.0 * noise))
    return np.asarray(np.flatnonzero(found) + 2, dtype=np.int64)


def mended(values: FloatArray, jump: Jump, shift: float) -> FloatArray:
    """Return uniform samples with what is missing put in, or what is too much taken out.

    Parameters
    ----------
    values : (n,) array
        Uniform samples.
    jump : Jump
        Where.
    shift : float
        Sampling intervals of ``values`` that are missing; negative where so many are too many.
    """
    before = np.arange(jump.index, dtype=np.float64)
    after = np.arange(jump.index, values.size) + shift
    kept = after > before[-1] + 0.5 if before.size else np.ones(after.size, dtype=np.bool_)
    stamps = np.concatenate([before, after[kept]])
    samples = np.concatenate([values[: jump.index], values[jump.index :][kept]])
    return np.asarray(CubicSpline(stamps, samples)(np.arange(int(np.floor(stamps[-1] + 1e-9)) + 1)), dtype=np.float64)


def _steps(path: Track) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the step of the time of phase at each place, its standard error, and the place [s]."""
    grid = np.arange(np.ceil(path.phase[0] * _PER_CYCLE / (2.0 * np.pi)), path.phase[-1] * _PER_CYCLE / (2.0 * np.pi))
    time = np.interp(grid * 2.0 * np.pi / _PER_CYCLE, path.phase, path.time)
    amplitude = np.interp(time, path.time, path.amplitude)
    found, errors = np.full(grid.size, np.nan), np.full(grid.size, np.nan)
    for before, after in _REACHES:
        offsets = np.concatenate([np.arange(-before * 8, -7, 4), np.arange(8, after * 8 + 1, 4)])
        u = offsets / 32.0
        degree = 3 if before + after > 6 else 2
        design = np.column_stack([u**power for power in range(degree + 1)] + [(u > 0.0).astype(float)])
        inverse = np.linalg.pinv(design)
        rest = np.eye(u.size) - design @ inverse
        first, last = before * 8, grid.size - after * 8
        if last <= first:
            continue
        windows = time[np.arange(first, last)[:, None] + offsets]
        windows = windows - windows.mean(axis=1, keepdims=True)
        steps = windows @ inverse[-1]
        # neighbouring phases share samples: their residuals are about half as many as they seem
        residual = np.sqrt(np.sum((windows @ rest.T) ** 2, axis=1) / (0.5 * (u.size - degree - 2)))
        scaled = residual * amplitude[first:last]
        common = _NORMAL / 0.9 * float(np.median(scaled)) / amplitude[first:last]
        error = np.hypot(residual, common) * float(np.linalg.norm(inverse[-1]))
        empty = np.isnan(found[first:last])
        found[first:last][empty], errors[first:last][empty] = steps[empty], error[empty]
    known = np.isfinite(found)
    return found[known], np.maximum(errors[known], 1e-12 * float(path.time[-1])), time[known]


def _confirmed(
    values: FloatArray, sampling_rate: float, path: Track, place: float, shift: float, interval: float
) -> Jump | None:
    """Return the jump near a place that the samples themselves show, or None."""
    centre, half = round(place * sampling_rate), int(_CONFIRM * sampling_rate / path.frequency)
    low, high = max(0, centre - half), min(values.size, centre + half + 1)
    if high - low < 1.5 * half:
        return None
    rate = 2.0 * np.pi * path.frequency / sampling_rate
    window = values[low:high]
    freedom = window.size - _width()
    floor = np.finfo(float).eps ** 2 * float(window @ window)
    # beside it, the same number of cycles without a jump
    beside: list[float] = []
    for start in (low - 2 * half, high):
        part = values[max(start, 0) : max(start, 0) + 2 * half + 1]
        if start >= 0 and part.size == 2 * half + 1:
            beside.append(_misfit(part, rate, part.size, 0.0) / (part.size - _width()))
    without = _misfit(window, rate, window.size, 0.0)
    if not beside:
        return None
    # what no jump can gain is not searched for: it leaves the noise of the quieter neighbour, four deviations aside
    noise = max(min(beside) * max(1.0 - 4.0 * np.sqrt(2.0 / freedom), 0.1), floor)
    if 0.5 * freedom * np.log(max(without / freedom, floor) / noise) < _GAIN:
        return None
    moved = shift * sampling_rate
    reach = int(1.25 * sampling_rate / path.frequency)
    bounds = (max(low + 4, centre - reach), min(high - 4, centre + reach))
    stride = max(1, (bounds[1] - bounds[0]) // 60)
    candidates = np.arange(bounds[0], bounds[1], stride)
    misfits = np.array([_misfit(window, rate, int(at) - low, moved) for at in candidates])
    for finer in (max(1, stride // 6), 1):
        best = int(candidates[int(np.argmin(misfits))])
        if finer < stride:
            extra = np.arange(max(bounds[0], best - stride), min(bounds[1], best + stride + 1), finer)
            extra = np.setdiff1d(extra, candidates)
            candidates = np.concatenate([candidates, extra])
            misfits = np.concatenate([misfits, [_misfit(window, rate, int(at) - low, moved) for at in extra]])
            stride = finer
    best = int(candidates[int(np.argmin(misfits))])
    least = float(misfits.min())
    one = interval * sampling_rate
    others = [_misfit(window, rate, best - low, moved + extra * one) for extra in (-1.0, 1.0)]
    gain = 0.5 * freedom * np.log(max(min(without, *others), floor) / max(least, floor))
    if gain < _GAIN:
        return None
    # the parabola through the misfits one interval to either side has its bottom where the shift fits best
    bend = others[0] + others[1] - 2.0 * least
    off, error = 0.5 * (others[0] - others[1]) / bend, np.sqrt(2.0 * least / freedom / bend)
    if not abs(off) < _WHOLE + 3.0 * error:
        return None
    if least / freedom > _AS_GOOD * max(float(np.exp(np.mean(np.log(np.maximum(beside, floor))))), floor):
        return None
    scale = max(least / freedom, floor)
    likely = candidates[misfits < misfits.min() + 4.0 * scale]
    return Jump(best, round(shift / interval), int(max(likely.max() - best, best - likely.min())))


def _width() -> int:
    return 2 + 2 * 4 + 2 * 2 * (_HARMONICS - 1)


def _misfit(window: FloatArray, rate: float, at: int, shift: float) -> float:
    """Return what a few smooth cycles leave of a window whose samples from ``at`` on come ``shift`` samples later."""
    place = np.arange(window.size, dtype=np.float64)
    weight = None
    if shift < 0.0:
        # what is too much is not fitted
        keep = (place < at) | (place >= at - shift)
        place, window = place[keep], window[keep]
        weight = keep.size / max(int(np.count_nonzero(keep)), 1)
    place = np.where(place >= at, place + shift, place)
    u = 2.0 * place / max(place[-1], 1.0) - 1.0
    columns = [np.ones_like(u), u]
    for order in range(1, _HARMONICS + 1):
        c, s = np.cos(order * rate * place), np.sin(order * rate * place)
        for power in range(4 if order == 1 else 2):
            columns += [u**power * c, u**power * s]
    design = np.array(columns).T
    q, _ = np.linalg.qr(design)
    left = window - q @ (q.T @ window)
    return float(left @ left) * (weight or 1.0)
