"""Whether a posterior describes what was measured: a predictive check with a p-value that is uniform if it does.

Two questions, kept apart because they have different answers:

*Can the model describe the specimens?* Every specimen is fitted with parameters of its own, inside the priors, from the
draws of the posterior that come nearest. Its squared distance has a known distribution if the model is right: as many
degrees of freedom as independent level values beyond the fitted parameters. The p-value of the sum is calibrated, which
a plain posterior predictive p-value is not: that uses the data twice and hardly ever comes near zero or one (Robins,
van der Vaart, Ventura, J. Am. Stat. Assoc. 95 (2000)). Scatter of the specimens plays no part in it.

*Does the posterior describe them?* Each level value is compared with the backbones that draws of the posterior give, in
units of standard error, posterior and, where one parameter set stands for all, scatter. A pooled posterior is asked if
the specimens are alike, one of a population if its distribution lies where theirs lies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.stats import chi2

from .._common.checks import FloatArray, InputError, check_choice
from .._common.threads import with_one_thread
from ..oscillator import Oscillator
from ..simulation.response import Response, make_response
from .fit_verdict import P_LIMIT, ExcludedBy, GoodnessOfFit, SpecimenFit
from .level_values import LevelValues, compare_values, find_displaced, find_narrow
from .measured import likelihood_of, select_observables
from .options import LIKELIHOODS
from .refit import Refit, refit
from .squared_distance import SquaredDistance

DRAWS = 400  # simulated in all
FEWEST_DRAWS = 60  # for each specimen
FLIPS = 4999
_NEGLIGIBLE = 1e-3  # of the specimens' spread: residuals without standard errors below it are rounding
_BETTER = 0.25  # of chi-square: what is left of it where a prior, not the model, keeps it from the data


@with_one_thread
def goodness_of_fit(
    source: Oscillator | Callable[[dict[str, float], FloatArray], ArrayLike],
    backbones: xr.Dataset,
    posterior: xr.DataTree,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    *,
    fixed: Mapping[str, float] | None = None,
    likelihood: str = "auto",
    observables: Sequence[str] | None = None,
    release_amplitude: float | None = None,
    virgin: bool = True,
    random_seed: int | None = None,
) -> GoodnessOfFit:
    """Check whether a model and its posterior describe measured backbones.

    Parameters
    ----------
    source : Oscillator or callable
        The model, as in `build_model`.
    backbones : xarray.Dataset
        What it was compared with: from `backbones_at_levels` or `read_backbones`.
    posterior : xarray.DataTree
        What `sample` returned. Its variables are known by the names of the parameters; one with an entry for each
        specimen has the dim ``specimen``.
    bounds : mapping of str to (float, float), optional
        Uniform priors of the parameters. Without them a fit may go to the physical limits: as it should for a
        hierarchical model, whose bounds are the population's.
    fixed : mapping of str to float, optional
        Parameters that are known.
    likelihood : {"auto", "population", "specimen", "pooled"}
        As the model was built. ``auto`` sees specimens by the dim ``specimen``, else a population from eight complete
        specimens on.
    observables : sequence of str, optional
        Which were used; default: all.
    release_amplitude, virgin
        As in `build_model`.
    random_seed : int, optional
        Chooses the draws that are simulated.

    Returns
    -------
    GoodnessOfFit
        ``passes``, ``p_value``, ``reduced_chi_square``, ``worst``, ``entries``, ``specimens``; ``sentences()`` says
        what is wrong, and `findings` takes it.

    Raises
    ------
    InputError
        Parameters that are neither in the posterior nor fixed, unknown names, missing standard errors where the
        likelihood needs them.

    See Also
    --------
    findings : says what is wrong with the fit and with the chains.
    find_missing_effect : what to do about a model that does not fit.

    Notes
    -----
    Level values that were read off smoothed curves are fewer than they seem. Their covariance holds the noise and the
    doubt about how smooth the curve is; where the curve is smooth indeed, the directions in which it might have been
    rough hardly move. So the squared distance has the distribution of ``sum(w_i chi2_1)``, with ``w`` the eigenvalues
    of the part of the covariance that is noise (``noise_covariance`` of the backbones), in units of all of it and
    beside the fitted directions. It is taken for the chi-square distribution of the same mean and variance, of
    ``sum(w)^2 / sum(w^2)`` degrees of freedom (Satterthwaite, Biometrics Bulletin 2 (1946) 110).

    Where a population has no standard errors, the p-value comes from the residuals of the specimens' own fits: if the
    model is right they are as often above as below, so the sum over the values of the squared mean over the specimens,
    in units of their spread, is compared with what random signs of whole specimens give (4999 of them).

    Examples
    --------
    A linear model of a batch with friction::

        posterior = pb.sample(pb.build_model(linear, backbones, bounds))
        fit = pb.goodness_of_fit(linear, backbones, posterior, bounds)
        print(fit.passes, fit.p_value, fit.worst)
        for sentence in pb.findings(posterior, bounds, fit=fit):
            print(sentence)
    """
    check_choice("likelihood", likelihood, LIKELIHOODS)
    data = select_observables(backbones, observables)
    draws = posterior["posterior"].to_dataset()
    fixed = {name: float(value) for name, value in (fixed or {}).items()}
    response = make_response(
        source,
        data["level"].values,
        [str(name) for name in data["observable"].values],
        parameter_names=None if isinstance(source, Oscillator) else _names(draws, bounds, fixed),
        release_amplitude=release_amplitude,
        virgin=virgin,
    )
    parameters, is_own = _parameters(response, draws, fixed, data, random_seed)
    kind = "specimen" if is_own else likelihood_of(data, likelihood)
    if kind == "specimen" and not is_own:  # scalars that stand for all specimens
        kind = "pooled"
    together = response.evaluate_many(parameters.reshape(-1, parameters.shape[-1]))
    predicted = together.reshape(*parameters.shape[:2], *together.shape[1:])
    batch = LevelValues.of(data)
    low, high = _limits(source, response, bounds, fixed)
    fits = _fit_all(batch, response, parameters, predicted, low, high)
    specimens, p_value, reduced, degrees = _verdict(batch, fits)
    excluded: tuple[ExcludedBy, ...] = ()
    if p_value < P_LIMIT and isinstance(source, Oscillator) and bounds:
        excluded = _excluded(batch, source, response, fits, specimens, low, high)
    scatter = np.zeros(batch.shape[1:])
    if kind == "pooled" and len(fits) > 1:
        curves = np.array([found.values for found in fits if found is not None]).reshape(-1, *batch.shape[1:])
        scatter = curves.std(axis=0, ddof=1) if len(curves) > 1 else scatter
    entries = compare_values(data, predicted, None if kind == "population" else scatter)
    displaced = find_displaced(entries, batch) if kind == "population" else ()
    return GoodnessOfFit(
        likelihood=kind,
        p_value=p_value,
        reduced_chi_square=reduced,
        degrees_of_freedom=degrees,
        specimens=specimens,
        entries=tuple(entries),
        pooling_p_value=_pooling(batch, response, parameters, predicted, fits, low, high)
        if kind == "pooled"
        else np.nan,
        displaced=displaced,
        narrow=find_narrow(data, predicted) if kind == "population" else (),
        excluded=excluded,
        amplitude_unit=str(data.attrs.get("amplitude_unit", "m")),
        levels=np.asarray(data["level"], dtype=float),
        draws=predicted,
    )


def _names(
    draws: xr.Dataset, bounds: Mapping[str, tuple[float, float]] | None, fixed: Mapping[str, float]
) -> tuple[str, ...]:
    """Return the parameters of a function, which does not say them itself."""
    return (*(bounds or [str(name) for name in draws.data_vars]), *fixed)


def _parameters(
    response: Response, draws: xr.Dataset, fixed: Mapping[str, float], data: xr.Dataset, random_seed: int | None
) -> tuple[FloatArray, bool]:
    """Return draws of all parameters (g, d, p), and whether each specimen has its own (g = n)."""
    known: list[Any] = []
    for name in response.parameter_names:
        if name in fixed:
            known.append(fixed[name])
        elif name in draws:
            known.append(draws[name].transpose("chain", "draw", ...))
        else:
            raise InputError(
                f"`posterior` must hold every parameter of the model or `fixed` give it; {name!r} is in neither."
            )
    n, total = data.sizes["specimen"], draws.sizes["chain"] * draws.sizes["draw"]
    is_own = any(isinstance(one, xr.DataArray) and one.ndim > 2 for one in known)
    wanted = min(total, max(FEWEST_DRAWS, DRAWS // n) if is_own else DRAWS)
    chosen = np.random.default_rng(random_seed).choice(total, size=wanted, replace=False)
    groups = n if is_own else 1
    result = np.empty((groups, wanted, len(known)))
    for j, one in enumerate(known):
        if isinstance(one, float):
            result[:, :, j] = one
            continue
        values = np.asarray(one, dtype=float).reshape(total, -1)
        if values.shape[1] not in (1, groups):
            raise InputError(
                f"{one.name} has {values.shape[1]} entries for {n} specimens; give the backbones it was inferred from."
            )
        result[:, :, j] = values[chosen].T
    return result, is_own


def _limits(
    source: Any, response: Response, bounds: Mapping[str, tuple[float, float]] | None, fixed: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return where a fit may go: the priors, else the physical limits; a fixed parameter stays."""
    physical = _physical(source)
    pairs = []
    for name in response.parameter_names:
        pair = (fixed[name],) * 2 if name in fixed else (bounds or {}).get(name, physical.get(name, (-np.inf, np.inf)))
        pairs.append(pair)
    low, high = np.array(pairs, dtype=float).T
    return low, high


