"""Force laws of the systems whose decays are generated: the effects of the library written anew, and others.

Nothing here comes from the package under test. A system is a flat vector of parameters in the order of `PARAMETERS`;
a parameter of zero switches its effect off. Within a *segment* of the motion (between two turning points and between
two kinks) the direction of motion and the branch of every force with a kink are constants, so that all forces are
smooth there; `motion.integrate` goes from segment to segment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numba
import numpy as np

LIBRARY: dict[str, tuple[str, ...]] = {
    "bilinear_stiffness": ("bilinear_stiffness",),
    "bouc_wen": (
        "bouc_wen_stiffness",
        "bouc_wen_amplitude",
        "bouc_wen_alpha",
        "bouc_wen_beta",
        "bouc_wen_gamma",
        "bouc_wen_exponent",
    ),
    "coulomb_friction": ("friction_force",),
    "cubic_damping": ("cubic_damping",),
    "cubic_stiffness": ("cubic_stiffness",),
    "displacement_dependent_damping": ("displacement_dependent_damping",),
    "freeplay": ("contact_stiffness", "gap"),
    "iwan": ("joint_stiffness", "joint_slip_force", "joint_exponent"),
    "jenkins": ("slider_stiffness", "slip_force"),
    "pendulum_stiffness": ("pendulum_stiffness",),
    "quadratic_damping": ("quadratic_damping",),
    "quadratic_stiffness": ("quadratic_stiffness",),
    "quintic_stiffness": ("quintic_stiffness",),
}
"""Effects that the package can name, with the package's names of their parameters."""

OUTSIDE: dict[str, tuple[str, ...]] = {
    "magnetic_attraction": ("magnet_strength", "magnet_distance"),
    "root_damping": ("root_damping",),
    "structural_damping": ("structural_damping",),
    "limited_negative_damping": ("negative_damping", "negative_damping_speed"),
    "stribeck_friction": ("stribeck_kinetic", "stribeck_static", "stribeck_speed"),
    "impact_stop": ("stop_stiffness", "stop_gap", "stop_damping"),
    "displacement_dependent_inertia": ("inertia_growth",),
    "deadband_damper": ("deadband_damping", "deadband"),
    "one_way_drag": ("one_way_drag",),
}
"""Effects that no effect of the library describes."""

BASE: tuple[str, ...] = ("linear_stiffness", "linear_stiffness_rate", "viscous_damping", "viscous_damping_rate")

PARAMETERS: tuple[str, ...] = (
    "mass",
    *BASE,
    *(name for effect in (LIBRARY | OUTSIDE).values() for name in effect),
)
"""Names of all parameters, in the order of the vector that the compiled functions take."""

_INDEX = {name: index for index, name in enumerate(PARAMETERS)}

# Positions as module constants, because compiled code cannot look names up.
MASS, K, K_RATE, C, C_RATE = (_INDEX[name] for name in ("mass", *BASE))
BILINEAR, CUBIC, QUINTIC, QUADRATIC, PENDULUM = (
    _INDEX[f"{kind}_stiffness"] for kind in ("bilinear", "cubic", "quintic", "quadratic", "pendulum")
)
Z_K, Z_A, Z_ALPHA, Z_BETA, Z_GAMMA, Z_N = (_INDEX[name] for name in LIBRARY["bouc_wen"])
FRICTION, C2, C3, CD = (
    _INDEX[name] for name in ("friction_force", "quadratic_damping", "cubic_damping", "displacement_dependent_damping")
)
CONTACT, GAP = (_INDEX[name] for name in LIBRARY["freeplay"])
JOINT_K, JOINT_F, JOINT_CHI = (_INDEX[name] for name in LIBRARY["iwan"])
SLIDER_K, SLIDER_F = (_INDEX[name] for name in LIBRARY["jenkins"])
MAGNET, MAGNET_D = (_INDEX[name] for name in OUTSIDE["magnetic_attraction"])
ROOT, STRUCTURAL, INERTIA, DRAG = (
    _INDEX[name] for name in ("root_damping", "structural_damping", "inertia_growth", "one_way_drag")
)
NEGATIVE, NEGATIVE_V = (_INDEX[name] for name in OUTSIDE["limited_negative_damping"])
KINETIC, STATIC, STRIBECK_V = (_INDEX[name] for name in OUTSIDE["stribeck_friction"])
STOP_K, STOP_GAP, STOP_C = (_INDEX[name] for name in OUTSIDE["impact_stop"])
BAND_C, BAND = (_INDEX[name] for name in OUTSIDE["deadband_damper"])


def pack(parameters: Mapping[str, float]) -> np.ndarray:
    """Return the vector of a system from named parameters; those not named are zero.

    Parameters
    ----------
    parameters : mapping of str to float
        SI units; must hold ``mass`` and ``linear_stiffness``.

    Returns
    -------
    ndarray, shape (len(PARAMETERS),)

    Raises
    ------
    KeyError
        If a name is not one of `PARAMETERS`.
    """
    vector = np.zeros(len(PARAMETERS))
    for name, value in parameters.items():
        vector[_INDEX[name]] = value
    return vector


