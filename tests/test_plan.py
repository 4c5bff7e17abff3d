"""The next test, computed: what a test would tell, against SciPy; what is advised; the command on a folder."""

from __future__ import annotations

import dataclasses
import json
from unittest.mock import patch

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import norm

import pymc_backbone as pb
from pymc_backbone.cli.main import main
from pymc_backbone.discrepancy.deciding.decision import NAMED
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.planning import plan as planning
from pymc_backbone.discrepancy.planning.imagined import imagine, miss, vector_of
from pymc_backbone.discrepancy.planning.plan import plan_tests
from pymc_backbone.discrepancy.results.design import Affordable, Contender, Design, Plan, PlannedTest
from pymc_backbone.discrepancy.wording.plan_words import sentences
from pymc_backbone.reporting.study_files import write_study

from .discrepancy_cases import AMPLITUDE, DAMPING, MASS, OMEGA, STIFFNESS, force_of, free_decay
from .study_cases import make_study

OWN = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING}
WEAK = 0.01 * STIFFNESS / AMPLITUDE**2
CUBIC = Contender(("cubic_stiffness",), 0.6, {**OWN, "cubic_stiffness": WEAK}, {"cubic_stiffness": 0.1 * WEAK})
NOTHING = Contender((), 0.4, {**OWN, "linear_stiffness": 1.005 * STIFFNESS})
PRESENT = Design(AMPLITUDE, 2, 4.0, 100.0, 0.02 * AMPLITUDE)


def layout(*effects):
    return make_layout(pb.Oscillator(MASS, list(effects)), PRESENT.release, OMEGA)


@pytest.mark.parametrize("added", [0.0, 0.4])
def test_what_a_test_would_tell_is_what_scipy_says(added):
    """The linear oscillator in closed form, fitted by SciPy to a hardening decay that SciPy integrated."""
    design = dataclasses.replace(PRESENT, added_mass=added)
    spring = layout("cubic_stiffness")
    test = imagine(spring, vector_of(spring, dict(CUBIC.parameters)), design)
    time, noise = test.waveform.time, design.noise / np.sqrt(design.records)
    exact = free_decay(force_of(("cubic_stiffness",), CUBIC.parameters), AMPLITUDE, time, mass=MASS + added)
    np.testing.assert_allclose(test.waveform.values, exact, atol=1e-5 * AMPLITUDE)

    def closed_form(q):
        omega, rate = q[0] * np.sqrt(STIFFNESS / (MASS + added)), q[1] * DAMPING / (2.0 * (MASS + added))
        damped, t = np.sqrt(omega**2 - rate**2), time - q[3] / OMEGA
        wave = np.cos(damped * t) + rate / damped * np.sin(damped * t)
        return AMPLITUDE * (q[2] * np.exp(-rate * t) * wave + q[4])

    best = least_squares(lambda q: (closed_form(q) - exact) / noise, [1.004, 1.0, 1.0, 0.0, 0.0], xtol=1e-12)
    found = miss(layout(), NOTHING, [test])
    assert best.cost > 5.0  # a difference that means something
    assert found.cost == pytest.approx(2.0 * best.cost, rel=1e-3)
    assert found.residuals @ found.residuals == pytest.approx(found.cost, rel=1e-6)


@pytest.mark.parametrize("gain", [0.5, 8.0, 40.0])
def test_one_rival_is_excluded_as_often_as_the_normal_distribution_says(gain):
    noise = np.random.default_rng(0).standard_normal((200_000, 2))
    shown = planning._share_resolved(np.array([0.7]), np.array([gain]), [np.ones(3)], noise)
    needed = np.log(NAMED / (1.0 - NAMED))
    assert shown == pytest.approx(norm.sf((needed - 0.7 - 0.5 * gain) / np.sqrt(gain)), abs=0.004)


def test_rivals_that_miss_alike_fall_together():
    """Two that miss in one direction are excluded together; two at right angles less often both."""
    noise = np.random.default_rng(0).standard_normal((100_000, 3))
    odds, gains = np.zeros(2), np.array([8.0, 8.0])
    alike = planning._share_resolved(odds, gains, [np.array([1.0, 0.0])] * 2, noise)
    apart = planning._share_resolved(odds, gains, [np.array([1.0, 0.0]), np.array([0.0, 1.0])], noise)
    # both have the same odds: p = 1/(1 + 2 exp(-l)) of one normal l
    needed = np.log(2.0 * NAMED / (1.0 - NAMED))
    assert alike == pytest.approx(norm.sf((needed - 4.0) / np.sqrt(8.0)), abs=0.006)
    assert apart < alike - 0.03


