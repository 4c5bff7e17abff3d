"""Bouc-Wen hysteresis: a restoring force with an internal displacement that lags behind the motion.

The parameters are redundant: the data see ``(1 - alpha) k`` as one stiffness, and scaling ``z`` trades it against the
amplitude, beta and gamma. Fix those that are known. The unit of beta and gamma depends on the exponent; their default
bounds are scaled for an exponent of 1, so give bounds of your own with any other.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return the sign of z; at zero, the sign it is about to have."""
    if z[0] == 0.0:
        return 1 if direction > 0.0 else -1
    return 1 if z[0] > 0.0 else -1


@numba.njit
def _power(size: float, exponent: float) -> float:
    """Return the power of a size: most exponents are 1, and a logarithm is cheaper than a power of any kind."""
    if exponent == 1.0:
        return size
    return math.exp(exponent * math.log(size)) if size > 0.0 else 0.0


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return (1.0 - p[2]) * p[0] * z[0]


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v, the parameters and z."""
    out[:] = 0.0
    out[2] = (1.0 - p[2]) * z[0]
    out[4] = -p[0] * z[0]
    out[8] = (1.0 - p[2]) * p[0]


@numba.njit
def state_rate(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write dz/dt [m/s]."""
    pull = p[3] * direction * v * regime(x, v, direction, z, p) + p[4] * v
    out[0] = p[1] * v - _power(abs(z[0]), p[5]) * pull


@numba.njit
def state_rate_gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of dz/dt to x, v, the parameters and z; finite at z = 0 for exponents from 1."""
    sign = regime(x, v, direction, z, p)
    size = abs(z[0])
    power = _power(size, p[5])
    speed = direction * v
    pull = p[3] * speed * sign + p[4] * v
    out[0, 0] = 0.0
    out[0, 1] = p[1] - power * (p[3] * direction * sign + p[4])
    out[0, 2] = 0.0
    out[0, 3] = v
    out[0, 4] = 0.0
    out[0, 5] = -power * speed * sign
    out[0, 6] = -power * v
    if size > 0.0:
        out[0, 7] = -power * math.log(size) * pull
        out[0, 8] = -p[5] * power / size * sign * pull
    else:
        out[0, 7] = 0.0
        out[0, 8] = -sign * pull if p[5] == 1.0 else 0.0


EFFECT = Effect(
    name="bouc_wen",
    summary="Bouc-Wen hysteresis: frequency falls and damping rises with amplitude, both levelling off.",
    text="(1 - bouc_wen_alpha) bouc_wen_stiffness z; z' = bouc_wen_amplitude x' "
    "- bouc_wen_beta |x'| |z|^(bouc_wen_exponent - 1) z - bouc_wen_gamma x' |z|^bouc_wen_exponent",
    latex=r"(1 - \alpha) k_z z; \dot{z} = \bar A \dot{x} - \beta |\dot{x}| |z|^{n - 1} z - \gamma \dot{x} |z|^n",
    parameters=(
        Parameter(
            name="bouc_wen_stiffness",
            unit="N/m",
            latex="k_z",
            summary="stiffness k of the hysteretic spring",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 2.0 * mass * angular_frequency**2),
        ),
        Parameter(
            name="bouc_wen_amplitude",
            unit="-",
            latex=r"\bar A",
            summary="A: rate of z to x where the hysteresis starts",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.1, 4.0),
        ),
        Parameter(
            name="bouc_wen_alpha",
            unit="-",
            latex=r"\alpha",
            summary="share of the hysteretic spring that is taken away; at 1 nothing of it is left",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 1.0),
            maximum=1.0,
        ),
        Parameter(
            name="bouc_wen_beta",
            unit="1/m^n",
            latex=r"\beta",
            summary="beta: how fast z saturates, dissipating",
            role="power_coefficient",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 4.0 / amplitude),
        ),
        Parameter(
            name="bouc_wen_gamma",
            unit="1/m^n",
            latex=r"\gamma",
            summary="gamma: shape of the loop; softening when beta + gamma is positive, hardening when negative",
            role="power_coefficient",
            bounds=lambda mass, amplitude, angular_frequency: (-2.0 / amplitude, 4.0 / amplitude),
            minimum=-np.inf,
        ),
        Parameter(
            name="bouc_wen_exponent",
            unit="-",
            latex="n",
            summary="n: sharpness of the transition; mostly 1 to 3",
            role="exponent",
            bounds=lambda mass, amplitude, angular_frequency: (1.0, 3.0),
            minimum=1.0,
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    n_states=1,
    state_rate=state_rate,
    state_rate_gradient=state_rate_gradient,
    redundant=(("bouc_wen_amplitude", 1.0), ("bouc_wen_alpha", 0.0)),
    opposed=(("bouc_wen_gamma", "bouc_wen_beta"),),
    references=(
        "Wen Y. K. (1976) Method for random vibration of hysteretic systems. Journal of the Engineering Mechanics "
        "Division 102(2), 249-263. doi:10.1061/JMCEA3.0002106",
        "Ismail M., Ikhouane F., Rodellar J. (2009) The hysteresis Bouc-Wen model, a survey. "
        "Archives of Computational Methods in Engineering 16, 161-188. doi:10.1007/s11831-009-9031-8",
    ),
    mechanism="hysteresis",
    signature=Signature(
        frequency="Falls with the amplitude, and levels off where the hysteretic spring has given all it can.",
        damping="Rises with the amplitude, levels off, and falls again at far larger ones.",
        offset="Zero.",
        found_in="wire-rope isolators, base isolation, joints and soils under large cycles",
        typical=lambda mass, amplitude, angular_frequency: (
            0.3 * mass * angular_frequency**2,
            1.0,
            0.0,
            1.0 / amplitude,
            0.5 / amplitude,
            1.0,
        ),
        resembles=("iwan", "jenkins"),
    ),
)
