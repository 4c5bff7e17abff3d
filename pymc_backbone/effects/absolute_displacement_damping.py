"""Damping that grows with the size of the displacement."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._sides import regime


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * abs(x) * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = p[0] * regime(x, v, direction, z, p) * v
    out[1] = p[0] * abs(x)
    out[2] = abs(x) * v


EFFECT = Effect(
    name="absolute_displacement_damping",
    summary="Damper in proportion to the displacement: damping rises in proportion to the amplitude.",
    text="absolute_displacement_damping |x| x'",
    latex=r"c_a |x| \dot{x}",
    parameters=(
        Parameter(
            name="absolute_displacement_damping",
            unit="N s/m^2",
            latex="c_a",
            summary="coefficient of the displacement-dependent damper",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.5 * mass * angular_frequency / amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=("Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",),
    mechanism="displacement_damping",
    variant_of=("displacement_dependent_damping", "quadratic_damping"),
    signature=Signature(
        frequency="Constant.",
        damping="Rises in proportion to the amplitude.",
        offset="Zero.",
        found_in="members that pump or press their support as they bend, contacts that close with the displacement",
        typical=lambda mass, amplitude, angular_frequency: (0.05 * mass * angular_frequency / amplitude,),
        resembles=("displacement_dependent_damping", "quadratic_damping", "power_damping"),
    ),
)
