"""Damper with a dead band: viscous beyond a displacement on either side, without force in between.

The coefficient rises smoothly over the fiftieth part of the band on either side of its edge, so that the force is
continuous; by symmetry the loss of a cycle is that of a sharp edge, but for motions that end there.
"""

from __future__ import annotations

import numba

from .._common.checks import FloatArray
from ._base import Effect, Parameter, Signature

_EDGE = 0.02  # half the width of the edge over the dead band


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 0 inside the band, 1 or -1 on its edge and 2 or -2 beyond; on a kink, the branch being entered."""
    low, high = (1.0 - _EDGE) * p[1], (1.0 + _EDGE) * p[1]
    if x >= 0.0:
        outward = direction > 0.0
        if x > high or (x == high and outward):
            return 2
        return 1 if x > low or (x == low and outward) else 0
    outward = direction < 0.0
    if x < -high or (x == -high and outward):
        return -2
    return -1 if x < -low or (x == -low and outward) else 0


@numba.njit
def _acting(x: float, gap: float) -> tuple[float, float]:
    """Return the share of the damper that acts at a displacement, and the derivative to the place over the edge."""
    width = 2.0 * _EDGE * gap
    beyond = abs(x) - (1.0 - _EDGE) * gap
    if beyond <= 0.0 and gap > 0.0:
        return 0.0, 0.0
    if beyond >= width:
        return 1.0, 0.0
    s = beyond / width
    return s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s)


@numba.njit
def force(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> float:
    """Return the force [N]."""
    return p[0] * _acting(x, p[1])[0] * v


@numba.njit
def gradient(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """Write the derivatives of the force to x, v and the parameters."""
    share, slope = _acting(x, p[1])
    out[0] = out[3] = 0.0
    if slope > 0.0:
        side = 1.0 if x > 0.0 else -1.0
        width = 2.0 * _EDGE * p[1]
        out[0] = p[0] * v * slope * side / width
        out[3] = -p[0] * v * slope * abs(x) / (width * p[1])
    out[1] = p[0] * share
    out[2] = share * v


EFFECT = Effect(
    name="dead_band_damping",
    summary="Damper with a dead band: damping constant up to the band, then rising ever more slowly, no offset.",
    text="dead_band_damping x' where |x| > dead_band, else 0",
    latex=r"c_e \dot{x} \left[\,|x| > x_e\,\right]",
    parameters=(
        Parameter(
            name="dead_band_damping",
            unit="N s/m",
            latex="c_e",
            summary="coefficient of the damper beyond its dead band",
            role="strength",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, 0.5 * mass * angular_frequency),
        ),
        Parameter(
            name="dead_band",
            unit="m",
            latex="x_e",
            summary="displacement beyond which the damper acts, on either side",
            role="gap",
            bounds=lambda mass, amplitude, angular_frequency: (0.0, amplitude),
        ),
    ),
    force=force,
    gradient=gradient,
    regime=regime,
    references=("Dixon J. C. (2007) The Shock Absorber Handbook, 2nd ed. Wiley. doi:10.1002/9780470516430",),
    mechanism="displacement_damping",
    variant_of=("displacement_dependent_damping", "jenkins"),
    signature=Signature(
        frequency="Constant.",
        damping="Rises once the amplitude is beyond the dead band, steeply at first; constant below.",
        offset="Zero.",
        found_in="dampers whose bypass is open in mid-stroke, damping layers and bearings that are touched beyond a "
        "clearance",
        typical=lambda mass, amplitude, angular_frequency: (0.04 * mass * angular_frequency, 0.4 * amplitude),
        resembles=("displacement_dependent_damping", "power_displacement_damping", "jenkins"),
    ),
)
