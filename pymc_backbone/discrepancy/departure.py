"""The evidence of a set of effects with a departure from it: smooth over amplitude, of unknown size, alike in all.

No library describes a structure exactly. Each observable of the backbone therefore departs from what a set gives by a
Gaussian process over the logarithm of the amplitude, whose size, smoothness and noise are summed over. A set that needs
a tenth of the departure wins over one that needs all; sets that differ by less than the departure cannot be told apart,
however small the noise. Where a law is exact, the departure shrinks to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from .._common.checks import OBSERVABLES, FloatArray, IntArray
from .batch import Batch
from .joint_fit import NUISANCES, State
from .layout import Layout
from .looks import level_data
from .scatter import SCATTER
from .set_fits import prior_widths

SIZES = np.array([0.0, 0.003, 0.007, 0.016, 0.037, 0.085, 0.2, 0.45, 1.0])
"""Standard deviations of a departure, in units of the force whose change with amplitude is measured."""
PRIOR_OF_SIZES = np.array([0.25, 0.12, 0.12, 0.12, 0.12, 0.12, 0.12, 0.025, 0.005])
"""Prior probability of each: none at all, any order of magnitude alike up to a fifth, and seldom more.

A departure that rivals all that is measured is as improbable as that the library holds nothing of what is missing.
"""
NOISES = np.array([0.15, 0.4, 1.0, 2.0, 4.0, 10.0, 30.0])
"""Factors of the standard errors: what scatters between levels is no law; smooth curves scatter less than is said."""
PRIOR_OF_NOISES = np.array([0.15, 0.25, 0.30, 0.15, 0.08, 0.05, 0.02])
"""Prior probability of each; that errors are smaller than is said, only specimens can show that scatter less."""
SCALES = (0.15, 0.5)
"""Decades of amplitude over which a departure is smooth."""
OWN_SHARE = 0.2
"""Departure of each specimen of its own, as a share of the common one."""
MOST_LEVELS = 24
_OWN = 3  # a specimen's own stiffness, damping and zero, before its deviations
_OWN_WIDTHS = (1.0, 1.0, 0.05)  # of these: relative, relative, of the amplitude
_LEAST_CHANGE = 1e-7
_LEAST_DAMPING = 0.2  # of the mean damping: where less is there, departures are no share of it
_ITERATIONS = 6
_ENOUGH = 0.3  # gain of the logarithm of the evidence below which an iteration was the last
_CUTS = (1.0, 0.3, 0.08)
_FIRST = (5, 2)  # size and noise that the first look begins with
_NUGGET = 1e-9
_ROUNDING = 1e-9  # of information scaled to a unit diagonal


@dataclass(frozen=True)
class Choice:
    """One size and one factor of the noise for each observable, and one smoothness."""

    scale: int
    sizes: tuple[int, int, int]
    noises: tuple[int, int, int]


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


@dataclass(frozen=True, eq=False)
class Point:
    """A set where it was linearised, and how likely it is there.

    Attributes
    ----------
    layout, state : Layout, State
        The set, and where.
    drifts : str
        Whether frequency and damping may drift with time: ``""``, ``"own"`` or ``"common"``.
    residuals : (n,) array
        Measured minus simulated values.
    jacobian : (n, m) array
        Derivatives of the simulated values: shared coordinates, common drifts, each specimen's own unknowns.
    own : (r, o) array of int
        Which columns are a specimen's own: stiffness, damping, zero, deviations, drifts.
    widths, pull : (m,) arrays
        Standard deviations of the priors; where the state stands in these priors.
    choice : Choice
        Sizes, noises and smoothness at which it was judged.
    log_evidence : float
        At that choice, its prior included.
    """

    layout: Layout
    state: State
    drifts: str
    residuals: FloatArray
    jacobian: FloatArray
    own: IntArray
    widths: FloatArray
    pull: FloatArray
    choice: Choice
    log_evidence: float = -np.inf


class Departures:
    """Departures of the backbones of some specimens, of every size.

    Parameters
    ----------
    batch : Batch
        At most as many specimens as are needed.
    mass : float
        Mass [kg].
    """

    def __init__(self, batch: Batch, mass: float) -> None:
        self.batch = batch
        data = level_data(batch.levels, mass)
        thinned = np.unique(
            np.linspace(0, data.levels.size - 1, min(data.levels.size, MOST_LEVELS)).round().astype(int)
        )
        self.levels = data.levels[thinned]
        self.nodes = np.log(self.levels)
        self.scatter = SCATTER if len(batch.levels) > 1 else 0.0
        kept: list[tuple[IntArray, IntArray]] = []  # of each specimen: places in its values, levels
        owner, observable, level, values, blocks = [], [], [], [], []
        for r, count in enumerate(data.count):
            rows = data.rows[r, :count]
            held = np.flatnonzero(np.isin(rows[:, 1], thinned))
            kept.append((rows[held, 0], np.searchsorted(thinned, rows[held, 1])))
            owner.append(np.full(held.size, r))
            observable.append(kept[-1][0])
            level.append(kept[-1][1])
            values.append(data.values[r, held])
            blocks.append(data.covariance[r][np.ix_(held, held)])
        self.kept = kept
        self.owner, self.observable = np.concatenate(owner), np.concatenate(observable)
        self.level, self.values = np.concatenate(level), np.concatenate(values)
        covariance = np.zeros((self.owner.size, self.owner.size))
        for r, block in enumerate(blocks):
            at = np.flatnonzero(self.owner == r)
            covariance[np.ix_(at, at)] = block
        self.rows = [np.flatnonzero(self.observable == o) for o in range(3)]
        frequency, damping = data.omegas[thinned] / (2.0 * np.pi), data.decrements[thinned]
        typical = np.maximum(damping, _LEAST_DAMPING * damping.mean())
        self.units = np.array([frequency, typical, np.ones(frequency.size)])
        self.changes = _changes(self.values, self.owner, self.rows, self.units)
        self.inverse: list[list[FloatArray]] = []
        self.log_determinant: list[list[FloatArray]] = []
        for scale in SCALES:
            pairs = [self._inverses(o, scale, covariance) for o in range(3)]
            self.inverse.append([item[0] for item in pairs])
            self.log_determinant.append([item[1] for item in pairs])
        self.covariance = covariance
        possible = np.where((NOISES < 1.0) & (len(batch.levels) < 2), 1e-12, PRIOR_OF_NOISES)
        self.prior_of_noises: FloatArray = possible / possible.sum()
        variance = np.diag(covariance)
        self.noise = np.array([np.sqrt(np.median(variance[rows])) if rows.size else np.inf for rows in self.rows])
        self.per_force = np.array([0.5 * float(self.units[0].mean()), np.pi, 1.0])
        self.elapsed = self._elapsed()

    def _kernel(self, scale: float, here: IntArray, there: IntArray) -> FloatArray:
        """Return the Matern correlation (5/2) of two lists of levels."""
        steps = np.abs(np.log10(self.levels[here])[:, None] - np.log10(self.levels[there]))
        distance = np.sqrt(5.0) * steps / scale
        kernel: FloatArray = (1.0 + distance + distance**2 / 3.0) * np.exp(-distance)
        return kernel

    def _departing(self, o: int, scale: float, common: float = 1.0, own: float = OWN_SHARE) -> FloatArray:
        """Return the covariance of the values of one observable by a departure of unit size."""
        rows = self.rows[o]
        unit = self.changes[o] * self.units[o, self.level[rows]]
        is_same = self.owner[rows][:, None] == self.owner[rows]
        share = common + own**2 * is_same if len(self.kept) > 1 else 1.0
        return self._kernel(scale, self.level[rows], self.level[rows]) * np.outer(unit, unit) * share

    def _inverses(self, o: int, scale: float, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inverses (sizes, noises, n, n) of the covariance of one observable, and log determinants."""
        rows = self.rows[o]
        noise = covariance[np.ix_(rows, rows)]
        departing = self._departing(o, scale)
        whole = SIZES[:, None, None, None] ** 2 * departing + NOISES[:, None, None] ** 2 * noise
        return _inverted(whole)

    def _elapsed(self) -> FloatArray:
        """Return the share of its record after which each value was passed (n,); zeros without cycles."""
        elapsed = np.zeros(self.owner.size)
        for r, cycles in enumerate(self.batch.cycles):
            order = np.argsort(cycles.smoothed_amplitude)
            share = (cycles.time - cycles.time[0]) / max(float(np.ptp(cycles.time)), 1e-300)
            at = self.owner == r
            elapsed[at] = np.interp(self.levels[self.level[at]], cycles.smoothed_amplitude[order], share[order])
        return elapsed

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
                departing = size**2 * self._departing(o, SCALES[found.choice.scale], common, own)
                whole = departing + noise**2 * self.covariance[np.ix_(rows, rows)]
                pair = _inverted(whole[None, None])
                inverse.append(pair[0][0, 0])
                determinant += float(pair[1][0, 0])
            products = sum(self._products(point, o, inverse[o][None])[0] for o in range(3))
            logs.append(float(_log_evidence(point, np.asarray(products)[None])[0]) - 0.5 * determinant)
        return logs[1] - logs[0]

    def _point(self, layout: Layout, state: State, choice: Choice, drifts: str) -> Point | None:
        """Return residuals and derivatives of a set at a state; None where a level cannot be simulated."""
        q, specimens = layout.free.size, len(self.kept)
        common = 2 if drifts == "common" else 0
        own = _OWN + q + (2 if drifts else 0)
        residuals = np.zeros(self.owner.size)
        jacobian = np.zeros((self.owner.size, q + common + specimens * own))
        for r, (observable, level) in enumerate(self.kept):
            delta = state.own[r, NUISANCES:]
            effects, slopes = layout.physical(state.eta, delta, self.scatter)
            vector = layout.template.copy()
            vector[:2], vector[layout.free] = state.own[r, :2], effects
            reached = np.unique(level)
            values, status = np.empty((3, reached.size)), np.zeros(reached.size, dtype=np.int64)
            derivatives = np.zeros((3, reached.size, vector.size))
            levels = np.ascontiguousarray(self.levels[reached])
            layout.simulator.backbone(vector, levels, 0.0, True, values, derivatives, status)
            pick = (observable, np.searchsorted(reached, level))
            if status.any() or not np.isfinite(derivatives).all():
                return None
            at = np.flatnonzero(self.owner == r)
            residuals[at] = self.values[at] - values[pick]
            by_effects = derivatives[pick][:, layout.free] @ slopes
            first = q + common + r * own
            jacobian[at, :q] = by_effects * (1.0 + self.scatter * delta)
            jacobian[at, first : first + 2] = derivatives[pick][:, :2]
            jacobian[at, first + 2] = np.where(observable == 2, 1.0 / self.levels[level], 0.0)
            jacobian[at, first + _OWN : first + _OWN + q] = by_effects * (state.eta * self.scatter)
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
            widths += [np.array(base), np.full(q, 1.0 if self.scatter else 0.0), drifting]
            pull += [np.zeros(_OWN), state.own[r, NUISANCES:], np.zeros(drifting.size)]
        columns = q + common + np.arange(specimens * own).reshape(specimens, own)
        point = Point(
            layout, state, drifts, residuals, jacobian, columns, np.concatenate(widths), np.concatenate(pull), choice
        )
        return self._judged(point, choice)

    def _judged(self, point: Point, choice: Choice) -> Point:
        """Return a point with the logarithm of its evidence at a choice."""
        products = self._chosen(point, choice)
        total = float(_log_evidence(point, products[None])[0]) + self._constants(choice)
        return replace(point, choice=choice, log_evidence=total)

    def _constants(self, choice: Choice) -> float:
        """Return what a choice adds to the logarithm whatever the set: its prior and the determinant."""
        total = 0.0
        for o in range(3):
            i, n = choice.sizes[o], choice.noises[o]
            total += float(np.log(PRIOR_OF_SIZES[i] * self.prior_of_noises[n]))
            total -= 0.5 * float(self.log_determinant[choice.scale][o][i, n])
        return total

    def _products(self, point: Point, o: int, inverse: FloatArray) -> FloatArray:
        """Return products (g, m + 1, m + 1) of derivatives and residuals of one observable for some inverses."""
        rows = self.rows[o]
        whole = np.concatenate([point.jacobian[rows] * point.widths, point.residuals[rows, None]], axis=1)
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
        logs = _log_evidence(point, products).reshape(sizes.size, noises.size)
        logs = logs - 0.5 * self.log_determinant[k][o][np.ix_(sizes, noises)]
        return logs + np.log(PRIOR_OF_SIZES[sizes])[:, None] + np.log(self.prior_of_noises[noises])

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
            eta = np.clip(point.state.eta + length * step[0], layout.low, layout.high)
            own = point.state.own.copy()
            own[:, :2] += length * step[1][:, :2]
            own[:, 1] = np.maximum(own[:, 1], 0.0)
            own[:, NUISANCES:] = np.clip(own[:, NUISANCES:] + length * step[1][:, 2 : 2 + q], -6.0, 6.0)
            if not (np.isfinite(own).all() and np.isfinite(eta).all() and (own[:, 0] > 0.0).all()):
                continue
            trial = self._point(layout, State(eta, own), point.choice, point.drifts)
            if trial is not None and trial.log_evidence > point.log_evidence:
                return self._near(trial, 1)
        return None

    def _step(self, point: Point) -> tuple[FloatArray, FloatArray] | None:
        """Return the step of the shared coordinates, and that of stiffness, damping and deviations of each specimen."""
        products = self._chosen(point, point.choice)
        q, m = point.layout.free.size, point.widths.size
        right = products[:m, m] - point.pull
        low = (point.state.eta <= point.layout.low) & (right[:q] <= 0.0)
        high = (point.state.eta >= point.layout.high) & (right[:q] >= 0.0)
        moved = np.concatenate([~(low | high), np.ones(m - q, dtype=bool)])
        try:
            information = products[:m, :m] + np.eye(m)
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
        q, m = point.layout.free.size, point.widths.size
        curves, errors = np.zeros((2, 3, self.levels.size))
        products = self._chosen(point, choice)
        information = products[:m, :m] + np.eye(m)
        right = products[:m, m] - point.pull
        inverse = np.linalg.inv(information)
        # residuals once every unknown is where it is most probable
        rest = point.residuals - (point.jacobian * point.widths) @ (inverse @ right)
        everywhere = np.arange(self.levels.size)
        for o in range(3):
            rows, size = self.rows[o], SIZES[choice.sizes[o]]
            if not rows.size or size == 0.0:
                continue
            unit = size * self.changes[o] * self.units[o]
            scale = SCALES[choice.scale]
            across = self._kernel(scale, everywhere, self.level[rows]) * np.outer(unit, unit[self.level[rows]])
            block = self.inverse[choice.scale][o][choice.sizes[o], choice.noises[o]]
            curves[o] = across @ (block @ rest[rows])
            prior = self._kernel(scale, everywhere, everywhere) * np.outer(unit, unit)
            along = across @ block @ (point.jacobian[rows] * point.widths)
            spread = prior - across @ block @ across.T + along @ inverse @ along.T
            errors[o] = np.sqrt(np.maximum(np.diag(spread), 0.0))
        covariance = inverse[:q, :q] * np.outer(point.widths[:q], point.widths[:q])
        return curves, errors, covariance


