"""Finite, dispersed starting points: a chain that starts where the log-density is -inf never moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymc as pm
from scipy.optimize import least_squares

from ._checks import OBSERVABLE_UNITS, FloatArray, InputError
from .decay import Status, simulate_backbone
from .model import Target, targets_of
from .op import OscillatorResponse

PRIOR_DRAWS = 128
SEARCHES = 24
_FAILED = 30.0  # standardised distance that stands for a failed simulation in a search


class StartFinder:
    """Finds starting points of a PyMC model that holds backbone likelihoods.

    Draws from the prior come first. Where too few of them have a finite log-density (a hard-edged density that no
    prior draw hits), least squares brings draws to the measured values, and points between there and the draws are
    tried, the farthest first.

    Parameters
    ----------
    model : pymc.Model
        The model.
    random_seed : int or numpy.random.Generator
        Seed of everything random here.
    """

    def __init__(self, model: pm.Model, random_seed: Any) -> None:
        self.model = model
        self.generator = np.random.default_rng(random_seed)
        self.log_density = model.compile_logp()
        self.targets = targets_of(model)
        values = model.value_vars
        free = model.replace_rvs_by_values(model.free_RVs)
        self.to_natural = model.compile_fn(free, inputs=values, on_unused_input="ignore")
        thetas = model.replace_rvs_by_values([target.theta for target in self.targets]) if self.targets else []
        self.thetas = model.compile_fn(thetas, inputs=values, on_unused_input="ignore") if thetas else None
        self.draw_point = pm.initial_point.make_initial_point_fn(model=model, default_strategy="prior")

    def find(self, chains: int) -> list[dict[str, FloatArray]]:
        """Return one start per chain: values of the free variables, on their natural scale.

        Raises
        ------
        InputError
            Where no point with a finite log-density exists within the prior, as far as the search can tell; the
            sentence names the observable and the level at fault.
        """
        draws = [self.draw_point(int(seed)) for seed in self.generator.integers(2**31, size=PRIOR_DRAWS)]
        heights = np.array([self._height(point) for point in draws])
        finite = [draws[i] for i in np.argsort(-heights) if np.isfinite(heights[i])]
        # The better half of the finite draws is spread over the posterior and beyond, without hopeless outliers.
        chosen = finite[: max(chains, (len(finite) + 1) // 2)]
        if len(chosen) >= chains:
            picked = self.generator.choice(len(chosen), size=chains, replace=False)
            return [self._natural(chosen[i]) for i in picked]
        found = list(chosen)
        for point in draws[:SEARCHES]:
            if len(found) >= chains or not self.targets:
                break
            solved = self._search(point)
            if np.isfinite(self._height(solved)):
                found.append(self._retreat(solved, point))
        if not found:
            raise InputError(self._explain(draws))
        while len(found) < chains:
            near = found[int(self.generator.integers(len(found)))]
            far = draws[int(self.generator.integers(len(draws)))]
            found.append(self._retreat(near, far))
        return [self._natural(point) for point in found[:chains]]

    def _height(self, point: dict[str, FloatArray]) -> float:
        value = float(self.log_density(point))
        return value if np.isfinite(value) else -np.inf

    def _natural(self, point: dict[str, FloatArray]) -> dict[str, FloatArray]:
        values = self.to_natural(self._inputs(point))
        return {variable.name: np.asarray(v) for variable, v in zip(self.model.free_RVs, values, strict=True)}

    def _inputs(self, point: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {variable.name: point[variable.name] for variable in self.model.value_vars}

    def _distances(self, point: dict[str, FloatArray]) -> FloatArray:
        """Return standardised distances between simulated and measured values, over all targets."""
        assert self.thetas is not None
        parts = []
        for target, theta in zip(self.targets, self.thetas(self._inputs(point)), strict=True):
            simulated = _simulate(target, np.asarray(theta))
            distance = (simulated - target.centre) / np.where(target.spread > 0.0, target.spread, 1.0)
            distance = np.where(np.isnan(simulated), _FAILED, distance)
            parts.append(np.where(np.isfinite(target.centre), distance, 0.0).ravel())
        return np.clip(np.concatenate(parts), -1e6, 1e6)

    def _search(self, point: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the point nearest to the measured values that least squares finds from ``point``."""
        names = [variable.name for variable in self.model.value_vars]
        shapes = [np.shape(point[name]) for name in names]
        sizes = [int(np.prod(shape)) for shape in shapes]

        def unpack(vector: FloatArray) -> dict[str, FloatArray]:
            pieces = np.split(vector, np.cumsum(sizes)[:-1])
            return {name: piece.reshape(shape) for name, piece, shape in zip(names, pieces, shapes, strict=True)}

        start = np.concatenate([np.ravel(point[name]) for name in names]).astype(np.float64)
        def residuals(vector: Any) -> Any:
            return self._distances(unpack(vector))

        solution: Any = least_squares(residuals, start, method="trf", max_nfev=60)
        return unpack(solution.x)

    def _retreat(self, good: dict[str, FloatArray], far: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Return the farthest point tried between ``good`` and ``far`` that has a finite log-density."""
        share = 0.5
        for _ in range(14):
            point = {name: value + share * (far[name] - value) for name, value in good.items()}
            if np.isfinite(self._height(point)):
                return point
            share *= 0.5
        return good

    def _explain(self, draws: list[dict[str, FloatArray]]) -> str:
        """Say in one sentence which observable and level no prior point reaches."""
        if not self.targets or self.thetas is None:
            return "no point drawn from the prior has a finite log-density; check priors and likelihood."
        for index, target in enumerate(self.targets):
            thetas = [np.asarray(self.thetas(self._inputs(point))[index]) for point in draws]
            simulated = np.array([_simulate(target, theta) for theta in thetas])
            failed = np.isnan(simulated).any(axis=2).mean(axis=(0, 1))
            if failed.max() > 0.98:
                return _explain_failure(target, thetas, int(np.argmax(failed)))
            worst: tuple[float, str] = (0.0, "")
            for o, observable in enumerate(target.response.observables):
                for k, level in enumerate(target.response.levels):
                    values = simulated[:, :, o, k]
                    low, high = np.nanmin(values), np.nanmax(values)
                    wanted_low, wanted_high = _range(target, o, k)
                    gap = max(wanted_low - high, low - wanted_high) / max(wanted_high - wanted_low, 1e-300)
                    if gap > worst[0]:
                        unit = "" if OBSERVABLE_UNITS[observable] == "1" else f" {OBSERVABLE_UNITS[observable]}"
                        worst = (gap, (
                            f"no prior point reaches the measured {observable} at amplitude {level:.4g}: measured "
                            f"{wanted_low:.5g} to {wanted_high:.5g}{unit}, simulated {low:.5g} to {high:.5g}{unit}; "
                            "widen the priors, check mass and units, or add the effect that is missing."
                        ))  # fmt: skip
            if worst[1]:
                return worst[1]
        return (
            "no prior point reaches all levels together although each level is reached by some; the model cannot "
            "follow the measured backbones: add an effect, widen the priors, or use a density without hard edges "
            "(marginal='normal')."
        )


def _simulate(target: Target, theta: FloatArray) -> FloatArray:
    """Return simulated values (n, o, l), NaN where a specimen's simulation failed."""
    rows = [target.response.evaluate(np.ascontiguousarray(row), False)[0] for row in theta.reshape(-1, theta.shape[-1])]
    return np.array(rows)


def _range(target: Target, o: int, k: int) -> tuple[float, float]:
    """Return the range of measured values at one observable and level."""
    if target.density is not None:
        draws = target.density.sample(2000, random_seed=0)[:, o, k]
        return float(draws.min()), float(draws.max())
    centre, spread = target.centre[:, o, k], target.spread[:, o, k]
    return float(np.nanmin(centre - 4.0 * spread)), float(np.nanmax(centre + 4.0 * spread))


def _explain_failure(target: Target, thetas: list[FloatArray], k: int) -> str:
    """Say why nearly no prior point can be simulated at level ``k``."""
    level = target.response.levels[k]
    reason = "the function returned no finite values"
    if isinstance(target.response, OscillatorResponse):
        codes = [
            int(simulate_backbone(target.response.oscillator, np.atleast_2d(theta)[0], [level]).status[0])
            for theta in thetas
        ]
        failures = [code for code in codes if code]
        if failures:
            reason = Status(max(set(failures), key=failures.count)).meaning
    return f"nearly no prior point can be simulated at amplitude {level:.4g}: {reason}."
