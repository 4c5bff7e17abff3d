"""Evidence, lack of fit, the gap, held-out data, rivals: each on data made for it."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.signal import lfilter
from scipy.stats import f, kstest, multivariate_normal

from pymc_backbone._common.checks import InputError
from pymc_backbone._common.text import per_cent
from pymc_backbone.discrepancy.checks import data_checks, rivals, verify
from pymc_backbone.discrepancy.checks.second_mode import second_mode_check
from pymc_backbone.discrepancy.deciding.compensation import compensation
from pymc_backbone.discrepancy.deciding.decide import decide
from pymc_backbone.discrepancy.deciding.decision import NAMED
from pymc_backbone.discrepancy.deciding.imitations import doubted, is_none_other
from pymc_backbone.discrepancy.deciding.tolerance import is_drift_small
from pymc_backbone.discrepancy.disturbances.lines import line_beside, line_near
from pymc_backbone.discrepancy.disturbances.undisturbed import Undisturbed, with_drifts
from pymc_backbone.discrepancy.drift import drift_fits, drift_kinds
from pymc_backbone.discrepancy.drift.drift_proposals import beside_drifts, single_beside_drifts
from pymc_backbone.discrepancy.fitting import equal_forces, starts
from pymc_backbone.discrepancy.fitting.curves import (
    about_zero,
    curve,
    is_told_apart,
    level_chi_square,
    measured,
    on_levels,
    prediction_errors,
    simulate,
)
from pymc_backbone.discrepancy.fitting.drift_course import DRIFT, changes_of, course_of, covered
from pymc_backbone.discrepancy.fitting.joint_fit import fit, parameters_of
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import (
    DRIFTS,
    NUISANCES,
    RELEASE_INSTANT,
    State,
    information,
    start_state,
)
from pymc_backbone.discrepancy.fitting.scatter import SCATTER
from pymc_backbone.discrepancy.results.entries import HeldOut
from pymc_backbone.discrepancy.results.locate import mean_gap, where_different
from pymc_backbone.discrepancy.sets.followed_sets import FEW_FOLLOWED
from pymc_backbone.discrepancy.sets.question import Question, check_one_batch, check_one_mode
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.effects import LIBRARY
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_waveform

from .discrepancy_cases import (
    AFTER_FIRST_SWING,
    AMPLITUDE,
    DAMPING,
    FREQUENCY,
    MASS,
    OMEGA,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    batch_of,
    decaying_sinusoid,
    drifting_records,
    force_of,
    free_decay,
    make_records,
    noisy,
    truth_of,
)

CANDIDATES = ("cubic_stiffness", "coulomb_friction", "quadratic_damping")


def search_of(batch, candidates=CANDIDATES, largest=2, base=()):
    search = Search(batch, Oscillator(MASS, base), candidates, largest)
    search.run()
    return search


@pytest.fixture(scope="module")
def cubic():
    records = make_records(np.random.default_rng(21), ("cubic_stiffness",), specimens=3)
    return search_of(batch_of(records, start=AFTER_FIRST_SWING))


@pytest.fixture(scope="module")
def linear():
    return search_of(batch_of(make_records(np.random.default_rng(22), (), specimens=3)))


# evidence


def test_probabilities_sum_to_one_and_the_right_set_leads(cubic):
    found = evidence.probabilities(cubic.fits, cubic.batch, len(CANDIDATES))
    assert sum(item.probability for item in found.values()) == pytest.approx(1.0, abs=1e-9)
    assert found[()].log_evidence == 0.0
    assert max(found, key=lambda names: found[names].probability) == ("cubic_stiffness",)
    assert cubic.ranked()[0] == cubic.best() == ("cubic_stiffness",)
    assert cubic.best(0) == ()


def test_ranking_again_simulates_nothing_and_says_the_same(cubic, monkeypatch):
    def ranked(fits):
        return evidence.probabilities(fits, cubic.batch, len(CANDIDATES))

    first = ranked(cubic.fits)
    anew = {names: replace(found) for names, found in cubic.fits.items()}  # of which nothing is remembered
    with monkeypatch.context() as patched:
        patched.setattr(evidence, "residuals_of", None)
        patched.setattr(evidence, "information", None)
        assert ranked(cubic.fits) == first
        with pytest.raises(TypeError):
            ranked(anew)
    assert ranked(anew) == first
    scale = evidence.noise_scale(cubic.fits, cubic.batch)
    found = cubic.fits[("cubic_stiffness",)]
    known = [information(found.layout, found.system, found.state, found.active, k * scale.noise)[0] for k in (1.0, 4.0)]
    gain = evidence.laplace(found, scale._replace(noise=4.0 * scale.noise)) - evidence.laplace(found, scale)
    assert gain == pytest.approx(0.5 * (known[0] - known[1]), rel=1e-9) and gain > 1.0  # of another noise, anew


def test_a_set_that_lost_its_way_begins_again_beside_one_that_explains(cubic):
    names = ("quintic_stiffness",)
    search = Search(cubic.batch, Oscillator(MASS, ()), (*CANDIDATES, *names), 1)
    search.fit_set(())
    from_backbones = min(search._proposed(names, None), key=lambda item: item.cost)
    search.fit_set(("cubic_stiffness",))
    assert search.fit_set(names).cost == pytest.approx(from_backbones.cost, abs=0.5)
    kept = search.fits[names]
    search.fit_beside(names)
    assert search.fits[names] is kept  # it keeps what the backbones promise: nothing is done
    own = kept.state.own.copy()
    own[:, 0] *= 1.1
    search.fits[names] = replace(kept, state=replace(kept.state, own=own), chi_square=kept.chi_square + 1e9)
    search.asked.clear()
    search.fit_beside(names)
    assert search.fits[names].cost == pytest.approx(from_backbones.cost, abs=0.5)


def test_an_effect_that_was_lost_on_the_way_is_found_from_the_smaller_set(monkeypatch):
    """A fit that ended where one effect is absent, though a linear step from the set without it promises thousands."""
    pair, one = ("cubic_stiffness", "quadratic_damping"), ("cubic_stiffness",)
    batch = batch_of(make_records(np.random.default_rng(31), pair, specimens=2))
    search = Search(batch, Oscillator(MASS, ()), CANDIDATES, 2)
    for names in ((), one, pair):
        search.fit_set(names)
    right, smaller = search.fits[pair], search.fits[one]
    assert search.explains(right) and smaller.cost > 1.5 * search.count and smaller.is_converged
    assert not search._look_closer() and search.fits[pair] is right  # nothing is lost
    asked = []
    extended = Search._extended
    monkeypatch.setattr(Search, "_extended", lambda *args: asked.append(args[1]) or extended(*args))
    for share, is_lost in ((0.93, True), (0.5, False)):
        # beside the smaller set, or halfway: then a step promises no more than was gained
        left = right.chi_square + share * (smaller.chi_square - right.chi_square)
        search.fits[pair] = replace(right, chi_square=left)
        assert search.best() == pair and search._look_closer() == is_lost and (asked == [pair]) == is_lost
        assert (search.fits[pair].cost < right.cost + 1.0) == is_lost
        asked.clear()


def test_other_laws_of_the_mechanism_are_asked_before_one_is_named(cubic):
    one, kindred = ("cubic_stiffness",), ("quintic_stiffness",)
    search = Search(cubic.batch, Oscillator(MASS, ()), (*CANDIDATES, *kindred), 2)
    for names in ((), one):
        search.fit_set(names)
    search.budget = 0.0
    search._ask_kindred()  # whatever effort is left
    assert set(search.fits) == {(), one, kindred}
    from_backbones = min(search._proposed(kindred, None), key=lambda item: item.cost)
    assert search.fits[kindred].cost == pytest.approx(from_backbones.cost, abs=0.5)
    assert search.fits[kindred].cost > search.fits[one].cost + 10.0
    known = dict(search.fits)
    search._ask_kindred()
    assert search.fits == known


def test_a_subset_that_was_left_aside_is_asked_where_a_larger_set_explains(cubic):
    one, pair = ("geometric_stiffness",), ("cubic_stiffness", "geometric_stiffness")
    search = Search(cubic.batch, Oscillator(MASS, ()), (*CANDIDATES, *one), 2)
    search.fit_set(())
    from_backbones = min(search._proposed(one, None), key=lambda item: item.cost)
    for names in (pair[:1], pair):
        search.fit_set(names)
    assert one not in search.fits
    search._look_within()
    assert search.fits[one].cost == pytest.approx(from_backbones.cost, abs=0.5)
    assert set(search.fits) == {(), pair[:1], one, pair}


def test_what_the_turning_points_refute_is_not_fitted_to_the_samples(cubic):
    """Counted in evaluations; without a set that explains the records only what no model leaves is refuted."""
    search = Search(cubic.batch, Oscillator(MASS, ()), CANDIDATES, 1)
    search.fit_set(())
    values = sum(term.size for term in cubic.batch.turning)
    assert search._limit == search.descent.unheard_of == 10.0 * values
    search.fit_set(("quadratic_damping",))  # the spring is strong
    assert search.refuted == {("quadratic_damping",)} and not search.fits[("quadratic_damping",)].is_converged
    search.fit_set(("cubic_stiffness",))
    assert ("cubic_stiffness",) not in search.refuted
    best = search.fits[("cubic_stiffness",)]
    turning = fit(best.layout, cubic.batch.turning, best.state, iterations=30)
    assert turning.cost < search._limit < 10.0 * sum(term.size for term in cubic.batch.turning)
    layout = search.layout(("quadratic_damping",))
    _, eta, own = search.proposals[("quadratic_damping",)].starts[0]
    state = search.descent.released(layout, eta, own)
    step, whole = search.descent.from_afar(layout, state, limit=search._limit), search.descent.from_afar(layout, state)
    assert step.evaluations <= 3 and not step.is_converged  # one iteration
    assert whole.evaluations > step.evaluations and whole.is_converged
    ways = []
    assert search.descent.from_afar(layout, state, ways=ways) is not None
    assert search.descent.from_afar(layout, state, ways=ways) is None  # the same way once more


def test_larger_sets_imitate_more_and_small_gaps_most():
    def chance(size, gap, has_drift=False):
        names = tuple("abc"[:size])
        fits = {(): SimpleNamespace(cost=gap**2), names: SimpleNamespace(cost=0.0)}
        return is_none_other(SimpleNamespace(fits=fits), names, has_drift)

    assert [round(chance(size, 100.0), 2) for size in (1, 2, 3)] == [1.0, 0.94, 0.4]
    assert chance(3, 500.0) < NAMED < chance(3, 5000.0)
    assert all(chance(size, 1e3) > chance(size, 100.0) for size in (1, 2, 3))
    assert chance(2, 100.0, has_drift=True) == chance(3, 100.0) and chance(1, 100.0, has_drift=True) > NAMED


def test_effects_that_take_each_others_doing_back_are_noticed(cubic):
    """Against the first-order frequency of two springs: of third power 3/8 of its share, of fifth power 5/16."""

    def found(names, values):
        layout = make_layout(Oscillator(MASS, names), AMPLITUDE, OMEGA, SCATTER)
        known = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING} | values
        vector = np.array([known[name] for name in layout.oscillator.parameter_names])
        fits = {names: SimpleNamespace(layout=layout, parameters=lambda r: vector)}
        return compensation(SimpleNamespace(fits=fits, batch=cubic.batch, own={}), names)

    springs = ("cubic_stiffness", "quintic_stiffness")
    expected = []
    for fifth in (1.0, -1.2, -1.8):
        third = 0.05 * STIFFNESS / AMPLITUDE**2
        values = {"cubic_stiffness": third, "quintic_stiffness": fifth * third / AMPLITUDE**2}
        worst = 1.0
        for term in cubic.batch.levels:
            share = term.levels / AMPLITUDE
            each = [0.5 * 0.05 * 0.75 * share**2, 0.5 * fifth * 0.05 * 0.625 * share**4]
            sizes = [np.std(item) for item in (*each, sum(each))]
            worst = max(worst, max(sizes[:2]) / sizes[2])
        assert found(springs, values) == pytest.approx(worst, rel=0.1)
        expected.append(worst)
    assert expected[0] < 1.01 and expected[2] > 3.0
    drag = {"quadratic_damping": 0.6 * DAMPING / (OMEGA * AMPLITUDE)}
    # a stiffer spring is damped less
    assert found(("cubic_stiffness", "quadratic_damping"), values | drag) == pytest.approx(1.0, abs=0.1)


def test_compensated_sets_are_rather_imitations():
    fits = {(): SimpleNamespace(cost=1e4), ("a", "b"): SimpleNamespace(cost=0.0)}
    chances = [
        is_none_other(SimpleNamespace(fits=fits), ("a", "b"), compensated=ratio) for ratio in (1.0, 2.0, 4.0, 20.0)
    ]
    assert chances[0] == chances[1] > NAMED > chances[2] > chances[3] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("large", [1.0, 0.2])  # share of the motion that the gap is, beyond which it counts less
@pytest.mark.parametrize("gap", [5.0, 12.0, 36.0, 300.0])
def test_a_weak_second_effect_may_stand_in_for_what_the_library_lacks(monkeypatch, gap, large):
    monkeypatch.setattr(evidence, "size_of_motion", lambda batch: 100.0 * gap * large)
    fits = {(): SimpleNamespace(cost=2e6), ("a",): SimpleNamespace(cost=gap**2), ("b",): SimpleNamespace(cost=1e6),
            ("a", "b"): SimpleNamespace(cost=0.0)}  # fmt: skip
    known = {
        names: evidence.Evidence(0.0, 0.0, chance) for names, chance in zip(fits, (0.0, 0.0, 0.0, 0.96), strict=True)
    }
    found = {names: item.probability for names, item in doubted(SimpleNamespace(fits=fits, batch=None), known).items()}
    stands_in = 0.2 * min(1.0, 12.0 / gap) ** 1.5 * large
    assert found[("a", "b")] == pytest.approx(0.96 / (1.0 + stands_in))
    assert found[("a",)] == pytest.approx(0.96 - found[("a", "b")]) and found[("b",)] == found[()] == 0.0
    assert (found[("a", "b")] > NAMED) == (gap > 20.0 or large < 1.0)


def test_an_irrelevant_effect_costs(cubic, linear):
    for search, right in ((cubic, ("cubic_stiffness",)), (linear, ())):
        found = evidence.probabilities(search.fits, search.batch, len(CANDIDATES))
        larger = [names for names in search.fits if len(names) == len(right) + 1 and set(right) < set(names)]
        assert larger
        for names in larger:
            # it can be turned off; what promises nothing is noted near zero strength after one step, not at zero
            assert search.fits[names].cost <= search.fits[right].cost + 2.0
            assert found[names].log_evidence < found[right].log_evidence - 0.5, names


def test_prior_is_shared_by_the_sets_of_one_size():
    from math import comb

    total = sum(comb(7, size) * np.exp(evidence.log_prior(size, 7)) for size in range(4))
    assert total == pytest.approx(1.0, abs=1e-12)


def test_evidence_does_not_depend_on_the_noise_that_was_assumed(cubic):
    """Residuals twice too large everywhere: hardly another probability, because the noise level is free."""
    compared = ((), ("coulomb_friction",), ("cubic_stiffness", "quadratic_damping"))
    for names in compared:
        cubic.fit_set(names)
    found = evidence.probabilities(cubic.fits, cubic.batch, len(CANDIDATES))
    doubled = tuple(
        replace(item, whiten=lambda columns, old=item.whiten: 2.0 * old(columns)) for item in cubic.batch.waveform
    )
    search = search_of(replace(cubic.batch, waveform=doubled))
    for names in compared:
        search.fit_set(names)
    again = evidence.probabilities(search.fits, search.batch, len(CANDIDATES))
    for names in compared:
        difference = found[names].log_posterior - found[("cubic_stiffness",)].log_posterior
        # the priors of scatter weigh differently, and where fits end: a few per cent of odds of thousands to one
        assert again[names].log_posterior - again[("cubic_stiffness",)].log_posterior == pytest.approx(
            difference, rel=0.1, abs=1.0
        )


def fake(residuals, batch, found, monkeypatch):
    monkeypatch.setattr(evidence, "residuals_of", lambda term, fit, specimen: residuals)
    return evidence.effective_size(batch.waveform[0], found, 0)


def test_effective_size_counts_independent_pieces(linear, rng, monkeypatch):
    found, n = linear.fits[()], linear.batch.waveform[0].size
    white = rng.standard_normal(n)
    assert fake(white, linear.batch, found, monkeypatch) == pytest.approx(n, rel=0.02)  # the slack: three sigma
    coherent = np.sin(OMEGA * linear.batch.waveform[0].time)[:n] + 0.1 * white
    assert fake(coherent, linear.batch, found, monkeypatch) < 0.02 * n
    blocks = np.repeat(rng.standard_normal(n // 10 + 1), 10)[:n]
    # runs of ten equal values: 1 + 2 sum (1 - k/10)^2 = 6.7 values to a piece, known to a fifth from fifty runs
    assert fake(blocks, linear.batch, found, monkeypatch) == pytest.approx(n / 6.7, rel=0.3)


def redrawn(batch, rng, effects=()):
    """The batch with new noise on exact waveforms of its first specimen's model, to be fitted from the truth."""
    oscillator = Oscillator(MASS, effects)
    layout = search_layout(oscillator)
    vector = oscillator.pack(truth_of(effects))
    terms, own = [], []
    for item, record in zip(batch.waveform, batch.records, strict=True):
        exact, _ = item.simulate(layout.simulator, vector, AMPLITUDE, RELEASE_TIME, item.time)
        noise = record.noise / np.sqrt(item.together)
        terms.append(replace(item, values=exact + noise * rng.standard_normal(exact.size)))
        own.append([vector[0], vector[1], AMPLITUDE, RELEASE_TIME, 0.0])
    return replace(batch, waveform=tuple(terms)), np.array(own)


