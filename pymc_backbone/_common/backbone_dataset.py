"""The one container of backbones at levels, for measured and simulated curves alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from .checks import OBSERVABLE_UNITS, FloatArray


def backbone_dataset(
    names: list[str],
    observables: tuple[str, ...],
    levels: FloatArray,
    value: FloatArray,
    covariance: FloatArray,
    amplitude_unit: str,
    notes: list[str],
    noise_covariance: FloatArray | None = None,
) -> xr.Dataset:
    """Put level values and their covariance into the Dataset that measured and simulated backbones share.

    Parameters
    ----------
    names : list of str
        Specimens.
    observables : tuple of str
        In the order of `OBSERVABLES`.
    levels : (l,) array
        Increasing amplitudes [m or rad].
    value : (specimen, observable, level) array
        Hz for frequency, - for damping (logarithmic decrement) and offset.
    covariance : (specimen, observable, level, level) array
        Of each curve over the levels: noise, and doubt about how smooth the curve is.
    amplitude_unit : str
        m or rad.
    notes : list of str
        Kept in the attributes.
    noise_covariance : (specimen, observable, level, level) array, optional
        What noise alone has of the covariance.

    Returns
    -------
    xarray.Dataset
        ``value``, ``standard_error``, ``covariance``, ``noise_covariance`` where given, and units of the observables.
    """
    error = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3))
    dims: tuple[Any, ...] = ("specimen", "observable", "level")
    more = {} if noise_covariance is None else {"noise_covariance": ((*dims, "level_other"), noise_covariance)}
    return xr.Dataset(
        {
            "value": (dims, value),
            "standard_error": (dims, error),
            "covariance": ((*dims, "level_other"), covariance),
            **more,
        },
        coords={
            "specimen": names,
            "observable": list(observables),
            "level": levels,
            "level_other": levels,
            "unit": ("observable", [OBSERVABLE_UNITS[name] for name in observables]),
        },
        attrs={"amplitude_unit": amplitude_unit, "notes": notes},
    )


FREQUENCY = "frequency"
"""Attribute of backbones whose frequency is known but was not measured over the amplitude [Hz]."""


def typical_frequency(backbones: xr.Dataset) -> float:
    """Return the frequency [Hz] of backbones: the median of what was measured, else the known one; NaN without."""
    if FREQUENCY in backbones["observable"].values:
        return float(np.nanmedian(np.asarray(backbones["value"].sel(observable=FREQUENCY))))
    return float(backbones.attrs.get(FREQUENCY, np.nan))
