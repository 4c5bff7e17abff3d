"""An updated model, and what is told of it: what ``result.json`` holds, the figures, the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import xarray as xr

from .._common.checks import FloatArray
from .._common.text import equation_of, unit_of
from ..reporting.output_folder import package_version
from ..reporting.terminal import compare
from .measure import Measured

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from ..inference.fit_verdict import GoodnessOfFit
    from ..inference.population_summary import Population
    from ..likelihood.density import Density
    from ..oscillator import Oscillator

MASS = "mass"
MOST_PAIRED = 6  # parameters against each other in one figure; ArviZ draws no more than 40 panels


@dataclass(frozen=True)
class Updated:
    """A model, the backbones it was updated with, and the draws of its parameters."""

    oscillator: Oscillator
    measured: Measured
    bounds: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]
    likelihood: str
    density: Density | None
    posterior: xr.DataTree
    fit: GoodnessOfFit
    predictive: xr.Dataset
    table: pd.DataFrame
    """What `summarise` says of each parameter."""
    mass_error: float = 0.0
    population: Population | None = None
    """Of a hierarchical model."""

    @property
    def names(self) -> list[str]:
        """Of the parameters that were inferred."""
        return [name for name in self.bounds if name in self.posterior["posterior"]]

    @property
    def units(self) -> dict[str, str]:
        """Of the parameters, as the measured motion has them."""
        unit = self.measured.amplitude_unit
        return {name: unit_of(text, unit) for name, text in self.oscillator.units.items()}

    @property
    def population_names(self) -> list[str]:
        """Of the variables that are mean and spread of a hierarchical model's population."""
        return [] if self.population is None else [f"{name}_{what}" for name in self.bounds for what in ("mean", "sd")]


def result_of(updated: Updated, command: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what ``result.json`` holds."""
    from ..inference.diagnostics import simulations_of

    oscillator, posterior = updated.oscillator, updated.posterior
    return {
        "version": package_version(),
        "command": command,
        "settings": dict(settings),
        "seed": settings["random_seed"],
        "equation": equation_of(oscillator.equation, updated.measured.amplitude_unit),
        "mass": oscillator.mass,
        "mass_error": updated.mass_error,
        "effects": [effect.name for effect in oscillator.effects],
        "density": None if updated.density is None else updated.density.description,
        **updated.measured.entries(),
        "parameters": _parameters(updated),
        "population": None if updated.population is None else updated.population.as_dict(),
        "fixed": dict(updated.fixed),
        "comparison": compare(updated.measured.backbones, updated.predictive),
        "interrupted": posterior.attrs.get("interrupted"),
        "fit": updated.fit.as_dict(),
        "findings": _findings(updated),
        "failures": posterior.attrs.get("failures"),
        "simulations": simulations_of(posterior),
    }


def _findings(updated: Updated) -> list[str]:
    """Return what is wrong with the fit and the posterior, in sentences."""
    from ..inference.diagnostics import findings

    remedy, units = _remedy(updated), updated.units
    if updated.population is None:
        return findings(updated.posterior, updated.bounds, units=units, fit=updated.fit, remedy=remedy)
    # A specimen's prior is the population; only the population's mean has bounds to lean on.
    is_normal = updated.population.family == "normal"
    bounds = {f"{name}_mean": pair for name, pair in updated.bounds.items()} if is_normal else {}
    units = {f"{name}_mean": unit for name, unit in units.items()}
    names = [*updated.population_names, *updated.names]
    found = findings(updated.posterior, bounds, names=names, units=units, fit=updated.fit, remedy=remedy)
    return found + updated.population.sentences(len(updated.measured.backbones["specimen"]))


def report_of(result: Mapping[str, Any], updated: Updated, figures: Mapping[str, Figure]) -> str:
    """Return the page of a result."""
    from ..reporting.report_update import update_report_html

    return update_report_html(result, updated.fit, figures)


def _remedy(updated: Updated) -> str:
    """Say what to do on the command line about a model that lacks something."""
    from ..effects import BASE_EFFECTS

    base = [effect.name for effect in updated.oscillator.effects if effect.name not in BASE_EFFECTS]
    if not base:
        return "run `pymc-backbone diagnose` with the same records to find what is missing"
    return f"run `pymc-backbone diagnose --base {' '.join(base)}` with the same records to find what is missing"


def _parameters(updated: Updated) -> dict[str, dict[str, Any]]:
    entries = {}
    mass = updated.oscillator.mass
    # of a prior that is no interval the central 95 % are given
    bounds = {
        **updated.bounds, MASS: (max(mass - 1.96 * updated.mass_error, 0.0), mass + 1.96 * updated.mass_error)
    }  # fmt: skip
    units = {**updated.units, MASS: unit_of("kg", updated.measured.amplitude_unit)}
    own = updated.table.drop(index=updated.population_names)
    for label, row in own.iterrows():
        name = str(label).partition("[")[0]
        low, high = bounds[name] if updated.population is None else (float("nan"),) * 2  # the population is the prior
        kept = ("mean", "sd", "hdi_low", "hdi_high", "r_hat", "ess_bulk", "ess_tail")
        entries[str(label)] = {
            **{key: float(row[key]) for key in kept},
            "unit": units[name],
            "prior_low": float(low),
            "prior_high": float(high),
        }
    return entries


def figures_of(updated: Updated, true_values: Mapping[str, FloatArray] | None) -> dict[str, Figure]:
    """Draw everything that can be drawn of it."""
    from .. import plots

    measured, posterior = updated.measured, updated.posterior
    names, units = list(updated.bounds), updated.units
    figures = {
        "backbones": plots.plot_backbones(measured.backbones),
        "predictive": plots.plot_fit(measured.backbones, updated.fit),
    }
    if updated.population is None:
        figures["prior_posterior"] = plots.plot_prior_posterior(
            posterior, updated.bounds, units=units, true_values=true_values
        )
    else:
        figures["population"] = plots.plot_population(posterior, updated.oscillator, names, units=units)
        units = {f"{name}_{what}": unit for name, unit in units.items() for what in ("mean", "sd")}
        names = updated.population_names
    figures["trace"] = plots.plot_trace(posterior, names, units=units)
    if posterior["posterior"].sizes["chain"] > 1:
        figures["rank"] = plots.plot_rank(posterior, names, units=units)
    if updated.density is not None:
        figures["densities"] = plots.plot_densities(measured.backbones, updated.density, simulated=updated.predictive)
    scalars = sum(posterior["posterior"][name].isel(chain=0, draw=0).size for name in names)
    if 1 < scalars <= MOST_PAIRED:
        figures["pair"] = plots.plot_pair(posterior, names, units=units)
    if measured.records:
        figures["records"] = plots.plot_records(measured.records)
    return figures
