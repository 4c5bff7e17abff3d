"""What a hierarchical posterior says of the population: mean, spread and correlation of its parameters, in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import xarray as xr
from scipy.stats import halfnorm

from .._common.checks import FloatArray
from .diagnostics import UNIDENTIFIED_DISTANCE, distance_from_uniform, summarise

POPULATION_VARIABLES = ("mean", "sd")
KEPT = ("mean", "sd", "hdi_low", "hdi_high", "r_hat", "ess_bulk", "ess_tail")
_CENTRAL = (0.025, 0.975)


@dataclass(frozen=True)
class Population:
    """Mean, spread and correlation of the parameters over a population.

    Attributes
    ----------
    family : {"normal", "uniform"}
        Of the population.
    parameters : mapping
        For each parameter what is known of the population's ``mean`` and ``sd``: mean, sd and 95 % interval of the
        posterior, R-hat, effective draws, and the central 95 % of the prior (``prior_low``, ``prior_high``).
    correlations : tuple of mapping
        For each pair of parameters (``between``) the same numbers; empty where parameters are independent.
    unidentified : tuple of str
        Parameters that the backbones say nothing about.
    prior_spreads : tuple of str
        Parameters whose spread is that of its prior: the specimens say nothing of it.
    """

    family: str
    parameters: Mapping[str, Mapping[str, Mapping[str, float]]]
    correlations: tuple[Mapping[str, object], ...]
    unidentified: tuple[str, ...]
    prior_spreads: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain numbers and words, as ``result.json`` holds them."""
        return {
            "family": self.family,
            "parameters": {name: dict(entry) for name, entry in self.parameters.items()},
            "correlations": [dict(entry) for entry in self.correlations],
            "unidentified": list(self.unidentified),
            "prior_spreads": list(self.prior_spreads),
        }

    def sentences(self, specimens: int) -> list[str]:
        """Say what the specimens leave open about their population.

        Parameters
        ----------
        specimens : int
            How many were measured.
        """
        found = [
            f"The backbones say nothing about {name}: its posterior is the prior; observe another quantity (damping, "
            "offset), use higher levels, or fix it."
            for name in self.unidentified
        ]
        found += [
            f"The spread of {name} over the population is that of its prior: {specimens} specimens say nothing of it; "
            "measure more of them, or narrow its prior."
            for name in self.prior_spreads
            if name not in self.unidentified
        ]
        return found


def population_of(
    posterior: xr.DataTree, bounds: Mapping[str, tuple[float, float]], unidentified: Sequence[str] = ()
) -> Population:
    """Summarise the population of a hierarchical posterior.

    Parameters
    ----------
    posterior : xarray.DataTree
        Draws of a model from `build_hierarchical_model`.
    bounds : mapping of str to (low, high)
        As the model was built with.
    unidentified : sequence of str, optional
        From `unidentified_parameters`.
    """
    draws = posterior["posterior"].to_dataset()
    family = "uniform" if f"{next(iter(bounds))}_low" in draws else "normal"
    names = [f"{name}_{what}" for name in bounds for what in POPULATION_VARIABLES]
    table = summarise(posterior, names)
    parameters: dict[str, dict[str, dict[str, float]]] = {}
    for name, (low, high) in bounds.items():
        priors = _priors(family, low, high)
        parameters[name] = {
            what: {
                **{key: float(table.loc[f"{name}_{what}", key]) for key in KEPT},
                "prior_low": priors[what][0],
                "prior_high": priors[what][1],
            }
            for what in POPULATION_VARIABLES
        }
    return Population(
        family,
        parameters,
        _correlations(draws, list(bounds)),
        tuple(unidentified),
        _of_prior(draws, bounds) if family == "normal" else (),
    )


def _priors(family: str, low: float, high: float) -> dict[str, tuple[float, float]]:
    """Return the central 95 % of the priors of a population's mean and standard deviation."""
    width, share = high - low, np.asarray(_CENTRAL)
    if family == "normal":
        mean, sd = low + width * share, halfnorm.ppf(share, scale=width / np.sqrt(12.0))
    else:  # two edges, uniform over all pairs: mean and difference are triangular
        tail = np.sqrt(0.5 * _CENTRAL[0])
        mean = low + width * np.array([tail, 1.0 - tail])
        sd = width / np.sqrt(12.0) * (1.0 - np.sqrt(1.0 - share))
    return {"mean": (float(mean[0]), float(mean[1])), "sd": (float(sd[0]), float(sd[1]))}


def _correlations(draws: xr.Dataset, names: list[str]) -> tuple[dict[str, object], ...]:
    if "correlation" not in draws:
        return ()
    chosen = {
        f"{a}|{b}": draws["correlation"].sel(parameter=a, parameter_other=b, drop=True)
        for a, b in combinations(names, 2)
    }
    table = summarise(xr.DataTree.from_dict({"posterior": xr.Dataset(chosen)}))
    return tuple(
        {"between": label.split("|"), **{key: float(table.loc[label, key]) for key in KEPT}} for label in chosen
    )


def _of_prior(draws: xr.Dataset, bounds: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Return the parameters whose spread before it is cut has the half-normal distribution of its prior."""
    found = []
    for name, (low, high) in bounds.items():
        spread: FloatArray = np.asarray(draws["population_spread"].sel(parameter=name), dtype=float).ravel()
        share = halfnorm.cdf(spread, scale=(high - low) / np.sqrt(12.0))
        if distance_from_uniform(share, 0.0, 1.0) < UNIDENTIFIED_DISTANCE:
            found.append(name)
    return tuple(found)
