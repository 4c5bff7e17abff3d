"""Backbones at levels as files that `read_backbones` reads back."""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd
import xarray as xr

from .._common.atomic_files import replacing
from .._common.checks import OBSERVABLE_UNITS, InputError
from .portable import portable, write_netcdf


def write_backbones(backbones: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write backbones at levels to a file that `read_backbones` reads back.

    Parameters
    ----------
    backbones : xarray.Dataset
        From `backbones_at_levels` or `read_backbones`.
    path : str or path
        Ends in ``.nc`` (NetCDF: all there is, with the covariance over the levels) or ``.csv`` (a row for each specimen
        and level, with standard errors, nine digits).
    overwrite : bool, default False
        Whether a file of that name may be replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        When the name ends otherwise, the file exists and ``overwrite`` is False, or it cannot be written.

    See Also
    --------
    read_backbones : reads them back.
    """
    file = Path(os.fspath(path))
    kind = file.suffix.lower()
    if kind not in (".nc", ".csv"):
        raise InputError(f"{file}: backbones are written as .nc or .csv; choose a name that ends so.")
    if file.exists() and not overwrite:
        raise InputError(f"{file}: exists already; choose another name or give `overwrite=True`.")
    with replacing(file) as temporary:
        if kind == ".nc":
            write_netcdf(portable(backbones), temporary)
        else:
            backbone_table(backbones).to_csv(temporary, index=False, float_format="%.9g")
    return file


def backbone_table(backbones: xr.Dataset) -> pd.DataFrame:
    """List backbones as `read_backbones` reads them: a row for each specimen and level that was reached."""
    unit = backbones.attrs.get("amplitude_unit", "m")
    frame = backbones["value"].to_series().unstack("observable")
    errors = backbones["standard_error"].to_series().unstack("observable")
    columns: dict[str, pd.Series] = {}
    for name in map(str, backbones["observable"].values):
        bracket = f" [{OBSERVABLE_UNITS[name]}]" if OBSERVABLE_UNITS[name] != "1" else ""
        columns[f"{name}{bracket}"] = frame[name]
        columns[f"{name}_error{bracket}"] = errors[name]
    table = pd.DataFrame(columns).dropna(how="all")
    order = [str(name) for name in backbones["specimen"].values]
    table = table.reindex(order, level="specimen").reset_index()
    return table.rename(columns={"level": f"amplitude [{unit}]"})


__all__ = ["backbone_table", "write_backbones"]
