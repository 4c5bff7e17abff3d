"""Coordinates of backbones for data-consistent densities: the combinations of values that predict the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .._common.checks import FloatArray, InputError
from .density_marginals import kernel_bandwidth

DETERMINED = 0.5  # share of a parameter's prior variance that the backbones must explain
_INNER = 0.005  # the same, linearly, of a direction that the polynomials begin from
_RESOLUTION = 0.01  # of the specimens' spread: smaller differences are no information, even where there is no error
_MARGIN = 3.0  # bandwidths around the specimens that belong to the region looked at
_SMALLEST_SHARE = 0.01  # of the measured variance that is left where measurement error explains all of it


@dataclass(frozen=True)
class Coordinates:
    """z, polynomials of second degree in u = projection (t - centre), where t is the values or their logarithms.

    In u and z the population has unit variance, in z zero mean and unit covariance too.
    """

    is_log: NDArray[np.bool_]  # (d,)
    centre: FloatArray  # (d,)
    projection: FloatArray  # (q, d)
    inner_reach: FloatArray  # (q,): beyond it, the polynomials keep their value at the edge
    polynomials: FloatArray  # (r, f)
    sample: FloatArray  # (n, r), of unit covariance
    bandwidth: float
    explained: FloatArray  # share of each parameter's variance near the population

    @property
    def radius(self) -> float:
        """How far the region of the population goes, in z."""
        return float(np.linalg.norm(self.sample, axis=1).max()) + _MARGIN * self.bandwidth

    def inner(self, values: FloatArray) -> FloatArray:
        """Return u (n, q) of values (n, d); infinite where a value has no logarithm."""
        scaled, has_all = _scaled(values, self.is_log)
        return np.where(has_all[:, None], (scaled - self.centre) @ self.projection.T, np.inf)

    def of_inner(self, u: FloatArray) -> FloatArray:
        """Return z (n, r) of u (n, q)."""
        return np.asarray(_features(np.clip(u, -self.inner_reach, self.inner_reach)) @ self.polynomials.T)

    def of(self, values: FloatArray) -> FloatArray:
        """Return z (n, r) of values (n, d)."""
        return self.of_inner(self.inner(values))

    def distance_of_inner(self, u: FloatArray) -> FloatArray:
        """Return how far u (n, q) is from the population's middle, 1 at the end of its region."""
        along = np.linalg.norm(self.of_inner(u), axis=1) / self.radius
        return np.asarray(np.maximum(along, (np.abs(u) / self.inner_reach).max(axis=1)))

    def distance(self, values: FloatArray) -> FloatArray:
        """Return the same of values (n, d)."""
        return self.distance_of_inner(self.inner(values))


def find_coordinates(
    parameters: FloatArray,
    values: FloatArray,
    measured: FloatArray,
    error: FloatArray,
    subtract: bool,
    observables: int,
) -> Coordinates:
    """Return the coordinates that predict the parameters best, scaled to the measured population.

    Where all values of an observable are positive, its logarithms are tried too: what explains more is taken.

    Parameters
    ----------
    parameters, values : (n, p) and (n, d) arrays
        Of draws from the priors.
    measured : (s, d) array
        Of the specimens.
    error : (d, d) array
        Their mean measurement covariance.
    subtract : bool
        Whether it is taken out of the population's.
    observables : int
        How many there are among the values, one after another.

    Raises
    ------
    InputError
        If the values predict no parameter, or there are too few specimens.
    """
    positive = ((values > 0.0).all(axis=0) & (measured > 0.0).all(axis=0)).reshape(observables, -1).all(axis=1)
    levels = values.shape[1] // observables
    best: Coordinates | None = None
    for choice in product(*[(False, True) if can else (False,) for can in positive]):
        found = _of_scales(parameters, values, measured, error, subtract, np.repeat(choice, levels))
        if found is not None and (best is None or found.explained.sum() > best.explained.sum()):
            best = found
    if best is None:
        raise InputError(_NOTHING)
    return best


def _of_scales(
    parameters: FloatArray,
    values: FloatArray,
    measured: FloatArray,
    error: FloatArray,
    subtract: bool,
    is_log: NDArray[np.bool_],
) -> Coordinates | None:
    """Return the best coordinates for values some of which are taken as logarithms; None where there are none."""
    scaled, specimens = _scaled(values, is_log)[0], _scaled(measured, is_log)[0]
    slope = np.where(is_log, 1.0 / np.where(is_log, measured.mean(axis=0), 1.0), 1.0)
    error = error * np.outer(slope, slope)
    noise = error + np.diag((_RESOLUTION * specimens.std(axis=0)) ** 2)
    projection = _inner_directions(parameters, scaled, noise)
    if not len(projection):
        return None
    centre = specimens.mean(axis=0)
    u = (specimens - centre) @ projection.T
    scale = u.std(axis=0)
    projection, u = projection / scale[:, None], u / scale
    reach = np.abs(u).max(axis=0) + _MARGIN * kernel_bandwidth(u)[0]
    predicted = (scaled - centre) @ projection.T
    outer, explained = _polynomials(parameters, predicted, reach, projection @ noise @ projection.T)
    kept = explained[0] > DETERMINED
    if not kept.any():
        return None
    r, n = int(kept.sum()), len(measured)
    if n < r + 3:
        raise InputError(
            f"a data_consistent density with {r} determined parameters needs at least {r + 3} specimens that reach "
            f"every level, got {n}. Fix parameters, or use `likelihood='specimen'`."
        )
    polynomials, sample = _whitened(outer[:, kept], u, projection @ error @ projection.T, subtract)
    bandwidth = kernel_bandwidth(sample)[0]
    return Coordinates(is_log, centre, projection, reach, polynomials.T, sample, bandwidth, explained[1])


