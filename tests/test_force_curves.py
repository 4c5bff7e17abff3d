"""What no law explains as force curves: against laws that SciPy integrated, and against nothing, drift and memory."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from pymc_backbone import InputError, find_missing_effect
from pymc_backbone.discrepancy import workflow
from pymc_backbone.discrepancy.checks.rivals import drift_fit
from pymc_backbone.discrepancy.deciding.decision import Decision
from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import State, start_state
from pymc_backbone.discrepancy.force_curves import curve_fit, curve_laws, families, force_curve
from pymc_backbone.discrepancy.force_curves.curve_bands import bands_of, simultaneous
from pymc_backbone.discrepancy.force_curves.curve_fit import CurveFit, fit_curves
from pymc_backbone.discrepancy.force_curves.curve_known import Known
from pymc_backbone.discrepancy.force_curves.curve_laws import with_laws
from pymc_backbone.discrepancy.force_curves.curve_words import Judgement, sentence
from pymc_backbone.discrepancy.force_curves.families import FAMILIES, Shape, _curve, judged, places, proposals
from pymc_backbone.discrepancy.force_curves.force_curve import fit_remainder, force_curves
from pymc_backbone.discrepancy.force_curves.tabulated import DAMPING, NODES, STIFFNESS, tabulate
from pymc_backbone.discrepancy.results.entries import MissingMechanism
from pymc_backbone.discrepancy.results.verdict import NamedLevel, Verdict
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.reporting.curve_plots import plot_force
from pymc_backbone.reporting.portable import plain
from pymc_backbone.reporting.report import report_html
from pymc_backbone.reporting.study_files import force_curve_entries, write_study
from pymc_backbone.reporting.study_plots import study_figures

from .discrepancy_cases import (
    AFTER_FIRST_SWING,
    AMPLITUDE,
    FREQUENCY,
    MASS,
    OMEGA,
    RELEASE_TIME,
    TIME,
    batch_of,
    batch_of_conditioned,
    drifting_records,
    free_decay,
    noisy,
)
from .discrepancy_cases import DAMPING as VISCOUS
from .discrepancy_cases import STIFFNESS as SPRING
from .study_cases import make_study

ELASTIC = SPRING * AMPLITUDE


def conservative(x):
    """A spring that no effect of the library is: an odd and an even part of broken powers."""
    u = np.asarray(x) / AMPLITUDE
    return ELASTIC * (0.1 * np.sign(u) * np.abs(u) ** 2.6 + 0.03 * np.abs(u) ** 3.4)


def dissipative(v):
    u = np.asarray(v) / (OMEGA * AMPLITUDE)
    return 0.008 * ELASTIC * np.sign(u) * np.abs(u) ** 1.6


def records_of(rng, spring, damper, specimens=3, decibels=55.0):
    records = []
    for r in range(specimens):
        k, c = SPRING * (1.0 + 0.01 * rng.standard_normal()), VISCOUS * (1.0 + 0.03 * rng.standard_normal())

        def force(x, v, direction, k=k, c=c):
            return k * x + c * v + float(spring(x)) + float(damper(v))

        exact = free_decay(force, AMPLITUDE * (1.0 - 0.2 * r), TIME - RELEASE_TIME)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, exact, decibels))
    return records


def nothing(_):
    return 0.0


def base_fit(batch):
    """The linear model, fitted to the samples from where the records say."""
    layout = make_layout(Oscillator(MASS), batch.amplitude, batch.angular_frequency)
    return fit(layout, batch.waveform, start_state(layout, np.zeros(0), batch.own), nuisances=batch.nuisances)


@pytest.fixture(autouse=True, scope="module")
def on_one_core():
    """The matrices are small: several threads of linear algebra would wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def outside():
    batch = batch_of(records_of(np.random.default_rng(5), conservative, dissipative), start=AFTER_FIRST_SWING)
    return batch, fit_remainder(batch, Oscillator(MASS))


