"""Damper that acts in mid-stroke and fades away from there, as a magnet that leaves its coil or its plate does.

With a negative coefficient it takes from the viscous damper in mid-stroke, as a bypass does.
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[1] <= 0.0:
        return 0.0
    u = x / p[1]
    return p[0] * math.exp(-u * u) * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    if p[1] <= 0.0:
        return
    u = x / p[1]
    share = math.exp(-u * u)
    out[0] = -2.0 * p[0] * v * share * u / p[1]
    out[1] = p[0] * share
    out[2] = share * v
    out[3] = -out[0] * u


EFFECT = Effect(
    name="mid_stroke_damping",
    summary="Damper that acts in mid-stroke: damping falls once the amplitude is beyond that, no offset.",
    text="mid_stroke_damping exp(-(x/mid_stroke)^2) x'",
    latex=r"c_m \exp\left(-(x / x_m)^2\right) \dot{x}",
    parameters=(
        Parameter(
            name="mid_stroke_damping",
            unit="N s/m",
            latex="c_m",
            summary="coefficient in the middle; negative: what a bypass takes from the viscous damper there",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -0.2 * mass * angular_frequency,
                0.5 * mass * angular_frequency,
            ),
            minimum=-math.inf,
        ),
        Parameter(
            name="mid_stroke",
            unit="m",
            latex="x_m",
            summary="displacement at which the coefficient has fallen to 1/e",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.05 * amplitude, 2.0 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Mann B. P., Sims N. D. (2009) Energy harvesting from the nonlinear oscillations of magnetic levitation. "
        "Journal of Sound and Vibration 319(1-2), 515-530. doi:10.1016/j.jsv.2008.06.011",
    ),
    mechanism="falling_damping",
    mechanism_below=("mid_stroke_damping", 0.0, "displacement_damping"),
    variant_of=("coulomb_friction", "displacement_dependent_damping"),
    signature=Signature(
        frequency="Constant.",
        damping="Falls once the amplitude is beyond the middle of the stroke, and ever more slowly; constant below.",
        offset="Zero.",
        found_in="magnets that leave their coil or plate, electromagnetic harvesters; negative: dampers with a bypass",
        typical=lambda mass, amplitude, angular_frequency: (0.04 * mass * angular_frequency, 0.3 * amplitude),
        resembles=("speed_limited_damping", "coulomb_friction", "dead_band_damping"),
    ),
)
