"""Which channels of a file are the measured ones, which is time, and in which units they are."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import NoReturn, Protocol

import numpy as np

from ..._common.checks import FloatArray, InputError, check_choice, check_positive
from ..._common.text import printable, shorten
from .headers import (
    ENVELOPE,
    ERROR_WORDS,
    FORCE_WORDS,
    QUANTITIES,
    READABLE,
    is_angle_name,
    is_envelope_name,
    is_frequency,
    is_time,
    mentions_time,
    quantity_of_name,
    words_of,
)
from .sensitivity import FORCE, Sensitivity, sensitivities_of
from .tables import Column, Table
from .units import Unit, amplitude_of, dimension_of, is_level_or_power, is_voltage, parse_unit, require_unit

SI_UNITS = {
    "displacement": ("m", "rad"),
    "velocity": ("m/s", "rad/s"),
    "acceleration": ("m/s^2", "rad/s^2"),
}
TIME_KEY = "time="


class Source(Protocol):
    """A file with named columns: a `Table`, or the channels of another format."""

    @property
    def name(self) -> str:
        """File name, as used in messages."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns, in the order of the file."""

    @property
    def header_line(self) -> int | None:
        """Line of the column headers, where there is such a line."""

    @property
    def found(self) -> str:
        """The column headers as text, for messages."""

    def fail(self, message: str, line: int | None = None, column: Column | None = None) -> NoReturn:
        """Raise `InputError` with the place in front of ``message``."""


@dataclass(frozen=True)
class Reading:
    """What the user said about the columns: names, the time column, quantity, unit, sampling rate [Hz], sensors.

    Of envelopes also the frequency of the motion [Hz] and the amplitude, with its unit, at 0 dB or at 1 of the file's.
    """

    columns: tuple[str, ...] = ()
    time: str | None = None
    quantity: str | None = None
    unit: str | None = None
    rate: float | None = None
    sensitivities: tuple[Sensitivity, ...] = ()
    frequency: float | None = None
    reference: tuple[float, str] | None = None

    def sensitivity_of(self, source: Source, column: Column, *, is_force: bool = False) -> Sensitivity | None:
        """Return the sensitivity of the sensor behind a column: its own, else that of all channels, else None."""
        of_all = None
        for item in self.sensitivities:
            if (item.quantity == FORCE) != is_force:
                continue
            if item.channel is None:
                of_all = item
            elif any(column.index == one.index for one in named_columns(source, item.channel, "sensitivity")):
                return item
        return of_all


def reading_of(
    columns: str | Sequence[str] | None,
    quantity: str | None,
    unit: str | None,
    sampling_rate: float | None,
    sensitivity: str | Sequence[str] | None = None,
    frequency: float | None = None,
    reference: float | str | None = None,
) -> Reading:
    """Check what the user said about the columns; an entry ``time=NAME`` of ``columns`` names the time column."""
    names = [columns] if isinstance(columns, str) else list(columns or ())
    if not all(isinstance(name, str) and name.strip() for name in names):
        raise InputError(f"`columns` must be names of columns, got {shorten(ascii(columns))}; give a list of texts.")
    times = [name[len(TIME_KEY) :].strip() for name in names if name.lower().startswith(TIME_KEY)]
    if len(times) > 1:
        raise InputError(f"`columns` names {len(times)} time columns; keep one.")
    return Reading(
        tuple(name.strip() for name in names if not name.lower().startswith(TIME_KEY)),
        times[0] if times else None,
        None if quantity is None else check_choice("quantity", quantity, READABLE),
        unit,
        None if sampling_rate is None else check_positive("sampling_rate", sampling_rate),
        sensitivities_of(sensitivity),
        None if frequency is None else check_positive("frequency", frequency),
        None if reference is None else amplitude_of(reference, "reference"),
    )


