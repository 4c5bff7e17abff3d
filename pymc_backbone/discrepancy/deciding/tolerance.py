"""What does not matter: effects that change the backbones, and sets that miss them, by less than the tolerance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..fitting.curves import relative_change
from ..fitting.drift_course import changes_of, stand_out
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import DRIFTS
from ..sets.search import Search, Set


def is_drift_small(found: Fit, tolerance: Mapping[str, float]) -> bool:
    """Return whether what drifts with time in a fit changes frequency and damping by less than the tolerance."""
    places = list(DRIFTS)
    changes = changes_of(found.state.own[:, places], np.nan_to_num(found.own_covariance[:, places]))
    return all(change < tolerance.get(key, np.inf) for key, change in changes.items())


def damping_drift(found: Fit) -> float:
    """Return by how much damping changes over a record in a fit, relative; nothing where that is within its errors."""
    places = list(DRIFTS)
    values, variances = found.state.own[:, places], np.nan_to_num(found.own_covariance[:, places])
    return changes_of(values, variances)["damping"] if stand_out(values, variances)[1] else 0.0


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
