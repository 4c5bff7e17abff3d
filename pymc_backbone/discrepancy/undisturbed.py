"""Records without what disturbs them: late beginnings, first cycles, noise that grows, a bent sensor, another mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..measurement.options import Measuring
from ..measurement.reading.record import Record
from . import evidence
from .earlier_release import Earlier, earlier
from .first_cycles import begun
from .motion_noise import MotionNoise, motion_noise
from .question import Question
from .readings import Disturbed, disturbed, sentences
from .search import Search

_PASSES = 2  # times that bent sensors and lines are looked for
_LESS = 0.5  # of what the best set left, where first cycles are left out or the release is another


@dataclass(frozen=True, eq=False)
class Undisturbed:
    """Question and search of records without what disturbs them, and whether that is a bent sensor."""

    question: Question
    search: Search
    is_bent: bool = False


def undisturbed(
    question: Question,
    search: Search,
    records: Sequence[Record],
    measuring: Measuring,
    searched: Callable[[Question], Search],
) -> Undisturbed:
    """Return the question and search of records without what disturbs them; as they were where nothing does.

    Specimens are released earlier, or else first cycles left out, where a set of effects leaves noise then, or half of
    what was left at most. Where the noise grows with the motion, samples count by the noise that they have. A bent
    sensor and another mode's line are taken out where a set leaves noise then; what was found with the noise of
    disturbed records is found again without it.
    """
    known, again = Undisturbed(question, search), search
    said: tuple[str, ...] = ()
    noise: MotionNoise | None = None
    release: Earlier | None = None

    def asked(records: Sequence[Record], said: Sequence[str]) -> Undisturbed:
        other = question.of_records(records, measuring, said)
        if release is not None:
            other = replace(other, batch=release.released(other.batch))
        if noise is not None:
            other = replace(other, batch=noise.weighed(other.batch))
        return Undisturbed(other, searched(other))

    if (release := earlier(search)) is not None:
        tried = asked(records, (release.sentence,))
        if _is_better(tried.search, search):
            said, known, again = (release.sentence,), tried, tried.search
        else:
            release = None
    first = begun(again) if release is None else None
    if first is not None:
        records, said = first.undisturbed(records), (first.sentence,)
        tried = asked(records, said)
        again = tried.search
        if _is_better(again, search):
            known = tried
    noise = motion_noise(again)
    if noise is not None:
        said = (*said, noise.sentence)
        known = asked(records, said)
        again = known.search
    if (first is not None or release is not None) and _is_exact(again):
        return known
    found: list[Disturbed] = []
    while len(found) < _PASSES and (one := disturbed(again)) is not None:
        found.append(one)
        records = one.undisturbed(records)
        tried = asked(records, (*said, *sentences(found)))
        again = tried.search
        if _is_exact(again):
            return replace(tried, is_bent=any(item.is_bent for item in found))
    return known


def _left(search: Search) -> evidence.LackOfFit:
    """Return what the most probable set leaves."""
    return evidence.lack_of_fit(search.batch, search.fits[search.best()])


def _is_better(tried: Search, search: Search) -> bool:
    """Return whether one search leaves noise, or half of what another left at most."""
    return _is_exact(tried) or _left(tried).share < _LESS * _left(search).share


def _is_exact(search: Search) -> bool:
    """Return whether the most probable set leaves noise."""
    return evidence.leaves_noise(search.batch, search.fits[search.best()])


__all__ = ["Undisturbed", "undisturbed"]
