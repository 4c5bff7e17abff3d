"""Structural damping (Reid): a loss in proportion to the displacement, whatever the frequency.

Beside the viscous damper that every oscillator has, the backbones of one mode do not tell it apart: both take the same
share of every cycle. Its force jumps at the turning points, which samples may show: it is looked for in data when it is
named, or where nothing else explains them.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._sides import regime


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * abs(x) * direction


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameter."""
    out[0] = p[0] * regime(x, v, direction, z, p) * direction
    out[1] = 0.0
    out[2] = abs(x) * direction


EFFECT = Effect(
    name="structural_damping",
    summary="Loss in proportion to the displacement: a constant damping at every amplitude and frequency.",
    text="structural_damping |x| sign(x')",
    latex=r"h_s |x| \operatorname{sign}(\dot{x})",
    parameters=(
        Parameter(
            name="structural_damping",
            unit="N/m",
            latex="h_s",
            summary="force over displacement; loss factor times stiffness times pi / 2",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.3 * mass * angular_frequency**2),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Reid T. J. (1956) Free vibration and hysteretic damping. The Journal of the Royal Aeronautical Society "
        "60(544), 283",
        "Muravskii G. B. (2004) On frequency independent damping. Journal of Sound and Vibration 274(3-5), 653-668",
    ),
    mechanism="hysteresis",
    only_if_named=True,
    signature=Signature(
        frequency="Constant.",
        damping="Constant.",
        offset="Zero.",
        found_in="the material's own damping, in any structure",
        typical=lambda mass, amplitude, angular_frequency: (0.02 * mass * angular_frequency**2,),
        resembles=("viscous_damping",),
    ),
)
