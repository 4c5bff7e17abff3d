"""One set of effects fitted to the level values: by looks, and by the exact simulator where it stands.

A point of a set holds what the look lacks there: exact minus look. Gauss-Newton moves it by looks and this defect; the
exact simulator confirms a step or has it cut back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..._common.checks import FloatArray
from ...effects import BASE_EFFECTS, LIBRARY, Effect
from ...oscillator import Oscillator
from ..fitting.batch import Batch
from ..fitting.layout import Layout, make_layout
from ..fitting.scatter import SCATTER
from ..fitting.starts import positions
from ..weighing import evidence
from .look_kernels import N_LOOK
from .looks import ROUNDS, Atoms, LevelData, atoms_of, level_data
from .points import Point, own_values
from .refine_kernels import observe, refine

Set = tuple[str, ...]

_HEAVY_WEIGHT = 6  # of what is simulated cycle by cycle
_CUTS = 3
_FAR = 3.0  # chi-square over the number of values from which specimens are taken for alike at first


class _View(NamedTuple):
    """How the compiled fit sees a set.

    The effect of each coordinate, and whether it is moved in the logarithm; of each effect whether it is asymmetric,
    whether its look is in proportion to its only coordinate, and at how many points of a cycle it is looked at. Effects
    are counted as the simulator does: without linear stiffness and viscous damping.
    """

    owners: Any
    is_log: Any
    is_asymmetric: Any
    is_proportional: Any
    points: Any


def _mean(values: FloatArray) -> float:
    """Return the mean of a few values, a tenth of the time of `numpy.mean`."""
    return float(np.add.reduce(values) / values.size)


class SetFits:
    """Fits of the sets of effects of one batch to its level values.

    Parameters
    ----------
    batch : Batch
        Level values of the specimens.
    base : Oscillator
        Mass and the effects that are there already.
    candidates : tuple of str
        Effects that may be missing.
    own_effects : mapping of str to Effect
        Candidates that the library does not hold, by name.
    scatter : float
        How much the parameters of effects differ between specimens, relative to their value.
    variants : tuple of str
        Effects that are looked for in the place of candidates, and rarer.
    """

    def __init__(
        self,
        batch: Batch,
        base: Oscillator,
        candidates: tuple[str, ...],
        own_effects: Mapping[str, Effect],
        scatter: float = SCATTER,
        variants: tuple[str, ...] = (),
    ) -> None:
        self.batch, self.base, self.candidates, self.own_effects = batch, base, candidates, own_effects
        self.variants = frozenset(variants)
        self.data: LevelData = level_data(batch.levels, base.mass)
        self.base_names = [effect.name for effect in base.effects if effect.name not in BASE_EFFECTS]
        self.scatter = scatter if self.data.count.size > 1 else 0.0
        self.layouts: dict[Set, Layout] = {}
        self.views: dict[Set, _View] = {}
        self.effects: list[str] = [*self.base_names, *candidates, *variants]
        by_name = {effect.name: effect for effect in base.effects}
        self.atoms: list[Atoms] = []
        for name in self.effects:
            effect = by_name.get(name) or own_effects.get(name) or LIBRARY[name]
            layout = make_layout(Oscillator(base.mass, [effect]), batch.amplitude, batch.angular_frequency)
            self.atoms.append(atoms_of(layout, name, self.data))
        self.own_values = [own_values(self.data, r) for r in range(self.data.count.size)]
        self.firsts = np.concatenate([[0], np.cumsum([len(item.points) for item in self.atoms])]).astype(np.int64)

    def layout(self, names: Set) -> Layout:
        """Return the layout of a set."""
        if names not in self.layouts:
            oscillator = self.base
            if names:
                oscillator = self.base + [self.own_effects.get(name) or LIBRARY[name] for name in names]
            self.layouts[names] = make_layout(
                oscillator, self.batch.amplitude, self.batch.angular_frequency, is_relaxed=self.batch.is_relaxed
            )
        return self.layouts[names]

    def at_atoms(self, names: Set, atoms: Any, strengths: FloatArray, defect: FloatArray) -> Point:
        """Return the point of a set at these atoms (k,), -1 for none, and strengths of them."""
        layout = self.layout(names)
        eta = np.zeros(layout.free.size)
        sums = np.zeros((self.data.levels.size, N_LOOK))
        for atom, strength in zip(atoms, strengths, strict=True):
            if atom < 0:
                continue
            e = int(np.searchsorted(self.firsts, atom, side="right")) - 1
            where = positions(layout, self.effects[e])
            point = self.atoms[e].points[atom - self.firsts[e]].copy()
            point[0] *= strength
            if self.atoms[e].is_positive:
                point[0] = point[0] if strength > 0.0 else 1e-6 * self.atoms[e].points[atom - self.firsts[e], 0]
            eta[where] = point
            sums += strength * self.atoms[e].looks[atom - self.firsts[e]]
        data = self.data
        own = np.zeros((data.count.size, 2))
        for r, known in enumerate(self.own_values):
            own[r, 0] = _mean(known.stiffness - sums[known.at_frequency, 0])
            at = known.at_damping
            own[r, 1] = _mean(known.damping - sums[at, 1]) if at.size else self.batch.own[r, 1]
        smallest = 0.02 * data.mass * data.omegas.min() ** 2
        own[:, 0] = np.maximum(own[:, 0], smallest)
        own[:, 1] = np.maximum(own[:, 1], 0.0)
        eta = layout.within(eta)
        n, q = data.levels.size, eta.size
        return Point(
            eta, own, defect.copy(), np.zeros((n, N_LOOK)), np.zeros((q, 3, n)), eta.copy(), np.zeros((q, n, N_LOOK))
        )

    def refine(
        self, names: Set, start: Point, whitening: FloatArray, iterations: int, *, careful: bool = False
    ) -> None:
        """Fit a point of a set by looks and its defect.

        What is ``careful`` takes specimens for alike at first, far from the values: what each may differ by, large
        where an effect is, makes up for what all lack there, and a step leads to where the effect is none.
        """
        if careful and self.scatter > 0.0:
            self._moved(names, start, whitening, 0, self.scatter)
            if _FAR * self.data.count.sum() < start.cost < np.inf:
                alike = start.copy()
                self._moved(names, alike, whitening, iterations, 0.0)
                self._moved(names, alike, whitening, 0, self.scatter)
                if alike.cost + alike.log_determinant < start.cost + start.log_determinant:
                    start.become(alike)
        self._moved(names, start, whitening, iterations, self.scatter)

    def _moved(self, names: Set, start: Point, whitening: FloatArray, iterations: int, scatter: float) -> None:
        """Move a point by so many iterations of the compiled fit; of none, its cost and look are brought up to date."""
        layout, data = self.layout(names), self.data
        view = self._view(names)
        shared = np.zeros((start.eta.size, start.eta.size))
        start.cost, start.log_determinant = refine(
            *layout.simulator.describe(), layout.template, layout.free, _pairs(layout.powers), _pairs(layout.slips),
            _pairs(layout.opposed), layout.low, layout.high, view.is_log, layout.width, layout.amplitude,
            view.owners, layout.is_strength, view.is_asymmetric, view.is_proportional, data.levels, data.omegas, ROUNDS,
            view.points, data.count, data.rows,
            data.values, whitening, start.defect, start.tilt, start.origin, scatter, iterations, 0.3, start.eta,
            start.own, start.look, shared, start.slopes,
        )  # fmt: skip
        start.shared = shared
        if not np.isfinite(start.cost):
            start.cost = np.inf

    def _view(self, names: Set) -> _View:
        """Return how the compiled fit sees a set."""
        if names not in self.views:
            layout = self.layout(names)
            owners = np.zeros(layout.free.size, dtype=np.int64)
            order = [effect.name for effect in layout.oscillator.effects if effect.name not in BASE_EFFECTS]
            counts = np.zeros(len(order), dtype=np.int64)
            for e, effect in enumerate(order):
                where = positions(layout, effect)
                owners[where], counts[e] = e, len(where)
            items = [self.atoms[self.effects.index(effect)] for effect in order]
            is_asymmetric = np.array([item.is_asymmetric for item in items], dtype=bool)
            points = np.array([item.instants for item in items], dtype=np.int64)
            self.views[names] = _View(owners, is_log(layout), is_asymmetric, ~is_asymmetric & (counts == 1), points)
        return self.views[names]

    def _exact(self, names: Set, start: Point) -> bool:
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
        release = float(data.releases.max())
        layout.simulator.backbone(vector, data.levels, release, True, values, jacobian, status, whole=False)
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

    def _exact_each(self, names: Set, start: Point) -> bool:
        """Bring the defect of each specimen up to date by its own exact values; False where one fails."""
        layout, data = self.layout(names), self.data
        centre = start.own.mean(axis=0)
        vector = layout.template.copy()
        vector[layout.free] = layout.physical(start.eta, np.zeros(start.eta.size), 0.0)[0]
        room = np.zeros(8)
        for r in range(data.count.size):
            held = np.unique(data.rows[r, : data.count[r], 1])
            values, status = np.empty((3, held.size)), np.zeros(held.size, dtype=np.int64)
            vector[:2] = start.own[r]
            reached = np.ascontiguousarray(data.levels[held])
            layout.simulator.backbone(
                vector, reached, float(data.releases[r]), True, values, np.zeros((0, 0, 0)), status, whole=False
            )
            if status.any():
                return False
            for i, k in enumerate(held):
                if not observe(start.look, k, data.mass, vector[0] - centre[0], vector[1] - centre[1], room):
                    return False
                start.defect[r, :, k] = values[:, i] - room[:3]
        start.origin[:] = start.eta
        return bool(np.isfinite(start.defect).all())

    def weight(self, names: Set) -> int:
        """Return how much the exact simulation of a set costs, that of a simple one being 1."""
        simulator = self.layout(names).simulator
        return (_HEAVY_WEIGHT if simulator.needs_decay else 1) * (2 if simulator.is_costly else 1)

    def improve(self, names: Set, start: Point, whitening: FloatArray, turns: int) -> Point | None:
        """Fit a point by the exact simulator: Gauss-Newton, steps cut back where it does not confirm them.

        Far from the values a step that promises nothing by its look is taken all the same, where it leads elsewhere.
        """
        self.refine(names, start, whitening, 0)
        if not np.isfinite(start.cost) or not self._exact(names, start):
            return None
        self.refine(names, start, whitening, 0)
        best = start
        best.is_exact = True
        is_log = self._view(names).is_log
        for _ in range(turns):
            trial = best.copy()
            self.refine(names, trial, whitening, 6, careful=True)
            promised = best.cost - trial.cost
            is_far = best.cost > _FAR * self.data.count.sum() and not np.array_equal(trial.eta, best.eta)
            if not (promised > 0.2 or is_far):
                break
            moved = None
            for _ in range(_CUTS):
                if self._exact(names, trial):
                    self.refine(names, trial, whitening, 0)
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
                self.refine(names, trial, whitening, 0)
            if moved is None:
                break
            gain = best.cost - moved.cost
            best = moved
            if gain < 0.3 + 0.003 * best.cost:
                break
        return best

    def polish(self, names: Set, start: Point, whitening: FloatArray) -> Point:
        """Return a point brought to the exact values of every specimen, not of the mean one only."""
        polished = start.copy()
        for _ in range(2):
            if not self._exact_each(names, polished):
                return start
            self.refine(names, polished, whitening, 4)
        return polished

    def scatter_looks(self, names: Set, start: Point) -> FloatArray:
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

    def transferred(self, start: Point, source: Set, target: Set) -> Point:
        """Return the point of one set as a point of another; what the first lacks begins small."""
        here, there = self.layout(target), self.layout(source)
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
        return Point(
            here.within(eta), start.own.copy(), start.defect.copy(), np.zeros((n, N_LOOK)),
            np.zeros((q, 3, n)), eta.copy(), np.zeros((q, n, N_LOOK)),
        )  # fmt: skip

    def log_evidence(self, names: Set, start: Point) -> float:
        """Return the logarithm of the evidence of a point by Laplace's method, with the prior of its size."""
        layout = self.layout(names)
        if not np.isfinite(start.cost):
            return -np.inf
        result = -0.5 * start.cost - 0.5 * start.log_determinant
        if start.eta.size:
            width = prior_widths(layout, start.eta)
            scaled = 0.5 * (start.shared + start.shared.T) * np.outer(width, width)
            eigenvalues = np.linalg.eigvalsh(scaled)
            result -= 0.5 * float(np.log1p(np.maximum(eigenvalues, 0.0)).sum())
        rarer = np.log(evidence.VARIANT) * len(self.variants.intersection(names))
        return float(result + rarer + evidence.log_prior(len(names), len(self.candidates)))


def prior_widths(layout: Layout, eta: FloatArray) -> FloatArray:
    """Return standard deviations (q,) of priors of as much information as log-uniform ones.

    These hold four decades of strength and two of shape.
    """
    strength = np.maximum(np.abs(eta), 1e-4 * layout.width) * np.log(1e4) / np.sqrt(12.0)
    shape = np.where(is_log(layout), np.abs(eta) * np.log(1e2) / np.sqrt(12.0), layout.width)
    return np.where(layout.is_strength, strength, np.minimum(shape, layout.high - layout.low))


def is_log(layout: Layout) -> Any:
    """Return which coordinates are moved in the logarithm: positive shapes with a scale of their own."""
    top = layout.width * np.sqrt(12.0)
    is_exponent = np.abs(layout.high - layout.low - top) < 1e-6 * top
    slips = np.isin(np.arange(top.size), [force for _, force in layout.slips])
    return ~layout.is_strength & (layout.low >= 0.0) & (~is_exponent | slips)


def _pairs(items: Sequence[tuple[int, int]]) -> Any:
    return np.array(items, dtype=np.int64).reshape(-1, 2)
