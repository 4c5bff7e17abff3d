"""Every format of measured records, with files that other programs wrote, and what is refused of them."""

from __future__ import annotations

import json
import math
import struct
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pymc_backbone._common.checks import InputError
from pymc_backbone.measurement.reading.dialect import AmbiguousNumbersError, Dialect, decide
from pymc_backbone.measurement.reading.formats.mat5 import read_mat5
from pymc_backbone.measurement.reading.record import Record
from pymc_backbone.measurement.reading.records import read_records

from . import format_files as files
from .format_files import RATE, TIME, VALUES

G = 9.80665


def one(path: Any, **options: Any) -> Record:
    (record,) = read_records(path, **options)
    return record


def refuses(path: Any, *words: str, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        read_records(path, **options)
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert message.isprintable() and message.endswith((".", "?")) and len(message) < 600, message
    return message


def agrees(record: Record, quantity: str, factor: float, *, digits: float = 0.0) -> None:
    """Check samples and instants; ``digits`` is what the writer rounds to."""
    assert record.quantity == quantity
    np.testing.assert_allclose(record.values, VALUES * factor, rtol=1e-14, atol=digits * factor)
    np.testing.assert_allclose(record.time, TIME, rtol=1e-14, atol=1e-15)


# ---- one of each ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "quantity", "factor", "digits"),
    [
        ("a.csv", "acceleration", G, 0.0),
        ("a.mat", "acceleration", G, 0.0),
        ("struct.mat", "displacement", 1e-3, 0.0),
        ("v73.mat", "velocity", 1.0, 0.0),
        ("a.nc", "velocity", 1e-3, 0.0),
        ("classic.nc", "velocity", 1e-3, 0.0),
        ("a.npz", "displacement", 1e-3, 0.0),
        ("a.json", "acceleration", 1.0, 0.0),
        ("a.lvm", "acceleration", 1.0, 0.6e-6),
    ],
)
def test_each_format_gives_the_same_decay(
    tmp_path: Path, name: str, quantity: str, factor: float, digits: float
) -> None:
    record = one(files.WRITERS[name](tmp_path / name))
    agrees(record, quantity, factor, digits=digits)
    assert record.specimen == name.partition(".")[0] and record.source == name


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
def test_universal_files(tmp_path: Path, binary: int, even: int) -> None:
    record = one(files.uff58(tmp_path / "a.uff", binary=binary, even=even))
    assert record.quantity == "acceleration" and record.unit == "m/s^2"
    # text holds 12 digits; the header's increment has six, times of uneven sampling in text too
    np.testing.assert_allclose(record.values, VALUES, rtol=1e-11)
    expected = TIME if even else TIME + 1e-4 * np.sin(np.arange(TIME.size))
    np.testing.assert_allclose(record.time, expected, rtol=1e-14 if binary and not even else 5e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "unit", "direction", "code", "expected", "factor"),
    [
        (12, "g", 3, None, ("acceleration", "m/s^2"), G),
        (11, "NONE", 3, 5, ("velocity", "m/s"), 1e-3),
        (8, "NONE", 3, 7, ("displacement", "m"), 0.0254),
        (8, "NONE", -5, None, ("displacement", "rad"), 1.0),
        (0, "mm/s", 3, None, ("velocity", "m/s"), 1e-3),
    ],
)
def test_units_of_universal_files(
    tmp_path: Path, kind: int, unit: str, direction: int, code: int | None, expected: tuple[str, str], factor: float
) -> None:
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "a.uff"
    if code is not None:
        units = pyuff.prepare_164(
            units_code=code, units_description="", temp_mode=1, length=1.0, force=1.0, temp=1.0, temp_offset=0.0
        )
        pyuff.UFF(str(path)).write_sets([units], mode="add")
    record = one(files.uff58(path, kind=kind, unit=unit, rsp_dir=direction))
    assert (record.quantity, record.unit) == expected
    np.testing.assert_allclose(record.values, VALUES * factor, rtol=1e-11)


