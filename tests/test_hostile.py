"""Nothing is unpickled, evaluated or given to a shell; names from files reach no path and do not steer the terminal.

HTML is looked at in a browser, in test_browser.py.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from pymc_backbone import InputError, demo_folder, read_records
from pymc_backbone.cli.common import visible
from pymc_backbone.cli.main import main
from pymc_backbone.reporting.claimed_folder import prepare_output
from pymc_backbone.reporting.output_folder import RESULT, read_result, write_results

from . import format_files as files

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "pymc_backbone").rglob("*.py"))
MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml", "runpy", "code", "pty"}
CALLS = {"eval", "exec", "compile", "__import__"}
ATTRIBUTES = {"system", "popen", "literal_eval", "read_pickle", "loadmat", "getoutput", "extractall"}
# Where one of these stands all the same, and why it cannot be reached from a file.
ALLOWED = {
    ("simulation/switches.py", "exec"): "a switch over the package's own functions, by number",
    ("simulation/lane_cycles.py", "exec"): "the same switch, its loops over lanes inside",
    (
        "_common/interpreter.py",
        "subprocess",
    ): "this interpreter with a constant program; names of files go through a pipe",
    ("inference/store/lock.py", "subprocess"): "ps, with a list of words and the number of a process",
}


def forbidden(tree: ast.AST) -> set[str]:
    """Return what of the lists above a module uses."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + ([node.module] if isinstance(node, ast.ImportFrom) else [])
            tops = {str(name).partition(".")[0] for name in names}
            found |= tops & (MODULES | {"subprocess"})
        elif isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            attribute = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            owner = ast.unparse(node.func.value) if isinstance(node.func, ast.Attribute) else ""
            found |= {name} & CALLS
            found |= {attribute} & ATTRIBUTES
            for word in node.keywords:
                is_false = isinstance(word.value, ast.Constant) and word.value.value is False
                if word.arg in ("allow_pickle", "shell") and not is_false:
                    found.add(str(word.arg))
            if (
                attribute == "load"
                and owner in ("np", "numpy")
                and not any(w.arg == "allow_pickle" for w in node.keywords)
            ):
                found.add("np.load")
    return found


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT / "pymc_backbone").as_posix())
def test_nothing_is_unpickled_evaluated_or_given_to_a_shell(path):
    place = path.relative_to(ROOT / "pymc_backbone").as_posix()
    allowed = {what for name, what in ALLOWED if name == place}
    assert forbidden(ast.parse(path.read_text(encoding="utf-8"))) == allowed


@pytest.mark.parametrize(
    ("source", "word"),
    [
        ("import pickle", "pickle"),
        ("from subprocess import run", "subprocess"),
        ("eval('1')", "eval"),
        ("os.system(x)", "system"),
        ("np.load(p)", "np.load"),
        ("np.load(p, allow_pickle=True)", "allow_pickle"),
        ("subprocess.run(x, shell=True)", "shell"),
        ("scipy.io.loadmat(x)", "loadmat"),
    ],
)
def test_the_check_sees_them(source, word):
    assert word in forbidden(ast.parse(source))


NAMES = [
    "../../outside.csv",
    "a;$(touch pwned).csv",
    "`touch pwned`.csv",
    "%s%n{0}.csv",
    "\N{RIGHT-TO-LEFT OVERRIDE}vsc.csv",
]


