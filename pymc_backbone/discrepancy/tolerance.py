"""What does not matter: effects that change the backbones, and sets that miss them, by less than the tolerance."""

from __future__ import annotations

from collections.abc import Mapping

from .curves import relative_change
from .search import Search, Set


def prune(search: Search, best: Set, tolerance: Mapping[str, float]) -> tuple[Set, Set]:
    """Return the effects of a set that change the backbones by more than the tolerance, and those that do not."""
    kept = best
    below: list[str] = []
    while kept:
        changes = {}
        for name in kept:
            rest = tuple(other for other in kept if other != name)
            if rest not in search.fits:
                search.fit_set(rest)
            if rest in search.fits:
                changes[name] = relative_change(search.batch, search.fits[kept], search.fits[rest])
        small = [
            name
            for name, change in changes.items()
            if all(change.get(key, 0.0) < limit for key, limit in tolerance.items() if key in change)
        ]
        if not small:
            break
        weakest = min(small, key=lambda name: max(changes[name].values()))
        below.append(weakest)
        kept = tuple(other for other in kept if other != weakest)
    return kept, tuple(below)
