"""MAT files of version 5 (MATLAB ``save -v6`` and ``-v7``), read strictly: every size is checked against what is there.

Reference: MathWorks, *MAT-File Format*, https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...._common.checks import InputError
from ...._common.text import printable
from .channel import LARGEST_COMPRESSION, MAXIMUM_BYTES, read_bytes
from .tree import Refused

MAGIC = b"MATLAB 5.0 MAT-file"
MAGIC_73 = b"MATLAB 7.3 MAT-file"
"""Of files that `mat73` reads, whose HDF5 takes long to import."""
_HEADER = 128
_COMPRESSED, _MATRIX = 15, 14
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_COMPLEX, _LOGICAL = 0x08, 0x02
_DEEPEST = 16
_MOST_ELEMENTS = 200_000
"""Cells and struct fields in a file; each takes at least 8 bytes of it, and far more in memory."""


class _DamagedError(ValueError):
    """What is wrong with the bytes, as a part of a sentence."""


def read_mat5(path: Path) -> dict[str, Any]:
    """Return the variables of a file: arrays, texts, dicts (structs), lists (cells, struct arrays) and refusals.

    Parameters
    ----------
    path : Path
        A file that begins with `MAGIC`.

    Returns
    -------
    dict
        Variables by name. Nothing in the file is executed: objects, function handles and sparse matrices become
        `Refused`.

    Raises
    ------
    InputError
        When the file is damaged or cut off.
    """
    data = read_bytes(path)
    name = printable(path.name)
    try:
        return _File(data).variables()
    except _DamagedError as error:
        raise InputError(
            f"{name}: the MAT file is damaged or cut off ({error}); save it again, for example with `save -v7`."
        ) from None
    except RecursionError:
        raise InputError(f"{name}: structs are nested too deeply; save time and signal as plain variables.") from None


class _File:
    """The elements of one file."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        if len(data) < _HEADER:
            raise _DamagedError(f"{len(data)} bytes, expected at least {_HEADER}")
        mark = data[126:128]
        if mark not in (b"IM", b"MI"):
            raise _DamagedError("the mark of the byte order is missing")
        self.order = "<" if mark == b"IM" else ">"
        self.elements = 0
        self.inflated = 0

    def variables(self) -> dict[str, Any]:
        """Return all variables."""
        found: dict[str, Any] = {}
        place = _HEADER
        while place + 8 <= len(self.data):
            kind, size = struct.unpack_from(f"{self.order}II", self.data, place)
            place += 8
            self._check(size, len(self.data) - place, f"an element at byte {place - 8}")
            body = memoryview(self.data)[place : place + size]
            place += size
            if kind == _COMPRESSED:
                kind, body = self._inflate(body)
            if kind == _MATRIX and len(body):
                name, value = _Matrix(self, body, 0).read()
                if name:  # function workspaces have none
                    found[name] = value
        return found

    def _inflate(self, body: memoryview) -> tuple[int, memoryview]:
        """Return kind and content of a compressed element, whose size is bounded before it is unpacked."""
        machine = zlib.decompressobj()
        try:
            head = machine.decompress(body, 8)
            if len(head) < 8:
                raise _DamagedError("a compressed element is empty")
            kind, size = struct.unpack(f"{self.order}II", head)
            self._check(size, len(body) * LARGEST_COMPRESSION, "a compressed element")
            self.inflated += size
            self._check(self.inflated, MAXIMUM_BYTES, "the content")
            content = machine.decompress(machine.unconsumed_tail, size) if size else b""
        except zlib.error as error:
            raise _DamagedError(f"a compressed element cannot be unpacked: {error}") from None
        self._check(size, len(content), "a compressed element")
        return kind, memoryview(content)

    def count(self, number: int) -> None:
        """Count cells and fields."""
        self.elements += number
        self._check(self.elements, _MOST_ELEMENTS, "the number of cells and fields", "")

    @staticmethod
    def _check(claimed: int, held: int, what: str, unit: str = " bytes") -> None:
        if claimed > held:
            raise _DamagedError(f"{what} promises {claimed}{unit}, there can be at most {held}")


