"""Distributions of specimens over a population, in coordinates that a sampler moves through easily.

Given the population, a specimen's parameters are known from two sides: from its own backbone and from the population.
Near the fits both are Gaussian, so their product is, with a mean and a covariance in closed form. The sampler moves
through offsets that are standardised by these: nearly independent, standard normal variables, whether a specimen is
known far better than the population is wide (where a non-centred parametrisation fails), not at all (where a centred
one fails), or along some combinations only. The true densities are used throughout; only the coordinates rest on the
linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytensor.tensor as pt
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import FloatArray
from .specimen_fits import SpecimenFits

_LOG_TWO_PI = float(np.log(2.0 * np.pi))
_LOGISTIC_PRECISION = 3.0 / np.pi**2
_REACH = 5.0  # standard errors of a specimen beyond which an edge of a Uniform population cannot exclude it


@dataclass(frozen=True)
class Coordinate:
    """A parameter as a function of an unconstrained number, inside its physical limits.

    ``unit * eta`` without limits, ``lower + unit * exp(eta)`` above one, ``upper - unit * exp(eta)`` below one, and
    logistic between two.
    """

    lower: float
    upper: float
    unit: float

    @property
    def _sign(self) -> float:
        return 1.0 if np.isfinite(self.lower) else -1.0

    @property
    def _is_free(self) -> bool:
        return not (np.isfinite(self.lower) or np.isfinite(self.upper))

    @property
    def _is_between(self) -> bool:
        return bool(np.isfinite(self.lower) and np.isfinite(self.upper))

    def value(self, eta: Tensor) -> Tensor:
        """Return the parameter."""
        if self._is_free:
            return self.unit * eta
        if self._is_between:
            return self.lower + (self.upper - self.lower) * pt.sigmoid(eta)
        return (self.lower if self._sign > 0.0 else self.upper) + self._sign * self.unit * pt.exp(eta)

    def log_slope(self, eta: Tensor) -> Tensor:
        """Return the logarithm of the size of the parameter's derivative."""
        if self._is_free:
            return np.log(self.unit) + pt.zeros_like(eta)
        if self._is_between:
            return np.log(self.upper - self.lower) - pt.softplus(eta) - pt.softplus(-eta)
        return np.log(self.unit) + eta

    def expand(self, value: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return coordinate and derivative at known values, kept a third of their errors away from the limits."""
        if self._is_free:
            return value / self.unit, np.full_like(value, self.unit)
        if self._is_between:
            width = self.upper - self.lower
            margin = np.minimum(error / 3.0, 0.25 * width)
            share = np.clip((value - self.lower), margin, width - margin) / width
            return np.log(share / (1.0 - share)), width * share * (1.0 - share)
        edge = self.lower if self._sign > 0.0 else self.upper
        distance = np.maximum(self._sign * (value - edge), error / 3.0)
        return np.log(distance / self.unit), self._sign * distance

    def of_normal(self, mean: Tensor, sd: Tensor) -> tuple[Tensor, Tensor]:
        """Return where a Normal distribution of the parameter peaks in this coordinate, and the curvature there."""
        if self._is_free:
            return mean / self.unit, (self.unit / sd) ** 2
        if self._is_between:
            width = self.upper - self.lower
            share = pt.clip((mean - self.lower) / width, 0.02, 0.98)
            spread = share * (1.0 - share)
            return pt.log(share / (1.0 - share)), (width * spread / sd) ** 2 + 2.0 * spread
        distance = self._sign * (mean - (self.lower if self._sign > 0.0 else self.upper))
        peak = 0.5 * (distance + pt.sqrt(distance**2 + 4.0 * sd**2))
        return pt.log(peak / self.unit), peak * (2.0 * peak - distance) / sd**2


def normal_specimens(
    offsets: Tensor,
    mean: Tensor,
    sd: Tensor,
    correlation_factor: Tensor | None,
    coordinates: list[Coordinate],
    fits: SpecimenFits,
) -> tuple[Tensor, Tensor]:
    """Return specimens (n, p) of a Normal population, and the log-density of their offsets under it.

    Parameters
    ----------
    offsets : tensor (n, p)
        Standardised coordinates.
    mean, sd : tensor (p,)
        Of the Normal before it is cut at the physical limits.
    correlation_factor : tensor (p, p), optional
        Lower Cholesky factor of the correlation matrix.
    coordinates : list of Coordinate
        One per parameter.
    fits : SpecimenFits
        Each specimen by itself.

    Notes
    -----
    The share of the Normal inside the limits divides the density: exact for independent parameters, and with
    correlation where at most one parameter comes near a limit.
    """
    n, p = fits.point.shape
    expanded = [c.expand(fits.point[:, j], fits.error[:, j]) for j, c in enumerate(coordinates)]
    at, slope = (np.stack(part, axis=1) for part in zip(*expanded, strict=True))
    information = slope[:, :, None] * fits.information * slope[:, None, :]
    known = slope * fits.slope + np.einsum("sij,sj->si", information, at)
    peaks, curvatures = zip(*(c.of_normal(mean[j], sd[j]) for j, c in enumerate(coordinates)), strict=True)
    peak, root = pt.stack(peaks), pt.sqrt(pt.stack(curvatures))
    inverse = np.eye(p)
    if correlation_factor is not None:
        inverse = _invert_lower(correlation_factor, p)
    whitener = inverse * root
    precision = (whitener[:, :, None] * whitener[:, None, :]).sum(axis=0)
    eta, log_determinant = _standardise(
        offsets, pt.as_tensor(information) + precision, pt.as_tensor(known) + (precision * peak).sum(axis=1)
    )
    columns = [c.value(eta[:, j]) for j, c in enumerate(coordinates)]
    log_slopes = sum((c.log_slope(eta[:, j]).sum() for j, c in enumerate(coordinates)), start=pt.constant(0.0))
    specimens = pt.stack(columns, axis=1)
    distance = (((specimens - mean) / sd)[:, None, :] * inverse).sum(axis=-1)
    log_density = -0.5 * (distance**2).sum() - n * (pt.log(sd).sum() + 0.5 * p * _LOG_TWO_PI)
    if correlation_factor is not None:
        log_density -= n * pt.log(pt.diagonal(correlation_factor)).sum()
    for j, c in enumerate(coordinates):
        log_density -= n * pt.log(_cut(c, mean[j], sd[j])[0])
    return specimens, log_density + log_slopes + log_determinant


def cut_moments(coordinate: Coordinate, mean: Tensor, sd: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and standard deviation of a Normal that is cut at the physical limits."""
    share, low, high, low_height, high_height = _cut(coordinate, mean, sd)
    shift = (low_height - high_height) / share
    variance = 1.0 + (low * low_height - high * high_height) / share - shift**2
    return mean + sd * shift, sd * pt.sqrt(variance)


def _cut(coordinate: Coordinate, mean: Tensor, sd: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Return the share inside the limits, the standardised limits and the standard normal's height there."""
    zero = pt.zeros_like(mean)
    low = (coordinate.lower - mean) / sd if np.isfinite(coordinate.lower) else zero
    high = (coordinate.upper - mean) / sd if np.isfinite(coordinate.upper) else zero
    heights = [
        pt.exp(-0.5 * (edge**2 + _LOG_TWO_PI)) if np.isfinite(limit) else zero
        for edge, limit in ((low, coordinate.lower), (high, coordinate.upper))
    ]
    below = 0.5 * pt.erfc(-low / np.sqrt(2.0)) if np.isfinite(coordinate.lower) else zero
    above = 0.5 * pt.erfc(high / np.sqrt(2.0)) if np.isfinite(coordinate.upper) else zero
    return 1.0 - below - above, low, high, *heights


def uniform_specimens(offsets: Tensor, low: Tensor, high: Tensor, fits: SpecimenFits) -> tuple[Tensor, Tensor]:
    """Return specimens (n, p) of a Uniform population, and the log-density of their offsets under it.

    Parameters
    ----------
    offsets : tensor (n, p)
        Standardised coordinates.
    low, high : tensor (p,)
        Edges of the population.
    fits : SpecimenFits
        Each specimen by itself.
    """
    above, below = (_softly_positive(d, fits.error) for d in (fits.point - low, high - fits.point))
    share = above / (above + below)
    at, slope = pt.log(above / below), (high - low) * share * (1.0 - share)
    information = slope[:, :, None] * fits.information * slope[:, None, :]
    known = slope * fits.slope + (information * at[:, None, :]).sum(axis=-1)
    eta, log_determinant = _standardise(offsets, information + _LOGISTIC_PRECISION * np.eye(fits.point.shape[1]), known)
    # The slope of the logistic, (high - low) w (1 - w), cancels the density's 1 / (high - low).
    log_density = -(pt.softplus(eta) + pt.softplus(-eta)).sum()
    return low + (high - low) * pt.sigmoid(eta), log_density + log_determinant


def edge_ranges(fits: SpecimenFits, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how high (p,) a Uniform population's lower edge may lie, and how low its upper one."""
    highest = (fits.point + _REACH * fits.error).min(axis=0)
    lowest = (fits.point - _REACH * fits.error).max(axis=0)
    return np.minimum(highest, high), np.maximum(lowest, low)


def _softly_positive(distance: Tensor, error: FloatArray) -> Tensor:
    """Return a distance that passes over to a positive one where it is within an error of zero or negative."""
    return 0.5 * (distance + pt.sqrt(distance**2 + 4.0 * error**2))


def _invert_lower(factor: Tensor, p: int) -> Tensor:
    """Return the inverse of a small lower triangular matrix.

    Entry by entry, as sums are taken here instead of products of matrices: these would look for a BLAS library to link
    with, and warn where there is none.
    """
    rows: list[Tensor] = []
    for i in range(p):
        total = pt.as_tensor(np.eye(p)[i])
        for k, row in enumerate(rows):
            total = total - factor[i, k] * row
        rows.append(total / factor[i, i])
    return pt.stack(rows)


def _standardise(offsets: Tensor, precision: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Return (n, p) draws ``precision^-1 known + precision^(-T/2) offsets``, and the log-determinant of that map.

    Cholesky column by column over all specimens at once: PyTensor's batched one is some fifty times slower.
    """
    p = int(offsets.type.shape[1])
    columns: list[Tensor] = []
    for j in range(p):
        column = precision[:, j:, j]
        for k, other in enumerate(columns):
            column = column - other[:, j - k :] * other[:, j - k, None]
        columns.append(column / pt.sqrt(column[:, 0, None]))
    forward: list[Tensor] = []
    for j in range(p):
        total = known[:, j]
        for k in range(j):
            total = total - columns[k][:, j - k] * forward[k]
        forward.append(total / columns[j][:, 0])
    result: list[Tensor] = [None] * p
    for j in reversed(range(p)):
        total = forward[j] + offsets[:, j]
        for i in range(j + 1, p):
            total = total - columns[j][:, i - j] * result[i]
        result[j] = total / columns[j][:, 0]
    log_determinant = -pt.log(pt.stack([column[:, 0] for column in columns])).sum()
    return pt.stack(result, axis=1), log_determinant
