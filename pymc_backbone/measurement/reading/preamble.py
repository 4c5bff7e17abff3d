"""What data loggers write above a table: where its header line is, and the sampling rate they state."""

from __future__ import annotations

import re
from collections.abc import Sequence

from .clock import is_clock, is_date
from .headers import RATE_WORDS, STEP_WORDS, is_time, key_of, mentions_time, quantity_of_name
from .units import dimension_of, parse_unit, split_header

LONGEST = 500
"""Lines above a table that are searched for its header."""
_CONFIRMED_BY = 3
_SPLITTERS = (";", "\t", ",", None)
_NUMBER = re.compile(r"[-+]?(?:[0-9]+[0-9.,]*|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?")
_STATED = re.compile(
    r"\s*[#\"']*\s*([^\d=:;,\t\"']+?)[\s\"']*[=:;,\t ]\s*[\"']?([-+0-9.,eE]+)\s*[\"']?\s*(k?Hz|[mun]?s)?\b"
)


def find_header(lines: Sequence[str]) -> int:
    """Return the index of the header line among the lines of a file without blank ones.

    It is the first line, unless that is not as wide as the first block of numbers and a line between them is, and
    names time, a quantity or a unit.
    """
    for index in range(1, min(len(lines) - _CONFIRMED_BY, LONGEST) + 1):
        for splitter in _SPLITTERS:
            width = _width(lines[index], splitter)
            if width and all(_width(line, splitter) == width for line in lines[index : index + _CONFIRMED_BY]):
                above = [
                    k
                    for k in range(index)
                    if _names_channels(_cells(lines[k], splitter) if width > 1 else [lines[k]], width)
                ]
                if above and above[-1] != 0:
                    return above[-1]
                return 0
    return 0


def settings_above(lines: Sequence[str]) -> dict[str, str]:
    """Return the settings that stand above one column of numbers without a header: a line of names, one of values.

    Empty for any other file.

    Examples
    --------
    >>> settings_above(["trigger, sample_rate", "90, 1000", "-90.4", "-90.6", "-90.6"])
    {'trigger': '90', 'sample_rate': '1000'}
    >>> settings_above(["time,x", "0,1", "1,2", "2,1", "3,0"])
    {}
    """
    below = lines[2 : 2 + _CONFIRMED_BY]
    if len(below) < _CONFIRMED_BY or not all(_width(line, None) == 1 for line in below):
        return {}
    for splitter in _SPLITTERS:
        names, values = (_cells(line, splitter) for line in lines[:2])
        is_named = len(names) == len(values) > 1 and not any(map(_is_datum, names))
        if is_named and all(map(_is_datum, values)) and not any(_width(line, splitter) for line in below if splitter):
            return dict(zip(names, values, strict=True))
    return {}


def stated_rate(lines: Sequence[str]) -> tuple[float, str] | None:
    """Return the sampling rate [Hz] that lines above a table state, and the line.

    Examples
    --------
    >>> stated_rate(["Operator: N. N.", "Sampling rate [Hz]: 2048"])
    (2048.0, 'Sampling rate [Hz]: 2048')
    """
    for line in lines:
        found = _STATED.match(re.sub(r"[\[(](k?Hz|[mun]?s)[\])]", " ", line, count=1))
        if found is None:
            continue
        unit = found.group(3) or (re.findall(r"[\[(](k?Hz|[mun]?s)[\])]", line) or [None])[0]
        key = key_of(found.group(1))
        try:
            value = float(found.group(2).replace(",", "."))
        except ValueError:
            continue
        if not 0.0 < value < float("inf"):
            continue
        if key in RATE_WORDS:
            frequency = parse_unit(unit or "Hz", "frequency")
            if frequency is not None:
                return value * frequency.factor, line.strip()
        elif key in STEP_WORDS | {"wfincrement", "deltax"}:
            step = parse_unit(unit or "s", "time")
            if step is not None:
                return 1.0 / (value * step.factor), line.strip()
    return None


def _cells(line: str, splitter: str | None) -> list[str]:
    cells = [cell.strip().strip("\"'") for cell in line.split(splitter)]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _width(line: str, splitter: str | None) -> int:
    """Return how many cells a line of numbers has, 0 for any other line."""
    cells = _cells(line, splitter)
    if len(cells) < 2 and splitter is not None:
        return 0
    return len(cells) if all(map(_is_datum, cells)) else 0


def _is_datum(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None or is_clock(cell) or is_date(cell)


def _names_channels(cells: Sequence[str], width: int) -> bool:
    if len(cells) != width or any(map(_is_datum, cells)):
        return False
    for cell in cells:
        name, unit = split_header(cell)
        if is_time(name) or mentions_time(name) or quantity_of_name(name) or (unit and dimension_of(unit)):
            return True
    return False
