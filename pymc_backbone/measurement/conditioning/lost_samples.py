"""Samples that a logger lost or wrote twice without a trace in the times: the motion itself is the clock.

A free decay passes its cycles at intervals that change slowly. Where a sample is lost, everything after it comes one
sampling interval too early: the time at which the phase passes any value steps by a whole number of intervals, which no
force can do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations_with_replacement

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
_FAR_WORSE = 15.0
"""And without it at the least, over the quieter side, at an edge or of jumps that hide each other: less is left where a
clearance is reached, too."""
_CONFIRM = 2.25
_HARMONICS = 3
_WIDTH = 2 + 2 * 4 + 2 * 2 * (_HARMONICS - 1)
"""Harmonics that smooth cycles have, and how many columns they and a slope of the zero are."""
_NOTHING = 1e-300  # where a structure is at rest and a logger has no noise
_TOGETHER = 3  # jumps by a sample, closer to each other than the phase tells apart
_PLACES = 16  # at which each of them is tried
_NEAR = 8  # samples around these at which they are found ...
_ALTERNATIONS = 4  # ... one after the other, so many times
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
    Where far more is left than beside it, a few jumps that lie closer than the phase tells apart are looked for
    together, and one in first or last cycles, of which too few lie beyond for a step.
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
        window = _Window(values, sampling_rate, path, float(places[at]))
        if (jump := _confirmed(window, int(count[at]), interval * sampling_rate)) is not None:
            return jump
    return _at_an_edge(values, sampling_rate, path, interval)


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
        # another jump within reach makes the cubic rough: a shorter reach leaves it out
        better = ~(errors[first:last] <= error)
        found[first:last][better], errors[first:last][better] = steps[better], error[better]
    known = np.isfinite(found)
    return found[known], np.maximum(errors[known], 1e-12 * float(path.time[-1])), time[known]


def _at_an_edge(values: FloatArray, sampling_rate: float, path: Track, interval: float) -> Jump | None:
    """Return a jump by a sample in cycles of which too few lie beyond for the phase to tell it."""
    reach = _CONFIRM / path.frequency
    for place in (reach, values.size / sampling_rate - reach):
        window = _Window(values, sampling_rate, path, place)
        if not window.is_told or not window.is_clear:
            continue
        one = interval * sampling_rate
        for shift in (one, -one):
            if (jump := window.jump(shift, one)) is not None:
                return jump
    return None


class _Window:
    """The samples around a place, and what smooth cycles leave of them with jumps mended.

    ``noise`` is what the quieter of the cycles beside them leaves, ``usual`` their geometric mean, both per sample.
    """

    def __init__(self, values: FloatArray, sampling_rate: float, path: Track, place: float) -> None:
        per_cycle = sampling_rate / path.frequency
        centre, half = round(place * sampling_rate), int(_CONFIRM * per_cycle)
        self.low, high = max(0, centre - half), min(values.size, centre + half + 1)
        self.rate = 2.0 * np.pi / per_cycle
        self.values = values[self.low : high]
        self.freedom = max(self.values.size - _WIDTH, 1)
        # at rest nothing is left of nothing
        self.floor = max(float(np.finfo(float).eps) ** 2 * float(self.values @ self.values), _NOTHING)
        reach = int(1.25 * per_cycle)
        self.bounds = max(self.low + 4, centre - reach), min(high - 4, centre + reach)
        # beside it, the same number of cycles without a jump
        beside: list[float] = []
        for start in (self.low - 2 * half, high):
            part = values[max(start, 0) : max(start, 0) + 2 * half + 1]
            if start >= 0 and part.size == 2 * half + 1:
                beside.append(_misfit(part, self.rate) / (part.size - _WIDTH))
        self.is_told = high - self.low >= 1.5 * half and bool(beside)
        self.without = self.left()
        quiet = np.maximum(beside or [np.inf], self.floor)
        self.noise = float(quiet.min()) * max(1.0 - 4.0 * np.sqrt(2.0 / self.freedom), 0.1)
        self.usual = float(np.exp(np.mean(np.log(quiet))))

    def left(self, *jumps: tuple[int, float]) -> float:
        """Return what is left with jumps at these samples of the record by so many samples."""
        return _misfit(self.values, self.rate, *((at - self.low, shift) for at, shift in jumps))

    def gain(self, least: float, other: float) -> float:
        """Return the logarithm of the likelihood ratio of what is left with jumps over something else."""
        return 0.5 * self.freedom * float(np.log(max(other, self.floor) / max(least, self.floor)))

    @property
    def is_clear(self) -> bool:
        """Return whether far more is left without a jump than of the cycles beside: nothing that bends explains it."""
        return bool(self.without / self.freedom > _FAR_WORSE * max(self.noise, self.floor))

    def is_as_good(self, least: float) -> bool:
        """Return whether the cycles are as smooth with jumps mended as those beside them."""
        return least / self.freedom <= _AS_GOOD * max(self.usual, self.floor)

    def placed(
        self, shift: float, *others: tuple[int, float], around: int | None = None
    ) -> tuple[IntArray, FloatArray]:
        """Return samples at which a jump may be beside others, and what each leaves; closest at the best of them."""
        first, last = self.bounds
        stride = max(1, (last - first) // 60)
        if around is not None:
            first, last = max(first, around - _NEAR), min(last, around + _NEAR + 1)
            stride = 1
        candidates = np.arange(first, last, stride)
        misfits = np.array([self.left(*others, (int(at), shift)) for at in candidates])
        for finer in (max(1, stride // 6), 1):
            best = int(candidates[int(np.argmin(misfits))])
            if finer < stride:
                extra = np.arange(max(first, best - stride), min(last, best + stride + 1), finer)
                extra = np.setdiff1d(extra, candidates)
                candidates = np.concatenate([candidates, extra])
                misfits = np.concatenate([misfits, [self.left(*others, (int(at), shift)) for at in extra]])
                stride = finer
        return candidates, misfits

    def jump(self, shift: float, one: float, *others: tuple[int, float], around: int | None = None) -> Jump | None:
        """Return the jump by ``shift`` samples, whole multiples of ``one``, that the samples show beside others."""
        candidates, misfits = self.placed(shift, *others, around=around)
        best, least = int(candidates[int(np.argmin(misfits))]), float(misfits.min())
        either = [self.left(*others, (best, shift + more * one)) for more in (-1.0, 1.0)]
        if self.gain(least, min(self.without, self.left(*others), *either)) < _GAIN:
            return None
        # the parabola through the misfits one interval to either side has its bottom where the shift fits best
        bend = either[0] + either[1] - 2.0 * least
        off, error = 0.5 * (either[0] - either[1]) / bend, np.sqrt(2.0 * least / self.freedom / bend)
        if not abs(off) < _WHOLE + 3.0 * error or not self.is_as_good(least):
            return None
        likely = candidates[misfits < least + 4.0 * max(least / self.freedom, self.floor)]
        return Jump(best, round(shift / one), int(max(likely.max() - best, best - likely.min())))


def _confirmed(window: _Window, count: int, one: float) -> Jump | None:
    """Return the jump in a window that the samples themselves show, the first of some that lie close, or None."""
    # what no jump can gain is not searched for: it leaves the noise of the quieter neighbour, four deviations aside
    if not window.is_told or window.gain(window.freedom * window.noise, window.without) < _GAIN:
        return None
    # what is missing lets everything come too early
    if (found := window.jump(-count * one, one)) is not None:
        return found
    sign = 1 if count > 0 else -1
    for together in (count, count + sign, count - sign) if window.is_clear else ():
        if 1 < abs(together) <= _TOGETHER and (found := _first_of_several(window, together, one)) is not None:
            return found
    return None


def _first_of_several(window: _Window, count: int, one: float) -> Jump | None:
    """Return the first of some jumps by a sample that lie closer than the phase tells apart, ``count`` together.

    Each has to be seen beside the others.
    """
    first, last = window.bounds
    grid = range(first, last, max(1, (last - first) // _PLACES))
    shift = -float(np.sign(count)) * one

    def left(places: Iterable[int]) -> float:
        return window.left(*((at, shift) for at in places))

    def beside(k: int) -> list[tuple[int, float]]:
        return [(at, shift) for j, at in enumerate(places) if j != k]

    places = list(min(combinations_with_replacement(grid, abs(count)), key=left))
    for _ in range(_ALTERNATIONS):
        for k, at in enumerate(places):
            tried, misfits = window.placed(shift, *beside(k), around=at)
            places[k] = int(tried[int(np.argmin(misfits))])
    found = [window.jump(shift, one, *beside(k), around=at) for k, at in enumerate(places)]
    jumps = [jump for jump in found if jump is not None]
    return min(jumps, key=lambda jump: jump.index) if len(jumps) == abs(count) else None


def _misfit(window: FloatArray, rate: float, *jumps: tuple[int, float]) -> float:
    """Return what a few smooth cycles leave of a window, from whose samples ``at`` on all come ``shift`` later."""
    place = np.arange(window.size, dtype=np.float64)
    shifted, keep = place.copy(), np.ones(place.size, dtype=np.bool_)
    for at, shift in jumps:
        shifted[at:] += shift
        if shift < 0.0:
            # what is too much is not fitted
            keep &= (place < at) | (place >= at - shift)
    weight = keep.size / max(int(np.count_nonzero(keep)), 1)
    place, window = shifted[keep], window[keep]
    u = 2.0 * place / max(place[-1], 1.0) - 1.0
    columns = [np.ones_like(u), u]
    for order in range(1, _HARMONICS + 1):
        c, s = np.cos(order * rate * place), np.sin(order * rate * place)
        for power in range(4 if order == 1 else 2):
            columns += [u**power * c, u**power * s]
    design = np.array(columns).T
    q, _ = np.linalg.qr(design)
    left = window - q @ (q.T @ window)
    return float(left @ left) * weight
