"""Parameters that make up for each other: intervals along a bent valley, and fits that rest on its plateau."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from pymc_backbone.discrepancy.fitting import starts, valley_walk, valleys
from pymc_backbone.discrepancy.fitting.estimates import estimates_of
from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.layout import make_layout
from pymc_backbone.discrepancy.fitting.normal_equations import State, linearise, start_state
from pymc_backbone.discrepancy.results.entries import Estimate
from pymc_backbone.discrepancy.results.extend import _reaching, _told_by, estimates_from_fit
from pymc_backbone.discrepancy.results.study import UNMIXED
from pymc_backbone.discrepancy.sets.known_sets import BUDGET
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.effects import LIBRARY
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.reporting.report_model import _interval
from pymc_backbone.simulation.decay import simulate_waveform

from .discrepancy_cases import (
    AFTER_FIRST_SWING,
    AMPLITUDE,
    DAMPING,
    MASS,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    batch_of,
    make_records,
    noisy,
    truth_of,
)
from .test_discrepancy_scatter import CUBIC, backbones
from .test_discrepancy_scatter import MASS as CASE_MASS

BASE = Oscillator(MASS, ())
IWAN = Oscillator(MASS, ("iwan",))


def joint_batch(seed, slip, share=0.1, exponent=-0.3, decibels=45.0, start=None):
    """Two specimens with a joint of a share of the stiffness that slips as a whole at ``slip`` amplitudes."""
    rng = np.random.default_rng(seed)
    force = share * STIFFNESS * slip * AMPLITUDE * (1.0 + exponent) / (2.0 + exponent)
    values = np.array([STIFFNESS, DAMPING, share * STIFFNESS, force, exponent])
    records = []
    for r in range(2):
        own = values * np.array([1.0 + 0.01 * r, 1.0, 1.0, 1.0, 1.0])
        found = simulate_waveform(IWAN, own, TIME, AMPLITUDE * (1.0 - 0.25 * r), release_time=RELEASE_TIME)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, found.values, decibels, "m"))
    return batch_of(records, start=start), dict(zip(IWAN.parameter_names, values, strict=True))


def fit_from(layout, batch, truth):
    """The fit that starts at these values of the mean specimen."""
    eta = layout.coordinates(np.array([truth[name] for name in layout.names]))
    own = batch.own.copy()
    own[:, :2] = truth["linear_stiffness"], truth["viscous_damping"]
    own[:, 0] *= 1.0 + 0.01 * np.arange(own.shape[0])
    near = fit(layout, batch.turning, start_state(layout, eta, own), nuisances=batch.nuisances)
    return fit(layout, batch.deciding, near.state, iterations=60, nuisances=batch.nuisances)


def far_along(layout, state, ratio):
    """The same force of a joint that never slips as a whole, with another slip displacement: written once more."""
    (strength, slip, exponent) = layout.beds[0]
    eta, own = state.eta.copy(), state.own.copy()
    for r in range(own.shape[0]):
        force, reach, chi = state.eta * (1.0 + layout.scatter * own[r, 7:])
        own[r, 7 + strength] = (
            force * ratio ** (2.0 + chi) / (eta[strength] * ratio ** (2.0 + eta[exponent])) - 1.0
        ) / layout.scatter
        own[r, 0] += force / (reach * layout.amplitude) * (1.0 - ratio ** (1.0 + chi))
    eta[slip] *= ratio
    eta[strength] *= ratio ** (2.0 + eta[exponent])
    return State(eta, own)


@pytest.fixture(scope="module")
def hardly_slipping():
    """A joint of which no record shows where it slips as a whole, and the fit from the truth."""
    batch, truth = joint_batch(21, 3.0, start=AFTER_FIRST_SWING)
    return batch, truth, fit_from(make_layout(IWAN, batch.amplitude, batch.angular_frequency), batch, truth)


# starts beyond the edge of the plateau


def test_what_just_slips_has_the_same_force_where_it_does_not(hardly_slipping):
    batch, _, found = hardly_slipping
    layout, states = found.layout, starts.slipping(found.layout, found.state)
    assert len(states) == 2
    x = np.linspace(0.05, 0.5, 6) * AMPLITUDE
    edges = []
    for state in states:
        for r in range(len(batch.specimens)):
            both = []
            for point in (found.state, state):
                k, force, chi = layout.physical(point.eta, point.own[r, 7:], layout.scatter)[0]
                p = np.array([k, force, chi])
                bed = [LIBRARY["iwan"].force(u, 1.0, 1.0, np.zeros(3), p) for u in x]
                both.append(point.own[r, 0] * x + bed)
            # equal but for rounding
            np.testing.assert_allclose(both[1], both[0], rtol=1e-9)
            edges.append(force * (2.0 + chi) / (k * (1.0 + chi)) / np.abs(found.state.own[:, 2]).max())
    # specimens scatter by a few per cent around the shares
    np.testing.assert_allclose(edges, np.repeat([0.9, 0.6], 2), rtol=0.1)


def test_what_slips_early_or_has_no_exponent_needs_no_start_beyond_an_edge(hardly_slipping):
    batch, _, found = hardly_slipping
    eta = found.state.eta.copy()
    eta[found.layout.beds[0][1]] = 0.1
    assert not starts.slipping(found.layout, State(eta, found.state.own))
    for name in ("jenkins", "cubic_stiffness"):
        layout = make_layout(Oscillator(MASS, (name,)), batch.amplitude, batch.angular_frequency)
        assert not starts.slipping(layout, start_state(layout, starts.typical(layout), batch.own))


def test_a_fit_on_the_plateau_begins_again_from_beyond_its_edge(monkeypatch):
    batch, truth = joint_batch(22, 0.7, decibels=50.0)
    search = Search(batch, BASE, ("iwan",), budget=BUDGET)
    layout = search.layout(("iwan",))
    known = fit_from(layout, batch, truth)
    begun = far_along(layout, known.state, 6.0)
    rested = fit(layout, batch.deciding, begun, iterations=60, nuisances=batch.nuisances)
    # the plateau is a minimum of its own, clearly above the other one
    assert rested.is_converged and rested.cost > known.cost + 20.0
    monkeypatch.setattr(Search, "_set_fits", lambda _self, _names: [rested])
    found = search.fit_set(("iwan",))
    assert found.cost < known.cost + 0.5
    # a set that was fitted is not fitted once more
    monkeypatch.setattr(starts, "slipping", lambda *_: pytest.fail("asked again"))
    assert search.fit_set(("iwan",)) is found


# intervals along the valley


def test_intervals_hold_the_truth_from_anywhere_along_the_valley(hardly_slipping):
    batch, truth, known = hardly_slipping
    every = []
    for ratio in (1.0, 4.0):
        begun = far_along(known.layout, known.state, ratio)
        found = fit(known.layout, batch.deciding, begun, iterations=60, nuisances=batch.nuisances)
        assert found.cost < known.cost + 0.5
        every.append(valleys.ranges(found, batch))
        for name in ("joint_stiffness", "joint_slip_force", "joint_exponent", "linear_stiffness"):
            assert every[-1][name].low < truth[name] * (1.005 if name == "linear_stiffness" else 1.0), name
            assert every[-1][name].high > truth[name], name
        # where the joint would slip as a whole the records say no; towards larger slip forces only the search ends
        assert every[-1]["joint_slip_force"].is_high_open and not every[-1]["joint_slip_force"].is_low_open
        assert not every[-1]["joint_exponent"].is_high_open and not every[-1]["joint_exponent"].is_low_open
        # beside the valley they are what the curvature says; where the joint is near to slipping, the exponent rises
        scattering = valleys._scattering(found, batch.deciding)
        value, error = estimates_of(scattering, scattering.covariance)["joint_exponent"]
        low, high = every[-1]["joint_exponent"].low, every[-1]["joint_exponent"].high
        assert low == pytest.approx(value - 1.96 * error, abs=0.2 * error)
        if ratio == 1.0:
            assert high == pytest.approx(value + 1.96 * error, abs=0.2 * error)
        assert value + 1.76 * error < high < value + 2.5 * error
    # the same end that the records set, wherever the way begins; it is found to the length of a step
    assert every[0]["joint_slip_force"].low == pytest.approx(every[1]["joint_slip_force"].low, rel=0.25)
    # the curvature far along it says the truth cannot be: what this is for
    value, error = estimates_of(found)["joint_slip_force"]
    assert value - 1.96 * error > truth["joint_slip_force"]
    estimate = estimates_from_fit(batch, found)["iwan"]["joint_slip_force"]
    assert estimate.hdi_low < truth["joint_slip_force"] < estimate.hdi_high and estimate.is_high_open


@pytest.fixture(scope="module")
def plain():
    effects = ("cubic_stiffness",)
    batch = batch_of(make_records(np.random.default_rng(24), effects, specimens=3))
    layout = make_layout(Oscillator(MASS, effects), batch.amplitude, batch.angular_frequency)
    return batch, fit_from(layout, batch, truth_of(effects))


def test_intervals_of_few_specimens_hold_the_value_about_which_these_differ(plain, monkeypatch):
    """Stiffnesses of three specimens tell their spread as roughly as three numbers do: Student's t, not the normal."""
    batch, found = plain
    monkeypatch.setattr(valleys, "ranges", lambda *_: {})
    rng, held = np.random.default_rng(25), []
    for _ in range(400):
        own = found.state.own.copy()
        own[:, 0] = STIFFNESS * (1.0 + 0.03 * rng.standard_normal(3))
        drawn = replace(found, state=State(found.state.eta, own))
        estimate = estimates_from_fit(batch, drawn)["linear_stiffness"]["linear_stiffness"]
        held.append(estimate.hdi_low < STIFFNESS < estimate.hdi_high)
    assert 0.92 < np.mean(held) < 0.98  # with 1.96 standard errors it would be 0.81


