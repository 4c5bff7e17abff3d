"""The evidence of a set of effects with a departure from it, where it fits best.

A set that needs a tenth of the departure wins over one that needs all; sets that differ by less than the departure
cannot be told apart, however small the noise. Where a law is exact, the departure shrinks to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from ..._common.checks import FloatArray, IntArray
from ..fitting.layout import Layout
from ..fitting.normal_equations import NUISANCES, State
from .departing_point import Point, log_evidence_of
from .departure import NOISES, OWN_SHARE, PRIOR_OF_SIZES, SCALES, SIZES, Choice, Departures, inverted
from .set_fits import prior_widths

_OWN = 3  # a specimen's own stiffness, damping and zero, before its deviations
_OWN_WIDTHS = (1.0, 1.0, 0.05)  # of these: relative, relative, of the amplitude
_ITERATIONS = 6
_ENOUGH = 0.3  # gain of the logarithm of the evidence below which an iteration was the last
_CUTS = (1.0, 0.3, 0.08)
_FIRST = (5, 2)  # size and noise that the first look begins with
_MOST_SCATTER = 6.0  # standard deviations that a specimen may differ


@dataclass(frozen=True, eq=False)
class Departing:
    """What the backbones say of one set with a departure.

    Attributes
    ----------
    log_evidence : float
        Natural logarithm; sizes, smoothness and factors of the noise summed over.
    curves, errors : (3, l) arrays
        Mean and standard deviation of the common departure of each observable at the levels [Hz, 1, 1].
    state : State
        Where the set was linearised.
    covariance : (q, q) array
        Of the shared coordinates there, the departure unknown.
    choice : Choice
        The most probable.
    """

    log_evidence: float
    curves: FloatArray
    errors: FloatArray
    state: State
    covariance: FloatArray
    choice: Choice


class DepartingSets(Departures):
    """Sets of effects fitted to the backbones of some specimens with departures of every size beside them."""

    def glance(self, layout: Layout, states: Sequence[State], drifts: str = "") -> Point | None:
        """Return a set linearised at the best of some states; None where none can be simulated.

        ``drifts`` lets frequency and damping drift with time: ``"own"`` in each record, ``"common"`` alike in all.
        """
        start = Choice(len(SCALES) - 1, (_FIRST[0],) * 3, (_FIRST[1],) * 3)
        points = [self._point(layout, state, start, drifts) for state in states]
        return max((self._near(item, 2) for item in points if item is not None),
                   key=lambda item: item.log_evidence, default=None)  # fmt: skip

    def approached(self, point: Point, iterations: int) -> Point:
        """Return a set after some steps to where it fits best, the departure in its covariance."""
        for _ in range(iterations):
            better = self._improved(point)
            if better is None:
                break
            gain, point = better.log_evidence - point.log_evidence, better
            if gain < _ENOUGH:
                break
        return point

    def evidence(
        self, layout: Layout, states: Sequence[State], iterations: int = _ITERATIONS, drifts: str = ""
    ) -> Departing | None:
        """Return the evidence of a set, fitted from the best of some states; None where none can be simulated."""
        point = self.glance(layout, states, drifts)
        return None if point is None else self.refined(point, iterations)

    def refined(self, point: Point, iterations: int = _ITERATIONS) -> Departing:
        """Return the evidence of a set where it fits best with the departure in its covariance."""
        point = self.approached(point, iterations)
        logs, choices = [], []
        for k in range(len(SCALES)):
            choice, total = self._scan(point, k)
            logs.append(total)
            choices.append(choice)
        best = choices[int(np.argmax(logs))]
        curves, errors, covariance = self._curves(point, best)
        total = float(logsumexp(logs)) - float(np.log(len(SCALES)))
        return Departing(total, curves, errors, point.state, covariance, best)

    def evidence_apart(self, found: Departing, layout: Layout) -> float:
        """Return by how much the logarithm of the evidence grows where each specimen departs in its own way only.

        Sizes, smoothness and noise are those of the set; the departure that was common becomes one of each.
        """
        point = self._point(layout, found.state, found.choice, "")
        if point is None:
            return -np.inf
        logs = []
        for common, own in ((1.0, OWN_SHARE), (0.0, 1.0)):
            inverse, determinant = [], 0.0
            for o in range(3):
                rows = self.rows[o]
                size, noise = SIZES[found.choice.sizes[o]], NOISES[found.choice.noises[o]]
                departing = size**2 * self.departing(o, SCALES[found.choice.scale], common, own)
                whole = departing + noise**2 * self.covariance[np.ix_(rows, rows)]
                pair = inverted(whole[None, None])
                inverse.append(pair[0][0, 0])
                determinant += float(pair[1][0, 0])
            products = sum(self._products(point, o, inverse[o][None])[0] for o in range(3))
            logs.append(float(log_evidence_of(point, np.asarray(products)[None])[0]) - 0.5 * determinant)
        return logs[1] - logs[0]

    def _point(self, layout: Layout, state: State, choice: Choice, drifts: str) -> Point | None:
        """Return residuals and derivatives of a set at a state; None where a level cannot be simulated."""
        q, specimens = layout.free.size, len(self.kept)
        scatter = layout.scatter if specimens > 1 else 0.0
        common = 2 if drifts == "common" else 0
        own = _OWN + q + (2 if drifts else 0)
        residuals = np.zeros(self.owner.size)
        jacobian = np.zeros((self.owner.size, q + common + specimens * own))
        for r, (observable, level) in enumerate(self.kept):
            delta = state.own[r, NUISANCES:]
            effects, slopes = layout.physical(state.eta, delta, scatter)
            vector = layout.template.copy()
            vector[:2], vector[layout.free] = state.own[r, :2], effects
            reached = np.unique(level)
            values, status = np.empty((3, reached.size)), np.zeros(reached.size, dtype=np.int64)
            derivatives = np.zeros((3, reached.size, vector.size))
            levels = np.ascontiguousarray(self.levels[reached])
            release = self.batch.levels[r].release
            layout.simulator.backbone(vector, levels, release, True, values, derivatives, status, whole=False)
            pick = (observable, np.searchsorted(reached, level))
            if status.any() or not np.isfinite(derivatives).all():
                return None
            at = np.flatnonzero(self.owner == r)
            residuals[at] = self.values[at] - values[pick]
            by_effects = derivatives[pick][:, layout.free] @ slopes
            first = q + common + r * own
            jacobian[at, :q] = by_effects * (1.0 + scatter * delta)
            jacobian[at, first : first + 2] = derivatives[pick][:, :2]
            jacobian[at, first + 2] = np.where(observable == 2, 1.0 / self.levels[level], 0.0)
            jacobian[at, first + _OWN : first + _OWN + q] = by_effects * (state.eta * scatter)
            for o in range(2 if drifts else 0):
                drift = np.where(observable == o, self.units[o, level] * self.changes[o] * self.elapsed[at], 0.0)
                jacobian[at, first + _OWN + q + o] = drift
                if common:
                    jacobian[at, q + o] = drift
        rough = self.batch.own[:, :2]
        widths = [_widths(layout, state.eta), np.full(common, 2.0)]
        pull = [np.zeros(q + common)]
        for r in range(specimens):
            base = (_OWN_WIDTHS[0] * rough[r, 0], _OWN_WIDTHS[1] * rough[r, 1], _OWN_WIDTHS[2] * self.batch.amplitude)
            drifting = np.full(2 if drifts else 0, 2.0 * (OWN_SHARE if common else 1.0))
            widths += [np.array(base), np.full(q, 1.0 if scatter else 0.0), drifting]
            pull += [np.zeros(_OWN), state.own[r, NUISANCES:], np.zeros(drifting.size)]
        columns = q + common + np.arange(specimens * own).reshape(specimens, own)
        point = Point(
            layout, state, drifts, residuals, jacobian, columns, np.concatenate(widths), np.concatenate(pull), choice
        )
        return self._judged(point, choice)

    def _judged(self, point: Point, choice: Choice) -> Point:
        """Return a point with the logarithm of its evidence at a choice."""
        products = self._chosen(point, choice)
        total = float(log_evidence_of(point, products[None])[0]) + self._constants(choice)
        return replace(point, choice=choice, log_evidence=total)

    def _constants(self, choice: Choice) -> float:
        """Return what a choice adds to the logarithm whatever the set: its prior and the determinant."""
        total = 0.0
        for o in range(3):
            i, n = choice.sizes[o], choice.noises[o]
            total += float(np.log(PRIOR_OF_SIZES[i] * self.prior_of_noises[o, n]))
            total -= 0.5 * float(self.log_determinant[choice.scale][o][i, n])
        return total

    def _products(self, point: Point, o: int, inverse: FloatArray) -> FloatArray:
        """Return products (g, m + 1, m + 1) of derivatives and residuals of one observable for some inverses."""
        rows = self.rows[o]
        whole = np.concatenate([point.in_widths[rows], point.residuals[rows, None]], axis=1)
        products: FloatArray = whole.T @ (inverse @ whole)
        return products

    def _chosen(self, point: Point, choice: Choice, skip: int = -1) -> FloatArray:
        """Return the products of all observables at a choice, without one of them."""
        m = point.widths.size + 1
        total = np.zeros((m, m))
        for o in range(3):
            if o != skip:
                inverse = self.inverse[choice.scale][o][choice.sizes[o], choice.noises[o]]
                total += self._products(point, o, inverse[None])[0]
        return total

    def _along(self, point: Point, choice: Choice, o: int, sizes: IntArray, noises: IntArray) -> FloatArray:
        """Return the logarithm of the evidence (i, n) over sizes and noises of one observable, the others held."""
        rest = self._chosen(point, choice, skip=o)
        k = choice.scale
        inverse = self.inverse[k][o][np.ix_(sizes, noises)]
        count = self.rows[o].size
        products = rest + self._products(point, o, inverse.reshape(-1, count, count))
        logs = log_evidence_of(point, products).reshape(sizes.size, noises.size)
        logs = logs - 0.5 * self.log_determinant[k][o][np.ix_(sizes, noises)]
        prior: FloatArray = np.log(PRIOR_OF_SIZES[sizes])[:, None] + np.log(self.prior_of_noises[o, noises])
        return logs + prior

    def _near(self, point: Point, reach: int) -> Point:
        """Return a point at the best choice near its own, observable by observable."""
        choice = point.choice
        for o in range(3):
            if not self.rows[o].size:
                continue
            sizes = _around(choice.sizes[o], reach, SIZES.size)
            noises = _around(choice.noises[o], 1, NOISES.size)
            logs = self._along(point, choice, o, sizes, noises)
            i, n = np.unravel_index(int(np.argmax(logs)), logs.shape)
            choice = _with(choice, o, int(sizes[i]), int(noises[n]))
        return self._judged(point, choice)

    def _scan(self, point: Point, scale: int) -> tuple[Choice, float]:
        """Return the best choice of one smoothness, and the logarithm of the evidence summed over choices.

        Sizes and noise of the observables are summed over as if they were independent.
        """
        choice = Choice(scale, point.choice.sizes, point.choice.noises)
        more = 0.0
        for o in range(3):
            if not self.rows[o].size:
                continue
            logs = self._along(point, choice, o, np.arange(SIZES.size), np.arange(NOISES.size))
            i, n = np.unravel_index(int(np.argmax(logs)), logs.shape)
            choice = _with(choice, o, int(i), int(n))
            more += float(logsumexp(logs) - logs.max())
        return choice, self._judged(point, choice).log_evidence + more

    def _improved(self, point: Point) -> Point | None:
        """Return the set where a step to the minimum leads, the departure in its covariance; None without one."""
        step = self._step(point)
        if step is None:
            return None
        layout, q = point.layout, point.layout.free.size
        for length in _CUTS:
            eta = layout.within(point.state.eta + length * step[0])
            own = point.state.own.copy()
            own[:, :2] += length * step[1][:, :2]
            own[:, 1] = np.maximum(own[:, 1], 0.0)
            low, high = self._room(layout, eta)
            own[:, NUISANCES:] = np.clip(own[:, NUISANCES:] + length * step[1][:, 2 : 2 + q], low, high)
            if not (np.isfinite(own).all() and np.isfinite(eta).all() and (own[:, 0] > 0.0).all()):
                continue
            trial = self._point(layout, State(eta, own), point.choice, point.drifts)
            if trial is not None and trial.log_evidence > point.log_evidence:
                return self._near(trial, 1)
        return None

    def _room(self, layout: Layout, eta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the deviations (q,) that no specimen goes beyond: the most, or where a coordinate has its limit."""
        if len(self.kept) < 2:
            return np.zeros(eta.size), np.zeros(eta.size)
        return layout.room(eta, layout.scatter, _MOST_SCATTER)

    def _step(self, point: Point) -> tuple[FloatArray, FloatArray] | None:
        """Return the step of the shared coordinates, and that of stiffness, damping and deviations of each specimen."""
        q, m = point.layout.free.size, point.widths.size
        information, right = point.normal(self._chosen(point, point.choice))
        low = (point.state.eta <= point.layout.low) & (right[:q] <= 0.0)
        high = (point.state.eta >= point.layout.high) & (right[:q] >= 0.0)
        moved = np.concatenate([~(low | high), np.ones(m - q, dtype=bool)])
        edges = self._room(point.layout, point.state.eta)
        for r, columns in enumerate(point.own[:, _OWN : _OWN + q]):
            delta, wanted = point.state.own[r, NUISANCES:], right[columns]
            moved[columns] = ~(((delta <= edges[0]) & (wanted < 0.0)) | ((delta >= edges[1]) & (wanted > 0.0)))
        try:
            solved = np.linalg.solve(information[np.ix_(moved, moved)], right[moved])
        except np.linalg.LinAlgError:
            return None
        whole = np.zeros(m)
        whole[moved] = solved
        whole *= point.widths
        each = whole[point.own]
        return whole[:q], np.concatenate([each[:, :2], each[:, _OWN : _OWN + q]], axis=1)

    def _curves(self, point: Point, choice: Choice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean and standard deviation of the common departure, and the covariance of the shared coordinates."""
        q = point.layout.free.size
        curves, errors = np.zeros((2, 3, self.levels.size))
        information, right = point.normal(self._chosen(point, choice))
        inverse = np.linalg.inv(information)
        # residuals once every unknown is where it is most probable
        rest = point.residuals - point.in_widths @ (inverse @ right)
        everywhere = np.arange(self.levels.size)
        for o in range(3):
            rows, size = self.rows[o], SIZES[choice.sizes[o]]
            if not rows.size or size == 0.0:
                continue
            unit = size * self.changes[o] * self.units[o]
            scale = SCALES[choice.scale]
            across = self.kernel(scale, everywhere, self.level[rows]) * np.outer(unit, unit[self.level[rows]])
            block = self.inverse[choice.scale][o][choice.sizes[o], choice.noises[o]]
            curves[o] = across @ (block @ rest[rows])
            prior = self.kernel(scale, everywhere, everywhere) * np.outer(unit, unit)
            along = across @ block @ point.in_widths[rows]
            spread = prior - across @ block @ across.T + along @ inverse @ along.T
            errors[o] = np.sqrt(np.maximum(np.diag(spread), 0.0))
        covariance = inverse[:q, :q] * np.outer(point.widths[:q], point.widths[:q])
        return curves, errors, covariance


def _widths(layout: Layout, eta: FloatArray) -> FloatArray:
    """Return prior widths (q,) of shared coordinates: the size of a strength is known, as that of a departure is."""
    strength = np.maximum(np.abs(eta), 1e-4 * layout.width)
    return np.where(layout.is_strength, strength, prior_widths(layout, eta))


def _around(index: int, reach: int, count: int) -> IntArray:
    return np.arange(max(index - reach, 0), min(index + reach + 1, count))


def _with(choice: Choice, o: int, size: int, noise: int) -> Choice:
    sizes, noises = list(choice.sizes), list(choice.noises)
    sizes[o], noises[o] = size, noise
    return Choice(choice.scale, (sizes[0], sizes[1], sizes[2]), (noises[0], noises[1], noises[2]))


__all__ = ["Departing", "DepartingSets"]
