"""The normal equations of all specimens at a point of a joint fit, the specimens' own values eliminated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ..._common.threads import in_threads
from ..._common.unit_diagonal import unit_diagonal
from .data_term import DataTerm
from .fit_kernels import eliminate_own, put_together
from .layout import Layout

NUISANCES = 7  # stiffness, damping, release amplitude, release instant, offset, drift of frequency, of damping
RELEASE_INSTANT, ZERO = 3, 4
_RELEASE = (2, RELEASE_INSTANT, ZERO)
DRIFTS = (5, 6)
_RIDGE = 1e-12  # on the diagonal of ones, as where own values are eliminated
_TWO_DECADES = np.log(1e2) / np.sqrt(2.0 * np.pi)  # width of a Gaussian as dense at its middle as log-uniform ones are


@dataclass(frozen=True, eq=False)
class State:
    """A point of the joint fit.

    Attributes
    ----------
    eta : (q,) array
        Shared coordinates of the effects.
    own : (r, 7 + q) array
        Per specimen: stiffness, damping, release amplitude, release instant, offset, drifts, delta.
    """

    eta: FloatArray
    own: FloatArray


def start_state(layout: Layout, eta: FloatArray, own: FloatArray) -> State:
    """Return a start with these shared coordinates and own nuisances (r, 5 or 7)."""
    full = np.zeros((own.shape[0], NUISANCES + layout.free.size))
    count = min(own.shape[1], NUISANCES)
    full[:, :count] = own[:, :count]
    return State(np.asarray(eta, dtype=np.float64), full)


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations at a point: cost, gradients and information, shared and per specimen."""

    chi_square: FloatArray
    penalty: float
    shared_gradient: FloatArray
    shared: FloatArray
    mixed: FloatArray
    own: FloatArray
    own_gradient: FloatArray

    @property
    def cost(self) -> float:
        """Return the sum of squares at the point."""
        return float(self.chi_square.sum() + self.penalty)


def linearise(layout: Layout, terms: Sequence[DataTerm], state: State, scatter: float, active: Any) -> System | None:
    """Return the normal equations at a point, or None where it cannot be simulated."""
    q, count = layout.free.size, len(terms)
    size = NUISANCES + q
    shared, shared_gradient = np.zeros((q, q)), np.zeros(q)
    mixed, own = np.zeros((count, q, size)), np.zeros((count, size, size))
    own_gradient, chi_square = np.zeros((count, size)), np.zeros(count)
    priors = np.flatnonzero(active & (np.arange(size) >= DRIFTS[0]))  # those with a standard normal prior
    jobs = [partial(_gram, layout, term, state.eta, state.own[r], scatter, active) for r, term in enumerate(terms)]
    for r, gram in enumerate(in_threads(jobs)):
        if gram is None:
            return None
        chi_square[r] = gram[-1, -1]
        shared += gram[:q, :q]
        shared_gradient += gram[:q, -1]
        mixed[r] = gram[:q, q:-1]
        own[r] = gram[q:-1, q:-1]
        own_gradient[r] = gram[q:-1, -1]
        own[r, priors, priors] += 1.0
        own_gradient[r, priors] -= state.own[r, priors]
    penalty = float((state.own[:, priors] ** 2).sum())
    return System(chi_square, penalty, shared_gradient, shared, mixed, own, own_gradient)


class Derivatives(NamedTuple):
    """Residuals (n,) of one specimen, and derivatives of what is simulated with respect to what is fitted.

    Attributes
    ----------
    residuals : (n,) array
        Standardised, measured minus simulated.
    shared : (n, q) array
        With respect to the shared coordinates.
    own : (n, 7 + q) array
        With respect to the specimen's own values; zero where these are not fitted.
    together : (n, 8 + 2 q) array
        Shared, own, residuals: what the three are columns of.
    """

    residuals: FloatArray
    shared: FloatArray
    own: FloatArray
    together: FloatArray


def parameters_at(layout: Layout, eta: FloatArray, values: FloatArray, scatter: float) -> tuple[FloatArray, FloatArray]:
    """Return the parameter vector (p,) of a specimen with these own values, and the effects' derivatives (q, q)."""
    effects, slopes = layout.physical(eta, values[NUISANCES:], scatter)
    vector = layout.template.copy()
    vector[:2] = values[:2]
    vector[layout.free] = effects
    return vector, slopes


def derivatives(
    layout: Layout, term: DataTerm, eta: FloatArray, values: FloatArray, scatter: float, active: Any
) -> Derivatives | None:
    """Return residuals and derivatives of one specimen at a point; None where it cannot be simulated."""
    vector, slopes = parameters_at(layout, eta, values, scatter)
    drifts = any(active[column] or values[column] != 0.0 for column in DRIFTS)
    compared = term.compare(layout.simulator, vector, values[2:NUISANCES], drifts=drifts)
    if compared is None:
        return None
    residuals, jacobian = compared
    q = layout.free.size
    together = np.empty((residuals.size, q + values.size + 1))
    put_together(
        np.ascontiguousarray(residuals), np.ascontiguousarray(jacobian), layout.free, slopes,
        1.0 + scatter * values[NUISANCES:], eta * scatter, active, together,
    )  # fmt: skip
    return Derivatives(together[:, -1], together[:, :q], together[:, q:-1], together)


