"""Turning points of a sampled decay: compiled local fits, and the covariance of what follows from them."""

from __future__ import annotations

import numpy as np
from numba import njit

from .._common.checks import BoolArray, FloatArray, IntArray
from .._common.compiled import ahead

N_FIXED = 5
"""Shape functions besides the harmonics: detuning, decay, decay squared, friction, drift of the decay."""


def n_shape_functions(harmonics: int) -> int:
    """Return how many shape functions a template of ``harmonics`` harmonics has."""
    return N_FIXED + 2 * (harmonics - 1)


@njit(cache=True)
def shape_functions(angle: float, harmonics: int, values: FloatArray, slopes: FloatArray) -> None:
    """Write the shape functions at ``angle`` from the turning point and their slopes; value and slope vanish at 0."""
    c, s = np.cos(angle), np.sin(angle)
    values[0], slopes[0] = angle * s, s + angle * c
    values[1], slopes[1] = s - angle * c, angle * s
    values[2], slopes[2] = angle * angle * c, 2.0 * angle * c - angle * angle * s
    side = 1.0 if angle > 0.0 else -1.0
    values[3], slopes[3] = side * (1.0 - c), side * s
    values[4], slopes[4] = angle * angle * s, 2.0 * angle * s + angle * angle * c
    ch, sh = c, s
    j = N_FIXED
    for h in range(2, harmonics + 1):
        ch, sh = ch * c - sh * s, sh * c + ch * s
        values[j], slopes[j] = 1.0 - ch, h * sh
        values[j + 1], slopes[j + 1] = sh - h * s, h * (ch - c)
        j += 2


@ahead("f1 f f f1 f1 f1 f1 f2 i f i", is_beside=True)
@njit(cache=True)
def fit_windows(
    x: FloatArray,
    start: float,
    step: float,
    guess: FloatArray,
    period: FloatArray,
    amplitude: FloatArray,
    sign: FloatArray,
    template: FloatArray,
    harmonics: int,
    reach: float,
    iterations: int,
) -> tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, IntArray, IntArray,
    FloatArray, FloatArray, FloatArray, FloatArray, BoolArray,
]:  # fmt: skip
    """Fit time, value and scale of every turning point to the samples around it, the shape given.

    The model around turning point k is ``x = p - s a (1 - cos u) + s sum_j b_kj g_j(u)``, ``u = 2 pi (t - t_k) /
    period_k``, s its sign, b the
    template. Free are t_k, p, a.

    Returns
    -------
    tuple
        t, p, a; sum of squared residuals; first sample and number of samples; influence of each sample on (t, p);
        Gram matrix and residual projection of the shape functions after the free parameters are projected out;
        response of (t, p) to the template's coefficients; success.
    """
    n, n_shape = guess.size, n_shape_of(harmonics)
    widest = 0
    for k in range(n):
        widest = max(widest, int(2.0 * reach * period[k] / (2.0 * np.pi * step)) + 3)
    times, values, scales, misfit = guess.copy(), np.zeros(n), amplitude.copy(), np.zeros(n)
    first, count = np.zeros(n, np.int64), np.zeros(n, np.int64)
    influence = np.zeros((n, widest, 2))
    gram, projection = np.zeros((n, n_shape, n_shape)), np.zeros((n, n_shape))
    response = np.zeros((n, 2, n_shape))
    good = np.zeros(n, np.bool_)
    g, dg = np.zeros(n_shape), np.zeros(n_shape)
    rows = np.zeros((widest, 3))
    shapes = np.zeros((widest, n_shape))
    residual = np.zeros(widest)
    for k in range(n):
        rate = 2.0 * np.pi / period[k]
        half = reach / rate
        lo = max(int(np.ceil((guess[k] - half - start) / step)), 0)
        hi = min(int(np.floor((guess[k] + half - start) / step)), x.size - 1)
        m = hi - lo + 1
        first[k], count[k] = lo, max(m, 0)
        if m < 4:
            continue
        t, a, s = guess[k], amplitude[k], sign[k]
        near = min(max(int(np.round((t - start) / step)), lo), hi)
        p = x[near]
        normal, right = np.zeros((3, 3)), np.zeros(3)
        ok = True
        for iteration in range(iterations + 1):
            normal[:], right[:] = 0.0, 0.0
            misfit[k] = 0.0
            for i in range(m):
                angle = rate * (start + (lo + i) * step - t)
                shape_functions(angle, harmonics, g, dg)
                value, slope = 0.0, 0.0
                for j in range(n_shape):
                    value += template[k, j] * g[j]
                    slope += template[k, j] * dg[j]
                    shapes[i, j] = s * g[j]
                turn = 1.0 - np.cos(angle)
                rows[i, 0] = rate * s * (a * np.sin(angle) - slope)
                rows[i, 1] = 1.0
                rows[i, 2] = -s * turn
                residual[i] = x[lo + i] - (p - s * a * turn + s * value)
                misfit[k] += residual[i] * residual[i]
                for c in range(3):
                    right[c] += rows[i, c] * residual[i]
                    for d in range(3):
                        normal[c, d] += rows[i, c] * rows[i, d]
            scale = normal[0, 0] * normal[1, 1] * normal[2, 2]
            if not (scale > 0.0) or not (np.linalg.det(normal) > 1e-9 * scale):
                ok = False
                break
            if iteration == iterations:
                break
            change = np.linalg.solve(normal, right)
            limit = 0.15 * period[k]
            t += min(max(change[0], -limit), limit)
            p += change[1]
            a += change[2]
            if a < 0.2 * amplitude[k]:
                a = 0.2 * amplitude[k]
        if not ok:
            continue
        inverse = np.linalg.inv(normal)
        for i in range(m):
            for c in range(2):
                influence[k, i, c] = (
                    inverse[c, 0] * rows[i, 0] + inverse[c, 1] * rows[i, 1] + inverse[c, 2] * rows[i, 2]
                )
        cross = rows[:m].T @ shapes[:m]
        solved = inverse @ cross
        response[k] = -solved[:2]
        gram[k] = shapes[:m].T @ shapes[:m] - cross.T @ solved
        projection[k] = shapes[:m].T @ residual[:m] - cross.T @ (inverse @ (rows[:m].T @ residual[:m]))
        times[k], values[k], scales[k], good[k] = t, p, a, True
    return times, values, scales, misfit, first, count, influence, gram, projection, response, good


