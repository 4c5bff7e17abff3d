"""First cycles that are no free motion: where no set explains them and they are the first alone, they are left out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..measurement.reading.record import Record
from . import evidence
from .search import Search

_NOT_FREE = 2.2  # cycles that are left out where the first is not free motion
_FEWEST = 8.0  # cycles that have to remain
_FIRST_ALONE = 5.0  # chi-square of the first cycle over that of the second, from which it is not
_CLEARLY = 100.0  # and over that of noise


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
            "explains, as where a hand, a trigger or a filter that has to settle is in them; they were left out, and "
            "what acts in them alone is not looked for"
        )


def _from(record: Record, begin: float) -> Record:
    """Return a record from an instant of free motion on."""
    kept = record.time >= begin
    if kept.all():
        return record
    return replace(record, time=record.time[kept], values=record.values[kept], starts_free=True)


def begun(search: Search) -> Begun | None:
    """Return where records begin to be free motion, if the best set does not explain their first cycle alone.

    A hand, a trigger, a filter that has to settle: a fit is off by hundreds of times the noise there, and by much less
    in the cycle after it. Where most records show it, one chain has measured them, and all are cut. None where records
    are compared through a band-pass.
    """
    batch, best = search.batch, search.best()
    if not batch.has_open_records:
        return None
    found = search.fits[best]
    places: dict[str, float] = {}
    seen = []
    for r, (term, record) in enumerate(zip(batch.waveform, batch.records, strict=True)):
        left = evidence.residuals_of(term, found, r)
        cycles = (float(term.time[-1]) - float(term.time[0])) * record.frequency
        each = left.size / max(cycles, 1.0)
        if cycles < _FEWEST + _NOT_FREE or each < 4.0:
            continue
        first, second = (float((left[round(k * each) : round((k + 1) * each)] ** 2).mean()) for k in (0, 1))
        places[batch.specimens[r]] = float(term.time[0]) + _NOT_FREE / record.frequency
        if first > _FIRST_ALONE * second and first > _CLEARLY:
            seen.append(batch.specimens[r])
    if 2 * len(seen) <= len(places):
        places = {name: places[name] for name in seen}
    return Begun(places) if places else None


__all__ = ["Begun", "begun"]
