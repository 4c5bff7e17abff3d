"""Backbones of what remembers, from a few cycles at each level: against every cycle of the decay, and against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.counts import half_cycles_run
from pymc_backbone.simulation.decay import Simulator, simulate_backbone

from .decay_oracles import Decay, cycles

MASS, AMPLITUDE, OMEGA = 2.0, 0.03, 2.0 * np.pi * 5.0
K = MASS * OMEGA**2
LEVELS = AMPLITUDE * np.geomspace(1.0 / 30.0, 1.0, 10)
RELEASE = 1.25 * AMPLITUDE
BESIDE = (None, "coulomb_friction", "cubic_stiffness", "iwan", "jenkins", "freeplay")
LIGHT = 0.04  # above this decrement the whole decay's own cubic, released elsewhere, is off by more than is asked here


def bouc_wen(zeta, share, slip, exponent, ratio):
    """Return linear stiffness, damping and Bouc-Wen's parameters; slip as a share of the amplitude."""
    total = (slip * AMPLITUDE) ** -exponent
    beta = total / (1.0 + abs(ratio))
    return [K * (1.0 - share), 2.0 * zeta * MASS * OMEGA, share * K, 1.0, 0.0, beta, ratio * beta, exponent]


def draw(beside, rng):
    """Return an oscillator and parameters; a share of the force that is there beside Bouc-Wen."""
    zeta, share, slip = (np.exp(rng.uniform(np.log(a), np.log(b))) for a, b in ((5e-4, 5e-3), (1e-3, 0.3), (5e-3, 3.0)))
    p = bouc_wen(zeta, share, slip, rng.uniform(1.0, 3.0), rng.uniform(-0.95, 1.0))
    part = np.exp(rng.uniform(np.log(1e-3), np.log(0.1)))
    own = {
        None: [],
        "coulomb_friction": [1e-3 * part * K * AMPLITUDE],
        "cubic_stiffness": [rng.choice([-1.0, 1.0]) * part * K / AMPLITUDE**2],
        "iwan": [part * K, part * K * AMPLITUDE * np.exp(rng.uniform(0.0, 1.5)), rng.uniform(-0.9, -0.1)],
        "jenkins": [part * K, part * K * AMPLITUDE * np.exp(rng.uniform(-1.0, 1.0))],
        "freeplay": [part * K, AMPLITUDE * rng.uniform(0.0, 1.0)],
    }[beside]
    return Oscillator(MASS, ["bouc_wen", *([beside] if beside else [])]), np.array([*p, *own])


@pytest.mark.parametrize("beside", BESIDE)
def test_a_few_cycles_at_each_level_are_the_whole_decay(beside, rng):
    compared, other = 0, 0
    for _ in range(12):
        oscillator, p = draw(beside, rng)
        whole = simulate_backbone(oscillator, p, LEVELS, release_amplitude=RELEASE, sensitivities=True)
        elsewhere = simulate_backbone(oscillator, p, LEVELS, release_amplitude=1.013 * RELEASE, sensitivities=True)
        values = simulate_backbone(oscillator, p, LEVELS)
        jumps = simulate_backbone(oscillator, p, LEVELS, sensitivities=True)
        if np.any(whole.status != 0) or whole.damping.max() > LIGHT:
            continue
        compared += 1
        other += bool(np.any(jumps.values != whole.values))
        for found in (values, jumps):
            assert np.all(found.status == 0)
            np.testing.assert_allclose(found.frequency, whole.frequency, rtol=1e-6)
            np.testing.assert_allclose(found.damping, whole.damping, rtol=1e-4)
            # A bed of sliders remembers its mid-line for ever: what a jump carries of it is good to some per cent.
            np.testing.assert_allclose(found.offset, whole.offset, atol=2e-4)
        # The whole decay, released a little further out, has other cycles, and reads other derivatives from them.
        scatter = np.abs(elsewhere.jacobian - whole.jacobian).max(axis=1, keepdims=True)
        tolerance = np.maximum(2e-3 * np.abs(whole.jacobian).max(axis=1, keepdims=True), 3.0 * scatter)
        # Derivatives of the frequency to what only damps are nearly zero; below 1e-6 of the frequency nothing counts.
        tolerance[0] = np.maximum(tolerance[0], 1e-6 * whole.frequency.mean() / np.maximum(np.abs(p), 1e-12))
        difference = np.abs(jumps.jacobian - whole.jacobian)
        assert np.all((difference <= tolerance)[:2]), (p, (difference / (tolerance + 1e-300))[:2].max(axis=1))
    assert compared >= 3
    assert other > 0 or beside == "jenkins"  # a slider that slips is left to the whole decay


