"""Which sets the search fits, in which order and from where: what it passes over must not be what is true."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances import undisturbed
from pymc_backbone.discrepancy.drift.drift_kinds import drift_bonus
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import DRIFTS
from pymc_backbone.discrepancy.fitting.scatter import SCATTER, WIDE_SCATTER
from pymc_backbone.discrepancy.proposals.proposal import Proposal
from pymc_backbone.discrepancy.sets import search as search_module
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.paper.cases import CASES

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    MASS,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    batch_of,
    free_decay,
    make_records,
    noisy,
    truth_of,
)

COSTLY = ("bouc_wen",)


def proposal_of(names: tuple[str, ...], log_evidence: float, scatter: float = SCATTER) -> Proposal:
    empty = np.zeros(0)
    return Proposal(
        names, empty, np.zeros((2, 2)), 10.0, True, log_evidence, ((10.0, empty, np.zeros((2, 2))),), scatter
    )


@pytest.fixture(scope="module")
def batch():
    return batch_of(make_records(np.random.default_rng(3), ("cubic_stiffness",)))


def search_with(batch, evidences, costs, candidates=("cubic_stiffness", "quadratic_damping", "coulomb_friction"), **kw):
    """A search whose proposals are given, and whose fits cost so many times the noise; what was asked is noted."""
    search = Search(batch, Oscillator(MASS), (*candidates, "bouc_wen"), 3, **kw)
    ranked = sorted(evidences.items(), key=lambda item: -item[1])
    search.__dict__["proposals"] = {names: proposal_of(names, value) for names, value in ranked}
    asked = []

    def fit_set(names):
        asked.append(names)
        search.fits[names] = SimpleNamespace(cost=costs.get(names, 50.0) * search.count)
        return search.fits[names]

    search.fit_set = fit_set
    search._is_settled = lambda: True
    search.fits[()] = SimpleNamespace(cost=1e3 * search.count)
    return search, asked


def test_a_release_is_where_the_swings_of_its_own_direction_lead():
    """A spring three times as stiff on one side, by SciPy: the first turning point lies beyond the release."""

    def force(x: float, v: float, direction: float) -> float:
        friction = 0.004 * STIFFNESS * AMPLITUDE * direction
        return STIFFNESS * (x if x < 0.0 else 3.0 * x) + DAMPING * v + friction

    decay = free_decay(force, AMPLITUDE, TIME - RELEASE_TIME)
    batch = batch_of([noisy(np.random.default_rng(1), "specimen 1", TIME, decay, 55.0)])
    assert decay.min() < -1.6 * AMPLITUDE  # negative control: the other side is no measure of the release
    _, _, release, instant, _ = batch.own[0]
    assert release == pytest.approx(AMPLITUDE, rel=0.08)
    assert instant == pytest.approx(RELEASE_TIME, abs=0.02 / 5.0)


def test_what_is_loaded_for_the_first_time_is_released_where_the_samples_say():
    """Three specimens of the source paper's fifth case: the first swing loses more than the later ones tell."""
    case, rng = CASES["5"], np.random.default_rng(5)
    time, records, releases, parameters = np.arange(0.0, 14.0, 0.025), [], [], []
    for k, values in enumerate(case.draw(3, rng)):
        release = 0.5 * rng.uniform(0.9, 1.1)
        clean = pb.simulate_waveform(case.data, values, time, release).displacement
        sigma = 10.0 ** (-45.0 / 20.0) * release / np.sqrt(2.0)
        records.append(pb.Record(f"specimen_{k + 1}", time, clean + sigma * rng.standard_normal(time.size)))
        releases.append(release)
        parameters.append(values)
    batch = batch_of(records, mass=case.data.mass)
    np.testing.assert_allclose(batch.own[:, 2], releases, rtol=0.01)
    layout = make_layout(case.data, batch.amplitude, batch.angular_frequency)
    left = {"as seen": 0.0, "anywhere": 0.0}
    for term, values in zip(batch.levels, parameters, strict=True):
        for name, used in (("as seen", term), ("anywhere", replace(term, release=0.0))):
            residuals = used.residuals(layout.simulator, case.data.pack(values), np.zeros(5))
            compared = used.compare(layout.simulator, case.data.pack(values), np.zeros(5))
            np.testing.assert_allclose(residuals, compared[0], rtol=1e-3, atol=0.02)
            left[name] += float(residuals @ residuals)
    count = sum(term.size for term in batch.levels)
    assert left["as seen"] < count < 2.0 * left["anywhere"] and left["anywhere"] > 3.0 * left["as seen"]


