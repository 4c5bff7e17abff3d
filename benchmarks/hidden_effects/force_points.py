"""Restoring-force points of records: displacement, velocity and force by differentiation, for whoever regresses them.

No model is simulated: a polynomial in a moving window (Savitzky and Golay) gives displacement, velocity and
acceleration of each sample, and Newton's law the force. It is how symbolic regression is usually fed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import savgol_filter

ORDER = 5
"""Of the polynomial: its third derivative is still free to bend."""
WINDOW = 0.5
"""Of a cycle: of 0.3 to 0.8 the one whose forces are nearest to the true ones at 50 dB; narrower ones leave noise."""
_LOUD = 0.02
"""Share of the largest amplitude below which a record is left out."""


class Points(NamedTuple):
    """Displacement [m], velocity [m/s] and restoring force [N] of the samples of one record, each (n,)."""

    x: np.ndarray
    v: np.ndarray
    force: np.ndarray


def differentiated(time: np.ndarray, values: np.ndarray, mass: float, per_cycle: float, window: float) -> Points:
    """Return the points of a record of a displacement without what half a window at either end spoils."""
    step = float(time[1] - time[0])
    width = max(2 * int(0.5 * window * per_cycle) + 1, ORDER + 4 - ORDER % 2)
    x, v, a = (savgol_filter(values, width, ORDER, deriv=k, delta=step) for k in range(3))
    inner = slice(width // 2, values.size - width // 2)
    return Points(x[inner], v[inner], -mass * a[inner])


def points_of(folder: Path, truth: dict[str, Any], window: float = WINDOW) -> list[Points]:
    """Return the points of each record of a batch from its release on, the sensor's offset taken out.

    The offset is the mean of the last whole cycles, where the mid-line of an asymmetric spring has come back to zero.
    """
    held = np.load(folder / "clean.npz", allow_pickle=False)  # release instants alone are read, as a trigger gives them
    frequency, per_cycle = truth["actual_frequency"], truth["samples_per_cycle"]
    found = []
    for k, row in enumerate(truth["parameters"]):
        table = np.loadtxt(folder / "records" / f"{row['specimen']}.csv", delimiter=",", skiprows=1)
        last = table[-int(3.0 * per_cycle) :, 1]
        kept = table[:, 0] >= max(float(held["release_time"][k]), 0.0) + 0.02 / frequency
        points = differentiated(table[kept, 0], table[kept, 1] - last.mean(), truth["mass"], per_cycle, window)
        omega = 2.0 * np.pi * frequency
        loud = np.hypot(points.x, points.v / omega) > _LOUD * truth["amplitude"]
        found.append(Points(*(column[loud] for column in points)))
    return found


def read_truth(folder: Path) -> dict[str, Any]:
    """Return the truth of a batch."""
    return json.loads((folder / "truth.json").read_text(encoding="utf-8"))
