"""The force laws once more, for the second generator: plain functions, hysteresis in closed form.

Nothing is shared with `laws.py` but the names of the parameters. Sliders follow Masing's rule: in a free decay every
stroke lies within the one before, so that the force on a stroke is twice the virgin curve at half the distance from
the last turning point. There are no sliders to be counted, and no states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Force = Callable[[float, float, float, float], float]
"""``force(x, v, s, at)`` [N]: displacement, velocity, direction of motion, and a displacement in the same segment."""
Values = Mapping[str, float]


@dataclass
class Term:
    """One force.

    Attributes
    ----------
    force : callable
        See `Force`; of a term with a state the argument ``v`` is that state.
    kinks : tuple of float
        Displacements at which its branch changes.
    rate : callable or None
        Of the state: ``rate(v, state, s)``.
    loaded : float
        The state after slow loading from rest to the release.
    mass : callable or None
        Mass that moves along, ``mass(x)``.
    """

    force: Force
    kinks: tuple[float, ...] = ()
    rate: Callable[[float, float, float], float] | None = None
    loaded: float = 0.0
    mass: Callable[[float], float] | None = None

    def turn(self, x: float, s: float) -> None:
        """Take note of a turning point after motion in direction ``s``."""


class Masing(Term):
    """A hysteresis that is its virgin curve, doubled, after each turning point."""

    def __init__(self, curve: Callable[[float], float], kink: float, release: float) -> None:
        super().__init__(self._pull)
        self._curve, self._kink = curve, kink
        self._at, self._pulls = 0.0, 0.0
        self.turn(release, 0.0)

    def _pull(self, x: float, v: float, s: float, at: float) -> float:
        return self._pulls + s * 2.0 * self._curve(max(0.5 * s * (x - self._at), 0.0))

    def turn(self, x: float, s: float) -> None:
        """Begin a stroke; the first is virgin loading from zero."""
        self._pulls = self._curve(x) if s == 0.0 else self._pull(x, 0.0, s, x)
        self._at = x
        self.kinks = (x - 2.0 * self._kink, x + 2.0 * self._kink)


def _polynomial(name: str, power: int) -> Callable[[Values, float], Term]:
    return lambda p, release: Term(lambda x, v, s, at, k=p[name]: k * x**power)


def _of_speed(name: str, power: int) -> Callable[[Values, float], Term]:
    return lambda p, release: Term(lambda x, v, s, at, c=p[name]: c * s * (s * v) ** power)


def _bilinear(p: Values, release: float) -> Term:
    k = p["bilinear_stiffness"]
    return Term(lambda x, v, s, at: k * x if at > 0.0 else 0.0, (0.0,))


def _pendulum(p: Values, release: float) -> Term:
    k = p["pendulum_stiffness"]
    return Term(lambda x, v, s, at: k * (math.sin(x) - x))


def _between_stops(k: float, low: float, high: float) -> Term:
    def force(x: float, v: float, s: float, at: float) -> float:
        return k * (x - high) if at > high else k * (x - low) if at < low else 0.0

    return Term(force, (low, high))


def _freeplay(p: Values, release: float) -> Term:
    return _between_stops(p["contact_stiffness"], -p["gap"], p["gap"])


def _offset_freeplay(p: Values, release: float) -> Term:
    half, middle = p["play"], p["play"] * p["play_asymmetry"]
    return _between_stops(p["play_stiffness"], middle - half, middle + half)


def _one_sided(p: Values, release: float) -> Term:
    k, gap = p["stop_stiffness"], p["stop_gap"]
    # Where a preload closes the contact at rest, its force there is part of the balance.
    return Term(lambda x, v, s, at: k * ((x - gap if at > gap else 0.0) + min(gap, 0.0)), (gap,))


def _impact_stop(p: Values, release: float) -> Term:
    k, gap, c = p["stop_stiffness"], p["stop_gap"], p["stop_damping"]
    return Term(lambda x, v, s, at: k * (x - gap) * (1.0 + c * v) if at > gap else 0.0, (gap,))


def _damped_stop(p: Values, release: float) -> Term:
    k, gap, loss = p["damped_stop_stiffness"], p["damped_stop_gap"], p["stop_loss"]
    side = 1.0 if k > 0.0 else -1.0

    def force(x: float, v: float, s: float, at: float) -> float:
        pressed = k * (side * x - gap) * (1.0 + loss * side * v) if side * at > gap else 0.0
        return pressed + k * min(gap, 0.0)

    return Term(force, (side * gap,))


def _inclined(p: Values, release: float) -> Term:
    k, length = p["geometric_stiffness"], p["inclined_length"]
    return Term(lambda x, v, s, at: k * x - k * x / math.sqrt(1.0 + (x / length) ** 2))


def _hertz(p: Values, release: float) -> Term:
    k, gap = p["hertz_stiffness"], p["hertz_gap"]
    side = math.copysign(1.0, k)
    at_rest = max(-gap, 0.0) ** 1.5

    def force(x: float, v: float, s: float, at: float) -> float:
        closed = max(side * x - gap, 0.0) if side * at > gap else 0.0
        return k * (closed * math.sqrt(closed) - at_rest)

    return Term(force, (side * gap,))


def _magnets(p: Values, release: float) -> Term:
    f, d, n = p["magnet_force"], p["magnet_distance"], p["magnet_exponent"]
    return Term(lambda x, v, s, at: f * ((d / (d - x)) ** n - (d / (d + x)) ** n - 2.0 * n * x / d))


def _magnet(p: Values, release: float) -> Term:
    f, d = p["magnet_strength"], p["magnet_distance"]
    return Term(lambda x, v, s, at: f / d**2 - f / (d - x) ** 2)


def _power_stiffness(p: Values, release: float) -> Term:
    f, n, unit = p["power_stiffness"], p["power_stiffness_exponent"], p["power_stiffness_displacement"]
    return Term(lambda x, v, s, at: math.copysign(f, f * at) * max(math.copysign(1.0, at) * x / unit, 0.0) ** n, (0.0,))


def _power_damping(p: Values, release: float) -> Term:
    f, n, unit = p["power_damping"], p["power_damping_exponent"], p["power_damping_speed"]
    return Term(lambda x, v, s, at: f * v / unit * math.hypot(v / unit, 1e-3) ** (n - 1.0))


def _absolute(p: Values, release: float) -> Term:
    c = p["absolute_displacement_damping"]
    return Term(lambda x, v, s, at: c * (x if at > 0.0 else -x) * v, (0.0,))


def _power_of_displacement(p: Values, release: float) -> Term:
    c, n, unit = p["power_displacement_damping"], p["displacement_exponent"], p["damping_displacement"]
    return Term(lambda x, v, s, at: c * v * math.hypot(x / unit, 1e-2) ** n)


def _structural(p: Values, release: float) -> Term:
    c = p["structural_damping"]
    return Term(lambda x, v, s, at: c * s * (x if at > 0.0 else -x), (0.0,))


def _van_der_pol(p: Values, release: float) -> Term:
    c = p["displacement_dependent_damping"]
    return Term(lambda x, v, s, at: c * x * x * v)


def _root(p: Values, release: float) -> Term:
    c = p["root_damping"]
    return Term(lambda x, v, s, at: c * s * math.sqrt(max(s * v, 0.0)))


def _negative(p: Values, release: float) -> Term:
    c, at_speed = p["negative_damping"], p["negative_damping_speed"]
    return Term(lambda x, v, s, at: -c * v * at_speed**2 / (at_speed**2 + v * v))


def _stribeck(p: Values, release: float) -> Term:
    kinetic, speed = p["kinetic_friction"], p["stribeck_speed"]
    excess = kinetic * p["stribeck_excess"]
    return Term(lambda x, v, s, at: s * (kinetic + excess * math.exp(-s * v / speed)))


def _deadband(p: Values, release: float) -> Term:
    c, band = p["deadband_damping"], p["deadband"]
    return Term(lambda x, v, s, at: c * v if abs(at) > band else 0.0, (-band, band))


def _dead_band(p: Values, release: float) -> Term:
    c, band = p["dead_band_damping"], p["dead_band"]
    low, high = 0.98 * band, 1.02 * band

    def force(x: float, v: float, s: float, at: float) -> float:
        if abs(at) > high or abs(at) < low:
            return c * v if abs(at) > high else 0.0
        share = (abs(x) - low) / (high - low)
        return c * v * (3.0 * share**2 - 2.0 * share**3)

    return Term(force, (-high, -low, low, high))


def _mid_stroke(p: Values, release: float) -> Term:
    c, middle = p["mid_stroke_damping"], p["mid_stroke"]
    return Term(lambda x, v, s, at: c * v / math.exp(x * x / middle**2))


def _speed_limited(p: Values, release: float) -> Term:
    c, at_speed = p["speed_limited_damping"], p["critical_speed"]
    return Term(lambda x, v, s, at: c * v * at_speed**2 / (at_speed**2 + v * v))


def _one_way(p: Values, release: float) -> Term:
    c = p["one_way_drag"]
    return Term(lambda x, v, s, at: c * v * v if s > 0.0 else 0.0)


def _asymmetric_drag(p: Values, release: float) -> Term:
    c, r = p["asymmetric_drag"], p["drag_asymmetry"]
    return Term(lambda x, v, s, at: c * (s + r) * v * v)


def _bump(p: Values, release: float) -> Term:
    c = p["bilinear_damping"]
    return Term(lambda x, v, s, at: c * v if s > 0.0 else 0.0)


def _inertia(p: Values, release: float) -> Term:
    # Lagrange: d/dt (m(x) x') - m'(x) x'^2 / 2 with m(x) = m2 x^2, the part with x'' apart.
    m2 = p["inertia_growth"] * p["mass"] if "inertia_growth" in p else p["nonlinear_inertia"]
    return Term(lambda x, v, s, at: 2.0 * m2 * x * v * v - m2 * x * v * v, mass=lambda x: m2 * x * x)


def _jenkins(p: Values, release: float) -> Term:
    k, slip = p["slider_stiffness"], p["slip_force"]
    return Masing(lambda u: min(k * u, slip), slip / k, release)


def _iwan(p: Values, release: float) -> Term:
    k, slip, chi = p["joint_stiffness"], p["joint_slip_force"], p["joint_exponent"]
    largest = slip * (chi + 2.0) / (k * (chi + 1.0))

    def curve(u: float) -> float:
        return k * u * (1.0 - (u / largest) ** (chi + 1.0) / (chi + 2.0)) if u < largest else slip

    return Masing(curve, largest, release)


def _loaded(rate: Callable[[float, float, float], float], release: float) -> float:
    from scipy.integrate import solve_ivp

    scale = release
    run = solve_ivp(lambda u, z: [rate(scale, z[0], 1.0)], (0.0, 1.0), [0.0], "DOP853", rtol=1e-12, atol=1e-14 * scale)
    return float(run.y[0, -1])


def _bouc_wen(p: Values, release: float) -> Term:
    a, beta, gamma, n = (p[f"bouc_wen_{name}"] for name in ("amplitude", "beta", "gamma", "exponent"))
    k = (1.0 - p["bouc_wen_alpha"]) * p["bouc_wen_stiffness"]

    def rate(v: float, z: float, s: float) -> float:
        return v * (a - abs(z) ** n * (beta * s * math.copysign(1.0, z) + gamma))

    return Term(lambda x, z, s, at: k * z, rate=rate, loaded=_loaded(rate, release))


def _dahl(p: Values, release: float) -> Term:
    k, f = p["dahl_stiffness"], p["dahl_force"]

    def rate(v: float, z: float, s: float) -> float:
        return v - s * v * k * z / f

    return Term(lambda x, z, s, at: k * z, rate=rate, loaded=_loaded(rate, release))


def _arm(p: Values, release: float) -> Term:
    k, time = p["arm_stiffness"], p["arm_time"]
    return Term(lambda x, z, s, at: k * z, rate=lambda v, z, s: v - z / time)


TERMS: dict[str, Callable[[Values, float], Term]] = {
    "linear": _polynomial("linear_stiffness", 1),
    "viscous": _of_speed("viscous_damping", 1),
    "absolute_displacement_damping": _absolute,
    "asymmetric_drag": _asymmetric_drag,
    "bilinear_damping": _bump,
    "bilinear_stiffness": _bilinear,
    "bouc_wen": _bouc_wen,
    "coulomb_friction": _of_speed("friction_force", 0),
    "cubic_damping": _of_speed("cubic_damping", 3),
    "cubic_stiffness": _polynomial("cubic_stiffness", 3),
    "dahl_friction": _dahl,
    "damped_stop": _damped_stop,
    "dead_band_damping": _dead_band,
    "deadband_damper": _deadband,
    "displacement_dependent_damping": _van_der_pol,
    "displacement_dependent_inertia": _inertia,
    "freeplay": _freeplay,
    "geometric_stiffness": _inclined,
    "hertz_contact": _hertz,
    "impact_stop": _impact_stop,
    "iwan": _iwan,
    "jenkins": _jenkins,
    "limited_negative_damping": _negative,
    "magnetic_attraction": _magnet,
    "magnetic_stiffness": _magnets,
    "maxwell_element": _arm,
    "mid_stroke_damping": _mid_stroke,
    "nonlinear_inertia": _inertia,
    "offset_freeplay": _offset_freeplay,
    "one_sided_stiffness": _one_sided,
    "one_way_drag": _one_way,
    "pendulum_stiffness": _pendulum,
    "power_damping": _power_damping,
    "power_displacement_damping": _power_of_displacement,
    "power_stiffness": _power_stiffness,
    "quadratic_damping": _of_speed("quadratic_damping", 2),
    "quadratic_stiffness": _polynomial("quadratic_stiffness", 2),
    "quintic_stiffness": _polynomial("quintic_stiffness", 5),
    "root_damping": _root,
    "speed_limited_damping": _speed_limited,
    "stribeck_friction": _stribeck,
    "structural_damping": _structural,
}
"""A term for the spring, the damper and every effect; built from parameters and the release [m]."""
