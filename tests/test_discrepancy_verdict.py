"""`find_missing_effect` from records or backbones to a verdict, on data whose truth is known."""

from __future__ import annotations

import dataclasses
import json
import re
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import pymc_backbone as pb
from pymc_backbone._common.text import capitalised, in_words
from pymc_backbone.discrepancy.checks import rivals
from pymc_backbone.discrepancy.deciding import decide, imitations, inexact, mechanisms, minded, shares
from pymc_backbone.discrepancy.deciding.decision import Decision, as_one
from pymc_backbone.discrepancy.disturbances import left_beside
from pymc_backbone.discrepancy.fitting.batch import batch_of_backbones
from pymc_backbone.discrepancy.fitting.curves import level_chi_square
from pymc_backbone.discrepancy.fitting.drift_course import DRIFT
from pymc_backbone.discrepancy.fitting.normal_equations import DRIFTS, State
from pymc_backbone.discrepancy.results.entries import Candidate, LawProbability, MissingMechanism, ScatterOfEffects
from pymc_backbone.discrepancy.results.verdict import AdequateBy, NamedLevel, Status, Verdict
from pymc_backbone.discrepancy.sets.question import TOLERANCE
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing.evidence import Evidence, LackOfFit
from pymc_backbone.discrepancy.wording import candidate_table, scatter_words, verdict_words, words
from pymc_backbone.effects import BASE_EFFECTS, LIBRARY
from pymc_backbone.reporting.words import candidate_name, verdict_means
from pymc_backbone.simulation.backbones import simulate_population
from pymc_backbone.workflows.diagnose import describe_study

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    FREQUENCY,
    MASS,
    STIFFNESS,
    TIME,
    batch_of,
    decaying_sinusoid,
    drifting_records,
    make_records,
    truth_of,
)

CANDIDATES = ("cubic_stiffness", "coulomb_friction", "quadratic_damping")
LINEAR = pb.Oscillator(MASS)


def study_of(data, base=(), **options):
    chosen = {"candidates": CANDIDATES, "quick": True, "random_seed": 1, **options}
    return pb.find_missing_effect(pb.Oscillator(MASS, base), data, **chosen)


def check_whole(study):
    """What holds for every study, whatever was found."""
    assert isinstance(study.verdict, Verdict) and study.sentence.endswith(".")
    probabilities = [item.probability for item in study.candidates]
    told = [probability for probability in probabilities if probability >= 1e-9]
    assert probabilities[: len(told)] == sorted(told, reverse=True)
    # what is less probable is in the order of what it leaves, but for one that may be told first
    fitted = [item for item in study.candidates[len(told) :] if np.isfinite(item.reduced_chi_square)]
    left = [item.reduced_chi_square for item in fitted if item.parameters]
    assert left[1:] == sorted(left[1:])
    assert 0.0 < sum(probabilities) <= 1.0 + 1e-9
    assert all(item.reason for item in study.candidates)
    names = [item.effects for item in study.candidates]
    assert len(set(names)) == len(names) and () in names
    assert (study.missing_effects == ()) == (study.named_level != "law")
    assert (study.named_level is None) == (study.verdict != "found")
    assert study.verdict != "adequate" or study.mechanisms == ()
    for item in study.mechanisms:
        assert 0.0 < item.probability <= 1.0 + 1e-9 and 0.0 <= item.share_of_gap <= 1.0
        assert item.laws and all(0.0 < law.probability <= item.probability + 1e-9 for law in item.laws)
    if study.verdict == "ambiguous":
        assert study.ambiguous_sets
    elif study.ambiguous_sets:  # sets that agree on the mechanism, and on no more
        assert study.named_level == "mechanism" and study.advice
    status = {item.effects: item.status for item in study.candidates}
    assert Status.REJECTED not in {status[names] for names in study.ambiguous_sets}
    assert not any("_" in text for text in (study.sentence, *study.reasons, *study.advice))
    assert (study.adequate_by is None) == (study.verdict != "adequate")
    assert (study.extended is None) == (study.after is None)
    assert len(study.checks) == 6 and all(item.message for item in study.checks)
    assert study.before["value"].shape == study.backbones["value"].shape
    assert dataclasses.is_dataclass(study) and study.seconds > 0.0


@pytest.fixture(scope="module")
def cubic_records():
    return make_records(np.random.default_rng(41), ("cubic_stiffness",))


@pytest.fixture(scope="module")
def cubic_study(cubic_records):
    return study_of(cubic_records)


def test_nothing_missing_is_adequate_with_what_would_have_been_seen(rng):
    study = study_of(make_records(rng))
    check_whole(study)
    assert study.verdict == "adequate" and study.adequate_by == "statistics"
    assert study.extended is None and study.reasons == () and study.advice == ()
    assert study.missing_p_value > 0.01
    assert {item.effect for item in study.detectable} == set(CANDIDATES)
    for item in study.detectable:
        assert item.value > 0.0 and item.unit
        assert 0.0 < np.nanmax([item.frequency, item.damping]) < 1.0
        # these records show the strengths of the other tests, which is what makes them found
        assert item.value < truth_of((item.effect,))[item.parameter]
    assert np.isnan(study.shrink) and study.held_out_levels.before < 2.5
    assert study.where == ()


@pytest.mark.parametrize("effect", CANDIDATES)
def test_one_missing_effect_is_found(effect, rng):
    # among single effects: a second one that fits the noise at two standard errors makes it ambiguous, rightly so
    # and damping that drifts over the record imitates drag where the releases differ by a quarter only: less noise
    study = study_of(make_records(rng, (effect,), decibels=52.0), max_effects=1)
    check_whole(study)
    assert study.verdict == "found" and study.missing_effects == (effect,), study.sentence
    assert study.probability > 0.9 and study.sentence.startswith(capitalised(in_words(effect)))
    assert study.extended.effects[-1].name == effect
    assert study.where and study.where[0].standard_errors > 3.0
    assert study.held_out_specimens.after < 2.5 and study.held_out_specimens.before > 3.0
    assert study.shrink_low <= study.shrink <= study.shrink_high and study.shrink > 2.0
    assert study.reasons[0].startswith(f"{capitalised(in_words(effect))}: ")
    for name, value in truth_of((effect,)).items():
        group = next(item for item in study.parameters.values() if name in item)
        estimate = group[name]
        # specimens scatter by a hundredth, so that the mean of two does; five standard errors beside
        assert abs(estimate.mean - value) < 5.0 * estimate.sd + 0.02 * value, name


def test_the_reason_is_in_physical_words(cubic_study):
    """A cubic spring raises the frequency in proportion to the square of the amplitude."""
    reason, _ = cubic_study.reasons
    assert "frequency rises" in reason and "grows with amplitude" in reason
    power = float(reason.split("A^(")[1].split(" ")[0])
    assert power == pytest.approx(2.0, abs=0.15)  # 8 % of hardening bends the law by some per cent
    assert cubic_study.where[0].observable == "frequency"


def test_an_effect_that_is_a_spring_at_rest_is_told_by_what_changes():
    """A slider that sticks is a spring more, which is the linear one's; what tells is that it gives way."""
    levels, error = np.array([0.1, 0.2, 0.5, 1.0]), np.full(4, 1e-3)
    excess, units = np.array([0.5, 0.48, 0.4, 0.3]), (" Hz", "mm")
    softer = words._change("frequency", excess, error, excess, levels, units)
    assert softer == "frequency falls by 0.2 Hz from 0.1 to 1 mm"
    # what changes is not this effect's: a spring that is stiffer on one side is so at every amplitude
    constant = words._change("frequency", excess, error, np.full(4, 0.45), levels, units)
    assert constant == "frequency is 0.5 Hz higher throughout"
    # nor is what is off at the first level, where the effect does nothing, or the contrary
    assert words._change("frequency", excess, error, np.full(4, -0.01), levels, units) == ""
    excess = np.array([-0.5, -0.4995, -0.5, -0.501])
    same = words._change("damping", excess, error, excess, levels, ("", "mm"))
    assert same == "damping is 0.5 lower throughout"


@pytest.mark.parametrize("is_rough", [False, True])
def test_specimens_that_differ_make_no_change_with_amplitude(monkeypatch, is_rough):
    """Springs of two sides, one stiffer by half, which alone is known well at the lowest levels: each is constant."""
    levels = AMPLITUDE * np.geomspace(0.1, 1.0, 8)
    truth = np.array([[STIFFNESS, DAMPING, 0.1 * STIFFNESS], [STIFFNESS, DAMPING, 0.15 * STIFFNESS]])
    backbones = simulate_population(pb.Oscillator(MASS) + "bilinear_stiffness", truth, levels)
    errors = 1e-5 * np.abs(backbones["value"].values)
    if is_rough:
        errors[0, :, :3] *= 10.0
    else:
        backbones["value"][0, :, :3] = np.nan
    backbones["standard_error"] = (backbones["value"].dims, errors)
    backbones["covariance"] = (
        ("specimen", "observable", "level", "level_other"), errors[..., None] ** 2 * np.eye(levels.size)
    )  # fmt: skip
    batch = batch_of_backbones(MASS, backbones)
    alone = np.array([[STIFFNESS, DAMPING]] * 2)
    without_it = simulate_population(pb.Oscillator(MASS), alone, levels)["value"].values
    brought = (
        simulate_population(pb.Oscillator(MASS) + "bilinear_stiffness", truth, levels)["value"].values - without_it
    )
    said = words._power_law(batch, without_it, brought, 0)
    assert "Hz higher throughout" in said

    def as_known(held, gap, spread, brought, levels):
        weight = np.where(held, 1.0 / spread, 0.0)
        mean, own = (np.where(held, item * weight, 0.0).sum(axis=0) / weight.sum(axis=0) for item in (gap, brought))
        return mean, 1.0 / np.sqrt(weight.sum(axis=0)), own, levels

    # negative control: with each level taken by itself the batch seems to fall
    monkeypatch.setattr(words, "_of_the_same", as_known)
    assert "frequency falls" in words._power_law(batch, without_it, brought, 0)


def test_a_set_that_leaves_several_times_as_much_as_a_simpler_one_is_outdone():
    left = {(): 90.0, ("jenkins",): 1.2, ("dead_band_damping",): 3.1, ("cubic_stiffness",): 3.0, ("a", "b"): 1.05}
    sizes = {"jenkins": 2, "dead_band_damping": 2, "cubic_stiffness": 1}
    search = SimpleNamespace(
        fits={names: SimpleNamespace(left=value, is_converged=True) for names, value in left.items()},
        reduced=lambda found: found.left,
        layout=lambda names: SimpleNamespace(free=np.zeros(sum(sizes.get(name, 3) for name in names))),
    )
    # not by what has more unknowns: these follow what disturbs the records
    assert mechanisms._outdone(search) == {("dead_band_damping",)}
    search.fits[("jenkins",)].is_converged = False
    assert mechanisms._outdone(search) == set()
    search.fits[("jenkins",)].is_converged = True
    for found in search.fits.values():
        found.left *= 100.0  # the phase of all is lost
    assert mechanisms._outdone(search) == set()


def test_a_contact_that_closes_at_the_highest_amplitudes_alone_is_told_there():
    """Two levels are no power of the amplitude, but what they show is to be told."""
    levels = AMPLITUDE * np.geomspace(0.1, 1.0, 8)
    truth = np.array([[STIFFNESS, DAMPING, STIFFNESS, 0.6 * AMPLITUDE]])
    backbones = simulate_population(pb.Oscillator(MASS) + "freeplay", truth, levels)
    errors = 1e-4 * np.abs(backbones["value"].values) + 1e-9
    backbones["standard_error"] = (backbones["value"].dims, errors)
    backbones["covariance"] = (
        ("specimen", "observable", "level", "level_other"), errors[..., None] ** 2 * np.eye(levels.size)
    )  # fmt: skip
    batch = batch_of_backbones(MASS, backbones)
    without_it = simulate_population(pb.Oscillator(MASS), truth[:, :2], levels)["value"].values
    with_it = backbones["value"].values
    rise = float(with_it[0, 0, -1] - without_it[0, 0, -1])
    said = words._power_law(batch, without_it, with_it - without_it, 0)
    assert said == f"frequency rises by {rise:.3g} Hz at {words.amplitude(float(levels[-1]), 'm')}"
    # negative control: nothing of it, where the contact is out of reach
    assert words._power_law(batch, with_it, with_it - without_it, 0) == ""


