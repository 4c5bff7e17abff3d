"""Backbone likelihoods and predictions inside a PyMC model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from numpy.typing import ArrayLike
from pytensor.tensor import TensorVariable as Tensor

from .._common.checks import InputError, check_choice
from ..likelihood.density import Density
from ..likelihood.dims import backbone_coords, name_dims
from ..likelihood.op import BackboneLogLikelihood, BackboneOp
from ..likelihood.specimen_likelihood import observe_specimens
from ..oscillator import Oscillator
from ..simulation.response import Response, make_response
from .intervals import Source
from .measured import check_measured, select_observables
from .targets import note_density


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
    else:
        data = select_observables(check_measured(data), observables)
        levels, names = np.asarray(data["level"]), tuple(str(v) for v in data["observable"].values)
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


__all__ = ["backbone_deterministic", "backbone_likelihood"]
