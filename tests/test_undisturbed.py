"""In which order what disturbs records is asked."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from pymc_backbone.discrepancy import undisturbed as module
from pymc_backbone.discrepancy.evidence import Drifting


@pytest.mark.parametrize("is_drifting", [True, False])
def test_a_drift_is_asked_before_cycles_are_left_out_and_sensors_straightened(is_drifting, monkeypatch):
    left = {"base": False, "drift": is_drifting}
    asked = []

    def says(name):
        return lambda *_: asked.append(name)

    for name in ("earlier", "begun", "motion_noise", "disturbed"):
        monkeypatch.setattr(module, name, says(name))
    monkeypatch.setattr(module.evidence, "leaves_noise", lambda _, found: left[found])
    search = SimpleNamespace(batch=None, fits={(): "base"}, best=tuple)

    def drifting(_):
        asked.append("drift")
        return {(): Drifting("drift", 0.0)}

    known = module.undisturbed(SimpleNamespace(), search, [], None, says("searched"), drifting)
    assert known.search is search and known.is_drifting == is_drifting
    first, last = (["earlier", "drift"], ["motion_noise"])
    assert asked == (first + last if is_drifting else [*first, "begun", *last, "disturbed"])
