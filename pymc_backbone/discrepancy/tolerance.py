"""What does not matter: effects that change the backbones, and sets that miss them, by less than the tolerance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .batch import Batch
from .curves import curve, on_levels
from .evidence import LackOfFit
from .joint_fit import Fit
from .search import Search, Set

UNEXPLAINED = 1e-4
"""p-value of a set's residuals below which it does not explain the records."""


def is_unexplained(lack: LackOfFit, tolerance: Mapping[str, float]) -> bool:
    """Return whether residuals are no noise, and larger than the tolerance on the waveform."""
    limit = tolerance.get("waveform", 0.0)
    return lack.p_value < UNEXPLAINED and not lack.share < limit


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


def relative_change(batch: Batch, larger: Fit, smaller: Fit) -> dict[str, float]:
    """Return the largest relative change of frequency and damping over the levels between two fits."""
    levels = np.asarray(batch.backbones["level"])
    first = on_levels(batch, larger)
    second = on_levels(batch, smaller, free_effects=smaller.layout.free.size > 0)
    worst = {"frequency": 0.0, "damping": 0.0}
    for r, term in enumerate(batch.levels):
        inside = levels[(levels >= term.levels[0] * 0.999) & (levels <= term.levels[-1] * 1.001)]
        a, b = (curve(item, item.parameters(r), inside) for item in (first, second))
        for row, key in ((0, "frequency"), (1, "damping")):
            with np.errstate(invalid="ignore", divide="ignore"):
                change = np.abs(a[row] - b[row]) / np.abs(a[row])
            worst[key] = max(worst[key], float(np.nanmax(change)) if np.isfinite(change).any() else np.inf)
    return worst
