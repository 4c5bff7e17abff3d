"""Noise that grows with the motion: found, weighed, and not taken for physics, nor physics for it."""

from __future__ import annotations

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone.discrepancy.disturbances.motion_noise import motion_noise
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence

from .discrepancy_cases import AMPLITUDE, FREQUENCY, MASS, TIME, batch_of, make_records, noisy, truth_of

CANDIDATES = ("cubic_stiffness", "quadratic_stiffness", "quintic_stiffness", "freeplay")
JITTER = 3e-3 / FREQUENCY  # standard deviation of the instants [s]
SHARE = 0.01  # of the reading


def disturbed(rng, *, jitter=0.0, share=0.0, effects=("cubic_stiffness",)):
    """Records at instants that jitter, or with noise that is a share of the reading, beside some at rest."""
    found = []
    for record in make_records(rng, effects, specimens=3, decibels=200.0):
        late = np.gradient(record.values, TIME) * jitter * rng.standard_normal(TIME.size)
        grown = record.values * share * rng.standard_normal(TIME.size)
        found.append(noisy(rng, record.specimen, TIME, record.values + late + grown, 60.0))
    return found


def searched(records, candidates=CANDIDATES):
    search = Search(batch_of(records), pb.Oscillator(MASS), candidates, 2, lambda _stage, _share: None)
    search.run()
    return search


@pytest.mark.parametrize(("kind", "words"), [("jitter", "clock jitters"), ("share", "share of its reading")])
def test_how_the_noise_grows_is_found_and_the_samples_weighed(rng, kind, words):
    search = searched(disturbed(rng, **{kind: JITTER if kind == "jitter" else SHARE}))
    found = motion_noise(search)
    assert words in found.sentence
    first = found.by_specimen[search.batch.specimens[0]]
    assert first.is_of_rate == (kind == "jitter")
    # noise at rest is 60 dB below the motion; what moves is a share of the amplitude, or of the rate
    moving = JITTER * 2.0 * np.pi * FREQUENCY if kind == "jitter" else SHARE
    amplitude = search.batch.cycles[0].smoothed_amplitude
    noise = np.hypot(1e-3 * AMPLITUDE, moving * amplitude)
    assert first.times == pytest.approx(noise.max() / noise.min(), rel=0.3)
    weighed = found.weighed(search.batch)
    exact = search.fits[("cubic_stiffness",)]
    before, after = (evidence.residuals_of(term, exact, 0) for term in (search.batch.waveform[0], weighed.waveform[0]))
    early, late = slice(0, before.size // 6), slice(-before.size // 3, None)
    assert before[early].std() > 1.8 * before[late].std()
    assert after[early].std() < 1.3 * after[late].std()
    for window, basis in weighed.waveform[0].subspace:
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-10)
        assert basis.shape[0] == window.stop - window.start


@pytest.mark.parametrize("share", [0.0, SHARE])
def test_samples_of_an_accelerometer_that_are_averaged_are_asked_as_well(share, rng):
    time = np.arange(2400) / (100.0 * FREQUENCY)  # a hundred samples a cycle, of which four are one value
    truth = truth_of(())
    exact = pb.simulate_waveform(pb.Oscillator(MASS), truth, time, AMPLITUDE, quantity="acceleration").values
    noise = 1e-3 * np.abs(exact).max() * rng.standard_normal(time.size)
    values = exact * (1.0 + share * rng.standard_normal(time.size)) + noise
    search = searched([pb.Record("one", time, values, "acceleration", "m/s^2")], ("cubic_stiffness",))
    assert search.batch.waveform[0].size < time.size / 2
    found = motion_noise(search)
    if not share:
        assert found is None
    else:
        assert "share of its reading" in found.sentence
        assert found.weighed(search.batch).waveform[0].size == search.batch.waveform[0].size


def test_loud_noise_of_values_that_are_averaged_makes_no_rate_of_its_own(rng):
    """Two samples to a value: loud noise had seemed to grow where its own slope was steep."""
    time = np.arange(3000) / (60.0 * FREQUENCY)
    exact = pb.simulate_waveform(pb.Oscillator(MASS), truth_of(()), time, AMPLITUDE, quantity="acceleration").values
    noise = 0.06 * np.abs(exact).max()
    records = [
        pb.Record(f"{r}", time, exact + noise * rng.standard_normal(time.size), "acceleration", "m/s^2")
        for r in range(4)
    ]
    search = searched(records, ("cubic_stiffness",))
    assert search.batch.waveform[0].averaged == 2
    assert motion_noise(search) is None


def test_noise_that_is_the_same_everywhere_is_left_alone(rng):
    assert motion_noise(searched(disturbed(rng))) is None


def test_a_line_that_decays_with_the_motion_is_no_noise_that_grows(rng):
    """Another mode, beyond the harmonics that are looked at: its neighbouring samples are not alike."""
    line = 1e-2 * AMPLITUDE * np.exp(-TIME / 0.5) * np.cos(2.0 * np.pi * 0.4 / (TIME[1] - TIME[0]) * TIME)
    records = [
        noisy(rng, record.specimen, TIME, record.values + line, 60.0)
        for record in make_records(rng, (), specimens=2, decibels=200.0)
    ]
    search = searched(records, ("cubic_stiffness",))
    left = evidence.residuals_of(search.batch.waveform[0], search.fits[()], 0)
    assert left[: left.size // 6].std() > 1.5 * left[-left.size // 3 :].std()
    assert motion_noise(search) is None


def test_a_law_that_no_set_holds_is_not_taken_for_noise(rng):
    search = searched(disturbed(rng, effects=("coulomb_friction",)), ("quadratic_stiffness",))
    assert search.fits[search.best()].cost > 10.0 * search.count
    assert motion_noise(search) is None


def test_a_spring_is_named_by_a_clock_that_jitters_and_the_noise_is_said(rng):
    study = pb.find_missing_effect(
        pb.Oscillator(MASS), disturbed(rng, jitter=JITTER), candidates=CANDIDATES, quick=True, held_out=0, random_seed=1
    )
    assert study.verdict == "found" and study.missing_effects == ("cubic_stiffness",)
    assert any("the noise grows with the motion" in note for note in study.notes)
