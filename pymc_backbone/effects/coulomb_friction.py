"""Dry friction: a constant force against the motion."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * direction


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 0.0
    out[1] = 0.0
    out[2] = direction


EFFECT = Effect(
    name="coulomb_friction",
    summary="Dry friction: damping grows as one over the amplitude, the decay ends in sticking, frequency unchanged.",
    text="friction_force sign(x')",
    latex=r"F_c \operatorname{sign}(\dot{x})",
    parameters=(
        Parameter(
            name="friction_force",
            unit="N",
            latex="F_c",
            summary="magnitude of the dry friction force",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.1 * mass * angular_frequency**2 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Feeny B. F., Liang J.-W. (1996) A decrement method for the simultaneous estimation of Coulomb and viscous "
        "friction. Journal of Sound and Vibration 195(1), 149-154",
    ),
    mechanism="hysteresis",
    signature=Signature(
        frequency="Constant.",
        damping="Falls as one over the amplitude: friction takes the same step off every cycle, a larger share of "
        "a small one. The decay ends in sticking.",
        offset="Zero.",
        found_in="rubbing guides, bearings, cables in their sheaths",
        typical=lambda mass, amplitude, angular_frequency: (0.003 * mass * angular_frequency**2 * amplitude,),
        resembles=("jenkins",),
    ),
)
