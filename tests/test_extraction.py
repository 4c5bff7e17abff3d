"""One road from records to backbones: what is left out, which levels are chosen, the same for all who ask."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from pymc_backbone._common.checks import InputError
from pymc_backbone.discrepancy.workflow import find_missing_effect
from pymc_backbone.inference.intervals import prior_intervals
from pymc_backbone.inference.model import build_model
from pymc_backbone.measurement.batch_levels import levels_for
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.extraction import ALIKE, LEFT_OUT, extract_all, measure_batch
from pymc_backbone.measurement.levels import default_levels
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.writing import write_records
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.workflows.extract import extract
from pymc_backbone.workflows.measure import measure

from .test_cli import MASS, is_one_sentence, run_cli

FREQUENCY, RATIO = 5.0, 0.01
TIME = np.arange(1200) / 200.0  # 30 cycles


def decay(rng, name, amplitude=0.01, cycles=30):
    """A specimen released from rest: the exact decay of a linear oscillator, and noise 50 dB below."""
    time = TIME[: int(cycles * 40)]
    omega = 2.0 * np.pi * FREQUENCY
    exact = amplitude * np.exp(-RATIO * omega * time) * np.cos(omega * np.sqrt(1.0 - RATIO**2) * time)
    return Record(name, time, exact + 3e-3 * amplitude * rng.standard_normal(time.size))


def noise(rng, name):
    """No decay at all."""
    return Record(name, TIME, 1e-4 * rng.standard_normal(TIME.size))


@pytest.fixture
def records(rng):
    return [decay(rng, "a"), decay(rng, "b", 0.009), noise(rng, "dead sensor"), decay(rng, "c", 0.011)]


def test_a_record_that_cannot_be_used_is_left_out_by_name(records):
    batch = measure_batch(records)
    assert list(batch.backbones["specimen"].values) == ["a", "b", "c"]
    (note,) = [note for note in batch.notes if note.startswith(LEFT_OUT)]
    assert "dead sensor" in note
    assert not [note for note in measure_batch(records[:2]).notes if note.startswith(LEFT_OUT)]


def test_the_values_of_the_others_do_not_change(records):
    """What is left out must leave no trace but its note; and they are right: the linear oscillator's."""
    with_bad = measure_batch(records).backbones
    without = measure_batch([record for record in records if record.specimen != "dead sensor"]).backbones
    np.testing.assert_array_equal(with_bad["value"], without["value"])
    frequency = with_bad["value"].sel(observable="frequency").values
    # A cycle lasts the damped period exactly; noise 50 dB below the release leaves some 1e-4 at the lowest level.
    assert frequency == pytest.approx(FREQUENCY * np.sqrt(1.0 - RATIO**2), rel=1e-3)


def test_strict_refuses_at_the_first(records):
    with pytest.raises(InputError, match=r"^dead sensor"):
        measure_batch(records, Measuring(strict=True))
    with pytest.raises(InputError, match=r"^dead sensor"):
        find_missing_effect(Oscillator(1.0), records, strict=True)


def test_most_must_remain(rng, records):
    dead = [noise(rng, f"dead {i}") for i in range(3)]
    assert len(extract_all([*records[:2], *dead[:2]]).records) == 2  # half is enough
    with pytest.raises(InputError, match="3 of 5 records cannot be used, more than half of them; the first: dead 0"):
        extract_all([*records[:2], *dead])
    with pytest.raises(InputError, match=r"^dead 0"):  # one alone: its own reason says it all
        extract_all(dead[:1])