def test_what_falls_by_little_and_then_rises_by_much_is_said_to_rise(rng):
    """A joint that sticks at most levels, where its spring lowers the decrement a little, and slips at the others."""
    oscillator = pb.Oscillator(MASS) + "jenkins"
    levels = AMPLITUDE * np.geomspace(0.1, 1.0, 10)
    stiffness = 0.1 * STIFFNESS
    truth = np.array([[STIFFNESS, DAMPING, stiffness, 0.7 * AMPLITUDE * stiffness]])
    backbones = simulate_population(oscillator, truth, levels)
    errors = np.array([1e-4, 1e-4])[None, :, None] * np.abs(backbones["value"].values)
    backbones["standard_error"] = (backbones["value"].dims, errors)
    backbones["covariance"] = (
        ("specimen", "observable", "level", "level_other"),
        errors[..., None] ** 2 * np.eye(levels.size),
    )
    study = study_of(backbones, candidates=("jenkins",))
    assert study.missing_effects == ("jenkins",)
    assert "damping rises by" in study.reasons[0] and "lower" not in study.reasons[0]


@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
def test_of_a_mid_line_that_is_not_measured_no_damping_is_told(quantity, rng):
    """A spring of two sides changes the decrement by its mid-line, which an acceleration does not show."""
    oscillator = pb.Oscillator(MASS) + "quadratic_stiffness"
    truth = {
        "linear_stiffness": STIFFNESS,
        "viscous_damping": DAMPING,
        "quadratic_stiffness": 0.3 * STIFFNESS / AMPLITUDE,
    }
    exact = pb.simulate_waveform(oscillator, truth, TIME, AMPLITUDE, quantity=quantity).values
    noise = 1e-3 * np.abs(exact).max() * rng.standard_normal(TIME.size)
    batch = batch_of([pb.Record("one", TIME, exact + noise, quantity, "m" if quantity == "displacement" else "m/s^2")])
    search = Search(batch, LINEAR, ("quadratic_stiffness",), 1)
    found = search.fit_set(("quadratic_stiffness",))
    (reason,) = words.reasons(batch, found, ("quadratic_stiffness",))
    assert "frequency falls" in reason and ("damping" in reason) == (quantity == "displacement")


def test_a_scatter_that_is_not_seen_is_told_by_its_bound():
    seen, unseen = ScatterOfEffects(0.06, 0.04, 0.1), ScatterOfEffects(0.013, 0.0105, 0.027)
    assert scatter_words.scatter_sentence(seen, ("iwan",)).endswith(
        "by 6 % of their value (standard deviation; 4 to 10 % with 90 %)."
    )
    assert scatter_words.scatter_sentence(unseen, ("coulomb_friction", "cubic_stiffness")) == (
        "The parameters of Coulomb friction and cubic stiffness differ between specimens by 2.7 % of their value at "
        "most (standard deviation, with 95 %)."
    )


@pytest.mark.parametrize(("exponent", "mechanism"), [(0.2, "hysteresis"), (1.8, "drag")])
def test_a_power_of_the_speed_below_one_is_friction(exponent, mechanism):
    search = Search(batch_of(make_records(np.random.default_rng(5), ())), LINEAR, ("power_damping",), 1)
    assert search.mechanism_of("power_damping") == "drag"  # as long as nothing is known
    held = {"power_damping_exponent": exponent}
    search.fits[("power_damping",)] = SimpleNamespace(cost=1.0, value_of=held.get)
    assert search.mechanism_of("power_damping") == mechanism
    assert search.mechanism_of("quadratic_damping") == "drag"


@pytest.mark.parametrize(("gap", "mechanism"), [(-0.85, "asymmetry"), (-0.3, "clearance"), (0.4, "clearance")])
def test_a_contact_that_is_closed_over_most_of_the_motion_is_an_asymmetric_spring(gap, mechanism):
    search = Search(batch_of(make_records(np.random.default_rng(5), ())), LINEAR, ("hertz_contact",), 1)
    held = {"hertz_gap": gap * search.batch.amplitude}
    search.fits[("hertz_contact",)] = SimpleNamespace(cost=1.0, value_of=held.get)
    assert search.mechanism_of("hertz_contact") == mechanism


def test_laws_that_are_needed_together_are_no_alternatives():
    laws = tuple(
        LawProbability(name, chance) for name, chance in (("bouc_wen", 0.999), ("iwan", 0.97), ("jenkins", 0.1))
    )
    named = {"named_level": NamedLevel.MECHANISM, "mechanisms": (replace(HYSTERESIS, laws=laws),), "best": ("iwan",)}
    exact = decision_of("found", **named, listed=(("bouc_wen", "iwan"), ("bouc_wen", "iwan", "jenkins")))
    like = decision_of("found", **named, is_approximate=True)
    assert "; its laws are Bouc-Wen and Iwan together." in verdict_words.sentence(exact)
    assert "its laws are Bouc-Wen and Iwan together, or ones like them, not exactly." in verdict_words.sentence(like)


def test_a_named_effect_comes_with_its_scatter_and_what_the_evidence_rests_on(cubic_study):
    scatter = cubic_study.scatter
    # two specimens with the same spring: little is known of a scatter but that it is not large
    assert 0.01 <= scatter.low < scatter.median < scatter.high <= 0.5 and scatter.median < 0.1
    assert cubic_study.reasons[-1].startswith("The parameters of cubic stiffness differ between specimens by")
    assert f"by {100.0 * scatter.high:.2g} % of their value at most" in cubic_study.reasons[-1]
    assert cubic_study.reasons[-1] in describe_study(cubic_study)
    basis = cubic_study.evidence_basis
    asked = [item for item in cubic_study.candidates if np.isfinite(item.evidence_shift)]
    assert len(asked) == basis.sets and basis.sentence
    assert (basis.cycles > 0.0) == (basis.sets > 0)


def test_why_a_set_is_the_best_is_told_where_it_is_not_the_most_probable(cubic_study):
    (best,) = (item for item in cubic_study.candidates if item.status == "best")
    others = tuple(item for item in cubic_study.candidates if item is not best)
    assert "best is" not in describe_study(cubic_study)
    less = replace(best, probability=0.5 * others[0].probability, reason="it holds no more than matters")
    said = describe_study(replace(cubic_study, candidates=(others[0], less, *others[1:])))
    assert "  best is cubic stiffness: it holds no more than matters" in said.splitlines()
    drifting = describe_study(replace(cubic_study, candidates=(replace(best, has_drift=True), *others)))
    assert "The drift with time is in none of these." in drifting
    assert "The drift with time is" not in describe_study(cubic_study)


def test_two_missing_effects_are_found_together(rng):
    study = study_of(make_records(rng, ("cubic_stiffness", "coulomb_friction"), decibels=55.0))
    check_whole(study)
    assert study.verdict == "found" and study.missing_effects == ("coulomb_friction", "cubic_stiffness")
    assert len(study.reasons) == 3  # one for each, and how they scatter


def test_a_base_that_holds_an_effect(rng):
    study = study_of(make_records(rng, ("cubic_stiffness", "coulomb_friction")), base=("cubic_stiffness",))
    check_whole(study)
    assert study.verdict == "found" and study.missing_effects == ("coulomb_friction",)
    assert "cubic_stiffness" not in study.settings["candidates"]
    assert {"cubic_stiffness", "coulomb_friction"} <= set(study.parameters)
    assert not any("is not seen" in reason for reason in study.reasons)  # the model's spring is


def test_a_base_whose_effect_is_not_there_is_adequate(rng):
    study = study_of(make_records(rng), base=("cubic_stiffness",), candidates=("coulomb_friction", "quadratic_damping"))
    assert study.verdict == "adequate"


def test_friction_of_the_base_that_is_not_there_is_adequate(rng):
    """Its best fit lies at zero, the edge of what is physical, where a decay that sticks cannot be simulated."""
    study = study_of(make_records(rng), base=("coulomb_friction",), candidates=("cubic_stiffness", "quadratic_damping"))
    check_whole(study)
    assert study.verdict == "adequate" and study.missing_effects == ()
    friction = study.parameters["coulomb_friction"]["friction_force"]
    assert 0.0 <= friction.mean < 5.0 * max(friction.sd, 1e-12) and friction.mean < 1e-3 * STIFFNESS * AMPLITUDE
    # negative control: with a spring that hardens, that is what is found beside the same base
    hardening = study_of(
        make_records(rng, ("cubic_stiffness",)), base=("coulomb_friction",), candidates=("cubic_stiffness",)
    )
    assert hardening.verdict == "found" and hardening.missing_effects == ("cubic_stiffness",)
    unseen = [reason for reason in hardening.reasons if "is not seen in these records" in reason]
    assert len(unseen) == 1
    assert unseen[0].startswith("The model's Coulomb friction") and unseen[0].endswith(" N (95 %).")


@pytest.mark.parametrize(
    ("p_value", "share", "limit", "by"),
    [
        (0.3, 0.02, 0.0, AdequateBy.STATISTICS),
        (0.3, 0.02, 0.05, AdequateBy.STATISTICS),
        (1e-9, 0.02, 0.05, AdequateBy.TOLERANCE),
        (1e-9, 0.02, 0.01, None),
    ],
)
def test_a_base_that_only_the_tolerance_saves_is_not_adequate_by_statistics(p_value, share, limit, by, monkeypatch):
    weighed = replace(
        decision_of("ambiguous", best=(), probabilities={(): 0.9}), p_missing=0.0,
        lack=SimpleNamespace(p_value=p_value, share=share),
    )  # fmt: skip
    monkeypatch.setattr(decide, "prune", lambda search, best, tolerance: (best, ()))
    monkeypatch.setattr(decide, "departing", lambda search, decision: replace(decision, verdict=Verdict.UNEXPLAINED))
    decision = decide._judged(SimpleNamespace(is_refuted=lambda names: False), weighed, {"waveform": limit}, None)
    assert decision.adequate_by is by and (decision.verdict is Verdict.ADEQUATE) == (by is not None)


@pytest.mark.parametrize(
    ("summary", "measured", "told"),
    [
        (LIBRARY["coulomb_friction"].summary, True, " In other words: dry friction."),
        (LIBRARY["bouc_wen"].summary, True, " In other words: Bouc-Wen hysteresis."),
        (LIBRARY["coulomb_friction"].summary, False, f" {LIBRARY['coulomb_friction'].summary}"),
        ("My own damper.", True, " My own damper."),
        ("", True, ""),
    ],
)
def test_the_library_does_not_contradict_what_was_measured(summary, measured, told):
    """'Frequency rises' was measured: 'frequency unchanged' must not follow."""
    assert words._said_by_the_library(summary, measured) == told


@pytest.mark.parametrize(
    ("name", "strength", "is_against"),
    [("mid_stroke_damping", -2.0, True), ("mid_stroke_damping", 2.0, False), ("cubic_stiffness", -2.0, False)],
)
def test_a_damper_that_takes_back_damping_is_not_called_by_where_it_acts(name, strength, is_against):
    """Of a damper that is weakest in mid-stroke 'damper that acts in mid-stroke' was said; a spring may soften."""
    oscillator = pb.Oscillator(MASS, [name])
    vector = np.ones(len(oscillator.parameter_names))
    first = next(item.name for item in LIBRARY[name].parameters if item.role == "strength")
    vector[oscillator.index(first)] = strength
    found = SimpleNamespace(layout=SimpleNamespace(oscillator=oscillator), parameters=lambda _: vector)
    assert words._is_against_its_name(found, name) == is_against


def test_no_summary_of_the_library_says_what_an_effect_does_before_its_colon():
    for effect in LIBRARY.values():
        what = effect.summary.partition(":")[0]
        assert what != effect.summary and not re.search(r"frequency|offset|no damping|rises|unchanged", what)


