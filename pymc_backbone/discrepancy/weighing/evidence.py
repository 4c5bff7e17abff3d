"""How probable each set of effects is, honest about errors that no set explains."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import comb
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.special import chdtr, chdtrc, chdtri, fdtrc, logsumexp, ndtr, ndtri

from ..._common.checks import FloatArray
from ..fitting.batch import Batch
from ..fitting.data_term import DataTerm
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import NUISANCES, information
from ..fitting.starts import positions
from ..fitting.waveform_term import Subspace, WaveformTerm

PRIOR_OF_SIZE = (0.38, 0.565, 0.05, 0.005)
"""Prior probability that so many effects are missing, shared evenly among the sets of that size."""
PRIOR_NONE = 0.05
"""Prior probability that the library does not hold what is missing."""
VARIANT = 0.03
"""Prior probability of a variant of an effect over that of the effect."""
DRIFTING = 0.1
"""Prior probability that frequency or damping change with time beside a set of effects, as with the temperature."""
UNSEEN = 0.5
"""Prior probability that a missing effect is too small to be seen, where nothing is known of the records."""
DETECTED = 5.0
"""Standard deviations at which an effect is named nine times in ten."""
_DECADES = 4.0  # over which a strength is log-uniform beforehand, up to the default bound
_LEAST_UNSEEN = 0.05
_PRESENT = 4.0  # standard errors of a strength from which an effect is no longer one that may be too small

MISSING = 0.01
"""p-value of "nothing is missing" below which something is."""
DRIFT = ("drift with time",)
"""What stands beside the effects of a set whose frequency and damping change with time as well."""
UNEXPLAINED = 1e-4
"""p-value of a set's residuals below which it does not explain the records."""
_MOST = 0.75  # of the lines midway between harmonics that say how loud the noise is
_PLACE = 0.4  # of a number beyond those kept, where the quantile lies that leaves no bias
_INDEPENDENT = 8.0  # the effects of the library count as so many independent attempts

