"""Stribeck friction: dry friction that is larger at low speed than at high speed.

Coulomb friction is its limit without an excess, and with one that ends at a speed far from the motion's own.
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def _share(v: float, direction: float, p: FloatArray) -> float:
    """Return exp(-|v| / v_s), continued smoothly beyond a turning point; held there where a step goes far too far."""
    if p[2] <= 0.0:
        return 0.0
    return math.exp(min(-direction * v / p[2], 1.0))


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * direction * (1.0 + p[1] * _share(v, direction, p))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    share = _share(v, direction, p)
    out[0] = 0.0
    out[1] = 0.0
    out[2] = direction * (1.0 + p[1] * share)
    out[3] = p[0] * direction * share
    out[4] = 0.0
    if p[2] > 0.0:
        fall = p[0] * p[1] * share / p[2]
        out[1] = -fall
        out[4] = fall * v / p[2]


EFFECT = Effect(
    name="stribeck_friction",
    summary="Dry friction that falls with speed: damping grows faster than one over the amplitude as a decay ends.",
    text="kinetic_friction (1 + stribeck_excess exp(-|x'|/stribeck_speed)) sign(x')",
    latex=r"F_k \left(1 + e_s \exp(-\left|\dot{x}\right| / v_s)\right) \operatorname{sign}(\dot{x})",
    parameters=(
        Parameter(
            name="kinetic_friction",
            unit="N",
            latex="F_k",
            summary="magnitude of the friction force at high speed",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.05 * mass * angular_frequency**2 * amplitude),
        ),
        Parameter(
            name="stribeck_excess",
            unit="-",
            latex="e_s",
            summary="friction at no speed over that at high speed, less one",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 2.0),
        ),
        Parameter(
            name="stribeck_speed",
            unit="m/s",
            latex="v_s",
            summary="speed at which the excess has fallen to 1/e",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (
                0.02 * amplitude * angular_frequency,
                amplitude * angular_frequency,
            ),
        ),
    ),
    force=force,
    gradient=gradient,
    references=(
        "Armstrong-Helouvry B., Dupont P., Canudas de Wit C. (1994) A survey of models, analysis tools and "
        "compensation methods for the control of machines with friction. Automatica 30(7), 1083-1138. "
        "doi:10.1016/0005-1098(94)90209-7",
    ),
    mechanism="hysteresis",
    variant_of=("coulomb_friction",),
    signature=Signature(
        frequency="Constant.",
        damping="Falls faster than one over the amplitude where the motion is slow enough for the excess, and as one "
        "over the amplitude above.",
        offset="Zero.",
        found_in="lubricated guides and bearings, rubber seals, stick-slip of slides",
        typical=lambda mass, amplitude, angular_frequency: (
            0.0015 * mass * angular_frequency**2 * amplitude,
            1.0,
            0.2 * amplitude * angular_frequency,
        ),
        resembles=("coulomb_friction", "dahl_friction"),
    ),
)
