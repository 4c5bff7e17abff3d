"""Laws that remember, and what stands in for them: each is asked, and from where it can be found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pymc_backbone.discrepancy.fitting import starts
from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.normal_equations import State
from pymc_backbone.discrepancy.sets.followed_sets import REACH, _Followed
from pymc_backbone.discrepancy.sets.known_sets import BUDGET
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_waveform

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    MASS,
    OMEGA,
    PER_CYCLE,
    RELEASE_TIME,
    STIFFNESS,
    batch_of,
    noisy,
)

CYCLES = 60
TIME = np.arange(0, int((CYCLES + 1.3) * PER_CYCLE)) / (PER_CYCLE * OMEGA / (2.0 * np.pi))


def far_from_saturation(decibels):
    """Two specimens with Bouc-Wen hysteresis of exponent 2 that loses a few tenths of its displacement at most."""
    rng, model = np.random.default_rng(31), Oscillator(MASS, ("bouc_wen",))
    records, vectors = [], []
    for r in range(2):
        truth = {
            "linear_stiffness": (1.0 + 0.01 * r) * STIFFNESS,
            "viscous_damping": DAMPING,
            "bouc_wen_stiffness": 0.25 * STIFFNESS,
            "bouc_wen_amplitude": 1.0,
            "bouc_wen_alpha": 0.0,
            "bouc_wen_beta": 0.4 / AMPLITUDE**2,
            "bouc_wen_gamma": 0.2 / AMPLITUDE**2,
            "bouc_wen_exponent": 2.0,
        }
        vectors.append(np.array([truth[name] for name in model.parameter_names]))
        release = AMPLITUDE * (1.0 - 0.25 * r)
        found = simulate_waveform(model, vectors[-1], TIME, release, release_time=RELEASE_TIME)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, found.values, decibels))
    return batch_of(records), np.array(vectors)


@pytest.fixture(scope="module")
def hysteretic():
    batch, vectors = far_from_saturation(55.0)
    search = Search(batch, Oscillator(MASS), ("bouc_wen",), 1, budget=BUDGET)
    layout = search.layout(("bouc_wen",))
    own = np.zeros((2, 7 + layout.free.size))
    own[:, :2], own[:, 2:7] = vectors[:, :2], np.pad(batch.own[:, 2:], ((0, 0), (0, 5)))[:, :5]
    eta = layout.coordinates(vectors[0][layout.free])
    known = fit(layout, batch.deciding, State(eta, own), iterations=60, nuisances=batch.nuisances)
    return search, known


def test_hysteresis_nearer_to_its_saturation_has_the_same_force_far_from_it(hysteretic):
    _, known = hysteretic
    layout = known.layout
    (strength, saturates), *others = layout.lags
    assert not others and [layout.names[place] for place in (strength, *saturates)] == [
        "bouc_wen_stiffness",
        "bouc_wen_beta",
        "bouc_wen_gamma",
    ]
    far = State(known.state.eta * np.array([5.0, 0.2, 0.2, 1.0]), known.state.own)
    states = starts.saturating(layout, far)
    assert len(states) == 2 and not starts.saturating(layout, known.state)
    for state in states:
        assert state.eta[saturates].sum() > 2.0 * far.eta[saturates].sum()
        np.testing.assert_allclose(state.eta[strength] * state.eta[saturates], far.eta[strength] * far.eta[saturates])
        np.testing.assert_allclose(state.own[:, 0] + state.eta[strength], far.own[:, 0] + far.eta[strength])


def test_hysteresis_begins_again_from_nearer_to_its_saturation(hysteretic, monkeypatch):
    search, known = hysteretic
    eta = known.state.eta * np.array([3.2, 1.0 / 3.2, 1.0 / 3.2, 1.0])
    own = known.state.own[:, :2].copy()
    own[:, 0] -= eta[0] - known.state.eta[0]
    rested = search.descent.from_afar(known.layout, search.descent.released(known.layout, eta, own))
    # a minimum of its own, whose plain spring is all but used up
    assert rested.is_converged and rested.cost > known.cost + 100.0
    assert rested.state.own[:, 0].max() < 0.25 * STIFFNESS
    monkeypatch.setattr(Search, "_set_fits", lambda _self, _names: [rested])
    assert search.fit_set(("bouc_wen",)).cost < known.cost + 0.5


def test_hysteresis_is_looked_for_in_the_other_valley_from_each_smaller_set(hysteretic, monkeypatch):
    known_search, known = hysteretic
    search = Search(known_search.batch, Oscillator(MASS), ("bouc_wen",), 1, budget=BUDGET)
    search.fit_set(())
    eta = known.state.eta * np.array([3.2, 1.0 / 3.2, 1.0 / 3.2, 1.0])
    own = known.state.own[:, :2].copy()
    own[:, 0] -= eta[0] - known.state.eta[0]
    rested = search.descent.from_afar(known.layout, search.descent.released(known.layout, eta, own))
    search.fits["bouc_wen",] = rested
    search._look_in_other_valley()
    assert search.fits["bouc_wen",] is rested  # what explains nothing is not named, and not asked
    monkeypatch.setattr(Search, "explains", lambda _self, _found: True)
    search._look_in_other_valley()
    assert search.fits["bouc_wen",].cost < known.cost + 0.5 < rested.cost - 100.0


@pytest.mark.parametrize(
    ("of_base", "of_other", "is_asked"),
    [(None, 0.0, True), (50.0, 0.0, True), (5.0, 0.0, False), (300.0, -200.0, False)],
)
def test_hysteresis_that_cannot_count_does_not_begin_again(of_base, of_other, is_asked, hysteretic, monkeypatch):
    """Of records that the model as it is explains, two whole fits of hysteresis had been most of what was spent."""
    known_search, known = hysteretic
    search = Search(known_search.batch, Oscillator(MASS), ("bouc_wen",), 1, budget=BUDGET)
    asked = []
    monkeypatch.setattr(Search, "_set_fits", lambda _self, _names: [known])
    monkeypatch.setattr(Search, "_slipping", lambda _self, _found: [])
    monkeypatch.setattr(Search, "_saturating", lambda _self, found: asked.append(found) or [])
    monkeypatch.setattr(Search, "explains", lambda _self, _found: of_base is not None)
    for names, above in (((), of_base or 1e6), (("cubic_stiffness",), of_other)):
        search.fits[names] = replace(known, chi_square=known.chi_square + above / known.chi_square.size)
    assert search.fit_set(("bouc_wen",)) is known
    assert asked == ([known] if is_asked else [])


def test_what_remembers_is_asked_where_two_laws_imitate_it_whatever_was_spent():
    batch, _ = far_from_saturation(40.0)
    pair, single = ("cubic_damping", "cubic_stiffness"), ("bouc_wen",)
    search = Search(batch, Oscillator(MASS), (*pair, *single), 2, budget=1e3)
    for names in ((), pair):
        search.fit_set(names)
    search._ask_simpler(_Followed())  # nothing explains
    assert search._is_spent and search.explains(search.fits[pair]) and single not in search.fits
    search._ask_simpler(_Followed(explained=[pair], reach=search.proposals[pair].log_evidence - REACH))
    assert set(search.fits) == {(), pair, single}
    assert search.best() == single


SLIDER, STOP = ("freeplay", "jenkins"), ("dead_band_damping", "freeplay")


def stops_with_loss(candidates, **settings):
    """The search of two specimens between stops that dissipate, its base, stops and slider fitted."""
    rng, model = np.random.default_rng(32), Oscillator(MASS, ("freeplay", "dead_band_damping"))
    truth = {
        "linear_stiffness": STIFFNESS,
        "viscous_damping": DAMPING,
        "contact_stiffness": 0.3 * STIFFNESS,
        "gap": 0.65 * AMPLITUDE,
        "dead_band_damping": 0.06 * STIFFNESS / OMEGA,
        "dead_band": 0.65 * AMPLITUDE,
    }
    records = []
    for release in (AMPLITUDE, 0.8 * AMPLITUDE):
        vector = [truth[name] for name in model.parameter_names]
        found = simulate_waveform(model, vector, TIME, release, release_time=RELEASE_TIME)
        records.append(noisy(rng, f"from {release}", TIME, found.values, 40.0))
    search = Search(batch_of(records), Oscillator(MASS), candidates, 2, **settings)
    for names in ((), ("freeplay",), SLIDER):
        search.fit_set(names)
        search.mend(names)
    assert search.best() == SLIDER and search.explains(search.fits[SLIDER])
    return search


def test_a_rare_law_beyond_a_gap_is_asked_in_the_place_of_a_slider():
    variants = ("dead_band_damping", "geometric_stiffness")
    search = stops_with_loss(("freeplay", "jenkins", "quadratic_damping"), variants=variants)
    assert search._in_place_of_memory() == [STOP]
    search._vary()
    assert search.best() == STOP
    assert search._in_place_of_memory() == []  # nothing that remembers is left


def test_what_a_step_promises_replaces_an_effect_whatever_was_spent():
    search = stops_with_loss(("freeplay", "jenkins", "quadratic_damping", "dead_band_damping"))
    search.budget = 0.0
    assert search._is_spent and search._replace()
    assert search.best() == STOP
    assert ("freeplay", "quadratic_damping") not in search.fits  # promises less than half of it
