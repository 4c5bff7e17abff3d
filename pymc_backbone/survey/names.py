"""Which structures there are: folders, names, folder names, seeds, and what a result depends on."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._common.checks import InputError
from .._common.text import natural_key, printable

MOST_CHARACTERS = 80  # of the name of a folder; longer ones trouble some file systems


def structures_of(batches: Any, leave_out: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Return the sources by name: of a folder of folders, a mapping, or a sequence of paths.

    Parameters
    ----------
    batches : path-like, mapping or sequence of path-like
        As in `diagnose_many`.
    leave_out : path-like, optional
        The output folder, which may lie inside the folder of folders.

    Returns
    -------
    dict
        Paths, records or backbones by name; folders in natural order, others as they are given.

    Raises
    ------
    InputError
        If there is none, or two have one name.
    """
    if isinstance(batches, Mapping):
        sources = {str(name): source for name, source in batches.items()}
        if len(sources) < len(batches):
            raise InputError("two of `batches` have the same name as text; rename one of them.")
    elif isinstance(batches, str | os.PathLike):
        sources = _folders(Path(batches), leave_out)
    elif isinstance(batches, Sequence) and all(isinstance(item, str | os.PathLike) for item in batches):
        sources = {}
        for item in map(Path, batches):
            name = item.name or str(item)
            if name in sources:
                raise InputError(f"two of `batches` are named {name!r}; give a mapping of names to paths.")
            sources[name] = item
    else:
        raise InputError(
            "`batches` must be a folder of folders, a mapping of names to folders, records or backbones, or a sequence "
            f"of paths; got {type(batches).__name__}."
        )
    if not sources:
        raise InputError("`batches` must hold at least one structure.")
    return sources


def _folders(root: Path, leave_out: str | os.PathLike[str] | None) -> dict[str, Any]:
    shown = printable(str(root))
    if not root.is_dir():
        state = "is a file" if root.exists() else "does not exist"
        raise InputError(f"{shown} {state}; name a folder that holds a folder of records for each structure.")
    try:
        entries = list(root.iterdir())
    except OSError as error:
        raise InputError(f"{shown}: cannot be read ({error.strerror}); check its permissions.") from None
    skipped = None if leave_out is None else Path(leave_out).resolve()
    found = [path for path in entries if path.is_dir() and path.name[0] != "." and path.resolve() != skipped]
    if not found:
        raise InputError(
            f"{shown} holds no folder; put the records of each structure in a folder of its own, or diagnose it as a "
            "single structure."
        )
    return {path.name: path for path in sorted(found, key=lambda path: natural_key(path.name))}


def folder_names(names: Sequence[str]) -> dict[str, str]:
    """Return a name that every file system takes for the folder of each structure; the same in every run.

    Examples
    --------
    >>> folder_names(["beam 1", "beam_2"])["beam 1"]
    'beam 1'
    >>> folder_names(["a/b"])["a/b"].startswith("a_b-")
    True
    """
    result = {}
    folded = [name.casefold() for name in names]
    for name in names:
        safe = re.sub(r"[^\w .+=@()-]", "_", name)[:MOST_CHARACTERS].strip(" .")
        is_reserved = re.fullmatch(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?", safe) is not None
        if not safe or safe != name or is_reserved or folded.count(name.casefold()) > 1:
            safe = f"{safe or 'structure'}-{_digest(name)[:8]}"
        result[name] = safe
    return result


def seed_of(seed: int, name: str) -> int:
    """Return the seed of one structure: it depends on the seed of the survey and the name, on nothing else.

    Examples
    --------
    >>> seed_of(1, "beam_01") == seed_of(1, "beam_01"), seed_of(1, "beam_01") == seed_of(1, "beam_02")
    (True, False)
    """
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).digest()
    key = tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint32)[0] >> 1)


def request_digest(source: Any, settings: Mapping[str, Any], version: str) -> str:
    """Return a digest of all that the result of a structure depends on: settings, version, records."""
    from ..reporting.portable import plain

    digest = hashlib.sha256(json.dumps([version, plain(settings)], sort_keys=True).encode())
    for part in _parts(source):
        digest.update(part)
    return digest.hexdigest()


def _parts(source: Any) -> list[bytes]:
    """Return what identifies records: names, sizes and times of files, or the numbers themselves."""
    if isinstance(source, str | os.PathLike):
        root = Path(source)
        try:
            files = sorted(path for path in root.rglob("*") if path.is_file()) if root.is_dir() else [root]
            found = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files]
        except OSError:
            found = [(str(root), -1, -1)]
        return [repr(item).encode() for item in found]
    if hasattr(source, "data_vars"):
        arrays = [source[name].values for name in ("value", "standard_error", "level") if name in source]
        return [np.ascontiguousarray(array).tobytes() for array in arrays]
    if isinstance(source, Sequence):
        return [part for record in source for part in _record_parts(record)]
    return []


def _record_parts(record: Any) -> list[bytes]:
    arrays = (getattr(record, name, None) for name in ("time", "values", "displacement"))
    return [str(getattr(record, "specimen", "")).encode(), *(np.asarray(a).tobytes() for a in arrays if a is not None)]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


__all__ = ["folder_names", "request_digest", "seed_of", "structures_of"]
