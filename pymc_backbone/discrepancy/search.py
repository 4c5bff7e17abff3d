"""The search over sets of effects: forward from the base, with replacement and pruning, every fit kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from ..effects import Effect
from ..oscillator import Oscillator
from . import evidence, starts
from .batch import Batch
from .data_term import DataTerm
from .joint_fit import NUISANCES, Fit, State, fit, start_state
from .layout import Layout, make_layout

Set = tuple[str, ...]
Progress = Callable[[str, float], None]

_POOR = 1.5  # reduced chi-square above which the score of a fit is no guide
_KEPT_PARENTS = 2
_GLANCE = 10  # iterations after which only the best start goes on
_PATIENT = 300  # iterations for the base model, from which all others start
BUDGET = 3e7  # simulated values after which the search ends; only what nothing explains takes as many
_ROUNDS = 2
_LOOKED_BACK = 3
_EXPLAINED = 1.1  # reduced chi-square up to which a set may be complete
_CLOSE = 30.0  # chi-square within which a smaller set rivals the best
_NOISE = 0.01  # p-value of the residuals from which they are taken for noise
_WORTH = 5.0  # fall of chi-square by which one more effect begins to earn its place


@dataclass
class Search:
    """Fits of sets of effects beyond the base, each set once.

    Attributes
    ----------
    batch : Batch
        The data.
    base : Oscillator
        Mass and base effects.
    candidates : tuple of str
        Effects that may be missing.
    max_effects : int
        Largest set.
    own : mapping of str to Effect
        Candidates that the library does not hold, by name.
    """

    batch: Batch
    base: Oscillator
    candidates: tuple[str, ...]
    max_effects: int = 3
    progress: Progress = lambda stage, share: None
    fits: dict[Set, Fit] = field(default_factory=dict)
    failed: dict[Set, str] = field(default_factory=dict)
    layouts: dict[Set, Layout] = field(default_factory=dict)
    by_levels: dict[Set, list[tuple[float, State]]] = field(default_factory=dict)
    reference: int = 0
    effort: float = 0.0
    budget: float = BUDGET
    is_cut: bool = False
    own: Mapping[str, Effect] = field(default_factory=dict)

    def __post_init__(self) -> None:
        spans = [w.levels[-1] / w.levels[0] if w.levels.size else 0.0 for w in self.batch.levels]
        self.reference = int(np.argmax(spans))

    def run(self) -> None:
        """Fit the base, every single effect, and larger sets as long as they earn their place."""
        self.progress("base model", 0.0)
        self.fit_set(())
        if () not in self.fits:
            return
        for k, name in enumerate(self.candidates):
            self.progress("single effects", (k + 1) / len(self.candidates))
            self.fit_set((name,))
        self._look_again()
        self._look_back()
        for size in range(2, self.max_effects + 1):
            before = self.best(size - 1)
            parents = self._parents(size - 1)
            if not parents or (size > 2 and len(before) < size - 1 and self._is_explained()):
                break
            self._extend(parents, size)
            self._look_back()
        for _ in range(_ROUNDS):
            if not self._replace():
                break
            self._look_back()

    def _is_costly(self, names: Set) -> bool:
        """Return whether a set takes much longer than the base does."""
        return is_heavy(self.layout(names)) and not is_heavy(self.layout(()))

    def _is_settled(self) -> bool:
        """Return whether the most probable set is a simple one that leaves nothing but noise."""
        best = self.best()
        return not self._is_costly(best) and evidence.lack_of_fit(self.batch, self.fits[best]).p_value > _NOISE

    def _is_explained(self) -> bool:
        """Return whether a set leaves hardly more than noise."""
        count = sum(w.size for w in self.batch.deciding)
        return min(item.cost for item in self.fits.values()) < _EXPLAINED * count

    def _look_again(self) -> None:
        """Fit single effects that have a shape, and lag behind, from their look in the backbones as well.

        Where the base holds effects and nothing explains the records yet, these may have bent to imitate what is
        missing: then from a fit without them.
        """
        lowest = min(item.cost for item in self.fits.values())
        is_bent = bool(self.layout(()).free.size) and not self._is_explained()
        bare = Search(self.batch, Oscillator(self.base.mass), self.candidates, 1, own=self.own)
        for name in self.candidates:
            known = self.fits.get((name,))
            layout = self.layout((name,))
            if known is None or len(starts.positions(layout, name)) < 2:
                continue
            found: list[Fit] = []
            if is_bent and self.effort <= self.budget:
                bare.fit_set(())
                alone = bare.fit_set((name,)) if () in bare.fits else None
                if alone is not None:
                    found += self.descend(layout, [starts.embedded(layout, alone)[0]], is_near=True)
            elif known.cost >= lowest + _CLOSE and not self._is_costly((name,)) and (name,) not in self.by_levels:
                found += self._from_backbones((name,), layout, lowest)
            self.fits[(name,)] = min([known, *found], key=lambda item: item.cost)
            self.effort, bare.effort = self.effort + bare.effort, 0.0

    def _look_back(self) -> None:
        """Fit the subsets of the best sets again, from where these ended: a larger set may have found a better way."""
        for names in self.ranked()[:_LOOKED_BACK]:
            larger = self.fits[names]
            for smaller in combinations(names, max(len(names) - 1, 0)):
                known = self.fits.get(smaller)
                if not names or known is None or known.cost < larger.cost + _CLOSE:
                    continue
                layout = self.layout(smaller)
                places = [larger.layout.names.index(name) for name in layout.names]
                own = np.concatenate(
                    [larger.state.own[:, :NUISANCES], larger.state.own[:, [NUISANCES + p for p in places]]], axis=1
                )
                state = State(larger.state.eta[places], own)
                for found in self.descend(layout, [state], is_near=True, rival=known.cost):
                    if found.cost < known.cost - 0.01:
                        self.fits[smaller] = found

    def layout(self, names: Set) -> Layout:
        """Return the layout of the base with these effects."""
        if names not in self.layouts:
            extended = self.base + [self.own.get(name, name) for name in names]
            self.layouts[names] = make_layout(extended, self.batch.amplitude, self.batch.angular_frequency)
        return self.layouts[names]

    def reduced(self, found: Fit) -> float:
        """Return the reduced chi-square of a fit."""
        return float(found.chi_square.sum() / sum(w.size for w in self.batch.deciding))

    def ranked(self, size: int | None = None) -> list[Set]:
        """Return the fitted sets, of one size or all, most probable first."""
        probability = evidence.probabilities(self.fits, self.batch, len(self.candidates))
        names = [name for name in self.fits if size is None or len(name) == size]
        return sorted(names, key=lambda name: -probability[name].log_posterior)

    def best(self, largest: int | None = None) -> Set:
        """Return the most probable set with at most ``largest`` effects."""
        limit = self.max_effects if largest is None else largest
        return next((name for name in self.ranked() if len(name) <= limit), ())

    def _parents(self, size: int) -> list[Set]:
        """Return the sets to extend: those that explain the records nearly as well as the best, else the best few."""
        ranked = self.ranked(size)
        count = sum(w.size for w in self.batch.deciding)
        lowest = min(item.cost for item in self.fits.values())
        explained = [name for name in ranked if self.fits[name].cost < min(_EXPLAINED * count, lowest + _CLOSE)]
        light = [name for name in ranked if not is_heavy(self.layout(name))][: _KEPT_PARENTS + 2 * (size == 1)]
        if explained:
            # what many parameters explain, two simple effects may explain as well
            simple = light[:_KEPT_PARENTS] if size == 1 and is_heavy(self.layout(explained[0])) else []
            return list(dict.fromkeys([*explained[:_KEPT_PARENTS], *simple]))
        return [name for name in ranked if name in light or name in ranked[:_KEPT_PARENTS]]

    def _extend(self, parents: Sequence[Set], size: int) -> None:
        sets = []
        for parent in parents:
            for name in self.candidates:
                union = tuple(sorted({*parent, name}))
                if len(union) == size and union not in sets:
                    sets.append(union)
        if min(self.reduced(self.fits[parent]) for parent in parents) > _POOR and self.batch.has_records:
            # far from the noise the backbones tell cheaply which sets are worth a closer look
            misfit = {
                names: min((cost for cost, _ in self._level_starts(names)), default=np.inf)
                for names in sets
                if not self._is_costly(names)
            }
            sets.sort(key=lambda names: misfit.get(names, np.inf))
        sets.sort(key=self._is_costly)
        for k, names in enumerate(sets):
            if self.effort > self.budget:
                self.is_cut = True
                break
            if self._is_costly(names) and self._is_settled():
                break
            self.progress(("pairs", "sets of three")[min(size - 2, 1)], (k + 1) / len(sets))
            self.fit_set(names)

    def _replace(self) -> bool:
        """Try every other effect in the place of each of the best set; return whether that found a better one."""
        best = self.best()
        if len(best) < 2:
            return False
        for out in best:
            rest = tuple(name for name in best if name != out)
            self.fit_set(rest)
            for name in self.candidates:
                if name not in best and self.effort <= self.budget:
                    self.fit_set(tuple(sorted((*rest, name))))
        for smaller in combinations(best, len(best) - 1):
            self.fit_set(tuple(sorted(smaller)))
        if len(best) < self.max_effects:
            self._extend([best], len(best) + 1)
        return self.best() != best

    def fit_set(self, names: Set) -> Fit | None:
        """Return the best fit of a set, from several starts; kept for the next time.

        Where a smaller set explains the records already, and a linear step says that one more effect would gain
        nothing worth its place, the set is noted with that gain and not fitted further.
        """
        if names in self.fits or names in self.failed:
            return self.fits.get(names)
        layout = self.layout(names)
        found: list[Fit] = []
        parents = (
            [] if not names else [self.fits[rest] for rest in combinations(names, len(names) - 1) if rest in self.fits]
        )
        parents.sort(key=lambda parent: parent.cost)
        count = sum(w.size for w in self.batch.deciding)
        rival = min((item.cost for item in self.fits.values()), default=None) if names else None
        for parent in parents[:2] if len(names) > 1 else parents[:1]:
            new = next(name for name in names if name not in self._names(parent))
            promised = starts.by_score(layout, new, parent, self.batch)
            is_explained = parent.cost < _EXPLAINED * count
            promised = promised[:1] if is_explained else promised
            if is_explained and promised and promised[0][0] < _WORTH:
                promised = promised[:1]
                near = self._fit(
                    layout, self.batch.deciding, promised[0][1], iterations=1, nuisances=self.batch.nuisances
                )
                found += [] if near is None else [near]
                continue
            found += self.descend(layout, [state for _, state in promised], is_near=True, rival=rival)
        lowest = min((item.cost for item in [*found, *parents[:1]]), default=np.inf)
        is_poor = lowest > _POOR * count and (rival is None or len(names) < 2 or rival > _POOR * count)
        if not names or not self.batch.has_records or is_poor:
            found += self._from_backbones(names, layout, rival)
        if not found:
            self.failed[names] = "no start could be simulated over the whole record"
            return None
        self.fits[names] = min(found, key=lambda item: item.cost)
        return self.fits[names]

    def _names(self, found: Fit) -> Set:
        held = {effect.name for effect in self.base.effects}
        return tuple(effect.name for effect in found.layout.oscillator.effects if effect.name not in held)

    def _from_backbones(self, names: Set, layout: Layout, rival: float | None) -> list[Fit]:
        if len(names) == 0:
            eta = starts.typical(layout)
            scales = (0.05, 1.0, 20.0) if eta.size else (1.0,)
            states = [
                start_state(layout, np.where(layout.is_strength, eta * scale, eta), self.batch.own) for scale in scales
            ]
            held = [effect.name for effect in layout.oscillator.effects if starts.positions(layout, effect.name)]
            for name in held:
                found = starts.by_backbone(layout, name, None, self.batch, self.reference)
                states += [state for _, state in found]
            return self.descend(layout, states, is_near=False)
        states = [state for _, state in self._level_starts(names)]
        return self.descend(layout, states, is_near=False, rival=rival)

    def _level_starts(self, names: Set) -> list[tuple[float, State]]:
        """Return starts from the look of a set in one backbone, with their misfit there; kept for the next time."""
        if names not in self.by_levels:
            parents = [self.fits[rest] for rest in combinations(names, len(names) - 1) if rest in self.fits]
            parent = min(parents, key=lambda item: item.cost, default=None)
            new = names[0] if parent is None else next(name for name in names if name not in self._names(parent))
            self.by_levels[names] = starts.by_backbone(self.layout(names), new, parent, self.batch, self.reference)
        return self.by_levels[names]

    def descend(
        self, layout: Layout, states: Sequence[State], *, is_near: bool, rival: float | None = None
    ) -> list[Fit]:
        """Return the minimum of the deciding data term that the best of some starts leads to.

        From afar the way is by the turning points, which have no phase to lose.
        """
        nuisances = self.batch.nuisances
        begun: list[Fit] = []
        for state in states:
            if not is_near and self.batch.has_records:
                turning = self._fit(layout, self.batch.turning, state, iterations=20, tolerance=1.0)
                if turning is None:
                    continue
                state = turning.state
            first = self._fit(
                layout, self.batch.deciding, state, iterations=_GLANCE, tolerance=0.03, rival=rival, nuisances=nuisances
            )
            begun += [] if first is None else [first]
        if not begun:
            return []
        best = min(begun, key=lambda item: item.cost)
        if best.is_converged or best.evaluations < _GLANCE:
            return [best]
        found = self._fit(
            layout, self.batch.deciding, best.state, iterations=80 if rival is not None else _PATIENT,
            tolerance=0.03, rival=rival, nuisances=nuisances,
        )  # fmt: skip
        return [best] if found is None else [found]

    def _fit(self, layout: Layout, terms: Sequence[DataTerm], state: State, **options: Any) -> Fit | None:
        """Fit, and count the effort in simulated values."""
        found = fit(layout, terms, state, **options)
        if found is not None:
            self.effort += found.evaluations * sum(w.size for w in terms) * (1.0 + 4.0 * is_heavy(layout))
        return found


def is_heavy(layout: Layout) -> bool:
    """Return whether the model has internal states with an equation of their own, which cost most."""
    return bool(layout.simulator.has_own_equation)