@pytest.mark.parametrize("name", [name for name in LIBRARY if not LIBRARY[name].with_role("ordinate")])
def test_the_mid_line_is_told_of_what_differs_between_the_sides_alone(name):
    """A damped cycle of a linear structure has one, too, which any effect that changes the damping changes."""
    effect, omega = LIBRARY[name], 2.0 * np.pi * FREQUENCY
    batch, oscillator = SimpleNamespace(angular_frequency=omega), pb.Oscillator(MASS, (name,))
    vector = np.zeros(len(oscillator.parameter_names))
    for parameter, value in zip(effect.parameter_names, effect.signature.typical(MASS, AMPLITUDE, omega), strict=True):
        vector[oscillator.index(parameter)] = value
    layout = SimpleNamespace(oscillator=oscillator, amplitude=AMPLITUDE)
    found = SimpleNamespace(layout=layout, parameters=lambda r: vector)
    sided = LIBRARY[name].mechanism in ("asymmetry", "damping_asymmetry") or name in (
        "offset_freeplay", "one_sided_stiffness", "hertz_contact", "damped_stop", "asymmetric_drag",
    )  # fmt: skip
    assert words._is_odd(batch, found, name) == (not sided)


def test_what_moves_the_mid_line_alone_is_not_below_the_tolerance(rng):
    """A spring of two sides, as a crack makes one: frequency and damping do not change with the amplitude."""
    records = drifting_records(rng, 0.0, one_side=0.08)
    study = study_of(records, candidates=("bilinear_stiffness", "coulomb_friction"))
    assert study.verdict == "found" and list(study.missing_effects) == ["bilinear_stiffness"]
    lenient = study_of(
        records, candidates=("bilinear_stiffness",), tolerance={"frequency": 0.001, "damping": 0.03, "offset": 0.1}
    )
    assert lenient.verdict == "adequate" and lenient.below_tolerance == ("bilinear_stiffness",)


def test_a_weak_effect_is_named_but_below_the_tolerance(rng):
    records = make_records(rng, ("cubic_stiffness",), share=0.02, specimens=3)
    study = study_of(records)
    check_whole(study)
    # frequency changes by 3/8 of 0.16 %, less than the default tolerance, and by several standard errors
    assert study.tolerance["frequency"] == TOLERANCE["frequency"] == 0.001
    assert study.verdict == "adequate" and study.adequate_by == "tolerance"
    assert study.below_tolerance == ("cubic_stiffness",) and "cubic stiffness" in study.sentence
    strict = study_of(records, tolerance=0)
    check_whole(strict)
    assert strict.verdict in ("found", "ambiguous") and strict.below_tolerance == ()
    named = [strict.missing_effects, *strict.ambiguous_sets]
    assert ("cubic_stiffness",) in named


def test_the_model_holds_what_is_below_the_tolerance_where_the_data_need_it(rng):
    """A drag that changes the damping by less than 3 %, at a noise that shows it: what is named is not the model."""
    truth = truth_of(CANDIDATES)
    truth["quadratic_damping"] *= 0.15
    hidden = ("cubic_stiffness", "quadratic_damping")
    study = study_of(make_records(rng, hidden, truth=truth, decibels=60.0))
    check_whole(study)
    assert study.missing_effects == ("cubic_stiffness",) and study.below_tolerance == ("quadratic_damping",)
    assert "below the tolerance, and in the model" in study.sentence
    assert study.extended.effects[-2:] == pb.Oscillator(MASS, hidden).effects[-2:]
    assert study.parameters["quadratic_damping"]["quadratic_damping"].mean == pytest.approx(
        truth["quadratic_damping"], rel=0.2
    )
    assert study.checks[3].passed and study.held_out_specimens.after < 1.5


def test_backbones_alone_are_enough(cubic_records):
    study = study_of(batch_of(cubic_records).backbones)
    check_whole(study)
    assert study.verdict == "found" and study.missing_effects == ("cubic_stiffness",)
    assert study.checks[0].passed and "not testable" in study.checks[0].message
    assert study.held_out_levels.after < 2.5


def test_order_of_observables_says_nothing(cubic_records):
    backbones = batch_of(cubic_records).backbones
    swapped = study_of(backbones.isel(observable=[1, 0, 2]))
    study = study_of(backbones)
    assert swapped.sentence == study.sentence
    assert swapped.where[0].observable == study.where[0].observable == "frequency"


def test_backbones_without_anything_missing(rng):
    study = study_of(batch_of(make_records(rng)).backbones)
    assert study.verdict == "adequate" and study.detectable


def test_pendulum_is_offered_for_angles_only(rng):
    records = make_records(rng)
    assert "pendulum_stiffness" not in study_of(records, candidates=None, max_effects=1).settings["candidates"]
    angles = [dataclasses.replace(record, unit="rad") for record in records]
    turning = study_of(angles, candidates=None, max_effects=1)
    of_spring = turning.parameters["linear_stiffness"]["linear_stiffness"]
    assert of_spring.unit == "N m/rad"
    assert {"N m", "N m s^2/rad^2"} <= {item.unit for item in turning.detectable}
    offered = turning.settings["candidates"]
    assert set(offered) == {
        name for name, effect in LIBRARY.items() if not (effect.variant_of or effect.only_if_named)
    } - set(BASE_EFFECTS)


def test_a_drift_is_not_named(rng):
    """A stiffness that grows by 2 % over each record, in an otherwise linear system."""
    study = study_of(drifting_records(rng, 0.02))
    check_whole(study)
    assert study.verdict != "found" and study.missing_effects == ()
    failed = {item.check for item in study.checks if not item.passed}
    assert "amplitude, not time" in failed
    assert "drift" in study.sentence


@pytest.mark.parametrize(
    ("tolerance", "verdict", "said"),
    [
        ({"frequency": 0.004}, "adequate", "a drift with time is detectable"),
        (
            None,
            "unexplained",
            "a drift with time explains the records, and so does a force that depends on displacement and speed alone",
        ),
    ],
)
def test_a_drift_that_explains_all_is_the_best_and_no_effect_beside_it(tolerance, verdict, said):
    """A stiffness that grows by 0.4 % over each record, 0.2 % of the frequency: twice the tolerance, or half of it."""
    study = study_of(drifting_records(np.random.default_rng(12), 0.004, specimens=3), tolerance=tolerance)
    assert study.verdict == verdict and said in study.sentence
    assert ("changes with time" in verdict_means(study)) == (verdict == "unexplained")
    best = study.candidates[0]
    assert best.effects == () and best.status == "best" and best.probability > 0.5
    assert 0.8 < best.reduced_chi_square < 1.2 and study.reasons == ()
    drifts = next(item for item in study.checks if item.check == "amplitude, not time")
    assert drifts.passed == (verdict == "adequate")
    # damping over a second stays, and so over a cycle falls by as much as the frequency rises: too little to be seen
    assert re.search(r"by \+0\.2\d? % over a record; damping by at most [2-4]\.?\d? %", drifts.message)
    assert "explains the records alone" in drifts.message and ("tolerance" in drifts.message) == drifts.passed
    assert all(item.passed for item in study.checks if item is not drifts)


def test_what_an_effect_does_not_bring_about_is_not_told_as_its_own(monkeypatch):
    """Dry friction leaves the frequency; that of the model is off by a little, as by the error of a stiffness."""
    monkeypatch.setattr(words, "on_levels", lambda _, found: found)
    batch = batch_of(make_records(np.random.default_rng(4), ("coulomb_friction",), specimens=3))
    found = Search(batch, LINEAR, ("coulomb_friction",), 1).fit_set(("coulomb_friction",))
    assert found is not None
    own = found.state.own.copy()
    own[:, 0] *= 1.002
    off = replace(found, state=State(found.state.eta, own))
    (reason,) = words.reasons(batch, off, ("coulomb_friction",))
    assert "damping rises" in reason and "frequency" not in reason
    # negative control: a cubic spring that is off alike changes the frequency itself
    batch = batch_of(make_records(np.random.default_rng(4), ("cubic_stiffness",), specimens=3))
    found = Search(batch, LINEAR, ("cubic_stiffness",), 1).fit_set(("cubic_stiffness",))
    assert found is not None
    own = found.state.own.copy()
    own[:, 0] *= 1.002
    (reason,) = words.reasons(batch, replace(found, state=State(found.state.eta, own)), ("cubic_stiffness",))
    assert "frequency rises" in reason


def test_laws_of_one_mechanism_are_told_together():
    """Of a spring that softens one of two laws had been told, by which the frequency rises."""
    base = pb.Oscillator(MASS, ["pendulum_stiffness"])
    found = SimpleNamespace(
        layout=SimpleNamespace(oscillator=base + "cubic_stiffness" + "quintic_stiffness" + "jenkins" + "iwan")
    )
    asked = SimpleNamespace(base=base)
    assert words._of_one_mechanism(found, ("jenkins", "quintic_stiffness"), asked) == [
        ["jenkins", "iwan"], ["quintic_stiffness", "cubic_stiffness"],
    ]  # fmt: skip
    both = ("cubic_stiffness", "quintic_stiffness")
    assert words._of_one_mechanism(found, both, asked) == [[*both]]
    # of what is not known to be added, only what is named
    assert words._of_one_mechanism(found, ("jenkins", "quintic_stiffness"), None) == [
        ["jenkins"], ["quintic_stiffness"],
    ]  # fmt: skip


def test_values_of_one_curve_speak_each_by_its_own_error(rng):
    """Errors that go together leave a difference between neighbours that is said to be known twenty times better."""
    together = np.full((10, 10), 1.0) + 0.0025 * np.eye(10)
    whitening = np.linalg.inv(np.linalg.cholesky(together))
    left = 0.5 * np.where(np.arange(10) % 2, 1.0, -1.0)
    term = SimpleNamespace(size=10, whitening=whitening, residuals=lambda *_: whitening @ left)
    batch = SimpleNamespace(has_records=False, levels=[term] * 3)
    found = SimpleNamespace(layout=SimpleNamespace(simulator=None), parameters=lambda _: None)
    assert level_chi_square(batch, found) > 50.0
    assert level_chi_square(batch, found, is_apart=True) == pytest.approx(30.0 * 0.25 / 1.0025 / 24.0)
    # negative control: what is six errors off is so by either
    left = np.full(10, 6.0)
    term.residuals = lambda *_: whitening @ left
    assert level_chi_square(batch, found, is_apart=True) > 36.0


def test_a_base_that_is_best_because_nothing_explains_is_no_chance():
    chances = {(): 0.01, ("iwan",): 0.02}
    decision = decision_of("unexplained", best=(), p_missing=1e-20, probabilities=chances)
    assert candidate_table._of_best(decision) == "no set of effects explains enough to be told in its place"
    assert "no rare chance" in candidate_table._of_best(replace(decision, p_missing=0.2))


@pytest.mark.parametrize("is_taken", [True, False])
def test_a_beating_mode_is_reported(is_taken, rng, monkeypatch):
    """Taken away where it is a disturbance; where it is more than that, nothing is named."""
    if not is_taken:
        monkeypatch.setattr(left_beside, "_MOST_OF_A_LINE", 0.05)
    beating = decaying_sinusoid(0.08 * AMPLITUDE, 7.3)
    records = [dataclasses.replace(record, values=record.values + beating) for record in make_records(rng)]
    study = study_of(records)
    told = [note for note in study.notes if "a line that is no harmonic of the mode, at 7." in note]
    assert len(told) == is_taken, study.notes
    assert (study.verdict == "adequate") == is_taken and study.verdict != "found"
    assert ("no second mode" in {item.check for item in study.checks if not item.passed}) == (not is_taken)


def test_a_sensor_offset_is_no_effect(rng):
    study = study_of(make_records(rng, offset=0.15 * AMPLITUDE))
    assert study.verdict == "adequate"


def test_same_seed_same_result(cubic_records, cubic_study):
    again = study_of(cubic_records)
    assert again.sentence == cubic_study.sentence
    for one, other in zip(again.candidates, cubic_study.candidates, strict=True):
        assert one.effects == other.effects and one.probability == other.probability
    assert (again.shrink, again.shrink_low, again.shrink_high) == (
        cubic_study.shrink, cubic_study.shrink_low, cubic_study.shrink_high,
    )  # fmt: skip
    drawn = study_of(cubic_records, random_seed=None, candidates=("cubic_stiffness",), max_effects=1, held_out=0)
    assert isinstance(drawn.seed, int) and drawn.held_out_levels is None and drawn.held_out_specimens is None


