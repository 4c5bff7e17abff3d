"""Results as files hold them: in JSON what Python holds, in NetCDF what xarray holds."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr


def write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write what `Dataset.to_netcdf` writes, which asks Dask, where it is installed, whether a cluster is at work."""
    store = xr.backends.H5NetCDFStore.open(path, mode="w", lock=False)
    try:
        dataset.dump_to_store(store)
    finally:
        store.close()


def portable(dataset: xr.Dataset) -> xr.Dataset:
    """Return a copy that NetCDF can hold: booleans and objects as it knows them, attributes as text or numbers."""
    result = dataset.copy()
    for name, variable in result.variables.items():
        if variable.dtype == object and not all(isinstance(value, str) for value in variable.values.ravel()):
            result[name] = variable.astype(str)
        result[name].attrs = {key: _attribute(value) for key, value in variable.attrs.items()}
    result.attrs = {key: _attribute(value) for key, value in dataset.attrs.items()}
    return result


def _attribute(value: Any) -> Any:
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        return value
    if isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
        return list(value)  # ArviZ finds its sample dimensions in such a list
    return json.dumps(plain(value))


def plain(value: Any) -> Any:
    """Turn NumPy scalars, arrays, paths and tuples into what JSON holds; NaN and infinities become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return [plain(item) for item in value.tolist()]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if value is None or isinstance(value, str | int | float | bool) else str(value)


__all__ = ["plain", "portable", "write_netcdf"]
