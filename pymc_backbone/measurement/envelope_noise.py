"""The noise of an envelope, from the record itself: how it depends on the amplitude, and the floor it makes.

What a parabola through neighbouring samples does not follow is noise. Its variance is ``a + r A^2``: a part that any
detector adds, and one in proportion to the amplitude (gain, drive, quantised decibels).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from .._common.checks import FloatArray

RAYLEIGH = 0.5227
"""Standard deviation over mean of the envelope of noise alone, as a lock-in shows it unsmoothed."""
_MOST = 25.0  # squared normalised difference that counts at most: a step of the record is no noise
_FEWEST_MEANS = 48
_SETTLED = 0.7  # of the largest scatter of means, over that of as many independent samples
_SMALLEST = 1e-10  # relative noise below which nothing is believed: rounding


@dataclass(frozen=True)
class Scatter:
    """Variance ``constant + relative * A^2`` of single samples at amplitude A."""

    constant: float
    relative: float

    def variance(self, amplitude: FloatArray) -> FloatArray:
        """Return the variance at each amplitude."""
        return np.asarray(self.constant + self.relative * amplitude**2)


@dataclass(frozen=True)
class Floor:
    """What is left of a record when the motion is gone.

    Attributes
    ----------
    power : float
        Mean square of the envelope there; the noise adds as much everywhere.
    doubt : float
        Relative standard error of it.
    begins : float
        Time from which there is nothing else [s]; infinity where the record ends before.
    spread : float
        Standard deviation over mean of the envelope there; NaN where the record ends before.
    """

    power: float
    doubt: float
    begins: float
    spread: float


def third_differences(place: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return combinations of four neighbours that vanish for any parabola, and their weights (n - 3, 4) of unit norm.

    Parameters
    ----------
    place, values : (n,) arrays
        Of uneven spacing, too.

    Returns
    -------
    differences : (n - 3,) array
        Of the variance of ``values`` where their noise is white.
    weights : (n - 3, 4) array
    """
    index = np.arange(place.size - 3)[:, None] + np.arange(4)
    at = place[index]
    gaps = at[:, :, None] - at[:, None, :] + np.eye(4)
    weights = 1.0 / gaps.prod(axis=2)
    weights = weights / np.sqrt((weights**2).sum(axis=1, keepdims=True))
    return (weights * values[index]).sum(axis=1), weights


def scatter_of(place: FloatArray, values: FloatArray, amplitude: FloatArray, power: float = 2.0) -> Scatter:
    """Return the scatter of single values as ``constant + relative * A^power``, the likeliest by their differences.

    Parameters
    ----------
    place, values : (n,) arrays
        What scatters, over time.
    amplitude : (n,) array
        Roughly, without its noise.
    power : float
        2 for an envelope; -2 for a frequency, which the noise disturbs as one over the amplitude.
    """
    difference, weights = third_differences(place, values)
    index = np.arange(place.size - 3)[:, None] + np.arange(4)
    shape = (weights**2 * (amplitude[index] / amplitude.max()) ** power).sum(axis=1)
    squared = difference**2
    typical = float(np.median(squared)) / 0.4549 + 1e-300  # the median of chi-square with one degree of freedom
    least = (_SMALLEST * float(np.abs(values).max())) ** 2 + 1e-300
    squared = np.minimum(squared, 1e4 * max(typical, float(np.mean(squared)) / 10.0))
    top = max(float(np.mean(squared)), least)

    def cost(logs: FloatArray) -> float:
        variance = np.exp(logs[0]) + np.exp(logs[1]) * shape + least
        return float(np.mean(np.log(variance) + squared / variance))

    starts = [np.log([top * one, top * other]) for one, other in ((1.0, 1e-4), (1e-4, 1.0), (0.5, 0.5))]
    limits = [(np.log(least) - 5.0, np.log(top) + 20.0)] * 2
    found = min((minimize(cost, start, bounds=limits, method="L-BFGS-B") for start in starts), key=lambda one: one.fun)
    constant, relative = np.exp(found.x)
    return Scatter(float(constant + least), float(relative / amplitude.max() ** power))


def excess(place: FloatArray, values: FloatArray, variance: FloatArray) -> float:
    """Return by which factor, at least 1, means scatter beyond ``variance``: samples that are not independent."""
    if place.size < 8:
        return 1.0
    difference, weights = third_differences(place, values)
    index = np.arange(place.size - 3)[:, None] + np.arange(4)
    expected = (weights**2 * variance[index]).sum(axis=1)
    return max(
        1.0, float(np.mean(np.minimum(difference**2 / expected, max(_MOST, np.median(difference**2 / expected)))))
    )


def memory_of(time: FloatArray, values: FloatArray, variance: FloatArray) -> int:
    """Return over how many samples the noise remembers itself: a lock-in is read faster than its filter follows.

    Means of more and more samples scatter by less, as many as they are, once they are longer than that.

    Parameters
    ----------
    time, values, variance : (n,) arrays
        What scatters, and the variance of single samples as neighbours show it.
    """
    found = [excess(time, values, variance)]
    size = 1
    while values.size // (2 * size) >= _FEWEST_MEANS:
        size *= 2
        count = values.size // size
        means = [part[: count * size].reshape(count, size).mean(axis=1) for part in (time, values, variance)]
        found.append(excess(means[0], means[1], means[2] / size))
    for step, now in enumerate(found):
        if now > _SETTLED * max(found):
            return int(2**step)
    return size


def floor_of(time: FloatArray, values: FloatArray) -> Floor | None:
    """Return the noise floor that a record ends in; None where it ends before.

    A decay that reached its floor has been there for longer than it took over the last decade of power before, and its
    power there is the same in the first half as in the second.

    Parameters
    ----------
    time, values : (n,) arrays
        Envelope.
    """
    size = max(values.size // 400, 4)
    count = values.size // size
    if count < 16:
        return None
    power = (values[: count * size] ** 2).reshape(count, size).mean(axis=1)
    at = time[: count * size].reshape(count, size).mean(axis=1)
    last = float(np.mean(power[-max(count // 20, 4) :]))
    smooth = np.convolve(np.pad(power, 2, mode="edge"), np.ones(5) / 5.0, mode="valid")
    above, far = np.flatnonzero(smooth > 4.0 * last), np.flatnonzero(smooth > 40.0 * last)
    if not last > 0.0 or not far.size:
        return None
    decade = float(at[above[-1]] - at[far[-1]])
    begins = float(at[above[-1]]) + 0.7 * decade
    tail = values[time > begins]
    if float(at[-1] - at[above[-1]]) < 1.2 * decade or tail.size < 16:
        return None
    first, second = (np.mean(part**2) for part in np.array_split(tail, 2))
    blocks = np.array([np.mean(part**2) for part in np.array_split(tail, min(8, tail.size // 4))])
    mean = float(np.mean(tail**2))
    doubt = float(blocks.std(ddof=1) / np.sqrt(blocks.size)) / mean
    if abs(np.log(first / second)) > 0.1 + 4.0 * min(doubt, 0.1):
        return None
    return Floor(mean, doubt, begins, float(tail.std() / tail.mean()))
