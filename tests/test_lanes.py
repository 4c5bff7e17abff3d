"""Lanes against the simulator of single ones, closed forms, and what lanes must not answer."""

import math

import numba
import numpy as np
import pytest
from scipy.special import ellipk

from pymc_backbone import Effect, Oscillator, Parameter, simulate_backbone, simulate_population
from pymc_backbone.effects import BASE_EFFECTS, LIBRARY
from pymc_backbone.simulation import many
from pymc_backbone.simulation.decay import Simulator
from pymc_backbone.simulation.lane_cycles import is_smooth
from pymc_backbone.simulation.lane_levels import LEAST_DAMPING
from pymc_backbone.simulation.lanes import lane_backbones

MASS, OMEGA = 1.3, 2.0 * math.pi * 20.0
SMOOTH = [name for name, effect in LIBRARY.items() if is_smooth(effect) and name not in BASE_EFFECTS]
ACCURACY = 1e-6  # what is promised, of frequency and damping relative, of the offset absolute


def draw(oscillator, amplitude, count, seed, *, strength=0.3, damping=(1e-3, 0.15)):
    """Return parameter vectors; strengths over a share of the default priors, springs of both signs."""
    rng = np.random.default_rng(seed)
    strengths = {name for effect in oscillator.effects for name in effect.with_role("strength")}
    bounds = oscillator.default_bounds(amplitude, OMEGA)
    stiffness = MASS * OMEGA**2
    columns = []
    for name in oscillator.parameter_names:
        low, high = bounds[name]
        if name == "linear_stiffness":
            columns.append(rng.uniform(0.9, 1.1, count) * stiffness)
        elif name == "viscous_damping":
            ratio = np.exp(rng.uniform(*np.log(damping), count))
            columns.append(2.0 * ratio * MASS * OMEGA)
        else:
            columns.append((strength if name in strengths else 1.0) * rng.uniform(low, high, count))
    return np.column_stack(columns)


def exact(oscillator, parameters, levels):
    """Return values of the simulator of single ones at a hundredth of its usual tolerance, NaN where it has none.

    Level by level: then none is carried along the curve between levels, which costs 1e-6 where the curve is steep.
    """
    simulator = Simulator(oscillator)
    values = np.empty((len(parameters), 3, levels.size))
    for k in range(levels.size):
        description = simulator.describe(levels[k : k + 1], tolerance=2e-11)
        for row, one in enumerate(parameters):
            here = np.empty((3, 1))
            many.kernels.backbone(*description, one, here, np.empty((0, 0, 0)), np.zeros(1, dtype=np.int64))
            values[row, :, k] = here[:, 0]
    return values


def errors(values, reference):
    """Return the largest errors of each vector as they are promised; NaN only where both are."""
    assert np.array_equal(np.isnan(values), np.isnan(reference))
    size = np.ones_like(reference)
    size[:, 0] = reference[:, 0]
    size[:, 1] = np.clip(np.abs(reference[:, 1]), LEAST_DAMPING, 1.0)
    return np.nan_to_num(np.abs(values - reference) / size).max(axis=(1, 2))


def judge(oscillator, parameters, levels):
    """Hold what lanes answer to a tighter simulation, and the rest, bit for bit, to the simulator of single ones.

    Returns which were answered in lanes.
    """
    simulator = Simulator(oscillator)
    values, status = many.simulate_many(simulator, parameters, levels)
    single, single_status = many.simulate_many(simulator, parameters, levels, least=len(parameters) + 1)
    alone, estimate = in_lanes(simulator, parameters, levels)
    taken = estimate <= many.ACCURACY
    assert np.array_equal(status, single_status)  # no lane swings that does not
    assert np.array_equal(values[~taken], single[~taken], equal_nan=True)
    assert np.array_equal(values[taken], alone[taken])
    assert errors(values[taken], exact(oscillator, parameters[taken], levels)).max(initial=0.0) < ACCURACY
    return taken


def levels_of(oscillator, count=10):
    """Return levels, for a pendulum up to one radian, and the highest."""
    amplitude = 1.0 if "pendulum_stiffness" in [effect.name for effect in oscillator.effects] else 1e-3
    return np.geomspace(0.1 * amplitude, amplitude, count), amplitude


def in_lanes(simulator, parameters, levels):
    """Return what lanes alone say, and their own estimate of its error."""
    values = np.full((len(parameters), 3, levels.size), np.nan)
    return values, many._in_lanes(simulator.describe(levels), parameters, levels, values)