def test_what_the_samples_refute_is_not_tried_with_effects_that_promise_nothing():
    """A cubic spring: with a quintic one in its place an asymmetry helps nothing, the cubic one everything."""
    strong = make_records(np.random.default_rng(3), ("cubic_stiffness",), share=2.0)
    search = Search(batch_of(strong), Oscillator(MASS), ("cubic_stiffness", "quintic_stiffness", "bilinear_stiffness"))
    for names in ((), ("cubic_stiffness",), ("quintic_stiffness",)):
        search.fit_set(names)
    costs = [search.fits[(name,)].cost for name in ("cubic_stiffness", "quintic_stiffness")]
    assert search.explains(search.fits[("cubic_stiffness",)]) and costs[1] > costs[0] + 200.0
    assert search._is_hopeless(("bilinear_stiffness", "quintic_stiffness"))
    assert not search._is_hopeless(("cubic_stiffness", "quintic_stiffness"))
    assert not search._is_hopeless(("bilinear_stiffness", "cubic_stiffness"))


@pytest.mark.parametrize(
    ("behind", "is_exact", "is_far"), [(5000.0, True, True), (500.0, True, False), (5000.0, False, False)]
)
def test_backbones_far_behind_are_not_doubted_where_they_are_explained(batch, behind, is_exact, is_far):
    search, _ = search_with(batch, {("cubic_stiffness",): 0.0, ("coulomb_friction",): -9.0}, {})
    known = search.proposals
    known[("coulomb_friction",)] = replace(
        known[("coulomb_friction",)], chi_square=known[("cubic_stiffness",)].chi_square + behind, is_exact=is_exact
    )
    search.best = lambda: ("cubic_stiffness",)
    assert search._is_far(("coulomb_friction",)) == is_far
    assert not search._is_far(("quadratic_damping",))  # of what was not proposed nothing is known
    unexplained = 10.0 * search._level_values
    known[("cubic_stiffness",)] = replace(known[("cubic_stiffness",)], chi_square=unexplained)
    assert not search._is_far(("coulomb_friction",))


@pytest.mark.parametrize(
    ("behind", "is_exact", "is_left"), [(40.0, True, True), (20.0, True, False), (40.0, False, False), (300.0, 0, True)]
)
def test_a_subset_far_behind_by_its_backbones_is_not_begun_beside_the_best(batch, behind, is_exact, is_left):
    """Of a pair that is noted for the effect that it shares with the best, the other one alone is no rival."""
    found, other = ("cubic_stiffness",), ("coulomb_friction",)
    search, _ = search_with(batch, {found: 0.0, other: -behind}, {})
    search.proposals[other] = replace(search.proposals[other], is_exact=bool(is_exact))
    search.fits |= {names: SimpleNamespace(cost=float(search.count)) for names in (found, tuple(sorted(found + other)))}
    search.best, search._is_hopeless, begun = lambda: found, lambda _: False, []
    search._beside = lambda names, _cost: begun.append(names)
    search._look_within()
    assert begun == ([] if is_left else [other])


@pytest.mark.parametrize(("is_explained", "rival"), [(True, 100.0), (False, 5000.0)])
def test_a_smaller_set_that_a_larger_one_led_elsewhere_races_against_what_explains(is_explained, rival):
    """It is fitted to the end where it comes near that only; where nothing explains, where it beats itself."""
    asked, fits = [], {names: SimpleNamespace(cost=cost) for names, cost in ((("a",), 5000.0), (("a", "b"), 100.0))}
    descent = SimpleNamespace(from_near=lambda _layout, _states, rival: asked.append(rival))
    search = SimpleNamespace(
        fits=fits, ranked=lambda: [("a", "b")], layout=lambda _: None, is_refuted=lambda _: False, descent=descent,
        _was_asked=lambda *_: False, _smaller=lambda *_: None, _is_explained=lambda: is_explained,
    )  # fmt: skip
    Search._look_back(search)
    assert asked == [rival]


