"""What a drift of frequency and damping with time does to the motion, sample by sample and at levels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._common.checks import FloatArray

DRIFT = 0.05
"""Relative change of frequency over a record that one unit of drift stands for."""
_FADE = 0.5
"""Relative change of damping over a record that one unit of drift stands for, as long as it takes no more than ..."""
_MOST_FADE = 1.0
"""... this of the logarithm of the amplitude, twice."""
_LEAST_FALL = 0.02  # of the logarithm of the amplitude, as which a record counts that hardly decays


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


def fade_of(amplitude: FloatArray) -> float:
    """Return what one unit of the drift of damping adds to the decrement, summed over a record, by its end.

    ``amplitude`` (n,) is that of the record's cycles. The drift takes half of it from the logarithm of the amplitude.
    In a record that loses little, a unit that is the same in all would be more than all its damping.
    """
    fall = float(np.log(amplitude[0] / amplitude[-1])) if amplitude.size > 1 and (amplitude > 0.0).all() else 0.0
    return min(_FADE * max(fall, _LEAST_FALL), _MOST_FADE)


def changes_of(drifts: FloatArray, variances: FloatArray) -> dict[str, float]:
    """Return by how much frequency and damping change over a record, relative: mean size of the drifts of records.

    Of damping it is what that is at most: a record that loses much holds less of it.

    Parameters
    ----------
    drifts, variances : (r, 2) arrays
        What was fitted, and its variance, which is no change.
    """
    frequency, damping = np.sqrt(np.maximum((drifts**2 - variances).mean(axis=0), 0.0))
    return {"frequency": DRIFT * float(frequency), "damping": _FADE * float(damping)}


def course_of(time: FloatArray, nuisances: FloatArray, order: int, fade: float) -> Course:
    """Return how drifts change the motion over the record, seen as its derivative of an order; ``fade`` as above."""
    _, release_time, _, drift, loss = nuisances
    length = float(time[-1] - time[0])
    elapsed = np.maximum(time - release_time, 0.0)
    share = 0.5 * fade * (elapsed / length) ** 2
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


__all__ = ["DRIFT", "Course", "changes_of", "course_of", "drifted", "fade_of", "levels_before"]