# --- against the simulator of single ones --------------------------------------------------------------------------


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("strength", [0.03, 1.0])
def test_every_smooth_effect_is_as_without_lanes(name, strength, random_seed):
    oscillator = Oscillator(MASS, [name])
    levels, amplitude = levels_of(oscillator)
    parameters = draw(oscillator, amplitude, 600, random_seed, strength=strength)
    judge(oscillator, parameters, levels)


@pytest.mark.parametrize("name", SMOOTH)
def test_lanes_answer_where_effects_are_moderate(name, random_seed):
    """Without this the simulator of single ones could have answered everything above."""
    oscillator = Oscillator(MASS, [name])
    levels, amplitude = levels_of(oscillator)
    parameters = draw(oscillator, amplitude, 600, random_seed, strength=0.03, damping=(1e-3, 0.02))
    assert judge(oscillator, parameters, levels).mean() > 0.95


def test_several_effects_at_once(random_seed):
    oscillator = Oscillator(MASS, ["cubic_stiffness", "quadratic_damping", "coulomb_friction"])
    levels, amplitude = levels_of(oscillator)
    parameters = draw(oscillator, amplitude, 600, random_seed, strength=0.1)
    judge(oscillator, parameters, levels)


@pytest.mark.parametrize("draw_number", range(6))
def test_any_mixture_of_effects_and_levels(draw_number, random_seed):
    """Strengths over two decades, up to three effects, one to twelve levels, evenly spaced or not."""
    rng = np.random.default_rng([random_seed, draw_number])
    names = [str(name) for name in rng.choice(SMOOTH, draw_number % 3 + 1, replace=False)]
    oscillator = Oscillator(MASS, names)
    _, amplitude = levels_of(oscillator)
    lowest = amplitude / 10.0 ** rng.uniform(0.2, 1.5)
    count = int(rng.integers(1, 13))
    even = np.geomspace(lowest, amplitude, count)
    levels = even if draw_number % 2 else np.sort(rng.uniform(lowest, amplitude, count))
    strength = 10.0 ** rng.uniform(-1.5, 0.2) / len(names)
    judge(oscillator, draw(oscillator, amplitude, 512, random_seed, strength=strength, damping=(1e-4, 0.3)), levels)


@pytest.mark.parametrize("levels", [[1e-3], [2e-4, 1e-3], [1e-4, 2e-4, 9e-4], [1e-5, 1e-4, 1e-3, 1.1e-3, 1.2e-3]])
def test_few_levels_and_levels_far_apart(levels, random_seed):
    oscillator = Oscillator(MASS, ["cubic_stiffness", "quadratic_damping"])
    parameters = draw(oscillator, 1e-3, 600, random_seed, strength=0.1, damping=(1e-3, 0.03))
    at = np.array(levels)
    assert judge(oscillator, parameters, at).mean() > 0.95


# --- hard cases: right, or left to the simulator of single ones -----------------------------------------------------

HARD = {
    "heavy damping": ((), {"viscous_damping": (0.05, 0.3)}),
    "near the escape": (("cubic_stiffness",), {"cubic_stiffness": (-0.99, -0.6)}),
    "strong quintic": (("quintic_stiffness",), {"quintic_stiffness": (1.0, 5.0)}),
    "strong cubic": (("cubic_stiffness",), {"cubic_stiffness": (1.0, 5.0)}),
    "asymmetric": (("quadratic_stiffness",), {"quadratic_stiffness": (0.3, 0.6)}),
    "nearly stuck": (("coulomb_friction",), {"friction_force": (0.005, 0.2)}),
}
"""Springs in units of the linear force at the highest level, friction too, damping as a ratio."""


@pytest.mark.parametrize("case", HARD)
def test_hard_cases_are_never_wrong_in_silence(case, random_seed):
    names, ranges = HARD[case]
    oscillator = Oscillator(MASS, names)
    levels, amplitude = levels_of(oscillator)
    stiffness = MASS * OMEGA**2
    powers = {"cubic_stiffness": 3, "quintic_stiffness": 5, "quadratic_stiffness": 2, "friction_force": 0}
    count = 600
    rng = np.random.default_rng(random_seed)
    columns = []
    for name in oscillator.parameter_names:
        low, high = ranges.get(name, (0.002, 0.15))
        drawn = rng.uniform(low, high, count)
        if name == "linear_stiffness":
            columns.append(np.full(count, stiffness))
        elif name == "viscous_damping":
            columns.append(2.0 * drawn * MASS * OMEGA)
        else:
            columns.append(drawn * stiffness * amplitude ** (1 - powers[name]))
    parameters = np.column_stack(columns)
    judge(oscillator, parameters, levels)