@pytest.mark.parametrize(
    ("above", "behind", "is_exact", "is_begun"),
    [(150.0, 1.0, True, True), (20.0, 1.0, True, False), (150.0, 20.0, True, False), (150.0, 1.0, False, False)],
)
def test_another_law_that_lost_its_way_begins_beside_the_best(batch, monkeypatch, above, behind, is_exact, is_begun):
    """A pendulum beside joint and slider lay 160 above a cubic spring there, which its backbones were as good as."""
    best, other = ("cubic_stiffness",), ("quintic_stiffness",)
    search, _ = search_with(batch, {best: 0.0, other: -1.0}, {}, candidates=(*best, *other))
    low = search.proposals[best].chi_square
    search.proposals[other] = replace(search.proposals[other], chi_square=low + behind, is_exact=is_exact)
    search.fits |= {best: SimpleNamespace(cost=1e3), other: SimpleNamespace(cost=1e3 + above)}
    begun = []
    monkeypatch.setattr(search, "budget", -1.0)  # spent
    monkeypatch.setattr(search, "_beside", lambda names, _cost: begun.append(names) or [])
    for name, said in (("best", best), ("explains", True), ("_is_costly", True), ("_is_hopeless", True)):
        monkeypatch.setattr(search, name, lambda *_, said=said: said)
    monkeypatch.setattr(search, "mechanism_of", lambda name: "spring" if name.endswith("stiffness") else "other")
    monkeypatch.setattr(search, "_drop_unneeded", lambda: None)
    search._ask_kindred()
    assert begun == ([other] if is_begun else [])


def test_a_variant_that_explains_no_more_is_no_rival_and_what_it_left_is_kept(batch):
    plain, varied = ("cubic_stiffness",), ("power_stiffness",)
    search, _ = search_with(batch, {plain: 0.0}, {}, variants=varied)
    search.fits |= {plain: SimpleNamespace(cost=1e3), varied: SimpleNamespace(cost=1e3 - 1.0)}
    left = search.fits[varied]
    search._drop_unneeded()
    assert set(search.fits) == {(), plain} and search.unneeded == {varied: left}


def test_single_effects_have_every_third_turn_and_nothing_is_asked_twice(batch):
    pairs = {("cubic_stiffness", "quadratic_damping"): 9.0, ("coulomb_friction", "cubic_stiffness"): 8.0,
             ("coulomb_friction", "quadratic_damping"): 7.0}  # fmt: skip
    singles = {("cubic_stiffness",): -300.0, ("quadratic_damping",): -400.0, ("coulomb_friction",): -500.0}
    search, _ = search_with(batch, pairs | singles, {})
    order = [names for names, _ in search._queue()]
    assert order[2] == ("cubic_stiffness",) and order[:2] == [*pairs][:2]
    assert sorted(order) == sorted([*pairs, *singles])


def test_the_likeliest_set_is_asked_whatever_it_costs(batch):
    """Behind six simple ones at most; where these explain the records, only if its backbones are likelier."""
    simple = {("cubic_stiffness", f"effect {k}"): -1.0 - k for k in range(20)}
    search, _ = search_with(batch, {COSTLY: 0.0} | simple, {})
    search._is_costly = lambda names: names == COSTLY
    order = [names for names, _ in search._queue()]
    assert 0 < order.index(COSTLY) <= 7
    # far likelier than all simple ones it still has one of them to be measured against, and only one
    search, _ = search_with(batch, {COSTLY: 100.0} | simple, {})
    search._is_costly = lambda names: names == COSTLY
    assert [names for names, _ in search._queue()].index(COSTLY) == 1
    explaining = {("cubic_stiffness",): 1.0, ("quadratic_damping",): 1.0}
    for log_evidence, is_asked in ((0.0, True), (-6.0, False)):
        evidences = {("cubic_stiffness",): -3.0, ("quadratic_damping",): -4.0, COSTLY: log_evidence}
        search, asked = search_with(batch, evidences, explaining)
        search._follow_backbones(24)
        assert (COSTLY in asked) == is_asked


