"""Records as a folder of CSV files, which read back unchanged."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..._common.checks import InputError
from ..._common.text import printable, shorten
from .record import Record

__all__ = ["write_records"]


def write_records(records: Iterable[Record], path: str | os.PathLike[str], *, overwrite: bool = False) -> list[Path]:
    """Write records as a folder of CSV files in SI units that `read_records` reads back.

    Parameters
    ----------
    records : iterable of Record
        One file is written for each.
    path : str or path
        Folder; created where it does not exist.
    overwrite : bool, default False
        Whether files of the same names may be replaced.

    Returns
    -------
    list of Path
        The files, in the order of ``records``.

    Raises
    ------
    InputError
        When the folder already holds other CSV files, a file exists and ``overwrite`` is False, two
        specimens have the same name, or the folder cannot be written.

    See Also
    --------
    read_records : reads them back.

    Notes
    -----
    A specimen's name is never used as a path: characters that are unsafe in file names become ``_``,
    and the file then carries the true name in a column ``specimen``.
    """
    given: Sequence[Record] = list(records)
    names = [record.specimen for record in given]
    if len(set(names)) != len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise InputError(f"`records` hold specimen {shorten(printable(repeated))!r} twice; rename one of them.")
    folder = Path(os.fspath(path))
    files = [folder / f"{stem}.csv" for stem in _file_stems(names)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        present = {entry.name.lower() for entry in folder.iterdir() if entry.suffix.lower() == ".csv"}
        ours = {file.name.lower() for file in files}
        foreign, taken = sorted(present - ours), sorted(present & ours)
        if foreign:
            raise InputError(
                f"{printable(str(folder))}: holds other CSV files ({', '.join(map(printable, foreign[:3]))}); "
                "choose an empty folder."
            )
        if taken and not overwrite:
            raise InputError(
                f"{printable(str(folder))}: already holds {printable(taken[0])}; "
                "choose another folder or set overwrite=True."
            )
        for record, file in zip(given, files, strict=True):
            file.write_text(_as_csv(record, file.stem), encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{printable(str(folder))}: cannot be written ({error.strerror}); choose another.") from None
    return files


def _file_stems(names: Sequence[str]) -> list[str]:
    """Return a distinct, safe file stem for each name."""
    stems: list[str] = []
    used: set[str] = set()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._ -")[:80] or "specimen"
        if re.fullmatch(r"(?i)con|prn|aux|nul|com[0-9]|lpt[0-9]", stem):
            stem += "_"
        unique, number = stem, 2
        while unique.lower() in used:
            unique, number = f"{stem}_{number}", number + 1
        used.add(unique.lower())
        stems.append(unique)
    return stems


def _as_csv(record: Record, stem: str) -> str:
    """Return a record as the text of a CSV file; numbers are written so that they read back unchanged."""
    named = record.specimen != stem
    quoted = '"' + record.specimen.replace('"', '""') + '"'
    tail = f",{quoted}\n" if named else "\n"
    header = f"time [s],{record.quantity} [{record.unit}]"
    columns = [record.time, record.values]
    if record.frequency is not None:  # a known one in every line, as it is read
        header += ",frequency [Hz]"
        columns.append(np.broadcast_to(record.frequency, record.time.shape))
    header += ",specimen\n" if named else "\n"
    lines = zip(*(column.tolist() for column in columns), strict=True)
    return header + "".join(",".join(map(repr, line)) + tail for line in lines)
