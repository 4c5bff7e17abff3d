"""NumPy's ``.npz`` and ``.npy`` files without pickles; sizes are checked before anything is allocated."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from ...._common.checks import InputError
from ...._common.text import printable
from .channel import MAXIMUM_BYTES, check_claim, read_bytes
from .tree import Refused

ZIP_MAGIC, NPY_MAGIC = b"PK\x03\x04", b"\x93NUMPY"
_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_LONGEST_HEADER = 10_000
_PICKLED = "holds pickled Python objects, which are never loaded; save plain arrays of numbers."


def read_npz(path: Path) -> dict[str, Any]:
    """Return the arrays of a file by name; arrays of objects become `Refused`.

    Parameters
    ----------
    path : Path
        A file that begins with `ZIP_MAGIC` or `NPY_MAGIC`.

    Returns
    -------
    dict
        Arrays of numbers, texts of a single string, and refusals.

    Raises
    ------
    InputError
        When the file is damaged or promises more than it holds.
    """
    data = read_bytes(path)
    name = printable(path.name)
    if data.startswith(NPY_MAGIC):
        return {path.stem: _array(data, name)}
    return unpack(data, name)


def unpack(data: bytes, name: str, kinds: str = "fiuc", *, is_compressed: bool = True) -> dict[str, Any]:
    """Return the arrays of an archive by name, as `read_npz` does.

    Parameters
    ----------
    data : bytes
        Content of an ``.npz`` file.
    name : str
        For messages.
    kinds : str, optional
        Kinds of NumPy's data types that are taken; others become `Refused`. With ``U`` a single text is an array, too.
    is_compressed : bool, optional
        Whether the arrays may be larger than the archive.

    Raises
    ------
    InputError
        When the archive is damaged or promises more than it holds.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            unpacked = sum(member.file_size for member in members)
            check_claim(unpacked, len(data), "the archive", name, is_compressed=is_compressed)
            found: dict[str, Any] = {}
            for member in members:
                if not member.filename.endswith(".npy"):
                    continue
                with archive.open(member) as stream:
                    content = stream.read(MAXIMUM_BYTES)
                found[member.filename.removesuffix(".npy")] = _array(content, name, kinds)
            return found
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError) as error:
        if isinstance(error, InputError):
            raise
        words = printable(" ".join(str(error).split())[:100])
        raise InputError(f"{name}: the archive cannot be read ({words}); save it again with numpy.savez.") from None


def _array(content: bytes, name: str, kinds: str = "fiuc") -> Any:
    """Return one array, whose header must fit its bytes and whose kind must be one of NumPy's ``kinds``."""
    stream = io.BytesIO(content)
    try:
        version = npy.read_magic(stream)
        if version not in _READERS:
            raise ValueError(f"version {version} of the format")
        shape, is_fortran, dtype = _READERS[version](stream, max_header_size=_LONGEST_HEADER)
    except Exception as error:  # the header is parsed as a Python literal, which fails in many ways
        words = printable(" ".join(str(error).split())[:80])
        raise InputError(
            f"{name}: an array's header cannot be read ({words}); save it again with numpy.savez."
        ) from None
    if dtype.hasobject:
        return Refused(_PICKLED)
    if dtype.kind == "U" and shape == () and "U" not in kinds:
        raw = content[stream.tell() : stream.tell() + dtype.itemsize]
        return str(np.frombuffer(raw, dtype)[0]) if len(raw) == dtype.itemsize and raw else ""
    if dtype.kind not in kinds:
        return Refused(f"holds {printable(str(dtype))[:40]}, expected numbers.")
    if any(n < 0 for n in shape):
        raise InputError(f"{name}: an array has the dimensions {shape}; save it again with numpy.savez.")
    check_claim(math.prod(shape) * dtype.itemsize, len(content) - stream.tell(), "an array", name)
    flat = np.frombuffer(content, dtype, math.prod(shape), stream.tell())
    return flat.reshape(shape, order="F" if is_fortran else "C")