def search_layout(oscillator):
    from pymc_backbone.discrepancy.fitting.layout import make_layout

    return make_layout(oscillator, AMPLITUDE, OMEGA)


def test_lack_of_fit_is_calibrated_under_the_right_model(linear, rng):
    layout = search_layout(Oscillator(MASS))
    p_values, exact = [], []
    for _ in range(40):
        batch, own = redrawn(linear.batch.subset([0]), rng)
        found = fit(layout, batch.waveform, start_state(layout, np.empty(0), own))
        lack = evidence.lack_of_fit(batch, found)
        p_values.append(lack.p_value)
        degrees = sum(basis.shape[1] for _, basis in batch.waveform[0].subspace) - 5
        exact.append(float(f.sf(lack.ratio, degrees, batch.waveform[0].size - degrees - 5)))
    # forty draws: the ratio has its F distribution, and the p-value is never too small
    assert kstest(exact, "uniform").pvalue > 1e-3
    assert kstest(p_values, "uniform", alternative="greater").pvalue > 1e-3


def test_noise_that_grows_towards_low_frequencies_is_no_lack_of_fit(linear, cubic, rng):
    """Its level is that midway between the harmonics; that of all residuals (negative control) refutes the truth."""
    layout = search_layout(Oscillator(MASS))

    def coloured(size: int) -> np.ndarray:
        spectrum = rng.standard_normal(size + 1) + 1j * rng.standard_normal(size + 1)
        spectrum[1:] *= np.arange(1, size + 1) ** -0.35
        values = np.fft.irfft(spectrum, 2 * size)[:size]
        return values / values.std()

    p_values, by_all = [], []
    for _ in range(20):
        batch, own = redrawn(linear.batch.subset([0]), rng)
        term = batch.waveform[0]
        size = batch.records[0].noise / np.sqrt(term.together)
        term = replace(term, values=term.values + 1.5 * size * coloured(term.values.size))
        found = fit(layout, (term,), start_state(layout, np.empty(0), own))
        p_values.append(evidence.lack_of_fit(replace(batch, waveform=(term,)), found, is_local=True).p_value)
        by_all.append(evidence.lack_of_fit(replace(batch, waveform=(term,)), found).p_value)
    assert kstest(p_values, "uniform", alternative="greater").pvalue > 1e-3
    assert np.median(by_all) < 1e-3
    louder = tuple(
        replace(item, values=item.values + 1.5 * record.noise / np.sqrt(item.together) * coloured(item.values.size))
        for item, record in zip(cubic.batch.waveform, cubic.batch.records, strict=True)
    )
    assert evidence.lack_of_fit(replace(cubic.batch, waveform=louder), cubic.fits[()], is_local=True).p_value < 1e-12


def test_lack_of_fit_sees_a_missing_effect_whatever_the_noise_was_taken_for(cubic):
    assert evidence.lack_of_fit(cubic.batch, cubic.fits[("cubic_stiffness",)]).p_value > 1e-4
    for factor in (1.0, 0.5):
        weaker = tuple(
            replace(item, whiten=lambda columns, old=item.whiten, factor=factor: factor * old(columns))
            for item in cubic.batch.waveform
        )
        lack = evidence.lack_of_fit(replace(cubic.batch, waveform=weaker), cubic.fits[()])
        assert lack.p_value < 1e-12 and lack.ratio > 5.0
        assert 1e-3 < lack.share < 1.0


# the gap


def hand_made(gap, errors):
    """A batch and a simulation whose gap (specimen, observable, level) is known."""
    gap = np.asarray(gap, dtype=np.float64)
    names = ["frequency", "damping"][: gap.shape[1]]
    coordinates = {
        "specimen": [f"s{i}" for i in range(gap.shape[0])],
        "observable": names,
        "level": np.arange(1.0, gap.shape[2] + 1.0),
    }
    dims = ("specimen", "observable", "level")
    measured = xr.Dataset({"value": (dims, 5.0 + gap), "standard_error": (dims, np.broadcast_to(errors, gap.shape))})
    measured = measured.assign_coords(coordinates)
    simulated = xr.Dataset({"value": (dims, np.full(gap.shape, 5.0))}).assign_coords(coordinates)
    return SimpleNamespace(backbones=measured, specimens=tuple(coordinates["specimen"])), simulated


def test_mean_gap_and_its_error():
    gap = [[[0.1, 0.2, np.nan]], [[0.3, 0.2, np.nan]]]
    batch, simulated = hand_made(gap, 0.02)
    mean, error = mean_gap(batch.backbones, simulated)
    np.testing.assert_allclose(mean[0, :2], [0.2, 0.2], rtol=1e-12)
    np.testing.assert_allclose(error[0, :2], 0.02 / np.sqrt(2.0), rtol=1e-12)
    assert np.isnan(mean[0, 2])
    # from three specimens on their scatter counts, where it is the larger
    batch, simulated = hand_made([[[0.1]], [[0.3]], [[0.5]]], 0.02)
    assert mean_gap(batch.backbones, simulated)[1][0, 0] == pytest.approx(0.2 / np.sqrt(3.0))


def test_ranges_with_their_direction_and_significance():
    gap = np.zeros((2, 2, 6))
    gap[:, 0] = [0.0, 0.03, 0.08, 0.0, -0.05, -0.06]  # errors of the mean: 0.01
    gap[:, 1] = [0.021, 0.0, 0.0, 0.0, 0.0, 0.0]  # visible, but below three standard errors
    batch, simulated = hand_made(gap, 0.01 * np.sqrt(2.0))
    ranges = where_different(batch, simulated)
    assert [(r.observable, r.amplitude_low, r.amplitude_high, r.direction) for r in ranges] == [
        ("frequency", 2.0, 3.0, "above"),
        ("frequency", 5.0, 6.0, "below"),
    ]
    assert ranges[0].gap == pytest.approx(0.08) and ranges[0].unit == "Hz"
    assert ranges[0].standard_errors == pytest.approx(8.0)
    assert where_different(*hand_made(np.zeros((2, 2, 6)), 0.01)) == ()


def test_ranges_end_where_the_gap_turns():
    batch, simulated = hand_made([[[0.1, -0.1, 0.1]]], 0.01)
    assert [r.amplitude_low for r in where_different(batch, simulated)] == [1.0, 2.0, 3.0]


# held-out data


@pytest.fixture(scope="module")
def pair(cubic):
    return on_levels(cubic.batch, cubic.fits[()]), cubic.fits[("cubic_stiffness",)]


def test_held_out_levels(cubic, pair):
    before, after = pair
    held = verify.held_out_levels(cubic.batch, before, on_levels(cubic.batch, after))
    count = cubic.batch.backbones.sizes["level"]
    assert len(held.labels) == count == held.before_each.size
    assert np.isfinite(held.after_each[[0, -1]]).all()  # lowest and highest included
    # three values for each of three specimens and level, correlated along the levels
    assert 0.1 < held.after < 2.5
    assert held.before > 50.0 * held.after
    alone = verify.held_out_levels(cubic.batch, before, None)
    assert np.isnan(alone.after) and alone.before == pytest.approx(held.before, rel=1e-6)


def test_mid_lines_are_counted_from_the_zero_that_the_samples_want(cubic):
    """What is predicted is a mid-line about it: the same chi-square as where the zero is taken off what is left."""
    batch, found = cubic.batch, cubic.fits[("cubic_stiffness",)]
    own = found.state.own.copy()
    own[:, 4] = 0.01 * AMPLITUDE * np.array([1.0, -1.0, 0.5])
    off = replace(found, state=State(found.state.eta, own))
    own = own.copy()
    own[:, 4] = 0.0
    seen = about_zero(batch, off)
    there = replace(found, state=State(found.state.eta, own))
    middle = level_chi_square(seen, there)
    assert middle == pytest.approx(level_chi_square(batch, off))
    assert middle > 1.5 * level_chi_square(batch, there)
    # no drift in time moves the mid-line: without it, frequency and damping alone are held against a fit, and are
    alone = level_chi_square(seen, there, has_mid_line=False)
    assert alone == pytest.approx(level_chi_square(batch, there, has_mid_line=False), rel=1e-9)
    assert alone < level_chi_square(batch, there)
    own = own.copy()
    own[:, 0] *= 1.01
    assert level_chi_square(seen, replace(found, state=State(found.state.eta, own)), has_mid_line=False) > 30.0 * alone
    levels, row = batch.backbones["level"].values, 2
    moved = (batch.backbones["value"] - seen.backbones["value"]).values
    np.testing.assert_allclose(moved[1, row], -0.01 * AMPLITUDE / levels, rtol=1e-9)
    assert not moved[:, :row].any()
    of_rates = replace(batch, waveform=tuple(replace(term, order=2) for term in batch.waveform))
    assert not (about_zero(of_rates, off).backbones["value"] - batch.backbones["value"]).values.any()