def test_bands_hold_the_true_forces(outside):
    batch, found = outside
    bands = bands_of(batch, found, 1)
    inner = np.linspace(0.0, found.tabulated.reach, 301)
    odd = 0.5 * (conservative(inner) - conservative(-inner))
    line = float(inner @ odd) / float(inner @ inner)
    x, v = bands.conservative.at, bands.damping.at
    truth = conservative(x) - line * x
    # what is visited is the release of the first specimen, or a little less where its record begins
    assert 0.9 * AMPLITUDE < -x[0] < 1.1 * AMPLITUDE and x[-1] < 1.1 * AMPLITUDE
    assert np.all((bands.conservative.low <= truth) & (truth <= bands.conservative.high))
    assert np.abs(bands.conservative.force - truth).max() < 0.05 * np.abs(truth).max()
    # negative control: the same curve with the sides exchanged is far outside
    assert not np.all((bands.conservative.low <= truth[::-1]) & (truth[::-1] <= bands.conservative.high))
    # the mean specimen's own damper is known to the scatter that was drawn: compared beyond a line
    shape, force = dissipative(v), bands.damping.force
    beyond = (force - v * float(v @ force) / float(v @ v)) - (shape - v * float(v @ shape) / float(v @ v))
    assert np.abs(beyond).max() < 0.1 * np.abs(shape).max()
    assert np.all(bands.damping_even.low <= 1e-12) and np.all(bands.damping_even.high >= -1e-12)


def test_a_curve_that_follows_a_law_is_nearer_to_the_truth_and_better_known(outside):
    batch, found = outside
    told, shapes = judged(found)
    alone = bands_of(batch, found, 1)
    lawful = bands_of(batch, with_laws(found, told, shapes, alone), 1)
    v = lawful.damping.at
    shape = dissipative(v)

    def beyond(force):  # the mean specimen's own damper is known to the scatter that was drawn
        return (force - v * float(v @ force) / float(v @ v)) - (shape - v * float(v @ shape) / float(v @ v))

    near, far = np.abs(beyond(lawful.damping.force)).max(), np.abs(beyond(alone.damping.force)).max()
    # a power law with exponent 1.6 is one of the families, told with near certainty
    assert near < 0.02 * np.abs(shape).max() and near < far
    assert np.median(lawful.damping.high - lawful.damping.low) < 0.7 * np.median(alone.damping.high - alone.damping.low)
    bound = 0.5 * (lawful.damping.high - lawful.damping.low)
    assert np.all(np.abs(beyond(lawful.damping.force)) <= bound + 1e-9 * np.abs(shape).max())
    # the spring is none of them: its curve stays as it is
    assert next(item for item in told if item.curve == "conservative").family == "none"
    assert np.abs(lawful.conservative.force - alone.conservative.force).max() < 1e-3 * ELASTIC


def test_a_law_that_is_not_the_right_one_is_seen_to_be_wrong(outside, monkeypatch):
    """Were a saturating damper certain, its band would not hold the truth; but it leaves that of the nodes."""
    batch, found = outside
    wrong = np.tanh(np.concatenate([-places(), places()]) / 0.05)
    effect = _curve(found, DAMPING)
    column = effect.shape(wrong)
    forced = Shape(1.0, column, np.array([0.1 * ELASTIC]), effect.beyond(wrong), np.zeros(column.shape[0]))
    alone, laws = bands_of(batch, found, 1), {STIFFNESS: (), DAMPING: (forced,)}
    kept = bands_of(batch, with_laws(found, (), laws, alone), 1)
    assert np.array_equal(kept.damping.force, alone.damping.force) and np.array_equal(
        kept.damping.low, alone.damping.low
    )
    # negative control: not held to that band, the law is taken for the curve
    monkeypatch.setattr(curve_laws, "_is_within", lambda band, moves: True)
    bands = bands_of(batch, with_laws(found, (), laws, alone), 1)
    v = bands.damping.at
    truth = dissipative(v) + VISCOUS * v
    assert not np.all((bands.damping.low <= truth) & (truth <= bands.damping.high))


