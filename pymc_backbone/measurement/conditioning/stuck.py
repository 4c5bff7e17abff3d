"""A record that ends in one value while the motion goes on: a sensor or a logger that stuck, a file filled up."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray

_LEAST = 16
"""Samples of one value from which a tail is looked at."""
_SHARE = 0.5
"""Of a cycle, that it lasts at least: at a turning point a coarse converter holds one value as well."""
_COME_TO_REST = 2.0
"""Falls of the swing per cycle: a motion of more than so many was not about to stop."""
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


__all__ = ["constant_tail", "is_stuck"]