def find_specimens(table: Table) -> dict[str, np.ndarray]:
    """Return the rows of each specimen of a table: those of its ``specimen`` column, else all, named after the file."""
    columns = [column for column in table.columns if column.name.lower() == "specimen"]
    if len(columns) > 1:
        table.fail(f"expected one column 'specimen', found {len(columns)}; remove one.", table.header_line)
    if not columns:
        return {table.path.stem: np.arange(len(table.lines))}
    names = table.text(columns[0])
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        if not name:
            table.fail("the specimen's name is missing; fill it in.", table.lines[row], columns[0])
        rows.setdefault(name, []).append(row)
    return {name: np.array(picked) for name, picked in rows.items()}


def named_columns(source: Source, wanted: str, option: str = "columns") -> list[Column]:
    """Return the columns of a name, of a pattern such as ``acc*``, or of a number counted from 1."""
    key = wanted.strip().lower()
    hits = [column for column in source.columns if key in (column.header.lower(), column.name.lower())]
    if not hits:
        # a channel of a struct by its own name
        hits = [column for column in source.columns if key == _own_name(column)]
    if not hits and any(sign in key for sign in "*?"):
        hits = [
            column
            for column in source.columns
            if fnmatchcase(column.header.lower(), key) or fnmatchcase(_own_name(column), key)
        ]
        hits = [column for column in hits if not is_time(column.name) and not mentions_time(column.name)]
        if hits:
            return hits
    if not hits and key.isdecimal() and 1 <= int(key) <= len(source.columns):
        hits = [source.columns[int(key) - 1]]
    if len(hits) != 1:
        near = difflib.get_close_matches(key, [column.header.lower() for column in source.columns], n=1)
        hint = next((f" Did you mean {shorten(c.header)!r}?" for c in source.columns if [c.header.lower()] == near), "")
        source.fail(
            f"expected one column {shorten(wanted)!r}, found {source.found}; correct `{option}`.{hint}",
            source.header_line,
        )
    return hits


def _own_name(column: Column) -> str:
    """Return the name of a channel without that of the struct or group that holds it."""
    return column.header.lower().rpartition(".")[2]


def find_time(source: Source, wanted: str | None = None) -> Column | None:
    """Return the time column, None if there is none, or raise naming the columns that may be it."""
    if wanted is not None:
        return named_columns(source, wanted)[0]
    exact = [column for column in source.columns if is_time(column.name)]
    loose = [column for column in source.columns if mentions_time(column.name)]
    by_unit = [column for column in source.columns if column.unit and parse_unit(column.unit, "time")]
    for found in (exact, loose, by_unit):
        if len(found) == 1:
            return found[0]
        if len(found) > 1:
            names = ", ".join(repr(shorten(column.header)) for column in found[:9])
            source.fail(
                f"expected one column 'time', found {names}; rename or remove the others, or give `columns` "
                f"'{TIME_KEY}NAME'.",
                source.header_line,
            )
    return None


def fail_without_time(source: Source) -> NoReturn:
    """Raise that there is no time column, with the remedies."""
    source.fail(
        f"expected a column 'time', found {source.found}; name it in the header or with `columns` '{TIME_KEY}NAME', or "
        "give `sampling_rate`.",
        source.header_line,
    )


def unit_of_time(source: Source, column: Column) -> Unit:
    """Return the unit of the time column, seconds where none is stated."""
    return require_unit(column.unit or "s", "time", f"{source.name}, column {shorten(column.header)!r}")


def _quantity_of(column: Column) -> str | None:
    """Return what a column holds: as the file states it, else by its name, else by its unit."""
    if column.quantity is not None:
        return column.quantity if column.quantity in QUANTITIES else None
    words = set(words_of(column.name))
    if is_time(column.name) or mentions_time(column.name) or words & ERROR_WORDS or column.name.lower() == "specimen":
        return None
    if is_envelope_name(column.name) or is_level_or_power(column.unit):
        return ENVELOPE
    return waveform_of(column)


