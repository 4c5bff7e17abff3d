"""Oscillators that the tests of the simulator share: the library's effects, combinations, a user's own."""

from __future__ import annotations

import numba
import numpy as np

from pymc_backbone.effects import BASE_EFFECTS, LIBRARY, Effect, Parameter
from pymc_backbone.oscillator import Oscillator

MASS, AMPLITUDE, OMEGA = 2.0, 0.03, 2.0 * np.pi * 5.0
COMBINATIONS = (
    ("coulomb_friction", "quadratic_damping", "cubic_stiffness"),
    ("freeplay", "coulomb_friction"),
    ("bouc_wen", "cubic_stiffness"),
    ("jenkins", "iwan"),
    ("jenkins", "bouc_wen"),
    ("bilinear_stiffness", "quadratic_stiffness", "displacement_dependent_damping"),
    ("offset_freeplay", "stribeck_friction"),
    ("dahl_friction", "power_stiffness"),
)
# Forces with a corner or a jump; their sensitivities and backbones are held to a wider tolerance.
ROUGH = (
    *("bilinear_stiffness", "freeplay", "coulomb_friction", "jenkins", "iwan", "bouc_wen"),
    *("stribeck_friction", "power_damping", "power_stiffness", "offset_freeplay", "one_sided_stiffness"),
    *("hertz_contact", "absolute_displacement_damping", "structural_damping", "dahl_friction"),
    "power_displacement_damping",
    *("tabulated_stiffness", "tabulated_damping"),
)
EFFECTS = tuple((name,) for name in LIBRARY if name not in BASE_EFFECTS)


TABULATED = ("tabulated_stiffness", "tabulated_damping")


def tabulated_cubic(name, force, reach):
    """Return the parameters of a curve with an odd and an even part, each one cubic."""
    if name == "tabulated_stiffness":
        u = np.arange(1, 13) / 12.0
        odd, even = 0.2 * force * (u**3 - 0.3 * u), 0.05 * force * u**2
    else:
        u = (np.arange(11) / 10.0) ** 2
        odd, even = 0.02 * force * (0.1 + u**3), 0.01 * force * u[1:] ** 2
    return np.array([odd[-1], *odd[:-1], *even, 1.1 * reach])


def oscillator_of(effects) -> Oscillator:
    return Oscillator(MASS, effects)


def parameters_of(oscillator, *, zeta=0.01, amplitude=AMPLITUDE, omega=OMEGA, share=0.3):
    """Return parameters inside the default bounds, so that an effect added to the library is covered by itself."""
    bounds = oscillator.default_bounds(amplitude, omega).values()
    # Different shares: with equal ones a slider would start to slip exactly at release, where nothing is smooth.
    p = np.array([low + (share + 0.037 * i) * (high - low) for i, (low, high) in enumerate(bounds)])
    force = oscillator.mass * omega**2 * amplitude
    for name in TABULATED:  # cubics, which their splines are: tests/test_tabulated.py has forces with bends
        if name in {effect.name for effect in oscillator.effects}:
            places = [oscillator.index(parameter) for parameter in LIBRARY[name].parameter_names]
            p[places] = tabulated_cubic(name, force, amplitude * (omega if name == "tabulated_damping" else 1.0))
    p[oscillator.index("linear_stiffness")] = oscillator.mass * omega**2
    p[oscillator.index("viscous_damping")] = 2.0 * zeta * oscillator.mass * omega
    return p


def is_rough(effects) -> bool:
    return any(name in ROUGH for name in effects)


def name_of(effects) -> str:
    return "+".join(getattr(effect, "name", effect) for effect in effects)


def _parameter(name, low, high):
    return Parameter(name, "-", name, name, lambda m, a, w: (low(m, a, w), high(m, a, w)))


@numba.njit
def _maxwell_force(x, v, direction, z, p):
    return z[0]


@numba.njit
def _maxwell_rate(x, v, direction, z, p, out):
    out[0] = p[0] * v - z[0] / p[1]


MAXWELL = Effect(
    name="maxwell",
    summary="A spring in series with a dashpot, without any gradient.",
    text="z; z' = k x' - z / tau",
    latex="z",
    parameters=(
        _parameter("maxwell_stiffness", lambda m, a, w: 0.0, lambda m, a, w: m * w * w),
        _parameter("maxwell_time", lambda m, a, w: 0.1 / w, lambda m, a, w: 3.0 / w),
    ),
    force=_maxwell_force,
    n_states=1,
    state_rate=_maxwell_rate,
)


@numba.njit
def _lag_force(x, v, direction, z, p):
    return p[0] * z[0]


@numba.njit
def _lag_rate(x, v, direction, z, p, out):
    out[0] = v - direction * v * z[0] / p[1]


LAG = Effect(
    name="lag",
    summary="Dahl friction by its rate, without any gradient: the way over which it builds up is the second parameter.",
    text="k z; z' = x' - |x'| z / way",
    latex="k z",
    parameters=(
        _parameter("lag_stiffness", lambda m, a, w: 0.0, lambda m, a, w: m * w * w),
        _parameter("lag_way", lambda m, a, w: 0.01 * a, lambda m, a, w: a),
    ),
    force=_lag_force,
    n_states=1,
    state_rate=_lag_rate,
)


@numba.njit
def _sinh_force(x, v, direction, z, p):
    return p[0] * p[1] * np.sinh(x / p[1])


SINH = Effect(
    name="sinh_stiffness",
    summary="A spring that stiffens exponentially, without gradient.",
    text="k u sinh(x / u)",
    latex="k u",
    parameters=(
        _parameter("sinh_stiffness", lambda m, a, w: 0.0, lambda m, a, w: m * w * w),
        _parameter("sinh_width", lambda m, a, w: 0.5 * a, lambda m, a, w: 2.0 * a),
    ),
    force=_sinh_force,
)


@numba.njit
def _quartic_mass(x, p):
    return p[0] * x**4


@numba.njit
def _quartic_mass_gradient(x, p, out):
    out[0] = 4.0 * p[0] * x**3
    out[1] = x**4


@numba.njit
def _quartic_mass_force(x, v, direction, z, p):
    return 2.0 * p[0] * x**3 * v**2


FOLLOWER = Effect(
    name="follower",
    summary="A mass on a link that moves along with the square of the displacement squared; no gradient of its force.",
    text="m4 (x^4 x'' + 2 x^3 x'^2)",
    latex="m_4",
    parameters=(_parameter("follower", lambda m, a, w: 0.0, lambda m, a, w: m / a**4),),
    force=_quartic_mass_force,
    added_mass=_quartic_mass,
    added_mass_gradient=_quartic_mass_gradient,
)


@numba.njit
def _stop_force(x, v, direction, z, p):
    return p[0] * (x - p[1]) if x > p[1] else 0.0


@numba.njit
def _stop_regime(x, v, direction, z, p):
    return 1 if x > p[1] or (x == p[1] and direction > 0.0) else 0


STOP = Effect(
    name="one_stop",
    summary="A stop on one side, with a label of its branches and without gradient.",
    text="k max(x - g, 0)",
    latex="k",
    parameters=(
        _parameter("stop_stiffness", lambda m, a, w: 0.0, lambda m, a, w: m * w * w),
        _parameter("stop_gap", lambda m, a, w: 0.0, lambda m, a, w: a),
    ),
    force=_stop_force,
    regime=_stop_regime,
)