def _physical(source: Any) -> dict[str, tuple[float, float]]:
    parameters = source.parameters if isinstance(source, Oscillator) else ()
    return {parameter.name: (parameter.minimum, parameter.maximum) for parameter in parameters}


def _nearest(batch: LevelValues, s: int, parameters: FloatArray, predicted: FloatArray) -> FloatArray | None:
    """Return the draw that comes nearest to a specimen."""
    group = s if len(parameters) > 1 else 0
    residual = (predicted[group].reshape(len(predicted[group]), -1) - batch.measured[s]) @ batch.whitening[s].T
    distance = (residual**2).sum(axis=1)
    if not np.isfinite(distance).any():
        return None
    return np.asarray(parameters[group][int(np.nanargmin(distance))])


def _fit_all(
    batch: LevelValues,
    response: Response,
    parameters: FloatArray,
    predicted: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> list[Refit | None]:
    """Fit every specimen with parameters of its own."""
    fits: list[Refit | None] = []
    for s in range(len(batch.names)):
        start = _nearest(batch, s, parameters, predicted)
        found = None
        if start is not None:
            found = refit(response, batch.measured[s], batch.whitening[s], start, low, high)
        fits.append(found)
    return fits


def _verdict(batch: LevelValues, fits: Sequence[Refit | None]) -> tuple[tuple[SpecimenFit, ...], float, float, float]:
    """Return every specimen's fit, and p-value, reduced chi-square and degrees of freedom of all."""
    specimens, total = [], SquaredDistance()
    for s, (name, size, found) in enumerate(zip(batch.names, batch.sizes(), fits, strict=True)):
        own = (
            SquaredDistance()
            if found is None
            else SquaredDistance.of(found, size, None if batch.noise is None else batch.noise[s])
        )
        specimens.append(
            SpecimenFit(name, *(own.judged() if batch.has_errors else (np.nan, own.degrees, np.nan, np.nan)))
        )
        total = total + own
    if not total.degrees:
        return tuple(specimens), np.nan, np.nan, 0.0
    if not batch.has_errors:
        return tuple(specimens), _sign_flips(fits), np.nan, total.degrees
    _, degrees, reduced, p_value = total.judged()
    return tuple(specimens), p_value, reduced, degrees


def _sign_flips(fits: Sequence[Refit | None]) -> float:
    """Return the p-value of residuals without standard errors: those of a right model have no sign in common."""
    residuals = np.array([found.residual for found in fits if found is not None])
    if len(residuals) < 6:  # fewer have too few signs for a p-value of a few per cent
        return float("nan")
    # Residuals are in units of the spread over the specimens already.
    if float(np.abs(residuals).max()) < _NEGLIGIBLE:
        return 1.0
    size = np.sqrt((residuals**2).mean(axis=0))
    scaled = residuals / np.where(size > 0.0, size, 1.0)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(FLIPS, len(residuals)))
    observed = float((scaled.mean(axis=0) ** 2).sum())
    flipped = ((signs @ scaled / len(residuals)) ** 2).sum(axis=1)
    return float((1 + np.sum(flipped >= observed * (1.0 - 1e-9))) / (FLIPS + 1))


