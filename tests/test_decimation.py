"""Long records: fewer samples for the same level values, with errors that stay honest."""

from __future__ import annotations

import resource
import sys

import numpy as np
import pytest

from pymc_backbone._common.checks import FloatArray
from pymc_backbone.measurement.conditioning import decimation
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.decimation import design_decimation
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.levels import backbones_at_levels
from pymc_backbone.measurement.reading.record import Record

from .test_conditioning import FREQUENCY, simulated

PER_CYCLE, CYCLES = 2000, 40
LEVELS = np.array([0.15, 0.25, 0.4, 0.6])


def level_values(values: FloatArray, quantity: str, rate: float) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    time = np.arange(values.size) / rate
    decay = condition(Record("s", time, values, quantity))
    found = backbones_at_levels(extract_cycles(decay), LEVELS, ("frequency", "damping", "offset"))
    return found["value"].values[0], found["standard_error"].values[0], decay.notes


def test_pass_band_and_stop_band() -> None:
    rate, frequency = 51_200.0, 10.0
    filtered = design_decimation(200_000, rate, frequency)
    assert filtered is not None and filtered.factor == 40
    time = np.arange(200_000) / rate
    kept = time[filtered.half : time.size - filtered.half : filtered.factor]
    # 1e-5 is the ripple of 100 dB
    for order, gain in ((1, 1.0), (5, 1.0), (30, 1.0), (97, 0.0), (127, 0.0)):
        out = filtered.apply(np.cos(2.0 * np.pi * order * frequency * time))
        assert out.size == kept.size
        np.testing.assert_allclose(out, gain * np.cos(2.0 * np.pi * order * frequency * kept), atol=3e-5)


def test_noise_of_decimated_white_noise_is_known(rng: np.random.Generator) -> None:
    filtered = design_decimation(400_000, 51_200.0, 10.0)
    assert filtered is not None
    out = filtered.apply(rng.standard_normal(400_000))
    stated = filtered.noise_autocovariance()
    for lag in range(stated.size):
        measured = float(np.mean(out[: out.size - lag] * out[lag:]))
        # four standard errors of a covariance from as many samples
        assert abs(measured - stated[lag]) < 4.0 * stated[0] * np.sqrt(2.0 / out.size)
    new = 51_200.0 / filtered.factor
    np.testing.assert_allclose(filtered.gain(np.array([0.1, 0.2]) * new), 1.0, atol=1e-4)
    np.testing.assert_allclose(filtered.gain(np.array([0.5]) * new), np.sqrt(0.5), rtol=1e-3)


def test_short_or_coarse_records_are_left_alone() -> None:
    assert design_decimation(decimation.SMALL, 51_200.0, 10.0) is None
    assert design_decimation(10**6, 2_000.0, 10.0) is None


@pytest.mark.parametrize("seed", range(3))
def test_level_values_and_errors_agree_with_those_of_all_samples(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(seed)
    _, motion = simulated("hardening", 0.01, CYCLES, PER_CYCLE)
    values = motion[0] + 0.04 * np.std(motion[0]) * rng.standard_normal(motion[0].size)
    few, few_errors, notes = level_values(values, "displacement", FREQUENCY * PER_CYCLE)
    assert any("every 15th was kept" in note for note in notes), notes
    monkeypatch.setattr(decimation, "SMALL", 10**9)
    every, every_errors, notes = level_values(values, "displacement", FREQUENCY * PER_CYCLE)
    assert not any("was kept" in note for note in notes)
    # the twentieth of a cycle at each end is all that is missing: a fraction of the errors
    assert np.max(np.abs(few - every)[:2] / every_errors[:2]) < 0.6
    np.testing.assert_allclose(few_errors[:2], every_errors[:2], rtol=0.25)
    # a symmetric structure has no mid-line
    assert np.all(np.abs(few[2]) < 4.0 * few_errors[2])


def test_errors_of_a_decimated_velocity_are_honest(rng: np.random.Generator) -> None:
    _, motion = simulated("hardening", 0.01, CYCLES, PER_CYCLE)
    true, _, _ = level_values(motion[1], "velocity", FREQUENCY * PER_CYCLE)
    scores = []
    for _ in range(6):
        noise = 0.04 * np.std(motion[1]) * rng.standard_normal(motion[1].size)
        found, errors, _ = level_values(motion[1] + noise, "velocity", FREQUENCY * PER_CYCLE)
        scores.append(((found - true) / errors)[:2])
    # six draws of eight correlated values: chance alone stays within a factor of two
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_two_million_samples_take_little_memory() -> None:
    rate, n = 51_200.0, 2_000_000
    time = np.arange(n) / rate
    values = 1e-3 * np.exp(-0.1 * time) * np.cos(2.0 * np.pi * 14.0 * time + 0.3)
    record = Record("s", time, values + 1e-6 * np.random.default_rng(1).standard_normal(n))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    decay = condition(record)
    cycles = extract_cycles(decay)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / (1e6 if sys.platform == "darwin" else 1e3)
    # beside the 320 MB of the libraries: 500 MB in all
    assert grown < 180.0
    assert decay.time.size < 80_000 and len(cycles) > 500
    np.testing.assert_allclose(np.median(cycles.frequency), 14.0, rtol=1e-5)
