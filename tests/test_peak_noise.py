"""Peaks that are off together: honest standard errors of damping, and nothing changed where the samples say it all."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pymc_backbone._common.checks import FloatArray
from pymc_backbone.measurement import cycles as cycles_module
from pymc_backbone.measurement.cycle_data import Cycles
from pymc_backbone.measurement.cycles import extract_cycles_from_arrays
from pymc_backbone.measurement.levels import backbones_at_levels, default_levels

PER_CYCLE, CYCLES, WHITE = 40, 60, 2e-3
DECREMENT = 2.0 * np.pi * 0.01
QUADRATIC = 0.02
RECORDS = 16


def decay(seed: int, peaks: float, correlation: float, outwards: bool) -> tuple[FloatArray, FloatArray]:
    """Return time and a decay whose amplitude obeys A' = -d A - q A^2, with white noise and that of the peaks."""
    rng = np.random.default_rng([7, seed])
    time = np.arange(PER_CYCLE * CYCLES) / PER_CYCLE
    fall = np.exp(-DECREMENT * time)
    amplitude = fall / (1.0 + QUADRATIC * (1.0 - fall) / DECREMENT)
    error = np.empty(2 * CYCLES + 8)
    error[0] = rng.standard_normal()
    for k in range(1, error.size):
        error[k] = correlation * error[k - 1] + np.sqrt(1.0 - correlation**2) * rng.standard_normal()
    if outwards:
        error *= (-1.0) ** np.arange(error.size)
    slow = peaks * CubicSpline((np.arange(error.size) - 4) / 2.0, error)(time)
    return time, amplitude * np.cos(2.0 * np.pi * time) + slow + WHITE * rng.standard_normal(time.size)


def exact(levels: FloatArray) -> FloatArray:
    """Return the decrement over the cycle in whose middle the amplitude is that of the level; 1/A obeys a line."""
    rate = QUADRATIC / DECREMENT
    begin, end = ((1.0 / levels + rate) * np.exp(DECREMENT * side) - rate for side in (-0.5, 0.5))
    return np.log(end / begin)


def normalised(peaks: float, correlation: float, outwards: bool) -> tuple[float, int]:
    """Return the rms of error over standard error of the damping at the levels, and how often noise was found."""
    errors, found = [], 0
    for seed in range(RECORDS):
        cycles = extract_cycles_from_arrays(*decay(seed, peaks, correlation, outwards), noise=WHITE)
        found += any("scatter by" in note for note in cycles.notes)
        levels = default_levels([cycles])
        damping = backbones_at_levels(cycles, levels, "damping")
        errors.append((damping["value"].values[0, 0] - exact(levels)) / damping["standard_error"].values[0, 0])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), found


@pytest.mark.parametrize(("correlation", "outwards"), [(0.64, True), (0.64, False), (0.0, True), (0.85, True)])
def test_standard_errors_hold_the_noise_of_peaks(correlation: float, outwards: bool) -> None:
    rms, found = normalised(3.0 * WHITE, correlation, outwards)
    assert found == RECORDS
    # of some eighty independent values; an estimated size and correlation leave a fifth of doubt
    assert 0.7 < rms < 1.25


def test_without_the_estimate_errors_are_too_small(monkeypatch: pytest.MonkeyPatch) -> None:
    # negative control
    monkeypatch.setattr(cycles_module, "with_peak_noise", lambda values, signs, turning: (turning, None))
    rms, _ = normalised(3.0 * WHITE, 0.64, True)
    assert rms > 1.4


def test_white_noise_of_samples_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def extracted() -> list[Cycles]:
        return [extract_cycles_from_arrays(*decay(seed, 0.0, 0.0, False), noise=WHITE) for seed in range(6)]

    found = extracted()
    monkeypatch.setattr(cycles_module, "with_peak_noise", lambda values, signs, turning: (turning, None))
    for one, other in zip(found, extracted(), strict=True):
        assert one.notes == other.notes == ()
        np.testing.assert_array_equal(one.bands, other.bands)
        np.testing.assert_array_equal(one.smoothed_amplitude, other.smoothed_amplitude)


def test_a_corner_of_the_damping_is_no_noise() -> None:
    # dry friction over a spring: the amplitude falls in a line and ends; damping rises as one over amplitude
    time = np.arange(PER_CYCLE * 40) / PER_CYCLE
    amplitude = np.maximum(1.0 - 0.022 * time, 0.1)
    rng = np.random.default_rng(3)
    values = amplitude * np.cos(2.0 * np.pi * time) + 2e-4 * rng.standard_normal(time.size)
    assert not any("scatter by" in note for note in extract_cycles_from_arrays(time, values, noise=2e-4).notes)