@pytest.mark.parametrize(("is_measured", "is_moved"), [(True, True), (False, False), (False, True)])
def test_damping_is_not_compared_where_a_lost_mid_line_moves(cubic, monkeypatch, is_measured, is_moved):
    batch, found = cubic.batch, cubic.fits[("cubic_stiffness",)]
    batch = replace(batch, records=tuple(replace(item, offset_is_measured=is_measured) for item in batch.records))
    monkeypatch.setattr(verify, "has_mid_line", lambda *_: is_moved)
    _, errors = verify._measured(batch, found)
    known = np.isfinite(measured(batch)[1])
    known[:, 1] &= is_measured or not is_moved
    np.testing.assert_array_equal(np.isfinite(errors), known)


def test_the_one_specimen_that_is_left_begins_with_its_own_parameters(cubic):
    """About the middle of both it had lost its phase: held-out chi-square rose sixfold with the right law."""
    two = cubic.batch.subset([0, 1])
    search = Search(two, cubic.base, ("cubic_stiffness",), budget=cubic.budget)
    before, after = search.fit_set(()), search.fit_set(("cubic_stiffness",))
    own = after.state.own.copy()
    own[:, NUISANCES:] = [[2.0], [-1.0]]
    apart = replace(after, state=State(after.state.eta, own))
    begun = []

    def refitted(model, others, state):
        begun.append((model, others, state))
        return None

    assert verify.held_out_specimens(two, before, apart, 6, refitted) is None
    for (_, others, state), r in zip([item for item in begun if item[0] is apart], (1, 0), strict=True):
        assert others.specimens == (two.specimens[r],)
        np.testing.assert_allclose(state.own[:, NUISANCES:], 0.0, atol=1e-12)
        alone = parameters_of(after.layout, state, 0)
        np.testing.assert_allclose(alone, parameters_of(after.layout, apart.state, r), rtol=1e-12)


def test_held_out_specimens(cubic, pair):
    before, after = pair
    held = verify.held_out_specimens(cubic.batch, before, after, 6)
    assert held.labels == cubic.batch.specimens
    assert 0.1 < held.after < 2.5 and held.before > 50.0 * held.after
    assert len(verify.held_out_specimens(cubic.batch, before, after, 2).labels) == 2
    assert verify.held_out_specimens(cubic.batch.subset([0]), before, after, 6) is None


def test_a_wrong_model_does_not_pass_held_out_data(cubic, pair):
    """Negative control: an effect that is not there predicts no better than nothing."""
    wrong = cubic.fit_set(("quadratic_damping",))
    held = verify.held_out_specimens(cubic.batch, pair[0], wrong, 6)
    assert held.after > 10.0


def test_shrink_and_its_interval():
    def held(before, after):
        before, after = np.array(before), np.array(after)
        return HeldOut(float(before.mean()), float(after.mean()), ("a",) * before.size, before, after)

    specimens = held([100.0, 140.0, 90.0, 120.0], [1.0, 1.4, 0.8, 1.2])
    ratio, low, high = verify.shrink(specimens, None, 1)
    assert ratio == pytest.approx(450.0 / 4.4)
    assert low <= ratio <= high and low > 90.0 and high < 120.0  # between the smallest and largest single ratio
    assert verify.shrink(specimens, None, 1) == (ratio, low, high)
    levels = held([10.0, 10.0], [1.0, 1.0])
    assert verify.shrink(None, levels, 1)[0] == pytest.approx(10.0)
    assert np.isnan(verify.shrink(None, None, 1)).all()


def test_errors_of_prediction_cover_what_they_should(cubic):
    """At levels beyond those fitted, the prediction is off by its standard error, not by its tenth nor tenfold."""
    found = cubic.fits[("cubic_stiffness",)]
    batch = cubic.batch
    brought = on_levels(batch, found, free_effects=True)
    levels = np.asarray(batch.backbones["level"])
    errors = prediction_errors(brought, list(batch.levels), levels)
    assert errors.shape == (3, 3, levels.size) and np.all(errors[:, :2] > 0.0)
    exact = curve(found, found.layout.oscillator.pack(truth_of(("cubic_stiffness",))), levels, 0.0)[0]
    for r in range(3):
        simulated = curve(brought, brought.parameters(r), levels, 0.0)[0]
        # stiffness differs between specimens by one per cent: compare how the curves bend
        bend = (simulated / simulated.mean() - exact / exact.mean())[[0, -1]]
        assert np.all(np.abs(bend) < 6.0 * errors[r, 0, [0, -1]] / simulated.mean() + 1e-5)


def test_simulated_backbones_stand_beside_the_measured(cubic):
    simulated = simulate(cubic.batch, cubic.fits[("cubic_stiffness",)])
    assert simulated["value"].shape == cubic.batch.backbones["value"].shape
    error = np.asarray(cubic.batch.backbones["standard_error"])
    gap = (np.asarray(cubic.batch.backbones["value"]) - np.asarray(simulated["value"])) / error
    assert np.nanmean(gap[:, :2] ** 2) < 5.0  # the backbones' errors, and stiffness from the waveforms


# what is asked


@pytest.mark.parametrize(("factor", "is_one_batch"), [(1.3, True), (1.8, False)])
def test_structures_that_are_not_alike_are_no_batch(factor, is_one_batch):
    rng, records = np.random.default_rng(2), []
    for k, ratio in enumerate((1.0, 1.02, factor)):
        truth = truth_of(())
        truth["linear_stiffness"] *= ratio**2
        exact = free_decay(force_of((), truth), AMPLITUDE, TIME - RELEASE_TIME)
        records.append(noisy(rng, f"part {k}", TIME, exact))
    backbones = batch_of(records).backbones
    if is_one_batch:
        check_one_batch(backbones)
        return
    message = r"not of one batch: at an amplitude of \S+ m part 1 moves at 5\.\d+ Hz and part 2 at (8\.9|9)"
    with pytest.raises(InputError, match=message):
        check_one_batch(backbones)
    # where it sinks into the noise its frequency is none
    unknown = backbones["specimen"] == "part 2"
    error = backbones["standard_error"]
    check_one_batch(backbones.assign(standard_error=error.where(~unknown, 0.3 * backbones["value"])))


@pytest.mark.parametrize("is_one_mode", [True, False])
def test_records_of_different_modes_are_no_batch(is_one_mode):
    """One hit excites the higher mode more than another hit does; each record holds both."""
    rng, records = np.random.default_rng(3), []
    for k, (low, high) in enumerate(((1.0, 0.2), (1.0, 0.2) if is_one_mode else (0.3, 1.0))):
        modes = zip((low, high), (FREQUENCY, 2.3 * FREQUENCY), (0.8, 1.1), strict=True)
        exact = sum(a * AMPLITUDE * np.exp(-c * TIME) * np.cos(2.0 * np.pi * f * TIME) for a, f, c in modes)
        records.append(condition(noisy(rng, f"part {k}", TIME, exact, 60.0)))
    if is_one_mode:
        check_one_mode(records)
        return
    message = (
        r"modes: part 1 that at 11\.\d+ Hz, part 0 that at 5 Hz.*`band=\(3\.5, 6\.\d+\)` or `band=\(8\.\d+, 15\.\d\)`"
    )
    with pytest.raises(InputError, match=message):
        check_one_mode(records)


# rivals


def test_a_drift_is_not_taken_for_an_effect(random_seed):
    batch = batch_of(drifting_records(np.random.default_rng(random_seed), 0.01))
    search = search_of(batch)
    found = rivals.drifting_sets(search)
    drifting = found[()].fit
    # stiffness up by 1 %: frequency by half a per cent over the record; one unit of drift stands for 5 %
    np.testing.assert_allclose(drifting.state.own[:, 5], 0.1, rtol=0.1)
    assert drifting.cost < min(item.cost for item in search.fits.values())
    decision = decide(search, found, {})
    assert decision.verdict == "unexplained" and decision.drift_probability > 0.9
    assert not rivals.drift_check(drifting, decision.drift_probability, True).passed


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_a_unit_of_drifting_damping_is_half_of_the_damping_in_a_short_record(random_seed, share):
    """However little the record decays: a unit that is the same in all would be more than all its damping."""
    change = 0.4
    records = drifting_records(np.random.default_rng(random_seed), 0.0, 1, damping=(share, change))
    batch = batch_of(records)
    fades = np.array([term.fade for term in batch.waveform])
    np.testing.assert_array_equal(fades, [term.fade for term in batch.turning])
    found = drift_fits.drift_fit(batch, make_layout(Oscillator(MASS), AMPLITUDE, OMEGA), batch_start(batch))
    length = TIME[-1] - RELEASE_TIME
    lost = share * DAMPING / (2.0 * MASS) * length  # of the logarithm of the amplitude, without the drift
    np.testing.assert_allclose(fades, np.minimum(0.5 * lost * (1.0 + 0.5 * change), 1.0), rtol=0.15)  # less a cycle
    drifts = found.state.own[:, 6]
    errors = np.sqrt(found.own_covariance[:, 6])
    assert (np.abs(drifts - change * lost / fades * (1.0 - errors**2)) < 4.0 * errors).all()
    assert (errors < 0.5).all()


def batch_start(batch):
    layout = make_layout(Oscillator(MASS), AMPLITUDE, OMEGA)
    return start_state(layout, np.zeros(0), batch.own)


def test_backbones_agree_with_a_spring_whose_stiffness_drifts(random_seed):
    batch = batch_of(drifting_records(np.random.default_rng(random_seed), 0.01, cubic=0.1))
    search = search_of(batch)
    cubic = search.fit_set(("cubic_stiffness",))
    drifting = drift_fits.drift_fit(batch, cubic.layout, cubic.state)
    assert level_chi_square(batch, drifting) < 3.0
    still = replace(drifting, state=replace(drifting.state, own=drifting.state.own.copy()))
    still.state.own[:, 5:7] = 0.0
    assert level_chi_square(batch, still) > 30.0


@pytest.mark.parametrize(("share", "is_asked"), [(0.2, True), (0.8, False)])
def test_backbones_are_asked_beside_drifts_where_a_drift_explains_half(cubic, monkeypatch, share, is_asked):
    asked = []
    search = Search(cubic.batch, Oscillator(MASS), ("coulomb_friction",), 1)
    search.run()
    base = search.fits[()]
    drifting = replace(base, chi_square=share * base.chi_square, penalty=share * base.penalty)
    monkeypatch.setattr(rivals, "drift_fit", lambda *_, **__: drifting)
    monkeypatch.setattr(drift_fits, "drift_bonus", lambda *_: 0.0)
    monkeypatch.setattr(rivals, "settled", lambda *_: None)
    monkeypatch.setattr(rivals, "_ask_backbones", lambda _, found: asked.append(list(found)))
    rivals.drifting_sets(search)
    assert bool(asked) == is_asked


@pytest.mark.parametrize(("strength", "gap"), [(0.2, 0.4), (1.8, 0.55)])
def test_a_stop_on_one_side_is_asked_where_a_play_off_the_middle_is_the_best(strength, gap):
    """Its other side is not reached: both are variants of the same play and say the same; the simpler one is kept."""
    rng, model = np.random.default_rng(7), Oscillator(MASS, ["one_sided_stiffness"])
    truth = truth_of(()) | {"stop_stiffness": strength * STIFFNESS, "stop_gap": gap * AMPLITUDE}
    vector, records = [truth[name] for name in model.parameter_names], []
    for release in (AMPLITUDE, 0.8 * AMPLITUDE):
        exact = simulate_waveform(model, vector, TIME - RELEASE_TIME, release).displacement
        records.append(noisy(rng, f"from {release}", TIME, np.where(TIME < RELEASE_TIME, release, exact)))
    search = Search(
        batch_of(records), Oscillator(MASS), ("freeplay",), 1, variants=("offset_freeplay", "one_sided_stiffness")
    )
    for names in ((), ("freeplay",), ("offset_freeplay",)):
        search.fit_set(names)
    assert search.best() == ("offset_freeplay",) and search.explains(search.fits[search.best()])
    play = search.fits[("offset_freeplay",)]
    search._vary()
    assert search.fits[("one_sided_stiffness",)].cost < play.cost + 1.0
    assert LIBRARY["offset_freeplay"].reduces_to == ("one_sided_stiffness",)
    assert ("offset_freeplay",) not in search.fits and search.best() == ("one_sided_stiffness",)


def test_a_look_that_was_lost_among_many_is_repeated_alone(cubic):
    """What was not simulated among hundreds of sets ended far off: its own look brings it to what it explains."""
    search = Search(cubic.batch, Oscillator(MASS), CANDIDATES, 1, variants=("power_stiffness",))
    names = ("power_stiffness",)
    known = next(item for item in search.proposals.values() if item.names == names)
    lost = replace(
        known, is_exact=False, chi_square=1e6 * known.chi_square, starts=((1e9, 0.0 * known.eta, known.own),)
    )
    search.proposals[names] = lost
    search.fit_set(("cubic_stiffness",))
    search._fit_varied(names)
    assert search._proposal(names).is_exact and search._proposal(names).chi_square < 2.0 * known.chi_square + 10.0
    assert search.fits[names].cost < search.fits[("cubic_stiffness",)].cost + 5.0
    # negative control: what was simulated is taken at its word
    search = Search(cubic.batch, Oscillator(MASS), CANDIDATES, 1, variants=("power_stiffness",))
    search.proposals[names] = replace(lost, is_exact=True)
    search.fit_set(("cubic_stiffness",))
    search._fit_varied(names)
    assert names not in search.varied


