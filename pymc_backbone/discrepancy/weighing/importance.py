"""An integral by importance sampling, its largest weights smoothed by a Pareto tail, with what says whether it holds.

The first draws are of Student-t distributions from the curvature at the mode, as wide and wider. Where their weights
are uneven, the next are of a mixture of narrower ones around the draws that count, so that a bent or skewed integrand
is followed. All draws are weighted by the mixture of all that was drawn from [1]_, and the tail of the weights is
smoothed [2]_. Where that tail cannot be summed, chains walk on from the draws that count; the next mixture is around
where they were, and a bridge between both says the integral as soon as the weights agree with it (`bridge.py`).

References
----------
.. [1] Veach E., Guibas L. J. (1995) Optimally combining sampling techniques for Monte Carlo rendering. SIGGRAPH 95,
   419-428. doi:10.1145/218380.218498
.. [2] Vehtari A., Simpson D., Gelman A., Yao Y., Gabry J. (2024) Pareto smoothed importance sampling. Journal of
   Machine Learning Research 25(72), 1-58.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv, gammaln, logsumexp, ndtri

from ..._common.checks import FloatArray
from .bridge import CHAINS, STEPS, at_even_places, flattened, meet, spread_of, walk

LARGEST_K = 0.7
"""Shape of the Pareto tail up to which an estimate is trusted."""
MOST_ROUNDS = 4
"""Rounds of mixtures after the first, where the weights stay uneven."""
MOST_WALKS = 4
"""Walks after these, where they do not suffice."""
WALK = CHAINS * STEPS
"""Points that the chains of a walk ask; a round of draws follows each."""
_AGREED = 0.25  # difference between bridge and weights up to which they say the same
_REACHED = 4.0  # standard deviations of a draw within which a limit is near
_FEWEST = 25  # weights of which a fifth is a tail that can be fitted
_FREEDOM = 6.0  # degrees of freedom of the proposals: tails heavier than any of the integrands'
_FAR, _WIDER = 0.4, 3.0  # share of the first draws that looks further, and how much: what is not seen has no weight
_FALLS = 4.0  # logarithm of the integrand by which it ends, instead of the half that a Gaussian falls by
_NARROWEST = 1e-3  # share of the standard deviation along an axis down to which it is looked where it ends
_KERNELS, _WALKED_KERNELS = 16, 32
_DEFENSIVE = 0.2  # share of the first proposal in a mixture
_EVEN = 1e-9  # spread of the logarithm of weights below which they are equal: the integrand is the proposal


class Integral(NamedTuple):
    """An integral and what it rests on.

    Attributes
    ----------
    log_value : float
        Logarithm.
    error : float
        Standard error of that.
    pareto_k : float
        Shape of the tail of the weights; NaN where nothing had to be sampled.
    draws : int
        Points at which the integrand was asked.
    is_bridged : bool
        Whether it is of a bridge with which the weights agree, whatever the shape of their tail.
    """

    log_value: float
    error: float
    pareto_k: float
    draws: int
    is_bridged: bool = False

    @property
    def is_trusted(self) -> bool:
        """Whether the weights have a tail that can be summed, or a bridge does without."""
        return bool(np.isfinite(self.log_value)) and (self.is_bridged or not self.pareto_k > LARGEST_K)


class _Mirror(NamedTuple):
    """A limit at which draws are reflected: of which argument, where, and +1 where it is the lower one, else -1."""

    argument: int
    at: float
    side: float


class _Kernels(NamedTuple):
    """A mixture of Student-t distributions: weights (k,), middles (k, q), factor (q, q) of each scale matrix, draws."""

    weights: FloatArray
    middles: FloatArray
    factors: Sequence[FloatArray]
    draws: int


class _Draws:
    """All draws so far, of all mixtures: points (n, q), logarithms of the integrand there (n,), how many were asked."""

    def __init__(
        self,
        log_densities: Callable[[FloatArray], FloatArray],
        mirrors: Sequence[_Mirror],
        rng: np.random.Generator,
    ) -> None:
        self.log_densities, self.mirrors, self.rng = log_densities, mirrors, rng
        self.mixtures: list[_Kernels] = []
        self.points, self.values, self.walked = np.empty((0, 0)), np.empty(0), 0

    def add(self, kernels: _Kernels) -> None:
        """Draw from one more mixture."""
        new = _reflected(_drawn(kernels, self.rng), self.mirrors)
        values = np.asarray(self.log_densities(new))
        self.points = np.concatenate([self.points, new]) if self.mixtures else new
        self.values = np.concatenate([self.values, values])
        self.mixtures.append(kernels)

    @property
    def log_weights(self) -> FloatArray:
        """The logarithm of the weight of each, over the mixture of all mixtures."""
        return _log_weights(self.points, self.values, self.mixtures, self.mirrors)

    def estimate(self) -> Integral:
        """Return the integral by the weights alone."""
        found = _estimate(self.log_weights)
        return found._replace(draws=self.values.size + self.walked)

    def walk(self) -> Integral:
        """Let chains walk from the draws that count, draw around where they were, and return what both say.

        The integral is that of the bridge where the weights agree with it.
        """
        walked = walk(self.log_densities, self.points, self.values, self.log_weights, self.rng)
        self.walked += WALK
        self.add(_around(walked.points, self.mixtures[0]))
        there = walked.points.reshape(-1, self.points.shape[1])
        own = _log_weights(there, walked.values.ravel(), self.mixtures, self.mirrors).reshape(walked.values.shape)
        log_value, error = meet(self.log_weights, own)
        found = self.estimate()
        apart = abs(found.log_value - log_value)
        if not apart <= _AGREED:
            return found
        return found._replace(log_value=log_value, error=max(error, apart), is_bridged=True)


def integrate(
    log_densities: Callable[[FloatArray], FloatArray],
    middle: FloatArray,
    covariance: FloatArray,
    draws: int,
    *,
    low: FloatArray | None = None,
    high: FloatArray | None = None,
    rounds: int = MOST_ROUNDS,
    walks: int = MOST_WALKS,
    random_seed: int = 0,
) -> Integral:
    """Return the integral of a function over all of its arguments.

    Parameters
    ----------
    log_densities : callable
        Takes points (n, q) to the logarithms of the integrand (n,); minus infinity where there is nothing.
    middle : (q,) array
        Near the mode.
    covariance : (q, q) array
        What the curvature there says.
    draws : int
        Of the first round, a power of two; as many again in each of the following.
    low, high : (q,) arrays, optional
        Limits of the arguments; by default none. Draws beyond the nearer one, where it is near, are reflected.
    rounds : int
        Of mixtures at most, after the first: where the tail of the weights asks for them.
    walks : int
        Of chains at most, each followed by a round: where the tail cannot be summed after all rounds.
    random_seed : int
        Of the shift of the points, which fill the space evenly, and of the chains.

    Returns
    -------
    Integral
        Where no draw found anything, minus infinity.

    See Also
    --------
    corrected_evidence.corrections : which evidences are integrated so.
    """
    q = middle.size
    if q == 0:
        return Integral(float(log_densities(np.zeros((1, 0)))[0]), 0.0, float("nan"), 1)
    mirrors = _mirrors(middle, np.sqrt(np.diag(covariance)), low, high)
    factor = np.linalg.cholesky(_probed(log_densities, middle, covariance, mirrors))
    first = _Kernels(np.array([1.0 - _FAR, _FAR]), np.array([middle, middle]), [factor, _WIDER * factor], draws)
    asked = _Draws(log_densities, mirrors, np.random.default_rng(random_seed))
    asked.add(first)
    found = asked.estimate()
    for _ in range(rounds):
        if not np.isfinite(found.log_value) or found.pareto_k < _good(asked.values.size):
            break
        asked.add(_adapted(asked.points, asked.log_weights, first))
        found = asked.estimate()
    for _ in range(walks):
        if not np.isfinite(found.log_value) or found.is_trusted:
            break
        found = asked.walk()
    return found


def _probed(
    log_densities: Callable[[FloatArray], FloatArray],
    middle: FloatArray,
    covariance: FloatArray,
    mirrors: Sequence[_Mirror],
) -> FloatArray:
    """Return the covariance, less wide along the axes where the integrand ends sooner than the curvature says.

    Two parameters that nearly stand for each other do so along a bent ridge: a straight line leaves it far within a
    standard deviation. What is beyond is left to the mixtures, which follow the ridge.
    """
    spread = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    axes = spread[:, None] * vectors * np.sqrt(np.maximum(values, 1e-12))
    there = float(log_densities(middle[None])[0])
    share = np.ones(middle.size)
    for j in range(middle.size):
        while share[j] > _NARROWEST:
            step = share[j] * axes[:, j]
            sides = _reflected(np.stack([middle + step, middle - step]), mirrors)
            if not max(log_densities(sides)) < there - _FALLS:
                break
            share[j] *= 0.5
    scaled = axes * share
    narrowed: FloatArray = scaled @ scaled.T
    return narrowed


def _mirrors(
    middle: FloatArray, spread: FloatArray, low: FloatArray | None, high: FloatArray | None
) -> tuple[_Mirror, ...]:
    """Return the limits that draws reach: of each argument the nearer one."""
    q = middle.size
    down = middle - (np.full(q, -np.inf) if low is None else low)
    up = (np.full(q, np.inf) if high is None else high) - middle
    return tuple(
        _Mirror(k, float(middle[k] - down[k]), 1.0) if down[k] <= up[k] else _Mirror(k, float(middle[k] + up[k]), -1.0)
        for k in range(q)
        if min(down[k], up[k]) < _REACHED * spread[k]
    )


def _reflected(points: FloatArray, mirrors: Sequence[_Mirror]) -> FloatArray:
    """Return points (n, q), those behind a mirror before it."""
    for item in mirrors:
        points[:, item.argument] = item.at + item.side * np.abs(points[:, item.argument] - item.at)
    return points


def _log_reflected(points: FloatArray, kernels: _Kernels, mirrors: Sequence[_Mirror]) -> FloatArray:
    """Return the logarithm of the density of reflected draws: the sum over all that would come to the same point."""
    parts = []
    for count in range(len(mirrors) + 1):
        for chosen in combinations(mirrors, count):
            there = points.copy()
            for item in chosen:
                there[:, item.argument] = 2.0 * item.at - there[:, item.argument]
            parts.append(_log_mixture(there, kernels))
    return np.asarray(logsumexp(parts, axis=0))


def _good(draws: int) -> float:
    """Return the shape of the tail up to which so many draws are enough (Vehtari et al. 2024, equation 13)."""
    return min(1.0 - 1.0 / float(np.log10(draws)), LARGEST_K)


def _drawn(kernels: _Kernels, rng: np.random.Generator) -> FloatArray:
    """Return points (n, q) of a mixture that fill it evenly: of a shifted Sobol sequence, kernel by kernel."""
    from scipy.stats import qmc

    q = kernels.middles.shape[1]
    even = qmc.Sobol(q + 2, scramble=False).random(kernels.draws)
    share = np.clip(np.mod(even + rng.random(q + 2), 1.0), 1e-12, 1.0 - 1e-12)
    which = np.minimum(np.searchsorted(np.cumsum(kernels.weights), share[:, 0]), kernels.weights.size - 1)
    stretch = np.sqrt(0.5 * _FREEDOM / gammaincinv(0.5 * _FREEDOM, share[:, 1]))
    normal = ndtri(share[:, 2:]) * stretch[:, None]
    return np.array([kernels.middles[k] + kernels.factors[k] @ row for k, row in zip(which, normal, strict=True)])


def _log_mixture(points: FloatArray, kernels: _Kernels) -> FloatArray:
    """Return the logarithm of the density of a mixture at points (n, q)."""
    q = points.shape[1]
    constant = gammaln(0.5 * (_FREEDOM + q)) - gammaln(0.5 * _FREEDOM) - 0.5 * q * np.log(_FREEDOM * np.pi)
    each = np.empty((kernels.weights.size, points.shape[0]))
    for k, (weight, middle, factor) in enumerate(zip(kernels.weights, kernels.middles, kernels.factors, strict=True)):
        scaled = np.linalg.solve(factor, (points - middle).T)
        distance = (scaled**2).sum(axis=0) / _FREEDOM
        each[k] = np.log(weight) - np.log(np.diag(factor)).sum() - 0.5 * (_FREEDOM + q) * np.log1p(distance)
    density: FloatArray = constant + np.asarray(logsumexp(each, axis=0))
    return density


def _log_weights(
    points: FloatArray, values: FloatArray, rounds: Sequence[_Kernels], mirrors: Sequence[_Mirror]
) -> FloatArray:
    """Return the logarithm of the weights (n,) of all draws, each over the mixture of all rounds."""
    total = sum(item.draws for item in rounds)
    parts = [np.log(item.draws / total) + _log_reflected(points, item, mirrors) for item in rounds]
    return values - np.asarray(logsumexp(parts, axis=0))


def _estimate(raw: FloatArray) -> Integral:
    """Return the mean of the weights, whose logarithms (n,) are given, the largest smoothed."""
    held = raw[np.isfinite(raw)]
    if held.size < _FEWEST:
        mean = float(logsumexp(held)) - np.log(raw.size) if held.size else -np.inf
        return Integral(mean, np.inf, np.inf, raw.size)
    if np.ptp(held) < _EVEN:
        return Integral(float(held[0]) + np.log(held.size / raw.size), 0.0, -np.inf, raw.size)
    from arviz_stats.base import array_stats

    with np.errstate(all="ignore"):  # a tail of weights that are next to nothing has no shape
        smoothed, k = array_stats.psislw(-held)  # takes what weights are divided by, returns them summing to one
    k = float(k) if np.isfinite(k) else np.inf
    # the least weight is not smoothed: it says what all were divided by
    least = int(np.argmin(held))
    log_sum = float(held[least] - smoothed[least])
    effective = float(np.exp(-logsumexp(2.0 * smoothed)))
    # draws without weight count in the variance, too
    error = np.sqrt(max(1.0 / effective - 1.0 / raw.size, 0.0))
    return Integral(log_sum - float(np.log(raw.size)), float(error), k, raw.size)


def _adapted(points: FloatArray, log_weights: FloatArray, first: _Kernels) -> _Kernels:
    """Return a mixture around the draws that count, beside the first proposal."""
    weights = flattened(log_weights)
    return _mixture(points[at_even_places(weights, _KERNELS)], spread_of(points, weights), first)


def _around(walked: FloatArray, first: _Kernels) -> _Kernels:
    """Return a mixture around where chains (chains, steps, q) were, beside the first proposal."""
    points = walked.reshape(-1, walked.shape[-1])
    middles = points[np.linspace(0, points.shape[0] - 1, _WALKED_KERNELS).astype(np.intp)]
    return _mixture(middles, spread_of(points, np.full(points.shape[0], 1.0 / points.shape[0])), first)


def _mixture(middles: FloatArray, spread: FloatArray, first: _Kernels) -> _Kernels:
    """Return kernels around middles (k, q), narrower than the spread of what they stand for (q, q)."""
    count, q = middles.shape
    own = first.factors[0] @ first.factors[0].T
    narrow = np.linalg.cholesky(spread + 1e-3 * own) * count ** (-1.0 / (q + 4.0))
    return _Kernels(
        np.array([*(_DEFENSIVE * first.weights), *[(1.0 - _DEFENSIVE) / count] * count]),
        np.vstack([first.middles, middles]),
        [*first.factors, *[narrow] * count],
        first.draws,
    )


__all__ = ["LARGEST_K", "MOST_ROUNDS", "MOST_WALKS", "WALK", "Integral", "integrate"]