def test_a_law_that_is_right_is_not_held_to_be_wrong(outside):
    """Negative control: it stays in the band of the nodes, and the curve is its own."""
    batch, found = outside
    u = np.concatenate([-places(), places()])
    effect = _curve(found, DAMPING)
    right = np.sign(u) * np.abs(u) ** 1.6
    column = effect.shape(right[:, None])
    shape = Shape(1.0, column, np.array([0.1 * ELASTIC]), effect.beyond(right), np.zeros(column.shape[0]))
    alone = bands_of(batch, found, 1)
    kept = bands_of(batch, with_laws(found, (), {STIFFNESS: (), DAMPING: (shape,)}, alone), 1)
    v, truth = kept.damping.at, dissipative(kept.damping.at)

    def apart(force):  # the mean specimen's own damper is known to the scatter that was drawn
        return np.abs(
            (force - v * float(v @ force) / float(v @ v)) - (truth - v * float(v @ truth) / float(v @ v))
        ).max()

    assert apart(kept.damping.force) < 0.8 * apart(alone.damping.force)
    assert np.all((alone.damping.low <= kept.damping.force) & (kept.damping.force <= alone.damping.high))


def test_what_records_say_of_a_curve_is_that_of_the_minimum_also_beside_it():
    """A fit rests within a share of an error; of a part that went to nothing, its prior would make that a force."""
    batch = batch_of(records_of(np.random.default_rng(8), nothing, nothing))
    found = fit_remainder(batch, Oscillator(MASS))
    known = found.known[DAMPING]
    values, vectors = np.linalg.eigh(known.prior)
    eta = found.fit.state.eta.copy()
    eta[found.tabulated.places(DAMPING)] += known.frame @ vectors[:, -1] * np.sqrt(0.05 / values[-1])
    near, at = (
        fit_curves(
            found.tabulated, batch.waveform, dataclasses.replace(found.fit.state, eta=start),
            nuisances=(0, 1, 2, 3, 4), precisions=found.precisions, is_learning=False, iterations=most,
        )
        for start, most in ((eta, 0), (found.fit.state.eta, 30))
    )  # fmt: skip
    assert near is not None and at is not None
    for one, other in zip(proposals(near), proposals(at), strict=True):
        assert (one.curve, one.family) == (other.curve, other.family)
        # what is left is that forces are no linear function of nodes
        assert one.probability == pytest.approx(other.probability, abs=0.01)
    # negative control: with the slope at the point left out, the prior's pull is taken for the records'
    here = near.known[DAMPING]
    free = here.frame.T @ near.fit.state.eta[near.tabulated.places(DAMPING)]
    without = dataclasses.replace(here, pull=(here.precision + here.prior) @ free)
    told, wrong = (
        next(item for item in proposals(each) if item.curve == "damping")
        for each in (near, dataclasses.replace(near, known={**near.known, DAMPING: without}))
    )
    assert told.family == "nothing" and wrong.family != "nothing" and wrong.probability > 0.99


def test_what_is_no_curve_goes_to_zero_and_keeps_its_errors():
    batch = batch_of(records_of(np.random.default_rng(8), nothing, nothing))
    found = fit_remainder(batch, Oscillator(MASS))
    told, shapes = judged(found)
    alone = bands_of(batch, found, 1)
    lawful = bands_of(batch, with_laws(found, told, shapes, alone), 1)
    for one, other in ((alone.conservative, lawful.conservative), (alone.damping_even, lawful.damping_even)):
        assert np.abs(other.force).max() < 0.9 * np.abs(one.force).max() + 1e-9 * ELASTIC, other.force
        assert np.all(other.standard_error >= 0.95 * one.standard_error - 1e-9 * ELASTIC)


