"""Which channels of a table or a file become records, and what is used beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray
from ..._common.text import printable, shorten
from .columns import Reading, Source, find_values, is_no_signal
from .envelopes import falls_back_to, frequency_column
from .hammer import Force, force_of
from .headers import ENVELOPE
from .tables import Column
from .units import split_header

_MOST_NAMED = 6


@dataclass(frozen=True)
class Choice:
    """What is read of a table or a file.

    Attributes
    ----------
    picked : list of (Column, str)
        Each channel that becomes a record, and what it holds.
    force : Force or None
        A hammer's, beside them.
    of_motion : Column or None
        The motion's frequency, where an envelope is read.
    notes : tuple of str
        A sentence that says which channels were taken, where there are others.
    """

    picked: list[tuple[Column, str]]
    force: Force | None
    of_motion: Column | None
    notes: tuple[str, ...]

    def specimen(self, stem: str, column: Column) -> str:
        """Return the specimen of a channel: named by ``stem``, and by the channel too where several are read."""
        return stem if stem and len(self.picked) == 1 else f"{stem} {_label(column)}".strip()


def choose(source: Source, reading: Reading, values_of: Callable[[Column], FloatArray]) -> Choice:
    """Return what is read of a source, whose channels hold ``values_of``."""
    picked = [
        (column, (falls_back_to(column, values_of(column), reading, source) if held == ENVELOPE else None) or held)
        for column, held in find_values(source, reading)
    ]
    columns = [column for column, _ in picked]
    force = force_of(source, reading, columns)
    of_motion = None
    if any(held == ENVELOPE for _, held in picked):
        of_motion = frequency_column(source, reading, {column.index for column in columns})
    beside = {column.index for column in (of_motion, None if force is None else force.column) if column is not None}
    return Choice(picked, force, of_motion, _taken(source, reading, columns, beside))


def check_finite(source: Source, column: Column, *arrays: FloatArray) -> None:
    """Refuse a channel whose numbers were finite in the file and are not in SI units."""
    if not all(np.isfinite(array).all() for array in arrays):
        source.fail("numbers overflow on conversion to SI units; check the unit in the header.", None, column)


def _taken(source: Source, reading: Reading, picked: Sequence[Column], beside: set[int]) -> tuple[str, ...]:
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


def _label(column: Column) -> str:
    """Return the name of a channel as a part of a specimen's name."""
    return " ".join(printable(split_header(column.header)[0] or column.header).split())


__all__ = ["Choice", "check_finite", "choose"]