def test_what_lanes_must_leave_alone_stays_so(random_seed):
    """The estimate is no decoration: with too few steps most lanes are wrong, and all of them say so."""
    oscillator = Oscillator(MASS, ["quintic_stiffness"])
    levels, amplitude = levels_of(oscillator)
    parameters = draw(oscillator, amplitude, 512, random_seed, strength=1.0, damping=(1e-3, 0.03))
    parameters[:, 2] = np.abs(parameters[:, 2])
    values, estimate = np.empty((512, 3, 10)), np.empty(512)
    steps = np.full(4, 2)
    lane_backbones(*Simulator(oscillator).describe(levels), parameters, np.arange(512), steps, True, values, estimate)
    wrong = errors(values, exact(oscillator, parameters, levels)) > ACCURACY
    assert wrong.mean() > 0.9
    assert not (estimate[wrong] <= many.ACCURACY).any()


def test_numbers_that_are_none_are_answered_as_without_lanes():
    oscillator = Oscillator(MASS, ["cubic_stiffness"])
    parameters = np.tile([MASS * OMEGA**2, 1.0, 0.0], (600, 1))
    parameters[7, 2] = np.nan
    parameters[8, 0] = -parameters[8, 0]
    parameters[9, 1] = np.inf
    values, status = many.simulate_many(Simulator(oscillator), parameters, np.geomspace(1e-4, 1e-3, 6))
    assert (status[[7, 8, 9]] != 0).all()
    assert np.isnan(values[[7, 8, 9]]).all()
    assert not np.delete(status, [7, 8, 9], axis=0).any()


# --- closed forms --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_undamped_duffing_oscillator_in_closed_form(sign, random_seed):
    """x'' + k x + k3 x^3 = 0 from rest at a: a period of 4 K(m) / sqrt(k + k3 a^2), m = k3 a^2 / 2 / (k + k3 a^2)."""
    oscillator = Oscillator(1.0, ["cubic_stiffness"])
    levels = np.geomspace(0.1, 1.0, 8)
    rng = np.random.default_rng(random_seed)
    k, cubic = rng.uniform(0.5, 2.0, 600), sign * rng.uniform(0.0, 0.4, 600)
    values, _ = many.simulate_many(Simulator(oscillator), np.column_stack([k, np.zeros(600), cubic]), levels)
    spring = k[:, None] + cubic[:, None] * levels**2
    frequency = np.sqrt(spring) / (4.0 * ellipk(0.5 * cubic[:, None] * levels**2 / spring))
    np.testing.assert_allclose(values[:, 0], frequency, rtol=ACCURACY)
    np.testing.assert_allclose(values[:, 1], 0.0, atol=ACCURACY * LEAST_DAMPING)
    np.testing.assert_allclose(values[:, 2], 0.0, atol=ACCURACY)


def test_linear_damping_in_closed_form():
    ratio = np.linspace(0.0, 0.3, 600)
    parameters = np.column_stack([np.ones(600), 2.0 * ratio])
    values, _ = many.simulate_many(Simulator(Oscillator(1.0)), parameters, np.geomspace(0.1, 1.0, 6))
    damped = np.sqrt(1.0 - ratio**2)[:, None]
    np.testing.assert_allclose(values[:, 0], np.broadcast_to(damped / (2.0 * np.pi), (600, 6)), rtol=ACCURACY)
    expected = np.broadcast_to(2.0 * np.pi * ratio[:, None] / damped, (600, 6))
    assert (np.abs(values[:, 1] - expected) <= ACCURACY * np.maximum(expected, LEAST_DAMPING)).all()


def test_coulomb_friction_takes_the_same_from_each_half_cycle():
    """Without viscous damping a half cycle loses 2 f / k of the peak, whatever its size."""
    oscillator = Oscillator(1.0, ["coulomb_friction"])
    friction = np.linspace(0.0, 0.01, 600)
    levels = np.geomspace(0.1, 1.0, 6)
    parameters = np.column_stack([np.ones(600), np.zeros(600), friction])
    values, _ = many.simulate_many(Simulator(oscillator), parameters, levels)
    loss = 2.0 * friction[:, None]
    # p0, -(p0 - loss), p0 - 2 loss: amplitude p0 - loss
    expected = 2.0 * np.log((2.0 * levels + loss) / (2.0 * levels - loss))
    assert (np.abs(values[:, 1] - expected) <= ACCURACY * np.maximum(expected, LEAST_DAMPING)).all()
    np.testing.assert_allclose(values[:, 0], 1.0 / (2.0 * np.pi), rtol=ACCURACY)


