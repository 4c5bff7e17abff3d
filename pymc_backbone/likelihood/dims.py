"""Names of the dimensions of backbones in a model: specimen, observable, level, with their coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pymc as pm
import xarray as xr
from pytensor.graph.basic import Variable

BACKBONE_DIMS = ("observable", "level")


def data_coords(data: xr.Dataset) -> dict[str, list[Any]]:
    """Return the coordinates of measured backbones."""
    return {"specimen": [str(v) for v in data["specimen"].values]} | backbone_coords(
        [str(v) for v in data["observable"].values], np.asarray(data["level"], dtype=float).tolist()
    )


def backbone_coords(observables: Sequence[str], levels: Sequence[float]) -> dict[str, list[Any]]:
    """Return the coordinates of one backbone."""
    return dict(zip(BACKBONE_DIMS, (list(observables), list(levels)), strict=True))


def name_dims(name: str, coords: Mapping[str, Sequence[Any]]) -> tuple[str, ...]:
    """Return the dimensions of a variable of the current model, added to the model where it has not got them.

    A model may hold backbones at other levels already, or a dimension of its own of the same name: then the variable's
    name stands in front. Specimens that the model names otherwise, but as many, are the same ones.
    """
    model = pm.modelcontext(None)
    dims = []
    for dim, labels in coords.items():
        chosen = next(each for each in (dim, f"{name}_{dim}") if _fits(model, each, labels))
        if chosen not in model.dim_lengths:
            model.add_coord(chosen, list(labels))
        dims.append(chosen)
    return tuple(dims)


def _fits(model: pm.Model, dim: str, labels: Sequence[Any]) -> bool:
    if dim not in model.dim_lengths:
        return True
    known = model.coords.get(dim)
    if known is None:
        return int(model.dim_lengths[dim].eval()) == len(labels)
    return list(known) == list(labels) or (dim == "specimen" and len(known) == len(labels))


def keep_unit(variable: Variable, data: xr.Dataset) -> None:
    """Note the unit of the amplitudes beside the measured values: coordinates of a model hold numbers only."""
    if "amplitude_unit" in data.attrs:
        variable.tag.amplitude_unit = str(data.attrs["amplitude_unit"])


def label_units(model: pm.Model, result: xr.DataTree) -> None:
    """Write the unit of amplitudes to the coordinate ``level`` of every group, where the model knows it."""
    units = {getattr(variable.tag, "amplitude_unit", None) for variable in model.data_vars} - {None}
    if len(units) != 1:
        return
    for group in result.children.values():
        for name in group.coords:
            if str(name) == "level" or str(name).endswith("_level"):
                group[str(name)].attrs["units"] = next(iter(units))
