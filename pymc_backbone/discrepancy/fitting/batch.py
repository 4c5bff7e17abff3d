"""The data of a batch as the fits see them: three data terms for each specimen, and rough values to start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from ..._common.backbone_dataset import FREQUENCY, typical_frequency
from ..._common.checks import FloatArray, InputError
from ...measurement.conditioning.conditioned import ConditionedRecord
from ...measurement.cycle_data import Cycles
from .data_term import DataTerm, LevelTerm, TurningTerm, level_term, with_frequency
from .record_term import release_of, turning_term, waveform_term
from .waveform_term import WaveformTerm

_ABOVE = 1.25  # release over the highest level, where none is known


@dataclass(frozen=True, eq=False)
class Batch:
    """Measured backbones with, where there are records, turning points and waveforms.

    Attributes
    ----------
    backbones : xarray.Dataset
        At levels.
    records, cycles : tuples
        As conditioned and extracted; empty where only backbones are known.
    levels, turning, waveform : tuples of data terms
        One per specimen; the last two empty where only backbones are known.
    specimens : tuple of str
        Names, in the order of the data terms.
    own : (r, 5) array
        Rough stiffness, damping, release amplitude, release instant, offset.
    amplitude : float
        Largest amplitude [m or rad].
    angular_frequency : float
        Typical [rad/s].
    notes : tuple of str
        What was left out and why.
    is_relaxed : bool
        Whether what remembers holds no force at the release, instead of being loaded from rest up to there.
    settling_odds : float
        Logarithm of how much less probable a drift of frequency is because it settles, and just so fast.
    """

    backbones: xr.Dataset
    records: tuple[ConditionedRecord, ...]
    cycles: tuple[Cycles, ...]
    levels: tuple[LevelTerm, ...]
    turning: tuple[TurningTerm, ...]
    waveform: tuple[WaveformTerm, ...]
    specimens: tuple[str, ...]
    own: FloatArray
    amplitude: float
    angular_frequency: float
    notes: tuple[str, ...] = ()
    is_relaxed: bool = False
    settling_odds: float = 0.0

    @property
    def amplitude_unit(self) -> str:
        """m, or rad for a rotation."""
        return str(self.backbones.attrs.get("amplitude_unit", "m"))

    @property
    def deciding(self) -> Sequence[DataTerm]:
        """The data term that decides: the waveform where there is one."""
        return self.waveform or self.levels

    @property
    def has_records(self) -> bool:
        """Whether there are waveforms."""
        return bool(self.waveform)

    @property
    def has_open_records(self) -> bool:
        """Whether there are waveforms, none of which is compared through a band-pass."""
        return self.has_records and all(record.band is None for record in self.records)

    @property
    def lacks_mid_line(self) -> bool:
        """Whether the mid-line of a record is not measured, and so the damping of its backbones may be off."""
        return self.has_open_records and not all(record.offset_is_measured for record in self.records)

    @property
    def is_behind_filter(self) -> bool:
        """Whether simulations go through a filter that was found; the backbones are those of the filtered records."""
        return any(term.chain is not None for term in self.waveform)

    @property
    def nuisances(self) -> tuple[int, ...]:
        """Which of a specimen's own values the deciding data term sees."""
        return (0, 1, 2, 3, 4) if self.has_records else (0, 1)

    @property
    def count(self) -> int:
        """How many values the deciding data term holds."""
        return sum(term.size for term in self.deciding)

    def subset(self, specimens: Sequence[int]) -> Batch:
        """Return the batch of some of its specimens."""
        index = list(specimens)

        def pick[T](items: tuple[T, ...]) -> tuple[T, ...]:
            return tuple(items[i] for i in index) if items else ()

        return Batch(
            self.backbones.isel(specimen=[self._row(i) for i in index]),
            pick(self.records), pick(self.cycles), pick(self.levels), pick(self.turning), pick(self.waveform),
            pick(self.specimens), self.own[index], self.amplitude, self.angular_frequency,
        )  # fmt: skip

    def without_records(self) -> Batch:
        """Return the batch as if its backbones alone were known."""
        return replace(self, records=(), cycles=(), turning=(), waveform=())

    @property
    def settling_time(self) -> float:
        """Time constant [s] of a drift of frequency; infinite for a steady one."""
        term = self.waveform[0] if self.waveform else None
        return float(np.ptp(term.time)) / term.settling if term is not None and term.settling else float("inf")

    def settling(self, time: float, odds: float = 0.0) -> Batch:
        """Return the batch whose drifts of frequency settle with a time constant [s], instead of being steady."""
        return replace(
            self,
            settling_odds=odds,
            turning=tuple(replace(term, settling=float(np.ptp(term.times)) / time) for term in self.turning),
            waveform=tuple(replace(term, settling=float(np.ptp(term.time)) / time) for term in self.waveform),
        )

    def _row(self, specimen: int) -> int:
        return [str(name) for name in self.backbones["specimen"].values].index(self.specimens[specimen])


