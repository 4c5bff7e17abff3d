"""The force laws, compiled: the effects of the package written anew, and others.

Within a *segment* of the motion (between two turning points and between two kinks) the direction of motion and the
branch of every force with a kink are constants, so that all forces are smooth there; `motion.simulate` goes from
segment to segment. The state ``y`` is displacement, velocity and what has an equation of its own: the displacement of
the Bouc-Wen element, the deflection of a Dahl contact, the stretch of a Maxwell element [m].
"""

from __future__ import annotations

import math

import numba
import numpy as np
from systems import BASE, INDEX, LIBRARY, NEW, OUTSIDE

STATES = 5
"""Length of the state: x, v, and the three with equations of their own."""

# Positions as module constants, because compiled code cannot look names up.
MASS, K, K_RATE, C, C_RATE = (INDEX[name] for name in ("mass", *BASE))
BILINEAR, CUBIC, QUINTIC, QUADRATIC, PENDULUM = (
    INDEX[f"{kind}_stiffness"] for kind in ("bilinear", "cubic", "quintic", "quadratic", "pendulum")
)
Z_K, Z_A, Z_ALPHA, Z_BETA, Z_GAMMA, Z_N = (INDEX[name] for name in LIBRARY["bouc_wen"])
FRICTION, C2, C3, CD = (
    INDEX[name] for name in ("friction_force", "quadratic_damping", "cubic_damping", "displacement_dependent_damping")
)
CONTACT, GAP = (INDEX[name] for name in LIBRARY["freeplay"])
JOINT_K, JOINT_F, JOINT_CHI = (INDEX[name] for name in LIBRARY["iwan"])
SLIDER_K, SLIDER_F = (INDEX[name] for name in LIBRARY["jenkins"])
MAGNET = INDEX["magnet_strength"]
ROOT, STRUCTURAL, INERTIA, DRAG = (
    INDEX[name] for name in ("root_damping", "structural_damping", "inertia_growth", "one_way_drag")
)
NEGATIVE, NEGATIVE_V = (INDEX[name] for name in OUTSIDE["limited_negative_damping"])
KINETIC, STATIC, STRIBECK_V = (INDEX[name] for name in OUTSIDE["stribeck_friction"])
STOP_K, STOP_GAP, STOP_C = (INDEX[name] for name in OUTSIDE["impact_stop"])
BAND_C, BAND = (INDEX[name] for name in OUTSIDE["deadband_damper"])
PAIR_F, MAGNET_D, PAIR_N = (INDEX[name] for name in NEW["magnetic_stiffness"])
ABS_C = INDEX["absolute_displacement_damping"]
BOTH_C, BOTH_R = (INDEX[name] for name in NEW["asymmetric_drag"])
BUMP = INDEX["bilinear_damping"]
EDGE_C, EDGE_X = (INDEX[name] for name in NEW["dead_band_damping"])
MID_C, MID_X = (INDEX[name] for name in NEW["mid_stroke_damping"])
LIMITED_C, LIMITED_V = (INDEX[name] for name in NEW["speed_limited_damping"])
SOFT_K, SOFT_GAP, SOFT_LOSS = (INDEX[name] for name in NEW["damped_stop"])
CROSS_K, CROSS_L = (INDEX[name] for name in NEW["geometric_stiffness"])
MOVES_ALONG = INDEX["nonlinear_inertia"]
DAHL_K, DAHL_F = (INDEX[name] for name in NEW["dahl_friction"])
HERTZ_K, HERTZ_GAP = (INDEX[name] for name in NEW["hertz_contact"])
ARM_K, ARM_TIME = (INDEX[name] for name in NEW["maxwell_element"])
PLAY_K, PLAY, PLAY_R = (INDEX[name] for name in NEW["offset_freeplay"])
POWER_C, POWER_C_N, POWER_C_V = (INDEX[name] for name in NEW["power_damping"])
WHERE_C, WHERE_N, WHERE_X = (INDEX[name] for name in NEW["power_displacement_damping"])
POWER_K, POWER_K_N, POWER_K_X = (INDEX[name] for name in NEW["power_stiffness"])

ROUNDED = 1e-3
"""Share of its reference speed below which a damper with a power of the speed is rounded, as the package defines it."""
ROUNDED_X = 1e-2
"""Share of its reference displacement below which a damper with a power of that is rounded."""
EDGE = 0.02
"""Share of a dead band on either side of its edge over which the package lets the damper set in."""


@numba.njit(cache=True)
def acceleration(t, y, direction, probe, slider, bed, p):
    """Return the acceleration [m/s^2] within a segment.

    ``probe`` is a displacement inside the segment: it says on which side of every kink the motion is. ``slider``
    holds displacement and force of the Jenkins element at the last turning point and where it slips; ``bed`` the
    same for the sliders of the Iwan bed, see `motion._start_stroke`.
    """
    x, v = y[0], y[1]
    force = (p[K] + p[K_RATE] * t) * x + (p[C] + p[C_RATE] * t) * v
    force = _common(force, y, direction, probe, slider, bed, p)
    force = _outside(force, x, v, direction, probe, p)
    force = _new(force, y, direction, probe, p)
    growth = p[INERTIA] + p[MOVES_ALONG] / p[MASS]
    x2 = x * x
    return -(force / p[MASS] + growth * x * v * v) / (1.0 + growth * x2)


@numba.njit(cache=True)
def _common(force, y, direction, probe, slider, bed, p):
    """Add the effects of `systems.LIBRARY`."""
    x, v, z = y[0], y[1], y[2]
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
    return force


