"""Compiled: linear systems of a few unknowns, in a tenth of the time that the libraries take for them."""

from __future__ import annotations

import math

from ..._common.checks import FloatArray
from ...simulation.curves import compiled

_LEAST_PIVOT = 1e-12  # of a system whose diagonal is 1


@compiled
def factorise(block: FloatArray, n: int, least: float) -> float:
    """Replace a symmetric matrix (n, n) by its Cholesky factor; return the logarithm of its determinant, or nan.

    Pivots are at least ``least``; where that is zero, a matrix that is not positive has no factor.
    """
    logarithm = 0.0
    for i in range(n):
        for j in range(i + 1):
            total = block[i, j]
            for k in range(j):
                total -= block[i, k] * block[j, k]
            if i > j:
                block[i, j] = total / block[j, j]
                continue
            pivot = max(total, least)
            if not pivot > 0.0:
                return math.nan
            block[i, i] = math.sqrt(pivot)
            logarithm += math.log(pivot)
    return logarithm


@compiled
def solve_by(factor: FloatArray, n: int, right: FloatArray) -> None:
    """Solve a system (n, n) for each column of ``right`` in place, by its Cholesky factor."""
    for c in range(right.shape[1]):
        for i in range(n):
            for k in range(i):
                right[i, c] -= factor[i, k] * right[k, c]
            right[i, c] /= factor[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                right[i, c] -= factor[k, i] * right[k, c]
            right[i, c] /= factor[i, i]


@compiled
def solve_in_place(block: FloatArray, right: FloatArray) -> float:
    """Solve a symmetric positive system with a diagonal of ones in place; return the logarithm of its determinant.

    ``block`` (n, n) becomes its factor, ``right`` (n, c) the solutions.
    """
    n = right.shape[0]
    logarithm = factorise(block, n, _LEAST_PIVOT)
    solve_by(block, n, right)
    return logarithm


__all__ = ["factorise", "solve_by", "solve_in_place"]
