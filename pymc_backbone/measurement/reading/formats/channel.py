"""What every reader of a format returns: the channels of a file, with their names, units, samples and instants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...._common.checks import FloatArray, InputError
from ...._common.text import printable, shorten
from ..columns import Reading, find_time, named_columns, scaled, unit_of_time
from ..tables import Column
from ..units import split_header

MAXIMUM_BYTES = 2_000_000_000
"""Largest file, and largest set of samples, that is read."""
MAXIMUM_CHANNELS = 10_000
LARGEST_COMPRESSION = 1100
"""Deflate makes nothing smaller than by a factor of 1032: a header that promises more lies."""
NO_MOTION = "other"
ITEM = "#"
"""Stands in a group before the number of an item of a cell array."""
_WITHOUT_MEANING = {"data", "values", "value", "signal", "samples", "y", "x"}


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel of a file.

    Attributes
    ----------
    name : str
        As the user may name it; a unit may follow as in ``acc [g]``.
    values : (n,) array
        Samples as they stand in the file, in ``unit``.
    unit : str or None
        As the file states it.
    quantity : str or None
        What the file says it measures: displacement, velocity, acceleration, or ``"other"``.
    group : str
        Channels of one group share their time channel.
    step, begin : float
        Interval of uniform sampling and time of the first sample [s]; None where there is no such interval.
    stamps : (n,) array or None
        Sampling instants [s].
    refusal : str
        Why it cannot be used, as the end of a sentence.
    cell : str
        Name of the cell array it is an item of, where each item is a record of its own.
    """

    name: str
    values: FloatArray = field(default_factory=lambda: np.empty(0))
    unit: str | None = None
    quantity: str | None = None
    group: str = ""
    step: float | None = None
    begin: float = 0.0
    stamps: FloatArray | None = None
    refusal: str = ""
    cell: str = ""

    @property
    def has_time(self) -> bool:
        """Whether its sampling instants are known without a time channel."""
        return self.step is not None or self.stamps is not None

    def column(self, index: int) -> Column:
        """Return how it is named and what it states, as a column of its file."""
        name, unit = split_header(self.name)
        parts = [part.partition(":")[0].rstrip("0123456789()") for part in name.split(".")]
        while len(parts) > 1 and parts[-1].lower() in _WITHOUT_MEANING:
            parts.pop()
        return Column(index, printable(self.name), parts[-1], self.unit or unit, self.quantity, self.cell)


@dataclass(frozen=True, eq=False)
class Recording:
    """The channels of one file and what was assumed while reading them."""

    path: Path
    channels: tuple[Channel, ...]
    notes: tuple[str, ...] = ()
    header_line: int | None = None

    def __post_init__(self) -> None:
        if not self.channels:
            self.fail("holds no channel of numbers; export time and the measured quantity as arrays.")
        if len(self.channels) > MAXIMUM_CHANNELS:
            self.fail(f"holds {len(self.channels)} channels, expected at most {MAXIMUM_CHANNELS}; export fewer.")
        refused = [channel for channel in self.channels if channel.refusal]
        if len(refused) == len(self.channels):
            self.refuse(refused[0])
        object.__setattr__(self, "channels", tuple(_with_unique_names(self.channels)))

    @property
    def name(self) -> str:
        """File name, as used in messages."""
        return printable(self.path.name)

    @property
    def columns(self) -> tuple[Column, ...]:
        """The channels as columns."""
        return tuple(channel.column(index) for index, channel in enumerate(self.channels))

    @property
    def found(self) -> str:
        """The names of the channels as text, for messages."""
        names = [repr(shorten(printable(channel.name))) for channel in self.channels]
        return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")

    def fail(self, message: str, line: int | None = None, column: Column | None = None) -> NoReturn:
        """Raise `InputError` with the place in front of ``message``."""
        place = self.name + ("" if line is None else f", line {line}")
        raise InputError(f"{place}{'' if column is None else f', channel {shorten(column.header)!r}'}: {message}")

    def refuse(self, channel: Channel) -> NoReturn:
        """Raise that a channel cannot be used."""
        raise InputError(f"{self.name}, channel {shorten(printable(channel.name))!r}: {channel.refusal}")

    def time_of(self, index: int, reading: Reading) -> tuple[FloatArray | None, tuple[str, ...]]:
        """Return the sampling instants [s] of a channel, or None where the file does not hold them, and notes."""
        channel = self.channels[index]
        if reading.time is not None:
            (column,) = named_columns(self, reading.time)[:1]
        elif channel.stamps is not None:
            return channel.stamps, ()
        elif channel.step is not None:
            if not 0.0 < channel.step < np.inf or not np.isfinite(channel.begin):
                self.fail(
                    f"states a sampling interval of {channel.step:g} s from {channel.begin:g} s, expected a positive "
                    "one; give `sampling_rate`.",
                    None,
                    self.columns[index],
                )
            return channel.begin + channel.step * np.arange(channel.values.size, dtype=np.float64), ()
        else:
            found = self._time_column(channel)
            if found is None:
                return None, ()
            column = found
        stamps = self.channels[column.index]
        if stamps.refusal:
            self.refuse(stamps)
        if stamps.values.size != channel.values.size:
            self.fail(
                f"holds {channel.values.size} samples but channel {shorten(column.header)!r} {stamps.values.size} "
                f"times; correct the file, or name its time with `columns` 'time=NAME'.",
                None,
                self.columns[index],
            )
        unit = unit_of_time(self, column)
        notes = () if unit.factor == 1.0 else (f"time was converted from {printable(unit.written)} to s",)
        return scaled(stamps.values, unit.factor), notes

    def _time_column(self, channel: Channel) -> Column | None:
        """Return the time channel of the group of a channel, or that of the whole file."""
        columns = self.columns
        for group in dict.fromkeys((channel.group, channel.group.partition(ITEM)[0], "")):
            near = [column for column in columns if self.channels[column.index].group == group]
            found = find_time(_Part(self, tuple(near)))
            if found is not None:
                return found
        return None