def test_records_that_were_conditioned_already(cubic_records, cubic_study):
    study = study_of([pb.condition(record) for record in cubic_records])
    assert study.sentence == cubic_study.sentence


def test_progress_is_told(cubic_records):
    told = []
    study_of(cubic_records, candidates=("cubic_stiffness",), progress=lambda stage, share: told.append((stage, share)))
    assert len({stage for stage, _ in told}) >= 4
    assert all(0.0 <= share <= 1.0 for _, share in told)


def test_a_record_that_is_no_decay_is_left_out(cubic_records, rng):
    noise = dataclasses.replace(cubic_records[0], specimen="noise", values=1e-5 * rng.standard_normal(TIME.size))
    study = study_of([*cubic_records, noise], candidates=("cubic_stiffness",))
    assert list(study.backbones["specimen"].values) == ["specimen 1", "specimen 2"]
    assert any(note.startswith("left out: ") for note in study.notes)


# what a user can get wrong


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"candidates": ("cubic",)}, "Did you mean"),
        ({"candidates": ()}, "no candidate is left"),
        ({"candidates": ("cubic_stiffness",), "base": ("cubic_stiffness",)}, "no candidate is left"),
        ({"tolerance": float("nan")}, "`tolerance` of frequency must be a number from 0 on, got nan"),
        ({"tolerance": -0.1}, "`tolerance` of frequency"),
        ({"tolerance": "small"}, "got 'small'"),
        ({"tolerance": {"frequency": None}}, "got None"),
        ({"tolerance": {"freq": 0.1}}, "Did you mean 'frequency'"),
        ({"max_effects": 4}, "`max_effects` must be 1, 2 or 3"),
        ({"levels": [-1.0, 2.0]}, "`levels` must be positive"),
    ],
)
def test_settings_that_cannot_be(options, said, cubic_records):
    with pytest.raises(pb.InputError) as caught:
        study_of(cubic_records, **options)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_data_that_cannot_be(cubic_records):
    backbones = batch_of(cubic_records).backbones
    angle = dataclasses.replace(cubic_records[1], unit="rad")
    for data, said in (
        ([], "at least one record"),
        (cubic_records[0], "must be a list of records"),
        ("my_folder", "must be a list of records"),
        (["a.csv"], "must be a list of records"),
        (None, "must be a list of records"),
        ([cubic_records[0], angle], "all be angles"),
        (backbones.drop_vars("standard_error"), "lack `standard_error`"),
        (backbones.drop_vars("value"), "lack `value`"),
        (backbones.isel(observable=[1]), "needs the observable `frequency`"),
        (backbones.assign(standard_error=0.0 * backbones["standard_error"]), "need standard errors"),
    ):
        with pytest.raises(pb.InputError) as caught:
            study_of(data)
        assert said in str(caught.value) and "\n" not in str(caught.value), str(caught.value)


def test_mass_only_scales_forces(cubic_records):
    study = pb.find_missing_effect(
        pb.Oscillator(1e-3 * MASS), cubic_records, candidates=("cubic_stiffness",), quick=True, random_seed=1
    )
    assert study.missing_effects == ("cubic_stiffness",)
    assert study.parameters["linear_stiffness"]["linear_stiffness"].mean == pytest.approx(1e-3 * STIFFNESS, rel=0.03)


# words


def mechanism_of(mechanism: str, probability: float, share: float, **laws: float) -> MissingMechanism:
    return MissingMechanism(mechanism, probability, share, tuple(LawProbability(*item) for item in laws.items()))


SPRING = mechanism_of("spring", 0.7, 0.9, cubic_stiffness=0.7)
CLEARANCE = mechanism_of("clearance", 0.3, 0.0, freeplay=0.3)
HARDENING = mechanism_of("spring", 0.992, 0.98, cubic_stiffness=0.96, quintic_stiffness=0.03)
HYSTERESIS = mechanism_of("hysteresis", 0.996, 0.93, iwan=0.46, jenkins=0.31, bouc_wen=0.2, coulomb_friction=0.001)


@pytest.mark.parametrize(
    ("exponent", "error", "begins"),
    [
        (0.75, 0.05, "A damping force that rises less than in proportion to the speed is missing"),
        (0.75, 0.2, "Damping that rises with speed is missing"),
        (2.0, 0.1, "Damping that rises with speed is missing"),
    ],
)
def test_a_damper_whose_damping_falls_with_speed_is_told_as_one(exponent, error, begins):
    drag = replace(
        mechanism_of("drag", 0.98, 0.9, power_damping=0.97), parameters={"power_damping_exponent": (exponent, error)}
    )
    decision = decision_of("found", named_level=NamedLevel.MECHANISM, mechanisms=(drag,))
    assert verdict_words.sentence(decision).startswith(begins)


@pytest.mark.parametrize(
    ("chances", "below", "is_said"),
    [((0.5, 0.45, 0.0), (), False), ((0.4, 0.2, 0.35), (), True), ((0.4, 0.2, 0.35), ("quadratic_stiffness",), False)],
)
def test_advice_says_what_a_test_need_not_rule_out(cubic_records, chances, below, is_said):
    """Where much is for something else, a test need not decide; with what is below the tolerance a set is the same."""
    sets, larger = (("cubic_stiffness",), ("quadratic_damping",)), ("cubic_stiffness", "quadratic_stiffness")
    search = Search(batch_of(cubic_records), pb.Oscillator(MASS), CANDIDATES, 1)
    for names in ((), *sets):
        search.fit_set(names)
    known = dict(zip((*sets, larger), chances, strict=True))
    decision = decision_of("ambiguous", best=sets[0], listed=sets, below=below, probabilities=known)
    said = words.advice(search, decision)
    assert any("it is none of these sets, but another, a drift or nothing known" in item for item in said) == is_said
    assert said[0].startswith("cubic stiffness and quadratic damping") or said[0].startswith("no amplitude")


@pytest.mark.parametrize(("factor", "said"), [(2.0, " (2 times the largest amplitude so far"), (0.5, "")])
def test_what_may_break_the_structure_is_told_as_that(factor, said):
    assert words._how_far(factor).startswith(said) and bool(words._how_far(factor)) == bool(said)


def decision_of(verdict: str, **options) -> Decision:
    lack = SimpleNamespace(share=0.012, p_value=1e-9)
    fields = {"best": ("a",), "probability": 0.97, "p_missing": 0.3, "probabilities": {}, "evidences": {}, **options}
    return Decision(verdict=Verdict(verdict), lack=lack, **fields)


def test_words_of_each_verdict():
    for verdict, options, said in (
        ("found", {}, "Cubic stiffness is missing from the model, with a probability of 97 %"),
        ("found", {"best": ("coulomb_friction", "iwan")}, "Coulomb friction + Iwan are missing from the model"),
        (
            "found",
            {"drifts": (("cubic_stiffness",),), "probabilities": {("cubic_stiffness",): 0.97, ("iwan",): 0.03}},
            "97 %, while frequency or damping also change with time, or a further effect imitates that.",
        ),
        (
            "found",
            {"drifts": (("cubic_stiffness",),), "probabilities": {("cubic_stiffness",): 0.8, ("iwan",): 0.2}},
            "while frequency or damping may also change with time (80 %), or a further effect imitates that.",
        ),
        ("found", {"below": ("iwan", "quadratic_damping")}, "(Iwan and quadratic damping are detectable too, below"),
        ("ambiguous", {"listed": (("cubic_stiffness",), ("freeplay",))}, "tell apart: cubic stiffness; freeplay."),
        (
            "ambiguous",
            {"listed": (("cubic_stiffness",), ("freeplay", "iwan"), ("jenkins",), ("bouc_wen",), ("iwan",))},
            "tell apart: cubic stiffness; freeplay + Iwan; Jenkins; and 2 more.",
        ),
        ("ambiguous", {"listed": (("freeplay",),), "drift_probability": 0.2}, "freeplay; a drift with time"),
        (
            "ambiguous",
            {"listed": (("freeplay",),), "drift_probability": 0.8, "probability": 0.1},
            "do not tell apart: a drift with time; freeplay.",
        ),
        (
            "ambiguous",
            {"listed": (("freeplay",), ("iwan",)), "drifts": (("iwan",),)},
            "do not tell apart: freeplay; Iwan with a drift in time.",
        ),
        (
            "ambiguous",
            {"best": ("iwan",), "listed": (("iwan",),), "drifts": (("iwan",),)},
            "of the known effects Iwan with a drift in time is the only explanation that remains",
        ),
        ("ambiguous", {"listed": (("cubic_stiffness",),)}, "is the only explanation that remains"),
        (
            "ambiguous",
            {
                "listed": (("cubic_stiffness",), ("freeplay",)),
                "is_approximate": True,
                "mechanisms": (SPRING, CLEARANCE),
            },
            "do not tell mechanisms apart: hardening or softening of the spring 70 %, clearance or contact 30 %.",
        ),
        (
            "ambiguous",
            {
                "listed": (("cubic_stiffness",), ("freeplay",)),
                "is_approximate": True,
                "mechanisms": (HYSTERESIS, SPRING, CLEARANCE),
            },
            "Friction-like hysteresis is missing (99.6 %, 93 % of the gap). What else is, these records do not tell, "
            "and no set is exact: hardening or softening of the spring 70 %, clearance or contact 30 %.",
        ),
        (
            "ambiguous",
            {
                "listed": (("iwan",), ("freeplay",)),
                "is_approximate": True,
                "mechanisms": (HYSTERESIS,),
                "unfinished": (("jenkins",),),
            },
            "Friction-like hysteresis is missing (99.6 %, 93 % of the gap). No set is exact. Fits of sets that could "
            "explain the backbones did not come to rest: Jenkins.",
        ),
        (
            "ambiguous",
            {
                "listed": (("iwan",), ("freeplay",)),
                "is_approximate": True,
                "mechanisms": (SPRING, CLEARANCE),
                "unfinished": (("jenkins",),),
            },
            "do not tell mechanisms apart: hardening or softening of the spring 70 %, clearance or contact 30 %. Fits "
            "of sets that could explain the backbones did not come to rest: Jenkins.",
        ),
        (
            "ambiguous",
            {
                "listed": (("iwan",), ("freeplay",)),
                "is_approximate": True,
                "mechanisms": (SPRING, CLEARANCE),
                "unfinished": (("jenkins",), ("iwan",), ("freeplay",), ("bouc_wen",), ("iwan", "jenkins")),
            },
            "did not come to rest: Jenkins; Iwan; freeplay; and 2 more.",
        ),
        (
            "ambiguous",
            {
                "listed": (("iwan",), ("freeplay",)),
                "is_approximate": True,
                "has_second_mode": True,
                "mechanisms": (HYSTERESIS, CLEARANCE),
            },
            "do not tell mechanisms apart: friction-like hysteresis 99.6 %, clearance or contact 30 %. A second mode "
            "may be there, too.",
        ),
        (
            "ambiguous",
            {"listed": (("iwan",),), "is_approximate": True, "unfinished": (("jenkins",),)},
            "Something is missing; no fit explains the records. Fits of sets that could explain the backbones did not "
            "come to rest: Jenkins.",
        ),
        (
            "ambiguous",
            {
                "listed": (("cubic_stiffness",), ("freeplay",)),
                "is_approximate": True,
                "is_single_valued": False,
                "mechanisms": (HYSTERESIS, CLEARANCE),
            },
            "do not tell mechanisms apart: friction-like hysteresis 99.6 %, clearance or contact 30 %.",
        ),
        (
            "found",
            {"named_level": NamedLevel.MECHANISM, "mechanisms": (HYSTERESIS, CLEARANCE), "is_approximate": True},
            "Friction-like hysteresis is missing (99.6 %, 93 % of the gap); which law these records do not tell: "
            "Iwan 46 %, Jenkins 31 %, Bouc-Wen 20 %.",
        ),
        (
            "found",
            {"named_level": NamedLevel.MECHANISM, "mechanisms": (HYSTERESIS, SPRING), "is_approximate": True},
            "What may be missing, too: hardening or softening of the spring (70 %).",
        ),
        (
            "found",
            {"named_level": NamedLevel.MECHANISM, "mechanisms": (HYSTERESIS, CLEARANCE), "listed": (("iwan",),)},
            "Iwan 46 %, Jenkins 31 %, Bouc-Wen 20 %. What may be missing, too: clearance or contact (30 %).",
        ),
        (
            "found",
            {"named_level": NamedLevel.MECHANISM, "mechanisms": (HARDENING,), "listed": (("cubic_stiffness",),)},
            "Hardening or softening of the spring is missing (99.2 %, 98 % of the gap); its law is cubic stiffness "
            "(96 %).",
        ),
        (
            "found",
            {
                "named_level": NamedLevel.MECHANISM,
                "mechanisms": (mechanism_of("spring", 0.99, 0.9, cubic_stiffness=0.97, quintic_stiffness=0.4),),
                "listed": (("cubic_stiffness",), ("cubic_stiffness", "quintic_stiffness")),
                "best": ("cubic_stiffness",),
                "drifts": (("cubic_stiffness",),),
                "probabilities": {("cubic_stiffness",): 0.97},
            },
            "its law is cubic stiffness (97 %), beside it perhaps quintic stiffness (40 %). Frequency or damping also",
        ),
        (  # behind a bent sensor no law is told, and no set listed
            "found",
            {"named_level": NamedLevel.MECHANISM, "mechanisms": (replace(HARDENING, laws=HARDENING.laws[:1]),)},
            "its law is cubic stiffness or one like it, not exactly.",
        ),
        (
            "found",
            {"named_level": NamedLevel.MECHANISM, "mechanisms": (HARDENING,), "is_approximate": True},
            "its law is cubic stiffness or one like it, not exactly.",
        ),
        (
            "found",
            {
                "named_level": NamedLevel.MECHANISM,
                "mechanisms": (mechanism_of("spring", 0.99, 0.9, cubic_stiffness=0.6, quintic_stiffness=0.4),),
                "is_approximate": True,
            },
            "which law these records do not tell: cubic stiffness 60 %, quintic stiffness 40 %.",
        ),
        (
            "found",
            {
                "named_level": NamedLevel.MECHANISM,
                "mechanisms": (mechanism_of("spring", 0.99, 0.9, cubic_stiffness=0.6, quintic_stiffness=0.6),),
                "is_approximate": True,
            },
            "do not tell: cubic stiffness 60 %, quintic stiffness 60 %, some of them together.",
        ),
        ("unexplained", {}, "no set of known effects explains it"),
        ("unexplained", {"drift_probability": 0.9}, "a drift with time explains the records better"),
        ("adequate", {"adequate_by": AdequateBy.STATISTICS, "best": ()}, "Nothing is missing"),
        (
            "adequate",
            {"adequate_by": AdequateBy.TOLERANCE, "below": ("iwan",), "probabilities": {("iwan",): 0.95}},
            "Iwan is detectable, but changes",
        ),
        (
            "adequate",
            {
                "adequate_by": AdequateBy.TOLERANCE,
                "below": ("iwan",),
                "probabilities": {("iwan",): 0.5, ("iwan", "jenkins"): 0.04, ("jenkins",): 0.46},
            },
            "something is detectable, most probably Iwan (54 %), but changes the backbones by less",
        ),
        (
            "adequate",
            {"adequate_by": AdequateBy.TOLERANCE, "drift_probability": 0.9},
            "a drift with time is detectable",
        ),
        ("unexplained", {"best": (), "is_approximate": True}, "none comes near what the records show (1.2 % of"),
        (
            "unexplained",
            {"best": (), "is_approximate": True, "nearest": ("freeplay", "jenkins")},
            "nearest to the samples is freeplay + Jenkins, but its backbones are far off",
        ),
        (
            "adequate",
            {"adequate_by": AdequateBy.TOLERANCE, "best": ()},
            "what it leaves, 1.2 % of the motion, is more than measurement error",
        ),
    ):
        decision = decision_of(verdict, **{"best": ("cubic_stiffness",), **options})
        text = verdict_words.sentence(decision)
        assert said in text and "_" not in text


