"""What a model predicts and how well: predictive backbones and log-likelihoods beside the draws of a run."""

from __future__ import annotations

import warnings

import numpy as np
import pymc as pm
import xarray as xr

from .._common.checks import FloatArray, InputError
from ..likelihood.dims import backbone_coords, label_units
from .start_hint import start_hint_of
from .targets import Target, targets_of

_KINDS = {"prior": "prior_predictive", "posterior": "posterior_predictive"}


def add_log_likelihood(draws: xr.DataTree, model: pm.Model | None = None) -> xr.DataTree:
    """Add the log-likelihood of every specimen at every draw: what `arviz.loo` and `arviz.compare` need.

    Parameters
    ----------
    draws : xarray.DataTree
        What `sample` or `pymc.sample` returned; it is changed.
    model : pymc.Model, optional
        The model that was sampled; default: that of the current context.

    Returns
    -------
    xarray.DataTree
        The same, with the group ``log_likelihood`` (chain, draw, specimen).

    Raises
    ------
    InputError
        For the likelihood of a population, which is no product over specimens, and for linearised specimens.

    See Also
    --------
    add_predictions : what the model predicts.
    goodness_of_fit : whether the model fits, for every likelihood.

    Notes
    -----
    The likelihood of a population is a density that was fitted to all specimens, at one simulated backbone: no specimen
    has a share in it that could be left out. Leave-one-out needs a model of specimens.

    Examples
    --------
    Which of two effects predicts specimens that were left out better::

        runs = {}
        for effect in ("cubic_stiffness", "quintic_stiffness"):
            model = build_model(Oscillator(1.0, effect), backbones, likelihood="pooled")
            runs[effect] = add_log_likelihood(sample(model), model)
        az.compare(runs)
    """
    model = pm.modelcontext(model)
    _check_draws(draws, ("posterior",))
    names = [target.name for target in targets_of(model) if target.density is None]
    if not names:
        raise InputError(
            "this model has no log-likelihood of single specimens, which leave-one-out needs; build one of specimens "
            "(`likelihood` 'specimen' or 'pooled', or build_hierarchical_model without `linearised`), or ask "
            "`goodness_of_fit` whether this one fits."
        )
    pm.compute_log_likelihood(draws, model=model, progressbar=False)
    label_units(model, draws)
    return draws


def add_predictions(
    draws: xr.DataTree, model: pm.Model | None = None, *, random_seed: int | np.random.Generator | None = None
) -> xr.DataTree:
    """Add backbones that the model predicts: of its posterior, and of its prior where there are draws of it.

    Parameters
    ----------
    draws : xarray.DataTree
        From `sample`, `pymc.sample` or `pymc.sample_prior_predictive`, with a group ``posterior`` or ``prior``; it is
        changed.
    model : pymc.Model, optional
        The model that was sampled; default: that of the current context.
    random_seed : int or numpy.random.Generator, optional
        Of measurement errors, for likelihoods of specimens.

    Returns
    -------
    xarray.DataTree
        The same, with ``posterior_predictive`` or ``prior_predictive`` or both. Of specimens: level values as they
        would be measured, with errors, (chain, draw, specimen, observable, level). Of a population: simulated backbones
        (chain, draw, observable, level), each that of another specimen of the population, NaN where one cannot be
        simulated.

    Raises
    ------
    InputError
        Where there are no draws, or the model has no backbone likelihood; for the prior of a hierarchical model.

    See Also
    --------
    add_log_likelihood : how well they are predicted.
    backbone_deterministic : at other levels.
    """
    model = pm.modelcontext(model)
    _check_draws(draws, tuple(_KINDS))
    targets = targets_of(model)
    if not targets:
        raise InputError("the model has no backbone likelihood to predict with; add one with `backbone_likelihood`.")
    seed = None if random_seed is None else int(np.random.default_rng(random_seed).integers(2**31))
    if "prior" in draws.children and start_hint_of(model) is not None:
        raise InputError(
            "the prior of a hierarchical model is not what PyMC draws: the density of specimens, given the population, "
            "is a potential, which prior draws leave out; predict from a posterior."
        )
    observed = [target.name for target in targets if target.density is None]
    populations = [target for target in targets if target.density is not None]
    for group in [name for name in _KINDS if name in draws.children]:
        found = xr.Dataset()
        if observed:
            found = _predict_specimens(model, draws[group].to_dataset(), observed, seed)
        for target in populations:
            found[target.name] = _predict_population(model, draws[group].to_dataset(), target)
        draws[_KINDS[group]] = xr.DataTree(found)
    label_units(model, draws)
    return draws


def _predict_specimens(model: pm.Model, draws: xr.Dataset, names: list[str], seed: int | None) -> xr.Dataset:
    """Return level values as they would be measured."""
    given = xr.DataTree.from_dict({"posterior": draws})
    with warnings.catch_warnings():
        # They weigh parameters, and the parameters are drawn already.
        warnings.filterwarnings("ignore", message="The effect of Potentials", category=UserWarning)
        predicted = pm.sample_posterior_predictive(
            given, model=model, var_names=names, random_seed=seed, progressbar=False
        )
    result: xr.Dataset = predicted["posterior_predictive"].to_dataset()
    return result


def _predict_population(model: pm.Model, draws: xr.Dataset, target: Target) -> xr.DataArray:
    """Return the backbones of the draws."""
    free = model.free_RVs
    vector = model.compile_fn([target.theta], inputs=free, on_unused_input="ignore", point_fn=False)
    given = [np.asarray(draws[variable.name].transpose("chain", "draw", ...)) for variable in free]
    chains, length = draws.sizes["chain"], draws.sizes["draw"]
    response = target.response
    drawn = [vector(*(each[chain, draw] for each in given))[0] for chain in range(chains) for draw in range(length)]
    together = response.evaluate_many(np.array(drawn, dtype=np.float64))
    values: FloatArray = together.reshape(chains, length, *together.shape[1:])
    coords = backbone_coords(response.observables, response.levels)
    dims = ("chain", "draw", *coords)
    return xr.DataArray(values, dims=dims, coords={"chain": draws["chain"], "draw": draws["draw"], **coords})


def _check_draws(draws: xr.DataTree, groups: tuple[str, ...]) -> None:
    if not any(group in getattr(draws, "children", {}) for group in groups):
        raise InputError(
            f"`draws` must be a DataTree with a group {' or '.join(map(repr, groups))}, as `sample` returns; got "
            f"{type(draws).__name__}."
        )
