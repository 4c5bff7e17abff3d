r"""Dahl friction: dry friction that builds up over a short way, without a sudden slip.

It is the Bouc-Wen law with gamma of zero and an exponent of one, in two parameters that have a meaning of their own:
the search looks for that law, and for this one only when it is named. From a turning point ``(x_r, f_r)`` on the force
approaches :math:`\pm F_D` as :math:`e^{-\sigma_0 |x - x_r| / F_D}`.
"""

from __future__ import annotations

import math

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]; a contact without friction does not hold."""
    if not p[1] > 0.0:
        return 0.0
    left = math.exp(-p[0] * direction * (x - z[0]) / p[1])
    return direction * p[1] * (1.0 - left) + z[1] * left


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v, the parameters and the memory."""
    out[:] = 0.0
    if not p[1] > 0.0:
        out[3] = direction
        return
    way = direction * (x - z[0])
    left = math.exp(-p[0] * way / p[1])
    lacking = (z[1] - direction * p[1]) * left
    out[0] = -lacking * p[0] * direction / p[1]
    out[2] = -lacking * way / p[1]
    out[3] = direction * (1.0 - left) + lacking * p[0] * way / (p[1] * p[1])
    out[4] = -out[0]
    out[5] = left


EFFECT = Effect(
    name="dahl_friction",
    summary="Friction that builds up over a short way: damping rises to a peak, then falls, frequency falls.",
    text="dahl_stiffness z; z' = x' - dahl_stiffness |x'| z / dahl_force",
    latex=r"\sigma_0 z; \dot{z} = \dot{x} - \sigma_0 |\dot{x}| z / F_D",
    parameters=(
        Parameter(
            name="dahl_stiffness",
            unit="N/m",
            latex=r"\sigma_0",
            summary="stiffness of the contact after each turning point",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2),
        ),
        Parameter(
            name="dahl_force",
            unit="N",
            latex="F_D",
            summary="friction force towards which it builds up",
            role="slip_force",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    has_memory=True,
    n_states=3,
    references=(
        "Dahl P. R. (1976) Solid friction damping of mechanical vibrations. AIAA Journal 14(12), 1675-1682. "
        "doi:10.2514/3.61511",
    ),
    mechanism="hysteresis",
    only_if_named=True,
    signature=Signature(
        frequency="Falls as friction is built up earlier in a cycle, and levels off.",
        damping="Rises, then falls: a peak where the amplitude is about the way over which friction builds up.",
        offset="Zero.",
        found_in="ball bearings and guides in presliding, cables, seals",
        typical=lambda mass, amplitude, angular_frequency: (
            0.2 * mass * angular_frequency**2,
            0.03 * mass * angular_frequency**2 * amplitude,
        ),
        resembles=("jenkins", "bouc_wen", "coulomb_friction"),
    ),
)
