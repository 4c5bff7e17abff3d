"""NetCDF files, classic (version 3) and version 4, with units in the attributes as in the CF conventions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...._common.checks import InputError
from ...._common.text import printable
from ..headers import RATE_WORDS, STEP_WORDS, is_time, key_of, mentions_time
from ..units import parse_unit
from .channel import LARGEST_COMPRESSION, MAXIMUM_BYTES, Channel, channel_of, check_claim
from .isolation import check_that_it_ends
from .tree import MOST_COLUMNS

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
CLASSIC_MAGIC = (b"CDF\x01", b"CDF\x02")
CDF5_MAGIC = b"CDF\x05"
_ONLY_A_DIMENSION = b"This is a netCDF dimension but not a netCDF variable"


def read_netcdf(path: Path) -> tuple[list[Channel], list[str]]:
    """Return the channels of a file, and notes.

    Parameters
    ----------
    path : Path
        A file that begins with `HDF5_MAGIC` or one of `CLASSIC_MAGIC`.

    Returns
    -------
    list of Channel, list of str

    Raises
    ------
    InputError
        When the file is damaged, promises more than it holds, or holds backbones.

    Notes
    -----
    Variables of one dimension are channels; of two, a channel for each index of the dimension that is not time. Time is
    the variable of that name on the same dimension, or an attribute ``sampling_rate`` of variable or file.
    """
    name = printable(path.name)
    with open_netcdf(path) as file:
        return _channels(file, path.stat().st_size, name)


@contextmanager
def open_netcdf(path: Path) -> Iterator[xr.Dataset]:
    """Yield the dataset in a file, whose sizes are checked first; whatever fails inside becomes an `InputError`.

    Parameters
    ----------
    path : Path
        NetCDF of version 3 or 4.

    Raises
    ------
    InputError
        When the file is damaged or promises more than it holds.
    """
    name = printable(path.name)
    try:
        with path.open("rb") as stream:
            is_hdf5 = stream.read(8) == HDF5_MAGIC
        if is_hdf5:
            check_that_it_ends(path, "netcdf")
            _check_sizes(path, name)
        with xr.open_dataset(path, engine="h5netcdf" if is_hdf5 else "scipy", decode_times=False) as file:
            yield file
    except InputError:
        raise
    except Exception as error:  # three libraries read the file, each with errors of its own
        words = printable(" ".join(str(error).split())[:100])
        raise InputError(f"{name}: cannot be read as NetCDF ({words}); write the file again.") from None


def try_netcdf(path: Path) -> None:
    """Read all of a file that may be read at all."""
    with open_netcdf(path) as file:
        file.load()


def _check_sizes(path: Path, name: str) -> None:
    """Refuse a file whose arrays are larger than what it holds of them: coordinates are loaded when it is opened."""
    import h5py  # only such files need it, and its import takes as long as reading a batch

    def check(key: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or node.size is None:
            return
        if bytes(node.attrs.get("NAME", b"")).startswith(_ONLY_A_DIMENSION):
            return
        if node.is_virtual or node.external:
            raise InputError(f"{name}: {printable(key)} is stored outside the file; write the values themselves.")
        claimed = int(node.size) * node.dtype.itemsize
        held = node.id.get_storage_size()
        check_claim(claimed, held, f"variable {printable(key)!r}", name, is_compressed=node.chunks is not None)

    with h5py.File(path, "r") as file:
        file.visititems(check)


def _channels(file: Any, size: int, name: str) -> tuple[list[Channel], list[str]]:
    if {"value", "standard_error", "covariance"} <= set(map(str, file.variables)):
        raise InputError(f"{name}: holds backbones, not time histories; read it with `read_backbones`.")
    channels: list[Channel] = []
    notes: list[str] = []
    common = _step(file.attrs)
    for key, variable in file.variables.items():
        label = str(key)
        if variable.dtype.kind not in "fiuc" or variable.ndim not in (1, 2) or min(variable.shape) == 0:
            continue
        check_claim(variable.nbytes, min(size * LARGEST_COMPRESSION, MAXIMUM_BYTES), f"variable {label!r}", name)
        step = _step(variable.attrs) or common
        unit = variable.attrs.get("units")
        unit = str(unit).partition(" since ")[0] if unit is not None else None
        fields: dict[str, Any] = {"unit": unit}
        if step is not None and not _is_time_variable(label, unit):
            fields["step"] = step[0]
            notes += [step[1]] if step[1] not in notes else []
        if variable.ndim == 1:
            channels.append(channel_of(label, variable.values, group=str(variable.dims[0]), **fields))
            continue
        along = _time_dimension(file, variable)
        across = variable.dims[1 - along]
        count = variable.shape[1 - along]
        if count > MOST_COLUMNS:
            words = f"has {count} entries along {across}, expected at most {MOST_COLUMNS}; write fewer."
            channels.append(Channel(label, refusal=words, group=str(across)))
            continue
        matrix = variable.values if along == 0 else variable.values.T
        group = str(variable.dims[along])
        labels = file[across].values if across in file.variables else np.arange(count)
        names = [f"{label}:{printable(str(labels[i]))}" for i in range(count)]
        channels += [channel_of(name, matrix[:, i], group=group, **fields) for i, name in enumerate(names)]
    return channels, notes


def _time_dimension(file: Any, variable: Any) -> int:
    """Return which of two dimensions is time: the one whose name or variable says so, else the longer one."""
    for i, dim in enumerate(variable.dims):
        unit = file[dim].attrs.get("units") if dim in file.variables else None
        if _is_time_variable(str(dim), None if unit is None else str(unit).partition(" since ")[0]):
            return i
    return 0 if variable.shape[0] >= variable.shape[1] else 1


def _is_time_variable(label: str, unit: str | None) -> bool:
    return is_time(label) or mentions_time(label) or (unit is not None and parse_unit(unit, "time") is not None)


def _step(attributes: Any) -> tuple[float, str] | None:
    """Return the sampling interval [s] that an attribute states, and the note that says so."""
    for key, value in attributes.items():
        word = key_of(str(key))
        if word not in RATE_WORDS | STEP_WORDS or not isinstance(value, int | float | np.number):
            continue
        number = float(value)
        if 0.0 < number < np.inf:
            note = f"time was counted by the attribute {printable(str(key))} = {number:g}"
            return (1.0 / number if word in RATE_WORDS else number), note
    return None
