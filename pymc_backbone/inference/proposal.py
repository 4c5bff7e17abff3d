"""Joint Metropolis proposals in the shape of the posterior.

Backbones determine combinations of parameters: stiffness at one amplitude, damping at another. One variable at a
time, a random walk crawls along such ridges; a joint proposal with the posterior's own shape does not. The curvature
at the best point begins it; a density with hard edges has no curvature that means anything, so each chain then learns
the shape from its own tuning draws.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pymc as pm
from pymc.pytensorf import floatX
from pymc.step_methods.metropolis import MetropolisState
from pymc.step_methods.state import dataclass_state

from .._common.checks import FloatArray
from .remembering import make_remembering
from .starts import StartFinder

_FIRST_WINDOW = (50, 150)  # tuning draws; each next window is twice as long
_WEIGHT_OF_OLD = 5.0  # draws per dimension that the shape so far counts for


@dataclass_state
class JointMetropolisState(MetropolisState):
    """What a draw depends on, beside PyMC's own."""

    factor: np.ndarray
    tuned_draws: int
    window: tuple[int, int]
    origin: np.ndarray
    total: np.ndarray
    squares: np.ndarray


class JointMetropolis(pm.Metropolis):
    """PyMC's Metropolis with joint proposals, as many a draw as there are variables; their covariance is learned.

    PyMC's own updates a vector one entry at a time, each entry with two evaluations, whatever covariance it is given.
    As there, a draw is a sweep: d proposals, of which a random walk needs some ten times d for one effective draw.
    Tuning draws are collected in windows of doubling length, from draw 50 on, and their covariance is the proposal's
    from the end of each window on [1]_; kept draws never change it, so they are those of one Markov chain.

    Parameters
    ----------
    covariance : ndarray, shape (d, d)
        Of the first proposals, over all unconstrained variables.
    **kwargs
        As of `pymc.Metropolis`.

    References
    ----------
    .. [1] H. Haario, E. Saksman, J. Tamminen, "An adaptive Metropolis algorithm", Bernoulli 7 (2001) 223-242.
    """

    name = "joint_metropolis"
    default_blocked = True
    _state_class = JointMetropolisState

    def __init__(self, covariance: FloatArray, **kwargs: Any) -> None:
        # The best scale of a joint random walk is 2.38 / sqrt(d): Roberts, Gelman, Gilks, Ann. Appl. Probab. 7 (1997).
        super().__init__(S=covariance, scaling=2.38 / np.sqrt(len(covariance)), blocked=True, **kwargs)
        self.elemwise_update = False
        self.accepted_sum = np.zeros(1, dtype=int)
        self.accept_rate_iter = np.zeros(1)
        self.accepted_iter = np.zeros(1, dtype=bool)
        self.proposal_dist = self._propose
        self._first_factor = np.linalg.cholesky(covariance)
        self._forget()

    def _propose(self, rng: np.random.Generator | None = None) -> FloatArray:
        """Return a step of the learned shape and unit scale."""
        generator = self.rng if rng is None else rng
        return np.asarray(self.factor @ generator.standard_normal(len(self.factor)))

    def _forget(self) -> None:
        self.factor = self._first_factor.copy()
        self.tuned_draws, self.window = 0, _FIRST_WINDOW
        self._clear()

    def _clear(self) -> None:
        size = len(self.factor)
        self.origin = getattr(self, "origin", np.zeros(size))
        self.total, self.squares = np.zeros(size), np.zeros((size, size))

    def reset_tuning(self) -> None:
        """Begin a chain as the first one began."""
        super().reset_tuning()
        self._forget()

    def astep(self, q0: Any) -> tuple[Any, Any]:
        """Draw once; while tuning, learn."""
        result, sweep = q0, []
        for _ in range(len(self.factor)):
            result, [statistics] = super().astep(result)
            sweep.append(statistics)
        if self.tune:
            self._learn(np.asarray(floatX(result.data), dtype=np.float64))
        return result, [{name: np.mean([entry[name] for entry in sweep]) for name in sweep[0]}]

    def _learn(self, point: FloatArray) -> None:
        self.tuned_draws += 1
        begin, end = self.window
        if self.tuned_draws <= begin:
            self.origin = point.copy()
            return
        offset = point - self.origin  # sums of squares of small numbers: a variable's unit may be large
        self.total = self.total + offset
        self.squares = self.squares + np.outer(offset, offset)
        if self.tuned_draws < end:
            return
        count = end - begin
        mean = self.total / count
        covariance = self.squares / count - np.outer(mean, mean)
        old = self.factor @ self.factor.T
        weight = _WEIGHT_OF_OLD * len(mean)
        shape = (count * covariance + weight * old) / (count + weight)
        try:
            factor = np.linalg.cholesky(0.5 * (shape + shape.T))
        except np.linalg.LinAlgError:  # rounding, where the window hardly moved: the shape so far stays
            factor = self.factor
        if np.isfinite(factor).all():
            self.factor = factor
            self.scaling = np.atleast_1d(2.38 / np.sqrt(len(mean)))
        self.window = (end, end + 2 * count)
        self._clear()


def make_metropolis(model: pm.Model, finder: StartFinder) -> pm.Metropolis:
    """Return a Metropolis step for ``model``: joint where the finder knows the posterior's shape, else PyMC's own."""
    if finder.shape is None:
        return make_remembering(pm.Metropolis, model)
    return make_remembering(functools.partial(JointMetropolis, finder.shape), model)
