"""Contact on one side: a spring that acts beyond one displacement only, after a gap or, preloaded, already at rest.

The displacement counts from where the specimen rests, so the static force of a preloaded contact is left out. Contact
on the negative side is a negative stiffness with a negative gap beside a linear spring that is stiffer by as much.
"""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 1 in contact and 0 apart, 2 more where a preload closes the contact at rest; on a kink, what comes."""
    touches = x > p[1] or (x == p[1] and direction > 0.0)
    return (1 if touches else 0) + (2 if p[1] < 0.0 else 0)


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]; zero at rest."""
    return p[0] * (max(x - p[1], 0.0) - max(-p[1], 0.0))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    label = regime(x, v, direction, z, p)
    touching = 1.0 if label == 1 or label == 3 else 0.0
    preloaded = 1.0 if label >= 2 else 0.0
    out[0] = p[0] * touching
    out[1] = 0.0
    out[2] = (x - p[1]) * touching + p[1] * preloaded
    out[3] = p[0] * (preloaded - touching)


EFFECT = Effect(
    name="one_sided_stiffness",
    summary="One-sided contact: frequency and offset constant up to the gap, then both change; no damping.",
    text="stop_stiffness (max(x - stop_gap, 0) - max(-stop_gap, 0))",
    latex=r"k_s \left[\max(x - g_s, 0) - \max(-g_s, 0)\right]",
    parameters=(
        Parameter(
            name="stop_stiffness",
            unit="N/m",
            latex="k_s",
            summary="stiffness in contact; negative takes away",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -1.5 * mass * angular_frequency**2,
                4.0 * mass * angular_frequency**2,
            ),
            minimum=-np.inf,
        ),
        Parameter(
            name="stop_gap",
            unit="m",
            latex="g_s",
            summary="displacement at which contact begins; negative: preloaded, contact is lost below",
            role="gap",
            bounds=lambda mass, amplitude, angular_frequency: (-amplitude, amplitude),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Shaw S. W., Holmes P. J. (1983) A periodically forced piecewise linear oscillator. "
        "Journal of Sound and Vibration 90(1), 129-155",
    ),
    mechanism="clearance",
    variant_of=("bilinear_stiffness", "freeplay"),
    signature=Signature(
        frequency="Rises once the amplitude has closed the gap; constant below. Falls with the amplitude where a "
        "preloaded contact opens.",
        damping="Falls a little where the frequency rises.",
        offset="Falls from zero once the gap is closed: the mid-line moves away from the stop.",
        found_in="bump stops, a plate that touches its support, bolted flanges that open",
        typical=lambda mass, amplitude, angular_frequency: (0.5 * mass * angular_frequency**2, 0.25 * amplitude),
        resembles=("bilinear_stiffness", "hertz_contact", "quadratic_stiffness"),
    ),
)
