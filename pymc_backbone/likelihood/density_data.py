"""What `fit_density` reads from a Dataset of backbones, checked."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from .._common.checks import OBSERVABLE_UNITS, FloatArray, InputError, check_choice, check_levels, check_observables


def population_values(
    backbones: xr.Dataset, observables: str | Iterable[str] | None
) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return observables, levels and values (n, o, l) of a dataset, or raise `InputError`."""
    if not isinstance(backbones, xr.Dataset) or "value" not in backbones:
        raise InputError(
            f"`backbones` must be an xarray.Dataset with a variable `value`, got {type(backbones).__name__}. "
            "Make one with `backbones_at_levels`."
        )
    dims = ("specimen", "observable", "level")
    found = tuple(str(name) for name in backbones["value"].dims)
    if set(found) != set(dims) or not {"observable", "level"} <= set(backbones.coords):
        raise InputError(
            f"`backbones` must have the dims {', '.join(dims)} with coordinates observable and level, got the dims "
            f"{', '.join(found)} and the coordinates {', '.join(map(str, backbones.coords)) or '(none)'}. "
            "Make it with `backbones_at_levels`."
        )
    available = tuple(str(name) for name in backbones["observable"].values)
    names = check_observables(available if observables is None else observables)
    for name in names:
        check_choice("observables", name, available)
    levels = check_levels(backbones["level"].values, "backbones.level")
    value = backbones["value"].sel(observable=list(names)).transpose(*dims).values.astype(np.float64)
    if np.isinf(value).any():
        specimen, observable, level = np.argwhere(np.isinf(value))[0]
        raise InputError(
            f"`backbones` must hold finite values or NaN, got {value[specimen, observable, level]} for "
            f"{names[observable]} of specimen {specimen} at level {levels[level]:g}. Drop that specimen."
        )
    return names, levels, value


def check_spread(sample: FloatArray, observable: str, level: float) -> None:
    """Raise `InputError` where values do not vary beyond rounding (observables without unit may have a true zero)."""
    size = max(float(np.abs(sample).max()), 1.0 if OBSERVABLE_UNITS[observable] == "1" else 0.0)
    if float(np.ptp(sample)) <= 1e-9 * size:
        raise InputError(
            f"`backbones` must vary between specimens, got {observable} from {sample.min():.9g} to {sample.max():.9g} "
            f"at level {level:g}. Leave {observable} out of `observables`, or that level out."
        )


def measurement_covariance(backbones: xr.Dataset, names: tuple[str, ...], complete: NDArray[np.bool_]) -> FloatArray:
    """Return the mean covariance (d, d) of the measurement errors: a block over the levels for every observable."""
    o, n_levels = len(names), backbones.sizes["level"]
    dims = ("specimen", "observable", "level", "level_other")
    if "covariance" in backbones:
        source = backbones["covariance"].sel(observable=list(names)).transpose(*dims)
        blocks = source.values[complete].astype(np.float64)
    elif "standard_error" in backbones:
        source = backbones["standard_error"].sel(observable=list(names)).transpose(*dims[:3])
        blocks = source.values[complete].astype(np.float64)[..., None] ** 2 * np.eye(n_levels)
    else:
        return np.zeros((o * n_levels, o * n_levels))
    if not np.isfinite(blocks).all():
        raise InputError(
            "`backbones` must hold a finite standard_error and covariance wherever it holds a value, got NaN or inf. "
            "Extract the backbones again, or drop those variables."
        )
    result = np.zeros((o, n_levels, o, n_levels))
    for i in range(o):
        block = blocks[:, i].mean(axis=0)
        result[i, :, i, :] = 0.5 * (block + block.T)
    return result.reshape(o * n_levels, o * n_levels)
