"""MAT files of version 7.3 (MATLAB ``save -v7.3``): HDF5 in MATLAB's layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ...._common.checks import InputError
from ...._common.text import printable
from .channel import check_claim
from .isolation import check_that_it_ends
from .mat5 import COMPLEX, object_words
from .tree import Refused

_DEEPEST = 16
_MOST_ITEMS = 100_000
_PLAIN = {"double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"}


def read_mat73(path: Path) -> dict[str, Any]:
    """Return the variables of a file: arrays, texts, dicts (structs), lists (cells, struct arrays) and refusals.

    Parameters
    ----------
    path : Path
        A file that begins with `MAGIC_73`.

    Returns
    -------
    dict
        As `read_mat5` returns it.

    Raises
    ------
    InputError
        When the file is damaged or cut off, or promises more than it holds.

    Notes
    -----
    Only what lies in the file itself is read: links to other files and storage outside are refused.
    """
    check_that_it_ends(path, "mat73")
    try:
        with h5py.File(path, "r") as file:
            return _Reader(file, printable(path.name)).members(file, 0)
    except InputError:
        raise
    except Exception as error:  # h5py raises whatever a damaged file leads to
        words = " ".join(str(error).split())[:100]
        raise InputError(
            f"{printable(path.name)}: the MAT file of version 7.3 cannot be read ({printable(words)}); save it again, "
            "for example with `save -v7`."
        ) from None


class _Reader:
    """Reads the groups and datasets of one file."""

    def __init__(self, file: Any, name: str) -> None:
        self.file, self.name = file, name
        self.items = 0

    def members(self, group: Any, depth: int) -> dict[str, Any]:
        """Return the members of a group by name."""
        found: dict[str, Any] = {}
        for key in group:
            if key.startswith("#"):  # where MATLAB keeps what cells and objects refer to
                continue
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                found[key] = Refused(
                    "is a link to another file or place, which is not followed; save the array itself."
                )
                continue
            found[key] = self.value(group[key], depth + 1, key)
        return found

    def value(self, node: Any, depth: int, what: str) -> Any:
        """Return a variable."""
        self.items += 1
        if depth > _DEEPEST or self.items > _MOST_ITEMS:
            raise InputError(
                f"{self.name}: structs are nested deeper than {_DEEPEST} or hold more than {_MOST_ITEMS} items; save "
                "time and signal as plain variables."
            )
        kind = node.attrs.get("MATLAB_class", b"")
        kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
        if "MATLAB_sparse" in node.attrs:
            return Refused("is a sparse matrix, expected the samples of a time history; save it with full().")
        if "MATLAB_object_decode" in node.attrs or kind == "function_handle":
            return Refused(object_words(kind))
        if isinstance(node, h5py.Group):
            return self._struct(node, depth)
        if "MATLAB_empty" in node.attrs:
            return np.empty((0, 0))
        self._check(node, what)
        if kind == "char":
            return "".join(map(chr, np.asarray(node[()], dtype=np.uint32).T.ravel(order="F").tolist()))
        if kind == "cell":
            return self._referred(node, depth)
        if node.dtype.kind == "V" and set(node.dtype.names or ()) == {"real", "imag"}:
            return Refused(COMPLEX)
        if kind in _PLAIN or (not kind and node.dtype.kind in "fiu"):
            return np.asarray(node[()], dtype=np.float64).T
        if kind == "logical":
            return Refused("holds true and false, expected numbers.") if node.size > 1 else np.asarray(node[()], float)
        return Refused(object_words(kind or str(node.dtype)))

    def _struct(self, group: Any, depth: int) -> Any:
        """Return a struct as a dict; an array of structs, whose fields are references, as a list of dicts."""
        shapes = {}
        for key in group:
            is_inside = isinstance(group.get(key, getlink=True), h5py.HardLink)
            node = group[key] if is_inside else None
            is_array = (
                isinstance(node, h5py.Dataset) and node.dtype == h5py.ref_dtype and not node.attrs.get("MATLAB_class")
            )
            shapes[key] = node.size if is_array and node is not None else None
        sizes = set(shapes.values())
        if not sizes or None in sizes or len(sizes) > 1:
            return self.members(group, depth)
        fields = {key: self._referred(group[key], depth) for key in shapes}
        return [{key: values[i] for key, values in fields.items()} for i in range(sizes.pop() or 0)]

    def _referred(self, node: Any, depth: int) -> list[Any]:
        """Return what the references of a cell point at."""
        self._check(node, "a cell")
        if node.dtype != h5py.ref_dtype:
            return []
        references = np.asarray(node[()]).T.ravel(order="F")
        return [self.value(self.file[r], depth + 1, "a cell") if r else np.empty((0, 0)) for r in references]

    def _check(self, node: Any, what: str) -> None:
        """Refuse a dataset whose content is elsewhere, or is larger than what the file holds of it."""
        if node.is_virtual or node.external:
            raise InputError(f"{self.name}: {printable(what)} is stored outside the file; save the array itself.")
        check_claim(
            int(node.size) * node.dtype.itemsize,
            node.id.get_storage_size(),
            f"array {printable(what)!r}",
            self.name,
            is_compressed=node.chunks is not None,
        )