@pytest.mark.parametrize(("chance", "verdict"), [(0.7, "ambiguous"), (0.95, "unexplained")])
def test_a_drift_that_is_not_certain_is_told_beside_the_sets(chance, verdict):
    evidences = {("a",): Evidence(10.0, 3.0, 1.0 - chance)}
    search = SimpleNamespace(layout=lambda names: SimpleNamespace(free=np.zeros(len(names))))
    lack = SimpleNamespace(share=0.01, p_value=0.4)
    weighed = replace(
        decision_of("ambiguous", p_missing=1e-6, drift_probability=chance, evidences=evidences, ranked=(("a",),)),
        lack=lack,
    )
    judged = decide._judged(search, weighed, {}, None)
    assert judged.verdict == verdict
    assert ("a drift with time" in verdict_words.sentence(judged)) and (judged.listed == (("a",),)) == (chance < 0.90)


@pytest.mark.parametrize(
    ("alone", "beside", "drifts", "is_told"),
    [
        (0.92, 0.05, (), True),
        (0.84, 0.08, (("a",),), True),
        (0.84, 0.08, (), False),
        (0.8, 0.15, (("a",),), False),
        (0.8, 0.08, (("a",),), False),
        (0.45, 0.5, (("a",),), False),
    ],
)
def test_a_drift_that_stands_beside_all_that_remains_is_told_alone(alone, beside, drifts, is_told):
    """No list of sets that are improbable and all hold the drift."""
    decision = decision_of(
        "ambiguous",
        best=("a",),
        drift_probability=alone,
        drifts=drifts,
        probability=beside,
        probabilities={("a",): beside},
    )
    assert decide._is_of_drift(decision) is is_told


@pytest.mark.parametrize(("left", "is_named"), [(0.9, True), (4.9, True), (5.1, False), (np.inf, False)])
def test_no_name_is_given_against_the_backbones(left, is_named, monkeypatch):
    monkeypatch.setattr(decide, "level_chi_square", lambda batch, found, *, has_mid_line: left)
    batch = SimpleNamespace(has_records=True, is_behind_filter=False)
    search = SimpleNamespace(batch=batch, fits={("a",): None, ("a", "b"): None})
    named = decision_of("found", named_level=NamedLevel.LAW, ranked=(("a", "b"), ("a",)), drifts=(("a", "b"),))
    monkeypatch.setattr(decide, "departing", lambda _, decision: replace(decision, verdict=Verdict.UNEXPLAINED))
    heeded = decide._mind_backbones(search, named)
    assert (heeded.verdict == "found") == (heeded.named_level == "law") == is_named
    if not is_named:
        assert heeded.listed == (("a",),)
        assert "with a drift in time beside it explains the samples, but leaves" in verdict_words.sentence(heeded)
        assert words.advice(SimpleNamespace(fits={}), heeded)[0].startswith("release from other amplitudes")
    by_mechanism = replace(named, named_level=NamedLevel.MECHANISM)
    assert decide._mind_backbones(search, by_mechanism) is by_mechanism
    alone = replace(named, drifts=(("a",),))  # what the backbones of a set without a drift say may be their own fault
    assert decide._mind_backbones(search, alone) is alone
    several = replace(named, verdict=Verdict.AMBIGUOUS, named_level=None, listed=(("a", "b"), ("a",)))
    assert decide._mind_backbones(search, several) is several
    by_time = replace(several, drift_probability=0.8)  # what backbones of a drift seem to tell is no mechanism
    assert decide._mind_backbones(search, by_time) is by_time
    # no set is exact then: mechanisms are named, of one set or of several, where backbones tell these apart
    monkeypatch.setattr(
        decide, "departing", lambda _, known: replace(by_mechanism, is_approximate=True, listed=known.listed)
    )
    for open_or_named in (named, several):
        told = decide._mind_backbones(search, open_or_named)
        assert (told.named_level == "mechanism" and told.is_approximate) == (not is_named)
        assert is_named or told.listed == ()  # else the report says that the sets listed leave no more than noise


@pytest.mark.parametrize(("against", "asked"), [(30.0, False), (np.nan, True)])
def test_what_the_backbones_speak_against_names_no_mechanism_either(against, asked, monkeypatch):
    known = decision_of("ambiguous", best=("a",), listed=(("a",),), against=against)
    for name in ("_complete", "_weighed", "_judged", "_mind_backbones", "_fit_parts"):
        monkeypatch.setattr(decide, name, lambda *_: known)
    monkeypatch.setattr(decide, "_by_mechanism", lambda search, decision: replace(decision, mechanisms=(HYSTERESIS,)))
    assert bool(decide.decide(SimpleNamespace(), {}, {}).mechanisms) == asked


def test_what_lies_below_the_tolerance_is_nothing_that_may_be_missing():
    known = {"named_level": NamedLevel.MECHANISM, "mechanisms": (HYSTERESIS, CLEARANCE), "listed": (("iwan",),)}
    assert verdict_words.sentence(decision_of("found", **known)).endswith("clearance or contact (30 %).")
    assert verdict_words.sentence(decision_of("found", **known, below=("freeplay",))).endswith("Bouc-Wen 20 %.")


def test_what_no_known_set_holds_of_the_probability_is_said():
    """20, 2.9 and 0.26 % leave 76 %; where the sets hold nearly all of it, nothing is said."""
    sets = (("coulomb_friction",), ("jenkins",), ("freeplay",))
    few = dict(zip(sets, (0.202, 0.029, 0.0026), strict=True))
    unsure = decision_of("ambiguous", best=sets[0], probability=0.202, listed=sets, probabilities=few)
    assert "With 77 % it is something else, which no known effect does." in verdict_words.sentence(unsure)
    drifts = replace(unsure, drift_probability=0.7)
    assert "something else" not in verdict_words.sentence(drifts)
    most = dict(zip(sets, (0.6, 0.3, 0.08), strict=True))
    assert "something else" not in verdict_words.sentence(replace(unsure, probabilities=most))


@pytest.mark.parametrize(("verdict", "best"), [("unexplained", ("iwan",)), ("adequate", ())])
def test_backbones_alone_leave_no_share_of_a_motion(verdict, best):
    decision = decision_of(verdict, best=best, adequate_by=AdequateBy.STATISTICS if not best else None, p_missing=1e-5)
    assert "1.2 % of the motion" in verdict_words.sentence(decision)
    unknown = replace(decision, lack=SimpleNamespace(share=np.nan, p_value=1e-9))
    text = verdict_words.sentence(unknown)
    assert "nan" not in text and "of the motion" not in text


@pytest.mark.parametrize(("count", "said"), [(1, "passes each amplitude once only"), (2, "whenever it is passed")])
def test_one_decay_cannot_show_that_an_amplitude_always_has_one_frequency(count, said):
    drifting = SimpleNamespace(state=SimpleNamespace(own=np.zeros((count, 12))))
    check = rivals.drift_check(drifting, 0.0, True)
    assert check.passed and said in check.message


def test_agreement_is_not_claimed_against_the_test_of_it():
    """A base that no set is more probable than, at a p-value that is rare where nothing is missing."""
    rare = decision_of("adequate", best=(), adequate_by=AdequateBy.STATISTICS, p_missing=0.0017)
    text = verdict_words.sentence(rare)
    assert "within measurement error" not in text and "adequate to 1.2 % of the motion" in text
    assert "Chance alone rarely leaves as much (p = 0.0017)" in text
    assert "within measurement error (p = 0.3)" in verdict_words.sentence(replace(rare, p_missing=0.3))


@pytest.mark.parametrize(
    ("names", "probability", "is_open", "status"),
    [
        ("a", 0.202, False, Status.BEST),
        ("b", 0.029, False, Status.POSSIBLE),
        ("c", 0.0026, False, Status.POSSIBLE),  # the verdict lists it
        ("d", 0.0026, False, Status.REJECTED),
        ("c", 0.0026, True, Status.NOT_CONVERGED),
    ],
)
def test_no_set_is_rejected_that_the_verdict_lists(names, probability, is_open, status):
    decision = decision_of("ambiguous", best=("a",), listed=(("a",), ("b",), ("c",)))
    assert candidate_table.status_of((names,), probability, decision, is_open=is_open) is status


