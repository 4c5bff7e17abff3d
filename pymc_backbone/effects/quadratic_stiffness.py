"""Quadratic spring: an asymmetric restoring force."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * x * x


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 2.0 * p[0] * x
    out[1] = 0.0
    out[2] = x * x


EFFECT = Effect(
    name="quadratic_stiffness",
    summary="Quadratic spring: offset grows with amplitude, frequency falls with its square (either sign), no damping.",
    text="quadratic_stiffness x^2",
    latex="k_2 x^2",
    parameters=(
        Parameter(
            name="quadratic_stiffness",
            unit="N/m^2",
            latex="k_2",
            summary="coefficient of the quadratic spring; the sign says to which side it stiffens",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -0.5 * mass * angular_frequency**2 / amplitude,
                0.5 * mass * angular_frequency**2 / amplitude,
            ),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    references=("Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",),
    mechanism="asymmetry",
    signature=Signature(
        frequency="Falls with the square of the amplitude, whatever the sign of the coefficient.",
        damping="Falls a little.",
        offset="Falls in proportion to the amplitude; rises where the coefficient is negative. The mid-line moves "
        "to the softer side.",
        found_in="preloaded, sagging or curved structures: cables, shallow arches, springs about a static load",
        typical=lambda mass, amplitude, angular_frequency: (0.3 * mass * angular_frequency**2 / amplitude,),
        resembles=("bilinear_stiffness",),
    ),
)
