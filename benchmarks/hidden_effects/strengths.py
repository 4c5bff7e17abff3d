"""Parameters of an effect from its strength at the release amplitude.

Strength is one number per effect. For springs (`STIFFNESS_KINDS`) it is the force at the release amplitude over that of
the linear spring. For everything that dissipates it is the damping ratio that the effect adds at the release amplitude,
from the work of one cycle ``W``: ``zeta = W / (2 pi k A^2)``. Limits on stiffnesses can make an effect weaker than
asked for; the strength handed back is what came out.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from systems import LIBRARY

Drawn = tuple[dict[str, float], float]
"""Parameters by name and the strength they amount to."""

STIFFNESS_KINDS = frozenset(
    (
        "bilinear_stiffness",
        "cubic_stiffness",
        "freeplay",
        "pendulum_stiffness",
        "quadratic_stiffness",
        "quintic_stiffness",
        "magnetic_attraction",
        "impact_stop",
        "damped_stop",
        "geometric_stiffness",
        "displacement_dependent_inertia",
        "nonlinear_inertia",
        "hertz_contact",
        "magnetic_stiffness",
        "offset_freeplay",
        "one_sided_stiffness",
        "power_stiffness",
    )
)
"""Effects whose strength is a share of the linear spring's force; of all others it is a damping ratio."""

_SOFTEST = {
    "bilinear_stiffness": 0.5,
    "cubic_stiffness": 0.35,
    "quadratic_stiffness": 0.35,
    "quintic_stiffness": 0.35,
    "displacement_dependent_inertia": 0.25,
}
_POWERS = {"bilinear_stiffness": 1, "quadratic_stiffness": 2, "cubic_stiffness": 3, "quintic_stiffness": 5}


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw_parameters(
    effect: str,
    strength: float,
    rng: np.random.Generator,
    *,
    mass: float,
    stiffness: float,
    damping: float,
    amplitude: float,
    narrow: bool = False,
    strong: bool = False,
) -> Drawn:
    """Draw the parameters of an effect of a given strength.

    Parameters
    ----------
    effect : str
        A key of `systems.LIBRARY` or `systems.OUTSIDE`.
    strength : float
        See the module; positive.
    rng : numpy.random.Generator
        Source of signs, length scales and exponents.
    mass, stiffness, damping, amplitude : float
        Of the linear oscillator and its release, SI units.
    narrow : bool, default False
        For a slider: slips after 0.5 to 5 % of the amplitude, so that it looks like dry friction.
    strong : bool, default False
        For hysteresis: slips from 0.5 % of the amplitude on.

    Returns
    -------
    parameters : dict of str to float
    strength : float
        What the parameters amount to.
    """
    k, big = stiffness, amplitude
    omega = math.sqrt(k / mass)
    work = strength * 2.0 * math.pi * k * big**2
    if effect in _SOFTEST:
        return _draw_signed(effect, strength, rng, k, big)
    if effect == "freeplay":
        gap = rng.uniform(0.1, 0.9) * big
        contact = min(strength * k * big / (big - gap), 3.5 * k)
        return {"contact_stiffness": contact, "gap": gap}, contact * (big - gap) / (k * big)
    if effect == "pendulum_stiffness":
        bend = (big - math.sin(big)) / big
        value = min(strength * k / bend, 1.7 * k)
        return {effect: value}, value * bend / k
    if effect == "bouc_wen":
        return _draw_bouc_wen(work, rng, k, big, 0.005 if strong else 0.3)
    if effect == "jenkins":
        if strong:
            slip = big * log_uniform(rng, 0.005, 0.9)
        else:
            slip = big * (log_uniform(rng, 0.005, 0.05) if narrow else rng.uniform(0.1, 0.9))
        slider = min(work / (4.0 * slip * (big - slip)), 0.9 * k)
        parameters = {"slider_stiffness": slider, "slip_force": slider * slip}
        return parameters, slider * 4.0 * slip * (big - slip) / (2.0 * math.pi * k * big**2)
    if effect == "iwan":
        return _draw_iwan(work, rng, k, big, 0.02 if strong else 0.4)
    if effect in ("magnetic_attraction", "impact_stop"):
        return _draw_one_sided(effect, strength, rng, k, big, omega)
    return _DAMPERS[effect](work, strength, rng, mass, damping, big, omega)