def test_what_universal_files_hold_besides(tmp_path: Path) -> None:
    path = files.uff58(tmp_path / "a.uff")
    files.uff58(path, kind=13, unit="N", id1="hammer")
    files.uff58(path, func_type=4, id1="response function")
    record = one(path)
    assert any("1 data sets 58 that are no time histories" in note for note in record.notes)
    files.uff58(path, id1="root Z")
    refuses(path, "'tip Z', 'root Z'", "`columns`")
    assert [item.specimen for item in read_records(path, columns=["root z", "tip*"])] == ["a root Z", "a tip Z"]
    refuses(files.uff58(tmp_path / "b.uff", func_type=4), "b.uff", "no time histories")


def test_the_same_number_of_samples_as_promised(tmp_path: Path) -> None:
    text = files.uff58(tmp_path / "a.uff").read_bytes()
    (tmp_path / "b.uff").write_bytes(text.replace(b"       400", b"       401"))
    refuses(tmp_path / "b.uff", "b.uff, data set 1", "promises 401 samples, found 400")
    (tmp_path / "c.uff").write_bytes(text[: len(text) // 2])
    refuses(tmp_path / "c.uff", "c.uff", "no complete data set")


def test_an_extra_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    path = files.uff58(tmp_path / "a.uff")
    monkeypatch.setitem(sys.modules, "pyuff", None)
    refuses(path, "a.uff", "pip install pymc-backbone[uff]")


# ---- MATLAB -----------------------------------------------------------------------------------


def save(path: Path, variables: dict[str, Any], **options: Any) -> Path:
    scipy.io.savemat(path, variables, **options)
    return path


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["<f8", "<f4", "<i4", "<i2"])
def test_numbers_of_mat_files_are_those_scipy_reads(tmp_path: Path, compressed: bool, kind: str) -> None:
    values = (1000 * np.cos(np.arange(120.0))).astype(kind)
    variables = {"x": values, "m": values.reshape(3, 40), "s": {"a": values, "deep": {"b": "Grüße", "c": 2.5}}}
    path = save(tmp_path / "a.mat", variables, do_compression=compressed)
    ours, theirs = read_mat5(path), scipy.io.loadmat(path, simplify_cells=True)
    np.testing.assert_array_equal(np.squeeze(ours["x"]), theirs["x"])
    np.testing.assert_array_equal(ours["m"], theirs["m"])
    np.testing.assert_array_equal(np.squeeze(ours["s"]["a"]), theirs["s"]["a"])
    assert ours["s"]["deep"]["b"] == theirs["s"]["deep"]["b"] == "Grüße"
    assert float(np.squeeze(ours["s"]["deep"]["c"])) == 2.5


@pytest.mark.parametrize(
    ("variables", "options"),
    [
        ({"t": TIME, "acc": VALUES}, {}),
        ({"t": TIME[:, None], "acc": VALUES[None, :]}, {}),
        ({"Fs": RATE, "acc": VALUES}, {}),
        ({"sample_rate_kHz": RATE / 1e3, "acc": VALUES}, {}),
        ({"dt": 1 / RATE, "acc": VALUES}, {}),
        ({"t_ms": TIME * 1e3, "acc": VALUES}, {}),
        ({"data": np.column_stack([TIME, VALUES])}, {"quantity": "acceleration"}),
        ({"data": np.vstack([TIME, VALUES])}, {"unit": "m/s^2"}),
        ({"y": VALUES}, {"sampling_rate": RATE, "quantity": "acceleration"}),
        ({"stamps": TIME, "y": VALUES}, {"columns": ["time=stamps", "y"], "quantity": "acceleration"}),
        ({"run": {"acc": VALUES, "time": TIME}, "Fs": 7.0}, {}),
        ({"acc": {"data": VALUES, "fs": RATE, "unit": "m/s^2"}}, {}),
        ({"data": np.column_stack([VALUES, 3 * VALUES]), "fs": RATE, "names": ["acc", "force"],
          "units": ["m/s^2", "N"]}, {}),
        ({"Signal": {"x_values": {"start_value": 0.0, "increment": 1 / RATE, "quantity": {"label": "s"}},
                     "y_values": {"values": VALUES, "quantity": {"label": "m/s^2"}}}}, {}),
    ],
)  # fmt: skip
def test_layouts_of_mat_files(tmp_path: Path, variables: dict[str, Any], options: dict[str, Any]) -> None:
    if "names" in variables:
        variables = {**variables, **{key: np.array(variables[key], dtype=object) for key in ("names", "units")}}
    agrees(one(save(tmp_path / "a.mat", variables), **options), "acceleration", 1.0)


def test_arrays_of_structs_hold_specimens(tmp_path: Path) -> None:
    runs = np.array([(TIME, VALUES), (TIME, 2 * VALUES)], dtype=[("t", "O"), ("vel", "O")])
    path = save(tmp_path / "a.mat", {"runs": runs})
    refuses(path, "'runs(1).vel', 'runs(2).vel'", "`columns`")
    records = read_records(path, columns="*.vel")
    assert [record.specimen for record in records] == ["a runs(1).vel", "a runs(2).vel"]
    np.testing.assert_array_equal(records[1].values, 2 * VALUES)


def test_a_file_without_a_known_channel_says_what_there_is(tmp_path: Path) -> None:
    refuses(save(tmp_path / "a.mat", {"t": TIME, "y": VALUES, "z": VALUES}), "'t', 'y', 'z'", "`columns`")
    refuses(save(tmp_path / "b.mat", {"t": TIME, "acc": VALUES}), "'acx'", "Did you mean 'acc'?", columns="acx")
    refuses(save(tmp_path / "c.mat", {"acc": VALUES}), "expected a column 'time'", "`sampling_rate`")
    refuses(save(tmp_path / "d.mat", {"t": TIME[:-3], "acc": VALUES}), "400 samples", "397")
    refuses(save(tmp_path / "e.mat", {"note": "nothing"}), "no channel of numbers")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (VALUES + 1j, ("'acc'", "complex")),
        (np.full(400, np.nan), ("finite", "values[0] = nan")),
        (np.zeros((400, 2, 3)), ("400 x 2 x 3",)),
    ],
)
def test_arrays_that_are_no_record(tmp_path: Path, values: Any, words: tuple[str, ...]) -> None:
    refuses(save(tmp_path / "a.mat", {"t": TIME, "acc": values}), "a.mat", *words)


