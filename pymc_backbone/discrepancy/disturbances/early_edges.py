"""First cycles that are no free motion, seen in the middle of a search: a set explains all that follows them."""

from __future__ import annotations

from itertools import batched

from ...effects import LIBRARY
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import DRIFTS
from ..proposals.set_fits import Set
from ..sets.fitted_sets import FittedSets
from ..sets.side_by_side import ABREAST, fit_side_by_side
from .behind_filter import ITERATIONS
from .edges import Edges, edges
from .free_start import FreeStart, without_start

_ASKED = 4  # sets so far that leave least
_NEAR = 1.1  # reduced chi-square of what follows the first cycles, up to which a set explains it
_LEFT = 0.5  # of what is left with the first cycles, that is left without them where a drift may explain the rest
_FROM = ("gap", "slip_force")  # roles of what says from which amplitude on an effect acts


def early_edges(search: FittedSets) -> Edges | None:
    """Return the first cycles that no set explains, where one explains what follows them; None where there are none.

    Asked in the middle of a search: beside a filter that has to settle, or a hand, no set leaves noise, however many
    are fitted, and all of them follow what is no free motion. What acts from some amplitude on looks alike: so that set
    is fitted with every such effect that is soon simulated beside it, and none may explain the first cycles.
    """
    lowest = min(search.fits.values(), key=lambda item: item.cost)
    if not search.batch.has_open_records or search.explains(lowest) or (seen := _seen(search)) is None:
        return None
    names, lost = seen
    return None if _is_explained_beside(search, names) else lost


def _seen(search: FittedSets) -> tuple[Set, Edges] | None:
    """Return the simplest set that explains what follows the first cycles, and these."""
    for names in sorted(sorted(search.fits, key=lambda item: search.fits[item].cost)[:_ASKED], key=len):
        free = without_start(search.batch, search.fits[names])
        found = None if free is None else _explaining(search, free, search.fits[names])
        lost = None if found is None else edges(search.batch, found)
        if lost is not None and lost.first:
            return names, lost
    return None


def _explaining(search: FittedSets, free: FreeStart, start: Fit) -> Fit | None:
    """Return the set that explains what follows the first cycles, alone or beside a drift in time; None if neither."""
    most = _NEAR * search.count
    if free.cost < most or not free.cost < _LEFT * start.cost:
        return free.found if free.cost < most else None
    nuisances = (*search.batch.nuisances, *DRIFTS)
    drifting = fit(start.layout, free.batch.waveform, free.found.state, iterations=ITERATIONS, nuisances=nuisances)
    return drifting if drifting is not None and drifting.cost + free.values < most else None


def _is_explained_beside(search: FittedSets, names: Set) -> bool:
    """Return whether a set explains the records to their first sample with what acts from some amplitude on."""
    if len(names) >= search.max_effects:
        return False
    others = [name for name in search.candidates if name not in names and _has_threshold(search, name)]
    larger: list[Set] = [tuple(sorted((*names, name))) for name in others]
    for few in batched([item for item in larger if not is_heavy(search.layout(item))], ABREAST):
        search.progress("what acts in the first cycles", 0.5)
        fit_side_by_side(search, few)
        if search.is_any_exact(search.fits.values()):
            return True
    return False


def _has_threshold(search: FittedSets, name: str) -> bool:
    effect = search.own.get(name) or LIBRARY[name]
    return any(parameter.role in _FROM for parameter in effect.parameters)


__all__ = ["early_edges"]
