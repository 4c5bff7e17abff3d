"""A departure of the backbones: its evidence against one dense Gaussian, and what it says where the truth is known."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from pymc_backbone._common.checks import OBSERVABLES
from pymc_backbone.discrepancy.deciding import gaps, mechanisms
from pymc_backbone.discrepancy.deciding.decide import _explains_nothing
from pymc_backbone.discrepancy.deciding.inexact import (
    _without_idle,
    _without_those_that_explain_nothing,
    _without_what_idles,
    leaves_the_samples,
)
from pymc_backbone.discrepancy.deciding.mechanisms import Weighed, _log_size
from pymc_backbone.discrepancy.fitting import starts
from pymc_backbone.discrepancy.fitting.batch import Batch, batch_of_backbones
from pymc_backbone.discrepancy.fitting.data_term import LevelTerm
from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import start_state
from pymc_backbone.discrepancy.proposals import departure as module
from pymc_backbone.discrepancy.proposals.departing import DepartingSets
from pymc_backbone.discrepancy.proposals.departure import NOISES, OWN_SHARE, SCALES, SIZES, Choice
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.backbones import simulate_population
from pymc_backbone.simulation.decay import simulate_backbone

OMEGA, ZETA = 20.0, 0.01
LEVELS = np.geomspace(0.1, 1.0, 9)


def batch_of(curves, seed, noise=(1e-4, 1e-3), count=3):
    """Backbones of some specimens: frequency [Hz] and decrement as functions of amplitude, with noise."""
    rng = np.random.default_rng(seed)
    rows = np.array([(o, k) for o in (0, 1) for k in range(LEVELS.size)])
    error = np.repeat(noise, LEVELS.size)
    levels, own = [], []
    for _ in range(count):
        values = np.concatenate(curves(1.0 + 0.01 * rng.standard_normal())) + error * rng.standard_normal(error.size)
        levels.append(LevelTerm(LEVELS, values, rows, np.diag(1.0 / error)))
        omega = 2.0 * np.pi * float(np.median(values[:9]))
        own.append((omega**2, 2.0 * ZETA * omega, 0.0, 0.0, 0.0))
    names = tuple(f"s{r}" for r in range(count))
    return Batch(None, (), (), tuple(levels), (), (), names, np.array(own), 1.0, OMEGA)


def layout_of(batch, effects):
    return make_layout(Oscillator(1.0, list(effects)), batch.amplitude, batch.angular_frequency)


def lone(batch, effects):
    """Evidence of the linear oscillator with these effects, from the best of some rough starts."""
    layout = layout_of(batch, effects)
    typical = starts.typical(layout)
    etas = [np.where(layout.is_strength, scale * typical, typical) for scale in (0.02, 0.2, 1.0)]
    begun = [fit(layout, batch.levels, start_state(layout, eta, batch.own), nuisances=(0, 1)) for eta in etas]
    near = min((item for item in begun if item is not None), key=lambda item: item.cost)
    return DepartingSets(batch, 1.0).evidence(layout, [near.state])


def matern(scale):
    steps = np.abs(np.log10(LEVELS)[:, None] - np.log10(LEVELS)) * np.sqrt(5.0) / scale
    return (1.0 + steps + steps**2 / 3.0) * np.exp(-steps)


@pytest.mark.parametrize("count", [1, 3])
def test_evidence_is_that_of_one_dense_gaussian(count):
    """The base with a departure: noise, departure common and own, stiffness and damping, all in one covariance."""
    noise = (1e-4, 1e-3)
    batch = batch_of(lambda s: (3.2 * s + 0.02 * LEVELS**2, 0.06 + 0.01 * LEVELS), 1, noise, count)
    departures = DepartingSets(batch, 1.0)
    choice = Choice(1, (6, 5, 0), (3, 2, 2))
    point = departures._point(
        layout_of(batch, ()), start_state(layout_of(batch, ()), np.zeros(0), batch.own), choice, ""
    )
    n = 18 * count
    covariance = np.diag(np.tile(np.repeat(noise, 9), count) ** 2 * np.tile(np.repeat((NOISES[3], 1.0), 9), count) ** 2)
    residuals = np.zeros(n)
    for r, term in enumerate(batch.levels):
        vector = batch.own[r, :2]
        oscillator = Oscillator(1.0)
        values = dict(zip(oscillator.parameter_names, vector, strict=True))
        residuals[18 * r : 18 * (r + 1)] = (
            term.values - simulate_backbone(oscillator, values, LEVELS).values[:2].ravel()
        )
        slopes = np.zeros((18, 2))
        omega = np.sqrt(vector[0])
        slopes[:9, 0] = 1.0 / (4.0 * np.pi * omega)
        slopes[9:, 1] = np.pi / omega
        slopes[9:, 0] = -0.5 * np.pi * vector[1] / vector[0] / omega
        at = slice(18 * r, 18 * (r + 1))
        covariance[at, at] += slopes @ np.diag(vector**2) @ slopes.T
        for o in range(2):  # errors of a smooth curve that are smooth
            block = slice(18 * r + 9 * o, 18 * r + 9 * (o + 1))
            covariance[block, block] += (noise[o] * (NOISES[3], 1.0)[o]) ** 2 * matern(SCALES[1])
        for s in range(count):
            there = slice(18 * s, 18 * (s + 1))
            share = 1.0 if count == 1 else 1.0 + OWN_SHARE**2 * (r == s)
            for o in range(2):
                unit = SIZES[choice.sizes[o]] * departures.changes[o] * departures.units[o]
                block = matern(SCALES[1]) * np.outer(unit, unit) * share
                covariance[at, there][9 * o : 9 * (o + 1), 9 * o : 9 * (o + 1)] += block
    dense = -0.5 * residuals @ np.linalg.solve(covariance, residuals) - 0.5 * np.linalg.slogdet(covariance)[1]
    prior = sum(np.log(module.PRIOR_OF_SIZES[i] * departures.prior_of_noises[o, k])
                for o, (i, k) in enumerate(zip(choice.sizes, choice.noises, strict=True)))  # fmt: skip
    assert point.log_evidence - prior == pytest.approx(dense, abs=0.05)


def micro_slip(own):
    """Curves of an Iwan bed, and beside it a force of 5 % of what it does that no law has."""
    oscillator = Oscillator(1.0, ["iwan"])
    values = dict(zip(oscillator.parameter_names, (400.0 * own**2, 0.2, 40.0, 20.0, -0.5), strict=True))
    frequency, damping, _ = simulate_backbone(oscillator, values, LEVELS).values
    wave = 0.05 * np.sin(4.0 * np.log(LEVELS))
    share = wave * 2.0 * np.std(frequency) / frequency.mean()
    return frequency * (1.0 + 0.5 * share), damping - np.pi * share


def test_a_law_that_explains_both_curves_wins_although_it_is_not_exact():
    """Micro-slip against damping alone and the base: what it leaves is far beyond the noise, and counts once."""
    batch = batch_of(micro_slip, 2, noise=(1e-5, 1e-4))
    logs = {names: lone(batch, names) for names in [(), ("displacement_dependent_damping",), ("iwan",)]}
    iwan, damping, base = logs[("iwan",)], logs[("displacement_dependent_damping",)], logs[()]
    assert iwan.log_evidence > max(damping.log_evidence, base.log_evidence) + 3.0
    assert 0.0 < iwan.curves[0].std() < 0.5 * base.curves[0].std()
    # the rest is many standard errors at each level: by these alone the odds would be beyond all bounds
    assert 0.5 * (iwan.curves[0] ** 2).sum() / 1e-5**2 > 100.0
    assert iwan.log_evidence - base.log_evidence < 60.0


def cubic(own):
    omega = np.sqrt((2.0 * np.pi * 3.2 * own) ** 2 + 0.75 * 8.0 * LEVELS**2)
    return omega / (2.0 * np.pi), np.full(LEVELS.size, 0.06)


def test_where_the_law_is_exact_the_departure_is_next_to_nothing():
    batch = batch_of(cubic, 3)
    exact, base = lone(batch, ("cubic_stiffness",)), lone(batch, ())
    assert exact.log_evidence > base.log_evidence + 10.0
    assert exact.curves[0].std() < 0.02 * base.curves[0].std()
    # the gap of the base is the curve itself, its mean taken by the stiffness
    gap = cubic(1.0)[0]
    assert base.curves[0] - base.curves[0].mean() == pytest.approx(gap - gap.mean(), abs=0.02 * np.ptp(gap))


def test_departures_of_one_specimen_each_are_no_law():
    """A common curve is told from curves that each specimen has to itself."""
    rng = np.random.default_rng(5)

    def own(scale):
        first, second = 0.01 * rng.standard_normal(2)
        return 3.2 * scale * (1.0 + first * LEVELS), 0.03 + second * LEVELS

    for curves, is_law in ((micro_slip, True), (own, False)):
        data = batch_of(curves, 4)
        layout = layout_of(data, ())
        departures = DepartingSets(data, 1.0)
        found = departures.evidence(layout, [start_state(layout, np.zeros(0), data.own)])
        assert (departures.evidence_apart(found, layout) < 0.0) is is_law


def test_a_zero_that_is_off_is_no_asymmetry():
    """A mid-line that is off by so many metres falls with the amplitude; that of a two-sided spring rises."""
    base, found = (
        departure_with_offset(lambda level: 0.004 / level, names) for names in ((), ("quadratic_stiffness",))
    )
    assert base.log_evidence > found.log_evidence - 1.0
    base, found = (
        departure_with_offset(lambda level: -0.02 * level, names) for names in ((), ("quadratic_stiffness",))
    )
    assert found.log_evidence > base.log_evidence + 3.0


def departure_with_offset(offset, names):
    rng = np.random.default_rng(6)
    rows = np.array([(o, k) for o in (0, 1, 2) for k in range(LEVELS.size)])
    error = np.repeat((1e-3, 1e-3, 1e-4), LEVELS.size)
    curves = np.concatenate([np.full(9, 3.2), np.full(9, 0.06), offset(LEVELS)])
    term = LevelTerm(LEVELS, curves + error * rng.standard_normal(error.size), rows, np.diag(1.0 / error))
    omega = 2.0 * np.pi * 3.2
    own = np.array([(omega**2, 2.0 * ZETA * omega, 0.0, 0.0, 0.0)])
    return lone(Batch(None, (), (), (term,), (), (), ("s0",), own, 1.0, omega), names)


def test_smoothness_and_sizes_cover_what_is_possible():
    assert SIZES[0] == 0.0 and module.PRIOR_OF_SIZES.sum() == pytest.approx(1.0)
    assert module.PRIOR_OF_NOISES.sum() == pytest.approx(1.0) and NOISES[2] == 1.0
    assert module.PRIOR_OF_SIZES[SIZES > 0.3].sum() < 0.05 and len(SCALES) == 2


def test_forces_far_larger_than_what_is_missing_are_rarer_in_proportion():
    """Of a gap of a few per mille: a spring as large as the elastic one is too large for it, one of a per mille not."""
    k, c = OMEGA**2, 2.0 * ZETA * OMEGA

    def gentle(scale):
        frequency = OMEGA * scale / (2.0 * np.pi) * (1.0 + 0.003 * LEVELS)
        return frequency, 2.0 * np.pi * ZETA * np.ones(LEVELS.size)

    batch = batch_of(gentle, 11)
    departures = DepartingSets(batch, 1.0)
    base = lone(batch, ())
    search = SimpleNamespace(batch=batch, base=Oscillator(1.0, ()), layout=lambda names: layout_of(batch, names))

    def size(**strengths):
        names = tuple(strengths)
        state = start_state(layout_of(batch, names), np.array([*strengths.values()]), np.array([[k, c, 0.0, 0.0, 0.0]]))
        return _log_size(search, names, replace(base, state=state), departures, base)

    assert size(cubic_stiffness=0.005 * k) == 0.0
    large = size(bilinear_stiffness=k)
    gap = 2.0 * 0.003 * float(np.std(LEVELS))  # of the elastic force, what a uniform change of stiffness leaves
    assert large == pytest.approx(-np.log(1.0 / (5.0 * gap)), abs=0.3)
    assert size(bilinear_stiffness=2.0 * k) == pytest.approx(large - np.log(2.0), abs=1e-6)
    both = size(bilinear_stiffness=k, quadratic_stiffness=-k)
    assert both == pytest.approx(2.0 * large, abs=1e-6)  # each pays
    assert size() == 0.0
    # where the base departs by nothing at all, a force is held against the errors of the levels, not against zero
    flat = replace(base, curves=np.zeros_like(base.curves))
    names = ("cubic_stiffness",)
    state = start_state(layout_of(batch, names), np.array([0.1 * k]), np.array([[k, c, 0.0, 0.0, 0.0]]))
    against_noise = _log_size(search, names, replace(base, state=state), departures, flat)
    seen = float(np.sqrt(((departures.noise / departures.per_force)[:2] ** 2).sum()))
    assert against_noise == pytest.approx(-np.log(0.1 / (5.0 * seen)), abs=0.01)
    assert -6.0 < against_noise < -3.0


def backbones_of(truth, vector, noise=(1e-4, 5e-3)):
    """A batch of two specimens that are known by their backbones only."""
    data = simulate_population(truth, np.array([vector, vector]), LEVELS, OBSERVABLES).drop_vars("covariance")
    typical = np.abs(data["value"].values)
    error = np.stack([noise[0] * typical[:, 0], noise[1] * typical[:, 1], np.full_like(typical[:, 0], 1e-3)], axis=1)
    noisy = data["value"].values + error * np.random.default_rng(6).standard_normal(error.shape)
    dims = data["value"].dims
    return batch_of_backbones(1.0, data.assign(value=(dims, noisy), standard_error=(dims, error)))


def test_simple_sets_are_weighed_however_unlikely_at_first_sight(monkeypatch):
    """What simulates fast is fitted with the departure, and stands beside what takes long: else rivals are missing."""
    monkeypatch.setattr(mechanisms, "_LEADERS", 1)
    monkeypatch.setattr(mechanisms, "_MOST_WEIGHED", 1)
    vector = np.array([OMEGA**2, 2.0 * ZETA * OMEGA, 0.2 * OMEGA**2, 0.4])
    batch = backbones_of(Oscillator(1.0, ["cubic_stiffness", "displacement_dependent_damping"]), vector)
    candidates = ("cubic_stiffness", "cubic_damping", "displacement_dependent_damping", "jenkins")
    search = Search(batch, Oscillator(1.0), candidates, 2)
    search.run()
    weighed = mechanisms.weigh(search)
    assert weighed is not None
    simple = [names for size in (1, 2) for names in combinations(sorted(candidates[:3]), size)]
    assert set(simple) <= set(weighed.departing)
    assert weighed.ranked()[0] == ("cubic_stiffness", "displacement_dependent_damping")


def test_laws_of_one_mechanism_are_as_probable_beforehand():
    """How many unknowns a law has is charged by the evidence, by how wide their priors are, and not once more."""
    batch = backbones_of(Oscillator(1.0, ["cubic_stiffness"]), np.array([OMEGA**2, 2.0 * ZETA * OMEGA, 0.1 * OMEGA**2]))
    search = Search(batch, Oscillator(1.0), ("coulomb_friction", "jenkins", "iwan", "cubic_stiffness"), 2)
    prior = {name: mechanisms._log_prior((name,), search) for name in search.candidates}
    assert prior["iwan"] == prior["jenkins"] == prior["coulomb_friction"]
    assert prior["cubic_stiffness"] == pytest.approx(prior["iwan"] + np.log(3.0))  # the only law of its mechanism
    total = [mechanisms._log_prior(names, search) for size in (1, 2) for names in combinations(search.candidates, size)]
    _, one, two, _ = mechanisms.PRIOR_OF_COUNT
    twice = 0.1 * one / 2  # two laws of friction
    assert np.exp(total).sum() == pytest.approx(one + two + twice, rel=1e-12)


def test_what_explains_next_to_nothing_has_no_probability():
    """It is none of the known effects then: a set whose strength is zero had been "the best"."""
    chances = {("cubic_stiffness",): 0.5, ("coulomb_friction",): 0.3, (): 0.2}
    left = {("cubic_stiffness",): 0.99, ("coulomb_friction",): 0.5, (): 1.0}
    found = _without_those_that_explain_nothing(Weighed({}, chances, left, 0.0, True, np.zeros(0)))
    assert found.probabilities == {("cubic_stiffness",): 0.0, ("coulomb_friction",): 0.3, (): 0.0}


def test_a_drift_explains_what_it_leaves_little_of(monkeypatch):
    """In each record or alike in all, whichever leaves less; without one that can be simulated nothing is explained."""
    monkeypatch.setattr(gaps, "gaps_of", lambda items, _: {names: item for names, item in items.items()})
    assert gaps.least_gap(1.0, [0.6, 0.2], None) == 0.2
    assert gaps.least_gap(1.0, [], None) == np.inf


SMALL, LARGE = ("iwan",), ("cubic_stiffness", "iwan")


@pytest.mark.parametrize(
    ("frequency", "damping", "noise", "is_as_good"),
    [
        (0.04, 0.04, 2, True),  # of what the base leaves: no mechanism is named for so little
        (0.10, 0.01, 2, False),
        (0.01, 0.10, 2, False),  # little of all, but not of what there is of the damping
        (0.04, 0.04, 4, False),  # what is left is taken for noise
    ],
)
def test_what_leaves_next_to_nothing_is_as_good_as_what_leaves_nothing(frequency, damping, noise, is_as_good):
    """Two springs that draw what a bent sensor adds to a law that explains all else, and take most of it from there."""
    wave = np.array([1.0, -1.0, 1.0, -1.0])
    known = {
        (): departing_by(wave, 0.1 * wave, 2),
        SMALL: departing_by(frequency * wave, 0.1 * damping * wave, noise),
        LARGE: departing_by(0.0 * wave, 0.0 * wave, 1),
    }
    departures = SimpleNamespace(noise=np.array([1e-3, 1e-3, 1e-3]))
    priors = {(): -3.0, SMALL: -4.0, LARGE: -7.0}
    logs = {(): 0.0, SMALL: 80.0, LARGE: 90.0}
    grown = gaps.with_smaller(logs, priors, known, departures)
    assert grown == {**logs, SMALL: 93.0 if is_as_good else 80.0}


def test_what_the_base_does_not_lack_a_set_must_not_lack_either():
    """A spring lowers the damping as a damper raises it: what the base leaves of both is nothing, and of one not."""
    wave = np.array([1.0, -1.0, 1.0, -1.0])
    logs, priors = {(): 0.0, SMALL: 80.0, LARGE: 90.0}, {(): -3.0, SMALL: -4.0, LARGE: -7.0}
    departures = SimpleNamespace(noise=np.array([1e-3, 1e-3, 1e-3]))
    for left, is_as_good in ((0.5e-3, True), (2e-3, False)):
        known = {
            (): departing_by(wave, 0.0 * wave, 2),
            SMALL: departing_by(0.01 * wave, left * wave, 2),
            LARGE: departing_by(0.0 * wave, 0.0 * wave, 2),
        }
        assert (gaps.with_smaller(logs, priors, known, departures)[SMALL] > 80.0) is is_as_good


def departing_by(frequency, damping, noise):
    curves = np.array([frequency, damping, np.zeros_like(frequency)])
    return SimpleNamespace(curves=curves, choice=Choice(1, (0, 0, 0), (noise, noise, 2)))


@pytest.mark.parametrize(
    ("cost", "parent", "moved"),
    [
        (119.0, 120.0, True),  # the second effect does nothing for the samples
        (100.0, 120.0, False),
        (399.0, 400.0, False),  # far from the noise: the samples do not say so
    ],
)
def test_an_effect_that_backbones_alone_want_is_not_believed(cost, parent, moved):
    """Backbones are made of the samples: what brings them nearer and these not follows an error of the backbones."""
    fits = {
        ("bilinear_stiffness",): SimpleNamespace(cost=parent),
        ("bilinear_stiffness", "bouc_wen"): SimpleNamespace(cost=cost),
    }
    search = SimpleNamespace(fits=fits, count=100, is_refuted=lambda _: False, fit_set=fits.get, mend=lambda _: None)
    chances = {("bilinear_stiffness",): 0.01, ("bilinear_stiffness", "bouc_wen"): 0.98, (): 0.01}
    weighed = Weighed({}, chances, {}, 0.0, True, np.zeros(0))
    found = _without_idle(search, weighed).probabilities
    expected = {("bilinear_stiffness",): 0.99, ("bilinear_stiffness", "bouc_wen"): 0.0, (): 0.01}
    assert found == pytest.approx(expected if moved else chances)


def test_a_set_that_was_not_weighed_is_not_what_remains_of_a_larger_one():
    """Samples rule a law out that a simpler one outdoes; beside a spring that does nothing for them it stayed."""
    alone, both = ("bouc_wen",), ("bouc_wen", "quintic_stiffness")
    fits = {alone: SimpleNamespace(cost=120.0), both: SimpleNamespace(cost=119.0)}
    search = SimpleNamespace(fits=fits, count=100, is_refuted=lambda _: False, fit_set=fits.get, mend=lambda _: None)
    weighed = Weighed(dict.fromkeys((alone, both)), {both: 0.99}, {}, 0.0, True, np.zeros(0))
    assert _without_what_idles(search, weighed, both) == both
    known = replace(weighed, probabilities={alone: 0.01, both: 0.98})
    assert _without_what_idles(search, known, both) == alone


@pytest.mark.parametrize(("left", "refuted", "leaves"), [(0.99, (), True), (0.5, (), False), (0.99, ((),), False)])
def test_what_leaves_all_of_the_samples_explains_nothing(left, refuted, leaves):
    """Of what a logger had held the backbones told a spring of two sides, which left 99 % of it in the samples."""
    names = ("quadratic_stiffness",)
    fits = {(): SimpleNamespace(cost=1000.0 + 5e4), names: SimpleNamespace(cost=1000.0 + left * 5e4)}
    search = SimpleNamespace(fits=fits, count=1000, is_refuted=lambda item: item in refuted)
    assert leaves_the_samples(search, fits[names]) == leaves


@pytest.mark.parametrize(("cost", "is_nothing"), [(3.94e3, True), (2.1e3, False), (1.3e3, False)])
def test_a_drift_that_leaves_far_more_than_noise_is_no_explanation(cost, is_nothing):
    """Where the line of another mode was left, a drift of 0.001 % had passed for what explains the records."""
    search = SimpleNamespace(
        fits={(): SimpleNamespace(cost=3.95e3 if is_nothing or cost > 2e3 else 1.31e3)}, count=1000,
        is_refuted=lambda _: False, reduced=lambda fit: fit.cost / 1000.0,
    )  # fmt: skip
    assert _explains_nothing(search, SimpleNamespace(cost=cost)) == is_nothing