def waveform_of(column: Column) -> str | None:
    """Return which waveform a column holds by its name or else by its unit; None where neither says so."""
    return quantity_of_name(column.name) or (dimension_of(column.unit) if column.unit else None)


def find_values(source: Source, reading: Reading) -> list[tuple[Column, str]]:
    """Return the columns to read and the quantity each holds."""
    by_unit = None
    if reading.unit:
        by_unit = ENVELOPE if is_level_or_power(reading.unit) else dimension_of(reading.unit)
    if reading.columns:
        return _named_values(source, reading, by_unit)
    found = _found_values(source, reading)
    if reading.quantity is None:  # where the motion itself is there, its envelope or a power beside it is not asked for
        picked = [pair for pair in found if pair[1] != ENVELOPE] or found
    else:
        picked = [pair for pair in found if pair[1] == reading.quantity]
    if len(picked) == 1 or _is_one_cell(column for column, _ in picked):
        return picked
    of_all = next((item.quantity for item in reading.sensitivities if item.channel is None), None)
    held = reading.quantity or by_unit or (of_all if of_all in QUANTITIES else None)
    if not found and held:
        others = [column for column in source.columns if not is_no_signal(column, reading.time)]
        if held == ENVELOPE:
            others = [column for column in others if not is_frequency(column.name)]
        if len(others) == 1 or _is_one_cell(others):
            return [(column, held) for column in others]
    if not picked:
        expected = (
            f"a column '{reading.quantity}'"
            if reading.quantity
            else "a column 'displacement', 'velocity', 'acceleration' or 'envelope'"
        )
        of_volts = " (of volts: `sensitivity`)" if any(is_voltage(column.unit) for column in source.columns) else ""
        source.fail(
            f"expected {expected}, found {source.found}; name it in the header, or give `columns` and "
            f"`quantity`{of_volts}.",
            source.header_line,
        )
    names = ", ".join(repr(shorten(column.header)) for column, _ in picked[:9]) + (" ..." if len(picked) > 9 else "")
    option = "`quantity`" if len({held for _, held in picked}) == len(picked) else "`columns`"
    source.fail(f"expected one measured quantity, found {names}; choose with {option}.", source.header_line)


def _is_one_cell(columns: Iterable[Column]) -> bool:
    """Return whether columns are the items of one cell array, which are records of their own."""
    cells = {column.cell for column in columns}
    return len(cells) == 1 and "" not in cells


def _named_values(source: Source, reading: Reading, by_unit: str | None) -> list[tuple[Column, str]]:
    """Return the columns that the user names, and the quantity each holds."""
    picked: list[tuple[Column, str]] = []
    for wanted in reading.columns:
        for column in named_columns(source, wanted):
            sensor = reading.sensitivity_of(source, column)
            by_sensor = None if sensor is None else sensor.quantity
            held = reading.quantity or _quantity_of(column) or by_unit or by_sensor
            if held is None:
                source.fail(
                    f"what column {shorten(column.header)!r} holds is not known; give `quantity` "
                    "(displacement, velocity, acceleration or envelope), or `unit`.",
                    source.header_line,
                )
            if all(column.index != other.index for other, _ in picked):
                picked.append((column, held))
    return picked


def _found_values(source: Source, reading: Reading) -> list[tuple[Column, str]]:
    """Return the columns that hold motion by name, by unit, or as volts of a sensor, and the quantity each holds.

    Where the user gives sensitivities, columns of volts come before those that are in a unit of motion.
    """
    found = [(column, held) for column in source.columns if (held := _quantity_of(column)) is not None]
    if not reading.sensitivities:
        return found
    in_volts = []
    for column in source.columns:
        sensor = reading.sensitivity_of(source, column)
        if sensor is None or is_no_signal(column, reading.time) or names_force(column):
            continue
        known = _quantity_of(column)
        if is_voltage(column.unit) or (known and not column.unit) or sensor.channel is not None:
            in_volts.append((column, known or sensor.quantity))
    return in_volts or found


