"""The search over sets of effects: backbones propose, all sets at once; waveforms decide, the likeliest first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np

from ..effects import Effect
from ..oscillator import Oscillator
from . import evidence, starts
from .batch import Batch
from .curves import level_chi_square
from .descent import Descent, is_heavy
from .joint_fit import NUISANCES, Fit, State
from .layout import Layout, make_layout
from .propose import Proposal, propose

Set = tuple[str, ...]
Progress = Callable[[str, float], None]

_POOR = 1.5  # reduced chi-square above which a fit may have lost its way
_KEPT_PARENTS = 2
BUDGET = 3e7  # simulated values after which the search ends; only what nothing explains takes as many
_ROUNDS = 2
_LOOKED_BACK = 3
_MOST_FOLLOWED = 24  # sets that are followed from the backbones to the waveforms before anything explains these
_MOST_EXTENDED = 8
_REACH = 12.0  # difference of the logarithm of evidence by the backbones within which the waveforms are asked, too
_SETTLED = 4
_LOST = 6.0  # reduced chi-square of the backbones, over what was promised, from which a fit ended elsewhere
_POSSIBLE_BACKBONE = 3.0  # reduced chi-square up to which a set could explain the backbones
_EXPLAINED = 1.1  # reduced chi-square up to which a set may be complete
_REFUTED = 100.0  # chi-square above one that explains, beyond which relatives are not asked
_CLOSE = 30.0  # chi-square within which a smaller set rivals the best
_NOISE = 0.01  # p-value of the residuals from which they are taken for noise
_NOTED = 1.0  # chi-square above that of the smaller set up to which one step is enough to note a set
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
    budget: float = BUDGET
    is_cut: bool = False
    own: Mapping[str, Effect] = field(default_factory=dict)
    asked: dict[tuple[Set, int], State] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.descent = Descent(self.batch)
        spans = [w.levels[-1] / w.levels[0] if w.levels.size else 0.0 for w in self.batch.levels]
        self.reference = int(np.argmax(spans))
        self.count = sum(term.size for term in self.batch.deciding)

    @cached_property
    def proposals(self) -> dict[Set, Proposal]:
        """How every set looks in the backbones, the likeliest first."""
        self.progress("all sets, by their backbones", 0.0)
        found = propose(self.batch, self.base, self.candidates, self.max_effects, self.own)
        return {item.names: item for item in found}

    @property
    def has_proposals(self) -> bool:
        """Whether the backbones were asked for proposals."""
        return "proposals" in self.__dict__

    def run(self) -> None:
        """Fit the base, the sets that the backbones propose, and what lies around the best of them."""
        self.progress("base model", 0.0)
        self.fit_set(())
        if () not in self.fits:
            return
        if self._is_explained():
            for k, name in enumerate(self.candidates):
                self.progress("single effects", (k + 1) / len(self.candidates))
                self.fit_set((name,))
            self._look_again()
        else:
            self._follow_backbones()
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
        self._look_forward()
        self._settle()

    def _is_costly(self, names: Set) -> bool:
        """Return whether a set takes much longer than the base does."""
        return is_heavy(self.layout(names)) and not is_heavy(self.layout(()))

    def _is_settled(self) -> bool:
        """Return whether the most probable set is a simple one that leaves nothing but noise."""
        best = self.best()
        return not self._is_costly(best) and evidence.lack_of_fit(self.batch, self.fits[best]).p_value > _NOISE

    def _is_explained(self) -> bool:
        """Return whether a set leaves hardly more than noise."""
        return min(item.cost for item in self.fits.values()) < _EXPLAINED * self.count

    @property
    def _is_spent(self) -> bool:
        return self.descent.effort > self.budget

    def _follow_backbones(self) -> None:
        """Fit the sets in the order of their backbones until one explains the records and no rival is within reach.

        A set that adds to one that explains already is left to the stage after, which starts from there.
        """
        fitted = 0
        reach = -np.inf
        explained: list[Set] = []
        for names, proposal in self.proposals.items():
            if not names or any(set(known) < set(names) for known in explained):
                continue
            if proposal.log_evidence < reach or fitted >= _MOST_FOLLOWED:
                break
            if self._is_spent:
                self.is_cut = True
                break
            if self._is_costly(names) and explained and self._is_settled():
                continue
            self.progress("sets that the backbones propose", min(fitted / _MOST_FOLLOWED, 1.0))
            found = self.fit_set(names)
            fitted += 1
            if found is not None and found.cost < _EXPLAINED * self.count:
                explained.append(names)
                reach = max(reach, proposal.log_evidence - _REACH)

    def _look_again(self) -> None:
        """Fit single effects that have a shape, and lag behind, from their look in the backbones as well."""
        lowest = min(item.cost for item in self.fits.values())
        for name in self.candidates:
            known, has_shape = self.fits.get((name,)), len(starts.positions(self.layout((name,)), name)) > 1
            if known is not None and known.cost >= lowest + _CLOSE and has_shape and not self._is_costly((name,)):
                self.fits[(name,)] = min([known, *self._proposed((name,), lowest)], key=lambda item: item.cost)

    def _settle(self) -> None:
        """Where nothing explains the records, carry the fits on that did not come to rest, the likeliest first."""
        if self._is_explained():
            return
        restless = [names for names in self.ranked() if not self.fits[names].is_converged]
        for names in restless[:_SETTLED]:
            if self._is_spent:
                self.is_cut = True
                break
            known = self.fits[names]
            found = self.descent.from_near(known.layout, [known.state])
            if found is not None and found.cost < known.cost:
                self.fits[names] = found

    def is_open(self, names: Set) -> bool:
        """Return whether the fit of a set did not come to rest although the set could explain the backbones."""
        found = self.fits[names]
        if found.is_converged or found.cost < _EXPLAINED * self.count or not names or not self.has_proposals:
            return False
        proposal = self.proposals.get(names)
        values = sum(term.size for term in self.batch.levels)
        return proposal is None or proposal.chi_square < _POSSIBLE_BACKBONE * values

    def _look_back(self) -> None:
        """Fit the subsets of the best sets again, from where these ended: a larger set may have found a better way."""
        lowest = min(item.cost for item in self.fits.values())
        for names in self.ranked()[:_LOOKED_BACK]:
            larger = self.fits[names]
            if lowest < _EXPLAINED * self.count and larger.cost > lowest + _REFUTED:
                continue
            for smaller in combinations(names, max(len(names) - 1, 0)):
                known = self.fits.get(smaller)
                if not names or known is None or known.cost < larger.cost + _CLOSE or self._was_asked(smaller, larger):
                    continue
                layout = self.layout(smaller)
                places = [larger.layout.names.index(name) for name in layout.names]
                own = np.concatenate(
                    [larger.state.own[:, :NUISANCES], larger.state.own[:, [NUISANCES + p for p in places]]], axis=1
                )
                found = self.descent.from_near(layout, [State(larger.state.eta[places], own)], rival=known.cost)
                if found is not None and found.cost < known.cost - 0.01:
                    self.fits[smaller] = found

    def _was_asked(self, names: Set, other: Fit) -> bool:
        """Return whether a set was started from this fit of another before, and note that it now is."""
        asked = (names, id(other.state))
        is_known = asked in self.asked
        self.asked[asked] = other.state  # kept, so that its identity stays its own
        return is_known

    def _look_forward(self) -> None:
        """Fit sets again that hold a smaller one and explain less than it does: from where that ended."""
        for names in [*self.fits]:
            for smaller in combinations(names, max(len(names) - 1, 0)):
                known = self.fits.get(smaller)
                is_behind = known is not None and known.cost < min(self.fits[names].cost, _EXPLAINED * self.count)
                if names and known is not None and is_behind and not self._was_asked(names, known):
                    found = self._extended(names, self.layout(names), known, None)
                    self.fits[names] = min([self.fits[names], *found], key=lambda item: item.cost)

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
        if not any(self.fits[parent].cost < _EXPLAINED * self.count for parent in parents):
            # far from the noise the backbones tell which sets are worth a closer look; the likeliest had theirs already
            known = self.proposals
            sets = [names for names in known if names in sets and names not in self.fits][:_MOST_EXTENDED]
        sets.sort(key=self._is_costly)
        for k, names in enumerate(sets):
            if self._is_spent:
                self.is_cut = True
                break
            if self._is_costly(names) and self._is_settled():
                break
            self.progress(("pairs", "sets of three")[min(size - 2, 1)], (k + 1) / len(sets))
            self.fit_set(names)

    def _replace(self) -> bool:
        """Try other effects in the place of each of the best set; return whether that found a better one."""
        best = self.best()
        if len(best) < 2:
            return False
        for out in best:
            rest = tuple(name for name in best if name != out)
            self.fit_set(rest)
            others = [tuple(sorted((*rest, name))) for name in self.candidates if name not in best]
            for names in self._within_reach(others, best):
                if not self._is_spent:
                    self.fit_set(names)
        for smaller in combinations(best, len(best) - 1):
            self.fit_set(tuple(sorted(smaller)))
        if len(best) < self.max_effects:
            self._extend([best], len(best) + 1)
        return self.best() != best

    def _within_reach(self, sets: Sequence[Set], best: Set) -> list[Set]:
        """Return those sets whose backbones are not much less likely than those of the best, the likeliest first."""
        known = self.proposals
        if best not in known:
            return list(sets)
        least = known[best].log_evidence - _REACH
        return [names for names, item in known.items() if names in sets and item.log_evidence > least]

    def fit_set(self, names: Set) -> Fit | None:
        """Return the best fit of a set, from several starts; kept for the next time.

        Where a smaller set explains the records already, and a linear step says that one more effect would gain
        nothing worth its place, the set is noted with that gain and not fitted further.
        """
        if names in self.fits or names in self.failed:
            return self.fits.get(names)
        found = self._base_fits() if not names else self._set_fits(names)
        if not found:
            self.failed[names] = "no start could be simulated over the whole record"
            return None
        self.fits[names] = min(found, key=lambda item: item.cost)
        return self.fits[names]

    def _base_fits(self) -> list[Fit]:
        """Return fits of the model as it is; effects that it holds may turn out to be absent."""
        layout = self.layout(())
        eta = starts.typical(layout)
        scales = (0.0, 0.05, 1.0, 20.0) if eta.size else (1.0,)
        states = [
            self.descent.released(layout, np.where(layout.is_strength, eta * scale, eta), self.batch.own[:, :2])
            for scale in scales
        ]
        found = [fit for fit in (self.descent.from_afar(layout, state) for state in states) if fit is not None]
        if eta.size and (not found or min(item.cost for item in found) > _EXPLAINED * self.count):
            found += self._proposed((), None)
        return found

    def _set_fits(self, names: Set) -> list[Fit]:
        """Return fits of a set: from the sets it extends where these are near, else from the backbones."""
        layout = self.layout(names)
        parents = [self.fits[rest] for rest in combinations(names, len(names) - 1) if rest in self.fits]
        parents.sort(key=lambda parent: parent.cost)
        rival = min((item.cost for item in self.fits.values()), default=None)
        is_near = bool(parents) and parents[0].cost < _EXPLAINED * self.count
        found: list[Fit] = []
        if not is_near:
            found = self._proposed(names, rival)
        if is_near or not found:
            for parent in parents[:2] if len(names) > 1 else parents[:1]:
                self._was_asked(names, parent)
                found += self._extended(names, layout, parent, rival)
        return found

    def _extended(self, names: Set, layout: Layout, parent: Fit, rival: float | None) -> list[Fit]:
        """Return the fit of a set from that of a smaller one, to which the score says what the new effect adds."""
        new = next(name for name in names if name not in self._names(parent))
        promised = starts.by_score(layout, new, parent, self.batch)
        is_explained = parent.cost < _EXPLAINED * self.count
        promised = promised[:1] if is_explained else promised
        if is_explained and promised and promised[0][0] < _WORTH:
            near = self.descent.fit(
                layout, self.batch.deciding, promised[0][1], iterations=1, nuisances=self.batch.nuisances
            )
            if near is None or near.cost < parent.cost + _NOTED:
                return [] if near is None else [near]
            promised = [(promised[0][0], near.state)]  # one step did not turn the effect off again
        near = self.descent.from_near(layout, [state for _, state in promised], rival=rival)
        return [] if near is None else [near]

    def _proposed(self, names: Set, rival: float | None) -> list[Fit]:
        """Return fits from what the backbones propose for a set, until one keeps what they promise."""
        proposal = self.proposals.get(names)
        if proposal is None:
            return []
        layout = self.layout(names)
        found: list[Fit] = []
        ways: list[float] = []
        for promised, eta, own in proposal.starts:
            state = self.descent.released(layout, eta, own)
            reached = self.descent.from_afar(layout, state, rival, ways)
            found += [] if reached is None else [reached]
            if reached is not None and not self._is_lost(reached, promised):
                break
        return found

    def _is_lost(self, found: Fit, promised: float) -> bool:
        """Return whether a fit ended far above what the backbones promise: then another start may do better."""
        if found.cost < _POOR * self.count:
            return False
        reduced = level_chi_square(self.batch, found)
        values = sum(term.size for term in self.batch.levels)
        return not reduced < _LOST * max(promised / values, 1.0)

    def _names(self, found: Fit) -> Set:
        held = {effect.name for effect in self.base.effects}
        return tuple(effect.name for effect in found.layout.oscillator.effects if effect.name not in held)
