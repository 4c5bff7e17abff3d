"""What closes less than a thousandth of the gap is given to what is simpler, or less rare."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from pymc_backbone.discrepancy.deciding import as_good
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.discrepancy.weighing.evidence import DRIFT, Evidence

BATCH = SimpleNamespace(has_records=True)
CUBIC, POWER, FREE = "cubic_stiffness", "power_stiffness", "freeplay"


def raised(costs, *, is_noise=True, monkeypatch=None):
    """What the odds of sets rise by, for costs and evidences of minus half of these."""
    monkeypatch.setattr(evidence, "leaves_noise", lambda *_: is_noise)
    fits = {names: SimpleNamespace(cost=cost) for names, cost in costs.items()}
    evidences = {names: Evidence(-0.5 * cost, 0.0, 0.0) for names, cost in costs.items()}
    return as_good.odds_of_as_good(BATCH, fits, evidences, (POWER,))


@pytest.mark.parametrize(("gap", "expected"), [(1e9, 32.0), (1e7, None)])
def test_a_law_is_as_good_as_its_variant_that_explains_a_thousandth_more(gap, expected, monkeypatch):
    """A chi-square of 64 is nothing of a gap of a thousand million, and six times the limit of ten millions."""
    costs = {(): gap, (CUBIC,): 1064.0, (POWER,): 1000.0, (FREE,): 1010.0}
    odds = raised(costs, monkeypatch=monkeypatch)
    assert odds == ({(CUBIC,): pytest.approx(expected)} if expected else {})
    assert raised(costs, is_noise=False, monkeypatch=monkeypatch) == {}


def test_beside_a_drift_what_makes_up_for_its_course_is_no_effect(monkeypatch):
    """Its course is linear in time, no real one's is; without a drift a second effect keeps its evidence."""
    costs = {(): 1e9, (CUBIC,): 2e3, (CUBIC, FREE): 1.9e3, DRIFT: 1060.0, (FREE, *DRIFT): 1020.0,
             (CUBIC, FREE, *DRIFT): 1000.0}  # fmt: skip
    odds = raised(costs, monkeypatch=monkeypatch)
    assert odds == {DRIFT: pytest.approx(30.0), (FREE, *DRIFT): pytest.approx(10.0)}


def test_backbones_alone_are_left_as_they_are(monkeypatch):
    monkeypatch.setattr(BATCH, "has_records", False)
    assert raised({(): 1e9, (CUBIC,): 1064.0, (POWER,): 1000.0}, monkeypatch=monkeypatch) == {}