def test_what_does_not_arrive_is_approached_slowly(outside, monkeypatch):
    batch, _ = outside
    walked, real = [], force_curve._approached

    def approached(*given, is_patient=False):
        walked.append(is_patient)
        return real(*given, is_patient=True) if is_patient else None

    monkeypatch.setattr(force_curve, "_approached", approached)
    found = fit_remainder(batch, Oscillator(MASS))
    count = sum(term.size for term in batch.waveform)
    assert walked == [False, True] and 0.8 < found.fit.chi_square.sum() / count < 1.2
    # negative control: what leaves noise is not approached again
    walked.clear()
    monkeypatch.setattr(force_curve, "_approached", lambda *given: walked.append(False) or real(*given))
    fit_remainder(batch, Oscillator(MASS))
    assert walked == [False]


def test_curves_leave_noise_and_predict_a_specimen_left_out(outside):
    batch, found = outside
    count = sum(term.size for term in batch.waveform)
    assert 0.8 < found.fit.chi_square.sum() / count < 1.2
    curves = force_curves(batch, base_fit(batch), (), None, 1e3, 2, 1)
    assert curves.is_possible and curves.held_out_after < 2.0 and curves.p_value > 1e-3
    assert set(curves.parameters) == set(curves.oscillator.parameter_names)
    entries = json.loads(json.dumps(plain(force_curve_entries(curves))))
    assert entries["held_out"]["before"] == 1e3 and len(entries["curves"]) == 6
    assert entries["range"]["displacement"] == [curves.bands.conservative.at[0], curves.bands.conservative.at[-1]]


def test_an_even_part_that_the_band_keeps_out_is_held_and_said():
    """Its second harmonic and its offset are all that measures it; a band of up to 2.6 times the frequency has one."""
    records = records_of(np.random.default_rng(5), conservative, dissipative, specimens=2)
    narrow, wide = (
        batch_of_conditioned([condition(record, band=(0.4 * FREQUENCY, highest * FREQUENCY)) for record in records])
        for highest in (1.6, 2.6)
    )
    curves, open_curves = (force_curves(each, base_fit(each), (), None, 1.0, 0, 1) for each in (narrow, wide))
    for band in (curves.bands.conservative_even, curves.bands.damping_even):
        assert not np.any(np.stack([band.force, band.low, band.high]))
    odd, at = curves.bands.conservative_odd, curves.bands.conservative_odd.at
    truth = 0.5 * (conservative(at) - conservative(-at))
    line = float(at @ (truth - odd.force)) / float(at @ at)
    assert np.abs(odd.force + line * at - truth).max() < 0.05 * np.abs(truth).max()
    assert np.all(odd.high[1:] > odd.low[1:])
    even = open_curves.bands.conservative_even
    assert np.all(even.high[1:] > even.low[1:])
    said = "keeps the second harmonic and the offset out"
    assert said in curves.sentence and said not in open_curves.sentence
    assert (curves.has_even, open_curves.has_even) == (False, True)
    titles = []
    for which in ("conservative", "damping"):
        figure = plot_force(curves, which)
        figure.canvas.draw()
        titles += [axis._left_title for axis in figure.axes]
        assert all(title.get_window_extent().x1 <= figure.bbox.x1 for title in titles)
    assert sum("not measured" in title.get_text() for title in titles) == 2


def test_nothing_is_seen_where_nothing_is_there():
    batch = batch_of(records_of(np.random.default_rng(8), nothing, nothing))
    curves = force_curves(batch, base_fit(batch), (), None, 1.0, 0, 1)
    assert curves.is_possible
    best = {item.curve: item for item in reversed(curves.proposals)}
    for item in best.values():
        assert item.family == "nothing" or item.probability < 0.7, item
    bands = curves.bands
    for band in (bands.conservative, bands.conservative_odd, bands.conservative_even, bands.damping_even):
        assert np.all(band.low <= 1e-9 * ELASTIC) and np.all(band.high >= -1e-9 * ELASTIC)


