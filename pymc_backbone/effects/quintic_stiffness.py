"""Spring of fifth order: acts at large amplitudes only."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * x**5


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 5.0 * p[0] * x**4
    out[1] = 0.0
    out[2] = x**5


EFFECT = Effect(
    name="quintic_stiffness",
    summary="Fifth-order spring: frequency rises with amplitude to the fourth (falls if negative), no damping.",
    text="quintic_stiffness x^5",
    latex="k_5 x^5",
    parameters=(
        Parameter(
            name="quintic_stiffness",
            unit="N/m^5",
            latex="k_5",
            summary="coefficient of the fifth-order spring; negative softens",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -1.5 * mass * angular_frequency**2 / amplitude**4,
                1.5 * mass * angular_frequency**2 / amplitude**4,
            ),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    references=("Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",),
    mechanism="spring",
    signature=Signature(
        frequency="Rises with the fourth power of the amplitude: hardly at small ones, steeply at large ones.",
        damping="Falls a little where the frequency rises, as beside a cubic spring.",
        offset="Zero.",
        found_in="stops and rubber that stiffen late; the next term where a cubic spring does not suffice",
        typical=lambda mass, amplitude, angular_frequency: (0.3 * mass * angular_frequency**2 / amplitude**4,),
        resembles=("cubic_stiffness", "freeplay"),
    ),
)
