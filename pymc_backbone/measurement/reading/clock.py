"""Clock times and ISO timestamps in a time column, as seconds from the first sample."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from ..._common.checks import FloatArray, IntArray

_CLOCK = re.compile(
    r"\s*(?:(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})[T ,]\s*"
    r"|(?P<german>\d{1,2}\.\d{1,2}\.\d{2,4})[T ,]\s*"
    r"|(?P<slashed>\d{1,2}/\d{1,2}/\d{2,4})[T ,]\s*)?"
    r"(?:(?P<hour>\d{1,2}):)?(?P<minute>\d{1,2}):(?P<second>\d{2})(?:[.,](?P<part>\d{1,12}))?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>[Zz]|UTC|[-+]\d{2}:?\d{2}|[-+]\d{2})?\s*"
)
_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}|\d{1,2}\.\d{1,2}\.\d{4}|\d{1,2}/\d{1,2}/\d{4}")
_NANO = 10**9
HOUR, HALF_DAY, DAY = 3600 * _NANO, 43200 * _NANO, 86400 * _NANO


class ClockError(ValueError):
    """A cell is no time of a clock; holds its index."""

    def __init__(self, index: int, reason: str) -> None:
        super().__init__(reason)
        self.index = index


def is_clock(cell: str) -> bool:
    """Return whether a cell is a time of a clock, with or without a date.

    Examples
    --------
    >>> [is_clock(cell) for cell in ("12:03:04.125", "2025-03-01T12:03:04+01:00", "03:04,5", "1.25")]
    [True, True, True, False]
    """
    return _CLOCK.fullmatch(cell) is not None


def is_date(cell: str) -> bool:
    """Return whether a cell is a date without a time."""
    return _DATE.fullmatch(cell.strip()) is not None


def seconds_of(cells: Sequence[str]) -> tuple[FloatArray, tuple[str, ...]]:
    """Return clock times as seconds from the first, and notes.

    Parameters
    ----------
    cells : sequence of str
        ``12:03:04.125``, ``03:04.125`` (minutes and seconds), ``12:03:04.125 PM``, with a date before
        (``2025-03-01T``, ``01.03.2025``, ``3/1/2025``) and an offset from UTC behind (``Z``, ``+01:00``) where there is
        one; decimal point or comma. All of one kind.

    Returns
    -------
    (n,) array, tuple of str

    Raises
    ------
    ClockError
        At the first cell that is no such time, or of another kind than the first.

    Notes
    -----
    With an offset from UTC every instant is known. Without one, a clock that falls back by an hour or skips one as a
    new hour begins was set to summer or winter time; one without a date that begins again at zero has passed midnight
    (or, of minutes and seconds, a full hour). All else is left for the caller to judge: gaps, times that do not rise.

    Examples
    --------
    >>> seconds, notes = seconds_of(["23:59:59.5", "00:00:00.0", "00:00:00.5"])
    >>> seconds.tolist(), notes[1]
    ([0.0, 0.5, 1.0], 'the clock passed midnight')
    """
    first: tuple[str, bool, bool, bool] | None = None
    stamps = np.empty(len(cells), dtype=np.int64)
    for index, cell in enumerate(cells):
        match = _CLOCK.fullmatch(cell)
        if match is None:
            raise ClockError(index, "is no time of a clock")
        first = first or _kind(match)
        if _kind(match) != first:
            raise ClockError(index, "is written otherwise than the first")
        try:
            stamps[index] = _nanoseconds(match)
        except ValueError as error:
            raise ClockError(index, str(error)) from None
    has_date, has_hour, has_zone, _ = first or ("", True, False, False)
    notes = [f"times of a clock were read as seconds from the first, {cells[0].strip()}"]
    if not has_date or has_date == "slashed":
        # where a date is day/month or month/day nobody knows: it is the clock that counts
        stamps, said = _unrolled(stamps, DAY if has_hour else HOUR)
        notes += said
    if not has_zone and has_hour:
        stamps, said = _without_changes(stamps)
        notes += said
    return (stamps - stamps[0]) / _NANO, tuple(notes)


def _kind(match: re.Match[str]) -> tuple[str, bool, bool, bool]:
    """Return what a time is made of: kind of date, hours, offset from UTC, half of the day."""
    dated = "slashed" if match["slashed"] else "date" if match["year"] or match["german"] else ""
    return dated, match["hour"] is not None, match["zone"] is not None, match["half"] is not None


def _nanoseconds(match: re.Match[str]) -> int:
    """Return the time since year 1, or since midnight where no date is known [ns]."""
    hour, minute, second = int(match["hour"] or 0), int(match["minute"]), int(match["second"])
    if match["half"]:
        if not 1 <= hour <= 12:
            raise ValueError("has an hour that is not from 1 to 12")
        hour = hour % 12 + (12 if match["half"][0] in "pP" else 0)
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError("has an hour, minute or second out of range")
    total = ((hour * 60 + minute) * 60 + second) * _NANO + int((match["part"] or "0").ljust(9, "0")[:9])
    if match["zone"] and match["zone"] not in ("Z", "z", "UTC"):
        digits = match["zone"][1:].replace(":", "").ljust(4, "0")
        offset = (int(digits[:2]) * 60 + int(digits[2:])) * 60 * _NANO
        total -= offset if match["zone"][0] == "+" else -offset
    if match["year"]:
        total += _day(int(match["year"]), int(match["month"]), int(match["day"]))
    elif match["german"]:
        day, month, year = map(int, match["german"].split("."))
        total += _day(year if year > 99 else 2000 + year, month, day)
    return total


def _day(year: int, month: int, day: int) -> int:
    try:
        # of the years 1970 to 2261 nanoseconds fit into 64 bits; what counts are differences
        return (date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()) * DAY
    except ValueError:
        raise ValueError("has a date that does not exist") from None


def _unrolled(stamps: IntArray, period: int) -> tuple[IntArray, list[str]]:
    """Return times of a clock that begins again after ``period`` as times that go on."""
    back = np.diff(stamps) < -period // 2
    if not back.any():
        return stamps, []
    turns = np.concatenate([[0], np.cumsum(back)])
    what = "midnight" if period == DAY else "a full hour"
    count = int(back.sum())
    return stamps + turns * period, [f"the clock passed {what}{f' {count} times' if count > 1 else ''}"]


def _without_changes(stamps: IntArray) -> tuple[IntArray, list[str]]:
    """Return times without the hours by which a clock was set, at full hours, to summer or winter time."""
    steps = np.diff(stamps)
    typical = int(np.median(steps)) if steps.size else 0
    if typical <= 0 or typical > HOUR // 4:
        return stamps, []
    notes = []
    result = stamps.copy()
    for at in np.flatnonzero((np.abs(steps) > HOUR // 2) & (np.abs(steps) < 2 * HOUR)).tolist():
        # what was set shows a time within two samples of a full hour, one sample after the last but for the hour
        is_full = int(stamps[at + 1]) % HOUR <= 2 * typical
        for hour, season in ((HOUR, "summer"), (-HOUR, "winter")):
            if is_full and 0 < int(steps[at]) - hour <= 2 * typical:
                result[at + 1 :] -= hour
                notes.append(f"the clock was set to {season} time by an hour")
    return result, notes
