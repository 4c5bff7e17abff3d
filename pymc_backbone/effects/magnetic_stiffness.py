"""Spring of two magnets, one on either side at the same distance, beyond its linear part.

Each force goes with an inverse power of the distance left. The power is not that of a point at the very end of the gap,
where magnets touch: from nine tenths of the distance on, the force goes on along its tangent, so it is always finite.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature

_LAST = 0.9  # share of the distance from which the force follows its tangent


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 1 or -1 on the tangent at that side and 0 between; on a kink, the branch being entered."""
    last = _LAST * p[1]
    if x > last or (x == last and direction > 0.0):
        return 1
    if x < -last or (x == -last and direction < 0.0):
        return -1
    return 0


@numba.njit
def _parts(x: float, p: FloatArray) -> tuple[float, float, float, float, float]:
    """Return x and where the law is taken, over the distance; near and far magnet's force there; law and tangent."""
    u = x / p[1]
    at = min(max(u, -_LAST), _LAST)
    near, far = (1.0 - at) ** -p[2], (1.0 + at) ** -p[2]
    return u, at, near, far, p[2] * (near / (1.0 - at) + far / (1.0 + at) - 2.0)


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[1] <= 0.0:
        return 0.0
    u, at, near, far, slope = _parts(x, p)
    return p[0] * (near - far - 2.0 * p[2] * at + (u - at) * slope)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    if p[1] <= 0.0:
        return
    u, at, near, far, slope = _parts(x, p)
    by_near, by_far = -near * math.log(1.0 - at), far * math.log(1.0 + at)  # to the exponent, the latter less
    by_exponent = slope / p[2] if p[2] != 0.0 else 0.0
    by_exponent += p[2] * (by_near / (1.0 - at) - by_far / (1.0 + at))
    out[0] = p[0] * slope / p[1]
    out[2] = near - far - 2.0 * p[2] * at + (u - at) * slope
    out[3] = -p[0] * slope * u / p[1]
    out[4] = p[0] * (by_near + by_far - 2.0 * at + (u - at) * by_exponent)


EFFECT = Effect(
    name="magnetic_stiffness",
    summary="Magnets on both sides: frequency rises ever faster towards them (falls if they attract), no damping.",
    text="magnet_force ((1 - x/magnet_distance)^-magnet_exponent - (1 + x/magnet_distance)^-magnet_exponent "
    "- 2 magnet_exponent x/magnet_distance)",
    latex=r"F_m \left[\left(1 - x / d_m\right)^{-n_m} - \left(1 + x / d_m\right)^{-n_m} - 2 n_m x / d_m\right]",
    parameters=(
        Parameter(
            name="magnet_force",
            unit="N",
            latex="F_m",
            summary="force of each magnet at rest; positive repels, negative attracts",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -0.1 * mass * angular_frequency**2 * amplitude,
                0.1 * mass * angular_frequency**2 * amplitude,
            ),
            minimum=-np.inf,
        ),
        Parameter(
            name="magnet_distance",
            unit="m",
            latex="d_m",
            summary="distance to each magnet at rest",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (1.2 * amplitude, 4.0 * amplitude),
        ),
        Parameter(
            name="magnet_exponent",
            unit="-",
            latex="n_m",
            summary="inverse power of the distance: 4 of magnets that are small beside it, less of larger ones",
            role="exponent",
            bounds=lambda mass, amplitude, angular_frequency: (1.0, 6.0),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Mann B. P., Sims N. D. (2009) Energy harvesting from the nonlinear oscillations of magnetic levitation. "
        "Journal of Sound and Vibration 319(1-2), 515-530. doi:10.1016/j.jsv.2008.06.011",
    ),
    mechanism="spring",
    variant_of=("cubic_stiffness", "quintic_stiffness"),
    signature=Signature(
        frequency="Rises with the square of the amplitude at first, then ever faster; falls where magnets attract.",
        damping="Falls where the frequency rises: the viscous damper has less time in a shorter cycle.",
        offset="Zero.",
        found_in="magnetic suspensions and energy harvesters, electrostatic actuators",
        typical=lambda mass, amplitude, angular_frequency: (
            0.02 * mass * angular_frequency**2 * amplitude,
            2.0 * amplitude,
            4.0,
        ),
        resembles=("cubic_stiffness", "quintic_stiffness", "freeplay"),
    ),
)
