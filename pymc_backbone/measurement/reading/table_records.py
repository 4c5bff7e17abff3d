"""The records of a table: its columns, and its lines specimen by specimen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ..._common.checks import FloatArray
from ..._common.text import printable, shorten
from .choice import check_finite, choose
from .clock import ClockError, is_clock, seconds_of
from .columns import (
    Reading,
    checked_time,
    fail_without_time,
    find_specimens,
    find_time,
    scaled,
    unit_of_time,
    unit_of_values,
)
from .envelopes import EnvelopeColumn, envelope_column, envelope_record, frequencies_of
from .hammer import after_hits
from .headers import ENVELOPE
from .record import MINIMUM_SAMPLES, Record
from .tables import Column, Table

_MOST_NAMED = 6
_MOST_TWICE = 0.02  # share of the lines that may stand there twice


def records_of_table(table: Table, reading: Reading) -> Iterator[Record]:
    """Yield the records of one table."""
    specimens = find_specimens(table)
    choice = choose(table, reading, table.numbers)
    picked, force, of_motion = choice.picked, choice.force, choice.of_motion
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
    notes = table.notes + twice + time_notes + choice.notes
    frequency = None if of_motion is None else frequencies_of(table, of_motion, table.numbers(of_motion))
    for (column, quantity), how in zip(picked, units, strict=True):
        values = table.numbers(column)
        if not isinstance(how, EnvelopeColumn):
            values = scaled(values, how[0].factor)
        for specimen, rows in specimens.items():
            time = times[specimen]
            check_finite(table, column, time, values[rows])
            source = table.name if len(specimens) == 1 else f"{table.name} (specimen {shorten(printable(specimen))})"
            whole = choice.specimen(specimen, column)
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


__all__ = ["records_of_table"]
