"""Finite, dispersed starting points: a chain that starts where the log-density is -inf never moves."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import NDArray
from pymc.distributions.transforms import Interval
from pytensor.compile.mode import Mode
from scipy.optimize import least_squares

from .._common.checks import FloatArray, InputError
from ..simulation.response import OscillatorResponse
from .compiling import compile_once
from .flat_priors import residual_of_prior, slope_of_prior
from .start_hint import StartHint, start_hint_of
from .targets import targets_of
from .unreached import sentence

PRIOR_DRAWS = 128
SEARCHES = 24
MAXIMUM_DIMENSIONS = 40  # beyond, the shape takes too long, and a joint random walk hardly moves
_DISPERSION = 3.0  # standard deviations
_CORRECTIONS = 2
_FORLORN = 30.0  # a mode this much lower in log-density holds nothing of the posterior
_PRIOR_PRECISION = 3.0 / np.pi**2  # of a Uniform prior on PyMC's unconstrained (logistic) scale, near its middle
_AT_BOUND = 25.0  # unconstrained value that lies 1e-11 of the interval beside its bound
_FAILED = 30.0  # standardised distance that stands for a failed simulation in a search
_HINT_DRAWS = 64
_UNCOMPILED = Mode(linker="py", optimizer="fast_run")  # asked some hundred times: machine code would take far longer
_THETA_STEP = 1e-6  # of central differences of parameters by unconstrained values


class StartFinder:
    """Finds starting points of a PyMC model that holds backbone likelihoods.

    Draws from the prior come first; least squares brings them to the measured values, and from there they are
    dispersed by several standard deviations of the posterior's own shape. So chains start apart, also in separate
    modes, but not where the log-density is -inf or the posterior out of reach.

    Parameters
    ----------
    model : pymc.Model
        The model.
    random_seed : int or numpy.random.Generator
        Seed of everything random here.
    """

    def __init__(self, model: pm.Model, random_seed: int | np.random.Generator) -> None:
        self.model = model
        self.generator = np.random.default_rng(random_seed)
        self.log_density = compile_once(model, "log-density", lambda: model.compile_logp(mode=_UNCOMPILED))
        self.targets = targets_of(model)
        self.to_natural = compile_once(model, "natural values", lambda: self._compile(model.free_RVs))
        self.bounded = {
            model.rvs_to_values[rv].name: isinstance(model.rvs_to_transforms[rv], Interval) for rv in model.free_RVs
        }
        self.best: dict[str, FloatArray] = {}
        self.shape: FloatArray | None = None
        self.prior_sd = np.ones(0)

    # A model with a hint needs neither of these two.

    @cached_property
    def thetas(self) -> Callable[..., Any] | None:
        """The parameters of every likelihood as a function of the unconstrained values; None without likelihoods."""
        thetas = [target.theta for target in self.targets]
        return compile_once(self.model, "parameters", lambda: self._compile(thetas)) if thetas else None

    @cached_property
    def draw_point(self) -> Callable[..., Any]:
        """What draws a point from the prior, for a seed."""
        model = self.model
        function: Callable[..., Any] = compile_once(
            model, "prior", lambda: pm.initial_point.make_initial_point_fn(model=model, default_strategy="prior")
        )
        return function

    def _compile(self, variables: list[Any]) -> Callable[..., Any]:
        """Return these variables as a function of the unconstrained values."""
        outputs = self.model.replace_rvs_by_values(variables)
        function: Callable[..., Any] = self.model.compile_fn(
            outputs, inputs=self.model.value_vars, on_unused_input="ignore", mode=_UNCOMPILED
        )
        return function

    def find(self, chains: int) -> list[dict[str, FloatArray]]:
        """Return one start per chain: values of the free variables, on their natural scale.

        Raises
        ------
        InputError
            Where no point with a finite log-density exists within the prior, as far as the search can tell; the
            sentence names the observable and the level at fault.
        """
        hint = start_hint_of(self.model)
        if hint is not None:
            return self._find_by_hint(chains, hint)
        draws = [self.draw_point(int(seed)) for seed in self.generator.integers(2**31, size=PRIOR_DRAWS)]
        spread = np.std([self._flatten(point)[0] for point in draws], axis=0)
        self.prior_sd = np.where(np.isfinite(spread) & (spread > 0.0), spread, 1.0)
        heights = np.array([self.height(point) for point in draws])
        order = np.argsort(-heights)
        if not self.targets:
            finite = [draws[i] for i in order if np.isfinite(heights[i])]
            if not finite:
                raise InputError(self._explain(draws))
            return [self._natural(finite[i % len(finite)]) for i in range(chains)]
        found: list[tuple[float, dict[str, FloatArray]]] = []
        for i in order[:SEARCHES]:
            # A draw from the prior may lie many thousand standard deviations off: each chain starts where least
            # squares ends from a draw of its own, so that separate modes are found, and disperses from there.
            solved = self._search(draws[i])
            reached = max(((self.height(point), point) for point in (solved, draws[i])), key=lambda pair: pair[0])
            if np.isfinite(reached[0]):
                found.append(reached)
            highest = max((height for height, _ in found), default=-np.inf)
            if sum(height > highest - _FORLORN for height, _ in found) >= chains:
                break
        if not found:
            raise InputError(self._explain(draws))
        highest, self.best = max(found, key=lambda pair: pair[0])
        good = [point for height, point in found if height > highest - _FORLORN]
        self.shape = self._find_shape()
        return [self._natural(self._disperse(good[i % len(good)])) for i in range(chains)]

    def _find_by_hint(self, chains: int, hint: StartHint) -> list[dict[str, FloatArray]]:
        """Return starts where the model's own hint says, those with a finite log-density."""
        names = {variable.name: self.model.rvs_to_values[variable].name for variable in self.model.free_RVs}
        found = []
        for _ in range(_HINT_DRAWS * chains):
            point = hint.draw(names, self.generator)
            if np.isfinite(self.height(point)):
                found.append(self._natural(point))
            if len(found) == chains:
                return found
        raise InputError(
            "no start near the fits of the specimens can be simulated at all levels; drop the outermost levels."
        )

    def _disperse(self, centre: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return a point some standard deviations away from ``centre``, nearer where it would lie out of reach.

        Out of reach is what lies lower in log-density than so many standard deviations of a normal posterior do: on
        the unconstrained scale a flat prior has no end, and its far edge can be a place that no walk comes back from.
        """
        vector, unpack = self._flatten(centre)
        lowest = self.height(centre) - 0.5 * _DISPERSION**2 * (vector.size + 2.0 * np.sqrt(2.0 * vector.size))
        factor = np.eye(vector.size) if self.shape is None else np.linalg.cholesky(self.shape)
        for _ in range(20):
            width = _DISPERSION
            offset = factor @ self.generator.standard_normal(vector.size)
            while width > 0.02:
                point = unpack(vector + width * offset)
                if self.height(point) > lowest:
                    return point
                width *= 0.6
        return centre

    def _flatten(
        self, point: dict[str, FloatArray]
    ) -> tuple[FloatArray, Callable[[FloatArray], dict[str, FloatArray]]]:
        """Return the unconstrained values as one vector, and the function that undoes it."""
        names = [variable.name for variable in self.model.value_vars]
        shapes = [np.shape(point[name]) for name in names]
        cuts = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]

        def unpack(vector: FloatArray) -> dict[str, FloatArray]:
            pieces = np.split(vector, cuts)
            return {name: piece.reshape(shape) for name, piece, shape in zip(names, pieces, shapes, strict=True)}

        return np.concatenate([np.ravel(point[name]) for name in names]).astype(np.float64), unpack

    def _bounded(self, point: dict[str, FloatArray]) -> NDArray[np.bool_]:
        """Return which of the flattened values have a Uniform prior's scale."""
        parts = [np.full(np.size(point[v.name]), self.bounded[v.name]) for v in self.model.value_vars]
        return np.concatenate(parts)

    def _find_shape(self) -> FloatArray | None:
        """Return the covariance of the unconstrained variables near the best point, or None where there is none.

        Gauss-Newton on the standardised distances to the measured values gives a first shape; second differences of
        the log-density, a fair step wide in that shape, correct it where the density is smooth there.
        """
        centre, unpack = self._flatten(self.best)
        size = centre.size
        if size > MAXIMUM_DIMENSIONS:
            return None
        # an unbounded variable has its own unit: the prior's spread is the length to step and to weigh by
        bounded = self._bounded(self.best)
        length = np.where(bounded, 1.0, self.prior_sd)
        steps = 1e-4 * np.diag(length)
        jacobian = np.column_stack(
            [(self.distances(unpack(centre + h)) - self.distances(unpack(centre - h))) / 2e-4 for h in steps]
        )
        # where the best point lies near a bound, the slope of the log-density there bends with the scale: by as much as
        # the prior's own slope, with which it is in balance
        slope = np.where(bounded, np.tanh(0.5 * centre) ** 2, 0.0)
        precision = np.diag(np.where(bounded, _PRIOR_PRECISION, 1.0) * (1.0 - slope) + slope)
        shape: FloatArray = np.linalg.inv(jacobian.T @ jacobian + precision) * np.outer(length, length)
        for _ in range(_CORRECTIONS):
            corrected = self._correct_shape(centre, unpack, 0.5 * (shape + shape.T))
            if corrected is None:
                break
            shape = corrected
        return 0.5 * (shape + shape.T)

    def _correct_shape(
        self, centre: FloatArray, unpack: Callable[[FloatArray], dict[str, FloatArray]], shape: FloatArray
    ) -> FloatArray | None:
        """Return ``shape`` corrected by second differences of the log-density; None if hard edges are within reach."""
        size = centre.size
        factor = np.linalg.cholesky(shape)

        def height(offset: FloatArray) -> float:
            return self.height(unpack(centre + factor @ offset))

        width, middle = 0.5, height(np.zeros(size))
        unit = width * np.eye(size)
        along = np.array([[height(sign * unit[j]) for sign in (1.0, -1.0)] for j in range(size)])
        if not (np.isfinite(along).all() and np.isfinite(middle)):
            return None
        curvature = np.diag(2.0 * middle - along.sum(axis=1)) / width**2
        for i in range(size):
            for j in range(i):
                both = height(unit[i] + unit[j]) + height(-unit[i] - unit[j])
                mixed = (along[i].sum() + along[j].sum() - 2.0 * middle - both) / (2.0 * width**2)
                curvature[i, j] = curvature[j, i] = mixed
        if not np.isfinite(curvature).all():
            return None
        values, vectors = np.linalg.eigh(curvature)
        # What looks flat or sharp beyond a factor of thirty is an artefact of a rough density.
        correction = vectors @ np.diag(1.0 / np.clip(values, 1.0 / 30.0, 30.0)) @ vectors.T
        result: FloatArray = factor @ correction @ factor.T
        return result

    def height(self, point: dict[str, FloatArray]) -> float:
        """Return the log-density at a point of unconstrained values; -inf where it is not finite."""
        value = float(self.log_density(point))
        return value if np.isfinite(value) else -np.inf

    def _natural(self, point: dict[str, FloatArray]) -> dict[str, FloatArray]:
        # a value that rounds to its bound has no place on the unconstrained scale: a chain from there never moves
        inside = {
            name: np.clip(value, -_AT_BOUND, _AT_BOUND) if self.bounded[name] else value
            for name, value in self._inputs(point).items()
        }
        values = self.to_natural(inside)
        return {variable.name: np.asarray(v) for variable, v in zip(self.model.free_RVs, values, strict=True)}

    def _inputs(self, point: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {variable.name: point[variable.name] for variable in self.model.value_vars}

    def distances(self, point: dict[str, FloatArray]) -> FloatArray:
        """Return standardised distances between simulated and measured values, over all targets."""
        assert self.thetas is not None
        parts = []
        for target, theta in zip(self.targets, self.thetas(self._inputs(point)), strict=True):
            simulated = target.simulated(np.asarray(theta))
            if target.density is not None and target.density.kind != "product":
                whole = np.where(np.isnan(simulated), target.centre, simulated)
                missing = np.where(np.isnan(simulated), _FAILED, 0.0)
                parts += [target.density.standardise(whole).ravel(), missing.ravel()]
                continue
            distance = (simulated - target.centre) / np.where(target.spread > 0.0, target.spread, 1.0)
            distance = np.where(np.isnan(simulated), _FAILED, distance)
            parts.append(np.where(np.isfinite(target.centre), distance, 0.0).ravel())
        residuals: FloatArray = np.clip(np.concatenate(parts), -1e6, 1e6)
        return residuals

    def _search(self, point: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the point nearest to the measured values that least squares finds from ``point``.

        The Uniform priors count, with their density on the unconstrained scale: where the nearest point lies at a
        bound, it would otherwise run away to where nothing changes any more.
        """
        start, unpack = self._flatten(point)
        bounded = self._bounded(point)

        def residuals(vector: FloatArray) -> FloatArray:
            return np.concatenate([self.distances(unpack(vector)), residual_of_prior(vector[bounded])])

        def slopes(vector: FloatArray) -> FloatArray:
            prior = np.zeros((int(bounded.sum()), vector.size))
            prior[:, bounded] = np.diag(slope_of_prior(vector[bounded]))
            return np.vstack([self._slopes_of_distances(vector, unpack), prior])

        solution: Any = least_squares(
            residuals,
            start,
            slopes if self._has_slopes else "2-point",
            method="trf",
            x_scale="jac",
            max_nfev=60,
        )
        return unpack(solution.x)

    @property
    def _has_slopes(self) -> bool:
        """Whether the simulators know their sensitivities, and distances are in units of single values."""
        return all(
            isinstance(target.response, OscillatorResponse)
            and (target.density is None or target.density.kind == "product")
            for target in self.targets
        )

    def _slopes_of_distances(
        self, vector: FloatArray, unpack: Callable[[FloatArray], dict[str, FloatArray]]
    ) -> FloatArray:
        """Return the derivatives of `distances` by the unconstrained values.

        One simulation with sensitivities for each parameter vector, chained with differences of the parameters, which
        cost no simulation: with differences of the distances every unknown of one specimen would simulate all of them.
        """
        assert self.thetas is not None
        thetas = self.thetas
        step = _THETA_STEP * np.maximum(np.abs(vector), 1.0)

        def at(values: FloatArray) -> list[FloatArray]:
            found = thetas(self._inputs(unpack(values)))
            return [np.atleast_2d(np.asarray(theta, dtype=np.float64)) for theta in found]

        centre = at(vector)
        ends = [(at(vector + h), at(vector - h)) for h in np.diag(step)]
        parts = []
        for index, target in enumerate(self.targets):
            by_unknown = np.array(
                [(up[index] - down[index]) / (2.0 * h) for (up, down), h in zip(ends, step, strict=True)]
            )
            spread = np.where(target.spread > 0.0, target.spread, 1.0)
            simulated = np.zeros((*target.centre.shape, vector.size))
            rows = [target.response.evaluate(np.ascontiguousarray(theta), True) for theta in centre[index]]
            for s in range(len(simulated)):
                k = s if len(rows) > 1 else 0
                _, by_parameter, completed = rows[k]
                if completed:
                    simulated[s] = by_parameter @ by_unknown[:, k].T
            known = np.isfinite(target.centre)[..., None]
            parts.append(np.where(known, simulated / spread[..., None], 0.0).reshape(-1, vector.size))
        return np.concatenate(parts)

    def _explain(self, draws: list[dict[str, FloatArray]]) -> str:
        """Say in one sentence which observable and level no prior point reaches."""
        if not self.targets or self.thetas is None:
            return "no point drawn from the prior has a finite log-density; check priors and likelihood."
        inputs = [self.thetas(self._inputs(point)) for point in draws]
        return sentence(self.targets, [[np.asarray(one[k]) for one in inputs] for k in range(len(self.targets))])
