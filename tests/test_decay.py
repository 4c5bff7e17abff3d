"""The simulator's interface: statuses, invariances, its two paths, its waveform's ends, its compiled code on disk."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pymc_backbone._common import compiled
from pymc_backbone._common.checks import InputError
from pymc_backbone.effects import BASE_EFFECTS, LIBRARY, Effect
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation import forces, memory, stepper
from pymc_backbone.simulation.counts import half_cycles_run
from pymc_backbone.simulation.decay import Simulator, simulate_backbone, simulate_decay, simulate_waveform
from pymc_backbone.simulation.pointers import address, shifted
from pymc_backbone.simulation.results import Status
from pymc_backbone.simulation.run import prepare

from .decay_cases import (
    AMPLITUDE,
    COMBINATIONS,
    EFFECTS,
    MASS,
    MAXWELL,
    OMEGA,
    SINH,
    name_of,
    oscillator_of,
    parameters_of,
)

K, C = MASS * OMEGA**2, 0.02 * MASS * OMEGA
LEVELS = AMPLITUDE * np.geomspace(0.1, 1.0, 6)
FOLDER = Path(__file__).parents[1]


def statuses(effects, parameters, levels=LEVELS, **options):
    result = simulate_backbone(oscillator_of(effects), parameters, levels, **options)
    done = result.status == Status.COMPLETED
    assert np.all(np.isfinite(result.values[:, done]))
    assert np.all(np.isnan(result.values[:, ~done]))
    return [Status(code).name for code in result.status]


# --- statuses ------------------------------------------------------------------------------------------------------


def test_overdamped_motion_does_not_return():
    assert set(statuses((), [K, 2.1 * MASS * OMEGA])) == {"NO_RETURN"}


def test_negative_stiffness_runs_away():
    assert set(statuses("cubic_stiffness", [1e-3 * K, C, -K / AMPLITUDE**2])) == {"RUNAWAY"}
    names = statuses("cubic_stiffness", [K, C, -1.2 * K / AMPLITUDE**2])
    # A softening spring lets go above some amplitude, and is fine below.
    assert names[0] == "COMPLETED" and names[-1] in ("RUNAWAY", "OUT_OF_REACH")


def test_friction_sticks_at_the_lowest_levels_only():
    names = statuses("coulomb_friction", [K, C, 0.15 * K * AMPLITUDE])
    stuck = [name == "STUCK" for name in names]
    assert stuck[0] and not stuck[-1]
    assert stuck == sorted(stuck, reverse=True)
    assert set(names) == {"STUCK", "COMPLETED"}


def test_zero_stiffness_does_not_return():
    assert set(statuses((), [0.0, C])) == {"NO_RETURN"}
    assert set(statuses((), [0.0, 0.0])) == {"NO_RETURN"}


@pytest.mark.parametrize("effects", [(), ("cubic_stiffness",), ("jenkins",), ("bouc_wen",)], ids=name_of)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
def test_parameters_that_are_no_numbers_give_a_status(effects, bad):
    oscillator = oscillator_of(effects)
    simulator = Simulator(oscillator)
    for j in range(len(oscillator.parameter_names)):
        p = parameters_of(oscillator)
        p[j] = bad
        for release in (0.0, AMPLITUDE):
            values, status = np.zeros((3, LEVELS.size)), np.zeros(LEVELS.size, dtype=np.int64)
            simulator.backbone(p, LEVELS, release, True, values, np.zeros((0, 0, 0)), status)
            for k in range(LEVELS.size):
                assert np.all(np.isfinite(values[:, k])) if status[k] == 0 else np.all(np.isnan(values[:, k]))
            if not np.isfinite(bad):
                assert np.all(status == Status.RUNAWAY)


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e6, 1e9])
def test_contact_however_stiff_is_passed(stiffness):
    result = simulate_backbone(oscillator_of("freeplay"), [K, 0.1 * C, stiffness * K, 0.5 * AMPLITUDE], LEVELS)
    below = LEVELS < 0.5 * AMPLITUDE
    assert np.all(result.status[below] == 0)
    # An amplitude beyond a wall as hard as that is out of reach, which has to be said and not searched for ever.
    assert set(result.status[~below].tolist()) <= {Status.COMPLETED, Status.OUT_OF_REACH, Status.NO_RETURN}
    if stiffness <= 1e4:
        assert np.all(result.status == 0)
    reached = result.status == 0
    assert np.all(np.diff(result.frequency[reached]) > -1e-9)


def test_levels_above_the_release_are_out_of_reach():
    for effects in ((), ("coulomb_friction",), ("jenkins",), ("bouc_wen",)):
        p = parameters_of(oscillator_of(effects), share=0.05)
        names = statuses(effects, p, AMPLITUDE * np.array([0.2, 0.5, 1.5]), release_amplitude=AMPLITUDE)
        assert names == ["COMPLETED", "COMPLETED", "OUT_OF_REACH"], effects


def test_levels_far_out_of_reach_are_said_to_be():
    """A quadratic spring has a barrier: no cycle is larger, however far it is drawn."""
    names = statuses("quadratic_stiffness", [K, C, 0.5 * K / AMPLITUDE], AMPLITUDE * np.array([0.5, 50.0]))
    assert names[0] == "COMPLETED" and names[1] in ("RUNAWAY", "OUT_OF_REACH", "NO_RETURN")


def test_a_decay_that_skips_levels_still_answers_between_its_cycles():
    oscillator = oscillator_of("jenkins")
    p = parameters_of(oscillator, zeta=0.12)
    levels = AMPLITUDE * np.linspace(0.1, 0.8, 15)
    result = simulate_backbone(oscillator, p, levels)
    cycles = simulate_decay(oscillator, p, 1.25 * levels[-1], n_cycles=4)
    assert cycles.amplitude[0] / cycles.amplitude[1] > 1.9, "several levels should lie between two cycles"
    assert np.all(result.status == 0)


def test_an_undamped_hysteretic_oscillator_ends_in_good_time():
    oscillator = oscillator_of("bouc_wen")
    p = [K, 0.0, 0.1 * K, 1.0, 0.2, 0.0, 0.0, 1.0]  # an elastic spring: nothing is lost
    before = half_cycles_run()
    result = simulate_backbone(oscillator, p, LEVELS)
    assert half_cycles_run() - before < 2000  # some 400 of each start, instead of 20000
    assert result.status[0] == Status.OUT_OF_REACH


def test_every_status_says_what_to_do():
    for status in Status:
        assert status.meaning
        assert status is Status.COMPLETED or ";" in status.meaning


@pytest.mark.parametrize("sensitivities", [False, True])
@pytest.mark.parametrize("effects", EFFECTS + COMBINATIONS, ids=name_of)
def test_any_draw_from_the_default_bounds_is_answered_soon(effects, sensitivities, rng):
    oscillator = oscillator_of(effects)
    bounds = np.array(list(oscillator.default_bounds(AMPLITUDE, OMEGA).values()))
    simulator = Simulator(oscillator)
    values, status = np.zeros((3, LEVELS.size)), np.zeros(LEVELS.size, dtype=np.int64)
    shape = (3, LEVELS.size, len(bounds)) if sensitivities else (0, 0, 0)
    jacobian = np.zeros(shape)
    most, seen = 0, set()
    draws = 100 if simulator.has_own_equation else 300
    for _ in range(draws):
        p = rng.uniform(bounds[:, 0], bounds[:, 1])
        before = half_cycles_run()
        simulator.backbone(p, LEVELS, 0.0, True, values, jacobian, status)
        # Left out: hysteretic decays with hardly any damping run thousands of cycles.
        if not (simulator.needs_decay and p[1] < 0.01 * bounds[1, 1]):
            most = max(most, half_cycles_run() - before)
        seen |= set(status.tolist())
        assert np.all(np.isfinite(values[:, status == 0])) and np.all(np.isnan(values[:, status != 0]))
        if sensitivities:
            assert np.all(np.isfinite(jacobian[:, status == 0]))
    assert Status.COMPLETED in seen
    assert seen <= set(Status)
    # measured: 1079 (jenkins); of one cycle per level at most fourteen are tried
    assert 0 < most <= (3000 if simulator.needs_decay else 2 * 14 * LEVELS.size)


# --- arguments -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda o: simulate_backbone(o, [K, C], [0.1, 0.1]), "strictly increasing"),
        (lambda o: simulate_backbone(o, [K, C], [-0.1, 0.1]), "positive"),
        (lambda o: simulate_backbone(o, [K], [0.1]), "must hold 2 values"),
        (lambda o: simulate_backbone(o, [K, np.nan], [0.1]), "finite"),
        (lambda o: simulate_backbone(o, [K, C], [0.1], release_amplitude=0.0), "release_amplitude"),
        (lambda o: simulate_decay(o, [K, C], -1.0), "release_amplitude"),
        (lambda o: simulate_decay(o, [K, C], 1.0, n_cycles=0), "n_cycles"),
        (lambda o: simulate_waveform(o, [K, C], [0.0, 1.0, 0.5], 1.0), r"after time\[1\]"),
        (lambda o: simulate_waveform(o, [K, C], [0.0, 1.0], 0.0), "not zero"),
        (lambda o: simulate_waveform(o, [K, C], [0.0, np.inf], 1.0), "finite"),
    ],
)
def test_wrong_arguments_are_named(call, says):
    with pytest.raises(InputError, match=says):
        call(oscillator_of(()))


def test_an_effect_of_ones_own_cannot_take_the_place_of_a_built_in_one():
    own = Effect("linear_stiffness", "s", "t", "l", LIBRARY["linear_stiffness"].parameters, SINH.force)
    with pytest.raises(InputError, match="built in"):
        Simulator(Oscillator(1.0, (own,)))


# --- two paths, one answer -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("effects", [e for e in EFFECTS if not LIBRARY[e[0]].n_states], ids=name_of)
def test_one_cycle_per_level_is_the_whole_decay(effects):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator, share=0.1 if effects == ("coulomb_friction",) else 0.3)
    levels = AMPLITUDE * np.array([0.5, 0.6, 0.7])
    cycles = simulate_backbone(oscillator, p, levels)
    whole = simulate_backbone(oscillator, p, levels, release_amplitude=AMPLITUDE)
    # What differs is the cubic between the decay's cycles, some 6 to 30 percent apart: smooth 1e-6, at a gap 1e-4.
    wide = ("freeplay", "damped_stop", "dead_band_damping", "coulomb_friction", "quadratic_damping", "asymmetric_drag")
    tolerance = 3e-4 if effects[0] in wide else 2e-5
    np.testing.assert_allclose(whole.frequency, cycles.frequency, rtol=tolerance)
    np.testing.assert_allclose(whole.damping, cycles.damping, rtol=10 * tolerance)
    np.testing.assert_allclose(whole.offset, cycles.offset, atol=tolerance)


@pytest.mark.parametrize("effects", EFFECTS + COMBINATIONS, ids=name_of)
def test_waveform_turns_where_the_decay_does(effects):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator)
    decay = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=3)
    wave = simulate_waveform(oscillator, p, decay.turning_times, AMPLITUDE)
    # Other steps are taken where samples are wanted: both err by some 1e-9 per half cycle.
    np.testing.assert_allclose(wave.displacement, decay.turning_values, atol=1e-7 * AMPLITUDE)


def test_decay_result_is_consistent():
    oscillator = oscillator_of("cubic_stiffness")
    result = simulate_decay(oscillator, [K, C, 0.0], AMPLITUDE, stop_amplitude=0.3 * AMPLITUDE)
    assert result.status is Status.COMPLETED
    assert result.amplitude[-1] < 0.3 * AMPLITUDE <= result.amplitude[-2]
    np.testing.assert_allclose(np.diff(result.time) * result.frequency[1:], 1.0, rtol=1e-7)
    assert result.turning_times.size == 2 * result.amplitude.size + 1
    assert result.turning_values[0] == AMPLITUDE


def test_virgin_and_relaxed_starts_differ_where_states_remember():
    oscillator = oscillator_of("jenkins")
    p = parameters_of(oscillator)
    loaded = simulate_waveform(oscillator, p, [0.05, 0.1], AMPLITUDE).displacement
    relaxed = simulate_waveform(oscillator, p, [0.05, 0.1], AMPLITUDE, virgin=False).displacement
    assert np.all(np.abs(loaded - relaxed) > 1e-3 * AMPLITUDE)


def test_states_that_relax_are_relaxed_when_released(rng):
    """Slow loading leaves nothing in a Maxwell element, in whatever unit time is measured."""
    oscillator = Oscillator(1.0, (MAXWELL,))
    time = np.linspace(0.0, 3.0, 50)
    p = [40.0, 0.1, 20.0, 0.3]
    loaded = simulate_waveform(oscillator, p, time, 1.0).displacement
    relaxed = simulate_waveform(oscillator, p, time, 1.0, virgin=False).displacement
    np.testing.assert_allclose(loaded, relaxed, atol=1e-12)
    slow = simulate_waveform(oscillator, [40.0 / 1e6, 0.1 / 1e3, 20.0 / 1e6, 300.0], 1e3 * time, 1.0).displacement
    np.testing.assert_allclose(slow, loaded, atol=1e-9)


# --- the waveform's ends -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effects", [(), ("coulomb_friction",), ("bouc_wen",)], ids=name_of)
def test_release_time_shifts_the_waveform(effects):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator)
    time = np.linspace(-0.1, 0.9, 300)
    at_zero = simulate_waveform(oscillator, p, time, AMPLITUDE, sensitivities=True)
    later = simulate_waveform(oscillator, p, time + 7.25, AMPLITUDE, release_time=7.25, sensitivities=True)
    # Time is rounded to 1e-15 s of 8 s, at 30 rad/s.
    np.testing.assert_allclose(later.displacement, at_zero.displacement, atol=3e-10 * AMPLITUDE)
    before = time < 0.0
    assert np.all(at_zero.displacement[before] == AMPLITUDE)
    assert np.all(at_zero.jacobian[before] == 0.0) and np.all(at_zero.release_slope[before] == 1.0)


def test_waveform_holds_where_it_sticks():
    oscillator = oscillator_of("coulomb_friction")
    p = [K, C, 0.2 * K * AMPLITUDE]
    decay = simulate_decay(oscillator, p, AMPLITUDE, n_cycles=50)
    assert decay.status is Status.STUCK
    end = decay.turning_times[-1]
    time = [0.5 * end, end + 1e-9, end + 1.0, end + 9.0]
    wave = simulate_waveform(oscillator, p, time, AMPLITUDE, sensitivities=True)
    assert wave.status is Status.STUCK
    np.testing.assert_allclose(wave.displacement[1:], decay.turning_values[-1], rtol=1e-9)
    # The place where it sticks moves with the friction, but no longer with time.
    np.testing.assert_array_equal(wave.jacobian[2], wave.jacobian[3])
    assert abs(wave.jacobian[2, 2]) > 0.0


def test_waveform_that_cannot_go_on_has_no_answer():
    p = [1e-3 * K, C, -K / AMPLITUDE**2]
    wave = simulate_waveform(oscillator_of("cubic_stiffness"), p, np.linspace(-0.1, 1.0, 20), AMPLITUDE)
    assert wave.status is Status.RUNAWAY
    assert np.all(wave.displacement[:2] == AMPLITUDE) and np.isnan(wave.displacement[-1])


@pytest.mark.parametrize("effects", [("cubic_stiffness",), ("freeplay",), ("jenkins",), ("bouc_wen",)], ids=name_of)
def test_a_symmetric_oscillator_swings_alike_from_either_side(effects):
    oscillator = oscillator_of(effects)
    p = parameters_of(oscillator)
    time = np.linspace(0.0, 1.0, 200)
    right = simulate_waveform(oscillator, p, time, AMPLITUDE, sensitivities=True)
    left = simulate_waveform(oscillator, p, time, -AMPLITUDE, sensitivities=True)
    np.testing.assert_allclose(left.displacement, -right.displacement, atol=1e-14)
    np.testing.assert_allclose(left.jacobian * p, -right.jacobian * p, atol=1e-12)
    np.testing.assert_allclose(left.release_slope, right.release_slope, atol=1e-10)


def test_samples_do_not_depend_on_the_other_samples(rng):
    oscillator = oscillator_of(("freeplay", "coulomb_friction"))
    p = parameters_of(oscillator, share=0.1)
    time = np.sort(rng.uniform(0.0, 1.5, 200))
    many = simulate_waveform(oscillator, p, time, AMPLITUDE).displacement
    few = simulate_waveform(oscillator, p, time[::17], AMPLITUDE).displacement
    np.testing.assert_array_equal(few, many[::17])


# --- invariances ---------------------------------------------------------------------------------------------------


def test_effects_in_any_order_give_one_answer(rng):
    for effects in COMBINATIONS:
        oscillator = oscillator_of(effects)
        values = dict(zip(oscillator.parameter_names, parameters_of(oscillator), strict=True))
        levels = AMPLITUDE * np.array([0.4, 0.6])
        expected = simulate_backbone(oscillator, values, levels, sensitivities=True)
        other = oscillator_of(tuple(rng.permutation([*effects, *BASE_EFFECTS]).tolist()))
        found = simulate_backbone(other, values, levels, sensitivities=True)
        # Only sums are formed in another order.
        np.testing.assert_allclose(found.values, expected.values, rtol=1e-9, atol=1e-10)
        place = [other.parameter_names.index(name) for name in oscillator.parameter_names]
        scale = np.array(list(values.values()))
        np.testing.assert_allclose(found.jacobian[..., place] * scale, expected.jacobian * scale, atol=1e-6)


def _unit_exponents(unit, n=1.0):
    """Return the exponents of mass, length and time of an SI unit as the library writes them."""
    total = np.zeros(3)
    none = (0, 0, 0)
    base = {"kg": (1, 0, 0), "N": (1, 1, -2), "m": (0, 1, 0), "s": (0, 0, 1), "rad": none, "-": none, "1": none}
    for sign, part in zip((1.0, -1.0), unit.split("/"), strict=False):
        for token in part.split():
            symbol, _, power = token.partition("^")
            total += sign * np.array(base[symbol]) * (n if power == "n" else float(power or 1))
    return total


@pytest.mark.parametrize("effects", EFFECTS + COMBINATIONS, ids=name_of)
@pytest.mark.parametrize("factors", [(1e3, 1.0, 1.0), (1.0, 1e5, 1.0), (1.0, 1.0, 1e-4), (1e-3, 1e-6, 60.0)], ids=str)
def test_units_do_not_matter(effects, factors):
    oscillator = oscillator_of(effects)
    if "pendulum_stiffness" in effects and factors[1] != 1.0:
        pytest.skip("an angle has no unit to change")
    values = parameters_of(oscillator)
    names = oscillator.parameter_names
    n = values[names.index("bouc_wen_exponent")] if "bouc_wen_exponent" in names else 1.0
    mass, length, time = factors
    scales = np.array([np.prod(np.array(factors) ** _unit_exponents(p.unit, n)) for p in oscillator.parameters])
    levels = AMPLITUDE * np.array([0.45, 0.7])
    expected = simulate_backbone(oscillator, values, levels)
    found = simulate_backbone(Oscillator(MASS * mass, effects), values * scales, levels * length)
    # Asked for 1e-9. Steps are cut alike, but for rounding; where they end on kinks, that is amplified.
    np.testing.assert_allclose(found.frequency * time, expected.frequency, rtol=1e-9)
    np.testing.assert_allclose(found.damping, expected.damping, rtol=2e-8)
    np.testing.assert_allclose(found.offset, expected.offset, atol=1e-9)


# --- the step ------------------------------------------------------------------------------------------------------


@numba.njit
def _steps(integers, numbers, p, h, count, sensitivities):
    """Return displacement, velocity, and their derivatives to the start and to p[2], after steps of fixed length."""
    run = prepare(integers, numbers, p, sensitivities, 1.5)
    place = memory.place_of(address(run.integers))
    room = address(run.memory)
    model = memory.model_of(address(run.integers), room, address(run.p), place)
    y, y1 = shifted(room, place.now), shifted(room, place.next)
    S, S1 = shifted(y, 2), shifted(y1, 2)
    n = run.columns
    y[0], y[1], S[0] = 1.0, -0.5, 1.0
    model.scales[0] = model.scales[1] = 1.0
    for _ in range(count):
        force, fx, fv = forces.force_slopes(model, y[0], y[1], -1.0, shifted(y, 2))
        if sensitivities:
            stepper.step_sensitivity(
                model, y, S, -force, fx, fv, -1.0, h, 1e-9, y1, S1, shifted(room, place.quadrature)
            )
        else:
            stepper.step_value(model, y, S, -force, fx, fv, -1.0, h, 1e-9, y1, S1)
        for k in range(2 + 2 * n):
            y[k] = y1[k]
    return np.array([y[0], y[1], S[0], S[n], S[n - 1], S[2 * n - 1]])


@pytest.mark.parametrize("sensitivities", [False, True])
def test_steps_are_of_eighth_order(sensitivities):
    described = Simulator(Oscillator(1.0, "cubic_stiffness")).describe(tolerance=1e-9)
    p, length = np.array([1.0, 0.1, 0.7]), 3.2

    def slope(t, y):
        x, v, u, du, s, ds = y
        stiffness = p[0] + 3.0 * p[2] * x * x
        return [v, -(p[0] * x + p[1] * v + p[2] * x**3), du, -(stiffness * u + p[1] * du),
                ds, -(stiffness * s + p[1] * ds + x**3)]  # fmt: skip

    start = [1.0, -0.5, 1.0, 0.0, 0.0, 0.0]
    exact = solve_ivp(slope, (0.0, length), start, "DOP853", rtol=3e-14, atol=1e-16).y[:, -1]
    quantities = 6 if sensitivities else 4
    errors = [
        np.linalg.norm((_steps(*described, p, length / count, count, sensitivities) - exact)[:quantities])
        for count in (24, 40)
    ]
    # The order 8 of Dormand and Prince's formula, for the sensitivities as well.
    assert np.log(errors[0] / errors[1]) / np.log(40 / 24) == pytest.approx(8.0, abs=0.2)


def test_tolerance_sets_the_error(monkeypatch):
    """Two decades of tolerance are about two decades of error: the error estimate does what it should."""
    oscillator = oscillator_of(("cubic_stiffness", "cubic_damping"))
    p = parameters_of(oscillator, share=0.8)
    results = []
    for tolerance in (1e-13, 1e-9, 1e-7, 1e-5):
        monkeypatch.setattr("pymc_backbone.simulation.decay.TOLERANCE", tolerance)
        results.append(simulate_decay(oscillator, p, AMPLITUDE, n_cycles=4).turning_values)
    errors = [np.abs(r - results[0]).max() / AMPLITUDE for r in results[1:]]
    slopes = np.diff(np.log10(errors)) / 2.0
    assert np.all((slopes > 0.6) & (slopes < 1.4)), slopes


# --- compiled code -------------------------------------------------------------------------------------------------


def test_the_written_out_stepper_is_what_its_generator_writes():
    generator = FOLDER / "scripts" / "generate_stepper.py"
    if not generator.is_file():
        pytest.skip("scripts/ is not part of an installed package")
    done = subprocess.run([sys.executable, str(generator), "--check"], capture_output=True)
    assert done.returncode == 0, "run python scripts/generate_stepper.py"


def test_every_file_that_is_compiled_in_is_part_of_the_cache_key(tmp_path, monkeypatch):
    package = compiled._PACKAGE
    for name in compiled._COMPILED_MODULES:
        assert (package / name).is_file(), f"{name} is listed in _COMPILED_MODULES and does not exist"
    needed, to_visit = set(), ["simulation/kernels.py"]
    while to_visit:
        name = to_visit.pop()
        needed.add(name)
        for dots, module in re.findall(r"^from (\.+)([\w.]+) import", (package / name).read_text(), re.M):
            folder = Path(name).parent if dots == "." else Path()
            imported = (folder / module.replace(".", "/")).with_suffix(".py").as_posix()
            if imported not in needed and (package / imported).is_file():
                to_visit.append(imported)
    assert len(needed) > 8, "the walk over imports found nothing"
    assert needed - {"_common/checks.py"} <= set(compiled._COMPILED_MODULES)
    copy = tmp_path / "copy"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__", "data"))
    monkeypatch.setattr(compiled, "_PACKAGE", copy)
    compute = compiled.compiled_sources_digest.__wrapped__
    before = compute()
    for path in [copy / "effects" / "jenkins.py", *(copy / name for name in compiled._COMPILED_MODULES)]:
        text = path.read_text()
        path.write_text(text + "\n")
        assert compute() != before, path.name
        path.write_text(text)
    assert compute() == before


_FRESH = """
import numpy as np
from numba.core import event
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_backbone, simulate_waveform
with event.install_recorder("numba:compile") as compiled:
    oscillator, p = Oscillator(1.0, "cubic_stiffness"), [100.0, 0.1, 50.0]
    result = simulate_backbone(oscillator, p, [0.1, 0.2])
    simulate_backbone(oscillator, p, [0.1, 0.2], release_amplitude=0.3)
    simulate_waveform(oscillator, p, [0.0, 0.1], 0.2)
