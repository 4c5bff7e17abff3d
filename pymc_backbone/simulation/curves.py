"""From turning points to cycles, and from cycles to curves over amplitude.

Rows of every table of cycles are amplitude, frequency [Hz], damping (logarithmic decrement) and offset; the last column
of the derivatives of a decay is the parameters', behind the one of the release amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np

from .._common.checks import FloatArray, IntArray

_NODES = 4  # a local cubic

_compiled = numba.njit(error_model="numpy")


def compiled[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function; to the type checker it stays what it was. Division by zero gives inf or nan."""
    result: Callable[P, R] = _compiled(function)
    return result


@compiled
def cycle_quantities(p0: float, q: float, p1: float, time: float) -> tuple[float, float, float, float]:
    """Return amplitude, frequency, damping and offset of the cycle p0, q, p1."""
    amplitude = 0.25 * (p0 + p1 - 2.0 * q)
    damping = 2.0 * math.log((p0 - q) / (p1 - q))
    return amplitude, 1.0 / time, damping, 0.5 * (0.5 * (p0 + p1) + q) / amplitude


@compiled
def cycle_slope(
    p0: float, q: float, p1: float, time: float, d0: float, dq: float, d1: float, dtime: float, offset: float
) -> tuple[float, float, float, float]:
    """Return the derivatives of the four cycle quantities along one column."""
    amplitude = 0.25 * (p0 + p1 - 2.0 * q)
    slope = 0.25 * (d0 + d1 - 2.0 * dq)
    damping = 2.0 * ((d0 - dq) / (p0 - q) - (d1 - dq) / (p1 - q))
    return slope, -dtime / (time * time), damping, (0.5 * (0.5 * (d0 + d1) + dq) - offset * slope) / amplitude


@compiled
def cycles_of_decay(
    turns: FloatArray, times: FloatArray, slopes: FloatArray, time_slopes: FloatArray, count: int, columns: int,
    values: FloatArray, jacobian: FloatArray,
) -> int:  # fmt: skip
    """Write the quantities of each peak-to-peak cycle and their derivatives; return how many there are."""
    i = 0 if turns[0] > turns[1] else 1
    cycles = 0
    while i + 2 < count:
        p0, q, p1 = turns[i], turns[i + 1], turns[i + 2]
        time = times[i + 2] - times[i]
        if not (p0 > q and p1 > q):
            break
        quantities = cycle_quantities(p0, q, p1, time)
        for o in range(4):
            values[cycles, o] = quantities[o]
        for c in range(columns):
            d0, dq, d1 = slopes[i, c], slopes[i + 1, c], slopes[i + 2, c]
            dtime = time_slopes[i + 2, c] - time_slopes[i, c]
            along = cycle_slope(p0, q, p1, time, d0, dq, d1, dtime, quantities[3])
            for o in range(4):
                jacobian[cycles, o, c] = along[o]
        cycles += 1
        i += 2
    return cycles


@compiled
def curve_at(
    cycles: FloatArray, cycle_slopes: FloatArray, found: int, level: float, k: int, columns: int, values: FloatArray,
    jacobian: FloatArray, weights: FloatArray, tilts: FloatArray,
) -> bool:  # fmt: skip
    """Write the three observables at ``level`` by the cubic in log amplitude through the nearest four cycles.

    ``weights`` and ``tilts`` are room for four numbers each. Returns whether the cycles enclose the level.
    """
    if found < 2 or not cycles[found - 1, 0] <= level <= cycles[0, 0]:
        return False
    low, high = 0, found - 1
    while high - low > 1:
        middle = (low + high) // 2
        if cycles[middle, 0] > level:
            low = middle
        else:
            high = middle
    size = min(_NODES, found)
    first = min(max(high - 2, 0), found - size)
    for i in range(1, size):
        if not cycles[first + i, 0] < cycles[first + i - 1, 0]:
            return False
    for i in range(size):
        weights[i] = 1.0
        for j in range(size):
            if j != i:
                width = math.log(cycles[first + i, 0] / cycles[first + j, 0])
                weights[i] *= math.log(level / cycles[first + j, 0]) / width
    for o in range(1, 4):
        total = 0.0
        for i in range(size):
            total += weights[i] * cycles[first + i, o]
        values[o - 1, k] = total
        if columns > 1:
            _curve_slopes(cycles, first, size, o, tilts)
        for c in range(1, columns):
            slope = 0.0
            for i in range(size):
                # A node that moves along the curve changes nothing: only what it leaves the curve by counts.
                moved = cycle_slopes[first + i, 0, c] / cycles[first + i, 0]
                slope += weights[i] * (cycle_slopes[first + i, o, c] - tilts[i] * moved)
            jacobian[o - 1, k, c - 1] = slope
    return True


@compiled
def _curve_slopes(cycles: FloatArray, first: int, size: int, column: int, out: FloatArray) -> None:
    """Write the slope along log amplitude, at each of ``size`` cycles, of the polynomial through all of them."""
    for i in range(size):
        out[i] = 0.0
        for j in range(size):
            if j == i:
                continue
            # Derivative of the Lagrange polynomial of node j at node i, applied to value j minus value i.
            term = 1.0 / math.log(cycles[first + j, 0] / cycles[first + i, 0])
            for m in range(size):
                if m != i and m != j:
                    term *= math.log(cycles[first + i, 0] / cycles[first + m, 0])
                    term /= math.log(cycles[first + j, 0] / cycles[first + m, 0])
            out[i] += term * (cycles[first + j, column] - cycles[first + i, column])


@compiled
def hermite(nodes: FloatArray, far: int, near: int, column: int, at: float) -> float:
    """Return the cubic through two rows of ``nodes`` (place first, value in ``column``, slope behind it)."""
    width = nodes[far, 0] - nodes[near, 0]
    value, slope, far_slope = nodes[near, column], nodes[near, column + 1], nodes[far, column + 1]
    secant = (nodes[far, column] - value) / width
    second = (3.0 * secant - 2.0 * slope - far_slope) / width
    third = (slope + far_slope - 2.0 * secant) / (width * width)
    e = at - nodes[near, 0]
    result: float = value + e * (slope + e * (second + e * third))
    return result


@compiled
def carry_jacobian(levels: FloatArray, nodes: FloatArray, status: IntArray, jacobian: FloatArray) -> None:
    """Take derivatives at cycles with log amplitudes ``nodes`` to the ``levels`` next to them.

    The slopes along log amplitude are those of the parabola through the cycle and the two nearest good ones.
    """
    good = np.empty(levels.size, np.int64)
    count = 0
    for k in range(levels.size):
        if status[k] == 0:
            good[count] = k
            count += 1
    if count < 3:
        return
    moves = np.empty(jacobian.shape)
    for g in range(count):
        k = good[g]
        first = min(max(g - 1, 0), count - 3)
        for i in range(3):
            for j in range(jacobian.shape[2]):
                moves[i, k, j] = 0.0
        for a in range(first, first + 3):
            other = good[a]
            if other == k:
                continue
            third = good[3 * first + 3 - a - g]
            # Derivative of the Lagrange polynomial of node `other` at node k, applied to the difference from k.
            weight = (nodes[k] - nodes[third]) / ((nodes[other] - nodes[k]) * (nodes[other] - nodes[third]))
            weight *= math.log(levels[k]) - nodes[k]
            for i in range(3):
                for j in range(jacobian.shape[2]):
                    moves[i, k, j] += weight * (jacobian[i, other, j] - jacobian[i, k, j])
    for g in range(count):
        k = good[g]
        for i in range(3):
            for j in range(jacobian.shape[2]):
                jacobian[i, k, j] += moves[i, k, j]
