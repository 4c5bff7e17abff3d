"""Each specimen fitted by itself, linearised about its fit: what a hierarchical model is scaled and shaped with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .._common.checks import FloatArray, InputError
from ..likelihood.specimen_likelihood import whiten_specimens
from ..simulation.response import OscillatorResponse

_STARTS = 6
_GOOD = 4.0  # squared distance per value below which no other start is tried
_FAILED = 1e3  # standardised residual that stands for a failed simulation
_KNOWN = 0.9  # share of the prior's spread that is left where the data are said to say nothing


@dataclass(frozen=True)
class SpecimenFits:
    """Level values of every specimen, linearised about its own fit.

    The log-likelihood of specimen s is close to ``slope[s] @ d - d @ information[s] @ d / 2`` with ``d`` the distance
    of its parameters from ``point[s]``.

    Attributes
    ----------
    point : (n, p) array
        Where least squares ends, in the parameters' units, inside their physical limits.
    information : (n, p, p) array
        Squared derivatives of the standardised level values. Singular where a combination is not seen.
    slope : (n, p) array
        Gradient of the log-likelihood at ``point``.
    error : (n, p) array
        Standard deviation of each parameter given its specimen and a prior as wide as the bounds.
    unidentified : (p,) array of bool
        Whether all specimens together leave more than nine tenths of the prior's spread.
    """

    point: FloatArray
    information: FloatArray
    slope: FloatArray
    error: FloatArray
    unidentified: NDArray[np.bool_]


def fit_specimens(
    response: OscillatorResponse,
    data: xr.Dataset,
    bounds: Mapping[str, tuple[float, float]],
    limits: Mapping[str, tuple[float, float]],
    fixed: Mapping[str, float],
) -> SpecimenFits:
    """Fit each specimen by weighted least squares, with a Gaussian prior of the moments of its bounds.

    Parameters
    ----------
    response : OscillatorResponse
        What is simulated.
    data : xarray.Dataset
        Backbones at levels with standard errors.
    bounds : mapping of str to (float, float)
        Bounds of the prior of every inferred parameter, in the order of the columns of the result.
    limits : mapping of str to (float, float)
        What fits may not leave.
    fixed : mapping of str to float
        The other parameters.

    Returns
    -------
    SpecimenFits

    Raises
    ------
    InputError
        Where no start of a specimen can be simulated, or standard errors are missing.
    """
    values, whitening, _ = whiten_specimens(data)
    names = list(bounds)
    columns = [response.parameter_names.index(name) for name in names]
    base = np.array([fixed.get(name, np.nan) for name in response.parameter_names])
    low, high = np.array(list(bounds.values())).T
    centre, scale = 0.5 * (low + high), (high - low) / np.sqrt(12.0)
    floor, ceiling = np.array([limits[name] for name in names]).T
    edges = (floor - centre) / scale, (ceiling - centre) / scale

    def linearise(unit: FloatArray, s: int) -> tuple[FloatArray, FloatArray]:
        """Return standardised residuals (d,) and their derivatives (d, p) by the scaled parameters."""
        theta = base.copy()
        theta[columns] = centre + scale * unit
        simulated, jacobian, completed = response.evaluate(theta, True)
        if not completed:
            return np.full(values.shape[1], _FAILED), np.zeros((values.shape[1], len(names)))
        residual = whitening[s] @ (simulated.ravel() - values[s])
        return residual, whitening[s] @ jacobian.reshape(-1, theta.size)[:, columns] * scale

    n, p = len(values), len(names)
    point, information, slope = np.empty((n, p)), np.empty((n, p, p)), np.empty((n, p))
    rng = np.random.default_rng(0)
    tried = [np.zeros(p), *(rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), (_STARTS - 1, p)))]
    for s in range(n):
        best, lowest = tried[0], np.inf
        for start in [*([point[s - 1]] if s else []), *tried]:
            inside = np.clip(start, edges[0] + 1e-6, edges[1] - 1e-6)
            if linearise(inside, s)[0][0] == _FAILED:
                continue
            found = least_squares(
                lambda u, s=s: np.concatenate([linearise(u, s)[0], u]),  # type: ignore[misc]
                inside,
                jac=lambda u, s=s: np.vstack([linearise(u, s)[1], np.eye(p)]),  # type: ignore[misc]
                bounds=edges,
                max_nfev=100,
            )
            if found.cost < lowest:
                best, lowest = found.x, found.cost
            if 2.0 * lowest < _GOOD * values.shape[1]:
                break
        if not np.isfinite(lowest):
            raise InputError(
                f"specimen {str(data['specimen'].values[s])!r} cannot be simulated at all levels from any of {_STARTS} "
                "points within the bounds; check mass, units and bounds, or drop its outermost levels."
            )
        residual, jacobian = linearise(best, s)
        point[s], information[s], slope[s] = best, jacobian.T @ jacobian, -jacobian.T @ residual
    prior = np.eye(p)
    error = np.sqrt(np.diagonal(np.linalg.inv(information + prior), axis1=1, axis2=2))
    together = np.sqrt(np.diag(np.linalg.inv(information.sum(axis=0) + prior)))
    return SpecimenFits(
        centre + scale * point,
        information / np.outer(scale, scale),
        slope / scale,
        scale * error,
        together > _KNOWN,
    )
