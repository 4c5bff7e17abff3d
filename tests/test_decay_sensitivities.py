"""Derivatives of the simulated backbone and waveform against Richardson's differences of the simulation itself.

The differences are taken at a step tolerance of 1e-13, so that their noise is far below the 1e-5 asked for.
"""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone.simulation import decay
from pymc_backbone.simulation.decay import simulate_backbone, simulate_decay, simulate_waveform

from .decay_cases import (
    AMPLITUDE,
    COMBINATIONS,
    EFFECTS,
    MASS,
    MAXWELL,
    OMEGA,
    SINH,
    STOP,
    TABULATED,
    name_of,
    oscillator_of,
    parameters_of,
)
from .decay_oracles import Decay, cycle_at

# Differences to a node force bend a tabulated curve: tests/test_tabulated.py holds these to their own accuracy.
SMOOTH = tuple(effects for effects in EFFECTS if not set(effects) & set(TABULATED))
CASES = ((), *SMOOTH, *COMBINATIONS, (MAXWELL,), (SINH,), (STOP, "cubic_damping"), (MAXWELL, "jenkins"))


def richardson(function, p, j, share=2e-3):
    """Return the derivative of ``function`` to p[j] times p[j]; error: the sixth power of ``share``."""

    def central(factor):
        above, below = p.copy(), p.copy()
        above[j] *= 1.0 + factor * share
        below[j] *= 1.0 - factor * share
        return (function(above) - function(below)) / (2.0 * factor * share)

    wide, middle, narrow = central(1.0), central(0.5), central(0.25)
    return (16.0 * (4.0 * narrow - middle) / 3.0 - (4.0 * middle - wide) / 3.0) / 15.0


@pytest.fixture
def exactly(monkeypatch):
    def run(function, *arguments):
        with monkeypatch.context() as patch:
            patch.setattr(decay, "TOLERANCE", 1e-13)
            return function(*arguments)

    return run


def prepare(effects):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator)
    if "bouc_wen" in effects:
        # With a fractional exponent the derivatives themselves have no derivative at z = 0; see the test below.
        p[oscillator.index("bouc_wen_exponent")] = 2.0
        for name in ("bouc_wen_beta", "bouc_wen_gamma"):
            p[oscillator.index(name)] /= AMPLITUDE
    if "offset_freeplay" in effects:
        # Between cycles that touch one stop and both, a curve that is read off a whole decay has a corner.
        p[oscillator.index("play")] *= 0.4
    for name in {"power_damping", "power_displacement_damping"} & set(effects):
        # Damping that is light at all levels, or curves are read off between cycles that are few and far apart.
        p[oscillator.index(name)] *= 0.2
    return oscillator, p


# The slope of this force has a vertical tangent at contact, where the derivatives are integrated with errors that fall
# with the tolerance only slowly: they are held to what is asked for at a tighter one, and to this at the usual one.
# A damper that rises within a hundredth of the displacement, where the speed is largest, has the same in small.
SINGULAR = {("hertz_contact",): 1e-3, ("power_displacement_damping",): 5e-5}


@pytest.mark.parametrize("by_decay", [False, True])
@pytest.mark.parametrize("effects", CASES, ids=name_of)
def test_backbone_sensitivities(effects, by_decay, exactly):
    oscillator, p = prepare(effects)
    release = AMPLITUDE if by_decay else None
    levels = AMPLITUDE * np.array([0.35, 0.5, 0.65])

    def values(q):
        # With derivatives wanted, cycles are taken closer to their levels.
        return simulate_backbone(oscillator, q, levels, release_amplitude=release, sensitivities=True).values

    def differentiate():
        return simulate_backbone(oscillator, p, levels, release_amplitude=release, sensitivities=True)

    expected = np.stack([exactly(richardson, values, p, j) for j in range(p.size)], axis=-1)
    runs = [(differentiate(), SINGULAR.get(effects, 1e-5))]
    if effects in SINGULAR:
        runs.append((exactly(differentiate), 1e-5))
    for found, tolerance in runs:
        assert np.all(found.status == 0)
        for row in range(3):
            largest = np.abs(expected[row]).max()
            np.testing.assert_allclose(found.jacobian[row] * p, expected[row], rtol=0.0, atol=tolerance * largest)


