"""What a model is compared with: backbones or a density over them, and which likelihood these bear."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from .._common.checks import OBSERVABLES, InputError, check_choice
from ..likelihood.density import Density

POPULATION_SIZE = 8  # from this many complete specimens on, "auto" fits a density over them


def check_measured(data: Any) -> xr.Dataset:
    """Return backbones as they are; what is neither these nor a density is refused."""
    if not isinstance(data, xr.Dataset):
        raise InputError(f"`data` must be a Density or a Dataset of backbones, got {type(data).__name__}.")
    return data


def chosen_data(
    data: Density | xr.Dataset, likelihood: str, observables: Sequence[str] | None
) -> tuple[Density | xr.Dataset, str]:
    """Return the data that the likelihood is made from, and its kind."""
    if isinstance(data, Density):
        if likelihood not in ("auto", "population"):
            raise InputError(f"a density is a likelihood of the population, not {likelihood!r}; pass the backbones.")
        return data, "population"
    data = select_observables(check_measured(data), observables)
    return data, likelihood_of(data, likelihood)


def likelihood_of(backbones: xr.Dataset, likelihood: str = "auto") -> str:
    """Return which likelihood `build_model` takes for backbones: the one asked for, or what ``auto`` stands for."""
    if likelihood == "auto":
        complete = int(np.isfinite(np.asarray(backbones["value"])).all(axis=(1, 2)).sum())
        likelihood = "population" if complete >= POPULATION_SIZE else "specimen"
    if likelihood == "population":
        return likelihood
    return "pooled" if backbones.sizes["specimen"] == 1 else likelihood


def select_observables(data: xr.Dataset, observables: Sequence[str] | None) -> xr.Dataset:
    """Return the wanted observables in the canonical order."""
    held = [str(v) for v in data["observable"].values]
    wanted = held if observables is None else list(observables)
    for name in wanted:
        check_choice("observables", name, held)
    return data.sel(observable=[name for name in OBSERVABLES if name in wanted])


__all__ = ["check_measured", "chosen_data", "likelihood_of", "select_observables"]