def test_what_rises_with_time_in_one_record_and_falls_in_another_is_no_force_curve():
    rising, falling = (drifting_records(np.random.default_rng(3), change) for change in (0.02, -0.02))
    batch = batch_of([rising[0], falling[1]])
    curves = force_curves(batch, base_fit(batch), (), None, 1.0, 0, 1)
    assert not curves.is_possible and curves.p_value < 1e-3
    assert (
        "A smooth force of displacement and speed is not" in curves.sentence
        and "drift with time explains more" in curves.sentence
    )


def test_curves_that_are_far_from_noise_are_not_followed_to_the_last(outside, monkeypatch):
    """Where no curve follows the records, the last steps change next to nothing; where one does, all are taken."""
    rising, falling = (drifting_records(np.random.default_rng(3), change) for change in (0.05, -0.05))
    far = batch_of([rising[0], falling[1]])
    asked, real = [], curve_fit.evaluated
    monkeypatch.setattr(curve_fit, "evaluated", lambda *given: asked.append(None) or real(*given))

    def steps(batch, found, share):
        """How many steps a fit takes from a tenth stiffer nodes on, and what it leaves."""
        state = State(share * found.fit.state.eta, found.fit.state.own)
        asked.clear()
        again = fit_curves(
            found.tabulated, batch.waveform, state, nuisances=range(5), precisions=found.precisions, is_learning=False,
            iterations=60,
        )  # fmt: skip
        return len(asked), float(again.fit.chi_square.sum()) / sum(term.size for term in batch.waveform)

    near, there = outside
    left = fit_remainder(far, Oscillator(MASS))
    soon, whole = [], []
    for counts, weight in ((soon, curve_fit._FAR), (whole, 0.0)):
        monkeypatch.setattr(curve_fit, "_FAR", weight)
        counts += [steps(far, left, 1.1), steps(near, there, 1.1)]
    assert whole[0][1] > 10.0 and soon[0][0] < whole[0][0] and soon[0][1] < 1.03 * whole[0][1], (soon, whole)
    assert soon[1] == whole[1] and whole[1][1] < 1.2


def test_a_drift_that_a_curve_imitates_is_told():
    """Decays that are alike turn time into amplitude: both explanations are named."""
    batch = batch_of(drifting_records(np.random.default_rng(3), 0.02))
    base = base_fit(batch)
    curves = force_curves(batch, base, (), drift_fit(batch, base.layout, base.state), 1.0, 0, 1)
    assert curves.is_possible and "drift with time explains them as well" in curves.sentence


def test_a_force_that_no_drift_imitates_is_not_called_one(outside):
    batch, _ = outside
    base = base_fit(batch)
    assert "drift" not in force_curves(batch, base, (), drift_fit(batch, base.layout, base.state), 1.0, 0, 1).sentence


def test_hysteresis_is_said_where_a_law_with_memory_leaves_less(outside):
    said = sentence(Judgement(False, 0.6, 1e-9, "hysteresis"), (), "m")
    assert "A smooth force of displacement and speed is not" in said and "remembers" in said and "60 %" in said


def test_what_no_smooth_force_explains_is_said_with_what_the_best_leaves():
    said = sentence(Judgement(False, 0.91, 7e-35, ""), (), "m", beside=("freeplay",))
    assert said == (
        "No smooth force of displacement and speed was found that is what the named effects leave: the best of them "
        "still leave 91 % of that rest (p = 7e-35), and that is more than noise."
    )


@pytest.mark.parametrize("left", [3.96, float("nan")])
def test_a_fit_that_is_lost_leaves_all_of_the_gap(left):
    said = sentence(Judgement(False, left, 1e-9, "hysteresis"), (), "m", beside=("freeplay",))
    assert "the best of them leave all of that rest (p = 1e-09)" in said