def test_a_known_release_is_where_it_begins_and_one_too_low_is_raised():
    """SciPy from the release: little above the highest level the first loading is not forgotten there."""
    oscillator = Oscillator(MASS, "bouc_wen")
    p = np.array(bouc_wen(1e-4, 0.23, 1.3, 1.62, 0.34))
    simulator = Simulator(oscillator)
    levels = AMPLITUDE * np.array([0.4, 0.55, 0.75, 1.0])

    def backbone(release):
        values, status = np.empty((3, levels.size)), np.zeros(levels.size, dtype=np.int64)
        simulator.backbone(p, levels, release, True, values, np.zeros((0, 0, 0)), status, whole=False)
        assert np.all(status == 0)
        return values

    release = 1.2 * AMPLITUDE
    row = cycles(*Decay(oscillator, p).turning_points(release, 200))[:, ::-1]
    assert row[0, 0] < levels[0] and row[0, -1] > levels[-1]
    expected = CubicSpline(np.log(row[0]), row[2])(np.log(levels))
    # the first cycles are few for a spline: it is read where three of them lie above
    inner = levels < row[0, -4]
    np.testing.assert_allclose(backbone(release)[1][inner], expected[inner], rtol=1e-4)
    whole = simulate_backbone(oscillator, p, levels, release_amplitude=release).values
    np.testing.assert_allclose(backbone(release)[1], whole[1], rtol=1e-4)
    default = simulate_backbone(oscillator, p, levels).values
    # negative control: from another release it is another mid-line and another damping
    assert abs(default[2, -1] - whole[2, -1]) > 0.2 * abs(whole[2, -1])
    assert abs(default[1, -1] / whole[1, -1] - 1.0) > 5.0 * 1e-4
    np.testing.assert_array_equal(backbone(0.0), default)
    low = backbone(0.9 * AMPLITUDE)  # no cycle of it reaches the highest level
    assert np.all(simulate_backbone(oscillator, p, levels, release_amplitude=0.9 * AMPLITUDE).status[-1:] != 0)
    assert np.isfinite(low).all()


@pytest.mark.parametrize(("slip", "exponent", "ratio"), [(0.02, 1.0, 0.6), (0.5, 1.5, -0.5), (3.0, 2.0, 0.3)])
def test_jumps_agree_with_scipy(slip, exponent, ratio):
    """SciPy runs every cycle from the release; a spline between its cycles is read at the levels."""
    oscillator = Oscillator(MASS, "bouc_wen")
    p = np.array(bouc_wen(0.003, 0.01, slip, exponent, ratio))
    levels = AMPLITUDE * np.array([0.3, 0.55, 1.0])
    found = simulate_backbone(oscillator, p, levels)
    whole = simulate_backbone(oscillator, p, levels, release_amplitude=RELEASE)
    assert np.any(found.values != whole.values)
    row = cycles(*Decay(oscillator, p).turning_points(RELEASE, 180))[:, ::-1]
    assert row[0, 0] < levels[0]
    for observable, tolerance in ((0, 1e-7), (1, 5e-5)):
        expected = CubicSpline(np.log(row[0]), row[1 + observable])(np.log(levels))
        np.testing.assert_allclose(found.values[observable], expected, rtol=tolerance)


@pytest.mark.parametrize(("name", "own"), [("quadratic_stiffness", [0.05 * K / AMPLITUDE]), ("jenkins", [20.0, 0.1])])
def test_what_has_no_mirror_image_or_slips_wholly_is_run_as_a_whole(name, own):
    p = [*bouc_wen(0.002, 0.05, 0.2, 1.0, 0.5), *own]
    one = simulate_backbone(Oscillator(MASS, ["bouc_wen", name]), p, LEVELS, sensitivities=True)
    whole = simulate_backbone(
        Oscillator(MASS, ["bouc_wen", name]), p, LEVELS, release_amplitude=RELEASE, sensitivities=True
    )
    np.testing.assert_array_equal(one.values, whole.values)
    np.testing.assert_array_equal(one.jacobian, whole.jacobian)


def test_derivatives_to_what_would_break_the_symmetry_are_those_of_the_whole_decay():
    """A quadratic spring of zero stiffness changes no value, but its derivative shifts the mid-line."""
    oscillator = Oscillator(MASS, ["bouc_wen", "quadratic_stiffness"])
    p = [*bouc_wen(0.001, 0.02, 0.5, 1.5, 0.3), 0.0]
    jumps = simulate_backbone(oscillator, p, LEVELS, sensitivities=True)
    whole = simulate_backbone(oscillator, p, LEVELS, release_amplitude=RELEASE, sensitivities=True)
    np.testing.assert_array_equal(jumps.jacobian, whole.jacobian)
    jumped = simulate_backbone(oscillator, p, LEVELS).values
    assert np.abs(jumped / whole.values - 1.0)[:2].max() > 1e-9  # more than rounding: the values alone are jumped to


@pytest.mark.parametrize("sensitivities", [False, True])
def test_jumps_run_through_a_fraction_of_the_half_cycles(sensitivities):
    simulator = Simulator(Oscillator(MASS, "bouc_wen"))
    p = np.array(bouc_wen(0.001, 0.02, 0.5, 1.5, 0.3))
    values, status = np.zeros((3, LEVELS.size)), np.zeros(LEVELS.size, dtype=np.int64)
    jacobian = np.zeros((3, LEVELS.size, p.size) if sensitivities else (0, 0, 0))

    def half_cycles(release):
        before = half_cycles_run()
        simulator.backbone(p, LEVELS, release, True, values, jacobian, status)
        return half_cycles_run() - before

    assert half_cycles(RELEASE) > 5 * half_cycles(0.0) > 0