def test_what_is_possible_beside_the_contenders_counts():
    """What goes with the truth stays, however far the rivals fall; what goes with a rival falls with it."""
    noise = np.random.default_rng(0).standard_normal((100_000, 2))
    shared = {"directions": [np.ones(3)], "noise": noise}
    # a sixth of the probability remains elsewhere
    assert planning._share_resolved(np.array([3.0]), np.array([1e4]), against=0.2, **shared) == 0.0
    assert planning._share_resolved(np.array([3.0]), np.array([1e4]), certainty=0.87, **shared) == 0.0
    shown = planning._share_resolved(np.array([0.0]), np.array([8.0]), each=1.2, **shared)
    needed = np.log(1.2 * NAMED / (1.0 - NAMED))
    assert shown == pytest.approx(norm.sf((needed - 4.0) / np.sqrt(8.0)), abs=0.006)
    # odds that scatter: named as often as they are small enough
    odds = np.random.default_rng(1).exponential(0.1, len(noise))
    shown = planning._share_resolved(np.array([3.0]), np.array([1e4]), against=odds, **shared)
    assert shown == pytest.approx(1.0 - np.exp(-(1.0 / NAMED - 1.0) / 0.1), abs=0.006)


def planner_of_nested(ahead, noise=PRESENT.noise):
    """A model, and the same with a cubic spring that is not there, which is ahead by so much chi-square."""
    smaller = dataclasses.replace(NOTHING, parameters=OWN, probability=0.5, chi_square=100.0 + ahead)
    larger = Contender(("cubic_stiffness",), 0.5, {**OWN, "cubic_stiffness": 0.0}, {}, 100.0)
    present = dataclasses.replace(PRESENT, noise=noise)
    return planning._Planner(pb.Oscillator(MASS), (smaller, larger), present, {}, 0)


@pytest.mark.parametrize(("records", "ahead"), [(2, 9.0), (6, 9.0), (18, 4.0)])
def test_what_a_larger_set_owes_to_noise_is_weighed_with_new_noise(records, ahead):
    """Against means of measurements: a value that is zero, measured as three errors, and then once more."""
    planner = planner_of_nested(ahead)
    before = planner._before(0, 1, 0)
    new = imagine(planner.layouts[0], planner.truths[0][0], dataclasses.replace(PRESENT, records=records))
    together = planner._together(planner.layouts[1], planner.contenders[1], before, new)
    odds = planner._larger(0, 1, ahead, before[1].fit, together.fit)
    rng = np.random.default_rng(4)
    weights = np.array([PRESENT.records, records])
    later = rng.standard_normal(200_000) / np.sqrt(weights[1])
    measured = np.stack([np.full(later.size, np.sqrt(ahead / weights[0])), later])
    z = np.abs(weights @ measured) / np.sqrt(weights.sum())
    # evidence of a normal value with a prior three times as wide as it is found, or could be seen: of its logarithm
    exact = np.exp(0.5 * (z**2 - ahead)) * max(np.sqrt(ahead), 3.0) / np.maximum(z, 3.0)
    for share in (0.25, 0.5, 0.75):
        assert np.quantile(odds, share) == pytest.approx(np.quantile(exact, share), rel=0.1)
    assert np.median(odds) < 0.5  # it falls behind, although both predict the same


def test_a_larger_set_that_is_ahead_by_noise_falls_behind_with_more_data():
    planner = planner_of_nested(9.0)
    shares = [planner.score(dataclasses.replace(PRESENT, records=n), 1).by_set[0] for n in (1, 20, 400)]
    assert shares[0] < shares[1] < shares[2] and shares[2] > 0.2
    unknown = planner_of_nested(float("nan"))
    assert unknown.score(dataclasses.replace(PRESENT, records=400), 1).by_set[0] == 0.0


