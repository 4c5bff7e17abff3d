"""Backbone likelihoods inside a PyMC model, and whole models from an oscillator, backbones and bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from numpy.typing import ArrayLike
from pytensor.tensor import TensorVariable as Tensor

from .._common.backbone_dataset import typical_frequency
from .._common.checks import OBSERVABLES, FloatArray, InputError, check_choice, check_positive
from ..likelihood.data_consistent import fit_data_consistent
from ..likelihood.density import Density
from ..likelihood.density_fit import fit_density
from ..likelihood.dims import backbone_coords, name_dims
from ..likelihood.op import BackboneLogLikelihood, BackboneOp
from ..likelihood.specimen_likelihood import observe_specimens
from ..oscillator import Oscillator
from ..simulation.response import Response, make_response
from .options import LIKELIHOODS
from .targets import note_density

Source = Oscillator | Callable[[dict[str, float], FloatArray], ArrayLike]
NOMINAL = "nominal_"
"""Before the name of a parameter as if the mass were that of the oscillator, where it is uncertain."""
POPULATION_SIZE = 8  # from this many complete specimens on, "auto" fits a density over them


def backbone_likelihood(
    name: str,
    source: Source,
    data: Density | xr.Dataset,
    parameters: Mapping[str, Tensor | float],
    *,
    observables: Sequence[str] | None = None,
    release_amplitude: float | None = None,
    virgin: bool = True,
) -> Tensor:
    """Add the likelihood of a simulated backbone to the current PyMC model.

    With a `Density` the likelihood is that of the *population*: one parameter vector, judged by the density that was
    fitted over the specimens (a potential). With a Dataset of backbones it is that of the *specimens*: Gaussian level
    errors with the measured covariance, an observed variable with one log-likelihood per specimen. There, a parameter
    may be a vector with one entry per specimen; scalars are shared by all of them.

    Parameters
    ----------
    name : str
        Name of the potential or the observed variable.
    source : Oscillator or callable
        The model. A function takes a dict of parameters and the levels (l,) and returns values (o, l); it has no
        gradient, everything else is the same.
    data : Density or xarray.Dataset
        From `fit_density`, or from `backbones_at_levels` or `read_backbones`.
    parameters : mapping of str to tensor or float
        A PyMC variable, an expression of them, or a number, for every parameter.
    observables : sequence of str, optional
        For a Dataset: which to use; default: all it holds.
    release_amplitude : float, optional
        For an oscillator: run the whole decay from here [m or rad].
    virgin : bool, default True
        For an oscillator: whether hysteretic states start loaded from rest.

    Returns
    -------
    TensorVariable
        The log-likelihood (population) or the observed variable (specimens).

    Raises
    ------
    InputError
        Outside a model context, unknown or missing parameters, data without standard errors, lengths that differ.

    See Also
    --------
    build_model : a whole model in one call.
    fit_density : what it compares with.
    sample : draws from the model.

    Examples
    --------
    Population likelihood of a Duffing oscillator, given backbones of a batch::

        density = fit_density(backbones)
        with pm.Model() as model:
            k = pm.Uniform("linear_stiffness", 5000.0, 8000.0)
            c = pm.Uniform("viscous_damping", 0.1, 3.0)
            k3 = pm.Uniform("cubic_stiffness", 5e6, 7e6)
            backbone_likelihood("backbone", duffing, density,
                                {"linear_stiffness": k, "viscous_damping": c, "cubic_stiffness": k3})
            posterior = sample()
    """
    pm.modelcontext(None)  # says so where there is none
    if isinstance(data, Density):
        if observables is not None and tuple(observables) != data.observables:
            raise InputError(
                f"the density was fitted to {', '.join(data.observables)}, not to {', '.join(observables)}; "
                "fit it to the observables you want."
            )
        levels, names = data.levels, data.observables
    elif isinstance(data, xr.Dataset):
        data = select_observables(data, observables)
        levels, names = np.asarray(data["level"]), tuple(str(v) for v in data["observable"].values)
    else:
        raise InputError(f"`data` must be a Density or a Dataset of backbones, got {type(data).__name__}.")
    response = make_response(
        source,
        levels,
        names,
        parameter_names=None if isinstance(source, Oscillator) else tuple(parameters),
        release_amplitude=release_amplitude,
        virgin=virgin,
    )
    n_specimens = 1 if isinstance(data, Density) else data.sizes["specimen"]
    theta = _stack(response, parameters, n_specimens, isinstance(data, Density))
    if isinstance(data, xr.Dataset):
        return observe_specimens(name, response, data, theta)
    codes = pm.Data(f"{name}_density_codes", data.codes)
    note_density(codes, data)
    table = pm.Data(f"{name}_density_table", data.table)
    return pm.Potential(name, BackboneLogLikelihood(response)(theta, codes, table)[0])


def backbone_deterministic(
    name: str,
    source: Source,
    levels: ArrayLike,
    parameters: Mapping[str, Tensor | float],
    *,
    observables: Sequence[str] = ("frequency", "damping"),
) -> Tensor:
    """Add the simulated backbone at ``levels`` to the current PyMC model as a deterministic, for predictions.

    Parameters
    ----------
    name : str
        Name of the deterministic; its dimensions are ``observable`` and ``level``, ``specimen`` in front where
        parameters differ between specimens. Where the model has such a dimension with other coordinates, the name of
        the deterministic stands in front: ``NAME_level``.
    source : Oscillator or callable
        The model, as in `backbone_likelihood`.
    levels : array_like, shape (l,)
        Amplitudes [m or rad].
    parameters : mapping of str to tensor or float
        A scalar, or a vector with one entry per specimen, for every parameter.
    observables : sequence of str
        Any of frequency, damping, offset.

    Returns
    -------
    TensorVariable
        Values (o, l) or (n, o, l); NaN where a level cannot be simulated.

    See Also
    --------
    backbone_likelihood : the likelihood of one.
    simulate_population : numbers instead of tensors.
    """
    names = None if isinstance(source, Oscillator) else tuple(parameters)
    model = pm.modelcontext(None)
    response = make_response(source, levels, observables, parameter_names=names)
    coords = backbone_coords(response.observables, response.levels)
    lengths = [n for value in parameters.values() for n in pt.as_tensor_variable(value).type.shape]
    specimens = model.coords.get("specimen") or range(next((n for n in lengths if n is not None), 1))
    theta = _stack(response, parameters, len(specimens), False)
    op = BackboneOp(response)
    if theta.ndim == 1:
        return pm.Deterministic(name, op(theta)[0], dims=name_dims(name, coords))
    simulated = pt.vectorize(lambda each: op(each)[0], "(p)->(o,l)")(theta)
    return pm.Deterministic(name, simulated, dims=name_dims(name, {"specimen": list(specimens)} | coords))


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
    data, kind = _choose(data, likelihood, observables)
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


def _choose(
    data: Density | xr.Dataset, likelihood: str, observables: Sequence[str] | None
) -> tuple[Density | xr.Dataset, str]:
    """Return the data that the likelihood is made from, and its kind."""
    if isinstance(data, Density):
        if likelihood not in ("auto", "population"):
            raise InputError(f"a density is a likelihood of the population, not {likelihood!r}; pass the backbones.")
        return data, "population"
    if not isinstance(data, xr.Dataset):
        raise InputError(f"`data` must be a Density or a Dataset of backbones, got {type(data).__name__}.")
    data = select_observables(data, observables)
    return data, likelihood_of(data, likelihood)


def likelihood_of(backbones: xr.Dataset, likelihood: str = "auto") -> str:
    """Return which likelihood `build_model` takes for backbones: the one asked for, or what ``auto`` stands for."""
    if likelihood == "auto":
        complete = int(np.isfinite(np.asarray(backbones["value"])).all(axis=(1, 2)).sum())
        likelihood = "population" if complete >= POPULATION_SIZE else "specimen"
    if likelihood == "population":
        return likelihood
    return "pooled" if backbones.sizes["specimen"] == 1 else likelihood


def select_observables(data: xr.Dataset, observables: Sequence[str] | None) -> xr.Dataset:
    """Return the wanted observables in the canonical order."""
    held = [str(v) for v in data["observable"].values]
    wanted = held if observables is None else list(observables)
    for name in wanted:
        check_choice("observables", name, held)
    return data.sel(observable=[name for name in OBSERVABLES if name in wanted])


def prior_intervals(
    source: Source,
    data: Density | xr.Dataset,
    bounds: dict[str, tuple[float, float]],
    fixed: dict[str, float],
) -> dict[str, tuple[float, float]]:
    """Return checked prior bounds of every parameter that is not fixed."""
    if isinstance(source, Oscillator):
        known = list(source.parameter_names)
        for label, given in (("bounds", bounds), ("fixed", fixed)):
            for name in given:
                check_choice(label, name, known)
        limits = {parameter.name: (parameter.minimum, parameter.maximum) for parameter in source.parameters}
        defaults = source.default_bounds(*_scales(data))
        result = {name: bounds.get(name, defaults[name]) for name in known if name not in fixed}
    else:
        limits = {}
        result = {name: interval for name, interval in bounds.items() if name not in fixed}
    for name, interval in result.items():
        try:
            low, high = (float(value) for value in interval)
        except (TypeError, ValueError):
            raise InputError(f"`bounds` of {name!r} must be two numbers (low, high), got {interval!r}.") from None
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(f"`bounds` of {name!r} must be finite with low < high, got ({low:g}, {high:g}).")
        minimum, maximum = limits.get(name, (-np.inf, np.inf))
        if low < minimum or high > maximum:
            raise InputError(
                f"`bounds` of {name!r} must lie between {minimum:g} and {maximum:g}, got ({low:g}, {high:g})."
            )
        result[name] = (low, high)
    return result


def _scales(data: Density | xr.Dataset) -> tuple[float, float]:
    """Return amplitude and angular frequency of the data, which default bounds are scaled with."""
    observables = data.observables if isinstance(data, Density) else ()
    levels = data.levels if isinstance(data, Density) else np.asarray(data["level"])
    if isinstance(data, xr.Dataset):
        frequency = typical_frequency(data)
    elif "frequency" in observables:
        frequency = float(np.nanmedian(data.sample(500, random_seed=0)[:, 0]))
    else:
        frequency = float("nan")
    if not np.isfinite(frequency):
        raise InputError("default bounds need the observable `frequency`; give `bounds` for every parameter.")
    return float(levels[-1]), 2.0 * np.pi * frequency


def _stack(
    response: Response, parameters: Mapping[str, Tensor | float], n_specimens: int, is_population: bool
) -> Tensor:
    """Return the parameters as one vector (p,), or as a matrix (n, p) where any differs between specimens."""
    for name in parameters:
        check_choice("parameters", name, response.parameter_names)
    missing = [name for name in response.parameter_names if name not in parameters]
    if missing:
        raise InputError(f"`parameters` must hold every parameter of the model; {', '.join(missing)} missing.")
    tensors = [pt.as_tensor_variable(parameters[name], dtype="float64") for name in response.parameter_names]
    for name, tensor in zip(response.parameter_names, tensors, strict=True):
        if tensor.ndim > 1 or (is_population and tensor.ndim > 0):
            kind = "a number" if is_population else "a number, or a vector with one entry per specimen"
            raise InputError(f"parameter {name!r} must be {kind}, got {tensor.ndim} dimension(s).")
        if tensor.ndim == 1 and tensor.type.shape[0] not in (None, n_specimens):
            raise InputError(
                f"parameter {name!r} must have one entry per specimen ({n_specimens}), got {tensor.type.shape[0]}."
            )
    if all(tensor.ndim == 0 for tensor in tensors):
        return pt.stack(tensors)
    return pt.stack([pt.broadcast_to(tensor, (n_specimens,)) for tensor in tensors], axis=-1)