def test_the_table_says_how_much_less_probable_a_set_is():
    chances = {("a",): 0.2, ("b",): 0.15, ("c",): 0.02, ("b", "c"): 0.3}
    decision = decision_of("ambiguous", best=("a",), probabilities=chances)

    def said(*names: str) -> str:
        status = candidate_table.status_of(names, chances[names], decision, is_open=False)
        return candidate_table._reason(names, chances[names], -3.0, decision, status)

    assert said("b") == "explains the records about as well"
    assert said("c") == "remains possible, 10 times less probable than the best set"
    assert "most probable set without" in said("a")  # another is more probable by itself
    sure = replace(decision, probabilities={("a",): 0.9, ("b",): 0.1})
    assert candidate_table._reason(("a",), 0.9, 0.0, sure, Status.BEST) == "the most probable set"
    # out of phase no sum of squares compares sets
    told = [candidate_table._reason(names, 0.0, np.nan, sure, Status.REJECTED) for names in ((), ("b",), ("a", "b"))]
    assert all("chi-square" not in text and "far less probable" in text for text in told)
    assert "no more chi-square" in candidate_table._of_backbones(0.0)
    assert candidate_table._of_backbones(123.4).endswith("larger by 123")


@pytest.mark.parametrize(
    ("before", "after", "listed"),
    [
        ("adequate", "unexplained", ()),
        ("found", "ambiguous", (("a",),)),
        ("ambiguous", "ambiguous", (("a",), ("b",))),
        ("unexplained", "unexplained", ()),
    ],
)
def test_a_second_mode_takes_back_names_and_leaves_the_decision_as_it_was(before, after, listed):
    given = (("a",), ("b",)) if before == "ambiguous" else ()
    decision = decision_of(before, listed=given, adequate_by=AdequateBy.STATISTICS if before == "adequate" else None)
    beaten = minded.mind_second_mode(decision)
    assert (beaten.verdict, beaten.listed, beaten.adequate_by) == (after, listed, None)
    assert beaten.has_second_mode and not decision.has_second_mode and decision.verdict == before
    with pytest.raises(dataclasses.FrozenInstanceError):
        decision.verdict = Verdict.FOUND


@pytest.mark.parametrize(("is_beside", "told"), [(True, "a second mode beats with it"), (False, "a drift with time")])
def test_a_line_that_is_there_beside_a_drift_is_told_before_it(is_beside, told):
    decision = decision_of("unexplained", drift_probability=0.9)
    assert told in verdict_words.sentence(minded.mind_second_mode(decision, is_beside_drift=is_beside))


@pytest.mark.parametrize("p_value", [1e-12, 1e-4, 0.01, 0.2, 0.6])
def test_least_bayes_factor_is_the_least_over_decreasing_densities(p_value):
    """Under the alternative p has the density s p^(s - 1), s at most 1; the null's is 1. Found by trying every s."""
    shape = np.linspace(1e-3, 1.0, 400_001)
    least = 1.0 / (shape * p_value ** (shape - 1.0)).max()
    assert imitations.least_bayes_factor(p_value) == pytest.approx(least, rel=1e-6)  # the steps of s, squared
    assert imitations.least_bayes_factor(0.0) > 0.0


def test_verdicts_are_plain_text_in_files():
    assert json.dumps({Verdict.FOUND: Status.BEST}) == '{"found": "best"}' and f"{Verdict.FOUND}" == "found"
    assert [str(verdict) for verdict in Verdict] == ["adequate", "found", "ambiguous", "unexplained"]
    assert [str(status) for status in Status] == ["best", "possible", "rejected", "not converged", "failed"]


@pytest.mark.parametrize(
    ("found", "is_named"),
    [
        ((HYSTERESIS,), True),
        ((HYSTERESIS, mechanism_of("drag", 0.19, 0.0, cubic_damping=0.19)), True),
        ((HYSTERESIS, CLEARANCE), True),  # another one is possible beside it
        ((mechanism_of("spring", 0.94, 0.9, cubic_stiffness=0.94),), False),  # not certain enough
        ((mechanism_of("spring", 0.99, 0.7, cubic_stiffness=0.99),), False),  # leaves too much of the gap
        ((mechanism_of("spring", 0.99, 0.5, cubic_stiffness=0.99), mechanism_of("drag", 0.97, 0.4)), True),
        ((), False),
    ],
)
def test_mechanisms_are_named_where_certain_and_most_of_the_gap(found, is_named):
    assert inexact.is_told_apart(found) is is_named


def test_sets_of_what_is_certain_hold_each_such_mechanism_and_no_other():
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism)
    rising = mechanism_of("rising_damping", 0.97, 0.4, cubic_damping=0.5)
    sets = [("bouc_wen", "quadratic_stiffness"), ("bouc_wen",), (), ("cubic_damping", "iwan"), ("iwan",)]
    sets.append(("displacement_dependent_damping", "jenkins"))
    # a spring is possible only
    assert inexact.certain_sets(search, (HYSTERESIS, SPRING), sets) == [
        ("bouc_wen",),
        ("iwan",),
    ]  # a spring is possible only
    both = [("cubic_damping", "iwan"), ("displacement_dependent_damping", "jenkins")]  # either of two kinds of damping
    assert inexact.certain_sets(search, (HYSTERESIS, rising), sets) == both
    assert inexact.certain_sets(search, (SPRING,), sets) == []


def test_unfinished_are_sets_that_explain_the_backbones_and_were_weighed(monkeypatch):
    dahl, undone, both = ("dahl_friction",), ("iwan", "jenkins"), ("cubic_damping", "iwan")
    open_sets = {("iwan",), ("jenkins",), dahl, ("bouc_wen", "freeplay"), undone, both}
    chances = {("freeplay",): 0.5, ("jenkins",): 0.3, ("iwan",): 0.1, dahl: 0.001, (): 0.01}
    asked = []
    batch = SimpleNamespace(levels=[None] * 9, subset=lambda some: asked.append(some) or "some")
    search = SimpleNamespace(is_open=lambda names: names in open_sets, fits=chances, batch=batch, layout=lambda it: it)
    weighed = SimpleNamespace(
        gaps={("iwan",): 0.05, dahl: 0.1, ("jenkins",): 0.6, ("freeplay",): 0.0},
        probabilities=chances, ranked=lambda: sorted(chances, key=lambda names: -chances[names]),
    )  # fmt: skip
    # the first was not weighed at all
    ranked = [("bouc_wen", "freeplay"), dahl, ("jenkins",), ("freeplay",), ("iwan",)]
    unfinished = inexact._unfinished(search, weighed, ranked)
    assert unfinished == (("iwan",), dahl)
    # effects that undo each other on the backbones, near where they depart least, draw any curve
    fitted = {undone: SimpleNamespace(state=State(np.zeros(2), np.arange(63.0).reshape(9, 7)))}
    search.fits = {**chances, **fitted, both: fitted[undone]}
    monkeypatch.setattr(
        inexact, "fit_on_levels", lambda batch, names, begun: begun_at.append(begun) or (names, batch)
    )  # fmt: skip
    begun_at = []
    undo = {(undone, "some"): 60.0}
    monkeypatch.setattr(inexact, "compensation", lambda search, names, found, batch: undo.get((*found[:1], batch), 1.5))
    weighed.gaps |= {undone: 0.0, both: 0.0}
    more = weighed.probabilities | {undone: 0.2, both: 0.05}
    least = {names: SimpleNamespace(state=SimpleNamespace(eta=names)) for names in (undone, both)}
    wide = SimpleNamespace(
        gaps=weighed.gaps, departing=least, ranked=lambda: sorted(more, key=lambda names: -more[names])
    )
    assert inexact._unfinished(search, wide, [*ranked, undone, both]) == (("iwan",), both, dahl)
    assert sorted(begun[0][0] for begun in begun_at) == sorted([undone, both])
    assert all(own.tolist() == [[0.0, 1.0], [28.0, 29.0], [56.0, 57.0]] for ((_, own),) in begun_at)
    search.fits = chances
    # what remains possible beside them is listed, in the order of the probabilities
    remaining = inexact._remaining(search, weighed)
    assert () not in remaining
    assert inexact._with_unfinished(remaining[:1], unfinished, weighed) == (("freeplay",), ("iwan",), dahl)
    many = tuple((f"e{k}",) for k in range(inexact.MOST_LISTED))
    chances.update(dict.fromkeys(many, 0.2))
    assert len(inexact._with_unfinished(many, unfinished, weighed)) == inexact.MOST_LISTED
    assert {*unfinished} < {*inexact._with_unfinished(many, unfinished, weighed)}
    assert asked and all(some == [0, 4, 8] for some in asked)


def test_what_a_mechanism_explains_is_the_mean_over_the_orders():
    """Chi-square 100 without any, 40 and 70 with one, 10 with both: 60 or 60 first and last, 30 or 30, by hand."""
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism)
    chi_square = {(): 100.0, ("iwan",): 40.0, ("cubic_stiffness",): 70.0, ("cubic_stiffness", "iwan"): 10.0}
    found = shares.shares_of_gap(search, ("cubic_stiffness", "iwan"), chi_square)
    assert found == pytest.approx({"hysteresis": 0.6, "spring": 0.3})
    chi_square[("iwan",)] = 20.0  # now 80 first, 60 last; the spring 30 first, 10 last
    found = shares.shares_of_gap(search, ("cubic_stiffness", "iwan"), chi_square)
    assert found == pytest.approx({"hysteresis": 0.7, "spring": 0.2}) and sum(found.values()) == pytest.approx(0.9)
    # two laws of one mechanism share nothing out
    both = {(): 100.0, ("iwan", "jenkins"): 25.0}
    assert shares.shares_of_gap(search, ("iwan", "jenkins"), both) == pytest.approx({"hysteresis": 0.75})


def test_a_mechanism_is_as_probable_as_all_sets_that_hold_a_law_of_it():
    search = SimpleNamespace(own={"rubber": SimpleNamespace(mechanism=None, mechanism_below=None)})
    search.mechanism_of = partial(Search.mechanism_of, search)
    chances = {(): 0.05, ("iwan",): 0.5, ("jenkins",): 0.3, ("cubic_stiffness", "iwan"): 0.1, ("rubber",): 0.05}
    chi_square = {(): 50.0, ("iwan",): 5.0}
    found = {item.mechanism: item for item in shares.missing_mechanisms(search, chances, ("iwan",), chi_square, {})}
    assert list(found) == ["hysteresis", "spring", "other"]  # most probable first
    assert found["hysteresis"].probability == pytest.approx(0.9) and found["other"].probability == pytest.approx(0.05)
    assert [(law.effect, round(law.probability, 6)) for law in found["hysteresis"].laws] == [
        ("iwan", 0.6),
        ("jenkins", 0.3),
    ]
    assert found["hysteresis"].share_of_gap == pytest.approx(0.9) and found["spring"].share_of_gap == 0.0


def test_what_an_effect_changes_by_less_than_the_tolerance_is_no_reason():
    """A damper changes the frequency by a hundredth of a per cent, too: nobody would find it by that."""
    limits = {"frequency": 1e-3, "damping": 1e-2, "offset": 1e-2}
    before = np.array([[[10.0, 10.0], [0.05, 0.05], [0.0, np.nan]]])
    after = np.array([[[10.001, 10.0], [0.05, 0.08], [0.001, np.nan]]])
    assert words._that_matter((0, 1, 2), after, before, limits) == (1,)
    assert words._that_matter((0, 1, 2), after, before, {}) == (0, 1, 2)
    assert words._that_matter((0, 2), after, before, limits) == (0, 2)
    assert words._that_matter((0, 2), after, before, limits, or_none=True) == ()
    assert words._that_matter((0, 1, 2), after, before, limits, or_none=True) == (1,)


def test_a_second_mode_is_told_where_no_fit_came_to_rest():
    decision = replace(
        decision_of("ambiguous", best=(), probabilities={(): 0.5}), unfinished=(("iwan",),), has_second_mode=True,
    )  # fmt: skip
    assert "a second mode beats in the records" in verdict_words.sentence(decision)
    assert "second mode" not in verdict_words.sentence(replace(decision, has_second_mode=False))