def test_sets_that_no_contender_is_are_as_probable_as_in_a_search():
    """Twelve effects that might be added, each with a normal estimate of zero: their odds as the evidence has them."""
    planner = planner_of_nested(0.0)
    nothing, odds = planner._unlisted(0), planner._unlisted(1)
    assert 0.4 < np.median(nothing) < 0.8  # the base alone holds some 0.6 where nothing is missing
    # what is named at last holds 0.9 to 0.96 where nothing else is near, in the benchmark
    assert 0.02 < np.median(odds) < 0.12
    assert 0.8 < np.mean(planner.held / (1.0 + odds) > NAMED) < 0.99
    assert np.quantile(odds, 0.95) > 3.0 * np.median(odds)  # one of them fits the noise well now and then


def test_a_plan_prefers_what_tells_the_springs_apart():
    """A gap between springs grows with amplitude: from higher up a test decides that the same again does not."""
    noisy = dataclasses.replace(PRESENT, noise=0.08 * AMPLITUDE)
    few = Affordable(smallest=0.5 * AMPLITUDE, records=2, duration=PRESENT.duration)
    plan = plan_tests(pb.Oscillator(MASS), [CUBIC, NOTHING], noisy, affordable=few)
    best = plan.best[0]
    assert best.probability > plan.repeat.probability + 0.1
    assert best.design.release == pytest.approx(1.5 * AMPLITUDE)
    assert all(item.probability <= plan.best[0].probability + 0.03 for item in plan.best)
    assert plan.contenders == (CUBIC, NOTHING)
    assert all(item.design.release <= 1.501 * AMPLITUDE and item.design.records <= 2 for item in plan.best)


def test_a_structure_whose_other_springs_outweigh_a_negative_one_is_planned_for():
    """Stops without a gap take the place of the linear spring: of a negative stiffness the frequency was no number."""
    outweighed = {**OWN, "linear_stiffness": -0.5 * STIFFNESS, "contact_stiffness": 1.5 * STIFFNESS, "gap": 0.0}
    freeplay = Contender(("freeplay",), 0.7, outweighed)
    weaker = dataclasses.replace(CUBIC, probability=0.3)
    models = [pb.Oscillator(MASS, list(item.effects)) for item in (freeplay, weaker)]
    found = planning._angular_frequency(models, [freeplay, weaker], AMPLITUDE)
    assert found == pytest.approx(OMEGA, rel=1e-3)
    assert planning._angular_frequency(models[::-1], [CUBIC, NOTHING], AMPLITUDE) == pytest.approx(OMEGA, rel=3e-3)
    plan = plan_tests(pb.Oscillator(MASS), [freeplay, weaker], PRESENT, affordable=Affordable(records=2))
    assert 0.0 <= plan.repeat.probability <= 1.0


def test_a_larger_set_that_is_absent_is_not_told_apart_by_more_data():
    """Cubic stiffness of exactly zero in the larger set: whatever is measured, both sets predict it."""
    larger = Contender(("cubic_stiffness",), 0.5, {**OWN, "cubic_stiffness": 0.0})
    plan = plan_tests(
        pb.Oscillator(MASS), [dataclasses.replace(NOTHING, probability=0.5, parameters=OWN), larger], PRESENT
    )
    assert plan.repeat.probability < 0.02 and all(item.probability < 0.02 for item in plan.best)
    said = sentences(plan, PRESENT, "m")
    assert "less than 2 %" in said[0]


def test_limits_are_kept_and_refused_where_they_allow_nothing():
    designs = Affordable(0.002, 0.012, 4, 6.0, 1e-6, (0.3,)).designs(PRESENT)
    assert designs[0] == PRESENT
    assert {item.noise for item in designs} == {PRESENT.noise, 1e-6} and {item.added_mass for item in designs} == {
        0.0,
        0.3,
    }
    assert max(item.records for item in designs) == 4 and max(item.duration for item in designs) == 6.0
    assert min(item.release for item in designs) == 0.002 and max(item.release for item in designs) == 0.012
    assert len(set(designs)) == len(designs)
    for limits, sentence in (
        (Affordable(smallest=0.02, largest=0.01), "is above"),
        (Affordable(records=0), "at least 1"),
        (Affordable(added_masses=(-1.0,)), "above zero"),
        (Affordable(noise=-1.0), "noise"),
    ):
        with pytest.raises(pb.InputError, match=sentence):
            limits.designs(PRESENT)
    with pytest.raises(pb.InputError, match="at least two sets"):
        plan_tests(pb.Oscillator(MASS), [CUBIC], PRESENT)


