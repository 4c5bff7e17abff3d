"""Force columns of the library's effects along a smoothed decay: one column per effect and shape parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from .signals import Array, Signal

GAPS = tuple(np.round(np.arange(0.1, 0.91, 0.08), 2))
"""Freeplay gaps offered, in release amplitudes."""
SLIPS = tuple(np.round(np.geomspace(0.015, 0.9, 14), 4))
"""Slip displacements of sliders offered, in release amplitudes."""
IWAN_EXPONENTS = (-0.8, -0.5, -0.2)
BOUC_WEN_SHAPES = ((1.0, 0.5), (1.0, 0.9), (2.0, 0.5))
"""Exponent n and beta / (beta + gamma) of the Bouc-Wen columns."""
PENDULUM_AMPLITUDE = 0.03
"""Below this angle [rad] a pendulum differs from a cubic spring by less than 1e-4 of either: it is not offered."""

NOT_NEGATIVE = frozenset(
    {
        "pendulum_stiffness",
        "freeplay",
        "coulomb_friction",
        "quadratic_damping",
        "cubic_damping",
        "displacement_dependent_damping",
        "jenkins",
        "iwan",
        "bouc_wen",
    }
)
"""Effects whose coefficient the library bounds from below by zero."""

Columns = dict[str, list[Array]]
"""Effect to its columns, one per shape parameter offered."""


def memoryless_columns(signal: Signal, amplitude: float) -> Columns:
    """Return the forces of all memoryless effects.

    Parameters
    ----------
    signal : Signal
        One decay.
    amplitude : float
        Unit of displacement [m or rad], common to the batch; the unit of time is one over the signal's own frequency.

    Returns
    -------
    dict
        Effect name to columns (n,) [-], over all rows of the signal.
    """
    u = signal.displacement / amplitude
    w = signal.velocity / (amplitude * signal.angular_frequency)
    columns = {
        "linear_stiffness": [u],
        "viscous_damping": [w],
        "quadratic_stiffness": [u * u],
        "cubic_stiffness": [u**3],
        "quintic_stiffness": [u**5],
        "bilinear_stiffness": [np.maximum(u, 0.0)],
        "freeplay": [np.sign(u) * np.maximum(np.abs(u) - gap, 0.0) for gap in GAPS],
        "coulomb_friction": [np.sign(w)],
        "quadratic_damping": [w * np.abs(w)],
        "cubic_damping": [w**3],
        "displacement_dependent_damping": [u * u * w],
    }
    if amplitude > PENDULUM_AMPLITUDE:
        columns["pendulum_stiffness"] = [np.sin(signal.displacement) / amplitude - u]
    return columns


def hysteretic_columns(signal: Signal, amplitude: float) -> Columns:
    """Return the forces of the effects with memory, each of unit stiffness where it does not slip.

    A Jenkins element is the stop operator of its slip displacement; an Iwan bed is a sum of stops; the Bouc-Wen
    state is integrated along the displacement, on which alone it depends.
    """
    u = signal.displacement / amplitude
    stops = np.array([_stop(u, slip) for slip in SLIPS])
    beds = []
    for exponent in IWAN_EXPONENTS:
        ends = range(6, len(SLIPS) + 1)
        beds += [_bed_weights(np.array(SLIPS[:end]), exponent) @ stops[:end] for end in ends]
    loops = [_bouc_wen(u, slip, n, share) for n, share in BOUC_WEN_SHAPES for slip in SLIPS[4:]]
    return {"jenkins": list(stops), "iwan": beds, "bouc_wen": loops}


def _bed_weights(slips: Array, exponent: float) -> Array:
    """Return the stiffness of each slider of a bed whose density of stiffness over slip is a power law."""
    edges = np.concatenate([[0.0], np.sqrt(slips[1:] * slips[:-1]), [slips[-1]]])
    return np.diff((edges / edges[-1]) ** (exponent + 1.0))


@numba.njit(cache=True)
def _stop(u: Array, slip: float) -> Array:
    out = np.empty_like(u)
    z = min(max(u[0], -slip), slip)
    out[0] = z
    for i in range(1, u.size):
        z = min(max(z + u[i] - u[i - 1], -slip), slip)
        out[i] = z
    return out


@numba.njit(cache=True)
def _bouc_wen(u: Array, slip: float, exponent: float, share: float) -> Array:
    """Integrate dz = du (1 - |z / slip|^n (share sign(z du) + 1 - share)); beta = share / slip^n."""
    out = np.empty_like(u)
    z = 0.0
    steps = 100
    for _ in range(steps):
        z = _advance(z, u[0] / steps, slip, exponent, share)
    out[0] = z
    for i in range(1, u.size):
        du = u[i] - u[i - 1]
        parts = max(int(4.0 * abs(du) / slip), 1) * 2
        for _ in range(parts):
            z = _advance(z, du / parts, slip, exponent, share)
        out[i] = z
    return out


@numba.njit(cache=True)
def _advance(z: float, du: float, slip: float, exponent: float, share: float) -> float:
    middle = z + 0.5 * du * _rate(z, du, slip, exponent, share)
    return z + du * _rate(middle, du, slip, exponent, share)


@numba.njit(cache=True)
def _rate(z: float, du: float, slip: float, exponent: float, share: float) -> float:
    sign = 1.0 if z * du >= 0.0 else -1.0
    return 1.0 - (abs(z) / slip) ** exponent * (share * sign + 1.0 - share)


def common_amplitude(signals: Sequence[Signal]) -> float:
    """Return the unit of displacement of a batch: the median release amplitude."""
    return float(np.median([signal.amplitude for signal in signals]))