def test_forces_that_leave_most_of_the_gap_to_what_is_beside_the_motion_explain_nothing():
    said = sentence(Judgement(True, 0.97, 0.2, ""), (), "m")
    assert said.startswith("97 % of the gap is no force of displacement and speed: it lies beside the motion")


def test_the_likeliest_number_lies_in_its_own_interval():
    """The records say ever more towards the end of what is looked at: the interval goes there."""
    family = SimpleNamespace(name="saturates", number="place")
    numbers, none = np.linspace(0.1, 1.0, 40), []
    weighed = families._Weighed(family, None, numbers, numbers, 1.0 * numbers, [np.ones(1)] * 40, none, 0.0)
    told = weighed.told(STIFFNESS, 0.9, 2.0)
    assert told.low < told.value == told.high == 2.0


def curve_like(found: CurveFit, effect: str, law, precision: float) -> CurveFit:
    """A fit whose records say of one curve that it is this law, and of the other nothing."""
    tabulated, nodes = found.tabulated, NODES[effect]
    at = nodes[1:] if effect == STIFFNESS else nodes
    tiny = np.where(at == 0.0, 1e-12, at)
    odd, even = 0.5 * (law(tiny) - law(-tiny)), 0.5 * (law(tiny) + law(-tiny))
    values = np.concatenate([odd, even[at > 0.0]])
    frame = found.known[effect].frame
    line = np.concatenate([at, np.zeros(values.size - at.size)])
    over = tabulated.lines()[0 if effect == STIFFNESS else 1][tabulated.places(effect)]
    free = frame.T @ (values - line * float(over @ values) / float(over @ line))
    size = free.size
    prior = found.known[effect].prior
    follows, left = found.known[effect].follows, found.known[effect].left
    known = Known(frame, precision * np.eye(size), prior, precision * free, follows, left)
    other = DAMPING if effect == STIFFNESS else STIFFNESS
    blind = dataclasses.replace(found.known[other], precision=1e-12 * np.eye(found.known[other].pull.size))
    blind = dataclasses.replace(blind, pull=np.zeros(blind.pull.size))
    return dataclasses.replace(found, known={effect: known, other: blind})


LAWS = [
    (STIFFNESS, "power law", 3.4, lambda u: np.sign(u) * np.abs(u) ** 3.4),
    (STIFFNESS, "power law, even", 2.0, lambda u: -(u**2)),
    (STIFFNESS, "kink", 0.4, lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0)),
    (STIFFNESS, "kink on one side", 0.6, lambda u: -np.maximum(-u - 0.6, 0.0)),
    (STIFFNESS, "pole on one side", 1.6, lambda u: (1.6 - u) ** -2.0 - 1.6**-2.0),
    (STIFFNESS, "saturation", 0.2, lambda u: np.tanh(u / 0.2)),
    (STIFFNESS, "none", None, lambda u: np.sin(7.0 * u) + 0.3 * np.cos(9.0 * u) - 0.3),
    (DAMPING, "power law", 0.5, lambda u: np.sign(u) * np.sqrt(np.abs(u))),
    (DAMPING, "power law on one side", 2.0, lambda u: np.maximum(u, 0.0) ** 2),
    (DAMPING, "saturation", 0.1, lambda u: np.tanh(u / 0.1)),
    (DAMPING, "minimum of damping", 0.15, lambda u: np.sign(u) * (1.0 + 0.8 * np.exp(-np.abs(u) / 0.15))),
    (DAMPING, "minimum of damping", 0.3, lambda u: -u / (1.0 + (u / 0.3) ** 2)),
    (DAMPING, "kink", 0.35, lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.35, 0.0)),
    (DAMPING, "kink", 0.3, lambda u: -np.sign(u) * np.maximum(np.abs(u) - 0.3, 0.0)),
    (DAMPING, "kink on one side", 0.5, lambda u: -np.maximum(u - 0.5, 0.0)),
    (DAMPING, "largest at a speed", 0.4, lambda u: u / (1.0 + (u / 0.4) ** 2)),
]


