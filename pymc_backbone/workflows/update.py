"""From records to an updated model in a folder in one call: what the command ``update`` and the demo do."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .._common.backbone_dataset import backbone_dataset
from .._common.checks import FloatArray, InputError, check_choice
from .._common.options import settings_of
from ..inference.options import Comparing, Keeping, Modelling, Sampling
from ..measurement.options import Measuring
from ..measurement.reading.options import Reading
from ..reporting.output_folder import REPORT, claimed_output, read_result, write_results
from ..reporting.terminal import describe_batch, describe_result
from .measure import Measured, Progress, Say, measure, say_reading, say_warnings
from .updated import MASS, Updated, figures_of, report_of, result_of

if TYPE_CHECKING:
    from ..inference.fit_verdict import GoodnessOfFit
    from ..oscillator import Oscillator

FEWEST_DRAWS = 20  # of a run that was ended early; nothing can be said from fewer


def update(
    path: str | os.PathLike[str],
    modelling: Modelling,
    *,
    reading: Reading | None = None,
    measuring: Measuring | None = None,
    comparing: Comparing | None = None,
    sampling: Sampling | None = None,
    keeping: Keeping | None = None,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    command: str = "update",
    true_values: Mapping[str, FloatArray] | None = None,
    progress: Progress | None = None,
    say: Say = print,
) -> dict[str, Any]:
    """Infer the parameters of an oscillator from records, and write everything to an output folder.

    Parameters
    ----------
    path : path-like
        File or folder of records, or of backbone tables.
    modelling : Modelling
        Mass, effects, priors, fixed parameters.
    reading, measuring : optional
        As in `measure`.
    comparing : Comparing, optional
        The likelihood.
    sampling : Sampling, optional
        Draws, chains, step, seed.
    keeping : Keeping, optional
        The folder that keeps the draws as they come, and whether to continue the run that is there.
    output : path-like, optional
        Output folder; without one nothing is written.
    overwrite : bool, optional
        Whether the folder may hold something already; where a run is resumed it may hold the result of one that Ctrl-C
        ended early.
    command : str, optional
        Written to the result.
    true_values : mapping of str to array of float, optional
        Known parameters of the specimens, drawn in the figure of the posterior.
    progress : callable, optional
        Called with the stage and the fraction done.
    say : callable, optional
        Called with each line of progress; ``print`` by default.

    Returns
    -------
    dict
        What ``result.json`` holds; its keys are `results.RESULT_KEYS`.
    """
    reading = Reading() if reading is None else reading
    measuring = Measuring() if measuring is None else measuring
    comparing = Comparing() if comparing is None else comparing
    sampling = Sampling() if sampling is None else sampling
    keeping = Keeping() if keeping is None else keeping
    with _output_of(path, output, overwrite, keeping) as folder:
        return _update_into(
            folder, path, modelling, reading, measuring, comparing, sampling, keeping, overwrite=overwrite,
            command=command, true_values=true_values, progress=progress, say=say,
        )  # fmt: skip


def _update_into(
    folder: Path | None, path: str | os.PathLike[str], modelling: Modelling, reading: Reading, measuring: Measuring,
    comparing: Comparing, sampling: Sampling, keeping: Keeping, *, overwrite: bool, command: str,
    true_values: Mapping[str, FloatArray] | None, progress: Progress | None, say: Say,
) -> dict[str, Any]:  # fmt: skip
    """Update into a folder that is ready, or into none."""
    begin = time.perf_counter()
    sampling = replace(sampling, random_seed=_seed(sampling, keeping))
    oscillator = _oscillator(modelling)
    tell = progress or (lambda _stage, _fraction: None)
    tell("reading the records", float("nan"))
    measured = measure(path, reading, measuring, progress)
    say_reading(measured, say)
    say(describe_batch(measured.backbones))
    say_warnings(measured.notes, say)
    read = time.perf_counter()
    updated = _infer(oscillator, measured, modelling, comparing, sampling, keeping, say, progress)
    sampled = time.perf_counter()
    settings = {
        "path": path,
        **settings_of(reading, measuring, modelling, comparing, sampling, keeping),
        "likelihood": updated.likelihood,
        "output": folder,
        "overwrite": overwrite,
    }
    result = result_of(updated, command, settings)
    say("\n" + describe_result(result))
    if result["interrupted"]:
        say(f"\n{result['interrupted']}")
    tell("drawing the figures", float("nan"))
    figures = {} if folder is None else figures_of(updated, true_values)
    texts = {} if folder is None else {REPORT: report_of(result, updated, figures)}
    result["seconds"] = {
        "reading": round(read - begin, 2),
        "sampling": round(sampled - read, 2),
        "total": round(time.perf_counter() - begin, 2),
    }
    if folder is not None:
        parts = {"backbones": measured.backbones, "summary": updated.table, "posterior": updated.posterior}
        write_results(folder, result, **parts, figures=figures, texts=texts)
        say(f"\nAll numbers, draws and figures are in {folder}; begin with {folder / REPORT}.")
    return result


def _infer(
    oscillator: Oscillator,
    measured: Measured,
    modelling: Modelling,
    comparing: Comparing,
    sampling: Sampling,
    keeping: Keeping,
    say: Say,
    progress: Progress | None,
) -> Updated:
    """Build the model, sample it, and simulate backbones with draws of its posterior."""
    tell = progress or (lambda _stage, _fraction: None)
    tell("building the model", float("nan"))
    from ..inference.diagnostics import summarise
    from ..inference.goodness import goodness_of_fit
    from ..inference.model import build_model, likelihood_of
    from ..inference.sampling import sample
    from ..inference.targets import targets_of

    kind = likelihood_of(measured.backbones, comparing.likelihood)
    bounds = _bounds(oscillator, measured, modelling)
    chosen = {**settings_of(comparing), "likelihood": kind}
    model = build_model(
        oscillator,
        measured.backbones,
        bounds=bounds,
        fixed=dict(modelling.fixed),
        mass_error=modelling.mass_error,
        **chosen,
    )
    say(
        f"\n{oscillator.equation}\n\nSampling {sampling.chains} chains of {sampling.tune} + {sampling.draws} draws "
        f"({sampling.step}, {kind} likelihood) ..."
    )
    kept = settings_of(keeping) if keeping.store is not None else {}
    posterior = sample(model, **settings_of(sampling), **kept, progress=progress)
    if "interrupted" in posterior.attrs and posterior["posterior"].sizes["draw"] < FEWEST_DRAWS:
        say(f"\n{posterior.attrs['interrupted']} These are too few for a summary.")
        raise KeyboardInterrupt
    tell("comparing the posterior with the measurement", float("nan"))
    nominal, fixed = _at_nominal_mass(posterior, oscillator, modelling)
    fit = goodness_of_fit(
        oscillator,
        measured.backbones,
        nominal,
        bounds,
        fixed=fixed,
        likelihood=kind,
        random_seed=sampling.random_seed,
    )
    return Updated(
        oscillator=oscillator,
        measured=measured,
        bounds=bounds,
        fixed=dict(modelling.fixed),
        likelihood=kind,
        density=targets_of(model)[0].density,
        posterior=posterior,
        fit=fit,
        predictive=_predictive(fit, measured.backbones),
        table=summarise(posterior, [name for name in (MASS, *bounds) if name in posterior["posterior"]]),
        mass_error=modelling.mass_error,
    )


def _at_nominal_mass(
    posterior: xr.DataTree, oscillator: Oscillator, modelling: Modelling
) -> tuple[xr.DataTree, dict[str, float]]:
    """Return the posterior as the oscillator with its one mass would have it, and what is fixed in all its draws."""
    fixed = dict(modelling.fixed)
    if MASS not in posterior["posterior"]:
        return posterior, fixed
    from ..inference.model import NOMINAL

    draws = posterior["posterior"].to_dataset()
    powers = oscillator.mass_exponents
    goes_with_mass = {name: draws[f"{NOMINAL}{name}"] for name in powers if f"{NOMINAL}{name}" in draws}
    for name in [name for name in fixed if powers[name]]:
        goes_with_mass[name] = fixed.pop(name) * (oscillator.mass / draws[MASS]) ** powers[name]
    kept = draws.drop_vars([MASS, *(f"{NOMINAL}{name}" for name in powers if f"{NOMINAL}{name}" in draws)])
    return xr.DataTree.from_dict({"posterior": kept.assign(goes_with_mass)}), fixed


def _output_of(
    path: str | os.PathLike[str], output: str | os.PathLike[str] | None, overwrite: bool, keeping: Keeping
) -> AbstractContextManager[Path | None]:
    """Return what makes the output folder ready; the draws are kept elsewhere."""
    is_same = output is not None and keeping.store is not None
    if is_same and Path(str(keeping.store)).resolve() == Path(str(output)).resolve():
        raise InputError(f"The store and the output are both {output}; give each a folder of its own.")
    is_rest = output is not None and keeping.resume and _ended_early(output)
    return claimed_output(output, overwrite or is_rest, records=path)


def _seed(sampling: Sampling, keeping: Keeping) -> int:
    """Return the seed: the one given, the one of the run that is resumed, or a new one; check the store on the way."""
    if keeping.store is not None:
        from ..inference.store.run_folder import DrawStore

        with DrawStore(keeping.store, keeping.resume) as kept:
            return kept.seed(sampling.random_seed)
    if keeping.resume:
        raise InputError("`resume` continues a run that was stored; name its folder with `store`.")
    if sampling.random_seed is not None:
        return sampling.random_seed
    return int(np.random.SeedSequence().generate_state(1)[0])


def _ended_early(output: str | os.PathLike[str]) -> bool:
    """Whether a folder holds the result of a run that was ended early, which the rest of that run may replace."""
    try:
        return bool(read_result(output).get("interrupted"))
    except InputError:
        return False


def _oscillator(modelling: Modelling) -> Oscillator:
    """Return the model; raise if priors or fixed values cannot be used with it."""
    from ..oscillator import Oscillator

    oscillator = Oscillator(modelling.mass, modelling.effects)
    for option, names in (("priors", modelling.priors), ("fixed", modelling.fixed)):
        for name in names:
            check_choice(option, name, oscillator.parameter_names)
    both = sorted(set(modelling.priors) & set(modelling.fixed))
    if both:
        raise InputError(f"{both[0]} has both a prior and a fixed value; keep one.")
    if set(modelling.fixed) == set(oscillator.parameter_names):
        raise InputError("Every parameter is fixed; leave at least one to infer.")
    return oscillator


def _bounds(oscillator: Oscillator, measured: Measured, modelling: Modelling) -> dict[str, tuple[float, float]]:
    highest = float(np.asarray(measured.backbones["level"])[-1])
    default = oscillator.default_bounds(highest, measured.angular_frequency)
    return {name: modelling.priors.get(name, limits) for name, limits in default.items() if name not in modelling.fixed}


def _predictive(fit: GoodnessOfFit, backbones: xr.Dataset) -> xr.Dataset:
    """Return the backbones of all draws as if each were a specimen."""
    value = fit.draws.reshape(-1, *fit.draws.shape[2:])
    return backbone_dataset(
        [f"simulated_{i + 1}" for i in range(len(value))],
        tuple(str(name) for name in backbones["observable"].values),
        fit.levels,
        value,
        np.where(np.isnan(value), np.nan, 0.0)[..., None] * np.ones(fit.levels.size),
        fit.amplitude_unit,
        ["simulated"],
    )