@pytest.mark.parametrize("is_likelier", [True, False])
def test_a_drift_is_asked_although_a_set_explains_the_records(monkeypatch, is_likelier):
    """Once a few sets were followed; where it is likelier than these few more are, and nothing that costs much."""
    batch = batch_of(drifting_records(np.random.default_rng(3), 0.1))
    candidates = ("bilinear_stiffness", *CANDIDATES, "freeplay", "jenkins", "quadratic_stiffness", "quintic_stiffness")
    asked: list[int] = []

    def alone(search):
        asked.append(len(search.fits) - 1)
        return drift_fits.drift_alone(search) if is_likelier else None

    search = Search(batch, Oscillator(MASS), candidates, 2, is_drifting=alone)
    search.fit_set(())
    monkeypatch.setattr(Search, "_is_explained", lambda self: len(self.fits) > 1)
    search._follow_backbones(24)
    assert 3 <= asked[0] <= 5 and len(asked) == 1  # not before, two at a time are followed
    assert (len(search.fits) - 1 <= FEW_FOLLOWED + 1) == is_likelier
    assert search.is_told == is_likelier


def test_beside_a_drift_that_explains_the_records_no_law_that_remembers_is_asked():
    batch = batch_of(drifting_records(np.random.default_rng(3), 0.1))
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness", "jenkins"), 2)
    search.fit_set(())
    best = ("cubic_stiffness", "jenkins")
    assert rivals._is_simple(search, ("jenkins",), best) and rivals._is_simple(search, ("cubic_stiffness",), best)
    search.drift_alone = drift_fits.drift_alone(search)
    assert search.is_told
    assert not rivals._is_simple(search, ("jenkins",), best) and rivals._is_simple(search, ("cubic_stiffness",), best)


def test_a_drift_that_explains_the_records_by_itself_ends_the_search_early():
    """Of records whose stiffness changes many laws come near, each at the price of a long fit."""
    batch = batch_of(drifting_records(np.random.default_rng(3), 0.1))
    candidates = ("bilinear_stiffness", *CANDIDATES, "freeplay", "iwan", "quadratic_stiffness", "quintic_stiffness")
    told = Search(batch, Oscillator(MASS), candidates, 2, is_drifting=drift_fits.drift_alone)
    told.run()
    assert told.is_told and not told._is_explained()
    assert not any(told._is_costly(names) for names in told.fits)
    spent = told.descent.effort
    found = rivals.drifting_sets(told)
    assert evidence.leaves_noise(batch, found[()].fit)
    begun, known = told.descent.effort, len(told.fits)
    told.resume()  # as where a drift beside the base turns out not to be enough
    assert not told.is_told and len(told.fits) > known
    assert spent < 0.5 * (spent + told.descent.effort - begun)  # of what the whole search takes


@pytest.mark.parametrize("change", [0.06, -0.06])
def test_a_drift_that_settles_is_told_with_its_time(change):
    """A stiffness that settles with a third of the record: no steady drift, and no spring, explains that."""
    batch = batch_of(drifting_records(np.random.default_rng(4), change, settling=3.0))
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness", "quintic_stiffness"), 2)
    base = search.fit_set(())
    steady = drift_fits.drift_fit(batch, base.layout, base.state)
    assert steady is not None and not evidence.leaves_noise(batch, steady)
    found = drift_fits.drift_alone(search)
    assert found is not None and evidence.leaves_noise(search.batch, found.fit)
    length = TIME[-1] - RELEASE_TIME
    assert search.batch.settling_time == pytest.approx(length / 3.0, rel=0.15)
    frequency = DRIFT * found.fit.state.own[:, DRIFTS[0]]
    # counted from the release, which is fitted half a cycle after that of the structure: some of it is over by then
    own, settles = found.fit.state.own, search.batch.settling_time
    over = np.exp(-(own[:, RELEASE_INSTANT] - RELEASE_TIME) / settles)
    np.testing.assert_allclose(frequency, 0.5 * change * over, rtol=0.02)
    message = rivals.drift_check(found.fit, 1.0, False, found.fit, settling=search.batch.settling_time).message
    sign = "+" if change > 0.0 else "-"
    assert re.search(
        rf"frequency drifts with time \(by \{sign}[23]\.?\d? % over a record, settling with a time constant of [^;]*; "
        r"damping by at most [2-4]\.?\d? %\)",
        message,
    )
    known = Undisturbed(Question(Oscillator(MASS), batch, ("cubic_stiffness",), (), (), {}, 2, {}, ()), search)
    asked = with_drifts(known, rivals.drifting_sets)
    assert asked.question.batch is search.batch and asked.is_drifting


@pytest.mark.parametrize(
    ("power", "share", "is_of_time"),
    [(0.0, 0.2, True), (2.0, 0.3, False), (3.0, 0.2, False), (0.0, 2.0, False), (-1.0, 0.6, False)],
)
def test_what_settles_is_a_drift_where_releases_say_so(power, share, is_of_time):
    """Drifts that differ by a tenth; a law of that power of the amplitude would settle as fast, over a fall by 1.6.

    What hardly settles is as a law of a small power, which these releases do not tell from none.
    """
    releases = np.array([1.0, 0.7, 0.95, 0.6])
    sizes = 0.3 * releases**power * np.array([1.1, 0.95, 1.05, 0.9])
    own, covariance = np.zeros((4, 7)), np.zeros((4, 7))
    own[:, DRIFTS[0]], covariance[:, DRIFTS[0]] = sizes, 1e-8
    turning = [
        SimpleNamespace(values=top * np.exp(-np.linspace(0.0, 1.6, 40)) * (-1.0) ** np.arange(40)) for top in releases
    ]
    fitted = SimpleNamespace(state=SimpleNamespace(own=own), own_covariance=covariance)
    assert drift_fits._is_of_time(SimpleNamespace(turning=turning), fitted, share) is is_of_time
    alike = SimpleNamespace(turning=turning[:1] * 4)
    assert not drift_fits._is_of_time(alike, fitted, share)


def settling_records(rng, released):
    """Records of specimens from other amplitudes, whose stiffness settles by 2 % with two thirds of the record."""
    records = []
    for factor in released:
        (record,) = drifting_records(rng, 0.02 * rng.uniform(0.95, 1.05), 1, settling=1.5)
        values = factor * record.values + 0.001 * AMPLITUDE * rng.standard_normal(record.values.size)
        records.append(replace(record, specimen=f"from {factor}", values=values))
    return records


def test_a_drift_that_settles_is_likelier_than_a_law_of_which_specimens_differ():
    """A law of a small power of the amplitude explains it to the noise, of other strength the lower the release."""
    batch = batch_of(settling_records(np.random.default_rng(5), (1.0, 0.8, 0.65, 0.5)))
    search = Search(batch, Oscillator(MASS), ("power_stiffness", "coulomb_friction"), 1)
    search.run()
    assert search.best() == ("power_stiffness",) and evidence.leaves_noise(batch, search.fits[search.best()])
    assert drift_fits.drift_alone(search) is None and search.batch is batch  # releases alone do not say so
    found = rivals.drifting_sets(search)
    assert search.batch.settling_time == pytest.approx((TIME[-1] - RELEASE_TIME) / 1.5, rel=0.1)
    assert search.batch.settling_odds < np.log(0.25)
    decision = decide(search, found, {})
    assert decision.verdict == "unexplained" and decision.drift_probability > 0.9


@pytest.mark.parametrize("released", [(1.0, 1.0, 1.0), (1.0, 0.8, 0.6)])
def test_a_law_is_likelier_than_a_drift_that_settles_as_fast(released):
    """Of equal releases a drift leaves as little; that its time constant is just so has to be worth something."""
    rng, records = np.random.default_rng(6), []
    for k, factor in enumerate(released):
        truth = truth_of(("cubic_stiffness",))
        truth["linear_stiffness"] *= 1.0 + 0.01 * rng.standard_normal()
        exact = free_decay(force_of(("cubic_stiffness",), truth), factor * AMPLITUDE, TIME - RELEASE_TIME)
        records.append(noisy(rng, f"specimen {k}", TIME, exact))
    search = Search(batch_of(records), Oscillator(MASS), ("cubic_stiffness", "coulomb_friction"), 1)
    search.run()
    found = rivals.drifting_sets(search)
    assert search.batch.settling_time == np.inf
    decision = decide(search, found, {})
    assert decision.verdict == "found" and decision.best == ("cubic_stiffness",)


def test_a_steady_drift_is_not_told_to_settle():
    search = Search(batch_of(drifting_records(np.random.default_rng(4), 0.03)), Oscillator(MASS), ("iwan",), 1)
    search.fit_set(())
    assert drift_fits.drift_alone(search) is not None
    assert search.batch.settling_time == np.inf


@pytest.mark.parametrize("order", [0, 1, 2])
def test_derivatives_beside_a_drift_that_settles_are_those_of_differences(order):
    """Of both data terms, by the drifts; a settling that is as good as none is a steady drift."""
    times = np.linspace(0.0, 1.0, 2001)
    nuisances = np.array([1.0, 0.05, 0.0, 0.7, 0.3])
    for settling in (0.0, 2.0, 40.0):
        course = course_of(times, nuisances, order, 1.0, settling)
        step = 1e-6
        pace = 1.0 + np.gradient(course.later, times, edge_order=2)
        there = covered(np.maximum(times - nuisances[1], 0.0), settling)
        np.testing.assert_allclose(pace[1:-1] ** 2, 1.0 + 2.0 * 0.7 * DRIFT * there[1:-1], atol=2e-3)
        more, less = nuisances.copy(), nuisances.copy()
        more[3] += step
        less[3] -= step
        up, down = (course_of(times, item, order, 1.0, settling).factor for item in (more, less))
        slope = (np.log(up) - np.log(down)) / (2.0 * step)
        np.testing.assert_allclose(course.hastened, slope, atol=1e-8)
    steady, slow = (course_of(times, nuisances, order, 1.0, settling) for settling in (0.0, 1e-6))
    np.testing.assert_allclose(slow.later, steady.later, rtol=1e-4, atol=1e-12)
    assert covered(np.array([0.0, 1.0]), 3.0).tolist() == [0.0, 1.0]


def test_a_drift_is_not_enough_where_an_effect_is_missing(cubic):
    search = Search(cubic.batch, Oscillator(MASS), CANDIDATES, 1, is_drifting=drift_fits.drift_alone)
    search.run()
    assert not search.is_told and search.best() == ("cubic_stiffness",)
    assert drift_fits.drift_alone(search) is None


def test_no_drift_is_seen_where_there_is_none(cubic):
    found = rivals.drifting_sets(cubic)
    assert list(found) == [()]  # a single effect leaves noise: nothing for a drift to explain beside it
    drifting = found[()].fit
    assert drifting.cost > 2.0 * cubic.fits[("cubic_stiffness",)].cost
    decision = decide(cubic, found, {})
    assert decision.verdict == "found" and decision.best == ("cubic_stiffness",)
    assert decision.drift_probability < 0.02
    assert rivals.drift_check(drifting, decision.drift_probability, True).passed
    assert rivals.drift_check(None, 0.0, True).passed


@pytest.mark.parametrize("frequency", [3.1, 7.3, 12.7, 10.5, 14.5])  # the last two within three bins of a harmonic
def test_a_second_mode_is_seen(frequency, rng):
    records = make_records(rng, ())
    beating = decaying_sinusoid(0.08 * AMPLITUDE, frequency)
    batch = batch_of([replace(record, values=record.values + beating) for record in records])
    search = Search(batch, Oscillator(MASS), CANDIDATES, 1)
    search.fit_set(())
    check = second_mode_check(batch, search.fits[()])
    assert not check.passed
    said = float(check.message.split(" Hz")[0].split()[-1])
    assert said == pytest.approx(frequency, abs=0.3)  # a bin of a record of five seconds is 0.2 Hz wide


@pytest.mark.parametrize(("left", "seen"), [(3.0, True), (1.0, False)])
def test_a_mode_that_is_gone_long_before_the_motion_is_seen_where_it_was(left, seen, linear, monkeypatch, rng):
    """Below 2 % of the motion it counts where the model leaves more than noise: something has to be there."""
    time = np.arange(3000) / (30.0 * 5.0)  # a hundred cycles
    values = np.exp(-0.1 * time) * np.cos(OMEGA * time)
    line = 0.03 * np.exp(-time / 1.2) * np.sin(1.46 * OMEGA * time)
    monkeypatch.setattr(evidence, "residuals_of", lambda *_: line + 3e-4 * rng.standard_normal(time.size))
    term = replace(linear.batch.waveform[0], time=time, values=values, size=time.size)
    batch = replace(linear.batch.subset([0]), waveform=(term,))
    best = SimpleNamespace(chi_square=[left * term.size])
    named = second_mode_check(batch, best)
    assert named.passed  # beside a name it is no reason to doubt that, and is told where it is looked for
    assert ("too small to speak against" in named.message) == seen
    check = second_mode_check(batch, best, is_bare=True)
    assert check.passed != seen
    if seen:
        assert float(check.message.split(" Hz")[0].split()[-1]) == pytest.approx(7.3, rel=0.03)


@pytest.mark.parametrize(("left", "passes"), [(3.0, False), (1.0, True)])
def test_a_mode_that_decays_soon_is_seen_beside_a_name_that_leaves_more(left, passes, linear, monkeypatch, rng):
    """Over the whole record its tenth of the motion is less than 2 %: the beginning tells."""
    time = np.arange(3000) / (30.0 * 5.0)
    values = np.exp(-0.1 * time) * np.cos(OMEGA * time)
    line = 0.1 * np.exp(-time / 0.8) * np.cos(2.7 * OMEGA * time)
    monkeypatch.setattr(evidence, "residuals_of", lambda *_: line + 3e-4 * rng.standard_normal(time.size))
    term = replace(linear.batch.waveform[0], time=time, values=values, size=time.size)
    batch = replace(linear.batch.subset([0]), waveform=(term,))
    check = second_mode_check(batch, SimpleNamespace(chi_square=[left * term.size]))
    assert check.passed is passes
    if not passes:
        assert float(check.message.split(" Hz")[0].split()[-1]) == pytest.approx(13.5, rel=0.03)


