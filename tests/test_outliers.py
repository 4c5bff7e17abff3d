"""Records and specimens that do not belong: spikes, second plucks, growth, limit cycles, other structures and units."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pymc_backbone._common.checks import FloatArray, InputError
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.spikes import without_spikes
from pymc_backbone.measurement.cycle_data import Cycles
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.outliers import find_outliers
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.writing import write_records
from pymc_backbone.reporting.output_folder import read_result

from .test_cli import run_cli
from .test_conditioning import FREQUENCY, friction, simulated, warnings_of

ROOT = Path(__file__).resolve().parents[1]


def decay(rng: np.random.Generator, name: str, frequency: float = 12.0, damping: float = 0.01) -> Record:
    time = np.arange(3000) / 1000.0
    omega = 2.0 * np.pi * frequency * (1.0 + 0.015 * rng.standard_normal())
    damping = damping * np.exp(0.2 * rng.standard_normal())
    values = 1e-3 * np.exp(-damping * omega * time) * np.cos(omega * time)
    return Record(name, time, values + 1e-6 * rng.standard_normal(time.size))


def cycles_of(record: Record, factor: float = 1.0) -> Cycles:
    return extract_cycles(condition(Record(record.specimen, record.time, factor * record.values)))


# ---- batches ------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 4])
def test_a_batch_of_one_kind_has_no_outlier(count: int, rng: np.random.Generator) -> None:
    assert find_outliers([cycles_of(decay(rng, f"s{i}")) for i in range(count)]) == []


@pytest.mark.parametrize(
    ("frequency", "factor", "kind", "words"),
    [
        (40.0, 1.0, "frequency", "another structure or another mode"),
        (12.0, 1000.0, "amplitude", "m for mm"),
        (12.0, 180.0 / np.pi, "amplitude", "radians for degrees"),
    ],
)
@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_specimen_that_does_not_belong_is_named(
    frequency: float, factor: float, kind: str, words: str, count: int, rng: np.random.Generator
) -> None:
    batch = [cycles_of(decay(rng, f"s{i}")) for i in range(count - 1)]
    batch.append(cycles_of(decay(rng, "stranger", frequency), factor))
    (found,) = find_outliers(batch)
    assert found.kind == kind and found.specimens[0] == "stranger" and words in found.sentence
    assert len(found.specimens) == (2 if count == 2 else 1)
    expected = frequency / 12.0 if kind == "frequency" else factor
    assert found.ratio == pytest.approx(expected, rel=0.1) and found.probability < 0.01


def test_a_nonlinear_structure_released_lower_is_no_outlier() -> None:
    # the frequency at its own amplitudes differs by a third from the others' at theirs
    time, (x, _, _) = simulated("strongly hardening", 0.01, 40, 50)
    whole = extract_cycles(condition(Record("a", time, x)))
    late = time > 0.5 * time[-1]
    low = extract_cycles(condition(Record("b", time[late], x[late])))
    assert np.median(whole.frequency[:5]) > 1.2 * np.median(low.frequency[:5])
    assert find_outliers([whole, low]) == []


def test_the_benchmark_keeps_its_rate_of_false_alarms() -> None:
    spec = importlib.util.spec_from_file_location("outliers_benchmark", ROOT / "benchmarks" / "outliers.py")
    assert spec is not None and spec.loader is not None
    benchmark: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    rng = np.random.default_rng(3)
    alarms = sum(bool(find_outliers(benchmark.batch(rng, int(rng.integers(2, 9)), 1.0)[1])) for _ in range(40))
    assert alarms <= 1
    # negative control: scatter three times as large is not honest, and is noticed now and then
    alarms = sum(bool(find_outliers(benchmark.batch(rng, 6, 3.0)[1])) for _ in range(20))
    assert alarms >= 3


def test_extract_says_which_specimen_does_not_belong(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = (("a", 12.0), ("b", 12.0), ("c", 40.0), ("d", 12.0))
    write_records([decay(rng, name, frequency) for name, frequency in names], tmp_path / "records")
    code, out, err = run_cli(capsys, "extract", str(tmp_path / "records"), "--out", str(tmp_path / "out"))
    said = " ".join((out + err).split())
    assert code == 0 and "warning: c: its frequency is 3.3" in said, said
    assert "a: its frequency" not in said and "d: its frequency" not in said


# ---- spikes -------------------------------------------------------------------------------------


@pytest.mark.parametrize("per_cycle", [16, 50, 400])
@pytest.mark.parametrize("width", [1, 3])
def test_a_spike_is_bridged_and_said(per_cycle: int, width: int, rng: np.random.Generator) -> None:
    if width == 3 and per_cycle == 16:
        pytest.skip("three samples of sixteen are a fifth of a cycle: motion may look like that")
    time, (x, _, _) = simulated("hardening", 0.01, 30, per_cycle)
    clean = x + 1e-4 * rng.standard_normal(x.size)
    at = x.size // 3
    spoiled = clean.copy()
    spoiled[at : at + width] += 0.7
    result = condition(Record("s", time, spoiled))
    assert any("a spike of 0." in note and "bridged" in note for note in warnings_of(result)), result.notes
    reference = extract_cycles(condition(Record("s", time, clean)))
    found = extract_cycles(result)
    assert len(found) == len(reference)
    # at sixteen samples per cycle the bridge itself is off by a few times the noise: three errors in one cycle
    assert np.max(np.abs(found.frequency - reference.frequency) / reference.frequency_error) < 3.0
    assert np.max(np.abs(found.damping - reference.damping) / reference.damping_error) < 3.0


@pytest.mark.parametrize("apart", [2, 3, 5, 7, 10])
@pytest.mark.parametrize("per_cycle", [20, 60])
def test_spikes_beside_each_other_are_bridged(apart: int, per_cycle: int, rng: np.random.Generator) -> None:
    """At any phase, also where motion passes zero fastest, and of either sign."""
    _, (x, _, _) = simulated("hardening", 0.01, 30, per_cycle)
    clean = x + 1e-4 * rng.standard_normal(x.size)
    for start in range(5 * per_cycle, 6 * per_cycle, max(per_cycle // 10, 1)):
        for heights in ((0.2, 0.3), (-0.25, 0.15)):
            at = start + np.array([0, apart])
            spoiled = clean.copy()
            spoiled[at] += heights
            bridged, spikes = without_spikes(spoiled)
            assert [(spike.first, spike.count) for spike in spikes] == [(i, 1) for i in at]
            assert np.max(np.abs(bridged - x)) < 0.01 and np.array_equal(np.delete(bridged, at), np.delete(clean, at))
    # negative control: more than five are no chance
    spoiled = clean.copy()
    spoiled[(7 + np.arange(6)) * per_cycle] += 0.3
    assert without_spikes(spoiled)[1] == [] and without_spikes(spoiled)[0] is spoiled


@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-2])
@pytest.mark.parametrize("quantity", [0, 1, 2])
@pytest.mark.parametrize("force", ["linear", "freeplay", "strongly hardening", "quadratic damping"])
def test_motion_and_noise_are_no_spikes(force: str, quantity: int, noise: float, rng: np.random.Generator) -> None:
    for per_cycle in (20, 50):
        _, motion = simulated(force, 0.01, 40, per_cycle, impact=True)
        values = np.concatenate([np.zeros(100), motion[quantity]])
        values = values + noise * np.std(values) * rng.standard_normal(values.size)
        assert without_spikes(values)[1] == []


def test_a_spike_stands_far_out_of_the_blows_of_a_stop(rng: np.random.Generator) -> None:
    """One of the blows looks like a spike; a true one is bridged, and that is not."""
    _, (_, _, clean) = simulated("late stop", 0.01, 40, 40)
    assert without_spikes(clean)[1] == []
    spoiled = clean.copy()
    spoiled[1200] += 0.5 * np.ptp(clean)
    bridged, (spike,) = without_spikes(spoiled)
    assert (spike.first, spike.count) == (1200, 1) and abs(bridged[1200] - clean[1200]) < 0.01 * np.ptp(clean)
    assert np.array_equal(np.delete(bridged, 1200), np.delete(clean, 1200))


def test_friction_and_converters_make_no_spikes() -> None:
    _, x = friction(0.01, 30, 100)
    assert without_spikes(x)[1] == []
    acceleration = np.gradient(np.gradient(x))
    assert without_spikes(acceleration)[1] == []
    step = 2.0**-8
    assert without_spikes(step * np.round(x / step), step)[1] == []


# ---- records that are no free decay -------------------------------------------------------------


@pytest.mark.parametrize(("strength", "words"), [(0.4, "grows again"), (0.9, "warning: the record holds two releases")])
def test_a_second_pluck_is_cut_off_and_said(strength: float, words: str, rng: np.random.Generator) -> None:
    time, (x, _, _) = simulated("linear", 0.01, 40, 50)
    second = strength * np.where(time > 2.0, np.interp(time - 2.0, time, x), 0.0)
    result = condition(Record("s", time, x + second + 1e-4 * rng.standard_normal(x.size)))
    assert any(words in note for note in result.notes), result.notes
    # the longer part that decays freely: before the weaker pluck, after the stronger one
    assert result.time[-1] < 2.3 if strength < 0.5 else result.time[0] > 2.0
    frequency = extract_cycles(result).frequency
    np.testing.assert_allclose(frequency, FREQUENCY * np.sqrt(1.0 - 0.01**2), rtol=5e-3)


def plucked(first: float, second: float, at: float, rng: np.random.Generator, damping: float = 0.01) -> Record:
    """Return a record of 6 s of a structure at 12 Hz that is held and let go twice, the second time at ``at`` [s]."""
    time = np.arange(3600) / 600.0
    omega = 2.0 * np.pi * 12.0
    since = np.where(time < at, time, time - at)
    values = np.where(time < at, first, second) * np.exp(-damping * omega * since) * np.cos(omega * since)
    return Record("s", time, values + 1e-6 * rng.standard_normal(time.size))


@pytest.mark.parametrize(
    ("second", "at", "damping", "words"),
    [
        (4e-3, 2.5, 0.01, "a second release or impact, or beating modes): only the part before is used"),
        (8e-3, 2.5, 0.01, "the record holds two releases: a free decay of 28 cycles, from 0.0047 to "),
        (4e-3, 4.5, 0.03, "the structure moves again from about 4."),
    ],
)
def test_a_second_release_is_warned_of_with_what_was_done(
    second: float, at: float, damping: float, words: str, rng: np.random.Generator
) -> None:
    result = condition(plucked(5e-3, second, at, rng, damping))
    (warning,) = [note for note in result.notes if note.startswith("warning: ")]
    assert words in warning and "is used" in warning and "`start" in warning and "`stop" in warning
    is_first = second < 5e-3
    assert result.time[-1] < at if is_first else result.time[0] > at


def test_the_part_that_a_warning_offers_is_the_first_decay(rng: np.random.Generator) -> None:
    record = plucked(5e-3, 8e-3, 2.5, rng)
    (warning,) = [note for note in condition(record).notes if note.startswith("warning: ")]
    start, stop = (float(re.search(rf"`{name}=([-\d.e]+)`", warning)[1]) for name in ("start", "stop"))
    first = condition(record, start=start, stop=stop)
    assert first.time[0] < 0.1 and 2.2 < first.time[-1] < 2.5
    assert not [note for note in first.notes if note.startswith("warning: ")]


@pytest.mark.parametrize("before", ["rest", "held", "driven", "swept"])
def test_what_is_no_decay_before_a_release_is_no_second_one(before: str, rng: np.random.Generator) -> None:
    """Negative control: at rest, held with a trembling hand, driven at resonance, swept through it."""
    time = np.arange(1800) / 600.0
    omega = 2.0 * np.pi * 12.0
    build_up = 1.0 - np.exp(-0.02 * omega * time)
    lead = {
        "rest": np.zeros(time.size),
        "held": 5e-3 + 2e-4 * np.sin(2.0 * np.pi * 3.0 * time) * (1.0 + 0.5 * np.sin(2.0 * np.pi * 0.4 * time)),
        "driven": 5e-3 * build_up * np.cos(omega * (time - time[-1])),
        "swept": 4e-3 / np.hypot(1.0, (time - 1.5) / 0.3) * np.cos(omega * time),
    }[before]
    free = 5e-3 * np.exp(-0.01 * omega * time) * np.cos(omega * time)
    values = np.concatenate([lead, free])
    result = condition(Record("s", np.arange(values.size) / 600.0, values + 1e-6 * rng.standard_normal(values.size)))
    assert not [note for note in result.notes if "two releases" in note or "moves again" in note]
    assert result.time[0] > 2.9


@pytest.mark.parametrize(
    ("command", "second"), [("extract", 4e-3), ("extract", 8e-3), ("update", 8e-3), ("diagnose", 4e-3)]
)
def test_a_second_release_is_told_by_each_command(
    command: str, second: float, tmp_path: Path, rng: np.random.Generator, capsys
) -> None:
    """On the terminal, in result.json, and unfolded in the report."""
    records = [plucked(5e-3, 5e-3, 99.0, rng), plucked(5e-3, second, 2.5, rng)]
    records = [dataclasses.replace(record, specimen=name) for record, name in zip(records, "ab", strict=True)]
    write_records(records, tmp_path / "records")
    out = tmp_path / "out"
    options = {
        "extract": [],
        "update": ["--mass", "1", "--draws", "200", "--tune", "200", "--chains", "2"],
        "diagnose": ["--mass", "1", "--quick", "--candidates", "cubic_stiffness", "--max-effects", "1"],
    }[command]
    code, text, _ = run_cli(capsys, command, str(tmp_path / "records"), *options, "--out", str(out))
    words = "two releases" if second > 5e-3 else "a second release or impact"
    (line,) = [line for line in text.splitlines() if words in line]
    assert code == 0 and line.startswith("b: warning: ") and "--start" in line
    result = read_result(out)
    assert [note for note in result["notes"] if words in note and note.startswith("b: warning: ")]
    if command != "extract":
        page = (out / "report.html").read_text(encoding="utf-8")
        unfolded = re.sub(r"<details.*?</details>", "", page, flags=re.DOTALL)
        assert words in unfolded


def van_der_pol(begin: float, cycles: int) -> tuple[FloatArray, FloatArray]:
    """Return an oscillator that excites itself to an amplitude of 2."""
    time = np.arange(cycles * 50) / (50 * FREQUENCY)
    omega = 2.0 * np.pi * FREQUENCY

    def rate(t: float, y: FloatArray) -> list[float]:
        return [y[1], 0.06 * omega * (1.0 - y[0] ** 2) * y[1] - omega**2 * y[0]]

    return time, solve_ivp(rate, (0.0, time[-1]), [begin, 0.0], "DOP853", time, rtol=1e-9, atol=1e-10).y[0]


@pytest.mark.parametrize(
    ("begin", "cycles", "words"),
    [(0.05, 15, "the amplitude grows from"), (0.05, 60, "limit cycle"), (2.0, 60, "limit cycle"), (9.0, 60, "settles")],
)
def test_growth_and_limit_cycles_are_refused_in_words(
    begin: float, cycles: int, words: str, rng: np.random.Generator
) -> None:
    time, x = van_der_pol(begin, cycles)
    with pytest.raises(InputError) as caught:
        condition(Record("s", time, x + 1e-4 * rng.standard_normal(x.size)))
    assert words in str(caught.value) and "fewer than 4" not in str(caught.value)
