"""Backbones at levels of a population of simulated specimens, in the Dataset of measured ones."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .._common.backbone_dataset import backbone_dataset
from .._common.checks import OBSERVABLES, check_finite_array, check_levels, check_observables, check_positive
from ..oscillator import Oscillator
from .decay import Simulator
from .many import simulate_many


def simulate_population(
    oscillator: Oscillator,
    parameters: ArrayLike,
    levels: ArrayLike,
    observables: str | Iterable[str] = ("frequency", "damping"),
    *,
    release_amplitude: float | None = None,
    amplitude_unit: str = "m",
) -> xr.Dataset:
    """Simulate the backbones of many parameter vectors at levels, in the same Dataset as measured ones.

    Parameters
    ----------
    oscillator : Oscillator
        The model.
    parameters : (n, p) or (p,) array
        One row per specimen, in the order of ``oscillator.parameter_names``.
    levels : (l,) array
        Increasing amplitudes [m or rad].
    observables : str or iterable of str, default ("frequency", "damping")
        Any of ``frequency``, ``damping``, ``offset``.
    release_amplitude : float, optional
        Where the decay starts; matters for effects with memory.
    amplitude_unit : str, default "m"
        Recorded in the attributes.

    Returns
    -------
    xarray.Dataset
        As `backbones_at_levels`, standard errors and covariance zero; NaN where the simulation has no cycle at a level.

    See Also
    --------
    simulate_backbone : one specimen, with sensitivities.
    backbones_at_levels : the same of records.

    Notes
    -----
    From 512 specimens on, those of an oscillator without kinks, memory and states are simulated side by side, some ten
    times as fast, each within 1e-6 of what `simulate_backbone` gives (damping below 0.003: of 0.003).
    """
    chosen = check_observables(observables)
    at = check_levels(levels)
    table = check_finite_array("parameters", np.atleast_2d(np.asarray(parameters, dtype=np.float64)), ndim=2)
    rows = [OBSERVABLES.index(name) for name in chosen]
    for extreme in (table.min(axis=0), table.max(axis=0)) if len(table) else ():
        oscillator.pack(extreme)  # the limits of a parameter are an interval: all are within it or one of these is not
    release = 0.0 if release_amplitude is None else check_positive("release_amplitude", release_amplitude)
    value = simulate_many(Simulator(oscillator), table, at, release)[0][:, rows]
    covariance = np.zeros((*value.shape, at.size)) + np.where(np.isnan(value), np.nan, 0.0)[..., None]
    names = [f"simulated_{i + 1}" for i in range(table.shape[0])]
    return backbone_dataset(names, chosen, at, value, covariance, amplitude_unit, ["simulated"])
