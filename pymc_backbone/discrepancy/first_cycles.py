"""First cycles that are no free motion: where no set explains them and they are the first alone, they are left out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from .._common.checks import FloatArray
from ..measurement.reading.record import Record
from . import evidence
from .search import Search

_MOST = 3  # cycles that are no free motion: of more, something else is wrong
_BEYOND = 1.2  # cycles that are left out after these
_FEWEST = 8.0  # cycles that have to remain
_FIRST_ALONE = 5.0  # chi-square of the first cycles over that of the one after them, from which it is they alone
_STEEP = 3.0  # power of the fall of the motion's square by which a law's may fall: a force of its third power
_CLEARLY = 100.0  # and over that of noise ...
_SEEN = 10.0  # ... or so much in most records, where they are more than any law leaves by which the motion falls:
_STEEPEST = 10.0  # the square of a force of the fifth power of the amplitude


@dataclass(frozen=True, eq=False)
class Begun:
    """Time [s] from which each record is free motion, where its first cycles are not."""

    by_specimen: dict[str, float]

    def undisturbed(self, records: Iterable[Record]) -> list[Record]:
        """Return the records from where they are free motion."""
        return [_from(record, self.by_specimen.get(record.specimen, -np.inf)) for record in records]

    @property
    def sentence(self) -> str:
        """What was left out, in one sentence."""
        names = sorted(self.by_specimen)
        which = "one record" if len(names) == 1 else f"{len(names)} records"
        return (
            f"warning: the first cycles of {which} ({', '.join(names)}) are no free motion that any set of effects "
            "explains, as where a hand, a trigger, a second blow or a filter that has to settle is in them; they were "
            "left out, and what acts in them alone is not looked for"
        )


def _from(record: Record, begin: float) -> Record:
    """Return a record from an instant of free motion on."""
    kept = record.time >= begin
    if kept.all():
        return record
    return replace(record, time=record.time[kept], values=record.values[kept], starts_free=True)


def begun(search: Search) -> Begun | None:
    """Return where records begin to be free motion, if the best set does not explain their first cycles alone.

    A hand, a trigger, a hammer that strikes twice, a filter that has to settle: a fit is off by hundreds of times the
    noise there, and by much less in the cycle after it. Where most records show it, one chain has measured them, and
    all are cut. A hand that is hardly felt is off by ten times the noise: most records have to show it, and less of
    what follows than any law leaves. None where records are compared through a band-pass.
    """
    batch, best = search.batch, search.best()
    if not batch.has_open_records:
        return None
    seen: dict[str, int] = {}
    hardly: dict[str, int] = {}
    long_enough = []
    for r, (term, record) in enumerate(zip(batch.waveform, batch.records, strict=True)):
        left = evidence.residuals_of(term, search.fits[best], r)
        cycles = (float(term.time[-1]) - float(term.time[0])) * record.frequency
        if cycles < _FEWEST + 1.0 + _BEYOND or left.size < 4.0 * cycles:
            continue
        long_enough.append(r)
        most = min(_MOST, int(cycles - _FEWEST - _BEYOND))
        motion = term.compared(term.values)
        fall = float(np.exp(_decrement(motion, cycles)))
        steps = _falls(motion, motion.size / cycles, most) ** _STEEP
        disturbed = _disturbed(left, left.size / cycles, most, alone=_FIRST_ALONE * steps)
        if disturbed:
            seen[batch.specimens[r]] = disturbed
        alone = _FIRST_ALONE * np.maximum(steps, fall**_STEEPEST)
        slightly = disturbed or _disturbed(left, left.size / cycles, most, _SEEN, alone=alone)
        if slightly:
            hardly[batch.specimens[r]] = slightly
    if 2 * len(hardly) > len(long_enough) > 1:
        seen = hardly
    usual = int(np.ceil(np.median([*seen.values()]))) if 2 * len(seen) > len(long_enough) else 0
    places = {}
    for r in long_enough:
        name = batch.specimens[r]
        cut = max(seen.get(name, 0), usual)
        if cut:
            places[name] = float(batch.waveform[r].time[0]) + (cut + _BEYOND) / batch.records[r].frequency
    return Begun(places) if places else None


def _decrement(values: FloatArray, cycles: float) -> float:
    """Return the logarithmic decrement over a cycle of motion, by the first quarters of a record; of noise, zero."""
    around = values - values[values.size // 2 :].mean()
    early, late = (float((part**2).mean()) for part in np.array_split(around, 4)[:2])
    return max(
        2.0 * float(np.log(early / max(late, 1e-300))) / cycles, 0.0
    )  # a quarter apart, squares of the amplitude


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


__all__ = ["Begun", "begun"]