# Sets are ranked again after each fit, and most fits are those of the last time.
_determinants: WeakKeyDictionary[Fit, dict[float, float]] = WeakKeyDictionary()
_sizes: WeakKeyDictionary[Fit, WeakKeyDictionary[DataTerm, dict[int, float]]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Evidence:
    """Evidence of a set: logarithm relative to the base, of the posterior up to a constant, and the probability."""

    log_evidence: float
    log_posterior: float
    probability: float


class NoiseScale(NamedTuple):
    """What the likelihood of all sets refers to.

    Attributes
    ----------
    sizes : (r,) array
        Independent pieces in the residuals of each specimen; infinite where the noise is known.
    floor : (r,) array
        Sums of squares of the best set.
    noise : float
        Variance of the residuals in units of the one assumed.
    """

    sizes: FloatArray
    floor: FloatArray
    noise: float


class Drifting(NamedTuple):
    """A set whose frequency and damping also change with time in each record: its fit, and what its evidence gains."""

    fit: Fit
    bonus: float


def beside_drifts(
    fits: Mapping[tuple[str, ...], Fit], drifting: Mapping[tuple[str, ...], Drifting]
) -> tuple[dict[tuple[str, ...], Fit], dict[tuple[str, ...], float]]:
    """Return fits with those beside a drift among them, `DRIFT` at the end of their names, and what these gain."""
    beside = {(*names, *DRIFT): item for names, item in drifting.items()}
    return (
        {**fits, **{names: item.fit for names, item in beside.items()}},
        {names: item.bonus for names, item in beside.items()},
    )


def log_prior(size: int, candidates: int) -> float:
    """Return the logarithm of the prior probability of one set of this size."""
    share = PRIOR_OF_SIZE[min(size, len(PRIOR_OF_SIZE) - 1)]
    return float(np.log(share / max(comb(candidates, size), 1)))


def _log_prior(names: tuple[str, ...], candidates: int) -> float:
    """Return the logarithm of the prior probability of a set, with a drift or without; with a drift alone it is one."""
    if len(names) > 1 and names[-1:] == DRIFT:
        return log_prior(len(names) - 1, candidates) + float(np.log(DRIFTING))
    return log_prior(len(names), candidates)


def probabilities(
    fits: Mapping[tuple[str, ...], Fit],
    batch: Batch,
    candidates: int,
    bonus: Mapping[tuple[str, ...], float] | None = None,
    variants: Collection[str] = (),
    odds: Mapping[tuple[str, ...], float] | None = None,
    corrections: Mapping[tuple[str, ...], float] | None = None,
) -> dict[tuple[str, ...], Evidence]:
    """Return the evidence of every fitted set.

    The likelihood has the scale of its noise free, specimen by specimen: ``-n_eff/2 log(chi^2 / chi^2_best)``. Where
    the residuals of the best set are white, ``n_eff`` is the number of samples. Where they are not, something is there
    that no set explains; it does not repeat itself independently in every sample, and ``n_eff`` is the number of
    independent pieces that the residuals' own correlation leaves. So a wrong set is never preferred with a certainty
    that only the number of samples lends it. ``bonus`` is added to the logarithm of the evidence of some, and so is
    what Laplace's method is off by (``corrections``); ``odds`` are what else than the likelihood speaks for a set, as a
    natural logarithm. Effects that are ``variants`` of others are rarer than these by a factor `VARIANT`.
    """
    if not fits:
        return {}
    scale, off = noise_scale(fits, batch), corrections or {}
    logs = {
        names: laplace(found, scale) + found.scatter.log_evidence + (bonus or {}).get(names, 0.0) + off.get(names, 0.0)
        for names, found in fits.items()
    }
    base = logs.get((), 0.0)
    for names, found in fits.items():
        if len(names) == 1 and names not in (bonus or {}):
            hidden = unseen(found, names[0])
            logs[names] = float(np.logaddexp(np.log(hidden) + base, np.log1p(-hidden) + logs[names]))
    rarer = {names: sum(name in variants for name in names) * np.log(VARIANT) for names in logs}
    others = odds or {}
    posterior = {
        names: value + _log_prior(names, candidates) + rarer[names] + others.get(names, 0.0)
        for names, value in logs.items()
    }
    total = logsumexp(list(posterior.values()))
    return {
        names: Evidence(logs[names] - base, posterior[names], float(np.exp(posterior[names] - total))) for names in fits
    }


def unseen(found: Fit, name: str) -> float:
    """Return the prior probability that an effect is there and too small to be seen: then it is as without it.

    By what these records would show: strengths are log-uniform over four decades up to their default bounds, and seen
    from `DETECTED` standard errors on. Of an effect that is clearly there nothing is to be said.
    """
    where = positions(found.layout, name)
    if not where or not np.isfinite(found.covariance).all():
        return UNSEEN
    error = float(np.sqrt(max(found.covariance[where[0], where[0]], 0.0)))
    if not error > 0.0 or abs(found.state.eta[where[0]]) > _PRESENT * error:
        return UNSEEN
    bound = float(found.layout.width[where[0]] * np.sqrt(12.0))
    below = 1.0 + np.log10(DETECTED * error / bound) / _DECADES
    return float(np.clip(below, _LEAST_UNSEEN, 1.0 - _LEAST_UNSEEN))


def noise_scale(fits: Mapping[tuple[str, ...], Fit], batch: Batch) -> NoiseScale:
    """Return what the best of some fits says of the noise."""
    best = min(fits.values(), key=lambda item: item.cost)
    floor = np.maximum(best.chi_square, 1e-12)
    if not batch.has_records:
        return NoiseScale(np.full(floor.size, np.inf), floor, 1.0)
    sizes = np.array([_known_size(w, best, r) for r, w in enumerate(batch.deciding)])
    return NoiseScale(sizes, floor, float(floor.sum() / sizes.sum()))


def _known_size(term: DataTerm, found: Fit, specimen: int) -> float:
    """Return the effective size; remembered, for it takes a simulation."""
    known = _sizes.setdefault(found, WeakKeyDictionary()).setdefault(term, {})
    if specimen not in known:
        known[specimen] = effective_size(term, found, specimen)
    return known[specimen]


def laplace(found: Fit, scale: NoiseScale) -> float:
    """Return the logarithm of the evidence of a fit with the scatter that it was made with, by Laplace's method."""
    if np.isfinite(scale.sizes).all():
        ratio = np.maximum(found.chi_square, 1e-12) / scale.floor
        likelihood = -0.5 * float(scale.sizes @ np.log(ratio)) - 0.5 * found.penalty
    else:
        likelihood = -0.5 * found.cost
    known = _determinants.setdefault(found, {})
    if scale.noise not in known:
        known[scale.noise] = information(found.layout, found.system, found.state, found.active, scale.noise)[0]
    return likelihood - 0.5 * known[scale.noise]


def residuals_of(term: DataTerm, found: Fit, specimen: int) -> FloatArray:
    """Return the standardised residuals of one specimen at a fit."""
    own = found.state.own[specimen]
    vector = found.parameters(specimen)
    compared = term.compare(found.layout.simulator, vector, own[2:NUISANCES])
    return np.zeros(term.size) if compared is None else compared[0]


def residuals_as_measured(term: WaveformTerm, found: Fit, specimen: int) -> FloatArray:
    """Return what a fit leaves of the samples of one specimen, not whitened.

    The estimate of the noise holds what disturbs the samples, too, and whitening would take most of it away.
    """
    return residuals_of(replace(term, whiten=lambda columns: columns), found, specimen)


def effective_size(term: DataTerm, found: Fit, specimen: int) -> float:
    """Return the number of independent pieces in the residuals of one specimen."""
    residuals = residuals_of(term, found, specimen)
    n = residuals.size
    if not isinstance(term, WaveformTerm) or n < 16:
        return float(n)
    power = np.abs(np.fft.rfft(residuals, 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n] / max(float(residuals @ residuals), 1e-300)
    excess = float(np.sum(correlation[1:] ** 2) - 0.5)  # white noise gives 1/n on each of n lags, tapered
    slack = 3.0 * np.sqrt(1.0 / n)
    return float(n / (1.0 + 2.0 * max(excess - slack, 0.0)))


@dataclass(frozen=True)
class LackOfFit:
    """Whether the residuals look like a model error: variance ratio, p-value, and size over the signal."""

    ratio: float
    p_value: float
    share: float


def lack_of_fit(batch: Batch, found: Fit, *, is_local: bool = False) -> LackOfFit:
    """Return whether residuals hold more along the motion's slowly varying harmonics than beside them.

    The noise level comes from the residuals beside, so that an error in its estimate does not matter: from all of them,
    or, where ``is_local``, midway between the harmonics if there is more of it. Noise often grows towards low
    frequencies; but of strongly damped motion a small model error is found midway, too. Of a measured velocity or
    acceleration, which hold less of what is slow, that level counts always, as it is in most parts of the record: a
    model error fades with the motion, and noise does not.
    """
    fitted = found.layout.free.size / max(len(batch.specimens), 1) + len(batch.nuisances)
    z, ratios, shares = [], [], []
    for r, term in enumerate(batch.deciding):
        residuals = residuals_of(term, found, r)
        if isinstance(term, WaveformTerm) and term.subspace:
            inside, degrees = _power(residuals, term.subspace)
            degrees -= fitted
            outside = float(residuals @ residuals) - inside
            rest = residuals.size - degrees - fitted
            noise = outside / max(rest, 1.0)
            level, lines = _between(residuals, term.beside, in_most=not is_local)
            if (is_local or term.order) and level > noise:
                noise, rest = level, lines
            ratio = inside / max(degrees, 1.0) / max(noise, 1e-300)
            p = float(fdtrc(max(degrees, 1.0), max(rest, 1.0), ratio))
            shares.append(np.sqrt(max(inside - degrees * noise, 0.0)) / _size_of_motion(term))
        else:
            degrees = max(residuals.size - fitted, 1.0)
            ratio = float(residuals @ residuals) / degrees
            # the noise itself is known to some ten per cent only
            p = float(fdtrc(degrees, 60.0, ratio)) if batch.has_records else float(chdtrc(degrees, ratio * degrees))
            excess = max(float(residuals @ residuals) - degrees, 0.0)
            size = _size_of_motion(term) if isinstance(term, WaveformTerm) else float("nan")
            shares.append(np.sqrt(excess) / size)
        ratios.append(ratio)
        z.append(float(-ndtri(min(max(p, 1e-300), 1.0 - 1e-15))))
    combined = float(ndtr(-np.sum(z) / np.sqrt(len(z)))) if z else 1.0
    worst = min(1.0, len(z) * float(ndtr(-max(z)))) if z else 1.0
    return LackOfFit(float(np.median(ratios)), min(1.0, 2.0 * min(combined, worst)), float(np.max(shares)))


def leaves_noise(batch: Batch, found: Fit) -> bool:
    """Return whether a set explains the records down to what may be noise."""
    return lack_of_fit(batch, found).p_value >= UNEXPLAINED


def _power(residuals: FloatArray, lines: Subspace) -> tuple[float, float]:
    """Return the sum of squares of residuals along lines, and how many these are."""
    return (
        sum(float(((basis.T @ residuals[window]) ** 2).sum()) for window, basis in lines),
        float(sum(basis.shape[1] for _, basis in lines)),
    )


def _between(residuals: FloatArray, lines: Subspace, *, in_most: bool) -> tuple[float, float]:
    """Return the mean square of residuals along lines and how many these are; zero where there are none.

    Over all of a record; or as it is along most lines in most parts of the record, so that neither another mode's line
    nor what fades counts.
    """
    if not lines:
        return 0.0, 0.0
    power, count = _power(residuals, lines)
    if not in_most:
        return power / count, count
    return float(np.median([_of_most((basis.T @ residuals[window]) ** 2) for window, basis in lines])), count


def _of_most(squares: FloatArray) -> float:
    """Return the variance of normal numbers from all but the largest of their squares."""
    kept = max(int(_MOST * squares.size), 1)
    share = min((kept + _PLACE) / squares.size, 1.0)
    largest = chdtri(1.0, 1.0 - share) if share < 1.0 else np.inf
    return float(np.sort(squares)[:kept].mean() * share / chdtr(3.0, largest))


def p_nothing_missing(fits: Mapping[tuple[str, ...], Fit], batch: Batch) -> float:
    """Return the p-value of the base model: by what its residuals hold, and by what any one effect would gain."""
    base = fits[()]
    count = sum(term.size for term in batch.deciding)
    lowest = min(item.cost for item in fits.values())
    # where the noise was taken for too small, gains count in its true size; where for too large, too
    scale = lowest / count if batch.has_records else max(lowest / count, 1.0)
    p_gain = 1.0
    for names, found in fits.items():
        if len(names) == 1:
            gain = max(base.cost - found.cost, 0.0) / scale
            degrees = found.layout.free.size - base.layout.free.size
            p_gain = min(p_gain, float(chdtrc(degrees, gain)))
    p_gain = min(1.0, _INDEPENDENT * p_gain)
    return min(1.0, 2.0 * min(p_gain, lack_of_fit(batch, base, is_local=True).p_value))


def is_unexplained(lack: LackOfFit, tolerance: Mapping[str, float]) -> bool:
    """Return whether residuals are no noise, and larger than the tolerance on the waveform."""
    limit = tolerance.get("waveform", 0.0)
    return lack.p_value < UNEXPLAINED and not lack.share < limit


def residuals_scale(term: WaveformTerm) -> float:
    """Return the standard deviation that one standardised residual stands for [m or rad]."""
    probe = np.random.default_rng(0).standard_normal((_compared(term).size, 1))
    return 1.0 / max(float(term.whiten(probe).std()), 1e-300)


def size_of_motion(batch: Batch) -> float:
    """Return the norm of the motion of all records in units of the standardised residuals; infinite without records."""
    if not batch.has_records:
        return float("inf")
    return float(np.sqrt(sum(_size_of_motion(term) ** 2 for term in batch.waveform)))


def _size_of_motion(term: WaveformTerm) -> float:
    """Return the norm of the motion in units of the standardised residuals."""
    motion = term.whiten(_compared(term)[:, None])
    return max(float(np.linalg.norm(motion)), 1e-300)


def _compared(term: WaveformTerm) -> FloatArray:
    """Return the motion (n,) at those instants that are compared with a simulation."""
    values = term.compared(term.values)
    return values - values.mean()
