"""Reading and writing of measured records and directly measured backbones."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pymc_backbone._common.checks import InputError
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.records import read_backbones, read_records
from pymc_backbone.measurement.reading.units import parse_unit, split_header
from pymc_backbone.measurement.reading.writing import write_records

TIME = np.arange(60) / 100.0
VALUES = np.exp(-TIME) * np.cos(30.0 * TIME)


def rows(separator: str = ",", time: np.ndarray = TIME, values: np.ndarray = VALUES) -> list[str]:
    return [f"{t:.6f}{separator}{x:.9g}" for t, x in zip(time, values, strict=True)]


def write(path: Path, header: str, lines: list[str], end: str = "\n", encoding: str = "utf-8") -> Path:
    path.write_bytes(end.join([header, *lines, ""]).encode(encoding))
    return path


def one(path: Path, **options: object) -> Record:
    records = read_records(path, **options)  # type: ignore[arg-type]
    assert len(records) == 1
    return records[0]


def refuses(path: Path, *words: str, **options: object) -> str:
    """Check that reading raises one sentence holding the words, and return it."""
    with pytest.raises(InputError) as caught:
        read_records(path, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert message.isprintable() and message.endswith((".", "?")) and len(message) < 500
    return message


# ---- what is read -----------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_plain_csv_is_read_unchanged(tmp_path: Path, quantity: str) -> None:
    record = one(write(tmp_path / "beam 7.csv", f"time,{quantity}", rows()))
    assert (record.specimen, record.quantity, record.source) == ("beam 7", quantity, "beam 7.csv")
    np.testing.assert_array_equal(record.time, [float(row.split(",")[0]) for row in rows()])
    np.testing.assert_array_equal(record.values, [float(row.split(",")[1]) for row in rows()])
    assert len(record.notes) == 1 and "assumed" in record.notes[0]


def test_arrays_of_a_record_cannot_be_changed(tmp_path: Path) -> None:
    record = one(write(tmp_path / "a.csv", "time,displacement [m]", rows()))
    assert record.notes == ()
    with pytest.raises(ValueError, match="read-only"):
        record.values[0] = 1.0


@pytest.mark.parametrize(
    ("header", "quantity", "unit", "time_factor", "factor"),
    [
        ("Time [ms],Displacement [mm]", "displacement", "m", 1e-3, 1e-3),
        ("TIME (s),Acc (g)", "acceleration", "m/s^2", 1.0, 9.80665),
        ("t,angle [deg]", "displacement", "rad", 1.0, math.pi / 180.0),
        ("time,roll angle [°]", "displacement", "rad", 1.0, math.pi / 180.0),
        ("time_ms,acc_g", "acceleration", "m/s^2", 1e-3, 9.80665),
        ("time (µs),velocity (mm/s)", "velocity", "m/s", 1e-6, 1e-3),
        ("time / s,acceleration / m/s²", "acceleration", "m/s^2", 1.0, 1.0),
        ("time,Channel 1 (m/s^2)", "acceleration", "m/s^2", 1.0, 1.0),
        ("time,angular velocity [rad/s]", "velocity", "rad/s", 1.0, 1.0),
        ("time,tip disp. [um]", "displacement", "m", 1.0, 1e-6),
        ("time,angle", "displacement", "rad", 1.0, 1.0),
    ],
)
def test_headers_name_quantity_and_unit(
    tmp_path: Path, header: str, quantity: str, unit: str, time_factor: float, factor: float
) -> None:
    record = one(write(tmp_path / "a.csv", header, rows()))
    assert (record.quantity, record.unit) == (quantity, unit)
    np.testing.assert_allclose(record.time, TIME * time_factor, rtol=1e-12)
    np.testing.assert_allclose(record.values, VALUES * factor, rtol=1e-8)  # nine digits are printed
    converted = [note for note in record.notes if "converted" in note]
    assert len(converted) == (time_factor != 1.0) + (factor != 1.0)


@pytest.mark.parametrize(
    ("text", "dimension", "factor"),
    [
        ("m s^-2", "acceleration", 1.0),
        ("m·s⁻²", "acceleration", 1.0),
        ("m/(s^2)", "acceleration", 1.0),
        ("m/s/s", "acceleration", 1.0),
        ("in/sec2", "acceleration", 0.0254),
        ("MM", "displacement", 1e-3),
        ("degrees", "displacement", math.pi / 180.0),
        ("seconds", "time", 1.0),
        ("msec", "time", 1e-3),
        ("khz", "frequency", 1e3),
        ("m/s", "acceleration", None),
        ("V", "velocity", None),
    ],
)
def test_unit_spellings(text: str, dimension: str, factor: float | None) -> None:
    unit = parse_unit(text, dimension)
    assert (unit.factor if unit else None) == factor


def test_header_without_unit_is_left_alone() -> None:
    assert split_header("frequency_standard_error") == ("frequency_standard_error", None)
    assert split_header("x [") == ("x [", None)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_line_ends_encodings_comments_and_blank_lines(tmp_path: Path, end: str, encoding: str) -> None:
    lines = ["# laser, range ± 2 mm", "", *rows(), "  ", "# end"]
    record = one(write(tmp_path / "a.csv", f"# µm{end}{end}time,displacement [µm]", lines, end, encoding))
    np.testing.assert_allclose(record.values, VALUES * 1e-6, rtol=1e-8)
    assert any("read as" in note for note in record.notes) == (encoding in ("utf-16", "cp1252"))


@pytest.mark.parametrize(
    ("separator", "word"), [(";", "semicolons"), ("\t", "tabs"), (" ", "spaces"), ("  ", "spaces")]
)
def test_other_separators_are_noted(tmp_path: Path, separator: str, word: str) -> None:
    record = one(write(tmp_path / "a.csv", f"time{separator}velocity", rows(separator)))
    np.testing.assert_allclose(record.values, VALUES, rtol=1e-8)
    assert f"values are separated by {word}" in record.notes


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas(tmp_path: Path, separator: str) -> None:
    text = [row.replace(".", ",") for row in rows(separator)]
    record = one(write(tmp_path / "a.csv", f"time{separator}velocity [m/s]", text))
    np.testing.assert_allclose(record.values, VALUES, rtol=1e-8)
    assert "commas in numbers were read as decimal commas" in record.notes


def test_decimal_comma_that_first_appears_late(tmp_path: Path) -> None:
    values = np.zeros(60)
    values[58] = 0.5
    text = [f"{i};{x:g}".replace(".", ",") for i, x in enumerate(values)]
    np.testing.assert_array_equal(one(write(tmp_path / "a.csv", "time;velocity [m/s]", text)).values, values)


def test_trailing_separators_quotes_and_a_line_of_units(tmp_path: Path) -> None:
    trailing = one(write(tmp_path / "a.csv", "time,velocity [m/s],", [row + "," for row in rows()]))
    headless = one(write(tmp_path / "b.csv", "time,velocity [m/s]", [row + "," for row in rows()]))
    quoted = one(
        write(
            tmp_path / "c.csv",
            '"time","velocity [m/s]"',
            [f'"{r.replace(",", chr(34) + "," + chr(34))}"' for r in rows()],
        )
    )
    units = one(write(tmp_path / "d.csv", "time,velocity", ["ms,mm/s", *rows()]))
    for record in (trailing, headless, quoted):
        np.testing.assert_allclose(record.values, VALUES, rtol=1e-8)
    np.testing.assert_allclose(units.values, VALUES * 1e-3, rtol=1e-8)
    assert any("dropped" in note for note in trailing.notes)
    assert any("read as units" in note for note in units.notes)


def test_folder_is_sorted_naturally_and_skips_what_is_hidden(tmp_path: Path) -> None:
    for name in ("run_10.csv", "run_2.csv", "Run_1.CSV", "._run_3.csv", "notes.txt"):
        write(tmp_path / name, "time,displacement", rows())
    assert [record.specimen for record in read_records(tmp_path)] == ["Run_1", "run_2", "run_10"]


def test_long_file_with_a_specimen_column_in_any_order(tmp_path: Path) -> None:
    lines = [f"{row},{name}" for row in rows() for name in ("b 10", "b 9", "../x;é")]
    records = read_records(write(tmp_path / "all.csv", "time,velocity,Specimen", lines))
    assert [record.specimen for record in records] == ["../x;é", "b 9", "b 10"]
    assert "b 9" in records[1].source and "all.csv" in records[1].source
    for record in records:
        np.testing.assert_allclose(record.values, VALUES, rtol=1e-8)


def test_several_quantities_need_a_choice(tmp_path: Path) -> None:
    lines = [f"{row},{2.0 * x:.9g}" for row, x in zip(rows(), VALUES, strict=True)]
    path = write(tmp_path / "a.csv", "time,displacement,velocity", lines)
    refuses(path, "line 1", "'displacement'", "'velocity'", "`quantity`")
    np.testing.assert_allclose(one(path, quantity="velocity").values, 2.0 * VALUES, rtol=1e-8)
    refuses(path, "'acceleration'", "found 'time', 'displacement', 'velocity'", quantity="acceleration")
    with pytest.raises(InputError, match="Did you mean 'velocity'"):
        read_records(path, quantity="velocty")
    axes = write(tmp_path / "b.csv", "time,acc x [g],acc y [g]", lines)
    refuses(axes, "'acc x [g]', 'acc y [g]'", "`columns`")
    np.testing.assert_allclose(one(axes, columns="ACC Y").values, 2.0 * VALUES * 9.80665, rtol=1e-8)
    refuses(axes, "'acc z'", columns="acc z")


def test_column_unit_and_sampling_rate_can_be_given(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "n,signal", rows())
    refuses(path, "what column 'signal' holds is not known", "`quantity`", columns="signal")
    record = one(path, columns="signal", unit="deg", sampling_rate=50.0)
    assert (record.quantity, record.unit) == ("displacement", "rad")
    np.testing.assert_allclose(record.time, np.arange(60) / 50.0)
    refuses(path, "`unit`", "Did you mean 'mm/s'", columns="signal", quantity="velocity", unit="mms/s")
    with pytest.raises(InputError, match="sampling_rate"):
        read_records(path, sampling_rate=-1.0)


def test_hundred_thousand_lines_are_read(tmp_path: Path) -> None:
    n = 100_000
    path = write(tmp_path / "a.csv", "time,displacement", rows(time=np.arange(n) / 1e3, values=np.cos(np.arange(n))))
    record = one(path)
    np.testing.assert_allclose(record.values, np.cos(np.arange(n)), rtol=1e-6)


# ---- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("0.1,abc", ("line 12", "column 'displacement'", "expected a number", "'abc'")),
        ("x,1.0", ("line 12", "column 'time'", "expected a number")),
        ("0.1,", ("line 12", "column 'displacement'", "empty")),
        ("0.1,nan", ("line 12", "finite", "nan")),
        ("0.1,-inf", ("line 12", "finite", "inf")),
        ("0.1,1e999", ("line 12", "finite")),
        ("0.1", ("line 12", "expected 2", "got 1")),
        ("0.1,1,2", ("line 12", "expected 2", "got 3")),
        ("0.09,1", ("line 12", "column 'time'", "twice")),
        ("0.05,1", ("line 12", "0.05 after 0.09", "specimen")),
        ('0.1,"1', ("line 12", "quotation mark")),
        ("0.1," + "1" * 200_000, ("line 12", "field")),
        ("0.1,1,000.5", ("line 12", "expected 2")),
        ("0.1,\ud7ff\u202e\u0007", ("binary",)),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: str, words: tuple[str, ...]) -> None:
    time = np.concatenate([np.arange(10) / 100.0, 0.2 + np.arange(50) / 100.0])
    lines = [f"{t:.2f},{x:.6f}" for t, x in zip(time, np.cos(time), strict=True)]
    refuses(write(tmp_path / "rec.csv", "time,displacement", [*lines[:10], line, *lines[10:]]), "rec.csv", *words)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("time,foo", ("line 1", "'displacement', 'velocity', 'acceleration' or 'envelope'", "found 'time', 'foo'")),
        ("foo,displacement", ("line 1", "'time'", "found 'foo', 'displacement'")),
        ("time,displacement,time [s]", ("line 2", "expected 3")),
        ("0.0,1.0", ("line 1", "header line", "numbers")),
        ("time,displacement [V]", ("'displacement [V]'", "is a voltage", "`sensitivity`")),
        ("time [furlong],displacement", ("'furlong'", "known unit of time")),
        ("time,velocity [mm]", ("'mm'", "Did you mean 'mm/s'")),
        ("time", ("line 2", "expected 1")),
    ],
)
def test_a_bad_header_is_named(tmp_path: Path, header: str, words: tuple[str, ...]) -> None:
    refuses(write(tmp_path / "rec.csv", header, rows()), "rec.csv", *words)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "empty"),
        (b" \r\n\t\n", "empty"),
        (b"# only a comment\n", "no data"),
        (b"time,displacement\n", "no lines below the header"),
        (b"time,displacement\n0,1\n1,2\n", "at least 32 samples, got 2"),
        (b"\x00\x01\x02PK\x03\x04" * 50, "binary"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "text"),
        (b"\x81\x8d\x8f" * 40, "UTF-8"),
        (b"\xff\xfea", "text"),
    ],
)
def test_unusable_files(tmp_path: Path, content: bytes, word: str) -> None:
    (tmp_path / "rec.csv").write_bytes(content)
    refuses(tmp_path / "rec.csv", "rec.csv", word)


def test_unusable_paths(tmp_path: Path) -> None:
    refuses(tmp_path / "none", "no such file")
    refuses(tmp_path, "no .csv file", "one CSV file per specimen")
    (tmp_path / "steel").mkdir()
    write(tmp_path / "steel" / "a.csv", "time,displacement", rows())
    refuses(tmp_path, "subfolders steel", "give one of them")
    (tmp_path / "b.csv").mkdir()
    refuses(tmp_path, "no .csv file")
    for bad in (3, None, b"\x00", "a\x00b"):
        with pytest.raises(InputError):
            read_records(bad)  # type: ignore[arg-type]


def test_a_file_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.csv", "time,displacement", rows())

    def denied(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "read_bytes", denied)  # root, who runs many CI jobs, may read everything
    refuses(path, "a.csv", "cannot be read (Permission denied)")


def test_the_same_specimen_twice(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", "time,displacement", rows())
    write(tmp_path / "b.csv", "time,displacement,specimen", [row + ",a" for row in rows()])
    refuses(tmp_path, "specimen 'a'", "a.csv", "b.csv")


def test_stamps_printed_too_coarsely_point_to_the_sampling_rate(tmp_path: Path) -> None:
    time = np.arange(200) / 5120.0
    path = write(tmp_path / "a.csv", "time,velocity", [f"{t:.3f},{np.cos(900 * t):.6f}" for t in time])
    refuses(path, "line 3", "`sampling_rate`")
    assert one(path, sampling_rate=5120.0).time[-1] == pytest.approx(199 / 5120.0)


def test_record_checks_its_arguments() -> None:
    with pytest.raises(InputError, match=r"values\[3\] = nan"):
        Record("a", TIME, np.where(np.arange(60) == 3, np.nan, VALUES))
    with pytest.raises(InputError, match="as long as"):
        Record("a", TIME, VALUES[:-1])
    with pytest.raises(InputError, match="must increase"):
        Record("a", TIME[::-1], VALUES)
    with pytest.raises(InputError, match="at least 32"):
        Record("a", TIME[:20], VALUES[:20])
    with pytest.raises(InputError, match="`unit` must be one of m/s, rad/s"):
        Record("a", TIME, VALUES, "velocity", "m")
    with pytest.raises(InputError, match="one line of text"):
        Record("a\nb", TIME, VALUES)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(st.binary(max_size=300), st.text(max_size=300).map(lambda text: text.encode("utf-8", "surrogatepass")))
)
@example(b"time,displacement\n" + b"0,1\n" * 40)
@example(b'"\n' * 40)
@example(b";\n;;\n")
@example("time,displacement\n²,3\n".encode())
def test_no_bytes_end_in_anything_but_an_input_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "fuzz.csv"
    path.write_bytes(content)
    for read in (read_records, read_backbones):
        with pytest.raises(InputError):
            read(path)  # type: ignore[operator]


CELL = st.one_of(
    st.sampled_from(["0", "1", "0,5", "-", "nan", "", '"', " ", "1e5", "#", "a", "1_0"]), st.text(max_size=5)
)
HEADER = st.sampled_from(
    ["time", "time [ms]", "displacement", "acc [g]", "specimen", "amplitude", "frequency", "damping", "x"]
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data(), st.sampled_from([",", ";", "\t", " "]), st.integers(1, 4))
def test_no_table_ends_in_anything_but_records_or_an_input_error(
    tmp_path: Path, data: st.DataObject, separator: str, width: int
) -> None:
    header = separator.join(data.draw(HEADER) for _ in range(width))
    good = [separator.join(f"{i + 0.5 * j}" for j in range(width)) for i in range(36)]
    row = st.lists(CELL, min_size=width, max_size=width).map(separator.join)
    lines = good[:20] + data.draw(st.lists(row, max_size=2)) + good[20:]
    path = tmp_path / "fuzz.csv"
    path.write_bytes("\n".join([header, *lines]).encode("utf-8", "surrogatepass"))
    for read in (read_records, read_backbones):
        try:
            read(path)  # type: ignore[operator]
        except InputError as error:
            assert str(error).isprintable()


# ---- writing ----------------------------------------------------------------------------------


def test_what_is_written_reads_back_unchanged(tmp_path: Path, rng: np.random.Generator) -> None:
    names = ["run_2", "run_10", "../../etc/passwd", "a/b", "a b", 'say "hi", é', "CON", "a;b", "日本"]
    records = [
        Record(
            name,
            np.cumsum(rng.uniform(0.5, 1.5, 50)),
            rng.normal(size=50) * 10.0 ** rng.integers(-9, 9),
            "velocity",
            "rad/s",
        )
        for name in names
    ]
    files = write_records(records, tmp_path / "out")
    assert all(file.parent == tmp_path / "out" and re.fullmatch(r"[\w.-]+\.csv", file.name, re.ASCII) for file in files)
    again = {record.specimen: record for record in read_records(tmp_path / "out")}
    assert sorted(again) == sorted(names)
    for record in records:
        other = again[record.specimen]
        np.testing.assert_array_equal(other.time, record.time)
        np.testing.assert_array_equal(other.values, record.values)
        assert (other.quantity, other.unit) == ("velocity", "rad/s")


def test_writing_refuses_to_overwrite_or_to_mix(tmp_path: Path) -> None:
    record = Record("a", TIME, VALUES)
    write_records([record], tmp_path)
    with pytest.raises(InputError, match=r"already holds a\.csv"):
        write_records([record], tmp_path)
    write_records([Record("a", TIME, 2.0 * VALUES)], tmp_path, overwrite=True)
    np.testing.assert_array_equal(one(tmp_path).values, 2.0 * VALUES)
    with pytest.raises(InputError, match="other CSV files"):
        write_records([Record("b", TIME, VALUES)], tmp_path, overwrite=True)
    with pytest.raises(InputError, match="twice"):
        write_records([record, record], tmp_path / "new")
    assert not (tmp_path / "new").exists()
    with pytest.raises(InputError, match="cannot be written"):
        write_records([record], tmp_path / "a.csv")


# ---- directly measured backbones --------------------------------------------------------------

AMPLITUDE = np.geomspace(1e-4, 1e-3, 12)
FREQUENCY = 10.0 + 2e5 * AMPLITUDE**2
DAMPING = 0.02 + 10.0 * AMPLITUDE


def table(path: Path, header: str, *columns: np.ndarray) -> Path:
    return write(path, header, [",".join(f"{value:.12g}" for value in row) for row in zip(*columns, strict=True)])


def test_backbones_are_interpolated_to_common_levels(tmp_path: Path) -> None:
    error = np.full(12, 1e-3)
    header = "amplitude [m],frequency,damping,frequency_error,damping_se"
    table(tmp_path / "s1.csv", header, AMPLITUDE, FREQUENCY, DAMPING, error, error)
    table(tmp_path / "s2.csv", header, 2 * AMPLITUDE, FREQUENCY + 1, DAMPING, error, error)
    data = read_backbones(tmp_path)
    assert data["value"].dims == data["standard_error"].dims == ("specimen", "observable", "level")
    assert data["covariance"].dims == ("specimen", "observable", "level", "level_other")
    assert list(data["specimen"].values) == ["s1", "s2"]
    assert list(data["observable"].values) == ["frequency", "damping"]
    levels = data["level"].values
    assert levels.size == 8 and levels[0] == pytest.approx(2e-4) and levels[-1] == pytest.approx(1e-3)
    assert data.attrs["amplitude_unit"] == "m" and data.attrs["notes"] == []
    value = data["value"].sel(specimen="s1")
    # interpolation of 12 points: third order in their spacing of 23 %
    np.testing.assert_allclose(value.sel(observable="frequency"), 10.0 + 2e5 * levels**2, rtol=3e-4)
    np.testing.assert_allclose(value.sel(observable="damping"), 0.02 + 10.0 * levels, rtol=3e-3)
    covariance = data["covariance"].sel(specimen="s2", observable="frequency").values
    np.testing.assert_allclose(
        np.sqrt(np.diag(covariance)), data["standard_error"].sel(specimen="s2", observable="frequency")
    )
    assert np.linalg.eigvalsh(covariance).min() > -1e-18
    assert (np.sqrt(np.diag(covariance)) <= 1e-3 * (1 + 1e-12)).all()
    assert (np.sqrt(np.diag(covariance)) >= 1e-3 / np.sqrt(2.0) * (1 - 1e-12)).all()


def test_errors_are_propagated_as_monte_carlo_says(tmp_path: Path, rng: np.random.Generator) -> None:
    error = np.full(12, 0.01)
    levels = np.array([1.3e-4, 1.35e-4, 6e-4])
    draws = []
    for _ in range(300):
        noisy = FREQUENCY + error * rng.normal(size=12)
        path = table(tmp_path / "s.csv", "amplitude [m],frequency,frequency_sd", AMPLITUDE, noisy, error)
        data = read_backbones(path, levels=levels)
        draws.append(data["value"].values[0, 0])
    stated = data["covariance"].values[0, 0]
    found = np.cov(np.array(draws), rowvar=False)
    # 300 draws determine a variance to 8 %; PCHIP's weights differ from linear ones by up to some 20 % of the variance
    np.testing.assert_allclose(np.diag(found), np.diag(stated), rtol=0.35)
    assert found[0, 1] / np.sqrt(found[0, 0] * found[1, 1]) > 0.8
    assert abs(stated[0, 2]) < 1e-12


def test_damping_ratio_units_order_and_repeats(tmp_path: Path) -> None:
    zeta = np.array([2.0, 1.0, 3.0, 1.0])
    path = table(
        tmp_path / "s.csv",
        "Amplitude (mm),Frequency (kHz),damping ratio [%],damping_ratio_error [%],frequency_error",
        np.array([2.0, 1.0, 3.0, 1.0]),
        np.array([0.02, 0.01, 0.03, 0.0102]),
        zeta,
        np.full(4, 0.1),
        np.full(4, 1e-5),
    )
    data = read_backbones(path, levels=[1e-3, 3e-3])
    np.testing.assert_allclose(data["value"].sel(observable="frequency").values[0], [10.1, 30.0])
    expected = 2 * np.pi * np.array([0.01, 0.03]) / np.sqrt(1 - np.array([0.01, 0.03]) ** 2)
    np.testing.assert_allclose(data["value"].sel(observable="damping").values[0], expected)
    np.testing.assert_allclose(data["standard_error"].sel(observable="frequency").values[0], [1e-2 / np.sqrt(2), 1e-2])
    np.testing.assert_allclose(
        data["standard_error"].sel(observable="damping").values[0, 1], 2 * np.pi * 1e-3, rtol=2e-3
    )
    notes = " ".join(data.attrs["notes"])
    assert "logarithmic decrement" in notes and "1 point(s) of repeated amplitude were averaged" in notes


def test_missing_errors_come_from_the_scatter_or_stay_unknown(tmp_path: Path, rng: np.random.Generator) -> None:
    noise = 0.01
    amplitude = np.geomspace(1e-4, 1e-3, 60)
    frequency = 10.0 + np.log(amplitude) + noise * rng.normal(size=60)
    data = read_backbones(
        table(tmp_path / "s.csv", "amplitude [m],frequency", amplitude, frequency), levels=amplitude[::10]
    )
    assert data["standard_error"].values[0, 0] == pytest.approx(noise, rel=0.3)  # 57 degrees of freedom: 9 %
    assert any("estimated from the scatter of 60 points" in note for note in data.attrs["notes"])
    data = read_backbones(table(tmp_path / "s.csv", "amplitude [m],frequency", AMPLITUDE[:5], FREQUENCY[:5]))
    assert data.sizes["level"] == 5
    assert np.isfinite(data["value"].values).all() and np.isnan(data["standard_error"].values).all()
    assert any("NaN" in note and "frequency_error" in note for note in data.attrs["notes"])


def test_a_folded_backbone_is_noted(tmp_path: Path) -> None:
    amplitude = np.concatenate([AMPLITUDE, AMPLITUDE[::-1]])
    folded = np.concatenate([FREQUENCY, FREQUENCY[::-1] + 0.5])
    data = read_backbones(table(tmp_path / "s.csv", "amplitude [m],frequency", amplitude, folded))
    assert any("folded" in note and "0.5 Hz" in note for note in data.attrs["notes"])
    closed = np.concatenate([FREQUENCY, FREQUENCY[::-1]])
    data = read_backbones(table(tmp_path / "s.csv", "amplitude [m],frequency", amplitude, closed))
    assert not any("folded" in note for note in data.attrs["notes"])


def test_long_backbone_file_with_levels_out_of_reach(tmp_path: Path) -> None:
    lines = [
        f"{a:.9g},{f:.9g},0.01,{name}"
        for name, k in (("p2", 1), ("p10", 4))
        for a, f in zip(k * AMPLITUDE, FREQUENCY, strict=True)
    ]
    path = write(tmp_path / "all.csv", "amplitude [rad],frequency,frequency_error,specimen", lines)
    data = read_backbones(path, levels=[2e-4, 6e-4, 3e-3])
    assert list(data["specimen"].values) == ["p2", "p10"] and data.attrs["amplitude_unit"] == "rad"
    np.testing.assert_array_equal(np.isfinite(data["value"].values[:, 0]), [[True, True, False], [False, True, True]])
    np.testing.assert_array_equal(np.isnan(data["standard_error"].values), np.isnan(data["value"].values))
    assert sum("lie outside" in note for note in data.attrs["notes"]) == 2


@pytest.mark.parametrize(
    ("header", "line", "words"),
    [
        ("amplitude,foo", "1,2", ("'amplitude' and 'frequency'", "'foo'")),
        ("amplitude,frequency", "-1,2", ("line 14", "column 'amplitude'", "positive")),
        ("amplitude,frequency", "1,0", ("line 14", "column 'frequency'", "positive")),
        ("amplitude,frequency", "1,x", ("line 14", "'x'")),
        ("amplitude [kg],frequency", "1,2", ("'kg'", "unit")),
        ("amplitude,frequency,frequency_error,frequency_se", "1,2,3,4", ("one column of standard errors",)),
        ("amplitude,frequency,frequency_error", "1,2,-3", ("line 14", "negative")),
        ("amplitude,frequency,zeta", "1,2,1.5", ("line 14", "below 1")),
    ],
)
def test_bad_backbone_tables_are_named(tmp_path: Path, header: str, line: str, words: tuple[str, ...]) -> None:
    extra = ",0.01" * (header.count(",") - 1)
    lines = [f"{a:.9g},{f:.9g}{extra}" for a, f in zip(AMPLITUDE, FREQUENCY, strict=True)]
    with pytest.raises(InputError) as caught:
        read_backbones(write(tmp_path / "s.csv", header, [*lines, line]))
    for word in ("s.csv", *words):
        assert word in str(caught.value)


def test_two_time_columns_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "time,displacement,time [s]", [f"{row},0" for row in rows()])
    refuses(path, "line 1", "expected one column 'time'", "'time [s]'")


def test_backbones_that_cannot_be_compared(tmp_path: Path) -> None:
    table(tmp_path / "a.csv", "amplitude [mm],frequency", AMPLITUDE, FREQUENCY)
    table(tmp_path / "b.csv", "amplitude [m],frequency", AMPLITUDE, FREQUENCY)
    with pytest.raises(InputError, match=r"share no range of amplitudes: b\.csv begins .* a\.csv ends"):
        read_backbones(tmp_path)
    table(tmp_path / "a.csv", "amplitude [deg],frequency", AMPLITUDE, FREQUENCY)
    with pytest.raises(InputError, match="amplitude is in m but in rad"):
        read_backbones(tmp_path)
    table(tmp_path / "a.csv", "amplitude,frequency", AMPLITUDE[:1], FREQUENCY[:1])
    with pytest.raises(InputError, match="at least 2 points"):
        read_backbones(tmp_path)


# ---- real files -------------------------------------------------------------------------------


def test_real_records_are_read(shared_data: Path) -> None:
    beams = read_records(shared_data / "jointed_beam")
    assert len(beams) == 9 and {record.quantity for record in beams} == {"velocity"}
    assert beams[0].specimen == "position_1_repeat_1" and beams[0].time.size == 15719
    ships = read_records(shared_data / "ship_roll_kvlcc2", unit="rad")
    assert [record.time.size for record in ships] == [6660, 5400] and ships[0].unit == "rad"
    refuses(shared_data, "subfolders jointed_beam, ship_roll_kvlcc2")


LINES = 9000


def long_text(separator: str = ",", end: str = "\n", **changed: str) -> str:
    """Return a table that is long by `monkeypatch`, with some lines changed (``line_17="..."``)."""
    rows = [separator.join((f"{i / 512:.9f}", f"{np.cos(0.1 * i):.7e}")) for i in range(LINES)]
    names = ("time", "displacement") if separator == " " else ("time [s]", "displacement [mm]")
    lines = [separator.join(names), *rows]
    for name, text in changed.items():
        lines[int(name.removeprefix("line_")) - 1] = text
    return end.join(lines) + end


@pytest.fixture
def long_from(monkeypatch):
    """Make a table of some hundred lines a long one."""
    from pymc_backbone.measurement.reading import long_tables

    monkeypatch.setattr(long_tables, "LONG", 20_000)
    monkeypatch.setattr(long_tables, "_HEAD", 5_000)
    monkeypatch.setattr(long_tables, "_CHUNK", 7_000)
    return long_tables


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_long_table_is_read_as_numbers_and_holds_the_same(tmp_path, monkeypatch, long_from, separator, end):
    from pymc_backbone.measurement.reading.tables import read_table

    text = long_text(separator, end)
    (tmp_path / "a.csv").write_bytes(text.encode())
    long = read_table(tmp_path / "a.csv")
    assert isinstance(long.cells[0], long_from.NumberCells)
    monkeypatch.setattr(long_from, "LONG", len(text) + 1)
    short = read_table(tmp_path / "a.csv")
    assert not isinstance(short.cells[0], long_from.NumberCells)
    assert long.columns == short.columns and list(long.lines) == list(short.lines) and long.notes == short.notes
    for column in long.columns:
        np.testing.assert_array_equal(long.numbers(column), short.numbers(column))
        assert float(long.cells[column.index][4321]) == float(short.cells[column.index][4321])
    rows = np.arange(LINES)
    assert not long.repeats(rows).any() and not short.repeats(rows).any()


@pytest.mark.parametrize(
    ("line", "text", "words"),
    [
        (7000, "13.668,abc", "line 7000, column 'displacement [mm]': expected a number, got 'abc'"),
        (7000, "13.668,nan", "line 7000, column 'displacement [mm]': expected a finite number"),
        (7000, "13.6", "line 7000: expected 2 comma-separated values"),
        (7000, "1.0,0.5", "line 7000, column 'time [s]': time must increase, got 1.0 after 13.6"),
    ],
)
def test_faults_of_a_long_table_are_found_with_their_line(tmp_path, long_from, line, text, words):
    path = tmp_path / "a.csv"
    path.write_text(long_text(**{f"line_{line}": text}))
    with pytest.raises(InputError) as caught:
        read_records(path)
    assert words in str(caught.value)


def test_blank_lines_comments_and_repeated_lines_of_a_long_table(tmp_path, long_from):
    whole = one(write_text(tmp_path / "a.csv", long_text()))
    rows = long_text().splitlines()
    blank = one(write_text(tmp_path / "b.csv", "\n".join([*rows[:6000], "", "# a remark", *rows[6000:]]) + "\n\n"))
    twice = one(write_text(tmp_path / "c.csv", "\n".join([*rows[:6000], *rows[5999:]])))
    for record in (blank, twice):
        np.testing.assert_array_equal(record.values, whole.values)
    assert any("1 line repeats the one before (line 6001)" in note for note in twice.notes)


def write_text(path, text):
    path.write_text(text)
    return path
