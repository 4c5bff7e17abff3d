"""Records in volts, and the sensitivity of the sensor that made them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone.measurement.reading.records import read_records
from pymc_backbone.measurement.reading.sensitivity import sensitivities_of

from .test_records import TIME, VALUES, one, refuses, rows, write

GRAVITY = 9.80665


@pytest.mark.parametrize(
    ("text", "quantity", "volts"),
    [
        ("10.2 mV/g", "acceleration", 10.2e-3 / GRAVITY),
        ("10,2 mV/g", "acceleration", 10.2e-3 / GRAVITY),
        ("0.0102 V/(m/s^2)", "acceleration", 0.0102),
        ("1.02 mV/ms-2", "acceleration", 1.02e-3),
        ("1.02mV/(m s⁻²)", "acceleration", 1.02e-3),
        ("2.25 mV/N", "force", 2.25e-3),
        ("100 mV/um", "displacement", 1e5),
        ("20 mV/(mm/s)", "velocity", 20.0),
        ("28.8 V s/m", "velocity", 28.8),
        ("98.0665 (m/s^2)/V", "acceleration", 1.0 / 98.0665),
        ("10 g/V", "acceleration", 1.0 / (10.0 * GRAVITY)),
        ("-5 V/mm", "displacement", -5000.0),
        ("0.5 V/deg", "displacement", 0.5 * 180.0 / np.pi),
    ],
)
def test_volts_per_unit(text: str, quantity: str, volts: float) -> None:
    (found,) = sensitivities_of(text)
    assert (found.quantity, found.channel) == (quantity, None)
    assert found.volts == pytest.approx(volts, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    ["", "mV/g", "10.2", "10.2 mV", "10.2 g", "10.2 mV/V", "10.2 pC/g", "10.2 mV/parsec", "0 mV/g", "1e999 V/g", "x"],
)
def test_nonsense_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(InputError, match=r"^`sensitivity` must [^\n]*\.$"):
        sensitivities_of(text)


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("time [s],acc [V]", 1.0),
        ("time [s],acc [mV]", 1e-3),
        ("time [s],acc_mV", 1e-3),
        ("time [s],acc", 1.0),
        ("time [s],channel 1 [V]", 1.0),
        ("time [s],channel 1", 1.0),
    ],
)
def test_volts_become_motion(tmp_path: Path, header: str, factor: float) -> None:
    record = one(write(tmp_path / "a.csv", header, rows()), sensitivity="10.2 mV/g")
    assert (record.quantity, record.unit) == ("acceleration", "m/s^2")
    np.testing.assert_allclose(record.values, VALUES * factor / 10.2e-3 * GRAVITY, rtol=1e-8)  # nine digits are printed
    assert any("at 10.2 mV/g" in note for note in record.notes)


def test_unit_says_what_the_header_does_not(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "time [s],channel 1", rows())
    record = one(path, sensitivity="2 V/mm", unit="mV")
    np.testing.assert_allclose(record.values, VALUES * 1e-3 / 2e3, rtol=1e-8)
    assert record.quantity == "displacement"


def test_each_channel_has_its_own(tmp_path: Path) -> None:
    lines = [f"{t:.6f},{x:.9g},{3.0 * x:.9g}" for t, x in zip(TIME, VALUES, strict=True)]
    path = write(tmp_path / "a.csv", "time [s],acc_x [V],acc_y [V]", lines)
    chosen = {"columns": ["acc*"], "sensitivity": ["acc_x=10 mV/g", "acc_y=30 mV/g"]}
    first, second = read_records(path, **chosen)  # type: ignore[arg-type]
    np.testing.assert_allclose(first.values, second.values, rtol=1e-7)
    refuses(path, "acc_q", columns=["acc*"], sensitivity="acc_q=10 mV/g")


def test_hammer_in_volts_shows_contact_and_its_size(tmp_path: Path) -> None:
    time = np.arange(400) / 1000.0
    force = np.where((time >= 0.02) & (time < 0.023), 2.25, 0.0)
    motion = np.where(time < 0.023, 0.0, np.exp(-5.0 * time) * np.sin(200.0 * (time - 0.023)))
    lines = [f"{t:.6f},{f:.9g},{x:.9g}" for t, f, x in zip(time, force, motion, strict=True)]
    path = write(tmp_path / "hit.csv", "time [s],hammer [V],acc [V]", lines)
    record = one(path, sensitivity=["10 mV/g", "2.25 mV/N"])
    assert record.starts_free and record.time[0] >= 0.023
    assert any("(1e+03 N)" in note for note in record.notes), record.notes


@pytest.mark.parametrize(
    ("header", "options", "words"),
    [
        ("time [s],acc [m/s^2]", {"sensitivity": "10 mV/g"}, "is in m/s^2, and `sensitivity` is for volts"),
        ("time [s],acc [V]", {"sensitivity": "10 mV/g", "unit": "g"}, "is in g, and `sensitivity` is for volts"),
        ("time [s],acc [V]", {}, "is a voltage (V); give `sensitivity`"),
        ("time [s],channel 1 [V]", {}, "`sensitivity`"),
        ("time [s],velocity [V]", {"sensitivity": "10 mV/g"}, "holds velocity, and a `sensitivity` of 10 mV/g"),
        ("time [s],acc [V]", {"sensitivity": "2 mV/N"}, "no channel of force for the `sensitivity` of 2 mV/N"),
        ("time [s],acc [V]", {"sensitivity": ["1 mV/g", "2 mV/g"]}, "gives both 1 mV/g and 2 mV/g"),
        ("time [s],acc [V]", {"sensitivity": "5 mV/g", "quantity": "displacement"}, "expected a column 'displacement'"),
    ],
)
def test_contradictions_are_refused(tmp_path: Path, header: str, options: dict[str, object], words: str) -> None:
    refuses(write(tmp_path / "a.csv", header, rows()), words, **options)
