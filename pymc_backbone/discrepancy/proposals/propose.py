"""Which sets of effects could explain the level values: all sets of up to three ranked in seconds, none left out.

Looks (`looks`) rank every combination of effects and shapes by regression. What looks lack for strong forces is nearly
the same for all sets that explain the same curve, so it is taken from the exact simulation of the best and the
regression is repeated. Then each set within reach is refined with its own defect: exact minus look where it stands.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from ..._common.checks import FloatArray
from ..._common.threads import in_threads
from ...effects import Effect
from ...oscillator import Oscillator
from ..fitting.batch import Batch
from ..fitting.scatter import SCATTER, WIDE_SCATTER
from .look_kernels import N_LOOK
from .looks import regression
from .points import Point, Standing
from .proposal import Proposal
from .set_fits import Set, SetFits
from .set_kernels import best_atoms

_SECOND_LOOK = 3.0  # standard deviations of chi-square above its mean from which effects may differ more
_STARTS = 3
_MOST_COMBINATIONS = 1500
_FLOOR = (5e-5, 0.01, 5e-4)  # model error: of frequency and damping relative, of the mid-line over the amplitude
_REACH = 400.0  # chi-square above the best within which a set gets its own defect, at least ...
_REACH_SHARE = 0.5  # ... or this share of the largest fall that any set brings
_CORRECTIONS = 5
_TURNS, _ADDED = 6, 4.0  # of a look from a smaller set, and the chi-square by which a costly one must leave less
_LITTLE = 3.0  # reduced chi-square of a smaller set from which it does not tell what a larger one would add
_EFFORTS = (250, 120, 60)  # fits by the exact simulator in turn, heavy ones by their weight
_PENALTY, _RARER = 10.0, 7.0  # chi-square by which an effect, and one that is a variant, has to be worth it
_TRUST = 0.2  # of the chi-square of a look
_LEADERS = 8  # sets whose relatives are asked
_NEARLY_AS_GOOD = 10.0  # chi-square above that of the best point of a set
_POLISHED = 16
_LARGEST_VARIED = 2  # effects of the sets that hold variants
_NEAR = 100  # sets that are refined from several starts, beside single effects


def propose(
    batch: Batch,
    base: Oscillator,
    candidates: Sequence[str],
    max_effects: int,
    own_effects: Mapping[str, Effect] | None = None,
    variants: Sequence[str] = (),
    scatter: float | None = None,
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
    variants : sequence of str, optional
        Effects that are looked for in the place of candidates, and rarer: sets of up to two effects hold them.
    scatter : float, optional
        How much effects differ between specimens, relative to their value; by default a tenth, or a third where only so
        something explains the level values and that is likelier.

    Returns
    -------
    list of Proposal
    """
    arguments = batch, base, tuple(candidates), int(max_effects), dict(own_effects or {}), tuple(variants)
    found = _Proposer(*arguments, SCATTER if scatter is None else scatter).run()
    if scatter is not None:
        return found
    values = sum(term.size for term in batch.levels)
    lowest = min((item.chi_square for item in found if item.is_exact), default=np.inf)
    if len(batch.levels) > 1 and values + _SECOND_LOOK * np.sqrt(2.0 * values) < lowest < np.inf:
        wider = _Proposer(*arguments, WIDE_SCATTER).run()
        if wider[0].log_evidence > found[0].log_evidence:
            return wider
    return found


