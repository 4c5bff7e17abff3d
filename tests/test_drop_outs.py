"""Samples off all motion: found beside a set that explains the others, and not where something else is the matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances.drop_outs import _come_at_a_phase, drop_outs
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence

from .discrepancy_cases import AMPLITUDE, FREQUENCY, MASS, TIME, batch_of, make_records, truth_of

NOISE = AMPLITUDE / np.sqrt(2.0) * 10.0 ** (-50.0 / 20.0)
SHAPE = np.array([0.5, 1.0, 0.7, 0.2])  # of an event; single wild samples were bridged before
WILD = ((140, 20.0), (310, -18.0))  # first sample, in standard deviations of the noise


def with_drop_outs(rng, is_often=False):
    records = make_records(rng, ("cubic_stiffness",), specimens=2, decibels=50.0, share=2.0)
    values = records[0].values.copy()
    for at, height in WILD:
        values[at : at + 4] += height * NOISE * SHAPE
    for at in range(60, 500, round(3.0 / FREQUENCY / (TIME[1] - TIME[0]))) if is_often else ():
        values[at : at + 4] += 40.0 * NOISE * SHAPE
    return [replace(records[0], values=values), records[1]], records


def searched(records):
    search = Search(batch_of(records), pb.Oscillator(MASS), ("cubic_stiffness",), 1)
    search.run()
    return search


def largest_residual(search):
    return np.abs(evidence.residuals_of(search.batch.waveform[0], search.fits[("cubic_stiffness",)], 0)).max()


def test_a_few_wild_samples_are_found_and_the_records_mended(rng):
    records, clean = with_drop_outs(rng)
    search = searched(records)
    assert largest_residual(search) > 6.0
    found = drop_outs(search)
    assert list(found.by_specimen) == ["specimen 1"] and found.events == 2
    assert "one record (specimen 1) jumps 2 times off all motion" in found.sentence
    mended = found.undisturbed(records)
    assert mended[1] is records[1]
    off = np.abs(mended[0].values - clean[0].values)
    changed = {at + side for at, _ in WILD for side in range(-2, 6)}
    assert not off[[k for k in range(TIME.size) if k not in changed]].any()
    assert off.max() < 5.0 * NOISE  # what the noise was there
    again = searched(mended)
    assert evidence.leaves_noise(again.batch, again.fits[("cubic_stiffness",)]) and drop_outs(again) is None
    assert largest_residual(again) < 5.0


@pytest.mark.parametrize(("count", "is_found"), [(4, True), (6, False)])
def test_a_few_do_not_count_in_a_record_of_few_cycles(count, is_found, rng):
    """More than one in ten cycles, but no more than four, with six cycles to each."""
    records = make_records(rng, ("cubic_stiffness",), specimens=2, decibels=50.0, share=2.0)
    values = records[0].values.copy()
    for at in np.linspace(140, 480, count).astype(int) + rng.integers(-9, 9, count):
        values[at : at + 4] += 25.0 * NOISE  # too wide to be bridged before
    search = searched([replace(records[0], values=values), records[1]])
    cycles = search.batch.waveform[0].cycles
    assert 24.0 < cycles < 36.0  # four of them are more than a tenth, and six of these fit in
    found = drop_outs(search)
    assert (found is not None and found.events == count) == is_found


@pytest.mark.parametrize("what", ["noise", "often", "no set"])
def test_nothing_is_mended_where_nothing_is_wild_or_something_comes_again(what, rng):
    records, clean = with_drop_outs(rng, is_often=what == "often")
    if what == "no set":  # what the others need is missing
        search = Search(batch_of(records), pb.Oscillator(MASS), (), 1)
        search.fit_set(())
        assert drop_outs(search) is None
    else:
        assert drop_outs(searched(clean if what == "noise" else records)) is None


@pytest.mark.parametrize("rings", [False, True])
def test_first_samples_that_are_off_are_told_as_the_release_and_not_as_a_cable(rings):
    """A sensor that rings when it is let go, or a joint that was not loaded slowly: the record begins with it."""
    records, _ = with_drop_outs(np.random.default_rng(1))
    search = searched(records)
    begin = int(np.flatnonzero(records[1].time >= search.batch.waveform[1].time[0])[0])
    values = records[1].values.copy()
    values[begin : begin + 4] += 12.0 * NOISE * np.array([1.0, 0.8, 0.5, 0.3])
    if rings:  # the swing after it is no event of its own
        values[begin + 8 : begin + 10] -= 10.0 * NOISE
    found = drop_outs(searched([records[0], replace(records[1], values=values)]))
    assert (found.events, found.jumping, list(found.begins)) == (2, ("specimen 1",), ["specimen 2"])
    assert "one record (specimen 1) jumps 2 times" in found.sentence
    assert "first samples of one record (specimen 2) are off the free motion" in found.sentence
    kept = found.undisturbed([replace(records[1], values=values)])[0]
    # cut, not put where the set has them, and as much again; what follows is as it was
    assert begin + 6 <= np.flatnonzero(records[1].time == kept.time[0])[0] <= begin + (30 if rings else 24)
    assert np.array_equal(kept.values, values[-kept.values.size :])
    alone = replace(found, events=0, jumping=())
    assert "jump" not in alone.sentence and alone.sentence.startswith("the first samples of one record")


def test_samples_of_an_acceleration_are_mended_where_they_are(rng):
    time = np.arange(2400) / (60.0 * FREQUENCY)  # two samples a value
    oscillator = pb.Oscillator(MASS)
    exact = pb.simulate_waveform(oscillator, truth_of(()), time, AMPLITUDE, quantity="acceleration").values
    noise = 3e-3 * np.abs(exact).max()
    values = exact + noise * rng.standard_normal(time.size)
    for at, height in ((700, 15.0), (1406, -20.0)):
        values[at : at + 4] += height * noise * SHAPE
    record = pb.Record("one", time, values, "acceleration", "m/s^2")
    found = drop_outs(searched([record]))
    assert found.events == 2
    mended = found.undisturbed([record])[0].values
    assert np.abs(mended[[700, 701, 1406, 1407]] - exact[[700, 701, 1406, 1407]]).max() < 1.5 * noise
    assert np.count_nonzero(mended != values) <= 20


@pytest.mark.parametrize(("is_at_peaks", "is_found"), [(False, True), (True, False)])
def test_what_comes_at_one_phase_of_the_motion_is_what_a_law_lacks(is_at_peaks, is_found, rng):
    """A friction that no law of the library is had been a cable that cracks, ten times and always where it turns."""
    records = make_records(rng, ("cubic_stiffness",), specimens=3, decibels=50.0, share=2.0)
    jumping = []
    for record in records:
        values = record.values.copy()
        tops = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] > values[2:])) + 1
        tops = tops[values[tops] > 0.3 * values.max()]
        for n, part in enumerate(np.array_split(tops, 2)):
            at = part[part.size // 2] + (0 if is_at_peaks else int(rng.integers(-8, 8)) * (n + 2) // 2)
            values[at : at + 4] += 20.0 * NOISE * SHAPE
        jumping.append(replace(record, values=values))
    found = drop_outs(searched(jumping))
    assert (found is not None) == is_found
    assert not is_found or found.jumping == tuple(record.specimen for record in records)


@pytest.mark.parametrize(
    ("phases", "is_one"),
    [
        (np.pi * np.array([1, 2, 3, 5, 8, 9]) - 0.2, True),  # where it turns
        (np.array([0.4, 6.8, 13.0, 19.2, 25.5, 31.9]), True),  # one side alone
        (np.array([0.4, 2.1, 13.9, 22.0, 24.3, 35.0]), False),
        (np.array([0.1, 0.2]), False),  # two of them say nothing
        (np.zeros(0), False),
    ],
)
def test_events_come_at_a_phase_where_chance_does_not_bring_them_there(phases, is_one):
    assert _come_at_a_phase(phases) == is_one
