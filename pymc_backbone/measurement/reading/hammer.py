"""The force channel of a hammer test: which it is, and the free decays that its hits leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from ..._common.checks import FloatArray
from ..._common.text import printable, shorten
from .columns import Reading, Source, names_force, unit_of_sensor
from .hits import decays_of, is_force
from .record import MINIMUM_SAMPLES, Record
from .sensitivity import FORCE
from .tables import Column
from .units import is_voltage


@dataclass(frozen=True)
class Force:
    """The channel of a hammer's force, and what turns its samples into ``unit``."""

    column: Column
    factor: float
    unit: str


def force_of(source: Source, reading: Reading, picked: Sequence[Column]) -> Force | None:
    """Return the one channel of force beside those that are read, or None."""
    used = {column.index for column in picked}
    others = [column for column in source.columns if column.index not in used]
    named = [item for item in reading.sensitivities if item.quantity == FORCE]
    forces = []
    for column in others:
        sensor = reading.sensitivity_of(source, column, is_force=True)
        is_sensor = sensor is not None and (sensor.channel is not None or names_force(column))
        if is_force(column) or is_sensor or (names_force(column) and is_voltage(column.unit)):
            forces.append((column, sensor))
    if named and not forces:
        source.fail(
            f"has no channel of force for the `sensitivity` of {printable(named[0].written)}, found {source.found}; "
            f"name the channel as in 'NAME={printable(named[0].written)}', or drop it.",
            source.header_line,
        )
    if len(forces) != 1:
        return None
    ((column, sensor),) = forces
    if sensor is None:
        return Force(column, 1.0, column.unit or "")
    unit, _ = unit_of_sensor(source, column, FORCE, sensor, None)
    return Force(column, unit.factor, unit.si)


def after_hits(record: Record, force: FloatArray, channel: Force) -> Iterator[Record]:
    """Yield the free decays after the hits of a hammer, or the whole record where its force shows none."""
    label = shorten(channel.column.header)
    name = printable(record.source)
    for decay in decays_of(record.time, force * channel.factor, label, channel.unit, MINIMUM_SAMPLES, name):
        yield replace(
            record,
            specimen=f"{record.specimen} hit {decay.number}" if decay.number else record.specimen,
            time=record.time[decay.part].copy(),
            values=record.values[decay.part].copy(),
            notes=record.notes + decay.notes,
            starts_free=decay.part.start > 0,
        )
