"""Edges of records that are no free motion: first or last cycles that no set explains, and they alone, are left out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..._common.checks import FloatArray
from ...measurement.reading.record import Record
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..fitting.waveform_term import WaveformTerm
from ..weighing import evidence

_MOST = 3  # cycles that are no free motion: of more, something else is wrong
_MOST_IN_ALL = 4  # the same where more is seen once these are left out
_BEYOND = 1.2  # cycles that are left out after these
_FEWEST = 8.0  # cycles that have to remain
_FIRST_ALONE = 5.0  # chi-square of the first cycles over that of the one after them, from which it is they alone
_STEEP = 3.0  # power of the fall of the motion's square by which a law's may fall: a force of its third power
_CLEARLY = 100.0  # and over that of noise ...
_SEEN = 10.0  # ... or so much in most records, where they are more than any law leaves by which the motion falls:
_STEEPEST = 10.0  # the square of a force of the fifth power of the amplitude
_GAINED, _OF_ALL = 10.0, 0.8  # chi-square that a set gains in the first cycle, and share of all that it gains
_REMAINS, _REMAINS_ALONE = 3.0, 2.0  # the same two where the edge is known to be none, and some of it is left


@dataclass(frozen=True, eq=False)
class Edges:
    """Time [s] from which each record is free motion, and until which, where its first or last cycles are not.

    Attributes
    ----------
    first, last : dict of str to float
        By specimen; those whose edge is free motion are in neither.
    cycles : int
        How many first cycles are none, in the record of which these are most.
    beside : str
        Effects that explain these as well, as they act in them alone; empty for none.
    """

    first: dict[str, float]
    last: dict[str, float] = field(default_factory=dict)
    cycles: int = 0
    beside: str = ""

    def undisturbed(self, records: Iterable[Record]) -> list[Record]:
        """Return the records where they are free motion."""
        return [
            between(record, self.first.get(record.specimen, -np.inf), self.last.get(record.specimen, np.inf))
            for record in records
        ]

    def within(self, other: Edges) -> Edges:
        """Return these edges of records that had already lost others."""
        return Edges({**other.first, **self.first}, {**other.last, **self.last}, self.cycles + other.cycles)

    @property
    def are_too_many(self) -> bool:
        """Whether so many first cycles are off, one after the other, that it is no edge, but a law that none is like.

        What acts at large amplitudes only, as a stop that is hardly reached, is off in them and in none that follow.
        """
        return self.cycles > _MOST_IN_ALL

    @property
    def sentence(self) -> str:
        """What was left out, in one sentence."""
        parts, causes = [], []
        if self.first:
            parts.append(f"the first cycles of {_counted(self.first)}")
            causes.append(
                "a hand, a trigger, a second blow, a filter that has to settle or a rubber that relaxes is in them"
            )
        if self.last:
            parts.append(f"the last cycles of {_counted(self.last)}")
            causes.append("a filter that runs both ways meets the end there, or something stops the motion")
        explained = "that any set of effects explains"
        if self.beside:
            explained = f"of the structure without {self.beside}, which would act in them alone"
        return (
            f"warning: {' and '.join(parts)} are no free motion {explained}, as where "
            f"{', and '.join(causes)}; they were left out, and what acts in them alone is not looked for"
        )


def _counted(names: Iterable[str]) -> str:
    """Return how many records there are, and which."""
    known = sorted(names)
    return f"{'one record' if len(known) == 1 else f'{len(known)} records'} ({', '.join(known)})"


def between(record: Record, begin: float, end: float) -> Record:
    """Return a record between two instants of free motion."""
    kept = (record.time >= begin) & (record.time <= end)
    if kept.all():
        return record
    starts_free = record.starts_free or begin > record.time[0]
    return replace(record, time=record.time[kept], values=record.values[kept], starts_free=starts_free)


def edges(batch: Batch, found: Fit, known: Edges | None = None) -> Edges | None:
    """Return between which instants records are free motion, if a set does not explain their edges alone.

    A hand, a trigger, a hammer that strikes twice, a filter that has to settle: a fit is off by hundreds of times the
    noise there, and by much less in the cycle after it. So it is at the end where a filter runs both ways. Where most
    records show it, one chain has measured them, and all are cut. A hand that is hardly felt is off by ten times the
    noise: most records have to show it, and less of what follows than any law leaves. Of edges that are ``known`` to be
    none, and were cut, what is left may be less. None where records are compared through a band-pass.
    """
    if not batch.has_open_records:
        return None
    seen = [
        _Seen(batch.specimens[r], term, record.frequency, evidence.residuals_of(term, found, r))
        for r, (term, record) in enumerate(zip(batch.waveform, batch.records, strict=True))
    ]
    long_enough = [item for item in seen if item.is_long_enough]
    ends = (known.first, known.last) if known is not None else ({}, {})
    first = _cut({item: item.at_begin() for item in long_enough}, ends[0])
    lost = {item: cut + _BEYOND for item, cut in first.items()}
    left_over = [item for item in long_enough if item.cycles - lost.get(item, 0.0) >= _FEWEST + 1.0 + _BEYOND]
    last = _cut({item: item.at_end(lost.get(item, 0.0)) for item in left_over}, ends[1])
    if not (first or last):
        return None
    return Edges(
        {item.specimen: float(item.time[0]) + (cut + _BEYOND) / item.frequency for item, cut in first.items()},
        {item.specimen: float(item.time[-1]) - (cut + _BEYOND) / item.frequency for item, cut in last.items()},
        max(first.values(), default=0),
    )


def begun_otherwise(batch: Batch, fewer: Fit, more: Fit) -> Edges | None:
    """Return the first cycles, where these alone speak for what a set has more than another; None where they do not.

    What acts in all cycles, or bends the phase of those that follow, is seen in all of them. What is gained in the
    first one and in none after it, in most records and by more than the motion falls, may be a joint or a rubber that
    relaxes, a filter that settles, or a contact that closes once: one cycle does not tell which.
    """
    if not batch.has_open_records:
        return None
    speaking = 0
    for r, (term, record) in enumerate(zip(batch.waveform, batch.records, strict=True)):
        alone, with_it = (evidence.residuals_of(term, found, r) for found in (fewer, more))
        seen = _Seen(batch.specimens[r], term, record.frequency, alone)
        if not seen.is_long_enough:
            return None
        motion, each = term.compared(term.values), alone.size / seen.cycles
        gained = np.cumsum(alone**2 - with_it**2)
        first, then, last = (float(gained[min(round(k * each), gained.size) - 1]) for k in (1, 2, seen.cycles))
        least = _FIRST_ALONE * float(_falls(motion, each, 1)[0]) ** _STEEP
        speaking += first > max(_GAINED, least * (then - first), _OF_ALL * last)
    if speaking <= len(batch.records) / 2:
        return None
    together = zip(batch.specimens, batch.waveform, batch.records, strict=True)
    return Edges({name: float(term.time[0]) + _BEYOND / record.frequency for name, term, record in together}, cycles=1)


def _cut(seen: Mapping[_Seen, _Off], known: Mapping[str, float]) -> dict[_Seen, int]:
    """Return how many cycles are cut of the records whose edge is no free motion, known to be none or not."""
    if known:
        return {item: off.remains for item, off in seen.items() if item.specimen in known and off.remains}
    clearly = {item: off.clearly for item, off in seen.items()}
    if 2 * sum(off.slightly > 0 for off in seen.values()) > len(seen) > 1:
        clearly = {item: off.slightly for item, off in seen.items()}
    counts = [count for count in clearly.values() if count]
    usual = int(np.ceil(np.median(counts))) if 2 * len(counts) > len(seen) else 0
    return {item: cut for item, count in clearly.items() if (cut := min(max(count, usual), seen[item].most))}


class _Off(NamedTuple):
    """How many cycles at an edge are no free motion: clearly, a little, of what is known to be none; and at most."""

    clearly: int
    slightly: int
    remains: int
    most: int


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a fit leaves of one record."""

    specimen: str
    term: WaveformTerm
    frequency: float
    left: FloatArray

    @property
    def time(self) -> FloatArray:
        """Instants [s] of the record."""
        return self.term.time

    @property
    def cycles(self) -> float:
        """Number of them."""
        return (float(self.time[-1]) - float(self.time[0])) * self.frequency

    @property
    def is_long_enough(self) -> bool:
        """Whether enough cycles remain without those of one edge."""
        return self.cycles >= _FEWEST + 1.0 + _BEYOND and self.left.size >= 4.0 * self.cycles

    def at_begin(self) -> _Off:
        """Return how many first cycles are no free motion."""
        motion, most = self.term.compared(self.term.values), self._most(0.0)
        return self._off(self.left, motion, _falls(motion, motion.size / self.cycles, most) ** _STEEP)

    def at_end(self, lost: float = 0.0) -> _Off:
        """Return how many last cycles are none, beside those lost at the begin.

        There the motion, and what a law leaves of it, does not grow.
        """
        return self._off(self.left[::-1], self.term.compared(self.term.values), np.ones(self._most(lost)))

    def _most(self, lost: float) -> int:
        """Return how many cycles may be left out at an edge beside those lost at the other."""
        return min(_MOST, int(self.cycles - lost - _FEWEST - _BEYOND))

    def _off(self, left: FloatArray, motion: FloatArray, steps: FloatArray) -> _Off:
        each, most = left.size / self.cycles, steps.size
        clearly = _disturbed(left, each, most, alone=_FIRST_ALONE * steps)
        fall = float(np.exp(_decrement(motion, self.cycles)))
        alone = _FIRST_ALONE * np.maximum(steps, fall**_STEEPEST)
        slightly = clearly or _disturbed(left, each, most, _SEEN, alone=alone)
        return _Off(clearly, slightly, _disturbed(left, each, most, _REMAINS, alone=_REMAINS_ALONE * steps), most)