@pytest.mark.parametrize("times", [TIME[::-1], np.repeat(TIME[::2], 2), np.where(TIME > 0.2, np.inf, TIME)])
def test_times_that_are_none(tmp_path: Path, times: Any) -> None:
    refuses(save(tmp_path / "a.mat", {"t": times, "acc": VALUES}), "a.mat", "time")


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def matrix(array_class: int, name: str, *content: bytes, shape: tuple[int, ...] = (1, 1), flags: int = 0) -> bytes:
    head = element(6, struct.pack("<II", array_class | flags << 8, 0))
    head += element(5, struct.pack(f"<{len(shape)}i", *shape)) + element(1, name.encode())
    return element(14, head + b"".join(content))


def mat_file(path: Path, *elements: bytes) -> Path:
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
    path.write_bytes(head + b"".join(elements))
    return path


@pytest.mark.parametrize(
    ("variable", "words"),
    [
        (element(14, element(6, struct.pack("<II", 17, 0)) + element(1, b"tt") + element(1, b"MCOS")
                 + element(1, b"timetable")), ("'tt'", "MATLAB object (timetable)")),
        (matrix(16, "f", matrix(4, "", element(16, b"@(x)x"))), ("'f'", "function handle", "never run")),
        (matrix(3, "o", element(1, b"inline")), ("'o'", "MATLAB object (inline)")),
        (matrix(5, "s", element(5, b""), element(5, b""), element(9, b"")), ("'s'", "sparse")),
    ],
)  # fmt: skip
def test_objects_are_never_read(tmp_path: Path, variable: bytes, words: tuple[str, ...]) -> None:
    refuses(mat_file(tmp_path / "a.mat", variable), "a.mat", *words)
    good = matrix(6, "acc", element(9, VALUES.tobytes()), shape=(400, 1))
    rate = matrix(6, "fs", element(9, np.float64(RATE).tobytes()))
    agrees(one(mat_file(tmp_path / "b.mat", variable, good, rate)), "acceleration", 1.0)