# --- when lanes are taken ------------------------------------------------------------------------------------------


def test_few_vectors_are_bit_for_bit_those_of_the_simulator_of_single_ones(random_seed):
    oscillator = Oscillator(MASS, ["cubic_stiffness"])
    levels = np.geomspace(1e-4, 1e-3, 6)
    parameters = draw(oscillator, 1e-3, many.LEAST - 1, random_seed, strength=0.05, damping=(1e-3, 0.02))
    values, _ = many.simulate_many(Simulator(oscillator), parameters, levels)
    single = np.array([simulate_backbone(oscillator, row, levels).values for row in parameters])
    assert np.array_equal(values, single)
    more = np.vstack([parameters, parameters[:1]])
    in_lanes_too, _ = many.simulate_many(Simulator(oscillator), more, levels)
    assert not np.array_equal(in_lanes_too[:-1], single)  # lanes were taken ...
    assert errors(in_lanes_too[:-1], single).max() < 2.0 * ACCURACY  # ... and both are within their accuracy


@pytest.mark.parametrize("name", sorted(set(LIBRARY) - set(SMOOTH) - set(BASE_EFFECTS)))
def test_kinks_memory_states_and_shapes_stay_out_of_lanes(name, random_seed):
    effect = LIBRARY[name]
    assert effect.regime is not None or effect.has_memory or effect.n_states or len(effect.parameters) > 1
    simulator = Simulator(Oscillator(MASS, [name]))
    assert not many.can_take_lanes(simulator)
    parameters = draw(simulator.oscillator, 1e-3, 8, random_seed)
    levels = np.geomspace(3e-4, 1e-3, 4)
    values, status = many.simulate_many(simulator, parameters, levels, least=1)
    single = [simulate_backbone(simulator.oscillator, row, levels) for row in parameters]
    assert np.array_equal(values, [item.values for item in single], equal_nan=True)
    assert np.array_equal(status, [item.status for item in single])


@numba.njit
def _stop(x, v, direction, z, p):
    return p[0] * x**7


def test_effects_of_ones_own_stay_out_of_lanes():
    own = Effect(
        name="rubber", summary="a stop", text="rubber x^7", latex="k_7 x^7", force=_stop,
        parameters=(Parameter(name="rubber_stiffness", unit="N/m^7", latex="k_7", summary="its coefficient",
                              bounds=lambda mass, amplitude, angular_frequency: (0.0, 1.0)),),
    )  # fmt: skip
    assert not many.can_take_lanes(Simulator(Oscillator(MASS, [own])))


def test_a_given_release_runs_the_whole_decay(random_seed):
    oscillator = Oscillator(MASS, ["cubic_stiffness"])
    levels = np.geomspace(3e-4, 1e-3, 4)
    parameters = draw(oscillator, 1e-3, 5, random_seed, strength=0.05, damping=(1e-2, 0.02))
    simulator = Simulator(oscillator)
    given, _ = many.simulate_many(simulator, parameters, levels, 1.5e-3, least=1)
    single = [simulate_backbone(oscillator, row, levels, release_amplitude=1.5e-3).values for row in parameters]
    assert np.array_equal(given, np.array(single))


def test_populations_are_simulated_in_lanes(random_seed):
    oscillator = Oscillator(MASS, ["cubic_stiffness"])
    levels = np.geomspace(1e-4, 1e-3, 6)
    parameters = draw(oscillator, 1e-3, 700, random_seed, strength=0.05, damping=(1e-3, 0.02))
    population = simulate_population(oscillator, parameters, levels, ("frequency", "damping", "offset"))
    values, _ = many.simulate_many(Simulator(oscillator), parameters, levels)
    assert np.array_equal(population["value"].values, values)
    assert errors(values, exact(oscillator, parameters, levels)).max() < ACCURACY


def test_the_order_of_the_vectors_does_not_matter_beyond_the_accuracy(random_seed):
    oscillator = Oscillator(MASS, ["cubic_stiffness", "quadratic_damping"])
    levels = np.geomspace(1e-4, 1e-3, 8)
    parameters = draw(oscillator, 1e-3, 700, random_seed, strength=0.2)
    shuffled = np.random.default_rng(random_seed).permutation(700)
    one, status = many.simulate_many(Simulator(oscillator), parameters, levels)
    other, other_status = many.simulate_many(Simulator(oscillator), parameters[shuffled], levels)
    assert np.array_equal(status[shuffled], other_status)
    assert errors(one[shuffled], other).max() < 2.0 * ACCURACY
