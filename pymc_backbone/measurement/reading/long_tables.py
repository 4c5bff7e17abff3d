"""The lines of a long table of nothing but numbers, read as numbers: as texts, millions of cells fill the memory."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import overload

import numpy as np

from ..._common.checks import FloatArray

LONG = 4_000_000  # characters from which on a file is long
_HEAD = 100_000  # characters that are read as texts in any case: what stands above the numbers, and how they look
_CHUNK = 1_000_000


class NumberCells(Sequence[str]):
    """The cells of a column that are known to be finite numbers; each is a text again when it is looked at.

    Parameters
    ----------
    values : array of float, shape (n,)
        The numbers.
    """

    def __init__(self, values: FloatArray) -> None:
        self.values = values

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[str]: ...
    def __getitem__(self, index: int | slice) -> str | Sequence[str]:
        """Return a cell, or some of them."""
        return NumberCells(self.values[index]) if isinstance(index, slice) else repr(float(self.values[index]))

    def __len__(self) -> int:
        """Return the number of cells."""
        return int(self.values.size)


def head_of(text: str) -> int:
    """Return where the first lines of a long text end, 0 where it is not long."""
    end = text.find("\n", _HEAD) if len(text) > LONG else -1
    return end + 1


def numbers_below(text: str, begin: int, separator: str, width: int) -> FloatArray | None:
    """Return the numbers (n, width) of the lines from ``begin`` on, or None where they hold anything else.

    Anything else is a word, a quotation mark, a comment, a line that is empty or of another width, a number that is
    not finite: whoever asks then reads the text cell by cell, and says what is wrong and where.
    """
    count = 0

    def counted() -> Iterator[str]:
        nonlocal count
        for line in _lines(text, begin):
            count += 1
            yield line

    try:
        values = np.loadtxt(
            counted(), dtype=np.float64, comments=None, delimiter=None if separator == " " else separator, ndmin=2
        )
    except ValueError:
        return None
    is_whole = values.shape == (count, width) and np.isfinite(values).all()
    return values if is_whole else None


def _lines(text: str, begin: int) -> Iterator[str]:
    """Yield the lines of a text from ``begin`` on, as `re.split` would, without the empty ones at its end."""
    size, empty = len(text), 0
    while begin < size:
        end = text.find("\n", begin + _CHUNK) + 1 or size
        chunk = text[begin:end]
        for line in re.split("\r\n|\n|\r", chunk.removesuffix("\n").removesuffix("\r")):
            if not line.strip():
                empty += 1
                continue
            yield from [""] * empty  # skipped by NumPy, so that their number tells of them
            empty = 0
            yield line
        begin = end
