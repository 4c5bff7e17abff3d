"""Records that hold one value, at their end or in between: what stuck or was lost is left out, what stopped is kept."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone._common.checks import FloatArray
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.conditioned import ConditionedRecord
from pymc_backbone.measurement.conditioning.stuck import held_between
from pymc_backbone.measurement.conditioning.time_grid import to_uniform
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_waveform

RATE, FREQUENCY = 400.0, 10.0
TIME = np.arange(int(3.0 * RATE)) / RATE


def _decay(noise: float = 2e-6) -> FloatArray:
    rng = np.random.default_rng(4)
    motion = 1e-3 * np.exp(-0.6 * TIME) * np.cos(2.0 * np.pi * FREQUENCY * TIME)
    return motion + noise * rng.standard_normal(TIME.size)


def _conditioned(values: FloatArray) -> ConditionedRecord:
    return condition(Record("s", TIME, values))


@pytest.mark.parametrize("filling", ["last", "zero"])
def test_a_sensor_that_sticks_while_the_motion_goes_on_is_cut_and_told(filling: str) -> None:
    values = _decay()
    values[1000:] = values[999] if filling == "last" else 0.0
    found = _conditioned(values)
    told = [note for note in found.notes if "hold one value" in note]
    assert len(told) == 1 and f"from {TIME[999 if filling == 'last' else 1000]:.6g} s on" in told[0]
    assert found.time[-1] <= TIME[1000]
    assert found.baseline == pytest.approx(0.0, abs=4.0 * found.baseline_error)
    assert not any("drift" in note or "came to rest" in note for note in found.notes)


def test_friction_that_stops_a_motion_is_no_sensor_that_sticks() -> None:
    friction = Oscillator(1.0, ["coulomb_friction"])
    stiffness = (2.0 * np.pi * FREQUENCY) ** 2
    stuck = 0
    for force in (0.02, 0.05, 0.13):  # of displacements of 5 to 33 micrometres
        values = simulate_waveform(friction, [stiffness, 0.1, force], TIME, 1e-3).displacement
        last = np.flatnonzero(np.isfinite(values))[-1]
        values = np.where(np.isfinite(values), values, values[last])
        stuck += int(np.sum(values == values[-1]) > 40)
        assert not any("hold one value" in note for note in _conditioned(values).notes)
    assert stuck


def test_a_motion_that_fades_below_the_step_of_the_converter_is_no_sensor_that_sticks() -> None:
    step = 4e-5
    values = np.round(_decay(0.0) * np.exp(-1.0 * TIME) / step) * step
    assert np.sum(values[-60:] == values[-1]) == 60
    assert not any("hold one value" in note for note in _conditioned(values).notes)


@pytest.mark.parametrize("filling", ["zero", "last"])
@pytest.mark.parametrize("at", [407, 413, 506, 733])
def test_samples_that_were_lost_in_between_are_left_out_and_told(filling: str, at: int) -> None:
    """Three of forty in a cycle, at any phase; what is put in is near the noise."""
    whole = _decay()
    values = whole.copy()
    values[at : at + 3] = 0.0 if filling == "zero" else values[at - 1]
    found = _conditioned(values)
    (told,) = (note for note in found.notes if "hold one value while the motion goes on" in note)
    assert f"{TIME[at + 1]:.6g}" in told
    expected = _conditioned(whole)
    assert found.displacement.size == expected.displacement.size
    off = np.abs((found.displacement + found.baseline) - (expected.displacement + expected.baseline))
    assert off.max() < 2e-5 and np.delete(off, np.arange(at - 3, at + 6)).max() < 1e-6


def test_samples_that_a_coarse_converter_repeats_are_kept() -> None:
    """At turning points of a converter of few steps, and where a sensor clips, the same value comes again and again."""
    for step in (1e-5, 4e-5):
        values = np.round(_decay(0.0) / step) * step
        assert np.any(np.diff(values[:600]) == 0.0)
        assert not any("hold one value" in note for note in _conditioned(values).notes)


@pytest.mark.parametrize("held", [2, 3])
def test_equal_samples_before_a_release_are_the_rest_before_it(held: int) -> None:
    """Of a velocity, which begins with a corner there: no cubic goes through it, and nothing was lost."""
    rest = 60
    rng = np.random.default_rng(5)
    motion = np.exp(-0.6 * TIME) * np.sin(2.0 * np.pi * FREQUENCY * TIME)
    values = np.concatenate([np.zeros(rest), motion])[: TIME.size] + 2e-3 * rng.standard_normal(TIME.size)
    values[rest - held + 1 : rest + 1] = values[rest - held]
    assert held_between(values, RATE / FREQUENCY, 0.0, 2e-3).size == 0
    values[400:403] = values[399]  # and one that was
    assert held_between(values, RATE / FREQUENCY, 0.0, 2e-3).tolist() == [400, 401, 402]


@pytest.mark.parametrize(("rate", "missing"), [(480.0, ()), (810.0, ()), (480.0, (700,)), (700.0, (300, 301))])
def test_stamps_of_few_digits_are_those_of_an_even_clock(rate: float, missing: tuple[int, ...]) -> None:
    """In milliseconds the steps of 480 samples a second are 2, 2, 2, 2, 2 and 3 ms: no sixth sample is missing."""
    instants = np.arange(2000) / rate
    kept = np.setdiff1d(np.arange(2000), missing)
    values = np.cos(2.0 * np.pi * 9.0 * instants)
    grid = to_uniform(np.round(instants, 3)[kept], values[kept])
    assert grid.sampling_rate == pytest.approx(rate, rel=1e-5) and grid.values.size == 2000
    np.testing.assert_allclose(grid.values, values, atol=1e-3)
    assert any("missing" in note for note in grid.notes) == bool(missing)