def batch_of_records(
    mass: float,
    backbones: xr.Dataset,
    records: Sequence[ConditionedRecord],
    cycles: Sequence[Cycles],
) -> Batch:
    """Return the batch of conditioned records, their cycles and their backbones."""
    names = [str(name) for name in backbones["specimen"].values]
    kept, levels, notes = [], [], []
    for i, item in enumerate(cycles):
        term = level_term(backbones, names.index(item.specimen)) if item.specimen in names else None
        if term is None:
            notes.append(f"{item.specimen}: reaches none of the levels and was left out")
            continue
        kept.append(i)
        levels.append(term)
    if not kept:
        raise InputError("no specimen reaches the levels; choose levels within the measured amplitudes.")
    records, cycles = [records[i] for i in kept], [cycles[i] for i in kept]
    turning = tuple(turning_term(record, item) for record, item in zip(records, cycles, strict=True))
    waveform = tuple(waveform_term(record, item) for record, item in zip(records, cycles, strict=True))
    own = np.array([_rough(mass, record, item) for record, item in zip(records, cycles, strict=True)])
    levels = [_released(term, record, row[2]) for term, record, row in zip(levels, records, own, strict=True)]
    amplitude = float(max(np.abs(item.values).max() for item in turning))
    frequency = float(np.median(np.concatenate([item.frequency for item in cycles])))
    return Batch(
        backbones, tuple(records), tuple(cycles), tuple(levels), turning, waveform,
        tuple(item.specimen for item in cycles), own, amplitude, 2.0 * np.pi * frequency, tuple(notes),
    )  # fmt: skip


def batch_of_backbones(mass: float, backbones: xr.Dataset) -> Batch:
    """Return the batch of backbones that were measured directly."""
    names = [str(name) for name in backbones["specimen"].values]
    observables = [str(name) for name in backbones["observable"].values]
    known = None if FREQUENCY in observables else typical_frequency(backbones)
    if known is not None and not np.isfinite(known):
        raise InputError(
            "the search for a missing effect needs the observable `frequency`, or the frequency in Hz as the attribute "
            "of that name; give backbones with it."
        )
    found = [(i, level_term(backbones, i)) for i in range(len(names))]
    held = [(i, term) for i, term in found if term is not None and term.levels.size > 1]
    if not held:
        raise InputError(
            "the backbones need standard errors to judge a model by, at two levels or more; give them with the table."
        )
    value = np.asarray(backbones["value"])
    own = np.zeros((len(held), 5))
    for row, (i, _) in enumerate(held):
        omega = 2.0 * np.pi * (known or float(np.nanmedian(value[i, observables.index("frequency")])))
        damping = 0.03
        if "damping" in observables and np.isfinite(value[i, observables.index("damping")]).any():
            damping = max(float(np.nanmedian(value[i, observables.index("damping")])), 1e-5)
        own[row] = (mass * omega**2, mass * omega * damping / np.pi, 0.0, 0.0, 0.0)
    amplitude = float(np.asarray(backbones["level"])[-1])
    terms = tuple(term if known is None else with_frequency(term, known) for _, term in held)
    terms = tuple(_released(term) for term in terms)
    return Batch(
        backbones, (), (), terms, (), (), tuple(names[i] for i, _ in held), own,
        amplitude, float(np.sqrt(np.median(own[:, 0]) / mass)),
    )  # fmt: skip


def _released(term: LevelTerm, record: ConditionedRecord | None = None, amplitude: float = 0.0) -> LevelTerm:
    """Return a term with its release; behind a band-pass, which loses the first cycles, it is not known."""
    known = abs(float(amplitude)) if record is not None and record.band is None else 0.0
    return replace(term, release=known or _ABOVE * float(term.levels[-1]))


def _rough(mass: float, record: ConditionedRecord, cycles: Cycles) -> tuple[float, ...]:
    """Return rough stiffness, damping, release amplitude, release instant and offset of one record."""
    omega = 2.0 * np.pi * float(np.median(cycles.frequency))
    damping = max(float(np.median(cycles.damping)), 1e-6)
    _, release_time, release = release_of(record, cycles)
    return mass * omega**2, mass * omega * damping / np.pi, release, release_time, 0.0