print(len(compiled.buffer), repr(float(result.frequency[0])))
"""


def _fresh_process(folder):
    """Return how often numba compiled something in a process of its own, and a frequency found there."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run([sys.executable, "-c", _FRESH], capture_output=True, text=True, env=environment, cwd=folder)
    assert done.returncode == 0, done.stderr
    compilations, frequency = done.stdout.split()
    return int(compilations), float(frequency)


def test_another_process_takes_the_machine_code_from_disk():
    oscillator = oscillator_of(())
    simulate_backbone(oscillator, [K, C], LEVELS)  # compiled by now, if they were not: all three kernels
    simulate_backbone(oscillator, [K, C], LEVELS, release_amplitude=AMPLITUDE)
    simulate_waveform(oscillator, [K, C], [0.0, 0.1], AMPLITUDE)
    # Counted, not timed: numba takes a second to start in a new process, whatever it then loads.
    assert _fresh_process(FOLDER)[0] == 0


@pytest.mark.slow
def test_an_edited_force_is_compiled_anew(tmp_path):
    package = compiled._PACKAGE
    shutil.copytree(package, tmp_path / "pymc_backbone", ignore=shutil.ignore_patterns("__pycache__", "data"))
    (tmp_path / "pymc_backbone" / "__init__.py").write_text("")  # the simulator needs nothing of the rest
    compilations, before = _fresh_process(tmp_path)
    assert compilations > 0  # else counting them would show nothing
    assert _fresh_process(tmp_path) == (0, before)
    force = tmp_path / "pymc_backbone" / "effects" / "cubic_stiffness.py"
    text = force.read_text()
    assert "return p[0] * x * x * x" in text
    force.write_text(text.replace("return p[0] * x * x * x", "return 2.0 * p[0] * x * x * x"))
    compilations, after = _fresh_process(tmp_path)
    assert compilations > 0 and after > before + 1e-4
