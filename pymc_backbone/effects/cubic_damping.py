"""Damping with the cube of the velocity."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * v * v * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 0.0
    out[1] = 3.0 * p[0] * v * v
    out[2] = v * v * v


EFFECT = Effect(
    name="cubic_damping",
    summary="Cubic damper: damping rises with the square of amplitude and of frequency, frequency hardly changed.",
    text="cubic_damping x'^3",
    latex=r"c_3 \dot{x}^3",
    parameters=(
        Parameter(
            name="cubic_damping",
            unit="N s^3/m^3",
            latex="c_3",
            summary="coefficient of the cubic damper",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.3 * mass / (angular_frequency * amplitude**2)),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Elliott S. J., Ghandchi Tehrani M., Langley R. S. (2015) Nonlinear damping and quasi-linear modelling. "
        "Philosophical Transactions of the Royal Society A 373, 20140402. doi:10.1098/rsta.2014.0402",
    ),
    mechanism="drag",
    signature=Signature(
        frequency="Constant.",
        damping="Rises with the square of the amplitude and with the frequency.",
        offset="Zero.",
        found_in="shock absorbers and other dampers that stiffen with speed, ship roll",
        typical=lambda mass, amplitude, angular_frequency: (0.03 * mass / (angular_frequency * amplitude**2),),
        resembles=("displacement_dependent_damping", "quadratic_damping"),
    ),
)