@pytest.mark.parametrize(("is_settled", "left"), [(True, {3, 7}), (False, set())])
def test_what_is_much_less_likely_than_a_simple_set_that_leaves_noise_is_not_followed(batch, is_settled, left):
    """A pendulum was named in 4 s, and what lay 4 to 12 nats behind by its backbones took another 10."""
    found, (one, other) = ("cubic_stiffness",), ("coulomb_friction", "quadratic_damping")
    behind = {1: (one,), 2: (one, other), 3: (other,), 7: (one, "quintic_stiffness")}
    distances = {1: -7.0, 2: -3.0, 3: -9.0, 7: -5.0}
    evidences = {found: 0.0} | {names: distances[key] for key, names in behind.items()}
    search, asked = search_with(batch, evidences, {found: 1.0})
    search._is_settled = lambda: is_settled
    search._follow_backbones(24)
    assert {key for key, names in behind.items() if names not in asked} == left


def test_what_is_as_likely_as_the_likeliest_is_asked_although_the_effort_is_spent(batch):
    """Bouc-Wen beside a cubic spring, which costs much, stood behind simple sets that explained nothing."""
    costly = {("bouc_wen", f"effect {k}"): -3.0 - k for k in range(6)}
    simple = {("cubic_stiffness", f"effect {k}"): -0.1 * k for k in range(8)}
    for costs, several in (({}, 2), ({("cubic_stiffness", "effect 0"): 1.0}, 0)):
        search, asked = search_with(batch, simple | costly, costs)
        search._is_costly = lambda names: "bouc_wen" in names
        search.layout = lambda names: None
        search.descent.effort = 2.0 * search.budget
        search._follow_backbones(24)
        likely = [names for names in asked if "bouc_wen" in names and costly[names] > -6.0]
        assert len(likely) == several and len([names for names in asked if "bouc_wen" in names]) == several


def test_a_costly_law_is_asked_in_the_place_of_several_simple_ones_although_the_effort_is_spent(batch):
    """Bouc-Wen, second by its backbones, was never fitted: triples of simple effects had taken the effort before."""
    pair, beside = ("cubic_stiffness", "quadratic_damping"), ("bouc_wen", "coulomb_friction")
    for best, likelihood, is_asked in ((pair, -1.0, True), (pair, -40.0, False), (("cubic_stiffness",), -1.0, False)):
        evidences = {best: 0.0, COSTLY: likelihood, beside: -0.5}
        search, asked = search_with(batch, evidences, {best: 1.0})
        search._is_costly = lambda names: "bouc_wen" in names
        search.fit_set(best)
        search.best, search.descent.effort = lambda best=best: best, 2.0 * search.budget
        search._ask_costly()
        assert (COSTLY in asked) == is_asked and beside not in asked


def test_a_rare_law_alone_is_asked_where_several_effects_explain(batch):
    """A damper with a dead band was a drag: friction and a power of the speed drew its backbones better."""
    pair, varied = ("coulomb_friction", "cubic_stiffness"), ("dead_band_damping",)
    for best, likelihood, is_asked in ((pair, -20.0, True), (pair, -40.0, False), (("cubic_stiffness",), -20.0, False)):
        evidences = {best: 0.0, varied: likelihood, ("dead_band_damping", "quadratic_damping"): -20.0}
        search, _ = search_with(batch, evidences, {best: 1.0}, variants=("dead_band_damping",))
        search.fit_set(best)
        search.best = lambda best=best: best
        assert search._promised_variants() == ([varied] if is_asked else [])


