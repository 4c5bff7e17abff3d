"""The output folder before anything is written: made ready, and kept from other runs while one lasts."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .._common.checks import InputError
from ..inference.store.lock import LOCK, FolderLock


@contextmanager
def claimed_output(
    path: str | os.PathLike[str] | None, overwrite: bool = False, *, records: Any = None
) -> Iterator[Path | None]:
    """Make the output folder ready as `prepare_output` does, and keep it from other runs while this one lasts.

    Parameters
    ----------
    path : path-like or None
        Folder; None: there is none.
    overwrite, records
        As in `prepare_output`.

    Yields
    ------
    pathlib.Path or None
        The folder.

    Raises
    ------
    InputError
        As `prepare_output`, and where another run is writing there.
    """
    if path is None:
        yield None
        return
    made = [place for place in (Path(path), *Path(path).parents) if not place.exists()]
    folder = prepare_output(path, overwrite, records=records)
    lock = FolderLock(folder, "output folder")
    lock.acquire()
    try:
        yield prepare_output(path, overwrite, records=records)  # another run may have ended between check and lock
    finally:
        lock.remove()
        with contextlib.suppress(OSError):  # a run that wrote nothing leaves nothing: only empty folders can be removed
            for place in made:
                place.rmdir()


def prepare_output(path: str | os.PathLike[str], overwrite: bool = False, *, records: Any = None) -> Path:
    """Make the output folder ready, before any long computation.

    Parameters
    ----------
    path : path-like
        Folder; made if it is not there, with its parents.
    overwrite : bool, optional
        Whether a folder that is not empty may be used. `write_results` then replaces what it writes, and removes what
        an earlier run listed in its own ``result.json`` and this one did not write; nothing else is touched.
    records : path-like, optional
        Where the records are: results among them would be taken for records by the next run.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    InputError
        If the path is a file or the folder of the records, the folder is not empty (without ``overwrite``), or nothing
        can be written there.
    """
    folder = Path(path)
    if isinstance(records, str | os.PathLike) and folder.resolve() == Path(records).resolve():
        raise InputError(f"The output {folder} is where the records are; name another folder.")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output {folder} is a file; name a folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        occupied = sorted(entry.name for entry in folder.iterdir() if entry.name != LOCK)
        if occupied and not overwrite:
            raise InputError(
                f"The output folder {folder} is not empty (it holds {occupied[0]}); name another one, or give "
                "`overwrite=True`."
            )
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"The output folder {folder} cannot be written ({error.strerror}); name another one."
        ) from None
    return folder


__all__ = ["claimed_output", "prepare_output"]
