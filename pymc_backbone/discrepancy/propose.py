"""Which sets of effects could explain the level values: all sets of up to three ranked in seconds, none left out.

Looks (`looks`) rank every combination of effects and shapes by regression. What looks lack for strong forces is nearly
the same for all sets that explain the same curve, so it is taken from the exact simulation of the best and the
regression is repeated. Then each set within reach is refined with its own defect: exact minus look where it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from .._common.checks import FloatArray
from ..effects import BASE_EFFECTS, LIBRARY, Effect
from ..oscillator import Oscillator
from . import evidence
from .batch import Batch
from .joint_fit import SCATTER
from .layout import Layout, make_layout
from .look_kernels import N_LOOK
from .looks import ROUNDS, Atoms, LevelData, atoms_of, level_data, regression
from .refine_kernels import observe, refine
from .set_kernels import best_atoms
from .starts import positions

Set = tuple[str, ...]

_STARTS = 3
_MOST_COMBINATIONS = 1500
_THREADS = 2
_FLOOR = (5e-5, 0.01, 5e-4)  # model error: of frequency and damping relative, of the mid-line over the amplitude
_REACH = 400.0  # chi-square above the best within which a set gets its own defect, at least ...
_REACH_SHARE = 0.5  # ... or this share of the largest fall that any set brings
_CORRECTIONS = 5
_HEAVY_WEIGHT = 6
_EFFORTS = (250, 120, 60)  # fits by the exact simulator in turn, heavy ones by their weight
_TRUST = 0.2  # of the chi-square of a look
_CUTS = 3
_LEADERS = 8  # sets whose relatives are asked
_POLISHED = 16
_NEAR = 100  # sets that are refined from several starts


@dataclass(frozen=True, eq=False)
class Proposal:
    """One set of effects and how well it explains the level values.

    Attributes
    ----------
    names : tuple of str
        Effects beyond the base, sorted.
    eta : (q,) array
        Shared coordinates in the set's `Layout`.
    own : (r, 2) array
        Stiffness and damping of each specimen.
    chi_square : float
        Of the level values with the model-error floor, the scatter of the effects at its best.
    is_exact : bool
        Whether the exact simulator gave ``chi_square``, or the look alone.
    log_evidence : float
        For ranking, the prior of the set's size included.
    starts : tuple of (float, (q,) array, (r, 2) array)
        Minima found: chi-square, coordinates, own values; best first.
    """

    names: Set
    eta: FloatArray
    own: FloatArray
    chi_square: float
    is_exact: bool
    log_evidence: float
    starts: tuple[tuple[float, FloatArray, FloatArray], ...]


@dataclass(eq=False)
class _Start:
    """A point of a set, with what the look lacks there."""

    eta: FloatArray
    own: FloatArray
    defect: FloatArray
    look: FloatArray
    tilt: FloatArray
    origin: FloatArray
    slopes: FloatArray
    cost: float = np.inf
    log_determinant: float = 0.0
    shared: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    is_exact: bool = False

    def copy(self) -> _Start:
        """Return a point that moves on its own."""
        arrays = ("eta", "own", "defect", "look", "tilt", "origin", "slopes", "shared")
        return replace(self, **{name: getattr(self, name).copy() for name in arrays})


def propose(
    batch: Batch,
    base: Oscillator,
    candidates: Sequence[str],
    max_effects: int,
    own_effects: Mapping[str, Effect] | None = None,
) -> list[Proposal]:
    """Return every set of up to ``max_effects`` candidates, the one that explains the level values best first.

    Parameters
    ----------
    batch : Batch
        Level values of the specimens.
    base : Oscillator
        Mass and the effects that are there already; they are fitted with every set and may vanish.
    candidates : sequence of str
        Effects that may be missing.
    max_effects : int
        Largest set, from 0 to 3.
    own_effects : mapping of str to Effect, optional
        Candidates that the library does not hold, by name.

    Returns
    -------
    list of Proposal
    """
    return _Proposer(batch, base, tuple(candidates), int(max_effects), dict(own_effects or {})).run()


class _Proposer:
    """The work of one call of `propose`."""

    def __init__(
        self, batch: Batch, base: Oscillator, candidates: tuple[str, ...], max_effects: int, own: dict[str, Effect]
    ) -> None:
        self.batch, self.base, self.candidates, self.own_effects = batch, base, candidates, own
        self.data: LevelData = level_data(batch.levels, base.mass)
        self.base_names = [effect.name for effect in base.effects if effect.name not in BASE_EFFECTS]
        self.scatter = SCATTER if self.data.count.size > 1 else 0.0
        self.sets: list[Set] = [
            tuple(sorted(names)) for size in range(max_effects + 1) for names in combinations(candidates, size)
        ]
        self.layouts: dict[Set, Layout] = {}
        self.views: dict[Set, tuple[Any, Any, Any]] = {}
        self.effects: list[str] = [*self.base_names, *candidates]
        by_name = {effect.name: effect for effect in base.effects}
        self.atoms: list[Atoms] = []
        for name in self.effects:
            effect = by_name.get(name) or own.get(name) or LIBRARY[name]
            layout = make_layout(Oscillator(base.mass, [effect]), batch.amplitude, batch.angular_frequency)
            self.atoms.append(atoms_of(layout, name, self.data))
        self.no_defect = np.zeros((self.data.count.size, 3, self.data.levels.size))
        self.points: dict[Set, list[_Start]] = {}
        self.asked: set[tuple[Set, Set]] = set()

    def layout(self, names: Set) -> Layout:
        """Return the layout of a set."""
        if names not in self.layouts:
            oscillator = self.base
            if names:
                oscillator = self.base + [self.own_effects.get(name) or LIBRARY[name] for name in names]
            self.layouts[names] = make_layout(oscillator, self.batch.amplitude, self.batch.angular_frequency)
        return self.layouts[names]

    def run(self) -> list[Proposal]:
        """Look at all sets, correct those within reach, rank."""
        data = self.data
        stiff = data.mass * data.omegas**2
        bend = np.abs(stiff - np.median(stiff)) / (2.0 * stiff)
        defect, scatter = self.no_defect, np.zeros((0, data.levels.size, N_LOOK))
        for share, lowest in ((0.03, 3e-4), (0.01, 1e-4), (0.004, 5e-5)):
            whitening = data.whitening(share * bend + lowest, 0.02 + share, 1e-3 + share * 0.1)
            found = self._enumerate(whitening, defect, scatter)
            leader = self._leader(found, whitening, defect)
            if leader is None:
                break
            names, start = leader
            defect, scatter = start.defect, self._scatter_looks(names, start)
        whitening = data.whitening(share * bend + lowest, 0.02 + share, 1e-3 + share * 0.1)
        found = self._enumerate(whitening, defect, scatter)
        self.sharp = data.whitening(np.full(data.levels.size, _FLOOR[0]), _FLOOR[1], _FLOOR[2])
        self._start_all(found, defect)
        self._correct()
        return self._ranked()

    def _enumerate(
        self, whitening: FloatArray, defect: FloatArray, scatter: FloatArray
    ) -> tuple[FloatArray, Any, FloatArray]:
        """Return misfits (s, t), atoms and strengths (s, t, k) of all sets."""
        products = regression(self.data, self.atoms, whitening, defect, scatter)
        counts = [len(item.points) for item in self.atoms]
        firsts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        positive = np.concatenate([np.full(n, item.is_positive) for n, item in zip(counts, self.atoms, strict=True)])
        places = np.concatenate([item.places for item in self.atoms]).astype(np.int64)
        base = len(self.base_names)
        width = max(base + max(len(names) for names in self.sets), 1)
        table = np.full((len(self.sets), width), -1, dtype=np.int64)
        index = {name: k for k, name in enumerate(self.effects)}
        for s, names in enumerate(self.sets):
            table[s, : base + len(names)] = [*range(base), *(index[name] for name in names)]
        misfits = np.full((len(self.sets), _STARTS), np.inf)
        atoms = np.full((len(self.sets), _STARTS, width), -1, dtype=np.int64)
        strengths = np.zeros((len(self.sets), _STARTS, width))
        edges = np.unique(np.linspace(0, len(self.sets), 9).astype(int))

        def work(begin: int, end: int) -> None:
            best_atoms(
                products.gram, products.constants, firsts, positive, places, table, begin, end, _MOST_COMBINATIONS,
                misfits, atoms, strengths,
            )  # fmt: skip

        _in_threads([partial(work, b, e) for b, e in pairwise(edges)])
        return misfits, atoms, strengths

    def _point(self, s: int, t: int, found: tuple[FloatArray, Any, FloatArray], defect: FloatArray) -> _Start:
        """Return what the regression found as a point of the set."""
        names = self.sets[s]
        layout = self.layout(names)
        eta = np.zeros(layout.free.size)
        firsts = np.concatenate([[0], np.cumsum([len(item.points) for item in self.atoms])])
        sums = np.zeros((self.data.levels.size, N_LOOK))
        for atom, strength in zip(found[1][s, t], found[2][s, t], strict=True):
            if atom < 0:
                continue
            e = int(np.searchsorted(firsts, atom, side="right")) - 1
            where = positions(layout, self.effects[e])
            point = self.atoms[e].points[atom - firsts[e]].copy()
            point[0] *= strength
            if self.atoms[e].is_positive:
                point[0] = point[0] if strength > 0.0 else 1e-6 * self.atoms[e].points[atom - firsts[e], 0]
            eta[where] = point
            sums += strength * self.atoms[e].looks[atom - firsts[e]]
        data = self.data
        own = np.zeros((data.count.size, 2))
        for r, m in enumerate(data.count):
            o, level = data.rows[r, :m, 0], data.rows[r, :m, 1]
            omega = 2.0 * np.pi * data.values[r, :m][o == 0]
            own[r, 0] = np.mean(data.mass * omega**2 - sums[level[o == 0], 0])
            at = level[o == 1]
            damping = data.values[r, :m][o == 1] * data.mass * data.omegas[at] / np.pi
            own[r, 1] = np.mean(damping - sums[at, 1]) if at.size else self.batch.own[r, 1]
        smallest = 0.02 * data.mass * data.omegas.min() ** 2
        own[:, 0] = np.maximum(own[:, 0], smallest)
        own[:, 1] = np.maximum(own[:, 1], 0.0)
        eta = np.clip(eta, layout.low, layout.high)
        n, q = data.levels.size, eta.size
        return _Start(
            eta, own, defect.copy(), np.zeros((n, N_LOOK)), np.zeros((q, 3, n)), eta.copy(), np.zeros((q, n, N_LOOK))
        )

    def _refine(self, names: Set, start: _Start, whitening: FloatArray, iterations: int) -> None:
        """Fit a point of a set by looks and its defect."""
        layout, data = self.layout(names), self.data
        owners, is_asymmetric, points = self._views(names)
        shared = np.zeros((start.eta.size, start.eta.size))
        start.cost, start.log_determinant = refine(
            *layout.simulator.describe(), layout.template, layout.free, _pairs(layout.powers), _pairs(layout.slips),
            _pairs(layout.opposed), layout.low, layout.high, self._is_log(layout), layout.width, layout.amplitude,
            owners, layout.is_strength, is_asymmetric, data.levels, data.omegas, ROUNDS, points, data.count, data.rows,
            data.values, whitening, start.defect, start.tilt, start.origin, self.scatter, iterations, 0.3, start.eta,
            start.own, start.look, shared, start.slopes,
        )  # fmt: skip
        start.shared = shared
        if not np.isfinite(start.cost):
            start.cost = np.inf

    def _views(self, names: Set) -> tuple[Any, Any, Any]:
        """Return the effect of each coordinate, and for each effect whether it is asymmetric, how many points it takes.

        Effects are counted as the simulator does: without linear stiffness and viscous damping.
        """
        if names not in self.views:
            layout = self.layout(names)
            owners = np.zeros(layout.free.size, dtype=np.int64)
            order = [effect.name for effect in layout.oscillator.effects if effect.name not in BASE_EFFECTS]
            for e, effect in enumerate(order):
                owners[positions(layout, effect)] = e
            items = [self.atoms[self.effects.index(effect)] for effect in order]
            self.views[names] = (
                owners, np.array([item.is_asymmetric for item in items], dtype=bool),
                np.array([item.instants for item in items], dtype=np.int64),
            )  # fmt: skip
        return self.views[names]

    @staticmethod
    def _is_log(layout: Layout) -> Any:
        """Return which coordinates are moved in the logarithm: positive shapes with a scale of their own."""
        top = layout.width * np.sqrt(12.0)
        is_exponent = np.abs(layout.high - layout.low - top) < 1e-6 * top
        slips = np.isin(np.arange(top.size), [force for _, force in layout.slips])
        return ~layout.is_strength & (layout.low >= 0.0) & (~is_exponent | slips)

    def _exact(self, names: Set, start: _Start) -> bool:
        """Bring the defect of a point and its derivatives up to date by the exact mean specimen; False if it fails.

        The look and its derivatives must be those of the point.
        """
        layout, data = self.layout(names), self.data
        n, q = data.levels.size, start.eta.size
        effects, physical = layout.physical(start.eta, np.zeros(q), 0.0)
        vector = layout.template.copy()
        vector[layout.free] = effects
        vector[:2] = start.own.mean(axis=0)
        values, jacobian, status = np.empty((3, n)), np.zeros((3, n, vector.size)), np.zeros(n, dtype=np.int64)
        layout.simulator.backbone(vector, data.levels, 0.0, True, values, jacobian, status)
        room = np.zeros((n, 8))
        seen = [observe(start.look, k, data.mass, 0.0, 0.0, room[k]) for k in range(n)]
        stiff, damp, turn, middle = start.slopes.transpose(2, 0, 1)
        looked = np.array(
            [
                room[:, 3] * stiff + room[:, 4] * damp,
                room[:, 5] * stiff + room[:, 6] * damp + room[:, 7] * turn,
                middle,
            ]
        ).transpose(1, 0, 2)
        tilt = (jacobian[:, :, layout.free] @ physical).transpose(2, 0, 1) - looked
        lacking = values - room[:, :3].T
        good = (status == 0) & np.array(seen) & np.isfinite(lacking).all(axis=0) & np.isfinite(tilt).all(axis=(0, 1))
        if good.sum() < 2:
            return False
        if not good.all():  # levels that are not reached stay with what their neighbours lack
            for o in range(3):
                lacking[o] = np.interp(data.levels, data.levels[good], lacking[o, good])
                for j in range(q):
                    tilt[j, o] = np.interp(data.levels, data.levels[good], tilt[j, o, good])
        start.defect[:] = lacking
        start.tilt[:] = tilt
        start.origin[:] = start.eta
        return True

    def _exact_each(self, names: Set, start: _Start) -> bool:
        """Bring the defect of each specimen up to date by its own exact values; False where one fails."""
        layout, data = self.layout(names), self.data
        n = data.levels.size
        centre = start.own.mean(axis=0)
        vector = layout.template.copy()
        vector[layout.free] = layout.physical(start.eta, np.zeros(start.eta.size), 0.0)[0]
        values, status, room = np.empty((3, n)), np.zeros(n, dtype=np.int64), np.zeros(8)
        for r in range(data.count.size):
            held = np.unique(data.rows[r, : data.count[r], 1])
            vector[:2] = start.own[r]
            reached = np.ascontiguousarray(data.levels[held])
            layout.simulator.backbone(
                vector, reached, 0.0, True, values[:, : held.size], np.zeros((0, 0, 0)), status[: held.size]
            )
            if status[: held.size].any():
                return False
            for i, k in enumerate(held):
                if not observe(start.look, k, data.mass, vector[0] - centre[0], vector[1] - centre[1], room):
                    return False
                start.defect[r, :, k] = values[:, i] - room[:3]
        start.origin[:] = start.eta
        return bool(np.isfinite(start.defect).all())

    def _improve(self, names: Set, start: _Start, whitening: FloatArray, turns: int) -> _Start | None:
        """Fit a point by the exact simulator: Gauss-Newton, steps cut back where it does not confirm them."""
        self._refine(names, start, whitening, 0)
        if not np.isfinite(start.cost) or not self._exact(names, start):
            return None
        self._refine(names, start, whitening, 0)
        best = start
        best.is_exact = True
        is_log = self._is_log(self.layout(names))
        for _ in range(turns):
            trial = best.copy()
            self._refine(names, trial, whitening, 6)
            promised = best.cost - trial.cost
            if not promised > 0.2:
                break
            moved = None
            for _ in range(_CUTS):
                if self._exact(names, trial):
                    self._refine(names, trial, whitening, 0)
                    if trial.cost < best.cost:
                        moved = trial
                        break
                shorter = best.copy()
                both = is_log & (best.eta > 0.0) & (trial.eta > 0.0)
                middle = 0.7 * best.eta + 0.3 * trial.eta
                ratio = np.where(both, trial.eta / np.where(both, best.eta, 1.0), 1.0)
                shorter.eta[:] = np.where(both, best.eta * ratio**0.3, middle)
                shorter.own[:] = 0.7 * best.own + 0.3 * trial.own
                trial = shorter
                self._refine(names, trial, whitening, 0)
            if moved is None:
                break
            gain = best.cost - moved.cost
            best = moved
            if gain < 0.3 + 0.003 * best.cost:
                break
        return best

    def _leader(
        self, found: tuple[FloatArray, Any, FloatArray], whitening: FloatArray, defect: FloatArray
    ) -> tuple[Set, _Start] | None:
        """Return the set that explains best by the exact simulator, of those that looks put first."""
        misfits = found[0]
        order = np.argsort(misfits[:, 0] + 6.0 * np.array([len(names) for names in self.sets]))
        chosen: list[tuple[int, int]] = [(int(s), 0) for s in order[:6]]
        light = [int(s) for s in order if not self.layout(self.sets[s]).simulator.needs_decay][:4]
        chosen += [(s, 0) for s in light if (s, 0) not in chosen]

        def work(s: int, t: int) -> tuple[Set, _Start] | None:
            names = self.sets[s]
            start = self._point(s, t, found, defect)
            self._refine(names, start, whitening, 6)
            best = self._improve(names, start, whitening, 2)
            return None if best is None else (names, best)

        tried = [item for item in _in_threads([partial(work, s, t) for s, t in chosen]) if item is not None]
        return min(tried, key=lambda item: item[1].cost + 6.0 * len(item[0]), default=None)

    def _scatter_looks(self, names: Set, start: _Start) -> FloatArray:
        """Return the looks (k, l, 4) of one standard deviation of scatter in each strength of a set."""
        layout, data = self.layout(names), self.data
        if self.scatter == 0.0:
            return np.zeros((0, data.levels.size, N_LOOK))
        rows = []
        for effect in [*self.base_names, *names]:
            where = positions(layout, effect)
            item = self.atoms[self.effects.index(effect)]
            distance = np.abs(np.log(np.maximum(np.abs(item.points[:, 1:]), 1e-9) / np.maximum(
                np.abs(start.eta[where[1:]]), 1e-9))).sum(axis=1)  # fmt: skip
            if item.is_asymmetric:
                distance = distance + np.abs(item.points[:, 0] - start.eta[where[0]])
            k = int(np.argmin(distance))
            rows.append(self.scatter * start.eta[where[0]] / item.points[k, 0] * item.looks[k])
        return np.array(rows).reshape(-1, data.levels.size, N_LOOK)

    def _start_all(self, found: tuple[FloatArray, Any, FloatArray], defect: FloatArray) -> None:
        """Refine the best points of all sets by looks with the common defect."""
        sizes = np.array([len(names) for names in self.sets])
        order = np.argsort(found[0][:, 0] + self._penalty(("",)) * sizes)
        near = set(order[:_NEAR].tolist())

        def work(s: int) -> None:
            names = self.sets[s]
            starts = []
            best = found[0][s, 0]
            for t in range(_STARTS if s in near else 1):
                if (found[1][s, t, 0] < 0 and t > 0) or not np.isfinite(found[0][s, t]):
                    continue
                if t > 0 and found[0][s, t] > 2.0 * best + 50.0:
                    continue
                start = self._point(s, t, found, defect)
                self._refine(names, start, self.sharp, 6 if s in near else 3)
                starts.append(start)
            starts.sort(key=lambda item: item.cost)
            self.points[names] = starts

        for names in self.sets:
            self.layout(names)
        _in_threads([partial(work, s) for s in range(len(self.sets))])

    def _penalty(self, names: Set) -> float:
        return 10.0 * len(names)

    def _correct(self) -> None:
        """Fit sets within reach by the exact simulator, the likeliest first, until those that lead have all been."""
        known = [self._cost(names) for names in self.sets if np.isfinite(self._cost(names))]
        if not known:
            return
        tried: set[tuple[Set, int]] = set()
        for budget in _EFFORTS:
            lowest = min(self._cost(names) for names in self.sets)
            reach = max(_REACH, _REACH_SHARE * (max(known) - lowest))
            order = sorted(self.sets, key=lambda names: _TRUST * self._cost(names) + self._penalty(names))
            jobs: list[tuple[Set, int]] = []
            effort = 0
            for names in order:
                for t, start in enumerate(self.points[names]):
                    is_far = start.cost - lowest > reach and len(names) > 1
                    if (names, t) in tried or is_far or (t > 0 and start.cost > 2.0 * self._cost(names) + 30.0):
                        continue
                    cost = _HEAVY_WEIGHT if self.layout(names).simulator.needs_decay else 1
                    cost *= 2 if self.layout(names).simulator.has_own_equation else 1
                    if effort + cost > budget:
                        continue
                    effort += cost
                    jobs.append((names, t))
            tried.update(jobs)

            def work(names: Set, t: int) -> None:
                better = self._improve(names, self.points[names][t].copy(), self.sharp, _CORRECTIONS)
                if better is not None:
                    self.points[names][t] = better

            _in_threads([partial(work, n, t) for n, t in jobs])
            self._ask_relatives()
        for starts in self.points.values():
            starts.sort(key=lambda item: (not item.is_exact, item.cost))
        self._polish()

    def _polish(self) -> None:
        """Bring the likeliest sets to the exact values of every specimen, not of the mean one only."""
        best = sorted((names for names in self.sets if self.points[names]), key=self._score)

        def polish(names: Set) -> None:
            start = self.points[names][0].copy()
            for _ in range(2):
                if not self._exact_each(names, start):
                    return
                self._refine(names, start, self.sharp, 4)
            self.points[names][0] = start

        _in_threads([partial(polish, n) for n in best[:_POLISHED] if self.points[n][0].is_exact])

    def _ask_relatives(self) -> None:
        """Start sets that lag behind a larger or smaller one from where that one stands.

        A set that holds another one cannot be worse, and one effect less than the best is what has to be ruled out.
        """
        exact = [names for names in self.sets if self.points[names] and self.points[names][0].is_exact]
        leaders = sorted(exact, key=lambda names: self._cost(names) + self._penalty(names))[:_LEADERS]
        jobs: dict[Set, Set] = {}
        largest = max(len(names) for names in self.sets)
        for leader in leaders:
            cost = self._cost(leader)
            for name in leader:
                less = tuple(other for other in leader if other != name)
                if self._cost(less) > cost + 10.0 and (leader, less) not in self.asked:
                    jobs.setdefault(less, leader)
            if len(leader) < largest:
                for name in self.candidates:
                    more = tuple(sorted({*leader, name}))
                    if len(more) > len(leader) and self._cost(more) > cost + 0.5 and (leader, more) not in self.asked:
                        jobs.setdefault(more, leader)
        self.asked.update((leader, names) for names, leader in jobs.items())

        def work(names: Set, leader: Set) -> None:
            better = self._improve(names, self._transferred(leader, names), self.sharp, _CORRECTIONS)
            if better is not None:
                self.points[names].append(better)
                self.points[names].sort(key=lambda item: item.cost)

        _in_threads([partial(work, n, b) for n, b in jobs.items()])

    def _transferred(self, source: Set, target: Set) -> _Start:
        """Return the best point of one set as a point of another; what the first lacks begins small."""
        start, here, there = self.points[source][0], self.layout(target), self.layout(source)
        eta = np.zeros(here.free.size)
        for effect in [*self.base_names, *target]:
            item = self.atoms[self.effects.index(effect)]
            point = item.points[len(item.points) // 2].copy()
            point[0] *= 1e-3
            eta[positions(here, effect)] = point
        for k, name in enumerate(there.names):
            if name in here.names:
                eta[here.names.index(name)] = start.eta[k]
        n, q = self.data.levels.size, eta.size
        return _Start(
            np.clip(eta, here.low, here.high), start.own.copy(), start.defect.copy(), np.zeros((n, N_LOOK)),
            np.zeros((q, 3, n)), eta.copy(), np.zeros((q, n, N_LOOK)),
        )  # fmt: skip

    def _cost(self, names: Set) -> float:
        return min((start.cost for start in self.points[names]), default=np.inf)

    def _score(self, names: Set) -> float:
        return -self._log_evidence(names, self.points[names][0]) if self.points[names] else np.inf

    def _log_evidence(self, names: Set, start: _Start) -> float:
        """Return the logarithm of the evidence of a point by Laplace's method, with the prior of its size."""
        layout = self.layout(names)
        if not np.isfinite(start.cost):
            return -np.inf
        result = -0.5 * start.cost - 0.5 * start.log_determinant
        if start.eta.size:
            # Log-uniform priors: four decades of strength, two of shape; as normal ones of the same information.
            strength = np.maximum(np.abs(start.eta), 1e-4 * layout.width) * np.log(1e4) / np.sqrt(12.0)
            shape = np.where(self._is_log(layout), np.abs(start.eta) * np.log(1e2) / np.sqrt(12.0), layout.width)
            width = np.where(layout.is_strength, strength, np.minimum(shape, layout.high - layout.low))
            scaled = 0.5 * (start.shared + start.shared.T) * np.outer(width, width)
            eigenvalues = np.linalg.eigvalsh(scaled)
            result -= 0.5 * float(np.log1p(np.maximum(eigenvalues, 0.0)).sum())
        return result + evidence.log_prior(len(names), len(self.candidates))

    def _ranked(self) -> list[Proposal]:
        """Return all sets, best first."""
        proposals = []
        for names in self.sets:
            starts = self.points[names]
            if not starts:
                layout = self.layout(names)
                empty = np.zeros(layout.free.size)
                proposals.append(Proposal(names, empty, self.batch.own[:, :2], np.inf, False, -np.inf, ()))
                continue
            best = min(starts, key=lambda item: (not item.is_exact, item.cost))
            proposals.append(
                Proposal(
                    names,
                    best.eta,
                    best.own,
                    best.cost,
                    best.is_exact,
                    self._log_evidence(names, best),
                    tuple((item.cost, item.eta, item.own) for item in starts),
                )
            )
        proposals.sort(key=lambda item: -item.log_evidence)
        return proposals


def _pairs(items: Sequence[tuple[int, int]]) -> Any:
    return np.array(items, dtype=np.int64).reshape(-1, 2)


def _in_threads(jobs: Sequence[Callable[[], Any]]) -> list[Any]:
    """Run jobs on the cores that compiled code can share; in order."""
    if len(jobs) < 2:
        return [job() for job in jobs]
    with ThreadPoolExecutor(_THREADS) as pool:
        return [future.result() for future in [pool.submit(job) for job in jobs]]
