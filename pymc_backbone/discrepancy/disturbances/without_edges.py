"""Records without first or last cycles that are no free motion: which, and beside which set of effects."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

from ..._common.text import in_words
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..proposals.set_fits import Set
from ..sets.promising import fitted_on
from ..sets.search import Search
from ..weighing import evidence
from .changed import LESS, Changed, Known, Undisturbed, is_exact, takes_nearly_all
from .edges import Edges, begun_otherwise, edges

_EDGES = 4  # times that edges are looked for
_NO_EDGE = 100.0  # reduced chi-square without the first edge found, above which a set leaves more than edges


def without_edges(changed: Changed, known: Undisturbed) -> Known | None:
    """Return the question of records without first or last cycles, where these alone are off and sets gain by that.

    Where what the best set leaves is free motion at the edges, too: what leaves noise, with some effects of that set,
    of records without edges that are off by it. Of a best set that leaves noise itself, that is the first cycle alone,
    and without effects that remember: these hold another force before they first turn, and follow a hand there. A
    slider that slips in that cycle and never again is told beside it, and not named; nor is anything else for which
    the first cycle alone speaks.
    """
    search = known.search
    best = search.best()
    if (cut := _cut_by(changed, search, best)) is not None:
        # what was taken for noise held the edges
        left_of_each = float(cut.found.chi_square.sum()) / cut.batch.count
        is_quieter = left_of_each < LESS * search.reduced(search.fits[best])
        return cut.changed.asked() if is_quieter else cut.changed.if_promising(search, LESS)
    is_needed = not is_exact(search)
    for names in (names for size in range(len(best)) for names in combinations(best, size) if names in search.fits):
        idle = tuple(name for name in best if name not in names)
        if is_needed and takes_nearly_all(search, best, names):
            continue  # the first cycles are those of a law
        if not (is_needed or _remember(search, idle)):
            continue
        if (cut := _cut_by(changed, search, names, is_needed=is_needed)) is None:
            continue
        if evidence.leaves_noise(cut.batch, cut.found) and (is_needed or cut.lost.cycles == 1):
            beside = "" if is_needed else _in_words(idle)
            said = replace(cut.lost, beside=beside)
            return changed.within(said).asked()
    return None if is_needed else without_first_cycle(changed, search)


def without_first_cycle(changed: Changed, search: Search) -> Known | None:
    """Return the question of records without their first cycle, where it alone speaks for a part of the best set."""
    best = search.best()
    for names in (names for size in range(len(best)) for names in combinations(best, size) if names in search.fits):
        if (lost := begun_otherwise(search.batch, search.fits[names], search.fits[best])) is None:
            continue
        said = replace(lost, beside=_in_words(name for name in best if name not in names))
        tried = changed.within(said)
        batch = tried.posed().batch
        again = fitted_on(search.fits[names], batch) if batch.specimens == search.batch.specimens else None
        if again is not None and evidence.leaves_noise(batch, again):
            return tried.asked()
    return None


def _in_words(names: Iterable[str]) -> str:
    """Return the names of effects, of which none need be there."""
    return " or ".join(map(in_words, names))


def _remember(search: Search, names: Collection[str]) -> bool:
    """Return whether effects have a memory or states of their own, all of them."""
    return all(effect.n_states for effect in search.layout(search.best()).oscillator.effects if effect.name in names)


class _Cut(NamedTuple):
    """Records without edges that are off by a set, what was cut, their batch, and the set fitted to them."""

    changed: Changed
    lost: Edges
    batch: Batch
    found: Fit


def _cut_by(changed: Changed, search: Search, names: Set, *, is_needed: bool = True) -> _Cut | None:
    """Return the records without the edges that are off by a set; None where none are, or too many cycles.

    Where no cut ``is_needed``, as another set explains the records, more than one first cycle is too many, and no more
    edges are looked for once the set is far off without the first: to measure what is left takes as long as reading.
    """
    cut: _Cut | None = None
    batch, found, lost = search.batch, search.fits[names], None
    for _ in range(_EDGES):  # while one edge is in the record, the estimate of the noise holds it, and hides the other
        if (more := edges(batch, found, lost)) is None:
            break
        lost = more if lost is None else more.within(lost)
        if lost.are_too_many or (not is_needed and lost.cycles > 1):
            return None
        shorter = changed.within(lost)
        batch = shorter.posed().batch
        again = fitted_on(found, batch) if batch.specimens == search.batch.specimens else None
        cut = _Cut(shorter, lost, batch, again or found)
        if again is None or (not is_needed and again.chi_square.sum() > _NO_EDGE * batch.count):
            break
        found = again
    return cut


__all__ = ["without_edges", "without_first_cycle"]
