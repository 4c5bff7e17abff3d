"""Whether changed records are worth a search of their own: by what the best sets leave of them."""

from __future__ import annotations

from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import State
from ..weighing import evidence
from .search import Search

_ASKED = 6  # sets that leave least, and the base
_BEGUN, _SETTLED = 8, 12  # iterations over the turning points and the samples


def is_promising(search: Search, batch: Batch, less: float) -> bool:
    """Return whether one of the best sets leaves noise of changed records, or less than that share of what was left.

    Each is fitted on from where it was, released as the changed records say. A whole search takes ten times as long,
    and where none of the best sets gains by the change, it ends as the one before it.
    """
    if batch.specimens != search.batch.specimens:
        return True
    before = evidence.lack_of_fit(search.batch, search.fits[search.best()]).share
    likeliest = sorted(search.fits, key=lambda names: search.fits[names].cost)[:_ASKED]
    for names in dict.fromkeys([search.best(), *likeliest, ()]):
        found = fitted_on(search.fits[names], batch)
        if found is None:
            continue
        lack = evidence.lack_of_fit(batch, found)
        if lack.p_value >= evidence.UNEXPLAINED or lack.share < less * before:
            return True
    return False


def fitted_on(found: Fit, batch: Batch) -> Fit | None:
    """Return the fit of a set to other records of the same specimens."""
    own = found.state.own.copy()
    own[:, 2:4] = batch.own[:, 2:4]
    begun = fit(found.layout, batch.turning, State(found.state.eta, own), iterations=_BEGUN)
    if begun is None:
        return None
    return fit(found.layout, batch.deciding, begun.state, iterations=_SETTLED, nuisances=batch.nuisances)


__all__ = ["fitted_on", "is_promising"]
