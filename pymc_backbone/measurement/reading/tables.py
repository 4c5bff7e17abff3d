"""Delimited text files to columns: encodings, separators, decimal commas, and errors that name the line."""

from __future__ import annotations

import codecs
import csv
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from ..._common.checks import FloatArray, InputError
from ..._common.text import natural_key, printable, shorten
from .dialect import PLAIN, AmbiguousNumbersError, Dialect, decide
from .long_tables import NumberCells, head_of, numbers_below
from .preamble import LONGEST, find_header, settings_above, stated_rate
from .units import UNITS, is_level_or_power, parse_unit, split_header

_SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma"}
_CONTROL = re.compile("[\x00-\x08\x0e-\x1f\x7f]")
_NO_HEADER = "reading"  # name of a column of numbers that has none
_MAXIMUM_BYTES = 2_000_000_000
_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


@dataclass(frozen=True)
class Column:
    """One column header: where it stands, its name and the unit it states."""

    index: int
    header: str
    name: str
    unit: str | None
    quantity: str | None = None
    """What it holds, where the file says so apart from name and unit."""
    cell: str = ""
    """Name of the cell array whose items are records of their own, this one among them; empty for any other column."""


@dataclass(frozen=True)
class Table:
    """The cells of one delimited text file, as text, with the line each row came from.

    Of a long file of nothing but numbers the cells are `NumberCells`.
    """

    path: Path
    columns: tuple[Column, ...]
    header_line: int
    cells: tuple[Sequence[str], ...]
    lines: Sequence[int]
    dialect: Dialect
    notes: tuple[str, ...]
    rate: tuple[float, str] | None = None
    """Sampling rate [Hz] stated above the table, and the line that states it."""
    separator: str = ","

    @property
    def name(self) -> str:
        """File name, as used in messages."""
        return printable(self.path.name)

    @property
    def found(self) -> str:
        """The column headers as text, for messages."""
        return ", ".join(repr(shorten(column.header)) for column in self.columns)

    def fail(self, message: str, line: int | None = None, column: Column | None = None) -> NoReturn:
        """Raise `InputError` with the place in front of ``message``."""
        place = self.name
        if line is not None:
            place += f", line {line}"
        if column is not None:
            place += f", column {shorten(column.header)!r}"
        raise InputError(f"{place}: {message}")

    def text(self, column: Column) -> tuple[str, ...]:
        """Return a column as stripped text."""
        return tuple(cell.strip() for cell in self.cells[column.index])

    def numbers(self, column: Column, rows: Sequence[int] | None = None) -> FloatArray:
        """Return a column as finite floats; on failure find the line and say what stands there."""
        cells = self.cells[column.index]
        if isinstance(cells, NumberCells):
            return cells.values if rows is None else cells.values[rows]
        if rows is not None:
            cells = [cells[row] for row in rows]
        try:
            text = cells if self.dialect == PLAIN else [self.dialect.plain(cell) for cell in cells]
            values = np.array(list(map(float, text)), dtype=np.float64)
        except ValueError:
            values = None
        if values is not None and np.isfinite(values).all():
            return values
        lines = self.lines if rows is None else [self.lines[row] for row in rows]
        self._blame(column, cells, lines)

    def repeats(self, rows: np.ndarray) -> NDArray[np.bool_]:
        """Return for each row but the first whether it holds what the row before it holds, cell by cell."""
        same = np.ones(max(len(rows) - 1, 0), dtype=bool)
        for cells in self.cells:
            if isinstance(cells, NumberCells):
                same &= np.diff(cells.values[rows]) == 0.0
            else:
                picked = [cells[row] for row in rows]
                same &= np.array([here == before for before, here in pairwise(picked)], dtype=bool)
        return same

    def _blame(self, column: Column, cells: Sequence[str], lines: Sequence[int]) -> NoReturn:
        """Raise the error for the first cell of a column that is no finite number."""
        for cell, line in zip(cells, lines, strict=True):
            number = self.dialect.plain(cell).strip()
            if not number:
                self.fail("the cell is empty, expected a number; cut the record there or fill the gap.", line, column)
            try:
                value = float(number)
            except ValueError:
                self.fail(f"expected a number, got {shorten(cell.strip())!r}; correct or remove it.", line, column)
            if not np.isfinite(value):
                self.fail(
                    f"expected a finite number, got {shorten(number)!r}; cut the record there or fill the gap.",
                    line,
                    column,
                )
        self.fail("expected numbers; check the column.", None, column)