@numba.njit(cache=True)
def _outside(force, x, v, direction, probe, p):
    """Add the laws of `systems.OUTSIDE`; a contact that is closed at rest by a preload pulls by that much less."""
    speed = direction * v
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
    if p[STOP_K] != 0.0:
        if probe > p[STOP_GAP]:
            force += p[STOP_K] * (x - p[STOP_GAP]) * (1.0 + p[STOP_C] * v)
        if p[STOP_GAP] < 0.0:
            force += p[STOP_K] * p[STOP_GAP]
    if p[BAND_C] != 0.0 and abs(probe) > p[BAND]:
        force += p[BAND_C] * v
    if direction > 0.0:
        force += p[DRAG] * v * v
    return force


@numba.njit(cache=True)
def _new(force, y, direction, probe, p):
    """Add the effects of `systems.NEW` that are not among the others; magnets are never reached."""
    x, v, deflection, stretch = y[0], y[1], y[3], y[4]
    side = math.copysign(1.0, probe)
    force += p[ABS_C] * side * x * v + p[DAHL_K] * deflection + p[ARM_K] * stretch
    if p[HERTZ_K] != 0.0:
        towards = math.copysign(1.0, p[HERTZ_K])
        if towards * probe > p[HERTZ_GAP]:
            force += p[HERTZ_K] * max(towards * x - p[HERTZ_GAP], 0.0) ** 1.5
        if p[HERTZ_GAP] < 0.0:
            force -= p[HERTZ_K] * (-p[HERTZ_GAP]) ** 1.5
    if p[SOFT_K] != 0.0:
        towards = math.copysign(1.0, p[SOFT_K])
        if towards * probe > p[SOFT_GAP]:
            force += p[SOFT_K] * (towards * x - p[SOFT_GAP]) * (1.0 + towards * p[SOFT_LOSS] * v)
        force -= p[SOFT_K] * max(-p[SOFT_GAP], 0.0)
    if p[PLAY_K] != 0.0:
        stop = p[PLAY] * (p[PLAY_R] + side)
        if side * (probe - stop) > 0.0:
            force += p[PLAY_K] * (x - stop)
    if p[PAIR_F] != 0.0:
        u, n = x / p[MAGNET_D], p[PAIR_N]
        force += p[PAIR_F] * ((1.0 - u) ** -n - (1.0 + u) ** -n - 2.0 * n * u)
    if p[BOTH_C] != 0.0:
        force += p[BOTH_C] * (v * abs(v) + p[BOTH_R] * v * v)
    if direction > 0.0:
        force += p[BUMP] * v
    if p[POWER_C] != 0.0:
        u = v / p[POWER_C_V]
        force += p[POWER_C] * u * (u * u + ROUNDED**2) ** (0.5 * (p[POWER_C_N] - 1.0))
    if p[WHERE_C] != 0.0:
        u = x / p[WHERE_X]
        force += p[WHERE_C] * v * (u * u + ROUNDED_X**2) ** (0.5 * p[WHERE_N])
    if p[EDGE_C] != 0.0 and abs(probe) > (1.0 - EDGE) * p[EDGE_X]:
        if abs(probe) > (1.0 + EDGE) * p[EDGE_X]:
            force += p[EDGE_C] * v
        else:
            s = 0.5 + 0.5 * (side * x / p[EDGE_X] - 1.0) / EDGE
            force += p[EDGE_C] * v * s * s * (3.0 - 2.0 * s)
    if p[MID_C] != 0.0:
        force += p[MID_C] * v * math.exp(-((x / p[MID_X]) ** 2))
    if p[LIMITED_C] != 0.0:
        force += p[LIMITED_C] * v / (1.0 + (v / p[LIMITED_V]) ** 2)
    if p[CROSS_K] != 0.0:
        force += p[CROSS_K] * x * (1.0 - p[CROSS_L] / math.hypot(x, p[CROSS_L]))
    if p[POWER_K] != 0.0:
        force += p[POWER_K] * side * max(side * x / p[POWER_K_X], 0.0) ** p[POWER_K_N]
    return force


@numba.njit(cache=True)
def write_rates(y, direction, side, p, out):
    """Write the rates of the states with equations of their own [m/s]; ``side`` is the sign of Bouc-Wen's."""
    v, z = y[1], y[2]
    if p[Z_K] != 0.0:
        out[2] = p[Z_A] * v - abs(z) ** p[Z_N] * (p[Z_BETA] * direction * v * side + p[Z_GAMMA] * v)
    if p[DAHL_K] != 0.0:
        out[3] = v * (1.0 - direction * p[DAHL_K] * y[3] / p[DAHL_F])
    if p[ARM_K] != 0.0:
        out[4] = v - y[4] / p[ARM_TIME]


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
    if p[BILINEAR] != 0.0 or p[STRUCTURAL] != 0.0 or p[ABS_C] != 0.0 or p[POWER_K] != 0.0:
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
    if p[EDGE_C] != 0.0:
        for side in (-1.0, 1.0):
            best = _nearer(best, direction * (side * (1.0 - EDGE) * p[EDGE_X] - x), margin)
            best = _nearer(best, direction * (side * (1.0 + EDGE) * p[EDGE_X] - x), margin)
    if p[HERTZ_K] != 0.0:
        best = _nearer(best, direction * (math.copysign(1.0, p[HERTZ_K]) * p[HERTZ_GAP] - x), margin)
    if p[SOFT_K] != 0.0:
        best = _nearer(best, direction * (math.copysign(1.0, p[SOFT_K]) * p[SOFT_GAP] - x), margin)
    if p[PLAY_K] != 0.0:
        best = _nearer(best, direction * (p[PLAY] * (p[PLAY_R] + 1.0) - x), margin)
        best = _nearer(best, direction * (p[PLAY] * (p[PLAY_R] - 1.0) - x), margin)
    return x + direction * best


@numba.njit(cache=True)
def _nearer(best, distance, margin):
    return distance if margin < distance < best else best
