"""The likelihood of specimens: Gaussian errors of their level values, correlated over the levels."""

from __future__ import annotations

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import FloatArray, InputError
from ..simulation.response import Response
from .op import BackboneOp


def whiten_specimens(data: xr.Dataset) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return measured values (n, d) (0 where missing), whitening (n, d, d) (rows of 0 there) and log constants (n,)."""
    values = np.asarray(data["value"], dtype=np.float64)
    errors = np.asarray(data["standard_error"], dtype=np.float64)
    n, observables, levels = values.shape
    specimens = [str(v) for v in data["specimen"].values]
    size = observables * levels
    whitening, constants = np.zeros((n, size, size)), np.zeros(n)
    held = np.isfinite(values)
    for s in range(n):
        if not held[s].any():
            raise InputError(f"specimen {specimens[s]!r} reaches none of the levels; drop it or choose lower levels.")
        usable = np.isfinite(errors[s]) & (errors[s] > 0.0)
        if not usable[held[s]].all():
            o, k = np.argwhere(held[s] & ~usable)[0]
            raise InputError(
                f"the likelihood of specimens needs standard errors; specimen {specimens[s]!r} has none for "
                f"{data['observable'].values[o]} at {float(data['level'][k]):g}. Use `likelihood='population'`, or "
                "give standard errors with the backbones."
            )
        covariance = np.zeros((size, size))
        for o in range(observables):
            block = np.diag(np.where(held[s, o], errors[s, o], 0.0) ** 2)
            if "covariance" in data:
                given = np.asarray(data["covariance"])[s, o]
                block = np.where(np.isfinite(given), given, block)
            covariance[o * levels : (o + 1) * levels, o * levels : (o + 1) * levels] = block
        index = np.flatnonzero(held[s].ravel())
        scale = np.sqrt(np.diag(covariance)[index])
        correlation = covariance[np.ix_(index, index)] / np.outer(scale, scale)
        factor = np.linalg.cholesky(correlation + 1e-9 * np.eye(index.size))
        whitening[s][np.ix_(index, index)] = np.linalg.inv(factor) / scale
        constants[s] = -0.5 * index.size * np.log(2.0 * np.pi) - np.log(np.diag(factor)).sum() - np.log(scale).sum()
    return np.where(held, values, 0.0).reshape(n, size), whitening, constants


def observe_specimens(name: str, response: Response, data: xr.Dataset, theta: Tensor) -> Tensor:
    """Return the observed variable: one Gaussian vector of level values per specimen."""
    values, whitening, constants = whiten_specimens(data)
    held = np.diagonal(whitening, axis1=1, axis2=2) != 0.0
    errors = np.where(held, np.asarray(data["standard_error"]).reshape(values.shape), 1.0)
    correlation = whitening * errors[:, None, :]  # of residuals in standard errors
    op = BackboneOp(response)
    size = values.shape[1]

    def simulate(point: Tensor) -> Tensor:
        backbone = op(point)[0] if point.ndim == 1 else pt.vectorize(lambda t: op(t)[0], "(p)->(o,l)")(point)
        return backbone.reshape((size,)) if point.ndim == 1 else backbone.reshape((backbone.shape[0], size))

    def log_probability(
        value: Tensor, point: Tensor, whitener: Tensor, constant: Tensor, factor: Tensor, error: Tensor
    ) -> Tensor:
        residual = (value - simulate(point)) / error
        standardised = (whitener * residual[..., None, :]).sum(axis=-1)
        total = constant - 0.5 * (standardised**2).sum(axis=-1)
        return pt.switch(pt.isnan(total), -np.inf, total)

    def draw(point: Tensor, whitener: Tensor, constant: Tensor, factor: Tensor, error: Tensor, size: Tensor) -> Tensor:
        noise = pm.Normal.dist(0.0, 1.0, size=values.shape)
        return simulate(point) + error * (factor * noise[:, None, :]).sum(axis=-1)

    return pm.CustomDist(
        name,
        theta,
        correlation,
        constants,
        np.linalg.pinv(correlation),
        errors,
        dist=draw,
        logp=log_probability,
        signature="(p),(d,e),(),(d,e),(d)->(d)",
        observed=values,
    )
