"""Columns that hold an envelope: amplitude or power over time, made an amplitude in the best unit that is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import FloatArray, InputError
from ..._common.text import printable, shorten
from .columns import Reading, Source, waveform_of
from .headers import is_frequency, may_be_waveform
from .record import Record
from .sensitivity import Sensitivity
from .tables import Column
from .units import RELATIVE, EnvelopeUnit, parse_envelope_unit, require_unit

_CONSTANT = 1e-12  # relative range of a column of frequencies up to which it is a setting that was printed each time
_MOTION = ("m", "rad")


@dataclass(frozen=True)
class EnvelopeColumn:
    """How the values of a column become an amplitude.

    Attributes
    ----------
    column : Column
        Where they stand.
    unit : EnvelopeUnit
        Theirs, with the sensitivity or the reference in it.
    notes : tuple of str
        What was assumed or converted.
    """

    column: Column
    unit: EnvelopeUnit
    notes: tuple[str, ...]


def falls_back_to(column: Column, values: FloatArray, reading: Reading, source: Source) -> str | None:
    """Return which waveform a column holds that is an envelope by a name that loggers give waveforms, too.

    Parameters
    ----------
    column : Column
        An envelope by its name.
    values : (n,) array
        As the file has them: an envelope is nowhere negative.
    reading : Reading
        What the user said.
    source : Source
        The file.

    Returns
    -------
    str or None
        None where it is an envelope after all.
    """
    if reading.quantity is not None or not may_be_waveform(column.name) or not (values < 0.0).any():
        return None
    unit = parse_envelope_unit(reading.unit or column.unit or "1")
    if unit is not None and unit.law != "amplitude":
        return None
    sensor = reading.sensitivity_of(source, column)
    held = waveform_of(column) or (None if sensor is None else sensor.quantity)
    if held is None:
        source.fail(
            "has negative values, so it is no envelope; give `quantity` (displacement, velocity or acceleration), or "
            "`unit`.",
            None,
            column,
        )
    return held


def envelope_column(source: Source, column: Column, reading: Reading) -> EnvelopeColumn:
    """Return how an envelope's column becomes an amplitude; raise where its unit is unknown or contradicts the user."""
    written = reading.unit or column.unit
    where = "`unit`" if reading.unit else f"{source.name}, column {shorten(column.header)!r}"
    unit = parse_envelope_unit(written or "1")
    if unit is None:
        raise InputError(
            f"{where}: {printable(shorten(written or ''))!r} is not a known unit of an envelope, expected a length, an "
            "angle, a velocity, an acceleration, V, W, dB, dBm or dBV (Vrms, nm pp and the like too); convert the "
            "column or correct its header."
        )
    notes: tuple[str, ...] = () if written else ("the header states no unit of the envelope: it is taken as relative",)
    sensor = reading.sensitivity_of(source, column)
    if sensor is not None and reading.reference is not None:
        source.fail("has both a `sensitivity` and a `reference`; keep one.", None, column)
    if sensor is not None:
        return _by_sensitivity(source, column, unit, sensor, bool(written), notes)
    if reading.reference is not None:
        if unit.si in _MOTION or unit.order:
            source.fail(
                f"is in {printable(unit.written)} already, and `reference` is for an envelope without a unit of "
                "motion; drop it.",
                None,
                column,
            )
        value, si = reading.reference
        one = {"level": f"0 {unit.written}", "power": f"1 {unit.written}"}.get(unit.law, f"1 {unit.written}")
        per_one = value * (RELATIVE.get(unit.written.lower(), 1.0) if unit.si == "1" and unit.law == "amplitude" else 1)
        notes += (f"envelope was converted from {printable(unit.written)} to {si}: {one} is {value:.6g} {si}",)
        return EnvelopeColumn(column, EnvelopeUnit(unit.written, unit.law, per_one, si), notes)
    if unit.law != "amplitude" or unit.factor != 1.0:
        notes += (f"envelope was converted from {printable(unit.written)} to {_in_words(unit.si)}",)
    if unit.si not in _MOTION and not unit.order:
        notes += (
            f"the envelope is known in {_in_words(unit.si)} and not in metres: parameters of forces hold for an "
            "amplitude of 1 taken as 1 m; `sensitivity` (of volts) or `reference` (such as '2.5 nm') says how much it "
            "is",
        )
    return EnvelopeColumn(column, unit, notes)


