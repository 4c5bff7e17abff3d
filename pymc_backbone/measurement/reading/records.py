"""Measured free-decay records: reading files of many formats into SI units, and checking them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..._common.checks import InputError
from ..._common.text import natural_key, printable, shorten
from .channel_records import records_of_channels
from .columns import Reading, reading_of
from .formats import list_recordings, read_recording
from .formats.channel import Recording
from .formats.sep005 import channels_of_sep005
from .measured_backbones import read_backbones
from .record import Record
from .table_records import records_of_table
from .tables import list_tables, read_table

__all__ = ["read_backbones", "read_records"]


def read_records(
    path: str | os.PathLike[str] | Mapping[str, Any] | Sequence[Mapping[str, Any]],
    *,
    columns: str | Sequence[str] | None = None,
    quantity: str | None = None,
    unit: str | None = None,
    sampling_rate: float | None = None,
    sensitivity: str | Sequence[str] | None = None,
    frequency: float | None = None,
    reference: float | str | None = None,
) -> list[Record]:
    """Read measured free decays from files, convert them to SI units and check them.

    Parameters
    ----------
    path : str or path, or SEP-005 dictionaries
        A file, or a folder of files of one kind (one specimen each, named after the file): CSV and other delimited
        text, LabVIEW (``.lvm``), MATLAB (``.mat``, version 5 and 7.3), universal files (data set 58), NetCDF, NumPy
        (``.npz``), SEP-005 as JSON. Or, from Python, one SEP-005 dictionary or a list of them.
    columns : str or sequence of str, optional
        The channels to take: names as the file has them, without regard to case; patterns such as ``"acc*"``; or
        numbers counted from 1. ``"time=NAME"`` names the time channel. Each of several channels becomes a record.
    quantity : {"displacement", "velocity", "acceleration", "envelope"}, optional
        Which channel to take where a file has several, or what ``columns`` hold.
    unit : str, optional
        Unit of the channels, for files that do not state it or state it wrongly.
    sampling_rate : float, optional
        Samples per second [Hz]; replaces the time channel, which may then be missing.
    sensitivity : str or sequence of str, optional
        Of the sensors, for channels that are in volts: ``"10.2 mV/g"`` for all, ``"acc_x=10.2 mV/g"`` for one. A
        hammer's, ``"2.25 mV/N"``, scales the channel of force.
    frequency : float, optional
        Of the motion [Hz], for envelopes; replaces a column of frequencies.
    reference : float or str, optional
        For envelopes in decibels, volts, watts or relative: the amplitude at 0 dB, or at 1 of the file's unit, in
        metres or as text such as ``"2.5 nm"``.

    Returns
    -------
    list of Record
        Naturally sorted by specimen (``run_2`` before ``run_10``).

    Raises
    ------
    InputError
        When anything cannot be used: the sentence names the file, the place in it, what was expected, and what to do.

    See Also
    --------
    write_records : writes them.
    condition : what follows.
    read_backbones : for backbones that were measured directly.

    Notes
    -----
    The format is told by the first bytes of a file. What is read of each, and what is refused: ``docs/formats.md``.

    A text file has one header line, then one line per sample; blank lines, lines starting with ``#`` and what a logger
    writes above the header are skipped. The separator is the first of semicolon, tab and comma that the header holds,
    else white space; decimal commas and separators of thousands are told apart by the whole file. Columns are ``time``
    [s] and one of ``displacement``, ``velocity``, ``acceleration``; a unit may follow in brackets (``time [ms]``,
    ``Acc (g)``, ``angle [deg]``) and SI is assumed, and noted, where none does. A further column ``specimen`` divides a
    file. Instead of a waveform there may be its ``envelope`` (amplitude, magnitude, power, the R of a lock-in) in a
    unit of motion, V, W, dB or dBm, and a column ``frequency`` beside it.
    """
    options = {"columns": columns, "quantity": quantity, "unit": unit, "sampling_rate": sampling_rate}
    of_envelopes = {"frequency": frequency, "reference": reference}
    return list(read_record_files(path, strict=True, sensitivity=sensitivity, **options, **of_envelopes).records)


@dataclass(frozen=True)
class RecordFiles:
    """What was read from files.

    Attributes
    ----------
    records : tuple of Record
        Naturally sorted by specimen.
    refused : tuple of str
        A sentence for each file that cannot be used.
    """

    records: tuple[Record, ...]
    refused: tuple[str, ...] = ()


def read_record_files(path: Any, *, strict: bool = False, **options: Any) -> RecordFiles:
    """Read as `read_records` does; leave out files of a folder that cannot be used, as long as half of them remain.

    Parameters
    ----------
    path
        As in `read_records`.
    strict : bool, default False
        Whether the first file that cannot be used ends it.
    **options
        ``columns``, ``quantity``, ``unit``, ``sampling_rate``, ``sensitivity``, ``frequency``, ``reference``, as in
        `read_records`.

    Returns
    -------
    RecordFiles

    Raises
    ------
    InputError
        When nothing or less than half can be used, or two files hold the same specimen.
    """
    names = ("columns", "quantity", "unit", "sampling_rate", "sensitivity", "frequency", "reference")
    reading = reading_of(*(options.get(name) for name in names))
    records: dict[str, Record] = {}
    refused: list[str] = []
    sources = _sources(path)
    for source in sources:
        try:
            found = list(_records_of(source, reading))
        except InputError as error:
            if strict or len(sources) == 1:
                raise
            refused.append(str(error))
            continue
        for record in found:
            if record.specimen in records:
                raise InputError(
                    f"{printable(record.source)}: specimen {shorten(record.specimen)!r} is also in "
                    f"{printable(records[record.specimen].source)}; rename one of them."
                )
            records[record.specimen] = record
    if len(refused) == len(sources):
        raise InputError(refused[0])
    if 2 * len(refused) > len(sources):
        raise InputError(
            f"{len(refused)} of {len(sources)} files cannot be used, more than half of them; the first: {refused[0]}"
        )
    for option in ("frequency", "reference"):
        if options.get(option) is not None and not any(record.is_envelope for record in records.values()):
            raise InputError(
                f"`{option}` is for envelopes, and {next(iter(records.values())).source} holds a waveform; drop it, or "
                "give `quantity=envelope`."
            )
    return RecordFiles(tuple(records[name] for name in sorted(records, key=natural_key)), tuple(refused))


def _sources(path: Any) -> list[Any]:
    """Return the files a path stands for, or what holds SEP-005 dictionaries as the only source."""
    return [path] if isinstance(path, Mapping | list | tuple) else list(list_tables(path, list_recordings))


def _records_of(source: Any, reading: Reading) -> Iterator[Record]:
    """Yield the records of a file, or of SEP-005 dictionaries."""
    if not isinstance(source, Path):
        where = "SEP-005"
        channels = channels_of_sep005(source, where)
        stem = channels[0].name if len(channels) == 1 else ""
        yield from records_of_channels(Recording(Path(where), tuple(channels)), stem, reading)
        return
    recording = read_recording(source)
    if recording is None:
        yield from records_of_table(read_table(source), reading)
    else:
        yield from records_of_channels(recording, source.stem, reading)
