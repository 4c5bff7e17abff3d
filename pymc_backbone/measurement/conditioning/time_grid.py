"""Time stamps to a uniform grid: rounding, jitter, missing samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from ..._common.checks import FloatArray, InputError

_SNAP = 0.05
"""Largest deviation of a time stamp from the uniform grid, in samples, that is put down to the clock."""
_LARGEST_GAP = 1.0 / 6.0
"""Longest pause between samples, in cycles, across which a spline may carry the motion."""
_PART, _MANY = 0.75, 0.05
"""Of a step, that the last printed digit is at most, or of all steps, that are long at least, where none is missing."""
_LARGEST_GROWTH = 50.0
"""Most samples of the uniform grid, over those measured: a single wrong time stamp can ask for any number."""


@dataclass(frozen=True)
class UniformSamples:
    """A record on a uniform grid.

    Attributes
    ----------
    start : float
        Time of the first sample [s].
    sampling_rate : float
        Samples per second [Hz].
    values : (n,) array
        Samples.
    gaps : (k, 2) array
        Begin and length [s] of the pauses longer than one and a half samples.
    notes : tuple of str
        What was done.
    """

    start: float
    sampling_rate: float
    values: FloatArray
    gaps: FloatArray
    notes: tuple[str, ...]

    @property
    def missing(self) -> list[tuple[int, int]]:
        """First sample of each gap that was put in by the spline, and first one after it."""
        places = np.round(np.column_stack([self.gaps[:, 0], self.gaps.sum(axis=1)]) - self.start, 12)
        ends = np.round(places * self.sampling_rate).astype(int) + np.array([1, 0])
        return [(first, end) for first, end in ends.tolist() if end > first]

    def check_gaps(self, frequency: float, until: float, name: str) -> None:
        """Raise `InputError` at the first gap before ``until`` that is too long for the motion."""
        for begin, length in self.gaps:
            if length * frequency > _LARGEST_GAP and begin < until:
                raise InputError(
                    f"{name}: samples are missing between {begin:.6g} and {begin + length:.6g} s, "
                    f"{length * frequency:.2g} cycles "
                    f"of the {frequency:.4g} Hz motion; use the part before or after (`stop={begin:.6g}` or "
                    f"`start={begin + length:.6g}`)."
                )


def to_uniform(time: FloatArray, values: FloatArray, name: str = "record") -> UniformSamples:
    """Return samples on the uniform grid that fits their time stamps, resampled only where they do not lie on it.

    Stamps within 5 % of a sample of the grid, or as far from it as rounding to printed digits
    explains, are put on it. Others are true jitter: the samples are interpolated by a cubic spline.
    Missing samples are interpolated too, by one of order 5 where the stamps lie on the grid.
    """
    steps = np.diff(time)
    typical = _typical(steps)
    counts = np.ones(steps.size) if _is_all_there(time, steps) else _counts(time, typical)
    index = np.concatenate([[0.0], np.cumsum(counts)])
    if not index[-1] <= _LARGEST_GROWTH * time.size:
        widest = int(np.argmax(steps))
        raise InputError(
            f"{name}: {steps[widest]:.3g} s lie between the time stamps {time[widest]:.9g} and {time[widest + 1]:.9g}, "
            f"sampled every {typical:.3g} s otherwise; cut the record there."
        )
    interval, start = _line(index, time)
    deviation = time - (start + interval * index)
    worst = float(np.max(np.abs(deviation))) / interval
    wide = counts > 1.0
    gaps = np.column_stack([time[:-1][wide], steps[wide]])
    notes: list[str] = []
    is_on_grid = worst < _SNAP or _is_rounding(steps, deviation)
    if is_on_grid:
        if worst > 0.01:
            notes.append(
                f"time stamps deviate by up to {worst:.0%} of a sample from {1.0 / interval:.6g} Hz and were put there"
            )
        if not wide.any():
            return UniformSamples(start, 1.0 / interval, values, gaps, tuple(notes))
        stamps = start + interval * index
    else:
        interval, start = float(time[-1] - time[0]) / float(index[-1]), float(time[0])
        stamps = time
        notes.append(
            f"time stamps jitter by up to {worst:.0%} of a sample: resampled at {1.0 / interval:.6g} Hz by a "
            f"cubic spline"
        )
    if wide.any():
        missing = int(np.sum(counts[wide] - 1.0))
        count = int(wide.sum())
        first = f"at {gaps[0, 0]:.6g} s" if count == 1 else f"the first at {gaps[0, 0]:.6g} s"
        notes.append(
            f"{missing} missing {'sample' if missing == 1 else 'samples'} in {count} "
            f"{'gap' if count == 1 else 'gaps'} of the times, {first}, {'was' if missing == 1 else 'were'} "
            f"interpolated"
        )
    grid = start + interval * np.arange(round((stamps[-1] - start) / interval) + 1)
    # over a gap of three samples a cubic is a thousandth of the motion off
    resampled = make_interp_spline(stamps, values, k=5 if is_on_grid else 3)(np.clip(grid, stamps[0], stamps[-1]))
    return UniformSamples(start, 1.0 / interval, resampled, gaps, tuple(notes))


def _line(index: FloatArray, time: FloatArray) -> tuple[float, float]:
    """Return slope and intercept of the least-squares line through time stamps."""
    middle, centre = float(index.mean()), float(time.mean())
    offset = index - middle
    slope = float(offset @ (time - centre)) / float(offset @ offset)
    return slope, centre - slope * middle


def _is_all_there(time: FloatArray, steps: FloatArray) -> bool:
    """Return whether stamps of few digits are those of evenly spaced samples none of which is missing.

    At 480 samples per second every sixth step is 3 ms long, and the others 2 ms, where stamps are printed in
    milliseconds. A sample that is missing moves all later ones off such a grid; one of few steps that are twice as long
    as the others is missing all the same.
    """
    typical = float(np.median(steps))
    wide = float(np.mean(steps > 1.5 * typical - 1e-6 * typical))
    quantum = _quantum(steps)
    if quantum == 0.0 or not (quantum < _PART * typical or wide > _MANY):
        return False
    interval, start = _line(np.arange(float(time.size)), time)
    return _is_rounding(steps, time - (start + interval * np.arange(time.size)))


def _typical(steps: FloatArray) -> float:
    """Return the sampling interval: the median step, or the mean of the two nearest where stamps have few digits."""
    typical, quantum = float(np.median(steps)), _quantum(steps)
    near = np.abs(steps - typical) < 1.01 * quantum
    is_coarse = quantum > 0.0 and float(np.mean(near & (steps > 1.5 * typical - 1e-6 * typical))) > _MANY
    return float(steps[near].mean()) if is_coarse else typical


def _counts(time: FloatArray, typical: float) -> FloatArray:
    """Return how many sampling intervals lie between neighbouring stamps: more than one where samples are missing.

    Stamps are compared with a lattice that follows them slowly, not with their neighbours: two stamps that jitter
    apart are no gap, a lattice that has lost its step is.
    """
    steps = np.diff(time) / typical
    counts = np.ones(steps.size)
    if not (steps > 1.5).any():
        return counts
    ahead = 0.0
    for i, step in enumerate(steps.tolist()):
        position = ahead + step
        counts[i] = max(round(position), 1)
        # how far the stamp lies ahead of the lattice, which gives way by a tenth
        ahead = 0.9 * (position - counts[i])
    return counts


def _is_rounding(steps: FloatArray, deviation: FloatArray) -> bool:
    """Return whether stamps deviate from the grid only because they were printed with few digits."""
    quantum = _quantum(steps)
    return quantum > 0.0 and bool(np.max(np.abs(deviation)) <= 0.6 * quantum)


def _quantum(steps: FloatArray) -> float:
    """Return the least difference of steps that take few values, as printed stamps do; 0 where one or many."""
    typical = float(np.median(steps))
    distinct = np.unique(np.round(steps / typical, 6))
    return float(np.min(np.diff(distinct))) * typical if 2 <= distinct.size <= 4 else 0.0
