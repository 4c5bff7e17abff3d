"""Where the harmonics of a motion lie whose frequency changes: at multiples of all the frequencies that it had."""

from __future__ import annotations

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from ...measurement.cycle_data import Cycles
from ..fitting.curves import frequencies
from ..fitting.data_term import LevelTerm
from ..fitting.joint_fit import Fit

_BEYOND = 0.5  # of the range of the measured frequencies, by which those of the motion may go beyond it
_BEYOND_MODEL = 0.2  # ... and those of a model at the levels
_ERRORS = 1.0  # standard errors of a measured frequency by which the range goes beyond it
_FEWEST_FIRST = 4  # cycles beyond the levels, through whose frequencies a line is laid to that of the first


def frequencies_of(term: LevelTerm, frequency: float, cycles: Cycles) -> tuple[float, float]:
    """Return between which frequencies [Hz] a specimen moved, by its level values and its cycles beyond these."""
    rows = term.rows[:, 0] == 0
    if not rows.any():
        return frequency, frequency
    root = np.linalg.inv(term.whitening)
    error = _ERRORS * np.sqrt((root**2).sum(axis=1))[rows]
    low, high = float((term.values[rows] - error).min()), float((term.values[rows] + error).max())
    further = _BEYOND * float(np.ptp(term.values[rows]))
    first = _first_frequency(cycles, float(term.levels.max()), frequency)
    return min(low - further, frequency, first), max(high + further, frequency, first)


def _first_frequency(cycles: Cycles, highest: float, otherwise: float) -> float:
    """Return the frequency [Hz] of the first cycle, by a line through those of all cycles beyond the highest level."""
    beyond = cycles.amplitude > highest
    if np.count_nonzero(beyond) < _FEWEST_FIRST:
        return otherwise
    x = np.log(cycles.amplitude[beyond])
    slope, middle = np.polyfit(x - x.mean(), cycles.frequency[beyond], 1)
    return float(middle + slope * (x.max() - x.mean()))


def frequencies_with(found: Fit, specimen: int, term: LevelTerm, frequency: float) -> tuple[float, float]:
    """Return between which frequencies [Hz] a specimen moves as a set has it: a disturbance bends those measured."""
    values = frequencies(found.layout, found.parameters(specimen), term)
    values = values[np.isfinite(values)]
    if not values.size:
        return frequency, frequency
    further = _BEYOND_MODEL * float(np.ptp(values))
    return min(float(values.min()) - further, frequency), max(float(values.max()) + further, frequency)


def beside_harmonics(grid: FloatArray, between: tuple[float, float], far: float) -> BoolArray:
    """Return which of equally spaced frequencies are beside all harmonics, and not as slow as the record is long.

    A motion that rests at its lowest frequency has lines at multiples of that, far from those of any mean. ``between``
    is where its frequency was, ``far`` how far [Hz] a line is from a harmonic at least.
    """
    low, high = between
    return np.asarray((np.ceil((grid - far) / high) > np.floor((grid + far) / low)) & (grid > 2.0 * grid[1]))


def is_harmonic(place: float, between: tuple[float, float], near: float) -> bool:
    """Return whether a frequency is within ``near`` [Hz] of a harmonic of a motion whose frequency was in a range."""
    low, high = between
    return bool(np.ceil((place - near) / high) <= np.floor((place + near) / low))


__all__ = ["beside_harmonics", "frequencies_of", "frequencies_with", "is_harmonic"]
