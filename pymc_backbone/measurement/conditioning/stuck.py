"""Records that hold one value while the motion goes on: sensors or loggers that stuck or lost it, files filled up."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray, IntArray

_LEAST = 16
"""Samples of one value from which a tail is looked at."""
_SHARE = 0.5
"""Of a cycle, that it lasts at least: at a turning point a coarse converter holds one value as well."""
_COME_TO_REST = 2.0
"""Falls of the swing per cycle: a motion of more than so many was not about to stop."""
_WIDEST = 1.0 / 6.0
"""Of a cycle, that what is held in between lasts at most: over more, what is beside it does not tell the motion."""
_NOISY, _CUBIC = 8.0, 4.0 * 5.0 / 384.0
"""Standard deviations of the noise, and of what a cubic leaves of a sine, by which a held value is off at least."""
_MOVES = 0.2
"""Of the swing over half a cycle on one side, that the other side has at least: else one of them is no motion."""
_STEPS = 6.0
"""Steps of the converter that the last swing has at least: what is smaller may hide within one step."""


def constant_tail(values: FloatArray) -> int:
    """Return how many samples (n,) at the end are one value, where that is worth a look, else 0."""
    moving = np.flatnonzero(values != values[-1])
    held = values.size - 1 - int(moving[-1]) if moving.size else 0
    return held if held >= _LEAST else 0


def is_stuck(values: FloatArray, held: int, per_cycle: float, step: float) -> bool:
    """Return whether a free decay ends in one value that its motion did not come to.

    Parameters
    ----------
    values : (n,) array
        Samples as they were read: nothing that was filtered or interpolated repeats.
    held : int
        How many of them are the constant tail.
    per_cycle : float
        Samples in a cycle.
    step : float
        Of the converter, 0 where none is seen.

    Notes
    -----
    Dry friction ends a motion in one value, too, but within one of its steps: the swing falls by eight displacements of
    the friction in a cycle, and is smaller than that in the last one. Air and material let it fade below the step.
    """
    first, cycle = values.size - held, round(per_cycle)
    if held < _SHARE * per_cycle or first < 2 * cycle:
        return False
    last, before = values[first - cycle : first], values[first - 2 * cycle : first - cycle]
    swing, fall = float(np.ptp(last)), float(np.ptp(before)) - float(np.ptp(last))
    return swing > max(_COME_TO_REST * fall, _STEPS * step)


def held_between(values: FloatArray, per_cycle: float, step: float, noise: float) -> IntArray:
    """Return the samples (k,) that hold the value beside them, or the same wrong one, while the motion goes on.

    Parameters
    ----------
    values : (n,) array
        Samples as they were read.
    per_cycle, step, noise : float
        Samples in a cycle, step of the converter (0 where none is seen), standard deviation of the noise.

    Notes
    -----
    Of two or more equal samples one has to be off the cubic through two on either side, by more than noise, steps,
    and what a cubic leaves of a sine over such a gap. The first of them is kept where it is not off itself. Where a
    sensor clips it holds its largest value: that is no loss of a few samples. Where nothing moves on one side, the
    structure was released there: what is held comes before its motion, and that begins with a corner.
    """
    is_same = np.diff(values) == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_same, [False]]).astype(np.int8)))
    around, found = max(round(0.5 * per_cycle), 4), []
    least = max(_STEPS * step, _NOISY * noise)
    firsts, lasts = edges[::2], edges[1::2]
    inside = (firsts >= 2) & (lasts <= values.size - 3) & (lasts - firsts <= _WIDEST * per_cycle)
    firsts, lasts = firsts[inside], lasts[inside]
    value = values[firsts]
    # a coarse converter holds many values, each a step off those beside it
    is_apart = np.maximum(np.abs(values[firsts - 1] - value), np.abs(values[lasts + 1] - value)) > least
    is_apart &= (value != values.max()) & (value != values.min())
    for first, last in zip(firsts[is_apart].tolist(), lasts[is_apart].tolist(), strict=True):
        swings = [float(np.ptp(side)) for side in (values[max(first - around, 0) : first], values[last + 1 :][:around])]
        if min(swings) < _MOVES * max(swings):
            continue
        gap = last - first + 2
        at = np.array([first - 2, first - 1, last + 1, last + 2])
        run = np.arange(first, last + 1)
        off = np.abs(values[run] - np.polyval(np.polyfit(at - first, values[at], 3), run - first))
        beside = np.delete(values[max(first - around, 0) : last + 1 + around], run - max(first - around, 0))
        unknown = 0.5 * float(np.ptp(beside)) * _CUBIC * (2.0 * np.pi * gap / per_cycle) ** 4
        is_off = off > unknown + least
        if is_off.any():  # the first may be the last one that was measured
            found += run[0 if is_off[0] else 1 :].tolist()
    return np.array(found, dtype=np.int64)


__all__ = ["constant_tail", "held_between", "is_stuck"]
