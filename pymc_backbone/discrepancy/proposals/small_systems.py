"""Compiled: linear systems of a few unknowns, in a tenth of the time that the libraries take for them."""

from __future__ import annotations

import math

from ..._common.checks import FloatArray
from ...simulation.curves import compiled

_LEAST_PIVOT = 1e-12  # of a system whose diagonal is 1


@compiled
def solve_in_place(block: FloatArray, right: FloatArray) -> float:
    """Solve a symmetric positive system with a diagonal of ones in place; return the logarithm of its determinant.

    By Cholesky: ``block`` (n, n) becomes its factor, ``right`` (n, c) the solutions.
    """
    n, columns = right.shape
    logarithm = 0.0
    for i in range(n):
        for j in range(i + 1):
            total = block[i, j]
            for k in range(j):
                total -= block[i, k] * block[j, k]
            if i == j:
                block[i, i] = math.sqrt(max(total, _LEAST_PIVOT))
                logarithm += 2.0 * math.log(block[i, i])
            else:
                block[i, j] = total / block[j, j]
        for c in range(columns):
            total = right[i, c]
            for k in range(i):
                total -= block[i, k] * right[k, c]
            right[i, c] = total / block[i, i]
    for i in range(n - 1, -1, -1):
        for c in range(columns):
            total = right[i, c]
            for k in range(i + 1, n):
                total -= block[k, i] * right[k, c]
            right[i, c] = total / block[i, i]
    return logarithm
