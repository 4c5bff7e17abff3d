"""Elastic slider (Jenkins element): a spring in series with a dry slider.

The force starts from its value at the last turning point, follows the spring, and stops at the slip force:
``direction * min(direction * (f_r + k (x - x_r)), F_j)``. Only the bound ahead of the motion is applied: the other
one cannot be reached inside a half cycle, and without it the force is smooth across the turning point.
One turning point is all the memory there is, whatever the history.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 0 while sticking and the direction of motion while slipping."""
    slips = p[1] <= 0.0 or direction * (z[1] + p[0] * (x - z[0])) >= p[1]
    return int(direction) if slips else 0


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    if regime(x, v, direction, z, p) != 0:
        return direction * p[1]
    return z[1] + p[0] * (x - z[0])


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v, the parameters and the memory."""
    out[:] = 0.0
    if regime(x, v, direction, z, p) != 0:
        out[3] = direction
    else:
        out[0] = p[0]
        out[2] = x - z[0]
        out[4] = -p[0]
        out[5] = 1.0


EFFECT = Effect(
    name="jenkins",
    summary="Elastic slider: no damping until it slips, then damping rises, peaks and falls while frequency drops.",
    text="f_j; f_j = clip(f_r + slider_stiffness (x - x_r), -slip_force, slip_force) "
    "from the last turning point (x_r, f_r)",
    latex=r"f_j; f_j = \operatorname{clip}\left(f_r + k_j (x - x_r), -F_j, F_j\right)",
    parameters=(
        Parameter(
            name="slider_stiffness",
            unit="N/m",
            latex="k_j",
            summary="stiffness of the spring in series with the slider",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2),
        ),
        Parameter(
            name="slip_force",
            unit="N",
            latex="F_j",
            summary="force at which the slider slips",
            role="slip_force",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, mass * angular_frequency**2 * amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    has_memory=True,
    n_states=3,
    references=(
        "Jenkin C. F. (1922) A mechanical model illustrating the behaviour of metals under static and alternating "
        "loads. Engineering 114, 603",
        "Iwan W. D. (1966) A distributed-element model for hysteresis and its steady-state dynamic response. "
        "Journal of Applied Mechanics 33(4), 893-900. doi:10.1115/1.3625199",
    ),
    mechanism="hysteresis",
    signature=Signature(
        frequency="Falls once the slider slips; constant below.",
        damping="Rises, then falls: nothing below slip, a peak, then less, because a friction of fixed size "
        "counts less in a larger cycle.",
        offset="Zero.",
        found_in="a bolted or riveted contact that slips as a whole, under-platform dampers of blades",
        typical=lambda mass, amplitude, angular_frequency: (
            0.15 * mass * angular_frequency**2,
            0.03 * mass * angular_frequency**2 * amplitude,
        ),
        resembles=("coulomb_friction", "iwan", "bouc_wen"),
    ),
)