@pytest.mark.parametrize(("orders", "is_told"), [((2.7, 0.0, 0.0), False), ((2.7, 2.72, 0.0), True)])
def test_what_goes_on_moving_a_structure_leaves_lines_that_come_and_go(orders, is_told, linear, monkeypatch, rng):
    """A band of noise about the mode has a highest bin in each record, and another mode is at one place in most."""
    time = np.arange(3000) / (30.0 * 5.0)
    values = np.exp(-0.1 * time) * np.cos(OMEGA * time)
    lines = [0.05 * values.std() * np.cos(order * OMEGA * time) * (order > 0.0) for order in orders]
    noise = [3e-4 * rng.standard_normal(time.size) for _ in orders]
    left = [line + item for line, item in zip(lines, noise, strict=True)]
    monkeypatch.setattr(evidence, "residuals_of", lambda _term, _best, r: left[r])
    terms = [replace(linear.batch.waveform[0], time=time, values=values, size=time.size) for _ in orders]
    batch = linear.batch.subset([0] * len(orders))
    batch = replace(batch, waveform=tuple(terms))
    best = SimpleNamespace(chi_square=[3.0 * time.size] * len(orders))
    assert not second_mode_check(batch, best).passed
    check = second_mode_check(batch, best, is_moved=True)
    assert check.passed is not is_told and "13.5 Hz" in check.message.replace("13.6", "13.5")


@pytest.mark.parametrize(("ratio", "share", "passes"), [(0.6, 0.015, False), (0.6, 0.007, True), (1.6, 0.015, True)])
def test_a_smaller_line_counts_below_the_frequency_of_the_mode(ratio, share, passes, linear, monkeypatch, rng):
    """As that of a liquid that moves along; above, a percent may be anything."""
    time = np.arange(3000) / (30.0 * 5.0)
    values = np.exp(-0.1 * time) * np.cos(OMEGA * time)
    motion = np.sqrt(2.0) * values.std()
    line = share * motion * np.sin(ratio * OMEGA * time)
    monkeypatch.setattr(evidence, "residuals_of", lambda *_: line + 3e-3 * rng.standard_normal(time.size))
    term = replace(linear.batch.waveform[0], time=time, values=values, size=time.size)
    batch = replace(linear.batch.subset([0]), waveform=(term,))
    best = SimpleNamespace(chi_square=[1.0 * term.size])
    check = second_mode_check(batch, best)
    assert check.passed == passes
    # where nothing would be said to be missing, half as much below the mode is enough, though it hides in the noise
    assert second_mode_check(batch, best, is_bare=True).passed == (ratio > 1.0)
    if not passes:
        assert float(check.message.split(" Hz")[0].split()[-1]) == pytest.approx(3.0, rel=0.01)


def test_a_zero_that_wanders_holds_no_line(rng):
    """Noise that falls with the square of the frequency is highest in the first bins, which have no neighbours."""
    time = np.arange(2400) / 40.0
    false = 0
    for _ in range(40):
        walk = np.cumsum(rng.standard_normal(time.size))
        false += line_beside(time, walk - walk.mean() + 5.0 * rng.standard_normal(time.size), (1.0, 1.0)).height > 0.0
    assert false <= 2
    slow = np.cos(2.0 * np.pi * 0.2 * time) + 0.05 * rng.standard_normal(time.size)
    assert line_beside(time, slow, (1.0, 1.0)).height == 0.0
    assert line_beside(time, slow, (0.5, 0.5)).frequency == pytest.approx(
        0.2, abs=0.01
    )  # no more than three times slower


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.9])
def test_noise_with_a_colour_holds_no_line(correlation, rng):
    time = np.arange(2400) / 40.0
    begun = np.exp(-time / 40.0)
    seen, false = 0, 0
    for _ in range(40):
        noise = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], rng.standard_normal(3000))[600:]
        false += line_beside(time, noise, (1.0, 1.0)).height > 0.0
        false += line_near(time, noise, (0.99, 1.0)).height > 0.0
        line = line_beside(time, noise + 0.8 * begun * np.cos(2.0 * np.pi * 3.4 * time), (1.0, 1.0))
        seen += abs(line.frequency - 3.4) < 0.02
    assert false <= 3 and seen >= 32


def test_the_harmonics_of_a_motion_that_comes_to_rest_at_another_frequency_are_no_line(rng):
    """As in a clearance: the frequency falls to 0.6 Hz, where it stays for half of the record."""
    time = np.arange(4000) / 40.0
    frequency = 0.6 + 0.4 * np.clip(1.0 - time / 50.0, 0.0, None)
    phase = 2.0 * np.pi * np.cumsum(frequency) / 40.0
    left = 0.05 * rng.standard_normal(time.size) + sum(np.cos(k * phase) / k for k in (2, 3))
    assert line_beside(time, left, (0.6, 1.0)).height == 0.0
    assert line_beside(time, left, (0.8, 0.8)).frequency == pytest.approx(1.2, abs=0.02)  # by its mean alone, one is
    beating = line_beside(time, left + 0.3 * np.cos(2.0 * np.pi * 1.1 * time), (0.6, 1.0))
    assert beating.frequency == pytest.approx(1.1, abs=0.02)


def test_no_second_mode_is_seen_in_noise_and_harmonics(cubic, linear):
    named = second_mode_check(cubic.batch, cubic.fits[("cubic_stiffness",)])
    assert named.passed and "times the noise" not in named.message
    assert second_mode_check(linear.batch, linear.fits[()]).passed
    assert second_mode_check(linear.batch, linear.fits[()], is_bare=True).passed


@pytest.mark.parametrize("name", ["softer on one side", "hardening by a third"])
def test_harmonics_that_a_model_lacks_are_no_second_mode(name, rng):
    """Springs whose frequency sweeps by per cents, against the linear model: large and broad harmonics."""
    even, odd = (0.35, 0.3) if name == "softer on one side" else (0.0, 0.35)

    def force(x: float, v: float, _: float) -> float:
        u = x / AMPLITUDE
        return STIFFNESS * AMPLITUDE * (u + even * u * u + odd * u**3) + DAMPING * v

    decays = [free_decay(force, AMPLITUDE * share, TIME - RELEASE_TIME) for share in (1.0, 0.7)]
    batch = batch_of([noisy(rng, f"specimen {r + 1}", TIME, decay, 55.0) for r, decay in enumerate(decays)])
    search = Search(batch, Oscillator(MASS), CANDIDATES, 1)
    base = search.fit_set(())
    assert base.cost > 100.0 * search.count
    check = second_mode_check(batch, base)
    assert check.passed and second_mode_check(batch, base, is_bare=True).passed
    assert "times the noise" in check.message and "is not told" in check.message


def test_specimens_alike_or_not(cubic, linear, rng):
    assert data_checks.alike_check(cubic.batch, cubic.fits[("cubic_stiffness",)]).passed
    assert data_checks.alike_check(linear.batch.subset([0]), linear.fits[()]).message.startswith("one specimen")
    swapped = replace(linear.batch, backbones=linear.batch.backbones.isel(observable=[1, 0, 2]))
    # the frequency is meant, wherever it stands
    assert data_checks.alike_check(swapped, linear.fits[()]) == data_checks.alike_check(linear.batch, linear.fits[()])
    records = make_records(rng, ("cubic_stiffness",), specimens=2)
    odd = make_records(rng, ("cubic_stiffness",), specimens=1, share=2.2)[0]
    batch = batch_of([*records, replace(odd, specimen="odd one")])
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness",), 1)
    search.fit_set(())
    found = search.fit_set(("cubic_stiffness",))
    check = data_checks.alike_check(batch, found)
    assert not check.passed and check.message.startswith("odd one needs an effect")


def test_records_that_grow_again_are_told_where_no_set_leaves_noise(cubic):
    """As where two modes beat; of a batch whose decays are followed by another release, the decays are free."""
    names, count = ("cubic_stiffness",), len(cubic.batch.records)
    growing = tuple(replace(record, grows_again=True) for record in cubic.batch.records)
    batch = replace(cubic.batch, records=growing)
    base, found = cubic.fits[()], cubic.fits[names]
    check = data_checks.one_decay_check(batch, base)
    assert not check.passed and check.message.startswith(f"{count} of {count} records grow again")
    assert data_checks.one_decay_check(batch, found).passed
    assert not data_checks.one_decay_check(batch, found, is_exact=False).passed
    assert data_checks.one_decay_check(cubic.batch, base).passed
    few = replace(batch, records=(growing[0], *cubic.batch.records[1:]))
    assert data_checks.one_decay_check(few, base).passed == (count > 1)
    # what goes on moving the structures makes them grow, and is told itself
    moved = data_checks.one_decay_check(batch, base, is_moved=True)
    assert moved.passed and moved.message.startswith(f"{count} of {count} records grow again")


def test_one_of_specimens_that_scatter_widely_is_no_outlier(rng):
    """How often the worst of some is told to be off, by the batch's own scatter and what was expected of it."""

    def told(values):
        apart = values - values.mean()
        worst = int(np.argmax(np.abs(apart)))
        return abs(apart[worst]) > 0.4 and data_checks._is_outlier(apart, worst, 0.1)

    for count in (5, 8, 20):  # of three, two say little of a scatter that was not expected
        wide = np.mean([told(rng.normal(0.0, 0.2, count)) for _ in range(400)])
        odd = np.mean([told(np.append(rng.normal(0.0, 0.05, count - 1), 0.9)) for _ in range(400)])
        assert wide < 0.09 and odd > 0.9, (count, wide, odd)


def test_data_terms_agree_or_not(cubic):
    assert data_checks.data_terms_check(cubic.batch, 1.2, 5.0).passed
    assert not data_checks.data_terms_check(cubic.batch, 12.0, 5.0).passed
    assert not data_checks.data_terms_check(cubic.batch, float("nan"), 5.0).passed
    # a hundredth of what the base leaves is as good as nothing, a tenth where no law is exact
    for share, is_exact, passes in [(0.009, True, True), (0.03, True, False), (0.03, False, True), (0.3, False, False)]:
        check = data_checks.data_terms_check(cubic.batch, 1e6 * share**2, 5.0, before=1e6, is_exact=is_exact)
        assert check.passed == passes
        assert (f"{100.0 * share:.2g} %" in check.message) == passes
        assert ("none of the library" in check.message) == (not passes and not is_exact)
    assert not data_checks.data_terms_check(cubic.batch, float("nan"), 5.0, before=1e6).passed


# the search itself


def test_every_set_is_kept_and_a_base_may_hold_effects():
    batch = batch_of(make_records(np.random.default_rng(31), ("cubic_stiffness", "coulomb_friction")))
    search = search_of(batch, ("coulomb_friction", "quadratic_damping"), base=("cubic_stiffness",))
    assert {(), ("coulomb_friction",), ("quadratic_damping",)} <= set(search.fits) | set(search.proposals)
    assert search.best() == ("coulomb_friction",)
    assert search.reduced(search.fits[("coulomb_friction",)]) == pytest.approx(1.0, abs=0.1)
    layout = search.layout(("coulomb_friction",))
    assert "cubic_stiffness" in layout.names and "friction_force" in layout.names


def test_a_base_begins_from_further_starts_only_until_two_agree(cubic, monkeypatch):
    """Friction that is not there finds its way to zero from every start."""
    search = Search(cubic.batch, Oscillator(MASS, ("cubic_stiffness", "coulomb_friction")), ("quadratic_damping",), 1)
    begun = []
    reached = search.descent.from_afar
    monkeypatch.setattr(search.descent, "from_afar", lambda *a, **k: begun.append(reached(*a, **k)) or begun[-1])
    search.fit_set(())
    assert len(begun) <= 2 and search.explains(search.fits[()])
    lacking = Search(cubic.batch, Oscillator(MASS, ("coulomb_friction",)), ("quadratic_damping",), 1)
    lacking.fit_set(())
    ended = [
        reached(
            lacking.layout(()), lacking.descent.released(lacking.layout(()), np.array([scale]), cubic.batch.own[:, :2])
        )
        for scale in (0.0, 0.05 * starts.typical(lacking.layout(()))[0], starts.typical(lacking.layout(()))[0])
    ]
    assert lacking.fits[()].cost < min(item.cost for item in ended) + 1.0


def test_search_over_backbones_alone():
    batch = batch_of(make_records(np.random.default_rng(32), ("cubic_stiffness",)))
    from pymc_backbone.discrepancy.fitting.batch import batch_of_backbones

    search = search_of(batch_of_backbones(MASS, batch.backbones))
    assert not search.batch.has_records and search.best() == ("cubic_stiffness",)
    assert drift_fits.drift_fit(search.batch, search.fits[()].layout, search.fits[()].state) is None


def test_a_search_ends_when_its_budget_does(cubic):
    search = Search(cubic.batch, Oscillator(MASS), CANDIDATES, 2, budget=0.0)
    search.run()
    # the base may take all the effort: the likeliest sets are fitted whatever it took
    assert search.is_cut and set(search.fits) == {(), next(iter(search.proposals))}  # what adds to this is left aside
    assert {(name,) for name in CANDIDATES} < set(search.proposals)  # what the backbones say of all stays


