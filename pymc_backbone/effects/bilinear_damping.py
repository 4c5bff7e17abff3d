"""Bilinear damper: one viscous coefficient while the displacement rises, another while it falls (bump and rebound)."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * v if direction > 0.0 else 0.0


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    acts = 1.0 if direction > 0.0 else 0.0
    out[0] = 0.0
    out[1] = p[0] * acts
    out[2] = v * acts


EFFECT = Effect(
    name="bilinear_damping",
    summary="Bilinear damper: a constant share of offset and more damping at every amplitude, the frequency constant.",
    text="bilinear_damping max(x', 0)",
    latex=r"c_b \max(\dot{x}, 0)",
    parameters=(
        Parameter(
            name="bilinear_damping",
            unit="N s/m",
            latex="c_b",
            summary="viscous coefficient added while the displacement rises; negative takes away",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -0.2 * mass * angular_frequency,  # more would feed what the viscous damper takes
                0.5 * mass * angular_frequency,
            ),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    references=("Dixon J. C. (2007) The Shock Absorber Handbook, 2nd ed. Wiley. doi:10.1002/9780470516430",),
    mechanism="damping_asymmetry",
    variant_of=("bilinear_stiffness",),
    signature=Signature(
        frequency="Constant.",
        damping="Constant.",
        offset="Constant, away from the direction that is damped more: a constant share of the amplitude.",
        found_in="shock absorbers with other rebound than bump, door closers, hydraulic buffers with check valves",
        typical=lambda mass, amplitude, angular_frequency: (0.05 * mass * angular_frequency,),
        resembles=("bilinear_stiffness", "asymmetric_drag", "viscous_damping"),
    ),
)