@pytest.mark.parametrize(("left", "few"), [(200.0, True), (50.0, False)])
def test_few_sets_are_followed_where_all_are_far_off_and_none_of_those_that_costs_much(batch, left, few):
    """What no set holds is there then: of a jointed beam ten hysteretic sets were fitted, and it was none of them."""
    simple = {("cubic_stiffness", f"effect {k}"): -1.0 - k for k in range(10)}
    costly = {("bouc_wen", f"effect {k}"): -0.5 - 0.1 * k for k in range(8)}
    search, asked = search_with(batch, simple | costly, dict.fromkeys(simple | costly, left))
    search._is_costly = lambda names: "bouc_wen" in names
    search.layout = lambda names: None
    search._follow_backbones(24)
    assert (len(asked) < 8) == few  # six, and what is fitted beside the sixth
    assert any("bouc_wen" in names for names in asked[3:]) != few


@pytest.mark.parametrize(("left", "is_wider"), [(200.0, False), (50.0, True)])
def test_a_search_ends_where_all_sets_are_far_off(batch, monkeypatch, left, is_wider):
    """No wider scatter is looked at and nothing is added: another look at the best set is all."""
    names, asked = ("cubic_stiffness",), []
    others = dict.fromkeys([("quadratic_damping",), ("coulomb_friction",)], 2.0 * left)
    search, _ = search_with(batch, {names: 0.0}, {names: left} | others)
    monkeypatch.setattr(search_module, "propose", lambda *_, **__: asked.append("wider") or [proposal_of(names, 1.0)])
    for name in ("_mind_scatter", "_begin_from_smaller"):
        monkeypatch.setattr(search, name, lambda: None)
    monkeypatch.setattr(search, "_look_around", lambda: asked.append("around") or True)
    assert search._ends_following() != is_wider
    assert asked == (["wider"] if is_wider else ["around"])


def test_what_adds_to_a_set_that_leaves_more_than_another_is_asked(batch):
    """A pair explains the records about, another set better: what adds to the pair is no longer left for its sake."""
    candidates = ("coulomb_friction", "cubic_stiffness", "quadratic_damping", "quintic_stiffness")
    evidences = {
        ("coulomb_friction", "cubic_stiffness"): 0.0,
        ("coulomb_friction", "cubic_stiffness", "quadratic_damping"): -0.5,
        ("quintic_stiffness",): -0.6,
    }
    close = 10.0 / batch_size(batch)
    for gap, is_asked in ((0.09, True), (close, False)):
        costs = {("coulomb_friction", "cubic_stiffness"): 1.0 + gap, ("quintic_stiffness",): 1.0}
        search, asked = search_with(batch, evidences, costs, candidates)
        search._follow_backbones(24)
        assert (("coulomb_friction", "cubic_stiffness", "quadratic_damping") in asked) == is_asked


def test_a_search_ends_early_where_what_is_in_front_of_the_records_is_known_and_can_be_resumed(batch):
    asked_with = []

    def is_disturbed(search):
        asked_with.append(len(search.fits))
        return "a filter"

    sets = ["cubic_stiffness", "coulomb_friction", "quadratic_damping"]
    evidences: dict[tuple[str, ...], float] = {(name,): 100.0 - 2.0 * k for k, name in enumerate(sets)}
    evidences |= {("coulomb_friction", "cubic_stiffness"): 95.0, ("cubic_stiffness", "quadratic_damping"): 94.0}
    search, asked = search_with(batch, evidences, {}, is_disturbed=is_disturbed)
    search._follow_backbones(24)
    assert search.halted == "a filter" and asked_with == [4] and len(asked) == 3  # the base beside three sets
    search.halted = None
    search._follow_backbones(24)
    assert search.halted is None and asked_with == [4]  # asked once
    assert set(asked) == set(evidences)
    # where the first set explains the records, what follows it is not asked
    explained, asked = search_with(batch, evidences, {("cubic_stiffness",): 1.0}, is_disturbed=is_disturbed)
    explained._follow_backbones(24)
    assert explained.halted == "a filter" and len(asked) < len(evidences)


