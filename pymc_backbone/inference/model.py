"""Whole PyMC models from an oscillator, measured backbones and bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pymc as pm
import xarray as xr
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import InputError, check_choice, check_positive
from ..likelihood.data_consistent import fit_data_consistent
from ..likelihood.density import Density
from ..likelihood.density_fit import fit_density
from ..oscillator import Oscillator
from .intervals import Source, prior_intervals
from .measured import chosen_data
from .options import LIKELIHOODS
from .terms import backbone_likelihood

NOMINAL = "nominal_"
"""Before the name of a parameter as if the mass were that of the oscillator, where it is uncertain."""


def build_model(
    source: Source,
    data: Density | xr.Dataset,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    fixed: Mapping[str, float] | None = None,
    likelihood: str = "auto",
    density: str = "product",
    marginal: str = "best",
    observables: Sequence[str] | None = None,
    blocked: bool = False,
    release_amplitude: float | None = None,
    virgin: bool = True,
    mass_error: float = 0.0,
) -> pm.Model:
    """Build a PyMC model with Uniform priors and the likelihood of measured backbones.

    Parameters
    ----------
    source : Oscillator or callable
        The model, as in `backbone_likelihood`.
    data : Density or xarray.Dataset
        A fitted density, or backbones at levels.
    bounds : mapping of str to (low, high), optional
        Bounds of the Uniform priors. For an oscillator, parameters without one get the effect's default, scaled with
        the data; a function needs one for every parameter.
    fixed : mapping of str to float, optional
        Parameters that are known.
    likelihood : {"auto", "population", "specimen", "pooled"}
        One vector judged by a density over the population; one vector per specimen; one vector for all specimens.
        ``auto`` is "population" from eight complete specimens on, else "specimen" ("pooled" for a single one).
    density : {"product", "joint", "data_consistent"}
        For the population: as in `fit_density`, or `fit_data_consistent` with these priors.
    marginal : str
        As in `fit_density`, for the population.
    observables : sequence of str, optional
        Which to use; default: all that the data hold.
    blocked : bool, default False
        Whether all parameters form one vector ``parameters``, which Metropolis then moves as a block.
    release_amplitude, virgin
        As in `backbone_likelihood`.
    mass_error : float, default 0
        Standard deviation of the oscillator's mass [kg, kg m^2]: the model then has a variable ``mass``, normal and
        positive. A decay shows forces over mass only, so that what is sampled is ``nominal_linear_stiffness`` and the
        like, the parameters as if the mass were the oscillator's, with the priors; ``linear_stiffness`` is what
        follows with the mass. The decays say nothing of the mass unless a parameter that goes with it is fixed.

    Returns
    -------
    pymc.Model
        Coordinates ``specimen``, ``observable`` and ``level`` (likelihoods of specimens), ``parameter`` (blocked). What
        was measured stands in it as data, which `set_backbones` replaces.

    Raises
    ------
    InputError
        Unknown names, bounds that are not an interval or leave the physical range, data that cannot be used.

    See Also
    --------
    backbone_likelihood : the likelihood alone, inside a model of one's own.
    build_hierarchical_model : the population behind few specimens.
    sample : draws from the model.
    """
    check_choice("likelihood", likelihood, LIKELIHOODS)
    fixed = dict(fixed or {})
    data, kind = chosen_data(data, likelihood, observables)
    if kind != "population" and (density, marginal) != ("product", "best"):
        raise InputError(
            f"`density` and `marginal` are those of a population, and the likelihood is {kind!r} here; leave them out, "
            "or set `likelihood` to 'population'."
        )
    intervals = prior_intervals(source, data, dict(bounds or {}), fixed)
    if not intervals:
        raise InputError("every parameter is fixed; leave at least one to infer.")
    if kind == "population" and isinstance(data, xr.Dataset):
        if density == "data_consistent":
            data = fit_data_consistent(
                source, data, intervals, fixed=fixed, release_amplitude=release_amplitude, virgin=virgin
            )
        else:
            data = fit_density(data, kind=density, marginal=marginal)
    names = [*intervals, *fixed] if not isinstance(source, Oscillator) else list(source.parameter_names)
    coords: dict[str, list[str]] = {}
    if isinstance(data, xr.Dataset):
        coords["specimen"] = [str(v) for v in data["specimen"].values]
    if blocked:
        coords["parameter"] = list(intervals)
    low = np.array([interval[0] for interval in intervals.values()])
    high = np.array([interval[1] for interval in intervals.values()])
    powers = _powers_of_mass(source, mass_error, blocked)
    with pm.Model(coords=coords) as model:
        values: dict[str, Tensor | float] = dict(fixed)
        if powers and isinstance(source, Oscillator):
            uncertain = (source.mass, mass_error)
            values = _with_mass(intervals, fixed, powers, uncertain, "specimen" if kind == "specimen" else None)
        elif blocked:
            dims = ("specimen", "parameter") if kind == "specimen" else ("parameter",)
            block = pm.Uniform("parameters", low, high, dims=dims)
            for index, name in enumerate(intervals):
                values[name] = pm.Deterministic(name, block[..., index], dims=dims[:-1] or None)
        else:
            for name, (lower, upper) in intervals.items():
                values[name] = pm.Uniform(name, lower, upper, dims="specimen" if kind == "specimen" else None)
        backbone_likelihood(
            "backbone",
            source,
            data,
            {name: values[name] for name in names},
            release_amplitude=release_amplitude,
            virgin=virgin,
        )
    return model


def _powers_of_mass(source: Source, mass_error: float, blocked: bool) -> dict[str, float]:
    """Return the power of the mass of each parameter; empty where the mass is known."""
    if mass_error == 0.0:
        return {}
    check_positive("mass_error", mass_error)
    if not isinstance(source, Oscillator):
        raise InputError("`mass_error` is of an oscillator's mass; a function has none.")
    if blocked:
        raise InputError(
            "`blocked` holds the parameters in one vector, and the mass is none of them; drop one of the two."
        )
    return source.mass_exponents


def _with_mass(
    intervals: Mapping[str, tuple[float, float]],
    fixed: Mapping[str, float],
    powers: Mapping[str, float],
    mass: tuple[float, float],
    dims: str | None,
) -> dict[str, Tensor | float]:
    """Add an uncertain mass (value, error) and the parameters; return these as they are at the nominal mass."""
    nominal, error = mass
    ratio = pm.TruncatedNormal("mass", nominal, error, lower=0.0) / nominal
    values: dict[str, Tensor | float] = {name: value / ratio ** powers[name] for name, value in fixed.items()}
    for name, (lower, upper) in intervals.items():
        label = f"{NOMINAL}{name}" if powers[name] else name
        values[name] = pm.Uniform(label, lower, upper, dims=dims)
        if powers[name]:
            pm.Deterministic(name, values[name] * ratio ** powers[name], dims=dims)
    return values


__all__ = ["NOMINAL", "build_model"]
