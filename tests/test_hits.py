"""Hammer tests: the force says where contact ends, hits are cut apart, double hits are left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pymc_backbone._common.checks import FloatArray, InputError
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.reading.hits import find_hits
from pymc_backbone.measurement.reading.record import MINIMUM_SAMPLES
from pymc_backbone.measurement.reading.records import read_records

RATE, FREQUENCY, RATIO = 5000.0, 40.0, 0.01
OMEGA = 2.0 * np.pi * FREQUENCY
CONTACT = 0.004  # s, a sixth of a cycle: what is taken for decay within it is wrong by much


def struck(
    rng: np.random.Generator, hits: list[tuple[float, float]], length: float, noise: float = 1e-3
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, force and acceleration of a linear oscillator under half-sine forces (time, peak), integrated exactly."""
    time = np.arange(int(length * RATE)) / RATE

    def force(t: FloatArray) -> FloatArray:
        total = np.zeros_like(t)
        for begin, peak in hits:
            inside = (t > begin) & (t < begin + CONTACT)
            total[inside] += peak * np.sin(np.pi * (t[inside] - begin) / CONTACT)
        return total

    def rate(t: float, y: FloatArray) -> list[float]:
        return [y[1], float(force(np.array([t]))[0]) - 2.0 * RATIO * OMEGA * y[1] - OMEGA**2 * y[0]]

    y = solve_ivp(rate, (0.0, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-9, atol=1e-12, max_step=CONTACT / 4).y
    applied = force(time)
    acceleration = applied - 2.0 * RATIO * OMEGA * y[1] - OMEGA**2 * y[0]
    scale = float(np.std(acceleration))
    acceleration = acceleration + noise * scale * rng.standard_normal(time.size)
    return time, applied + 0.002 * rng.standard_normal(time.size), acceleration


def write(path: Path, time: FloatArray, force: FloatArray, acceleration: FloatArray, header: str = "force [N]") -> Path:
    rows = "\n".join(f"{t:.6f},{f:.6g},{a:.9g}" for t, f, a in zip(time, force, acceleration, strict=True))
    path.write_text(f"time [s],{header},acc [m/s^2]\n{rows}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("header", ["force [N]", "hammer", "channel 1 (lbf)"])
def test_the_record_starts_at_the_end_of_contact(header: str, rng: np.random.Generator, tmp_path: Path) -> None:
    time, force, acceleration = struck(rng, [(0.3, 1.0)], 1.5)
    (record,) = read_records(write(tmp_path / "hit.csv", time, force, acceleration, header))
    assert record.specimen == "hit" and record.starts_free
    # within a quarter of the contact after its end, and never in it
    assert 0.3 + 0.97 * CONTACT < record.time[0] < 0.3 + 1.5 * CONTACT
    assert any("shows 1 hit" in note and "end of contact" in note for note in record.notes)
    cycles = extract_cycles(condition(record))
    assert cycles.time[0] < 0.3 + CONTACT + 1.5 / FREQUENCY
    decrement = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)
    score = (cycles.damping - decrement) / cycles.damping_error
    # not the first cycle: integrating an acceleration twice leaves its errors there
    assert np.abs(score[1:6]).max() < 4.0 and np.sqrt(np.mean(score[1:] ** 2)) < 2.0


def test_without_the_force_the_first_cycle_is_later_or_wrong(rng: np.random.Generator, tmp_path: Path) -> None:
    # negative control: the channel of force is what tells where the contact ends
    time, force, acceleration = struck(rng, [(0.3, 1.0)], 1.5)
    path = write(tmp_path / "hit.csv", time, force, acceleration, "temperature [K]")
    (record,) = read_records(path)
    assert not record.starts_free and record.time[0] == 0.0


def test_hits_are_cut_apart_and_double_hits_left_out(rng: np.random.Generator, tmp_path: Path) -> None:
    hits = [(0.3, 1.0), (1.7, 0.4), (3.1, 0.8), (3.18, 0.3), (4.5, 1.3)]
    time, force, acceleration = struck(rng, hits, 5.8)
    records = read_records(write(tmp_path / "run.csv", time, force, acceleration))
    assert [record.specimen for record in records] == ["run hit 1", "run hit 2", "run hit 4"]
    for record, begin, end in zip(records, (0.3, 1.7, 4.5), (1.7, 3.1, 5.8), strict=True):
        assert begin + 0.97 * CONTACT < record.time[0] < begin + 1.5 * CONTACT and record.time[-1] <= end
        assert any("double hits at 3.1002 s were left out" in note for note in record.notes), record.notes
        assert any(f"this is the hit at {begin:g}" in note for note in record.notes), record.notes
        frequency = extract_cycles(condition(record)).frequency
        np.testing.assert_allclose(frequency[:10].mean(), FREQUENCY * np.sqrt(1.0 - RATIO**2), rtol=1e-3)


def test_a_double_hit_alone_is_taken_after_its_last_contact(rng: np.random.Generator, tmp_path: Path) -> None:
    time, force, acceleration = struck(rng, [(0.3, 1.0), (0.37, 0.4)], 1.8)
    (record,) = read_records(write(tmp_path / "run.csv", time, force, acceleration))
    assert 0.37 + 0.97 * CONTACT < record.time[0] < 0.37 + 1.5 * CONTACT
    assert any("after their last contact" in note for note in record.notes)


@pytest.mark.parametrize("noise", [0.0, 1e-3, 2e-2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_hits_are_found_in_noise_whatever_the_sign_and_offset(
    noise: float, sign: float, rng: np.random.Generator
) -> None:
    at = np.arange(20_000)
    force = np.where((at >= 4000) & (at < 4020), np.sin(np.pi * (at - 4000) / 20.0), 0.0)
    force += np.where((at >= 12_000) & (at < 12_020), 0.3 * np.sin(np.pi * (at - 12_000) / 20.0), 0.0)
    hits = find_hits(sign * force + 0.7 + noise * rng.standard_normal(at.size))
    assert [abs(hit.begin - where) <= 4 for hit, where in zip(hits, (4000, 12_000), strict=True)] == [True, True]
    assert all(hit.contacts == 1 for hit in hits)


def test_what_is_no_hammer_is_not_used(rng: np.random.Generator, tmp_path: Path) -> None:
    assert find_hits(rng.standard_normal(5000)) == []
    assert find_hits(np.zeros(5000)) == []
    assert find_hits(np.sin(0.1 * np.arange(5000))) == []
    time = np.arange(2000) / RATE
    decay = np.exp(-5.0 * time) * np.cos(OMEGA * time)
    path = write(tmp_path / "run.csv", time, np.sin(0.3 * OMEGA * time), decay)
    (record,) = read_records(path)
    assert record.time.size == 2000 and not record.starts_free
    assert any("shows no hit" in note for note in record.notes)


def test_hits_without_a_decay_are_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    time, force, acceleration = struck(rng, [(0.3, 1.0)], 0.3 + CONTACT + 0.5 * MINIMUM_SAMPLES / RATE)
    with pytest.raises(InputError, match="none of 1 hits"):
        read_records(write(tmp_path / "run.csv", time, force, acceleration))
