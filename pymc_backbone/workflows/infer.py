"""From measured backbones to an updated model: the likelihood chosen, the model built, sampled and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from .._common.backbone_dataset import FREQUENCY, backbone_dataset
from .._common.checks import InputError, check_choice
from .._common.options import settings_of
from .._common.text import equation_of, unit_of
from ..inference.options import (
    GRADIENT_STEPS,
    HIERARCHICAL,
    LIKELIHOODS,
    POPULATIONS,
    Comparing,
    Keeping,
    Modelling,
    Sampling,
)
from .measure import Measured, Progress, Say
from .updated import MASS, Updated

if TYPE_CHECKING:
    import pandas as pd
    import pymc as pm

    from ..inference.fit_verdict import GoodnessOfFit
    from ..inference.population_summary import Population
    from ..oscillator import Oscillator

STIFFNESS = "linear_stiffness"
TARGET_ACCEPT = 0.9  # of a hierarchical model: where spreads are small and damping near zero longer steps diverge
FEWEST_DRAWS = 20  # of a run that was ended early; nothing can be said from fewer


def infer(
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
    from ..inference.goodness import goodness_of_fit
    from ..inference.measured import likelihood_of
    from ..inference.sampling import sample
    from ..inference.targets import targets_of

    modelling = _with_known_stiffness(oscillator, measured, modelling, say)
    is_hierarchical = comparing.likelihood == HIERARCHICAL
    kind = HIERARCHICAL if is_hierarchical else likelihood_of(measured.backbones, comparing.likelihood)
    bounds = _bounds(oscillator, measured, modelling)
    model = _build(oscillator, measured, bounds, modelling, comparing, kind)
    equation = equation_of(oscillator.equation, measured.amplitude_unit)
    say(
        f"\n{equation}\n\nSampling {sampling.chains} chains of {sampling.tune} + {sampling.draws} draws "
        f"({sampling.step}, {kind} likelihood) ..."
    )
    kept = settings_of(keeping) if keeping.store is not None else {}
    if is_hierarchical:
        kept["target_accept"] = TARGET_ACCEPT
    posterior = sample(model, **settings_of(sampling), **kept, progress=progress)
    if "interrupted" in posterior.attrs and posterior["posterior"].sizes["draw"] < FEWEST_DRAWS:
        say(f"\n{posterior.attrs['interrupted']} These are too few for a summary.")
        raise KeyboardInterrupt
    tell("comparing the posterior with the measurement", float("nan"))
    nominal, fixed = _at_nominal_mass(posterior, oscillator, modelling)
    # The bounds of a hierarchical model are those of its population; a specimen may lie beyond them.
    fit = goodness_of_fit(
        oscillator,
        measured.backbones,
        nominal,
        None if is_hierarchical else bounds,
        fixed=fixed,
        likelihood="specimen" if is_hierarchical else kind,
        random_seed=sampling.random_seed,
    )
    population, table = _summaries(posterior, model, bounds, is_hierarchical)
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
        table=table,
        mass_error=modelling.mass_error,
        population=population,
    )


def _build(
    oscillator: Oscillator,
    measured: Measured,
    bounds: Mapping[str, tuple[float, float]],
    modelling: Modelling,
    comparing: Comparing,
    kind: str,
) -> pm.Model:
    """Build the model of the likelihood that was chosen."""
    fixed = dict(modelling.fixed)
    if kind == HIERARCHICAL:
        from ..inference.hierarchical import build_hierarchical_model

        is_correlated = comparing.population == "correlated" and len(bounds) > 1
        return build_hierarchical_model(
            oscillator,
            measured.backbones,
            bounds,
            population="uniform" if comparing.population == "uniform" else "normal",
            correlated=is_correlated,
            fixed=fixed,
        )
    from ..inference.model import build_model

    return build_model(
        oscillator,
        measured.backbones,
        bounds=bounds,
        fixed=fixed,
        mass_error=modelling.mass_error,
        likelihood=kind,
        density=comparing.density,
        marginal=comparing.marginal,
    )


def _summaries(
    posterior: xr.DataTree,
    model: pm.Model,
    bounds: Mapping[str, tuple[float, float]],
    is_hierarchical: bool,
) -> tuple[Population | None, pd.DataFrame]:
    """Return what the posterior says of the population, where it has one, and a row for each parameter."""
    from ..inference.diagnostics import summarise

    names = [name for name in (MASS, *bounds) if name in posterior["posterior"]]
    if not is_hierarchical:
        return None, summarise(posterior, names)
    from ..inference.hierarchical import unidentified_parameters
    from ..inference.population_summary import POPULATION_VARIABLES, population_of

    population = population_of(posterior, bounds, unidentified_parameters(model))
    of_all = [f"{name}_{what}" for name in bounds for what in POPULATION_VARIABLES]
    return population, summarise(posterior, [*of_all, *names])


def check_comparing(modelling: Modelling, comparing: Comparing, sampling: Sampling) -> None:
    """Raise where options are given that the likelihood which was asked for has no use for.

    Raises
    ------
    InputError
        Say a random walk, an uncertain mass or a density for a hierarchical model, or a family of its population for
        any other likelihood.
    """
    check_choice("likelihood", comparing.likelihood, (*LIKELIHOODS, HIERARCHICAL))
    check_choice("population", comparing.population, POPULATIONS)
    if comparing.likelihood != HIERARCHICAL:
        if comparing.population != Comparing.population:
            raise InputError(
                f"`population` is the family of a hierarchical model, and the likelihood is {comparing.likelihood!r}; "
                "leave it out, or set `likelihood=hierarchical`."
            )
        return
    if (comparing.density, comparing.marginal) != (Comparing.density, Comparing.marginal):
        raise InputError(
            "`density` and `marginal` are those of the likelihood of a population, and the likelihood is "
            "'hierarchical'; leave them out."
        )
    if sampling.step not in GRADIENT_STEPS:
        raise InputError(
            f"a hierarchical model has parameters for every specimen, too many for the random walk of step "
            f"{sampling.step!r}; use `step=nuts` or `step=nutpie`."
        )
    if modelling.mass_error:
        raise InputError(
            "an uncertain mass is not for a hierarchical model, whose specimens may differ in mass or share one: give "
            "the mass alone, and add its relative doubt to that of stiffness, damping and friction."
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


def oscillator_of(modelling: Modelling) -> Oscillator:
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


def _with_known_stiffness(oscillator: Oscillator, measured: Measured, modelling: Modelling, say: Say) -> Modelling:
    """Return the model with its stiffness fixed where the frequency is known and was not measured.

    Damping per cycle alone tells a damper only together with the stiffness, never the stiffness itself.
    """
    is_known = FREQUENCY in measured.backbones.attrs and FREQUENCY not in measured.backbones["observable"].values
    if not is_known or STIFFNESS in modelling.priors or STIFFNESS in modelling.fixed:
        return modelling
    stiffness = oscillator.mass * measured.angular_frequency**2
    unit = unit_of(oscillator.units[STIFFNESS], measured.amplitude_unit)
    say(
        f"\nOnly damping was measured: {STIFFNESS} is held at mass times angular frequency squared, {stiffness:.6g} "
        f"{unit}; a prior for it would take its place."
    )
    return replace(modelling, fixed={**modelling.fixed, STIFFNESS: stiffness})


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