@pytest.mark.parametrize(
    "content",
    [
        struct.pack("<II", 14, 2**31),
        struct.pack("<II", 15, 16) + zlib.compress(struct.pack("<II", 14, 2**32 - 1))[:16],
        matrix(6, "acc", element(9, VALUES.tobytes()), shape=(2**31 - 1, 2**31 - 1)),
        matrix(1, "c", shape=(2**30, 2**30)),
        matrix(2, "s", element(5, struct.pack("<i", 8)), element(1, b"a".ljust(8, b"\0")), shape=(2**20, 2**10)),
        matrix(6, "acc", element(9, VALUES.tobytes()), shape=(-400, 1)),
        matrix(99, "acc", element(9, VALUES.tobytes()), shape=(400, 1)),
        matrix(6, "acc", element(77, VALUES.tobytes()), shape=(400, 1)),
        element(15, b"no deflate"),
    ],
)
def test_sizes_that_lie_allocate_nothing(tmp_path: Path, content: bytes) -> None:
    import tracemalloc

    path = mat_file(tmp_path / "a.mat", content)
    refuses(path, "a.mat")
    tracemalloc.start()
    refuses(path, "damaged or cut off")
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    inner = struct.pack("<II", 14, 10**8) + bytes(10**6)
    refuses(mat_file(tmp_path / "a.mat", element(15, zlib.compress(inner))), "damaged or cut off")
    deep = matrix(6, "", element(9, b""), shape=(0, 0))
    for _ in range(60):
        deep = matrix(1, "", deep)
    refuses(mat_file(tmp_path / "b.mat", deep), "nested")


def test_other_mat_files_are_named(tmp_path: Path) -> None:
    refuses(save(tmp_path / "a.mat", {"acc": VALUES}, format="4"), "MATLAB 4", "save -v7")
    (tmp_path / "b.mat").write_bytes(b"time,acc\n")
    refuses(tmp_path / "b.mat", "no MAT file")
    for name in ("a.mat", "v73.mat"):
        data = files.WRITERS[name](tmp_path / name).read_bytes()
        (tmp_path / f"cut_{name}").write_bytes(data[: int(len(data) * 0.7)])
        refuses(tmp_path / f"cut_{name}", f"cut_{name}")


@pytest.mark.parametrize("kind", ["<u8", "<u4"])
def test_numbers_that_are_none_or_overflow_are_refused_without_a_warning(tmp_path: Path, kind: str) -> None:
    signalling = np.array([0x7FF0000000000001 if kind == "<u8" else 0x7F800001], dtype=kind).view(
        kind.replace("u", "f")
    )
    acc = np.concatenate([VALUES.astype(signalling.dtype), signalling])
    path = save(tmp_path / "a.mat", {"fs": RATE, "acc_g": acc})
    refuses(path, "values[400] = nan")
    refuses(save(tmp_path / "b.mat", {"fs": RATE, "acc_g": np.full(400, 1e308)}), "overflow", "check the unit")
    (tmp_path / "c.csv").write_text("time [min];acc [g]\n" + "".join(f"{k};1e308\n" for k in range(40)))
    refuses(tmp_path / "c.csv", "overflow", "check the unit")


