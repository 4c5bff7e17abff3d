"""Free decays by an adaptive Runge-Kutta method of order 8 with every kink and turning point located exactly.

The coefficients are SciPy's (Dormand and Prince's 8(5,3) pair). Steps end at the wanted instants, so no interpolation
is involved; a step that passes a turning point or a kink is repeated with the length at which it just reaches it.
Friction, sliders and contact are switched there and nowhere smoothed.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
from laws import (
    DAHL_F,
    DAHL_K,
    JOINT_CHI,
    JOINT_F,
    JOINT_K,
    MASS,
    SLIDER_F,
    SLIDER_K,
    STATES,
    Z_A,
    Z_BETA,
    Z_GAMMA,
    Z_K,
    Z_N,
    K,
    acceleration,
    next_kink,
    write_rates,
)
from scipy.integrate import DOP853

# Code kept on disk is renewed when this file changes, not when the force laws do that it was compiled with.
_LAWS = max(Path(__file__).with_name(name).stat().st_mtime for name in ("laws.py", "systems.py"))
for _kept in Path(__file__).with_name("__pycache__").glob("*.nbi"):
    if _kept.name.startswith(("motion.", "laws.")) and _kept.stat().st_mtime < _LAWS:
        _kept.unlink(missing_ok=True)

_A = np.ascontiguousarray(DOP853.A[:12, :12])
_B = np.ascontiguousarray(DOP853.B)
_C = np.ascontiguousarray(DOP853.C[:12])
_E3 = np.ascontiguousarray(DOP853.E3[:12])
_E5 = np.ascontiguousarray(DOP853.E5[:12])

TOLERANCE = 1e-11
"""Error of a step relative to the amplitude of the moment."""
BED_TOLERANCE = 1e-9
"""The same with an Iwan bed, whose many small kinks are not located one by one."""
SLIDERS = 4000
"""Sliders of an Iwan bed; its force then differs from the continuous one by less than 1e-8 of its stiffness."""
MAXIMUM_TURNS = 4000


class Decay(NamedTuple):
    """The motion at the wanted instants, the turning points, and whether the motion came to rest by friction.

    ``rates`` holds velocity and acceleration, each (n,): zero before the release and after the motion has come to rest.
    """

    displacement: np.ndarray
    rates: np.ndarray
    turn_times: np.ndarray
    turn_values: np.ndarray
    stuck: bool


def simulate(p: np.ndarray, release: float, times: np.ndarray, *, tolerance: float | None = None) -> Decay:
    """Release a system from rest and return its motion.

    Parameters
    ----------
    p : ndarray
        Parameters, see `systems.pack`.
    release : float
        Displacement of the release [m], positive. Hysteretic elements are loaded from their unstressed state to it.
    times : ndarray, shape (n,)
        Ascending instants after the release [s]; at negative ones the system is still held.
    tolerance : float, optional
        Error of a step relative to the amplitude of the moment.

    Returns
    -------
    Decay

    Raises
    ------
    FloatingPointError
        If the motion leaves five times the release amplitude, which happens to springs that soften too much.
    """
    has_bed = p[JOINT_K] != 0.0
    limit = tolerance if tolerance is not None else (BED_TOLERANCE if has_bed else TOLERANCE)
    bed = _make_bed(p, SLIDERS if has_bed else 1)
    motion = np.zeros((3, times.size))
    turns = np.empty((2, MAXIMUM_TURNS))
    y = np.array([release, 0.0, _load_hysteresis(p, release), _load_contact(p, release), 0.0])
    count, status = _integrate(times, p, y, bed, limit, motion, turns)
    if status == 2:
        raise FloatingPointError("the motion left five times the release amplitude or needs too many turning points.")
    return Decay(motion[0], motion[1:], turns[0, :count].copy(), turns[1, :count].copy(), status == 1)


def _make_bed(p: np.ndarray, sliders: int) -> np.ndarray:
    """Return an unstressed Iwan bed: rows strength, stiffness and force of each slider, then the tables of a stroke.

    The density of the strengths is a power ``chi`` up to the largest; each slider stands for an equal share of the
    stiffness and slips at the mean displacement of its share, which makes total stiffness and strength exact.
    """
    bed = np.zeros((7, sliders + 1))
    if p[JOINT_K] == 0.0:
        return bed
    chi = p[JOINT_CHI]
    largest = p[JOINT_F] * (chi + 2.0) / (p[JOINT_K] * (chi + 1.0))
    share = np.linspace(0.0, 1.0, sliders + 1)
    # Mean of phi over a share, with phi = largest * share^(1/(chi+1)).
    power = 1.0 / (chi + 1.0)
    means = largest * np.diff(share ** (power + 1.0)) * sliders / (power + 1.0)
    bed[1, :sliders] = p[JOINT_K] / sliders
    bed[0, :sliders] = bed[1, :sliders] * means
    return bed


@numba.njit(cache=True)
def _start_stroke(x, direction, bed):
    """Tabulate the force of the bed for a stroke that begins at ``x`` with the sliders' forces in row 2."""
    n = bed.shape[1] - 1
    distance = np.empty(n)
    is_sorted = True
    for i in range(n):
        distance[i] = (bed[0, i] - direction * bed[2, i]) / bed[1, i]
        if i > 0 and distance[i] < distance[i - 1]:
            is_sorted = False
    order = np.arange(n) if is_sorted else np.argsort(distance)
    stiffness, slipped, total = 0.0, 0.0, 0.0
    for i in range(n):
        stiffness += bed[1, i]
        total += bed[2, i]
    for j in range(n):
        i = order[j]
        bed[3, j] = distance[i]
        bed[4, j] = slipped
        bed[5, j] = stiffness
        slipped += bed[1, i] * distance[i]
        stiffness -= bed[1, i]
    bed[3, n] = np.inf
    bed[4, n] = slipped
    bed[5, n] = 0.0
    bed[6, 0] = x
    bed[6, 1] = total


