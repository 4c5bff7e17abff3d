"""What Uniform priors add to least squares, on the unconstrained scale of PyMC."""

from __future__ import annotations

import numpy as np

from .._common.checks import FloatArray


def residual_of_prior(inside: FloatArray) -> FloatArray:
    """Return the residual (n,) of unconstrained values (n,), 0 in the middle of the interval.

    4 log cosh(u / 2), its square, is twice the loss in log-density, up to a constant.
    """
    return np.asarray(np.sign(inside) * 2.0 * np.sqrt(np.logaddexp(0.5 * inside, -0.5 * inside) - np.log(2.0)))


def slope_of_prior(inside: FloatArray) -> FloatArray:
    """Return the derivative of `residual_of_prior`, r: tanh(u / 2) / r, which is 1 / sqrt(2) at zero."""
    residual = np.abs(residual_of_prior(inside))
    is_zero = residual < 1e-6
    slope = np.tanh(0.5 * np.abs(inside)) / np.where(is_zero, 1.0, residual)
    return np.asarray(np.where(is_zero, np.sqrt(0.5), slope))


__all__ = ["residual_of_prior", "slope_of_prior"]
