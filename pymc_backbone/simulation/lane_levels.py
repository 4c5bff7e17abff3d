"""From the cycles of lanes to their curves at the levels, with estimates of what is lost on the way."""

from __future__ import annotations

import math

import numpy as np

from .._common.checks import FloatArray, IntArray
from .lane_stages import LANES
from .switches import plain

DISTANCE, VALUES, RATIO, N_ROWS = 0, 1, 4, 5
"""Rows of a cycle: log of its amplitude over the level; frequency, damping, offset; starting peak over amplitude."""
LEAST_DAMPING = 0.003
"""The error of a damping is measured by itself, or by this where it is smaller."""
_SLOW = 0.3  # share of the last term but one that may be left where the terms fall slowly
_FAR, _CAREFULLY_FAR = 0.02, 1e-5  # how far from its level a cycle may be


@plain
def _relative(observable: int, value: float) -> float:
    """Return what the error of an observable is measured by."""
    if observable == 0:
        return abs(value)
    return min(max(abs(value), LEAST_DAMPING), 1.0) if observable == 1 else 1.0


@plain
def read_off_carefully(
    levels: FloatArray, cycles: FloatArray, before: FloatArray, values: FloatArray, errors: FloatArray
) -> None:
    """Write values on the levels, along the straight line through the two cycles at each."""
    for k in range(levels.size):
        beside = k - 1 if k > 0 else min(1, levels.size - 1)
        width = math.log(levels[k] / levels[beside]) if beside != k else 0.1
        for o in range(3):
            for i in range(LANES):
                a, b = cycles[k, DISTANCE, i], before[k, DISTANCE, i]
                y = cycles[k, VALUES + o, i]
                rise = (y - before[k, VALUES + o, i]) / (a - b) if abs(a - b) > 1e-9 else 0.0
                across = (y - cycles[beside, VALUES + o, i]) / width if beside != k else 0.0
                value = y - a * rise
                bend = abs(a * b) * (abs(rise) + abs(rise - across) / abs(width))
                error = bend / _relative(o, value)
                values[o, k, i] = value
                if not error < errors[i]:
                    errors[i] = error
        for i in range(LANES):
            if not abs(cycles[k, DISTANCE, i]) < _CAREFULLY_FAR:
                errors[i] = np.inf


@plain
def _nearest(levels: FloatArray, k: int, chosen: IntArray) -> None:
    """Write which levels are nearest to level ``k``, itself first."""
    chosen[0] = k
    low, high = k - 1, k + 1
    for j in range(1, chosen.size):
        if high < levels.size and (low < 0 or levels[high] / levels[k] <= levels[k] / levels[low]):
            chosen[j] = high
            high += 1
        else:
            chosen[j] = low
            low -= 1


@plain
def read_off_between(
    levels: FloatArray, cycles: FloatArray, chosen: IntArray, at: FloatArray, inverse: FloatArray, y: FloatArray,
    values: FloatArray, errors: FloatArray,
) -> None:  # fmt: skip
    """Write values on the levels, along the polynomial through the cycles of the nearest levels (Newton's form)."""
    count = chosen.size
    for k in range(levels.size):
        _nearest(levels, k, chosen)
        for j in range(count):
            t = math.log(levels[chosen[j]] / levels[k])
            for i in range(LANES):
                at[j, i] = t + cycles[chosen[j], DISTANCE, i]
        for m in range(1, count):
            for j in range(m, count):
                for i in range(LANES):
                    inverse[m * count + j, i] = 1.0 / (at[j, i] - at[j - m, i])
        for o in range(3):
            for j in range(count):
                for i in range(LANES):
                    y[j, i] = cycles[chosen[j], VALUES + o, i]
            for m in range(1, count):
                for j in range(count - 1, m - 1, -1):
                    for i in range(LANES):
                        y[j, i] = (y[j, i] - y[j - 1, i]) * inverse[m * count + j, i]
            for i in range(LANES):
                value, product, term, last = y[0, i], 1.0, 0.0, 0.0
                for j in range(1, count):
                    product *= -at[j - 1, i]
                    last = term
                    term = y[j, i] * product
                    value += term
                values[o, k, i] = value
                error = (abs(term) + _SLOW * abs(last)) / _relative(o, value)
                if not error < errors[i]:
                    errors[i] = error
        for i in range(LANES):
            if not abs(cycles[k, DISTANCE, i]) < _FAR:
                errors[i] = np.inf