@dataclass(frozen=True)
class _Part:
    """Some of the columns of a recording."""

    recording: Recording
    columns: tuple[Column, ...]
    header_line: int | None = None

    @property
    def name(self) -> str:
        return self.recording.name

    @property
    def found(self) -> str:
        return ", ".join(repr(shorten(column.header)) for column in self.columns[:12])

    def fail(self, message: str, line: int | None = None, column: Column | None = None) -> NoReturn:
        self.recording.fail(message, line, column)


def channel_of(name: str, values: NDArray[Any], **fields: Any) -> Channel:
    """Return a channel of real numbers, or one that says why it is none.

    Parameters
    ----------
    name : str
        As in `Channel`.
    values : (n,) array
        Numbers of any kind.
    **fields
        As in `Channel`.
    """
    if np.iscomplexobj(values):
        return Channel(
            name,
            refusal="holds complex numbers, expected the samples of a time history; export the real signal, not its "
            "spectrum or analytic signal.",
            **{key: fields[key] for key in ("group",) if key in fields},
        )
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return Channel(name, np.ascontiguousarray(values, dtype=np.float64), **fields)


def _with_unique_names(channels: tuple[Channel, ...]) -> list[Channel]:
    """Return the channels with those of the same name numbered, so that each can be chosen."""
    used: dict[str, int] = {}
    taken = {channel.name for channel in channels}
    result = []
    for channel in channels:
        count = used[channel.name] = used.get(channel.name, 0) + 1
        if count > 1:
            name = f"{channel.name} #{count}"
            while name in taken:
                name += "'"
            taken.add(name)
            channel = replace(channel, name=name)
        result.append(channel)
    return result


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file that is not too large, or raise `InputError`."""
    name = printable(path.name)
    try:
        if path.stat().st_size > MAXIMUM_BYTES:
            raise InputError(f"{name}: the file is larger than 2 GB; cut it to the free decay.")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror}); check that it is a readable file.") from None


def check_claim(claimed: int, held: int, what: str, name: str, *, is_compressed: bool = False) -> None:
    """Raise `InputError` when a header promises more bytes than the file can hold, before anything is allocated."""
    most = min(held * LARGEST_COMPRESSION, MAXIMUM_BYTES) if is_compressed else held
    if not 0 <= claimed <= most:
        raise InputError(
            f"{name}: {what} promises {claimed} bytes, but at most {most} can be there; the file is damaged or cut "
            "off, export it again."
        )


def missing_extra(name: str, package: str, extra: str, alternative: str) -> InputError:
    """Return the error that a format needs a package that is not installed."""
    return InputError(
        f"{name}: reading this format needs the package {package}; install it with "
        f"`pip install pymc-backbone[{extra}]`, or {alternative}."
    )


def text_of(values: Mapping[str, Any], *keys: str) -> str | None:
    """Return the first text that stands under one of the keys, or None."""
    for key in keys:
        value = values.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.strip():
            return value.strip()
    return None
