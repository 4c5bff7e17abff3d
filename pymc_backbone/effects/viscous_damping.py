"""Linear viscous damper; always part of an oscillator."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 0.0
    out[1] = p[0]
    out[2] = v


EFFECT = Effect(
    name="viscous_damping",
    summary="Viscous damper: the same logarithmic decrement at every amplitude, frequency hardly changed.",
    text="viscous_damping x'",
    latex=r"c \dot{x}",
    parameters=(
        Parameter(
            name="viscous_damping",
            unit="N s/m",
            latex="c",
            summary="coefficient of the viscous damper",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.2 * mass * angular_frequency),
        ),
    ),
    force=force,
    gradient=gradient,
    references=("Rao S. S. (2017) Mechanical Vibrations, 6th ed. Pearson, section 2.6",),
    signature=Signature(
        frequency="Constant, and relatively lower by half the square of the damping ratio.",
        damping="Constant: the same decrement at every amplitude.",
        offset="Zero.",
        found_in="material losses and small motions in a fluid, roughly; what is left when nothing better is known",
        typical=lambda mass, amplitude, angular_frequency: (0.02 * mass * angular_frequency,),
    ),
)
