"""From records to an output folder in one call: what the command line and the demo do.

`extract` turns records into backbones; `update` goes on to the posterior of an oscillator's parameters. Both say what
they do as they go, and return what they write to ``result.json``.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .._common.checks import FloatArray, InputError, check_choice
from ..reporting.output_folder import package_version, prepare_output, read_result, write_results
from ..reporting.terminal import compare, describe_batch, describe_measured, describe_reading, describe_result
from .measure import Levels, Measured, measure

if TYPE_CHECKING:
    import pandas as pd

    from ..oscillator import Oscillator

Say = Callable[[str], None]
Progress = Callable[[str, float], None]
PREDICTIVE_DRAWS = 400
MOST_WARNINGS = 5
MOST_PAIRED = 6  # parameters against each other in one figure; ArviZ draws no more than 40 panels
FEWEST_DRAWS = 20  # of a run that was ended early; nothing can be said from fewer


def extract(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str],
    overwrite: bool = False,
    progress: Progress | None = None,
    say: Say = print,
    **measurement: Any,
) -> dict[str, Any]:
    """Extract backbones and write them with figures to an output folder.

    Parameters
    ----------
    path : path-like
        File or folder of records.
    output : path-like
        Output folder.
    overwrite : bool, optional
        Whether the folder may hold something already.
    progress : callable, optional
        Called with the stage and the fraction done while cycles are extracted.
    say : callable, optional
        Called with each line of progress; ``print`` by default.
    **measurement
        ``band``, ``start``, ``levels``, ``observables``, ``columns``, ``quantity``, ``unit``, ``sampling_rate``, as in
        `measure`.

    Returns
    -------
    dict
        What ``result.json`` holds.
    """
    begin = time.perf_counter()
    folder = prepare_output(output, overwrite)
    measured = measure(path, progress=progress, **measurement)
    _say_assumptions(measured, say)
    say(describe_measured(measured.backbones))
    _say_warnings(measured, say)
    result: dict[str, Any] = {
        "version": package_version(),
        "command": "extract",
        "settings": {"records": str(path), **measurement},
        **_measured_entries(measured),
    }
    from ..reporting import posterior_plots as plots

    figures = {"backbones": plots.plot_backbones(measured.backbones)}
    if measured.records:
        figures["records"] = plots.plot_records(measured.records)
    result["seconds"] = {"total": round(time.perf_counter() - begin, 2)}
    write_results(folder, result, backbones=measured.backbones, figures=figures)
    say(f"\nBackbones and figures are in {folder}.")
    return result


def update(
    path: str | os.PathLike[str],
    *,
    mass: float,
    effects: Sequence[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
    fixed: Mapping[str, float] | None = None,
    is_table: bool = False,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    levels: Levels = None,
    observables: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    quantity: str | None = None,
    unit: str | None = None,
    sampling_rate: float | None = None,
    likelihood: str = "auto",
    density: str = "product",
    marginal: str = "best",
    draws: int = 2000,
    tune: int = 1000,
    chains: int = 4,
    step: str = "metropolis",
    random_seed: int | None = None,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
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
        File or folder of records, or of backbone tables if ``is_table``.
    mass : float
        Mass [kg], or inertia [kg m^2] for a rotation.
    effects : sequence of str, optional
        Effects beside linear stiffness and viscous damping.
    priors : mapping of str to (float, float), optional
        Bounds of Uniform priors that replace the default ones.
    fixed : mapping of str to float, optional
        Parameters that are not inferred.
    is_table, band, start, levels, observables, columns, quantity, unit, sampling_rate
        As in `measure`.
    likelihood : {"auto", "population", "specimen", "pooled"}, optional
        As in `build_model`; "auto" takes "population" from 8 specimens that reach every level, else "specimen",
        and "pooled" for one.
    density, marginal : str, optional
        As in `build_model`; for the population likelihood.
    draws, tune, chains, step, random_seed
        As in `sample`. Without a seed one is drawn, and written to the result.
    store, resume
        As in `sample`: a folder that keeps the draws as they come, and whether to continue the run that is there.
    output : path-like, optional
        Output folder; without one nothing is written.
    overwrite : bool, optional
        Whether the folder may hold something already; with ``resume`` it may hold the result of a run that Ctrl-C
        ended early.
    command : str, optional
        Written to the result.
    true_values : mapping of str to array of float, optional
        Known parameters of the specimens, drawn in the figure of the posterior.
    progress : callable, optional
        Called with the stage and the fraction done while cycles are extracted.
    say : callable, optional
        Called with each line of progress; ``print`` by default.

    Returns
    -------
    dict
        What ``result.json`` holds; its keys are `results.RESULT_KEYS`.
    """
    begin = time.perf_counter()
    settings = {
        name: value
        for name, value in locals().items()
        if name not in ("say", "progress", "true_values", "begin", "command")
    }
    if store is not None and output is not None and Path(store).resolve() == Path(output).resolve():
        raise InputError(f"The store and the output are both {output}; give each a folder of its own.")
    folder = None if output is None else prepare_output(output, overwrite or (resume and _ended_early(output)))
    seed = _seed(random_seed, store, resume)
    from ..oscillator import Oscillator

    oscillator = Oscillator(mass, effects)
    _check_names(oscillator, priors or {}, fixed or {})
    reading: dict[str, Any] = {"columns": columns, "quantity": quantity, "unit": unit, "sampling_rate": sampling_rate}
    conditioning: dict[str, Any] = {"band": band, "start": start, "levels": levels, "observables": observables}
    measured = measure(path, is_table=is_table, progress=progress, **conditioning, **reading)
    _say_assumptions(measured, say)
    say(describe_batch(measured.backbones))
    _say_warnings(measured, say)
    read = time.perf_counter()

    from ..inference.diagnostics import findings, simulations_of, summarise
    from ..inference.model import build_model
    from ..inference.sampling import sample
    from ..inference.targets import targets_of

    kind = _likelihood(likelihood, measured.backbones)
    bounds = _bounds(oscillator, measured, priors or {}, fixed or {})
    model = build_model(
        oscillator,
        measured.backbones,
        bounds=bounds,
        fixed=dict(fixed or {}),
        likelihood=kind,
        density=density,
        marginal=marginal,
    )
    fitted = targets_of(model)[0].density
    say(
        f"\n{oscillator.equation}\n\nSampling {chains} chains of {tune} + {draws} draws ({step}, {kind} likelihood) ..."
    )
    kept: dict[str, Any] = {} if store is None else {"store": store, "resume": resume}
    posterior = sample(model, draws=draws, tune=tune, chains=chains, step=step, random_seed=seed, **kept)
    sampled = time.perf_counter()
    if "interrupted" in posterior.attrs and posterior["posterior"].sizes["draw"] < FEWEST_DRAWS:
        say(f"\n{posterior.attrs['interrupted']} These are too few for a summary.")
        raise KeyboardInterrupt

    names = [name for name in bounds if name in posterior["posterior"]]
    table = summarise(posterior, names)
    predictive = _predictive(oscillator, posterior, fixed or {}, measured.backbones, seed)
    result: dict[str, Any] = {
        "version": package_version(),
        "command": command,
        "settings": {**settings, "likelihood": kind, "random_seed": seed},
        "seed": seed,
        "equation": oscillator.equation,
        "mass": oscillator.mass,
        "effects": [effect.name for effect in oscillator.effects],
        "density": None if fitted is None else fitted.description,
        **_measured_entries(measured),
        "parameters": _parameters(table, oscillator, bounds),
        "fixed": dict(fixed or {}),
        "comparison": compare(measured.backbones, predictive),
        "interrupted": posterior.attrs.get("interrupted"),
        "findings": findings(posterior, bounds, units=oscillator.units),
        "failures": posterior.attrs.get("failures"),
        "simulations": simulations_of(posterior),
    }
    say("\n" + describe_result(result))
    if result["interrupted"]:
        say(f"\n{result['interrupted']}")
    if folder is not None:
        figures = _figures(measured, fitted, predictive, posterior, bounds, oscillator.units, true_values)
        result["seconds"] = _seconds(begin, read, sampled)
        write_results(folder, result, backbones=measured.backbones, summary=table, posterior=posterior, figures=figures)
        say(f"\nAll numbers, draws and figures are in {folder}; begin with {folder / 'figures' / 'predictive.png'}.")
    result.setdefault("seconds", _seconds(begin, read, sampled))
    return result


