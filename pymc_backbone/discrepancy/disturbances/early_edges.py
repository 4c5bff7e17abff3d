"""First cycles that are no free motion, seen in the middle of a search: a set explains all that follows them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

from ...effects import LIBRARY
from ..fitting import starts
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import Fit, fit
from ..fitting.layout import Layout
from ..fitting.normal_equations import DRIFTS, State
from ..proposals.set_fits import Set
from ..sets.fitted_sets import FittedSets
from .behind_filter import ITERATIONS
from .changed import takes_nearly_all
from .edges import Edges, edges
from .free_start import FreeStart, without_start

_ASKED = 4  # sets so far that leave least
_NEAR = 1.1  # reduced chi-square of what follows the first cycles, up to which a set explains it
_LEFT = 0.5  # of what is left with the first cycles, that is left without them where a drift may explain the rest
_NEARLY = 0.1  # of what the first cycles leave, that is left where an effect explains them
_STRENGTHS = (0.02, 0.3)  # of what may act in them, over its largest typical one
_SHARES, _SLIPPING = (0.03, 0.15), (0.6, 0.95)  # stiffness of a slider over all, slip displacement over the amplitude
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
    return None if _is_explained_beside(search, seen) else seen.lost


class _Seen(NamedTuple):
    """A set that explains what follows the first cycles, how, and these."""

    names: Set
    found: Fit
    lost: Edges


def _seen(search: FittedSets) -> _Seen | None:
    """Return the simplest set that explains what follows the first cycles, and these."""
    likeliest = sorted(search.fits, key=lambda item: search.fits[item].cost)[:_ASKED]
    for names in sorted(likeliest, key=len):
        if takes_nearly_all(search, likeliest[0], names):
            continue
        free = without_start(search.fits[names], search.batch)
        found = None if free is None else _explaining(search, free, search.fits[names])
        lost = None if found is None else edges(search.batch, found)
        if free is not None and lost is not None and lost.first:
            return _Seen(names, free.found, lost)
    return None


def _explaining(search: FittedSets, free: FreeStart, start: Fit) -> Fit | None:
    """Return the set that explains what follows the first cycles, alone or beside a drift in time; None if neither."""
    most = _NEAR * search.count
    if free.cost < most or not free.cost < _LEFT * start.cost:
        return free.found if free.cost < most else None
    nuisances = (*search.batch.nuisances, *DRIFTS)
    drifting = fit(start.layout, free.batch.waveform, free.found.state, iterations=ITERATIONS, nuisances=nuisances)
    return drifting if drifting is not None and drifting.cost + free.values < most else None


def _is_explained_beside(search: FittedSets, seen: _Seen) -> bool:
    """Return whether a set explains the first cycles, or nearly, with what acts from some amplitude on."""
    noise, left = float(search.count), search.fits[seen.names].cost
    if len(seen.names) >= search.max_effects:
        return False
    for name in search.candidates:
        if name in seen.names or not _has_threshold(search, name):
            continue
        layout = search.layout(tuple(sorted((*seen.names, name))))
        if is_heavy(layout):
            continue
        search.progress("what acts in the first cycles", 0.5)
        found = search.descent.from_near(layout, list(_begun(layout, name, seen.found)))
        if found is not None and found.cost - noise < _NEARLY * (left - noise):
            return True
    return False


def _begun(layout: Layout, name: str, known: Fit) -> Iterator[State]:
    """Yield starts with an effect beside a set as it ended without the first cycles.

    A slider begins as a part of the spring that it is where it sticks, so that the phase is not lost.
    """
    begun, _ = starts.embedded(layout, known)
    where = starts.positions(layout, name)
    slips = [(strength, slip) for strength, slip in layout.slips if strength in where]
    for share, slipping in product(_SHARES, _SLIPPING) if slips else ():
        eta, own = begun.eta.copy(), begun.own.copy()
        for strength, slip in slips:
            stiffness = share * float(own[:, 0].mean())
            eta[[strength, slip]] = stiffness * slipping * layout.amplitude, slipping
            own[:, 0] -= stiffness
        yield State(eta, own)
    for point in starts.grid(layout, name, _STRENGTHS) if not slips else ():
        eta = begun.eta.copy()
        eta[where] = point
        yield State(eta, begun.own)


def _has_threshold(search: FittedSets, name: str) -> bool:
    effect = search.own.get(name) or LIBRARY[name]
    return any(parameter.role in _FROM for parameter in effect.parameters)


__all__ = ["early_edges"]