def test_priors_hold_what_the_fit_allows():
    fitted = {"iwan": {"a": Estimate(2.0, 1.0, 0.5, 9.0, "N"), "b": Estimate(1.0, 0.1, 0.9, 1.1, "N")}}
    assert _reaching({"a": (1.0, 3.0), "b": (0.0, 2.0), "c": (4.0, 5.0)}, fitted) == {
        "a": (0.5, 9.0), "b": (0.0, 2.0), "c": (4.0, 5.0),
    }  # fmt: skip


@pytest.mark.parametrize("apart", [0.0, 5.0])
def test_draws_that_did_not_mix_say_nothing_of_the_parameters(plain, apart):
    _, found = plain
    rng, names = np.random.default_rng(26), found.layout.oscillator.parameter_names
    offsets = apart * np.arange(2)[:, None]
    draws = {name: 10.0 + offsets + rng.standard_normal((2, 500)) for name in names}
    posterior = xr.DataTree.from_dict({"posterior": xr.Dataset({k: (("chain", "draw"), v) for k, v in draws.items()})})
    fitted = {"cubic_stiffness": {"cubic_stiffness": Estimate(1.0, 0.1, 0.8, 1.2, "N/m^3")}}
    estimates, said, figures = _told_by(posterior, found, {}, fitted)
    assert (estimates is fitted) == (figures["r_hat"] > UNMIXED) == bool(apart)
    assert any("did not mix" in item for item in said) == bool(apart)


