"""Samples that were lost or written twice: noticed by the motion, said, mended; honest records are left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pymc_backbone._common.checks import FloatArray, InputError
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.lost_samples import Jump, find_jump, mended, repeats
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.records import read_records
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_waveform

from .test_conditioning import FORCES, simulated

FREQUENCY, PER_CYCLE, RATIO = 10.0, 40, 0.008
RATE = FREQUENCY * PER_CYCLE
DECREMENT = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)


def decay(rng: np.random.Generator, noise: float = 2e-3, cycles: int = 40) -> FloatArray:
    """Return an exactly linear decay with white noise."""
    turns = np.arange(cycles * PER_CYCLE) / PER_CYCLE
    return np.exp(-DECREMENT * turns) * np.cos(2.0 * np.pi * turns) + noise * rng.standard_normal(turns.size)


def record(values: FloatArray) -> Record:
    return Record("s", np.arange(values.size) / RATE, values)


def clock_notes(values: FloatArray) -> list[str]:
    return [note for note in condition(record(values)).notes if "check the logger" in note]


@pytest.mark.parametrize("lost", [[(333, 1)], [(333, 2)], [(333, 1), (700, 1)], [(240, 1), (500, 3), (760, 1)]])
def test_lost_samples_are_noticed_said_and_put_in(lost: list[tuple[int, int]], rng: np.random.Generator) -> None:
    true = decay(rng)
    missing = np.concatenate([np.arange(at, at + count) for at, count in lost])
    values = np.delete(true, missing)
    (note,) = clock_notes(values)
    total = sum(count for _, count in lost)
    assert note.startswith(f"warning: {total} sample{'s are' if total > 1 else ' is'} missing without a trace")
    said = [float(text) for text in note.partition("(at ")[2].partition(" s)")[0].split(",")]
    np.testing.assert_allclose(said, [at / RATE for at, _ in lost], atol=4.0 / RATE)  # noise leaves a few samples open
    cycles = extract_cycles(condition(record(values)))
    off = np.abs(cycles.frequency - FREQUENCY) / cycles.frequency_error
    assert off.max() < 4.5  # of some thirty cycles


@pytest.mark.parametrize("kind", ["lost", "doubled"])
@pytest.mark.parametrize("at", [(820, 850), (820, 838, 852), (300, 412, 1000), (70,), (60, 800)])
def test_jumps_that_hide_each_other_and_those_of_first_cycles(at, kind, rng: np.random.Generator) -> None:
    """Within a cycle of each other, within the cycles that tell either, or where too few cycles lie before."""
    true = decay(rng)
    values = np.delete(true, at) if kind == "lost" else np.insert(true, at, true[np.array(at) - 1])
    (note,) = [note for note in clock_notes(values) if "without a trace" in note]
    assert note.startswith(f"warning: {len(at)} sample{'s are' if len(at) > 1 else ' is'} ")
    assert ("missing" if kind == "lost" else "too many") in note
    said = [float(text) for text in note.partition("(at ")[2].partition(" s)")[0].split(",")]
    np.testing.assert_allclose(said, [place / RATE for place in at], atol=5.0 / RATE)


def test_a_clearance_that_is_left_is_no_lost_sample(rng: np.random.Generator) -> None:
    """Where friction brings the motion into a gap, its frequency steps, and the phase by 0.7 sampling intervals."""
    oscillator = Oscillator(1.0, ["freeplay", "coulomb_friction"])
    stiffness = (2.0 * np.pi * FREQUENCY) ** 2
    time = np.arange(40 * 55) / (55 * FREQUENCY)
    for friction in np.geomspace(0.002, 0.006, 12):
        parameters = [stiffness, 0.005 * np.sqrt(stiffness), 3.2 * stiffness, 0.53, friction * stiffness]
        motion = simulate_waveform(oscillator, parameters, time, 1.0).displacement
        moving = motion[np.isfinite(motion)]
        noisy = moving + 10.0 ** (-55.0 / 20.0) / np.sqrt(2.0) * rng.standard_normal(moving.size)
        notes = condition(Record("s", time[: moving.size], noisy)).notes
        assert not [note for note in notes if "check the logger" in note]


def test_without_the_check_the_frequency_is_wrong(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    # negative control: what the check is for
    monkeypatch.setattr("pymc_backbone.measurement.conditioning.free_part.find_jump", lambda *_: None)
    cycles = extract_cycles(condition(record(np.delete(decay(rng), [333, 334]))))
    assert (np.abs(cycles.frequency - FREQUENCY) / cycles.frequency_error).max() > 20.0


def test_a_doubled_sample_is_taken_out(rng: np.random.Generator) -> None:
    true = decay(rng)
    values = np.insert(true, 410, true[409])
    notes = clock_notes(values)
    assert any("too many without a trace" in note and "1.02" in note for note in notes), notes
    cycles = extract_cycles(condition(record(values)))
    assert (np.abs(cycles.frequency - FREQUENCY) / cycles.frequency_error).max() < 4.5


def test_repeated_frames_are_left_out(rng: np.random.Generator) -> None:
    # the camera wrote frames twice in place of the ones that followed: no cycle is longer or shorter
    values = decay(rng)
    at = np.array([250, 411, 730])
    values[at] = values[at - 1]
    (note,) = clock_notes(values)
    assert "3 samples repeat the one before" in note and "0.625, 1.0275, 1.825 s" in note
    found = condition(record(values))
    place = np.searchsorted(found.time, at / RATE - 1e-9)
    exact = np.exp(-DECREMENT * at / PER_CYCLE) * np.cos(2.0 * np.pi * at / PER_CYCLE)
    np.testing.assert_allclose(found.displacement[place], exact, atol=1e-2)  # five times the noise; a step is 0.1


def test_film_at_half_the_rate_is_thinned(rng: np.random.Generator) -> None:
    values = np.repeat(decay(rng)[::2], 2)
    found = condition(record(values))
    cycles = extract_cycles(found)
    assert cycles.frequency.mean() == pytest.approx(FREQUENCY, rel=1e-3)
    assert any("repeat the one before" in note for note in found.notes)


@pytest.mark.parametrize("per_cycle", [12, 60])
@pytest.mark.parametrize("force", list(FORCES))
def test_honest_motion_is_no_fault_of_the_clock(force: str, per_cycle: int, rng: np.random.Generator) -> None:
    for noise in (1e-4, 3e-3):
        values = simulated(force, 0.01, 40, per_cycle)[1][0]
        values = values + noise * np.max(np.abs(values)) * rng.standard_normal(values.size)
        assert find_jump(values, per_cycle * FREQUENCY, FREQUENCY, 1.0 / (per_cycle * FREQUENCY)) is None
        step = 1e-3 * float(np.max(np.abs(values)))
        assert repeats(step * np.round(values / step), step, noise).size == 0


def test_a_blow_between_two_samples_is_not_taken_for_a_lost_sample(rng: np.random.Generator) -> None:
    # the phase steps by half a sample, and the amplitude with it: physics, which no clock does
    turns = np.arange(40 * PER_CYCLE) / PER_CYCLE
    shifted = turns + np.where(turns > 15.0, 0.5 / PER_CYCLE, 0.0)
    values = np.exp(-DECREMENT * turns) * np.cos(2.0 * np.pi * shifted) + 5e-4 * rng.standard_normal(turns.size)
    assert find_jump(values, RATE, FREQUENCY, 1.0 / RATE) is None
    # and a whole one is
    lost = np.delete(decay(rng, 5e-4), 600)
    found = find_jump(lost, RATE, FREQUENCY, 1.0 / RATE)
    assert found is not None and found.count == 1


def test_mending_puts_samples_in_and_takes_them_out() -> None:
    line = np.arange(50.0)
    np.testing.assert_allclose(mended(np.delete(line, [20, 21]), Jump(20, 2, 0), 2.0), line, atol=1e-9)
    np.testing.assert_allclose(mended(np.insert(line, 20, 19.0), Jump(20, -1, 0), -1.0), line, atol=1e-9)


def test_lines_written_twice_are_dropped_and_said(tmp_path: Path, rng: np.random.Generator) -> None:
    values = decay(rng)
    lines = [f"{k / RATE:.6f},{x:.9g}" for k, x in enumerate(values)]
    doubled = [*lines[:300], lines[299], *lines[300:]]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time [s],displacement [m]", *doubled]))
    (found,) = read_records(path)
    np.testing.assert_array_equal(found.time, [float(line.partition(",")[0]) for line in lines])
    assert any("1 line repeats the one before (line 302)" in note for note in found.notes), found.notes
    other = [*lines[:300], lines[299].partition(",")[0] + ",0.5", *lines[300:]]
    path.write_text("\n".join(["time [s],displacement [m]", *other]))
    with pytest.raises(InputError, match=r"line 302.*twice"):
        read_records(path)


def test_gaps_and_jitter_of_the_times_are_counted_and_placed(rng: np.random.Generator) -> None:
    values = decay(rng)
    time = np.arange(values.size) / RATE
    kept = np.setdiff1d(np.arange(values.size), [500, 501, 800])
    found = condition(Record("s", time[kept], values[kept]))
    assert any("3 missing samples in 2 gaps of the times, the first at 1.2475 s" in note for note in found.notes)
    assert not [note for note in found.notes if "without a trace" in note]
    jitter = time + 0.2 / RATE * rng.uniform(-1.0, 1.0, time.size)
    assert any("jitter by up to" in note for note in condition(Record("s", jitter, values)).notes)
