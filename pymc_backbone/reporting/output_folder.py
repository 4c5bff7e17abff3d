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

import json
import os
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import xarray as xr

from .._common.atomic_files import replacing
from .._common.checks import OBSERVABLES, InputError
from .backbone_files import backbone_table
from .portable import plain, portable, write_netcdf

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
        writers[BACKBONES] = partial(write_netcdf, portable(backbones))
    if mean_backbone is not None:
        writers[MEAN_BACKBONE] = partial(write_netcdf, portable(mean_backbone))
    if summary is not None:
        writers[SUMMARY] = lambda path: summary.to_csv(path, float_format="%.9g")
    if posterior is not None:
        tree = xr.DataTree.from_dict({node.path: portable(node.to_dataset()) for node in posterior.subtree})
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
