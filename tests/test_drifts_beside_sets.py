"""Sets with a drift in time beside them: from where they are begun, and when a drift may settle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pymc_backbone.discrepancy.checks import rivals
from pymc_backbone.discrepancy.drift.drift_fits import Settled, drift_fit, likeliest, weighed
from pymc_backbone.discrepancy.fitting import equal_forces, starts
from pymc_backbone.discrepancy.fitting.normal_equations import State
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.discrepancy.weighing.evidence import Drifting

from .discrepancy_cases import AMPLITUDE, DAMPING, STIFFNESS, drifting_records
from .test_early_edges import PLAY, searched, simulated


def test_what_is_in_a_set_with_a_drift_begins_where_that_ended(rng, monkeypatch):
    """Alone, a law had followed the drift; so had it beside one, begun there, and what is not there had to help."""
    search = searched(drifting_records(rng, 0.03, cubic=0.08), ("cubic_stiffness", "quadratic_damping"))
    law, both = ("cubic_stiffness",), ("cubic_stiffness", "quadratic_damping")
    layout, truth = search.layout(both), {"cubic_stiffness": 0.08 * STIFFNESS / AMPLITUDE**2, "quadratic_damping": 0.0}
    own = np.zeros((2, 7 + layout.free.size))
    own[:, :2], own[:, 2:4] = (STIFFNESS, DAMPING), search.batch.own[:, 2:4]
    begun = State(layout.coordinates(np.array([truth[name] for name in layout.names])), own)
    alone, lost = search.fit_set(both), search.fit_set(law)
    larger = drift_fit(search.batch, layout, begun)
    assert evidence.leaves_noise(search.batch, larger)
    found = {both: weighed(search.batch, larger, alone)}
    assert larger.cost < alone.cost - 100.0
    rivals._ask_parts(search, found, np.inf)
    assert evidence.leaves_noise(search.batch, found[law].fit)
    assert found[law].fit.cost < larger.cost + 10.0 < lost.cost
    assert () not in found or found[()].fit.cost > 2.0 * larger.cost


@pytest.mark.parametrize("change", [-0.01, -0.02])
def test_what_a_variant_varies_is_asked_beside_a_drift(change, rng):
    """A gap makes up for a small drift, and no other law of a contact did without: that of no gap is no contact."""
    search = searched(drifting_records(rng, change, one_side=-0.15), ("bilinear_stiffness", "coulomb_friction"))
    search.variants = ("one_sided_stiffness",)
    varied, plain = ("one_sided_stiffness",), ("bilinear_stiffness",)
    search.fit_set(varied)
    assert evidence.leaves_noise(search.batch, search.fits[varied]) == (change > -0.015)
    found = rivals.drifting_sets(search)
    assert evidence.leaves_noise(search.batch, found[plain].fit)
    assert found[plain].fit.cost < search.fits[varied].cost - 20.0
    assert likeliest(search, found) == (*plain, *evidence.DRIFT)


def test_a_contact_beside_a_drift_is_begun_from_other_gaps(rng, monkeypatch):
    """Alone it had followed the drift with a gap of a quarter and stops of twice the stiffness, and stayed there."""
    search = searched(simulated(rng, "freeplay", PLAY, 2), ("freeplay", "cubic_stiffness"))
    law = ("freeplay",)
    right = search.fit_set(law)
    layout = search.layout(law)
    gap = right.state.eta[1]
    begun = equal_forces.with_other_gaps(layout, right, search.batch.angular_frequency)
    displacements = [starts.parameters_at(layout, state.eta)[layout.oscillator.index("gap")] for state in begun]
    assert np.array(displacements) / layout.amplitude == pytest.approx([0.1, 0.25, 0.5])
    asked = []

    def fitted(_batch, _layout, state, _limit):
        asked.append(state)
        # what a fit leaves that stays at the gap where it began
        return replace(right, chi_square=right.chi_square + 50.0 * abs(np.log(state.eta[1] / gap)))

    monkeypatch.setattr(rivals, "drift_fit", fitted)
    monkeypatch.setattr(rivals, "weighed", lambda _batch, drifting, _alone: Drifting(drifting, 0.0))
    lost = Drifting(replace(right, chi_square=right.chi_square + 100.0), 0.0)
    found = {law: lost, (): lost}
    rivals._ask_other_gaps(search, found, np.inf)
    assert len(asked) == 3 and found[()] is lost
    nearest = min(asked, key=lambda state: abs(np.log(state.eta[1] / gap)))
    assert found[law].fit.cost == pytest.approx(fitted(None, None, nearest, None).cost)
    assert found[law].fit.cost < lost.fit.cost


def test_other_gaps_keep_the_force_over_the_motion(rng):
    search = searched(simulated(rng, "freeplay", PLAY, 2), ("freeplay",))
    known = search.fit_set(("freeplay",))
    layout, omega = known.layout, search.batch.angular_frequency
    x, v, a = equal_forces.typical_motion(layout, omega)
    for state in equal_forces.with_other_gaps(layout, known, omega):
        forces = []
        for item in (known.state, state):
            force = starts.forces(
                layout, layout.oscillator.effects[-1], starts.parameters_at(layout, item.eta), x, v, a
            )
            forces.append(force + item.own[0, 0] * x)
        before, after = (np.abs(force).max() for force in forces)
        assert np.abs(forces[1] - forces[0]).max() < 0.05 * before
        assert after == pytest.approx(before, rel=0.05)


@pytest.mark.parametrize("releases_say_so", [True, False])
def test_a_drift_settles_in_the_place_of_a_law_where_releases_say_so(releases_say_so, rng, monkeypatch):
    """Over one record both are the same curve: a softening spring had been a stiffness that settles, and a play."""
    search = searched(drifting_records(rng, 0.0, cubic=0.08), ("cubic_stiffness", "quadratic_damping"))
    both = ("cubic_stiffness", "quadratic_damping")
    for names in (both, ("cubic_stiffness",)):
        assert evidence.leaves_noise(search.batch, search.fit_set(names))
    steady, batch = search.fits[("cubic_stiffness",)], search.batch
    found = {both: Drifting(search.fits[both], 0.0), (): Drifting(search.fits[()], 0.0)}
    monkeypatch.setattr(search, "best", lambda: both)
    monkeypatch.setattr(rivals, "settled", lambda *_: Settled(batch, steady, releases_say_so))
    monkeypatch.setattr(rivals, "_is_likeliest", lambda *_: True)
    monkeypatch.setattr(rivals, "drifting_sets", lambda _: "with a drift that settles")
    assert rivals._settled(search, found) == ("with a drift that settles" if releases_say_so else found)
