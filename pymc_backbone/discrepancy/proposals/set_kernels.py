"""Compiled: for every set of effects the best combinations of one atom of each, by regression."""

from __future__ import annotations

import math

import numpy as np

from ..._common.checks import BoolArray, FloatArray, IntArray
from ..._common.compiled import ahead, cached
from ...simulation.curves import compiled

_RIDGE = 1e-9


@compiled
def _solve_positive(
    matrix: FloatArray, right: FloatArray, is_positive: BoolArray, size: int, solution: FloatArray,
    factor: FloatArray,
) -> float:  # fmt: skip
    """Solve by Cholesky's method, leaving out in turn what would be negative; return by how much the sum falls."""
    held = np.zeros(size, np.bool_)
    for _ in range(size + 1):
        for i in range(size):
            for j in range(i + 1):
                total = matrix[i, j]
                if held[i] or held[j]:
                    total = 1.0 if i == j else 0.0
                for k in range(j):
                    total -= factor[i, k] * factor[j, k]
                if i == j:
                    factor[i, i] = math.sqrt(max(total, _RIDGE * matrix[i, i] + 1e-300))
                else:
                    factor[i, j] = total / factor[j, j]
        for i in range(size):
            total = 0.0 if held[i] else right[i]
            for k in range(i):
                total -= factor[i, k] * solution[k]
            solution[i] = total / factor[i, i]
        gain = 0.0
        for i in range(size):
            gain += solution[i] * solution[i]
        for i in range(size - 1, -1, -1):
            total = solution[i]
            for k in range(i + 1, size):
                total -= factor[k, i] * solution[k]
            solution[i] = total / factor[i, i]
        worst, at = 0.0, -1
        for i in range(size):
            if is_positive[i] and not held[i]:
                size_of = solution[i] * math.sqrt(matrix[i, i])
                if size_of < worst:
                    worst, at = size_of, i
        if at < 0:
            return gain
        held[at] = True
    return 0.0


@ahead("f2 f1 i1 b1 i2 i2 i i i f2 i3 f3", is_beside=True)
@cached
def best_atoms(
    gram: FloatArray, constants: FloatArray, firsts: IntArray, is_positive: BoolArray, places: IntArray,
    sets: IntArray, begin: int, end: int, most: int, misfits: FloatArray, atoms: IntArray, strengths: FloatArray,
) -> None:  # fmt: skip
    """Write for each of the sets ``begin`` to ``end`` its best combinations of one atom of each of its effects.

    ``gram`` (n + 1, n + 1) are the products of the atoms, the data last; the atoms of effect ``e`` are those from
    ``firsts[e]`` to ``firsts[e + 1]``, their places on the grid (n, d) tell neighbours, ``constants`` (n,) are
    added to the sum of squares. ``sets`` (s, k) hold effects, -1
    for none. Each set gets its best ``misfits`` (s, t), ``atoms`` and ``strengths`` (s, t, k) that are no neighbours.
    At most ``most`` combinations of a set are tried, on a coarser grid where there are more.
    """
    n = gram.shape[0] - 1
    width = sets.shape[1]
    kept = misfits.shape[1]
    matrix, factor = np.zeros((width, width)), np.zeros((width, width))
    right, solution = np.zeros(width), np.zeros(width)
    flags = np.zeros(width, np.bool_)
    now, strides = np.zeros(width, np.int64), np.zeros(width, np.int64)
    first, last = np.zeros(width, np.int64), np.zeros(width, np.int64)
    for s in range(begin, end):
        size = 0
        while size < width and sets[s, size] >= 0:
            size += 1
        product = 1.0
        for i in range(size):
            first[i], last[i] = firsts[sets[s, i]], firsts[sets[s, i] + 1]
            strides[i] = 1
            product *= last[i] - first[i]
        while product > most:
            longest, at = 0.0, 0
            product = 1.0
            for i in range(size):
                length = math.ceil((last[i] - first[i]) / strides[i])
                if length > longest:
                    longest, at = length, i
            strides[at] += 1
            for i in range(size):
                product *= math.ceil((last[i] - first[i]) / strides[i])
        for t in range(kept):
            misfits[s, t] = np.inf
            for i in range(width):
                atoms[s, t, i] = -1
        for i in range(size):
            now[i] = first[i]
        while True:
            for i in range(size):
                for j in range(i + 1):
                    matrix[i, j] = gram[now[i], now[j]]
                right[i] = gram[now[i], n]
                flags[i] = is_positive[now[i]]
            misfit = gram[n, n]
            for i in range(size):
                misfit += constants[now[i]]
            if size > 0:
                misfit -= _solve_positive(matrix, right, flags, size, solution, factor)
            if misfit < misfits[s, kept - 1]:
                near = -1
                for t in range(kept):
                    if not misfits[s, t] < np.inf:
                        break
                    distance = 0
                    for i in range(size):
                        for d in range(places.shape[1]):
                            distance = max(distance, abs(places[now[i], d] - places[atoms[s, t, i], d]))
                    if distance <= 2:
                        near = t
                        break
                if near < 0 or misfit < misfits[s, near]:
                    t = near if near >= 0 else kept - 1
                    while t > 0 and misfits[s, t - 1] > misfit:
                        misfits[s, t] = misfits[s, t - 1]
                        atoms[s, t] = atoms[s, t - 1]
                        strengths[s, t] = strengths[s, t - 1]
                        t -= 1
                    misfits[s, t] = misfit
                    for i in range(size):
                        atoms[s, t, i] = now[i]
                        strengths[s, t, i] = solution[i]
            moved = 0
            while moved < size:
                now[moved] += strides[moved]
                if now[moved] < last[moved]:
                    break
                now[moved] = first[moved]
                moved += 1
            if moved == size:
                break