def test_where_everything_is_well_known_the_curvature_says_all():
    effects = ("cubic_stiffness", "quadratic_damping")
    batch, truth = batch_of(make_records(np.random.default_rng(23), effects)), truth_of(effects)
    found = fit_from(make_layout(Oscillator(MASS, effects), batch.amplitude, batch.angular_frequency), batch, truth)
    assert valleys.ranges(found, batch) == {}
    for name, (value, error) in estimates_of(found).items():
        (estimate,) = (group[name] for group in estimates_from_fit(batch, found).values() if name in group)
        assert (estimate.mean, estimate.sd) == (value, error)
        assert not estimate.is_low_open and not estimate.is_high_open


def test_a_straight_valley_is_as_long_as_the_curvature_says(monkeypatch):
    effects = ("cubic_stiffness", "quadratic_damping")
    batch, truth = batch_of(make_records(np.random.default_rng(24), effects, share=0.3)), truth_of(effects, 0.3)
    found = fit_from(make_layout(Oscillator(MASS, effects), batch.amplitude, batch.angular_frequency), batch, truth)
    monkeypatch.setattr(valley_walk, "LOOSE", 1e-3)  # as if it had to be followed
    monkeypatch.setattr(valley_walk, "_MIXED", 0.0)
    monkeypatch.setattr(valley_walk, "_FIRST_STEP", 0.02)
    followed = valleys.ranges(found, batch)
    for name, (value, error) in estimates_of(found).items():
        assert followed[name].low == pytest.approx(value - 1.96 * error, abs=0.15 * error)
        assert followed[name].high == pytest.approx(value + 1.96 * error, abs=0.15 * error)


