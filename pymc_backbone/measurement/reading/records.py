"""Measured free-decay records: reading files of many formats into SI units, and checking them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..._common.checks import FloatArray, InputError
from ..._common.text import natural_key, printable, shorten
from .clock import ClockError, is_clock, seconds_of
from .columns import (
    Reading,
    Source,
    checked_time,
    fail_without_time,
    find_specimens,
    find_time,
    find_values,
    is_no_signal,
    reading_of,
    scaled,
    unit_of_time,
    unit_of_values,
)
from .envelopes import (
    EnvelopeColumn,
    envelope_column,
    envelope_record,
    falls_back_to,
    frequencies_of,
    frequency_column,
)
from .formats import list_recordings, read_recording
from .formats.channel import Recording
from .formats.sep005 import channels_of_sep005
from .hammer import after_hits, force_of
from .headers import ENVELOPE
from .measured_backbones import read_backbones
from .record import MINIMUM_SAMPLES, Record
from .tables import Column, Table, list_tables, read_table
from .units import split_header

__all__ = ["read_backbones", "read_records"]

_MOST_NAMED = 6
_MOST_TWICE = 0.02
"""Share of the lines that may stand there twice."""


def read_records(
    path: str | os.PathLike[str] | Mapping[str, Any] | Sequence[Mapping[str, Any]],
    *,
    columns: str | Sequence[str] | None = None,
    quantity: str | None = None,
    unit: str | None = None,
    sampling_rate: float | None = None,
    sensitivity: str | Sequence[str] | None = None,
    frequency: float | None = None,
    reference: float | str | None = None,
) -> list[Record]:
    """Read measured free decays from files, convert them to SI units and check them.

    Parameters
    ----------
    path : str or path, or SEP-005 dictionaries
        A file, or a folder of files of one kind (one specimen each, named after the file): CSV and other delimited
        text, LabVIEW (``.lvm``), MATLAB (``.mat``, version 5 and 7.3), universal files (data set 58), NetCDF, NumPy
        (``.npz``), SEP-005 as JSON. Or, from Python, one SEP-005 dictionary or a list of them.
    columns : str or sequence of str, optional
        The channels to take: names as the file has them, without regard to case; patterns such as ``"acc*"``; or
        numbers counted from 1. ``"time=NAME"`` names the time channel. Each of several channels becomes a record.
    quantity : {"displacement", "velocity", "acceleration", "envelope"}, optional
        Which channel to take where a file has several, or what ``columns`` hold.
    unit : str, optional
        Unit of the channels, for files that do not state it or state it wrongly.
    sampling_rate : float, optional
        Samples per second [Hz]; replaces the time channel, which may then be missing.
    sensitivity : str or sequence of str, optional
        Of the sensors, for channels that are in volts: ``"10.2 mV/g"`` for all, ``"acc_x=10.2 mV/g"`` for one. A
        hammer's, ``"2.25 mV/N"``, scales the channel of force.
    frequency : float, optional
        Of the motion [Hz], for envelopes; replaces a column of frequencies.
    reference : float or str, optional
        For envelopes in decibels, volts, watts or relative: the amplitude at 0 dB, or at 1 of the file's unit, in
        metres or as text such as ``"2.5 nm"``.

    Returns
    -------
    list of Record
        Naturally sorted by specimen (``run_2`` before ``run_10``).

    Raises
    ------
    InputError
        When anything cannot be used: the sentence names the file, the place in it, what was expected, and what to do.

    See Also
    --------
    write_records : writes them.
    condition : what follows.
    read_backbones : for backbones that were measured directly.

    Notes
    -----
    The format is told by the first bytes of a file. What is read of each, and what is refused: ``docs/formats.md``.

    A text file has one header line, then one line per sample; blank lines, lines starting with ``#`` and what a logger
    writes above the header are skipped. The separator is the first of semicolon, tab and comma that the header holds,
    else white space; decimal commas and separators of thousands are told apart by the whole file. Columns are ``time``
    [s] and one of ``displacement``, ``velocity``, ``acceleration``; a unit may follow in brackets (``time [ms]``,
    ``Acc (g)``, ``angle [deg]``) and SI is assumed, and noted, where none does. A further column ``specimen`` divides a
    file. Instead of a waveform there may be its ``envelope`` (amplitude, magnitude, power, the R of a lock-in) in a
    unit of motion, V, W, dB or dBm, and a column ``frequency`` beside it.
    """
    options = {"columns": columns, "quantity": quantity, "unit": unit, "sampling_rate": sampling_rate}
    of_envelopes = {"frequency": frequency, "reference": reference}
    return list(read_record_files(path, strict=True, sensitivity=sensitivity, **options, **of_envelopes).records)


@dataclass(frozen=True)
class RecordFiles:
    """What was read from files.

    Attributes
    ----------
    records : tuple of Record
        Naturally sorted by specimen.
    refused : tuple of str
        A sentence for each file that cannot be used.
    """

    records: tuple[Record, ...]
    refused: tuple[str, ...] = ()


def read_record_files(path: Any, *, strict: bool = False, **options: Any) -> RecordFiles:
    """Read as `read_records` does; leave out files of a folder that cannot be used, as long as half of them remain.

    Parameters
    ----------
    path
        As in `read_records`.
    strict : bool, default False
        Whether the first file that cannot be used ends it.
    **options
        ``columns``, ``quantity``, ``unit``, ``sampling_rate``, ``sensitivity``, ``frequency``, ``reference``, as in
        `read_records`.

    Returns
    -------
    RecordFiles

    Raises
    ------
    InputError
        When nothing or less than half can be used, or two files hold the same specimen.
    """
    names = ("columns", "quantity", "unit", "sampling_rate", "sensitivity", "frequency", "reference")
    reading = reading_of(*(options.get(name) for name in names))
    records: dict[str, Record] = {}
    refused: list[str] = []
    sources = _sources(path)
    for source in sources:
        try:
            found = list(_records_of(source, reading))
        except InputError as error:
            if strict or len(sources) == 1:
                raise
            refused.append(str(error))
            continue
        for record in found:
            if record.specimen in records:
                raise InputError(
                    f"{printable(record.source)}: specimen {shorten(record.specimen)!r} is also in "
                    f"{printable(records[record.specimen].source)}; rename one of them."
                )
            records[record.specimen] = record
    if len(refused) == len(sources):
        raise InputError(refused[0])
    if 2 * len(refused) > len(sources):
        raise InputError(
            f"{len(refused)} of {len(sources)} files cannot be used, more than half of them; the first: {refused[0]}"
        )
    for option in ("frequency", "reference"):
        if options.get(option) is not None and not any(record.is_envelope for record in records.values()):
            raise InputError(
                f"`{option}` is for envelopes, and {next(iter(records.values())).source} holds a waveform; drop it, or "
                "give `quantity=envelope`."
            )
    return RecordFiles(tuple(records[name] for name in sorted(records, key=natural_key)), tuple(refused))


def _sources(path: Any) -> list[Any]:
    """Return the files a path stands for, or what holds SEP-005 dictionaries as the only source."""
    return [path] if isinstance(path, Mapping | list | tuple) else list(list_tables(path, list_recordings))


def _records_of(source: Any, reading: Reading) -> Iterator[Record]:
    """Yield the records of a file, or of SEP-005 dictionaries."""
    if not isinstance(source, Path):
        where = "SEP-005"
        channels = channels_of_sep005(source, where)
        stem = channels[0].name if len(channels) == 1 else ""
        yield from _records_of_channels(Recording(Path(where), tuple(channels)), stem, reading)
        return
    recording = read_recording(source)
    if recording is None:
        yield from _records_of_table(read_table(source), reading)
    else:
        yield from _records_of_channels(recording, source.stem, reading)


def _records_of_table(table: Table, reading: Reading) -> Iterator[Record]:
    """Yield the records of one table."""
    specimens = find_specimens(table)
    picked = find_values(table, reading)
    picked = [
        (column, (falls_back_to(column, table.numbers(column), reading, table) if held == ENVELOPE else None) or held)
        for column, held in picked
    ]
    force = force_of(table, reading, [column for column, _ in picked])
    of_motion = _frequency_of(table, reading, picked)
    units = [
        envelope_column(table, column, reading)
        if quantity == ENVELOPE
        else unit_of_values(table, column, quantity, reading)
        for column, quantity in picked
    ]
    for specimen, rows in specimens.items():
        if len(rows) < MINIMUM_SAMPLES:
            whose = f" of specimen {shorten(specimen)!r}" if len(specimens) > 1 else ""
            table.fail(f"a record needs at least {MINIMUM_SAMPLES} samples, got {len(rows)}{whose}; record longer.")
    specimens, twice = _without_repeats(table, reading, specimens)
    times, time_notes = _times_of_table(table, reading, specimens)
    beside = {column.index for column in (of_motion, None if force is None else force.column) if column is not None}
    notes = table.notes + twice + time_notes + _choice(table, reading, [column for column, _ in picked], beside)
    frequency = None if of_motion is None else frequencies_of(table, of_motion, table.numbers(of_motion))
    for (column, quantity), how in zip(picked, units, strict=True):
        values = table.numbers(column)
        if not isinstance(how, EnvelopeColumn):
            values = scaled(values, how[0].factor)
        for specimen, rows in specimens.items():
            time = times[specimen]
            _check_finite(table, column, time, values[rows])
            source = table.name if len(specimens) == 1 else f"{table.name} (specimen {shorten(printable(specimen))})"
            whole = specimen if len(picked) == 1 else f"{specimen} {_label(column)}"
            if isinstance(how, EnvelopeColumn):
                here = reading.frequency if frequency is None else frequency[rows]
                yield envelope_record(whole, time, values[rows], here, how, source, notes)
                continue
            record = Record(whole, time, values[rows], quantity, how[0].si, source, notes + how[1])
            yield from [record] if force is None else after_hits(record, table.numbers(force.column)[rows], force)


def _without_repeats(
    table: Table, reading: Reading, specimens: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return the rows of each specimen without lines that repeat the one before, time and all, and a note on them.

    Where most lines do, it is no mistake of the logger but times of too few digits, which are refused later.
    """
    kept: dict[str, np.ndarray] = {}
    lines: list[int] = []
    has_time = reading.rate is None and _time_column(table, reading) is not None
    for name, rows in specimens.items():
        same = table.repeats(rows) if has_time else np.zeros(0, dtype=bool)
        if 0 < np.count_nonzero(same) <= _MOST_TWICE * len(rows):
            lines += [table.lines[row] for row in rows[1:][same]]
            rows = rows[np.concatenate([[True], ~same])]
        kept[name] = rows
    if not lines:
        return kept, ()
    places = ", ".join(map(str, lines[:_MOST_NAMED])) + (" ..." if len(lines) > _MOST_NAMED else "")
    what = "1 line repeats" if len(lines) == 1 else f"{len(lines)} lines repeat"
    return kept, (f"{what} the one before (line {places}) and {'was' if len(lines) == 1 else 'were'} dropped",)


