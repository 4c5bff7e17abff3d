"""Other data for a model that is there: models of one shape are built, and compiled, once."""

from __future__ import annotations

import numpy as np
import pymc as pm
import xarray as xr

from .._common.checks import InputError
from ..likelihood.density import Density
from ..likelihood.dims import keep_unit
from ..likelihood.specimen_likelihood import specimen_arrays
from .targets import Target, note_density, targets_of


def set_backbones(data: Density | xr.Dataset, *, name: str = "backbone", model: pm.Model | None = None) -> None:
    """Put what was measured on another structure into a model, which keeps its shape: `pymc.set_data` for backbones.

    What is compiled for the model stays valid: `sample` does not compile again, nor does nutpie.

    Parameters
    ----------
    data : Density or xarray.Dataset
        Of the kind that the model was built from: a density for the likelihood of a population, else backbones with
        standard errors, of as many specimens. At the same levels, of the same observables; a specimen need not reach
        every level.
    name : str, default "backbone"
        Name of the likelihood in the model.
    model : pymc.Model, optional
        Default: the model of the current context.

    Raises
    ------
    InputError
        No such likelihood in the model, or data of another kind, other levels, observables or number of specimens.

    See Also
    --------
    build_model : builds one for each structure.
    sample : draws from the model.

    Notes
    -----
    Priors stay as they are, and so does the mass. Choose levels that all structures reach and bounds that hold for all
    of them; else build a model for each.

    Examples
    --------
    Backbones of many structures at common levels::

        model = build_model(oscillator, structures[0], bounds, likelihood="pooled")
        for backbones in structures:
            set_backbones(backbones, model=model)
            posterior = sample(model)
    """
    model = pm.modelcontext(model)
    targets = {target.name: target for target in targets_of(model)}
    if name not in targets:
        raise InputError(f"`name` must be a backbone likelihood of the model ({', '.join(targets) or 'it has none'}), "
                         f"got {name!r}.")  # fmt: skip
    target = targets[name]
    if isinstance(data, Density):
        _set_density(model, target, data)
    elif isinstance(data, xr.Dataset):
        _set_specimens(model, target, data)
    else:
        raise InputError(f"`data` must be a Density or a Dataset of backbones, got {type(data).__name__}.")


def _set_density(model: pm.Model, target: Target, density: Density) -> None:
    if target.density is None:
        raise InputError(f"{target.name!r} is the likelihood of specimens; give their backbones, not a density.")
    _check_same(target, density.observables, density.levels.tolist())
    codes = model[f"{target.name}_density_codes"]
    codes.set_value(density.codes.astype(codes.type.dtype))
    note_density(codes, density)
    model[f"{target.name}_density_table"].set_value(density.table)


def _set_specimens(model: pm.Model, target: Target, data: xr.Dataset) -> None:
    if target.density is not None:
        raise InputError(f"{target.name!r} is the likelihood of a population; give a density, from `fit_density`.")
    held = [str(observable) for observable in data["observable"].values]
    if set(target.response.observables) <= set(held):
        data = data.sel(observable=list(target.response.observables))
    observables = tuple(str(observable) for observable in data["observable"].values)
    _check_same(target, observables, np.asarray(data["level"], dtype=float).tolist())
    count = len(target.centre)
    if data.sizes["specimen"] != count:
        raise InputError(
            f"{target.name!r} compares {count} specimen(s), got {data.sizes['specimen']}; build a model for these."
        )
    for ending, array in specimen_arrays(data).items():
        model[f"{target.name}_{ending}"].set_value(array)
    keep_unit(model[f"{target.name}_values"], data)
    dim = model.named_vars_to_dims[target.name][0]
    model.set_dim(dim, count, coord_values=[str(specimen) for specimen in data["specimen"].values])


def _check_same(target: Target, observables: tuple[str, ...], levels: list[float]) -> None:
    """Raise unless the model simulates these observables at these levels."""
    response = target.response
    if observables != response.observables:
        raise InputError(
            f"{target.name!r} compares {', '.join(response.observables)}, got {', '.join(observables)}; build a model "
            "for these."
        )
    if levels != list(response.levels):
        raise InputError(
            f"{target.name!r} simulates {len(response.levels)} levels from {response.levels[0]:.6g} to "
            f"{response.levels[-1]:.6g}, got {len(levels)} from {levels[0]:.6g} to {levels[-1]:.6g}; measure at "
            "the same levels, or build a model for these."
        )
