"""Free decays by SciPy's DOP853 with its own events, for the second generator; slow, and independent of `motion.py`.

One call of the solver for each piece of the motion between two turning points or kinks, in units of the release
amplitude and of the linear angular frequency, at a relative tolerance of 1e-11.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from second_laws import TERMS

TOLERANCE = 1e-11
MOST_PIECES = 6000


class Motion(NamedTuple):
    """Displacement, velocity and acceleration at the wanted instants, (3, n); turning points as times and values."""

    values: np.ndarray
    turn_times: np.ndarray
    turn_values: np.ndarray
    stuck: bool


def decay(
    parameters: Mapping[str, float],
    effects: Sequence[str],
    release: float,
    times: np.ndarray,
    *,
    until: float = 0.0,
) -> Motion:
    """Release an oscillator with the given effects from rest.

    Parameters
    ----------
    parameters : mapping of str to float
        SI units, ``mass`` among them.
    effects : sequence of str
        Keys of `second_laws.TERMS` beside spring and damper.
    release : float
        Displacement at the release [m], positive; hysteresis has been loaded slowly up to it.
    times : ndarray, shape (n,)
        Ascending instants after the release [s]; held at negative ones.
    until : float, default 0
        Stop where two successive turning points are closer than twice this share of the release, and leave NaN.

    Returns
    -------
    Motion

    Raises
    ------
    FloatingPointError
        If the motion leaves three times the release or comes in too many pieces, or the solver gives up.
    """
    terms = [TERMS[name](parameters, release) for name in ("linear", "viscous", *effects)]
    states = [term for term in terms if term.rate]
    mass, omega = parameters["mass"], math.sqrt(parameters["linear_stiffness"] / parameters["mass"])
    unit = mass * omega**2 * release

    def pull(y: np.ndarray, s: float, at: float) -> float:
        x, v = y[0] * release, y[1] * release * omega
        total, place, heavier = 0.0, 2, mass
        for term in terms:
            heavier += term.mass(x) if term.mass else 0.0
            if term.rate:
                total += term.force(x, y[place] * release, s, at)
                place += 1
            else:
                total += term.force(x, v, s, at)
        return -total / unit * mass / heavier

    def slope(t: float, y: np.ndarray, s: float, at: float) -> list[float]:
        v = y[1] * release * omega
        rates = [term.rate(v, z * release, s) / (release * omega) for term, z in zip(states, y[2:], strict=True)]
        return [y[1], pull(y, s, at), *rates]

    wanted = times * omega
    values = np.full((3, times.size), np.nan)
    values[:, wanted <= 0.0] = [[1.0], [0.0], [0.0]]
    y, t, s = np.array([1.0, 0.0, *(term.loaded / release for term in states)]), 0.0, -1.0
    turns = [(0.0, 1.0)]
    stuck = False
    for _ in range(MOST_PIECES):
        if wanted.size == 0 or t >= wanted[-1]:
            break
        ahead = [s * (kink / release - y[0]) for term in terms for kink in term.kinks]
        edge = y[0] + s * min((gap for gap in ahead if gap > 1e-12), default=10.0)
        at = 0.5 * (y[0] + edge) * release
        if y[1] == 0.0 and s * pull(y, s, at) <= 0.0:
            stuck = True
            values[:, wanted > t] = [[y[0]], [0.0], [0.0]]
            break

        def turning(t: float, y: np.ndarray, s: float, at: float) -> float:
            return s * y[1]

        def leaving(t: float, y: np.ndarray, s: float, at: float, edge: float = edge) -> float:
            return s * (edge - y[0])

        turning.terminal = leaving.terminal = True  # type: ignore[attr-defined]
        turning.direction = leaving.direction = -1.0  # type: ignore[attr-defined]
        run = solve_ivp(
            slope,
            (t, wanted[-1]),
            y,
            "DOP853",
            args=(s, at),
            events=(turning, leaving),
            dense_output=True,
            rtol=TOLERANCE,
            atol=TOLERANCE * max(math.hypot(y[0], y[1]), 1e-4),
            max_step=0.4,
        )
        if not run.success or not np.all(np.isfinite(run.y[:, -1])) or abs(run.y[0, -1]) > 3.0:
            raise FloatingPointError("the solver gave up, or the motion left three times the release amplitude.")
        inside = (wanted > t) & (wanted <= run.t[-1])
        if inside.any():
            held = run.sol(wanted[inside])
            values[:2, inside] = held[:2]
            values[2, inside] = [pull(column, s, at) for column in held.T]
        y, t = run.y[:, -1].copy(), float(run.t[-1])
        if run.t_events[0].size:
            y[1] = 0.0
            turns.append((t, y[0]))
            for term in terms:
                term.turn(y[0] * release, s)
            if abs(turns[-1][1] - turns[-2][1]) < 2.0 * until:
                break
            s = -s
        elif run.t_events[1].size:
            y[0] = edge
    else:
        raise FloatingPointError("the motion came in too many pieces.")
    scale = release * np.array([[1.0], [omega], [omega**2]])
    at_turns = np.array(turns)
    return Motion(values * scale, at_turns[:, 0] / omega, at_turns[:, 1] * release, stuck)