def _times_of_table(
    table: Table, reading: Reading, specimens: Mapping[str, np.ndarray]
) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Return the sampling instants [s] of each specimen of a table, and notes."""
    rate = reading.rate
    notes: tuple[str, ...] = ()
    if rate is not None:
        notes = (f"time was counted at the given {rate:g} samples per second",)
    elif (column := _time_column(table, reading)) is not None:
        if is_clock(table.cells[column.index][0]):
            return _clock_times(table, column, specimens)
        unit = unit_of_time(table, column)
        notes = () if unit.factor == 1.0 else (f"time was converted from {unit.written} to s",)
        stamps = scaled(table.numbers(column), unit.factor)
        return {name: checked_time(table, column, stamps[rows], rows) for name, rows in specimens.items()}, notes
    elif table.rate is not None:
        rate, line = table.rate
        notes = (f"time was counted at {rate:g} samples per second, by the line {shorten(printable(line))!r}",)
    else:
        fail_without_time(table)
    return {name: np.arange(len(rows)) / rate for name, rows in specimens.items()}, notes


def _time_column(table: Table, reading: Reading) -> Column | None:
    """Return the time column by its name or, where none has such a name, by the times of a clock that it holds."""
    column = find_time(table, reading.time)
    if column is not None:
        return column
    clocks = [column for column in table.columns if is_clock(table.cells[column.index][0])]
    return clocks[0] if len(clocks) == 1 else None


def _clock_times(
    table: Table, column: Column, specimens: Mapping[str, np.ndarray]
) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Return the sampling instants [s] from a column of clock times, and notes."""
    times, notes = {}, []
    cells = table.cells[column.index]
    for name, rows in specimens.items():
        try:
            stamps, said = seconds_of([cells[row] for row in rows])
        except ClockError as error:
            row = rows[error.index]
            table.fail(
                f"{shorten(cells[row].strip())!r} {error}; write times as {shorten(cells[rows[0]].strip())!r}.",
                table.lines[row],
                column,
            )
        times[name] = checked_time(table, column, stamps, rows)
        notes += [note for note in said if note not in notes]
    return times, tuple(notes)


