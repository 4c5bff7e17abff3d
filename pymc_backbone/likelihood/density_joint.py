"""Principal directions of a measured population, behind the joint density of `fit_density`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._common.checks import FloatArray

# Spread, relative to each value's own, below which a principal direction is not taken for a variation of the population
# but for the curvature of the surface on which the values lie. Whitening such a direction as if it were a variation of
# its own narrows what is recovered by 10-16 % (populations of Duffing oscillators, coefficients of variation 2.5-10 %);
# at 0.1 the error is 0-5 %.
RELATIVE_FLOOR = 0.1

# The principal directions of n specimens are off by chance, and each of the d - r directions without population
# variance feels it: the recovered variance shrinks by 1 + (d - r) / (n f) when those directions are f times as wide as
# the measurement error. f = 20 (d - r) / n holds the loss in standard deviation at 2.5 %.
FLOOR_WIDENING = 20.0


class Directions(NamedTuple):
    """Principal directions, z = whitening @ (y - mean), the first ``n_population`` with population variance."""

    mean: FloatArray
    whitening: FloatArray
    log_determinant: float
    n_population: int
    whitened_sample: FloatArray


def principal_directions(values: FloatArray, measurement: FloatArray, subtract: bool) -> Directions:
    """Split the covariance of a measured population into directions with and without population variance.

    With S the sample covariance and F = ``measurement`` + diag(0.1 s)^2 the floor (s the standard deviation of each
    value), the directions solve S v = lambda F v. A direction belongs to the population where lambda exceeds what
    measurement error alone would give it by chance, the edge (1 + sqrt(d / (n - 1)))^2 of the Marchenko-Pastur law
    [1]_, of which only the part by which the floor is measurement error counts. It keeps the sample's variance, less
    that of the measurement if ``subtract``. The others get the floor, widened by 20 (d - r) / n where that is more than
    1.

    Parameters
    ----------
    values : array, shape (n, d)
        One row per specimen.
    measurement : array, shape (d, d)
        Mean covariance of the measurement errors.
    subtract : bool
        Whether the population without measurement error is wanted.

    References
    ----------
    .. [1] I. M. Johnstone, "On the distribution of the largest eigenvalue in principal components analysis", Annals of
       Statistics 29 (2001) 295-327.
    """
    n, d = values.shape
    mean = values.mean(axis=0)
    spread = values.std(axis=0, ddof=1)
    # An estimated covariance need not be positive semi-definite: negative eigenvalues, in each value's own standard
    # deviation, are set to zero.
    error_values, error_vectors = np.linalg.eigh(measurement / np.outer(spread, spread))
    error = (error_vectors * np.maximum(error_values, 0.0)) @ error_vectors.T
    factor = np.linalg.cholesky(error + RELATIVE_FLOOR**2 * np.eye(d))
    scaled = np.linalg.solve(factor, ((values - mean) / spread).T).T
    ratios, vectors = np.linalg.eigh(scaled.T @ scaled / (n - 1))
    ratios, vectors = np.maximum(ratios[::-1], 0.0), vectors[:, ::-1]
    root = np.linalg.solve(factor, np.linalg.solve(factor, error).T).T
    measured = np.clip(np.einsum("jk,jl,lk->k", vectors, root, vectors), 0.0, 1.0)
    edge = (1.0 + np.sqrt(d / (n - 1.0))) ** 2
    # A prefix of the ordered directions, at most as many as n specimens can span with one degree of freedom to spare.
    below = np.flatnonzero(ratios <= 1.0 + (edge - 1.0) * measured)
    r = min(int(below[0]) if below.size else d, n - 2)
    variance = np.full(d, max(1.0, FLOOR_WIDENING * (d - r) / n))
    variance[:r] = ratios[:r] - measured[:r] if subtract else ratios[:r]
    whitening = np.linalg.solve(factor.T, vectors).T / spread / np.sqrt(variance)[:, None]
    log_determinant = -float(np.log(np.diag(factor)).sum() + np.log(spread).sum() + 0.5 * np.log(variance).sum())
    return Directions(mean, whitening, log_determinant, r, scaled @ vectors[:, :r] / np.sqrt(ratios[:r]))
