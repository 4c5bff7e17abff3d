"""Springs or wires that lie across the motion and are inclined by it: a stiffness that changes up to their length.

The law of a pair of inclined springs without preload, beyond which they pull as any spring does. With a negative
coefficient it is a spring that softens and then stays as soft, as one that saturates.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[1] <= 0.0:
        return 0.0
    u = x / p[1]
    root = math.sqrt(1.0 + u * u)
    return p[0] * x * u * u / (root * (root + 1.0))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    if p[1] <= 0.0:
        return
    u = x / p[1]
    root = math.sqrt(1.0 + u * u)
    share = u * u / (root * (root + 1.0))
    out[0] = p[0] * (share + u * u / (root * root * root))
    out[2] = x * share
    out[3] = -p[0] * u * u * u / (root * root * root)


EFFECT = Effect(
    name="geometric_stiffness",
    summary="Inclined springs or wires: hardens as a cubic spring does, ever more slowly; no damping, no offset.",
    text="geometric_stiffness x (1 - 1/sqrt(1 + (x/inclined_length)^2))",
    latex=r"k_g x \left(1 - \frac{1}{\sqrt{1 + (x / l_g)^2}}\right)",
    parameters=(
        Parameter(
            name="geometric_stiffness",
            unit="N/m",
            latex="k_g",
            summary="stiffness along the motion once the springs lie in it; negative: softening that saturates",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -1.0 * mass * angular_frequency**2,
                4.0 * mass * angular_frequency**2,
            ),
            minimum=-np.inf,
        ),
        Parameter(
            name="inclined_length",
            unit="m",
            latex="l_g",
            summary="length of the springs at rest, across the motion",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.1 * amplitude, 3.0 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Carrella A., Brennan M. J., Waters T. P. (2007) Static analysis of a passive vibration isolator with "
        "quasi-zero-stiffness characteristic. Journal of Sound and Vibration 301(3-5), 678-689. "
        "doi:10.1016/j.jsv.2006.10.011",
    ),
    mechanism="spring",
    variant_of=("cubic_stiffness", "quintic_stiffness"),
    signature=Signature(
        frequency="Rises with the square of the amplitude at first, ever more slowly beyond the length of the springs.",
        damping="Falls a little where the frequency rises.",
        offset="Zero.",
        found_in="wires and springs across the motion, isolators of quasi-zero stiffness; negative: rubber and wire "
        "rope mounts that soften up to a stiffness",
        typical=lambda mass, amplitude, angular_frequency: (0.5 * mass * angular_frequency**2, 0.5 * amplitude),
        resembles=("cubic_stiffness", "power_stiffness", "freeplay"),
    ),
)