def test_no_high_pass_is_asked_in_front_of_records_that_a_set_explains(batch, monkeypatch):
    monkeypatch.setattr(undisturbed, "early_high_pass", lambda _: "a filter")
    monkeypatch.setattr(undisturbed, "early_line", lambda _: None)
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness",), 1)
    search.fit_set(())
    assert not search.explains(search.fits[()])
    assert undisturbed.in_the_way(search) == "a filter"
    search.fit_set(("cubic_stiffness",))
    assert undisturbed.in_the_way(search) is None


def test_a_line_is_asked_before_a_high_pass(batch, monkeypatch):
    """The noise is estimated from records that hold the line: behind any filter a set seems to leave noise."""
    monkeypatch.setattr(undisturbed, "early_high_pass", lambda _: "a filter")
    monkeypatch.setattr(undisturbed, "early_line", lambda _: "a line")
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness",), 1)
    search.fit_set(())
    assert undisturbed.in_the_way(search) == "a line"


def batch_size(batch) -> int:
    return sum(term.size for term in batch.deciding)


def test_noise_that_was_taken_for_too_small_explains_and_what_bends_does_not(batch):
    """A fifth more than the noise: of white residuals it counts, of what the model lacks it does not."""
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness",), 1)
    right, wrong = search.fit_set(("cubic_stiffness",)), search.fit_set(())
    search.count = right.cost / 1.2
    assert search.explains(right)
    search.count, search.noisy = wrong.cost / 1.2, {}
    assert not search.explains(wrong)
    search.count, search.noisy = right.cost / 1.6, {}
    assert not search.explains(right)  # so much more is no chance


@pytest.mark.parametrize("is_explained", [True, False])
def test_wide_scatter_is_looked_at_where_nothing_explains_and_left_where_it_does_not_either(
    batch, monkeypatch, is_explained
):
    names = ("cubic_stiffness",)
    search, _ = search_with(batch, {names: -5.0}, {names: 3.0})
    search.fits[names] = SimpleNamespace(cost=3.0 * search.count)
    before, narrow = dict(search.fits), search.proposals
    wide = [proposal_of(names, 3.0, WIDE_SCATTER)]
    monkeypatch.setattr(search_module, "propose", lambda *_, scatter, **__: wide if scatter == WIDE_SCATTER else None)
    costs = {(): 1e3, names: 1.0 if is_explained else 2.0}

    def fit_set(asked_for):
        search.fits[asked_for] = SimpleNamespace(cost=costs[asked_for] * search.count)
        return search.fits[asked_for]

    search.fit_set = fit_set
    search._look_wider()
    if is_explained:
        assert search.scatter == WIDE_SCATTER and search.fits[names].cost == search.count
    else:
        assert search.scatter == SCATTER and search.fits == before and search.proposals is narrow
    wide[0] = replace(wide[0], log_evidence=-1.0)  # hardly likelier: not even begun
    search, _ = search_with(batch, {names: -5.0}, {})
    search.fits[names] = SimpleNamespace(cost=3.0 * search.count)
    search._look_wider()
    assert search.scatter == SCATTER


def test_what_the_best_set_still_asks_for_is_added_although_the_effort_is_spent(monkeypatch):
    """A weak drag beside a cubic spring, of which the backbones proposed the spring alone."""
    names = ("cubic_stiffness", "quadratic_damping")
    batch = batch_of(make_records(np.random.default_rng(7), names, share=0.5))

    def searched():
        search = Search(batch, Oscillator(MASS), names, 2, budget=0.0)
        known = search.proposals
        search.__dict__["proposals"] = {(name,): known[(name,)] for name in names}
        search.fits = {(): search.fit_set(()), names[:1]: search.fit_set(names[:1])}
        search.count = search.fits[names[:1]].cost / 1.05  # it explains the records, about
        return search

    search = searched()
    assert search._score(names[:1], "quadratic_damping") > 10.0
    search._complete()
    assert search.best() == names
    asked = searched()
    monkeypatch.setattr(asked, "_score", lambda *_: 9.0)  # negative control: what noise may gain is not asked
    asked._complete()
    assert names not in asked.fits