def test_a_few_simple_sets_follow_although_a_costly_one_took_the_effort(cubic):
    search = Search(cubic.batch, Oscillator(MASS), (*CANDIDATES, "bouc_wen"), 2, budget=10.0)
    assert search._is_affordable(("bouc_wen",)) and not search.is_cut
    search.descent.effort = 11.0
    assert not search._is_affordable(("bouc_wen",)) and search.is_cut
    assert [search._is_affordable(("cubic_stiffness",)) for _ in range(8)] == [True] * 6 + [False] * 2


def test_deciding_does_not_need_all_subsets_to_be_fitted(cubic):
    """A set found by replacement may have subsets that were never fitted; the tolerance asks for them."""
    search = Search(cubic.batch, Oscillator(MASS), CANDIDATES, 2)
    for names in ((), ("coulomb_friction",), ("quadratic_damping",), ("coulomb_friction", "quadratic_damping")):
        search.fit_set(names)
    search.fit_set(("coulomb_friction", "cubic_stiffness"))
    assert ("cubic_stiffness",) not in search.fits
    decision = decide(search, {}, {"frequency": 0.001, "damping": 0.03, "waveform": 0.003})
    assert set(search.fits) == set(decision.probabilities) == set(decision.evidences)


@pytest.mark.parametrize("name", [name for name in LIBRARY if name not in ("linear_stiffness", "viscous_damping")])
def test_every_effect_of_the_library_can_be_started_from(name, linear):
    layout = linear.layout((name,))
    where = starts.positions(layout, name)
    assert where[0] == 0 and len(where) == layout.free.size
    for point in starts.grid(layout, name, (0.02, 0.3)):
        assert np.all(point >= layout.low[where]) and np.all(point <= layout.high[where]) and point[0] != 0.0
    promised = starts.by_score(layout, name, linear.fits[()], linear.batch)
    assert promised and promised[0][0] >= promised[-1][0] >= 0.0
    # nothing is missing: what one effect of some shape promises is noise, chi-square with at most a few degrees
    assert promised[0][0] < 40.0


def test_what_adds_nothing_ends_where_the_smaller_set_did(cubic):
    """A larger set holds the smaller one: noted without a full fit, it leaves as much, never more."""
    alone = cubic.fits[("cubic_stiffness",)].cost
    larger = [found.cost for names, found in cubic.fits.items() if len(names) == 2 and "cubic_stiffness" in names]
    assert len(larger) == 2
    assert all(alone - 15.0 < cost < alone + 1.0 for cost in larger)


def test_a_single_effect_that_a_linear_step_promises_little_of_is_fitted_all_the_same(monkeypatch):
    """A slider between two slips of a coarse grid: the step from the base tells a third of what it explains."""
    monkeypatch.setattr(starts, "_SLIPS_OF_ONE", starts._SLIPS)
    monkeypatch.setattr(Search, "_sliding", lambda *_: [])
    rng, model = np.random.default_rng(4), Oscillator(MASS, ["jenkins"])
    slider = {"slider_stiffness": 0.0008 * STIFFNESS, "slip_force": 0.72 * 0.0008 * STIFFNESS * AMPLITUDE}
    truth, records = truth_of(()) | slider, []
    for release in (AMPLITUDE, 0.8 * AMPLITUDE):
        vector = [truth[name] for name in model.parameter_names]
        exact = simulate_waveform(model, vector, TIME - RELEASE_TIME, release).displacement
        records.append(noisy(rng, f"from {release}", TIME, np.where(TIME < RELEASE_TIME, release, exact)))
    search = Search(batch_of(records), Oscillator(MASS), ("jenkins",), 1)
    base = search.fit_set(())
    layout = search.layout(("jenkins",))
    promised = starts.by_score(layout, "jenkins", base, search.batch)
    assert 1.0 < promised[0].gain < 2.0
    one_step = search._noted(layout, promised[0], base)
    eta = layout.coordinates(np.array([slider[name] for name in layout.names]))
    true = search.descent.from_near(layout, [start_state(layout, eta, base.state.own[:, :5])])
    found = search.fit_set(("jenkins",))
    assert found.cost < true.cost + 0.5
    assert one_step.cost > found.cost + 2.0  # negative control: what was noted before


@pytest.mark.parametrize(("tolerance", "is_enough"), [(0.5, True), (0.0, False), (1e-5, False)])
def test_search_ends_where_what_is_missing_does_not_matter(cubic, tolerance, is_enough):
    limits = dict.fromkeys(("frequency", "damping"), tolerance)
    search = Search(cubic.batch, Oscillator(MASS), CANDIDATES, 2, tolerance=limits)
    search.run()
    assert search.best() == ("cubic_stiffness",)
    assert all(len(names) < 2 for names in search.fits) is is_enough


def test_search_ends_where_nothing_is_missing(linear):
    assert set(linear.fits) == {(), *((name,) for name in CANDIDATES)}
    assert evidence.p_nothing_missing(linear.fits, linear.batch) > evidence.MISSING


def test_effects_begin_again_from_a_base_that_a_larger_set_led_to_a_better_place(linear, monkeypatch):
    """They were fitted from where the base had rested before; then it is asked whether that is all."""
    answers = iter((False, True))
    names = ("quadratic_damping",)
    search = Search(linear.batch, linear.base, names, 1)

    def behind():
        known = search.fit_set(names)
        search.fits[names] = replace(known, chi_square=known.chi_square + 20.0)

    def better():
        base = search.fits[()]
        search.fits[()] = replace(base, state=replace(base.state))

    monkeypatch.setattr(search, "_ask_single_effects", behind)
    monkeypatch.setattr(search, "_is_answered", lambda: next(answers))
    monkeypatch.setattr(search, "_look_back", better)
    search.run()
    assert search.fits[names].cost < search.fits[()].cost + 1.0


def test_one_set_of_each_kind_is_extended():
    """Of sets that hold the same mechanisms the simplest, unless another leaves clearly less."""
    costs = {("jenkins",): 103.0, ("iwan",): 101.0, ("bouc_wen",): 100.0, ("cubic_stiffness",): 120.0}
    search = search_of(batch_of(make_records(np.random.default_rng(22), (), specimens=1)), candidates=())
    search.fits = {names: SimpleNamespace(cost=cost) for names, cost in costs.items()}
    assert search._one_of_a_kind([*costs]) == [("jenkins",), ("cubic_stiffness",)]
    search.fits[("jenkins",)] = SimpleNamespace(cost=110.0)
    assert search._one_of_a_kind([*costs]) == [("iwan",), ("cubic_stiffness",)]


def test_a_smaller_set_takes_the_springs_of_a_larger_one_over():
    """Without a play whose gap is next to nothing, its contact is a spring more: the stiffness takes it over."""
    batch = batch_of(make_records(np.random.default_rng(22), (), specimens=2))
    search = Search(batch, Oscillator(MASS), ("freeplay",), 1)
    layout = search.layout(("freeplay",))
    contact = 0.3 * batch.own[:, 0].mean()
    values = dict(contact_stiffness=contact, gap=1e-9)
    own = batch.own.copy()
    own[:, 0] -= contact
    state = start_state(layout, layout.coordinates(np.array([values[name] for name in layout.names])), own)
    larger = fit(layout, batch.levels, state, iterations=0, nuisances=(0, 1))
    moved = search._smaller(search.layout(()), larger)
    np.testing.assert_allclose(moved.own[:, 0], batch.own[:, 0], rtol=1e-4)
    np.testing.assert_array_equal(moved.own[:, 1:5], own[:, 1:5])


def test_variants_are_looked_for_in_the_place_of_what_they_vary():
    batch = batch_of(make_records(np.random.default_rng(31), ("quadratic_damping",)))
    search = Search(
        batch, Oscillator(MASS), ("quadratic_damping", "coulomb_friction"), 1,
        variants=("power_damping", "stribeck_friction", "power_stiffness"),
    )  # fmt: skip
    search.run()
    assert search.best() == ("quadratic_damping",)
    assert ("power_damping",) in search.proposals
    assert ("power_damping",) not in search.fits  # the square is one of its powers, and leaves as little
    assert ("stribeck_friction",) not in search.fits


def test_a_variant_is_asked_where_its_backbones_are_likely_though_what_it_varies_is_not_the_best():
    """Damping with the displacement's size beside cubic damping, which explains as much at this noise."""
    batch = batch_of(make_records(np.random.default_rng(5), ("quadratic_damping",), decibels=22.0))
    search = Search(batch, Oscillator(MASS), ("cubic_damping",), 1, variants=("absolute_displacement_damping",))
    for names in ((), ("cubic_damping",)):
        search.fit_set(names)
    assert search.best() == ("cubic_damping",) and search.explains(search.fits[search.best()])
    search._vary()
    kept = search.fits[("absolute_displacement_damping",)]
    assert search.explains(kept) and kept.cost < search.fits[("cubic_damping",)].cost
    fitted, search.proposals = dict(search.fits), {}  # negative control: backbones that promise nothing
    search.fits = {names: found for names, found in fitted.items() if names != ("absolute_displacement_damping",)}
    search._vary()
    assert ("absolute_displacement_damping",) not in search.fits


def test_a_variant_of_another_mechanism_that_is_as_simple_stays_beside_what_it_varies():
    """Damping with the displacement's size makes the backbones of drag: where no harmonic tells, both remain."""
    batch = batch_of(make_records(np.random.default_rng(36), ("quadratic_damping",), decibels=40.0))
    search = Search(
        batch, Oscillator(MASS), ("quadratic_damping", "displacement_dependent_damping"), 1,
        variants=("absolute_displacement_damping", "asymmetric_drag"),
    )  # fmt: skip
    search.run()
    drag, size = search.fits[("quadratic_damping",)], search.fits[("absolute_displacement_damping",)]
    assert abs(drag.cost - size.cost) < 5.0
    assert ("asymmetric_drag",) not in search.fits  # of the mechanism, and less simple


def test_what_made_up_for_the_lack_of_a_variant_is_left_out():
    """Drag in one direction only, by SciPy: half is drag, and the other half bends the motion as a spring does."""

    def force(x: float, v: float, direction: float) -> float:
        return STIFFNESS * x + DAMPING * v + 0.9 * DAMPING / (OMEGA * AMPLITUDE) * v * v * (direction + 1.0)

    rng = np.random.default_rng(33)
    records = []
    for r in range(3):
        exact = free_decay(force, AMPLITUDE * (1.0 - 0.1 * r), np.maximum(TIME - RELEASE_TIME, 0.0))
        records.append(noisy(rng, f"specimen {r + 1}", TIME, exact, 55.0))
    candidates = ("quadratic_damping", "quadratic_stiffness", "bilinear_stiffness")
    search = Search(batch_of(records), Oscillator(MASS), candidates, 2, variants=("asymmetric_drag",))
    search.run()
    assert search.best() == ("asymmetric_drag",)
    assert any("asymmetric_drag" in names and len(names) == 2 for names in search.fits)  # from here it was found
    # also where three effects imitate the backbones: by these the variant stands first
    candidates = ("quadratic_damping", "quadratic_stiffness", "cubic_stiffness")
    larger = Search(search.batch, Oscillator(MASS), candidates, 3, variants=("asymmetric_drag",))
    assert next(iter(larger.proposals)) == ("asymmetric_drag",)
    spent = Search(search.batch, Oscillator(MASS), candidates, 3, variants=("asymmetric_drag",), budget=0.0)
    spent.run()
    assert spent.is_cut and spent.best() == ("asymmetric_drag",)


def test_a_variant_is_kept_where_it_leaves_less():
    """A damper with the power 1.5 of the speed, by SciPy; its square and a viscous damper leave more."""
    speed = AMPLITUDE * OMEGA

    def force(x: float, v: float, _: float) -> float:
        return STIFFNESS * x + DAMPING * v + 2.0 * DAMPING * v * np.sqrt(abs(v) / speed)

    rng = np.random.default_rng(8)
    decays = [free_decay(force, AMPLITUDE * share, TIME - RELEASE_TIME) for share in (1.0, 0.8)]
    batch = batch_of([noisy(rng, f"specimen {r + 1}", TIME, decay, 55.0) for r, decay in enumerate(decays)])
    search = Search(batch, Oscillator(MASS), ("quadratic_damping",), 1, variants=("power_damping",))
    search.run()
    assert search.best() == ("power_damping",)
    square = search.fits[("quadratic_damping",)]
    assert square.cost > search.fits[("power_damping",)].cost + 50.0


def test_laws_of_one_mechanism_compete_with_a_drift_beside_them():
    """A cubic spring in a structure that warms up: other springs are asked with the drift, too."""
    batch = batch_of(drifting_records(np.random.default_rng(5), 0.01, cubic=0.1))
    search = search_of(batch, ("cubic_stiffness", "quintic_stiffness", "freeplay"))
    found = rivals.drifting_sets(search)
    assert {(), ("cubic_stiffness",), ("quintic_stiffness",)} <= set(found)
    decision = decide(search, found, {})
    assert ("cubic_stiffness",) in decision.drifts
    assert decision.best == ("cubic_stiffness",)
    named = search.fits[decision.best]
    check = rivals.drift_check(found[()].fit, 0.0, True, named)
    changes = changes_of(named.state.own[:, list(DRIFTS)], named.own_covariance[:, list(DRIFTS)])
    assert not check.passed
    assert f"(by +{per_cent(changes['frequency'])} over a record; " in check.message  # it becomes stiffer
    assert re.search(r"over a record; damping by at most [1-4]\.?\d? %\)", check.message)  # damping stays
    below = rivals.drift_check(found[()].fit, 0.0, True, named, is_small=True)
    assert below.passed and "below the tolerance" in below.message
    rate = DRIFT * float(np.abs(named.state.own[:, DRIFTS[0]]).mean())
    assert not is_drift_small(named, {"frequency": 0.5 * rate}) and is_drift_small(named, {"frequency": 2.0 * rate})


