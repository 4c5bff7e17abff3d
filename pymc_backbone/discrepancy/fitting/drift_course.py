"""What a drift of frequency and damping with time does to the motion, sample by sample and at levels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from ..._common.checks import FloatArray
from ...measurement.cycle_data import Cycles

DRIFT = 0.05
"""Relative change of the frequency of a linear structure over a record that one unit of drift stands for: half of that
of its stiffness, to first order."""
_FADE = 0.5
"""Relative change of damping over a record that one unit of drift stands for, as long as it takes no more than ..."""
_MOST_FADE = 1.0
"""... this of the logarithm of the amplitude, twice."""
_STANDS_OUT = 4.0  # mean square of drifts that are seen, over their mean variance
_LEAST_FALL = 0.02  # of the logarithm of the amplitude, as which a record counts that hardly decays
_LEAST_LEFT = 0.05  # of a stiffness or a pace, that drifts leave: far from any motion fits go beyond
_MOST_BENDS, _CYCLES_PER_BEND = 5, 4  # degree of the curves through cycles, and cycles that one more needs
# Of a decay d(t), the square of the frequency is w^2 - d^2 - d'; but turning points come d / w^2 before those of that
# oscillation, and as this changes so does their distance: counted from turn to turn it is w^2 - d^2 + d'.
_AT_TURNS = -1.0
_LEAST_ERROR = 1e-6  # of a frequency, relative: how closely a curve is asked to follow it


class Motion(NamedTuple):
    """How the measured motion passes at the instants of a data term.

    Attributes
    ----------
    angular_frequency : (n,) array
        Of the cycle there [rad/s].
    frequency_growth : (n,) array
        Derivative of its logarithm with respect to time [1/s].
    bend : (n,) array
        By how much the logarithm of the frequency changes with that of the amplitude, for a unit of the former's
        growth [s].
    """

    angular_frequency: FloatArray
    frequency_growth: FloatArray
    bend: FloatArray

    def first(self, count: int) -> Motion:
        """Return that at the first ``count`` instants."""
        return Motion(*(values[:count] for values in self))


class Linear(NamedTuple):
    """The linear part of a model.

    Attributes
    ----------
    square : float
        Spring over the mass [rad^2/s^2].
    decay : float
        Damping over twice the mass [1/s].
    """

    square: float = 1.0
    decay: float = 0.0

    @classmethod
    def of(cls, parameters: FloatArray, mass: float) -> Linear:
        """Return that of a model with these parameters: the first two are the linear stiffness and damping."""
        return cls(float(parameters[0]) / mass, 0.5 * float(parameters[1]) / mass)

    def slower(self, added: FloatArray, growing: FloatArray | float) -> FloatArray:
        """Return by how much what is ``added`` to the decay (n,) lowers the square of the angular frequency (n,).

        Where ``x'' + 2 d(t) x' + w^2 x`` is zero, ``x`` times the exponential of the integral of ``d`` oscillates with
        the square ``w^2 - d^2 - d'``. ``growing`` is the derivative of what is added with respect to time:
        less twice that for turning points and the cycles between them (`_AT_TURNS`).
        """
        lower: FloatArray = added * (2.0 * self.decay + added) + growing
        return lower


UNDAMPED = Linear()
"""A linear structure in units of its own frequency."""


class Course(NamedTuple):
    """What drifts do over a record, sample by sample.

    Attributes
    ----------
    later : (n,) array or None
        By how much they put the motion forward [s]; None where they are zero.
    pace : (n,) array or float
        How much faster it passes: one more than the derivative of that.
    factor : (n,) array or None
        By which they change the measured quantity; None where they are zero.
    share : (n,) array or float
        By how much one unit of the drift of damping lowers the logarithm of the amplitude.
    hastened : (n,) array or float
        Derivative of the logarithm of the factor with respect to the drift of frequency.
    by_drift, by_loss : (n,) arrays or float
        Derivatives of ``later`` with respect to the drifts of frequency and damping [s].
    by_stiffness : (n,) array or None
        The same with respect to the logarithm of the stiffness; None where the drifts are zero.
    """

    later: FloatArray | None
    pace: FloatArray | float
    factor: FloatArray | None
    share: FloatArray | float
    hastened: FloatArray | float
    by_drift: FloatArray | float
    by_loss: FloatArray | float
    by_stiffness: FloatArray | None


STEADY = Course(None, 1.0, None, 0.0, 0.0, 0.0, 0.0, None)
"""The course of a motion without drifts, where nobody asks how they would change it."""


def motion_of(cycles: Cycles, time: FloatArray) -> Motion:
    """Return how the motion of a record passes at these instants [s], by smooth curves through its cycles."""
    at, most = cycles.time, min(_MOST_BENDS, cycles.time.size // _CYCLES_PER_BEND)
    frequency = _curve_of(cycles, most)
    falling = Polynomial.fit(at, np.log(np.maximum(cycles.smoothed_amplitude, 1e-300)), most)
    inside = np.clip(time, at[0], at[-1])
    values = np.clip(frequency(inside), 0.5 * cycles.frequency.min(), 2.0 * cycles.frequency.max())
    least = _LEAST_FALL / max(float(np.ptp(at)), 1e-300)  # of a motion that hardly falls no law is seen
    falls = falling.deriv()(inside)
    return Motion(2.0 * np.pi * values, frequency.deriv()(inside) / values, falls / (falls**2 + least**2))


def _curve_of(cycles: Cycles, most: int) -> Polynomial:
    """Return the frequency over time as a polynomial, with no more bends than the cycles tell (by Schwarz's criterion).

    Of a linear structure that is a constant: what noise would bend counts as a law with which drifts change the phase.
    """
    errors = np.maximum(cycles.frequency_error, _LEAST_ERROR * cycles.frequency)
    curves = [Polynomial.fit(cycles.time, cycles.frequency, k, w=1.0 / errors) for k in range(most + 1)]
    left = np.array([float((((cycles.frequency - curve(cycles.time)) / errors) ** 2).sum()) for curve in curves])
    spread = max(float(left[-1]) / max(errors.size - most - 1, 1), 1e-300)
    worth = left / spread + np.log(errors.size) * np.arange(1, most + 2)
    return curves[int(np.argmin(worth))]


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


def stand_out(drifts: FloatArray, variances: FloatArray) -> tuple[bool, bool]:
    """Return whether the drifts (r, 2) of frequency and of damping stand out of their errors, all records together."""
    frequency, damping = (drifts**2).sum(axis=0) > _STANDS_OUT * variances.sum(axis=0)
    return bool(frequency), bool(damping)


def covered(share: FloatArray, settling: float) -> FloatArray:
    """Return how much of a drift of frequency is there after these shares of a record.

    In proportion to the time, or as what ``settling`` times over a record comes nearer to its end by a factor e: a
    structure that warms up, or a joint that settles.
    """
    return share if settling == 0.0 else np.expm1(-settling * share) / np.expm1(-settling)


def course_of(
    time: FloatArray,
    nuisances: FloatArray,
    order: int,
    fade: float,
    settling: float = 0.0,
    motion: Motion | None = None,
    linear: Linear = UNDAMPED,
    *,
    at_turns: bool = False,
) -> Course:
    """Return how drifts change the motion over the record, seen as its derivative of an order.

    ``fade`` and ``settling`` as above, ``linear`` is that part of the model. What drifts is its spring, in proportion
    to the time (or as it settles), and no other force: the motion without a drift is passed faster, but by less where
    the spring is less of the whole stiffness. Over a cycle it hardly changes, so that energy over frequency stays (the
    adiabatic invariant), and the amplitude falls as the root of the frequency rises. Where the frequency goes with the
    amplitude, what the drifts take from that changes it as well. A drift of damping lowers the frequency itself, by the
    square of the damping, otherwise where it is seen ``at_turns``. Without a ``motion`` the structure counts as linear,
    and hardly damped.
    """
    _, release_time, _, drift, loss = nuisances
    length = float(time[-1] - time[0])
    elapsed = np.maximum(time - release_time, 0.0)
    share = 0.5 * fade * (elapsed / length) ** 2
    there = covered(elapsed / length, settling)
    of_slope = _AT_TURNS if at_turns else 1.0
    if drift == 0.0 and loss == 0.0:
        return _unchanged(order, elapsed, share, there, motion, linear, fade, length, of_slope)
    stiffer = np.maximum(1.0 + 2.0 * drift * DRIFT * there, _LEAST_LEFT)
    if motion is None:
        pace = np.sqrt(stiffer)
        faster = DRIFT * there / pace
        factor = np.exp(-loss * share) * pace ** (order - 0.5)
        hastened = (order - 0.5) * faster / pace
        later, by_drift = _so_far(pace - 1.0, elapsed), _so_far(faster, elapsed)
        return Course(later, pace, factor, share, hastened, by_drift, 0.0 * share, None)
    softness, each = linear.square / motion.angular_frequency**2, elapsed / length
    squared = _squared_pace(stiffer, softness)
    rate = 2.0 * DRIFT * _growing(each, settling) / length
    grows = motion.frequency_growth
    # of the square of the pace
    growth = softness * ((2.0 * stiffer - 1.0) * drift * rate - 2.0 * (stiffer - 1.0) * stiffer * grows)
    unit = fade / length  # of what the drift of damping adds to the decay by the end
    added = unit * loss * each + linear.decay * (np.sqrt(squared) - 1.0)  # what is passed faster decays faster, too
    adding = unit * loss / length + 0.5 * linear.decay * growth / np.sqrt(squared)
    slower = linear.slower(added, of_slope * adding)
    squared = np.maximum(squared - slower / motion.angular_frequency**2, _LEAST_LEFT)
    growth = growth - 2.0 * (linear.decay + added) * adding / motion.angular_frequency**2
    plain = np.sqrt(squared)
    # a measured frequency that tells no growth tells of no law beside one that is calculated
    by_law = motion.bend * bool(grows.any())
    bend = (grows - 0.5 * growth / squared) * by_law
    less = -loss * share - 0.25 * np.log(squared)
    open_pace = np.maximum(1.0 + bend * less, _LEAST_LEFT)

    def pace_by(of_squared: FloatArray, of_growth: FloatArray) -> FloatArray:
        """Return the derivative of the pace, by those of the squared one without a law and of its growth."""
        of_bend = -0.5 * by_law * (of_growth - growth / squared * of_squared) / squared
        of_open = of_bend * less - 0.25 * bend * of_squared / squared
        by: FloatArray = 0.5 * of_squared / plain * open_pace + plain * of_open
        return by

    by_drift = 2.0 * DRIFT * there * (2.0 * stiffer - 1.0) * softness
    by_loss = -unit * (2.0 * each * (linear.decay + added) + of_slope / length) / motion.angular_frequency**2
    of_growth = -2.0 * unit * (each * adding + (linear.decay + added) / length) / motion.angular_frequency**2
    faster = pace_by(by_drift, softness * rate * (4.0 * stiffer - 3.0) - 2.0 * by_drift * grows)
    pace = plain * open_pace
    return Course(
        later=_so_far(pace - 1.0, elapsed),
        pace=pace,
        factor=np.exp(less) * pace**order,
        share=share,
        hastened=order * faster / pace - 0.25 * by_drift / squared,
        by_drift=_so_far(faster, elapsed),
        by_loss=_so_far(pace_by(by_loss, of_growth) - plain * bend * share, elapsed),
        by_stiffness=_so_far(pace_by((stiffer - 1.0) * stiffer * softness, growth), elapsed),
    )


def _unchanged(
    order: int,
    elapsed: FloatArray,
    share: FloatArray,
    there: FloatArray,
    motion: Motion | None,
    linear: Linear,
    fade: float,
    length: float,
    of_slope: float,
) -> Course:
    """Return the course of a motion without drifts, and how they would change it."""
    faster, bend, slower = DRIFT * there, np.zeros_like(share), np.zeros_like(share)
    if motion is not None:
        faster = faster * linear.square / motion.angular_frequency**2
        bend = motion.frequency_growth * motion.bend
        slower = fade / length**2 * (2.0 * linear.decay * elapsed + of_slope) / motion.angular_frequency**2
    pace = (1.0 - 0.5 * bend) * faster
    by_drift = _so_far(pace, elapsed)
    by_loss = _so_far(-0.5 * (1.0 - 0.5 * bend) * slower - bend * share, elapsed)
    return Course(None, 1.0, None, share, order * pace - 0.5 * faster, by_drift, by_loss, None)


def _squared_pace(stiffer: FloatArray, softness: FloatArray) -> FloatArray:
    """Return the square of how much faster (n,) a motion passes with a linear spring that is so many times as stiff.

    The work of the linear spring adds to the square of the frequency, whatever else acts: to first order in what it
    changes, for any motion that is nearly harmonic. ``softness`` is the spring, as it was, over the mass and the square
    of the angular frequency as it is; of a linear structure that is one over ``stiffer``.
    """
    squared: FloatArray = np.maximum(1.0 + (stiffer - 1.0) * stiffer * softness, _LEAST_LEFT)
    return squared


def _so_far(values: FloatArray, elapsed: FloatArray) -> FloatArray:
    """Return the integral (n,) of values from the release on, before the first of which they begin at zero."""
    whole = np.empty_like(values)
    whole[0] = 0.5 * values[0] * elapsed[0]
    np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(elapsed), out=whole[1:])
    whole[1:] += whole[0]
    return whole


class Passage(NamedTuple):
    """How a motion with drifts passes levels: the share of the record, how much faster, and how fast that grows."""

    share: FloatArray
    pace: FloatArray
    hardening: FloatArray
    loss: float
    length: float

    def levels_before(self, levels: FloatArray) -> FloatArray:
        """Return the amplitudes (l,) that a motion without drifts has where the one with them has these."""
        before: FloatArray = levels * np.exp(0.5 * self.loss * self.share**2) * np.sqrt(self.pace)
        return before

    def drifted(self, frequency: FloatArray, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return frequency [Hz] and decrement (l,) that are passed with drifts, where these are those without."""
        faster = frequency * self.pace
        # the amplitude falls as the structure hardens, too
        return faster, damping + (self.loss * self.share + 0.5 * self.hardening) / (self.length * faster)


def passage_of(
    share: FloatArray,
    drift: float,
    loss: float,
    length: float,
    settling: float,
    softness: FloatArray,
    linear: Linear = UNDAMPED,
) -> Passage:
    """Return how levels are passed after shares of a record of some length [s]; ``softness`` is `_squared_pace`'s."""
    stiffer = np.maximum(1.0 + 2.0 * drift * DRIFT * covered(share, settling), _LEAST_LEFT)
    squared = _squared_pace(stiffer, softness)
    hardening = drift * DRIFT * _growing(share, settling) * (2.0 * stiffer - 1.0) * softness / squared
    plain = np.sqrt(squared)
    added = loss * share / length + linear.decay * (plain - 1.0)
    slower = linear.slower(added, _AT_TURNS * (loss / length**2 + linear.decay * hardening * plain / length))
    pace = np.sqrt(np.maximum(squared - slower * softness / linear.square, _LEAST_LEFT))
    return Passage(share, pace, hardening, loss, length)


def _growing(share: FloatArray, settling: float) -> FloatArray:
    """Return the derivative of `covered` with respect to the share of the record."""
    if settling == 0.0:
        return np.ones_like(share)
    rate: FloatArray = settling * np.exp(-settling * share) / -np.expm1(-settling)
    return rate


__all__ = [
    "DRIFT",
    "STEADY",
    "Course",
    "Linear",
    "Motion",
    "changes_of",
    "course_of",
    "covered",
    "fade_of",
    "motion_of",
    "passage_of",
    "stand_out",
]  # fmt: skip