def test_what_may_be_a_spring_and_a_clearance_at_once_is_told_as_either():
    """Where no law is exact, a contact that closes gradually is imitated by both, or by springs alone."""
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism)
    springs, both = ("cubic_stiffness", "quintic_stiffness"), ("cubic_stiffness", "freeplay", "quintic_stiffness")
    chances, gaps = {springs: 0.9, both: 0.1}, {(): 50.0, springs: 5.0, both: 4.0}

    def told(joined):
        found = shares.missing_mechanisms(search, chances, springs, gaps, {}, joined=frozenset(joined))
        return {item.mechanism: item.probability for item in found}

    assert told(("spring",)) == pytest.approx({"spring": 1.0, "clearance": 0.1})
    assert told(("spring", "clearance")) == pytest.approx({"changing_stiffness": 1.0})
    # nor is it told twice, as a spring or a clearance and as a spring or an inertia
    assert told(("spring", "clearance", "inertia")) == pytest.approx({"changing_stiffness": 1.0})


def test_what_a_larger_set_leaves_far_less_with_is_not_told_to_be_absent():
    springs, both = ("cubic_stiffness", "quintic_stiffness"), ("cubic_stiffness", "freeplay", "quintic_stiffness")
    other = ("cubic_stiffness", "iwan")

    def joined(left, refuted=()):
        search = SimpleNamespace(
            mechanism_of=lambda name: LIBRARY[name].mechanism, count=1000.0, is_refuted=lambda names: names in refuted,
            fits={names: SimpleNamespace(cost=1000.0 * reduced) for names, reduced in left.items()},
        )  # fmt: skip
        return inexact._joined(search, springs)

    assert joined({springs: 34.8, both: 1.8, other: 1.1}) == {"spring", "clearance"}  # the last holds not all of it
    assert joined({springs: 34.8, both: 1.8}, refuted=(springs,)) == {"spring", "clearance"}
    assert joined({springs: 2.0, both: 1.5}) == {"spring"}
    assert joined({springs: 900.0, both: 12.0}) == {"spring"}  # near nothing
    assert joined({springs: 34.8, both: 1.8}, refuted=(both,)) == {"spring"}
    # another set leaves less, and does so by its clearance
    gap, spring = ("freeplay", "power_stiffness"), ("power_stiffness",)
    assert joined({springs: 1332.0, gap: 158.0, spring: 525.0}) == {"spring", "clearance"}
    assert joined({springs: 1332.0, gap: 158.0, spring: 200.0}) == {"spring"}
    assert joined({springs: 200.0, gap: 158.0, spring: 525.0}) == {"spring"}
    assert joined({springs: 2.5, gap: 1.2, spring: 2.5}) == {"spring"}  # near the noise a larger set has to show it


@pytest.mark.parametrize("compensated", [1.5, 2.6])
def test_laws_of_one_mechanism_that_take_each_other_back_are_one_curve(monkeypatch, compensated):
    """Two springs of opposite sign add up to any smooth third one: the mechanism is named, the laws are not."""
    springs = ("magnetic_stiffness", "power_stiffness")
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism)
    monkeypatch.setattr(decide, "compensation", lambda search, names: compensated)
    assert decide._is_one_curve(search, decision_of("found", best=springs)) == (compensated > 2.0)
    assert not decide._is_one_curve(search, decision_of("found", best=("cubic_stiffness", "quadratic_damping")))
    decision = replace(
        decision_of("found", named_level=NamedLevel.LAW, best=springs, probability=0.92),
        mechanisms=(mechanism_of("spring", 0.96, 1.0, magnetic_stiffness=0.92, power_stiffness=0.92),),
    )
    said = verdict_words.sentence(decide.without_laws(decision))
    assert "spring is missing (96 %, 100 % of the gap); its laws are magnetic stiffness and power stiffness" in said
    assert "together, or ones like them, not exactly" in said
    open_still = decide.without_laws(replace(decision, mechanisms=()))
    assert (open_still.verdict, open_still.named_level, open_still.listed) == (Verdict.AMBIGUOUS, None, (springs,))


@pytest.mark.parametrize(
    ("names", "is_like"),
    [
        (("magnetic_stiffness", "power_stiffness"), True),  # two rare springs
        (("mid_stroke_damping", "stribeck_friction"), True),  # two rare laws of two mechanisms
        (("cubic_stiffness", "power_stiffness"), True),
        (("cubic_stiffness", "quintic_stiffness"), False),
        (("power_stiffness", "quadratic_damping"), False),
        (("power_stiffness",), False),
    ],
)
def test_two_rare_laws_are_likelier_one_that_the_library_lacks(names, is_like):
    rare = {name for name, effect in LIBRARY.items() if effect.variant_of}
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism, variants=rare)
    assert decide._is_of_rare_laws(search, decision_of("found", best=names)) == is_like
    mechanisms = (mechanism_of("spring", 0.999, 1.0, **dict.fromkeys(names, 0.99)),)
    exact = {"named_level": NamedLevel.MECHANISM, "mechanisms": mechanisms, "best": names, "listed": (names,)}
    said = verdict_words.sentence(decision_of("found", **exact, is_like=is_like))
    assert ("like" in said) == is_like


@pytest.mark.parametrize(
    ("change", "error", "is_bent"), [(0.4, 0.05, True), (0.4, 0.3, False), (0.06, 0.005, True), (0.03, 0.005, False)]
)
def test_a_law_beside_which_damping_is_to_change_by_much_is_one_like_it(change, error, is_bent):
    names = ("speed_limited_damping",)
    own, variances = np.zeros((3, 20)), np.zeros((3, 20))
    own[:, DRIFTS[1]], variances[:, DRIFTS[1]] = 2.0 * change, (2.0 * error) ** 2  # of half the damping each
    search = SimpleNamespace(fits={names: SimpleNamespace(state=SimpleNamespace(own=own), own_covariance=variances)})
    assert decide._is_bent_by_time(search, decision_of("found", best=names, drifts=(names,))) == is_bent
    assert not decide._is_bent_by_time(search, decision_of("found", best=names))


def test_a_law_that_wants_another_of_its_mechanism_below_the_tolerance_is_one_like_it():
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism)
    power, both = ("power_stiffness",), ("cubic_stiffness", "power_stiffness")
    decision = replace(
        decision_of("found", named_level=NamedLevel.LAW, best=power, probability=0.93),
        probabilities={power: 0.12, both: 0.81}, below=("cubic_stiffness",),
    )  # fmt: skip
    assert decide._is_inexact_alone(search, decision)
    assert decide._is_inexact_alone(search, replace(decision, below=("quadratic_stiffness",)))  # the other side differs
    assert not decide._is_inexact_alone(search, replace(decision, below=("quadratic_damping",)))
    assert not decide._is_inexact_alone(search, replace(decision, below=("freeplay",)))
    assert not decide._is_inexact_alone(search, replace(decision, probabilities={power: 0.81, both: 0.12}))
    # a damper that weakens with the displacement and rises at another is one law, and none that falls
    falling, two = ("mid_stroke_damping",), ("dead_band_damping", "mid_stroke_damping")
    damper = replace(decision, best=falling, probabilities={falling: 0.12, two: 0.81}, below=("dead_band_damping",))
    assert decide._is_inexact_alone(search, damper)
    assert not decide._is_inexact_alone(search, replace(damper, below=("cubic_stiffness",)))


@pytest.mark.parametrize(
    ("law", "tolerance", "level"),
    [("power_stiffness", 0.01, "mechanism"), ("power_stiffness", 1e-4, "law"), ("cubic_stiffness", 0.01, "law")],
)
def test_a_law_of_free_shape_that_needs_a_drift_too_small_to_matter_is_one_like_it(law, tolerance, level, monkeypatch):
    """The drift makes up for what the law is not; one that matters is told beside the law, as before."""
    names = (law,)
    decision = decision_of(
        "found", named_level=NamedLevel.LAW, best=names, ranked=(names,), probabilities={names: 0.97}, drifts=(names,)
    )
    decision = replace(decision, lack=SimpleNamespace(share=0.0, p_value=0.4))
    own = np.zeros((2, 20))
    own[:, DRIFTS[0]] = 0.001 / DRIFT  # of the frequency
    fit = SimpleNamespace(cost=100.0, state=SimpleNamespace(own=own), own_covariance=np.zeros_like(own))
    for name, given in [
        ("_complete", lambda search: None), ("_weighed", lambda *_: None), ("_judged", lambda *_: decision),
        ("_mind_backbones", lambda search, decision: decision), ("estimates_of", lambda fit: {}),
        ("_backbones_disagree", lambda *_: False), ("_fit_parts", lambda *_: None),
    ]:  # fmt: skip
        monkeypatch.setattr(decide, name, given)
    search = SimpleNamespace(
        fits={(): SimpleNamespace(cost=1e4), names: fit}, mechanism_of=lambda name: LIBRARY[name].mechanism,
        variants=("power_stiffness",), count=100,
    )  # fmt: skip
    found = decide.decide(search, {}, {"frequency": tolerance, "damping": tolerance})
    assert found.named_level == level and found.has_small_drift == (tolerance > 0.001)
    assert ("also change with time" in verdict_words.sentence(found)) == (not found.has_small_drift)


def test_what_is_told_of_a_set_that_is_not_exact_is_of_that_set(monkeypatch):
    """What of an exact set was above the tolerance had stayed in the model: another than the one that was told."""
    other = ("c",)
    weighed = SimpleNamespace(
        ranked=lambda: [other], gaps={other: 0.1}, probabilities={other: 0.9}, is_law=True, drift_probability=0.0
    )
    for name, value in {
        "weigh": weighed, "_without_idle": weighed, "_is_kept": True, "_told": (), "remainder_of": (),
        "certain_sets": [], "_remaining": (other,),
    }.items():  # fmt: skip
        monkeypatch.setattr(inexact, name, lambda *_, value=value: value)
    monkeypatch.setattr(inexact.evidence, "lack_of_fit", lambda *_: LackOfFit(2.0, 1e-9, 0.01))
    search = SimpleNamespace(mend=lambda _: None, is_refuted=lambda _: False, batch=None, fits={other: None}, count=100)
    monkeypatch.setattr(inexact, "_nearest", lambda *_: None)
    pruned = replace(decision_of("ambiguous", best=("a",), below=("b",)), simulated=("a", "b"))
    said = inexact.departing(search, pruned)
    assert (said.best, said.model, said.above) == (other, other, other)


@pytest.mark.parametrize(
    ("left", "before", "is_off"), [(4.9, 10.0, False), (5.1, 10.0, True), (24.0, 2500.0, False), (26.0, 2500.0, True)]
)
def test_no_mechanism_is_named_of_a_set_that_is_not_exact_and_leaves_the_backbones(left, before, is_off, monkeypatch):
    """A second mode at twice the frequency had been a spring of two sides with 97 %, at 24 times the errors."""
    names, mechanism = ("quadratic_stiffness",), SimpleNamespace(is_certain=True, share_of_gap=0.95)
    weighed = SimpleNamespace(
        ranked=lambda: [names], gaps={names: 0.1, (): 1.0}, probabilities={names: 0.97, (): 0.0}, is_law=True,
        drift_probability=0.0,
    )  # fmt: skip
    for name, value in {
        "weigh": weighed, "_without_idle": weighed, "_is_kept": True, "_told": (mechanism,), "remainder_of": (),
        "certain_sets": [], "leaves_the_samples": False, "has_mid_line": False, "_unfinished": (),
    }.items():  # fmt: skip
        monkeypatch.setattr(inexact, name, lambda *_, value=value: value)
    monkeypatch.setattr(inexact, "on_levels", lambda _, found: found)
    monkeypatch.setattr(inexact, "about_zero", lambda batch, _: batch)
    monkeypatch.setattr(inexact, "level_chi_square", lambda _, found: {"found": left, "base": before}[found])
    monkeypatch.setattr(inexact.evidence, "lack_of_fit", lambda *_: LackOfFit(2.0, 1e-9, 0.01))
    batch = SimpleNamespace(has_records=True, is_behind_filter=False, waveform=())
    fits = {names: "found", (): "base"}
    search = SimpleNamespace(mend=lambda _: None, is_refuted=lambda _: False, batch=batch, fits=fits, count=100)
    said = inexact.departing(search, decision_of("ambiguous", best=names))
    assert said.verdict == ("unexplained" if is_off else "found")
    assert (said.best, said.nearest) == (((), names) if is_off else (names, None))
    assert said.probabilities[names] == (0.0 if is_off else 0.97)
    told = verdict_words.sentence(said) if is_off else ""
    assert ("nearest to the samples is quadratic stiffness, but its backbones are far off" in told) == is_off
    if is_off:  # behind a filter backbones are not those of the motion
        batch.is_behind_filter = True
        assert inexact.departing(search, decision_of("ambiguous", best=names)).verdict == "found"