_NOTHING = (
    "the backbones determine none of the parameters: simulated ones hardly change within the priors, or less than "
    "their errors. Add observables or levels, or widen the priors."
)


def _scaled(values: FloatArray, is_log: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the values, some as logarithms, and which rows have them all."""
    has_all = np.asarray(((values > 0.0) | ~is_log).all(axis=1))
    scaled = values.copy()
    scaled[:, is_log] = np.log(np.where(values > 0.0, values, 1.0)[:, is_log])
    return scaled, has_all


def _inner_directions(parameters: FloatArray, scaled: FloatArray, noise: FloatArray) -> FloatArray:
    """Return projections (q, d): directions of the linear regression of the parameters on the values."""
    spread = scaled.std(axis=0)
    standard = (scaled - scaled.mean(axis=0)) / spread
    wanted = (parameters - parameters.mean(axis=0)) / parameters.std(axis=0)
    covariance = standard.T @ standard / len(standard)
    gain = np.linalg.solve(covariance + noise / np.outer(spread, spread), standard.T @ wanted / len(standard))
    shares, vectors = np.linalg.eigh(gain.T @ covariance @ gain)
    return np.asarray((gain @ vectors[:, shares > _INNER] / spread[:, None]).T)


def _polynomials(
    parameters: FloatArray, u: FloatArray, reach: FloatArray, noise: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Return polynomials (f, p) that predict combinations of parameters, the shares of these and of each parameter.

    Combinations that are uncorrelated near the population, so that a share is one of a variance of its own.
    """
    near = (np.abs(u) < 2.0 * reach).all(axis=1)
    if near.sum() < 8 * _features(u[:1]).shape[1]:
        near = np.ones(len(u), dtype=bool)
    held = parameters[near] - parameters[near].mean(axis=0)
    wanted = np.linalg.solve(np.linalg.cholesky(np.atleast_2d(np.cov(held.T, bias=True))), held.T).T
    # with the error that the measured ones have: the best prediction from values that are not exact
    jitter = np.random.default_rng(0).multivariate_normal(np.zeros(len(noise)), noise, len(held), method="cholesky")
    features = _features(u[near] + jitter)
    coefficients = np.linalg.lstsq(features, wanted, rcond=None)[0]
    shares, vectors = np.linalg.eigh(np.atleast_2d(np.cov((features @ coefficients).T, bias=True)))
    single = features @ np.linalg.lstsq(features, held / held.std(axis=0), rcond=None)[0]
    return coefficients @ vectors, (shares, np.clip(single.var(axis=0), 0.0, 1.0))


def _whitened(outer: FloatArray, u: FloatArray, error: FloatArray, subtract: bool) -> tuple[FloatArray, FloatArray]:
    """Return polynomials (f, r) in which the population has zero mean and unit covariance, and it (n, r) in them."""
    r, q = outer.shape[1], u.shape[1]
    z = _features(u) @ outer
    mean = z.mean(axis=0)
    remaining, whitener = np.eye(r), np.linalg.inv(np.linalg.cholesky(np.atleast_2d(np.cov(z.T))))
    if subtract:
        i, j = np.triu_indices(q)
        mean = mean - error[i, j] @ outer[1 + q :]  # a square of what has an error is too large by its variance
        slopes = np.einsum("naf,fr->nar", _slopes(u), outer)
        ours = np.einsum("nar,ab,nbs->rs", slopes, error, slopes) / len(u)
        remaining = remaining - whitener @ ours @ whitener.T
    sizes, axes = np.linalg.eigh(0.5 * (remaining + remaining.T))
    turn = whitener.T @ axes
    polynomials = outer.copy()
    polynomials[0] -= mean
    polynomials = polynomials @ turn / np.sqrt(np.maximum(sizes, _SMALLEST_SHARE))
    return polynomials, (z - z.mean(axis=0)) @ turn


def _features(u: FloatArray) -> FloatArray:
    """Return 1, u and the products of two u: (n, f)."""
    i, j = np.triu_indices(u.shape[1])
    return np.column_stack([np.ones(len(u)), u, u[:, i] * u[:, j]])


def _slopes(u: FloatArray) -> FloatArray:
    """Return the derivatives of the features: (n, q, f)."""
    n, q = u.shape
    i, j = np.triu_indices(q)
    slopes = np.zeros((n, q, 1 + q + i.size))
    slopes[:, np.arange(q), 1 + np.arange(q)] = 1.0
    for place, (a, b) in enumerate(zip(i, j, strict=True)):
        slopes[:, a, 1 + q + place] += u[:, b]
        slopes[:, b, 1 + q + place] += u[:, a]
    return slopes


__all__ = ["DETERMINED", "Coordinates", "find_coordinates"]
