"""A linear spring that drifts beside a law, against SciPy."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from pymc_backbone.discrepancy.fitting.drift_course import DRIFT, Linear, course_of, motion_of, passage_of

CYCLES, PER_CYCLE, OMEGA, ZETA = 90, 64, 2.0 * np.pi, 0.004
TIME = np.linspace(0.0, CYCLES, CYCLES * PER_CYCLE + 1)


def cubic(x, _):
    return 0.1 * OMEGA**2 * x**3


def gap(x, _):
    return 0.3 * OMEGA**2 * np.sign(x) * max(abs(x) - 0.3, 0.0)


def drag(_, v):
    return 0.02 * v * abs(v)


def none(*_):
    return 0.0


def decay(law, times, change=0.0, damping=ZETA, less=0.0):
    """Free decay from rest at 1 of a unit mass, whose linear spring and damper change in proportion to the time."""

    def rate(t, y):
        damper = 2.0 * damping * (1.0 - less * t / times[-1]) * OMEGA
        return [y[1], -(OMEGA**2) * (1.0 + change * t / CYCLES) * y[0] - damper * y[1] - law(*y)]

    found = solve_ivp(rate, (0.0, times[-1]), [1.0, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12, max_step=0.05)
    return found.y[0]


def cycles_of(times, values):
    """The cycles of a decay, from peak to peak."""
    curve = CubicSpline(times, values)
    at = curve.derivative().roots(extrapolate=False)
    at = at[curve(at) > 0.0]
    peaks = curve(at)
    frequency = 1.0 / np.diff(at)
    return SimpleNamespace(
        time=0.5 * (at[1:] + at[:-1]), frequency=frequency, frequency_error=1e-5 * frequency,
        smoothed_amplitude=np.sqrt(peaks[1:] * peaks[:-1]),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("law", "change", "limit", "gain"),
    [(none, 0.05, 3e-4, 1.0), (drag, 0.02, 2e-4, 1.0), (cubic, 0.006, 1e-4, 10.0), (gap, 0.05, 3e-3, 10.0)],
)
def test_a_spring_that_drifts_beside_a_law_is_what_scipy_makes_of_it(law, change, limit, gain):
    """Its drift is found from the motion without one, and what is left is far below what a stretched time leaves."""
    true = decay(law, TIME, change)
    plain = CubicSpline(long := np.linspace(0.0, 1.1 * CYCLES, 7 * CYCLES * 10), decay(law, long))
    motion = motion_of(cycles_of(TIME, true), TIME)

    def left(values, known):
        course = course_of(TIME, np.array([1.0, 0.0, 0.0, *values]), 0, 1.0, 0.0, known, Linear(OMEGA**2, ZETA * OMEGA))
        return course.factor * plain(TIME + course.later) - true

    def fitted(known):
        found = least_squares(left, [0.5 * change / DRIFT, 0.01], x_scale=[0.01, 0.01], args=(known,))
        return found.x, np.sqrt(np.mean(found.fun**2) / np.mean(true**2))

    (drift, _), rest = fitted(motion)
    assert drift * DRIFT == pytest.approx(0.5 * change, rel=0.005)
    _, stretched = fitted(None)
    assert rest < limit and rest * gain < stretched * 1.05


def test_damping_that_drifts_changes_the_frequency_by_its_square():
    """By far more than samples tell: it had passed for a spring that drifts, or for one of a law."""
    damping, less, times = 0.03, 0.5, np.linspace(0.0, 20.0, 20 * PER_CYCLE + 1)
    true = decay(none, times, damping=damping, less=less)
    plain = CubicSpline(long := np.linspace(0.0, 22.0, 22 * 70), decay(none, long, damping=damping))
    motion, linear = motion_of(cycles_of(times, true), times), Linear(OMEGA**2, damping * OMEGA)

    def course(drift, loss):
        return course_of(times, np.array([1.0, 0.0, 0.0, drift, loss]), 0, 1.0, 0.0, motion, linear)

    def left(values):
        known = course(*values)
        return known.factor * plain(times + known.later) - true

    found = least_squares(left, [0.01, 0.01], x_scale=[0.01, 0.01])
    drift, loss = found.x
    as_drift = 0.5 * damping**2 * (1.0 - (1.0 - less) ** 2)
    assert abs(drift) * DRIFT < 0.01 * as_drift
    assert loss == pytest.approx(-less * damping * OMEGA * times[-1], rel=2e-3)
    assert np.sqrt(np.mean(found.fun**2)) < 2e-4 * np.sqrt(np.mean(true**2))
    for at in ((0.0, 0.0), (drift, loss), (0.1, -0.3)):
        step = 1e-4
        ends = [course(at[0], at[1] + side * step).later for side in (1.0, -1.0)]
        np.testing.assert_allclose(course(*at).by_loss, (ends[0] - ends[1]) / (2.0 * step), rtol=1e-3, atol=1e-9)
    turns, plainly = cycles_of(times, true), cycles_of(times, plain(times))
    share = turns.time / times[-1]
    passage = passage_of(share, 0.0, loss, times[-1], 0.0, 1.0 / turns.frequency**2, linear)
    frequency, damping = passage.drifted(plainly.frequency[: share.size], damping * OMEGA / turns.frequency)
    np.testing.assert_allclose(frequency, turns.frequency, rtol=0.03 * as_drift)
    decrement = damping[1:-1] * turns.frequency[1:-1]
    known = -np.gradient(np.log(turns.smoothed_amplitude), turns.time)[1:-1]
    np.testing.assert_allclose(decrement, known, rtol=0.01)


def test_noise_bends_no_frequency(rng):
    """A law that is not there would change the phase with all that a drift of damping takes from the amplitude."""
    for law, change, bends in ((none, 0.0, False), (none, 0.02, True), (cubic, 0.0, True)):
        cycles = cycles_of(TIME, decay(law, TIME, change))
        cycles.frequency_error = np.full(cycles.frequency.size, 1e-3)
        cycles.frequency = cycles.frequency + 1e-3 * rng.standard_normal(cycles.frequency.size)
        assert np.any(motion_of(cycles, TIME).frequency_growth) == bends


def test_levels_are_passed_with_drifts_as_scipy_passes_them():
    """Frequency and decrement of a cubic spring at an amplitude, from those without a drift."""
    true, plain = (cycles_of(TIME, decay(cubic, TIME, change)) for change in (0.04, 0.0))
    decrement = [-np.gradient(np.log(item.smoothed_amplitude)) for item in (true, plain)]
    k = np.arange(5, CYCLES - 6, 8)
    softness = 1.0 / true.frequency[k] ** 2
    passage = passage_of(true.time[k] / CYCLES, 0.02 / DRIFT, 0.0, CYCLES, 0.0, softness)
    # damping that stays as it is over a second is less over a cycle that is faster
    loss = -0.02 * np.log(1.0 / plain.smoothed_amplitude[-1])
    passage = passage._replace(loss=loss)
    before = passage.levels_before(true.smoothed_amplitude[k])
    order = np.argsort(plain.smoothed_amplitude)
    known = [np.interp(before, plain.smoothed_amplitude[order], of[order]) for of in (plain.frequency, decrement[1])]
    frequency, damping = passage.drifted(*known)
    np.testing.assert_allclose(frequency, true.frequency[k], rtol=2e-4)
    np.testing.assert_allclose(damping, decrement[0][k], rtol=0.02)