def test_what_a_variant_varies_begins_again_from_the_variant():
    """Plain drag whose fit was lost, and drag with two strengths that found it: the plain one is fitted from there."""
    batch = batch_of(make_records(np.random.default_rng(4), ("quadratic_damping",)))
    plain, variant = ("quadratic_damping",), ("asymmetric_drag",)
    search = Search(batch, Oscillator(MASS), plain, 1, variants=variant)
    search.fit_set(()), search.fit_set(plain), search.fit_set(variant)
    reached = search.fits[plain].cost
    lost = search.fits[plain]
    search.fits[plain] = replace(lost, chi_square=lost.chi_square + 100.0)
    assert search._is_needed(variant)  # what a lost fit makes of it
    search._ask_plain()
    assert search.fits[plain].cost == pytest.approx(reached, abs=0.5)
    assert not search._is_needed(variant)


def _drifting(own, covariance, gained=0.0):
    """A fit with drifts, and the same set without: as much as the drift bonus asks of both."""
    state = SimpleNamespace(own=own)
    scatters = (SimpleNamespace(log_evidence=0.3 + gained), SimpleNamespace(log_evidence=0.3))
    return tuple(SimpleNamespace(state=state, own_covariance=covariance, scatter=scatter) for scatter in scatters)


def test_drifts_of_no_meaning_gain_no_more_than_they_cost():
    """A fit that ended far from the records, at drifts of twenty prior widths of which the data say nothing."""

    def of(values, variance):
        own = np.zeros((4, 9))
        own[:, DRIFTS] = np.asarray(values)[:, None]
        covariance = np.ones((4, 9))
        covariance[:, DRIFTS] = variance
        return _drifting(own, covariance)

    absurd = np.array([25.0, 7.0, 16.0, 13.0])
    assert drift_bonus(*of(absurd, 0.999)) <= absurd @ absurd + 0.01
    # what is alike in all records, and well measured, keeps what that is worth: more than drifts of any size each
    alike, each = (
        drift_bonus(*of([1.0, 1.02, 0.98, 1.0], 1e-3)),
        drift_bonus(*of([1.0, -0.4, 0.1, -1.6], 1e-3)),
    )
    assert alike > 2.0 and each < alike


def test_kinds_of_drift_have_their_chances():
    """Absent, common up to 2 to 20 %, or independent: SciPy's densities, weighed, against that of independent ones."""
    values, variance = np.array([0.30, 0.34, 0.27, 0.31]), 4e-3
    own, covariance = np.zeros((4, 9)), np.ones((4, 9))
    own[:, DRIFTS], covariance[:, DRIFTS] = values[:, None], variance
    found = drift_bonus(*_drifting(own, covariance))
    noise = 1.0 / (1.0 / variance - 1.0)
    measured = values * noise / variance
    each = [(noise + (share * measured.mean()) ** 2) * np.eye(4) for share in (0.2, 0.06, 0.02)]
    alike = [multivariate_normal.pdf(measured, cov=apart + size**2) for apart in each for size in (1.0, 0.1, 0.01)]
    densities = [
        multivariate_normal.pdf(measured, cov=noise * np.eye(4)),
        np.mean(alike),
        multivariate_normal.pdf(measured, cov=(noise + 1.0) * np.eye(4)),
    ]
    of_frequency, of_damping = (np.dot(prior, densities) / densities[-1] for prior in ([1, 2, 1], [2, 1, 1]))
    assert found == pytest.approx(np.log(of_frequency / 4 * of_damping / 4), rel=1e-6)


def test_drifts_that_are_alike_in_all_records_are_likelier_the_more_they_are_alike():
    """Damping that falls by a sixth in all of eight records, known to a hundredth of that, was two laws of damping."""
    gained = []
    for apart in (0.02, 0.2):
        own, covariance = np.zeros((8, 9)), np.full((8, 9), 2.5e-5)
        own[:, DRIFTS[1]] = -0.37 * (1.0 + apart * np.array([0.3, -0.5, 1.0, -0.8, 0.1, 0.6, -1.2, 0.5]))
        gained.append(drift_bonus(*_drifting(own, covariance)))
    assert gained[0] > gained[1] + 5.0


