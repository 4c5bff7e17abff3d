"""Records that begin more than half a cycle after the release of a structure that remembers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances import earlier_release as module
from pymc_backbone.discrepancy.disturbances import undisturbed
from pymc_backbone.discrepancy.disturbances.changed import Known, Undisturbed
from pymc_backbone.discrepancy.disturbances.earlier_release import Earlier, earlier
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence

from .discrepancy_cases import AMPLITUDE, DAMPING, FREQUENCY, MASS, STIFFNESS, TIME, batch_of, noisy

# yields where the motion begins; a slider that slips each half cycle would forget where it was released
_YIELD = AMPLITUDE**-1.8
REMEMBERS = {
    "bouc_wen_stiffness": 0.2 * STIFFNESS, "bouc_wen_amplitude": 1.0, "bouc_wen_alpha": 0.0,
    "bouc_wen_beta": 0.6 * _YIELD, "bouc_wen_gamma": 0.4 * _YIELD, "bouc_wen_exponent": 1.8,
}  # fmt: skip
STEADY = {"cubic_stiffness": 0.08 * STIFFNESS / AMPLITUDE**2}


def begun(rng, late, effect="bouc_wen", values=REMEMBERS):
    """A search whose base holds the effect, of records that begin so many cycles after their releases."""
    base = pb.Oscillator(MASS, [effect])
    records = []
    for r, cycles in enumerate(late):
        parameters = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING} | values
        release = AMPLITUDE * (1.0 - 0.1 * r)
        exact = pb.simulate_waveform(base, parameters, TIME, release, release_time=-cycles / FREQUENCY)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, exact.displacement, 55.0))
    search = Search(batch_of(records), base, ("cubic_stiffness",), 1, lambda _stage, _share: None)
    search.fit_set(())
    return search


def test_what_remembers_tells_that_its_release_was_earlier(rng):
    late = 0.62  # between a turning point and rest: what begins at rest was struck
    search = begun(rng, (0.2, late))
    assert not evidence.leaves_noise(search.batch, search.fits[()])
    found = earlier(search)
    assert found.turns == {"specimen 2": 1}
    again = Search(found.released(search.batch), search.base, search.candidates, 1, search.progress)
    again.fit_set(())
    assert evidence.leaves_noise(again.batch, again.fits[()])
    begin, amplitude = again.fits[()].state.own[1, [3, 2]]
    # known to the noise of hundreds of samples, far below a hundredth of a cycle and a per cent
    assert begin == pytest.approx(-late / FREQUENCY, abs=0.01 / FREQUENCY)
    assert amplitude == pytest.approx(0.9 * AMPLITUDE, rel=0.01)
    assert again.batch.levels[1].release == pytest.approx(0.9 * AMPLITUDE, rel=0.05)
    assert "specimen 2" in found.sentence


@pytest.mark.parametrize(("left", "is_told"), [(110.0, True), (140.0, False)])
def test_fewer_effects_are_asked_beside_several_that_explain(left, is_told, monkeypatch):
    """Two records began a quarter of a cycle late: Bouc-Wen left 1.2 of the noise, and a slider with a drag passed."""
    best, fewer, far = ("jenkins", "power_damping"), ("bouc_wen",), ("iwan",)
    fits = {names: SimpleNamespace(cost=cost) for names, cost in ((best, 100.0), (fewer, 140.0), (far, 400.0))}
    asked = []
    monkeypatch.setattr(module, "remembers", lambda _: True)
    monkeypatch.setattr(module.evidence, "leaves_noise", lambda *_: True)
    monkeypatch.setattr(module, "_released", lambda _, found: asked.append(found) or (left, {"specimen 1": 1}))
    search = SimpleNamespace(
        batch=SimpleNamespace(has_open_records=True), fits=fits, best=lambda: best, ranked=lambda: [*fits]
    )
    found = earlier(search)
    assert asked == [fits[fewer]]
    assert (found is not None and found.turns == {"specimen 1": 1}) == is_told


@pytest.mark.parametrize(
    ("was_exact", "now", "is_taken"), [(True, 1, True), (True, 2, False), (False, 2, True), (False, 3, True)]
)
def test_a_release_that_was_earlier_has_to_take_fewer_effects_where_records_were_explained(
    was_exact, now, is_taken, monkeypatch
):
    before, after = (SimpleNamespace(best=lambda n=n: ("effect",) * n) for n in (2, now))
    tried = Known(None, Undisturbed(None, after))
    monkeypatch.setattr(undisturbed, "earlier", lambda _: SimpleNamespace(sentence="earlier"))
    monkeypatch.setattr(undisturbed, "is_exact", lambda _: was_exact)
    monkeypatch.setattr(undisturbed, "is_better", lambda *_: True)
    changed = SimpleNamespace(but=lambda *_, **__: SimpleNamespace(asked=lambda: tried))
    found = undisturbed._released_earlier(changed, Undisturbed(None, before))
    assert (found is tried) == is_taken


def test_what_remembers_nothing_is_not_asked(rng):
    search = begun(rng, (0.2, 0.62), "cubic_stiffness", STEADY)
    assert earlier(search) is None
    # nor does it matter: every turning point is a release
    assert evidence.leaves_noise(search.batch, search.fits[()])


def test_a_record_that_holds_the_release_was_not_released_before_it_began(rng):
    search = begun(rng, (0.2, 0.62))
    held = search.batch.records[1]
    longer = replace(held, measured=replace(held.measured, time=held.measured.time - 2.0 / FREQUENCY))
    search.batch = replace(search.batch, records=(search.batch.records[0], longer))
    assert earlier(search) is None


def test_a_record_that_holds_the_later_of_two_turning_points_is_asked_for_the_earlier(rng, monkeypatch):
    """One that began between them: what it holds is no release, and counts are not mistaken for places in a list."""
    search = begun(rng, (0.2, 0.62))
    monkeypatch.setattr(module, "_holds", lambda own, count: count == 1)
    monkeypatch.setattr(module, "_left", lambda own, found, specimen, count: {0: 900.0, 2: 100.0}[count])
    assert earlier(search).turns == {"specimen 1": 2, "specimen 2": 2}


def test_releases_go_on_from_the_turning_points(rng):
    search = begun(rng, (0.2, 0.62))
    moved = Earlier({"specimen 1": 2}).released(search.batch)
    assert [term.skipped for term in moved.turning] == [2, 0]
    cycle = 2.0 * np.pi / search.batch.angular_frequency  # which yielding makes longer at the first amplitudes
    assert search.batch.own[0, 3] - moved.own[0, 3] == pytest.approx(cycle, rel=0.05)
    np.testing.assert_array_equal(moved.own[1], search.batch.own[1])
    assert moved.own[0, 2] > search.batch.own[0, 2]