class _Proposer:
    """The work of one call of `propose`."""

    def __init__(
        self,
        batch: Batch,
        base: Oscillator,
        candidates: tuple[str, ...],
        max_effects: int,
        own: dict[str, Effect],
        variants: tuple[str, ...] = (),
        scatter: float = SCATTER,
    ) -> None:
        self.fits = SetFits(batch, base, candidates, own, scatter, variants)
        self.batch, self.candidates, self.data, self.scatter = batch, (*candidates, *variants), self.fits.data, scatter
        self.sets: list[Set] = [
            tuple(sorted(names)) for size in range(max_effects + 1) for names in combinations(candidates, size)
        ]
        for size in range(1, min(max_effects, _LARGEST_VARIED) + 1):
            pairs = (tuple(sorted(names)) for names in combinations(self.candidates, size))
            self.sets += [names for names in pairs if not {*names}.isdisjoint(variants)]
        self.points: dict[Set, list[Point]] = {}
        self.unpolished: dict[Set, Point] = {}
        self.asked: set[tuple[Set, Set]] = set()
        self.needless: set[Set] = set()

    def run(self) -> list[Proposal]:
        """Look at all sets, correct those within reach, rank."""
        data = self.data
        stiff = data.mass * data.omegas**2
        bend = np.abs(stiff - np.median(stiff)) / (2.0 * stiff)
        defect, scatter = np.zeros((data.count.size, 3, data.levels.size)), np.zeros((0, data.levels.size, N_LOOK))
        for share, lowest in ((0.03, 3e-4), (0.01, 1e-4), (0.004, 5e-5)):
            whitening = data.whitening(share * bend + lowest, 0.02 + share, 1e-3 + share * 0.1)
            found = self._enumerate(whitening, defect, scatter)
            leader = self._leader(found, whitening, defect)
            if leader is None:
                break
            names, start = leader
            defect, scatter = start.defect, self.fits.scatter_looks(names, start)
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
        products = regression(self.data, self.fits.atoms, whitening, defect, scatter)
        positive = np.concatenate([np.full(len(item.points), item.is_positive) for item in self.fits.atoms])
        places = np.concatenate([item.places for item in self.fits.atoms]).astype(np.int64)
        base = len(self.fits.base_names)
        width = max(base + max(len(names) for names in self.sets), 1)
        table = np.full((len(self.sets), width), -1, dtype=np.int64)
        index = {name: k for k, name in enumerate(self.fits.effects)}
        for s, names in enumerate(self.sets):
            table[s, : base + len(names)] = [*range(base), *(index[name] for name in names)]
        misfits = np.full((len(self.sets), _STARTS), np.inf)
        atoms = np.full((len(self.sets), _STARTS, width), -1, dtype=np.int64)
        strengths = np.zeros((len(self.sets), _STARTS, width))
        edges = np.unique(np.linspace(0, len(self.sets), 9).astype(int))

        def work(begin: int, end: int) -> None:
            best_atoms(
                products.gram, products.constants, self.fits.firsts, positive, places, table, begin, end,
                _MOST_COMBINATIONS, misfits, atoms, strengths,
            )  # fmt: skip

        in_threads([partial(work, b, e) for b, e in pairwise(edges)])
        return misfits, atoms, strengths

    def _leader(
        self, found: tuple[FloatArray, Any, FloatArray], whitening: FloatArray, defect: FloatArray
    ) -> tuple[Set, Point] | None:
        """Return the set that explains best by the exact simulator, of those that looks put first."""
        misfits = found[0]
        order = np.argsort(misfits[:, 0] + 6.0 * np.array([len(names) for names in self.sets]))
        chosen: list[tuple[int, int]] = [(int(s), 0) for s in order[:6]]
        light = [int(s) for s in order if not self.fits.layout(self.sets[s]).simulator.needs_decay][:4]
        chosen += [(s, 0) for s in light if (s, 0) not in chosen]

        def work(s: int, t: int) -> tuple[Set, Point] | None:
            names = self.sets[s]
            start = self.fits.at_atoms(names, found[1][s, t], found[2][s, t], defect)
            self.fits.refine(names, start, whitening, 6)
            best = self.fits.improve(names, start, whitening, 2)
            return None if best is None else (names, best)

        tried = [item for item in in_threads([partial(work, s, t) for s, t in chosen]) if item is not None]
        return min(tried, key=lambda item: item[1].cost + 6.0 * len(item[0]), default=None)

    def _start_all(self, found: tuple[FloatArray, Any, FloatArray], defect: FloatArray) -> None:
        """Refine the best points of all sets by looks with the common defect."""
        order = np.argsort(found[0][:, 0] + np.array([self._penalty(names) for names in self.sets]))
        near = set(order[:_NEAR].tolist()) | {s for s, names in enumerate(self.sets) if len(names) == 1}

        def work(s: int) -> None:
            names = self.sets[s]
            starts = []
            best = found[0][s, 0]
            for t in range(_STARTS if s in near else 1):
                if (found[1][s, t, 0] < 0 and t > 0) or not np.isfinite(found[0][s, t]):
                    continue
                if t > 0 and found[0][s, t] > 2.0 * best + 50.0:
                    continue
                start = self.fits.at_atoms(names, found[1][s, t], found[2][s, t], defect)
                self.fits.refine(names, start, self.sharp, 6 if s in near else 3, careful=s in near)
                starts.append(start)
            starts.sort(key=lambda item: item.cost)
            self.points[names] = starts

        for names in self.sets:
            self.fits.layout(names)
        in_threads([partial(work, s) for s in range(len(self.sets))])

    def _penalty(self, names: Set) -> float:
        return _PENALTY * len(names) + _RARER * len(self.fits.variants.intersection(names))

    def _correct(self) -> None:
        """Fit sets within reach by the exact simulator, the likeliest first, until those that lead have all been."""
        known = [self._cost(names) for names in self.sets if np.isfinite(self._cost(names))]
        if not known:
            return
        tried: set[tuple[Set, int]] = set()
        for k, budget in enumerate(_EFFORTS):
            lowest = min(self._cost(names) for names in self.sets)
            reach = max(_REACH, _REACH_SHARE * (max(known) - lowest))
            jobs = self._next(tried, lowest + reach, budget, smaller_first=k == 0)
            tried.update((names, t) for names, places in jobs.items() for t in places)
            work = [partial(self._simulate, names, jobs[names], self._best_part(names)) for names in self._dear(jobs)]
            in_threads(work)
            self._ask_relatives()
        for starts in self.points.values():
            starts.sort(key=lambda item: (not item.is_exact, item.cost))
        self._polish()

    def _next(
        self, tried: set[tuple[Set, int]], most: float, budget: int, *, smaller_first: bool
    ) -> dict[Set, list[int]]:
        """Return sets within reach that were not simulated yet, and which of their points, the likeliest first."""
        order = sorted(self.sets, key=lambda names: _TRUST * self._cost(names) + self._penalty(names))
        jobs: dict[Set, list[int]] = {}
        effort = 0
        for names in order:
            for t, start in enumerate(self.points[names]):
                is_far = start.cost > most and len(names) > 1
                is_worse = t > 0 and start.cost > 2.0 * self._cost(names) + 30.0
                if (names, t) in tried or names in self.needless or is_far or is_worse:
                    continue
                cost = self.fits.weight(names)
                is_later = smaller_first and cost > 1 and len(names) > 1  # it may be looked at from smaller ones
                if is_later or effort + cost > budget:
                    continue
                effort += cost
                jobs.setdefault(names, []).append(t)
        return jobs

    def _simulate(self, names: Set, places: list[int], smaller: Standing | None) -> None:
        """Fit points of a set by the exact simulator, unless it adds nothing to a smaller one."""
        if smaller is not None and self._is_needless(names, smaller):
            return  # one point is left of it, whatever it had
        for t in places:
            better = self.fits.improve(names, self.points[names][t].copy(), self.sharp, _CORRECTIONS)
            if better is not None:
                self.points[names][t] = better

    def _dear(self, sets: Iterable[Set]) -> list[Set]:
        """Return sets that are fitted beside each other, those that take long first."""
        return sorted(sets, key=self.fits.weight, reverse=True)

    def _standing(self, names: Set) -> Standing:
        return Standing(names, self.points[names][0], self._cost(names))

    def _best_part(self, names: Set) -> Standing | None:
        """Return the best of the sets that a costly one extends, of those that were simulated."""
        if len(names) < 2 or self.fits.weight(names) == 1:
            return None
        parts = [part for part in combinations(names, len(names) - 1) if self.points[part]]
        exact = [self._standing(part) for part in parts if self.points[part][0].is_exact]
        return min(exact, key=lambda item: item.cost, default=None)

    def _is_needless(self, names: Set, smaller: Standing) -> bool:
        """Return whether a costly set, looked at from where a smaller one was simulated, adds nothing to that.

        Where that explains little, the set's own look counts, which may have begun elsewhere.
        """
        if self._cost(names) < smaller.cost and smaller.cost > _LITTLE * self.data.count.sum():
            return False
        start = self.fits.transferred(smaller.point, smaller.names, names)
        self.fits.refine(names, start, self.sharp, _TURNS)
        if start.cost < smaller.cost - _ADDED or not np.isfinite(start.cost):
            return False
        self.needless.add(names)
        self.points[names] = [start]
        return True

    def _polish(self) -> None:
        """Bring the likeliest sets to the exact values of every specimen, not of the mean one only."""
        best = sorted((names for names in self.sets if self.points[names]), key=self._score)[:_POLISHED]

        def polish(names: Set) -> None:
            self.unpolished[names] = self.points[names][0]
            self.points[names][0] = self.fits.polish(names, self.points[names][0].copy(), self.sharp)

        in_threads([partial(polish, n) for n in best if self.points[n][0].is_exact])

    def _ask_relatives(self) -> None:
        """Start sets that lag behind a larger or smaller one from where that one stands.

        A set that holds another one cannot be worse, and one effect less than the best is what has to be ruled out. So
        it is with what has another effect in the place of one of the best: its look may have lost the rest.
        """
        exact = [names for names in self.sets if self.points[names] and self.points[names][0].is_exact]
        leaders = sorted(exact, key=lambda names: self._cost(names) + self._penalty(names))[:_LEADERS]
        jobs: dict[Set, Set] = {}
        for leader in leaders:
            cost = self._cost(leader)
            for name in leader:
                less = tuple(other for other in leader if other != name)
                if self._cost(less) > cost + 10.0 and (leader, less) not in self.asked:
                    jobs.setdefault(less, leader)
                elif less in self.points and less:
                    for lagging in self._lagging(less):
                        jobs.setdefault(lagging, less)
            for more in self._lagging(leader):
                jobs.setdefault(more, leader)
        self.asked.update((leader, names) for names, leader in jobs.items())

        def work(names: Set, leader: Standing) -> None:
            if len(names) > len(leader.names) and self.fits.weight(names) > 1 and self._is_needless(names, leader):
                return
            begun = self.fits.transferred(leader.point, leader.names, names)
            better = self.fits.improve(names, begun, self.sharp, _CORRECTIONS)
            if better is not None:
                self.points[names].append(better)
                self.points[names].sort(key=lambda item: item.cost)

        in_threads([partial(work, names, self._standing(jobs[names])) for names in self._dear(jobs)])

    def _lagging(self, smaller: Set) -> list[Set]:
        """Return the sets that hold one effect more than another and explain less, unless they began there."""
        larger = (tuple(sorted({*smaller, name})) for name in self.candidates if name not in smaller)
        known = (names for names in larger if names in self.points and names not in self.needless)
        cost = self._cost(smaller)
        return [names for names in known if (smaller, names) not in self.asked and self._cost(names) > cost + 0.5]

    def _cost(self, names: Set) -> float:
        return min((start.cost for start in self.points[names]), default=np.inf)

    def _score(self, names: Set) -> float:
        return -self.fits.log_evidence(names, self.points[names][0]) if self.points[names] else np.inf

    def _log_evidence(self, names: Set, best: Point) -> float:
        """Return the evidence of a set: of the points nearly as good as the best, those that stand apart, together.

        Chi-square of what sticks is rough, and long valleys have several dents, the deepest of which holds little.
        """
        rough = [self.unpolished[names]] if names in self.unpolished else []
        near = [item for item in (*self.points[names], *rough) if item.cost < best.cost + _NEARLY_AS_GOOD]
        known = [(self.fits.log_evidence(names, item), item) for item in (best, *near) if item.is_exact or item is best]
        known.sort(key=lambda pair: -pair[0])
        apart: list[Point] = []
        logs = []
        for log, item in known:
            if all(item.is_apart_from(other) for other in apart):
                apart.append(item)
                logs.append(log)
        return float(np.logaddexp.reduce(logs))

    def _ranked(self) -> list[Proposal]:
        """Return all sets, best first.

        What was looked at and not simulated is likelier than nothing that was: a look may promise what no simulation
        keeps.
        """
        proposals = []
        for names in self.sets:
            starts = self.points[names]
            if not starts:
                layout = self.fits.layout(names)
                empty = np.zeros(layout.free.size)
                proposals.append(
                    Proposal(names, empty, self.batch.own[:, :2], np.inf, False, -np.inf, (), self.scatter)
                )
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
                    self.scatter,
                )
            )
        most = max((item.log_evidence for item in proposals if item.is_exact), default=np.inf)
        known = [replace(item, log_evidence=min(item.log_evidence, most)) for item in proposals]
        return sorted(known, key=lambda item: (-item.log_evidence, not item.is_exact))
