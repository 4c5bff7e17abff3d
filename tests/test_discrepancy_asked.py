"""What the search asks whatever the backbones say: springs of two sides, and what a linear step promises most of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from pymc_backbone.discrepancy.checks import data_checks
from pymc_backbone.discrepancy.fitting.curves import has_mid_line
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.oscillator import Oscillator

from .discrepancy_cases import DAMPING, MASS, RELEASE_TIME, STIFFNESS, TIME, batch_of, free_decay, make_records, noisy

SIDES = 0.2  # stiffness of one side beyond that of the other, over the latter


def two_sided(rng, quantity):
    """Records of a spring that is stiffer on one side: displacements, or velocities through a spline of many points."""

    def force(x: float, v: float, direction: float) -> float:
        return STIFFNESS * (x + SIDES * max(x, 0.0)) + DAMPING * v

    dense = np.arange(0, 10 * TIME.size) / 10.0 * (TIME[1] - TIME[0])
    records = []
    for r, release in enumerate((0.01, 0.008)):
        exact = free_decay(force, release, dense - RELEASE_TIME)
        if quantity == "velocity":
            moving = dense >= RELEASE_TIME
            rate = np.zeros(dense.size)
            rate[moving] = make_interp_spline(dense[moving], exact[moving], k=5).derivative()(dense[moving])
            exact = rate / 30.0  # about as large as the displacement, for the noise
        record = noisy(rng, f"specimen {r + 1}", TIME, exact[::10], 50.0)
        if quantity == "velocity":
            record = replace(record, values=30.0 * record.values, quantity="velocity", unit="m/s")
        records.append(record)
    return records


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
def test_springs_of_two_sides_are_asked_in_the_place_of_contacts_where_no_mid_line_is_measured(
    rng, quantity, monkeypatch
):
    batch = batch_of(two_sided(rng, quantity))
    assert batch.lacks_mid_line == (quantity == "velocity")
    search = Search(batch, Oscillator(MASS), ("bilinear_stiffness", "cubic_stiffness", "freeplay"), 1)
    search.fit_set(())
    monkeypatch.setattr(search, "best", lambda largest=None: ("freeplay",))
    monkeypatch.setattr(search, "_is_explained", lambda: True)
    search._ask_two_sides()
    assert set(search.fits) - {()} == ({("bilinear_stiffness",)} if quantity == "velocity" else set())
    if quantity == "velocity":
        found = search.fits[("bilinear_stiffness",)]
        assert search.reduced(found) < 1.2
        assert found.value_of("bilinear_stiffness") == pytest.approx(SIDES * STIFFNESS, rel=0.02)
        # its backbones are not held against it: without the mid-line they are off
        assert has_mid_line(batch, found) and not has_mid_line(batch, search.fits[()])
        assert data_checks.data_terms_check(batch, 50.0, 5.0, is_of_two_sides=True).passed
        assert not data_checks.data_terms_check(batch, 50.0, 5.0).passed


@pytest.mark.parametrize("is_spent", [False, True])
def test_what_a_linear_step_promises_most_of_is_added_to_simple_sets(is_spent):
    """Of three effects two were fitted; the third is found from there, and nothing more is asked once it explains.

    Whatever was spent: of a stop with friction and air drag the stop and the friction had been left at that.
    """
    rng = np.random.default_rng(5)
    hidden = ("coulomb_friction", "cubic_stiffness", "quadratic_damping")
    batch = batch_of(make_records(rng, hidden, decibels=62.0))
    candidates = (*hidden, "quadratic_stiffness", "quintic_stiffness")
    search = Search(batch, Oscillator(MASS), tuple(sorted(candidates)), 3)
    for names in ((), ("coulomb_friction", "cubic_stiffness")):
        search.fit_set(names)
    before = search.fits[("coulomb_friction", "cubic_stiffness")]
    assert 1.5 < search.reduced(before) < 10.0
    search.budget = 0.0 if is_spent else search.budget
    assert search._is_spent == is_spent
    search._ask_promised()
    assert set(search.fits) == {(), ("coulomb_friction", "cubic_stiffness"), hidden}
    assert search.reduced(search.fits[hidden]) < 1.2
    search._ask_promised()
    assert len(search.fits) == 3


def test_nothing_is_added_where_no_effect_promises_most_of_the_rest(rng):
    batch = batch_of(make_records(rng, ("coulomb_friction", "cubic_stiffness"), decibels=50.0))
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness", "quadratic_damping", "quadratic_stiffness"), 2)
    search.fit_set(())
    search.fit_set(("cubic_stiffness",))
    search._ask_promised()
    assert ("cubic_stiffness", "quadratic_stiffness") not in search.fits


def test_a_search_that_is_spent_asks_once_what_the_nearest_lack(rng, monkeypatch):
    batch = batch_of(make_records(rng, ("cubic_stiffness",), decibels=40.0))
    search = Search(batch, Oscillator(MASS), ("cubic_stiffness", "quadratic_damping"), 3)
    search.fit_set(())
    search.fit_set(("cubic_stiffness",))
    search.budget, asked = 0.0, []
    monkeypatch.setattr(search, "_is_settled", lambda: False)
    monkeypatch.setattr(
        search, "_promised", lambda names: asked.append(names) or ("cubic_stiffness", "quadratic_damping")
    )
    search._ask_promised()
    assert asked == [("cubic_stiffness",)] and ("cubic_stiffness", "quadratic_damping") in search.fits
    search.budget = np.inf
    search._ask_promised()  # the first again, then what it led to
    assert sorted(asked[1:]) == [("cubic_stiffness",), ("cubic_stiffness", "quadratic_damping")]