def test_sets_that_differ_by_what_is_below_the_tolerance_are_one():
    chances = {("a",): 0.3, ("b",): 0.3, ("a", "c"): 0.2, ("c", "d"): 0.1, (): 0.1}
    assert as_one(("c",), chances) == {("a",): 0.5, ("b",): 0.3, ("c", "d"): 0.1, (): 0.1}
    assert as_one((), chances) == chances
    evidences = {names: Evidence(0.0, float(np.log(chance)), chance) for names, chance in chances.items()}
    search = SimpleNamespace(layout=lambda names: SimpleNamespace(free=np.zeros(len(names))))
    weighed = replace(
        decision_of(
            "ambiguous", best=("a", "c"), probability=0.5, p_missing=1e-6, evidences=evidences, ranked=tuple(chances)
        ),
        lack=LackOfFit(1.0, 0.4, 0.001),
    )
    judged = decide._judged(search, weighed, {}, None)
    assert ("a", "c") in judged.listed and judged.listed[0] == ("a",)
    one = replace(weighed, best=("a",), below=("c",))
    assert decide._judged(search, one, {}, None).listed[:2] == (("a",), ("b",))
    assert ("a", "c") not in decide._judged(search, one, {}, None).listed


def test_a_drift_that_a_force_explains_as_well_is_told_beside_it():
    drifting = verdict_words.sentence(decision_of("unexplained", drift_probability=0.9, best=("cubic_stiffness",)))
    both = verdict_words.with_forces(drifting, is_drift_exact=True)
    assert "so does a force that depends on displacement and speed alone" in both
    assert "better than any effect" not in both
    alone = verdict_words.with_forces(drifting, is_drift_exact=False)
    assert "explains the records, and a drift with time does not" in alone
    other = verdict_words.sentence(decision_of("unexplained"))
    assert verdict_words.with_forces(other, is_drift_exact=True) == other


def test_what_is_sure_and_small_is_no_perhaps():
    decision = decision_of(
        "found", named_level=NamedLevel.MECHANISM, best=("cubic_stiffness",), listed=(("cubic_stiffness",),),
        mechanisms=(
            mechanism_of("spring", 0.99, 0.95, cubic_stiffness=0.99),
            mechanism_of("asymmetry", 0.99, 0.03, quadratic_stiffness=0.99),
            mechanism_of("drag", 0.3, 0.0, quadratic_damping=0.3),
        ),
    )  # fmt: skip
    said = verdict_words.sentence(decision)
    assert "A small part beside it: a spring that differs between the two sides (99 %, 3 % of the gap)." in said
    assert "What may be missing, too: damping that rises with speed (30 %)." in said


def test_of_improbable_sets_the_one_that_is_told_stands_first():
    rows = [
        Candidate(names, chance, 0.0, left, 1.0, Status.REJECTED, "")
        for names, chance, left in (
            (("a",), 0.0, 2.0), (("b",), 1e-30, 9.0), ((), 0.6, 30.0), (("c",), 1e-12, np.nan), (("d",), 0.1, 1.0),
        )
    ]  # fmt: skip
    decision = decision_of("unexplained", nearest=("b",))
    rows.sort(key=lambda item: candidate_table._place(item, decision))
    assert [row.effects for row in rows] == [(), ("d",), ("b",), ("a",), ("c",)]


def test_a_row_says_that_its_fit_drifts_with_time():
    row = Candidate((), 0.9, 0.0, 1.0, 1.0, Status.BEST, "", has_drift=True)
    assert candidate_name(row) == "nothing (base model), with a drift in time"
    assert candidate_name(replace(row, effects=("iwan",), has_drift=False)) == "Iwan"


@pytest.mark.parametrize(("left", "of_mechanism"), [(5.0, 0.9), (34.0, 0.8), (45.0, 0.5)])
def test_what_imitates_a_law_from_outside_is_mostly_of_the_mechanism_that_closes_the_gap(left, of_mechanism):
    """0.9 for sets that hold the mechanism in two of three parts; the other 0.06 is shared out alike.

    Of a mechanism that closes most of the gap nine tenths of its part count, of one that closes none of it half.
    """
    search = SimpleNamespace(mechanism_of=lambda name: LIBRARY[name].mechanism)
    chances = {("iwan",): 0.6, ("cubic_stiffness",): 0.3}
    found = shares.missing_mechanisms(search, chances, ("iwan",), {(): 50.0, ("iwan",): left}, {}, 0.06)
    known = {item.mechanism: item.probability for item in found}
    expected = {"hysteresis": 0.6 + of_mechanism * 0.06 * 2.0 / 3.0, "spring": 0.3 + 0.5 * 0.06 / 3.0}
    assert known == pytest.approx(expected)


@pytest.mark.parametrize(
    ("chances", "options", "level"),
    [
        ({("iwan",): 0.5, ("jenkins",): 0.48}, {}, "mechanism"),
        ({("iwan",): 0.5, ("jenkins",): 0.4}, {"drift_probability": 0.08}, None),  # a drift remains possible
        ({("iwan",): 0.5, ("cubic_stiffness",): 0.48}, {}, None),  # mechanisms differ
        ({("iwan",): 0.5, ("jenkins",): 0.48}, {"unfinished": (("bouc_wen",),)}, None),
        ({("iwan",): 0.5, ("jenkins",): 0.48}, {"drifts": (("iwan",),)}, None),  # with a drift, and far off backbones
        ({("iwan",): 0.5, ("jenkins",): 0.48}, {"drifts": (("jenkins",),)}, "mechanism"),
        ({("iwan",): 0.5, ("jenkins",): 0.48}, {"verdict": Verdict.UNEXPLAINED}, None),
    ],
)
def test_exact_sets_that_agree_on_the_mechanism_only_name_it(chances, options, level, monkeypatch):
    monkeypatch.setattr(decide, "estimates_of", lambda fit: {})
    monkeypatch.setattr(decide, "level_chi_square", lambda batch, fit, *, has_mid_line: 30.0)
    costs = {(): 250.0, ("iwan",): 180.0, ("jenkins",): 181.0, ("cubic_stiffness",): 181.0}  # the noise is louder
    search = SimpleNamespace(
        count=100, variants=(), batch=SimpleNamespace(is_behind_filter=False),
        fits={names: SimpleNamespace(cost=cost) for names, cost in costs.items()},
        mechanism_of=lambda name: LIBRARY[name].mechanism,
    )  # fmt: skip
    sets = tuple(chances)
    options = {"probabilities": chances, "best": ("iwan",), "listed": sets, "verdict": "ambiguous", **options}
    found = decide._by_mechanism(search, replace(decision_of(**options), lack=SimpleNamespace(share=0.0, p_value=0.4)))
    assert found.named_level == level and found.listed == sets
    assert found.verdict == (Verdict.FOUND if level else options["verdict"])
    assert found.mechanisms[0].mechanism == "hysteresis"


def test_two_dampers_that_few_records_do_not_tell_apart_are_one_mechanism():
    records = make_records(np.random.default_rng(2), ("quadratic_damping",), specimens=3, decibels=34.0)
    study = study_of(records, candidates=("quadratic_damping", "cubic_damping"), max_effects=1)
    check_whole(study)
    assert study.verdict == "found" and study.named_level == "mechanism" and study.missing_effects == ()
    assert set(study.ambiguous_sets) == {("quadratic_damping",), ("cubic_damping",)}
    assert study.mechanisms[0].mechanism == "drag" and study.mechanisms[0].is_certain
    assert "do not tell: " in study.sentence and study.advice


def test_what_no_set_explains_exactly_is_not_named(rng):
    """A damper with a dead band is no effect of the library: sets that follow it are listed, none is named."""
    records = []
    for k, record in enumerate(make_records(rng, (), specimens=3, decibels=60.0)):
        stiffness = STIFFNESS * (1.0 + 0.01 * k)

        def force(t, y, stiffness=stiffness):
            extra = 3.0 * DAMPING * y[1] if abs(y[0]) > 0.4 * AMPLITUDE else 0.0
            return [y[1], -(stiffness * y[0] + DAMPING * y[1] + extra) / MASS]

        time = record.time
        solved = solve_ivp(force, (0.0, time[-1]), [AMPLITUDE, 0.0], t_eval=time, rtol=1e-9, atol=1e-12, max_step=0.002)
        noise = 1e-3 * AMPLITUDE / np.sqrt(2.0) * rng.standard_normal(time.size)
        records.append(pb.Record(record.specimen, time, solved.y[0] + noise))
    study = study_of(records, candidates=("quadratic_damping", "cubic_damping", "coulomb_friction", "cubic_stiffness"))
    check_whole(study)
    assert study.verdict in ("ambiguous", "unexplained") and study.missing_effects == ()
    assert () not in study.ambiguous_sets


def test_ambiguous_sets_come_with_advice(rng):
    """Gap and cubic spring at one weak strength, and much noise: told apart by other amplitudes, if at all."""
    records = make_records(rng, ("cubic_stiffness",), share=0.02, decibels=38.0)
    study = study_of(records, candidates=("cubic_stiffness", "quintic_stiffness", "freeplay"), tolerance=0)
    check_whole(study)
    assert study.verdict in ("ambiguous", "adequate")
    if study.verdict == "ambiguous":
        assert ("cubic_stiffness",) in study.ambiguous_sets
        assert study.advice


# with sampling


def test_with_sampling_the_posterior_brackets_the_truth(random_seed):
    records = make_records(np.random.default_rng(random_seed), ("cubic_stiffness",), scatter=0.0)
    study = study_of(
        records, candidates=("cubic_stiffness", "coulomb_friction"), max_effects=1, quick=False, draws=200, tune=300,
        chains=2, held_out=0,
    )  # fmt: skip
    assert study.missing_effects == ("cubic_stiffness",)
    assert isinstance(study.posterior, xr.DataTree)
    assert dict(study.posterior["posterior"].sizes) == {"chain": 2, "draw": 200}
    assert study.convergence["draws"] == 200 and study.convergence["chains"] == 2
    assert list(study.posterior_backbone["specimen"].values) == ["mean specimen"]
    for name, value in truth_of(("cubic_stiffness",)).items():
        estimate = study.parameters[name][name]
        low, high = study.posterior_bounds[name]
        assert low <= estimate.hdi_low < estimate.mean < estimate.hdi_high <= high
        # twice the 95 % interval, which few draws of a random walk know to a quarter: about four standard deviations
        reach = estimate.hdi_high - estimate.hdi_low
        assert estimate.hdi_low - 0.5 * reach < value < estimate.hdi_high + 0.5 * reach, name
        assert reach < 0.5 * value
    assert study.settings["likelihood"] == "pooled"


@pytest.mark.parametrize(("gap", "is_asked"), [(20.0, True), (0.5, False)])
def test_the_base_begins_once_more_where_the_best_set_ended(gap, is_asked):
    """Whether anything is missing hangs on the base: its fit may be lost by less than what refutes a set."""

    def fit_of(cost, q):
        return SimpleNamespace(
            cost=cost, state=SimpleNamespace(eta=np.ones(q), own=np.ones((2, 7 + q))), layout=layouts[q]
        )

    layouts = {0: SimpleNamespace(names=()), 1: SimpleNamespace(names=("a",))}
    asked = []

    def from_near(layout, states, rival):
        asked.append((layout.names, states, rival))
        return fit_of(100.2, 0)

    search = SimpleNamespace(
        fits={(): fit_of(100.0 + gap, 0), ("a",): fit_of(100.0, 1)}, count=100, ranked=lambda: [("a",), ()],
        layout=lambda names: layouts[len(names)], _was_asked=lambda names, other: False,
        _smaller=lambda layout, larger: larger.cost, descent=SimpleNamespace(from_near=from_near),
        is_refuted=lambda names: False, _is_explained=lambda: True,
    )  # fmt: skip
    Search._look_back(search)
    assert asked == ([((), [100.0], 100.0 + gap)] if is_asked else [])
    assert search.fits[()].cost == (100.2 if is_asked else 100.0 + gap)
