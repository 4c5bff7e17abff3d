"""Spring with any power of the displacement, the same on both sides.

The force is given at a reference displacement, so that its size does not change by orders of magnitude with the
exponent. At a reference displacement of 1 m it is the coefficient k of k |x|^p.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._sides import regime


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[2] <= 0.0:
        return 0.0
    return p[0] * math.copysign((abs(x) / p[2]) ** p[1], x)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    size = abs(x)
    if p[2] <= 0.0 or size == 0.0:
        if p[2] > 0.0 and p[1] == 1.0:
            out[0] = p[0] / p[2]
        return
    power = math.copysign((size / p[2]) ** p[1], x)
    out[0] = p[0] * p[1] * power / x
    out[2] = power
    out[3] = p[0] * power * math.log(size / p[2])
    out[4] = -p[0] * p[1] * power / p[2]


EFFECT = Effect(
    name="power_stiffness",
    summary="Spring with a power of the displacement: the frequency changes with the amplitude to that power less one.",
    text="power_stiffness (|x|/power_stiffness_displacement)^power_stiffness_exponent sign(x)",
    latex=r"F_p \left(|x| / x_p\right)^{q_p} \operatorname{sign}(x)",
    parameters=(
        Parameter(
            name="power_stiffness",
            unit="N",
            latex="F_p",
            summary="force at the reference displacement; negative softens",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -1.5 * mass * angular_frequency**2 * amplitude,
                1.5 * mass * angular_frequency**2 * amplitude,
            ),
            minimum=-np.inf,
        ),
        Parameter(
            name="power_stiffness_exponent",
            unit="-",
            latex="q_p",
            summary="power of the displacement: 1 linear, 3 cubic",
            role="exponent",
            bounds=lambda mass, amplitude, angular_frequency: (1.2, 7.0),
            minimum=1.0,
        ),
        Parameter(
            name="power_stiffness_displacement",
            unit="m",
            latex="x_p",
            summary="reference displacement; chosen, not measured",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.5 * amplitude, 2.0 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    redundant=(("power_stiffness_displacement", lambda mass, amplitude, angular_frequency: amplitude),),
    references=(
        "Gottlieb H. P. W. (2003) Frequencies of oscillators with fractional-power non-linearities. "
        "Journal of Sound and Vibration 261(3), 557-566",
        "Kovacic I., Brennan M. J. (2011) The Duffing Equation. Wiley. doi:10.1002/9780470977859",
    ),
    mechanism="spring",
    variant_of=("cubic_stiffness", "quintic_stiffness"),
    signature=Signature(
        frequency="Rises with the amplitude to the power of the exponent less one; falls where the force is negative.",
        damping="Falls a little where the frequency rises: the viscous damper has less time in a shorter cycle.",
        offset="Zero.",
        found_in="rubber and foam mounts, wire ropes, geometric stiffening of another order than three",
        typical=lambda mass, amplitude, angular_frequency: (
            0.2 * mass * angular_frequency**2 * amplitude,
            2.0,
            amplitude,
        ),
        resembles=("cubic_stiffness", "quintic_stiffness", "freeplay"),
    ),
)