@pytest.mark.parametrize("scatter", [0.02, 0.3])
def test_a_valley_is_as_wide_as_specimens_are_inferred_to_scatter(monkeypatch, scatter):
    drawn = np.random.default_rng(8).standard_normal(10)
    batch = backbones(1.0 + scatter * (drawn - drawn.mean()) / drawn.std())
    oscillator = Oscillator(CASE_MASS, ("cubic_stiffness", "quintic_stiffness"))
    layout = make_layout(oscillator, batch.amplitude, batch.angular_frequency)
    start = start_state(layout, np.array([CUBIC, 0.0]), batch.own)
    found = fit(layout, batch.levels, start, nuisances=batch.nuisances)
    monkeypatch.setattr(valley_walk, "LOOSE", 1e-3)
    monkeypatch.setattr(valley_walk, "_MIXED", 0.0)
    monkeypatch.setattr(valley_walk, "_FIRST_STEP", 0.02)
    cubic = valleys.ranges(found, batch)["cubic_stiffness"]
    # ten values of this scatter leave their mean open by it over the root of ten; it is known to a third itself
    assert 0.5 * (cubic.high - cubic.low) / 1.96 == pytest.approx(scatter * CUBIC / np.sqrt(10.0), rel=0.35)


def test_a_way_leads_back_from_the_limit_that_a_fit_rests_at(hardly_slipping):
    batch, truth, known = hardly_slipping
    begun = far_along(known.layout, known.state, 4.0)
    strength = known.layout.beds[0][0]
    high = known.layout.high.copy()
    high[strength] = begun.eta[strength]
    low = known.layout.low.copy()
    low[strength] = high[strength]  # or it comes to rest a little below, where specimens deviate less
    held = replace(known.layout, low=low, high=high)
    found = fit(held, batch.deciding, begun, iterations=60, nuisances=batch.nuisances)
    assert found.state.eta[strength] == high[strength] and found.cost < known.cost + 0.5
    found = replace(found, layout=replace(known.layout, high=high))
    followed = valleys.ranges(found, batch)
    for name in ("joint_stiffness", "joint_slip_force", "joint_exponent", "linear_stiffness"):
        assert followed[name].low < truth[name] < followed[name].high, name


@pytest.mark.parametrize("slip", [3.0, 0.3])
def test_at_the_edge_of_the_plateau_intervals_are_those_of_the_plateau(slip):
    """Where the bed just slips as a whole the curvature is that of the steep side, and says the truth cannot be."""
    batch, truth = joint_batch(22, slip, decibels=55.0)
    known = fit_from(make_layout(IWAN, batch.amplitude, batch.angular_frequency), batch, truth)
    near = starts.slipping(known.layout, known.state)[:1] if slip > 1.0 else [known.state]
    found = fit(known.layout, batch.deciding, near[0], iterations=60, nuisances=batch.nuisances)
    followed = valleys.ranges(found, batch)
    value, error = estimates_of(found)["joint_slip_force"]
    if slip > 1.0:
        assert value + 4.0 * error < truth["joint_slip_force"] < followed["joint_slip_force"].high
    else:  # one that slips is well known: nothing lies beyond
        assert not followed or followed["joint_slip_force"].high < 1.2 * value


