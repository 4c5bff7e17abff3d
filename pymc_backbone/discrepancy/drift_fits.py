"""Models with a frequency and a damping that change with time: at one rate, or as what settles."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from . import evidence
from .batch import Batch
from .descent import first_limit
from .drift_kinds import drift_bonus
from .evidence import Drifting
from .fitted_sets import FittedSets
from .joint_fit import Fit, fit
from .layout import Layout
from .normal_equations import DRIFTS, State
from .set_fits import Set

_FIRST_TURNS = 108  # turning points that may refute a set with a drift, before all are looked at
_STEADY = 0.5  # of what a set leaves, that a steady drift leaves at most beside which one is asked that settles
_SETTLES = (0.1, 5.0)  # time constants that are asked, in lengths of the records
_NEAR_ENOUGH, _MOST = 0.02, 14  # in the logarithm of that, and most fits for it
_NOT_FITTED = 1e3  # times what the set leaves, as which a time constant counts that cannot be fitted
_ALIKE_DRIFTS = 0.05  # by which drifts that are alike may differ, relative to their size
_OF_LAW = 0.5  # of the power of a law that settles so fast, up to which with two standard errors drifts are none of it


def drift_fit(batch: Batch, layout: Layout, state: State, limit: float = np.inf) -> Fit | None:
    """Return a model with a frequency and a damping that change with time, in each record as it likes.

    None where the sum of squares over the turning points stays above ``limit``: these are soon fitted.
    """
    if not batch.has_records:
        return None
    nuisances = (*batch.nuisances, *DRIFTS)
    first = [term.first(_FIRST_TURNS) for term in batch.turning]
    edge = first_limit(batch, limit)
    begun = fit(layout, first, state, iterations=20, nuisances=nuisances, tolerance=1.0, goal=edge)
    if begun is not None and begun.cost > edge:
        return None
    turning = fit(layout, batch.turning, state, iterations=20, nuisances=nuisances, tolerance=1.0)
    found = None
    if turning is not None and turning.cost > limit:
        return None
    if turning is not None:
        found = fit(layout, batch.waveform, turning.state, iterations=40, nuisances=nuisances)
    rival = None if found is None else found.cost
    near = fit(layout, batch.waveform, state, iterations=40, nuisances=nuisances, rival=rival)
    both = [item for item in (found, near) if item is not None]
    return min(both, key=lambda item: item.cost) if both else None


def drift_alone(search: FittedSets) -> Drifting | None:
    """Return the model as it is with a drift in time, if that leaves noise; asked before larger sets are."""
    if not search.batch.has_open_records:
        return None
    base = search.fits[()]
    found = drift_fit(search.batch, base.layout, base.state)
    if found is None:
        return None
    if not evidence.leaves_noise(search.batch, found):
        found = settle(search, (), found)
    return None if found is None else Drifting(found, drift_bonus(found, base))


def _is_of_time(batch: Batch, drifting: Fit, share: float) -> bool:
    """Return whether records drift in frequency by as much whatever amplitude they were released from.

    Of a law the frequency changes with a power of the amplitude, and so does the drift with that of the release; the
    drift settles as that power of a decaying amplitude does. ``share`` is its time constant, in lengths of the records:
    it says which power that would be.
    """
    drift, variance = drifting.state.own[:, DRIFTS[0]], drifting.own_covariance[:, DRIFTS[0]]
    if not ((drift > 0.0).all() or (drift < 0.0).all()) or not np.isfinite(variance).all():
        return False
    falls = [np.log(np.abs(term.values[:2]).max() / np.abs(term.values[-2:]).max()) for term in batch.turning]
    needed = 1.0 / (share * max(float(np.median(falls)), 1e-12))
    sizes, releases = np.log(np.abs(drift)), np.log(np.abs([term.values[0] for term in batch.turning]))
    apart = releases - releases.mean()
    known = float(apart @ apart)
    if not known > 0.0:
        return False
    power = float(apart @ sizes) / known
    left = sizes - sizes.mean() - power * apart
    scatter = max(float(np.sqrt(left @ left / max(sizes.size - 2, 1))), _ALIKE_DRIFTS)
    error = np.sqrt(scatter**2 + float((variance / drift**2).mean())) / np.sqrt(known)
    return bool(abs(power) + 2.0 * error < _OF_LAW * needed)


def settle(search: FittedSets, names: Set, steady: Fit) -> Fit | None:
    """Return a set with a drift that settles, and let drifts settle as that does; None unless it leaves noise.

    Asked where a steady drift takes away most of what the set leaves, and not all. What settles and what a decaying
    amplitude leaves of a spring's law are the same curve over one record: only where releases of different amplitude
    drift by as much is it a drift.
    """
    batch, alone = search.batch, search.fits[names]
    length = float(np.median([np.ptp(term.time) for term in batch.waveform]))
    left, before = steady.cost - search.count, alone.cost - search.count
    if batch.waveform[0].settling or left > _STEADY * before:
        return None
    found: dict[float, Fit] = {}

    def leaves(log_share: float) -> float:
        share = float(np.exp(log_share))
        fitted = drift_fit(batch.settling(share * length), alone.layout, steady.state)
        if fitted is not None:
            found[share] = fitted
        return _NOT_FITTED * alone.cost if fitted is None else fitted.cost  # finite, as parabolas are laid through it

    minimize_scalar(
        leaves, bounds=np.log(_SETTLES), method="bounded", options={"xatol": _NEAR_ENOUGH, "maxiter": _MOST}
    )
    share = min(found, key=lambda item: found[item].cost, default=0.0)
    if not share:
        return None
    settled = batch.settling(share * length)
    if not (evidence.leaves_noise(settled, found[share]) and _is_of_time(batch, found[share], share)):
        return None
    search.batch = settled
    return found[share]


__all__ = ["drift_alone", "drift_fit", "settle"]
