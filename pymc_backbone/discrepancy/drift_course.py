"""What a drift of frequency and damping with time does to the motion, sample by sample and at levels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._common.checks import FloatArray

DRIFT = 0.05
"""Relative change of frequency over a record that one unit of drift stands for."""


class Course(NamedTuple):
    """What drifts do over a record, sample by sample.

    Attributes
    ----------
    later : (n,) array
        By how much one unit of the drift of frequency puts the motion forward [s].
    share : (n,) array
        By how much one unit of the drift of damping lowers the logarithm of the amplitude.
    factor : (n,) array or None
        By which both change the measured quantity; None where they are zero or change when it is reached, not its size.
    hastened : (n,) array or None
        Derivative of the logarithm of that with respect to the drift of frequency; None for a displacement.
    """

    later: FloatArray
    share: FloatArray
    factor: FloatArray | None
    hastened: FloatArray | None


def course_of(time: FloatArray, nuisances: FloatArray, order: int) -> Course:
    """Return how drifts change the motion over the record, seen as its derivative of an order."""
    _, release_time, _, drift, loss = nuisances
    length = float(time[-1] - time[0])
    elapsed = np.maximum(time - release_time, 0.0)
    share = 0.5 * (elapsed / length) ** 2
    factor = hastened = None
    if loss != 0.0 or order:
        # y(s(t)) exp(-loss share) is the displacement: its rates have the pace ds/dt in them
        pace = 1.0 + drift * DRIFT * elapsed / length
        if loss != 0.0 or drift != 0.0:
            factor = np.exp(-loss * share) * pace**order
        if order:
            hastened = order * DRIFT * elapsed / length / pace
    return Course(0.5 * DRIFT * elapsed**2 / length, share, factor, hastened)


def levels_before(levels: FloatArray, share: FloatArray, loss: float) -> FloatArray:
    """Return the amplitudes (l,) that a motion without the drift of damping has where the one with it has these.

    ``share`` is how much of the record has passed there.
    """
    before: FloatArray = levels * np.exp(0.5 * loss * share**2)
    return before


def drifted(
    frequency: FloatArray, damping: FloatArray, share: FloatArray, drift: float, loss: float, length: float
) -> tuple[FloatArray, FloatArray]:
    """Return frequency [Hz] and decrement (l,) that are passed after these shares of a record of some length [s]."""
    faster = frequency * (1.0 + drift * DRIFT * share)
    return faster, damping + loss * share / (length * faster)


__all__ = ["DRIFT", "Course", "course_of", "drifted", "levels_before"]