class _Matrix:
    """One array: flags, dimensions, name and content, each an element of its own."""

    def __init__(self, file: _File, body: memoryview, depth: int) -> None:
        self.file, self.body, self.depth = file, body, depth
        self.place = 0
        if depth > _DEEPEST:
            raise _DamagedError(f"structs are nested more than {_DEEPEST} deep")

    def read(self) -> tuple[str, Any]:
        """Return name and value."""
        kind, flags = self._element()
        if kind != 6 or len(flags) != 8:
            raise _DamagedError("the flags of an array are missing")
        word = struct.unpack_from(f"{self.file.order}I", flags)[0]
        what, is_complex = word & 0xFF, bool((word >> 8) & _COMPLEX)
        if what == _OPAQUE:
            names = [bytes(self._element()[1]).decode("latin-1") for _ in range(3)]
            return names[0], Refused(object_words(names[2]))
        shape = self._shape()
        name = bytes(self._element()[1]).decode("utf-8", "replace").rstrip("\x00")
        if what in _CLASSES:
            return name, self._numbers(shape, is_complex, bool((word >> 8) & _LOGICAL))
        if what == _CHAR:
            return name, self._text()
        if what == _CELL:
            return name, self._cells(math.prod(shape))
        if what == _STRUCT:
            return name, self._structs(math.prod(shape))
        return name, Refused(self._refusal(what))

    def _element(self) -> tuple[int, memoryview]:
        """Return kind and content of the next element."""
        order, body = self.file.order, self.body
        if self.place + 8 > len(body):
            raise _DamagedError("an array ends too early")
        kind, size = struct.unpack_from(f"{order}II", body, self.place)
        if kind >> 16:  # up to four bytes, packed into the tag
            kind, size, begin = kind & 0xFFFF, kind >> 16, self.place + 4
            if size > 4:
                raise _DamagedError("a small element is larger than 4 bytes")
            self.place += 8
        else:
            begin = self.place + 8
            self.place = begin + size + (-size % 8)
        if begin + size > len(body):
            raise _DamagedError(f"an element promises {size} bytes, {max(len(body) - begin, 0)} are left")
        return kind, body[begin : begin + size]

    def _shape(self) -> tuple[int, ...]:
        kind, raw = self._element()
        if kind != 5 or len(raw) % 4 or not 8 <= len(raw) <= 128:
            raise _DamagedError("the dimensions of an array are missing")
        shape = tuple(int(n) for n in np.frombuffer(raw, f"{self.file.order}i4"))
        if min(shape) < 0:
            raise _DamagedError(f"an array has the dimensions {shape}")
        return shape

    def _part(self, shape: tuple[int, ...]) -> Any:
        kind, raw = self._element()
        if kind not in _NUMBERS:
            raise _DamagedError(f"numbers are of the unknown type {kind}")
        code = np.dtype(self.file.order + _NUMBERS[kind])
        if len(raw) != math.prod(shape) * code.itemsize:
            raise _DamagedError(f"an array of {' x '.join(map(str, shape))} numbers holds {len(raw)} bytes")
        with np.errstate(invalid="ignore"):  # a signalling NaN
            return np.frombuffer(raw, code).astype(np.float64).reshape(shape, order="F")

    def _numbers(self, shape: tuple[int, ...], is_complex: bool, is_logical: bool) -> Any:
        real = self._part(shape)
        if is_complex:
            return Refused(COMPLEX)
        return Refused("holds true and false, expected numbers.") if is_logical and real.size > 1 else real

    def _text(self) -> str:
        kind, raw = self._element()
        if kind not in _TEXTS:
            raise _DamagedError(f"a text is of the unknown type {kind}")
        coding = _TEXTS[kind]
        if coding in ("utf-16", "utf-32"):
            coding += "-le" if self.file.order == "<" else "-be"
        return bytes(raw).decode(coding, "replace")

    def _cells(self, count: int) -> list[Any]:
        self._check_count(count)
        return [self._inner() for _ in range(count)]

    def _structs(self, count: int) -> Any:
        _, raw = self._element()
        width = int.from_bytes(bytes(raw[:4]), "little" if self.file.order == "<" else "big")
        _, raw = self._element()
        if not 0 < width <= 4096 or len(raw) % width:
            raise _DamagedError("the field names of a struct are missing")
        names = [
            bytes(raw[i : i + width]).split(b"\x00")[0].decode("utf-8", "replace") for i in range(0, len(raw), width)
        ]
        self._check_count(count * max(len(names), 1))
        structs = [{field: self._inner() for field in names} for _ in range(count)]
        return structs[0] if len(structs) == 1 else structs

    def _check_count(self, count: int) -> None:
        if count * 8 > len(self.body) - self.place:
            raise _DamagedError(f"{count} cells or fields are promised, {len(self.body) - self.place} bytes are left")
        self.file.count(count)

    def _inner(self) -> Any:
        kind, body = self._element()
        if kind != _MATRIX:
            raise _DamagedError(f"a cell or field is of type {kind}, expected an array")
        return _Matrix(self.file, body, self.depth + 1).read()[1] if len(body) else np.empty((0, 0))

    def _refusal(self, what: int) -> str:
        if what == _SPARSE:
            return "is a sparse matrix, expected the samples of a time history; save it with full()."
        if what == _FUNCTION:
            return object_words("function_handle")
        if what == _OBJECT:
            return object_words(bytes(self._element()[1]).decode("latin-1"))
        _unknown_class(what)


def _unknown_class(what: int) -> NoReturn:
    raise _DamagedError(f"an array is of the unknown class {what}")


def object_words(kind: str) -> str:
    """Return why an object of a MATLAB class is not read."""
    if kind == "function_handle":
        return "is a function handle, which is never run; save time and signal as plain arrays."
    return (
        f"is a MATLAB object ({printable(kind)[:40] or 'of a class'}), which only MATLAB can read; save its columns as "
        "plain arrays, for example t = seconds(tt.Time); acc = tt.acc."
    )


COMPLEX = "holds complex numbers, expected the samples of a time history; export the real signal, not its spectrum."
