"""Displacement, velocity and acceleration of free decays, smoothed alike, for the two methods in the time domain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, savgol_filter

from pymc_backbone import ConditionedRecord, InputError, Record, condition

Array = NDArray[np.float64]

SMOOTHING_WINDOW = 0.6
"""Length of the Savitzky-Golay window in cycles: order 5 follows the fundamental to 1e-4 over it."""
SMOOTHING_ORDER = 5
LOW_PASS_WIDTH = 0.5
"""Half width of the low-pass kernel in cycles."""
LOW_PASS_POWER = 4


@dataclass(frozen=True, eq=False)
class Signal:
    """One free decay, smoothed, from the release to the end of its motion.

    Attributes
    ----------
    displacement, velocity : (n,) arrays
        Smoothed [m or rad, per s].
    raw : (n,) array
        The displacement as conditioned.
    step : float
        Sampling interval [s].
    angular_frequency : float
        Of the dominant mode [rad/s].
    amplitude : float
        Largest displacement [m or rad].
    margin : int
        Samples at either end that smoothing and low-pass do not cover.
    kernel, kernel_curvature : (w,) arrays
        Low-pass kernel and its second derivative.
    """

    displacement: Array
    velocity: Array
    raw: Array
    step: float
    angular_frequency: float
    amplitude: float
    margin: int
    kernel: Array
    kernel_curvature: Array

    def low_pass(self, column: Array) -> Array:
        """Low-pass a column of forces; the result has the rows of `acceleration`."""
        return self._inside(fftconvolve(column, self.kernel, mode="same"))

    def acceleration(self) -> Array:
        """Return the second derivative of the low-passed displacement."""
        return self._inside(fftconvolve(self.raw, self.kernel_curvature, mode="same"))

    def _inside(self, column: Array) -> Array:
        return column[self.margin : column.size - self.margin]

    def independent_share(self) -> float:
        """Return how many rows of `acceleration` are worth one independent row, inverted."""
        lags = np.correlate(self.kernel_curvature, self.kernel_curvature, mode="full")
        return float(lags.max() ** 2 / np.sum(lags**2))


@lru_cache(maxsize=2)
def conditioned_records(records: tuple[Record, ...]) -> tuple[ConditionedRecord, ...]:
    """Condition the records that can be conditioned; shared by all methods."""
    kept = []
    for record in records:
        try:
            kept.append(condition(record))
        except InputError:
            continue
    return tuple(kept)


def signals_of(records: Sequence[Record]) -> list[Signal]:
    """Return the smoothed signals of a batch, without the records that hold fewer than four cycles."""
    signals = [_signal(item) for item in conditioned_records(tuple(records))]
    return [signal for signal in signals if signal is not None]


def _signal(item: ConditionedRecord) -> Signal | None:
    step = 1.0 / item.sampling_rate
    per_cycle = item.sampling_rate / item.frequency
    moving = item.time <= item.end_of_motion
    raw = item.displacement[moving]
    if raw.size < 4 * per_cycle or raw.size < 4 * SMOOTHING_ORDER:
        return None
    window = max(int(SMOOTHING_WINDOW * per_cycle) // 2 * 2 + 1, SMOOTHING_ORDER + 2)
    displacement = savgol_filter(raw, window, SMOOTHING_ORDER)
    velocity = savgol_filter(raw, window, SMOOTHING_ORDER, deriv=1, delta=step)
    kernel, curvature = _low_pass_kernel(per_cycle, step)
    return Signal(
        displacement=displacement,
        velocity=velocity,
        raw=raw,
        step=step,
        angular_frequency=2 * np.pi * item.frequency,
        amplitude=float(np.max(np.abs(displacement))),
        margin=kernel.size // 2 + window // 2,
        kernel=kernel,
        kernel_curvature=curvature,
    )


def _low_pass_kernel(per_cycle: float, step: float) -> tuple[Array, Array]:
    """Return a smooth kernel of compact support, and a curvature kernel that is exact on parabolas.

    The kernel is sampled; its curvature is the second difference of the kernel, undone by the factor by which a
    second difference differs from a second derivative at the dominant frequency.
    """
    half = max(LOW_PASS_WIDTH * per_cycle, 2.5)
    n = int(np.ceil(half)) + 1
    place = np.arange(-n, n + 1) / half
    kernel = np.where(np.abs(place) < 1.0, np.clip(1.0 - place**2, 0.0, None) ** LOW_PASS_POWER, 0.0)
    kernel /= kernel.sum()
    curvature = np.convolve(kernel, [1.0, -2.0, 1.0], mode="same") / step**2
    angle = np.pi / per_cycle
    return kernel, curvature * (angle / np.sin(angle)) ** 2
