"""Hierarchical models: each specimen has its own parameters, drawn from a population whose spread is inferred."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import FloatArray, InputError, check_choice, check_positive
from ..oscillator import Oscillator
from ..simulation.response import make_response
from .intervals import prior_intervals
from .measured import select_observables
from .population import Coordinate, cut_moments, edge_ranges, normal_specimens, uniform_specimens
from .specimen_fits import SpecimenFits, fit_specimens
from .start_hint import StartHint, give_hint, start_hint_of
from .terms import backbone_likelihood

POPULATIONS = ("normal", "uniform")
MINIMUM_SPECIMENS = 3
logger = logging.getLogger("pymc_backbone")


def build_hierarchical_model(
    oscillator: Oscillator,
    backbones: xr.Dataset,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    population: str = "normal",
    correlated: bool = False,
    correlation_shape: float = 1.0,
    linearised: bool = False,
    fixed: Mapping[str, float] | None = None,
    observables: Sequence[str] | None = None,
    release_amplitude: float | None = None,
    virgin: bool = True,
) -> pm.Model:
    """Build a PyMC model of specimens drawn from a population, for few specimens with standard errors.

    Specimen s has parameters theta_s; its measured level values are Gaussian about the simulated ones, with the
    measured covariance. The theta_s are independent draws from the population:

    - ``normal``: theta_s ~ Normal(m, S), cut at the physical limits (damping is not negative). Priors: m Uniform within
      the bounds; each spread half-normal with the standard deviation that a Uniform over the bounds has; with
      ``correlated`` an LKJ prior of the correlation matrix.
    - ``uniform``: theta_s ~ Uniform(low, high), parameter by parameter. Prior: (low, high) is uniform over all
      pairs with low < high within the bounds.

    Parameters
    ----------
    oscillator : Oscillator
        The model; its gradient is needed, so a backbone function will not do.
    backbones : xarray.Dataset
        Of at least three specimens, with standard errors: from `backbones_at_levels` or `read_backbones`.
    bounds : mapping of str to (low, high), optional
        Prior bounds of the population's mean (``normal``) or of the whole population (``uniform``), in the
        parameters' units; default: the effects' own, scaled with the data.
    population : {"normal", "uniform"}
        Kind of distribution over the specimens.
    correlated : bool, default False
        Whether parameters may be correlated over the population (``normal`` only).
    correlation_shape : float, default 1.0
        Of the LKJ prior; 1 is uniform over correlation matrices, larger values favour small correlations.
    linearised : bool, default False
        Whether level values are taken as linear in a specimen's parameters about its own fit, instead of simulated at
        every step: for many specimens with small errors. The variable ``backbone`` is then a potential, without
        log-likelihoods for leave-one-out.
    fixed : mapping of str to float, optional
        Parameters that are known and the same for all specimens.
    observables : sequence of str, optional
        Which to use; default: all that the data hold.
    release_amplitude, virgin
        As in `backbone_likelihood`.

    Returns
    -------
    pymc.Model
        Coordinates ``specimen``, ``parameter`` (and ``parameter_other``). For each parameter the variables ``NAME``
        (specimen), ``NAME_mean`` and ``NAME_sd``, those of the population as it is cut at its limits; for a Uniform
        population ``NAME_low`` and ``NAME_high``; with ``correlated`` the matrix ``correlation``
        (parameter, parameter_other). The observed variable is ``backbone``.

    Raises
    ------
    InputError
        Fewer than three specimens, data without standard errors, a function for an oscillator, unknown names, bounds
        that cannot be used, correlation asked of a Uniform population or of one parameter, specimens that cannot be
        simulated.

    See Also
    --------
    build_model : one vector of parameters for all, or one for each.
    unidentified_parameters : what the data do not see.
    sample : draws from the model.

    Notes
    -----
    Sample it with ``sample(model, step="nutpie")`` or ``"nuts"``; a random walk is no use in so many dimensions. The
    sampler moves through standardised offsets from what each specimen's own least-squares fit and the population
    together predict, so the shape of the posterior does not depend on how informative specimens are, nor on units.
    A parameter that no backbone sees keeps its prior; `unidentified_parameters` names it.

    References
    ----------
    Gelman, Hill, "Data analysis using regression and multilevel models", Cambridge 2007; Papaspiliopoulos, Roberts,
    Skoeld, Statist. Sci. 22 (2007), doi 10.1214/088342307000000014, for the parametrisation; Lewandowski, Kurowicka,
    Joe, J. Multivar. Anal. 100 (2009), doi 10.1016/j.jmva.2009.04.008, for LKJ.

    Examples
    --------
    Nine measured specimens of a Duffing oscillator::

        model = build_hierarchical_model(Oscillator(1.0, "cubic_stiffness"), backbones)
        posterior = sample(model, draws=1000, tune=500, step="nutpie")
        az.summary(posterior, var_names=["linear_stiffness_mean", "linear_stiffness_sd"])
    """
    if not isinstance(oscillator, Oscillator):
        raise InputError(
            "a hierarchical model needs the gradient that an Oscillator has, got "
            f"{type(oscillator).__name__}; use build_model with likelihood='specimen' for a function."
        )
    if not isinstance(backbones, xr.Dataset):
        raise InputError(f"`backbones` must be a Dataset of backbones at levels, got {type(backbones).__name__}.")
    check_choice("population", population, POPULATIONS)
    check_positive("correlation_shape", correlation_shape)
    fixed = {name: float(value) for name, value in (fixed or {}).items()}
    data = select_observables(backbones, observables)
    if data.sizes["specimen"] < MINIMUM_SPECIMENS:
        raise InputError(
            f"a population needs at least {MINIMUM_SPECIMENS} specimens, got {data.sizes['specimen']}; take "
            "the likelihood 'specimen' or 'pooled' of build_model."
        )
    intervals = prior_intervals(oscillator, data, dict(bounds or {}), fixed)
    names = list(intervals)
    if not names:
        raise InputError("every parameter is fixed; leave at least one to infer.")
    if correlated and (population == "uniform" or len(names) < 2):
        raise InputError("`correlated` is for a Normal population of at least two parameters; leave it out.")
    physical = {p.name: (p.minimum, p.maximum) for p in oscillator.parameters}
    response = make_response(
        oscillator,
        data["level"].values,
        [str(v) for v in data["observable"].values],
        release_amplitude=release_amplitude,
        virgin=virgin,
    )
    limits = intervals if population == "uniform" else physical
    fits = fit_specimens(response, data, intervals, limits, fixed)  # type: ignore[arg-type]
    low, high = np.array(list(intervals.values())).T
    unidentified = tuple(name for name, is_free in zip(names, fits.unidentified, strict=True) if is_free)
    coords: dict[str, list[str]] = {"specimen": [str(v) for v in data["specimen"].values], "parameter": names}
    if correlated:
        coords["parameter_other"] = names
    with pm.Model(coords=coords) as model:
        offsets = pm.Normal("specimen_offsets", shape=fits.point.shape, dims=("specimen", "parameter"))
        if population == "normal":
            coordinates = [
                Coordinate(*physical[name], (high[j] - low[j]) / np.sqrt(12.0)) for j, name in enumerate(names)
            ]
            specimens, log_density = _add_normal(
                offsets, names, low, high, correlation_shape if correlated else None, coordinates, fits
            )
        else:
            specimens, log_density = _add_uniform(offsets, names, low, high, fits)
        # The offsets' own standard normal density is a helper only: it is taken out again.
        reference = -0.5 * (offsets**2).sum() - 0.5 * fits.point.size * np.log(2.0 * np.pi)
        hint = _make_hint(fits, low, high, unidentified)
        pm.Potential("specimens_given_population", give_hint(log_density - reference, hint))
        values: dict[str, Tensor | float] = dict(fixed)
        for j, name in enumerate(names):
            values[name] = pm.Deterministic(name, specimens[:, j], dims="specimen")
        if linearised:
            away = specimens - fits.point
            squared = (away[:, :, None] * fits.information * away[:, None, :]).sum()
            pm.Potential("backbone", (fits.slope * away).sum() - 0.5 * squared)
        else:
            backbone_likelihood(
                "backbone", oscillator, data, values, release_amplitude=release_amplitude, virgin=virgin
            )
    if unidentified:
        logger.warning("the backbones say nothing about %s: the posterior is the prior there", ", ".join(unidentified))
    return model


def unidentified_parameters(model: pm.Model) -> tuple[str, ...]:
    """Return the parameters of a hierarchical model that its data say nothing about: their posterior is the prior.

    All specimens together leave more than nine tenths of the prior's spread, judged by their level values linearised
    about their fits.

    Parameters
    ----------
    model : pymc.Model
        From `build_hierarchical_model`.

    Returns
    -------
    tuple of str
        Their names, in the order of the oscillator's parameters; empty where the data say something about each.

    Raises
    ------
    InputError
        For any other model.

    See Also
    --------
    build_hierarchical_model : the model that needs to know.
    findings : what the draws say.
    """
    hint = start_hint_of(model)
    if hint is None:
        raise InputError("`model` must come from build_hierarchical_model.")
    return hint.unidentified


def _add_normal(
    offsets: Tensor,
    names: list[str],
    low: FloatArray,
    high: FloatArray,
    correlation_shape: float | None,
    coordinates: list[Coordinate],
    fits: SpecimenFits,
) -> tuple[Tensor, Tensor]:
    """Add the variables of a Normal population; return specimens and the log-density of their offsets."""
    location = pm.Uniform("population_location", low, high, dims="parameter")
    spread = pm.HalfNormal("population_spread", (high - low) / np.sqrt(12.0), dims="parameter")
    factor = None
    if correlation_shape is not None:
        factor = pm.LKJCorr("correlation_factor", n=len(names), eta=correlation_shape)
        pm.Deterministic(
            "correlation", (factor[:, None, :] * factor).sum(axis=-1), dims=("parameter", "parameter_other")
        )
    for j, name in enumerate(names):
        mean, sd = cut_moments(coordinates[j], location[j], spread[j])
        pm.Deterministic(f"{name}_mean", mean)
        pm.Deterministic(f"{name}_sd", sd)
    return normal_specimens(offsets, location, spread, factor, coordinates, fits)


def _add_uniform(
    offsets: Tensor, names: list[str], low: FloatArray, high: FloatArray, fits: SpecimenFits
) -> tuple[Tensor, Tensor]:
    """Add the variables of a Uniform population; return specimens and the log-density of their offsets."""
    highest, lowest = edge_ranges(fits, low, high)
    below = pm.Uniform("population_low_share", 0.0, 1.0, shape=len(names), dims="parameter")
    above = pm.Uniform("population_high_share", 0.0, 1.0, shape=len(names), dims="parameter")
    edge_low = low + (highest - low) * below
    room = high - pt.maximum(edge_low, lowest)
    edge_high = high - room * (1.0 - above)
    pm.Potential("population_edges", (pt.log(room) - np.log(high - low)).sum())
    for j, name in enumerate(names):
        pm.Deterministic(f"{name}_low", edge_low[j])
        pm.Deterministic(f"{name}_high", edge_high[j])
        pm.Deterministic(f"{name}_mean", 0.5 * (edge_low[j] + edge_high[j]))
        pm.Deterministic(f"{name}_sd", (edge_high[j] - edge_low[j]) / np.sqrt(12.0))
    return uniform_specimens(offsets, edge_low, edge_high, fits)


def _make_hint(fits: SpecimenFits, low: FloatArray, high: FloatArray, unidentified: tuple[str, ...]) -> StartHint:
    """Return where chains start: at the moments of the fits, dispersed, and offsets near zero."""
    width = high - low
    share = np.clip((fits.point.mean(axis=0) - low) / width, 0.05, 0.95)
    spread = np.clip(fits.point.std(axis=0), 0.02 * width, 0.5 * width)
    n, p = fits.point.shape
    # On the unconstrained scale: logistic for bounded variables, logarithmic for spreads.
    centres = {
        "specimen_offsets": (np.zeros((n, p)), 0.5),
        "population_location": (np.log(share / (1.0 - share)), 0.2),
        "population_spread": (np.log(spread), 0.3),
        "population_low_share": (np.full(p, 1.0), 0.7),
        "population_high_share": (np.full(p, -1.0), 0.7),
        "correlation_factor": (np.zeros(p * (p - 1) // 2), 0.2),
    }
    return StartHint.of(centres, unidentified)
