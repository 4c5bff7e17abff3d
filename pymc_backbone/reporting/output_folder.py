"""The output folder of a run.

========================  ====================================================================================
file                      what it holds
========================  ====================================================================================
``result.json``           everything in numbers and words; see `RESULT_KEYS`
``summary.csv``           a row for each parameter: mean, sd, 95 % HDI, R-hat, effective draws
``backbones.csv``         measured backbones with standard errors: a row for each specimen and level
``backbones.nc``          the same with the covariance over the levels (NetCDF)
``mean_backbone.nc``      the backbone of the mean specimen, where the posterior was sampled on it
``report.html``           verdict, findings, numbers and figures in one page
``posterior.nc``          all draws and the sampler's statistics (NetCDF; ``xarray.open_datatree``)
``figures/*.png``         records, backbones, densities, chains, posteriors, measured against simulated
========================  ====================================================================================

Every file is written beside its place and then renamed, so that a run that is stopped leaves no half-written file.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from .._common.atomic_files import replacing
from .._common.checks import OBSERVABLE_UNITS, OBSERVABLES, InputError
from ..inference.store.lock import LOCK, FolderLock

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROGRAM = "pymc-backbone"
RESULT, SUMMARY, BACKBONES_TABLE, BACKBONES, POSTERIOR = (
    "result.json",
    "summary.csv",
    "backbones.csv",
    "backbones.nc",
    "posterior.nc",
)
REPORT, SCRIPT, MEAN_BACKBONE = "report.html", "model.py", "mean_backbone.nc"
CURVE_SCRIPT = "model_with_curves.py"
FIGURES = ("records", "backbones", "densities", "prior_posterior", "population", "trace", "rank", "pair", "predictive")
DIAGNOSIS_FIGURES = (
    *(f"{kind}_{observable}" for kind in ("backbones", "gap") for observable in OBSERVABLES),
    *("candidates", "held_out_levels", "held_out_specimens", "parameters", "detectable"),
    *("force_conservative", "force_damping", "force_sections", "distortion"),
    *("time_frequency_1", "time_frequency_2"),
)

RESULT_KEYS = {
    "program": "'pymc-backbone'",
    "version": "of this package",
    "command": "'extract', 'update' or 'demo', with its settings under 'settings'",
    "settings": "every setting of the run, defaults filled in",
    "seed": "of the sampler; the same seed and versions give the same draws",
    "equation": "of motion, with the meaning and unit of each symbol",
    "mass": "kg, or kg m^2 for a rotation",
    "mass_error": "standard deviation of the mass; 0 where it is known",
    "effects": "names, in the order of the parameters",
    "observables": "compared with the measurement: frequency [Hz], damping [1], offset [1]",
    "density": "what was fitted to the population, in words; null if none was",
    "levels": "amplitudes at which curves are compared, in 'amplitude_unit'",
    "amplitude_unit": "m or rad",
    "specimens": "names",
    "parameters": "name: mean, sd, hdi_low, hdi_high, unit, r_hat, ess_bulk, ess_tail, prior_low, prior_high; also of "
    "a mass that is uncertain, of whose prior these are the central 95 %; null where the prior is a population",
    "population": "of a hierarchical model: family, for each parameter the population's mean and sd (as under "
    "'parameters'; prior_low and prior_high are the prior's central 95 %), correlations, unidentified, prior_spreads; "
    "else null",
    "fixed": "name: value of the parameters that were not inferred",
    "comparison": "for each observable and level: mean and sd over the specimens, measured and simulated",
    "interrupted": "what is missing where a stored run was ended with Ctrl-C, a sentence; else null",
    "fit": "whether the model fits: passes, sentence, p_value, reduced_chi_square, degrees_of_freedom, "
    "pooling_p_value, worst, narrow (where the population comes out too narrow), prior_excludes, and "
    "lists of specimens and of entries (observable, level, specimen)",
    "findings": "sentences on what is wrong with the fit and the posterior; empty if nothing was found",
    "notes": "what was assumed or done while reading and conditioning the records",
    "failures": "number of simulations that gave no backbone; 0 too where they are not counted (see 'simulations')",
    "simulations": "number of simulations counted: those of the population likelihood; 0 for the others",
    "seconds": "reading, sampling and in total",
    "files": "written by this run, relative to the folder",
}
"""Keys of ``result.json``; ``extract`` writes those that apply to it."""


@contextmanager
def claimed_output(
    path: str | os.PathLike[str] | None, overwrite: bool = False, *, records: Any = None
) -> Iterator[Path | None]:
    """Make the output folder ready as `prepare_output` does, and keep it from other runs while this one lasts.

    Parameters
    ----------
    path : path-like or None
        Folder; None: there is none.
    overwrite, records
        As in `prepare_output`.

    Yields
    ------
    pathlib.Path or None
        The folder.

    Raises
    ------
    InputError
        As `prepare_output`, and where another run is writing there.
    """
    if path is None:
        yield None
        return
    made = [place for place in (Path(path), *Path(path).parents) if not place.exists()]
    folder = prepare_output(path, overwrite, records=records)
    lock = FolderLock(folder, "output folder")
    lock.acquire()
    try:
        yield prepare_output(path, overwrite, records=records)  # another run may have ended between check and lock
    finally:
        lock.remove()
        with contextlib.suppress(OSError):  # a run that wrote nothing leaves nothing: only empty folders can be removed
            for place in made:
                place.rmdir()


def prepare_output(path: str | os.PathLike[str], overwrite: bool = False, *, records: Any = None) -> Path:
    """Make the output folder ready, before any long computation.

    Parameters
    ----------
    path : path-like
        Folder; made if it is not there, with its parents.
    overwrite : bool, optional
        Whether a folder that is not empty may be used. `write_results` then replaces what it writes, and removes what
        an earlier run listed in its own ``result.json`` and this one did not write; nothing else is touched.
    records : path-like, optional
        Where the records are: results among them would be taken for records by the next run.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    InputError
        If the path is a file or the folder of the records, the folder is not empty (without ``overwrite``), or nothing
        can be written there.
    """
    folder = Path(path)
    if isinstance(records, str | os.PathLike) and folder.resolve() == Path(records).resolve():
        raise InputError(f"The output {folder} is where the records are; name another folder.")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output {folder} is a file; name a folder.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        occupied = sorted(entry.name for entry in folder.iterdir() if entry.name != LOCK)
        if occupied and not overwrite:
            raise InputError(
                f"The output folder {folder} is not empty (it holds {occupied[0]}); name another one, or give "
                "`overwrite=True`."
            )
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"The output folder {folder} cannot be written ({error.strerror}); name another one."
        ) from None
    return folder


def write_results(
    folder: Path,
    result: Mapping[str, Any],
    *,
    backbones: xr.Dataset | None = None,
    summary: pd.DataFrame | None = None,
    posterior: xr.DataTree | None = None,
    figures: Mapping[str, Figure] | None = None,
    texts: Mapping[str, str] | None = None,
    mean_backbone: xr.Dataset | None = None,
    keys: Collection[str] = RESULT_KEYS,
) -> list[str]:
    """Write what there is; return the names of the files, ``result.json`` last.

    Parameters
    ----------
    folder : pathlib.Path
        From `prepare_output`.
    result : mapping
        For ``result.json``: keys of `RESULT_KEYS`; ``program`` and ``files`` are added.
    backbones : xarray.Dataset, optional
        Measured backbones.
    summary : pandas.DataFrame, optional
        From `diagnostics.summarise`.
    posterior : xarray.DataTree, optional
        What `sample` returned.
    figures : mapping of str to matplotlib.figure.Figure, optional
        Figures by name, without suffix.
    texts : mapping of str to str, optional
        Whole text files by name.
    mean_backbone : xarray.Dataset, optional
        Backbone of the mean specimen, where a posterior was sampled on it.
    keys : collection of str, optional
        The documented keys of ``result.json``; `RESULT_KEYS` by default.

    Raises
    ------
    InputError
        If a file cannot be written (no space, no permission).
    """
    unknown = sorted(set(result) - set(keys))
    if unknown:
        raise KeyError(f"undocumented key of {RESULT}: {', '.join(unknown)}")
    writers: dict[str, Callable[[Path], Any]] = {}
    if backbones is not None:
        table = backbone_table(backbones)
        writers[BACKBONES_TABLE] = lambda path: table.to_csv(path, index=False, float_format="%.9g")
        portable = _portable(backbones)
        writers[BACKBONES] = partial(_write_netcdf, portable)
    if mean_backbone is not None:
        mean = _portable(mean_backbone)
        writers[MEAN_BACKBONE] = partial(_write_netcdf, mean)
    if summary is not None:
        writers[SUMMARY] = lambda path: summary.to_csv(path, float_format="%.9g")
    if posterior is not None:
        tree = xr.DataTree.from_dict({node.path: _portable(node.to_dataset()) for node in posterior.subtree})
        writers[POSTERIOR] = lambda path: tree.to_netcdf(path, engine="h5netcdf")
    for name, figure in (figures or {}).items():
        writers[f"figures/{name}.png"] = partial(_write_png, figure)
    for name, content in (texts or {}).items():
        writers[name] = partial(_write_text, content)
    files = [*writers, RESULT]
    stale = [name for name in _files_of_earlier_run(folder) if name not in files]
    text = json.dumps(plain({"program": PROGRAM, **result, "files": files}), indent=1, allow_nan=False)
    writers[RESULT] = partial(_write_text, text + "\n")
    write_files(folder, writers)
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    return files


def write_files(folder: Path, writers: Mapping[str, Callable[[Path], Any]]) -> list[str]:
    """Write files by name, each beside the place it then takes whole; return the names.

    Raises
    ------
    InputError
        If a file cannot be written (no space, no permission).
    """
    for name, write in writers.items():
        with replacing(folder / name) as temporary:
            write(temporary)
    return list(writers)


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
            _write_netcdf(_portable(backbones), temporary)
        else:
            backbone_table(backbones).to_csv(temporary, index=False, float_format="%.9g")
    return file


def read_result(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Read ``result.json`` of an output folder; raise `InputError` if there is none of this program."""
    path = Path(folder) / RESULT
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # no such file, no text, no JSON, nested too deep
        data = None
    if not isinstance(data, dict) or data.get("program") != PROGRAM:
        raise InputError(f"{path} is not a result of {PROGRAM}; name the output folder of a run.")
    return data


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


def _files_of_earlier_run(folder: Path) -> list[str]:
    """Names, out of those that this program writes, which an earlier run says it wrote."""
    ours = {RESULT, SUMMARY, BACKBONES_TABLE, BACKBONES, POSTERIOR, REPORT, SCRIPT, CURVE_SCRIPT}
    ours |= {f"figures/{name}.png" for name in (*FIGURES, *DIAGNOSIS_FIGURES)}
    try:
        listed = read_result(folder).get("files", [])
    except InputError:
        return []
    return [name for name in listed if isinstance(name, str) and name in ours] if isinstance(listed, list) else []


def package_version() -> str:
    """Return the version of this package."""
    from .. import __version__

    return str(__version__)


def _write_png(figure: Figure, path: Path) -> None:
    from .pictures import png

    path.write_bytes(png(figure))


def _write_text(text: str, path: Path) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def _write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write what `Dataset.to_netcdf` writes, which asks Dask, where it is installed, whether a cluster is at work."""
    store = xr.backends.H5NetCDFStore.open(path, mode="w", lock=False)
    try:
        dataset.dump_to_store(store)
    finally:
        store.close()


def _portable(dataset: xr.Dataset) -> xr.Dataset:
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
