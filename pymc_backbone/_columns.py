"""Which column of a table is time, which is the measured quantity, and in which units they are."""

from __future__ import annotations

import re

import numpy as np

from ._checks import FloatArray
from ._tables import Column, Table, printable, shorten
from ._units import Unit, dimension_of, require_unit

QUANTITIES: tuple[str, ...] = ("displacement", "velocity", "acceleration")
_WORDS = {
    "displacement": {"displacement", "disp", "deflection", "position", "angle", "rotation"},
    "velocity": {"velocity", "vel"},
    "acceleration": {"acceleration", "acc", "accel"},
}
_TIME_WORDS = {"time", "t", "timestamp", "seconds"}
SI_UNITS = {
    "displacement": ("m", "rad"),
    "velocity": ("m/s", "rad/s"),
    "acceleration": ("m/s^2", "rad/s^2"),
}


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


def _words(column: Column) -> list[str]:
    return re.findall(r"[a-z]+", column.name.lower())


def find_time(table: Table) -> Column:
    """Return the time column, or raise naming the columns found."""
    exact = [column for column in table.columns if column.name.lower().strip() in _TIME_WORDS]
    loose = [column for column in table.columns if "time" in _words(column) or "timestamp" in _words(column)]
    for found in (exact, loose):
        if len(found) == 1:
            return found[0]
        if len(found) > 1:
            names = ", ".join(repr(shorten(column.header)) for column in found)
            table.fail(f"expected one column 'time', found {names}; rename or remove the others.", table.header_line)
    table.fail(
        f"expected a column 'time', found {table.found}; name it in the header, or give `sampling_rate`.",
        table.header_line,
    )


def unit_of_time(table: Table, column: Column) -> Unit:
    """Return the unit of the time column, seconds where none is stated."""
    return require_unit(column.unit or "s", "time", f"{table.name}, column {shorten(column.header)!r}")


def _quantity_of(column: Column) -> str | None:
    """Return what a column holds by its name, else by its unit."""
    words = set(_words(column))
    if words & {"error", "se", "sd", "std"} or words & _TIME_WORDS or column.name.lower() == "specimen":
        return None
    matches = [name for name in reversed(QUANTITIES) if words & _WORDS[name]]
    if matches:
        # "angle velocity" is a velocity, "position acceleration" an acceleration
        return matches[0]
    return dimension_of(column.unit) if column.unit else None


def find_values(table: Table, quantity: str | None, wanted: str | None, unit_text: str | None) -> tuple[Column, str]:
    """Return the column to read and the quantity it holds."""
    if wanted is not None:
        key = str(wanted).strip().lower()
        hits = [column for column in table.columns if key in (column.header.lower(), column.name.lower())]
        if len(hits) != 1:
            table.fail(
                f"expected one column {shorten(str(wanted))!r}, found {table.found}; correct `column`.",
                table.header_line,
            )
        held = quantity or _quantity_of(hits[0]) or (dimension_of(unit_text) if unit_text else None)
        if held is None:
            table.fail(
                f"what column {shorten(hits[0].header)!r} holds is not known; give `quantity` "
                "(displacement, velocity or acceleration).",
                table.header_line,
            )
        return hits[0], held
    found = [(column, held) for column in table.columns if (held := _quantity_of(column)) is not None]
    picked = found if quantity is None else [(column, held) for column, held in found if held == quantity]
    if len(picked) == 1:
        return picked[0]
    if not picked:
        expected = f"a column '{quantity}'" if quantity else "a column 'displacement', 'velocity' or 'acceleration'"
        table.fail(
            f"expected {expected}, found {table.found}; name it in the header, or give `column` and `quantity`.",
            table.header_line,
        )
    names = ", ".join(repr(shorten(column.header)) for column, _ in picked)
    option = "`quantity`" if len({held for _, held in picked}) == len(picked) else "`column`"
    table.fail(f"expected one measured quantity, found {names}; choose one with {option}.", table.header_line)


def unit_of_values(table: Table, column: Column, quantity: str, unit_text: str | None) -> tuple[Unit, tuple[str, ...]]:
    """Return the unit of the value column and notes on what was assumed or converted."""
    where = f"{table.name}, column {shorten(column.header)!r}"
    if unit_text is not None:
        unit = require_unit(unit_text, quantity, "`unit`")
    elif column.unit is not None:
        unit = require_unit(column.unit, quantity, where)
    else:
        is_angle = bool({"angle", "rotation", "angular"} & set(_words(column)))
        si = SI_UNITS[quantity][1 if is_angle else 0]
        return Unit(si, 1.0, si), (f"the header states no unit of {quantity}: {si} was assumed",)
    if unit.factor == 1.0:
        return unit, ()
    return unit, (f"{quantity} was converted from {printable(unit.written)} to {unit.si}",)


def checked_time(table: Table, column: Column | None, stamps: FloatArray | None, rows: np.ndarray) -> FloatArray:
    """Return the time stamps of one specimen, or raise at the line where they do not increase."""
    assert stamps is not None and column is not None
    time = stamps[rows]
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
