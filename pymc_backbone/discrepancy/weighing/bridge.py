"""A bridge between two samples, for integrals whose weights importance sampling cannot sum.

Weights have no finite variance where the integrand is wider than the proposal. A bridge asks both: draws of the
proposal, and draws of the integrand, each of which only has to see where the other one is [1]_. Those of the integrand
are walked by Metropolis' rule, by many short chains that begin where the weights are.

References
----------
.. [1] Meng X.-L., Wong W. H. (1996) Simulating ratios of normalizing constants via a simple identity. Statistica
   Sinica 6, 831-860.
.. [2] Frühwirth-Schnatter S. (2004) Estimating marginal likelihoods for mixture and Markov switching models using
   bridge sampling techniques. The Econometrics Journal 7, 143-167. doi:10.1111/j.1368-423X.2004.00125.x
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from ..._common.checks import FloatArray

CHAINS = 16
STEPS = 24
"""Of each chain; the first quarter is left out."""
_LENGTHS = (1.0, 0.4, 0.15)  # of steps: a bent ridge asks for short ones, its length for long ones
_ITERATIONS = 200
_SETTLED = 1e-9


class Walk(NamedTuple):
    """Where chains were (chains, steps, q), and the logarithm of the integrand there (chains, steps)."""

    points: FloatArray
    values: FloatArray


def walk(
    log_densities: Callable[[FloatArray], FloatArray],
    points: FloatArray,
    values: FloatArray,
    log_weights: FloatArray,
    rng: np.random.Generator,
) -> Walk:
    """Return draws of an integrand by Metropolis' rule, begun at weighted points.

    Parameters
    ----------
    log_densities : callable
        Takes points (n, q) to the logarithms of the integrand (n,).
    points : (n, q) array
        Draws of a proposal.
    values, log_weights : (n,) arrays
        Logarithms of the integrand there and of the weights; finite for some.
    rng : Generator
        Of the steps.

    Returns
    -------
    Walk
    """
    q = points.shape[1]
    begun = at_even_places(np.exp(log_weights - logsumexp(log_weights)), CHAINS, rng.random())
    at, value = points[begun], values[begun]
    spread = spread_of(points, flattened(log_weights))
    factor = np.linalg.cholesky(spread + 1e-9 * np.diag(np.diag(spread))) * 2.38 / np.sqrt(q)
    where, known = [], []
    for step in range(STEPS):
        asked = at + _LENGTHS[step % len(_LENGTHS)] * rng.standard_normal((CHAINS, q)) @ factor.T
        there = np.asarray(log_densities(asked))
        is_taken = np.log(rng.random(CHAINS)) < there - value
        at, value = np.where(is_taken[:, None], asked, at), np.where(is_taken, there, value)
        if step >= STEPS // 4:
            where.append(at)
            known.append(value)
    return Walk(np.stack(where, axis=1), np.stack(known, axis=1))


def flattened(log_weights: FloatArray) -> FloatArray:
    """Return weights (n,) of half the logarithm, which sum to one: flatter, so that one draw does not make them all."""
    weights = np.exp(0.5 * (log_weights - np.max(log_weights)))
    normed: FloatArray = weights / weights.sum()
    return normed


def spread_of(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the covariance (q, q) of weighted points (n, q)."""
    centred = points - weights @ points
    return np.asarray((weights[:, None] * centred).T @ centred)


def at_even_places(weights: FloatArray, count: int, shift: float = 0.5) -> np.ndarray:
    """Return which points (count,) are at even places of the sum of their weights."""
    places = (np.arange(count) + shift) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), weights.size - 1)


def meet(ratio: FloatArray, own: FloatArray) -> tuple[float, float]:
    """Return the logarithm of an integral from draws on both sides, and its standard error [2]_.

    Parameters
    ----------
    ratio : (n,) array
        Logarithms of the integrand over the density of the proposal, at draws of the proposal.
    own : (chains, steps) array
        The same at draws of the integrand.
    """
    from arviz_stats.base import array_stats

    independent = float(np.clip(array_stats.ess(own, method="mean"), 1.0, own.size))
    both = independent + ratio.size
    share = np.log(independent / both), np.log(ratio.size / both)
    log_value = float(logsumexp(ratio)) - np.log(ratio.size)
    for _ in range(_ITERATIONS):
        above = ratio - np.logaddexp(share[0] + ratio, share[1] + log_value)
        below = -np.logaddexp(share[0] + own, share[1] + log_value)
        before = log_value
        log_value = float(logsumexp(above) - np.log(ratio.size) - logsumexp(below) + np.log(own.size))
        if abs(log_value - before) < _SETTLED:
            break
    drawn = np.exp(ratio - np.logaddexp(share[0] + ratio, share[1] + log_value))
    walked = np.exp(log_value - np.logaddexp(share[0] + own, share[1] + log_value))
    variance = drawn.var() / drawn.mean() ** 2 / ratio.size + walked.var() / walked.mean() ** 2 / independent
    return log_value, float(np.sqrt(variance))


__all__ = ["CHAINS", "STEPS", "Walk", "at_even_places", "flattened", "meet", "spread_of", "walk"]
