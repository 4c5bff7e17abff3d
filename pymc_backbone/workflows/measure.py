"""From a file or folder, of records or of backbone tables, to measured backbones at levels."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from .._common.checks import InputError, check_choice, check_levels

Levels = int | Sequence[float] | None
DEFAULT_OBSERVABLES = ("frequency", "damping")


@dataclass(frozen=True)
class Measured:
    """Measured backbones, and the records they came from (none if they were read as tables)."""

    backbones: xr.Dataset
    angular_frequency: float
    """Typical one [rad/s], to scale default priors with."""
    records: list[Any] = field(default_factory=list)

    @property
    def notes(self) -> list[str]:
        """What was assumed or done."""
        return [str(note) for note in self.backbones.attrs.get("notes", [])]

    @property
    def amplitude_unit(self) -> str:
        """Unit of the levels: m or rad."""
        return str(self.backbones.attrs.get("amplitude_unit", "m"))


def measure(
    path: str | os.PathLike[str],
    *,
    is_table: bool = False,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    levels: Levels = None,
    observables: Sequence[str] | None = None,
    progress: Callable[[str, float], None] | None = None,
    **reading: Any,
) -> Measured:
    """Read records, or tables of backbones, and return backbones at levels.

    Parameters
    ----------
    path : path-like
        File or folder.
    is_table : bool, optional
        Whether it holds backbone tables instead of time histories.
    band : (float, float), optional
        Frequency band to keep [Hz].
    start : float, optional
        Time of release [s]; found by default.
    levels : int or sequence of float, optional
        Number of levels, or the amplitudes [m or rad].
    observables : sequence of str, optional
        By default frequency and damping, or for tables all they hold.
    progress : callable, optional
        Called with the stage and the fraction done.
    **reading
        ``columns``, ``quantity``, ``unit``, ``sampling_rate``, as in `read_records`; not for tables.

    Returns
    -------
    Measured
    """
    if is_table:
        return _measure_tables(path, levels, observables, {"band": band, "start": start, **reading})
    from ..measurement.reading.records import read_records

    records = read_records(path, **reading)  # before the compiled modules are loaded: errors in the files come at once
    from ..measurement.extraction import extract_all
    from ..measurement.levels import backbones_at_levels, default_levels

    extraction = extract_all(records, band=band, start=start, progress=progress)
    cycles = extraction.cycles
    chosen = default_levels(cycles, levels) if isinstance(levels, int) else levels
    backbones = backbones_at_levels(cycles, chosen, observables or DEFAULT_OBSERVABLES, amplitude_unit=extraction.unit)
    backbones.attrs["notes"] = extraction.notes(backbones.attrs.get("notes", []))
    frequency = float(np.median(np.concatenate([item.frequency for item in cycles])))
    return Measured(backbones, 2.0 * np.pi * frequency, records)


def _measure_tables(
    path: str | os.PathLike[str],
    levels: Levels,
    observables: Sequence[str] | None,
    for_records: Mapping[str, Any],
) -> Measured:
    from ..measurement.reading.measured_backbones import read_backbones

    for name, value in for_records.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} is for time histories; drop it, or drop --backbones.")
    if isinstance(levels, int):
        reached = np.asarray(read_backbones(path)["level"])
        backbones = read_backbones(path, levels=np.geomspace(reached[0], reached[-1], levels))
    else:
        backbones = read_backbones(path, levels=None if levels is None else check_levels(levels))
    frequency = float(np.nanmedian(np.asarray(backbones["value"].sel(observable="frequency"))))
    if observables is not None:
        held = [str(name) for name in backbones["observable"].values]
        for name in observables:
            check_choice("observables", name, held)
        backbones = backbones.sel(observable=list(observables))
    return Measured(backbones, 2.0 * np.pi * frequency)
