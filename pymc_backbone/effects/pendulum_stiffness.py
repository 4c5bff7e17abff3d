"""Gravity of a pendulum, beyond its linear part; the displacement is an angle."""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * (math.sin(x) - x)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = p[0] * (math.cos(x) - 1.0)
    out[1] = 0.0
    out[2] = math.sin(x) - x


EFFECT = Effect(
    name="pendulum_stiffness",
    summary="Pendulum: frequency falls with the square of the angle as sin(x) demands, no damping, no offset.",
    text="pendulum_stiffness (sin(x) - x)",
    latex=r"k_p \left(\sin x - x\right)",
    parameters=(
        Parameter(
            name="pendulum_stiffness",
            unit="N m/rad",
            latex="k_p",
            summary="weight times lever arm of the pendulum",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 2.0 * mass * angular_frequency**2),
        ),
    ),
    force=force,
    gradient=gradient,
    references=("Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",),
    needs_rotation=True,
    mechanism="spring",
    signature=Signature(
        frequency="Falls with the square of the angle: by 6 % at one radian.",
        damping="Rises a little where the frequency falls: a longer cycle leaves the viscous damper more time.",
        offset="Zero.",
        found_in="pendulums, cranes, the roll of a ship by its righting arm; the displacement is an angle",
        typical=lambda mass, amplitude, angular_frequency: (mass * angular_frequency**2,),
        resembles=("cubic_stiffness",),
    ),
)
