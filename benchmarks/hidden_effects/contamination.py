"""Small things in records that no effect of the library explains: of the structure, of the sensor, of the processing.

The size of each is a share, 3 to 30 %, of what the hidden effect does: of its force at the release amplitude over that
of the linear spring (of a damper, twice the damping ratio that it adds).
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt

CONTAMINATIONS: tuple[str, ...] = (
    "outside",
    "second_mode",
    "sensor",
    "temperature",
    "encoder",
    "jitter",
    "filter",
)
"""A force of `systems.OUTSIDE`, a weak second mode, a sensor that bends, stiffness that drifts with time, coarse steps,
instants that scatter, a causal low-pass with its transients."""

_LIMITS = {"second_mode": (5e-4, 0.03), "sensor": (1e-4, 0.05), "encoder": (5e-4, 0.02), "jitter": (2e-4, 0.01)}


def limited(kind: str, size: float) -> float:
    """Return the size of a contamination within what a careful laboratory would still accept."""
    low, high = _LIMITS[kind]
    return float(min(max(size, low), high))


def jittered(time: np.ndarray, size: float, frequency: float, rng: np.random.Generator) -> np.ndarray:
    """Return the instants at which samples were really taken; they scatter by a phase ``size`` [rad]."""
    shift = size / (2.0 * np.pi * frequency) * rng.standard_normal(time.size)
    step = float(time[1] - time[0])
    return np.sort(time + np.clip(shift, -0.4 * step, 0.4 * step))


def distorted(values: np.ndarray, sizes: dict[str, float], scale: float, per_cycle: float) -> np.ndarray:
    """Return what bending sensor, coarse encoder and causal filter make of a record.

    ``scale`` is the quantity at the release amplitude, ``per_cycle`` the number of samples of a cycle.
    """
    if "sensor" in sizes:
        values = values * (1.0 + sizes["sensor"] * (values / scale) ** 2)
    if "filter" in sizes:
        cut = min(sizes["filter"] * 2.0 / per_cycle, 0.9)
        values = sosfilt(butter(4, cut, output="sos"), values)
    if "encoder" in sizes:
        step = sizes["encoder"] * scale
        values = step * np.round(values / step)
    return values
