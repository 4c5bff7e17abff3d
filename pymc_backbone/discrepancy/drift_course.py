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
        By which both change the measured quantity; None where they are zero.
    hastened : (n,) array
        Derivative of the logarithm of that with respect to the drift of frequency.
    """

    later: FloatArray
    share: FloatArray
    factor: FloatArray | None
    hastened: FloatArray


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


def covered(share: FloatArray, settling: float) -> FloatArray:
    """Return how much of a drift of frequency is there after these shares of a record.

    In proportion to the time, or as what ``settling`` times over a record comes nearer to its end by a factor e: a
    structure that warms up, or a joint that settles.
    """
    return share if settling == 0.0 else np.expm1(-settling * share) / np.expm1(-settling)


def covered_so_far(share: FloatArray, settling: float) -> FloatArray:
    """Return the integral of that from the release on."""
    if settling == 0.0:
        return 0.5 * share**2
    whole: FloatArray = (share + np.expm1(-settling * share) / settling) / -np.expm1(-settling)
    return whole


def course_of(time: FloatArray, nuisances: FloatArray, order: int, fade: float, settling: float = 0.0) -> Course:
    """Return how drifts change the motion over the record, seen as its derivative of an order.

    ``fade`` and ``settling`` as above. What drifts is a stiffness: over a cycle it hardly changes, so that energy over
    frequency stays (the adiabatic invariant), and the amplitude falls as the root of the frequency rises.
    """
    _, release_time, _, drift, loss = nuisances
    length = float(time[-1] - time[0])
    elapsed = np.maximum(time - release_time, 0.0)
    share = 0.5 * fade * (elapsed / length) ** 2
    # y(s(t)) exp(-loss share) over the root of the pace ds/dt is the displacement: its rates have that pace in them
    there = covered(elapsed / length, settling)
    pace = 1.0 + drift * DRIFT * there
    factor = np.exp(-loss * share) * pace ** (order - 0.5) if loss != 0.0 or drift != 0.0 else None
    hastened = (order - 0.5) * DRIFT * there / pace
    return Course(DRIFT * length * covered_so_far(elapsed / length, settling), share, factor, hastened)


def levels_before(
    levels: FloatArray, share: FloatArray, loss: float, drift: float = 0.0, settling: float = 0.0
) -> FloatArray:
    """Return the amplitudes (l,) that a motion without drifts has where the one with them has these.

    ``share`` is how much of the record has passed there.
    """
    pace = 1.0 + drift * DRIFT * covered(share, settling)
    before: FloatArray = levels * np.exp(0.5 * loss * share**2) * np.sqrt(pace)
    return before


def drifted(
    frequency: FloatArray,
    damping: FloatArray,
    share: FloatArray,
    drift: float,
    loss: float,
    length: float,
    settling: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return frequency [Hz] and decrement (l,) that are passed after these shares of a record of some length [s]."""
    faster = frequency * (1.0 + drift * DRIFT * covered(share, settling))
    pace = faster / frequency
    hardens = drift * DRIFT * _growing(share, settling) / pace  # by which the amplitude falls, too
    return faster, damping + (loss * share + 0.5 * hardens) / (length * faster)


def _growing(share: FloatArray, settling: float) -> FloatArray:
    """Return the derivative of `covered` with respect to the share of the record."""
    if settling == 0.0:
        return np.ones_like(share)
    rate: FloatArray = settling * np.exp(-settling * share) / -np.expm1(-settling)
    return rate


__all__ = [
    "DRIFT",
    "Course",
    "changes_of",
    "course_of",
    "covered",
    "covered_so_far",
    "drifted",
    "fade_of",
    "levels_before",
]  # fmt: skip