def promised():
    near = PlannedTest(dataclasses.replace(PRESENT, release=1.5 * AMPLITUDE), 0.91, (0.95, 0.85), 8.0)
    heavy = PlannedTest(dataclasses.replace(PRESENT, noise=0.25 * PRESENT.noise, added_mass=0.4), 0.8, (0.9, 0.65), 8.0)
    return Plan((near, heavy), PlannedTest(PRESENT, 0.2, (0.3, 0.05), 8.0), (CUBIC, NOTHING), 14)


def test_a_plan_in_words():
    said = sentences(promised(), PRESENT, "m")
    assert said[0] == (
        "how probably one of cubic stiffness and no missing effect is left after 2 ring-downs from 15 mm (1.5 times "
        "the present release), 4 s each: 91 % (8 s of recording); after the same test again: 20 %."
    )
    assert "4 times less noise, with 0.4 kg added" in said[1]
    nothing = dataclasses.replace(promised(), best=())
    assert "none of 14 tests" in sentences(nothing, PRESENT, "m")[0]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """An ambiguous result on records, as a study writes it."""
    study = dataclasses.replace(make_study("ambiguous"), present=PRESENT, contenders=(CUBIC, NOTHING), plan=promised())
    place = tmp_path_factory.mktemp("written") / "diagnosis"
    write_study(study, place)
    return (place / "result.json").read_text()


@pytest.fixture
def folder(written, tmp_path):
    """A folder of its own with that result."""
    (tmp_path / "diagnosis").mkdir()
    (tmp_path / "diagnosis" / "result.json").write_text(written)
    return tmp_path / "diagnosis"


@pytest.mark.parametrize("verdict", ["ambiguous", "found"])  # of the second a mechanism, its law open
def test_the_command_reads_a_folder_and_writes_what_it_says(verdict, folder, tmp_path, capsys):
    result = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps(result | {"verdict": verdict}))
    assert result["contenders"][0]["parameters"]["cubic_stiffness"] == WEAK
    assert result["plan"]["best"][0]["design"]["release"] == pytest.approx(1.5 * AMPLITUDE)
    target = tmp_path / "plan.json"
    with patch.object(planning, "plan_tests", return_value=promised()) as called:
        assert main(["plan", str(folder), "--up-to", "0.02", "--most-records", "3", "--out", str(target)]) == 0
    (base, contenders, present), given = called.call_args
    assert base.mass == result["mass"] and tuple(contenders) == (CUBIC, NOTHING) and present == PRESENT
    assert given["affordable"] == Affordable(largest=0.02, records=3)
    shown = capsys.readouterr().out
    assert "91 %" in shown and "the same again" in shown and "A: cubic stiffness" in shown and "if B" in shown
    assert json.loads(target.read_text())["repeat"]["probability"] == 0.2
    assert main(["plan", str(folder), "--out", str(target)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"verdict": "found", "ambiguous_sets": []}, "no sets left to tell apart"),
        ({"verdict": "found", "named_level": "mechanism", "ambiguous_sets": []}, "none is exact"),
        ({"verdict": "unexplained", "named_level": None, "ambiguous_sets": []}, "`What to do next` in report.html"),
        ({"present": None}, "backbones alone"),
        ({"contenders": []}, "fewer than two sets"),
        ({"contenders": [{"effects": ["cubic_stiffness"]}, {}]}, "not as `diagnose` writes them"),
        ({"present": {"release": "far"}}, "not as `diagnose` writes them"),
    ],
)
def test_a_folder_that_cannot_be_planned_from_is_refused_in_a_sentence(folder, capsys, change, sentence):
    path = folder / "result.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert main(["plan", str(folder)]) == 2
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1


def test_a_folder_of_something_else_is_refused(tmp_path, capsys):
    assert main(["plan", str(tmp_path)]) == 2
    assert "not a result of" in capsys.readouterr().err
