"""Files that are whole or absent: written beside their place, brought to the disk, then renamed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .checks import InputError

TEMPORARY_PREFIX = ".writing-"


@contextmanager
def replacing(path: Path, remedy: str = "free space or name another folder") -> Iterator[Path]:
    """Yield a temporary path to write; rename it to ``path`` at the end, remove it on any failure.

    Parameters
    ----------
    path : pathlib.Path
        The file in the end; its folder is made if it is not there.
    remedy : str, optional
        What to do if it cannot be written, the end of the sentence.

    Raises
    ------
    InputError
        If the file cannot be written: no space, no permission.

    Notes
    -----
    The file's content is on the disk before its name is, and the name before this returns: a power cut leaves the
    former file or the new one.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=path.parent))
        yield temporary / path.name
        _sync(temporary / path.name)
        os.replace(temporary / path.name, path)
        if os.name == "posix":  # elsewhere a folder cannot be opened
            _sync(path.parent)
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror or error}); {remedy}.") from None
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove what a killed process was writing in ``folder``; only for the one who owns it."""
    for entry in folder.glob(f"{TEMPORARY_PREFIX}*"):
        shutil.rmtree(entry, ignore_errors=True)


def _sync(path: Path) -> None:
    """Wait until the disk has what was written to a file, or the names in a folder."""
    # Windows syncs only what is open for writing.
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
