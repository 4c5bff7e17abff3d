"""Linear spring; always part of an oscillator."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * x


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = p[0]
    out[1] = 0.0
    out[2] = x


EFFECT = Effect(
    name="linear_stiffness",
    summary="Linear spring: one frequency at every amplitude, no damping.",
    text="linear_stiffness x",
    latex="k x",
    parameters=(
        Parameter(
            name="linear_stiffness",
            unit="N/m",
            latex="k",
            summary="stiffness of the linear spring",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                0.25 * mass * angular_frequency**2,
                4.0 * mass * angular_frequency**2,
            ),
        ),
    ),
    force=force,
    gradient=gradient,
    references=("Rao S. S. (2017) Mechanical Vibrations, 6th ed. Pearson, section 2.6",),
    signature=Signature(
        frequency="Constant: one frequency at every amplitude.",
        damping="Constant: a spring dissipates nothing.",
        offset="Zero.",
        found_in="every structure that returns to rest",
        typical=lambda mass, amplitude, angular_frequency: (1.2 * mass * angular_frequency**2,),
    ),
)
