"""The simulated free decay against answers found another way: closed forms, elliptic integrals, SciPy, heyoka."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipe, ellipk

from pymc_backbone.effects import LIBRARY
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_backbone, simulate_decay, simulate_waveform
from pymc_backbone.simulation.results import Status

from .decay_cases import (
    AMPLITUDE,
    COMBINATIONS,
    EFFECTS,
    FOLLOWER,
    LAG,
    MASS,
    MAXWELL,
    OMEGA,
    SINH,
    STOP,
    is_rough,
    name_of,
    oscillator_of,
    parameters_of,
)
from .decay_oracles import ORACLES, Decay, Slider, Spring, cycle_at, cycles


def tolerances(effects):
    """Return the tolerance of frequency and of decrement, relative: what is asked for. Measured is 1e-9 and 2e-8."""
    return (1e-6, 1e-5) if is_rough(effects) else (1e-8, 1e-6)


def test_every_library_effect_has_an_oracle():
    missing = set(LIBRARY) - set(ORACLES)
    assert not missing, f"write the force of {', '.join(sorted(missing))} a second time in tests/decay_oracles.py"


@pytest.mark.parametrize("zeta", [1e-6, 1e-4, 0.01, 0.2, 0.6])
def test_linear_decay_is_exact(zeta):
    omega = 2.0 * np.pi * 3.7
    oscillator = Oscillator(1.7, ())
    result = simulate_backbone(oscillator, [1.7 * omega**2, 2.0 * 1.7 * zeta * omega], [1e-4, 1e-3, 0.5])
    root = np.sqrt(1.0 - zeta**2)
    np.testing.assert_allclose(result.frequency, omega * root / (2.0 * np.pi), rtol=1e-9)  # asked for: 1e-8
    # The energy a step loses is wrong by some 1e-11 whatever the damping, which the lightest damping feels most.
    np.testing.assert_allclose(result.damping, 2.0 * np.pi * zeta / root, rtol=1e-7, atol=2e-10)
    p0, q, p1 = np.exp(-np.pi * zeta / root * np.arange(3)) * np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(result.offset, ((p0 + p1) / 2 + q) / 2 / ((p0 + p1 - 2 * q) / 4), rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("ratio", [-0.9, -0.3, 0.5, 10.0, 1e3])
def test_undamped_duffing_period_is_the_elliptic_integral(ratio):
    k, amplitude = 350.0, 0.04
    period = 4.0 * ellipk(ratio / (2.0 * (1.0 + ratio))) / np.sqrt(k * (1.0 + ratio))
    result = simulate_backbone(Oscillator(1.0, "cubic_stiffness"), [k, 0.0, ratio * k / amplitude**2], [amplitude])
    np.testing.assert_allclose(result.frequency, 1.0 / period, rtol=1e-8)
    np.testing.assert_allclose(result.damping, 0.0, atol=2e-9)  # energy lost by the integrator, per cycle


@pytest.mark.parametrize("angle", [0.1, 1.0, 2.5, 3.1])
def test_undamped_pendulum_period_is_the_elliptic_integral(angle):
    # k x + k (sin x - x) = k sin x
    result = simulate_backbone(Oscillator(1.0, "pendulum_stiffness"), [9.81, 0.0, 9.81], [angle])
    period = 4.0 / np.sqrt(9.81) * ellipk(np.sin(angle / 2.0) ** 2)
    # Near the top the period hangs on the amplitude, and with it the error: 1e-8 until 2.5 rad.
    np.testing.assert_allclose(result.frequency, 1.0 / period, rtol=1e-8 if angle < 3.0 else 1e-6)


@pytest.mark.parametrize("effects", EFFECTS + COMBINATIONS, ids=name_of)
def test_decay_and_waveform_are_those_of_scipy(effects):
    oscillator = oscillator_of(effects)
    amplitude = 1.0 if "pendulum_stiffness" in effects else AMPLITUDE
    p = parameters_of(oscillator, amplitude=amplitude)
    oracle = Decay(oscillator, p)
    times, turns = oracle.turning_points(amplitude, 8)
    expected = cycles(times, turns)
    n = expected.shape[1]
    assert n >= 2, "the case should swing for two cycles at least"
    found = simulate_decay(oscillator, p, amplitude, n_cycles=n)
    for_frequency, for_damping = tolerances(effects)
    np.testing.assert_allclose(found.amplitude, expected[0], rtol=1e-7)
    np.testing.assert_allclose(found.frequency, expected[1], rtol=for_frequency)
    np.testing.assert_allclose(found.damping, expected[2], rtol=for_damping)
    np.testing.assert_allclose(found.offset, expected[3], atol=1e-7)
    time = np.linspace(0.0, times[-1], 400)
    wave = simulate_waveform(oscillator, p, time, amplitude).displacement
    # Measured: 7e-9 of the amplitude at worst, smooth; 2e-8 rough.
    np.testing.assert_allclose(wave, oracle.displacement(time), atol=1e-7 * amplitude)


@pytest.mark.parametrize(
    "effects", [e for e in EFFECTS + COMBINATIONS if not any(LIBRARY[name].n_states for name in e)], ids=name_of
)
def test_backbone_at_a_level_is_that_of_scipy(effects):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator)
    levels = AMPLITUDE * np.array([0.45, 0.6, 0.83])
    result = simulate_backbone(oscillator, p, levels)
    assert np.all(result.status == Status.COMPLETED)
    for_frequency, for_damping = tolerances(effects)
    for k in (0, 2):
        frequency, damping, offset = cycle_at(Decay(oscillator, p), levels[k])
        assert result.frequency[k] == pytest.approx(frequency, rel=for_frequency)
        assert result.damping[k] == pytest.approx(damping, rel=for_damping)
        assert result.offset[k] == pytest.approx(offset, abs=1e-7)


@pytest.mark.parametrize("frequency", [0.2, 200.0])
@pytest.mark.parametrize("amplitude", [1e-6, 1.0])
@pytest.mark.parametrize("zeta", [1e-4, 0.2])
def test_smooth_accuracy_holds_from_light_to_heavy_small_to_large_slow_to_fast(zeta, amplitude, frequency):
    oscillator = Oscillator(0.3, ("cubic_stiffness",))
    omega = 2.0 * np.pi * frequency
    p = np.array([0.3 * omega**2, 0.6 * zeta * omega, 0.3 * omega**2 / amplitude**2])
    result = simulate_backbone(oscillator, p, [0.3 * amplitude, amplitude])
    expected = cycle_at(Decay(oscillator, p), amplitude)
    assert result.frequency[1] == pytest.approx(expected[0], rel=1e-8)
    assert result.damping[1] == pytest.approx(expected[1], rel=1e-6)


def test_hard_and_light_damping_at_once_keeps_the_decrement(rng):
    """Friction, contact and slip with almost no viscous damping: what is lost is lost where it should be."""
    for effects in (("coulomb_friction",), ("freeplay",), ("jenkins",), ("iwan",)):
        oscillator = oscillator_of(effects)
        p = parameters_of(oscillator, zeta=1e-4, share=0.25)
        expected = cycles(*Decay(oscillator, p).turning_points(AMPLITUDE, 6))
        n = expected.shape[1]
        found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=n)
        np.testing.assert_allclose(found.frequency, expected[1], rtol=1e-6)
        np.testing.assert_allclose(found.damping, expected[2], rtol=1e-5)


def test_iwan_is_the_bed_of_sliders_it_stands_for():
    """Against a thousand sliders, each with its own position: strengths phi from the density R phi^chi."""
    stiffness, strength, chi = 0.4 * MASS * OMEGA**2, 0.15 * MASS * OMEGA**2 * AMPLITUDE, -0.4
    oscillator = Oscillator(MASS, "iwan")
    p = [MASS * OMEGA**2, 0.02 * MASS * OMEGA, stiffness, strength, chi]
    count = 1000
    largest = strength * (chi + 2.0) / (stiffness * (chi + 1.0))
    # Shares of stiffness, not of displacement, so that every slider weighs the same: midpoint rule, error 1 / count^2.
    share = (np.arange(count) + 0.5) / count
    phi = largest * share ** (1.0 / (chi + 1.0))
    foot = AMPLITUDE - np.minimum(AMPLITUDE, phi)
    mass, c, k = MASS, p[1], p[0]
    x, turns, times, t, direction = AMPLITUDE, [AMPLITUDE], [0.0], 0.0, -1.0
    for _ in range(4):

        def slope(t, y, foot=foot):
            moved = np.clip(y[0] - foot, -phi, phi)
            return [y[1], -(k * y[0] + c * y[1] + stiffness * moved.mean()) / mass]

        def turning(t, y):
            return y[1]

        turning.terminal, turning.direction = True, -direction
        run = solve_ivp(slope, (t, t + 1.0), [x, 0.0], "RK45", events=turning, rtol=1e-9, atol=1e-12, first_step=1e-5)
        t, x = run.t[-1], run.y[0, -1]
        foot = x - np.clip(x - foot, -phi, phi)
        turns.append(x)
        times.append(t)
        direction = -direction
    found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=2)
    # What is left is the bed's own coarseness; against the closed form the same decay agrees to 1e-9.
    np.testing.assert_allclose(found.turning_values, turns, atol=3e-6 * AMPLITUDE)
    np.testing.assert_allclose(found.turning_times, times, rtol=3e-6)


@pytest.mark.parametrize("share", [-0.4, 0.05, 1.0])
def test_the_undamped_period_with_a_mass_that_moves_along_is_the_elliptic_integral(share):
    """Energy: with ``x = A sin(angle)`` the period is the integral of the root of ``1 + share sin(angle)^2``."""
    stiffness = MASS * OMEGA**2
    oscillator = Oscillator(MASS, "nonlinear_inertia")
    p = [stiffness, 0.0, share * MASS / AMPLITUDE**2]
    found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=3)
    period = 4.0 / OMEGA * ellipe(-share)
    np.testing.assert_allclose(found.turning_times, 0.5 * period * np.arange(found.turning_times.size), rtol=1e-8)
    np.testing.assert_allclose(np.abs(found.turning_values), AMPLITUDE, rtol=1e-8)


def test_the_third_harmonic_of_a_mass_that_moves_along_is_three_times_a_springs():
    """At the same change of frequency, to first order: -1/16 and -1/48 of the share that moves, by harmonic balance."""
    stiffness, share = MASS * OMEGA**2, 0.01
    ratios = []
    for name, strength in (
        ("nonlinear_inertia", share * MASS / AMPLITUDE**2),
        ("cubic_stiffness", -2.0 / 3.0 * share * stiffness / AMPLITUDE**2),
    ):
        oscillator, p = Oscillator(MASS, name), [stiffness, 0.0, strength]
        period = 1.0 / simulate_backbone(oscillator, p, [AMPLITUDE]).frequency[0]
        assert period * OMEGA / (2.0 * np.pi) == pytest.approx(1.0 + share / 4.0, rel=1e-4)
        angle = 2.0 * np.pi * np.arange(64) / 64
        x = simulate_waveform(oscillator, p, period * angle / (2.0 * np.pi), AMPLITUDE).displacement
        ratios.append(2.0 * np.mean(x * np.cos(3.0 * angle)) / AMPLITUDE)
    np.testing.assert_allclose(ratios, [-share / 16.0, -share / 48.0], rtol=0.02)


@pytest.mark.parametrize("user", [MAXWELL, SINH, STOP, FOLLOWER], ids=lambda effect: effect.name)
def test_user_effects_are_integrated_as_exactly_as_the_librarys(user, monkeypatch):
    class Maxwell(Slider):
        def start(self, p, x):
            return np.zeros(1)  # loaded slowly, so relaxed

        def enter(self, p, x, d, z):
            pass

        def force(self, p, x, v, d, z):
            return z[0]

        def rate(self, p, x, v, d, z):
            return (p[0] * v - z[0] / p[1],)

        def events(self, p, d):
            return []

    class Follower(Spring):
        def mass(self, p, x):
            return p[0] * x**4

    own = {
        "maxwell": Maxwell,
        "follower": lambda: Follower(lambda x, v, d, p: (4.0 - 2.0) * p[0] * x**3 * v**2),
        "sinh_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * p[1] * np.sinh(x / p[1])),
        "one_stop": lambda: Spring(lambda x, v, d, p, side: p[0] * (x - p[1]) * (side > 0.0), lambda p: (p[1],)),
    }
    monkeypatch.setitem(ORACLES, user.name, own[user.name])
    oscillator = oscillator_of((user, "coulomb_friction"))
    p = parameters_of(oscillator, share=0.2)
    times, turns = Decay(oscillator, p).turning_points(AMPLITUDE, 5)
    found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=2)
    np.testing.assert_allclose(found.turning_values, turns[:5], atol=1e-8 * AMPLITUDE)  # smooth-effect accuracy
    np.testing.assert_allclose(found.turning_times, times[:5], rtol=1e-8)


@pytest.mark.parametrize("way", [0.3, 0.01, 0.005, 0.003])
def test_friction_that_builds_up_over_a_short_way_starts_where_slow_loading_leads(way):
    """Of the amplitude; down to there a search goes. In closed form, and by the rate: too long a step would diverge."""
    oscillator = Oscillator(MASS, "dahl_friction")
    force = 0.01 * MASS * OMEGA**2 * AMPLITUDE
    p = [MASS * OMEGA**2, 0.02 * MASS * OMEGA, force / (way * AMPLITUDE), force]
    times, turns = Decay(oscillator, p).turning_points(AMPLITUDE, 5)
    found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=2)
    np.testing.assert_allclose(found.turning_values, turns[:5], atol=1e-7 * AMPLITUDE)
    np.testing.assert_allclose(found.turning_times, times[:5], rtol=1e-6)
    as_bouc_wen = [*p[:3], 1.0, 0.0, 1.0 / (way * AMPLITUDE), 0.0, 1.0]
    same = simulate_decay(Oscillator(MASS, "bouc_wen"), as_bouc_wen, AMPLITUDE, n_cycles=2)
    np.testing.assert_allclose(same.turning_values, found.turning_values, atol=1e-9 * AMPLITUDE)
    by_rate = simulate_decay(Oscillator(MASS, [LAG]), [*p[:3], way * AMPLITUDE], AMPLITUDE, n_cycles=2)
    np.testing.assert_allclose(by_rate.turning_values, turns[:5], atol=1e-7 * AMPLITUDE)


def test_an_effect_of_ones_own_has_room_and_remembers_as_the_librarys():
    library = LIBRARY["bouc_wen"]
    mine = replace(library, name="mine")  # reached by another way, with the same functions
    p = parameters_of(oscillator_of(("bouc_wen", "cubic_stiffness")))
    results = [
        simulate_decay(Oscillator(MASS, [effect, "cubic_stiffness"]), p, AMPLITUDE, n_cycles=4)
        for effect in (library, mine)
    ]
    np.testing.assert_allclose(results[1].turning_values, results[0].turning_values, rtol=1e-12)
    np.testing.assert_allclose(results[1].turning_times, results[0].turning_times, rtol=1e-12)
    curves = [
        simulate_backbone(Oscillator(MASS, [effect]), p[:-1], [0.3 * AMPLITUDE, 0.5 * AMPLITUDE], sensitivities=True)
        for effect in (library, mine)
    ]
    np.testing.assert_allclose(curves[1].jacobian, curves[0].jacobian, rtol=1e-9, atol=1e-12)


def test_turning_points_are_those_of_heyoka():
    hy = pytest.importorskip("heyoka", reason="heyoka is installed with the group `test` only")
    oscillator = Oscillator(MASS, ("cubic_stiffness", "cubic_damping"))
    p = parameters_of(oscillator, share=0.8)
    found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=3)
    x, v = hy.make_vars("x", "v")
    k, c, k3, c3 = p
    integrator = hy.taylor_adaptive(
        [(x, v), (v, -(k * x + c * v + k3 * x * x * x + c3 * v * v * v) / MASS)], [AMPLITUDE, 0.0], tol=1e-16
    )
    for time, value in zip(found.turning_times[1:], found.turning_values[1:], strict=True):
        integrator.propagate_until(float(time))
        # The displacement is stationary at a turning point; the velocity shows the error in time.
        assert integrator.state[0] == pytest.approx(value, abs=1e-8 * AMPLITUDE)
        assert integrator.state[1] == pytest.approx(0.0, abs=1e-8 * AMPLITUDE * OMEGA)


@pytest.mark.parametrize("effects", [(), ("cubic_stiffness",), ("freeplay",), ("bouc_wen",)], ids=name_of)
@pytest.mark.parametrize("per_cycle", [8, 500])
def test_waveform_is_as_exact_however_densely_it_is_sampled(effects, per_cycle):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator)
    oracle = Decay(oscillator, p)
    times, _turns = oracle.turning_points(-AMPLITUDE, 6)
    time = np.arange(0.0, times[-1], 2.0 * np.pi / OMEGA / per_cycle)
    wave = simulate_waveform(oscillator, p, time, -AMPLITUDE).displacement
    np.testing.assert_allclose(wave, oracle.displacement(time), atol=1e-7 * AMPLITUDE)  # asked for; measured 2e-8