def _decrement(values: FloatArray, cycles: float) -> float:
    """Return the logarithmic decrement over a cycle of motion, by the first quarters of a record; of noise, zero."""
    around = values - values[values.size // 2 :].mean()
    early, late = (float((part**2).mean()) for part in np.array_split(around, 4)[:2])
    # a quarter apart, squares of the amplitude
    return max(2.0 * float(np.log(early / max(late, 1e-300))) / cycles, 0.0)


def _falls(values: FloatArray, each: float, most: int) -> FloatArray:
    """Return by how much the square of a motion falls from its first 1, 2, ... cycles to the one after them."""
    around = values - values[values.size // 2 :].mean()
    squares = [float((around[round(k * each) : round((k + 1) * each)] ** 2).mean()) for k in range(most + 1)]
    falls = [np.mean(squares[:k]) / max(squares[k], 1e-300) for k in range(1, most + 1)]
    return np.maximum(np.array(falls), 1.0)


def _disturbed(left: FloatArray, each: float, most: int, clearly: float = _CLEARLY, *, alone: FloatArray) -> int:
    """Return how many first cycles of residuals, with so many values each, are no free motion; 0 where none is.

    They leave ``clearly`` times what noise does, and the cycle after k of them that over ``alone`` (most,): where the
    motion falls fast, so does what a wrong law leaves of it. What is no free motion
    may have been taken for noise: the later half of the record says how much of it there is.
    """
    noise = min(1.0, float((left[left.size // 2 :] ** 2).mean()))
    squares = [float((left[round(k * each) : round((k + 1) * each)] ** 2).mean()) for k in range(most + 1)]
    for k in range(1, most + 1):
        first = float(np.mean(squares[:k]))
        if first > alone[k - 1] * squares[k] and first > clearly * noise:
            return k
    return 0


__all__ = ["Edges", "begun_otherwise", "between", "edges"]
