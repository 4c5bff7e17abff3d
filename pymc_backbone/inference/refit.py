"""The best that a model can do for one vector of level values: weighted least squares between hard limits.

A parameter that ends at a limit is not counted among the fitted ones. The squared distance of a Gaussian vector from a
face of a convex set, given that the nearest point lies on that face, has as many degrees of freedom as the vector has
values beyond the dimension of the face (the chi-bar-square theory of constrained fits): so the distance keeps its
distribution where a true parameter is zero, or close to a bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._common.checks import FloatArray
from ..simulation.response import Response

_MOST_STEPS = 80
_ENOUGH = 1e-3  # of chi-square: a step that promises less ends the fit
_DIFFERENCE = 1e-5  # step of central differences, as a share of a parameter's scale


@dataclass(frozen=True, eq=False)
class Refit:
    """Where least squares ended.

    Attributes
    ----------
    point : (p,) array
        All parameters, in their units.
    values : (d,) array
        Simulated there.
    residual : (d,) array
        Standardised; zero where nothing was measured.
    at_low, at_high : (p,) array of bool
        Which ended at a limit that holds them back.
    directions : (d, fitted) array
        Of the residual, orthonormal: what the fitted parameters take out of it.
    """

    point: FloatArray
    values: FloatArray
    residual: FloatArray
    at_low: NDArray[np.bool_]
    at_high: NDArray[np.bool_]
    directions: FloatArray

    @property
    def chi_square(self) -> float:
        """Squared distance in standard errors."""
        return float(self.residual @ self.residual)

    @property
    def fitted(self) -> int:
        """Directions that the data determine beyond their limits: parameters that count against the level values."""
        return int(self.directions.shape[1])


def refit(
    response: Response,
    measured: FloatArray,
    whitening: FloatArray,
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> Refit | None:
    """Fit one vector of level values from a start between limits; None if the start cannot be simulated.

    Parameters
    ----------
    response : Response
        What is simulated.
    measured : (d,) array
        Level values, any number where there is none.
    whitening : (d, d) array
        Makes errors independent and of unit size; rows of zero where there is no value.
    start : (p,) array
        Parameters in their units.
    low, high : (p,) array
        Limits, infinite where there is none; equal where a parameter is fixed.

    Notes
    -----
    Levenberg-Marquardt steps of the parameters that no limit holds back, cut at the limits.
    """
    with np.errstate(invalid="ignore"):
        width = np.where(np.isfinite(high - low), (high - low) / np.sqrt(12.0), np.inf)
    size = np.maximum(np.abs(start), np.where(np.isfinite(width), width, 0.0))
    scale = np.where(np.isfinite(width), width, np.where(size > 0.0, size, 1.0))
    is_free = high > low
    point = np.clip(start, low, high)
    here = _linearise(response, measured, whitening, point, scale, is_free, low, high)
    if here is None:
        return None
    damping = 1e-3
    for _ in range(_MOST_STEPS):
        residual, jacobian, _values = here
        gradient = jacobian.T @ residual
        at_low, at_high = is_free & (point <= low) & (gradient > 0.0), is_free & (point >= high) & (gradient < 0.0)
        moving = is_free & ~at_low & ~at_high
        if not moving.any():
            break
        inner = jacobian[:, moving]
        curvature = inner.T @ inner
        ridge = damping * np.maximum(np.diag(curvature), 1e-12 * max(np.trace(curvature), 1e-300))
        step = np.zeros(point.size)
        step[moving] = -np.linalg.solve(curvature + np.diag(ridge), gradient[moving])
        proposal = np.clip(point + scale * step, low, high)
        change = jacobian @ ((proposal - point) / np.where(scale > 0.0, scale, 1.0))
        promised = -float(change @ (2.0 * residual + change))
        there = None if promised <= 0.0 else _linearise(response, measured, whitening, proposal, scale, is_free, low,
                                                         high)  # fmt: skip
        if there is not None and there[0] @ there[0] < residual @ residual:
            point, here, damping = proposal, there, max(0.2 * damping, 1e-9)
            if promised < _ENOUGH:
                break
        else:
            damping *= 8.0
            if damping > 1e9 or 0.0 < promised < _ENOUGH:
                break
    residual, jacobian, values = here
    gradient = jacobian.T @ residual
    at_low, at_high = is_free & (point <= low) & (gradient > 0.0), is_free & (point >= high) & (gradient < 0.0)
    directions = _determined(jacobian, is_free & ~at_low & ~at_high, width)
    return Refit(point, values, residual, at_low, at_high, directions)


def _determined(jacobian: FloatArray, moving: NDArray[np.bool_], width: FloatArray) -> FloatArray:
    """Return directions of the residual (d, k) in which the data say more than the limits do."""
    inner = jacobian[:, moving]
    if not inner.size:
        return np.zeros((jacobian.shape[0], 0))
    left, singular, _ = np.linalg.svd(inner, full_matrices=False)
    # Scaled by the limits' spread, a direction is seen from one on; without limits, where it is seen at all.
    least = 1.0 if np.isfinite(width[moving]).all() else 1e-6 * float(singular[0])
    return np.asarray(left[:, singular > least])


def _linearise(
    response: Response,
    measured: FloatArray,
    whitening: FloatArray,
    point: FloatArray,
    scale: FloatArray,
    is_free: NDArray[np.bool_],
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return standardised residuals, their derivatives by scaled parameters, and simulated values."""
    simulated, jacobian, completed = response.evaluate(point, True)
    if not completed:
        return None
    values = simulated.ravel()
    if not jacobian.size:
        jacobian = np.zeros((values.size, point.size))
        for j in np.flatnonzero(is_free):
            ends = np.array([point, point])
            ends[0, j] = max(point[j] - _DIFFERENCE * scale[j], low[j])
            ends[1, j] = min(point[j] + _DIFFERENCE * scale[j], high[j])
            below, above = (response.evaluate(end, False) for end in ends)
            if not (below[2] and above[2]):
                return None
            jacobian[:, j] = (above[0] - below[0]).ravel() / (ends[1, j] - ends[0, j])
    slopes = whitening @ jacobian.reshape(values.size, point.size) * np.where(is_free, scale, 0.0)
    residual = whitening @ (values - measured)
    return (residual, slopes, values) if np.isfinite(slopes).all() else None
