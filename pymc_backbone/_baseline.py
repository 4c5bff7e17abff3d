"""The zero of a displacement record, told from physical offsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ._checks import FloatArray
from ._tracking import Track

_SIGNIFICANT = 4.0


@dataclass(frozen=True)
class Baseline:
    """The sensor's zero.

    Attributes
    ----------
    value, error : float
        Reading at the equilibrium, and its standard error.
    rest : float
        Where the motion came to rest, relative to ``value``; NaN where the record ends before or where it is zero
        within its uncertainty.
    """

    value: float
    error: float
    rest: float


def find_baseline(values: FloatArray, sampling_rate: float, path: Track, end: float, noise: float) -> Baseline:
    """Find the reading at equilibrium: the limit of the mid-line at vanishing amplitude.

    Parameters
    ----------
    values : (n,) array
        Displacement; time counts from its first sample.
    sampling_rate : float
        Samples per second.
    path : Track
        Its track up to the end of motion.
    end : float
        End of motion [s].
    noise : float
        Standard deviation of the noise.

    Notes
    -----
    The mid-line of a cycle differs from the equilibrium by c A^2 for a quadratic stiffness and by c A for a bilinear
    one, and not at all for dry friction, whose half cycles lie on opposite sides. So the mid-line is
    extrapolated to zero amplitude with whichever of 1, A, A^2 the record supports (Bayesian
    information criterion). Where a quiet tail follows the motion and agrees, it is averaged in. Where it does not agree, the
    structure stuck on dry friction off its equilibrium, and the tail says nothing about the sensor's zero: it is reported
    as ``rest``.
    """
    value, error = _extrapolated(path, sampling_rate, noise)
    cycle = 1.0 / path.frequency
    tail = values[int(np.ceil((end + 1.5 * cycle) * sampling_rate)) :]
    if tail.size < max(1.0 * cycle * sampling_rate, 16.0):
        return Baseline(value, error, np.nan)
    level = float(tail.mean())
    # a factor for noise that is not white
    tail_error = 2.0 * max(noise, float(tail.std())) / np.sqrt(tail.size)
    if abs(level - value) > _SIGNIFICANT * np.hypot(error, tail_error) + 1e-4 * float(path.amplitude[0]):
        return Baseline(value, error, level - value)
    weights = 1.0 / np.maximum(np.array([error, tail_error]), 1e-12 * float(path.amplitude[0])) ** 2
    mean = float(np.average([value, level], weights=weights))
    return Baseline(mean, float(1.0 / np.sqrt(weights.sum())), np.nan)


def _extrapolated(path: Track, sampling_rate: float, noise: float) -> tuple[float, float]:
    """Return the mid-line at zero amplitude and its standard error."""
    n = path.time.size
    # the last cycle may hold the stop
    stop = max(n - path.per_cycle, min(n, path.per_cycle))
    stride = path.per_cycle if stop >= 6 * path.per_cycle else max(path.per_cycle // 4, 1)
    picked = slice(stop - 1, None, -stride)
    middle, amplitude = path.mean[picked], path.amplitude[picked]
    relative = amplitude / path.amplitude.max()
    sigma = noise * np.sqrt(2.0 * path.frequency / (3.0 * sampling_rate))
    sigma = max(sigma, 1e-6 * float(path.amplitude.max()))
    best: tuple[float, float, float] | None = None
    for powers in ((), (2,), (1,), (1, 2)):
        basis = np.column_stack([np.ones(relative.size), *(relative**power for power in powers)])
        if relative.size < basis.shape[1] + 2 and powers:
            continue
        solution = np.linalg.lstsq(basis, middle, rcond=None)[0]
        chi_square = float(np.sum((middle - basis @ solution) ** 2)) / sigma**2
        criterion = chi_square + basis.shape[1] * np.log(max(relative.size, 2))
        if best is None or criterion < best[0]:
            inflation = max(1.0, chi_square / max(relative.size - basis.shape[1], 1))
            overlap = max(1.0, 1.5 * path.per_cycle / stride)
            variance = np.linalg.pinv(basis.T @ basis)[0, 0] * sigma**2 * inflation * overlap
            best = criterion, float(solution[0]), float(np.sqrt(variance))
    assert best is not None
    return best[1], best[2]
