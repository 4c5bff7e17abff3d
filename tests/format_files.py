"""Files of measured records as independent writers make them, all of the same decay."""

from __future__ import annotations

import gc
import json
import warnings
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import scipy.io
import xarray as xr

RATE = 1024.0
TIME = np.arange(400) / RATE  # exact in binary
VALUES = 0.01 * np.exp(-2.0 * TIME) * np.cos(2 * np.pi * 40.0 * TIME)


def mat5(path: Path) -> Path:
    scipy.io.savemat(path, {"time": TIME, "acc_g": VALUES[:, None], "comment": "blade 3"}, do_compression=True)
    return path


def mat5_struct(path: Path) -> Path:
    test = {"displacement": VALUES, "fs": RATE, "unit": "mm"}
    scipy.io.savemat(path, {"test": test, "info": {"who": "N. N.", "k": np.arange(3.0)}})
    return path


def matlab_char(text: str) -> np.ndarray:
    return np.array([[ord(char)] for char in text], dtype=np.uint16)


def mat73(path: Path) -> Path:
    """Write as MATLAB does: HDF5 behind 512 bytes of text, arrays transposed, classes in attributes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in {"time": TIME[None], "velocity": VALUES[None], "fs": np.array([[RATE]])}.items():
            file.create_dataset(name, data=value).attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("comment", data=matlab_char("blade 3"))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        text.attrs["MATLAB_int_decode"] = np.int32(2)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sat Nov 21 10:00:00 2026 HDF5 schema 1.00 ."
    with path.open("r+b") as stream:
        stream.write(head.ljust(116) + bytes(8) + b"\x00\x02IM")
    return path


def netcdf4(path: Path) -> Path:
    _dataset().to_netcdf(path, engine="h5netcdf")
    return path


def netcdf3(path: Path) -> Path:
    _dataset().to_netcdf(path, engine="scipy", format="NETCDF3_CLASSIC")
    return path


def _dataset() -> xr.Dataset:
    data = xr.Dataset({"velocity": ("time", VALUES, {"units": "mm/s"})}, coords={"time": TIME * 1e3})
    data["time"].attrs["units"] = "ms"
    return data


def uff58(path: Path, *, binary: int = 0, even: int = 1, unit: str = "m/s^2", kind: int = 12, **fields: object) -> Path:
    import pyuff

    x = TIME if even else TIME + 1e-4 * np.sin(np.arange(TIME.size))
    entries = {
        "id1": "tip Z", "id2": "", "id3": "", "id4": "", "id5": "", "func_type": 1, "rsp_node": 7, "rsp_dir": 3,
        "ref_node": 1, "ref_dir": 3, "binary": binary, "abscissa_spacing": even, "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": kind, "ordinate_axis_units_lab": unit,
        "abscissa_axis_units_lab": "s", "orddenom_spec_data_type": 0, "x": x, "data": VALUES, **fields,
    }  # fmt: skip
    dataset = pyuff.prepare_58(**entries)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves a file open when it writes binary data
        pyuff.UFF(str(path)).write_sets([dataset], mode="add")
        gc.collect()
    return path


def npz(path: Path) -> Path:
    np.savez_compressed(path, t=TIME, displacement_mm=VALUES)
    return path


def sep005(path: Path) -> Path:
    series = {"name": "tip", "data": VALUES.tolist(), "unit_str": "m/s²", "fs": RATE, "quantity": "a"}
    path.write_text(json.dumps([series]), encoding="utf-8")
    return path


def lvm(
    path: Path, *, x_columns: str = "One", decimal: str = ".", separator: str = "Tab", segments: int = 1, **more: object
) -> Path:
    """Write as LabVIEW documents it: two channels, a header for the file and one for each segment."""
    multi = bool(more.get("multi_headings", segments > 1))
    mark = "\t" if separator == "Tab" else ","
    columns = ["", "m/s^2", "Volts"] if x_columns != "Multi" else ["", "m/s^2", "", "Volts"]

    def tagged(tag: str, *values: str) -> str:
        placed = list(values) if x_columns != "Multi" else [values[0], "", values[1]]
        return mark.join([tag, *placed, ""])

    lines = [
        mark.join(pair)
        for pair in [
            ("LabVIEW Measurement", ""), ("Writer_Version", "2"), ("Reader_Version", "2"), ("Separator", separator),
            ("Decimal_Separator", decimal), ("Multi_Headings", "Yes" if multi else "No"), ("X_Columns", x_columns),
            ("Time_Pref", "Relative"), ("Operator", "N. N."), ("Date", "2026/11/21"), ("Time", "10:00:00,5"),
            ("***End_of_Header***", ""),
        ]
    ]  # fmt: skip

    def number(value: float) -> str:
        return f"{value:.6f}".replace(".", decimal)

    size = TIME.size // segments
    for k in range(segments):
        part = slice(k * size, (k + 1) * size)
        begin = f"{TIME[part][0]:.16E}".replace(".", decimal)
        lines += ["", mark.join(["Channels", "2", "", ""]), tagged("Samples", str(size), str(size))]
        lines += [tagged("Date", "2026/11/21", "2026/11/21"), tagged("Time", "10:00:00,5", "10:00:00,5")]
        lines += [tagged("Y_Unit_Label", columns[1], "Volts"), tagged("X_Dimension", "Time", "Time")]
        lines += [tagged("X0", begin, begin)]
        lines += [
            tagged("Delta_X", *[f"{1 / RATE:.16E}".replace(".", decimal)] * 2),
            mark.join(["***End_of_Header***", "", ""]),
        ]
        names = {"One": ["X_Value", "Acc", "Hammer", "Comment"], "No": ["X_Value", "Acc", "Hammer", "Comment"]}
        lines.append(mark.join(names.get(x_columns, ["X_Value", "Acc", "X_Value", "Hammer", "Comment"])))
        for t, x in zip(TIME[part], VALUES[part], strict=True):
            cells = {"One": [t, x, 2 * x], "No": [None, x, 2 * x], "Multi": [t, x, t, 2 * x]}[x_columns]
            lines.append(mark.join("" if cell is None else number(cell) for cell in cells))
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")
    return path


def csv(path: Path) -> Path:
    rows = (f"{t!r};{x!r}".replace(".", ",") for t, x in zip(TIME.tolist(), VALUES.tolist(), strict=True))
    path.write_text("\n".join(["Logger;3", "time [s];Acc (g)", *rows]) + "\n", encoding="utf-8")
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "a.csv": csv, "a.mat": mat5, "struct.mat": mat5_struct, "v73.mat": mat73, "a.nc": netcdf4, "classic.nc": netcdf3,
    "a.uff": uff58, "binary.uff": lambda path: uff58(path, binary=1), "a.npz": npz, "a.json": sep005, "a.lvm": lvm,
}  # fmt: skip
"""One file of each format, by its name."""
