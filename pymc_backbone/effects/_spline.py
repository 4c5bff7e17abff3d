"""Cubic splines through the node forces of a tabulated curve, linear in these."""

from __future__ import annotations

import numba
import numpy as np

from .._common.checks import FloatArray

Weights = tuple[int, float, float, float, float, float, float, float, float]


def slope_matrix(nodes: FloatArray) -> FloatArray:
    """Return the matrix (n, n) that takes values at the nodes (n,) to the slopes of their spline, n at least 4.

    Second derivatives are continuous at each node, the third ones at the last node but one on either side as well, so
    that every cubic is met exactly.
    """
    count, step = nodes.size, np.diff(nodes)
    left, right = np.zeros((count, count)), np.zeros((count, count))
    for i in range(1, count - 1):
        a, b = 1.0 / step[i - 1], 1.0 / step[i]
        left[i, i - 1 : i + 2] = a, 2.0 * (a + b), b
        right[i, i - 1 : i + 2] = -3.0 * a * a, 3.0 * (a * a - b * b), 3.0 * b * b
    for row, i in ((0, 0), (count - 1, count - 3)):
        a, b = 1.0 / step[i] ** 2, 1.0 / step[i + 1] ** 2
        left[row, i : i + 3] = a, a - b, -b
        a, b = 2.0 * a / step[i], 2.0 * b / step[i + 1]
        right[row, i : i + 3] = -a, a + b, -b
    return np.linalg.solve(left, right)


def mirrored_slopes(nodes: FloatArray, sign: float) -> FloatArray:
    """Return the matrix (n, n - 1) to the slopes at nodes from 0 on, of values that are 0 at the first.

    The curve goes on beyond zero as an odd (``sign`` -1) or an even one (1).
    """
    count = nodes.size
    whole = np.concatenate([-nodes[:0:-1], nodes])
    inner = np.eye(count)[:, 1:]
    slopes: FloatArray = (slope_matrix(whole) @ np.concatenate([sign * inner[:0:-1], inner]))[count - 1 :]
    return slopes


@numba.njit
def weights(u: float, nodes: FloatArray) -> Weights:
    """Return the piece that holds u, and the weights of values and slopes at its two ends in the curve and its slope.

    Beyond the last node the curve is linear; before the first its first piece goes on.
    """
    last = nodes.shape[0] - 1
    if u > nodes[last]:
        return last - 1, 0.0, 1.0, 0.0, u - nodes[last], 0.0, 0.0, 0.0, 1.0
    i = 0
    while i < last - 1 and u > nodes[i + 1]:
        i += 1
    h = nodes[i + 1] - nodes[i]
    s = (u - nodes[i]) / h
    r = 1.0 - s
    rise = 6.0 * s * r / h
    return (
        i, (1.0 + 2.0 * s) * r * r, s * s * (3.0 - 2.0 * s), h * s * r * r, -h * s * s * r,
        -rise, rise, r * (1.0 - 3.0 * s), s * (3.0 * s - 2.0),
    )  # fmt: skip