def _pooling(
    batch: LevelValues,
    response: Response,
    parameters: FloatArray,
    predicted: FloatArray,
    fits: Sequence[Refit | None],
    low: FloatArray,
    high: FloatArray,
) -> float:
    """Return the chance that specimens which are alike need own parameters as much as these do."""
    if len(fits) < 2 or not batch.has_errors or any(found is None for found in fits):
        return float("nan")
    residual = np.einsum(
        "sed,ksd->kse",
        batch.whitening,
        predicted[0].reshape(len(predicted[0]), 1, -1) - batch.measured,
    )
    distance = (residual**2).sum(axis=(1, 2))
    if not np.isfinite(distance).any():
        return float("nan")
    # All specimens side by side are one vector: their information adds up to one whitening of one mean.
    information = np.einsum("sed,sef->sdf", batch.whitening, batch.whitening)
    total = information.sum(axis=0)
    root, vectors = np.linalg.eigh(total)
    kept = root > 1e-10 * root[-1]
    whitening = np.zeros_like(total)
    whitening[kept] = (np.sqrt(np.where(kept, root, 0.0))[:, None] * vectors.T)[kept]
    right = np.einsum("sdf,sf->d", information, batch.measured)
    mean = vectors[:, kept] @ ((vectors[:, kept].T @ right) / root[kept])
    start = parameters[0][int(np.nanargmin(distance))]
    together = refit(response, mean, whitening, start, low, high)
    if together is None:
        return float("nan")
    residual = np.einsum("sed,sd->se", batch.whitening, together.values - batch.measured)
    own = [found for found in fits if found is not None]
    excess = float((residual**2).sum()) - sum(found.chi_square for found in own)
    degrees = sum(found.fitted for found in own) - together.fitted
    return float(chi2.sf(max(excess, 0.0), degrees)) if degrees > 0 else float("nan")


