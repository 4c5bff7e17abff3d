"""Sets fitted beside each other: what each learns is kept, and the same on one core as on many."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from pymc_backbone._common import threads
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.sets.side_by_side import fit_side_by_side
from pymc_backbone.oscillator import Oscillator

from .discrepancy_cases import MASS, batch_of, make_records

CUBIC, QUINTIC, DRAG = ("cubic_stiffness",), ("quintic_stiffness",), ("quadratic_damping",)
CANDIDATES = ("cubic_stiffness", "quintic_stiffness", "quadratic_damping")


@pytest.fixture(scope="module")
def batch():
    return batch_of(make_records(np.random.default_rng(8), CUBIC, specimens=2))


@pytest.fixture(autouse=True)
def one_thread_of_linear_algebra():
    """As a study has it: several round differently."""
    with threadpool_limits(1):
        yield


def begun(batch) -> Search:
    search = Search(batch, Oscillator(MASS), CANDIDATES, 2)
    search.fit_set(())
    return search


@pytest.mark.parametrize("cores", [1, 2])
def test_each_is_fitted_as_if_the_other_were_not_there(batch, monkeypatch, cores):
    monkeypatch.setattr(threads, "cores", lambda: cores)
    together, effort = begun(batch), {}
    before = together.descent.effort
    fit_side_by_side(together, [CUBIC, QUINTIC])
    for names in (CUBIC, QUINTIC):
        alone = begun(batch)
        found = alone.fit_set(names)
        effort[names] = alone.descent.effort - before
        assert found.cost == together.fits[names].cost
        np.testing.assert_array_equal(found.state.own, together.fits[names].state.own)
        assert (names in alone.refuted) == (names in together.refuted)
    assert list(together.fits) == [(), CUBIC, QUINTIC]
    assert together.descent.effort - before == pytest.approx(sum(effort.values()))
    assert together.explains(together.fits[CUBIC]) and not together.explains(together.fits[QUINTIC])


def test_what_is_known_is_left_alone(batch):
    search = begun(batch)
    kept, effort = search.fit_set(CUBIC), search.descent.effort
    fit_side_by_side(search, [CUBIC, CUBIC])
    assert search.fits[CUBIC] is kept and search.descent.effort == effort
    fit_side_by_side(search, [CUBIC, DRAG, DRAG])
    assert search.fits[CUBIC] is kept and set(search.fits) == {(), CUBIC, DRAG}


def test_what_cannot_be_fitted_is_told(batch, monkeypatch):
    search = begun(batch)
    fitted = Search._set_fits
    monkeypatch.setattr(Search, "_set_fits", lambda self, names: [] if names == DRAG else fitted(self, names))
    fit_side_by_side(search, [DRAG, CUBIC])
    assert set(search.fits) == {(), CUBIC} and set(search.failed) == {DRAG}


def test_a_set_that_holds_another_begins_where_that_one_ended(batch, monkeypatch):
    both, seen = ("cubic_stiffness", "quadratic_damping"), {}
    fitted = Search._set_fits

    def noted(self, names):
        seen[names] = set(self.fits)
        return fitted(self, names)

    monkeypatch.setattr(Search, "_set_fits", noted)
    search = begun(batch)
    fit_side_by_side(search, [both, CUBIC, QUINTIC])
    assert CUBIC in seen[both] and QUINTIC in seen[both] and seen[CUBIC] == seen[QUINTIC] == {()}
    assert search.fits[both].cost <= search.fits[CUBIC].cost + 1.0
