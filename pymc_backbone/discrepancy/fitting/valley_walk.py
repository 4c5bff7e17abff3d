"""The valley of a fit, walked along: one step after the other, everything else fitted again at each point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from .chart import Chart
from .data_term import DataTerm
from .joint_fit import Fit
from .layout import MOST_OPPOSED
from .limits import leans, within
from .normal_equations import DRIFTS, NUISANCES, State, System, eliminate, linearise, prior_width, symmetric

RISE = 3.841459
"""Rise of the sum of squares up to which a value belongs to a 95 % interval (chi-square of one degree of freedom)."""
LOOSE = 0.1
"""Relative standard deviation of a direction from which it is followed: below, a valley is as good as straight."""
SETTLED = 0.05
"""Fall of the sum of squares below which a point of the way has come to rest."""
_FIRST_STEP, _LONGEST_STEP = 0.1, 0.7  # relative
_GROWTH, _CUT, _SHORTEST = 1.6, 0.4, 0.02
_CORRECTIONS = 5
_MOST = {False: 200, True: 60}  # evaluations on the way; where the model has states with an equation of their own
_DEGREE = 3  # of the polynomial that goes on from the last points
_OVERSHOOT, _FINE = 10.0, 0.15  # rise beyond the end of the interval, or else length, of a step that was not too long
_MOSTLY, _MIXED = 0.5, 0.05  # share of relative ones in a direction that is a valley, of one that takes part
_GONE = 1e-3  # share of what was found, at which an effect is gone


class Range(NamedTuple):
    """What the records allow a parameter, and whether they bound it at either end, or only its limits do."""

    low: float
    high: float
    is_low_open: bool
    is_high_open: bool


class Place(NamedTuple):
    """A point of the way: where, relative coordinates there, normal equations, sum of squares."""

    at: float
    chart: FloatArray
    state: State
    system: System
    cost: float


class Walk:
    """The valley of a fit along one direction, everything else fitted again at each point."""

    def __init__(self, found: Fit, terms: Sequence[DataTerm]) -> None:
        self.found, self.layout, self.terms, self.active = found, found.layout, terms, found.active
        self.scatter = found.layout.scatter if found.active[NUISANCES:].any() else 0.0
        self.chart = Chart.around(found.layout, found.state.eta)
        self.most = _MOST[found.layout.simulator.is_costly]
        self.left = 0
        self.widths = prior_width(
            found.layout, found.state.eta, np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
        )  # fmt: skip

    def directions(self) -> list[FloatArray]:
        """Return the directions (q,) that the records determine loosely, the least determined first."""
        eliminated = self._eliminated(self.found.system, self.found.state, 0.0)
        if eliminated is None:
            return []
        shared, gradient, _ = eliminated
        slopes = self.chart.slopes(self.found.state.eta)
        # what its limit holds up without being pushed against it may go back: a plateau slopes next to nothing
        is_hardly_pushed = np.abs(gradient @ slopes) < RISE / LOOSE
        free = np.flatnonzero(self._free(self.found.state.eta, gradient) | is_hardly_pushed)
        slopes = slopes[:, free]
        values, vectors = np.linalg.eigh(symmetric(slopes.T @ symmetric(shared) @ slopes))
        loose = []
        is_relative = self.chart.is_log | self.layout.is_strength
        for value, vector in zip(values, vectors.T, strict=True):
            along = np.zeros(self.layout.free.size)
            along[free] = vector
            # what is only in units of its prior has limits of its own, and is no valley
            is_sized = np.abs(along[is_relative]).max(initial=0.0) > _MOSTLY
            if value < LOOSE**-2.0 and is_sized and np.count_nonzero(np.abs(along) > _MIXED) > 1:
                loose.append(along)
        return loose

    def follow(self, along: FloatArray) -> tuple[list[list[Place]], list[bool]]:
        """Return the way to either side, and whether each side ends at a limit of the parameters or of the effort."""
        ways, opens = [], []
        for side in (1.0, -1.0):
            self.left = self.most // 2
            way, is_open = self._side(side * along)
            ways.append(way)
            opens.append(is_open)
        return ways, opens

    def _side(self, along: FloatArray) -> tuple[list[Place], bool]:
        chart = self.chart.to(self.found.state.eta)
        way = [Place(0.0, chart, self.found.state, self.found.system, self.found.cost)]
        step, growth, lowest = _FIRST_STEP, _GROWTH, self.found.cost
        while self.left > 0:
            at, is_limit = self._reachable(way, along, way[-1].at + step)
            if at - way[-1].at < 0.1 * _SHORTEST:
                return way, True
            reached = self._corrected(way, along, at)
            step = at - way[-1].at
            is_far = reached is not None and reached.cost > lowest + RISE + _OVERSHOOT
            if reached is None or (is_far and step > _FINE):
                step, growth = _CUT * step, 1.0
                if step < _SHORTEST:
                    return way, True
                continue
            way.append(reached)
            lowest = min(lowest, reached.cost)
            if reached.cost > lowest + RISE:
                return way, False
            if is_limit:
                return way, True
            step, growth = min(growth * step, _LONGEST_STEP), max(growth, np.sqrt(growth * _GROWTH))
        return way, True

    def _predicted(self, way: Sequence[Place], along: FloatArray, at: float) -> tuple[FloatArray, FloatArray]:
        """Return relative coordinates as the last points of the way go on, and the specimens' own values there.

        These follow the physical parameters in proportion: a joint's stiffness is made up for by that of the specimen,
        and no phase may be lost on the way.
        """
        last = way[-1]
        chart = way[0].chart + at * along
        if len(way) > 1:
            points = way[-_DEGREE - 1 :]
            ats = np.array([place.at for place in points])
            weights = [float(np.prod((at - np.delete(ats, k)) / (ats[k] - np.delete(ats, k)))) for k in range(ats.size)]
            chart = np.sum([weight * place.chart for weight, place in zip(weights, points, strict=True)], axis=0)
        own = last.state.own.copy()
        eliminated = self._eliminated(last.system, last.state, 0.0)
        if eliminated is None:
            return chart, own
        still = np.zeros(along.size)
        before, slopes = self.layout.physical(last.state.eta, still, 0.0)
        after, _ = self.layout.physical(self.layout.within(self.chart.back(chart)), still, 0.0)
        moved = np.linalg.lstsq(slopes, after - before, rcond=None)[0]
        for r, (index, scale, reduced, _) in enumerate(eliminated[2]):
            own[r, index] -= scale * (reduced[:, :-1] @ moved)
        return chart, own

    def _reachable(self, way: Sequence[Place], along: FloatArray, at: float) -> tuple[float, bool]:
        """Return how far the way may go at most, up to ``at``, and whether a limit is there."""
        last = way[-1]
        chart, own = self._predicted(way, along, at)
        low, high = self.layout.low, self.layout.high
        with np.errstate(divide="ignore", invalid="ignore"):
            low = np.where(self.chart.is_log, np.log(np.maximum(low, 0.0)), low / self.chart.unit)
            high = np.where(self.chart.is_log, np.log(high), high / self.chart.unit)
        for j, _ in self.layout.opposed:
            low[j], high[j] = -1.0, MOST_OPPOSED
        gone = np.where(self.chart.is_log & self.layout.is_strength, way[0].chart + np.log(_GONE), -np.inf)
        low = np.maximum(low, gone)
        moved = chart - last.chart
        room = np.where(moved > 0.0, high - last.chart, last.chart - low)
        is_moving = (np.abs(moved) > 1e-3) & np.isfinite(room)
        shares = room[is_moving] / np.abs(moved[is_moving])
        stiff = last.state.own[:, 0] > 0.0
        falls = 1.0 - own[stiff, 0] / last.state.own[stiff, 0]
        shares = np.append(shares, 0.98 / np.maximum(falls, 1e-9))
        share = float(np.min(shares, initial=np.inf))
        return (at, False) if share >= 1.0 else (last.at + max(share, 0.0) * (at - last.at), True)

    def _corrected(self, way: Sequence[Place], along: FloatArray, at: float) -> Place | None:
        """Return the lowest point at this place of the way; None where none is found."""
        chart, own = self._predicted(way, along, at)
        damping, best = 0.0, None
        for _ in range(_CORRECTIONS):
            state = within(self.layout, State(self.layout.within(self.chart.back(chart)), own), self.scatter)
            chart = self.chart.to(state.eta)
            self.left -= 1
            system = linearise(self.layout, self.terms, state, self.scatter, self.active)
            if system is None or (best is not None and system.cost > best.cost + SETTLED):
                if best is None:
                    return None
                damping = max(10.0 * damping, 1e-3)
            else:
                if best is not None and best.cost - system.cost < SETTLED:
                    return Place(at, chart, state, system, system.cost)
                best = Place(at, chart, state, system, system.cost)
            stepped = self._step(best, along, damping)
            if stepped is None:
                return None
            fall, chart, own = stepped
            if fall < SETTLED:
                return best
        return None

    def _step(self, place: Place, along: FloatArray, damping: float) -> tuple[float, FloatArray, FloatArray] | None:
        """Return the fall of the sum of squares that a step beside the way promises, and where it leads."""
        eliminated = self._eliminated(place.system, place.state, damping)
        if eliminated is None:
            return None
        shared, gradient, solved = eliminated
        beside = self._beside(along, place.state.eta, gradient)
        slopes = self.chart.slopes(place.state.eta)
        moved = np.zeros(along.size)
        if beside.size:
            inner = beside.T @ slopes.T @ symmetric(shared) @ slopes @ beside
            pull = beside.T @ slopes.T @ gradient
            inner += (damping + 1e-12) * np.diag(np.diag(inner))
            moved = beside @ np.linalg.lstsq(inner, pull, rcond=1e-12)[0]
        chart = place.chart + np.clip(moved, -_LONGEST_STEP, _LONGEST_STEP)
        shift = self.chart.back(chart) - place.state.eta
        fall, own = float(gradient @ slopes @ moved), place.state.own.copy()
        for r, (index, scale, reduced, _) in enumerate(solved):
            fall += float((place.system.own_gradient[r, index] * scale) @ reduced[:, -1])
            own[r, index] += scale * (reduced[:, -1] - reduced[:, :-1] @ shift)
        own[:, 1] = np.maximum(own[:, 1], 0.0)
        return fall, chart, own

    def _beside(self, along: FloatArray, eta: FloatArray, gradient: FloatArray) -> FloatArray:
        """Return a basis (q, n) of the directions at right angles to the way, limits minded."""
        free = np.flatnonzero(self._free(eta, gradient))
        basis = np.zeros((along.size, free.size))
        basis[free, np.arange(free.size)] = 1.0
        inside = along[free]
        length = float(np.linalg.norm(inside))
        if length < 1e-12:
            return basis
        # the last columns of the complete orthogonal matrix that begins with the way
        complete = np.linalg.qr((inside / length)[:, None], mode="complete")[0]
        return np.asarray(basis @ complete[:, 1:])

    def _free(self, eta: FloatArray, gradient: FloatArray) -> BoolArray:
        at_low = (eta <= self.layout.low) & (gradient < 0.0)
        at_high = (eta >= self.layout.high) & (gradient > 0.0)
        inside: BoolArray = ~(at_low | at_high)
        return inside

    def _eliminated(self, system: System, state: State, damping: float) -> Any:
        """Return what remains for the shared values, limits minded; None where it cannot be said."""
        held = np.zeros(state.own.shape, dtype=bool)
        held[:, 1] = (state.own[:, 1] <= 0.0) & (system.own_gradient[:, 1] < 0.0)
        leaning = leans(self.layout, state, system.own_gradient, self.scatter)
        held[:, DRIFTS[0] :] = leaning[:, DRIFTS[0] :]
        return eliminate(system, self.active, damping, held)

    def values(self, place: Place) -> FloatArray:
        """Return the parameters (2 + q,) over the batch: the mean stiffness and damping, and those of the effects."""
        return np.concatenate([place.state.own[:, :2].mean(axis=0), self._physical(place.state)[0]])

    def _physical(self, state: State) -> tuple[FloatArray, FloatArray]:
        centre = state.eta
        if self.scatter > 0.0:
            each = state.eta * (1.0 + self.scatter * state.own[:, NUISANCES:])
            centre = np.clip(each, self.layout.low, self.layout.high).mean(axis=0)
        return self.layout.physical(centre, np.zeros(centre.size), 0.0)

    def spread(self, place: Place, along: FloatArray) -> FloatArray:
        """Return the standard deviations (q,) of the effects' parameters that a point of the way leaves open."""
        eliminated = self._eliminated(place.system, place.state, 0.0)
        slopes = self.chart.slopes(place.state.eta)
        if eliminated is None:
            return np.zeros(along.size)
        shared, gradient, _ = eliminated
        beside = slopes @ self._beside(along, place.state.eta, gradient)
        inner = beside.T @ (symmetric(shared) + np.diag(self.widths**-2.0)) @ beside
        physical = self._physical(place.state)[1] @ beside
        variance = np.einsum("ij,ji->i", physical, np.linalg.lstsq(inner, physical.T, rcond=None)[0])
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def around(self) -> list[Range]:
        """Return the 95 % intervals (2 + q) that the curvature of the fit says."""
        found = self.found
        place = Place(0.0, self.chart.to(found.state.eta), found.state, found.system, found.cost)
        errors = np.concatenate([own_errors(found), self.spread(place, np.zeros(self.layout.free.size))])
        together = zip(self.values(place), errors * np.sqrt(RISE), strict=True)
        return [Range(float(value - reach), float(value + reach), False, False) for value, reach in together]

    def log_evidence(self) -> float:
        """Return the logarithm of what is likely around the fit, but for a constant: its height times its widths."""
        eliminated = self._eliminated(self.found.system, self.found.state, 0.0)
        if eliminated is None:
            return -np.inf
        slopes = self.chart.slopes(self.found.state.eta)
        precision = slopes.T @ (symmetric(eliminated[0]) + np.diag(self.widths**-2.0)) @ slopes
        return float(-0.5 * (self.found.cost + np.linalg.slogdet(precision)[1]))


def own_errors(found: Fit) -> FloatArray:
    """Return the standard errors (2,) of the mean stiffness and damping, the effects held."""
    own = found.state.own[:, :2]
    spread = own.std(axis=0, ddof=1) if own.shape[0] > 1 else np.zeros(2)
    each = np.nan_to_num(found.own_covariance[:, :2]).mean(axis=0)
    return np.asarray(np.sqrt((spread**2 + each) / own.shape[0]))


__all__ = ["LOOSE", "RISE", "SETTLED", "Place", "Range", "Walk", "own_errors"]
