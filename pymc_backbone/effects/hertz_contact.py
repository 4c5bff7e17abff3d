"""Hertzian contact of round bodies on one side, after a gap or, preloaded, already at rest.

The force goes with the approach to the power 3/2. The displacement counts from where the specimen rests, so the static
force of a preloaded contact is left out.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._contact import regime


@numba.njit
def _approach(x: float, p: FloatArray) -> float:
    """Return how far the bodies have approached [m], and 0 where they do not touch."""
    return max((-x if p[0] < 0.0 else x) - p[1], 0.0)


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]; zero at rest."""
    return p[0] * (_approach(x, p) ** 1.5 - max(-p[1], 0.0) ** 1.5)


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    approach, preload = _approach(x, p), max(-p[1], 0.0)
    slope = 1.5 * p[0] * math.sqrt(approach)
    out[0] = -slope if p[0] < 0.0 else slope
    out[1] = 0.0
    out[2] = approach**1.5 - preload**1.5
    out[3] = 1.5 * p[0] * math.sqrt(preload) - slope


EFFECT = Effect(
    name="hertz_contact",
    summary="Hertzian contact on one side: frequency and offset change with the root of how far the contact is closed.",
    text="hertz_stiffness (max(s x - hertz_gap, 0)^1.5 - max(-hertz_gap, 0)^1.5); s = sign(hertz_stiffness)",
    latex=r"k_H \left[\max(s x - g_H, 0)^{3/2} - \max(-g_H, 0)^{3/2}\right]; s = \operatorname{sign}(k_H)",
    parameters=(
        Parameter(
            name="hertz_stiffness",
            unit="N/m^1.5",
            latex="k_H",
            summary="coefficient of the contact; negative: on the negative side",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -3.0 * mass * angular_frequency**2 / amplitude**0.5,
                3.0 * mass * angular_frequency**2 / amplitude**0.5,
            ),
            minimum=-np.inf,
        ),
        Parameter(
            name="hertz_gap",
            unit="m",
            latex="g_H",
            summary="displacement to that side at which contact begins; negative: approach at rest, by a preload",
            role="gap",
            bounds=lambda mass, amplitude, angular_frequency: (-amplitude, amplitude),
            minimum=-np.inf,
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Johnson K. L. (1985) Contact Mechanics. Cambridge University Press. doi:10.1017/CBO9781139171731",
        "Rigaud E., Perret-Liaudet J. (2003) Experiments and numerical results on non-linear vibrations of an "
        "impacting Hertzian contact. Part 1: harmonic excitation. Journal of Sound and Vibration 265(2), 289-307",
    ),
    mechanism="clearance",
    mechanism_below=("hertz_gap", -0.5, "asymmetry"),  # closed over most of the motion: a spring that softens one way
    variant_of=("bilinear_stiffness", "freeplay"),
    signature=Signature(
        frequency="Rises once the amplitude has closed the gap; constant below. Where a preload closes it, falls with "
        "the amplitude.",
        damping="Falls a little where the frequency rises.",
        offset="Falls from zero once the gap is closed: the mid-line moves away from the contact.",
        found_in="balls and rollers of bearings, gear teeth, a rounded stop",
        typical=lambda mass, amplitude, angular_frequency: (
            0.5 * mass * angular_frequency**2 / amplitude**0.5,
            0.3 * amplitude,
        ),
        resembles=("one_sided_stiffness", "bilinear_stiffness", "quadratic_stiffness"),
    ),
)
