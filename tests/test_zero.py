"""The zero of records that end in motion: within its stated error, which the offsets carry on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pymc_backbone._common.checks import FloatArray
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycles import extract_cycles, extract_cycles_from_arrays
from pymc_backbone.measurement.levels import backbones_at_levels
from pymc_backbone.measurement.reading.record import Record

from .test_conditioning import simulated


def slow_wander(rng: np.random.Generator, size: int, per_cycle: int) -> FloatArray:
    """Return noise of unit variance that is correlated over half a cycle: a sensor's drift, a hand near by."""
    kernel = np.hanning(per_cycle)
    return np.convolve(rng.standard_normal(size + per_cycle - 1), kernel, mode="valid") / np.linalg.norm(kernel)


@pytest.mark.parametrize("force", ["linear", "hardening", "quadratic damping"])
def test_the_zero_of_a_record_that_ends_in_motion_is_within_its_error(force: str, rng: np.random.Generator) -> None:
    scores, errors = [], []
    for _ in range(12):
        time, (x, _, _) = simulated(force, 0.02, 8, 100)
        spoiled = x + 3e-3 * slow_wander(rng, x.size, 100) + 1e-3 * rng.standard_normal(x.size)
        found = condition(Record("s", time, spoiled))
        scores.append(found.baseline / found.baseline_error)
        errors.append(found.baseline)
    # twelve independent scores: chance alone stays below 1.6 (chi-square, 1e-4)
    assert np.sqrt(np.mean(np.square(scores))) < 1.6
    # and the zero is as well known as the wander lets it be, not a multiple of it
    assert np.sqrt(np.mean(np.square(errors))) < 6e-3


def test_offsets_carry_the_error_of_the_zero(rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("linear", 0.01, 30, 50)
    x = x + 1e-4 * rng.standard_normal(x.size)
    known = extract_cycles_from_arrays(time, x)
    doubtful = extract_cycles_from_arrays(time, x, zero_error=5e-3)
    amplitude = known.smoothed_amplitude
    expected = np.hypot(known.offset_error, 5e-3 / amplitude)
    np.testing.assert_allclose(doubtful.offset_error, expected, rtol=1e-9)
    np.testing.assert_array_equal(doubtful.damping_error, known.damping_error)
    levels = [0.3, 0.5]
    of_levels = backbones_at_levels(doubtful, levels, ("damping", "offset"))
    # the errors of all levels are the same error: nearly fully correlated, in proportion to one over amplitude
    covariance = of_levels["covariance"].values[0, 1]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 5e-3 / np.array(levels), rtol=0.05)
    assert covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]) > 0.95
    before = backbones_at_levels(known, levels, ("damping", "offset"))
    np.testing.assert_allclose(
        of_levels["standard_error"].values[0, 0], before["standard_error"].values[0, 0], rtol=1e-9
    )


def test_a_zero_that_is_off_lies_within_the_offsets_errors(rng: np.random.Generator) -> None:
    scores = []
    for _ in range(10):
        time, (x, _, _) = simulated("linear", 0.02, 8, 100)
        found = condition(Record("s", time, x + 3e-3 * slow_wander(rng, x.size, 100)))
        cycles = extract_cycles(found)
        scores.append(float(cycles.offset[-1] / cycles.offset_error[-1]))
    assert np.sqrt(np.mean(np.square(scores))) < 2.0


def test_the_zero_of_measured_pendulums(shared_data: Path) -> None:
    # a pendulum is symmetric: its zero is the mid-line of its swings, -0.0087 rad in the third record
    folder = shared_data / "rotary_pendulum"
    for number, mid_line in ((1, 0.0075), (3, -0.0087)):
        angle = np.radians(np.loadtxt(folder / f"pendulum_free_swing_data_0{number}.txt", skiprows=2))
        found = condition(Record("p", np.arange(angle.size) / 1000.0, angle, unit="rad"))
        assert abs(found.baseline - mid_line) < 2.0 * found.baseline_error
        assert found.baseline_error < 0.02