def _draw_signed(effect: str, strength: float, rng: np.random.Generator, k: float, big: float) -> Drawn:
    """Draw a spring of either sign, or an inertia that grows or falls with the displacement."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    share = strength if sign > 0.0 else min(strength, _SOFTEST[effect])
    if effect == "displacement_dependent_inertia":
        return {"inertia_growth": sign * share / big**2}, share
    return {effect: sign * share * k / big ** (_POWERS[effect] - 1)}, share


def _draw_one_sided(
    effect: str, strength: float, rng: np.random.Generator, k: float, big: float, omega: float
) -> Drawn:
    """Draw a magnet or a dissipating stop on the positive side."""
    if effect == "magnetic_attraction":
        distance = rng.uniform(1.4, 3.0) * big
        share = min(strength, 0.3)
        pull = share * k * big / (1.0 / (distance - big) ** 2 - 1.0 / distance**2)
        return {"magnet_strength": pull, "magnet_distance": distance}, share
    gap = rng.uniform(0.1, 0.9) * big
    parameters = {
        "stop_stiffness": strength * k * big / (big - gap),
        "stop_gap": gap,
        "stop_damping": rng.uniform(0.1, 0.7) / (omega * big),
    }
    return parameters, strength


def _draw_bouc_wen(work: float, rng: np.random.Generator, k: float, big: float, smallest: float) -> Drawn:
    """Draw a Bouc-Wen element, half of the time in another of its equivalent scalings."""
    exponent = rng.uniform(1.0, 2.0)
    largest = log_uniform(rng, smallest, 1.5) * big
    asymmetry = rng.uniform(-0.5, 0.5)
    total = largest**-exponent
    beta, gamma = (1.0 - asymmetry) * total, asymmetry * total
    loop = bouc_wen_loop(beta, gamma, exponent, big)
    spring = min(work / loop, 1.4 * k)
    scale = log_uniform(rng, 0.3, 3.0)
    alpha = rng.uniform(0.0, 0.6)
    if rng.random() < 0.5:
        scale, alpha = 1.0, 0.0
    parameters = {
        "bouc_wen_stiffness": spring / (scale * (1.0 - alpha)),
        "bouc_wen_amplitude": scale,
        "bouc_wen_alpha": alpha,
        "bouc_wen_beta": beta * scale ** (1.0 - exponent),
        "bouc_wen_gamma": gamma * scale ** (1.0 - exponent),
        "bouc_wen_exponent": exponent,
    }
    return parameters, spring * loop / (2.0 * math.pi * k * big**2)


def bouc_wen_loop(beta: float, gamma: float, exponent: float, amplitude: float, points: int = 400) -> float:
    """Return the area of the steady loop of ``z`` over the displacement, for unit amplitude parameter [m^2]."""
    h = 2.0 * amplitude / points
    z, area = 0.0, 0.0
    for stroke in range(6):
        direction = 1.0 if stroke % 2 == 0 else -1.0
        area = 0.0 if stroke == 4 else area
        for _ in range(points):
            # Midpoint rule in the displacement.
            middle = z + 0.5 * h * direction * _bouc_wen_slope(z, direction, beta, gamma, exponent)
            z += h * direction * _bouc_wen_slope(middle, direction, beta, gamma, exponent)
            area += middle * direction * h
    return area


def _bouc_wen_slope(z: float, direction: float, beta: float, gamma: float, exponent: float) -> float:
    side = 1.0 if z >= 0.0 else -1.0
    return 1.0 - abs(z) ** exponent * (beta * direction * side + gamma)


def _draw_iwan(work: float, rng: np.random.Generator, k: float, big: float, smallest: float) -> Drawn:
    """Draw a bed of sliders, mostly in micro-slip."""
    chi = rng.uniform(-0.8, 0.0)
    largest = log_uniform(rng, smallest, 6.0) * big
    u = np.linspace(0.0, big, 4001)
    ratio = np.minimum(u / largest, 1.0)
    curve = np.where(u < largest, u * (1.0 - ratio ** (chi + 1.0) / (chi + 2.0)), largest * (chi + 1.0) / (chi + 2.0))
    # Masing's rule: work of a closed loop between -A and A.
    loop = float(8.0 * np.trapezoid(curve, u) - 4.0 * big * curve[-1])
    joint = min(work / loop, 0.9 * k)
    parameters = {
        "joint_stiffness": joint,
        "joint_slip_force": joint * largest * (chi + 1.0) / (chi + 2.0),
        "joint_exponent": chi,
    }
    return parameters, joint * loop / (2.0 * math.pi * k * big**2)


def _friction(work, strength, rng, mass, damping, big, omega) -> Drawn:
    return {"friction_force": work / (4.0 * big)}, strength


def _quadratic(work, strength, rng, mass, damping, big, omega) -> Drawn:
    return {"quadratic_damping": work * 3.0 / (8.0 * omega**2 * big**3)}, strength


def _cubic(work, strength, rng, mass, damping, big, omega) -> Drawn:
    return {"cubic_damping": work * 4.0 / (3.0 * math.pi * omega**3 * big**4)}, strength


def _van_der_pol(work, strength, rng, mass, damping, big, omega) -> Drawn:
    return {"displacement_dependent_damping": work * 4.0 / (math.pi * omega * big**4)}, strength


def _root(work, strength, rng, mass, damping, big, omega) -> Drawn:
    # The integral of |sin|^(3/2) over a cycle.
    cycle = 2.0 * math.sqrt(math.pi) * math.gamma(1.25) / math.gamma(1.75)
    return {"root_damping": work / (math.sqrt(omega * big) * big * cycle)}, strength


def _structural(work, strength, rng, mass, damping, big, omega) -> Drawn:
    return {"structural_damping": work / (2.0 * big**2)}, strength


def _negative(work, strength, rng, mass, damping, big, omega) -> Drawn:
    # The net damping at small amplitudes stays positive: at most 80 % of the viscous damper is taken away.
    value = min(strength * 2.0 * mass * omega, 0.8 * damping)
    return {
        "negative_damping": value,
        "negative_damping_speed": log_uniform(rng, 0.08, 0.6) * omega * big,
    }, value / (2.0 * mass * omega)


def _stribeck(work, strength, rng, mass, damping, big, omega) -> Drawn:
    kinetic = work / (4.0 * big)
    return {
        "stribeck_kinetic": kinetic,
        "stribeck_static": kinetic * rng.uniform(1.3, 2.5),
        "stribeck_speed": log_uniform(rng, 0.05, 0.4) * omega * big,
    }, strength


def _deadband(work, strength, rng, mass, damping, big, omega) -> Drawn:
    band = rng.uniform(0.1, 0.8)
    angle = math.acos(band)
    value = work / (2.0 * omega * big**2 * (angle - math.sin(angle) * math.cos(angle)))
    return {"deadband_damping": value, "deadband": band * big}, strength


def _one_way(work, strength, rng, mass, damping, big, omega) -> Drawn:
    return {"one_way_drag": work * 3.0 / (4.0 * omega**2 * big**3)}, strength


_DAMPERS: dict[str, Callable[..., Drawn]] = {
    "coulomb_friction": _friction,
    "quadratic_damping": _quadratic,
    "cubic_damping": _cubic,
    "displacement_dependent_damping": _van_der_pol,
    "root_damping": _root,
    "structural_damping": _structural,
    "limited_negative_damping": _negative,
    "stribeck_friction": _stribeck,
    "deadband_damper": _deadband,
    "one_way_drag": _one_way,
}

FULL_RANGE = {True: (1e-4, 0.6), False: (1e-5, 0.05)}
"""Strengths from far below to far above what can be seen: of springs, of dampers."""
VISIBLE_RANGE = {True: (1e-2, 0.4), False: (1.5e-3, 0.03)}
"""Strengths that most records show."""
STRONG_RANGE = {True: (0.5, 3.0), False: (0.005, 0.15)}
"""Strengths at the edge of what still makes a record."""
LARGEST = {"coulomb_friction": 0.012, "stribeck_friction": 0.006}
"""Dry friction above this stops the motion within a dozen cycles."""


def draw_strength(effect: str, rng: np.random.Generator, *, visible: bool = False, strong: bool = False) -> float:
    """Draw a strength, log-uniform over `FULL_RANGE`, `VISIBLE_RANGE` or `STRONG_RANGE`."""
    ranges = STRONG_RANGE if strong else VISIBLE_RANGE if visible else FULL_RANGE
    low, high = ranges[effect in STIFFNESS_KINDS]
    high = min(high, LARGEST.get(effect, high))
    return log_uniform(rng, min(low, 0.5 * high), high)


def is_scattered(parameter: str) -> bool:
    """Whether a parameter differs between specimens.

    Exponents, the scaling of a hysteresis, and the speed or displacement at which a power is given do not.
    """
    return parameter not in _THE_SAME


_THE_SAME = frozenset(
    (
        "bouc_wen_amplitude",
        "bouc_wen_alpha",
        "bouc_wen_exponent",
        "joint_exponent",
        "magnet_exponent",
        "displacement_exponent",
        "damping_displacement",
        "power_damping_exponent",
        "power_damping_speed",
        "power_stiffness_exponent",
        "power_stiffness_displacement",
    )
)


LIBRARY_NAMES: tuple[str, ...] = tuple(LIBRARY)