def _in_words(si: str) -> str:
    return "relative amplitude" if si == "1" else si


def _by_sensitivity(
    source: Source, column: Column, unit: EnvelopeUnit, sensor: Sensitivity, is_stated: bool, notes: tuple[str, ...]
) -> EnvelopeColumn:
    """Return the column of a sensor's volts."""
    is_volts = unit.si == "V" or not is_stated
    if not is_volts:
        source.fail(
            f"is in {printable(unit.written)}, and `sensitivity` is for volts; give `reference` instead, the amplitude "
            f"at {'0' if unit.law == 'level' else '1'} {printable(unit.written)}.",
            None,
            column,
        )
    order = {"m/s": 1, "rad/s": 1, "m/s^2": 2, "rad/s^2": 2}.get(sensor.si, 0)
    made = replace(unit, factor=unit.factor / abs(sensor.volts), si=sensor.si, order=order)
    if not is_stated:
        notes = ("the header states no unit of the envelope: V was assumed",)
    name = unit.written if is_stated else "V"
    said = f"envelope was converted from {printable(name)} to {sensor.si} at {printable(sensor.written)}"
    return EnvelopeColumn(column, made, (*notes, said))


def frequency_column(source: Source, reading: Reading, used: set[int]) -> Column | None:
    """Return the column of the motion's frequency beside an envelope, None where there is none or it is replaced."""
    found = [column for column in source.columns if column.index not in used and is_frequency(column.name)]
    if reading.frequency is not None or not found:
        return None
    if len(found) > 1:
        names = ", ".join(repr(shorten(column.header)) for column in found)
        source.fail(
            f"expected one column 'frequency', found {names}; remove the others, or give `frequency`.",
            source.header_line,
        )
    return found[0]


def frequencies_of(source: Source, column: Column, values: FloatArray) -> FloatArray:
    """Return a column of frequencies [Hz], all positive."""
    where = f"{source.name}, column {shorten(column.header)!r}"
    found = values * require_unit(column.unit or "Hz", "frequency", where).factor
    bad = np.flatnonzero(~(found > 0.0))
    if bad.size:
        source.fail(
            f"a frequency must be positive, got {found[bad[0]]:.6g} Hz in sample {bad[0] + 1}; give the frequency of "
            "the motion itself, not its distance from another.",
            None,
            column,
        )
    return found


def envelope_record(
    specimen: str, time: FloatArray, values: FloatArray, frequency: FloatArray | float | None, how: EnvelopeColumn,
    source: str, notes: tuple[str, ...],
) -> Record:  # fmt: skip
    """Return the record of an envelope.

    Parameters
    ----------
    specimen, time, source, notes
        As in `Record`.
    values : (n,) array
        As the file has them.
    frequency : (n,) array, float or None
        Of the motion [Hz].
    how : EnvelopeColumn
        How they become amplitudes.

    Returns
    -------
    Record

    Raises
    ------
    InputError
        For negative amplitudes or powers, and a velocity or an acceleration without a frequency.
    """
    label = f"{source}, column {shorten(how.column.header)!r}"
    amplitude = how.unit.amplitudes(values)
    bad = np.flatnonzero(~(amplitude >= 0.0) | ~np.isfinite(amplitude))
    if bad.size:
        what = "a power" if how.unit.law == "power" else "an envelope"
        raise InputError(
            f"{label}: {what} must be finite and not negative, got {values[bad[0]]:.6g} at {time[bad[0]]:.6g} s; if "
            "this is the motion itself, give `quantity`, and if these are decibels, give `unit`."
        )
    notes = notes + how.notes
    if isinstance(frequency, np.ndarray) and np.ptp(frequency) <= _CONSTANT * frequency[0]:
        frequency = float(frequency[0])
        notes += (
            f"the frequency is {frequency:.9g} Hz in every line: it is taken as known, not as measured over the "
            "amplitude",
        )
    si = how.unit.si
    if how.unit.order:
        if frequency is None:
            raise InputError(
                f"{label}: is an envelope in {si}, which needs the frequency of the motion to become a displacement; "
                "give `frequency`, in Hz."
            )
        amplitude = amplitude / (2.0 * np.pi * np.asarray(frequency)) ** how.unit.order
        notes += (f"envelope was divided by the angular frequency{' squared' if how.unit.order == 2 else ''}",)
        si = si.partition("/")[0]
    return Record(specimen, time, amplitude, "envelope", si, source, notes, frequency=frequency)
