"""Lines in what a model leaves: beside the harmonics of the motion, below its frequency, or close to a harmonic."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from .harmonic_lines import beside_harmonics

_LOWEST = 0.3  # of the frequency of the mode, down to which lines are looked for
_LINE = 25.0  # peak of the residuals' periodogram over its median that a line has at least
_FAR = 4.0  # bins between a line and a harmonic, where it is looked for beside these
_OFF = 0.75  # bins from where a harmonic may lie, beyond which a peak close to one is another mode
_WIDE = 0.5  # of the frequency, from which the ranges of harmonics run into one another
_FEWEST = 8  # bins beside the harmonics that tell how high nothing is
_AROUND = 24  # bins on either side of a peak that tell it where noise has a colour ...
_OF_A_LINE = 3  # ... but for those that a line itself fills
_PEAKS = 12  # highest bins beside the harmonics that are looked at: where noise has a colour, a line is not the highest


class Line(NamedTuple):
    """Amplitude, as the residuals, and frequency [Hz] of a line; zeros where there is none."""

    height: float = 0.0
    frequency: float = 0.0


def line_beside(time: FloatArray, residuals: FloatArray, between: tuple[float, float]) -> Line:
    """Return the highest line beside the harmonics of a motion whose frequency was in a range.

    But for what is much slower: a zero that wanders has its highest bins there, and no neighbours to hold them against.
    """
    return next(iter(lines_beside(time, residuals, between)), Line())


def lines_beside(time: FloatArray, residuals: FloatArray, between: tuple[float, float]) -> list[Line]:
    """Return the lines beside the harmonics of a motion whose frequency was in a range, the highest first."""
    grid, power = _periodogram(time, residuals)
    beside = beside_harmonics(grid, between, _FAR * grid[1])
    return sorted(_lines(grid, power, beside & (grid > _LOWEST * between[0])), reverse=True)


def line_below(time: FloatArray, residuals: FloatArray, between: tuple[float, float]) -> Line:
    """Return the highest line below the frequency of a motion, but for what is much slower."""
    grid, power = _periodogram(time, residuals)
    beside = beside_harmonics(grid, between, _FAR * grid[1])
    return _highest(grid, power, beside & (grid > _LOWEST * between[0]) & (grid < between[0]))


def _highest(grid: FloatArray, power: FloatArray, beside: BoolArray) -> Line:
    """Return the highest line in some bins."""
    return max(_lines(grid, power, beside), default=Line())


def _lines(grid: FloatArray, power: FloatArray, beside: BoolArray) -> list[Line]:
    """Return the lines in some bins."""
    if np.count_nonzero(beside) < _FEWEST:
        return []
    peaks = np.flatnonzero(beside)[np.argsort(-power[beside])][:_PEAKS]
    found = [_line(grid, power, int(peak), _level(power, beside, int(peak))) for peak in peaks]
    return [line for line in found if line.height > 0.0]


def line_near(time: FloatArray, residuals: FloatArray, between: tuple[float, float], *, off: float = _OFF) -> Line:
    """Return the highest line close to a harmonic of a motion whose frequency was in a range, ``off`` bins from it."""
    low, high = between
    grid, power = _periodogram(time, residuals)
    beside = beside_harmonics(grid, between, _FAR * grid[1])
    if np.count_nonzero(beside) < _FEWEST:
        return Line()
    width, highest = float(grid[1]), Line()
    for k in range(2, int(grid[-1] / high)):
        if k * (high - low) > _WIDE * low:
            break
        close = np.flatnonzero((grid > k * low - _FAR * width) & (grid < k * high + _FAR * width))
        peak = int(close[np.argmax(power[close])])
        line = _line(grid, power, peak, _level(power, beside, peak))
        is_off = max(k * low - line.frequency, line.frequency - k * high) > off * width
        if is_off and line.height > highest.height:
            highest = line
    return highest


def _periodogram(time: FloatArray, residuals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the frequencies [Hz] and the power of residuals, windowed."""
    power = np.abs(np.fft.rfft(residuals * np.hanning(residuals.size))) ** 2
    return np.fft.rfftfreq(residuals.size, float(np.median(np.diff(time)))), power


def _level(power: FloatArray, beside: BoolArray, peak: int) -> float:
    """Return how high nothing is at a peak: the median beside the harmonics, or that of the bins around it if higher.

    Noise that is not white is higher at one end of the spectrum than at the other, and no line there.
    """
    distance = np.abs(np.arange(power.size) - peak)
    near = beside & (distance <= _AROUND) & (distance > _OF_A_LINE)
    around = float(np.median(power[near])) if np.count_nonzero(near) >= _FEWEST else 0.0
    return max(float(np.median(power[beside])), around)


def _line(grid: FloatArray, power: FloatArray, peak: int, level: float) -> Line:
    """Return the line at the highest of some bins, where it is a peak and clearly above the ``level`` of the others."""
    around = power[max(peak - 3, 0) : peak + 4]
    if power[peak] < _LINE * level or power[peak] < around.max() or not 0 < peak < power.size - 1:
        return Line()
    left, middle, right = np.log(power[peak - 1 : peak + 2])
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    return Line(float(2.0 * np.sqrt(power[peak]) / (power.size - 1)), float(grid[peak] + shift * grid[1]))


__all__ = ["Line", "line_below", "line_beside", "line_near", "lines_beside"]