@numba.njit(cache=True)
def _end_stroke(x, direction, bed):
    """Bring every slider of the bed to where the stroke has ended."""
    moved = x - bed[6, 0]
    for i in range(bed.shape[1] - 1):
        force = bed[2, i] + bed[1, i] * moved
        bed[2, i] = direction * min(direction * force, bed[0, i])


def _load_contact(p: np.ndarray, release: float) -> float:
    """Return the deflection of a Dahl contact after slow loading; a Maxwell element has relaxed by then."""
    if p[DAHL_K] == 0.0:
        return 0.0
    way = p[DAHL_F] / p[DAHL_K]
    return float(-way * math.expm1(-release / way))


@numba.njit(cache=True)
def _load_hysteresis(p, release):
    """Return the Bouc-Wen displacement z after slow loading from zero to ``release``."""
    if p[Z_K] == 0.0:
        return 0.0
    z, n = 0.0, 2000
    # Classical Runge-Kutta in the displacement, finer at the start: x = release * (i / n)^3.
    for i in range(n):
        x0, x1 = release * (i / n) ** 3, release * ((i + 1) / n) ** 3
        h = x1 - x0
        k1 = _loading_slope(z, p)
        k2 = _loading_slope(z + 0.5 * h * k1, p)
        k3 = _loading_slope(z + 0.5 * h * k2, p)
        k4 = _loading_slope(z + h * k3, p)
        z += h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
    return z


@numba.njit(cache=True)
def _loading_slope(z, p):
    return p[Z_A] - (p[Z_BETA] + p[Z_GAMMA]) * abs(z) ** p[Z_N]


@numba.njit(cache=True)
def _step(t, h, y, direction, probe, side, slider, bed, p, stages, scale, out):
    """Write the state after a step of length ``h`` into ``out`` and return the error in units of the tolerance."""
    for s in range(12):
        out[:] = y
        for j in range(s):
            for i in range(STATES):
                out[i] += h * _A[s, j] * stages[j, i]
        stages[s, 0] = out[1]
        stages[s, 1] = acceleration(t + _C[s] * h, out, direction, probe, slider, bed, p)
        write_rates(out, direction, side, p, stages[s])
    fifth, third = 0.0, 0.0
    for i in range(STATES):
        change, e5, e3 = 0.0, 0.0, 0.0
        for s in range(12):
            change += _B[s] * stages[s, i]
            e5 += _E5[s] * stages[s, i]
            e3 += _E3[s] * stages[s, i]
        out[i] = y[i] + h * change
        fifth += (e5 / scale[i]) ** 2
        third += (e3 / scale[i]) ** 2
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return h * fifth / math.sqrt(3.0 * (fifth + 0.01 * third))


@numba.njit(cache=True)
def _gauge(kind, y, direction, target, side):
    """Return a quantity that is positive before the event: turning point, kink of x, zero of z."""
    if kind == 0:
        return direction * y[1]
    if kind == 1:
        return direction * (target - y[0])
    return side * y[2]


@numba.njit(cache=True)
def _reach(kind, target, t, h, y, direction, probe, side, slider, bed, p, stages, scale, out):
    """Return the length of a step, at most ``h``, at which an event is just reached (Illinois method)."""
    low, high = 0.0, h
    g_low = _gauge(kind, y, direction, target, side)
    _step(t, high, y, direction, probe, side, slider, bed, p, stages, scale, out)
    g_high = _gauge(kind, out, direction, target, side)
    last = 0
    for _ in range(60):
        if high - low <= 1e-15 * h or g_high == 0.0:
            break
        if g_low > 0.0:
            middle = (low * g_high - high * g_low) / (g_high - g_low)
        else:
            middle = 0.5 * (low + high)
        if not low < middle < high:
            middle = 0.5 * (low + high)
        _step(t, middle, y, direction, probe, side, slider, bed, p, stages, scale, out)
        g = _gauge(kind, out, direction, target, side)
        if g > 0.0:
            low, g_low = middle, g
            if last == 1:
                g_high *= 0.5
            last = 1
        else:
            high, g_high = middle, g
            if last == -1:
                g_low *= 0.5
            last = -1
    _step(t, high, y, direction, probe, side, slider, bed, p, stages, scale, out)
    return high