@np.errstate(over="ignore", invalid="ignore")  # far from any motion derivatives overflow: counted as a failure
def _gram(
    layout: Layout, term: DataTerm, eta: FloatArray, values: FloatArray, scatter: float, active: Any
) -> FloatArray | None:
    """Return the products of derivatives and residuals of one specimen: shared, own, residual; None where it fails."""
    found = derivatives(layout, term, eta, values, scatter, active)
    if found is None:
        return None
    gram: FloatArray = found.together.T @ found.together
    return gram if np.isfinite(gram).all() else None


def eliminate(system: System, active: Any, damping: float, held: Any) -> Any:
    """Return what remains for the shared values once each specimen's own are eliminated; None where nothing does."""
    free = active & ~held
    (count, q, size), shared = system.mixed.shape, system.shared + damping * np.diag(np.diag(system.shared))
    gradient, scale = system.shared_gradient.copy(), np.empty((count, size))
    reduced, logarithms = np.empty((count, size, q + 1)), np.empty(count)
    is_regular = eliminate_own(
        system.mixed, system.own, system.own_gradient, free, damping, shared, gradient, scale, reduced, logarithms
    )
    if not is_regular:
        return None
    solved = []
    for r in range(count):
        index = np.flatnonzero(free[r])
        solved.append((index, scale[r, : index.size], reduced[r, : index.size], float(logarithms[r])))
    return shared, gradient, solved


def information(layout: Layout, system: System, state: State, active: Any, noise: float) -> tuple[float, FloatArray]:
    """Return the logarithm of the determinant of the information, and the covariance (q, q) of the shared values.

    ``noise`` is the variance of the residuals in units of the one assumed. The shared values are scaled with the width
    of their priors; the covariance holds their default priors. How specimens were released has no part in it
    (`log_of_release`).
    """
    q, size = layout.free.size, state.own.shape[1]
    prior = np.diag((active & (np.arange(size) >= DRIFTS[0])).astype(np.float64))
    scaled_system = replace(
        system, shared=system.shared / noise, mixed=system.mixed / noise, own=(system.own - prior) / noise + prior
    )
    eliminated = eliminate(scaled_system, active, 0.0, np.zeros(state.own.shape, dtype=bool))
    if eliminated is None:
        return np.inf, np.full((q, q), np.nan)
    shared, _, solved = eliminated
    released = sum(log_of_release(block, np.arange(size), active) for block in scaled_system.own)
    own = float(sum(item[3] for item in solved)) - released
    if q == 0:
        return own, np.empty((0, 0))
    widths = np.where(layout.is_strength, layout.width, shape_width(layout, state.eta))
    try:
        covariance = np.outer(widths, widths) * np.linalg.inv(np.eye(q) + symmetric(shared) * np.outer(widths, widths))
    except np.linalg.LinAlgError:
        return np.inf, np.full((q, q), np.nan)
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    chosen = prior_width(layout, state.eta, spread)
    eigenvalues = np.linalg.eigvalsh(symmetric(shared) * np.outer(chosen, chosen))
    return own + float(np.log1p(np.maximum(eigenvalues, 0.0)).sum()), covariance


def log_of_release(own: FloatArray, index: IntArray, active: Any) -> float:
    """Return the logarithm of the determinant of the information on how a specimen was released, the rest given.

    Release, instant and zero are no part of a model, and by Jeffreys' prior [1]_ what is known of them counts alike for
    every set. With densities that are alike everywhere, a slider that had slipped by any amount at the release, and
    moved as if it had been released where it slips, took specimens that were released alike for its doing.

    Parameters
    ----------
    own : (n, n) array
        Information on the specimen's own values.
    index : (n,) array of int
        Which of them its rows stand for.
    active : (m,) array of bool
        Which are fitted.

    References
    ----------
    .. [1] Jeffreys H. (1946) An invariant form for the prior probability in estimation problems. Proceedings of the
       Royal Society A 186(1007), 453-461. doi:10.1098/rspa.1946.0056
    """
    kept = np.flatnonzero(np.isin(index, _RELEASE) & active[index])
    return unit_diagonal(own[np.ix_(kept, kept)], _RIDGE).log_determinant() if kept.size else 0.0


def prior_width(layout: Layout, eta: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the standard deviation of the prior of each shared coordinate.

    The size of an effect is not known beforehand, not even its order of magnitude: the prior of a strength is as wide
    as three times what is found, or what could just be seen.
    """
    own = np.minimum(3.0 * np.maximum(np.abs(eta), 3.0 * spread), 10.0 * layout.width)
    return np.where(layout.is_strength, own, shape_width(layout, eta))


def shape_width(layout: Layout, eta: FloatArray) -> FloatArray:
    """Return the standard deviation of the prior of each shared coordinate, taken for a shape.

    That of its default bounds; but where it is looked for beyond these, a value far outside of them (of the Bouc-Wen
    law, which slips at a hundredth of the amplitude then) is known by its order of magnitude only: log-uniform over
    two decades. With the width of the bounds there it would come at no cost, and beside every other law be favoured.
    """
    span = np.sqrt(12.0) * layout.width
    is_open = layout.high - layout.low > 1.01 * span
    return np.where(is_open, layout.width + _TWO_DECADES * np.maximum(np.abs(eta) - span, 0.0), layout.width)


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix, without what rounding adds."""
    return 0.5 * (matrix + matrix.T)
