"""The records of a file of channels, each with a time of its own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..._common.checks import FloatArray
from ..._common.text import shorten
from .choice import check_finite, choose
from .columns import Reading, fail_without_time, scaled, unit_of_values
from .envelopes import envelope_column, envelope_record, frequencies_of
from .formats.channel import Recording
from .hammer import after_hits
from .headers import ENVELOPE
from .record import Record
from .tables import Column


def records_of_channels(recording: Recording, stem: str, reading: Reading) -> Iterator[Record]:
    """Yield the records of the channels of a file; one record is named by ``stem``, several by their channels too."""
    choice = choose(recording, reading, lambda column: _values_of(recording, column))
    picked, force = choice.picked, choice.force
    for column, quantity in picked:
        read = _values_of(recording, column)
        time, notes = _time_of_channel(recording, column, reading)
        notes = (*recording.notes, *notes, *choice.notes)
        source = recording.name if len(picked) == 1 else f"{recording.name} ({shorten(column.header)})"
        whole = choice.specimen(stem, column)
        if quantity == ENVELOPE:
            how = envelope_column(recording, column, reading)
            frequency = _frequencies_of_channel(recording, choice.of_motion, time.size, reading)
            yield envelope_record(whole, time, read, frequency, how, source, notes)
            continue
        unit, unit_notes = unit_of_values(recording, column, quantity, reading)
        values = scaled(read, unit.factor)
        if np.isfinite(read).all():  # else the record says which sample is not
            check_finite(recording, column, values)
        record = Record(whole, time, values, quantity, unit.si, source, (*notes, *unit_notes))
        shown = None if force is None else recording.channels[force.column.index]
        is_beside = shown is not None and not shown.refusal and shown.values.size == values.size
        if shown is None or force is None or not is_beside or not np.isfinite(shown.values).all():
            yield record
        else:
            yield from after_hits(record, shown.values, force)


def _time_of_channel(recording: Recording, column: Column, reading: Reading) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the sampling instants [s] of a channel, and notes."""
    if reading.rate is not None:
        time = np.arange(recording.channels[column.index].values.size) / reading.rate
        return time, (f"time was counted at the given {reading.rate:g} samples per second",)
    found, notes = recording.time_of(column.index, reading)
    return fail_without_time(recording) if found is None else found, notes


def _frequencies_of_channel(
    recording: Recording, column: Column | None, size: int, reading: Reading
) -> FloatArray | float | None:
    """Return the frequency [Hz] of the motion in an envelope: of each sample, or one, or None where it is unknown."""
    if column is None:
        return reading.frequency
    read = _values_of(recording, column)
    if read.size not in (1, size):
        recording.fail(f"holds {read.size} frequencies for {size} samples; give `frequency`.", None, column)
    found = frequencies_of(recording, column, read)
    return found if found.size == size else float(found[0])


def _values_of(recording: Recording, column: Column) -> FloatArray:
    """Return the values of a channel; one that cannot be used is refused."""
    channel = recording.channels[column.index]
    if channel.refusal:
        recording.refuse(channel)
    return channel.values


__all__ = ["records_of_channels"]