def _changes(values: FloatArray, owner: IntArray, rows: list[IntArray], units: FloatArray) -> FloatArray:
    """Return the departure (3,) of each observable, in its unit, that rivals what the backbones show.

    One force stands for all: the change with amplitude of the force in phase and in quadrature, as a share of the
    elastic one. What is small beside it in one observable may be a departure however much of that curve it is.
    """
    frequency, damping = units[0], units[1]
    stiff = [np.log(values[rows[0]][owner[rows[0]] == r]).std() for r in np.unique(owner[rows[0]])]
    whole = 2.0 * max(float(np.log(frequency).std()), float(np.mean(stiff)) if stiff else 0.0)
    force = max(float(np.hypot(whole, damping.std() / np.pi)), _LEAST_CHANGE)
    offset = float(np.sqrt((values[rows[2]] ** 2).mean())) if rows[2].size else 0.0
    return np.array([0.5 * force, np.pi * force / damping.mean(), max(force, offset)])


def _widths(layout: Layout, eta: FloatArray) -> FloatArray:
    """Return prior widths (q,) of shared coordinates: the size of a strength is known, as that of a departure is."""
    strength = np.maximum(np.abs(eta), 1e-4 * layout.width)
    return np.where(layout.is_strength, strength, prior_widths(layout, eta))


