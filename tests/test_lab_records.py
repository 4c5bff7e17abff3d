"""What laboratories bring: cells of records, lists of units, files that cannot be read, a floor, a busy folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from pymc_backbone._common.checks import FloatArray, InputError
from pymc_backbone.cli.many import read_structures
from pymc_backbone.cli.options import amplitude
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.extraction import LEFT_OUT
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.records import read_record_files, read_records
from pymc_backbone.measurement.reading.writing import write_records
from pymc_backbone.reporting.claimed_folder import claimed_output
from pymc_backbone.workflows.measure import measure

from .test_cli import is_one_sentence, run_cli

RATE, FREQUENCY, RATIO = 200.0, 5.0, 0.01
DECREMENT = 2.0 * np.pi * RATIO / np.sqrt(1.0 - RATIO**2)
LENGTHS = (1000, 1200, 1400)


def decay(rng: np.random.Generator, size: int = 1200) -> FloatArray:
    turns = np.arange(size) / RATE * FREQUENCY
    return 1e-3 * np.exp(-DECREMENT * turns) * np.cos(2.0 * np.pi * turns) + 2e-6 * rng.standard_normal(size)


def cell(items: list[object]) -> np.ndarray:
    array = np.empty((1, len(items)), dtype=object)
    array[0] = items
    return array


# ---- text files --------------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [", ", "; ", "\t"])
@pytest.mark.parametrize("count", [1200, 40_000])  # long files of numbers are read another way
def test_settings_above_a_column_without_a_header(separator: str, count: int, tmp_path: Path, rng) -> None:
    """Two lines of settings, then an angle a line: as loggers of microcontrollers write it."""
    values = decay(rng, count)
    head = [separator.join(("trigger_start_deg", "sample_rate", "duration_sec")), separator.join(("90", "200", "6"))]
    path = tmp_path / "swing.txt"
    path.write_text("\n".join([*head, *(f"{1e3 * x:.9g}" for x in values), ""]))
    (record,) = read_records(path, unit="mm")
    np.testing.assert_allclose(record.values, values, rtol=0.0, atol=1e-11)
    assert record.time[-1] == pytest.approx((values.size - 1) / RATE) and record.unit == "m"
    assert any("lines 1 and 2 were read as settings" in note for note in record.notes)
    with pytest.raises(InputError, match="line 2: expected a column 'displacement'"):
        read_records(path)  # nothing says what was measured
    # as many numbers in a line as above: a table, whose first line of numbers is one of data
    path.write_text("\n".join([separator.join(("time", "x [mm]")), *(f"{k / RATE}{separator}{1e3 * x:.9g}" for k, x in
                                                                      enumerate(values[:1200]))]))  # fmt: skip
    assert read_records(path)[0].values.size == 1200


# ---- MAT files ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["rate", "times", "matrices"])
def test_a_cell_holds_records_of_unequal_length(kind: str, tmp_path: Path, rng: np.random.Generator) -> None:
    values = [decay(rng, size) for size in LENGTHS]
    times = [np.arange(size) / RATE for size in LENGTHS]
    content: dict[str, object] = {"disp": cell(list(values))}
    if kind == "rate":
        content["fs"] = RATE
    elif kind == "times":
        content["t"] = cell(list(times))
    else:
        content = {"runs": cell([np.column_stack(pair) for pair in zip(times, values, strict=True)])}
    scipy.io.savemat(tmp_path / "lab.mat", content)
    found = read_records(tmp_path / "lab.mat", quantity="displacement")
    assert [record.time.size for record in found] == list(LENGTHS)
    for record, time, true in zip(found, times, values, strict=True):
        np.testing.assert_allclose(record.time, time, atol=1e-12)
        np.testing.assert_array_equal(record.values, true)


def test_the_columns_of_a_matrix_are_no_records_of_their_own(tmp_path: Path, rng: np.random.Generator) -> None:
    # negative control: x, y and z of one sensor stand in a matrix, and which is meant nobody knows
    scipy.io.savemat(tmp_path / "lab.mat", {"disp": np.column_stack([decay(rng) for _ in range(3)]), "fs": RATE})
    with pytest.raises(InputError, match="expected one measured quantity"):
        read_records(tmp_path / "lab.mat")


@pytest.mark.parametrize("units", [["ms", "mm", "g"], ["ms", "mm"], "ms, mm"])
def test_a_list_of_units_in_a_struct(units: object, tmp_path: Path, rng: np.random.Generator) -> None:
    values = decay(rng)
    listed = units if isinstance(units, str) else cell(list(units))  # type: ignore[call-overload]
    test = {"time": np.arange(values.size) / RATE * 1e3, "disp": values * 1e3, "units": listed}
    if len(units) == 3:  # type: ignore[arg-type]
        test["acc"] = values
    scipy.io.savemat(tmp_path / "lab.mat", {"test": test})
    (record,) = read_records(tmp_path / "lab.mat", columns="disp")
    np.testing.assert_allclose(record.time, np.arange(values.size) / RATE, rtol=1e-12)
    np.testing.assert_allclose(record.values, values, rtol=1e-12)


def test_lvm_channels_of_unequal_length(tmp_path: Path, rng: np.random.Generator) -> None:
    long, short = decay(rng, 1200), decay(rng, 900)
    rows = [f"{k / RATE:.6f}\t{x:.12g}\t{f'{short[k]:.12g}' if k < 900 else ''}" for k, x in enumerate(long)]
    head = ["LabVIEW Measurement", "Separator\tTab", "X_Columns\tOne", "***End_of_Header***", "", "Channels\t2"]
    head += ["Samples\t1200\t900", "***End_of_Header***", "X_Value\tdisp_a\tdisp_b\tComment"]
    (tmp_path / "a.lvm").write_text("\n".join([*head, *rows, ""]))
    for name, true in (("disp_a", long), ("disp_b", short)):
        (record,) = read_records(tmp_path / "a.lvm", columns=[name])
        np.testing.assert_allclose(record.values, true, rtol=1e-11)
    both = read_records(tmp_path / "a.lvm", columns=["disp*"])
    assert [record.values.size for record in both] == [1200, 900]


# ---- files among others that cannot be read ---------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    records = [Record(f"s{k}", np.arange(1200) / RATE, decay(rng)) for k in range(3)]
    write_records(records, tmp_path / "records")
    (tmp_path / "records" / "s9.csv").write_text("time,displacement\n0,oops\n")
    return tmp_path / "records"


def test_a_file_that_cannot_be_read_is_left_out_by_name(folder: Path) -> None:
    measured = measure(folder)
    assert [str(name) for name in measured.backbones["specimen"].values] == ["s0", "s1", "s2"]
    (note,) = [note for note in measured.notes if note.startswith(LEFT_OUT)]
    assert "s9.csv" in note
    with pytest.raises(InputError, match=r"^s9\.csv"):
        measure(folder, measuring=Measuring(strict=True))
    with pytest.raises(InputError, match=r"^s9\.csv"):
        read_records(folder)


def test_where_most_cannot_be_read_something_is_wrong_with_all(folder: Path) -> None:
    for k in (5, 6, 7):
        (folder / f"s{k}.csv").write_text("time,displacement\n0,oops\n")
    with pytest.raises(InputError, match="4 of 7 files cannot be used, more than half"):
        read_record_files(folder)
    with pytest.raises(InputError, match=r"expected a column.*`columns`"):  # the one reason, not a count
        read_record_files(folder, quantity="velocity")


def test_files_and_records_count_towards_one_limit(folder: Path, rng: np.random.Generator) -> None:
    noise = [Record(f"noise{k}", np.arange(1200) / RATE, 1e-3 * rng.standard_normal(1200)) for k in range(3)]
    write_records(noise, folder.parent / "noise")
    for file in (folder.parent / "noise").iterdir():
        file.rename(folder / file.name)
    with pytest.raises(InputError, match="4 of 7 records cannot be used, more than half"):
        measure(folder)


# ---- floor ------------------------------------------------------------------------------------------


def test_the_floor_ends_the_record_and_changes_nothing_above(rng: np.random.Generator) -> None:
    record = Record("s", np.arange(6000) / RATE, decay(rng, 6000))
    whole, cut = extract_cycles(condition(record)), extract_cycles(condition(record, floor=2e-4))
    assert whole.amplitude.min() < 1e-4
    assert 1.7e-4 < cut.amplitude.min() < 2.1e-4  # a cycle loses 6 %
    same = cut.time.size - 3
    np.testing.assert_allclose(cut.frequency[:same], whole.frequency[:same], rtol=1e-4)
    with pytest.raises(InputError, match=r"fewer than 4 cycles lie above the floor of 0\.1 m, .*`floor`\.$"):
        condition(record, floor=0.1)


@pytest.mark.parametrize(
    ("text", "value"), [("0.2 mm", 2e-4), ("2e-4", 2e-4), ("0.2mm", 2e-4), ("5 deg", 0.0872664626)]
)
def test_the_floor_has_a_unit(text: str, value: float) -> None:
    assert amplitude(text) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("text", ["0", "-1 mm", "0.2 g", "mm", "nan", "0.2 V"])
def test_a_floor_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(Exception, match="expected an amplitude such as"):
        amplitude(text)


def test_motion_of_no_structure_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(InputError, match="is no motion of a structure; check the units of time"):
        condition(Record("s", np.arange(1200) * 1e14, decay(rng), "acceleration"))
    condition(Record("s", np.arange(1200) * 10.0, decay(rng)))  # a bridge's tower sways in minutes


# ---- the table of structures ----------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_structures_with_semicolons_and_decimal_commas(encoding: str, tmp_path: Path) -> None:
    table = tmp_path / "masses.csv"
    text = "Name;mass;band;floor;columns;levels\nMöwe;1,25;90,5:160;0,2 mm;time=t,acc_z;0.001,0.002\n"
    table.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert read_structures(table, ["Möwe"]) == {
        "Möwe": {
            "mass": 1.25, "band": (90.5, 160.0), "floor": pytest.approx(2e-4), "columns": ["time=t", "acc_z"],
            "levels": (0.001, 0.002),
        }
    }  # fmt: skip


def test_a_comma_between_cells_is_no_decimal_comma(tmp_path: Path) -> None:
    table = tmp_path / "masses.csv"
    table.write_text("name,mass\nx,1,25\n")
    with pytest.raises(InputError, match="line 2: expected 2 cells"):
        read_structures(table, ["x"])
    table.write_text("name;mass\nx;1,25\nz;2\n")
    with pytest.raises(InputError, match=r"masses\.csv, line 3: name"):
        read_structures(table, ["x"])


# ---- the output folder ----------------------------------------------------------------------------------

HOLD = """
import sys
from pymc_backbone.reporting.claimed_folder import claimed_output
with claimed_output(sys.argv[1]):
    print("held", flush=True)
    sys.stdin.readline()