def _say_assumptions(measured: Measured, say: Say) -> None:
    text = describe_reading(measured.records)
    if text:
        say(text + "\n")


def _seed(random_seed: int | None, store: str | os.PathLike[str] | None, resume: bool) -> int:
    """Return the seed: the one given, the one of the run that is resumed, or a new one; check the store on the way."""
    if store is not None:
        from ..inference.store.run_folder import DrawStore

        with DrawStore(store, resume) as kept:
            return kept.seed(random_seed)
    if resume:
        raise InputError("--resume continues a run that was stored; name its folder with --store.")
    return int(np.random.SeedSequence().generate_state(1)[0]) if random_seed is None else random_seed


def _ended_early(output: str | os.PathLike[str]) -> bool:
    """Whether a folder holds the result of a run that was ended early, which the rest of that run may replace."""
    try:
        return bool(read_result(output).get("interrupted"))
    except InputError:
        return False


def _say_warnings(measured: Measured, say: Say) -> None:
    warnings = [note for note in measured.notes if "warning: " in note]
    for note in warnings[:MOST_WARNINGS]:
        say(note)
    if len(warnings) > MOST_WARNINGS:
        say(f"... and {len(warnings) - MOST_WARNINGS} more warnings, in the notes of the result.")


def _check_names(oscillator: Oscillator, priors: Mapping[str, tuple[float, float]], fixed: Mapping[str, float]) -> None:
    known = oscillator.parameter_names
    for option, names in (("--prior", priors), ("--fix", fixed)):
        for name in names:
            check_choice(option, name, known)
    both = sorted(set(priors) & set(fixed))
    if both:
        raise InputError(f"{both[0]} has both a prior and a fixed value; keep one.")
    if set(fixed) == set(known):
        raise InputError("Every parameter is fixed; leave at least one to infer.")


