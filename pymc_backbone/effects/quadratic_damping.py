"""Damping with the square of the velocity, as of drag in air or water."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * v * v * direction


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = 0.0
    out[1] = 2.0 * p[0] * v * direction
    out[2] = v * v * direction


EFFECT = Effect(
    name="quadratic_damping",
    summary="Drag: damping rises in proportion to amplitude, frequency hardly changed.",
    text="quadratic_damping x' |x'|",
    latex=r"c_2 \dot{x} \left|\dot{x}\right|",
    parameters=(
        Parameter(
            name="quadratic_damping",
            unit="N s^2/m^2",
            latex="c_2",
            summary="coefficient of the quadratic damper",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.5 * mass / amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",
        "Elliott S. J., Ghandchi Tehrani M., Langley R. S. (2015) Nonlinear damping and quasi-linear modelling. "
        "Philosophical Transactions of the Royal Society A 373, 20140402. doi:10.1098/rsta.2014.0402",
    ),
    mechanism="drag",
    signature=Signature(
        frequency="Constant.",
        damping="Rises in proportion to the amplitude.",
        offset="Zero.",
        found_in="drag of blunt bodies in air or water, orifices",
        typical=lambda mass, amplitude, angular_frequency: (0.02 * mass / amplitude,),
        resembles=("cubic_damping", "displacement_dependent_damping", "iwan"),
    ),
)