"""


def test_the_second_of_two_runs_into_one_new_folder_refuses(
    tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdin is not None and other.stdout is not None
    with other:
        assert other.stdout.readline() == "held\n"
        for overwrite in (False, True):
            with pytest.raises(InputError, match=rf"in use by process {other.pid} .*name another folder\.$"):
                with claimed_output(out, overwrite):
                    pass
        code, _, said = run_cli(capsys, "extract", str(folder), "--out", str(out))
        assert code == 2 and is_one_sentence(said) and "is in use by process" in said
        other.stdin.close()
    assert not out.exists()  # it wrote nothing
    with claimed_output(out) as ready:
        assert ready == out


def test_a_run_that_died_does_not_keep_its_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(out)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    with other:
        assert other.stdout.readline() == "held\n"
        other.kill()
    assert json.loads((out / "lock.json").read_text())["process"] == other.pid
    with claimed_output(out):
        pass
    assert os.listdir(out) == []


def test_surveys_and_cases_keep_other_runs_out_of_their_folder(tmp_path):
    from pymc_backbone.paper.run_cases import run_cases
    from pymc_backbone.reporting.claimed_folder import claimed_output
    from pymc_backbone.survey.files import begun_survey

    with begun_survey(tmp_path / "survey", False, False, 1) as folder:
        assert (folder / "summary.json").is_file()
        for again in (False, True):  # to resume is no reason either
            with (
                pytest.raises(InputError, match="in use by process"),
                begun_survey(folder, overwrite=not again, resume=again, seed=1),
            ):
                pass
        with pytest.raises(InputError, match="in use by process"):
            run_cases(["1"], ["product"], output=folder, overwrite=True, say=lambda _: None)
    with begun_survey(folder, overwrite=False, resume=True, seed=1):  # over: free again
        pass
    with claimed_output(tmp_path / "cases"), pytest.raises(InputError, match="in use by process"):
        run_cases(["1"], ["product"], output=tmp_path / "cases", overwrite=True, say=lambda _: None)
