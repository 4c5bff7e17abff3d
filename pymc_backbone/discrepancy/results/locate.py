"""Where measurement and model differ: per observable and level, in its own unit and in standard errors."""

from __future__ import annotations

import numpy as np
import xarray as xr

from ..._common.checks import OBSERVABLE_UNITS, FloatArray
from ..fitting.batch import Batch
from .entries import GapRange

_REAL = 3.0  # standard errors that the largest gap of a range has at least
_EDGE = 2.0  # standard errors up to which the range goes on


def mean_gap(backbones: xr.Dataset, simulated: xr.Dataset) -> tuple[FloatArray, FloatArray]:
    """Return measured minus simulated (observable, level), mean over the specimens, and its standard error.

    The standard error is that of the measurement or, where more than two specimens differ by more, that of their
    scatter. NaN where no specimen reaches a level. Both datasets hold the same specimens in the same order.
    """
    errors = np.asarray(backbones["standard_error"])
    gap = np.asarray(backbones["value"]) - np.asarray(simulated["value"])
    held = np.isfinite(gap) & np.isfinite(errors)
    count = held.sum(axis=0)
    gap = np.where(held, gap, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(count > 0, gap.sum(axis=0) / np.maximum(count, 1), np.nan)
        noise = np.where(held, errors, 0.0) ** 2
        variance = noise.sum(axis=0) / np.maximum(count, 1) ** 2
        scatter = np.where(held, gap - mean, 0.0) ** 2
        spread = scatter.sum(axis=0) / np.maximum(count - 1, 1) / np.maximum(count, 1)
    variance = np.where(count > 2, np.maximum(variance, spread), variance)
    return mean, np.where(count > 0, np.sqrt(variance), np.nan)


def where_different(batch: Batch, simulated: xr.Dataset) -> tuple[GapRange, ...]:
    """Return the ranges of amplitude in which the gap is real, largest first."""
    mean, error = mean_gap(batch.backbones.sel(specimen=list(batch.specimens)), simulated)
    names = [str(name) for name in simulated["observable"].values]
    levels = np.asarray(simulated["level"])
    found = []
    for o, name in enumerate(names):
        with np.errstate(invalid="ignore", divide="ignore"):
            significance = np.nan_to_num(mean[o] / error[o])
        for first, last in _runs(significance):
            inside = slice(first, last + 1)
            peak = first + int(np.argmax(np.abs(significance[inside])))
            if abs(significance[peak]) < _REAL:
                continue
            found.append(
                GapRange(
                    observable=name,
                    amplitude_low=float(levels[first]),
                    amplitude_high=float(levels[last]),
                    gap=float(mean[o, peak]),
                    unit=OBSERVABLE_UNITS[name],
                    standard_errors=float(abs(significance[peak])),
                    direction="above" if mean[o, peak] > 0.0 else "below",
                )
            )
    return tuple(sorted(found, key=lambda item: -item.standard_errors))


def _runs(significance: FloatArray) -> list[tuple[int, int]]:
    """Return first and last level of each run in which the gap has one sign and stands out."""
    runs: list[tuple[int, int]] = []
    begin: int | None = None
    for k in range(significance.size + 1):
        outside = k == significance.size or abs(significance[k]) < _EDGE
        turned = begin is not None and not outside and significance[k] * significance[begin] < 0.0
        if begin is not None and (outside or turned):
            runs.append((begin, k - 1))
            begin = None
        if begin is None and not outside:
            begin = k
    return runs
