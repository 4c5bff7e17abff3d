"""Models with a frequency and a damping that change with time: at one rate, or as what settles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from ..fitting.batch import Batch
from ..fitting.descent import first_limit, is_heavy
from ..fitting.joint_fit import Fit, fit
from ..fitting.layout import Layout
from ..fitting.normal_equations import DRIFTS, State
from ..proposals.set_fits import Set
from ..sets.fitted_sets import FittedSets
from ..sets.followed_sets import NOISE
from ..weighing import evidence
from ..weighing.evidence import Drifting
from .drift_kinds import drift_bonus

_FIRST_TURNS = 108  # turning points that may refute a set with a drift, before all are looked at
_STEADY = 0.5  # of what a set leaves, that a steady drift leaves at most beside which one is asked that settles
_SETTLES = (0.1, 5.0)  # time constants that are asked, in lengths of the records
_ROUGH, _NEAR_ENOUGH, _MOST = 0.1, 0.02, 14  # in the logarithm of that: by turning points, samples; most fits of these
_ON = 12  # iterations over the samples, from where the nearest time constant ended
_AROUND = 0.7  # in the logarithm of that, about what the turning points tell, where the samples are asked
_FOLLOWS = 10.0  # reduced chi-square of the turning points that no drift leaves which explains the records
_SETTLING, _OF_PEAK = 0.25, 5  # share of drifts that settle; time constants that tell how closely one is known
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


def weighed(batch: Batch, found: Fit, alone: Fit) -> Drifting:
    """Return a fit with a drift, and what its evidence gains over that of the set ``alone``; that it settles minded."""
    return Drifting(found, drift_bonus(found, alone) + batch.settling_odds)


def drift_alone(search: FittedSets) -> Drifting | None:
    """Return the model as it is with a drift in time, if that leaves noise; asked before larger sets are."""
    if not search.batch.has_open_records:
        return None
    base = search.fits[()]
    found = drift_fit(search.batch, base.layout, base.state)
    if found is None:
        return None
    if evidence.leaves_noise(search.batch, found):
        return weighed(search.batch, found, base)
    # what law explains releases of different amplitude, no drift that settles does better
    with_time = None if _is_noise_left(search) else settled(search.batch, base, found)
    if with_time is None or not with_time.is_of_time:
        return None
    search.batch = with_time.batch
    return with_time.drifting(base)


def likeliest(search: FittedSets, drifting: Mapping[Set, Drifting], batch: Batch | None = None) -> Set:
    """Return the most probable set, with `DRIFT` among its names where that is with a drift in time beside it.

    The residuals of ``batch``, which is that of the search by default, say how much the samples tell.
    """
    fits, bonus = evidence.beside_drifts(search.fits, drifting)
    known = search.batch if batch is None else batch
    posterior = evidence.probabilities(fits, known, len(search.candidates), bonus, search.variants)
    return max(posterior, key=lambda names: posterior[names].log_posterior)


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


class Settled(NamedTuple):
    """A set with a drift of frequency that settles: the batch whose drifts do so, the fit, and what releases say."""

    batch: Batch
    fit: Fit
    is_of_time: bool

    def drifting(self, alone: Fit) -> Drifting:
        """Return the fit with what its evidence gains over that of the set ``alone``."""
        return weighed(self.batch, self.fit, alone)


def settled(batch: Batch, alone: Fit, steady: Fit) -> Settled | None:
    """Return a set with a drift that settles; None unless it leaves noise.

    Asked where a ``steady`` drift takes away most of what the set ``alone`` leaves, and not all. What settles and what
    a decaying amplitude leaves of a spring's law are the same curve over one record: only where releases of different
    amplitude drift by as much do these say that it is a drift. That it settles, and with this time constant of all, it
    has to be worth (`Batch.settling_odds`).
    """
    length = float(np.median([np.ptp(term.time) for term in batch.waveform]))
    left, before = steady.cost - batch.count, alone.cost - batch.count
    if batch.waveform[0].settling or left > _STEADY * before:
        return None
    nuisances = (*batch.nuisances, *DRIFTS)
    found: dict[float, Fit] = {}

    def over_turning_points(log_share: float) -> float:
        terms = batch.settling(float(np.exp(log_share)) * length).turning
        fitted = fit(alone.layout, terms, steady.state, iterations=20, nuisances=nuisances, tolerance=1.0)
        return _NOT_FITTED * alone.cost if fitted is None else fitted.cost  # finite, as parabolas are laid through it

    def over_samples(log_share: float) -> float:
        terms = batch.settling(float(np.exp(log_share)) * length).waveform
        begin = found[min(found, key=lambda at: abs(at - log_share))].state
        fitted = fit(alone.layout, terms, begin, iterations=_ON, nuisances=nuisances)
        if fitted is not None:
            found[log_share] = fitted
        return _NOT_FITTED * alone.cost if fitted is None else fitted.cost

    low, high = np.log(_SETTLES).tolist()
    # turning points are soon fitted, and tell where no drift that settles leaves noise
    begun = minimize_scalar(over_turning_points, bounds=(low, high), method="bounded", options={"xatol": _ROUGH})
    if begun.fun > _FOLLOWS * sum(term.size for term in batch.turning):
        return None
    first = drift_fit(batch.settling(float(np.exp(begun.x)) * length), alone.layout, steady.state)
    if first is None:
        return None
    found[float(begun.x)] = first
    near = (max(float(begun.x) - _AROUND, low), min(float(begun.x) + _AROUND, high))
    minimize_scalar(over_samples, bounds=near, method="bounded", options={"xatol": _NEAR_ENOUGH, "maxiter": _MOST})
    place = min(found, key=lambda item: found[item].cost)
    odds = _log_odds({at: item.cost for at, item in found.items()}, place, high - low)
    share = float(np.exp(place))
    with_it = batch.settling(share * length, odds)
    if not evidence.leaves_noise(with_it, found[place]):
        return None
    return Settled(with_it, found[place], _is_of_time(batch, found[place], share))


def _log_odds(costs: dict[float, float], place: float, width: float) -> float:
    """Return the logarithm of what a time constant is worth: the width of its peak over that of all that it may be."""
    around = sorted(costs, key=lambda at: abs(at - place))[:_OF_PEAK]
    if len(around) < 3:
        return float(np.log(_SETTLING))
    bent = float(np.polyfit([at - place for at in around], [costs[at] for at in around], 2)[0])  # half the curvature
    peak = np.sqrt(2.0 * np.pi / bent) if bent > 0.0 else width  # of exp(-cost / 2), in the logarithm of the constant
    return float(np.log(_SETTLING * min(peak / width, 1.0)))


def _is_noise_left(search: FittedSets) -> bool:
    """Return whether a set that is soon simulated leaves nothing but noise."""
    lowest = min(search.fits.values(), key=lambda item: item.cost)
    return not is_heavy(lowest.layout) and evidence.lack_of_fit(search.batch, lowest).p_value > NOISE


__all__ = ["Settled", "drift_alone", "drift_fit", "likeliest", "settled", "weighed"]
