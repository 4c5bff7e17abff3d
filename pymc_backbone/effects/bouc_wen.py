"""Bouc-Wen hysteresis: a restoring force with an internal displacement that lags behind the motion.

The parameters are redundant: the data see ``(1 - alpha) k`` as one stiffness, and scaling ``z`` trades it against the
amplitude, beta and gamma. Fix those that are known. The unit of beta and gamma depends on the exponent; their default
bounds are scaled for an exponent of 1, so give bounds of your own with any other.

Between two turning points ``z`` is a function of the displacement alone (`_hysteresis`), so nothing has to be
integrated beside the motion: what is remembered of a turning point is its place and ``z`` there.
"""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._hysteresis import N_ROOM, lagging, lagging_slopes, place


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return the sign of z; at zero, the sign it is about to have."""
    return int(direction) if place(x, direction, z, p) >= 0.0 else -int(direction)


@numba.njit
def remembered(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the hysteretic displacement [m]."""
    return lagging(x, direction, z, p)


@numba.njit
def remembered_gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the hysteretic displacement to x, v, the parameters and the memory."""
    lagging_slopes(x, direction, z, p, out)


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return (1.0 - p[2]) * p[0] * lagging(x, direction, z, p)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v, the parameters and the memory."""
    lag = lagging_slopes(x, direction, z, p, out)
    stiffness = (1.0 - p[2]) * p[0]
    for j in range(out.size):
        out[j] *= stiffness
    out[2] = (1.0 - p[2]) * lag
    out[4] = -p[0] * lag


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
    has_memory=True,
    n_states=3,
    remembered=remembered,
    remembered_gradient=remembered_gradient,
    n_room=N_ROOM,
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