@pytest.mark.parametrize(("effect", "family", "number", "law"), LAWS, ids=lambda value: str(value)[:24])
def test_each_family_is_proposed_for_a_law_of_it(outside, effect, family, number, law):
    _, found = outside
    told = proposals(curve_like(found, effect, law, 1e8 / ELASTIC**2))
    mine = [item for item in told if item.curve == ("conservative" if effect == STIFFNESS else "damping")]
    assert mine[0].family == family and mine[0].probability > 0.9
    assert sum(item.probability for item in mine) == pytest.approx(1.0)
    if number is not None:
        reach = found.tabulated.ranges()[0 if effect == STIFFNESS else 1] if mine[0].number != "exponent" else 1.0
        # the grid of numbers is as fine as 1/160 of its range
        assert mine[0].value == pytest.approx(number * reach, rel=0.05)
        assert mine[0].low <= mine[0].value * 1.02 and mine[0].high >= mine[0].value * 0.98
    blind = [item for item in told if item not in mine]
    assert blind[0].family == "nothing"


@pytest.mark.parametrize("share", [0.0, 1.0, 2.0, 3.0])
def test_a_root_is_one_whichever_spline_stands_for_it(outside, monkeypatch, share):
    """From the spline nearest to the root to the one through it, and beyond: the records may take any."""
    _, found = outside

    def root(u):
        return np.sign(u) * np.sqrt(np.abs(u))

    exact = curve_like(found, DAMPING, root, 1e11 / ELASTIC**2)
    curve, known = _curve(found, DAMPING), exact.known[DAMPING]
    near = curve.shape(root(np.concatenate([-places(), places()])))[:, 0]
    through = curve.through(lambda u, q: np.sign(u) * np.abs(u) ** q, 0.5)[:, 0]
    assert known.pull == pytest.approx(known.precision @ through)
    between = dataclasses.replace(known, pull=known.precision @ (near + share * (through - near)))
    given = dataclasses.replace(exact, known={**exact.known, DAMPING: between})

    def best():
        return next(item for item in proposals(given) if item.curve == "damping")

    assert best().family == "power law" and best().probability > 0.9 and best().value == pytest.approx(0.5, abs=0.04)
    # negative control: held to the nearest one, what lies beyond the one through the law follows none
    monkeypatch.setattr(families, "spared", lambda known, ambiguity: (known, 0.0))
    assert (best().family == "power law") == (share <= 1.0)


def test_families_have_names_that_words_know():
    from pymc_backbone.discrepancy.force_curves.curve_words import WORDS

    assert {family.name for each in FAMILIES.values() for family in each} | {"none", "nothing"} == set(WORDS)


def test_simultaneous_factor_is_that_of_independent_points_or_of_one(rng):
    points = 20
    exact = norm.ppf(0.5 * (1.0 + 0.95 ** (1.0 / points)))
    # 4000 draws know the quantile to 0.03
    assert simultaneous(np.diag(rng.uniform(0.1, 9.0, points)), rng) == pytest.approx(exact, abs=0.1)
    assert simultaneous(np.outer(np.arange(1.0, 5.0), np.arange(1.0, 5.0)), rng) == pytest.approx(1.96, abs=0.08)


def test_a_line_is_no_roughness_and_belongs_to_the_specimens(outside):
    batch, _ = outside
    for is_sharp in (False, True):
        tabulated = tabulate(Oscillator(MASS), batch, 0.5 * AMPLITUDE, is_sharp=is_sharp)
        for part in tabulated.parts:
            nodes = NODES[part.effect]
            line, square = nodes[nodes.size - part.places.size :], nodes[nodes.size - part.places.size :] ** 2
            assert square @ part.roughness @ square > 0.1
            if part.side == "odd":
                assert line @ part.roughness @ line < 1e-9 * (square @ part.roughness @ square)
        basis, _ = tabulated.free_basis()
        assert np.abs(tabulated.lines() @ basis).max() < 1e-12 * np.abs(tabulated.lines()).max()