def _inverted(whole: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inverses and log determinants of covariances (..., n, n)."""
    n = whole.shape[-1]
    if n == 0:
        return whole, np.zeros(whole.shape[:-2])
    scale = np.sqrt(np.einsum("...ii->...i", whole))
    scaled = whole / (scale[..., :, None] * scale[..., None, :]) + _NUGGET * np.eye(n)
    factor = np.linalg.cholesky(scaled)
    half = np.linalg.inv(factor) / scale[..., None, :]
    determinant = 2.0 * (np.log(np.einsum("...ii->...i", factor)).sum(axis=-1) + np.log(scale).sum(axis=-1))
    return np.swapaxes(half, -1, -2) @ half, determinant


def _log_evidence(point: Point, products: FloatArray) -> FloatArray:
    """Return the logarithm of the evidence (g,) without determinants of the noise, from products in prior widths.

    A specimen's own unknowns are taken where they are most probable; the shared ones stay where they are.
    """
    q, m = point.layout.free.size, point.widths.size
    information = products[:, :m, :m] + np.eye(m)
    own = information[:, q:, q:]
    right = products[:, q:m, m] - point.pull[q:]
    scale = np.sqrt(np.einsum("gii->gi", own))
    scaled = own / (scale[:, :, None] * scale[:, None, :]) + _ROUNDING * np.eye(m - q)
    turned = np.linalg.solve(np.linalg.cholesky(scaled), (right / scale)[..., None])[..., 0]
    misfit = products[:, m, m] + float((point.pull**2).sum()) - (turned**2).sum(axis=1)
    determinant = np.linalg.slogdet(information)[1]
    logs: FloatArray = -0.5 * (misfit + determinant)
    return np.where(np.isfinite(logs), logs, -np.inf)


def _around(index: int, reach: int, count: int) -> IntArray:
    return np.arange(max(index - reach, 0), min(index + reach + 1, count))


def _with(choice: Choice, o: int, size: int, noise: int) -> Choice:
    sizes, noises = list(choice.sizes), list(choice.noises)
    sizes[o], noises[o] = size, noise
    return Choice(choice.scale, (sizes[0], sizes[1], sizes[2]), (noises[0], noises[1], noises[2]))


__all__ = ["NOISES", "OBSERVABLES", "SCALES", "SIZES", "Choice", "Departing", "Departures"]