@numba.njit(cache=True)
def acceleration(t, x, v, z, direction, probe, slider, bed, p):
    """Return the acceleration [m/s^2] within a segment.

    ``probe`` is a displacement inside the segment: it says on which side of every kink the motion is. ``slider``
    holds displacement and force of the Jenkins element at the last turning point and where it slips; ``bed`` the
    same for the sliders of the Iwan bed, see `motion.Bed`.
    """
    speed = direction * v
    force = (p[K] + p[K_RATE] * t) * x + (p[C] + p[C_RATE] * t) * v
    x2 = x * x
    force += x2 * (p[QUADRATIC] + x * (p[CUBIC] + p[QUINTIC] * x2) + p[CD] * v)
    force += v * v * (p[C3] * v + direction * p[C2]) + direction * p[FRICTION]
    if p[PENDULUM] != 0.0:
        force += p[PENDULUM] * (math.sin(x) - x)
    if probe > 0.0:
        force += p[BILINEAR] * x
    if p[CONTACT] != 0.0 and abs(probe) > p[GAP]:
        force += p[CONTACT] * (x - math.copysign(p[GAP], probe))
    if p[Z_K] != 0.0:
        force += (1.0 - p[Z_ALPHA]) * p[Z_K] * z
    if p[SLIDER_K] != 0.0:
        if direction * (probe - slider[2]) > 0.0:
            force += direction * p[SLIDER_F]
        else:
            force += slider[1] + p[SLIDER_K] * (x - slider[0])
    if p[JOINT_K] != 0.0:
        force += bed_force(x, direction, bed)
    # Outside of the library.
    if p[MAGNET] != 0.0:
        force -= p[MAGNET] * (1.0 / (p[MAGNET_D] - x) ** 2 - 1.0 / p[MAGNET_D] ** 2)
    if p[ROOT] != 0.0:
        force += direction * p[ROOT] * math.sqrt(max(speed, 0.0))
    if p[STRUCTURAL] != 0.0:
        force += direction * p[STRUCTURAL] * math.copysign(1.0, probe) * x
    if p[NEGATIVE] != 0.0:
        force -= p[NEGATIVE] * v / (1.0 + (v / p[NEGATIVE_V]) ** 2)
    if p[STATIC] != 0.0:
        force += direction * (p[KINETIC] + (p[STATIC] - p[KINETIC]) * math.exp(-speed / p[STRIBECK_V]))
    if p[STOP_K] != 0.0 and probe > p[STOP_GAP]:
        force += p[STOP_K] * (x - p[STOP_GAP]) * (1.0 + p[STOP_C] * v)
    if p[BAND_C] != 0.0 and abs(probe) > p[BAND]:
        force += p[BAND_C] * v
    if direction > 0.0:
        force += p[DRAG] * v * v
    growth = p[INERTIA]
    return -(force / p[MASS] + growth * x * v * v) / (1.0 + growth * x2)


@numba.njit(cache=True)
def hysteresis_rate(v, z, direction, side, p):
    """Return dz/dt [m/s] of the Bouc-Wen element; ``side`` is the sign of z within the segment."""
    if p[Z_K] == 0.0:
        return 0.0
    return p[Z_A] * v - abs(z) ** p[Z_N] * (p[Z_BETA] * direction * v * side + p[Z_GAMMA] * v)


@numba.njit(cache=True)
def bed_force(x, direction, bed):
    """Return the force [N] of a bed of sliders in motion away from its last turning point.

    Row 3 of ``bed`` holds the distances at which the sliders slip, ascending; row 4 the force of those that have
    slipped by then, above what they had; row 5 the stiffness of the others. ``bed[6, 0]`` and ``bed[6, 1]`` are
    displacement and force at the turning point.
    """
    distance = direction * (x - bed[6, 0])
    low, high = 0, bed.shape[1] - 1
    while low < high:
        middle = (low + high) // 2
        if bed[3, middle] < distance:
            low = middle + 1
        else:
            high = middle
    return bed[6, 1] + direction * (bed[4, low] + bed[5, low] * distance)


@numba.njit(cache=True)
def next_kink(x, direction, margin, slider, p):
    """Return the displacement of the next kink ahead, or infinity with the sign of ``direction``."""
    best = np.inf
    if p[BILINEAR] != 0.0 or p[STRUCTURAL] != 0.0:
        best = _nearer(best, -direction * x, margin)
    if p[CONTACT] != 0.0:
        best = _nearer(best, direction * (p[GAP] - x), margin)
        best = _nearer(best, direction * (-p[GAP] - x), margin)
    if p[SLIDER_K] != 0.0:
        best = _nearer(best, direction * (slider[2] - x), margin)
    if p[STOP_K] != 0.0:
        best = _nearer(best, direction * (p[STOP_GAP] - x), margin)
    if p[BAND_C] != 0.0:
        best = _nearer(best, direction * (p[BAND] - x), margin)
        best = _nearer(best, direction * (-p[BAND] - x), margin)
    return x + direction * best


@numba.njit(cache=True)
def _nearer(best, distance, margin):
    return distance if margin < distance < best else best
