"""The likelihood of specimens: Gaussian errors of their level values, correlated over the levels.

What was measured stands in the model as data (`pymc.Data`), so that a compiled model takes other numbers.
"""

from __future__ import annotations

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import FloatArray, InputError
from ..simulation.response import Response
from .dims import data_coords, keep_unit, name_dims
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


def specimen_arrays(data: xr.Dataset) -> dict[str, FloatArray]:
    """Return what a model holds of the specimens, by the ending of its name.

    ``values`` and ``standard_errors`` (n, o, l), NaN where a specimen does not reach a level; ``whitening`` (n, d, d),
    which makes residuals in standard errors independent, and ``error_factor`` (n, d, d), which makes errors from
    independent numbers, both with rows of zeros there; ``log_constant`` (n,) is the log-density at
    residuals of zero.
    """
    _, whitening, constants = whiten_specimens(data)
    values = np.asarray(data["value"], dtype=np.float64)
    held = np.isfinite(values)
    errors = np.where(held, np.asarray(data["standard_error"], dtype=np.float64), np.nan)
    scale = np.where(held, errors, 1.0).reshape(len(values), 1, -1)
    correlation = whitening * scale
    return {
        "values": np.where(held, values, np.nan),
        "standard_errors": errors,
        "whitening": correlation,
        "log_constant": constants,
        "error_factor": np.swapaxes(scale, 1, 2) * np.linalg.pinv(correlation),
    }


def observe_specimens(name: str, response: Response, data: xr.Dataset, theta: Tensor) -> Tensor:
    """Return the observed variable: one Gaussian backbone per specimen, with dimensions specimen, observable, level."""
    arrays = specimen_arrays(data)
    dims = name_dims(name, data_coords(data))
    shape = arrays["values"].shape
    matrix = (dims[0], f"{name}_value", f"{name}_value_other")
    which = {
        "values": dims,
        "standard_errors": dims,
        "whitening": matrix,
        "error_factor": matrix,
        "log_constant": dims[:1],
    }
    shared = {ending: _add_data(f"{name}_{ending}", array, which[ending]) for ending, array in arrays.items()}
    keep_unit(shared["values"], data)
    op = BackboneOp(response)

    def simulate(point: Tensor) -> Tensor:
        return op(point)[0] if point.ndim == 1 else pt.vectorize(lambda t: op(t)[0], "(p)->(o,l)")(point)

    def hold(whitener: Tensor) -> Tensor:
        """Return which values were measured: comparing numbers, as NaN is not safe from fast mathematics."""
        return pt.neq(pt.diagonal(whitener, axis1=-2, axis2=-1), 0.0).reshape(shape)

    def log_probability(
        value: Tensor, point: Tensor, whitener: Tensor, constant: Tensor, error: Tensor, mixer: Tensor
    ) -> Tensor:
        held = hold(whitener)
        error = pt.switch(held, error, 1.0)  # a NaN in the branch that is not taken would spoil the gradient
        residual = ((pt.switch(held, value, 0.0) - simulate(point)) / error).reshape((shape[0], 1, -1))
        standardised = (whitener * residual).sum(axis=-1)
        total = constant - 0.5 * (standardised**2).sum(axis=-1)
        return pt.switch(pt.isnan(total), -np.inf, total)

    def draw(point: Tensor, whitener: Tensor, constant: Tensor, error: Tensor, mixer: Tensor, size: Tensor) -> Tensor:
        noise = pm.Normal.dist(0.0, 1.0, size=(shape[0], 1, shape[1] * shape[2]))
        return simulate(point) + (mixer * noise).sum(axis=-1).reshape(shape)

    return pm.CustomDist(
        name,
        theta,
        shared["whitening"],
        shared["log_constant"],
        shared["standard_errors"],
        shared["error_factor"],
        dist=draw,
        logp=log_probability,
        signature="(p),(d,e),(),(o,l),(d,e)->(o,l)",
        observed=shared["values"],
        dims=dims,
    )


def _add_data(name: str, array: FloatArray, dims: tuple[str, ...]) -> Tensor:
    """Add an array to the current model as data; NaN stands for what was not measured, not for what is to be imputed.

    PyMC refuses NaN in the call itself.
    """
    data = pm.Data(name, np.nan_to_num(array), dims=dims, shape=array.shape)
    data.set_value(array)
    return data
