"""Records that begin after the release by more than half a cycle: what remembers was released a turning point earlier.

A record without its release is taken for one that begins in the first half cycle. Where nothing remembers that is no
assumption: every turning point is a release. What remembers begins as the release left it at the true one only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import NUISANCES, State
from ..fitting.record_term import before
from ..sets.relaxed_release import remembers
from ..sets.search import Search
from ..weighing import evidence

_ASKED = 3  # likeliest sets that remember, which are asked
_MOST = 2  # turning points by which a record that begins within a cycle of its release may be too late
_BEGUN, _SETTLED = 8, 12  # iterations over the turning points and the samples, the shared values held
_FEWEST = 4  # turning points that tell those before them
_RUN_IN, _LARGER = 4, 1.25  # turning points from which a cut record runs in, and how much larger these may be
_WORTH = 25.0  # fall of chi-square of one record from which it was released earlier
_NEAR = 1.5  # of what the most probable set leaves, within which a set of fewer effects is asked beside it


@dataclass(frozen=True, eq=False)
class Earlier:
    """By how many turning points each specimen was released earlier than its record was taken to begin."""

    turns: Mapping[str, int]

    def released(self, batch: Batch) -> Batch:
        """Return a batch of the same records with these releases."""
        for r, name in enumerate(batch.specimens):
            batch = _earlier(batch, r, self.turns.get(name, 0))
        return batch

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        names = sorted(self.turns)
        which = "one record begins" if len(names) == 1 else f"{len(names)} records begin"
        return f"{which} more than half a cycle after the release, which what remembers tells ({', '.join(names)})"


def earlier(search: Search) -> Earlier | None:
    """Return which specimens were released earlier than taken for, if what remembers does not explain the records.

    Each is released from there once more, the shared values of one of the likeliest sets that remember held; that set
    counts which leaves least then. Where a set of several effects explains the records, sets of fewer are asked that
    leave hardly more, and count where they leave as little then: what a release at another place leaves is small, and
    several effects imitate it. None where records are compared through a band-pass: their releases are found from the
    course of the decay.
    """
    batch, best = search.batch, search.best()
    if not batch.has_open_records:
        return None
    asked, most = [names for names in search.ranked() if remembers(search.fits[names])], np.inf
    if evidence.leaves_noise(batch, search.fits[best]):
        lowest = search.fits[best].cost
        asked = [names for names in asked if len(names) < len(best) and search.fits[names].cost < _NEAR * lowest]
        most = lowest + _WORTH
    found = [item for item in (_released(batch, search.fits[names]) for names in asked[:_ASKED]) if item is not None]
    found = [item for item in found if item[0] < most]
    if not found:
        return None
    turns = min(found, key=lambda item: item[0])[1]
    return Earlier(turns) if turns else None


def run_in(batch: Batch, specimens: Iterable[str]) -> Batch:
    """Return a batch of which some specimens move for up to two cycles before the simulation is compared.

    Where the first cycles of a record were cut, what remembers has the history of those: loaded from rest up to the
    first turning point that is left, it would hold another force than after them, by much for some laws. Not so many
    cycles that the motion had been much larger: nobody knows what acts there.
    """
    for r in [batch.specimens.index(name) for name in specimens if name in batch.specimens]:
        limit = _LARGER * abs(float(batch.own[r, 2]))
        tried = (_earlier(batch, r, count) for count in range(_RUN_IN, 0, -1))
        batch = next((item for item in tried if abs(float(item.own[r, 2])) <= limit), batch)
    return batch


def _released(batch: Batch, found: Fit) -> tuple[float, dict[str, int]] | None:
    """Return what a set leaves with each specimen released where it leaves least, and where that is earlier."""
    cost, turns = 0.0, {}
    for r, name in enumerate(batch.specimens):
        own = batch.subset([r])
        most = _MOST if own.turning[0].times.size >= _FEWEST else 0
        left = {k: _left(own, found, r, k) for k in range(most + 1) if k == 0 or not _holds(own, k)}
        best = min(left, key=lambda k: left[k] + (_WORTH if k else 0.0))
        if not np.isfinite(left[best]):
            return None
        cost += left[best]
        if best:
            turns[name] = best
    return cost, turns


def _holds(own: Batch, count: int) -> bool:
    """Return whether a record holds the instant so many turning points before its release: it had not begun then."""
    return bool(_earlier(own, 0, count).own[0, 3] > own.records[0].measured.time[0])


def _left(own: Batch, found: Fit, specimen: int, count: int) -> float:
    """Return what a fit leaves of a specimen that was released so many turning points earlier, its own values free."""
    own = _earlier(own, 0, count)
    values = found.state.own[[specimen]].copy()
    eta = found.layout.within(found.state.eta * (1.0 + found.layout.scatter * values[0, NUISANCES:]))
    layout = replace(found.layout, low=eta, high=eta)
    values[:, NUISANCES:] = 0.0
    if count:
        values[0, 2:4] = own.own[0, 2:4]
    state = State(eta, values)
    if count:
        begun = fit(layout, own.turning, state, iterations=_BEGUN, has_scatter=False)
        state = state if begun is None else begun.state
    reached = fit(layout, own.deciding, state, iterations=_SETTLED, nuisances=own.nuisances, has_scatter=False)
    return np.inf if reached is None else float(reached.chi_square.sum())


def _earlier(batch: Batch, specimen: int, count: int) -> Batch:
    """Return a batch with one specimen released so many turning points earlier."""
    term, own = batch.turning[specimen], batch.own.copy()
    release, begin = own[specimen, 2:4]
    times, values = term.times, term.values
    for _ in range(count):
        times, values = np.concatenate([[begin], times]), np.concatenate([[release], values])
        begin, release = before(times, values)
    own[specimen, 2:4] = release, begin
    level = replace(batch.levels[specimen], release=abs(float(release)))

    def changed[T](items: tuple[T, ...], item: T) -> tuple[T, ...]:
        return (*items[:specimen], item, *items[specimen + 1 :])

    return replace(
        batch,
        own=own,
        levels=changed(batch.levels, level),
        turning=changed(batch.turning, replace(term, skipped=term.skipped + count)),
    )


__all__ = ["Earlier", "earlier", "run_in"]
