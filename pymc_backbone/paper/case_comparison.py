"""Measured and simulated distributions of an observable, side by side at low, middle and high amplitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import stats

from .._common.checks import OBSERVABLE_UNITS, FloatArray
from ..likelihood.density_marginals import fit_gev, fit_uniform

PLACES = ("low", "middle", "high")
_WORDS = {"damping": "logarithmic decrement"}


@dataclass(frozen=True)
class Comparison:
    """One observable at one level.

    Attributes
    ----------
    observable, place : str
        ``place`` is low, middle or high.
    level : float
        Amplitude [m or rad].
    family : {"gev", "uniform"}
        What was fitted to both sides.
    measured, simulated : (n,) array
        Values in the unit of the observable.
    measured_fit, simulated_fit : tuple of float
        GEV: shape k (the sign of the source paper and of most tables: k > 0 has a tail upwards), scale, location.
        Uniform: low, high.
    overlap : float
        Integral of the smaller of both densities (kernel estimates): 1 where they agree, 0 where they are apart.
    wasserstein : float
        Mean distance by which one distribution must be moved to become the other, in the unit of the observable.
    """

    observable: str
    place: str
    level: float
    family: str
    measured: FloatArray
    simulated: FloatArray
    measured_fit: tuple[float, ...]
    simulated_fit: tuple[float, ...]
    overlap: float
    wasserstein: float

    def density(self, side: str) -> Callable[[FloatArray], FloatArray]:
        """Return the fitted density of one side, ``measured`` or ``simulated``, as a function."""
        fit = self.measured_fit if side == "measured" else self.simulated_fit
        if self.family == "uniform":
            return lambda x: np.asarray(stats.uniform.pdf(x, fit[0], fit[1] - fit[0]))
        shape, scale, location = fit
        return lambda x: np.asarray(stats.genextreme.pdf(x, -shape, location, scale))


def compare_distributions(measured: xr.Dataset, simulated: xr.Dataset, family: str) -> list[Comparison]:
    """Compare two sets of backbones at the lowest, the middle and the highest level they share.

    Parameters
    ----------
    measured, simulated : xarray.Dataset
        ``value`` over specimen, observable and level.
    family : {"gev", "uniform"}
        What is fitted to both sides.
    """
    levels = np.asarray(measured["level"], dtype=float)
    places = dict(zip(PLACES, (0, (levels.size - 1) // 2, levels.size - 1), strict=True))
    result = []
    for observable in [str(name) for name in measured["observable"].values]:
        for place, k in places.items():
            one, other = (_values(backbones, observable, k) for backbones in (measured, simulated))
            if min(one.size, other.size) < 3 or min(float(np.ptp(one)), float(np.ptp(other))) == 0.0:
                continue
            fits = _fit(one, family), _fit(other, family)
            distance = float(stats.wasserstein_distance(one, other))
            result.append(
                Comparison(
                    observable, place, float(levels[k]), family, one, other, *fits, overlap(one, other), distance
                )
            )
    return result


def _values(backbones: xr.Dataset, observable: str, k: int) -> FloatArray:
    value = np.asarray(backbones["value"].sel(observable=observable))[:, k]
    return value[np.isfinite(value)]


def _fit(values: FloatArray, family: str) -> tuple[float, ...]:
    if family == "uniform":
        return fit_uniform(values)
    location, scale, shape = fit_gev(values)
    return shape, scale, location


def overlap(one: FloatArray, other: FloatArray) -> float:
    """Return the integral of the smaller of two kernel densities (Silverman's bandwidth)."""
    spread = max(float(np.std(one)), float(np.std(other)))
    x = np.linspace(min(one.min(), other.min()) - spread, max(one.max(), other.max()) + spread, 2000)
    smaller = np.minimum(stats.gaussian_kde(one, "silverman")(x), stats.gaussian_kde(other, "silverman")(x))
    return float(np.clip(np.trapezoid(smaller, x), 0.0, 1.0))


def describe_gap(comparisons: list[Comparison], observable: str) -> str:
    """Say what the model cannot follow of an observable, or that it follows; one sentence."""
    chosen = [item for item in comparisons if item.observable == observable]
    if len(chosen) < 2:
        return ""
    name = _WORDS.get(observable, observable)
    unit = "" if OBSERVABLE_UNITS[observable] == "1" else f" {OBSERVABLE_UNITS[observable]}"
    worst = min(chosen, key=lambda item: item.overlap)
    if worst.overlap >= 0.8:
        return (
            f"The simulated {name} overlaps the measured one by {worst.overlap:.0%} or more at every amplitude shown."
        )
    low, high = chosen[0], chosen[-1]
    measured, simulated = (
        float(np.median(getattr(high, side)) - np.median(getattr(low, side))) for side in ("measured", "simulated")
    )
    offset = float(np.median(worst.simulated) - np.median(worst.measured))
    parts = [
        f"The model does not follow the {name}: at {worst.place} amplitude the distributions overlap by "
        f"{worst.overlap:.0%}, the simulated one lies {abs(offset):.3g}{unit} too {'high' if offset > 0 else 'low'}"
    ]
    words = [f"{'rises' if change > 0 else 'falls'} by {abs(change):.3g}{unit}" for change in (measured, simulated)]
    parts.append(f"from low to high amplitude the measured median {words[0]}, the simulated one {words[1]}")
    ratio = float(np.std(worst.simulated) / np.std(worst.measured))
    if not 0.67 < ratio < 1.5:
        parts.append(f"its spread there is {ratio:.2g} times the measured one")
    return "; ".join(parts) + "."


__all__ = ["Comparison", "compare_distributions", "describe_gap", "overlap"]
