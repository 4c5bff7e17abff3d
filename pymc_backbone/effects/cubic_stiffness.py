"""Cubic spring (Duffing): hardening when positive, softening when negative."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * x * x * x


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 3.0 * p[0] * x * x
    out[1] = 0.0
    out[2] = x * x * x


EFFECT = Effect(
    name="cubic_stiffness",
    summary="Cubic spring: frequency rises with the square of the amplitude (falls if negative), no damping.",
    text="cubic_stiffness x^3",
    latex="k_3 x^3",
    parameters=(
        Parameter(
            name="cubic_stiffness",
            unit="N/m^3",
            latex="k_3",
            summary="coefficient of the cubic spring; negative softens",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -1.5 * mass * angular_frequency**2 / amplitude**2,
                1.5 * mass * angular_frequency**2 / amplitude**2,
            ),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Kovacic I., Brennan M. J. (2011) The Duffing Equation. Wiley. doi:10.1002/9780470977859",
        "Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",
    ),
    mechanism="spring",
    signature=Signature(
        frequency="Rises with the square of the amplitude; falls where the coefficient is negative.",
        damping="Falls a little where the frequency rises: the spring dissipates nothing, but the viscous damper "
        "has less time in a shorter cycle.",
        offset="Zero.",
        found_in="clamped thin beams and plates that stretch as they bend; negative: magnets, shallow arches, "
        "pendulums",
        typical=lambda mass, amplitude, angular_frequency: (0.3 * mass * angular_frequency**2 / amplitude**2,),
        resembles=("quintic_stiffness", "freeplay", "pendulum_stiffness"),
    ),
)