def test_levels_are_those_of_every_road(records, tmp_path, monkeypatch):
    """`extract`, `update` (by `measure`) and the search must compare at the same amplitudes."""
    write_records(records, tmp_path / "records")
    chosen = measure(tmp_path / "records").backbones["level"].values
    written = extract(tmp_path / "records", output=tmp_path / "out", say=lambda text: None)
    seen = {}

    class Enough(Exception):
        pass

    def batch_of_records(mass, backbones, *_):
        seen["levels"] = backbones["level"].values
        raise Enough

    monkeypatch.setattr("pymc_backbone.discrepancy.sets.question.batch_of_records", batch_of_records)
    from pymc_backbone.measurement.reading.records import read_records

    with pytest.raises(Enough):
        find_missing_effect(Oscillator(1.0), read_records(tmp_path / "records"))
    np.testing.assert_array_equal(chosen, written["levels"])
    np.testing.assert_array_equal(chosen, seen["levels"])


def test_repeats_of_one_structure_are_recognised_and_said(capsys, rng, tmp_path):
    repeats = [decay(rng, f"test {i}", 0.01 * (1.0 - 0.03 * i)) for i in range(4)]
    (note,) = [note for note in measure_batch(repeats).notes if note.startswith(ALIKE)]
    assert "the 4 records" in note and "Each counts as a specimen" in note and "pooled" in note
    # the same decays on time axes that differ by 1 %: a batch with that scatter of frequency
    batch = [Record(item.specimen, item.time * (1.0 + 0.01 * i), item.values) for i, item in enumerate(repeats)]
    assert not [note for note in measure_batch(batch).notes if note.startswith(ALIKE)]
    assert not [note for note in measure_batch(repeats[:1]).notes if note.startswith(ALIKE)]
    write_records(repeats, tmp_path / "records")
    code, out, _ = run_cli(capsys, "extract", str(tmp_path / "records"), "--out", str(tmp_path / "out"))
    assert code == 0 and " ".join(note.split()) in " ".join(out.split())


def test_specimens_without_a_common_range_have_levels_of_their_own(rng):
    cycles = extract_all([decay(rng, "high", 0.1, 12), decay(rng, "low", 0.01, 12)]).cycles
    with pytest.raises(InputError, match="must share a range"):
        default_levels(cycles)
    levels, (note,) = levels_for(cycles)
    assert "share no range" in note
    reached = [(levels >= c.smoothed_amplitude.min()) & (levels <= c.smoothed_amplitude.max()) for c in cycles]
    assert all(here.sum() >= 2 for here in reached) and not np.any(reached[0] & reached[1])


@pytest.mark.parametrize(("release", "cycles"), [(0.02, 24), (0.03, 9)])
def test_two_halves_of_a_batch_far_apart_have_levels_where_each_of_them_was(release, cycles, rng):
    """Records of a second test, from larger releases: the medians of both ends lie between the two halves."""
    tests = [decay(rng, f"test {k}", 0.004 if k < 2 else release, cycles) for k in range(4)]
    batch = measure_batch(tests, whole_range=True)
    assert any("share no range" in note for note in batch.notes)
    assert np.isfinite(batch.backbones["value"].sel(observable="frequency")).sum("level").min() >= 3
    if cycles == 9:  # no specimen was at any amplitude between those medians
        with pytest.raises(InputError, match="must share a range"):
            default_levels(batch.extraction.cycles)


def test_a_narrow_common_range_gives_levels_over_the_whole_where_the_search_asks(rng):
    cycles = extract_all(
        [decay(rng, "high", 0.1, 24), decay(rng, "middle", 0.07, 24), decay(rng, "low", 0.045, 24)]
    ).cycles
    tops = [np.partition(item.smoothed_amplitude, -2)[-2] for item in cycles]
    bottoms = [item.smoothed_amplitude.min() for item in cycles]
    shared, said = levels_for(cycles)
    assert not said and shared[0] > max(bottoms) and shared[-1] < min(tops)
    levels, (note,) = levels_for(cycles, whole_range=True)
    assert "is narrow" in note
    assert levels[0] == pytest.approx(1.02 * min(bottoms)) and levels[-1] == pytest.approx(0.98 * max(tops))
    for item in cycles:  # two cycles for each level, as elsewhere
        reached = (levels >= item.smoothed_amplitude.min()) & (levels <= item.smoothed_amplitude.max())
        assert 3 <= reached.sum() <= item.smoothed_amplitude.size / 2
    alike = extract_all([decay(rng, "a"), decay(rng, "b")]).cycles
    np.testing.assert_array_equal(levels_for(alike, whole_range=True)[0], levels_for(alike)[0])


