"""Simulated velocity and acceleration against SciPy's, and their derivatives against differences of themselves."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation import decay
from pymc_backbone.simulation.decay import simulate_decay, simulate_waveform
from pymc_backbone.simulation.results import Status

from .decay_cases import (
    AMPLITUDE,
    COMBINATIONS,
    EFFECTS,
    MASS,
    MAXWELL,
    OMEGA,
    SINH,
    STOP,
    name_of,
    oscillator_of,
    parameters_of,
)
from .decay_oracles import Decay
from .test_decay_sensitivities import SMOOTH, exactly, prepare, richardson

__all__ = ["exactly"]  # a fixture

CASES = (*SMOOTH, *COMBINATIONS, (MAXWELL,), (SINH,), (STOP, "cubic_damping"))
# The law is rounded over less than the first step after a turning point: inside of it the polynomial is less exact.
ROUNDED = {("power_damping",): 3e-7}
RATES = (("velocity", OMEGA), ("acceleration", OMEGA**2))


@pytest.mark.parametrize("effects", EFFECTS + COMBINATIONS, ids=name_of)
def test_velocity_and_acceleration_are_those_of_scipy(effects):
    oscillator = oscillator_of(effects)
    amplitude = 1.0 if "pendulum_stiffness" in effects else AMPLITUDE
    p = parameters_of(oscillator, amplitude=amplitude)
    oracle = Decay(oscillator, p)
    times, _ = oracle.turning_points(amplitude, 5)
    time = np.linspace(0.0, times[-1], 298)[1:-1]  # none at a turning point
    velocity, acceleration = oracle.rates(time)
    found = simulate_waveform(oscillator, p, time, amplitude, quantity="velocity").values
    # the displacement is held to 1e-7; the acceleration follows from the equation, or is a derivative
    np.testing.assert_allclose(found, velocity, atol=ROUNDED.get(effects, 1e-7) * OMEGA * amplitude)
    found = simulate_waveform(oscillator, p, time, amplitude, quantity="acceleration").values
    np.testing.assert_allclose(found, acceleration, atol=1e-6 * OMEGA**2 * amplitude)


@pytest.mark.parametrize("effects", CASES, ids=name_of)
def test_rates_have_the_derivatives_of_their_differences(effects, exactly):
    oscillator, p = prepare(effects)
    time = np.linspace(0.0, 5.0 * np.pi / OMEGA, 160)[1:]
    everything = np.append(AMPLITUDE, p)
    for quantity, rate in RATES:
        result = exactly(derivatives, oscillator, everything, time, quantity)
        slopes = np.column_stack([result.release_slope, result.jacobian]) * everything
        # a jump or a kink of the acceleration within the step of the difference has no derivative
        for j in range(everything.size):
            difference = exactly(richardson, Values(oscillator, time, quantity), everything, j, 1e-4)
            scale = max(np.abs(slopes[:, j]).max(), 1e-3 * rate * AMPLITUDE)
            assert np.mean(np.abs(slopes[:, j] - difference) < 2e-4 * scale) > 0.97, f"{quantity}, column {j}"
        step = 1e-4 / OMEGA
        above, below = (exactly(Values(oscillator, time + by, quantity), everything) for by in (step, -step))
        near = np.abs(result.time_slope - (above - below) / (2.0 * step)) < 1e-4 * rate * OMEGA * AMPLITUDE
        assert np.mean(near) > 0.97, f"{quantity}, time"


def derivatives(oscillator, everything, time, quantity):
    return simulate_waveform(oscillator, everything[1:], time, everything[0], sensitivities=True, quantity=quantity)


class Values:
    """What is simulated, as a function of release amplitude and parameters."""

    def __init__(self, oscillator, time, quantity):
        self.oscillator, self.time, self.quantity = oscillator, time, quantity

    def __call__(self, everything):
        return simulate_waveform(
            self.oscillator, everything[1:], self.time, everything[0], quantity=self.quantity
        ).values


def test_friction_makes_the_acceleration_jump_at_the_turning_point():
    friction = 0.04 * MASS * OMEGA**2 * AMPLITUDE
    oscillator = Oscillator(MASS, ("coulomb_friction",))
    p = [MASS * OMEGA**2, 0.0, friction]
    run = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=2)
    tiny = 1e-6 / OMEGA
    for turn, value, direction in zip(run.turning_times[1:4], run.turning_values[1:4], (-1.0, 1.0, -1.0), strict=True):
        sides = simulate_waveform(oscillator, p, [turn - tiny, turn + tiny], AMPLITUDE, quantity="acceleration").values
        spring = -(OMEGA**2) * value
        # the force of friction points against the motion: that of the half cycle before, then of the next one
        np.testing.assert_allclose(sides, spring + np.array([-1.0, 1.0]) * direction * friction / MASS, rtol=1e-5)


def test_what_is_held_does_not_move():
    oscillator = Oscillator(MASS, ("coulomb_friction",))
    p = [MASS * OMEGA**2, 0.0, 0.2 * MASS * OMEGA**2 * AMPLITUDE]
    time = np.linspace(-0.1, 2.0, 400)
    for quantity, _ in RATES:
        found = simulate_waveform(oscillator, p, time, AMPLITUDE, sensitivities=True, quantity=quantity)
        assert found.status == Status.STUCK
        held = (time < 0.0) | (time > 1.0)
        for part in (found.values, found.jacobian, found.release_slope, found.time_slope):
            assert np.all(part[held] == 0.0) and np.any(part[~held] != 0.0)


def test_a_rate_is_not_handed_out_as_displacement():
    oscillator = Oscillator(MASS)
    p = [MASS * OMEGA**2, 0.1]
    found = simulate_waveform(oscillator, p, [0.0, 0.1], AMPLITUDE, quantity="velocity")
    with pytest.raises(InputError, match="read `values`"):
        _ = found.displacement
    with pytest.raises(InputError, match="velocity"):
        simulate_waveform(oscillator, p, [0.0, 0.1], AMPLITUDE, quantity="velocty")
    assert decay.QUANTITIES == ("displacement", "velocity", "acceleration")