def test_a_law_is_found_that_a_strong_drift_had_hidden_in_the_backbones():
    """A structure that warms up by as much as its spring hardens: without a drift, backbones show next to nothing."""
    change, cubic = 0.04, 0.1
    batch = batch_of(drifting_records(np.random.default_rng(5), change, cubic=cubic))
    search = Search(batch, Oscillator(MASS), ("freeplay", "quintic_stiffness", "cubic_stiffness"), 2)
    search.fit_set(())  # what was fitted without a drift leads nowhere
    found = rivals.drifting_sets(search)
    drifting = found[("cubic_stiffness",)].fit
    assert evidence.leaves_noise(batch, drifting) and not evidence.leaves_noise(batch, found[()].fit)
    # half the change of the stiffness, in units of 5 %; a few per cent is what a record of 25 cycles tells
    np.testing.assert_allclose(drifting.state.own[:, 5], 0.5 * change / 0.05, rtol=0.05)
    assert drifting.centre[0] == pytest.approx(cubic * STIFFNESS / AMPLITUDE**2, rel=0.05)


def test_a_plain_law_beside_a_drift_rivals_a_contact_that_makes_up_for_both():
    """A spring with two sides that cools: with a free approach, a contact bends the backbone as the drift does."""
    batch = batch_of(drifting_records(np.random.default_rng(5), -0.004, 1, one_side=0.04))
    search = search_of(batch, ("bilinear_stiffness", "hertz_contact"), 1)
    assert search.best() == ("hertz_contact",)
    beside = rivals.drifting_sets(search)[("bilinear_stiffness",)].fit
    contact, alone = (search.fits[names].cost for names in (("hertz_contact",), ("bilinear_stiffness",)))
    assert beside.cost < contact + 10.0 and alone > contact + 100.0
    assert beside.centre[0] == pytest.approx(0.04 * STIFFNESS, rel=0.1)


@pytest.mark.parametrize("exponent", [1.3, 2.0])
def test_a_drag_with_an_exponent_of_its_own_is_asked_beside_a_drift(exponent):
    """Alone it follows the drift; begun from the square of the speed with a drift beside it, it comes to rest."""
    batch = batch_of(drifting_records(np.random.default_rng(5), -0.02, 3, drag=(0.1, exponent)))
    search = Search(batch, Oscillator(MASS), ("quadratic_damping",), 1, variants=("power_damping",))
    names = ("quadratic_damping",)
    alone = search.fit_set(names)
    plain = drift_fits.drift_fit(batch, alone.layout, alone.state)
    found = {names: drift_fits.weighed(batch, plain, alone)}
    rivals._ask_variants(search, found, np.inf)
    if exponent == 2.0:
        assert set(found) == {names}
        return
    varied = found[("power_damping",)].fit
    assert varied.cost < plain.cost - 20.0
    assert varied.value_of("power_damping_exponent") == pytest.approx(exponent, abs=0.1)
    # half the change of stiffness, in units of 5 %: three records tell it to 0.01
    assert varied.state.own[:, 5].mean() == pytest.approx(-0.5 * 0.02 / 0.05, abs=0.03)


def test_sliders_alone_are_asked_beside_drifts():
    batch = batch_of(drifting_records(np.random.default_rng(5), 0.04))
    search = Search(batch, Oscillator(MASS), ("jenkins",), 1)
    search.fit_set(())
    assert {names for names, _ in single_beside_drifts(search)} <= {("jenkins",)}


def test_backbones_beside_drifts_have_them_as_errors():
    batch = batch_of(drifting_records(np.random.default_rng(5), 0.04))
    start = Search(batch, Oscillator(MASS), CANDIDATES, 1).fit_set(())
    assert level_chi_square(batch, on_levels(batch, start)) > 100.0
    beside = beside_drifts(batch)
    assert level_chi_square(beside, on_levels(beside, start)) < 2.0


@pytest.mark.parametrize("common", [0.0, 0.7, 1e4])
def test_density_of_values_with_a_common_part_is_that_of_scipy(common, rng):
    value, variance = rng.normal(size=5), rng.uniform(0.1, 2.0, 5)
    density = drift_kinds._log_normal(value, variance, common) - 2.5 * np.log(2.0 * np.pi)
    covariance = np.diag(variance) + common
    expected = multivariate_normal.logpdf(value, np.zeros(5), covariance, allow_singular=False)
    assert density == pytest.approx(expected, rel=1e-9)


def test_an_information_without_an_inverse_is_no_fault(cubic):
    """A direction of negative information as large as the prior's: no covariance, and evidence against the set."""
    found = cubic.fits[("cubic_stiffness",)]
    width = found.layout.width[0]
    own = found.system.own.copy()
    mixed = np.zeros_like(found.system.mixed)
    singular = replace(found.system, shared=np.array([[-1.0 / width**2]]), mixed=mixed, own=own)
    determinant, covariance = information(found.layout, singular, found.state, found.active, 1.0)
    assert determinant == np.inf and np.isnan(covariance).all()


def test_what_acts_above_all_levels_is_asked_from_the_model_as_it_is():
    """A slider that slips in the first cycle of one specimen only: no backbone shows it, and one record does."""
    names = ("linear_stiffness", "viscous_damping", "slider_stiffness", "slip_force")
    slider, rng = 0.035 * STIFFNESS, np.random.default_rng(9)
    values = dict(zip(names, (STIFFNESS, DAMPING, slider, 0.8 * AMPLITUDE * slider), strict=True))
    records = []
    for r, share in enumerate((1.0, 0.7, 0.65)):
        release, after = share * AMPLITUDE, np.maximum(TIME - RELEASE_TIME, 0.0)
        held = np.unique(after)
        exact = simulate_waveform(Oscillator(MASS, ["jenkins"]), values, held, release).displacement
        records.append(noisy(rng, f"specimen {r + 1}", TIME, np.interp(after, held, exact), 60.0))
    batch = batch_of(records)
    search = search_of(batch, ("quadratic_damping", "jenkins"), 1)
    highest = max(term.levels[-1] for term in batch.levels)
    assert highest < 0.8 * AMPLITUDE  # negative control: the backbones explain the model as it is
    assert search.proposals[()].chi_square < sum(term.size for term in batch.levels)
    assert search.fits[()].cost > 2.0 * search.count
    assert search.best() == ("jenkins",)
    assert search.fits[("jenkins",)].cost < 1.1 * search.count


@pytest.mark.parametrize(
    ("share", "slip", "releases"), [(0.073, 0.82, (0.6, 1.0)), (0.3, 0.55, (1.0,)), (0.275, 0.38, (0.6, 0.8, 1.0))]
)
def test_a_slider_of_the_model_as_it_is_is_not_lost_at_zero(share, slip, releases):
    """One that slips in the first cycles only; without it a damper with a dead band explained the records."""
    names = ("linear_stiffness", "viscous_damping", "slider_stiffness", "slip_force")
    slider, rng = share * STIFFNESS, np.random.default_rng(11)
    truth = dict(zip(names, (STIFFNESS, DAMPING, slider, slip * AMPLITUDE * slider), strict=True))
    base, records = Oscillator(MASS, ["jenkins"]), []
    for r, release in enumerate(releases):
        after = np.maximum(TIME - RELEASE_TIME, 0.0)
        held = np.unique(after)
        exact = simulate_waveform(base, truth, held, release * AMPLITUDE).displacement
        records.append(noisy(rng, f"specimen {r + 1}", TIME, np.interp(after, held, exact), 51.0))
    search = Search(batch_of(records), base, ("quadratic_damping",), 1)
    found = search.fit_set(())
    assert found.cost < 1.1 * search.count
    values = dict(zip(names, found.parameters(0), strict=True))
    assert values["slip_force"] / values["slider_stiffness"] == pytest.approx(slip * AMPLITUDE, rel=0.02)


def test_a_stop_of_the_model_as_it_is_that_is_met_once_is_found():
    """One at 0.94 of the largest amplitude, nearly twice as stiff as the spring: it had been one on the other side."""
    values = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING, "stop_stiffness": 1.7 * STIFFNESS}
    base, records, rng = Oscillator(MASS, ["one_sided_stiffness"]), [], np.random.default_rng(19)
    for r, release in enumerate((0.6, 0.8, 1.0)):
        after = np.maximum(TIME - RELEASE_TIME, 0.0)
        held = np.unique(after)
        truth = values | {"stop_gap": 0.94 * AMPLITUDE}
        exact = simulate_waveform(base, truth, held, release * AMPLITUDE).displacement
        records.append(noisy(rng, f"specimen {r + 1}", TIME, np.interp(after, held, exact), 52.0))
    search = Search(batch_of(records), base, ("quadratic_damping",), 1)
    found = search.fit_set(())
    assert found.cost < 1.06 * search.count
    assert 0.7 * AMPLITUDE < found.parameters(0)[-1] < AMPLITUDE  # one specimen meets it, and once


def test_a_start_in_the_place_of_another_effect_has_its_force(linear):
    play = LIBRARY["offset_freeplay"], LIBRARY["freeplay"]
    names = [effect.parameter_names for effect in play]
    batch = linear.batch
    search = Search(batch, Oscillator(MASS, ()), CANDIDATES, 2)
    layout, plain = (
        search.layout(("coulomb_friction", "offset_freeplay")),
        search.layout(("coulomb_friction", "freeplay")),
    )
    truth = {"friction_force": 0.02, names[0][0]: 0.4 * STIFFNESS, names[0][1]: 0.3 * AMPLITUDE, names[0][2]: 0.0}
    eta = layout.coordinates(np.array([truth[name] for name in layout.names]))
    known = fit(layout, batch.deciding, start_state(layout, eta, batch.own), iterations=1)
    known = replace(known, state=start_state(layout, eta, batch.own))
    state = equal_forces.in_place_of(plain, known, OMEGA)
    values = dict(zip(plain.names, plain.physical(state.eta, np.zeros(state.eta.size), 0.0)[0], strict=True))
    assert values["friction_force"] == pytest.approx(0.02)
    # without its asymmetry the variant is the plain law: the same stops, and neither stiffness nor damping changes
    assert values[names[1][0]] == pytest.approx(0.4 * STIFFNESS, rel=1e-6)
    assert values[names[1][1]] == pytest.approx(0.3 * AMPLITUDE, rel=1e-6)
    np.testing.assert_allclose(state.own[:, :2], batch.own[:, :2], rtol=1e-6)


def test_a_damper_in_the_place_of_another_takes_the_same_energy(linear):
    batch = linear.batch
    search = Search(batch, Oscillator(MASS, ()), CANDIDATES, 2)
    layout, plain = search.layout(("power_damping",)), search.layout(("quadratic_damping",))
    eta = starts.typical(layout)
    known = fit(layout, batch.deciding, start_state(layout, eta, batch.own), iterations=1)
    known = replace(known, state=start_state(layout, eta, batch.own))
    state = equal_forces.in_place_of(plain, known, batch.angular_frequency)

    def work(one, point):  # of a cycle, of all dampers, by quadrature at an amplitude within those asked
        angle = 2.0 * np.pi * (np.arange(4000) + 0.5) / 4000.0
        pace = -0.8 * one.amplitude * batch.angular_frequency * np.sin(angle)
        vector = one.template.copy()
        vector[one.free] = one.physical(point.eta, np.zeros(point.eta.size), 0.0)[0]
        vector[:2] = 0.0, point.own[0, 1]
        total = np.zeros(angle.size)
        for effect in one.oscillator.effects:
            p = vector[[one.oscillator.index(name) for name in effect.parameter_names]]
            total += [effect.force(0.0, v, np.sign(v), np.zeros(0), p) for v in pace]
        return float((total * pace).mean())

    assert state.eta[0] > 0.0
    assert work(plain, state) == pytest.approx(work(layout, known.state), rel=0.05)


def test_specimens_that_hold_a_fit_beside_its_minimum_begin_alike(cubic):
    """One specimen's own value far off, as behind a kink: the fit begins where it ended with that taken back."""
    names, descent = ("cubic_stiffness",), cubic.descent
    right = cubic.fits[names]
    own = right.state.own.copy()
    own[0, 7:] += 3.0
    held = replace(right, state=replace(right.state, own=own), chi_square=right.chi_square + 20.0, penalty=9.0)
    assert np.all(starts.alike(held).own[:, 7:] == 0.0) and np.all(starts.alike(held).own[:, :7] == own[:, :7])
    assert descent.begun_alike(held).cost == pytest.approx(right.cost, abs=0.1)
    assert descent.begun_alike(replace(right, chi_square=right.chi_square - 1.0)).cost < right.cost - 0.9  # no better
    # of a fit near the noise whose specimens differ by more than they were taken to: one value of each of three here
    assert descent._is_strained(held) and not descent._is_strained(replace(held, penalty=2.9))
    assert not descent._is_strained(replace(held, chi_square=held.chi_square + cubic.count))