def test_no_more_levels_than_cycles(rng):
    """Values at more amplitudes than there are cycles depend on each other exactly; their covariance has no inverse."""
    cycles = extract_all([decay(rng, "a")]).cycles
    count = cycles[0].smoothed_amplitude.size
    assert levels_for(cycles, count)[0].size == count
    for levels in (count + 2, 100_000, np.linspace(0.004, 0.008, count + 2)):
        with pytest.raises(InputError, match=f"a has {count} cycles; ask for fewer"):
            levels_for(cycles, levels)
    with pytest.raises(InputError, match="at least 1"):
        levels_for(cycles, 0)


def test_as_many_levels_as_the_cycles_bear_can_be_inferred_from(rng):
    """45 levels of one smooth curve are nearly dependent: their covariance has to be whitened all the same."""
    time = np.arange(60 * 40) / 200.0
    omega = 2.0 * np.pi * FREQUENCY
    exact = 0.01 * np.exp(-RATIO * omega * time) * np.cos(omega * np.sqrt(1.0 - RATIO**2) * time)
    records = [Record(f"s{i}", time, exact + 1e-6 * rng.standard_normal(time.size)) for i in range(2)]
    backbones = measure_batch(records, Measuring(levels=45)).backbones
    model = build_model(Oscillator(1.0), backbones, likelihood="pooled")
    height = model.compile_logp()
    right = {"linear_stiffness": omega**2, "viscous_damping": 2.0 * RATIO * omega}

    def at(**other):
        values = {name: other.get(name, value) for name, value in right.items()}
        bounds = prior_intervals(Oscillator(1.0), backbones, {}, {})
        share = {
            name: (value - bounds[name][0]) / (bounds[name][1] - bounds[name][0]) for name, value in values.items()
        }
        return float(height({f"{name}_interval__": np.log(s / (1.0 - s)) for name, s in share.items()}))

    assert np.isfinite(at()) and at() > at(linear_stiffness=1.01 * omega**2) + 100.0
    assert at() > at(viscous_damping=1.1 * right["viscous_damping"]) + 10.0


def test_offset_is_taken_only_where_all_is_asked_for(rng):
    records = [decay(rng, "a")]
    assert list(measure_batch(records).backbones["observable"].values) == ["frequency", "damping"]
    every = measure_batch(records, every_observable=True).backbones
    assert list(every["observable"].values) == ["frequency", "damping", "offset"]
    chosen = measure_batch(records, Measuring(observables=["offset"]), every_observable=True).backbones
    assert list(chosen["observable"].values) == ["offset"]


@pytest.mark.parametrize("command", ["extract", "update", "diagnose"])
@pytest.mark.parametrize("levels", ["45", "200", "100000"])
def test_too_many_levels_are_one_sentence(capsys, rng, tmp_path, command, levels):
    write_records([decay(rng, "a"), decay(rng, "b")], tmp_path / "records")
    mass = [] if command == "extract" else MASS
    arguments = [command, str(tmp_path / "records"), *mass, "--levels", levels, "--out", str(tmp_path / "out"), "-q"]
    code, out, error = run_cli(capsys, *arguments)
    assert code == 2 and out == ""
    assert is_one_sentence(error.splitlines(keepends=True)[-1]) and "--levels put" in error


