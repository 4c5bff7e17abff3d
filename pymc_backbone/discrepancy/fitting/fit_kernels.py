"""Compiled: what a joint fit does at every point beside simulating, of arrays so small that calls would cost most."""

from __future__ import annotations

import math

import numpy as np

from ..._common.checks import BoolArray, FloatArray, IntArray
from ..._common.compiled import cached
from .small_systems import factorise, solve_by

_STRETCH = 2048  # values that are filtered before the next ones


@cached
def to_physical(
    own: FloatArray, amplitude: float, powers: IntArray, slips: IntArray, opposed: IntArray, most: float,
    values: FloatArray, slopes: FloatArray,
) -> None:  # fmt: skip
    """Write effect parameters (q,) and their derivatives (q, q) to coordinates that are within their limits.

    ``powers``, ``slips``, ``opposed`` (., 2) as in `Layout`; ``most`` is how many times another one of the last are.
    """
    q = own.size
    slopes[:] = 0.0
    for j in range(q):
        values[j] = own[j]
        slopes[j, j] = 1.0
    for i in range(opposed.shape[0]):
        j, other = opposed[i]
        values[j] = min(max(values[j], -values[other]), most * values[other])
    for i in range(powers.shape[0]):
        j, exponent = powers[i]
        factor = amplitude ** -values[exponent]
        values[j] *= factor
        slopes[j, j] = factor
        slopes[j, exponent] = -values[j] * math.log(amplitude)
    for i in range(slips.shape[0]):
        j, force = slips[i]
        strength, slip = values[j], values[force]
        values[j], values[force] = strength / (slip * amplitude), strength
        slopes[j, j], slopes[j, force] = 1.0 / (slip * amplitude), -values[j] / slip
        slopes[force, j], slopes[force, force] = 1.0, 0.0
    for i in range(opposed.shape[0]):  # one that another holds at its limit goes with that one
        j, other = opposed[i]
        for limit in (-1.0, most):
            if limit * (own[j] - limit * own[other]) > 0.0:
                for row in range(q):
                    slopes[row, other] += limit * slopes[row, j]
                    slopes[row, j] = 0.0


@cached
def put_together(
    residuals: FloatArray, jacobian: FloatArray, free: IntArray, slopes: FloatArray, common: FloatArray,
    apart: FloatArray, active: BoolArray, together: FloatArray,
) -> None:  # fmt: skip
    """Write derivatives to shared coordinates, to own values, and residuals (n, 8 + 2 q), side by side.

    ``jacobian`` (n, p + 5) to parameters and nuisances, ``slopes`` (q, q) of the parameters at ``free`` to the
    coordinates, ``common`` and ``apart`` (q,) what a shared coordinate and a deviation change of a specimen's.
    """
    q, p, size = free.size, jacobian.shape[1] - 5, active.size
    for i in range(residuals.size):
        row, simulated = together[i], jacobian[i]
        for k in range(2):
            row[q + k] = simulated[k] if active[k] else 0.0
        for k in range(5):
            row[q + 2 + k] = simulated[p + k] if active[2 + k] else 0.0
        for j in range(q):
            total = 0.0
            for k in range(q):
                total += simulated[free[k]] * slopes[k, j]
            row[j] = total * common[j]
            row[q + 7 + j] = total * apart[j] if active[7 + j] else 0.0
        row[q + size] = residuals[i]


@cached
def eliminate_own(
    mixed: FloatArray, own: FloatArray, own_gradient: FloatArray, free: BoolArray, damping: float,
    shared: FloatArray, gradient: FloatArray, scale: FloatArray, reduced: FloatArray, logarithms: FloatArray,
) -> bool:  # fmt: skip
    """Take what specimens' own free values explain from ``shared`` (q, q) and ``gradient`` (q,); False where singular.

    Of the free values of each, in their order at the front: ``scale`` (r, n), by which they are divided, and
    ``reduced`` (r, n, q + 1), the solutions for mixed blocks and gradient; ``logarithms`` (r,) of the determinants.
    """
    q, size = mixed.shape[1], own.shape[1]
    block = np.empty((size, size))
    for r in range(own.shape[0]):
        index = np.flatnonzero(free[r])
        n = index.size
        logarithms[r] = 0.0
        for i in range(n):
            scale[r, i] = 1.0 / math.sqrt(max(own[r, index[i], index[i]], 1e-300))
            logarithms[r] -= 2.0 * math.log(scale[r, i])
            for j in range(i + 1):
                block[i, j] = own[r, index[i], index[j]] * scale[r, i] * scale[r, j]
            block[i, i] += damping + 1e-12
            for j in range(q):
                reduced[r, i, j] = mixed[r, j, index[i]] * scale[r, i]
            reduced[r, i, q] = own_gradient[r, index[i]] * scale[r, i]
        logarithms[r] += factorise(block, n, 0.0)
        if math.isnan(logarithms[r]):
            return False
        solve_by(block, n, reduced[r])
        for j in range(q):
            for i in range(n):
                weight = mixed[r, j, index[i]] * scale[r, i]
                for c in range(q):
                    shared[j, c] -= weight * reduced[r, i, c]
                gradient[j] -= weight * reduced[r, i, q]
    return True


@cached
def _add(weight: float, given: FloatArray, total: FloatArray) -> None:
    """Add so much of ``given`` (n,) to ``total`` (n,)."""
    for i in range(total.size):
        total[i] += weight * given[i]


@cached
def filter_columns(taps: FloatArray, columns: FloatArray, result: FloatArray) -> None:
    """Write each column (n, c) after a filter of finite length, before the first row of which there is nothing.

    Value by value, whatever row it is in, so that several are taken at once; a stretch of them stays in the cache.
    """
    c = columns.shape[1]
    given, made = columns.reshape(-1), result.reshape(-1)
    for begin in range(0, made.size, _STRETCH):
        end = min(begin + _STRETCH, made.size)
        made[begin:end] = 0.0
        for k in range(taps.size):
            back = k * c
            first = max(begin, back)
            _add(taps[k], given[first - back : end - back], made[first:end])


@cached
def mean_rows(columns: FloatArray, together: int, result: FloatArray) -> None:
    """Write means (n, c) over ``together`` neighbouring rows each."""
    c = columns.shape[1]
    for i in range(result.shape[0]):
        for j in range(c):
            result[i, j] = columns[i * together, j]
        for k in range(1, together):
            for j in range(c):
                result[i, j] += columns[i * together + k, j]
        for j in range(c):
            result[i, j] /= together


__all__ = ["eliminate_own", "filter_columns", "mean_rows", "put_together", "to_physical"]
