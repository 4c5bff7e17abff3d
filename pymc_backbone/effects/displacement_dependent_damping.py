"""Damping that grows with the displacement squared (van der Pol type)."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * x * x * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 2.0 * p[0] * x * v
    out[1] = p[0] * x * x
    out[2] = x * x * v


EFFECT = Effect(
    name="displacement_dependent_damping",
    summary="Displacement-dependent damper: damping rises with the square of the amplitude, whatever the frequency.",
    text="displacement_dependent_damping x^2 x'",
    latex=r"c_d x^2 \dot{x}",
    parameters=(
        Parameter(
            name="displacement_dependent_damping",
            unit="N s/m^3",
            latex="c_d",
            summary="coefficient of the displacement-dependent damper",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.8 * mass * angular_frequency / amplitude**2),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Zaitsev S., Shtempluck O., Buks E., Gottlieb O. (2012) Nonlinear damping in a micromechanical oscillator. "
        "Nonlinear Dynamics 67, 859-883. arXiv:0911.0833",
    ),
    mechanism="displacement_damping",
    signature=Signature(
        frequency="Constant.",
        damping="Rises with the square of the amplitude.",
        offset="Zero.",
        found_in="micromechanical resonators, slender members that pump their support as they bend",
        typical=lambda mass, amplitude, angular_frequency: (0.08 * mass * angular_frequency / amplitude**2,),
        resembles=("cubic_damping", "quadratic_damping"),
    ),
)
