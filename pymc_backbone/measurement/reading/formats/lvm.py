"""LabVIEW measurement files (``.lvm``): text with a header for the file and one for each segment.

Reference: National Instruments, *Specification for the LabVIEW Measurement File (.lvm)*,
https://www.ni.com/en/support/documentation/supplemental/06/specification-for-the-labview-measurement-file---lvm-.html
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from ...._common.checks import FloatArray, InputError
from ...._common.text import printable, shorten
from ..tables import read_text
from ..units import parse_unit
from .channel import Channel

MAGIC = b"LabVIEW Measurement"
_END = "***End_of_Header***"
_X = "X_Value"
_COMMENT = "Comment"
_SPECIAL = ("***Start_Special***", "***End_Special***")
_ABSOLUTE = 1e8
"""Times beyond this [s] are dates, which LabVIEW counts from 1904."""


@dataclass
class _Segment:
    """One segment: the header's entries, the names of the columns, and the rows with their lines."""

    header: dict[str, list[str]]
    names: list[str]
    rows: list[list[str]]
    lines: list[int]


class _File:
    """What is common to the segments of a file."""

    def __init__(self, path: Path) -> None:
        self.name = printable(path.name)
        text, self.notes = read_text(path, self.name)
        self.lines = re.split("\r\n|\n|\r", text)
        head: dict[str, str] = {}
        separator = "\t"
        for number, line in enumerate(self.lines[1:], start=2):  # noqa: B007
            if line.startswith("Separator"):
                separator = "," if "comma" in line.lower() or line[9:10] == "," else "\t"
            if line.strip().startswith(_END):
                break
            key, _, value = line.strip().partition("\t" if "\t" in line else separator)
            head[key.strip().lower()] = value.strip(" \t,")
        else:
            self.fail(f"the line {_END} is missing", None)
        self.separator, self.begin = separator, number
        self.decimal = "," if head.get("decimal_separator", ".").startswith(",") or "," in self._decimal() else "."
        self.x_columns = head.get("x_columns", "One").lower()
        if self.decimal == "," and self.separator == ",":
            self.fail("both the separator and the decimal mark are commas", None)
        if self.decimal == ",":
            self.notes += ("commas in numbers were read as decimal commas",)

    def _decimal(self) -> str:
        line = next((line for line in self.lines[:40] if line.startswith("Decimal_Separator")), "")
        return line[len("Decimal_Separator") + 1 :].strip()[:1]

    def fail(self, what: str, line: int | None) -> NoReturn:
        place = self.name if line is None else f"{self.name}, line {line}"
        raise InputError(f"{place}: {what}; save the measurement again, or export it as CSV.")

    def number(self, cell: str, line: int, column: str) -> float:
        """Return a cell as a number, or raise at its line."""
        text = cell.strip()
        try:
            if "," in text and self.decimal == ".":
                raise ValueError(text)
            return float(text.replace(",", "."))
        except ValueError:
            self.fail(f"expected a number in column {shorten(column)!r}, got {shorten(text)!r}", line)

    def segments(self) -> list[_Segment]:
        """Return the segments, each with a header of its own or with that of the one before."""
        found: list[_Segment] = []
        header: dict[str, list[str]] = {}
        is_data = is_special = False
        for number in range(self.begin, len(self.lines)):
            line = self.lines[number]
            cells = line.split(self.separator)
            if line.strip().startswith(_SPECIAL):
                is_special = line.strip().startswith(_SPECIAL[0])
            elif is_special or line.strip().startswith(_END):
                continue
            elif not line.strip(self.separator + " "):
                header, is_data = ({}, False) if is_data else (header, False)
            elif cells[0].strip() == _X:
                names = [cell.strip() for cell in cells]
                found.append(_Segment(header, names, [], []))
                is_data = True
            elif is_data and not _is_header_line(cells[0]):
                found[-1].rows.append(cells)
                found[-1].lines.append(number + 1)
            else:
                header, is_data = (header, False) if not is_data else ({}, False)
                header[cells[0].strip().lower()] = cells[1:]
        return [segment for segment in found if segment.rows]


def _is_header_line(cell: str) -> bool:
    return bool(re.fullmatch(r"[A-Za-z][A-Za-z_0-9 ]+", cell.strip()))


def read_lvm(path: Path) -> tuple[list[Channel], list[str]]:
    """Return the channels of a file, and notes.

    Parameters
    ----------
    path : Path
        A file that begins with `MAGIC`.

    Returns
    -------
    list of Channel, list of str

    Raises
    ------
    InputError
        When the file is not as the specification says; file and line are named.

    Notes
    -----
    Sampling instants are ``X0`` and ``Delta_X`` of the segment's header where they agree with the column of X values
    (printed with few digits) or there is none, else that column. Segments that continue one another are joined;
    otherwise those after the first carry their number in the name.
    """
    file = _File(path)
    segments = file.segments()
    if not segments:
        file.fail("there are no samples below the header", None)
    joined: dict[str, Channel] = {}
    for k, segment in enumerate(segments, start=1):
        for channel in _channels(file, segment):
            before = joined.get(channel.name)
            if before is None:
                joined[channel.name] = channel
            elif (whole := _joined(before, channel)) is not None:
                joined[channel.name] = whole
            else:
                name = f"{channel.name} segment {k}"
                joined[name] = replace(channel, name=name, group=f"{channel.group} {k}")
    notes = [f"{len(segments)} segments were read"] if len(segments) > 1 else []
    return list(joined.values()), [*file.notes, *notes]


