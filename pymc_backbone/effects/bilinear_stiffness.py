"""Bilinear spring: one stiffness for positive displacements, another for negative ones (a breathing crack)."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._sides import regime


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * max(x, 0.0)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = p[0] if regime(x, v, direction, z, p) > 0 else 0.0
    out[1] = 0.0
    out[2] = max(x, 0.0)


EFFECT = Effect(
    name="bilinear_stiffness",
    summary="Bilinear spring: a constant share of offset and a shifted frequency at every amplitude, no damping.",
    text="bilinear_stiffness max(x, 0)",
    latex=r"k_b \max(x, 0)",
    parameters=(
        Parameter(
            name="bilinear_stiffness",
            unit="N/m",
            latex="k_b",
            summary="stiffness added on the positive side; negative takes away",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -1.5 * mass * angular_frequency**2,
                1.5 * mass * angular_frequency**2,
            ),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Shaw S. W., Holmes P. J. (1983) A periodically forced piecewise linear oscillator. "
        "Journal of Sound and Vibration 90(1), 129-155",
    ),
    mechanism="asymmetry",
    signature=Signature(
        frequency="Constant: the mean of two half cycles, whatever their amplitude.",
        damping="Constant.",
        offset="Constant, away from the stiffer side: a constant share of the amplitude.",
        found_in="breathing cracks, one-sided contact that is closed at rest, cables that go slack",
        typical=lambda mass, amplitude, angular_frequency: (0.4 * mass * angular_frequency**2,),
        resembles=("quadratic_stiffness", "linear_stiffness"),
    ),
)
