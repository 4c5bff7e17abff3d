"""The data-consistent density: which distribution of parameters has the measured distribution of backbones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp
from scipy.stats import qmc

from .._common.checks import FloatArray, InputError
from ..oscillator import Oscillator
from ..simulation.response import Response, make_response
from .coordinates import DETERMINED, Coordinates, find_coordinates
from .density import Density
from .density_data import measurement_covariance, population_values
from .density_fit import fit_density
from .density_kernel import DATA_CONSISTENT, log_density_batch
from .density_marginals import shrunk_centres

Bounds = Mapping[str, tuple[float, float]]

_PILOT, _PILOTS = 768, 15  # draws that narrow the box, and how often at most
_SETTLED = 0.7  # share of the box's volume that a pilot must leave for the box to be the last one
_REFINEMENTS = 2  # of the surrogate, once the box has settled
_FEWEST_EFFECTIVE = 50.0
_CANDIDATES = 2**14  # points tried at once for their predicted coordinates, at most
_MOST_ROUNDS = 64
_CENTRES = 1500  # of the predicted density: each costs 10 ns a call and dimension
_FRESH = 2048  # draws that judge the result
_FEWEST_NEAR = 64
_OUT_OF_REACH = (
    "of the draws from the priors, {} can be simulated at all levels and come near the measured backbones; widen the "
    "priors, check mass and units, or add the effect that is missing."
)


def fit_data_consistent(
    source: Oscillator | Callable[[dict[str, float], FloatArray], ArrayLike],
    backbones: xr.Dataset,
    bounds: Bounds,
    *,
    fixed: Mapping[str, float] | None = None,
    observables: Sequence[str] | None = None,
    release_amplitude: float | None = None,
    virgin: bool = True,
    subtract_measurement: bool = True,
    draws: int = 16384,
    random_seed: int = 0,
) -> Density:
    r"""Fit the density of data-consistent inversion: that of the population over what the priors predict.

    A population's parameters have *some* distribution. The posterior whose backbones are distributed as the measured
    ones are is the prior times :math:`\pi_{obs}(q) / \pi_{pred}(q)`: the density of the measured population over that
    of the backbones of prior draws (the push-forward of the prior), at the backbone q of the parameters [1]_. Where the
    backbones determine every parameter, it is the population's own distribution; where they do not, the prior's shape
    stays along what they leave open. A likelihood without the division (``product``, ``joint``) is drawn to where the
    prior has many parameters with alike backbones.

    Parameters
    ----------
    source : Oscillator or callable
        The model, as in `backbone_likelihood`.
    backbones : xarray.Dataset
        Measured backbones; specimens that do not reach all levels are left out.
    bounds : mapping of str to (low, high)
        Of the Uniform priors, by parameter.
    fixed : mapping of str to float, optional
        The other parameters.
    observables : sequence of str, optional
        Default: all in the dataset.
    release_amplitude, virgin
        As in `backbone_likelihood`.
    subtract_measurement : bool, default True
        Take the measurement variance out of the population's.
    draws : int, default 16384
        Backbones that are simulated for the final estimate; some thousands more find the region and judge the result.
    random_seed : int, default 0
        Of the quasi-random draws.

    Returns
    -------
    Density
        ``diagnostics`` holds ``mean_ratio`` (prior mean of observed over predicted density, before calibration: near 1
        where the priors can produce the measured population), ``effective_draws`` (how many independent draws the
        simulated ones are worth), ``directions`` (how many combinations of parameters the backbones determine),
        ``explained`` (by parameter: the share of its variance near the population that they determine),
        ``undetermined`` (the parameters for which this is below one half: their posterior is the prior's doing), and
        ``mean`` and ``sd`` (by parameter: what the calibration draws say the posterior is).

    Raises
    ------
    InputError
        Too few specimens or (effective) prior draws near them, nothing that the backbones determine, bad bounds.

    See Also
    --------
    fit_density : densities that need no prior.
    build_model : infers with it.

    Notes
    -----
    The ratio is not taken in the space of the o x l values, which lie on a surface of as many dimensions as parameters,
    but in the r coordinates z that predict the parameters best (regression of the parameters on the values of prior
    draws, or their logarithms, by polynomials of second degree, with the measurement error in the values; directions
    of which they explain less than half are dropped). Both densities have the same Gaussian kernels, so an edge that
    they share does not move; the measured one has its centres drawn in, so that its variance is the sample's. The
    predicted one comes from quasi-random draws of that box within the priors whose backbones come near the population.
    What smoothing still changes is taken back: a quadratic in z is added to the log ratio so that mean and covariance
    of z, over draws of the prior weighted with the ratio, are those of the measured population.

    References
    ----------
    .. [1] T. Butler, J. Jakeman, T. Wildey, "Combining push-forward measures and Bayes' rule to construct consistent
       solutions to stochastic inverse problems", SIAM Journal on Scientific Computing 40 (2018) A984-A1011,
       doi:10.1137/16M1087229.
    """
    joint = fit_density(backbones, kind="joint", observables=observables, subtract_measurement=subtract_measurement)
    names, levels, value = population_values(backbones, joint.observables)
    complete = np.isfinite(value).all(axis=(1, 2))
    measured = value[complete].reshape(int(complete.sum()), -1)
    fixed = dict(fixed or {})
    given = [*bounds, *fixed]
    response = make_response(
        source, levels, names, parameter_names=None if isinstance(source, Oscillator) else tuple(given),
        release_amplitude=release_amplitude, virgin=virgin,
    )  # fmt: skip
    missing = [name for name in response.parameter_names if name not in given]
    if missing:
        raise InputError(f"`bounds` or `fixed` must hold every parameter of the model; {', '.join(missing)} missing.")
    predictor = _Predictor(response, bounds, fixed, random_seed)
    error = measurement_covariance(backbones, names, complete)
    closest = np.inf
    for _ in range(_PILOTS):
        parameters, values = predictor.draw(_PILOT)
        # how far the population lies outside of what is predicted, in the spread of either
        spread = np.hypot(values.std(axis=0), measured.std(axis=0))
        before, closest = closest, float((np.abs(values - measured.mean(axis=0)) / spread).max(axis=1).min())
        if closest > 3.0 and closest > 0.9 * before:
            raise InputError(_OUT_OF_REACH.format("none"))
        coordinates = find_coordinates(parameters, values, measured, error, subtract_measurement, len(names))
        if predictor.narrow(parameters, coordinates.distance(values)) > _SETTLED:
            break
    region = _Region(coordinates, parameters, values)
    for _ in range(_REFINEMENTS):
        region = _Region(coordinates, *predictor.draw(_PILOT, region))
    parameters, values = predictor.draw(draws, region)
    return _fit_ratio(joint, predictor, region, parameters, values)


class _Predictor:
    """Backbones of quasi-random draws from that box within the priors which holds the population."""

    def __init__(self, response: Response, bounds: Bounds, fixed: Mapping[str, float], random_seed: int) -> None:
        self.response = response
        self.names = [name for name in response.parameter_names if name in bounds]
        self.free = [response.parameter_names.index(name) for name in self.names]
        self.template = np.array([float(fixed.get(name, 0.0)) for name in response.parameter_names])
        self.low, self.high = np.array([bounds[name] for name in self.names], dtype=np.float64).T
        self.generator = np.random.default_rng(random_seed)

    def draw(self, count: int, region: _Region | None = None) -> tuple[FloatArray, FloatArray]:
        """Return parameters (n, p) and values (n, d) of those of so many draws that can be simulated.

        With a region, of draws whose backbones are expected in it.
        """
        sequence = qmc.Sobol(len(self.names), rng=self.generator)
        kept: list[FloatArray] = []
        held = 0
        for _ in range(_MOST_ROUNDS if region else 1):
            points = sequence.random(_CANDIDATES if region else 2 ** int(np.ceil(np.log2(count))))
            parameters = self.low + points * (self.high - self.low)
            kept.append(parameters if region is None else parameters[region.expects(parameters)])
            held += len(kept[-1])
            if held >= count:
                break
        parameters = np.concatenate(kept)[:count]
        theta = np.tile(self.template, (len(parameters), 1))
        theta[:, self.free] = parameters
        values = self.response.evaluate_many(theta).reshape(len(theta), -1)
        good = np.isfinite(values).all(axis=1) if len(values) else np.zeros(0, dtype=bool)
        if good.sum() < _FEWEST_NEAR:
            raise InputError(_OUT_OF_REACH.format(f"only {int(good.sum())}"))
        return parameters[good], values[good]

    def narrow(self, parameters: FloatArray, distance: FloatArray) -> float:
        """Shrink the box to what comes near the population (``distance`` below 1), with a margin.

        Return the share of its volume that is left.
        """
        near = distance < 1.0
        if near.sum() < _FEWEST_NEAR:
            near = distance <= np.sort(distance)[_FEWEST_NEAR - 1]
        low, high = parameters[near].min(axis=0), parameters[near].max(axis=0)
        margin = 0.1 * (high - low)
        before = self.high - self.low
        self.low, self.high = np.maximum(self.low, low - margin), np.minimum(self.high, high + margin)
        return float(np.prod((self.high - self.low) / before))


class _Region:
    """Where the population lies, and how to tell from parameters whether their backbones fall into it."""

    def __init__(self, coordinates: Coordinates, parameters: FloatArray, values: FloatArray) -> None:
        self.coordinates = coordinates
        self.centre, self.scale = parameters.mean(axis=0), parameters.std(axis=0)
        u, distance = coordinates.inner(values), coordinates.distance(values)
        near = distance < 2.0
        if near.sum() < 4 * self._features(parameters[:1]).shape[1]:
            near = np.isfinite(distance)
        features = self._features(parameters[near])
        self.coefficients = np.linalg.lstsq(features, u[near], rcond=None)[0]
        misses = coordinates.distance_of_inner(features @ self.coefficients) - distance[near]
        self.limit = 1.0 + 3.0 * float(np.sqrt(np.mean(misses**2)))

    def _features(self, parameters: FloatArray) -> FloatArray:
        scaled = (parameters - self.centre) / self.scale
        i, j = np.triu_indices(scaled.shape[1])
        return np.column_stack([np.ones(len(scaled)), scaled, scaled[:, i] * scaled[:, j]])

    def expects(self, parameters: FloatArray) -> NDArray[np.bool_]:
        """Return whether the backbones of parameters (n, p) are expected near the population."""
        return self.coordinates.distance_of_inner(self._features(parameters) @ self.coefficients) < self.limit


def _fit_ratio(
    joint: Density, predictor: _Predictor, region: _Region, parameters: FloatArray, values: FloatArray
) -> Density:
    """Return the density ratio, calibrated and judged."""
    coordinates = region.coordinates
    near = coordinates.distance(values) < 1.0
    if near.sum() < 4 * _FEWEST_NEAR:
        raise InputError(_OUT_OF_REACH.format(f"only {int(near.sum())}"))
    z, inside = coordinates.of(values)[near], parameters[near]
    order = predictor.generator.permutation(len(z))
    chosen = order[: min(_CENTRES, len(z) // 2)]
    rest = order[chosen.size :]
    centres = shrunk_centres(coordinates.sample, coordinates.bandwidth)
    d, q, r = values.shape[1], len(coordinates.projection), z.shape[1]
    share = float(near.mean())

    def assemble(constant: float, linear: FloatArray, quadratic: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        codes = np.array([DATA_CONSISTENT, d, q, r, len(centres), chosen.size, *joint.codes])
        pieces = (
            [constant, coordinates.bandwidth], coordinates.is_log, coordinates.centre, coordinates.projection.ravel(),
            coordinates.inner_reach, coordinates.polynomials.ravel(), centres.ravel(), z[chosen].ravel(),
            np.full(r, coordinates.radius), linear, quadratic.ravel(), joint.table,
        )  # fmt: skip
        return codes.astype(np.int64), np.concatenate([np.asarray(piece, dtype=np.float64) for piece in pieces])

    def evaluate(layout: tuple[NDArray[np.int64], FloatArray], points: FloatArray) -> FloatArray:
        logs = np.empty(len(points))
        log_density_batch(*layout, np.ascontiguousarray(points), logs, np.empty_like(points))
        return logs

    # of the box's draws, the share near the population has `chosen` as its sample
    scale = float(np.log(chosen.size / len(centres) / share))
    raw = assemble(scale, np.zeros(r), np.zeros((r, r)))
    logs = evaluate(raw, values[near][rest])
    linear, quadratic = _calibrate(logs, z[rest], len(coordinates.sample))
    tilted = logs + z[rest] @ linear + np.einsum("ni,ij,nj->n", z[rest], quadratic, z[rest])
    normal = float(logsumexp(tilted) - np.log(rest.size / share))
    final = assemble(scale - normal, linear, quadratic)
    weights = np.exp(tilted - logsumexp(tilted))
    effective = float(1.0 / (weights**2).sum())
    if effective < _FEWEST_EFFECTIVE:
        raise InputError(
            f"the data-consistent density rests on {effective:.0f} effective of {rest.size} prior draws near the "
            "measured population, too few to trust; narrow the priors, or raise `draws`."
        )
    mean = weights @ inside[rest]
    sd = np.sqrt(weights @ (inside[rest] - mean) ** 2)
    _, fresh = predictor.draw(_FRESH, region)
    inside_region = fresh[coordinates.distance(fresh) < 1.0]
    mean_ratio = float(np.exp(evaluate(raw, inside_region)).sum() / len(fresh))
    explained = dict(zip(predictor.names, coordinates.explained.tolist(), strict=True))
    diagnostics = {
        "mean_ratio": mean_ratio,
        "effective_draws": effective,
        "directions": r,
        "explained": explained,
        "undetermined": [name for name, part in explained.items() if part < DETERMINED],
        "mean": dict(zip(predictor.names, mean.tolist(), strict=True)),
        "sd": dict(zip(predictor.names, sd.tolist(), strict=True)),
    }
    description = (
        f"Density of the population over that of the backbones which the priors predict, in the {r} combination(s) of "
        f"values that determine the parameters, from {len(coordinates.sample)} specimens and {len(z)} prior draws near "
        f"them; mean ratio {mean_ratio:.2f}."
    )
    return Density(
        "data_consistent", joint.levels, joint.observables, *final, description, joint.rows, diagnostics
    )  # fmt: skip


def _calibrate(logs: FloatArray, z: FloatArray, specimens: int) -> tuple[FloatArray, FloatArray]:
    """Return the polynomial for which the weighted draws have zero mean and unit covariance.

    Newton's method on the convex dual of the smallest change of the weights (relative entropy) with those moments, with
    a penalty in the size of the moments' own sampling error: what the priors cannot reach is not forced.
    """
    r = z.shape[1]
    i, j = np.triu_indices(r)
    features = np.column_stack([z, z[:, i] * z[:, j] - (i == j)])
    penalty = 0.25 / specimens
    theta = np.zeros(features.shape[1])

    def loss(at: FloatArray) -> float:
        return float(logsumexp(logs + features @ at) + 0.5 * penalty * at @ at)

    value = loss(theta)
    for _ in range(50):
        tilted = logs + features @ theta
        weights = np.exp(tilted - logsumexp(tilted))
        moments = weights @ features
        gradient = moments + penalty * theta
        hessian = (features * weights[:, None]).T @ features - np.outer(moments, moments)
        step = -np.linalg.solve(hessian + penalty * np.eye(theta.size), gradient)
        length = 1.0
        while loss(theta + length * step) > value and length > 1e-6:
            length *= 0.5
        theta = theta + length * step
        value = loss(theta)
        if float(np.abs(step).max()) < 1e-9:
            break
    quadratic = np.zeros((r, r))
    quadratic[i, j] = theta[r:]
    return theta[:r], 0.5 * (quadratic + quadratic.T)


__all__ = ["fit_data_consistent"]