def test_rivals_of_the_best_set_begin_otherwise(cubic, monkeypatch):
    """A law with a shape that rests above its minimum, and one without: the first is begun again, from its look too."""
    names = ("power_stiffness",)
    search = Search(cubic.batch, Oscillator(MASS, ()), (*CANDIDATES, *names), 1)
    for item in ((), ("cubic_stiffness",), names):
        search.fit_set(item)
    right, asked = search.fits[names], []
    proposed = Search._proposed
    monkeypatch.setattr(Search, "_proposed", lambda *args: asked.append(args[1]) or proposed(*args))
    search.asked.clear()
    search.fits[names] = replace(right, chi_square=right.chi_square + 0.6)
    assert search.best() == ("cubic_stiffness",) and search._rivals() == [names]  # strengths alone have one minimum
    search._begin_otherwise()
    assert search.fits[names].cost == pytest.approx(right.cost, abs=0.2) and asked == [names]
    search._begin_otherwise()
    assert asked == [names]  # once


def test_of_minima_that_leave_the_same_the_one_with_most_evidence_counts(cubic, monkeypatch):
    """A wide one that leaves hardly more than a narrow one; not one that leaves more, or did not come to rest."""
    names = ("power_stiffness",)
    search = Search(cubic.batch, Oscillator(MASS, ()), (*CANDIDATES, *names), 1)
    for item in ((), ("cubic_stiffness",), names):
        search.fit_set(item)
    narrow = search.fits[names]
    wide = replace(narrow, chi_square=narrow.chi_square + 1.0)  # in each of three specimens
    weights = {id(narrow): 0.0, id(wide): 1.5}
    monkeypatch.setattr(evidence, "laplace", lambda found, _: weights.get(id(found), 5.0))
    assert narrow.is_converged and narrow.chi_square.size == 3
    near, far = (replace(narrow, chi_square=narrow.chi_square + more) for more in (0.9, 1.1))
    for some, kept in (
        ([narrow, near], near), ([narrow, far], narrow), ([narrow, replace(near, is_converged=False)], narrow),
    ):  # fmt: skip
        assert search._weightiest(some) is kept
    weights[id(near)] = 0.9  # hardly more evidence
    assert search._weightiest([near, narrow]) is narrow
    monkeypatch.undo()
    # from the places that the backbones hold for as good as the best, once
    proposal, begun = search._proposal(names), []
    (promised, eta, own), *_ = proposal.starts
    starts_of = ((promised, eta, own), (promised + 5.0, eta * 1.1, own), (promised + 7.0, eta * 1.2, own))
    monkeypatch.setattr(search.descent, "from_afar", lambda layout, state: begun.append(state.eta) or narrow)
    known = replace(proposal, starts=starts_of)
    assert search._other_minima(names, known) == [narrow] and search._other_minima(names, known) == []
    np.testing.assert_array_equal(begun, [search.layout(names).within(eta * 1.1)])


def test_plain_laws_are_asked_beside_a_rare_one(cubic, monkeypatch):
    """Where one is the best set: those whose backbones leave as little, and one more effect that a step promises."""
    search = Search(cubic.batch, Oscillator(MASS, ()), CANDIDATES, 2, variants=("power_stiffness",))
    for names in ((), ("power_stiffness",)):
        search.fit_set(names)
    assert search.best() == ("power_stiffness",) and search.has_proposals
    search._ask_common()
    assert search.best() == ("cubic_stiffness",)
    asked = set(search.fits)
    search._ask_common()  # negative control: no rare law is the best
    assert set(search.fits) == asked
    # a plain set that leaves more than a rare one, and what it lacks is another plain effect
    plain, rare = ("cubic_stiffness",), ("power_stiffness",)
    for lead, other, gain in ((12.0, CANDIDATES[2], 11.0), (12.0, None, 5.0), (4.0, None, 11.0)):
        search.fits = {key: search.fits[key] for key in ((), plain, rare)}
        least = replace(search.fits[rare], chi_square=search.fits[plain].chi_square - lead / 3.0)
        search.fits[rare] = replace(least, penalty=search.fits[plain].penalty)
        monkeypatch.setattr(search, "best", lambda: rare)
        monkeypatch.setattr(search, "_score", lambda names, name, gain=gain: gain if name == CANDIDATES[2] else 1.0)
        search._ask_common()
        new = set(search.fits) - {(), plain, rare}
        assert new == ({tuple(sorted((*plain, other)))} if other else set())


def test_variants_of_the_best_set_are_asked_although_the_effort_is_spent(cubic, monkeypatch):
    """Where nothing explains the records whatever was spent: a damping |x|v, which a drag imitates, had been missed."""
    search = Search(cubic.batch, Oscillator(MASS, ()), ("cubic_stiffness",), 1, variants=("power_stiffness",))
    for names in ((), ("cubic_stiffness",)):
        search.fit_set(names)
    search.budget = 0.9 * search.descent.effort
    assert search._is_spent
    varied = []
    monkeypatch.setattr(Search, "_fit_varied", lambda _, names: varied.append(names))
    search._vary()
    assert varied == [("power_stiffness",)]
    search.budget = 0.5 * search.descent.effort  # negative controls: what took half as much again ends
    search._vary()
    assert varied == [("power_stiffness",)]
    monkeypatch.setattr(Search, "explains", lambda *_: False)
    search._vary()
    assert varied == 2 * [("power_stiffness",)]
    monkeypatch.setattr(Search, "_is_costly", lambda _, names: "power_stiffness" in names)
    search._vary()
    assert varied == 2 * [("power_stiffness",)]


@pytest.mark.parametrize(("share", "is_told"), [(0.15, True), (0.005, False)])
def test_backbones_tell_a_mirror_image_where_the_mid_line_moves_by_more_than_noise(share, is_told):
    names, rng = ("linear_stiffness", "viscous_damping", "quadratic_stiffness"), np.random.default_rng(41)
    values = dict(zip(names, (STIFFNESS, DAMPING, share * STIFFNESS / AMPLITUDE), strict=True))
    after = np.maximum(TIME - RELEASE_TIME, 0.0)
    held = np.unique(after)
    exact = simulate_waveform(Oscillator(MASS, ["quadratic_stiffness"]), values, held, AMPLITUDE).displacement
    batch = batch_of([noisy(rng, "specimen 1", TIME, np.interp(after, held, exact), 45.0)])
    search = Search(batch, Oscillator(MASS, ()), ("quadratic_stiffness",), 1)
    layout = search.layout(("quadratic_stiffness",))
    begun = search.descent.released(layout, layout.coordinates(np.array([values[names[2]]])), batch.own[:, :2])
    found = search.descent.from_near(layout, [begun])
    image = starts.mirrored(layout, found.state)
    assert is_told_apart(batch, found, image, 3.0) == is_told
    unknown = replace(batch, records=tuple(replace(item, offset_is_measured=False) for item in batch.records))
    assert not is_told_apart(unknown, found, image, 3.0)


def test_a_slider_that_holds_in_one_specimen_begins_again_from_where_it_just_slips():
    """Released below the slip displacement of a fit it is a spring there, whatever its slip force."""
    layout = make_layout(Oscillator(MASS, ("jenkins",)), AMPLITUDE, OMEGA, SCATTER)
    own = np.tile([STIFFNESS, DAMPING, AMPLITUDE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], (3, 1))
    own[1, 2] = -0.5 * AMPLITUDE
    own[:, 8] = (0.0, 0.2, -0.1)
    state = State(np.array([0.01 * STIFFNESS * AMPLITUDE, 0.6]), own)
    lags = np.array([False, True, True])
    found = starts.slipping_each(layout, state, lags)
    assert len(found) == 2
    for share, item in zip((0.9, 0.6), found, strict=True):
        np.testing.assert_array_equal(item.eta, state.eta)
        np.testing.assert_array_equal(item.own[[0, 2]], state.own[[0, 2]])  # they slip
        force, reach = item.eta * (1.0 + SCATTER * item.own[1, 7:])
        assert reach == pytest.approx(share * 0.5)
        # the spring of the slider is as stiff as it was
        assert force / reach == pytest.approx(state.eta[0] / (state.eta[1] * (1.0 + SCATTER * 0.2)))
    assert not starts.slipping_each(layout, state, np.zeros(3, dtype=bool))  # as well as the others
    own[:, 2] = 0.5 * AMPLITUDE
    assert not starts.slipping_each(layout, State(state.eta, own), np.ones(3, dtype=bool))  # it holds in all of them


def test_a_slider_begins_again_where_a_linear_step_promises_more():
    """One that slips in the first cycles only is far from one that slips in all, and no way leads there."""
    rng, oscillator = np.random.default_rng(5), Oscillator(MASS, ("jenkins",))
    strength, slip = 0.001 * STIFFNESS, 0.7 * AMPLITUDE
    records = []
    for r, release in enumerate((1.0, 0.9, 0.8)):
        values = np.array([STIFFNESS, DAMPING, strength, strength * slip])
        motion = simulate_waveform(oscillator, values, TIME, release * AMPLITUDE, release_time=RELEASE_TIME)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, motion.values, 55.0))
    search = Search(batch_of(records), Oscillator(MASS), ("jenkins",), 1)
    base, layout = search.fit_set(()), search.layout(("jenkins",))

    def begun(share):
        own = base.state.own.copy()
        own[:, 0] -= strength
        state = start_state(layout, layout.coordinates(np.array([strength, strength * share * AMPLITUDE])), own[:, :4])
        return fit(layout, search.batch.deciding, state, iterations=60, nuisances=search.batch.nuisances)

    lost, right = begun(0.12), begun(0.7)
    assert lost.cost > right.cost + 30.0
    search.fits[("jenkins",)] = lost
    search._look_elsewhere()
    assert search.fits[("jenkins",)].cost < right.cost + 1.0
    again = search.fits[("jenkins",)]
    search._look_elsewhere()  # it was asked
    assert search.fits[("jenkins",)] is again


def test_a_slider_is_looked_for_in_the_dents_beside_its_own(linear, monkeypatch):
    layout = make_layout(Oscillator(MASS, ("jenkins", "iwan")), AMPLITUDE, OMEGA)
    state = State(np.array([0.1, 0.5, 0.2, 0.6, -0.2]), np.zeros((2, 9)))
    strength, slip = next(pair for pair in layout.slips if pair[0] not in {bed[0] for bed in layout.beds})
    found = starts.jolted(layout, state)
    assert [item.eta[slip] / state.eta[slip] for item in found] == pytest.approx([0.95, 1.05])
    for item in found:  # all else stays as it is
        np.testing.assert_array_equal(np.delete(item.eta, slip), np.delete(state.eta, slip))
    absent = state.eta.copy()
    absent[strength] = 0.0
    assert not starts.jolted(layout, State(absent, state.own))

    # of two sets within reach the better one is asked once, and a place that is no better is not taken
    fits = {names: SimpleNamespace(cost=cost, state=state, layout=layout) for names, cost in (
        (("jenkins",), 100.0), (("cubic_stiffness", "jenkins"), 90.0), (("iwan",), 20.0))}  # fmt: skip
    search = Search(linear.batch, Oscillator(MASS), ("jenkins",), 1)
    search.fits = dict(fits)
    asked = []

    def beside(_layout, states, *, rival):
        asked.append(rival)
        return SimpleNamespace(cost=rival - (5.0 if len(asked) == 1 else 0.0), state=states[0], layout=layout)

    monkeypatch.setattr(search, "_sliding", lambda *_: [])
    monkeypatch.setattr(search, "explains", lambda _: True)
    monkeypatch.setattr(evidence, "leaves_noise", lambda *_: True)
    monkeypatch.setattr(Search, "_is_spent", False)
    monkeypatch.setattr(search, "layout", lambda names: make_layout(Oscillator(MASS, names), AMPLITUDE, OMEGA))
    monkeypatch.setattr(search.descent, "from_near", beside)
    search._look_elsewhere()
    assert asked == []  # 70 and 80 above the lowest
    search.fits[("iwan",)] = SimpleNamespace(cost=60.0, state=state, layout=layout)
    search._look_elsewhere()
    assert asked == [90.0, 100.0]
    assert search.fits["cubic_stiffness", "jenkins"].cost == 85.0
    assert search.fits[("jenkins",)] is fits[("jenkins",)]

    # where none leaves noise, those near the lowest may have lost their slider, though they explain nothing
    monkeypatch.setattr(search, "explains", lambda _: False)
    assert search._with_sliders() == []
    monkeypatch.setattr(evidence, "leaves_noise", lambda *_: False)
    assert search._with_sliders() == [("cubic_stiffness", "jenkins")]  # half as much again is too far


@pytest.mark.parametrize(("gains", "rival", "rounds"), [(10.0, None, 3), (10.0, 900.0, 1), (30.0, 900.0, 3)])
def test_a_fit_that_comes_hardly_nearer_to_a_rival_begins_alike_once(cubic, monkeypatch, gains, rival, rounds):
    """A magnet in the place of a pendulum began alike three times, 4800 above what explained the records."""
    known, asked = replace(cubic.fits[("cubic_stiffness",)], chi_square=np.array([1000.0]), penalty=0.0), []

    def fit_once(*_, rival=None, **__):
        asked.append(rival)
        return replace(known, chi_square=known.chi_square - gains * len(asked), is_converged=True)

    monkeypatch.setattr(cubic.descent, "fit", fit_once)
    lowest = cubic.descent.begun_alike(known, rival=rival)
    assert len(asked) == rounds and lowest.cost == 1000.0 - gains * rounds
