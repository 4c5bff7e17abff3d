"""Whether what rested was struck, and a hammer or a hand still acts on the first swing, or held and let go."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ..._common.checks import FloatArray

_FEWEST = 3  # samples at rest that tell the reading there
_REST = 2.0  # cycles of rest before the motion that are looked at, the last quarter of them left out
_EARLIER = 0.25  # of a cycle that the motion may have begun before it is seen
_CYCLES = 2.0  # of motion that are looked at
_OFF_CENTRE = 0.5  # amplitudes from the place of rest to the middle of the motion, between 0 and 1


def is_struck(values: FloatArray, begin: int, sampling_rate: float, frequency: float, integrations: int) -> bool:
    """Return whether a structure was at rest in its equilibrium until the motion began.

    Parameters
    ----------
    values : (n,) array
        The record, with the rest before the motion.
    begin : int
        First sample of the motion.
    sampling_rate : float
        Samples per second.
    frequency : float
        Of the motion [Hz].
    integrations : int
        How often the measured quantity has to be integrated to give displacement.

    Returns
    -------
    bool
        False where too little of the rest was recorded to tell.

    Notes
    -----
    What is struck swings about the place where it rested, what was held swings to twice its amplitude on one side of
    it. The displacement from there is integrated from rest, which needs no constant; over two cycles neither drift nor
    a high-pass of the sensor matters. Where few samples see an acceleration jump, the speed after that is off by some
    of their intervals: a constant speed is taken out.
    """
    period = sampling_rate / frequency
    before = values[max(begin - round(_REST * period), 0) : begin]
    if before.size < _FEWEST:
        return False
    reading = float(np.median(before[: max(3 * before.size // 4, _FEWEST)]))
    earlier = min(round(_EARLIER * period), begin)
    motion = values[begin - earlier : begin + int(np.ceil(_CYCLES * period)) + 1] - reading
    for _ in range(integrations):
        motion = np.asarray(cumulative_trapezoid(motion, initial=0))
    cycles = np.arange(motion.size - earlier) / period
    columns = [np.ones(cycles.size), np.cos(2.0 * np.pi * cycles), np.sin(2.0 * np.pi * cycles), cycles]
    shapes = np.column_stack(columns if integrations > 1 else columns[:3])
    middle, *swing = np.linalg.lstsq(shapes, motion[earlier:])[0][:3]
    return bool(abs(middle) < _OFF_CENTRE * np.hypot(*swing))


__all__ = ["is_struck"]
