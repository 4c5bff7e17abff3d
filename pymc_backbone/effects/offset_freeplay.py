"""Contact after a gap that is not the same on both sides: the specimen does not rest in the middle of its play.

A joint that rests against one of its stops is a `one_sided_stiffness` that loses contact.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 1 or -1 in contact on that side and 0 inside the gap; on a kink, the branch being entered."""
    above, below = p[1] * (1.0 + p[2]), -p[1] * (1.0 - p[2])
    if x > above or (x == above and direction > 0.0):
        return 1
    if x < below or (x == below and direction < 0.0):
        return -1
    return 0


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * (max(x - p[1] * (1.0 + p[2]), 0.0) - max(-x - p[1] * (1.0 - p[2]), 0.0))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    side = regime(x, v, direction, z, p)
    touching = abs(side)
    out[0] = p[0] * touching
    out[1] = 0.0
    out[2] = (x - p[1] * (side + p[2])) * touching
    out[3] = -p[0] * (side + p[2]) * touching
    out[4] = -p[0] * p[1] * touching


EFFECT = Effect(
    name="offset_freeplay",
    summary="Gap contact off the middle: frequency rises in two steps, the mid-line moves to the wider side between.",
    text="play_stiffness (max(x - play (1 + play_asymmetry), 0) - max(-x - play (1 - play_asymmetry), 0))",
    latex=r"k_o \left[\max(x - g_o (1 + r_o), 0) - \max(-x - g_o (1 - r_o), 0)\right]",
    parameters=(
        Parameter(
            name="play_stiffness",
            unit="N/m",
            latex="k_o",
            summary="stiffness of the stops",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 4.0 * mass * angular_frequency**2),
        ),
        Parameter(
            name="play",
            unit="m",
            latex="g_o",
            summary="half the way between the stops",
            role="gap",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, amplitude),
        ),
        Parameter(
            name="play_asymmetry",
            unit="-",
            latex="r_o",
            summary="middle of the play over half its width: 0 as far to either stop, 1 or -1 resting at a stop",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (-1.0, 1.0),
            minimum=-1.0,
            maximum=1.0,
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
    variant_of=("freeplay",),
    reduces_to=("one_sided_stiffness",),
    signature=Signature(
        frequency="Rises once the amplitude has reached the nearer stop, and again at the farther one.",
        damping="Falls where the frequency rises; constant below the gap.",
        offset="Falls from zero once the nearer stop is touched, if that is on the positive side: the mid-line moves "
        "to the wider side; back again beyond the farther one.",
        found_in="loose joints and worn bearings under a static load, stops that were not adjusted",
        typical=lambda mass, amplitude, angular_frequency: (
            0.2 * mass * angular_frequency**2,
            0.6 * amplitude,
            -0.6,
        ),
        resembles=("freeplay", "one_sided_stiffness", "bilinear_stiffness"),
    ),
)
