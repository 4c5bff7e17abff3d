"""Tabulated forces against SciPy's splines: the force, its node forces, its gradient beyond the range."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone.effects import LIBRARY
from pymc_backbone.effects._spline import slope_matrix
from pymc_backbone.simulation.decay import simulate_decay, simulate_waveform

from .decay_cases import AMPLITUDE, MASS, OMEGA, oscillator_of, parameters_of
from .decay_oracles import Decay, tabulated_damping, tabulated_stiffness

STIFFNESS, DAMPING = LIBRARY["tabulated_stiffness"], LIBRARY["tabulated_damping"]
NONE = np.zeros(0)


def drawn(effect, rng, reach):
    return np.array([*rng.standard_normal(len(effect.parameters) - 1), reach])


def test_spring_is_the_spline_through_its_nodes(rng):
    p = drawn(STIFFNESS, rng, 0.3)
    odd, even = np.array([*p[1:12], p[0]]), p[12:24]
    for j in range(1, 13):
        x = 0.3 * j / 12.0
        assert STIFFNESS.force(x, 0.0, 1.0, NONE, p) == pytest.approx(even[j - 1] + odd[j - 1], abs=1e-13)
        assert STIFFNESS.force(-x, 0.0, 1.0, NONE, p) == pytest.approx(even[j - 1] - odd[j - 1], abs=1e-13)
    assert STIFFNESS.force(0.0, 1.0, 1.0, NONE, p) == 0.0
    for x in rng.uniform(-0.6, 0.6, 200):
        # the same spline by other arithmetic; the node forces are of order one
        assert STIFFNESS.force(x, 0.0, 1.0, NONE, p) == pytest.approx(tabulated_stiffness(x, 0.0, 1.0, p), abs=1e-11)


def test_damper_is_the_spline_through_its_nodes(rng):
    p = drawn(DAMPING, rng, 2.0)
    odd, even = np.array([*p[1:11], p[0]]), np.array([0.0, *p[11:21]])
    for j in range(11):
        v = 2.0 * (j / 10.0) ** 2
        assert DAMPING.force(0.0, v, 1.0, NONE, p) == pytest.approx(even[j] + odd[j], abs=1e-13)
        assert DAMPING.force(0.0, -v, -1.0, NONE, p) == pytest.approx(even[j] - odd[j], abs=1e-13)
    for v in rng.uniform(-4.0, 4.0, 200):
        for d in (-1.0, 1.0):
            assert DAMPING.force(0.0, v, d, NONE, p) == pytest.approx(tabulated_damping(0.0, v, d, p), abs=1e-11)


@pytest.mark.parametrize("effect", [STIFFNESS, DAMPING], ids=lambda e: e.name)
def test_force_is_linear_in_its_nodes_and_gone_without_them(effect, rng):
    one, two = drawn(effect, rng, 1.5), drawn(effect, rng, 1.5)
    both = np.array([*(2.0 * one[:-1] - 3.0 * two[:-1]), 1.5])
    for x, v in rng.uniform(-3.0, 3.0, (50, 2)):
        d = 1.0 if v > 0.0 else -1.0
        combined = 2.0 * effect.force(x, v, d, NONE, one) - 3.0 * effect.force(x, v, d, NONE, two)
        assert effect.force(x, v, d, NONE, both) == pytest.approx(combined, abs=1e-11)
        assert effect.force(x, v, d, NONE, np.array([*np.zeros(one.size - 1), 1.5])) == 0.0
    assert effect.force(1.0, 1.0, 1.0, NONE, np.array([*one[:-1], 0.0])) == 0.0  # no range


def test_gradient_beyond_the_range_is_that_of_a_straight_line(rng):
    out = np.empty(2 + 25)
    p = drawn(STIFFNESS, rng, 0.5)
    for x in (0.6, -0.9):
        STIFFNESS.gradient(x, 0.0, 1.0, NONE, p, out)
        force = [STIFFNESS.force(at, 0.0, 1.0, NONE, p) for at in (x - 0.05, x, x + 0.05)]
        assert out[0] == pytest.approx((force[2] - force[0]) / 0.1, rel=1e-9)
        assert force[1] == pytest.approx(0.5 * (force[0] + force[2]), rel=1e-9)
        assert out[2:26] @ p[:24] == pytest.approx(force[1], rel=1e-12)  # linear in the nodes


def test_slopes_of_a_cubic_are_exact_and_of_a_quartic_not():
    nodes = np.array([0.0, 0.1, 0.4, 0.9, 1.0])
    matrix = slope_matrix(nodes)
    np.testing.assert_allclose(matrix @ (nodes**3 - nodes), 3.0 * nodes**2 - 1.0, atol=1e-12)
    assert np.abs(matrix @ nodes**4 - 4.0 * nodes**3).max() > 1e-3


def bent(name, rng):
    """An oscillator with a smooth curve that is no cubic, and its parameters: the splines bend at their nodes."""
    oscillator = oscillator_of((name,))
    p = parameters_of(oscillator)
    force = MASS * OMEGA**2 * AMPLITUDE
    count = len(LIBRARY[name].parameters) - 1
    u = np.arange(count) / count
    share = 0.1 if name == "tabulated_stiffness" else 0.01
    p[2:-1] += share * force * 0.2 * np.sin(9.0 * u + rng.uniform(0.0, 6.0))
    return oscillator, p


@pytest.mark.parametrize("name", ["tabulated_stiffness", "tabulated_damping"])
def test_decay_with_bent_curves_is_that_of_scipy(name, rng):
    oscillator, p = bent(name, rng)
    oracle = Decay(oscillator, p)
    times, values = oracle.turning_points(AMPLITUDE, 6)
    found = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=3)
    # steps do not end where the third derivative of the force jumps: measured 1e-6
    np.testing.assert_allclose(found.turning_times[: times.size], times[: found.turning_times.size], rtol=1e-5)
    np.testing.assert_allclose(
        found.turning_values[: values.size], values[: found.turning_values.size], atol=1e-5 * AMPLITUDE
    )


@pytest.mark.parametrize("name", ["tabulated_stiffness", "tabulated_damping"])
def test_derivatives_to_node_forces_are_those_of_differences(name, rng):
    oscillator, p = bent(name, rng)
    time = np.linspace(0.02, 6.0 * np.pi / OMEGA, 90)
    found = simulate_waveform(oscillator, p, time, AMPLITUDE, sensitivities=True)
    force = MASS * OMEGA**2 * AMPLITUDE
    largest = np.abs(found.jacobian[:, 2:-1]).max()
    for j in range(2, p.size - 1):
        step = np.zeros(p.size)
        step[j] = 1e-3 * force
        above, below = (simulate_waveform(oscillator, p + by, time, AMPLITUDE).displacement for by in (step, -step))
        # the decay is nearly linear in a force this small; steps err by 1e-6 of the amplitude, over 2e-3 of the force
        difference = (above - below) / (2e-3 * force)
        np.testing.assert_allclose(found.jacobian[:, j], difference, atol=3e-3 * largest, err_msg=f"column {j}")
    assert largest > 0.1 * AMPLITUDE / force