def test_structs_cells_and_objects_of_version_73(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        hidden = file.create_group("#refs#")
        run = file.create_group("run")
        run.attrs["MATLAB_class"] = np.bytes_("struct")
        references = []
        for i, values in enumerate([VALUES, 2 * VALUES]):
            item = hidden.create_dataset(f"v{i}", data=values[None])
            item.attrs["MATLAB_class"] = np.bytes_("double")
            references.append(item.ref)
        run.create_dataset("vel", data=np.array([references], dtype=h5py.ref_dtype).T)
        rate = hidden.create_dataset("fs", data=[[RATE]])
        rate.attrs["MATLAB_class"] = np.bytes_("double")
        run.create_dataset("fs", data=np.array([[rate.ref, rate.ref]], dtype=h5py.ref_dtype).T)
        handle = file.create_dataset("f", data=np.zeros(4, dtype=np.uint8))
        handle.attrs["MATLAB_class"] = np.bytes_("function_handle")
        table = file.create_dataset("tt", data=np.zeros((1, 6), dtype=np.uint32))
        table.attrs["MATLAB_class"], table.attrs["MATLAB_object_decode"] = np.bytes_("timetable"), np.int32(3)
        file["elsewhere"] = h5py.ExternalLink("/etc/hostname", "/x")
        file["loop"] = h5py.SoftLink("/")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    records = read_records(path, columns="run*vel")
    assert [record.specimen for record in records] == ["a run(1).vel", "a run(2).vel"]
    np.testing.assert_array_equal(records[1].values, 2 * VALUES)
    for name, words in {
        "f": "never run",
        "tt": "timetable",
        "elsewhere": "not followed",
        "loop": "not followed",
    }.items():
        refuses(path, words, columns=name, quantity="velocity")


@pytest.mark.parametrize("suffix", [".mat", ".nc"])
def test_arrays_larger_than_their_file_are_not_allocated(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    with h5py.File(path, "w", userblock_size=512 if suffix == ".mat" else 0) as file:
        huge = file.create_dataset("acc", shape=(10**11,), dtype="f8", chunks=(1000,))
        huge.attrs["MATLAB_class"] = np.bytes_("double")
        huge.make_scale("acc")
    if suffix == ".mat":
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    refuses(path, f"a{suffix}", "'acc' promises 800000000000 bytes")


# ---- NumPy, NetCDF, SEP-005 -------------------------------------------------------------------


def test_pickles_are_refused(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> Any:
            return (pytest.fail, ("a pickle was loaded",))

    np.savez(tmp_path / "a.npz", acc=np.array([Bomb()], dtype=object), allow_pickle=True)
    refuses(tmp_path / "a.npz", "'acc'", "pickled", "never loaded")
    np.save(tmp_path / "b.npy", np.column_stack([TIME, VALUES]))
    agrees(one(tmp_path / "b.npy", unit="m"), "displacement", 1.0)


def test_an_npy_header_that_lies(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data.replace(b"(400,), ", b"(9**9,),"))
    refuses(tmp_path / "a.npy", "header cannot be read")
    (tmp_path / "a.npy").write_bytes(data.replace(b"(400,), }   ", b"(400000,), }"))
    refuses(tmp_path / "a.npy", "an array promises 3200000 bytes, but at most 3200")


def test_channels_of_netcdf(tmp_path: Path) -> None:
    both = xr.DataArray(
        np.vstack([VALUES, 2 * VALUES]), dims=("sensor", "time"), attrs={"units": "m s-2"},
        coords={"sensor": ["tip", "root"], "time": ("time", TIME, {"units": "seconds since 2026-11-21 10:00:00"})},
    )  # fmt: skip
    both.to_dataset(name="acc").to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    refuses(tmp_path / "a.nc", "'acc:tip', 'acc:root'")
    agrees(one(tmp_path / "a.nc", columns="acc:root"), "acceleration", 2.0)
    rated = xr.Dataset({"acc": ("sample", VALUES)}, attrs={"sampling_rate": RATE})
    rated.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    record = one(tmp_path / "b.nc")
    agrees(record, "acceleration", 1.0)
    assert any("sampling_rate = 1024" in note for note in record.notes)
    backbones = xr.Dataset({name: ("level", [1.0, 2.0]) for name in ("value", "standard_error", "covariance")})
    backbones.to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
    refuses(tmp_path / "c.nc", "read_backbones")
    (tmp_path / "d.nc").write_bytes(b"CDF\x05" + bytes(60))
    refuses(tmp_path / "d.nc", "nccopy")


SERIES = {"name": "tip", "data": VALUES, "unit_str": "mm", "time": TIME, "quantity": "d", "group": "beam"}


def test_sep005_dictionaries_are_as_its_own_check_wants_them(tmp_path: Path) -> None:
    check = pytest.importorskip("sdypy_sep005.sep005").assert_sep005
    by_rate = {
        "name": "root",
        "data": VALUES.tolist(),
        "unit_str": "m",
        "fs": RATE,
        "start_timestamp": "2026-11-21T10:00:00",
    }
    check([{**SERIES, "time": TIME.tolist()}, by_rate])
    record = one(SERIES)
    agrees(record, "displacement", 1e-3)
    assert (record.specimen, record.source) == ("tip", "SEP-005")
    agrees(one([by_rate]), "displacement", 1.0)
    assert [item.specimen for item in read_records([SERIES, by_rate], columns="*")] == ["root", "tip"]
    refuses([SERIES, by_rate], "'tip', 'root'", "`columns`")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"data": None}, ("data must hold a list of numbers",)),
        ({"data": ["a"] * 40}, ("data must hold",)),
        ({"data": VALUES[:-1]}, ("time holds 400", "399")),
        ({"data": [None, *VALUES[1:]]}, ("values[0] = nan",)),
        ({"data": VALUES + 1j}, ("complex",)),
        ({"time": None, "fs": 0}, ("fs must be a positive number",)),
        ({"name": 3}, ("name must hold a text",)),
        ({"unit_str": "V"}, ("is a voltage (V)", "`sensitivity`")),
        ({"quantity": "f"}, ("found 'tip'",)),
    ],
)
def test_sep005_dictionaries_that_are_not(change: dict[str, Any], words: tuple[str, ...]) -> None:
    refuses({**SERIES, **change}, "SEP-005", *words)
    for key in ("data", "name", "unit_str", "time"):
        refuses([{k: v for k, v in SERIES.items() if k != key}], "time series 1", "is missing")
    refuses([3], "expected a dictionary")
    refuses([], "SEP-005")