def _channels(file: _File, segment: _Segment) -> list[Channel]:
    """Return the channels of a segment."""
    dimension = _first(segment.header.get("x_dimension", []))
    if dimension and dimension.lower() != "time":
        file.fail(f"the samples are over {shorten(printable(dimension))!r}, expected time", segment.lines[0])
    columns = [i for i, name in enumerate(segment.names) if name not in (_X, _COMMENT, "")]
    channels = []
    for order, column in enumerate(columns):
        name = segment.names[column]
        cells = [row[column].strip() if column < len(row) else "" for row in segment.rows]
        while cells and not cells[-1]:  # channels of one segment may differ in length
            cells.pop()
        if not cells:
            continue
        values = np.array([file.number(cell, line, name) for cell, line in zip(cells, segment.lines, strict=False)])
        stamps = _stamps(file, segment, column, len(cells))
        begin, step = (_entry(file, segment, key, order, column, len(columns)) for key in ("x0", "delta_x"))
        channel = Channel(name, values, _unit(segment, order, column, len(columns)))
        channels.append(_with_time(channel, stamps, 0.0 if begin is None else begin, step))
    return channels


def _first(cells: Sequence[str]) -> str:
    return next((cell.strip() for cell in cells if cell.strip()), "")


def _cell(segment: _Segment, key: str, order: int, column: int, count: int) -> str:
    """Return the entry of a header line for a channel: by order where there is one for each, else by its column."""
    cells = segment.header.get(key, [])
    filled = [cell.strip() for cell in cells if cell.strip()]
    if len(filled) == count:
        return filled[order]
    return cells[column - 1].strip() if 0 < column <= len(cells) else ""


def _unit(segment: _Segment, order: int, column: int, count: int) -> str | None:
    text = _cell(segment, "y_unit_label", order, column, count)
    known = any(parse_unit(text, kind) for kind in ("displacement", "velocity", "acceleration")) if text else False
    # LabVIEW writes Volts where nobody chose a unit
    return None if text.lower() in ("", "volts", "v", "none") and not known else text


def _entry(file: _File, segment: _Segment, key: str, order: int, column: int, count: int) -> float | None:
    text = _cell(segment, key, order, column, count)
    if not text:
        return None
    value = file.number(text, max(segment.lines[0] - 1, 1), key)
    if not np.isfinite(value) or (key == "delta_x" and value <= 0.0):
        file.fail(f"expected a finite {key} above zero, got {shorten(text)!r}", segment.lines[0])
    return value


def _stamps(file: _File, segment: _Segment, column: int, count: int) -> FloatArray | None:
    """Return the X values of a channel: the nearest column of them to its left, or None where it is empty."""
    if file.x_columns.startswith("no"):
        return None
    x = max((i for i, name in enumerate(segment.names[:column]) if name == _X), default=0)
    cells = [row[x].strip() if x < len(row) else "" for row in segment.rows[:count]]
    if not any(cells):
        return None
    return np.array([file.number(cell, line, _X) for cell, line in zip(cells, segment.lines, strict=False)])


def _with_time(channel: Channel, stamps: FloatArray | None, begin: float, step: float | None) -> Channel:
    """Return the channel with its sampling instants; dates are counted from the first sample."""
    if stamps is not None and step is not None:
        counted = begin + step * np.arange(stamps.size)
        if np.abs((stamps - stamps[0]) - (counted - counted[0])).max() < 0.5 * step:
            stamps, begin = None, float(begin if abs(begin) < _ABSOLUTE else 0.0)
    if stamps is None:
        return channel if step is None else replace(channel, step=step, begin=begin if abs(begin) < _ABSOLUTE else 0.0)
    return replace(channel, stamps=stamps - stamps[0] if abs(stamps[0]) > _ABSOLUTE else stamps)


def _joined(first: Channel, second: Channel) -> Channel | None:
    """Return two pieces of a channel as one, or None where the second does not continue the first."""
    if first.unit != second.unit:
        return None
    values = np.concatenate([first.values, second.values])
    if first.step is not None and second.step is not None:
        gap = second.begin - (first.begin + first.step * first.values.size)
        is_next = first.step == second.step and abs(gap) < 0.01 * first.step
        return replace(first, values=values) if is_next else None
    if first.stamps is not None and second.stamps is not None and first.stamps.size > 1:
        gap = float(second.stamps[0] - first.stamps[-1])
        typical = float(np.median(np.diff(first.stamps)))
        is_next = 0.0 < gap < 1.5 * typical
        return replace(first, values=values, stamps=np.concatenate([first.stamps, second.stamps])) if is_next else None
    return None
