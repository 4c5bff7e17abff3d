"""Envelopes: amplitude or power over time instead of a waveform, held to decays that have a closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone._common.checks import InputError
from pymc_backbone.discrepancy.sets.question import is_spring
from pymc_backbone.effects import LIBRARY
from pymc_backbone.measurement.cycle_data import Cycles
from pymc_backbone.measurement.envelope import envelope_cycles
from pymc_backbone.measurement.extraction import measure_batch
from pymc_backbone.measurement.levels import backbones_at_levels
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.records import read_records
from pymc_backbone.measurement.reading.units import parse_envelope_unit
from pymc_backbone.measurement.reading.writing import write_records
from pymc_backbone.reporting.output_folder import read_result

from .test_cli import is_one_sentence, run_cli
from .test_records import refuses, rows, write

F = 32768.0  # Hz: a tuning fork
RATE = 3.0  # 1/s: of the linear part of the decay
NOISE = 1e-3  # of each quadrature, over the amplitude at release
TIME = np.linspace(0.0, 3.0, 1500)


@dataclass(frozen=True)
class Law:
    """A decay A(t) from A(0) = 1 with a closed form, and the damping that follows: -A'/A over the frequency."""

    amplitude: Callable[[np.ndarray], np.ndarray]
    damping: Callable[[np.ndarray], np.ndarray]


DRAG, CUBIC, DRY = 8.0, 20.0, 0.4
LAWS = {
    # A' = -g A
    "viscous": Law(lambda t: np.exp(-RATE * t), lambda a: RATE / F + 0.0 * a),
    # A' = -g A - d: ends in finite time
    "dry": Law(
        lambda t: np.maximum((1.0 + DRY / RATE) * np.exp(-RATE * t) - DRY / RATE, 0.0), lambda a: (RATE + DRY / a) / F
    ),
    # A' = -g A - q A^2
    "drag": Law(lambda t: RATE / ((RATE + DRAG) * np.exp(RATE * t) - DRAG), lambda a: (RATE + DRAG * a) / F),
    # A' = -g A - h A^3
    "cubic": Law(
        lambda t: np.sqrt(RATE / ((RATE + CUBIC) * np.exp(2.0 * RATE * t) - CUBIC)), lambda a: (RATE + CUBIC * a**2) / F
    ),
}