def names_force(column: Column) -> bool:
    """Return whether the name of a column says force or hammer."""
    return bool(FORCE_WORDS & set(words_of(column.name)))


def is_no_signal(column: Column, time: str | None) -> bool:
    """Return whether a column is time, the specimen's name, or a date."""
    name = column.name.lower()
    is_given = time is not None and time.lower() in (name, column.header.lower())
    return is_given or name in ("specimen", "date", "datum") or is_time(name) or mentions_time(name)


def unit_of_values(source: Source, column: Column, quantity: str, reading: Reading) -> tuple[Unit, tuple[str, ...]]:
    """Return the unit of the value column and notes on what was assumed or converted."""
    where = f"{source.name}, column {shorten(column.header)!r}"
    sensor = reading.sensitivity_of(source, column)
    if sensor is not None:
        return unit_of_sensor(source, column, quantity, sensor, reading.unit)
    if is_voltage(reading.unit or column.unit):
        source.fail(
            f"is a voltage ({printable(reading.unit or column.unit or '')}); give `sensitivity`, such as '10.2 mV/g'.",
            None,
            column,
        )
    if reading.unit is not None:
        unit = require_unit(reading.unit, quantity, "`unit`")
    elif column.unit is not None:
        unit = require_unit(column.unit, quantity, where)
    else:
        si = SI_UNITS[quantity][1 if is_angle_name(column.name) else 0]
        return Unit(si, 1.0, si), (f"the header states no unit of {quantity}: {si} was assumed",)
    if unit.factor == 1.0:
        return unit, ()
    return unit, (f"{quantity} was converted from {printable(unit.written)} to {unit.si}",)


def unit_of_sensor(
    source: Source, column: Column, quantity: str, sensor: Sensitivity, given: str | None
) -> tuple[Unit, tuple[str, ...]]:
    """Return the unit that a column of volts has by the sensitivity of its sensor, and notes."""
    if quantity != sensor.quantity:
        source.fail(
            f"holds {quantity}, and a `sensitivity` of {printable(sensor.written)} is that of a sensor of "
            f"{sensor.quantity}; correct one of them.",
            None,
            column,
        )
    written = given or column.unit or "V"
    volts = parse_unit(written, "voltage")
    if volts is None:
        source.fail(
            f"is in {printable(shorten(written))}, and `sensitivity` is for volts; drop it, or, if the samples are "
            "volts, give `unit` V.",
            None,
            column,
        )
    assumed = () if given or column.unit else (f"the header states no unit of {quantity}: V was assumed",)
    note = f"{quantity} was converted from {printable(written)} to {sensor.si} at {printable(sensor.written)}"
    return Unit(written, volts.factor / sensor.volts, sensor.si), (*assumed, note)


def scaled(values: FloatArray, factor: float) -> FloatArray:
    """Return values in SI units; what overflows or is no number is found, and named, by the checks that follow."""
    with np.errstate(over="ignore", invalid="ignore"):
        return values * factor


def checked_time(table: Table, column: Column, time: FloatArray, rows: np.ndarray) -> FloatArray:
    """Return the time stamps of one specimen, or raise at the line where they do not increase."""
    drop = np.flatnonzero(np.diff(time) <= 0.0)
    if not drop.size:
        return time
    at = int(drop[0])
    line, cell = table.lines[rows[at + 1]], table.cells[column.index][rows[at + 1]].strip()
    before = table.cells[column.index][rows[at]].strip()
    if time[at + 1] == time[at]:
        fraction = drop.size / time.size
        remedy = "print more digits of time or give `sampling_rate`" if fraction > 0.02 else "remove the repeated line"
        table.fail(f"time must increase, got {shorten(cell)} twice; {remedy}.", line, column)
    table.fail(
        f"time must increase, got {shorten(cell)} after {shorten(before)}; cut the file there, or, if it holds several "
        "specimens, add a column 'specimen'.",
        line,
        column,
    )