def test_json_that_is_none(tmp_path: Path) -> None:
    for text in (
        "{",
        "[" * 100_000,
        "3",
        '{"a": 1}',
        "[]",
        json.dumps({**SERIES, "data": [1], "time": [10**400]})[:0] + "x",
    ):
        (tmp_path / "a.json").write_text(text)
        refuses(tmp_path / "a.json", "a.json")


# ---- LabVIEW ----------------------------------------------------------------------------------


@pytest.mark.parametrize("x_columns", ["One", "No", "Multi"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("segments", [1, 4])
def test_variants_of_labview_files(tmp_path: Path, x_columns: str, decimal: str, segments: int) -> None:
    path = files.lvm(tmp_path / "a.lvm", x_columns=x_columns, decimal=decimal, segments=segments)
    record = one(path)
    agrees(record, "acceleration", 1.0, digits=0.6e-6)
    hammer = one(path, columns="hammer", unit="m")  # Volts is what LabVIEW writes where nobody chose
    np.testing.assert_allclose(hammer.values, 2 * VALUES, atol=0.6e-6)
    assert ("commas in numbers were read as decimal commas" in record.notes) == (decimal == ",")


def test_segments_that_do_not_continue_are_apart(tmp_path: Path) -> None:
    text = files.lvm(tmp_path / "a.lvm", segments=2).read_bytes()
    (tmp_path / "b.lvm").write_bytes(text.replace(b"1.9531250000000000E-01", b"0.0000000000000000E+00"))
    refuses(tmp_path / "b.lvm", "'Acc', 'Acc segment 2'")
    records = read_records(tmp_path / "b.lvm", columns=["Acc", "Acc segment 2"])
    np.testing.assert_allclose(records[1].values, VALUES[200:], atol=0.6e-6)


def test_commas_between_the_columns_of_labview(tmp_path: Path) -> None:
    agrees(one(files.lvm(tmp_path / "a.lvm", separator="Comma")), "acceleration", 1.0, digits=0.6e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("***End_of_Header***", "", ("***End_of_Header*** is missing",)),
        ("0.010000", "0.01x000", ("line 24", "'Acc'", "'0.01x000'")),
        ("Time\tTime\t", "Frequency\tFrequency\t", ("'Frequency', expected time",)),
        ("9.7656250000000000E-04", "-1", ("above zero",)),
        ("X_Value", "Value", ("no samples below the header",)),
    ],
)
def test_labview_files_that_are_damaged(tmp_path: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    path = files.lvm(tmp_path / "a.lvm")
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
    refuses(path, "a.lvm", *words)


# ---- text -------------------------------------------------------------------------------------


def rows(separator: str = ";") -> list[str]:
    return [f"{t:.9f}{separator}{x:.9f}" for t, x in zip(TIME, VALUES, strict=True)]


def test_what_a_logger_writes_above_the_table_is_skipped(tmp_path: Path) -> None:
    top = ["Logger 3000;SN 17", "Operator: N. N.", "Sampling rate [Hz];1024", "", "Zeit [s];Beschleunigung [g]"]
    (tmp_path / "a.csv").write_text("\n".join([*top, *[row.replace(".", ",") for row in rows()]]), encoding="utf-8")
    record = one(tmp_path / "a.csv")
    assert record.quantity == "acceleration"
    np.testing.assert_allclose(record.values, VALUES * G, atol=1e-8)
    assert any("3 lines above the column headers in line 5 were skipped" in note for note in record.notes)
    single = [*top[:4], "Acc (g)", *[row.partition(";")[2] for row in rows()]]
    (tmp_path / "b.txt").write_text("\n".join(single), encoding="utf-8")
    record = one(tmp_path / "b.txt")
    np.testing.assert_allclose(record.time, TIME, rtol=1e-14)
    assert any("1024 samples per second, by the line" in note for note in record.notes)


def test_text_exported_from_tdms(tmp_path: Path) -> None:
    top = ["Group\tMeasurement", "wf_increment\t0,0009765625", "wf_samples\t400", "Time (s)\tAcc (m/s^2)\tForce (N)"]
    lines = [f"{row}\t1,0".replace(".", ",") for row in rows("\t")]
    (tmp_path / "a.txt").write_text("\n".join([*top, *lines]), encoding="utf-16")
    record = one(tmp_path / "a.txt")
    np.testing.assert_allclose(record.values, VALUES, atol=1e-9)
    (tmp_path / "a.tdms").write_bytes(b"TDSm" + bytes(100))
    refuses(tmp_path / "a.tdms", "binary TDMS", "export it as text")


def test_several_columns_are_several_records(tmp_path: Path) -> None:
    lines = [f"{row};{2 * x:.9f}" for row, x in zip(rows(), VALUES, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["Zeit;Acc 1 [g];Acc 2 [g]", *lines]))
    records = read_records(tmp_path / "a.csv", columns=["time=zeit", "acc*"])
    assert [record.specimen for record in records] == ["a Acc 1", "a Acc 2"]
    np.testing.assert_allclose(records[1].values, 2 * VALUES * G, atol=1e-8)
    assert one(tmp_path / "a.csv", columns="2").specimen == "a"
    refuses(tmp_path / "a.csv", "'time=zit'"[6:-1], "Did you mean 'Zeit'?", columns=["time=zit", "acc*"])


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["1.5", "2"], Dialect()),
        (["0,5", "1,234"], Dialect(",")),
        ([",5", "1,234"], Dialect(",")),
        (["1,2345", "1,234"], Dialect(",")),
        (["1,234e-3", "1,234"], Dialect(",")),
        (["1,234", "12345"], Dialect(",")),
        (["1.234,5", "12,0"], Dialect(",", ".")),
        (["1,234", "0.5"], Dialect(".", ",")),
        (["1,234.5"], Dialect(".", ",")),
        (["1,234,567", "1,234"], Dialect(".", ",")),
        (["abc,def"], Dialect()),
    ],
)
def test_decimal_mark_is_decided_by_the_whole_file(cells: list[str], expected: Dialect) -> None:
    assert decide(cells) == decide(cells[::-1]) == expected


