"""One of the source paper's systems, run: population, density, posterior, numbers beside the published ones."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from .._common.checks import FloatArray, check_choice
from .case_comparison import Comparison, compare_distributions
from .cases import CASES, Case, get_case

if TYPE_CHECKING:
    import pandas as pd

    from ..likelihood.density import Density

LIKELIHOODS = ("product", "joint", "data_consistent")
PREDICTIVE_DRAWS = 400
UNDETERMINED = 0.1  # Kolmogorov distance from the prior below which the data said nothing of a parameter
KEYS = (
    "case", "likelihood", "observables", "parameter", "unit", "true_mean", "true_sd", "prior_low", "prior_high",
    "published_mean", "published_sd", "drawn_mean", "drawn_sd", "mean", "sd", "hdi_low", "hdi_high", "r_hat",
    "ess_bulk", "acceptance_rate", "seconds", "seed",
)  # fmt: skip
"""What each record of ``cases.json`` holds."""


@dataclass(frozen=True)
class CaseResult:
    """One case with one likelihood.

    Attributes
    ----------
    case : Case
        What was run.
    likelihood : str
        One of `LIKELIHOODS`.
    vectors : (n, p) array
        The population's parameters, in the order of ``case.data.parameter_names``.
    backbones : xarray.Dataset
        What was measured of it.
    density : Density
        What was fitted to that.
    posterior : xarray.DataTree
        Draws.
    predicted : xarray.Dataset
        Backbones of posterior draws.
    table : pandas.DataFrame
        As `summarise`.
    records : list of dict
        What ``cases.json`` holds.
    undetermined : tuple of str
        Parameters whose posterior is their prior.
    comparisons : list of Comparison
        Measured and simulated distributions at low, middle and high amplitude.

    See Also
    --------
    paper.run_case : returns it.
    """

    case: Case
    likelihood: str
    vectors: FloatArray
    backbones: xr.Dataset
    density: Density
    posterior: xr.DataTree
    predicted: xr.Dataset
    table: pd.DataFrame
    records: list[dict[str, Any]]
    undetermined: tuple[str, ...]
    comparisons: list[Comparison]


def run_case(
    name: str,
    likelihood: str = "product",
    *,
    specimens: int = 200,
    draws: int = 5000,
    tune: int = 2000,
    chains: int = 4,
    step: str = "metropolis",
    observables: Sequence[str] | None = None,
    random_seed: int = 1,
) -> CaseResult:
    """Draw the population of a case, fit the likelihood, sample the posterior, compare.

    Parameters
    ----------
    name : str
        One of `CASES`.
    likelihood : {"product", "joint", "data_consistent"}
        The source paper's, one density across the levels, or the one that recovers the population.
    specimens : int
        Size of the population, where the case leaves it open.
    draws, tune, chains, step
        As in `sample`.
    observables : sequence of str, optional
        Default: those of the case. ``("frequency",)`` is the source paper's likelihood.
    random_seed : int
        Of population and draws. The population does not depend on the likelihood.

    Returns
    -------
    CaseResult

    Raises
    ------
    InputError
        Unknown names, or a population that a density cannot be fitted to.

    See Also
    --------
    paper.CASES : the systems.
    fit_density : the likelihoods.
    """
    from ..inference.diagnostics import acceptance_rate, distance_from_uniform, summarise
    from ..inference.model import build_model
    from ..inference.sampling import sample
    from ..likelihood.density_fit import fit_density

    case = get_case(name)
    check_choice("likelihood", likelihood, LIKELIHOODS)
    begin = time.perf_counter()
    generator = np.random.default_rng([random_seed, list(CASES).index(case.name)])
    vectors = case.draw(specimens, generator)
    backbones = case.measure(vectors, generator, observables)
    bounds, fixed = case.prior_bounds, case.model_fixed
    if likelihood == "data_consistent":
        from ..likelihood.data_consistent import fit_data_consistent

        density = fit_data_consistent(case.model, backbones, bounds, fixed=fixed, random_seed=random_seed)
    else:
        density = fit_density(backbones, kind=likelihood)
    model = build_model(case.model, density, bounds, fixed=fixed)
    posterior = sample(model, draws=draws, tune=tune, chains=chains, step=step, random_seed=random_seed)
    seconds = time.perf_counter() - begin
    table = summarise(posterior, list(case.prior))
    predicted = _predict(case, posterior, backbones, random_seed)
    undetermined = tuple(
        parameter
        for parameter in case.prior
        if distance_from_uniform(np.asarray(posterior["posterior"][parameter]), *bounds[parameter]) < UNDETERMINED
    )
    facts = (acceptance_rate(posterior), seconds, random_seed)
    records = [_record(case, likelihood, backbones, vectors, parameter, table, facts) for parameter in case.prior]
    return CaseResult(
        case, likelihood, vectors, backbones, density, posterior, predicted, table, records, undetermined,
        compare_distributions(backbones, predicted, case.comparison),
    )  # fmt: skip


def _predict(case: Case, posterior: xr.DataTree, backbones: xr.Dataset, random_seed: int) -> xr.Dataset:
    """Return the backbones of some posterior draws."""
    from ..simulation.backbones import simulate_population

    chains, draws = (posterior["posterior"].sizes[dim] for dim in ("chain", "draw"))
    chosen = np.random.default_rng(random_seed).choice(chains * draws, min(PREDICTIVE_DRAWS, chains * draws), False)
    columns = [
        np.ravel(posterior["posterior"][name])[chosen]
        if name in case.prior
        else np.full(chosen.size, case.model_fixed[name])
        for name in case.model.parameter_names
    ]
    names = [str(value) for value in backbones["observable"].values]
    return simulate_population(case.model, np.column_stack(columns), case.levels, names)


def refused_records(
    case: Case, likelihood: str, observables: Sequence[str] | None, random_seed: int
) -> list[dict[str, Any]]:
    """Return the records of a run that came to no posterior: None where its numbers would stand."""
    names = case.observables if observables is None else observables
    nothing = dict.fromkeys(KEYS)
    return [
        {**nothing, **_known(case, likelihood, parameter), "observables": list(names), "seed": random_seed}
        for parameter in case.prior
    ]


def _known(case: Case, likelihood: str, parameter: str) -> dict[str, Any]:
    """Return what a record holds before anything is run."""
    true, published = (held.get(parameter, (None, None)) for held in (case.true, case.published))
    bounds = case.prior_bounds[parameter]
    return {
        "case": case.name,
        "likelihood": likelihood,
        "parameter": parameter,
        "unit": {item.name: item.unit for item in case.model.parameters}[parameter],
        **{
            key: value
            for name, pair in (("true", true), ("published", published))
            for key, value in zip((f"{name}_mean", f"{name}_sd"), pair, strict=True)
        },
        **dict(zip(("prior_low", "prior_high"), bounds, strict=True)),
    }


def _record(
    case: Case,
    likelihood: str,
    backbones: xr.Dataset,
    vectors: FloatArray,
    parameter: str,
    table: pd.DataFrame,
    facts: tuple[float | None, float, int],
) -> dict[str, Any]:
    """Return one record of ``cases.json``; None where there is no such number."""
    drawn: tuple[float | None, float | None] = (None, None)
    if parameter in case.true:
        column = vectors[:, case.data.parameter_names.index(parameter)]
        drawn = (float(column.mean()), float(column.std()))
    held = {
        **_known(case, likelihood, parameter),
        "observables": [str(v) for v in backbones["observable"].values],
        **dict(zip(("drawn_mean", "drawn_sd"), drawn, strict=True)),
        **{key: float(table.loc[parameter, key]) for key in ("mean", "sd", "hdi_low", "hdi_high", "r_hat", "ess_bulk")},
        **dict(zip(("acceptance_rate", "seconds", "seed"), facts, strict=True)),
    }
    return {key: held[key] for key in KEYS}


__all__ = ["KEYS", "LIKELIHOODS", "CaseResult", "refused_records", "run_case"]
