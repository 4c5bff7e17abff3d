"""The likelihood of shared values alone: what is each specimen's own is integrated out, given these.

Given the effects, specimens do not depend on each other. Their own values are known far better than the effects are
where anything is open, so that their integral is Gaussian; but the middle of that Gaussian bends with the effects, by
many times its width. It is followed by steps that need residuals only: the derivatives are those at the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from ..._common.checks import FloatArray
from ..._common.threads import in_threads
from ..._common.unit_diagonal import unit_diagonal
from ..fitting.data_term import DataTerm
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import (
    DRIFTS,
    NUISANCES,
    derivatives,
    log_of_release,
    parameters_at,
    prior_width,
    symmetric,
)

_MOST_STEPS = 4
_NEAR = 0.5  # fall of minus twice the log-likelihood that a further step promises, up to which its promise is kept
_LOST = 4.0  # the same, above which it is not
_RIDGE = 1e-12  # on the diagonal of ones of a matrix that is inverted
_DAMPING = 1  # place of the specimen's damping, which is not negative


@dataclass(frozen=True, eq=False)
class _Specimen:
    """One specimen around the fit.

    Attributes
    ----------
    term : DataTerm
        Its data.
    own : (n,) array
        All of its own values at the fit.
    jacobian : (m, a) array
        Derivatives with respect to those that were fitted.
    variance : float
        Of the residuals, in units of the one assumed.
    size : float
        Independent pieces in the residuals; infinite where the variance is known.
    floor : float
        Sum of squares that logarithms refer to.
    precision, inverse : (a, a) arrays
        Of the own values given the shared ones, and its inverse.
    follows : (a, q) array
        How the own values go after the shared ones.
    log_determinant : float
        Of the precision, without what it says of the release alone.
    """

    term: DataTerm
    own: FloatArray
    jacobian: FloatArray
    variance: float
    size: float
    floor: float
    precision: FloatArray
    inverse: FloatArray
    follows: FloatArray
    log_determinant: float


class Proposal(NamedTuple):
    """Where the shared values are by the curvature of the fit: middle (q,), covariance (q, q)."""

    middle: FloatArray
    covariance: FloatArray


class Conditional:
    """The likelihood of a set of effects as a function of its shared coordinates alone.

    Attributes
    ----------
    proposal : Proposal
        What the curvature at the fit says of the shared coordinates, their prior included.
    widths : (q,) array
        Standard deviations of the prior of the shared coordinates, which is centred at the fit.
    simulated : float
        Cycles simulated so far.
    cycles : float
        Cycles of one simulation of all specimens.
    """

    def __init__(self, found: Fit, terms: Sequence[DataTerm], sizes: FloatArray, floor: FloatArray) -> None:
        self.found, self.layout = found, found.layout
        self.index = np.flatnonzero(found.active)
        self.scatter = found.layout.scatter if found.active[NUISANCES:].any() else 0.0
        self.prior = (self.index >= DRIFTS[0]).astype(np.float64)
        self.cycles = float(sum(term.cycles for term in terms))
        self.simulated = 0.0
        self.specimens: list[_Specimen] = []
        q = found.layout.free.size
        shared, gradient = np.zeros((q, q)), np.zeros(q)
        for r, term in enumerate(terms):
            specimen, pull = self._specimen(term, r, float(sizes[r]), float(floor[r]))
            self.specimens.append(specimen)
            shared += pull[:, :-1]
            gradient += pull[:, -1]
        spread = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
        self.widths = prior_width(found.layout, found.state.eta, spread)
        # in units of the prior, where rounding cannot make it indefinite
        values, vectors = np.linalg.eigh(symmetric(shared) * np.outer(self.widths, self.widths))
        scaled = (vectors / (1.0 + np.maximum(values, 0.0))) @ vectors.T
        covariance = symmetric(scaled) * np.outer(self.widths, self.widths)
        limits = 3.0 * np.sqrt(np.diag(covariance))
        step = np.clip(covariance @ gradient, -limits, limits)
        stepped = found.layout.within(found.state.eta + step)
        # a fit that did not come to rest is left behind; but along a bent valley a straight step leads away
        middle = max((found.state.eta, stepped), key=lambda eta: self._log_density(eta)[0]) if q else stepped
        self.proposal = Proposal(middle, covariance)

    def _specimen(self, term: DataTerm, r: int, size: float, floor: float) -> tuple[_Specimen, FloatArray]:
        """Return a specimen, and what it says of the shared values (q, q + 1), its own eliminated."""
        found = self.found
        own = found.state.own[r]
        known = derivatives(found.layout, term, found.state.eta, own, self.scatter, found.active)
        if known is None:
            raise FloatingPointError("the fit itself cannot be simulated")
        variance = float(known.residuals @ known.residuals) / size if np.isfinite(size) else 1.0
        jacobian = known.own[:, self.index]
        precision = jacobian.T @ jacobian / variance + np.diag(self.prior)
        unseen = np.flatnonzero(np.diag(precision) <= 0.0)  # an offset behind a band-pass: it stays where it is
        precision[unseen, unseen] = 1.0
        inverse = _inverse(precision)
        mixed = jacobian.T @ known.shared / variance
        slope = jacobian.T @ known.residuals / variance - self.prior * own[self.index]
        held = (self.index == _DAMPING) & (own[self.index] <= 0.0) & (slope < 0.0)
        free = np.flatnonzero(~held)
        within = np.zeros_like(inverse)
        within[np.ix_(free, free)] = _inverse(precision[np.ix_(free, free)])
        gradient = known.shared.T @ known.residuals / variance - mixed.T @ within @ slope
        left = known.shared.T @ known.shared / variance - mixed.T @ within @ mixed
        log_determinant = unit_diagonal(precision, _RIDGE).log_determinant()
        log_determinant -= log_of_release(precision, self.index, found.active)
        specimen = _Specimen(
            term, own, jacobian, variance, size, floor, precision, inverse, -within @ mixed, log_determinant
        )
        return specimen, np.concatenate([left, gradient[:, None]], axis=1)

    def log_densities(self, points: FloatArray) -> FloatArray:
        """Return the logarithm of the integrand, likelihood times prior, at shared coordinates (n, q).

        Minus infinity outside of the limits, and where a specimen cannot be simulated.
        """
        found = in_threads([partial(self._log_density, point) for point in points])
        self.simulated += sum(cycles for _, cycles in found)
        return np.array([value for value, _ in found])

    def _log_density(self, eta: FloatArray) -> tuple[float, float]:
        """Return the logarithm of the integrand at one point, and the cycles that were simulated for it."""
        layout, cycles = self.layout, 0.0
        if np.any(eta != layout.within(eta)):
            return -np.inf, cycles
        place = (eta - self.found.state.eta) / self.widths
        total = -0.5 * float(place @ place) - float(np.log(self.widths).sum()) - 0.5 * place.size * np.log(2.0 * np.pi)
        for specimen in self.specimens:
            value, steps = self._marginal(specimen, eta)
            total, cycles = total + value, cycles + steps * specimen.term.cycles
            if not np.isfinite(total):
                return -np.inf, cycles
        return total, cycles

    @np.errstate(over="ignore", invalid="ignore")  # draws from heavy tails: what overflows counts as lost
    def _marginal(self, specimen: _Specimen, eta: FloatArray) -> tuple[float, int]:
        """Return the logarithm of one specimen's likelihood, its own values integrated out, and the simulations."""
        own = specimen.own.copy()
        own[self.index] += specimen.follows @ (eta - self.found.state.eta)
        own[_DAMPING] = max(own[_DAMPING], 0.0)
        best, steps = -np.inf, 0
        while steps < _MOST_STEPS:
            steps += 1
            vector, _ = parameters_at(self.layout, eta, own, self.scatter)
            residuals = specimen.term.residuals(self.layout.simulator, vector, own[2:NUISANCES])
            if residuals is None or not np.isfinite(residuals @ residuals):
                break
            slope = specimen.jacobian.T @ residuals / specimen.variance
            pull = slope - self.prior * own[self.index]
            step = specimen.inverse @ pull
            inside = self._inside(specimen, own, step)
            fall = float(inside @ (2.0 * pull - specimen.precision @ inside))
            if not abs(fall) <= _LOST:
                step = np.zeros_like(step)  # promised by derivatives that hold elsewhere
            best = max(best, self._log_likelihood(specimen, own, residuals, slope, step))
            if abs(fall) < _NEAR:
                break
            own = own.copy()
            own[self.index] += inside
        return best, steps

    def _inside(self, specimen: _Specimen, own: FloatArray, step: FloatArray) -> FloatArray:
        """Return the step to the best values whose damping is not negative."""
        place = int(np.searchsorted(self.index, _DAMPING))
        lacking = -(own[_DAMPING] + step[place])
        if lacking <= 0.0:
            return step
        inside: FloatArray = step + specimen.inverse[:, place] / specimen.inverse[place, place] * lacking
        return inside

    def _log_likelihood(
        self, specimen: _Specimen, own: FloatArray, residuals: FloatArray, slope: FloatArray, step: FloatArray
    ) -> float:
        """Return the logarithm of the Gaussian integral over a specimen's own values, as seen from a point close by."""
        there = own[self.index] + step
        moved = specimen.precision @ step - self.prior * step
        variance, square = specimen.variance, float(residuals @ residuals)
        square = max(square + variance * float(step @ (moved - 2.0 * slope)), 1e-6 * square)
        penalty = float((self.prior * there) @ there)
        if np.isfinite(specimen.size):
            value = -0.5 * specimen.size * float(np.log(square / specimen.floor)) - 0.5 * penalty
        else:
            value = -0.5 * (square + penalty)
        place = int(np.searchsorted(self.index, _DAMPING))
        above = there[place] / np.sqrt(specimen.inverse[place, place])
        return value - 0.5 * specimen.log_determinant + float(log_ndtr(above))


def _inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix whose entries differ by orders of magnitude."""
    known = unit_diagonal(matrix, _RIDGE)
    return known.scaled(symmetric(np.linalg.inv(known.matrix)))


__all__ = ["Conditional", "Proposal"]