@njit(cache=True)
def n_shape_of(harmonics: int) -> int:
    """Return the number of shape functions (compiled twin of `n_shape_functions`)."""
    return N_FIXED + 2 * (harmonics - 1)


@ahead("f2 f1 f f i i1")
@njit(cache=True)
def select_terms(
    normal: FloatArray, right: FloatArray, noise_variance: float, threshold: float, maximum: int, forced: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Choose regression terms one by one while the best lowers chi-square by more than ``threshold``.

    A term that those chosen leave less than a thousandth of its own is not taken: at ten samples per cycle such
    combinations imitate the scale of the turning point, and fit and template would run away together.

    Returns
    -------
    tuple
        Coefficients (zero where not chosen) and the inverse normal matrix of the chosen terms, in the full numbering.
    """
    n = right.size
    work, r = normal.copy(), right.copy()
    reference = np.diag(normal).copy()
    chosen = np.zeros(n, np.bool_)
    for number in range(min(maximum, n) + forced.size):
        best, gain = -1, threshold * noise_variance
        for j in range(n):
            if chosen[j] or not (work[j, j] > 1e-3 * reference[j]) or not (reference[j] > 0.0):
                continue
            lowered = r[j] * r[j] / work[j, j]
            if lowered > gain:
                best, gain = j, lowered
        if number < forced.size:
            best = forced[number]
            if not (work[best, best] > 1e-3 * reference[best]):
                continue
        if best < 0:
            break
        chosen[best] = True
        pivot = work[best, best]
        column = work[:, best].copy()
        target = r[best]
        for i in range(n):
            if not chosen[i]:
                factor = column[i] / pivot
                r[i] -= factor * target
                for j in range(n):
                    if not chosen[j]:
                        work[i, j] -= factor * column[j]
    picked = np.flatnonzero(chosen)
    coefficients, inverse = np.zeros(n), np.zeros((n, n))
    if picked.size:
        small = np.zeros((picked.size, picked.size))
        side = np.zeros(picked.size)
        for i in range(picked.size):
            side[i] = right[picked[i]]
            for j in range(picked.size):
                small[i, j] = normal[picked[i], picked[j]]
            small[i, i] *= 1.0 + 1e-10
        solved = np.linalg.solve(small, side)
        for i in range(picked.size):
            coefficients[picked[i]] = solved[i]
        small = np.linalg.inv(small)
        for i in range(picked.size):
            for j in range(picked.size):
                inverse[picked[i], picked[j]] = small[i, j]
    return coefficients, inverse


@njit(cache=True)
def turning_covariance(
    influence: FloatArray, first: IntArray, count: IntArray, autocovariance: FloatArray, n_bands: int
) -> FloatArray:
    """Return cov[k, b] (2, 2) between (t, p) of turning points k and k + b, the noise stationary."""
    n = first.size
    lags = autocovariance.size
    result = np.zeros((n, n_bands, 2, 2))
    widest = influence.shape[1]
    filtered = np.zeros((widest + 2 * lags, 2))
    for k in range(n):
        length = count[k] + 2 * (lags - 1)
        filtered[:] = 0.0
        for i in range(count[k]):
            for c in range(2):
                w = influence[k, i, c]
                centre = i + lags - 1
                filtered[centre, c] += w * autocovariance[0]
                for lag in range(1, lags):
                    filtered[centre + lag, c] += w * autocovariance[lag]
                    filtered[centre - lag, c] += w * autocovariance[lag]
        base = first[k] - (lags - 1)
        for b in range(min(n_bands, n - k)):
            other = k + b
            for i in range(count[other]):
                place = first[other] + i - base
                if 0 <= place < length:
                    for c in range(2):
                        for d in range(2):
                            result[k, b, c, d] += filtered[place, c] * influence[other, i, d]
    return result


@njit(cache=True)
def cycle_covariance(gradients: FloatArray, turning: FloatArray, offset: int, n_bands: int) -> FloatArray:
    """Return bands[q, b, i], the covariance of quantity q of cycles i and i + b; gradients (q, cycle, 3, 2)."""
    n_quantities, n = gradients.shape[0], gradients.shape[1]
    lags = turning.shape[1]
    result = np.zeros((n_quantities, n_bands, n))
    for q in range(n_quantities):
        for i in range(n):
            for b in range(min(n_bands, n - i)):
                total = 0.0
                for a in range(3):
                    for e in range(3):
                        k, m = 2 * i + offset + a, 2 * (i + b) + offset + e
                        if abs(m - k) >= lags:
                            continue
                        for c in range(2):
                            for d in range(2):
                                pair = turning[k, m - k, c, d] if m >= k else turning[m, k - m, d, c]
                                total += gradients[q, i, a, c] * gradients[q, i + b, e, d] * pair
                result[q, b, i] = total
    return result
