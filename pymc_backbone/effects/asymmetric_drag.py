"""Drag that differs with the direction of motion, as of flaps, check valves and dampers that bite one way."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * v * v * (direction + p[1])


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[0] = 0.0
    out[1] = 2.0 * p[0] * v * (direction + p[1])
    out[2] = v * v * (direction + p[1])
    out[3] = p[0] * v * v


EFFECT = Effect(
    name="asymmetric_drag",
    summary="Drag that is stronger in one direction: damping rises with amplitude, and the mid-line moves.",
    text="asymmetric_drag x' |x'| (1 + drag_asymmetry sign(x'))",
    latex=r"c_w \dot{x} \left|\dot{x}\right| \left(1 + r_w \operatorname{sign} \dot{x}\right)",
    parameters=(
        Parameter(
            name="asymmetric_drag",
            unit="N s^2/m^2",
            latex="c_w",
            summary="coefficient of the quadratic damper, mean of both directions",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.5 * mass / amplitude),
        ),
        Parameter(
            name="drag_asymmetry",
            unit="-",
            latex="r_w",
            summary="1: only while the displacement rises; -1: only while it falls; 0: alike",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (-1.0, 1.0),
            minimum=-1.0,
            maximum=1.0,
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Dixon J. C. (2007) The Shock Absorber Handbook, 2nd ed. Wiley. doi:10.1002/9780470516430",
        "Nayfeh A. H., Mook D. T. (1979) Nonlinear Oscillations. Wiley. doi:10.1002/9783527617586",
    ),
    mechanism="drag",
    variant_of=("quadratic_damping",),
    signature=Signature(
        frequency="Constant.",
        damping="Rises in proportion to the amplitude.",
        offset="Falls in proportion to the amplitude; rises where the asymmetry is negative.",
        found_in="flaps and check valves, shock absorbers with other rebound than compression, dashpots that suck air",
        typical=lambda mass, amplitude, angular_frequency: (0.02 * mass / amplitude, 0.5),
        resembles=("quadratic_damping", "cubic_damping", "quadratic_stiffness", "bilinear_stiffness"),
    ),
)