def lock_in(amplitude: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> np.ndarray:
    """Return what a lock-in shows: the modulus of the motion and of noise in both quadratures."""
    return np.abs(amplitude + noise * (rng.standard_normal(amplitude.size) + 1j * rng.standard_normal(amplitude.size)))


def record(values: np.ndarray, time: np.ndarray = TIME, frequency: float | np.ndarray | None = F, **more) -> Record:
    return Record("fork", time, values, "envelope", more.pop("unit", "V"), frequency=frequency, **more)


def damping(cycles: Cycles, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = backbones_at_levels(cycles, levels, ("damping",))
    return found["value"].values[0, 0], found["standard_error"].values[0, 0]


def levels_in(cycles: Cycles, count: int = 7) -> np.ndarray:
    top = np.partition(cycles.smoothed_amplitude, -2)[-2]
    return np.geomspace(1.2 * cycles.smoothed_amplitude.min(), 0.97 * top, count)


def scores(law: Law, seeds: int, rng: np.random.Generator, make=lock_in, time=TIME) -> np.ndarray:
    """Return estimated minus true damping over its standard error (seeds, levels), levels that one lacks left out."""
    found, levels = [], None
    for _ in range(seeds):
        cycles = envelope_cycles(record(make(law.amplitude(time), rng), time))
        levels = levels_in(cycles) if levels is None else levels
        value, error = damping(cycles, levels)
        found.append((value - law.damping(levels)) / error)
    every = np.array(found)
    reached = np.isfinite(every).all(axis=0)
    assert reached.sum() >= 5
    return every[:, reached]


# ---- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LAWS)
def test_without_noise_the_damping_is_that_of_the_closed_form(name):
    law = LAWS[name]
    time = TIME if name != "dry" else TIME[TIME < 0.6]
    cycles = envelope_cycles(record(law.amplitude(time), time))
    levels = levels_in(cycles)
    value, error = damping(cycles, levels)
    # stretches of a fall by some 6 % taken as straight: a part in a thousand at most, and in the standard errors
    np.testing.assert_allclose(value, law.damping(levels), rtol=2e-3)
    assert (error < 0.01 * value).all()


def test_a_damper_is_a_straight_line_in_decibels(tmp_path):
    """The slope over the frequency, read off by a straight line through the decibels: an estimate of another kind."""
    decibels = -20.0 + -8.6859 * RATE * TIME
    path = write(tmp_path / "a.csv", "time [s],R [dB]", rows(time=TIME, values=decibels))
    (item,) = read_records(path, frequency=F)
    slope = np.polyfit(TIME, decibels, 1)[0]
    cycles = envelope_cycles(item)
    value, _ = damping(cycles, levels_in(cycles))
    np.testing.assert_allclose(value, -slope * np.log(10.0) / 20.0 / F, rtol=1e-4)  # six decimals of a decibel


@pytest.mark.parametrize("name", LAWS)
def test_standard_errors_cover_the_truth(name, rng):
    """The mean square of scores is 1 where errors are honest; a kink's width of caution makes it less."""
    z = scores(LAWS[name], 16, rng)
    # 16 seeds, 7 levels that hang together: some 40 independent scores, whose mean square has a deviation of 0.22
    assert 0.2 < np.mean(z**2) < 1.6
    assert np.mean(np.abs(z) < 2.0) > 0.88


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1e-3, 1e-2])
@pytest.mark.parametrize("name", LAWS)
def test_coverage_over_many_records(name, noise, rng):
    z = scores(LAWS[name], 200, rng, lambda a, r: lock_in(a, r, noise))
    inside = np.mean(np.abs(z) < 1.96, axis=0)
    # binomial: 0.95 has a deviation of 0.015; the lowest level may lack 4 % for the bias that is allowed there
    assert (inside[1:] > 0.90).all() and inside[0] > 0.85, inside
    assert (np.abs(z.mean(axis=0)) < 1.2).all()