def test_the_command_line_says_what_is_left_out_and_strict_refuses(capsys, records, tmp_path):
    write_records(records, tmp_path / "records")
    base = ["extract", str(tmp_path / "records"), "--out", str(tmp_path / "out"), "--overwrite"]
    code, out, error = run_cli(capsys, *base)
    assert code == 0, error
    assert f"\n{LEFT_OUT}" in out and "dead" in out and "3 specimens" in out
    code, out, error = run_cli(capsys, *base, "--strict")
    assert code == 2 and is_one_sentence(error.splitlines(keepends=True)[-1]) and "dead" in error


def test_top_level_of_struck_records_is_right_behind_a_band_pass(rng):
    """Hammer contact, a second mode at twice the frequency and one far above: the first cycles hold them all."""
    rate, frequency, ratio = 5120.0, 122.4, 9e-4
    time = np.arange(0.0, 2.0, 1.0 / rate)
    records = []
    for i in range(4):
        struck = 0.1 + 0.01 * i
        since = np.clip(time - struck, 0.0, None)
        modes = ((1.0, frequency, ratio), (0.5, 243.5, 0.002), (0.3, 700.0, 0.01))
        velocity = sum(
            share * np.exp(-zeta * 2.0 * np.pi * f * since) * np.cos(2.0 * np.pi * f * np.sqrt(1.0 - zeta**2) * since)
            for share, f, zeta in modes
        )
        velocity = np.where(time < struck, 0.0, velocity * (1.0 - np.exp(-since / 8e-4)))
        noisy = velocity + 2e-3 * rng.standard_normal(time.size)
        records.append(Record(f"hit {i}", time, noisy, quantity="velocity", unit="m/s"))
    backbones = measure_batch(records, Measuring(band=(90.0, 160.0))).backbones
    top = backbones.isel(level=-1)
    truth = {"frequency": frequency * np.sqrt(1.0 - ratio**2), "damping": 2.0 * np.pi * ratio / np.sqrt(1.0 - ratio**2)}
    for name, value in truth.items():
        own = top.sel(observable=name)
        z = (own["value"].values - value) / own["standard_error"].values
        assert np.abs(z).max() < 3.5 and (z**2).mean() < 2.5, name  # four of each: chance passes these once in 1000
    # what the second mode does to the top level that is not passed
    beaten = measure_batch(records[:1]).backbones.isel(level=-1).sel(observable="damping")
    assert abs(float(beaten["value"][0]) / truth["damping"] - 1.0) > 0.02


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_settles_after_the_release_costs_no_cycle(seed):
    """Behind a high-pass at a third of the frequency an acceleration begins with a slow decay: errors are large there.

    No cycle stood "above its noise" at the beginning, and the record was refused although it falls to a quarter only.
    """
    rng = np.random.default_rng(seed)
    count, rate, finer, frequency, ratio = 3000, 150.0, 20, 3.01, 0.0043
    pole = -ratio * 2.0 * np.pi * frequency + 2j * np.pi * frequency * np.sqrt(1.0 - ratio**2)
    time = np.arange(count * finer) / (rate * finer)
    released = 0.01 * pole.conjugate() / (pole.conjugate() - pole)  # at rest
    acceleration = 2.0 * (released * pole**2 * np.exp(pole * time)).real
    passed = lfilter(*bilinear([1, 0], [1, 2.0 * np.pi * 0.3 * frequency], rate * finer), acceleration)[::finer]
    passed += 2e-3 * np.std(passed) * rng.standard_normal(count)
    step = 2.2 * np.abs(passed).max() / 2**12
    passed = step * np.round(passed / step)
    cycles = extract_cycles(condition(Record("s", time[::finer], passed, "acceleration", unit="m/s^2", source="s.csv")))
    assert cycles.amplitude.size > 56
    later = slice(10, 50)
    np.testing.assert_allclose(cycles.damping[later].mean(), 2.0 * np.pi * ratio, rtol=0.01)
    np.testing.assert_allclose(cycles.frequency[later], abs(pole.imag) / (2.0 * np.pi), rtol=2e-3)
