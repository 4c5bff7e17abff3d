"""Damping with any power of the displacement.

The coefficient is given at a reference displacement, so that its size does not change by orders of magnitude with the
exponent. Below a few hundredths of that displacement the law is rounded: with an exponent below 1 it would have a
vertical tangent in the middle, where the speed is largest.
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._sides import regime

_ROUND = 1e-2  # of the reference displacement


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[2] <= 0.0:
        return 0.0
    u = x / p[2]
    return p[0] * v * (u * u + _ROUND * _ROUND) ** (0.5 * p[1])


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    if p[2] <= 0.0:
        return
    u = x / p[2]
    square = u * u + _ROUND * _ROUND
    power = square ** (0.5 * p[1])
    out[0] = p[0] * v * p[1] * power * u / (square * p[2])
    out[1] = p[0] * power
    out[2] = v * power
    out[3] = 0.5 * p[0] * v * power * math.log(square)
    out[4] = -u * out[0]


EFFECT = Effect(
    name="power_displacement_damping",
    summary="Damper with a power of the displacement: damping goes with the amplitude to that power.",
    text="power_displacement_damping x' (u^2 + 0.01^2)^(displacement_exponent/2); u = x/damping_displacement",
    latex=r"c_p \dot{x} \left(u^2 + 0.01^2\right)^{r/2}; u = x / x_d",
    parameters=(
        Parameter(
            name="power_displacement_damping",
            unit="N s/m",
            latex="c_p",
            summary="damping coefficient at the reference displacement",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.8 * mass * angular_frequency),
        ),
        Parameter(
            name="displacement_exponent",
            unit="-",
            latex="r",
            summary="power of the displacement: 0 viscous, 2 the van der Pol type",
            role="exponent",
            bounds=lambda mass, amplitude, angular_frequency: (0.2, 4.0),
        ),
        Parameter(
            name="damping_displacement",
            unit="m",
            latex="x_d",
            summary="reference displacement; chosen, not measured",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.5 * amplitude, 2.0 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    redundant=(("damping_displacement", lambda mass, amplitude, angular_frequency: amplitude),),
    references=("Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",),
    mechanism="displacement_damping",
    variant_of=("displacement_dependent_damping", "quadratic_damping"),
    signature=Signature(
        frequency="Constant.",
        damping="Rises with the amplitude to the power of the exponent.",
        offset="Zero.",
        found_in="members that pump or press their support as they bend, layers that are squeezed",
        typical=lambda mass, amplitude, angular_frequency: (0.04 * mass * angular_frequency, 1.5, amplitude),
        resembles=("displacement_dependent_damping", "absolute_displacement_damping", "power_damping"),
    ),
)