@pytest.mark.parametrize(("above", "is_followed"), [(4.5, True), (25.0, False)])
def test_a_plateau_that_leaves_more_than_its_edge_is_followed_while_it_is_not_much_less_likely(
    above, is_followed, monkeypatch
):
    """It is so much wider: a slip force of a third of the truth, to 6 %, had left 3.5 of chi-square less."""
    batch, truth = joint_batch(22, 3.0, decibels=55.0)
    known = fit_from(make_layout(IWAN, batch.amplitude, batch.angular_frequency), batch, truth)
    edge = fit(known.layout, batch.deciding, starts.slipping(known.layout, known.state)[0], iterations=60,
               nuisances=batch.nuisances)  # fmt: skip
    (start,) = starts.sticking(edge.layout, edge.state)
    plateau = fit(edge.layout, batch.deciding, start, nuisances=batch.nuisances)
    monkeypatch.setattr(valleys, "_scattering", lambda found, _terms: found)
    raised = replace(
        plateau, chi_square=plateau.chi_square + (edge.cost + above - plateau.cost) / plateau.chi_square.size
    )
    assert raised.cost == pytest.approx(edge.cost + above)
    monkeypatch.setattr(valleys, "_fitted", lambda *_: raised)
    loose = valley_walk.Walk.directions
    monkeypatch.setattr(valley_walk.Walk, "directions", lambda walk: [] if walk.found is edge else loose(walk))
    followed = valleys.ranges(edge, batch)
    name = "joint_slip_force"
    value, error = estimates_of(edge)[name]
    assert value + 4.0 * error < truth[name]
    if is_followed:
        assert followed[name].high > truth[name] and followed[name].is_high_open
        assert followed[name].low < value - error  # and what the edge says is in it
    else:
        assert followed == {}


def test_no_phase_is_lost_on_a_step_along_a_valley(hardly_slipping):
    """What a joint has less of stiffness the specimen has more: by the tangent, such a step left 1100 to 1400 more."""
    batch, _, known = hardly_slipping
    begun = far_along(known.layout, known.state, 4.0)
    found = fit(known.layout, batch.deciding, begun, iterations=60, nuisances=batch.nuisances)
    walk = valley_walk.Walk(found, batch.deciding)
    (along,) = walk.directions()
    here = valley_walk.Place(0.0, walk.chart.to(found.state.eta), found.state, found.system, found.cost)
    for side in (1.0, -1.0):
        chart, own = walk._predicted([here], side * along, 0.1)
        state = State(walk.layout.within(walk.chart.back(chart)), own)
        moved = linearise(walk.layout, walk.terms, state, walk.scatter, walk.active)
        assert moved.cost < found.cost + 30.0


def test_a_fit_to_other_data_is_not_followed(hardly_slipping):
    batch, _, found = hardly_slipping
    assert valleys.ranges(replace(found, chi_square=found.chi_square + 50.0), batch) == {}


def test_an_end_that_only_the_search_sets_is_told_as_such(hardly_slipping):
    batch, _, found = hardly_slipping
    estimate = estimates_from_fit(batch, found)["iwan"]["joint_slip_force"]
    said = {
        ends: str(_interval(replace(estimate, is_low_open=ends[0], is_high_open=ends[1]), 3))
        for ends in ((False, False), (False, True), (True, False), (True, True))
    }
    assert " to " in said[False, False] and said[True, True] == "not bounded by the records"
    assert said[False, True].startswith("at least ") and said[True, False].startswith("at most ")