def _records_of_channels(recording: Recording, stem: str, reading: Reading) -> Iterator[Record]:
    """Yield the records of the channels of a file; one record is named by ``stem``, several by their channels too."""
    picked = find_values(recording, reading)
    columns = [column for column, _ in picked]
    force = force_of(recording, reading, columns)
    of_motion = _frequency_of(recording, reading, picked)
    beside = {column.index for column in (of_motion, None if force is None else force.column) if column is not None}
    chosen = _choice(recording, reading, columns, beside)
    for column, named in picked:
        channel = recording.channels[column.index]
        if channel.refusal:
            recording.refuse(channel)
        time, notes = _time_of_channel(recording, column, reading)
        notes = (*recording.notes, *notes, *chosen)
        source = recording.name if len(picked) == 1 else f"{recording.name} ({shorten(column.header)})"
        whole = stem if stem and len(picked) == 1 else f"{stem} {_label(column)}".strip()
        other = falls_back_to(column, channel.values, reading, recording) if named == ENVELOPE else None
        if named == ENVELOPE and other is None:
            how = envelope_column(recording, column, reading)
            frequency = _frequencies_of_channel(recording, of_motion, time.size, reading)
            yield envelope_record(whole, time, channel.values, frequency, how, source, notes)
            continue
        quantity = other or named
        unit, unit_notes = unit_of_values(recording, column, quantity, reading)
        values = scaled(channel.values, unit.factor)
        if np.isfinite(channel.values).all():  # else the record says which sample is not
            _check_finite(recording, column, values)
        record = Record(whole, time, values, quantity, unit.si, source, (*notes, *unit_notes))
        shown = None if force is None else recording.channels[force.column.index]
        is_beside = shown is not None and not shown.refusal and shown.values.size == values.size
        if shown is None or force is None or not is_beside or not np.isfinite(shown.values).all():
            yield record
        else:
            yield from after_hits(record, shown.values, force)


