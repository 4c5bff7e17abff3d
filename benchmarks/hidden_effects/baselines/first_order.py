"""First-order (averaging, harmonic balance) contributions of every effect to the two backbones and the mid-line.

For ``x = a cos(theta)`` and a force f of an effect with coefficient 1, in units where linear stiffness, release
amplitude and frequency are 1:

- storage ``N(a) = 1/(pi a) * integral of f cos(theta)`` adds to ``mass (2 pi frequency)^2``,
- loss ``L(a) = E(a) / (pi a^2)``, E the energy per cycle, adds to ``decrement * mass (2 pi frequency)^2 / pi``,
- mid-line ``O(a)`` is the offset that the even harmonics of f bring about.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import j1

from .columns import PENDULUM_AMPLITUDE
from .signals import Array

GAPS = tuple(np.round(np.geomspace(0.04, 0.95, 24), 4))
SLIPS = tuple(np.round(np.geomspace(0.01, 1.2, 26), 5))
BED_SLIPS = tuple(np.round(np.geomspace(0.05, 6.0, 16), 4))
BED_EXPONENTS = (-0.85, -0.6, -0.35, -0.1)
BOUC_WEN_SLIPS = tuple(np.round(np.geomspace(0.05, 3.0, 14), 4))
BOUC_WEN_SHAPES = ((1.0, 0.5), (1.0, 1.0), (2.0, 0.5))
"""Exponent n and beta / (beta + gamma)."""

SECOND_ORDER = {
    "viscous_damping": (0.0, 0.0),
    "coulomb_friction": (1.4, -1.0),
    "quadratic_damping": (-0.8, 1.0),
    "cubic_damping": (-1.25, 2.0),
    "displacement_dependent_damping": (-9.2, 2.0),
}
"""What a damper of decay rate r, in a decay of rate R, adds beyond viscous damping: to the squared frequency the first
number times r R, to the mid-line the second times that of viscous damping, r R pi^2 / 4 (the exponent of r in the
amplitude). Without these x^2 x' and x'^3 are the same. The first numbers are those of cycles from peak to peak."""


@dataclass(frozen=True, eq=False)
class Contribution:
    """What an effect of coefficient 1 adds at the levels: storage, loss and offset, (l,) each."""

    storage: Array
    loss: Array
    offset: Array


def contributions(
    level: Array, speed: Array, amplitude: float, quadratic: float, rate: Array
) -> dict[str, list[Contribution]]:
    """Return the contributions of all effects, one per shape parameter.

    Parameters
    ----------
    level : (l,) array
        Amplitudes, in units of ``amplitude``.
    speed : (l,) array
        Frequency at the levels over that of the record.
    amplitude : float
        Unit of displacement [m or rad].
    quadratic : float
        Rough coefficient of a quadratic spring, from the mid-line. Its effect on frequency is of second order,
        ``-5/6 (coefficient a)^2``, and enters as this coefficient times a column.
    rate : (l,) array
        Measured decay rate over angular frequency. Of second order is also what damping that changes with amplitude
        does to the timing and the mid-line of a cycle; see `SECOND_ORDER`.

    Returns
    -------
    dict
        Effect name to contributions.
    """
    a, none = level, np.zeros_like(level)

    def stores(values: Array) -> Contribution:
        return Contribution(values, none, none)

    def loses(name: str, values: Array) -> Contribution:
        frequency, exponent = SECOND_ORDER[name]
        return Contribution(0.5 * frequency * rate * values, values, np.pi**2 / 8.0 * exponent * rate * values)

    effects = {
        "linear_stiffness": [stores(np.ones_like(a))],
        "viscous_damping": [loses("viscous_damping", speed)],
        "cubic_stiffness": [stores(0.75 * a**2)],
        "quintic_stiffness": [stores(0.625 * a**4)],
        "quadratic_stiffness": [Contribution(-5.0 / 6.0 * quadratic * a**2, none, -a / 3.0)],
        "bilinear_stiffness": [Contribution(np.full_like(a, 0.5), none, np.full_like(a, -0.25))],
        "freeplay": [stores(freeplay_storage(a, gap)) for gap in GAPS],
        "coulomb_friction": [loses("coulomb_friction", 4.0 / (np.pi * a))],
        "quadratic_damping": [loses("quadratic_damping", 8.0 / (3.0 * np.pi) * speed**2 * a)],
        "cubic_damping": [loses("cubic_damping", 0.75 * speed**3 * a**2)],
        "displacement_dependent_damping": [loses("displacement_dependent_damping", 0.25 * speed * a**2)],
        "jenkins": [Contribution(*slider(a, slip), none) for slip in SLIPS],
        "iwan": [Contribution(*bed(a, slip, power), none) for power in BED_EXPONENTS for slip in BED_SLIPS],
        "bouc_wen": [
            Contribution(*bouc_wen(a, slip, n, share), none) for n, share in BOUC_WEN_SHAPES for slip in BOUC_WEN_SLIPS
        ],
    }
    if amplitude > PENDULUM_AMPLITUDE:
        angle = amplitude * a
        effects["pendulum_stiffness"] = [stores(2.0 * j1(angle) / angle - 1.0)]
    return effects


def freeplay_storage(a: Array, gap: float) -> Array:
    """Return the describing function of contact after a gap."""
    ratio = np.minimum(gap / a, 1.0)
    return 2.0 / np.pi * (np.arccos(ratio) - ratio * np.sqrt(1.0 - ratio**2))


def slider(a: Array, slip: float | Array) -> tuple[Array, Array]:
    """Return storage and loss of an elastic slider with the given slip displacement."""
    ratio = np.minimum(slip / a, 1.0)
    stick = np.arccos(1.0 - 2.0 * ratio)
    return (stick - 0.5 * np.sin(2.0 * stick)) / np.pi, 4.0 / np.pi * ratio * (1.0 - ratio)


def bed(a: Array, slip: float, exponent: float) -> tuple[Array, Array]:
    """Return storage and loss of an Iwan bed that slips wholly at ``slip``, integrated over its sliders."""
    share = (np.arange(200) + 0.5) / 200
    slips = slip * share ** (1.0 / (exponent + 1.0))
    storage, loss = slider(a[:, None], slips[None, :])
    return storage.mean(axis=1), loss.mean(axis=1)


def bouc_wen(a: Array, slip: float, exponent: float, share: float) -> tuple[Array, Array]:
    """Return storage and loss of the Bouc-Wen loop, interpolated in amplitude over ``slip``."""
    grid, storage, loss = _bouc_wen_table(exponent, share)
    place = np.log(a / slip)
    return np.interp(place, grid, storage), np.interp(place, grid, loss)


@lru_cache
def _bouc_wen_table(exponent: float, share: float) -> tuple[Array, Array, Array]:
    """Integrate the loop ``dz = du (1 - |z|^n (share sign(z du) + 1 - share))`` over amplitudes."""
    grid = np.linspace(np.log(0.003), np.log(60.0), 120)
    amplitude = np.exp(grid)
    steps, cycles = 800, 3
    theta = np.linspace(0.0, 2 * np.pi * cycles, steps * cycles + 1)

    def rate(z: Array, du: Array) -> Array:
        sign = np.where(z * du >= 0.0, share, -share)
        return 1.0 - np.abs(z) ** exponent * (sign + 1.0 - share)

    z = np.tanh(amplitude)
    storage, loss = np.zeros_like(amplitude), np.zeros_like(amplitude)
    for i in range(steps * cycles):
        du = amplitude * (np.cos(theta[i + 1]) - np.cos(theta[i]))
        middle = z + 0.5 * du * rate(z, du)
        after = z + du * rate(middle, du)
        if i >= steps * (cycles - 1):
            force = 0.5 * (z + after)
            storage += force * (np.sin(theta[i + 1]) - np.sin(theta[i])) / (np.pi * amplitude)
            loss += force * du / (np.pi * amplitude**2)
        z = after
    return grid, storage, loss
