"""Samples missing in between: put in by the cycles around them, or by a spline where that is nearer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.gap_filling import filled
from pymc_backbone.measurement.conditioning.time_grid import to_uniform
from pymc_backbone.measurement.reading.record import Record

PER_CYCLE = 50


def decay(time):
    """A damped motion with a third harmonic whose frequency falls by 8 % over ten cycles: time in cycles."""
    phase = 2.0 * np.pi * (time - 0.004 * time**2)
    return np.exp(-0.06 * time) * np.cos(phase) + 0.03 * np.exp(-0.18 * time) * np.cos(3.0 * phase)


def with_another_mode(time):
    return decay(time) + 0.1 * np.exp(-0.1 * time) * np.cos(2.0 * np.pi * 5.37 * time)


def errors(truth, noise, missing, rng, draws=40):
    """Errors, root mean square, of the spline and of what is put in, over gaps anywhere in ten cycles."""
    time = np.arange(10 * PER_CYCLE) / PER_CYCLE
    by_spline, put_in = [], []
    for _ in range(draws):
        values = truth(time) + noise * rng.normal(size=time.size)
        first = int(rng.integers(PER_CYCLE, 9 * PER_CYCLE))
        gap = np.arange(first, first + missing)
        known = np.setdiff1d(np.arange(time.size), gap)
        values[gap] = make_interp_spline(time[known], values[known], k=5)(time[gap])
        result = filled(values, [(first, first + missing)], PER_CYCLE)
        np.testing.assert_array_equal(result[known], values[known])
        by_spline.append(values[gap] - truth(time[gap]))
        put_in.append(result[gap] - truth(time[gap]))
    return tuple(float(np.sqrt(np.mean(np.square(item)))) for item in (by_spline, put_in))


@pytest.mark.parametrize("missing", [1, 3, 5, 8])
def test_what_is_put_in_is_nearer_than_the_noise(missing, rng):
    by_spline, put_in = errors(decay, 2e-3, missing, rng)
    assert put_in < 2e-3 < by_spline and put_in < 0.6 * by_spline


@pytest.mark.parametrize("missing", [1, 5])
def test_another_mode_or_a_corner_keeps_the_spline(missing, rng):
    by_spline, put_in = errors(with_another_mode, 1e-4, missing, rng)
    assert put_in <= 1.01 * by_spline

    def released(time):
        return np.where(time < 4.0, 1.0, decay(np.maximum(time - 4.0, 0.0)) / 1.03)

    by_spline, put_in = errors(released, 1e-5, missing, rng)
    assert put_in <= 1.01 * by_spline


def test_too_few_samples_keep_the_spline(rng):
    values = rng.normal(size=12)
    np.testing.assert_array_equal(filled(values, [(5, 6)], 8.0), values)
    np.testing.assert_array_equal(filled(values, [(5, 6)], 2.1), values)
    at_the_end = np.cos(2.0 * np.pi * np.arange(100) / 20.0)
    np.testing.assert_array_equal(filled(at_the_end, [(98, 100)], 20.0), at_the_end)


def test_gaps_of_the_times_are_known_by_their_samples():
    kept = np.setdiff1d(np.arange(200), [50, 51, 52, 120])
    samples = to_uniform(3.0 + 0.002 * kept, np.cos(0.1 * kept))
    assert samples.missing == [(50, 53), (120, 121)] and samples.values.size == 200
    assert to_uniform(3.0 + 0.002 * np.arange(200), np.cos(0.1 * np.arange(200))).missing == []


def test_held_values_leave_less_than_the_noise_behind(rng):
    """A logger that held its last value five times over five samples while it moved: the motion stands there."""
    time = np.arange(40 * PER_CYCLE) / (PER_CYCLE * 14.0)
    truth = 3e-3 * np.exp(-0.06 * 14.0 * time) * np.cos(2.0 * np.pi * 14.0 * time)
    values = truth + 5e-6 * rng.normal(size=time.size)
    held = [410 + 200 * k for k in range(5)]
    for first in held:
        values[first : first + 5] = values[first - 1]
    conditioned = condition(Record("s", time, values, unit="m", source="s.csv", starts_free=True))
    assert any("hold one value while the motion goes on" in note for note in conditioned.notes)
    at = np.concatenate([np.arange(first, first + 5) for first in held])
    place = np.round((time[at] - conditioned.time[0]) * conditioned.sampling_rate).astype(int)
    np.testing.assert_allclose(conditioned.time[place], time[at], atol=1e-9)
    left = conditioned.displacement[place] - truth[at]
    assert np.sqrt(np.mean(np.square(left - np.median(left)))) < 5e-6