def _time_of_channel(recording: Recording, column: Column, reading: Reading) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the sampling instants [s] of a channel, and notes."""
    if reading.rate is not None:
        time = np.arange(recording.channels[column.index].values.size) / reading.rate
        return time, (f"time was counted at the given {reading.rate:g} samples per second",)
    found, notes = recording.time_of(column.index, reading)
    return fail_without_time(recording) if found is None else found, notes


def _frequencies_of_channel(
    recording: Recording, column: Column | None, size: int, reading: Reading
) -> FloatArray | float | None:
    """Return the frequency [Hz] of the motion in an envelope: of each sample, or one, or None where it is unknown."""
    if column is None:
        return reading.frequency
    channel = recording.channels[column.index]
    if channel.refusal:
        recording.refuse(channel)
    if channel.values.size not in (1, size):
        recording.fail(f"holds {channel.values.size} frequencies for {size} samples; give `frequency`.", None, column)
    found = frequencies_of(recording, column, channel.values)
    return found if found.size == size else float(found[0])


def _frequency_of(source: Source, reading: Reading, picked: Sequence[tuple[Column, str]]) -> Column | None:
    """Return the column of the motion's frequency where an envelope is read, else None."""
    if all(held != ENVELOPE for _, held in picked):
        return None
    return frequency_column(source, reading, {column.index for column, _ in picked})


def _choice(source: Source, reading: Reading, picked: Sequence[Column], beside: set[int]) -> tuple[str, ...]:
    """Return a sentence that says which channels were taken, where there are others than those used ``beside`` them."""
    used = {column.index for column in picked} | beside
    rest = [column for column in source.columns if column.index not in used and not is_no_signal(column, reading.time)]
    if not rest:
        return ()
    taken, left = (", ".join(repr(shorten(c.header)) for c in several[:_MOST_NAMED]) for several in (picked, rest))
    taken += f" and {len(picked) - _MOST_NAMED} more" if len(picked) > _MOST_NAMED else ""
    left += f" and {len(rest) - _MOST_NAMED} more" if len(rest) > _MOST_NAMED else ""
    many = "channels" if len(picked) > 1 else "channel"
    return (f"{many} {taken} {'were' if len(picked) > 1 else 'was'} taken, {left} not",)


def _check_finite(source: Source, column: Column, *arrays: FloatArray) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        source.fail("numbers overflow on conversion to SI units; check the unit in the header.", None, column)


def _label(column: Column) -> str:
    """Return the name of a channel as a part of a specimen's name."""
    return " ".join(printable(split_header(column.header)[0] or column.header).split())
