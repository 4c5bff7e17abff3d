"""Records that were changed: what the question of them is, and whether their search explains more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ...measurement.options import Measuring
from ...measurement.reading.record import Record
from ..fitting.joint_fit import Fit
from ..sets.fitted_sets import FittedSets
from ..sets.promising import is_promising
from ..sets.question import Question
from ..sets.search import Search, Set
from ..weighing import evidence
from ..weighing.evidence import Drifting
from .disturbance import Disturbed, sentences
from .earlier_release import Earlier, run_in
from .edges import Edges
from .mode_lines import whatever_is_left
from .motion_noise import MotionNoise
from .sensor_filter import SensorFilter

LESS = 0.5
"""Share of what the best set left, up to which a set explains more of changed records."""

_NEXT_TO_NOTHING = 1e-3  # share of what one set leaves beyond the noise

Drifts = Callable[[Search], Mapping[Set, Drifting]]
"""Asks the sets of a finished search with a drift in time beside them."""


@dataclass(frozen=True, eq=False)
class Undisturbed:
    """Question and search of records without what disturbs them, and whether that is a bent sensor.

    ``drifting`` holds the sets that were asked with a drift in time beside them; None where none were.
    """

    question: Question
    search: Search
    is_bent: bool = False
    drifting: Mapping[Set, Drifting] | None = None

    @property
    def is_drifting(self) -> bool:
        """Whether a set leaves noise with a drift in time beside it."""
        return self.noise_beside_drift < np.inf

    @property
    def noise_beside_drift(self) -> float:
        """The least that a set leaves over the motion which leaves noise with a drift beside it; infinite for none."""
        fits = [item.fit for item in (self.drifting or {}).values()]
        exact = [found for found in fits if evidence.leaves_noise(self.search.batch, found)]
        return min((over_motion(self.search, found) for found in exact), default=np.inf)


@dataclass(frozen=True, eq=False)
class Changed:
    """Records as they were changed, how they are measured and searched, and what is said of all that.

    ``question`` is that of the records as they were given; what was found on the way (lines, records that begin late, a
    release, a filter, a noise) holds for every question that follows. ``measured`` holds the questions of records that
    were measured already, by the identity of these, beside the records: they are measured once, however often asked.
    """

    question: Question
    measuring: Measuring
    searched: Callable[..., Search]
    drifts: Drifts
    records: Sequence[Record]
    lines: tuple[Disturbed, ...] = ()
    said: tuple[str, ...] = ()
    begun_late: frozenset[str] = frozenset()
    release: Earlier | None = None
    is_relaxed: bool = False
    sensor_filter: SensorFilter | None = None
    noise: MotionNoise | None = None
    measured: dict[int, tuple[Sequence[Record], Question]] = field(default_factory=dict)

    @property
    def is_of_rates(self) -> bool:
        """Whether velocities or accelerations were measured."""
        return bool(self.records) and all(record.quantity != "displacement" for record in self.records)

    def but(self, *said: str, **changes: Any) -> Changed:
        """Return these with other attributes, and what is said of that."""
        return replace(self, said=(*self.said, *said), **changes)

    def within(self, lost: Edges) -> Changed:
        """Return these without the edges of records."""
        cut = self.but(lost.sentence, records=lost.undisturbed(self.records))
        return replace(cut, begun_late=self.begun_late | lost.first.keys())

    def asked(self, *early: Callable[..., Any]) -> Known:
        """Return the question of these records, searched; ``early`` is what a search is asked as it begins."""
        question = self.posed()
        return Known(self, Undisturbed(question, self.searched(question, *early)))

    def if_promising(self, search: Search, less: float) -> Known | None:
        """Return the same where a set of an earlier search leaves noise then, or that share of what the best left."""
        question = self.posed()
        if not is_promising(search, question.batch, less):
            return None
        return Known(self, Undisturbed(question, self.searched(question)))

    def posed(self) -> Question:
        """Return the question of these records."""
        if id(self.records) not in self.measured:
            self.measured[id(self.records)] = self.records, self.question.of_records(self.records, self.measuring)
        other = self.measured[id(self.records)][1].saying(*sentences(self.lines), *self.said)
        if self.is_relaxed:
            other = replace(other, batch=replace(other.batch, is_relaxed=True))
        if self.begun_late:
            other = replace(other, batch=run_in(other.batch, sorted(self.begun_late)))
        if self.release is not None:
            other = replace(other, batch=self.release.released(other.batch))
        if self.sensor_filter is not None:
            other = replace(other, batch=self.sensor_filter.passed(other.batch))
        if self.noise is not None:
            other = replace(other, batch=self.noise.weighed(other.batch))
        for taken in self.lines:
            other = replace(other, batch=whatever_is_left(other.batch, taken))
        return other


class Known(NamedTuple):
    """Records as they were changed, and what was found of these."""

    changed: Changed
    found: Undisturbed

    @property
    def search(self) -> Search:
        """The search of these records."""
        return self.found.search


def over_motion(search: Search, found: Fit) -> float:
    """Return what a fit leaves as a share of the motion."""
    return float(np.sqrt(found.chi_square.sum())) / evidence.size_of_motion(search.batch)


def left(search: Search) -> evidence.LackOfFit:
    """Return what the most probable set leaves."""
    return evidence.lack_of_fit(search.batch, search.fits[search.best()])


def is_exact(search: Search) -> bool:
    """Return whether the most probable set leaves noise."""
    return evidence.leaves_noise(search.batch, search.fits[search.best()])


def is_better(tried: Search, search: Search) -> bool:
    """Return whether one search leaves noise, or half of what another left at most."""
    return is_exact(tried) or left(tried).share < LESS * left(search).share


def takes_nearly_all(search: FittedSets, best: Set, names: Set) -> bool:
    """Return whether one set takes next to all of what another leaves beyond the noise: a law, and no imitation.

    What stands in for a hand in the first cycle takes most of it.
    """
    left, before = (search.fits[item].cost - search.count for item in (best, names))
    return bool(left < _NEXT_TO_NOTHING * before)


def gains(tried: Search, search: Search) -> bool:
    """Return whether the most probable set of one search leaves half of what it leaves in another at most.

    Not so of a set as large as they are looked for: with a disturbance beside it, it comes near anything.
    """
    if len(tried.best()) >= tried.max_effects:
        return False
    same = search.fit_set(tried.best())
    return same is None or left(tried).share < LESS * evidence.lack_of_fit(search.batch, same).share


__all__ = [
    "LESS", "Changed", "Drifts", "Known", "Undisturbed", "gains", "is_better", "is_exact", "left", "over_motion",
    "takes_nearly_all",
]  # fmt: skip
