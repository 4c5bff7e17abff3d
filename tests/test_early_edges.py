"""First cycles that are no free motion: seen in the middle of a search, and what remembers runs in behind them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances import undisturbed as module
from pymc_backbone.discrepancy.disturbances import without_edges as of_edges
from pymc_backbone.discrepancy.disturbances.changed import Changed
from pymc_backbone.discrepancy.disturbances.earlier_release import Earlier, run_in
from pymc_backbone.discrepancy.disturbances.early_edges import early_edges
from pymc_backbone.discrepancy.disturbances.edges import Edges, between, edges
from pymc_backbone.discrepancy.disturbances.free_start import without_start
from pymc_backbone.discrepancy.fitting.joint_fit import fit
from pymc_backbone.discrepancy.fitting.normal_equations import State
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence

from .discrepancy_cases import (
    AMPLITUDE,
    DAMPING,
    FREQUENCY,
    MASS,
    OMEGA,
    PER_CYCLE,
    RELEASE_TIME,
    STIFFNESS,
    TIME,
    batch_of,
    drifting_records,
    make_records,
    noisy,
)
from .test_earlier_release import REMEMBERS

_CUT = 2.2  # cycles


def filtered(records):
    """Records that went through a causal low-pass after they were made, which began at rest with them."""
    sections = butter(4, 3.0 * FREQUENCY, fs=PER_CYCLE * FREQUENCY, output="sos")
    found = []
    for record in records:
        begun = record.time >= RELEASE_TIME
        time = record.time[begun] - RELEASE_TIME
        found.append(pb.Record(record.specimen, time, sosfilt(sections, record.values[begun]), record.quantity,
                               record.unit, "made in a test", ()))  # fmt: skip
    return found


def searched(records, candidates=("cubic_stiffness", "freeplay")):
    search = Search(batch_of(records), pb.Oscillator(MASS), candidates, 2, lambda _stage, _share: None)
    search.fit_set(())
    return search


def simulated(rng, effect, truth, count):
    """Records of specimens whose stiffness differs a little."""
    oscillator, time, records = pb.Oscillator(MASS, effect), TIME - TIME[0], []
    for r in range(count):
        own = truth | {"linear_stiffness": STIFFNESS * (1.0 + 0.005 * r)}
        exact = pb.simulate_waveform(oscillator, own, time, AMPLITUDE * (1.0 - 0.1 * r)).displacement
        records.append(noisy(rng, f"specimen {r + 1}", time, exact, 60.0))
    return records


PLAY = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING, "contact_stiffness": 0.1 * STIFFNESS,
        "gap": 0.3 * AMPLITUDE}  # fmt: skip


def test_cycles_in_which_a_filter_settles_are_seen_before_all_sets_were_fitted(rng):
    search = searched(filtered(make_records(rng, ("cubic_stiffness",), specimens=3)))
    assert early_edges(search) is None  # of what follows nothing is known yet
    search.fit_set(("cubic_stiffness",))
    lost = early_edges(search)
    assert lost is not None and sorted(lost.first) == ["specimen 1", "specimen 2", "specimen 3"]
    for name, begin in lost.first.items():
        assert 1.0 < begin * FREQUENCY < 4.0, name


def test_beside_a_drift_in_time_they_are_seen_as_well(rng):
    search = searched(filtered(drifting_records(rng, 0.02, cubic=0.05)))
    search.fit_set(("cubic_stiffness",))
    lost = early_edges(search)
    assert lost is not None and len(lost.first) == 2


@pytest.mark.parametrize("effects", [("cubic_stiffness",), ("quadratic_damping",)])
def test_of_free_motion_no_cycle_is_left_out(effects, rng):
    """Neither where a set explains the records, nor where none does."""
    search = searched(make_records(rng, effects))
    search.fit_set(("cubic_stiffness",))
    assert early_edges(search) is None


@pytest.mark.parametrize("effect", ["jenkins", "freeplay"])
def test_what_acts_in_the_first_cycle_alone_is_no_edge(effect, rng):
    """A slider that slips, or a stop that is reached, at the largest amplitudes only: fitted, it explains them."""
    at = 0.85 * AMPLITUDE
    truth = {"linear_stiffness": STIFFNESS, "viscous_damping": 4.0 * DAMPING} | {
        "jenkins": {"slider_stiffness": 0.5 * STIFFNESS, "slip_force": 0.5 * STIFFNESS * at},
        "freeplay": {"contact_stiffness": STIFFNESS, "gap": at},
    }[effect]
    search = searched(simulated(rng, effect, truth, 3), ("cubic_stiffness", effect))
    free = without_start(search.fits[()], search.batch)
    assert free.cost < 1.1 * search.count < 0.5 * search.fits[()].cost  # without the first cycle nothing is missing
    seen = edges(search.batch, free.found)
    assert seen is not None and seen.cycles == 1
    assert early_edges(search) is None


def test_what_remembers_runs_in_behind_cycles_that_were_cut(rng):
    """Loaded from rest up to the first turning point that is left, it would hold another force than after the cut."""
    base = pb.Oscillator(MASS, ["bouc_wen"])
    truth = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING} | REMEMBERS
    records = []
    for r in range(2):
        exact = pb.simulate_waveform(base, truth, TIME, AMPLITUDE * (1.0 - 0.1 * r), release_time=0.0).displacement
        whole = noisy(rng, f"specimen {r + 1}", TIME, exact, 65.0)
        records.append(between(whole, _CUT / FREQUENCY, np.inf))
    batch = batch_of(records)
    vector = np.array([truth[name] for name in base.parameter_names])
    search = Search(batch, base, ("cubic_stiffness",), 1, lambda _stage, _share: None)
    layout = search.layout(())
    eta = layout.coordinates(vector[layout.free])

    def fitted(batch):
        own = np.zeros((2, 7 + layout.free.size))
        own[:, :2], own[:, 2:4] = vector[:2], batch.own[:, 2:4]
        return fit(layout, batch.deciding, State(eta, own), iterations=40, nuisances=batch.nuisances)

    cut, run = fitted(batch), fitted(run_in(batch, batch.specimens))
    assert not evidence.leaves_noise(batch, cut)
    assert evidence.leaves_noise(batch, run)
    assert run.cost < cut.cost - 100.0


def test_records_run_in_over_motion_that_is_hardly_larger(rng):
    slowly, fast = (
        batch_of([noisy(rng, "one", TIME, AMPLITUDE * np.exp(-loss * OMEGA * TIME) * np.cos(OMEGA * TIME), 60.0)])
        for loss in (0.004, 0.03)
    )
    for batch, count in ((slowly, 4), (fast, 2)):
        begun = run_in(batch, ("one", "another"))
        assert begun.own[0, 3] == pytest.approx(Earlier({"one": count}).released(batch).own[0, 3])
        assert abs(begun.own[0, 2]) <= 1.25 * abs(batch.own[0, 2])
        assert begun.own[0, 3] == pytest.approx(batch.own[0, 3] - 0.5 * count / FREQUENCY, abs=0.02 / FREQUENCY)
    assert run_in(slowly, ()) is slowly


def test_cut_records_are_remembered_to_begin_late():
    class Question(SimpleNamespace):
        def of_records(self, records, _measuring):
            return SimpleNamespace(batch=SimpleNamespace(specimens=("one", "two")), records=records)

    record = SimpleNamespace(specimen="one", time=np.arange(5.0), values=np.arange(5.0), starts_free=False)
    changed = Changed(Question(), None, None, None, [record])
    assert changed.begun_late == frozenset()
    lost = Edges({"one": -1.0}, {"two": 3.0})
    assert changed.within(lost).begun_late == {"one"}
    assert changed.within(lost).within(Edges({"two": -1.0})).begun_late == {"one", "two"}
    assert changed.within(lost).said == (lost.sentence,)


@pytest.mark.parametrize("explains", [True, False])
def test_a_search_that_first_cycles_halted_goes_on_where_nothing_is_explained_without_them(explains, monkeypatch):
    monkeypatch.setattr(module, "lines_that_beat", lambda *_: None)
    monkeypatch.setattr(module, "clock_steps", lambda *_: None)
    monkeypatch.setattr(module, "is_relaxed_at_release", lambda _: False)
    monkeypatch.setattr(module, "earlier", lambda _: None)
    resumed = []
    search = SimpleNamespace(halted=Edges({"one": 1.0}), is_told=False, batch=None, resume=lambda: resumed.append(1))
    rest = SimpleNamespace(halted=None)
    cut = module.Known(None, SimpleNamespace(search=rest, is_drifting=False))
    changed = SimpleNamespace(lines=(), records=(), is_of_rates=True,
                              within=lambda lost: SimpleNamespace(asked=lambda *_: cut))  # fmt: skip
    monkeypatch.setattr(module, "is_exact", lambda item: explains and item is rest)
    monkeypatch.setattr(module, "_one_by_one", lambda known: known.found)
    original = module._undisturbed
    monkeypatch.setattr(module, "_undisturbed", lambda known: known.found if known is cut else original(known))
    known = module.Known(changed, SimpleNamespace(search=search))
    found = module._undisturbed(known)
    assert found is (cut.found if explains else known.found)
    assert resumed == ([] if explains else [1])


@pytest.mark.parametrize(("left", "is_cut"), [(110.0, False), (1500.0, True)])
def test_cycles_that_a_law_explains_nearly_are_its_own(left, is_cut, monkeypatch):
    """A slider that slips in the first ones alone, read by a bent sensor: not exact, but next to all of it."""
    fits = {("jenkins",): SimpleNamespace(cost=left), (): SimpleNamespace(cost=2e5)}
    search = SimpleNamespace(fits=fits, count=100, best=lambda: ("jenkins",))
    seen = of_edges._Cut(None, Edges({"one": 1.0}, cycles=3), "batch", "fit")
    monkeypatch.setattr(of_edges, "is_exact", lambda _: False)
    monkeypatch.setattr(of_edges, "_cut_by", lambda _changed, _search, names, **_: None if names else seen)
    monkeypatch.setattr(of_edges.evidence, "leaves_noise", lambda *_: True)
    changed = SimpleNamespace(within=lambda lost: SimpleNamespace(asked=lambda: lost))
    found = of_edges.without_edges(changed, SimpleNamespace(search=search))
    assert (found is not None) == is_cut
