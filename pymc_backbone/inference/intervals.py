"""Bounds of the Uniform priors: those that were given, checked, and the effects' own, scaled with the data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .._common.backbone_dataset import typical_frequency
from .._common.checks import FloatArray, InputError, check_choice
from ..likelihood.density import Density
from ..oscillator import Oscillator

Source = Oscillator | Callable[[dict[str, float], FloatArray], ArrayLike]
"""What is simulated: an oscillator, or a function of parameters and levels."""


def prior_intervals(
    source: Source,
    data: Density | xr.Dataset,
    bounds: dict[str, tuple[float, float]],
    fixed: dict[str, float],
) -> dict[str, tuple[float, float]]:
    """Return checked prior bounds of every parameter that is not fixed."""
    if isinstance(source, Oscillator):
        known = list(source.parameter_names)
        for label, given in (("bounds", bounds), ("fixed", fixed)):
            for name in given:
                check_choice(label, name, known)
        limits = {parameter.name: (parameter.minimum, parameter.maximum) for parameter in source.parameters}
        defaults = source.default_bounds(*_scales(data))
        result = {name: bounds.get(name, defaults[name]) for name in known if name not in fixed}
    else:
        limits = {}
        result = {name: interval for name, interval in bounds.items() if name not in fixed}
    for name, interval in result.items():
        try:
            low, high = (float(value) for value in interval)
        except (TypeError, ValueError):
            raise InputError(f"`bounds` of {name!r} must be two numbers (low, high), got {interval!r}.") from None
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(f"`bounds` of {name!r} must be finite with low < high, got ({low:g}, {high:g}).")
        minimum, maximum = limits.get(name, (-np.inf, np.inf))
        if low < minimum or high > maximum:
            raise InputError(
                f"`bounds` of {name!r} must lie between {minimum:g} and {maximum:g}, got ({low:g}, {high:g})."
            )
        result[name] = (low, high)
    return result


def _scales(data: Density | xr.Dataset) -> tuple[float, float]:
    """Return amplitude and angular frequency of the data, which default bounds are scaled with."""
    observables = data.observables if isinstance(data, Density) else ()
    levels = data.levels if isinstance(data, Density) else np.asarray(data["level"])
    if isinstance(data, xr.Dataset):
        frequency = typical_frequency(data)
    elif "frequency" in observables:
        frequency = float(np.nanmedian(data.sample(500, random_seed=0)[:, 0]))
    else:
        frequency = float("nan")
    if not np.isfinite(frequency):
        raise InputError("default bounds need the observable `frequency`; give `bounds` for every parameter.")
    return float(levels[-1]), 2.0 * np.pi * frequency


__all__ = ["Source", "prior_intervals"]
