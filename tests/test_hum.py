"""Hum of the mains: taken out of a record, told, and not confused with what a structure does."""

from __future__ import annotations

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone.measurement.conditioning.hum import without_hum

RATE, FREQUENCY = 700.0, 13.0
TIME = np.arange(6000) / RATE
DECAY = np.where(TIME > 0.3, np.exp(-0.5 * (TIME - 0.3)) * np.cos(2.0 * np.pi * FREQUENCY * (TIME - 0.3)), 0.0)


def hum(mains, phase=0.7):
    return 0.01 * np.cos(2.0 * np.pi * mains * TIME + phase) + 0.003 * np.sin(2.0 * np.pi * 3.0 * mains * TIME)


@pytest.mark.parametrize("mains", [50.0, 49.93, 60.02])
def test_hum_is_taken_out_and_told(mains, rng):
    noise = 2e-3 * rng.standard_normal(TIME.size)
    left, found = without_hum(DECAY + hum(mains) + noise, RATE, FREQUENCY)
    assert found.frequencies == pytest.approx([mains, 3.0 * mains], abs=0.01)
    assert found.share == pytest.approx(np.hypot(0.01, 0.003) / np.abs(DECAY).max(), rel=0.05)
    assert f"{mains:.4g} and {3.0 * mains:.4g} Hz" in found.note
    # each of four amplitudes is known to the noise over the root of a quarter of the samples (a window of Hann)
    assert np.std(left - DECAY - noise) < 3.0 * 2e-3 * np.sqrt(4.0 / (0.25 * TIME.size))


def test_hum_is_taken_out_of_a_record_with_many_samples(rng):
    rate = 20000.0
    time = np.arange(160000) / rate
    motion = np.exp(-0.5 * time) * np.cos(2.0 * np.pi * FREQUENCY * time)
    lines = 0.01 * np.cos(2.0 * np.pi * 50.02 * time + 0.4) + 0.004 * np.cos(2.0 * np.pi * 350.14 * time)
    left, found = without_hum(motion + lines + 1e-3 * rng.standard_normal(time.size), rate, FREQUENCY)
    assert found.frequencies == pytest.approx([50.02, 350.14], abs=0.01)
    smooth = (left - motion).reshape(-1, 20).mean(axis=1)
    assert np.std(smooth) == pytest.approx(1e-3 / np.sqrt(20.0), rel=0.1)


@pytest.mark.parametrize("frequency", [34.0, 37.0, 62.0, 71.0])
def test_hum_close_to_the_motion_in_a_short_record_is_taken_out(frequency, rng):
    """The line of the motion, and what its decay spreads, are not what lies beside that of the mains."""
    rate = 1500.0
    time = np.arange(1800) / rate
    motion = np.exp(-1.5 * time) * np.cos(2.0 * np.pi * frequency * time)
    line, noise = 0.008 * np.cos(2.0 * np.pi * 50.0 * time + 0.4), 5e-3 * rng.standard_normal(time.size)
    left, found = without_hum(motion + line + noise, rate, frequency)
    assert found.frequencies == pytest.approx([50.0], abs=0.1) and found.share == pytest.approx(0.008, rel=0.2)
    assert np.std(left - motion - noise) < 3.0 * 5e-3 * np.sqrt(4.0 / (0.25 * time.size))
    assert without_hum(motion + noise, rate, frequency)[1] is None


def test_a_record_says_that_hum_was_taken_out(rng):
    values = 1e-3 * (DECAY + hum(50.0)) + 1e-6 * rng.standard_normal(TIME.size)
    conditioned = pb.condition(pb.Record("beam", TIME, values, "displacement", "m"))
    assert any("hum of the mains at 50 and 150 Hz, 1 % of the largest reading" in note for note in conditioned.notes), (
        conditioned.notes
    )
    clean = pb.condition(pb.Record("beam", TIME, values - 1e-3 * hum(50.0), "displacement", "m"))
    assert not any("hum" in note for note in clean.notes)
    n = min(clean.displacement.size, conditioned.displacement.size)
    assert np.std(conditioned.displacement[:n] - clean.displacement[:n]) < 5e-7


@pytest.mark.parametrize(
    "motion",
    [
        0.01 * np.exp(-0.3 * TIME) * np.cos(2.0 * np.pi * 50.0 * TIME),  # another mode
        0.01 * DECAY * np.cos(2.0 * np.pi * 37.0 * TIME),  # what goes with the motion
        0.01 * np.cos(2.0 * np.pi * 47.0 * TIME),  # a machine beside it
        0.01 * np.cos(2.0 * np.pi * 52.0 * TIME),  # close to the fourth harmonic, and off the mains
    ],
)
def test_what_is_no_hum_is_left(motion, rng):
    values = DECAY + motion + 1e-4 * rng.standard_normal(TIME.size)
    left, found = without_hum(values, RATE, FREQUENCY)
    assert found is None and left is values


def test_no_hum_is_found_in_noise(rng):
    """White, and the longer the record the more places to look at: none in 100 records."""
    for _ in range(100):
        assert without_hum(DECAY + 0.02 * rng.standard_normal(TIME.size), RATE, FREQUENCY)[1] is None


def test_the_fourth_harmonic_of_a_motion_close_to_the_mains_is_no_hum(rng):
    """A motion that hardly decays, whose fourth harmonic is at 50 Hz: as high at the end as at the beginning."""
    phase = 2.0 * np.pi * 12.5 * TIME
    values = np.exp(-0.01 * TIME) * (np.cos(phase) + 0.02 * np.cos(4.0 * phase)) + 1e-4 * rng.standard_normal(TIME.size)
    assert without_hum(values, RATE, 12.5)[1] is None


def test_hum_close_to_an_even_harmonic_of_a_motion_that_falls_is_taken_out(rng):
    """No law's even harmonics last; it had been a low-pass beside friction. The odd ones of dry friction do last."""
    for frequency, is_found in ((8.33, True), (12.5, True), (16.67, False)):
        phase = 2.0 * np.pi * frequency * TIME
        values = np.exp(-0.5 * TIME) * np.cos(phase) + hum(50.02) + 1e-4 * rng.standard_normal(TIME.size)
        found = without_hum(values, RATE, frequency)[1]
        assert (found is not None and found.frequencies[0] == pytest.approx(50.02, abs=0.01)) == is_found


@pytest.mark.parametrize(("frequency", "cycles"), [(91.03, 63.2), (109.0, 60.0), (136.0, 60.0)])
def test_the_skirt_of_a_short_decay_close_to_the_mains_is_no_hum(frequency, cycles, rng):
    """Its ripples are as narrow as a line, and those towards the motion are higher."""
    rate = 90.0 * frequency
    time = np.arange(int(cycles * 90.0)) / rate
    for phase in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        decay = np.exp(-0.0016 * 2.0 * np.pi * frequency * time)
        angle = 2.0 * np.pi * frequency * (time - 0.0035 * np.cumsum(decay**2) / rate) + phase  # a softening spring
        values = decay * np.cos(angle) + 1e-3 * rng.standard_normal(time.size)
        assert without_hum(values, rate, frequency)[1] is None
