"""A low-pass in front of the records: found by what it does to harmonics, applied to the simulation, not made up."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, freqs, sosfilt, sosfilt_zi

import pymc_backbone as pb
from pymc_backbone.discrepancy import workflow
from pymc_backbone.discrepancy.checks import data_checks
from pymc_backbone.discrepancy.disturbances.filter_search import early_high_pass, sensor_filter
from pymc_backbone.discrepancy.disturbances.high_passes import lowest_cut
from pymc_backbone.discrepancy.disturbances.sensor_filter import Chain, SensorFilter, with_past
from pymc_backbone.discrepancy.fitting.normal_equations import State
from pymc_backbone.discrepancy.fitting.telling import most_telling
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence

from .discrepancy_cases import (
    AMPLITUDE,
    FREQUENCY,
    MASS,
    RELEASE_TIME,
    TIME,
    batch_of,
    decaying_sinusoid,
    force_of,
    free_decay,
    make_records,
    noisy,
    truth_of,
)

STEP = float(TIME[1] - TIME[0])
CANDIDATES = ("cubic_stiffness", "quintic_stiffness", "quadratic_damping", "freeplay")


def measured(rng, cut=None, order=4, line=0.0, kind="lowpass", share=2.0):
    """Records of specimens with a cubic spring, behind a causal digital filter.

    A low-pass begins at rest; what couples to alternating current has long been on while the specimen is held.
    """
    records = make_records(rng, ("cubic_stiffness",), specimens=3, decibels=200.0, share=share)
    found = []
    for record in records:
        values = record.values + line * decaying_sinusoid(1.0, 2.2 * FREQUENCY)
        if cut is not None:
            sections = butter(order, 2.0 * cut * STEP, kind, output="sos")
            held = values[0] if kind == "highpass" else 0.0
            values = sosfilt(sections, values, zi=held * sosfilt_zi(sections))[0]
        found.append(noisy(rng, record.specimen, TIME, values, 55.0))
    return found


def searched(records, behind=None):
    batch = batch_of(records)
    search = Search(
        batch if behind is None else behind.passed(batch),
        pb.Oscillator(MASS),
        CANDIDATES,
        2,
        lambda _stage, _share: None,
    )
    search.run()
    return search


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 8])
def test_the_response_is_butterworths(order):
    at = np.array([0.1, 1.0, 2.7, 10.0])
    gain, phase = SensorFilter(order, 2.7).response(at)
    _, expected = freqs(*butter(order, 2.0 * np.pi * 2.7, analog=True), worN=2.0 * np.pi * at)
    np.testing.assert_allclose(gain * np.exp(1j * phase), expected, rtol=1e-9)
    assert (np.diff(phase) < 0.0).all()


@pytest.mark.parametrize("order", [1, 2])
def test_the_response_of_a_high_pass_is_butterworths(order):
    at = np.array([0.1, 1.0, 2.7, 10.0])
    gain, phase = SensorFilter(order, 2.7, "high-pass").response(at)
    _, expected = freqs(*butter(order, 2.0 * np.pi * 2.7, "highpass", analog=True), worN=2.0 * np.pi * at)
    np.testing.assert_allclose(gain * np.exp(1j * phase), expected, rtol=1e-9)
    assert SensorFilter(order, 2.7, "high-pass").response(np.zeros(1))[0] == 0.0


def test_a_start_that_creeps_is_no_filter(rng):
    """Of a displacement it looks like a high-pass, but its past explains nearly all that one does."""
    slow = 0.04 * AMPLITUDE * np.exp(-np.maximum(TIME - RELEASE_TIME, 0.0) * FREQUENCY / 0.3)
    exact = make_records(rng, ("cubic_stiffness",), specimens=3, decibels=200.0, share=8.0)
    records = [
        noisy(rng, record.specimen, TIME, record.values + np.sign(record.values[0]) * slow, 55.0) for record in exact
    ]
    without = searched(records)
    assert not evidence.leaves_noise(without.batch, without.fits[without.best()])
    assert sensor_filter(without) is None


def test_a_coupling_far_below_a_displacement_is_told_as_no_low_pass(rng):
    """It looks like a start that creeps; a low-pass of order 8, which is not there, had been told."""
    without = searched(measured(rng, cut=0.1 * FREQUENCY, order=1, kind="highpass", share=8.0))
    assert not evidence.leaves_noise(without.batch, without.fits[without.best()])
    assert sensor_filter(without) is None


@pytest.mark.parametrize("share", [0.2, 0.3])
def test_a_coupling_to_alternating_current_is_found_and_the_law_behind_it(share, rng):
    without = searched(measured(rng, cut=share * FREQUENCY, order=1, kind="highpass", share=8.0))
    assert not evidence.leaves_noise(without.batch, without.fits[without.best()])
    found = sensor_filter(without)
    assert found is not None and (found.order, found.kind) == (1, "high-pass")
    assert found.cut / FREQUENCY == pytest.approx(share, rel=0.08)
    behind = Search(found.passed(without.batch), pb.Oscillator(MASS), CANDIDATES, 2)
    behind.run()
    assert behind.best() == ("cubic_stiffness",) and evidence.leaves_noise(behind.batch, behind.fits[behind.best()])
    assert "as behind a high-pass of order 1" in " ".join(found.sentences(behind.batch))


def test_where_nothing_has_harmonics_the_release_shows_a_high_pass(rng):
    """Accelerations of linear structures that are held and let go: the jump decays in the coupling."""
    order, share = 2, 0.4
    time = np.arange(3000) / (60.0 * FREQUENCY)
    exact = np.zeros(time.size)
    moving = time >= 0.8 / FREQUENCY
    elapsed = time[moving] - time[moving][0]
    omega, damping = 2.0 * np.pi * FREQUENCY, 0.008
    free = np.exp(-damping * omega * elapsed) * np.cos(omega * elapsed)
    exact[moving] = -AMPLITUDE * np.gradient(np.gradient(free, elapsed), elapsed)
    coupled = sosfilt(butter(order, 2.0 * share * FREQUENCY * time[1], "highpass", output="sos"), exact)
    records = []
    for name in ("one", "two"):
        values = coupled + 3e-3 * np.abs(exact).max() * rng.standard_normal(time.size)
        records.append(pb.Record(name, time, values, "acceleration", "m/s^2"))
    without = searched(records)
    assert not evidence.leaves_noise(without.batch, without.fits[without.best()])
    found = sensor_filter(without)
    assert (found.kind, found.shows_at_release) == ("high-pass", True) and found.cut < FREQUENCY
    assert "begin with a slow decay" in " ".join(found.sentences(without.batch))
    early = SimpleNamespace(batch=without.batch, fits={(): without.fits[()]})  # nothing but the base was fitted so far
    assert early_high_pass(early).kind == "high-pass"
    assert early_high_pass(SimpleNamespace(batch=batch_of(measured(rng)), fits={})) is None  # displacements
    behind = Search(found.passed(without.batch), pb.Oscillator(MASS), CANDIDATES, 2)
    behind.run()
    assert behind.best() == () and evidence.leaves_noise(behind.batch, behind.fits[()])
    assert data_checks.data_terms_check(behind.batch, 50.0, 5.0).passed
    assert not data_checks.data_terms_check(without.batch, 50.0, 5.0).passed


def test_a_linear_structure_shows_no_harmonics_that_a_high_pass_turns(rng):
    """Coupled at a twentieth of the mode, read by a clock that jitters: a cut-off of 0.7 had been made up for."""
    time = np.arange(3000) / (36.0 * FREQUENCY)
    elapsed = time - 0.8 / FREQUENCY
    moving, records = elapsed >= 0.0, []
    for name in ("one", "two", "three"):
        omega = 2.0 * np.pi * FREQUENCY * (1.0 + 0.004 * rng.standard_normal())
        exact = np.where(
            moving, -AMPLITUDE * omega**2 * np.exp(-0.005 * omega * elapsed) * np.cos(omega * elapsed), 0.0
        )
        coupled = sosfilt(butter(1, 0.1 * FREQUENCY * time[1], "highpass", output="sos"), exact)
        jitter = 0.003 / FREQUENCY * rng.standard_normal(time.size) * np.gradient(coupled, time)
        noise = 3e-3 * np.abs(exact).max() * rng.standard_normal(time.size)
        values = coupled + np.where(elapsed > 2.0 * time[1], jitter, 0.0) + noise
        records.append(pb.Record(name, time, values, "acceleration", "m/s^2"))
    without = searched(records)
    found = early_high_pass(SimpleNamespace(batch=without.batch, fits={(): without.fits[()]}))
    assert found.kind == "high-pass" and found.shows_at_release
    assert set(found.gains(without.batch).values()) == {1.0}
    assert "were added" not in " ".join(found.sentences(without.batch))


@pytest.mark.parametrize("shows_at_release", [False, True])
def test_what_a_filter_takes_from_the_motion_is_given_back(shows_at_release, rng):
    """Of a coupling at a third of the frequency 5 %: a cubic stiffness had been a tenth too large."""
    coupling = SensorFilter(1, FREQUENCY / 3.0, "high-pass", shows_at_release=shows_at_release)
    records = measured(rng, cut=FREQUENCY / 3.0, order=1, kind="highpass", share=8.0)
    batch = batch_of(records)
    undone = coupling.undone(records, batch)
    places = [record.frequency for record in batch.records]
    for before, after, place in zip(records, undone, places, strict=True):
        gain = 1.0 if shows_at_release else 1.0 / np.hypot(1.0, FREQUENCY / 3.0 / place)
        np.testing.assert_allclose(gain * after.values, before.values, rtol=1e-12)
    assert ("that it takes from the motion were added" in " ".join(coupling.sentences(batch))) == (not shows_at_release)
    if shows_at_release:  # its cut-off is not known well enough
        return
    found = searched(undone, coupling).fits[("cubic_stiffness",)]
    strength = np.mean([found.parameters(r)[2] for r in range(3)])
    assert strength == pytest.approx(truth_of(("cubic_stiffness",), share=8.0)["cubic_stiffness"], rel=0.03)


def test_a_past_of_several_times_the_motion_is_forgotten(rng):
    """The mirror image that stands for it is as large; what was left of it had refuted right laws behind filters."""
    term = batch_of(measured(rng)).waveform[0]
    filtered = SensorFilter(1, 0.3 * FREQUENCY, "high-pass")
    size = 3.0 * np.abs(term.values).max()
    past = size * np.exp(-2.0 * np.pi * filtered.cut * (term.time - term.time[0]))[:, None]
    assert np.linalg.norm(term.whiten(term.compared(past))) > 1000.0
    assert np.linalg.norm(with_past(term, filtered).whiten(term.compared(past))) < 1.0


def test_the_cut_off_is_where_the_costs_around_it_arelowest_cut():
    costs = [(np.log(cut) - np.log(1.04)) ** 2 for cut in (1.0 / 1.1, 1.0, 1.1)]
    assert lowest_cut(1.0, 1.1, tuple(costs)) == pytest.approx(1.04, rel=1e-12)
    assert lowest_cut(1.0, 1.1, (3.0, 2.0, 0.5)) == pytest.approx(1.1) and lowest_cut(1.0, 1.1, (1.0, 2.0, 3.0)) < 0.92


@pytest.mark.parametrize("order", [2, 4, 8])
def test_the_fundamental_passes_and_a_harmonic_is_turned(order):
    filtered = SensorFilter(order, 3.5 * FREQUENCY)
    time = np.arange(4000) / (40.0 * FREQUENCY)
    chain = Chain(filtered, FREQUENCY, float(time[1]), time.size)
    waves = np.exp(2j * np.pi * FREQUENCY * np.array([1.0, 3.0]) * time[:, None])
    passed = chain(waves.real) + 1j * chain(waves.imag)
    inner = slice(chain.before + 200, -chain.ahead - 200)
    ratio = (passed / waves)[inner]
    gain, phase = filtered.response(FREQUENCY * np.array([1.0, 3.0]))
    third = gain[1] / gain[0] * np.exp(1j * (phase[1] - 3.0 * phase[0]))
    np.testing.assert_allclose(ratio[:, 0], 1.0, atol=2e-6)
    np.testing.assert_allclose(ratio[:, 1], third, atol=2e-5)
    assert abs(third - 1.0) > 0.05


def test_a_filter_is_found_and_the_law_behind_it(rng):
    records = measured(rng, cut=4.0 * FREQUENCY)
    without = searched(records)
    assert not evidence.leaves_noise(without.batch, without.fits[without.best()])
    found = sensor_filter(without)
    assert found is not None and found.cut / FREQUENCY == pytest.approx(4.0, rel=0.08)
    behind = searched(records, found)
    best = behind.best()
    assert best == ("cubic_stiffness",) and evidence.leaves_noise(behind.batch, behind.fits[best])
    assert f"order {found.order}" in " ".join(found.sentences(behind.batch)) and sensor_filter(behind) is None


def test_a_coupling_and_a_low_pass_are_found_together(rng):
    """An accelerometer and its logger: either filter alone, elsewhere, makes up for a part of what both do."""
    coupled, against_aliases, finer = 0.1 * FREQUENCY, 5.0 * FREQUENCY, 6
    truth = truth_of(("cubic_stiffness",), share=6.0)
    time = np.arange(1600) / (40.0 * FREQUENCY)
    fine = np.arange(finer * time.size) * time[1] / finer
    moving, records = fine >= RELEASE_TIME, []
    for name, release in (("one", AMPLITUDE), ("two", 0.8 * AMPLITUDE)):
        elapsed = fine[moving] - fine[moving][0]
        law = force_of(("cubic_stiffness",), truth)
        displacement = free_decay(law, release, elapsed)
        exact = np.zeros(fine.size)
        exact[moving] = -law(displacement, np.gradient(displacement, elapsed), 0.0) / MASS
        values = sosfilt(butter(1, 2.0 * coupled * fine[1], "highpass", output="sos"), exact)
        values = sosfilt(butter(6, 2.0 * against_aliases * fine[1], output="sos"), values)[::finer]
        values += 1.2e-3 * np.abs(values).max() * rng.standard_normal(time.size)
        records.append(pb.Record(name, time, values, "acceleration", "m/s^2"))
    without = Search(batch_of(records), pb.Oscillator(MASS), ("cubic_stiffness", "quadratic_damping"), 2)
    without.run()
    found = sensor_filter(without)
    low, high = sorted(found.parts, key=lambda part: part.kind, reverse=True)
    assert (low.kind, low.order, high.kind, high.order) == ("low-pass", 6, "high-pass", 1)
    assert low.cut == pytest.approx(against_aliases, rel=0.05) and high.cut == pytest.approx(coupled, rel=0.1)
    behind = searched(records, found)
    assert evidence.leaves_noise(behind.batch, behind.fits[("cubic_stiffness",)])
    assert not evidence.leaves_noise(without.batch, without.fits[without.best()])
    (said,) = found.sentences(behind.batch)
    assert "a high-pass of order 1 at 0.5" in said and ", and a low-pass of order 6 at 2" in said


def test_what_rings_after_the_release_of_a_linear_structure_is_no_slider():
    """Behind a coupling and a low-pass; a slider that slips in the first cycle had been told."""
    rng, ratio, finer = np.random.default_rng(1), 0.006, 8
    time = np.arange(3000) / (50.0 * FREQUENCY)
    fine = np.arange(finer * time.size) * time[1] / finer
    elapsed, records = fine - RELEASE_TIME, []
    for r in range(3):
        omega = 2.0 * np.pi * FREQUENCY * (1.0 + 0.005 * rng.standard_normal())
        damped = omega * np.sqrt(1.0 - ratio**2)
        swing = np.cos(damped * elapsed) - ratio * omega / damped * np.sin(damped * elapsed)
        exact = np.where(elapsed >= 0.0, (0.1 * r - 1.0) * omega**2 * np.exp(-ratio * omega * elapsed) * swing, 0.0)
        values = sosfilt(butter(1, 0.2 * FREQUENCY * fine[1], "highpass", output="sos"), AMPLITUDE * exact)
        values = sosfilt(butter(6, 10.0 * FREQUENCY * fine[1], output="sos"), values)[::finer]
        values += 2.2e-3 * np.abs(values).max() * rng.standard_normal(time.size)
        records.append(pb.Record(f"specimen {r}", time, values, "acceleration", "m/s^2"))
    study = pb.find_missing_effect(pb.Oscillator(MASS), records, candidates=(*CANDIDATES, "jenkins"), quick=True)
    assert study.sentence.startswith("Nothing is missing")


@pytest.mark.parametrize("line", [0.0, 2e-5])
def test_no_filter_is_made_up(rng, line):
    """Neither for records that a law explains nor for the line of another mode beside the harmonics."""
    assert sensor_filter(searched(measured(rng, line=line))) is None


@pytest.mark.parametrize(
    ("is_cut", "explains", "behind", "quick", "is_found"),
    [(True, True, True, False, False), (True, False, False, True, False), (True, False, False, True, True)],
)
def test_what_a_search_notes(is_cut, explains, behind, quick, is_found):
    """Backbones of filtered records are not sampled; a search that was cut says so where nothing explains the end."""
    search = SimpleNamespace(
        is_cut=is_cut, fits={(): "base"}, best=tuple, explains=lambda _: explains,
        batch=SimpleNamespace(is_behind_filter=behind),
    )  # fmt: skip
    said = " ".join(workflow._search_notes(search, quick=quick, is_found=is_found))
    assert ("nothing came near the noise" in said) == (is_cut and not explains and not is_found)
    assert ("nothing was sampled" in said) == (behind and not quick)


def test_the_records_that_a_set_leaves_most_of_are_asked_first(rng):
    """Two of four, as they were fitted with all; a fit of these alone goes back into that of all."""
    batch = batch_of(make_records(rng, specimens=4))
    found = Search(batch, pb.Oscillator(MASS), ("cubic_stiffness",), 1).fit_set(())
    held = replace(found, chi_square=np.array([1.0, 9.0, 2.0, 7.0]))
    part = most_telling(batch, held)
    assert part.specimens == [1, 3] and part.batch.specimens == (batch.specimens[1], batch.specimens[3])
    assert part.left == 16.0 and part.batch.count < batch.count
    np.testing.assert_array_equal(part.found.state.own, found.state.own[[1, 3]])
    other = State(found.state.eta, part.found.state.own + 1.0)
    whole = part.whole(other, found)
    np.testing.assert_array_equal(whole.own[[1, 3]], found.state.own[[1, 3]] + 1.0)
    np.testing.assert_array_equal(whole.own[[0, 2]], found.state.own[[0, 2]])
    assert most_telling(batch.subset([0]), replace(held, chi_square=held.chi_square[:1])).specimens == [0]
