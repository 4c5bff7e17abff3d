"""Whole samples lost late in a decay: found beside the set that explains the rest, and not where a law is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances.clock_steps import clock_steps
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.measurement.conditioning import free_part

from .discrepancy_cases import FREQUENCY, MASS, batch_of, drifting_records
from .discrepancy_cases import make_records as made

TIME = np.arange(2600) / (65.0 * FREQUENCY)
LATE = int(0.7 * TIME.size)
STEP = float(TIME[1] - TIME[0])


@pytest.fixture(autouse=True)
def _unseen(monkeypatch):
    """Few cycles show no step: what they show is put right before any set is fitted."""
    monkeypatch.setattr(free_part, "find_jump", lambda *_: None)


def make_records(rng, effects=(), **options):
    """Records of many samples a cycle, so that one is little: 40 cycles."""
    return made(rng, effects, time=TIME, **options)


def jumping(record, *places, count=1):
    """A record from which samples were lost, or in which they were written twice, the times going on regularly."""
    values = record.values
    for at in sorted(places, reverse=True):
        repeated = values[at : at + 1].repeat(abs(count))
        values = np.r_[values[:at], values[at + count :]] if count > 0 else np.r_[values[:at], repeated, values[at:]]
    values = values[: TIME.size]
    return replace(record, time=record.time[: values.size], values=values)


def searched(records, candidates=()):
    search = Search(batch_of(records), pb.Oscillator(MASS), candidates, max(len(candidates), 1))
    for names in ((), *((name,) for name in candidates)):
        search.fit_set(names)
    return search


@pytest.mark.parametrize("count", [1, 2, -1])
def test_a_sample_lost_or_doubled_late_is_found_and_the_clock_set_right(count, rng):
    clean = make_records(rng, specimens=2, decibels=38.0)
    records = [clean[0], jumping(clean[1], LATE, count=count)]
    search = searched(records)
    assert evidence.lack_of_fit(search.batch, search.fits[()]).p_value < 1e-6
    found = clock_steps(search, records)
    assert list(found.by_specimen) == ["specimen 2"]
    (step,) = found.by_specimen["specimen 2"]
    assert step.count == count and abs(step.time - TIME[LATE]) < 12 * STEP
    assert f"specimen 2: {abs(count)} at" in found.sentence and ("lost" in found.sentence) == (count > 0)
    mended = found.undisturbed(records)
    assert mended[0] is records[0]
    gone = max(-count, 0)
    after = mended[1].time[LATE + 20 :], mended[1].values[LATE + 20 :]
    assert after[0] == pytest.approx(TIME[LATE + 20 + max(count, 0) :][: after[0].size], abs=1e-9)
    np.testing.assert_array_equal(after[1], clean[1].values[LATE + 20 + max(count, 0) :][: after[1].size])
    assert mended[1].time.size == records[1].time.size - gone
    again = searched(mended)
    assert evidence.leaves_noise(again.batch, again.fits[()]) and clock_steps(again, mended) is None


def test_several_steps_are_found_beside_each_other(rng):
    clean = make_records(rng, specimens=2, decibels=42.0)
    places = (LATE, int(0.85 * TIME.size))
    records = [clean[0], jumping(clean[1], *places)]
    search = searched(records)
    found = clock_steps(search, records)
    assert [step.count for step in found.by_specimen["specimen 2"]] == [1, 1]
    for step, at in zip(found.by_specimen["specimen 2"], places, strict=True):
        assert abs(step.time - TIME[at]) < 25 * STEP


def test_the_set_that_leaves_least_beside_the_steps_tells_them(rng):
    clean = make_records(rng, ("cubic_stiffness",), specimens=2, decibels=40.0)
    records = [jumping(clean[0], LATE), clean[1]]
    search = searched(records, ("cubic_stiffness",))
    found = clock_steps(search, records)
    assert [step.count for step in found.by_specimen["specimen 1"]] == [1]


@pytest.mark.parametrize("effect", ["cubic_stiffness", "coulomb_friction", "quadratic_damping"])
def test_what_a_law_lacks_is_no_step(effect, rng):
    """Negative control: the phase bends away from that of a linear structure, and does not step."""
    for decibels, share in ((35.0, 0.2), (35.0, 1.0), (50.0, 0.2), (50.0, 1.0)):
        records = make_records(rng, (effect,), specimens=2, decibels=decibels, share=share)
        assert clock_steps(searched(records), records) is None


def test_a_step_by_a_part_of_a_sample_is_no_clock(rng):
    """Negative control: what moves a motion by less than a sample, as a knock does, is no lost sample."""
    records = make_records(rng, specimens=2, decibels=42.0)
    values = records[1].values.copy()
    values[LATE:] = np.interp(TIME[LATE:] + 0.5 * STEP, TIME, values)
    records = [records[0], replace(records[1], values=values)]
    search = searched(records)
    assert evidence.lack_of_fit(search.batch, search.fits[()]).p_value < 1e-3
    assert clock_steps(search, records) is None


@pytest.mark.parametrize("change", [0.002, 0.01, 0.03])
def test_a_drift_is_no_staircase(change, rng):
    """Negative control: a stiffness that drifts bends the phase as steps would, but smoothly."""
    records = drifting_records(rng, change)
    search = searched(records)
    assert clock_steps(search, records) is None
