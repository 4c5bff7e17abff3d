"""Samples that are off all motion: a laser that loses its speckle, a cable that cracks, a bit that falls.

A few of them hide that a set explains all others. They stand alone, at any phase of the motion and in few cycles, where
what a law lacks comes again in every cycle.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import BoolArray, FloatArray, IntArray
from ...measurement.reading.record import Record
from ..sets.search import Search
from ..weighing import evidence
from .edges import between

_OFF = 6.0  # standard deviations of the noise, which one of 5e8 samples is off by
_ITS_SIDES = 2.5  # and those beside such a sample, to be part of the same event
_PER_CYCLE = 0.1  # events in a cycle: more of them are no chance,
_FEW, _CYCLES = 4.0, 6.0  # but for a few, where there are so many cycles to each
_SCALE = 1.2  # of the residuals, robust, up to which the set explains the other samples
_NORMAL = 1.4826  # median absolute deviation to standard deviation, for a normal distribution
_WIDEST = 5  # values of an event
_FIRST = 2  # values, one of which is off where a record begins with what is no free motion
_AGAIN = 2  # times as many as are off are left out: what settles rings
_AT_A_PHASE = 0.01  # p-value of phases that are no chance: what comes at one of them is a law's lack


@dataclass(frozen=True, eq=False)
class DropOuts:
    """What each record holds at its wild samples, by time.

    Attributes
    ----------
    by_specimen : mapping of str to ((k,) array, (k,) array)
        Time [s] of values that are off, and by how much [unit of the record].
    step : mapping of str to float
        Time [s] from one value to the next.
    events : int
        Number of events, but for those with which a record begins.
    jumping : tuple of str
        Specimens with such events.
    begins : mapping of str to float
        Time [s] from which records are free motion whose first samples are off: how they were held and released is in
        these, and a filter that settles.
    """

    by_specimen: dict[str, tuple[FloatArray, FloatArray]]
    step: dict[str, float]
    events: int
    jumping: tuple[str, ...]
    begins: dict[str, float]

    def undisturbed(self, records: Iterable[Record]) -> list[Record]:
        """Return the records from their free motion on, with wild samples put where the set has them.

        First samples are left out, and not put there: what a wrong set makes of them would speak for that set.
        """
        mended = [self._mended(record) if record.specimen in self.by_specimen else record for record in records]
        return [between(record, self.begins.get(record.specimen, -np.inf), np.inf) for record in mended]

    def _mended(self, record: Record) -> Record:
        time, off = self.by_specimen[record.specimen]
        nearest = _nearest(record.time, time)
        is_wild = np.abs(record.time - time[nearest]) <= 0.5 * self.step[record.specimen] * (1.0 + 1e-6)
        return replace(record, values=np.where(is_wild, record.values - off[nearest], record.values))

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        begun = ""
        if self.begins:
            which = "one record" if len(self.begins) == 1 else f"{len(self.begins)} records"
            begun = (
                f"the first samples of {which} ({', '.join(self.begins)}) are off the free motion by how it was "
                "held and released, or a filter that settles, and do not count"
            )
        if not self.events:
            return begun
        return f"{self._jumps}; {begun}" if begun else self._jumps

    @property
    def _jumps(self) -> str:
        times = "once" if self.events == 1 else f"{self.events} times"
        names = sorted(self.jumping)
        which = "one record" if len(names) == 1 else f"{len(names)} records"
        return (
            f"warning: {which} ({', '.join(names)}) {'jumps' if len(names) == 1 else 'jump'} {times} off all motion "
            "for a sample or a few, as where a laser loses its signal or a cable cracks; these samples do not count"
        )


def drop_outs(search: Search) -> DropOuts | None:
    """Return the wild samples in what the best set leaves; None where there are none, or it leaves other things."""
    batch = search.batch
    if not batch.has_open_records:
        return None
    best = search.fits[search.best()]
    found: dict[str, tuple[FloatArray, FloatArray]] = {}
    steps: dict[str, float] = {}
    jumping: list[str] = []
    beginning: dict[str, float] = {}
    events, phases = 0, []
    for r, (name, term) in enumerate(zip(batch.specimens, batch.waveform, strict=True)):
        left = evidence.residuals_of(term, best, r)
        scale = max(_NORMAL * float(np.median(np.abs(left))), 1e-300)
        wild, count = _wild(left / max(scale, 1.0))
        if scale > _SCALE or count > max(_PER_CYCLE * term.cycles, min(_FEW, term.cycles / _CYCLES)):
            return None
        if not count:
            continue
        plain = evidence.residuals_of(replace(term, whiten=lambda columns: columns, shown=None), best, r)
        instants, time = term.standardised(term.time)[wild], term.compared(term.time)
        step = float(np.median(np.diff(time)))
        near = np.abs(time - instants[_nearest(time, instants)]) <= (0.5 * term.averaged + 1e-6) * step
        found[name], steps[name] = (time[near], plain[near]), step
        first = wild[: max(round(term.size / term.cycles), _FIRST)]  # what rings stands in the first cycle
        at_first = _begun(first).size if first[:_FIRST].any() else 0
        if at_first:
            ringing = _AGAIN * (1 + int(np.flatnonzero(first)[-1]))
            beginning[name] = float(time[min(ringing * term.averaged, time.size - 1)])
        begins = term.standardised(term.time)[_begun(wild)][at_first:]
        jumping += [name] if begins.size else []
        events += begins.size
        turning = batch.cycles[r].turning_times
        phases.append(np.pi * np.interp(begins, turning, np.arange(turning.size)))
    if phases and _come_at_a_phase(np.concatenate(phases)):
        return None
    return DropOuts(found, steps, events, tuple(jumping), beginning) if found else None


def _come_at_a_phase(phases: FloatArray) -> bool:
    """Return whether events come at one phase of the motion, or at two that are opposite, by Rayleigh's test."""
    if not phases.size:
        return False
    least = max(abs(np.exp(1j * order * phases).mean()) for order in (1, 2))
    return bool(2.0 * np.exp(-phases.size * least**2) < _AT_A_PHASE)


def _nearest(time: FloatArray, places: FloatArray) -> IntArray:
    """Return which of ascending places (k,) is nearest to each instant (n,)."""
    after = np.clip(np.searchsorted(places, time), 1, places.size - 1) if places.size > 1 else np.zeros_like(time, int)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(time - places[before]) <= np.abs(time - places[after]), before, after)


def _begun(wild: BoolArray) -> IntArray:
    """Return at which values events begin."""
    return np.flatnonzero(np.diff(wild.astype(int), prepend=0) > 0)


def _wild(left: FloatArray) -> tuple[BoolArray, int]:
    """Return which standardised values belong to an event, and the number of these; wide ones are none."""
    wild, count = np.zeros(left.size, dtype=bool), 0
    beside = np.abs(left) > _ITS_SIDES
    for at in np.flatnonzero(np.abs(left) > _OFF):
        if wild[at]:
            continue
        first, last = at, at
        while first > 0 and beside[first - 1]:
            first -= 1
        while last < left.size - 1 and beside[last + 1]:
            last += 1
        if last - first < _WIDEST:
            wild[max(first - 1, 0) : last + 2] = True
            count += 1
        else:
            count += left.size  # no event: something that moves
    return wild, count


__all__ = ["DropOuts", "drop_outs"]