def test_samples_that_a_filter_makes_alike_have_larger_errors(rng):
    """A lock-in's time constant of five samples: taken for independent, they would scatter beyond their errors."""

    def filtered(amplitude: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        kernel = np.exp(-np.arange(40) / 5.0)
        kernel /= np.sqrt((kernel**2).sum())
        parts = [np.convolve(rng.standard_normal(amplitude.size + 39), kernel, "valid") for _ in range(2)]
        return np.abs(amplitude + NOISE * (parts[0] + 1j * parts[1]))

    z = scores(LAWS["viscous"], 16, rng, filtered)
    assert np.mean(z**2) < 1.6
    levels = np.array([0.02, 0.1, 0.5])
    made = [envelope_cycles(record(make(LAWS["viscous"].amplitude(TIME), rng))) for make in (lock_in, filtered)]
    white, alike = (damping(cycles, levels)[1] for cycles in made)
    # white noise has as much in means over many samples as one over the square root of ten of this has
    assert np.median(alike / white) > 1.7


# ---- noise floor -------------------------------------------------------------------------------


def test_a_noise_floor_adds_in_power_and_is_cut(rng):
    """Near the floor a straight line through ln R is far too flat; what is kept is not."""
    time = np.linspace(0.0, 6.0, 6000)
    values = lock_in(np.exp(-RATE * time), rng, 0.01)
    cycles = envelope_cycles(record(values, time))
    (note,) = [note for note in cycles.notes if "noise floor" in note]
    assert "scatters as the envelope of noise does" in note and note.count(".") <= 3
    lowest = cycles.smoothed_amplitude.min()
    assert 0.03 < lowest < 0.06  # sqrt(10) times sqrt(2) times 0.01 is 0.045
    level = np.array([1.3 * lowest])
    value, error = damping(cycles, level)
    assert abs(value[0] - RATE / F) < 3.0 * error[0]
    # negative control: the logarithm of the samples from 0.02 to 0.06, floor and all
    near = (np.exp(-RATE * time) < 0.06) & (np.exp(-RATE * time) > 0.005)
    naive = -np.polyfit(time[near], np.log(values[near]), 1)[0] / F
    assert naive < 0.85 * RATE / F


def test_a_floor_that_is_no_noise_is_doubted(rng):
    """An offset of a detector looks like a floor without scatter: half of what is subtracted goes into the errors."""
    time = np.linspace(0.0, 6.0, 6000)
    smooth = np.sqrt(np.exp(-2.0 * RATE * time) + 0.01**2) * (1.0 + 1e-4 * rng.standard_normal(time.size))
    cycles = envelope_cycles(record(smooth, time))
    assert any("offset of the detector" in note for note in cycles.notes)
    noisy = envelope_cycles(record(lock_in(np.exp(-RATE * time), rng, 0.01 / np.sqrt(2.0)), time))
    doubt = [item.shared[2, item.smoothed_amplitude < 0.05, 0] for item in (cycles, noisy)]
    assert np.abs(doubt[0]).max() > 5.0 * np.abs(doubt[1]).max()


@pytest.mark.parametrize("kind", ["constant", "noise alone", "rising"])
def test_what_does_not_decay_is_refused(kind, rng):
    values = {
        "constant": lock_in(np.ones(1500), rng, 0.01),
        "noise alone": lock_in(np.zeros(1500), rng, 0.01),
        "rising": lock_in(np.linspace(0.5, 1.0, 1500), rng, 0.01),
    }[kind]
    with pytest.raises(InputError, match=r"^the envelope of 'fork' (does not decay|must hold at least)[^\n]*\.$"):
        envelope_cycles(record(values))


# ---- which part --------------------------------------------------------------------------------


def test_a_drive_that_holds_the_amplitude_is_no_decay(rng):
    driven = np.where(TIME < 0.5, 1.0, np.exp(-RATE * (TIME - 0.5)))
    cycles = envelope_cycles(record(lock_in(driven, rng)))
    assert any("held or still rising" in note for note in cycles.notes)
    assert 0.49 < cycles.time[0] < 0.56
    value, error = damping(cycles, levels_in(cycles))
    assert (np.abs(value - RATE / F) < 4.0 * error).all()
    # negative control: a decay from the first sample on, and friction that bends it, keep their beginning
    for name in LAWS:
        plain = envelope_cycles(record(lock_in(LAWS[name].amplitude(TIME), rng)))
        assert plain.time[0] < 0.02, name


def test_another_release_ends_the_first(rng):
    twice = np.where(TIME < 1.5, np.exp(-RATE * TIME), np.exp(-RATE * (TIME - 1.5)))
    cycles = envelope_cycles(record(lock_in(twice, rng)))
    assert cycles.time[-1] < 1.5
    assert any(note.startswith("fork: warning: the envelope rises again") for note in cycles.notes)


def test_start_stop_and_floor(rng):
    item = record(lock_in(np.exp(-RATE * TIME), rng))
    cycles = envelope_cycles(item, start=0.3, stop=0.9)
    assert 0.3 <= cycles.time[0] and cycles.time[-1] <= 0.9
    assert envelope_cycles(item, floor=0.2).smoothed_amplitude.min() == pytest.approx(0.2, rel=0.05)
    with pytest.raises(InputError, match=r"at least 24 samples"):
        envelope_cycles(item, start=2.99)


# ---- frequency ---------------------------------------------------------------------------------


def test_a_column_of_frequencies_gives_the_backbone(rng):
    """Hardening by 0.2 % at the top, and phase noise that grows as the amplitude falls."""
    z = []
    for _ in range(12):
        amplitude = np.exp(-RATE * TIME)
        motion = F * (1.0 + 2e-3 * amplitude**2) + 0.01 * rng.standard_normal(TIME.size) / np.maximum(amplitude, 1e-3)
        cycles = envelope_cycles(record(lock_in(amplitude, rng), frequency=motion))
        assert cycles.observables == ("frequency", "damping")
        levels = levels_in(cycles)
        found = backbones_at_levels(cycles, levels, ("frequency",))
        z.append((found["value"].values[0, 0] - F * (1.0 + 2e-3 * levels**2)) / found["standard_error"].values[0, 0])
    assert 0.2 < np.mean(np.square(z)) < 1.7


def test_without_it_only_damping_is_measured(rng):
    batch = measure_batch([record(lock_in(np.exp(-RATE * TIME), rng))])
    assert list(batch.backbones["observable"].values) == ["damping"]
    assert batch.backbones.attrs["frequency"] == F and batch.backbones.attrs["amplitude_unit"] == "V"
    (note,) = [note for note in batch.notes if "only damping was measured" in note]
    assert "springs" in note and note.startswith("warning: ")
    with pytest.raises(InputError, match="`observables` hold frequency, which these envelopes do not tell"):
        measure_batch([record(lock_in(np.exp(-RATE * TIME), rng))], Measuring(observables=("frequency",)))
    with pytest.raises(InputError, match=r"frequency of the motion must be known.*give `frequency`, in Hz\.$"):
        measure_batch([record(lock_in(np.exp(-RATE * TIME), rng), frequency=None)])


# ---- files -------------------------------------------------------------------------------------

VALUES = lock_in(LAWS["drag"].amplitude(TIME), np.random.default_rng(7))


def table(path: Path, header: str, *columns: np.ndarray) -> Path:
    return write(path, header, [",".join(f"{x:.10g}" for x in row) for row in zip(TIME, *columns, strict=True)])


FILES = {
    "R [V]": VALUES,
    "Envelope (mV)": 1e3 * VALUES,
    "magnitude [dBV]": 20.0 * np.log10(VALUES),
    "R [Vrms]": VALUES / np.sqrt(2.0),
    "amplitude [Vpp]": 2.0 * VALUES,
    "power [V^2]": VALUES**2,
}


@pytest.mark.parametrize("header", FILES)
def test_volts_decibels_and_powers_are_the_same(header, tmp_path):
    """Written in any of these ways the record is the same, and so are its backbones in metres."""
    path = table(tmp_path / "a.csv", f"time [s],{header}", FILES[header])
    (item,) = read_records(path, frequency=F, sensitivity="50 mV/um")
    assert (item.quantity, item.unit, item.frequency) == ("envelope", "m", F)
    np.testing.assert_allclose(item.values, VALUES / 5e4, rtol=1e-8)  # ten digits are printed
    (plain,) = read_records(path, frequency=F)
    assert plain.unit == "V" and any("not in metres" in note for note in plain.notes)
    levels = np.array([0.02, 0.1, 0.5])
    of_volts, error = damping(envelope_cycles(plain), levels)
    of_metres, _ = damping(envelope_cycles(item), levels / 5e4)
    np.testing.assert_allclose(of_volts, of_metres, rtol=1e-6)
    assert (np.abs(of_volts - LAWS["drag"].damping(levels)) < 4.0 * error).all()


@pytest.mark.parametrize(
    ("header", "values"),
    [
        ("power [dBm]", 20.0 * np.log10(VALUES)),
        ("power [W]", VALUES**2),
        ("amplitude [dB]", 20.0 * np.log10(VALUES)),
        ("magnitude", VALUES),
    ],
)
def test_a_reference_says_how_much_it_is(header, values, tmp_path):
    """Metres at 0 dB, at 0 dBm, at 1 W, at 1."""
    path = table(tmp_path / "a.csv", f"time [s],{header}", values)
    for given in ("2.5 nm", 2.5e-9):
        (item,) = read_records(path, frequency=F, reference=given)
        assert item.unit == "m"
        np.testing.assert_allclose(item.values, 2.5e-9 * VALUES, rtol=1e-8)


def test_velocity_and_acceleration_are_divided_by_the_angular_frequency(tmp_path):
    motion = np.linspace(1000.0, 1100.0, TIME.size)
    path = table(tmp_path / "a.csv", "time [s],envelope [mm/s],frequency [kHz]", VALUES, motion / 1e3)
    (item,) = read_records(path)
    np.testing.assert_allclose(item.values, 1e-3 * VALUES / (2.0 * np.pi * motion), rtol=1e-8)
    np.testing.assert_allclose(item.frequency, motion, rtol=1e-9)
    path = table(tmp_path / "a.csv", "time [s],amplitude [g]", VALUES)
    (item,) = read_records(path, frequency=50.0)
    np.testing.assert_allclose(item.values, 9.80665 * VALUES / (100.0 * np.pi) ** 2, rtol=1e-8)
    refuses(path, "a.csv", "needs the frequency of the motion", "`frequency`")


def test_a_frequency_in_every_line_is_known_and_not_measured(tmp_path):
    path = table(tmp_path / "a.csv", "time [s],R [V],frequency [Hz]", VALUES, np.full(TIME.size, F))
    (item,) = read_records(path)
    assert item.frequency == F and any("not as measured" in note for note in item.notes)
    (given,) = read_records(path, frequency=2.0 * F)
    assert given.frequency == 2.0 * F


def test_a_waveform_called_amplitude_is_one(tmp_path):
    wave = np.exp(-RATE * TIME) * np.cos(2.0 * np.pi * 20.0 * TIME)
    (item,) = read_records(table(tmp_path / "a.csv", "time [s],Amplitude [mm]", wave))
    assert item.quantity == "displacement"
    (item,) = read_records(table(tmp_path / "a.csv", "time [s],displacement [mm],power [W]", wave, VALUES))
    assert item.quantity == "displacement" and any("'power [W]' not" in note for note in item.notes)
    (item,) = read_records(table(tmp_path / "a.csv", "time [s],power [W],x [mm]", VALUES, wave), columns=["power*"])
    assert item.quantity == "envelope"


def test_wrong_files_are_refused_in_one_sentence(tmp_path):
    path = tmp_path / "a.csv"
    wave = np.cos(2.0 * np.pi * 20.0 * TIME)
    refuses(table(path, "time [s],envelope [V]", wave), "a.csv", "not negative", frequency=F)
    refuses(table(path, "time [s],amplitude [V]", wave), "a.csv", "negative values", "`quantity`", frequency=F)
    refuses(table(path, "time [s],power [W]", wave), "a.csv", "a power must", frequency=F)
    refuses(table(path, "time [s],R [furlong]", VALUES), "a.csv", "'furlong'", "dBm", frequency=F)
    refuses(table(path, "time [s],R [V],frequency [Hz]", VALUES, -TIME), "a.csv", "frequency must be positive")
    refuses(table(path, "time [s],R [nm]", VALUES), "a.csv", "`reference`", reference="1 nm", frequency=F)
    refuses(table(path, "time [s],R [dBm]", VALUES), "a.csv", "`reference`", sensitivity="1 V/m", frequency=F)
    refuses(table(path, "time [s],R [V]", VALUES), "`reference`", "'2.5 nm'", reference="big", frequency=F)
    refuses(table(path, "time [s],displacement [mm]", wave), "`frequency`", "waveform", frequency=F)
    table(path, "time [s],R [V],freq A [Hz],freq B [Hz]", VALUES, 1 + TIME, 2 + TIME)
    refuses(path, "a.csv", "one column", "freq B")


@pytest.mark.parametrize(
    ("text", "law", "si", "at_one"),
    [
        ("dB", "level", "1", 10**0.05),
        ("dBm", "level", "sqrt(W)", np.sqrt(1e-3) * 10**0.05),
        ("mW", "power", "sqrt(W)", np.sqrt(1e-3)),
        ("uVrms", "amplitude", "V", 1e-6 * np.sqrt(2.0)),
        ("nm pp", "amplitude", "m", 0.5e-9),
        ("m/s rms", "amplitude", "m/s", np.sqrt(2.0)),
        ("a.u.", "amplitude", "1", 1.0),
    ],
)
def test_units(text, law, si, at_one):
    unit = parse_envelope_unit(text)
    assert unit is not None and (unit.law, unit.si) == (law, si)
    assert unit.amplitudes(np.array([1.0]))[0] == pytest.approx(at_one, rel=1e-12)


def test_records_read_back(tmp_path):
    known = record(VALUES, unit="sqrt(W)")
    measured = Record("other", TIME, VALUES, "envelope", "sqrt(W)", frequency=F + TIME)
    write_records([known, measured], tmp_path / "out")
    first, second = read_records(tmp_path / "out")
    np.testing.assert_array_equal(first.values, VALUES)
    np.testing.assert_array_equal(second.frequency, F + TIME)
    assert first.frequency == F and first.unit == second.unit == "sqrt(W)"


def test_a_record_checks_what_it_is_given():
    with pytest.raises(InputError, match="must not be negative"):
        record(-VALUES)
    with pytest.raises(InputError, match="`frequency` must be as long as `time`"):
        record(VALUES, frequency=np.ones(3))
    with pytest.raises(InputError, match="`frequency` must be positive"):
        record(VALUES, frequency=-1.0)
    with pytest.raises(InputError, match="`frequency` is for an envelope"):
        Record("a", TIME, VALUES, frequency=F)
    with pytest.raises(InputError, match="which has no waveform to condition"):
        pb.condition(record(VALUES))


# ---- the whole way -----------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, rng) -> Path:
    """Three forks with drag, a few per cent apart, in nanometres."""
    made = tmp_path / "forks"
    made.mkdir()
    for k in range(3):
        values = 10.0 * lock_in(LAWS["drag"].amplitude(TIME * (1.0 + 0.01 * k)), rng)
        table(made / f"fork_{k}.csv", "time [s],amplitude [nm]", values)
    return made


def test_extract_writes_backbones_that_read_back(folder, tmp_path, capsys):
    out = tmp_path / "out"
    code, said, _ = run_cli(capsys, "extract", str(folder), "--frequency", str(F), "--out", str(out))
    assert code == 0 and "only damping was measured" in said
    result = read_result(out)
    assert result["observables"] == ["damping"] and result["amplitude_unit"] == "m"
    again = pb.read_backbones(out / "backbones.nc")
    assert again.attrs["frequency"] == F and list(again["observable"].values) == ["damping"]
    # the same from the table, which has no frequency either
    from_table = pb.read_backbones(out / "backbones.csv", levels=again["level"].values[2:4])
    np.testing.assert_allclose(
        from_table["value"].values, again["value"].values[:, :, 2:4], rtol=1e-6
    )  # nine digits are written


def test_mixed_folders_and_forgotten_frequencies_end_in_one_sentence(folder, tmp_path, capsys):
    code, _, said = run_cli(capsys, "extract", str(folder), "--out", str(tmp_path / "out"))
    assert code == 2 and is_one_sentence(said) and "--frequency" in said
    table(folder / "wave.csv", "time [s],displacement [mm]", np.exp(-TIME) * np.cos(60.0 * TIME))
    for command in (["extract"], ["diagnose", "--mass", "1", "--quick"]):
        code, _, said = run_cli(
            capsys, command[0], str(folder), *command[1:], "--frequency", str(F), "--out", str(tmp_path / "out")
        )
        assert code == 2 and is_one_sentence(said) and "waveform" in said and "envelope" in said


def test_update_with_damping_alone(folder, tmp_path, capsys):
    """The stiffness is held at what the frequency says; drag is found within its error."""
    out, mass = tmp_path / "out", 1e-12
    code, said, _ = run_cli(
        capsys, "update", str(folder), "--frequency", str(F), "--mass", str(mass), "--effect", "quadratic_damping",
        "--draws", "300", "--tune", "300", "--chains", "2", "--seed", "3", "--likelihood", "pooled", "--out", str(out),
    )  # fmt: skip
    assert code == 0 and "Only damping was measured" in said
    result = read_result(out)
    assert result["observables"] == ["damping"]
    assert result["fixed"]["linear_stiffness"] == pytest.approx(mass * (2.0 * np.pi * F) ** 2, rel=1e-9)
    # averaged over a cycle, a force b v|v| takes 8 b / (3 pi) * (omega A) A / 2 m ... : A' = -4 b omega A^2 / (3 pi m)
    expected = DRAG / 1e-8 * 3.0 * np.pi * mass / (4.0 * 2.0 * np.pi * F)
    found = result["parameters"]["quadratic_damping"]["mean"]
    assert found == pytest.approx(expected, rel=0.03)  # the forks are up to 2 % apart in time


def test_diagnose_names_drag_and_looks_for_no_spring(folder):
    records = read_records(folder, frequency=F)
    study = pb.find_missing_effect(
        pb.Oscillator(1e-12),
        records,
        candidates=["quadratic_damping", "coulomb_friction", "cubic_stiffness"],
        max_effects=1,
        quick=True,
        held_out=0,
        random_seed=1,
    )
    assert study.missing_effects == ("quadratic_damping",)
    assert all("cubic_stiffness" not in item.effects for item in study.candidates)
    assert any("not looked for" in note and "cubic stiffness" in note for note in study.notes)
    assert any("only damping was measured" in note for note in study.notes)
    with pytest.raises(InputError, match="only damping was measured, which does not tell springs"):
        pb.find_missing_effect(pb.Oscillator(1e-12), records, candidates=["cubic_stiffness"], quick=True)


def test_a_sampled_diagnosis_holds_the_stiffness(folder):
    """Damping alone does not tell it: it is mass times angular frequency squared, in the draws and in the script."""
    mass = 1e-12
    study = pb.find_missing_effect(
        pb.Oscillator(mass), read_records(folder, frequency=F), candidates=["quadratic_damping"], max_effects=1,
        held_out=0, random_seed=1, draws=100, tune=100, chains=2,
    )  # fmt: skip
    stiffness = mass * (2.0 * np.pi * F) ** 2
    assert study.settings["fixed"]["linear_stiffness"] == pytest.approx(stiffness, rel=2e-3)  # a part in a thousand
    assert "linear_stiffness" not in study.posterior["posterior"]
    drag = study.parameters["quadratic_damping"]["quadratic_damping"]
    assert drag.mean == pytest.approx(DRAG / 1e-8 * 3.0 * np.pi * mass / (4.0 * 2.0 * np.pi * F), rel=0.03)


def test_with_a_column_of_frequencies_springs_are_named(rng):
    """Hardening and drag together, as a phase-locked loop shows them."""
    amplitude = LAWS["drag"].amplitude(TIME)
    records = []
    for k in range(2):
        motion = F * (1.0 + 0.001 * k + 2e-3 * amplitude**2)
        motion = motion + 0.003 * rng.standard_normal(TIME.size) / np.maximum(amplitude, 1e-3)
        values = 1e-8 * lock_in(amplitude, rng)
        records.append(Record(f"fork {k}", TIME, values, "envelope", "m", frequency=motion))
    study = pb.find_missing_effect(
        pb.Oscillator(1e-12), records, candidates=["quadratic_damping", "coulomb_friction", "cubic_stiffness"],
        max_effects=2, quick=True, held_out=0, random_seed=1,
    )  # fmt: skip
    assert study.missing_effects == ("cubic_stiffness", "quadratic_damping")
    assert any("the mid-line was not" in note for note in study.notes) and study.portraits is None


def test_springs_are_those_that_take_nothing_from_a_cycle():
    """By the force itself, against what the catalogue says the effects are."""
    found = {name for name, effect in LIBRARY.items() if is_spring(effect, (1.0, 0.01, 30.0))}
    kinds = {name: effect.mechanism for name, effect in LIBRARY.items()}
    springs = {name for name, kind in kinds.items() if kind in ("spring", "asymmetry", "clearance")}
    assert springs - found == {"damped_stop"}  # which takes from each cycle what it is pressed by
    assert not {
        name for name in found if kinds[name] in ("drag", "hysteresis", "displacement_damping", "falling_damping")
    }
