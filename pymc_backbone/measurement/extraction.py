"""Records to the backbones of a batch: one road for all who need them.

Records are conditioned one after another, their cycles extracted, levels chosen, backbones taken at them. What cannot
be used is left out with its reason, as long as half of the records remain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from .._common.backbone_dataset import FREQUENCY
from .._common.checks import OBSERVABLES, InputError
from .._common.threads import in_threads
from .batch_levels import levels_for
from .conditioning.condition import condition
from .conditioning.conditioned import ConditionedRecord
from .conditioning.one_sensor import records_of_one_sensor
from .cycle_data import Cycles
from .cycles import extract_cycles
from .envelope import envelope_cycles
from .levels import backbones_at_levels
from .options import Measuring
from .outliers import Finding, find_outliers
from .reading.record import Record

DEFAULT_OBSERVABLES = ("frequency", "damping")
LEFT_OUT = "left out: "
"""What the note on a record that could not be used begins with."""
ALIKE = "alike: "
"""What the note on records that look like repeats of one structure begins with."""
REPEATS = 0.002
"""Relative standard deviation of frequency up to which they do: clamping and temperature make as much."""
LEAST_SHARE = 0.5
"""Share of the records that must remain: where most cannot be used, something is wrong with all of them."""
_AT_ONCE = 8  # records between two calls of what shows the progress


@dataclass(frozen=True)
class Extraction:
    """The records that could be used, their cycles, and why others could not.

    Attributes
    ----------
    records, cycles : tuples
        One each per specimen; no records where these are envelopes, which hold no waveform.
    unit : str
        Of the motion: m or rad; of envelopes that are not calibrated V, sqrt(W) or 1.
    refused : tuple of str
        A sentence for each record that was left out.
    """

    records: tuple[ConditionedRecord, ...]
    cycles: tuple[Cycles, ...]
    unit: str
    refused: tuple[str, ...] = ()

    @property
    def observables(self) -> tuple[str, ...]:
        """Those that every record tells."""
        held = [item.observables for item in self.cycles]
        offset = all(record.offset_is_measured for record in self.records)
        return tuple(name for name in OBSERVABLES if all(name in one for one in held) and (name != "offset" or offset))

    @property
    def frequency(self) -> float:
        """Typical frequency [Hz]."""
        return float(np.median(np.concatenate([item.frequency for item in self.cycles])))

    def notes(self, others: Sequence[str] = ()) -> list[str]:
        """Return what was assumed or done, the specimen in front of what is about one; then what ``others`` add."""
        notes, known = [f"{LEFT_OUT}{sentence}" for sentence in self.refused], set()
        for item in self.cycles:
            for note in item.notes:
                known.add(note)
                notes.append(note if note.startswith(f"{item.specimen}:") else f"{item.specimen}: {note}")
        return notes + [str(note) for note in others if note not in known]


@dataclass(frozen=True, eq=False)
class MeasuredBatch:
    """The backbones of a batch at levels, and what they come from.

    Attributes
    ----------
    backbones : xarray.Dataset
        As `backbones_at_levels` returns them; ``attrs["notes"]`` holds everything that was assumed, done or left out.
    extraction : Extraction
        Records and cycles, one each per specimen.
    outliers : tuple of Finding
        Specimens that do not seem to belong to the batch; they are in it all the same, and the notes warn of them.
    """

    backbones: xr.Dataset
    extraction: Extraction
    outliers: tuple[Finding, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What was assumed, done or left out."""
        return [str(note) for note in self.backbones.attrs["notes"]]


