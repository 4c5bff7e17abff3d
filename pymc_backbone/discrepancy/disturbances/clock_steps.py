"""Whole samples that a logger lost or wrote twice, which the cycles around did not show: the set is the clock.

Where the motion has decayed towards the noise, a few cycles do not tell a step of the clock; all that follow do. What a
set leaves then is, from one instant on, the derivative of the motion with respect to time, by a whole number of
sampling intervals, and no force does that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import FloatArray
from ...measurement.reading.record import Record
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import DRIFTS, RELEASE_INSTANT, derivatives
from ..sets.search import Search, Set

_ASKED = 3  # sets that leave least, asked beside the model as it is
_IN_PHASE = 30.0  # reduced chi-square of a set beside which steps are a linear problem
_GAIN = 30.0  # chi-square that a step has to explain: by chance 18 in one of a hundred records of 4000 samples
_MOST = 4  # steps in one record, and ...
_MOST_LOST = 4  # ... samples of one: where there are more, it is no clock
_WHOLE, _ERRORS, _SHARPEST = 0.1, 3.0, 0.3  # how near to a whole number, in samples and errors; how well it is known
_ROUNDS = 3  # in which the places of several are found beside each other
_PRICE = 16.0  # chi-square that a step must be worth, and four for each parameter of a set
_PARAMETER = 4.0
_LEFT = 1.5  # reduced chi-square up to which what is left may be noise
_SIDE = 4  # values beside an edge between which no step is looked for


@dataclass(frozen=True)
class Step:
    """A step of the clock.

    Attributes
    ----------
    time : float
        First instant [s] after it.
    count : int
        Samples that are missing there; negative where so many are too many.
    """

    time: float
    count: int


@dataclass(frozen=True, eq=False)
class ClockSteps:
    """The steps of the clock in each record that has some."""

    by_specimen: Mapping[str, tuple[Step, ...]]

    def undisturbed(self, records: Iterable[Record]) -> list[Record]:
        """Return the records with every sample at its own instant: what is missing is left open."""
        return [_mended(record, self.by_specimen.get(record.specimen, ())) for record in records]

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        told = "; ".join(
            f"{name}: {', '.join(f'{abs(step.count)} at {step.time:.5g} s' for step in steps)}"
            for name, steps in self.by_specimen.items()
        )
        counts = [step.count for steps in self.by_specimen.values() for step in steps]
        state = "lost" if min(counts) > 0 else "written twice" if max(counts) < 0 else "lost or written twice"
        return (
            f"warning: samples were {state} without a trace in the times, late in the decay, where a few cycles do not "
            f"show it and all that follow do ({told}); the clock was set right there; check the logger"
        )


def clock_steps(search: Search, records: Sequence[Record]) -> ClockSteps | None:
    """Return the steps of the clock beside which a set leaves no more than noise may; None where there are none.

    Asked of the model as it is and the sets that leave least, each with its parameters and the release moved by what
    the steps explain. ``records`` are those of the loggers.
    """
    batch = search.batch
    if not batch.has_open_records:
        return None
    intervals = {record.specimen: float(np.median(np.diff(record.time))) for record in records}
    likeliest = sorted(search.fits, key=lambda names: search.fits[names].cost)[:_ASKED]
    asked = [names for names in dict.fromkeys(((), *likeliest)) if names in search.fits]
    found = [item for names in asked if (item := _beside(search, names, intervals)) is not None]
    return min(found, key=lambda item: item[0])[1] if found else None


def _beside(search: Search, names: Set, intervals: Mapping[str, float]) -> tuple[float, ClockSteps] | None:
    """Return the steps beside a set and what these leave, with a price; None where that is no noise."""
    batch, found = search.batch, search.fits[names]
    if found.cost > _IN_PHASE * search.count:
        return None
    steps: dict[str, tuple[Step, ...]] = {}
    left = found.cost
    for r, name in enumerate(batch.specimens):
        known = _of_record(batch, found, r, intervals[name])
        if known is None:
            return None
        left -= known[0]
        if known[1]:
            steps[name] = known[1]
    if not steps or left > _LEFT * search.count:
        return None
    count = sum(map(len, steps.values()))
    return left + _PRICE * count + _PARAMETER * found.layout.free.size, ClockSteps(steps)


def _of_record(batch: Batch, found: Fit, r: int, interval: float) -> tuple[float, tuple[Step, ...]] | None:
    """Return what the steps of one record explain, and these; None where they are no whole samples."""
    term, layout = batch.waveform[r], found.layout
    active = np.ones(found.state.own.shape[1], dtype=bool)
    known = derivatives(layout, term, found.state.eta, found.state.own[r], layout.scatter, active)
    if known is None or not np.isfinite(known.together).all():
        return None
    idle = () if found.state.own[r, DRIFTS].any() else DRIFTS  # a drift imitates steps, and steps a drift
    kept = np.setdiff1d(np.arange(known.own.shape[1]), idle)
    moved = np.hstack([known.shared, known.own[:, kept]])
    looked = _Looked(known.residuals, -interval * known.own[:, RELEASE_INSTANT], moved)
    places: list[int] = []
    while len(places) < _MOST:
        at, gain = looked.best(places)
        if gain < _GAIN:
            break
        places.append(at)
        for _ in range(_ROUNDS if len(places) > 1 else 0):
            for k in range(len(places)):
                places[k] = looked.best([*places[:k], *places[k + 1 :]])[0]
    if not places:
        return 0.0, ()
    places.sort()
    counts, errors, gain = looked.solved(places)
    whole = np.round(counts)
    is_whole = (np.abs(counts - whole) < _WHOLE + _ERRORS * errors) & (errors < _SHARPEST)
    if not np.all(is_whole & (whole != 0.0) & (np.abs(whole) <= _MOST_LOST)):
        return None
    time = term.standardised(term.time)
    return gain, tuple(Step(float(time[at]), int(count)) for at, count in zip(places, whole, strict=True))


class _Looked:
    """Steps in what a set leaves of one record, beside all that may move it: one linear problem for every place."""

    def __init__(self, residuals: FloatArray, later: FloatArray, moved: FloatArray) -> None:
        unit = np.sqrt((moved**2).sum(axis=0))
        self.basis = np.linalg.qr(moved[:, unit > 0.0] / unit[unit > 0.0])[0]
        self.later = later
        self.left = residuals - self.basis @ (self.basis.T @ residuals)

    def best(self, others: Sequence[int]) -> tuple[int, float]:
        """Return the place at which a step beside others explains most, and how much that is."""
        basis, left = self.basis, self.left
        if others:
            basis = np.hstack([basis, np.linalg.qr(self._beside(others))[0]])
            left = left - basis @ (basis.T @ left)
        explained = _from_the_end(self.later * left)
        square = _from_the_end(self.later**2)
        along = _from_the_end(self.later[:, None] * basis)
        free = square - (along**2).sum(axis=1)
        gains = np.where(free > 1e-9 * square[0], explained**2 / np.maximum(free, 1e-300), 0.0)
        gains[:_SIDE], gains[-_SIDE:] = 0.0, 0.0
        at = int(np.argmax(gains))
        return at, float(gains[at])

    def solved(self, places: Sequence[int]) -> tuple[FloatArray, FloatArray, float]:
        """Return the samples lost at some places together, their errors, and what that explains."""
        columns = self._beside(places)
        inverse = np.linalg.pinv(columns.T @ columns)
        counts: FloatArray = inverse @ (columns.T @ self.left)
        return counts, np.sqrt(np.diag(inverse)), float(counts @ (columns.T @ self.left))

    def _beside(self, places: Sequence[int]) -> FloatArray:
        """Return the steps at some places, without what moves of the set draw of them."""
        columns = self.later[:, None] * (np.arange(self.later.size)[:, None] >= np.asarray(places))
        beside: FloatArray = columns - self.basis @ (self.basis.T @ columns)
        return beside


def _from_the_end(rows: FloatArray) -> FloatArray:
    """Return the sum of each row and all that follow."""
    summed: FloatArray = np.cumsum(rows[::-1], axis=0)[::-1]
    return summed


def _mended(record: Record, steps: Sequence[Step]) -> Record:
    """Return a record whose samples after each step are as much later as samples are missing; what is twice goes."""
    time, values = record.time.copy(), record.values
    interval = float(np.median(np.diff(time)))
    for step in sorted(steps, key=lambda item: -item.time):
        at = int(np.searchsorted(time, step.time - 0.5 * interval))
        time[at:] += step.count * interval
        if step.count < 0:
            kept = np.r_[0:at, min(at - step.count, time.size) : time.size]
            time, values = time[kept], values[kept]
    return replace(record, time=time, values=values) if steps else record


__all__ = ["ClockSteps", "Step", "clock_steps"]
