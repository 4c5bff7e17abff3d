"""Damper whose force is largest at a speed and falls beyond it, as that of eddy currents does.

With a negative coefficient it takes from the viscous damper at small speed: self-excitation that is limited.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if p[1] <= 0.0:
        return 0.0
    u = v / p[1]
    return p[0] * v / (1.0 + u * u)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    out[:] = 0.0
    if p[1] <= 0.0:
        return
    u = v / p[1]
    share = 1.0 / (1.0 + u * u)
    out[1] = p[0] * (1.0 - u * u) * share * share
    out[2] = v * share
    out[3] = 2.0 * p[0] * u * u * u * share * share


EFFECT = Effect(
    name="speed_limited_damping",
    summary="Damper whose force is largest at a speed and falls beyond: damping falls as the amplitude rises.",
    text="speed_limited_damping x' / (1 + (x'/critical_speed)^2)",
    latex=r"\frac{c_v \dot{x}}{1 + (\dot{x} / v_c)^2}",
    parameters=(
        Parameter(
            name="speed_limited_damping",
            unit="N s/m",
            latex="c_v",
            summary="coefficient at small speed; negative: self-excitation that is limited",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -0.2 * mass * angular_frequency,
                0.5 * mass * angular_frequency,
            ),
            minimum=-float("inf"),
        ),
        Parameter(
            name="critical_speed",
            unit="m/s",
            latex="v_c",
            summary="speed at which the force is largest",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (
                0.05 * amplitude * angular_frequency,
                2.0 * amplitude * angular_frequency,
            ),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Wouterse J. H. (1991) Critical torque and speed of eddy current brake with widely separated soft iron poles. "
        "IEE Proceedings B 138(4), 153-158. doi:10.1049/ip-b.1991.0019",
    ),
    mechanism="falling_damping",
    mechanism_below=("speed_limited_damping", 0.0, "drag"),  # what is taken away at small speed is there at high speed
    variant_of=("coulomb_friction", "quadratic_damping", "cubic_damping"),
    signature=Signature(
        frequency="Constant.",
        damping="Falls once the speed is near the critical one, and ever more slowly beyond; constant below.",
        offset="Zero.",
        found_in="eddy-current brakes and dampers, electromagnetic harvesters; negative: wind-excited cables and "
        "towers",
        typical=lambda mass, amplitude, angular_frequency: (
            0.04 * mass * angular_frequency,
            0.4 * amplitude * angular_frequency,
        ),
        resembles=("mid_stroke_damping", "coulomb_friction", "power_damping"),
    ),
)
