"""Stop on one side with loss: a spring that acts beyond one displacement only, and pushes back with less than it took.

The force of Hunt and Crossley, without a jump where the stop is met. The displacement counts from where the specimen
rests, so the static force of a preloaded contact is left out.
"""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature
from ._contact import regime


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]; zero at rest."""
    side = -1.0 if p[0] < 0.0 else 1.0
    return p[0] * (max(side * x - p[1], 0.0) * (1.0 + p[2] * side * v) - max(-p[1], 0.0))


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    label = regime(x, v, direction, z, p)
    side = -1.0 if label >= 4 else 1.0
    touching = 1.0 if label % 2 == 1 else 0.0
    preloaded = 1.0 if label % 4 >= 2 else 0.0
    approach, share = touching * (side * x - p[1]), touching * (1.0 + p[2] * side * v)
    out[0] = p[0] * side * share
    out[1] = p[0] * approach * p[2] * side
    out[2] = approach * (1.0 + p[2] * side * v) + p[1] * preloaded
    out[3] = p[0] * (preloaded - share)
    out[4] = p[0] * approach * side * v


EFFECT = Effect(
    name="damped_stop",
    summary="Stop on one side with loss: constant up to the gap, then frequency, damping and offset change together.",
    text="damped_stop_stiffness (max(s x - damped_stop_gap, 0) (1 + stop_loss s x') - max(-damped_stop_gap, 0)); "
    "s = sign(damped_stop_stiffness)",
    latex=r"k_q \left[\max(s x - g_q, 0) (1 + \lambda_q s \dot{x}) - \max(-g_q, 0)\right]; "
    r"s = \operatorname{sign}(k_q)",
    parameters=(
        Parameter(
            name="damped_stop_stiffness",
            unit="N/m",
            latex="k_q",
            summary="stiffness in contact; negative: on the negative side",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (
                -4.0 * mass * angular_frequency**2,
                4.0 * mass * angular_frequency**2,
            ),
            minimum=-np.inf,
        ),
        Parameter(
            name="damped_stop_gap",
            unit="m",
            latex="g_q",
            summary="displacement to that side at which contact begins; negative: preloaded",
            role="gap",
            bounds=lambda mass, amplitude, angular_frequency: (-amplitude, amplitude),
            minimum=-np.inf,
        ),
        Parameter(
            name="stop_loss",
            unit="s/m",
            latex=r"\lambda_q",
            summary="how much more the stop pushes per speed of approach",
            role="shape",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.9 / (amplitude * angular_frequency)),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=(
        "Hunt K. H., Crossley F. R. E. (1975) Coefficient of restitution interpreted as damping in vibroimpact. "
        "Journal of Applied Mechanics 42(2), 440-445. doi:10.1115/1.3423596",
    ),
    mechanism="clearance",
    variant_of=("bilinear_stiffness", "freeplay"),
    reduces_to=("one_sided_stiffness",),
    signature=Signature(
        frequency="Rises once the amplitude has closed the gap; constant below. Falls with the amplitude where a "
        "preloaded contact opens.",
        damping="Rises with the amplitude once that has closed the gap, by which it falls a little at first.",
        offset="Falls from zero once the gap is closed: the mid-line moves away from the stop.",
        found_in="rubber buffers and bump stops, a plate that rattles against its support",
        typical=lambda mass, amplitude, angular_frequency: (
            0.5 * mass * angular_frequency**2,
            0.02 * amplitude,
            0.3 / (amplitude * angular_frequency),
        ),
        resembles=("one_sided_stiffness", "hertz_contact", "dead_band_damping"),
    ),
)