@pytest.mark.parametrize("cells", [["1,234"], ["1,234", "2,345"], ["0,5", "1,234.5"], ["0,5", "1.234"]])
def test_an_open_decimal_mark_is_refused(cells: list[str]) -> None:
    with pytest.raises(AmbiguousNumbersError):
        decide(cells)


def test_an_open_decimal_mark_in_a_file_is_named(tmp_path: Path) -> None:
    lines = [f"{k};1,{k:03d}" for k in range(100)]
    (tmp_path / "a.csv").write_text("\n".join(["time;acc", *lines]))
    refuses(tmp_path / "a.csv", "a.csv, line 2", "'1,000' may be decimal or thousands", "decimal points")
    (tmp_path / "b.csv").write_text("\n".join(["time;acc", *lines, "100;12,5"]))
    assert one(tmp_path / "b.csv").values[7] == 1.007
    (tmp_path / "c.csv").write_text("\n".join(["time;acc", *lines, "100.5;1"]))
    assert one(tmp_path / "c.csv").values[7] == 1007.0


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(-1e6, 1e6), min_size=40, max_size=60), st.booleans())
def test_numbers_survive_every_dialect(tmp_path: Path, values: list[float], grouped: bool) -> None:
    """Negative control of the decision: grouping by one sign and decimals by the other, as Python formats them."""
    style = ",.3f" if grouped else ".3f"
    swap = str.maketrans(",.", ".,")
    lines = [f"{k},0;{format(x, style).translate(swap)}" for k, x in enumerate(values)]
    (tmp_path / "a.csv").write_text("\n".join(["time;acc", *lines]))
    expected = [float(format(x, ".3f")) for x in values]
    try:
        np.testing.assert_array_equal(one(tmp_path / "a.csv").values, expected)
    except InputError as error:
        assert (not grouped and "contradict" in str(error)) or "thousands" in str(error)


