"""Records that end in one value: stuck sensors are cut, motion that friction or a coarse converter ended is kept."""

from __future__ import annotations

import numpy as np
import pytest

from pymc_backbone._common.checks import FloatArray
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.conditioned import ConditionedRecord
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