@numba.njit(cache=True)
def _probe(x, direction, target, release):
    return 0.5 * (x + target) if math.isfinite(target) else x + direction * release


@numba.njit(cache=True)
def _integrate(times, p, y, bed, tolerance, motion, turns):
    """Integrate from the state at the release; return the number of turning points and 0, 1 (at rest) or 2 (failed)."""
    release, z_release = y[0], y[2]
    omega = math.sqrt(p[K] / p[MASS])
    longest, margin = 0.3 / omega, 1e-13 * release
    out, mid = np.empty(STATES), np.empty(STATES)
    scale, stages, slider = np.empty(STATES), np.zeros((12, STATES)), np.zeros(3)
    direction, side = -1.0, 1.0
    slider[0] = release
    slider[1] = min(p[SLIDER_K] * release, p[SLIDER_F])
    if p[SLIDER_K] != 0.0:
        slider[2] = release - (p[SLIDER_F] + slider[1]) / p[SLIDER_K]
    if p[JOINT_K] != 0.0:
        _end_stroke(release, 1.0, bed)
        _start_stroke(release, direction, bed)
    turns[0, 0], turns[1, 0] = 0.0, release
    count, t, h = 1, 0.0, 0.01 / omega
    target = next_kink(y[0], direction, margin, slider, p)
    probe = _probe(y[0], direction, target, release)
    stuck = acceleration(0.0, y, direction, probe, slider, bed, p) >= 0.0
    i = 0
    while i < times.size and times[i] <= 0.0:
        motion[0, i] = release
        i += 1
    while i < times.size:
        if stuck:
            motion[0, i] = y[0]
            i += 1
            continue
        size = max(math.hypot(y[0], y[1] / omega), 1e-5 * release)
        scale[:] = tolerance * size
        scale[1] *= omega
        scale[2] = tolerance * size * max(abs(z_release) / release, 1e-300) if z_release != 0.0 else 1.0
        whole = min(h, longest)
        ends = times[i] - t <= whole
        use = times[i] - t if ends else whole
        error = _step(t, use, y, direction, probe, side, slider, bed, p, stages, scale, out)
        if not math.isfinite(error):
            if use < 1e-9 / omega:
                return count, 2
            h = 0.1 * use
            continue
        factor = min(5.0, max(0.2, 0.9 * max(error, 1e-12) ** -0.125))
        if error > 1.0 and use > 1e-9 / omega:
            h = factor * use
            continue
        # A step cut short by a wanted instant says little about how long the next may be.
        h = max(whole, factor * use) if ends else factor * use
        # The first of the events within the step: 0 a turning point, 1 a kink, 2 a zero of z.
        event = -1
        length = use
        if direction * out[1] <= 0.0:
            event = 0
            length = _reach(0, 0.0, t, use, y, direction, probe, side, slider, bed, p, stages, scale, out)
        if direction * (target - out[0]) <= 0.0:
            event = 1
            length = _reach(1, target, t, length, y, direction, probe, side, slider, bed, p, stages, scale, out)
        if p[Z_K] != 0.0 and side * out[2] <= 0.0:
            event = 2
            length = _reach(2, 0.0, t, length, y, direction, probe, side, slider, bed, p, stages, scale, mid)
            out[:] = mid
        if not abs(out[0]) < 5.0 * release:
            return count, 2
        ends = ends and length == use
        t = times[i] if ends else t + length
        y[:] = out
        if ends:
            motion[0, i] = y[0]
            motion[1, i] = y[1]
            motion[2, i] = acceleration(t, y, direction, probe, slider, bed, p)
            i += 1
        if event == -1:
            continue
        if event == 2:
            side = -side
            y[2] = 0.0
        if event == 1:
            y[0] = target
        if event == 0 or (event == 1 and direction * y[1] <= 0.0):
            if count >= turns.shape[1]:
                return count, 2
            y[1] = 0.0
            turns[0, count], turns[1, count] = t, y[0]
            count += 1
            if p[SLIDER_K] != 0.0:
                force = slider[1] + p[SLIDER_K] * (y[0] - slider[0])
                slider[1] = direction * min(direction * force, p[SLIDER_F])
                slider[0] = y[0]
                slider[2] = y[0] - direction * (p[SLIDER_F] + direction * slider[1]) / p[SLIDER_K]
            if p[JOINT_K] != 0.0:
                _end_stroke(y[0], direction, bed)
                _start_stroke(y[0], -direction, bed)
            direction = -direction
        target = next_kink(y[0], direction, margin, slider, p)
        probe = _probe(y[0], direction, target, release)
        if y[1] == 0.0:
            stuck = direction * acceleration(t, y, direction, probe, slider, bed, p) <= 0.0
    return count, 1 if stuck else 0
