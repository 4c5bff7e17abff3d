"""Noise of turning points that the samples around them do not show: frames of a camera, wind, a floor that moves.

The errors of turning points follow from the noise of the samples near them. What moves slower than a cycle is no noise
to the samples, but each peak is off by it, and neighbours by much the same: a curve of damping that believes the peaks
follows them from one to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from .._common.checks import FloatArray
from .rough_turning import running_line
from .smoothing import log_evidence
from .turning import cycle_covariance

CORRELATIONS = (-0.9, -0.75, -0.55, -0.3, 0.0, 0.3, 0.55, 0.75, 0.9)
"""Of one turning point and the next, outwards; negative where the zero drifts rather than the scale."""
SIZES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Of the noise, over the median standard error of the turning values."""
ENOUGH = 5.0
"""Logarithm of the evidence over that of peaks that are as the samples say."""
_NEGLIGIBLE = 1e-4
_MOST_CYCLES, _FEWEST_CYCLES = 600, 10
_MOST_BANDS, _FORGOTTEN = 20, 0.05


def with_peak_noise(
    values: FloatArray, signs: FloatArray, turning: FloatArray
) -> tuple[FloatArray, tuple[float, float] | None]:
    """Return the covariance of turning points with noise of their own, where the damping shows it.

    Parameters
    ----------
    values, signs : (m,) arrays
        Turning values, and +1.0 for peaks.
    turning : (m, b, 2, 2) array
        Covariance of (time, value) of turning points k and k + b, as the samples tell it.

    Returns
    -------
    turning : (m, b, 2, 2) array
        ``turning`` itself where there is no evidence of more noise; else with more of it, perhaps over more neighbours.
    found : (float, float) or None
        Standard deviation and correlation from one turning point to the next.

    Notes
    -----
    The noise is a first-order autoregression over the turning points, outwards. Its covariance is the mean over sizes
    and correlations, weighted with the probability of the damping of the cycles under all curves that smoothing
    considers. Where the likeliest does not beat the samples' own word by 5 units of logarithm, corners of the curve
    allowed, nothing is changed.
    """
    shift = 0 if signs[0] > 0 else 1
    n = min((values.size - shift - 1) // 2, _MOST_CYCLES)
    if n < _FEWEST_CYCLES:
        return turning, None
    at = shift + 2 * np.arange(n)
    upper, lower = values[at] - values[at + 1], values[at + 2] - values[at + 1]
    if not (np.all(upper > 0.0) and np.all(lower > 0.0)):
        return turning, None
    damping = 2.0 * np.log(upper / lower)
    halves = np.abs(np.diff(values)) / 2.0
    smoothed = running_line(np.append(halves, halves[-1]), 4)
    smoothed = np.minimum.accumulate(np.maximum(smoothed, 1e-3 * smoothed.max())) * np.exp(
        -1e-9 * np.arange(values.size)
    )
    r0, r1 = smoothed[at] + smoothed[at + 1], smoothed[at + 1] + smoothed[at + 2]
    gradients = np.zeros((1, n, 3, 2))
    gradients[0, :, 0, 1], gradients[0, :, 1, 1], gradients[0, :, 2, 1] = 2 / r0, -2 / r0 + 2 / r1, -2 / r1
    places = [np.log(0.25 * (r0 + r1))]

    def evidence(covariance: FloatArray, *, kinks: bool) -> float:
        bands = cycle_covariance(gradients, covariance, shift, 1 + (covariance.shape[1] + 1) // 2)[0]
        return log_evidence(places, damping, bands, kinks=kinks)

    unit = float(np.median(np.sqrt(np.maximum(turning[: 2 * n + 1, 0, 1, 1], 0.0))))
    trials: dict[tuple[float, float], float] = {}
    without = evidence(turning, kinks=False)

    def best(sizes: Sequence[float], correlations: Sequence[float]) -> tuple[float, float]:
        for size, correlation in product(sizes, correlations):
            if (size, correlation) not in trials:
                covariance = _added(turning, signs, size * unit, correlation)
                trials[size, correlation] = evidence(covariance, kinks=False)
        return max(trials, key=lambda key: trials[key])

    if trials[best(SIZES[1::2], CORRELATIONS[1::3])] - without < ENOUGH:
        return turning, None
    size, _ = best(SIZES, [best(SIZES[1::2], CORRELATIONS)[1]])
    near = SIZES.index(size)
    size, correlation = best(SIZES[max(near - 1, 0) : near + 2], CORRELATIONS)
    # with corners allowed, for a corner is no noise
    likeliest = _added(turning, signs, size * unit, correlation)
    if evidence(likeliest, kinks=True) - evidence(turning, kinks=True) < ENOUGH:
        return turning, None
    weights = np.exp(np.array(list(trials.values())) - trials[size, correlation])
    weights /= weights.sum()
    result = np.zeros((turning.shape[0], max(turning.shape[1], min(_MOST_BANDS, signs.size)), 2, 2))
    for weight, (one, other) in zip(weights, trials, strict=True):
        if weight > _NEGLIGIBLE:
            covariance = _added(turning, signs, one * unit, other)
            result[:, : covariance.shape[1]] += weight * covariance
    return result, (size * unit, correlation)


def _added(turning: FloatArray, signs: FloatArray, deviation: float, correlation: float) -> FloatArray:
    """Return the covariance with an autoregression over the turning points added to their values."""
    reach = 1 if correlation == 0.0 else 1 + int(np.ceil(np.log(_FORGOTTEN) / np.log(abs(correlation))))
    count = max(turning.shape[1], min(reach, _MOST_BANDS, signs.size))
    result = np.zeros((turning.shape[0], count, 2, 2))
    result[:, : turning.shape[1]] = turning
    for lag in range(min(reach, count)):
        # tapered to the last: a covariance that is cut off would not be one
        taper = 1.0 - lag / reach
        end = signs.size - lag
        result[:end, lag, 1, 1] += deviation**2 * correlation**lag * taper * signs[:end] * signs[lag:]
    return result
