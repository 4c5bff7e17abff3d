"""Means of samples over short blocks, and whitening of coloured noise."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_toeplitz, toeplitz

from ..._common.checks import FloatArray
from .fit_kernels import filter_columns, mean_rows

MOST_LAGS = 32
EDGE = 2
"""Blocks at either end that the mean over blocks cannot give."""


def average(columns: FloatArray, together: int) -> FloatArray:
    """Return means over each step from values at the middle of the steps; two steps at either end are lost."""
    return _filtered(_mean_weights(together), columns)[2 * EDGE :]  # the weights are alike to either side


@functools.cache
def _mean_weights(together: int) -> FloatArray:
    """Return weights (5,) on the middles of neighbouring steps that give the mean of a step's ``together`` samples.

    Exact for polynomials of degree five. A mean of few samples is not the mean over the step: for two samples of a
    sinusoid the integral would be 7e-4 off, which shows in long records.
    """
    place = (np.arange(together) - 0.5 * (together - 1)) / together
    second, fourth = float(np.mean(place**2)), float(np.mean(place**4))
    outer = (fourth - second) / 24.0
    inner = 0.5 * second - 4.0 * outer
    return np.array([outer, inner, 1.0 - 2.0 * (outer + inner), inner, outer])


def means(columns: FloatArray, together: int) -> FloatArray:
    """Return means over so many neighbouring rows; what is left over at the end is dropped."""
    result = np.empty((columns.shape[0] // together, columns.shape[1]))
    mean_rows(np.ascontiguousarray(columns), together, result)
    return result


def of_means(autocovariance: FloatArray, together: int) -> FloatArray:
    """Return the autocovariance of means over so many neighbouring samples."""
    size = autocovariance.size
    lags = int(np.ceil((size - 1) / together)) + 1
    weights = together - np.abs(np.arange(-together + 1, together))
    padded = np.zeros((lags + 2) * together + size)
    padded[:size] = autocovariance
    result = np.empty(max(lags, 2))
    for lag in range(result.size):
        at = np.abs(lag * together + np.arange(-together + 1, together))
        result[lag] = float(weights @ padded[at]) / together**2
    return result


def whitener(autocovariance: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the filter that makes noise with this autocovariance white, of unit variance."""
    significant = np.abs(autocovariance[1:]) > 0.03 * autocovariance[0]
    if not significant.any():
        scale = 1.0 / np.sqrt(autocovariance[0])
        return lambda columns: columns * scale
    order = min(int(np.flatnonzero(significant)[-1]) + 1, MOST_LAGS)
    row = np.zeros(order + 1)
    row[: min(order + 1, autocovariance.size)] = autocovariance[: order + 1]
    row[0] *= 1.0 + 1e-3
    prediction = solve_toeplitz(row[:-1], row[1:])
    variance = float(row[0] - prediction @ row[1:])
    taps = np.concatenate([[1.0], -prediction]) / np.sqrt(max(variance, 1e-6 * row[0]))
    try:
        start = np.linalg.inv(np.linalg.cholesky(toeplitz(row[:-1])))
    except np.linalg.LinAlgError:  # what was estimated is no autocovariance
        return lambda columns: _filtered(taps, columns)

    def whiten(columns: FloatArray) -> FloatArray:
        filtered = _filtered(taps, columns)
        first = min(order, columns.shape[0])  # samples whose past is not in the record
        filtered[:first] = start[:first, :first] @ columns[:first]
        return filtered

    return whiten


def with_slow_noise(
    whiten: Callable[[FloatArray], FloatArray], modes: FloatArray
) -> Callable[[FloatArray], FloatArray]:
    """Return the filter that makes noise white which also holds independent normal amounts of slow ``modes`` (n, k)."""
    if not modes.shape[1]:
        return whiten
    directions, sizes, _ = np.linalg.svd(whiten(modes), full_matrices=False)
    less = 1.0 - 1.0 / np.sqrt(1.0 + sizes**2)

    def both(columns: FloatArray) -> FloatArray:
        white = whiten(columns)
        return white - directions @ (less[:, None] * (directions.T @ white))

    return both


def _filtered(taps: FloatArray, columns: FloatArray) -> FloatArray:
    """Return each column after a filter of finite length."""
    filtered = np.empty(columns.shape)
    filter_columns(taps, np.ascontiguousarray(columns), filtered)
    return filtered