def list_tables(path: str | os.PathLike[str], list_folder: Callable[[Path], list[Path]] | None = None) -> list[Path]:
    """Return the files a path stands for (a folder's or the file itself), naturally sorted.

    ``list_folder`` returns those of a folder; by default they are its CSV files.
    """
    try:
        root = Path(os.fspath(path))
        is_folder, exists = root.is_dir(), root.exists()
        files = (list_folder or _csv_files)(root) if is_folder else [root]
    except InputError:
        raise
    except (TypeError, ValueError):
        raise InputError(
            f"`path` must be the path of a file or of a folder of files, got {shorten(ascii(path))}."
        ) from None
    except OSError as error:
        raise InputError(f"{printable(str(path))}: cannot be read ({error.strerror}); check its permissions.") from None
    if not exists:
        raise InputError(f"{printable(str(root))}: there is no such file or folder; check the path.")
    if not files:
        what = ".csv file" if list_folder is None else "record (no .csv file, nor one of another known format)"
        raise InputError(f"{printable(str(root))}: the folder holds no {what}; {_folder_hint(root)}")
    return files


def _csv_files(root: Path) -> list[Path]:
    return sorted(filter(_is_table, root.iterdir()), key=lambda file: natural_key(file.name))


def _is_table(entry: Path) -> bool:
    return entry.suffix.lower() == ".csv" and not entry.name.startswith((".", "~")) and entry.is_file()


def _folder_hint(root: Path) -> str:
    """Return the remedy for a folder without CSV files."""
    below = sorted({file.parent.name for file in root.glob("*/*.[cC][sS][vV]")}, key=natural_key)
    if below:
        return f"its subfolders {', '.join(below[:5])} do: give one of them."
    return "put one CSV file per specimen into it."


def read_table(path: Path) -> Table:
    """Read a delimited text file with one header line into text cells, or raise `InputError`."""
    name = printable(path.name)
    text, notes = read_text(path, name)
    return _long_table(path, name, text, notes) or _table_of(path, name, text, notes)


def _long_table(path: Path, name: str, text: str, notes: tuple[str, ...]) -> Table | None:
    """Return the table of a long text that holds nothing but numbers below its head; None of any other."""
    end = head_of(text)
    if not end:
        return None
    try:
        head = _table_of(path, name, text[:end], notes)
        above = [head.numbers(column) for column in head.columns]
    except InputError:  # which the whole text may show in another light
        return None
    first = head.lines[0]
    is_whole = list(head.lines) == list(range(first, first + len(head.lines)))
    if head.dialect != PLAIN or not is_whole or not text[:end].splitlines()[-1].strip():
        return None
    below = numbers_below(text, end, head.separator, len(head.columns))
    if below is None:
        return None
    cells = tuple(NumberCells(np.concatenate([one, below[:, i]])) for i, one in enumerate(above))
    return replace(head, cells=cells, lines=range(first, first + len(cells[0])))


def _table_of(path: Path, name: str, text: str, notes: tuple[str, ...]) -> Table:
    """Return the table that a text holds."""
    kept: list[str] = []
    lines: list[int] = []
    every = re.split("\r\n|\n|\r", text)
    for number, line in enumerate(every, start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            kept.append(line)
            lines.append(number)
    if not kept:
        raise InputError(f"{name}: the file holds no data; expected a header line and one line per sample.")
    settings = settings_above(kept)
    if settings:
        rate = stated_rate([f"{key}: {value}" for key, value in settings.items()])
        notes += (f"lines {lines[0]} and {lines[1]} were read as settings: {shorten(', '.join(settings))}",)
        kept, lines = [_NO_HEADER, *kept[2:]], lines[1:]
    else:
        top = find_header(kept)
        rate = stated_rate(every[: min(lines[top], LONGEST) - 1])
        if top:
            skipped, were = ("the line", "was") if top == 1 else (f"the {top} lines", "were")
            notes += (f"{skipped} above the column headers in line {lines[top]} {were} skipped",)
            kept, lines = kept[top:], lines[top:]
    separator, separator_note = _sniff(kept[0], kept[1] if len(kept) > 1 else "")
    notes += separator_note
    rows = _split(kept, lines, separator, name)
    rows, trailing_note = _drop_trailing(rows)
    notes += trailing_note
    columns = _columns(rows[0], name, lines[0])
    first = 1
    if len(rows) > 1 and _is_units_row(rows[1], columns):
        columns = tuple(
            Column(c.index, c.header, c.name, u.strip("[]() ")) for c, u in zip(columns, rows[1], strict=True)
        )
        notes += ("the second line was read as units",)
        first = 2
    body, body_lines = rows[first:], lines[first:]
    for row, line in zip(body, body_lines, strict=True):
        if len(row) != len(columns):
            raise InputError(
                f"{name}, line {line}: expected {len(columns)} {_SEPARATORS.get(separator, 'space')}-separated values "
                f"as in the header, got {len(row)}; complete or remove the line."
            )
    if not body:
        raise InputError(f"{name}: there are no lines below the header; expected one line per sample.")
    cells = tuple(zip(*body, strict=True))
    dialect = _dialect(columns, cells, body_lines, name)
    notes += (dialect.note,) if dialect.note else ()
    return Table(path, columns, lines[0], cells, body_lines, dialect, notes, rate, separator)


def _dialect(columns: Sequence[Column], cells: Sequence[Sequence[str]], lines: Sequence[int], name: str) -> Dialect:
    """Return how the numbers of a table are written, or raise naming the first cell that leaves it open."""
    numeric = [texts for column, texts in zip(columns, cells, strict=True) if column.name.lower() != "specimen"]
    if not any("," in cell for texts in numeric for cell in texts):
        return PLAIN
    try:
        return decide(cell for texts in numeric for cell in texts)
    except AmbiguousNumbersError as error:
        row = next(i for i, row in enumerate(zip(*numeric, strict=True)) if error.cell in map(str.strip, row))
        what = f"and {shorten(error.other)!r} contradict each other" if error.other else "may be decimal or thousands"
        raise InputError(
            f"{name}, line {lines[row]}: {shorten(error.cell)!r} {what}, and nothing in the file decides which sign is "
            "the decimal mark; write the numbers with decimal points and without separators of thousands."
        ) from None


def read_text(path: Path, name: str) -> tuple[str, tuple[str, ...]]:
    """Return the text of a file and a note when it was not plain UTF-8."""
    try:
        if path.stat().st_size > _MAXIMUM_BYTES:
            raise InputError(f"{name}: the file is larger than 2 GB; cut it to the free decay.")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror}); check that it is a readable file.") from None
    if not raw.strip():
        raise InputError(f"{name}: the file is empty; expected a header line and one line per sample.")
    encoding = next((codec for mark, codec in _BOMS if raw.startswith(mark)), "utf-8")
    notes: tuple[str, ...] = ()
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        try:
            text = raw.decode("cp1252" if encoding == "utf-8" else encoding)
        except UnicodeDecodeError:
            raise InputError(
                f"{name}: is neither UTF-8 nor Windows-1252 text; export the record as a CSV text file in UTF-8."
            ) from None
        notes = ("the file is not UTF-8 and was read as Windows-1252",)
    if encoding.startswith(("utf-16", "utf-32")):
        notes = (f"the file was read as {encoding.upper()}",)
    if _CONTROL.search(text):
        raise InputError(f"{name}: looks like a binary file; export the record as a CSV text file.")
    return text, notes