# ---- units ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "quantity", "si", "factor"),
    [
        ("m", "displacement", "m", 1.0), ("mm", "displacement", "m", 1e-3), ("µm", "displacement", "m", 1e-6),
        ("in", "displacement", "m", 0.0254), ("rad", "displacement", "rad", 1.0),
        ("deg", "displacement", "rad", math.pi / 180), ("m/s", "velocity", "m/s", 1.0),
        ("mm/s", "velocity", "m/s", 1e-3), ("in/s", "velocity", "m/s", 0.0254),
        ("deg/s", "velocity", "rad/s", math.pi / 180), ("m/s^2", "acceleration", "m/s^2", 1.0),
        ("mm/s²", "acceleration", "m/s^2", 1e-3), ("g", "acceleration", "m/s^2", 9.80665),
        ("mg", "acceleration", "m/s^2", 9.80665e-3), ("ft/s^2", "acceleration", "m/s^2", 0.3048),
    ],
)  # fmt: skip
def test_quantity_follows_from_the_unit_and_conversion_is_exact(
    unit: str, quantity: str, si: str, factor: float
) -> None:
    record = one({"name": "tip", "data": VALUES, "unit_str": unit, "fs": RATE})
    assert (record.quantity, record.unit) == (quantity, si)
    np.testing.assert_allclose(record.values, VALUES * factor, rtol=1e-15)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("min", 60.0)])
def test_units_of_time(tmp_path: Path, unit: str, factor: float) -> None:
    path = save(tmp_path / "a.mat", {f"time_{unit}": TIME, "acc": VALUES})
    np.testing.assert_allclose(one(path).time, TIME * factor, rtol=1e-15)


# ---- folders ----------------------------------------------------------------------------------


def test_folders_hold_files_of_one_kind(tmp_path: Path) -> None:
    for name in ("run_10.mat", "run_2.mat"):
        files.mat5(tmp_path / name)
    (tmp_path / "notes.txt").write_text("rain")
    (tmp_path / "truth.json").write_text("{}")
    assert [record.specimen for record in read_records(tmp_path)] == ["run_2", "run_10"]
    files.csv(tmp_path / "run_2.csv")
    refuses(tmp_path, ".csv and .mat", "twice")


BEGINNINGS = [
    b"", b"\x00", b"\xff\xfe", b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file", b"CDF\x01", b"\x89HDF\r\n\x1a\n",
    b"PK\x03\x04", b"\x93NUMPY", b"    -1\n    58\n", b"LabVIEW Measurement",
]  # fmt: skip


@pytest.mark.parametrize("content", BEGINNINGS)
@pytest.mark.parametrize("name", ["a.mat", "a.nc", "a.uff", "a.npz", "a.json", "a.lvm", "a.txt"])
def test_beginnings_of_files_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    refuses(tmp_path / name, name)
