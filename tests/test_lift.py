"""The hand's lift before the release is not taken for decay, and free motion is not taken for a hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pymc_backbone._common.checks import FloatArray
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.lift import end_of_lift
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.reading.record import Record

from .test_conditioning import FORCES, FREQUENCY, friction, simulated

PER_CYCLE = 100
RATIO = 0.01


def lifted(cycles: float, force: str = "linear") -> FloatArray:
    """Return a displacement that is lifted smoothly from zero to 1 and let go without a pause."""
    count = int(cycles * PER_CYCLE)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / count)
    return np.concatenate([rise, simulated(force, RATIO, 30, PER_CYCLE)[1][0]])


@pytest.mark.parametrize("cycles", [0.7, 0.85, 1.0, 1.3, 2.0])
@pytest.mark.parametrize("force", ["linear", "hardening"])
def test_a_lift_is_cut_off_and_said(cycles: float, force: str, rng: np.random.Generator) -> None:
    values = lifted(cycles, force)
    values = values + 1e-3 * rng.standard_normal(values.size)
    time = np.arange(values.size) / (PER_CYCLE * FREQUENCY)
    found = condition(Record("s", time, values))
    # from the top on, or from the rest before it where the lift was so slow that it counts as rest
    assert found.time[0] > 0.9 * cycles / FREQUENCY
    assert any("moved by hand" in note or "at rest" in note for note in found.notes), found.notes
    if force == "linear":
        cycles_found = extract_cycles(found)
        decrement = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)
        assert np.abs((cycles_found.damping - decrement) / cycles_found.damping_error)[:3].max() < 4.0


def test_with_the_lift_in_it_the_first_damping_is_wrong() -> None:
    # negative control: with `start` the search is off, and what the hand did is taken for decay
    values = lifted(0.7)
    time = np.arange(values.size) / (PER_CYCLE * FREQUENCY)
    cycles = extract_cycles(condition(Record("s", time, values), start=0.0))
    decrement = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)
    assert abs(cycles.damping[0] / decrement - 1.0) > 0.05


@pytest.mark.parametrize("impact", [False, True])
@pytest.mark.parametrize("damping", [0.002, 0.05])
@pytest.mark.parametrize("force", list(FORCES))
def test_free_motion_is_not_taken_for_a_hand(
    force: str, damping: float, impact: bool, rng: np.random.Generator
) -> None:
    for per_cycle in (20, 100):
        _, motion = simulated(force, damping, 30, per_cycle, impact=impact)
        for noise in (0.0, 3e-2):
            values = motion[0][int(0.2 * per_cycle) :]
            values = values + noise * rng.standard_normal(values.size)
            assert end_of_lift(values, per_cycle * FREQUENCY, FREQUENCY, noise) is None


@pytest.mark.parametrize("stick", [0.005, 0.02, 0.04])
def test_dry_friction_is_not_taken_for_a_hand(stick: float) -> None:
    _, x = friction(stick, 20, PER_CYCLE)
    assert end_of_lift(x, PER_CYCLE * FREQUENCY, FREQUENCY, 0.0) is None


def test_ship_roll_is_not_taken_for_a_hand(shared_data: Path) -> None:
    for file in sorted((shared_data / "ship_roll_kvlcc2").glob("*.csv")):
        time, angle = np.loadtxt(file, delimiter=",", skiprows=1).T
        found = condition(Record("s", time, angle, unit="rad"))
        assert not any("by hand" in note for note in found.notes)
