"""From files, of records or of backbone tables, to measured backbones at levels, and what is said of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .._common.backbone_dataset import FREQUENCY, typical_frequency
from .._common.checks import InputError, check_choice, check_levels, check_motion
from .._common.text import likewise, printable
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from ..reporting.terminal import describe_reading

if TYPE_CHECKING:
    from ..measurement.reading.record import Record

Say = Callable[[str], None]
Progress = Callable[[str, float], None]
MOST_WARNINGS = 5
MOST_TABLE_LEVELS = 1000  # the covariance of more fills the memory and tells nothing: tables hold some tens of rows


@dataclass(frozen=True)
class Measured:
    """Measured backbones, and the records they came from (none if they were read as tables)."""

    backbones: xr.Dataset
    angular_frequency: float
    """Typical one [rad/s], to scale default priors with."""
    records: Sequence[Record] = field(default_factory=list)

    @property
    def notes(self) -> list[str]:
        """What was assumed or done."""
        return [str(note) for note in self.backbones.attrs.get("notes", [])]

    @property
    def amplitude_unit(self) -> str:
        """Unit of the levels: m or rad."""
        return str(self.backbones.attrs.get("amplitude_unit", "m"))

    def entries(self) -> dict[str, Any]:
        """Return what ``result.json`` says of them."""
        return {
            "observables": [str(name) for name in self.backbones["observable"].values],
            "levels": np.asarray(self.backbones["level"], dtype=float),
            "amplitude_unit": self.amplitude_unit,
            "specimens": [str(name) for name in self.backbones["specimen"].values],
            "notes": self.notes,
        }


def measure(
    path: str | os.PathLike[str],
    reading: Reading | None = None,
    measuring: Measuring | None = None,
    progress: Progress | None = None,
) -> Measured:
    """Read records, or tables of backbones, and return backbones at levels.

    Parameters
    ----------
    path : path-like
        File or folder.
    reading : Reading, optional
        How files are read, and whether they are tables.
    measuring : Measuring, optional
        How records become backbones; of tables only ``levels`` and ``observables``.
    progress : callable, optional
        Called with the stage and the fraction done.

    Returns
    -------
    Measured

    Raises
    ------
    InputError
        For files or records that cannot be used, or options of records that are given for tables.
    """
    reading = Reading() if reading is None else reading
    measuring = Measuring() if measuring is None else measuring
    if reading.is_table:
        return _measure_tables(path, reading, measuring)
    from ..measurement.reading.records import read_record_files

    # Before the compiled modules are loaded: errors in the files come at once.
    files = read_record_files(path, strict=measuring.strict, **reading.of_records)
    from ..measurement.extraction import measure_batch

    batch = measure_batch(files.records, measuring, refused=files.refused, progress=progress)
    return Measured(batch.backbones, 2.0 * np.pi * batch.extraction.frequency, files.records)


def _measure_tables(path: str | os.PathLike[str], reading: Reading, measuring: Measuring) -> Measured:
    from ..measurement.reading.measured_backbones import read_backbones

    for name, value in {
        **reading.of_records,
        "band": measuring.band,
        "start": measuring.start,
        "stop": measuring.stop,
        "floor": measuring.floor,
    }.items():
        if value is not None:
            raise InputError(f"`{name}` is for time histories, and `is_table` says these are not; drop one of them.")
    levels = measuring.levels
    if isinstance(levels, int):
        if levels > MOST_TABLE_LEVELS:
            raise InputError(f"`levels` of tables must be at most {MOST_TABLE_LEVELS}, got {levels}; ask for fewer.")
        reached = np.asarray(read_backbones(path)["level"])
        backbones = read_backbones(path, levels=np.geomspace(reached[0], reached[-1], levels))
    else:
        backbones = read_backbones(path, levels=None if levels is None else check_levels(levels))
    _check_tables(backbones, path)
    held = [str(name) for name in backbones["observable"].values]
    frequency = typical_frequency(backbones)
    if measuring.observables is not None:
        for name in measuring.observables:
            check_choice("observables", name, held)
        backbones = backbones.sel(observable=list(measuring.observables))
        if FREQUENCY not in measuring.observables and np.isfinite(frequency):
            backbones.attrs[FREQUENCY] = frequency
    return Measured(backbones, 2.0 * np.pi * frequency)


def _check_tables(backbones: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Raise where amplitudes or frequencies of tables are those of no structure."""
    top = float(np.asarray(backbones["level"])[-1])
    unit = str(backbones.attrs.get("amplitude_unit", "m"))
    frequency = typical_frequency(backbones)
    if np.isfinite(frequency) and unit in ("m", "rad"):
        check_motion(top, frequency, unit, printable(str(path)))


def say_reading(measured: Measured, say: Say) -> None:
    """Say what was read and assumed meanwhile."""
    text = describe_reading(measured.records)
    if text:
        say(text + "\n")


def say_warnings(notes: Sequence[str], say: Say) -> None:
    """Say which records were left out and why, what else the notes warn of, and whether records may be repeats."""
    left_out = [note for note in notes if note.startswith("left out: ")]
    others = likewise([note for note in notes if "warning: " in note and note not in left_out])
    alike = [note for note in notes if note.startswith("alike: ")]
    for warnings in (left_out, others, alike):
        for note in warnings[:MOST_WARNINGS]:
            say(note)
        if len(warnings) > MOST_WARNINGS:
            say(f"... and {len(warnings) - MOST_WARNINGS} more, in the notes of the result.")
