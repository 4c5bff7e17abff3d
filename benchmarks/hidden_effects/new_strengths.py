"""Parameters of the effects of `systems.NEW` from their strength at the release amplitude, see `strengths.py`.

Length scales and exponents are drawn where the law is itself: a contact whose stops are both reached, an exponent away
from those of other laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from laws import ROUNDED, ROUNDED_X
from strengths import Drawn, log_uniform

_ANGLE = np.linspace(0.0, 2.0 * math.pi, 4001)
_SINE = np.sin(_ANGLE)
_STIFFEST = 3.5
"""Largest stiffness of a stop over that of the spring."""
_LIGHTEST = 0.25
"""Largest share of the mass that is missing at the release."""


def draw_new(
    effect: str,
    strength: float,
    rng: np.random.Generator,
    *,
    mass: float,
    stiffness: float,
    amplitude: float,
) -> Drawn:
    """Draw the parameters of an effect of a given strength, in the package's names.

    Parameters
    ----------
    effect : str
        A key of `systems.NEW`.
    strength : float
        See `strengths.py`; positive.
    rng : numpy.random.Generator
        Source of signs, length scales and exponents.
    mass, stiffness, amplitude : float
        Of the linear oscillator and its release, SI units.

    Returns
    -------
    parameters : dict of str to float
    strength : float
        What the parameters amount to.
    """
    return _DRAWN[effect](strength, rng, stiffness, amplitude, math.sqrt(stiffness / mass))


def _work(force: np.ndarray, big: float) -> float:
    """Return the work of one cycle of a force given over the angle at which the speed is a sine."""
    return float(np.trapezoid(force * _SINE * big, _ANGLE))


def _ratio(work: float, k: float, big: float) -> float:
    """Return the damping ratio that a work of one cycle is."""
    return work / (2.0 * math.pi * k * big**2)


def _absolute(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    unit = _work(np.abs(np.cos(_ANGLE)) * _SINE * omega * big**2, big)
    return {"absolute_displacement_damping": strength / _ratio(unit, k, big)}, strength


def _two_way(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    unit = _work(_SINE * np.abs(_SINE) * (omega * big) ** 2, big)
    asymmetry = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.2, 1.0))
    return {"asymmetric_drag": strength / _ratio(unit, k, big), "drag_asymmetry": asymmetry}, strength


def _bump(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    return {"bilinear_damping": strength / _ratio(0.5 * math.pi * omega * big**2, k, big)}, strength


def _inertia(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    share = strength if rng.random() < 0.5 else -min(strength, _LIGHTEST)
    return {"nonlinear_inertia": share * k / (omega * big) ** 2}, abs(share)


def _dahl(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    way = log_uniform(rng, 0.1, 0.8) * big
    # The steady loop between -A and A, whose ends are way * tanh(A / way).
    unit = _ratio(4.0 * way * (big - way * math.tanh(big / way)), k, big)
    contact = min(strength / unit, 0.9 * k)
    return {"dahl_stiffness": contact, "dahl_force": contact * way}, contact * unit


def _hertz(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    gap = float(rng.uniform(-0.5, 0.75)) * big
    closed = (big - gap) ** 1.5 - max(-gap, 0.0) ** 1.5
    contact = min(strength * k * big / closed, 2.7 * k / math.sqrt(big))
    side = 1.0 if rng.random() < 0.5 else -1.0
    return {"hertz_stiffness": side * contact, "hertz_gap": gap}, contact * closed / (k * big)


def _magnets(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    u, n = 1.0 / float(rng.uniform(1.4, 3.0)), float(rng.uniform(1.5, 5.0))
    share = strength if rng.random() < 0.5 else -min(strength, 0.3)
    force = share * k * big / ((1.0 - u) ** -n - (1.0 + u) ** -n - 2.0 * n * u)
    return {"magnet_force": force, "magnet_distance": big / u, "magnet_exponent": n}, abs(share)


def _arm(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    turn = log_uniform(rng, 0.2, 5.0)  # angle by which the phase goes on during the relaxation time
    unit = _ratio(math.pi * big**2 * turn / (1.0 + turn**2), k, big)
    arm = min(strength / unit, 0.9 * k)
    return {"arm_stiffness": arm, "arm_time": turn / omega}, arm * unit


def _offset_play(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    off = float(rng.uniform(0.15, 0.8))
    play = float(rng.uniform(0.1, 0.85 / (1.0 + off))) * big  # the farther stop is reached as well
    nearer = big - play * (1.0 - off)
    stop = min(strength * k * big / nearer, _STIFFEST * k)
    sign = 1.0 if rng.random() < 0.5 else -1.0
    return {"play_stiffness": stop, "play": play, "play_asymmetry": sign * off}, stop * nearer / (k * big)


def _one_sided(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    # A contact at rest without preload would be a bilinear spring.
    gap = float(rng.uniform(0.1, 0.9) if rng.random() < 0.6 else -rng.uniform(0.1, 0.6)) * big
    reach = big - max(gap, 0.0)
    stop = min(strength * k * big / reach, _STIFFEST * k)
    if rng.random() < 0.25:
        stop = -min(stop, 0.6 * k)
    return {"stop_stiffness": stop, "stop_gap": gap}, abs(stop) * reach / (k * big)


def _power_damper(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    exponent = float(rng.uniform(*((0.2, 0.7), (1.3, 1.8), (2.2, 2.8))[int(rng.integers(3))]))
    unit = _work(_SINE * (_SINE**2 + ROUNDED**2) ** (0.5 * (exponent - 1.0)), big)
    parameters = {
        "power_damping": strength / _ratio(unit, k, big),
        "power_damping_exponent": exponent,
        "power_damping_speed": omega * big,
    }
    return parameters, strength


def _power_of_displacement(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    exponent = float(rng.uniform(*((0.4, 0.8), (1.3, 1.7), (2.4, 3.2))[int(rng.integers(3))]))
    unit = _work((np.cos(_ANGLE) ** 2 + ROUNDED_X**2) ** (0.5 * exponent) * _SINE * omega * big, big)
    parameters = {
        "power_displacement_damping": strength / _ratio(unit, k, big),
        "displacement_exponent": exponent,
        "damping_displacement": big,
    }
    return parameters, strength


def _dead_band(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    band = float(rng.uniform(0.1, 0.8))
    unit = _work(np.where(np.abs(np.cos(_ANGLE)) > band, _SINE, 0.0) * omega * big, big)
    return {"dead_band_damping": strength / _ratio(unit, k, big), "dead_band": band * big}, strength


def _mid_stroke(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    middle = log_uniform(rng, 0.15, 0.9)
    unit = _work(np.exp(-((np.cos(_ANGLE) / middle) ** 2)) * _SINE * omega * big, big)
    return {"mid_stroke_damping": strength / _ratio(unit, k, big), "mid_stroke": middle * big}, strength


def _speed_limited(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    critical = log_uniform(rng, 0.1, 0.8)
    unit = _work(_SINE / (1.0 + (_SINE / critical) ** 2) * omega * big, big)
    return {
        "speed_limited_damping": strength / _ratio(unit, k, big),
        "critical_speed": critical * omega * big,
    }, strength


def _power_spring(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    exponent = float(rng.uniform(*((1.4, 2.7), (3.3, 4.6), (5.4, 6.5))[int(rng.integers(3))]))
    share = strength if rng.random() < 0.5 else -min(strength, 0.35)
    parameters = {
        "power_stiffness": share * k * big,
        "power_stiffness_exponent": exponent,
        "power_stiffness_displacement": big,
    }
    return parameters, abs(share)


def _damped_stop(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    gap = float(rng.uniform(0.1, 0.9) if rng.random() < 0.6 else -rng.uniform(0.1, 0.6)) * big
    reach = big - max(gap, 0.0)
    stop = min(strength * k * big / reach, _STIFFEST * k)
    side = 1.0 if rng.random() < 0.5 else -1.0
    loss = float(rng.uniform(0.05, 0.4)) / (big * omega)
    parameters = {"damped_stop_stiffness": side * stop, "damped_stop_gap": gap, "stop_loss": loss}
    return parameters, stop * reach / (k * big)


def _inclined(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    length = log_uniform(rng, 0.2, 1.5)
    share = strength if rng.random() < 0.5 else -min(strength, 0.12)
    unit = 1.0 - length / math.hypot(1.0, length)
    limited = float(np.clip(share / unit, -0.5, _STIFFEST))
    return {"geometric_stiffness": limited * k, "inclined_length": length * big}, abs(limited) * unit


def _stribeck(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    excess, turn = float(rng.uniform(0.3, 1.5)), log_uniform(rng, 0.05, 0.4)
    unit = _work(np.sign(_SINE) * (1.0 + excess * np.exp(-np.abs(_SINE) / turn)), big)
    parameters = {
        "kinetic_friction": strength / _ratio(unit, k, big),
        "stribeck_excess": excess,
        "stribeck_speed": turn * omega * big,
    }
    return parameters, strength


def _structural(strength: float, rng: np.random.Generator, k: float, big: float, omega: float) -> Drawn:
    return {"structural_damping": strength * math.pi * k}, strength


_DRAWN: dict[str, Callable[[float, np.random.Generator, float, float, float], Drawn]] = {
    "absolute_displacement_damping": _absolute,
    "asymmetric_drag": _two_way,
    "bilinear_damping": _bump,
    "damped_stop": _damped_stop,
    "dead_band_damping": _dead_band,
    "dahl_friction": _dahl,
    "geometric_stiffness": _inclined,
    "hertz_contact": _hertz,
    "magnetic_stiffness": _magnets,
    "maxwell_element": _arm,
    "mid_stroke_damping": _mid_stroke,
    "nonlinear_inertia": _inertia,
    "offset_freeplay": _offset_play,
    "one_sided_stiffness": _one_sided,
    "power_damping": _power_damper,
    "power_displacement_damping": _power_of_displacement,
    "power_stiffness": _power_spring,
    "speed_limited_damping": _speed_limited,
    "stribeck_friction": _stribeck,
    "structural_damping": _structural,
}
