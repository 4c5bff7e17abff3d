"""Contact after a gap: a stop on either side that acts only once the displacement has closed the gap.

A loose joint (no stiffness inside the gap) is this contact with a small linear stiffness.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 1 or -1 in contact on that side and 0 inside the gap; on a kink, the branch being entered."""
    gap = p[1]
    if x > gap or (x == gap and direction > 0.0):
        return 1
    if x < -gap or (x == -gap and direction < 0.0):
        return -1
    return 0


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * (x - regime(x, v, direction, z, p) * p[1]) if abs(x) > p[1] else 0.0


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    side = regime(x, v, direction, z, p)
    touching = abs(side)
    out[0] = p[0] * touching
    out[1] = 0.0
    out[2] = (x - side * p[1]) * touching
    out[3] = -p[0] * side


EFFECT = Effect(
    name="freeplay",
    summary="Gap contact: frequency constant up to the gap, then rising ever more slowly, no damping, no offset.",
    text="contact_stiffness sign(x) max(|x| - gap, 0)",
    latex=r"k_c \operatorname{sign}(x) \max(|x| - g, 0)",
    parameters=(
        Parameter(
            name="contact_stiffness",
            unit="N/m",
            latex="k_c",
            summary="stiffness of the stops",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 4.0 * mass * angular_frequency**2),
        ),
        Parameter(
            name="gap",
            unit="m",
            latex="g",
            summary="displacement at which a stop is touched, on either side",
            role="gap",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Kerschen G., Worden K., Vakakis A. F., Golinval J.-C. (2006) Past, present and future of nonlinear system "
        "identification in structural dynamics. Mechanical Systems and Signal Processing 20(3), 505-592",
    ),
    mechanism="clearance",
    signature=Signature(
        frequency="Rises once the amplitude has closed the gap, steeply at first; constant below.",
        damping="Falls where the frequency rises; constant below the gap.",
        offset="Zero.",
        found_in="loose joints, worn bearings, stops on both sides",
        typical=lambda mass, amplitude, angular_frequency: (0.5 * mass * angular_frequency**2, 0.3 * amplitude),
        resembles=("cubic_stiffness", "quintic_stiffness"),
    ),
)
