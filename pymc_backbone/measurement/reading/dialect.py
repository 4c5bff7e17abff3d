"""Which sign is the decimal mark in a text file, decided from the whole file: 1,234 may be 1.234 or 1234."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

_SIGNED = r"\s*[-+]?"
_EXPONENT = r"(?:[eE][-+]?[0-9]+)?\s*"
_NUMBER_WITH_COMMA = re.compile(rf"{_SIGNED}[0-9.]*,[0-9.,]*{_EXPONENT}")
_EITHER = re.compile(rf"{_SIGNED}[1-9][0-9]{{0,2}},[0-9]{{3}}\s*")
_GROUPED_BY_COMMA = re.compile(rf"{_SIGNED}[0-9]{{1,3}}(?:,[0-9]{{3}})+(?:\.[0-9]*)?\s*")
_GROUPED_BY_POINT = re.compile(rf"{_SIGNED}[1-9][0-9]{{0,2}}(?:\.[0-9]{{3}})+(?:,[0-9]*)?\s*")
_DECIMAL_COMMA = re.compile(rf"{_SIGNED}(?:[0-9]+|[0-9]{{1,3}}(?:\.[0-9]{{3}})+|),[0-9]*{_EXPONENT}")
_UNGROUPED = re.compile(rf"{_SIGNED}[0-9]{{4,}}(?:[.,][0-9]*)?{_EXPONENT}")
_DECIMAL_POINT = re.compile(rf"{_SIGNED}[0-9]*\.[0-9]*{_EXPONENT}")


class AmbiguousNumbersError(ValueError):
    """The cells do not say which sign is the decimal mark; holds the cell."""

    def __init__(self, cell: str, other: str = "") -> None:
        super().__init__(cell)
        self.cell, self.other = cell.strip(), other.strip()


@dataclass(frozen=True)
class Dialect:
    """How numbers are written: the decimal mark, and the sign between thousands or an empty text."""

    decimal: str = "."
    group: str = ""

    @property
    def note(self) -> str:
        """What was understood, as a sentence; empty for plain numbers."""
        parts = []
        if self.decimal == ",":
            parts.append("commas in numbers were read as decimal commas")
        if self.group:
            word = {",": "commas", ".": "points"}[self.group]
            parts.append(f"{word} between groups of three digits were read as separators of thousands")
        return "; ".join(parts)

    def plain(self, cell: str) -> str:
        """Return a cell as Python writes the number; a cell that does not fit is returned as it is."""
        if self.group and self.group in cell:
            grouped = _GROUPED_BY_COMMA if self.group == "," else _GROUPED_BY_POINT
            if not grouped.fullmatch(cell):
                return cell
            cell = cell.replace(self.group, "")
        return cell.replace(",", ".") if self.decimal == "," else cell


PLAIN = Dialect()


def decide(cells: Iterable[str]) -> Dialect:
    """Return how the numbers of a file are written.

    Parameters
    ----------
    cells : iterable of str
        All cells that may be numbers; read twice at most.

    Returns
    -------
    Dialect

    Raises
    ------
    AmbiguousNumbersError
        When a comma may be either, or is both in different cells.

    Notes
    -----
    A comma is decimal for certain where the digits around it cannot be a group of thousands (``0,5``, ``12,34``,
    ``1234,5``, ``1.234,5``), and a separator where it stands more than once or before a point (``1,234.5``). Where
    every comma could be both, ungrouped thousands elsewhere make it decimal and decimal points elsewhere a separator.

    Examples
    --------
    >>> decide(["0,5", "1,234"]), decide(["1,234", "0.5"])
    (Dialect(decimal=',', group=''), Dialect(decimal='.', group=','))
    """
    cells = list(cells)
    commas = [cell for cell in cells if "," in cell and _NUMBER_WITH_COMMA.fullmatch(cell)]
    if not commas:
        return PLAIN
    either = decimal = grouping = ""
    for cell in commas:
        if _EITHER.fullmatch(cell):
            either = either or cell
        elif _DECIMAL_COMMA.fullmatch(cell):
            decimal = decimal or cell
        elif _GROUPED_BY_COMMA.fullmatch(cell):
            grouping = grouping or cell
    if decimal and grouping:
        raise AmbiguousNumbersError(decimal, grouping)
    if decimal or grouping:
        return _with_points(cells, commas) if decimal else Dialect(".", ",")
    if not either:
        return PLAIN
    ungrouped = any(_UNGROUPED.fullmatch(cell) for cell in cells)
    pointed = any("." in cell and _DECIMAL_POINT.fullmatch(cell) for cell in cells)
    if ungrouped == pointed:
        raise AmbiguousNumbersError(either)
    return Dialect(",") if ungrouped else Dialect(".", ",")


def _with_points(cells: list[str], commas: list[str]) -> Dialect:
    """Return the dialect of a file with decimal commas, whose points may separate thousands."""
    if any("." in cell and _GROUPED_BY_POINT.fullmatch(cell) for cell in commas):
        return Dialect(",", ".")
    pointed = next((cell for cell in cells if "." in cell and _GROUPED_BY_POINT.fullmatch(cell)), None)
    if pointed is not None:
        raise AmbiguousNumbersError(commas[0], pointed)
    return Dialect(",")