def _excluded(
    batch: LevelValues,
    source: Oscillator,
    response: Response,
    fits: Sequence[Refit | None],
    specimens: Sequence[SpecimenFit],
    low: FloatArray,
    high: FloatArray,
) -> tuple[ExcludedBy, ...]:
    """Return the bounds of priors without which the worst specimen would be fitted far better."""
    judged = [s for s, found in enumerate(fits) if found is not None and (found.at_low | found.at_high).any()]
    if not judged:
        return ()
    worst = max(judged, key=lambda s: np.nan_to_num(specimens[s].reduced_chi_square))
    held = fits[worst]
    assert held is not None
    physical = _physical(source)
    outer = np.array([physical[name] for name in response.parameter_names], dtype=float)
    is_fixed = low >= high
    floor, ceiling = np.where(is_fixed, low, outer[:, 0]), np.where(is_fixed, high, outer[:, 1])
    starts = [held.point]
    if "frequency" in batch.observables:
        frequency = float(np.nanmedian(batch.values[worst, batch.observables.index("frequency")]))
        usual = source.default_bounds(float(batch.levels[-1]), 2.0 * np.pi * frequency)
        middle = np.array([np.mean(usual[name]) for name in response.parameter_names])
        starts.append(np.where(is_fixed, low, np.clip(middle, floor, ceiling)))
        is_stiffness = np.array([name == "linear_stiffness" for name in response.parameter_names])
        starts.append(np.where(is_stiffness & ~is_fixed, source.mass * (2.0 * np.pi * frequency) ** 2, held.point))
    free = [refit(response, batch.measured[worst], batch.whitening[worst], start, floor, ceiling) for start in starts]
    reached = [found for found in free if found is not None]
    if not reached:
        return ()
    best = min(reached, key=lambda found: found.chi_square)
    if best.chi_square > _BETTER * held.chi_square:
        return ()
    result = []
    for j, name in enumerate(response.parameter_names):
        bound, side = (low[j], "lower") if held.at_low[j] else (high[j], "upper")
        beyond = best.point[j] < bound if held.at_low[j] else best.point[j] > bound
        if (held.at_low[j] or held.at_high[j]) and beyond:
            result.append(ExcludedBy(name, side, float(bound), float(best.point[j])))
    return tuple(result)