def measure_batch(
    records: Sequence[Record | ConditionedRecord],
    measuring: Measuring | None = None,
    *,
    every_observable: bool = False,
    whole_range: bool = False,
    refused: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> MeasuredBatch:
    """Return the backbones of records at levels.

    Parameters
    ----------
    records : sequence of Record or ConditionedRecord
        At least one.
    measuring : Measuring, optional
        Band, release and end, levels, observables, and whether one record that cannot be used ends it.
    every_observable : bool, optional
        Whether the observables, where none are named, are all that every record tells, the offset among them; else
        frequency and damping.
    whole_range : bool, optional
        As in `levels_for`.
    refused : sequence of str, optional
        A sentence for each file that could not be read: they count as records that cannot be used.
    progress : callable, optional
        Called with the stage and the fraction done, before every few records.

    Returns
    -------
    MeasuredBatch

    Raises
    ------
    InputError
        For records that cannot be used, records of different units, or levels that the decays do not bear.
    """
    measuring = Measuring() if measuring is None else measuring
    extraction = extract_all(
        records,
        band=measuring.band,
        start=measuring.start,
        stop=measuring.stop,
        floor=measuring.floor,
        strict=measuring.strict,
        refused=refused,
        progress=progress,
    )
    levels, said = levels_for(extraction.cycles, measuring.levels, whole_range=whole_range)
    observables = measuring.observables
    if observables is None:
        observables = [name for name in extraction.observables if every_observable or name in DEFAULT_OBSERVABLES]
    backbones = backbones_at_levels(extraction.cycles, levels, observables, amplitude_unit=extraction.unit)
    if not extraction.records:
        said = [*_of_envelopes(extraction), *said]
    outliers = find_outliers(extraction.cycles)
    said = [*(f"warning: {finding.sentence}" for finding in outliers), *_alike(backbones), *said]
    backbones.attrs["notes"] = [*extraction.notes(backbones.attrs.get("notes", [])), *said]
    return MeasuredBatch(backbones, extraction, tuple(outliers))


def _of_envelopes(extraction: Extraction) -> list[str]:
    """Say what envelopes do not tell."""
    if FREQUENCY in extraction.observables:
        return [
            "warning: envelopes with their frequency: damping and frequency were measured, the mid-line was not, so "
            "springs that are stiffer to one side show by their frequency alone"
        ]
    return [
        f"warning: only damping was measured: the envelopes have no frequency over the amplitude, and "
        f"{extraction.frequency:.6g} Hz is taken at every amplitude, so springs (hardening, softening, play) cannot be "
        "told; a column of frequencies in the files would show them"
    ]


def _alike(backbones: xr.Dataset) -> list[str]:
    """Say that records look like repeats of one structure, and what they are taken for; nothing where they do not."""
    if "frequency" not in backbones["observable"].values:
        return []
    values = backbones["value"].sel(observable="frequency").values
    held = values[:, np.isfinite(values).sum(axis=0) > 1]
    if len(values) < 2 or not held.size:
        return []
    scatter = float(np.max(np.nanstd(held, axis=0, ddof=1) / np.nanmean(held, axis=0)))
    if scatter > REPEATS:
        return []
    return [
        f"{ALIKE}the frequencies of the {len(values)} records differ by {100.0 * scatter:.2g} % (standard deviation) "
        "at most, as repeats of one structure do. Each counts as a specimen of its own; if they are repeats, the "
        "spread is that of testing, not of a batch, and the pooled likelihood infers one parameter set from all of them"
    ]


def extract_all(
    records: Sequence[Record | ConditionedRecord],
    *,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    stop: float | None = None,
    floor: float | None = None,
    strict: bool = False,
    refused: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> Extraction:
    """Condition records and extract their cycles.

    Parameters
    ----------
    records : sequence of Record or ConditionedRecord
        At least one.
    band, start, stop, floor
        As in `condition`.
    strict : bool, optional
        Whether one record that cannot be used ends it; otherwise it is left out, as long as half of them remain.
    refused : sequence of str, optional
        As in `measure_batch`.
    progress : callable, optional
        Called with the stage and the fraction done, before every few records and once they are conditioned.

    Returns
    -------
    Extraction

    Raises
    ------
    InputError
        For records that cannot be used (one with ``strict``, else more than half), or that are of different units.
    """
    envelopes = [item for item in records if isinstance(item, Record) and item.is_envelope]
    if envelopes and len(envelopes) < len(records):
        other = next(item for item in records if item not in envelopes)
        raise InputError(
            f"the records must all be waveforms or all be envelopes: {envelopes[0].source} holds an envelope, "
            f"{other.source} a waveform; put them into folders of their own."
        )
    if envelopes and band is not None:
        raise InputError("`band` is for waveforms, and these records are envelopes; drop it.")
    given, left_out = len(records) + len(refused), list(refused)
    one_must_do = strict or given == 1

    def stage(done: float) -> None:
        if progress is not None:
            progress("extracting cycles", done)

    def conditioned_record(item: Record | ConditionedRecord) -> ConditionedRecord:
        if not isinstance(item, Record):
            return item
        return condition(item, band=band, start=start, stop=stop, floor=floor)

    def cycles_of_envelope(item: Record | ConditionedRecord) -> Cycles:
        assert isinstance(item, Record)
        return envelope_cycles(item, start=start, stop=stop, floor=floor)

    conditioned: list[ConditionedRecord] = []
    if envelopes:
        pairs = _usable(records, cycles_of_envelope, one_must_do, left_out, stage)
        units = [item.unit for item, _ in pairs]
        cycles = [extracted for _, extracted in pairs]
    else:
        ready = _usable(records, conditioned_record, one_must_do, left_out, lambda done: stage(0.5 * done))
        together = records_of_one_sensor([record for _, record in ready])
        both = _usable(together, extract_cycles, one_must_do, left_out, lambda done: stage(0.5 + 0.5 * done))
        conditioned, cycles = [record for record, _ in both], [extracted for _, extracted in both]
        units = [record.unit for record in conditioned]
    if len(cycles) < LEAST_SHARE * given:
        raise InputError(
            f"{len(left_out)} of {given} records cannot be used, more than half of them; the first: {left_out[0]}"
        )
    different = sorted(set(units))
    if len(different) > 1:
        what = "in one unit" if envelopes else "displacements or all be angles"
        raise InputError(f"the records must all be {what}, got both {' and '.join(different)}.")
    return Extraction(tuple(conditioned), tuple(cycles), units[0], tuple(left_out))


def _usable[T, R](
    items: Sequence[T],
    work: Callable[[T], R],
    one_must_do: bool,
    left_out: list[str],
    progress: Callable[[float], None],
) -> list[tuple[T, R]]:
    """Return what became of those that can be used; why the others cannot goes into ``left_out``, or is raised.

    A few are worked on at the same time; of what cannot be used, the first is told of first.
    """
    done: list[tuple[T, R]] = []
    for begin in range(0, len(items), _AT_ONCE):
        progress(begin / len(items))
        few = items[begin : begin + _AT_ONCE]
        with threadpool_limits(1):  # once for all of them: threads that lift the limit in turn would lift it for others
            results = in_threads([partial(_tried, work, item) for item in few])
        for item, result in zip(few, results, strict=True):
            if not isinstance(result, InputError):
                done.append((item, result))
            elif one_must_do:
                raise result
            else:
                left_out.append(str(result))
    return done


def _tried[T, R](work: Callable[[T], R], item: T) -> R | InputError:
    """Return what comes of an item, or why it cannot be used."""
    try:
        return work(item)
    except InputError as error:
        return error
