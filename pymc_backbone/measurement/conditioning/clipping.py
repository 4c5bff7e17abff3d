"""Peaks that are cut off at the limit of a sensor or converter, and the instant from which a record has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import BoolArray, FloatArray, IntArray
from ..rough_turning import rough_noise

_CLIPPED_PEAKS = 3
_BEYOND = 0.98  # of the limit, from which a peak on the other side may be cut as well
_WITHIN, _FLAT, _FLAT_SHARE = 3.0, 20.0, 0.02
"""Noise about a flat top; by how much more the cosine falls beside it, in noise and as a share of the amplitude."""
_FINE = 1e-5


@dataclass(frozen=True)
class Clipping:
    """Peaks of a record that are cut off at one value.

    Attributes
    ----------
    count : int
        How many they are.
    limit : float
        What the sensor showed there [measured quantity].
    side : str
        ``upper`` or ``lower``.
    first, free : float
        Time [s] of the first of them, and from which no peak is cut.
    """

    count: int
    limit: float
    side: str
    first: float
    free: float

    def __str__(self) -> str:
        return (
            f"{self.count} peaks are clipped at {self.limit:.6g} ({self.side} limit of the sensor or converter), "
            f"first at {self.first:.6g} s"
        )


def find_clipping(
    values: FloatArray, reading: float, time: FloatArray, frequency: float, step: float
) -> Clipping | None:
    """Return the peaks whose tops are cut off at the same value; None where fewer than three are.

    Samples at the extreme value that follow each other are natural on a coarse converter: a cosine of
    amplitude A stays within one step of its top for a while. Clipped tops last longer than that. The sensor showed
    ``values + reading``.
    """
    sampling_rate = (time.size - 1) / float(time[-1] - time[0])
    middle, amplitude = 0.5 * float(values.max() + values.min()), 0.5 * float(np.ptp(values))
    for extreme in (float(values.max()), float(values.min())):
        at = np.abs(values - extreme) <= 1e-9 * amplitude
        first, length = _runs_of_peaks(at, (values > middle) == (extreme > middle))
        # the fall of a true cosine from the middle to the end of the run
        fall = amplitude * (1.0 - np.cos(np.minimum(np.pi * frequency * (length - 1) / sampling_rate, np.pi)))
        cut = (length >= 2) & (fall > 3.0 * step) & (fall > 1e-3 * amplitude)
        if step < _FINE * amplitude and cut.any():
            # on a fine scale no two peaks are equal by chance, as far as single samples
            cut |= length >= 1
        # a model held at rest is one long run, not a peak
        cut &= length < 0.6 * sampling_rate / frequency
        if np.count_nonzero(cut) < _CLIPPED_PEAKS:
            at, first, cut = _noisy_tops(values, extreme, middle, amplitude, sampling_rate / frequency)
        if np.count_nonzero(cut) >= _CLIPPED_PEAKS:
            # the next peak on the other side may be cut as well, and a cut peak must not be the first of what follows
            beyond = at | (np.abs(values - middle) > _BEYOND * amplitude)
            quarter = round(0.25 * sampling_rate / frequency)
            last = min(int(np.flatnonzero(beyond)[-1]) + 1 + quarter, time.size - 1)
            side = "upper" if extreme > middle else "lower"
            begun = float(time[first[cut][0]])
            return Clipping(int(np.count_nonzero(cut)), extreme + reading, side, begun, float(time[last]))
    return None


def _noisy_tops(
    values: FloatArray, extreme: float, middle: float, amplitude: float, per_cycle: float
) -> tuple[BoolArray, IntArray, BoolArray]:
    """Return what lies at an extreme but for noise, where peaks begin to, and which of these are cut off there.

    A sensor that saturates adds its noise behind the limit. Its peaks are flat for longer than a cosine is, and as high
    as each other though the motion decays: the peaks after them say by how much it would have.
    """
    noise, side = rough_noise(values), 1.0 if extreme > middle else -1.0
    # the highest of many samples of a flat top is some three deviations above it
    at = side * (values - extreme) > -2.0 * _WITHIN * noise
    first, length = _runs_of_peaks(at, side * (values - middle) > 0.0)
    fall = amplitude * (1.0 - np.cos(np.minimum(np.pi * (length - 1) / per_cycle, np.pi)))
    cut = (fall > _FLAT * noise) & (fall > _FLAT_SHARE * amplitude) & (length < 0.6 * per_cycle)
    count = int(np.count_nonzero(cut))
    if count < _CLIPPED_PEAKS:
        return at, first, cut
    after = side * (values[int(first[-1]) + round(0.5 * per_cycle) :] - middle)
    cycles = int(after.size / per_cycle)
    if cycles < 2:
        return at, first, np.zeros_like(cut)
    tops = np.array([part.max() for part in np.array_split(after[: round(cycles * per_cycle)], cycles)])[: 2 * count]
    expected = side * (extreme - middle) * (1.0 - (tops[-1] / tops[0]) ** (count / max(tops.size - 1, 1)))
    return at, first, cut & bool(expected > _FLAT * noise)


def _runs_of_peaks(at: BoolArray, beyond: BoolArray) -> tuple[IntArray, IntArray]:
    """Return where the values stay at their extreme, and for how many samples, at most once in each peak.

    Of a peak, while the motion is ``beyond`` the middle, the longest run counts: a model that is held before release
    comes and goes with the last digit of the converter, many times, and is one.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(int)))
    first, last = edges[::2], edges[1::2]
    if not first.size:
        return first, first
    crossings = np.cumsum(np.concatenate([[0], np.diff(beyond.astype(int)) != 0]))
    _, begin = np.unique(crossings[first], return_index=True)
    return first[begin], np.maximum.reduceat(last - first, begin)


__all__ = ["Clipping", "find_clipping"]
