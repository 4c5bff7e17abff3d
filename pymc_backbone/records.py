"""Measured free-decay records: reading CSV files into SI units, checking them, and writing them back."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ._checks import FloatArray, InputError, check_choice, check_finite_array, check_positive
from ._columns import (
    QUANTITIES,
    SI_UNITS,
    checked_time,
    find_specimens,
    find_time,
    find_values,
    unit_of_time,
    unit_of_values,
)
from ._tables import Table, list_tables, natural_key, printable, read_table, shorten
from .measured_backbones import read_backbones

__all__ = ["QUANTITIES", "Record", "read_backbones", "read_records", "write_records"]

MINIMUM_SAMPLES = 32
"""Four cycles of eight samples: with less there is no decay to speak of."""


@dataclass(frozen=True, eq=False)
class Record:
    """One measured free decay in SI units.

    Parameters
    ----------
    specimen : str
        Name of the specimen, kept as text.
    time : (n,) array
        Time stamps [s], strictly increasing.
    values : (n,) array
        Samples of ``quantity`` in ``unit``, finite.
    quantity : {"displacement", "velocity", "acceleration"}
        What was measured.
    unit : str
        SI unit of ``values``: ``"m"`` or ``"rad"``, the same over ``s`` or over ``s^2``.
    source : str
        Where it came from, for messages; by default the specimen's name.
    notes : tuple of str
        Sentences about what was assumed or converted.

    Raises
    ------
    InputError
        When the lengths differ, a value is not finite, time does not increase, there are fewer than
        32 samples, or the quantity or its unit is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(200) / 100.0
    >>> record = Record("beam", time, 1e-3 * np.exp(-time) * np.cos(20.0 * time))
    >>> record.quantity, record.unit, record.time.size
    ('displacement', 'm', 200)
    """

    specimen: str
    time: FloatArray
    values: FloatArray
    quantity: str = "displacement"
    unit: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        specimen = str(self.specimen).strip().encode("utf-8", "backslashreplace").decode("utf-8")
        if not specimen or re.search("[\x00-\x1f\x7f]", specimen):
            raise InputError(f"`specimen` must be one line of text, got {shorten(ascii(self.specimen))}; rename it.")
        quantity = check_choice("quantity", self.quantity, QUANTITIES)
        units = SI_UNITS[quantity]
        unit = check_choice("unit", self.unit or units[0], units)
        source = self.source or specimen
        name = printable(source)
        try:
            time = check_finite_array("time", self.time)
            values = check_finite_array("values", self.values)
        except InputError as error:
            raise InputError(f"{name}: {error} Cut the record there or fill the gap.") from None
        if time.size != values.size:
            raise InputError(f"{name}: `values` must be as long as `time` ({time.size}), got {values.size}.")
        if time.size < MINIMUM_SAMPLES:
            raise InputError(
                f"{name}: a record needs at least {MINIMUM_SAMPLES} samples, got {time.size}; record longer or faster."
            )
        drop = np.flatnonzero(np.diff(time) <= 0.0)
        if drop.size:
            at = int(drop[0]) + 1
            raise InputError(
                f"{name}: `time` must increase, got time[{at}] = {time[at]:.9g} after {time[at - 1]:.9g}; "
                "sort the samples and drop repeats."
            )
        time.setflags(write=False)
        values.setflags(write=False)
        for field, value in (("time", time), ("values", values), ("unit", unit), ("source", source)):
            object.__setattr__(self, field, value)
        object.__setattr__(self, "specimen", specimen)
        object.__setattr__(self, "notes", tuple(self.notes))


def read_records(
    path: str | os.PathLike[str],
    *,
    quantity: str | None = None,
    column: str | None = None,
    unit: str | None = None,
    sampling_rate: float | None = None,
) -> list[Record]:
    """Read measured free decays from CSV files, convert them to SI units and check them.

    Parameters
    ----------
    path : str or path
        A folder of ``.csv`` files (one specimen each, named after the file), one such file, or one
        file with a further column ``specimen``.
    quantity : {"displacement", "velocity", "acceleration"}, optional
        Which column to take where a file has several, or what ``column`` holds.
    column : str, optional
        Header of the column to take, for files whose headers do not name the quantity.
    unit : str, optional
        Unit of that column, for files whose headers do not state it or state it wrongly.
    sampling_rate : float, optional
        Samples per second [Hz]; replaces the time column, which may then be missing.

    Returns
    -------
    list of Record
        Naturally sorted by specimen (``run_2`` before ``run_10``).

    Raises
    ------
    InputError
        When anything cannot be used: the sentence names the file, line and column, what was
        expected, and what to do.

    Notes
    -----
    A file has one header line, then one line per sample; blank lines and lines starting with ``#``
    are skipped. The separator is the first of semicolon, tab and comma that the header holds, else
    white space; decimal commas are understood where the separator is no comma. Columns are ``time``
    [s] and one of ``displacement``, ``velocity``, ``acceleration``; a unit may follow in brackets
    (``time [ms]``, ``Acc (g)``, ``angle [deg]``) and SI is assumed, and noted, where none does.
    """
    if quantity is not None:
        quantity = check_choice("quantity", quantity, QUANTITIES)
    rate = None if sampling_rate is None else check_positive("sampling_rate", sampling_rate)
    records: dict[str, Record] = {}
    for file in list_tables(path):
        for record in _records_of(read_table(file), quantity, column, unit, rate):
            if record.specimen in records:
                raise InputError(
                    f"{printable(file.name)}: specimen {shorten(record.specimen)!r} is also in "
                    f"{printable(records[record.specimen].source)}; rename one of them."
                )
            records[record.specimen] = record
    return [records[name] for name in sorted(records, key=natural_key)]


def _records_of(
    table: Table, quantity: str | None, wanted: str | None, unit_text: str | None, rate: float | None
) -> list[Record]:
    """Return the records of one table."""
    specimens = find_specimens(table)
    value_column, quantity = find_values(table, quantity, wanted, unit_text)
    unit, unit_notes = unit_of_values(table, value_column, quantity, unit_text)
    notes = table.notes + unit_notes
    stamps, time_column = None, None
    if rate is None:
        time_column = find_time(table)
        time_unit = unit_of_time(table, time_column)
        notes += () if time_unit.factor == 1.0 else (f"time was converted from {time_unit.written} to s",)
        stamps = table.numbers(time_column) * time_unit.factor
    else:
        notes += (f"time was counted at the given {rate:g} samples per second",)
    values = table.numbers(value_column) * unit.factor
    records = []
    for specimen, rows in specimens.items():
        lines = [table.lines[row] for row in rows]
        if len(lines) < MINIMUM_SAMPLES:
            whose = f" of specimen {shorten(specimen)!r}" if len(specimens) > 1 else ""
            table.fail(f"a record needs at least {MINIMUM_SAMPLES} samples, got {len(lines)}{whose}; record longer.")
        time = np.arange(len(lines)) / rate if rate is not None else checked_time(table, time_column, stamps, rows)
        picked = values[rows]
        if not np.isfinite(picked).all() or not np.isfinite(time).all():
            table.fail("numbers overflow on conversion to SI units; check the unit in the header.", None, value_column)
        source = table.name if len(specimens) == 1 else f"{table.name} (specimen {shorten(printable(specimen))})"
        records.append(Record(specimen, time, picked, quantity, unit.si, source, notes))
    return records


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
    header = f"time [s],{record.quantity} [{record.unit}]" + (",specimen\n" if named else "\n")
    pairs = zip(record.time.tolist(), record.values.tolist(), strict=True)
    return header + "".join(f"{time!r},{value!r}{tail}" for time, value in pairs)