@pytest.mark.parametrize("effects", CASES, ids=name_of)
def test_waveform_sensitivities(effects, exactly):
    oscillator, p = prepare(effects)
    period = 2.0 * np.pi / OMEGA
    time = np.linspace(-0.25 * period, 3.0 * period, 120)
    # Where friction reverses, the derivatives have a corner that differences cannot be taken across.
    turning = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=4).turning_times
    time = time[np.abs(time[:, None] - turning).min(axis=1) > 0.02 * period]
    wide = np.append(p, AMPLITUDE)

    def displacement(q):
        return simulate_waveform(oscillator, q[:-1], time, q[-1]).displacement

    found = simulate_waveform(oscillator, p, time, AMPLITUDE, sensitivities=True)
    columns = np.column_stack([found.jacobian, found.release_slope]) * wide
    largest = np.abs(columns).max()
    for j in range(wide.size):
        expected = exactly(richardson, displacement, wide, j)
        np.testing.assert_allclose(columns[:, j], expected, rtol=0.0, atol=1e-5 * largest, err_msg=f"column {j}")


def test_a_fractional_bouc_wen_exponent_costs_accuracy_of_derivatives_only(exactly):
    oscillator = oscillator_of("bouc_wen")
    p = parameters_of(oscillator)
    assert oscillator.parameter_names[-1] == "bouc_wen_exponent"
    p[-1] = 1.55
    levels = AMPLITUDE * np.array([0.35, 0.5, 0.65])

    def values(q):
        return simulate_backbone(oscillator, q, levels).values

    expected = np.stack([exactly(richardson, values, p, j) for j in range(p.size)], axis=-1)
    found = simulate_backbone(oscillator, p, levels, sensitivities=True).jacobian * p
    for row in range(3):
        # |z|^n has no second derivative at z = 0, where steps end: measured 3e-5 (offset), 6e-6 (the others).
        np.testing.assert_allclose(found[row], expected[row], rtol=0.0, atol=1e-4 * np.abs(expected[row]).max())


def test_sensitivities_are_those_of_scipy():
    """One case without any number from the package: differences of SciPy's answer."""
    oscillator = oscillator_of(("freeplay", "quadratic_damping"))
    p = parameters_of(oscillator)
    level = 0.7 * AMPLITUDE
    expected = np.stack(
        [richardson(lambda q: cycle_at(Decay(oscillator, q), level), p, j, 1e-2) for j in range(p.size)], axis=-1
    )
    found = simulate_backbone(oscillator, p, [level], sensitivities=True).jacobian[:, 0] * p
    for row in range(2):
        # The differences' own error at this width is 1e-6.
        np.testing.assert_allclose(found[row], expected[row], rtol=0.0, atol=1e-5 * np.abs(expected[row]).max())


def test_sensitivities_do_not_depend_on_the_other_levels():
    oscillator, p = prepare(("coulomb_friction", "cubic_stiffness"))
    levels = AMPLITUDE * np.geomspace(0.3, 0.9, 7)
    together = simulate_backbone(oscillator, p, levels, sensitivities=True)
    for k, level in enumerate(levels):
        alone = simulate_backbone(oscillator, p, [level], sensitivities=True)
        np.testing.assert_allclose(together.values[:, k], alone.values[:, 0], rtol=1e-8, atol=1e-9)
        for row in range(3):
            largest = np.abs(alone.jacobian[row] * p).max()
            np.testing.assert_allclose(together.jacobian[row, k] * p, alone.jacobian[row, 0] * p, atol=1e-5 * largest)


def test_values_do_not_depend_on_whether_sensitivities_are_wanted():
    for effects in CASES:
        oscillator, p = prepare(effects)
        levels = AMPLITUDE * np.geomspace(0.3, 0.7, 4)
        plain = simulate_backbone(oscillator, p, levels)
        assert plain.jacobian is None
        both = simulate_backbone(oscillator, p, levels, sensitivities=True)
        # Cycles are carried to their levels in different ways: a few 1e-9.
        np.testing.assert_allclose(plain.values, both.values, rtol=3e-7, atol=1e-8, err_msg=name_of(effects))


def test_derivative_to_mass_units():
    """Frequency and decrement depend on stiffness over mass: the derivative to k is half f over k, undamped."""
    oscillator = oscillator_of(())
    k = MASS * OMEGA**2
    result = simulate_backbone(oscillator, [k, 0.0], [1.0, 2.0], sensitivities=True)
    np.testing.assert_allclose(result.jacobian[0, :, 0], 0.5 * result.frequency / k, rtol=1e-8)
    # d(decrement)/dc = pi / (m omega)
    np.testing.assert_allclose(result.jacobian[1, :, 1], np.pi / (MASS * OMEGA), rtol=1e-8)