@pytest.mark.parametrize(
    ("names", "promised", "asked"),
    [
        (("iwan",), (20.0, 20.5, 21.0), 2),  # two shapes, and minima that are alike
        (("iwan",), (20.0, 26.0, 27.0), 1),
        (("cubic_stiffness",), (20.0, 20.5, 21.0), 1),
        (("cubic_stiffness", "iwan"), (20.0, 20.5, 21.0), 1),
    ],
)
def test_a_single_effect_of_several_shapes_begins_from_minima_that_backbones_do_not_tell_apart(
    batch, names, promised, asked
):
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness", "iwan"), 2)
    search.fit_set(())
    layout = search.layout(names)
    starts = tuple((value, np.full(layout.free.size, value), batch.own[:, :2]) for value in promised)
    search.__dict__["proposals"] = {names: Proposal(names, starts[0][1], starts[0][2], 20.0, True, 0.0, starts)}
    begun = []

    def from_afar(_, state, *__):
        begun.append(state)
        return SimpleNamespace(cost=search.count * (1.0 + 0.05 * (len(begun) == 1)), layout=layout)

    search.descent.in_order = lambda _, proposed: iter([(value, eta) for value, eta, _ in proposed])
    search.descent.from_afar = from_afar
    found = search._proposed(names, None)
    assert len(begun) == len(found) == asked


@pytest.mark.parametrize(("values", "share"), [((0.02, -0.03, 0.01, 0.02), 0.0), ((0.9, -0.7, 0.2, -1.1), 1.0)])
def test_drifts_take_the_place_of_scatter_as_far_as_each_record_has_its_own(values, share):
    """Effects scatter less where drifts may differ: that is worth nothing where drifts are absent."""
    own, covariance = np.zeros((4, 9)), np.ones((4, 9))
    own[:, DRIFTS], covariance[:, DRIFTS] = np.array(values)[:, None], 2e-3
    without, with_gain = (drift_bonus(*_drifting(own, covariance, gained)) for gained in (0.0, 5.0))
    # the evidence of the fit with drifts holds these 5
    assert with_gain - without == pytest.approx(-5.0 * (1.0 - share), abs=0.35)


def test_drifts_of_each_record_that_are_certain_leave_a_number():
    """Rounding made the probability that none has its own less than nothing, and its logarithm no number."""
    found = []
    for seed in range(200):
        own, covariance = np.zeros((4, 9)), np.ones((4, 9))
        own[:, DRIFTS], covariance[:, DRIFTS] = 9.0 * np.random.default_rng(seed).normal(size=(4, 2)), 1e-6
        found.append(drift_bonus(*_drifting(own, covariance, 5.0)))
    assert np.isfinite(found).all()


@pytest.mark.parametrize("is_blind", [True, False])
def test_what_is_in_the_best_set_is_asked_where_backbones_lack_the_mid_line(is_blind, rng):
    """A stop on one side had been named with a clearance that did nothing: by its backbones it was far off."""
    oscillator = pb.Oscillator(MASS, ["cubic_stiffness"])
    truth = truth_of(("cubic_stiffness",), share=4.0)
    quantity = "acceleration" if is_blind else "displacement"
    records = []
    for name, share in (("one", 1.0), ("two", 0.8)):
        values = pb.simulate_waveform(oscillator, truth, TIME, share * AMPLITUDE, quantity=quantity).values
        values = values + 3e-3 * np.abs(values).max() * rng.standard_normal(TIME.size)
        records.append(pb.Record(name, TIME, values, quantity, "m/s^2" if is_blind else "m"))
    search = Search(batch_of(records), Oscillator(MASS), ("cubic_stiffness", "quadratic_damping"), 2)
    search.fit_set(())
    search.fit_set(("cubic_stiffness", "quadratic_damping"))
    search.fits = {names: search.fits[names] for names in ((), ("cubic_stiffness", "quadratic_damping"))}
    assert search.batch.lacks_mid_line == is_blind
    search._ask_parts()
    assert (("cubic_stiffness",) in search.fits) == is_blind
    assert search.best() == (("cubic_stiffness",) if is_blind else ("cubic_stiffness", "quadratic_damping"))