def _sniff(header: str, following: str) -> tuple[str, tuple[str, ...]]:
    """Return the separator of a header line: the first of semicolon, tab, comma it holds, else white space."""
    for separator, word in _SEPARATORS.items():
        if separator in header:
            return separator, () if separator == "," else (f"values are separated by {word}s",)
    is_one_column = len(following.split()) == 1 and len(header.split()) == 2 and split_header(header)[1] is not None
    if len(header.split()) > 1 and not is_one_column:
        return " ", ("values are separated by spaces",)
    return ",", ()


def _split(kept: list[str], lines: list[int], separator: str, name: str) -> list[list[str]]:
    """Split lines into cells, with quotes where there are any."""
    if separator == " " and not any('"' in line for line in kept):
        return [line.split() for line in kept]
    try:
        rows = list(csv.reader(kept, delimiter=separator, skipinitialspace=True))
    except csv.Error as error:
        rows = []
        reason = str(error)
    else:
        reason = "a quotation mark is not closed"
    if len(rows) == len(kept):
        return rows
    for line, number in zip(kept, lines, strict=True):
        if len(line) > csv.field_size_limit() or line.count('"') % 2:
            raise InputError(f"{name}, line {number}: the line cannot be split into values ({reason}); correct it.")
    raise InputError(f"{name}: the lines cannot be split into values ({reason}); remove the quotation marks.")


def _drop_trailing(rows: list[list[str]]) -> tuple[list[list[str]], tuple[str, ...]]:
    """Drop an empty last column made by separators at the line ends."""
    width = max(map(len, rows))
    if width < 2 or any(len(row) == width and row[-1].strip() for row in rows):
        return rows, ()
    body = rows[1:] or rows
    if not all(len(row) == width for row in body):
        return rows, ()
    trimmed = [row[: width - 1] if len(row) == width else row for row in rows]
    return trimmed, ("an empty last column (separator at the line end) was dropped",)


def _columns(header: list[str], name: str, line: int) -> tuple[Column, ...]:
    """Return the columns of a header line, refusing one that holds numbers."""
    try:
        numbers = [float(cell.replace(",", ".")) for cell in header]
    except ValueError:
        numbers = []
    if numbers:
        raise InputError(
            f"{name}, line {line}: expected a header line such as 'time,displacement', got numbers; add the header."
        )
    return tuple(Column(i, cell.strip(), *split_header(cell)) for i, cell in enumerate(header))


def _is_units_row(row: list[str], columns: tuple[Column, ...]) -> bool:
    """Return whether a row holds units (some tools write them below the names)."""
    if len(row) != len(columns) or any(column.unit for column in columns):
        return False
    texts = [cell.strip().strip("[]() ") for cell in row]
    return all(
        text and (any(parse_unit(text, d) for d in UNITS) or is_level_or_power(text)) for text in texts
    ) and not _all_numbers(texts)


def _all_numbers(texts: Sequence[str]) -> bool:
    return all(re.fullmatch(r"[-+0-9.,eE ]+", text) for text in texts)
