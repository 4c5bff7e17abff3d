"""The zero of a displacement record, told from physical offsets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..._common.checks import FloatArray
from .asymmetry import GAPS, beyond_stop, implied_shift
from .tracking import Track

_SIGNIFICANT = 4.0
_FLOOR = 1e-4
_STOPPING = 2.0
_FEWEST = 3
"""Numbers that a mid-line is extrapolated with, however few cycles there are."""
_SHAPE = 0.1
"""Of the mid-line of the last cycles, how far laws of force that are none of these carry it elsewhere."""


@dataclass(frozen=True)
class Baseline:
    """The sensor's zero.

    Attributes
    ----------
    value, error : float
        Reading at the equilibrium, and its standard error.
    rest : float
        Where dry friction stopped the motion, relative to ``value``; NaN where it did not.
    """

    value: float
    error: float
    rest: float


def find_baseline(
    values: FloatArray, sampling_rate: float, path: Track, end: float, noise: float, harmonic: tuple[float, float]
) -> Baseline:
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
    harmonic : (float, float)
        Second harmonic over fundamental at the first cycle, and its standard error.

    Notes
    -----
    The mid-line of a cycle differs from the equilibrium by c A^2 for a quadratic stiffness and by c A for a
    bilinear one, and not at all for dry friction, whose half cycles lie on opposite sides. So the mid-line is
    extrapolated to zero amplitude with 1, A, A^2 and what one or two stops add beyond their gaps (`beyond_stop`),
    averaged over which of them the record supports (Bayesian information criterion); what laws of force make of it
    that are none of these is an error in proportion to the mid-line of the last cycles. A record that hardly decays
    says little about that; but the force that shifts the mid-line also makes a second harmonic, and about a third of
    the shift, which is used as one more observation.

    A quiet tail after a decay that faded away shows the zero itself. A tail after a motion that stopped within a
    few cycles (dry friction: amplitude falls by four times the friction's displacement per cycle, and the rest is
    within one of it) shows where the structure stuck: it is reported as ``rest`` and says nothing about the zero.
    """
    value, error = _extrapolated(path, sampling_rate, noise, harmonic)
    cycle = 1.0 / path.frequency
    tail = values[int(np.ceil((end + 1.5 * cycle) * sampling_rate)) :]
    if tail.size < max(cycle * sampling_rate, 16.0):
        return Baseline(value, error, np.nan)
    level = float(tail.mean())
    # twice the error of white noise, for it is not white
    tail_error = float(
        np.hypot(2.0 * max(noise, float(tail.std())) / np.sqrt(tail.size), 0.1 * _FLOOR * path.amplitude[0])
    )
    rest = level - value
    last = path.amplitude[-min(3 * path.per_cycle, path.amplitude.size) :]
    fall = float(last[0] - last[-1]) * path.per_cycle / max(last.size - 1, 1)
    has_stopped = fall > _STOPPING * abs(rest)
    if has_stopped and abs(rest) > _SIGNIFICANT * np.hypot(error, tail_error):
        return Baseline(value, error, rest)
    if has_stopped:
        weights = 1.0 / np.array([error, tail_error]) ** 2
        mean = float(np.average([value, level], weights=weights))
        # friction may have stopped it anywhere within the uncertainty
        return Baseline(mean, float(np.hypot(1.0 / np.sqrt(weights.sum()), rest)), np.nan)
    return Baseline(level, tail_error, np.nan)


def _extrapolated(
    path: Track, sampling_rate: float, noise: float, harmonic: tuple[float, float]
) -> tuple[float, float]:
    """Return the mid-line at zero amplitude and its standard error."""
    middle, amplitude, overlap = _cycle_means(path)
    highest = float(amplitude.max())
    relative = amplitude / highest
    sigma = noise * np.sqrt(2.0 * path.frequency / (3.0 * sampling_rate))
    sigma = max(float(sigma), 1e-6 * highest)
    shift, shift_error = (highest * item for item in implied_shift(*harmonic))
    shift_error += sigma
    misfits, counts, rarities, values, variances = [], [], [], [], []
    for columns, gaps, rarity in _shapes(relative):
        if 1 + len(columns) + gaps > max(_FEWEST, relative.size / overlap - 1.0):
            continue  # as many numbers as there are cycles
        shape = np.column_stack([np.ones(relative.size), *columns])
        # the last row: the mid-line at full amplitude as the second harmonic has it
        rows = np.vstack([shape / sigma, np.append(0.0, np.ones(len(columns))) / shift_error])
        right = np.append(middle / sigma, shift / shift_error)
        solution = np.linalg.lstsq(rows, right, rcond=None)[0]
        misfits.append(float(np.sum((right - rows @ solution) ** 2)))
        counts.append(shape.shape[1] + gaps)
        rarities.append(rarity)
        values.append(float(solution[0]))
        variances.append(float(np.linalg.pinv(rows.T @ rows)[0, 0]))
    misfit, count = np.array(misfits), np.array(counts)
    # what no model explains is no white noise: the best one says how large it is
    scatter = np.maximum(np.min(misfit / np.maximum(relative.size + 1 - count, 1)), 1.0)
    # cycles that overlap are fewer observations than they seem: as evidence between the models, too
    scores = misfit / (scatter * overlap) + count * np.log(max(relative.size / overlap, 2.0)) + 2.0 * np.log(rarities)
    own = np.maximum(misfit / np.maximum(relative.size + 1 - count, 1), 1.0)
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    mean = float(weights @ values)
    last = float(np.mean(middle[: max(middle.size // 8, 1)]))  # cycles are picked from the end
    otherwise = (_SHAPE * (last - mean)) ** 2
    variance = float(weights @ (np.array(variances) * own * overlap + (np.array(values) - mean) ** 2)) + otherwise
    return mean, float(np.hypot(np.sqrt(variance), _FLOOR * highest))


def _shapes(relative: FloatArray) -> Iterator[tuple[list[FloatArray], int, int]]:
    """Yield what may move the mid-line, each 1 at the largest amplitude, its number of gaps, and of how many it is one.

    Shapes that differ in their gaps or orders alone are one possibility beforehand, not as many.
    """
    linear, square = relative, relative**2
    for columns in ([], [square], [linear], [linear, square]):
        yield columns, 0, 1
    for order in (3, 4):  # of a spring that bends and hardens
        yield [square, relative**order], 0, 2
        yield [square, relative**order, relative ** (2 * order - 2)], 0, 2
    stops = [beyond_stop(relative, gap) / beyond_stop(np.ones(1), gap) for gap in GAPS]
    for stop in stops:
        for columns in ([stop], [linear, stop], [square, stop]):
            yield columns, 1, len(stops)
    pairs = list(combinations(stops, 2))
    for pair in pairs:
        yield [*pair], 2, len(pairs)


def _cycle_means(path: Track) -> tuple[FloatArray, FloatArray, float]:
    """Return mid-line and amplitude about once per cycle, and by what factor they are fewer than independent."""
    n, per_cycle = path.time.size, path.per_cycle
    # the last cycle may hold the stop; the first reaches into the extrapolated beginning
    stop = max(n - per_cycle, min(n, per_cycle))
    start = per_cycle if stop > 7 * per_cycle else 0
    stride = per_cycle if stop - start >= 6 * per_cycle else max(per_cycle // 4, 1)
    picked = np.arange(stop - 1, start - 1, -stride)
    return path.mean[picked], path.amplitude[picked], max(1.0, 1.5 * per_cycle / stride)