@pytest.mark.parametrize("name", NAMES)
def test_names_of_specimens_are_no_paths(name, tmp_path, monkeypatch):
    """A column `specimen` may hold anything; files are written under the output folder, with names of this program."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    lines = (demo_folder() / "specimen_01.csv").read_text().splitlines()
    head = f"specimen,{lines[0]}"
    (tmp_path / "in" / "all.csv").write_text("\n".join([head, *(f'"{name}",{line}' for line in lines[1:])]))
    (record,) = read_records(tmp_path / "in" / "all.csv")
    assert record.specimen == name
    before = {path for path in tmp_path.rglob("*")}
    assert main(["extract", "in", "--out", "out", "--quiet"]) == 0
    made = {path for path in tmp_path.rglob("*")} - before
    assert made and all((tmp_path / "out") in (path, *path.parents) for path in made)
    assert all(re.fullmatch(r"[\w.]+", path.name) for path in made), made


def test_what_a_terminal_would_obey_is_shown(capsys, tmp_path):
    assert visible("a\x1b[31m\x07\u202e\udcff\nb") == "a\\x1b[31m\\x07\\u202e\\udcff\nb"
    assert main(["extract", str(tmp_path / "\x1b]0;title\x07.csv")]) == 2
    assert "\x1b" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "content", ["[" * 100_000, '{"program": "pymc-backbone", "files": [["x"], {"y": 1}, null, 3]}']
)
def test_a_result_of_other_origin_is_refused_or_read(content, tmp_path):
    (tmp_path / RESULT).write_text(content)
    write_results(prepare_output(tmp_path, overwrite=True), {"command": "extract"})
    assert read_result(tmp_path)["files"] == [RESULT]


def test_a_result_cannot_name_files_elsewhere(tmp_path):
    """What an earlier run lists is removed only where this program could have written it."""
    (tmp_path / "mine.txt").write_text("x")
    (tmp_path / "out").mkdir()
    listed = ["../mine.txt", str(tmp_path / "mine.txt"), "figures/../../mine.txt"]
    (tmp_path / "out" / RESULT).write_text(f'{{"program": "pymc-backbone", "files": {listed!r}}}'.replace("'", '"'))
    write_results(prepare_output(tmp_path / "out", overwrite=True), {"command": "extract"})
    assert (tmp_path / "mine.txt").exists()


def test_objects_of_matlab_and_python_are_refused(tmp_path):
    """The rows of docs/formats.md on objects; more of each in test_formats.py."""
    np.savez(tmp_path / "a.npz", acc=np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="never loaded"):
        read_records(tmp_path / "a.npz")
    assert len(read_records(files.WRITERS["struct.mat"](tmp_path / "b.mat"))) == 1


def test_the_table_of_inputs_is_tested_row_by_row():
    """Every row of the table in docs/formats.md says by which tests it holds, here; a new row needs a new entry."""
    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8").split("\n## ")[0]
    rows = re.findall(r"^\| (.+?) \| .+ \|$", text, flags=re.MULTILINE)
    rows = [row for row in rows if row not in ("input", "---")]
    unknown = [row for row in rows if not any(row.startswith(known) for known in ROWS)]
    assert unknown == [] and len(rows) == len(ROWS), "rows of docs/formats.md without an entry in ROWS, or the reverse"
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("test_*.py"))
    for names in ROWS.values():
        for name in names.split():
            assert f"def {name}(" in tests, name


ROWS = {
    "`.csv .tsv": "test_other_separators_are_noted test_line_ends_encodings_comments_and_blank_lines",
    "lines of a logger": "test_what_a_logger_writes_above_the_table_is_skipped test_text_exported_from_tdms",
    "a line of names": "test_settings_above_a_column_without_a_header",
    "a line of units": "test_trailing_separators_quotes_and_a_line_of_units",
    "`0,5` in": "test_decimal_commas test_decimal_comma_that_first_appears_late",
    "`1.234,5` or": "test_decimal_mark_is_decided_by_the_whole_file test_numbers_survive_every_dialect",
    "`1,234`": "test_an_open_decimal_mark_is_refused test_an_open_decimal_mark_in_a_file_is_named",
    "a column `specimen`": "test_long_file_with_a_specimen_column_in_any_order",
    "`.lvm`": "test_variants_of_labview_files test_segments_that_do_not_continue_are_apart",
    "`Volts`": "test_each_format_gives_the_same_decay",
    "`.mat` of version 5": "test_layouts_of_mat_files test_structs_cells_and_objects_of_version_73",
    "a cell of vectors": (
        "test_a_cell_holds_records_of_unequal_length test_the_columns_of_a_matrix_are_no_records_of_their_own"
    ),
    "a cell or a text such as": "test_a_list_of_units_in_a_struct",
    "units in a `.mat`": "test_layouts_of_mat_files test_each_format_gives_the_same_decay",
    "MATLAB objects": "test_objects_are_never_read test_structs_cells_and_objects_of_version_73",
    "`.mat` of version 4": "test_other_mat_files_are_named",
    "`.uff .unv": "test_universal_files test_units_of_universal_files test_what_universal_files_hold_besides",
    "`.nc`, NetCDF": "test_channels_of_netcdf test_each_format_gives_the_same_decay",
    "`.nc` of this": "test_backbones_that_are_written_read_back",
    "`.npz .npy`": "test_pickles_are_refused test_an_npy_header_that_lies",
    "`.json` and": "test_sep005_dictionaries_are_as_its_own_check_wants_them test_sep005_dictionaries_that_are_not",
    "`.tdms .xlsx`": "test_beginnings_of_files_are_refused",
    "several channels": "test_several_quantities_need_a_choice test_several_columns_are_several_records",
    "a column named envelope": "test_volts_decibels_and_powers_are_the_same test_a_waveform_called_amplitude_is_one",
    "no quantity": "test_quantity_follows_from_the_unit_and_conversion_is_exact",
    "no unit": "test_headers_name_quantity_and_unit",
    "times that repeat": "test_a_bad_line_is_named test_times_that_are_none",
    "a line that stands there twice": "test_lines_written_twice_are_dropped_and_said",
    "samples missing with a gap": "test_gaps_and_jitter_of_the_times_are_counted_and_placed",
    "an end in one value": (
        "test_a_sensor_that_sticks_while_the_motion_goes_on_is_cut_and_told "
        "test_friction_that_stops_a_motion_is_no_sensor_that_sticks"
    ),
    "a value held for": "test_held_values_leave_less_than_the_noise_behind",
    "samples lost or written twice": "test_lost_samples_are_noticed_said_and_put_in test_a_doubled_sample_is_taken_out",
    "peaks clipped": "test_clipping test_clipping_that_leaves_few_cycles_is_refused",
    "samples or frames that repeat": "test_repeated_frames_are_left_out",
    "NaN, empty": "test_a_bad_line_is_named test_arrays_that_are_no_record",
    "a header that promises": (
        "test_sizes_that_lie_allocate_nothing test_arrays_larger_than_their_file_are_not_allocated"
    ),
    "a damaged file of HDF5": "test_a_file_on_which_the_library_hangs_is_refused",
    "a file of a folder that cannot": "test_a_file_that_cannot_be_read_is_left_out_by_name",
    "a folder with files": "test_folders_hold_files_of_one_kind",
    "names with markup": (
        "test_names_of_files_and_columns_are_text_in_the_report test_what_a_terminal_would_obey_is_shown"
    ),
    "files above 2 GB": "test_files_that_are_too_large_are_refused",
}
"""Rows of the table by how they begin, and the tests that hold them."""


def test_files_that_are_too_large_are_refused(tmp_path):
    """A file of 3 GB that holds nothing takes no room on the disk."""
    for name in ("a.csv", "a.mat", "a.npy"):
        with (tmp_path / name).open("wb") as stream:
            stream.write(
                {
                    "a.csv": b"time,x\n",
                    "a.mat": b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM",
                    "a.npy": b"\x93NUMPY",
                }[name]
            )
            stream.truncate(3_000_000_000)
        with pytest.raises(InputError, match=r"GB|MB|large"):
            read_records(tmp_path / name)