def test_a_curve_is_no_candidate():
    records = records_of(np.random.default_rng(1), nothing, nothing, specimens=1)
    with pytest.raises(InputError, match="'tabulated_stiffness', a curve that fits any force"):
        find_missing_effect(Oscillator(MASS), records, candidates=["tabulated_stiffness"], quick=True)


def test_report_and_files_hold_the_curves(outside, tmp_path):
    batch, _ = outside
    curves = force_curves(batch, base_fit(batch), (), None, 50.0, 2, 1)
    study = dataclasses.replace(make_study("unexplained"), force_curves=curves)
    figures = study_figures(study)
    assert {"force_conservative", "force_damping"} <= set(figures)
    page = report_html(study, figures, version="1")
    assert "What is left, as a force" in page and "model_with_curves.py" in page
    assert "What is left, as a force" not in report_html(make_study("unexplained"), {}, version="1")
    files = write_study(study, tmp_path / "out")
    assert "model_with_curves.py" in files and "figures/force_damping.png" in files
    text = (tmp_path / "out" / "model_with_curves.py").read_text()
    compile(text, "model_with_curves.py", "exec")
    assert all(f'"{name}"' in text for name in curves.oscillator.parameter_names)


OPEN = Verdict.AMBIGUOUS
DRAG = MissingMechanism("drag", 0.99, 0.6, (), ())
SPRING_TOO = MissingMechanism("spring", 0.6, 0.3, (), ())


@pytest.mark.parametrize(
    ("verdict", "level", "is_approximate", "is_moved_on", "best", "mechanisms", "beside"),
    [
        (Verdict.UNEXPLAINED, None, True, False, ("cubic_stiffness",), (), "base"),
        (Verdict.UNEXPLAINED, None, True, True, ("cubic_stiffness",), (), None),
        (Verdict.FOUND, NamedLevel.MECHANISM, True, False, ("quadratic_damping",), (DRAG,), "model"),
        (Verdict.FOUND, NamedLevel.LAW, False, False, ("quadratic_damping",), (DRAG,), None),
        (OPEN, None, False, False, ("quadratic_damping",), (DRAG,), None),
        (OPEN, None, True, False, ("quadratic_damping",), (DRAG, SPRING_TOO), "model"),
        (OPEN, None, True, False, ("cubic_stiffness", "quadratic_damping"), (DRAG, SPRING_TOO), "base"),
        (OPEN, None, True, False, ("cubic_stiffness",), (SPRING_TOO,), "base"),
        (Verdict.ADEQUATE, None, False, False, (), (), None),
    ],
)
def test_curves_stand_beside_what_is_certain(
    monkeypatch, verdict, level, is_approximate, is_moved_on, best, mechanisms, beside
):
    kinds = {"quadratic_damping": "drag", "cubic_stiffness": "spring"}
    decision = Decision(
        verdict, best, 0.9, 1.0, lack=None, probabilities={}, evidences={}, named_level=level, mechanisms=mechanisms,
        is_approximate=is_approximate, is_moved_on=is_moved_on,
    )  # fmt: skip
    outcome = SimpleNamespace(
        search=SimpleNamespace(fits={}, mechanism_of=kinds.get), decision=decision, drifting=None, base="base",
        model="model",
    )  # fmt: skip
    verification = SimpleNamespace(held_out_specimens=SimpleNamespace(before="base", after="model"))
    monkeypatch.setattr(workflow, "force_curves", lambda batch, start, rivals, drifting, gap, most, seed: (start, gap))
    drawn = workflow._curves(SimpleNamespace(batch=None), outcome, verification, 2, 1, False, lambda stage, share: None)
    assert drawn == (None if beside is None else (beside, beside))