def _bounds(
    oscillator: Oscillator,
    measured: Measured,
    priors: Mapping[str, tuple[float, float]],
    fixed: Mapping[str, float],
) -> dict[str, tuple[float, float]]:
    highest = float(np.asarray(measured.backbones["level"])[-1])
    default = oscillator.default_bounds(highest, measured.angular_frequency)
    return {name: priors.get(name, limits) for name, limits in default.items() if name not in fixed}


def _likelihood(likelihood: str, backbones: xr.Dataset) -> str:
    from ..inference.model import POPULATION_SIZE

    if likelihood != "auto":
        return likelihood
    complete = np.isfinite(np.asarray(backbones["value"])).all(axis=(1, 2)).sum()
    if complete >= POPULATION_SIZE:
        return "population"
    return "specimen" if backbones.sizes["specimen"] > 1 else "pooled"


def _predictive(
    oscillator: Oscillator, posterior: xr.DataTree, fixed: Mapping[str, float], backbones: xr.Dataset, seed: int
) -> xr.Dataset:
    from ..simulation.backbones import simulate_population

    draws = posterior["posterior"].to_dataset()
    columns = [
        np.full(1, fixed[name]) if name in fixed else np.asarray(draws[name], dtype=float).ravel()
        for name in oscillator.parameter_names
    ]
    size = max(column.size for column in columns)
    chosen = np.random.default_rng(seed).choice(size, size=min(PREDICTIVE_DRAWS, size), replace=False)
    parameters = np.column_stack([np.broadcast_to(column, (size,))[chosen] for column in columns])
    names = [str(name) for name in backbones["observable"].values]
    return simulate_population(oscillator, parameters, np.asarray(backbones["level"]), names)


def _parameters(
    table: pd.DataFrame, oscillator: Oscillator, bounds: Mapping[str, tuple[float, float]]
) -> dict[str, dict[str, Any]]:
    entries = {}
    for label, row in table.iterrows():
        name = str(label).partition("[")[0]
        low, high = bounds[name]
        kept = ("mean", "sd", "hdi_low", "hdi_high", "r_hat", "ess_bulk", "ess_tail")
        entries[str(label)] = {
            **{key: float(row[key]) for key in kept},
            "unit": oscillator.units[name],
            "prior_low": float(low),
            "prior_high": float(high),
        }
    return entries


def _measured_entries(measured: Measured) -> dict[str, Any]:
    backbones = measured.backbones
    return {
        "observables": [str(name) for name in backbones["observable"].values],
        "levels": np.asarray(backbones["level"], dtype=float),
        "amplitude_unit": measured.amplitude_unit,
        "specimens": [str(name) for name in backbones["specimen"].values],
        "notes": measured.notes,
    }


def _figures(
    measured: Measured,
    density: Any,
    predictive: xr.Dataset,
    posterior: xr.DataTree,
    bounds: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
    true_values: Mapping[str, FloatArray] | None,
) -> dict[str, Any]:
    from ..reporting import posterior_plots as plots

    names = list(bounds)
    figures = {
        "backbones": plots.plot_backbones(measured.backbones),
        "predictive": plots.plot_predictive(measured.backbones, predictive),
        "prior_posterior": plots.plot_prior_posterior(posterior, bounds, units=units, true_values=true_values),
        "trace": plots.plot_trace(posterior, names, units=units),
    }
    if posterior["posterior"].sizes["chain"] > 1:
        figures["rank"] = plots.plot_rank(posterior, names, units=units)
    if density is not None:
        figures["densities"] = plots.plot_densities(measured.backbones, density, simulated=predictive)
    scalars = sum(posterior["posterior"][name].isel(chain=0, draw=0).size for name in names)
    if 1 < scalars <= MOST_PAIRED:
        figures["pair"] = plots.plot_pair(posterior, names, units=units)
    if measured.records:
        figures["records"] = plots.plot_records(measured.records)
    return figures


def _seconds(begin: float, read: float, sampled: float) -> dict[str, float]:
    return {
        "reading": round(read - begin, 2),
        "sampling": round(sampled - read, 2),
        "total": round(time.perf_counter() - begin, 2),
    }
