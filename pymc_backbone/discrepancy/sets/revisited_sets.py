"""Second looks at sets of effects: what one fit found may show where another lost its way."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..fitting import starts
from ..fitting.curves import frequencies
from ..fitting.descent import GLANCE, is_heavy
from ..fitting.joint_fit import Fit, parameters_of
from ..fitting.layout import Layout
from ..fitting.normal_equations import State
from ..proposals.proposal import Proposal
from ..proposals.set_fits import Set
from ..weighing import evidence
from .hysteretic_sets import ASKED_FOR, GAINED, NEAR_BY, REFUTED, HystereticSets
from .known_sets import POSSIBLE_BACKBONE

Kept = tuple[dict[Set, Fit], dict[Set, str], set[Set], float]
"""Fits, failures, refuted sets and the scatter that they were made with."""
CLOSE = 30.0
"""Chi-square within which a smaller set rivals the best."""
_LOOKED_BACK = 3
_SETTLED = 2
_CLOSE_TO_BASE = 1.0
_LOST_GAIN = 3.0  # promised over achieved, from which a fit has lost an effect
_HARDLY = 0.05  # share of what a refuted set leaves, which one more effect has to promise (it keeps ten times as much)
_FAR = 1000.0  # chi-square of the backbones above those of the best set, from which they are not doubted
_BEHIND, _BEHIND_BY_LOOKS = 30.0, 200.0
"""Logarithm of evidence of the backbones, simulated or looked at, by which a set is too far behind to begin beside the
best: an effect that both hold lets a larger set explain, and the rest of that is no rival."""
_RIVALS, _MOST_RIVALS = 7.0, 8  # logarithm of the odds within which sets rival the best, and how many are asked
_IDLE, _LOWER = 4, 0.5  # rivals in a row that lie no lower, after which no more are asked; and what is lower
_LAGGING = 2  # sets with a displacement that lags, that are begun in the other valley
_AS_GOOD = 6.0  # chi-square of the backbones within which a place is as good as the best
_HARDLY_MORE, _WEIGHTIER = 3.0, 1.0  # chi-square that a wider minimum may leave; logarithm of odds by which it counts


class RevisitedSets(HystereticSets):
    """Fitted sets, ranked, and fits begun again from where others ended."""

    def ranked(self, size: int | None = None) -> list[Set]:
        """Return the fitted sets, of one size or all, most probable first."""
        probability = evidence.probabilities(self.fits, self.batch, len(self.candidates), variants=self.variants)
        names = [name for name in self.fits if size is None or len(name) == size]
        return sorted(names, key=lambda name: -probability[name].log_posterior)

    def best(self, largest: int | None = None) -> Set:
        """Return the most probable set with at most ``largest`` effects."""
        limit = self.max_effects if largest is None else largest
        return next((name for name in self.ranked() if len(name) <= limit), ())

    def _is_costly(self, names: Set) -> bool:
        """Return whether a set takes much longer than the base does."""
        return is_heavy(self.layout(names)) and not is_heavy(self.layout(()))

    def _mind_scatter(self) -> None:
        """Begin again with effects that differ more between specimens, where only so a set explains the backbones."""
        asked = next(iter(self.proposals.values())).scatter
        if asked != self.scatter and self._is_any_possible(self.proposals.values()):
            self._begin_again(asked)

    def _begin_again(self, scatter: float) -> bool:
        """Forget all fits and fit the base with another scatter; return whether that can be simulated."""
        before, self.scatter = self._kept(), scatter
        self.fits, self.failed, self.refuted, self.unneeded = {}, {}, set(), {}
        self.layouts, self.asked, self.limited, self.noisy = {}, {}, (None, np.inf), {}
        if self.fit_set(()) is None:
            self._return_to(before)
            return False
        return True

    def _kept(self) -> Kept:
        """Return what was found, to return to it."""
        return self.fits, self.failed, self.refuted, self.scatter

    def _return_to(self, kept: Kept) -> None:
        """Take up what was found before the search began again."""
        self.fits, self.failed, self.refuted, self.scatter = kept
        self.layouts = {}

    def _look_again(self) -> None:
        """Fit single effects that have a shape, and lag behind, from their look in the backbones as well."""
        lowest = min(item.cost for item in self.fits.values())
        for name in self.candidates:
            known, has_shape = self.fits.get((name,)), len(starts.positions(self.layout((name,)), name)) > 1
            if known is not None and known.cost >= lowest + CLOSE and has_shape and not self._is_costly((name,)):
                self._keep_lower((name,), *self._proposed((name,), lowest))

    def _look_back(self) -> None:
        """Fit the subsets of the best sets again, from where these ended: a larger set may have found a better way."""
        lowest = min(item.cost for item in self.fits.values())
        is_explained = self._is_explained()
        for names in self.ranked()[:_LOOKED_BACK]:
            larger = self.fits[names]
            is_behind = is_explained and larger.cost > lowest + REFUTED
            if is_behind or self.is_refuted(names):
                continue
            for smaller in combinations(names, max(len(names) - 1, 0)):
                known = self.fits.get(smaller)
                close = GAINED if smaller else _CLOSE_TO_BASE  # whether anything is missing hangs on the base
                if not names or known is None or known.cost < larger.cost + close:
                    continue
                # what lies within a set that leaves more than noise leaves more than noise
                if (not is_explained and self.is_refuted(smaller)) or self._was_asked(smaller, larger):
                    continue
                layout, rival = self.layout(smaller), lowest if is_explained and smaller else known.cost
                found = self.descent.from_near(layout, [self._smaller(layout, larger)], rival=rival)
                if found is None or (found.cost > rival + REFUTED and not found.is_converged):
                    continue  # given up
                if found.cost < known.cost - 0.01:
                    self.fits[smaller] = found

    def _look_forward(self) -> None:
        """Fit sets again that hold a smaller one and explain less than it does: from where that ended."""
        for names in [*self.fits]:
            for smaller in combinations(names, max(len(names) - 1, 0)):
                known = self.fits.get(smaller)
                is_behind = known is not None and known.cost < self.fits[names].cost and self.explains(known)
                if names and known is not None and is_behind and not self._was_asked(names, known):
                    if self._is_spent:
                        self.is_cut = True
                        return
                    self._keep_lower(names, *self._extended(names, self.layout(names), known, None))

    def mend(self, names: Set) -> None:
        """Fit a set again from the smaller ones that leave less than it does: its own fit has lost its way."""
        if self.is_refuted(names):
            return
        for smaller in combinations(names, max(len(names) - 1, 0)):
            known = self.fits.get(smaller)
            if names and known is not None and known.cost < self.fits[names].cost:
                self._keep_lower(names, *self._extended(names, self.layout(names), known, None))

    def _look_within(self) -> None:
        """Fit the subsets that were not asked of sets that explain the records as well as the best.

        By their backbones they may have been left aside for a start that failed; here they begin beside the best.
        """
        if not self._is_explained() or not self.has_proposals:
            return
        best = self.best()
        near = [names for names, found in self.fits.items() if found.cost < self.fits[best].cost + CLOSE]
        asked = [part for names in near if len(names) > 1 for part in combinations(names, len(names) - 1)]
        for names in dict.fromkeys(asked):
            is_slow = self._is_costly(names) and not self._is_costly(best)
            is_left = is_slow or self._is_spent or self._is_behind(names)
            if names in self.fits or is_left or self._is_hopeless(names):
                continue
            found = self._beside(names, self.fits[best].cost)
            if found:
                self.fits[names] = found[0]

    def _look_closer(self) -> bool:
        """Fit the best set again where it gained far less than a linear step from a smaller one promises.

        Its fit has lost an effect on the way: one of no strength, at a shape from which nothing leads back. Only where
        no set explains the records; return whether that was mended.
        """
        best = self.best()
        if self._is_explained() or len(best) < 2 or self.is_refuted(best):
            return False
        before = self.fits[best]
        for smaller in combinations(best, len(best) - 1):
            known = self.fits.get(smaller)
            if known is None or not known.is_converged or known.cost > NEAR_BY * self.count:
                continue
            name = next(name for name in best if name not in smaller)
            promised = starts.by_score(self.layout(best), name, known, self.batch)
            if not promised or promised[0].gain < _LOST_GAIN * max(known.cost - self.fits[best].cost, REFUTED):
                continue
            self.progress("effects that were lost on the way", 0.5)
            self._keep_lower(best, *self._extended(best, self.layout(best), known, None))
        return self.fits[best] is not before

    def _complete(self) -> None:
        """Where the effort is spent, add to the best set what its score still asks for, as long as it does.

        A set that one more effect would improve is not complete, however little time is left to say so.
        """
        best = self.best()
        while self._is_explained() and not self.is_refuted(best) and len(best) < self.max_effects:
            gains = {name: self._score(best, name) for name in self.candidates if name not in best}
            name = max(gains, key=lambda key: gains[key], default=None)
            if name is None or gains[name] < ASKED_FOR:
                break
            self.progress("what the best set lacks", 0.5)
            larger = tuple(sorted((*best, name)))
            if self.fit_set(larger) is None:
                break
            for out in best:  # it may have made up for what was lacking
                smaller = tuple(other for other in larger if other != out)
                self._fit_within(smaller, larger)
            if self.best() == best:
                break
            best = self.best()

    def _fit_within(self, part: Set, names: Set) -> None:
        """Fit a part of a set from where that ended, if it was never fitted."""
        if part in self.fits:
            return
        layout = self.layout(part)
        found = self.descent.from_near(layout, [self._smaller(layout, self.fits[names])])
        if found is not None:
            self.fits[part] = found

    def _score(self, names: Set, name: str) -> float:
        """Return the fall of chi-square that a linear step promises for one effect more; none where it was fitted."""
        larger = tuple(sorted((*names, name)))
        if larger in self.fits:
            return 0.0
        promised = starts.by_score(self.layout(larger), name, self.fits[names], self.batch)
        return max((item.gain for item in promised), default=0.0)

    def _is_far(self, names: Set) -> bool:
        """Return whether a set is so far behind the best by its backbones that no better start would bring it near."""
        best, known = self._proposal(self.best()), self._proposal(names)
        if best is None or known is None or not (best.is_exact and known.is_exact):
            return False
        return best.chi_square < POSSIBLE_BACKBONE * self._level_values and known.chi_square > best.chi_square + _FAR

    def _is_behind(self, names: Set) -> bool:
        """Return whether the backbones of a set are much less likely than those of the best, which explains these."""
        best, known = self._proposal(self.best()), self._proposal(names)
        if best is None or known is None or best.chi_square > POSSIBLE_BACKBONE * self._level_values:
            return False
        most = _BEHIND if best.is_exact and known.is_exact else _BEHIND_BY_LOOKS
        return known.log_evidence < best.log_evidence - most

    def _is_hopeless(self, names: Set) -> bool:
        """Return whether the samples refute a set without one of its effects, and this would hardly bring it nearer.

        What a linear step promises there. Backbones ask for such sets where they do not see what the samples do.
        """
        lowest = min(item.cost for item in self.fits.values())
        for name in names:
            smaller = tuple(other for other in names if other != name)
            known = self.fits.get(smaller)
            if not smaller or known is None or not known.is_converged or known.cost < lowest + REFUTED:
                continue
            if self._score(smaller, name) < _HARDLY * (known.cost - lowest):
                return True
        return False

    def _smaller(self, layout: Layout, larger: Fit) -> State:
        """Return where a larger set ended as a start of a smaller one, whose springs replace what is left out."""
        state = starts.restricted(layout, larger.layout, larger.state)
        own = state.own
        for r, term in enumerate(self.batch.levels):
            before = frequencies(larger.layout, larger.parameters(r), term)
            after = frequencies(layout, parameters_of(layout, state, r), term)
            change = self.base.mass * (2.0 * np.pi) ** 2 * np.mean(before**2 - after**2)
            if np.isfinite(change) and own[r, 0] + change > 0.0:
                own[r, 0] += change
        return state

    def _begin_otherwise(self) -> bool:
        """Begin the most probable sets again from elsewhere; return whether another one is the most probable then.

        With specimens that are alike, and from their own look in the backbones where they were only begun beside
        another set. What has a kink or a memory rests in one of several dents, and its evidence with it: of dents that
        leave the same the likeliest counts. No more are asked where some in a row lie no lower.
        """
        best = self.best()
        if self.is_refuted(best) or not self.explains(self.fits[best]):
            return False
        idle = 0
        for names in self._rivals():
            known, proposal = self.fits[names], self._proposal(names)
            self.progress("the most probable sets, begun otherwise", 0.5)
            found = [self.descent.begun_alike(known, GLANCE)] if len(self.batch.specimens) > 1 else [known]
            if proposal is not None and (names, id(proposal)) not in self.asked:
                found += self._proposed(names, known.cost)
            found += self._other_minima(names, proposal)
            self.fits[names] = self._weightiest(found)
            idle = 0 if self.fits[names].cost < known.cost - _LOWER else idle + 1
            if idle == _IDLE:
                break
        return self.best() != best

    def _other_minima(self, names: Set, proposal: Proposal | None) -> list[Fit]:
        """Return the fits of a set from where its backbones are as good as at the best place, but elsewhere."""
        if proposal is None or (names, id(proposal.starts)) in self.asked:
            return []
        self.asked[names, id(proposal.starts)] = proposal.starts
        (lowest, _, _), *others = proposal.starts
        near = [(eta, own) for promised, eta, own in others if promised < lowest + _AS_GOOD]
        layout = self.layout(names)
        found = (self.descent.from_afar(layout, self.descent.released(layout, eta, own)) for eta, own in near)
        return [item for item in found if item is not None]

    def _weightiest(self, minima: Sequence[Fit]) -> Fit:
        """Return the lowest minimum of a set; or one that leaves hardly more, and is so much wider that it is likelier.

        A small gap between stiff stops and one that closes near the largest amplitude may leave the same.
        """
        lowest = min(minima, key=lambda item: item.cost)
        scale = evidence.noise_scale(self.fits, self.batch)

        def weight(item: Fit) -> float:
            return evidence.laplace(item, scale) + item.scatter.log_evidence - _WEIGHTIER * (item is not lowest)

        near = [item for item in minima if item.is_converged and item.cost < lowest.cost + _HARDLY_MORE]
        return max([lowest, *near], key=weight)

    def _rivals(self) -> list[Set]:
        """Return the best set and those that are nearly as probable, but for what has no shape, or costs much.

        And but for what adds to the best set: that began where this one ended.
        """
        probability = evidence.probabilities(self.fits, self.batch, len(self.candidates), variants=self.variants)
        best = self.best()
        least = probability[best].log_posterior - _RIVALS
        near = [names for names in self.ranked() if probability[names].log_posterior > least]
        apart = [names for names in near if not set(best) < set(names) and not self.layout(names).is_strength.all()]
        return [names for names in apart if not is_heavy(self.layout(names))][:_MOST_RIVALS]

    def _begin_from_smaller(self) -> None:
        """Where no fit has kept the phase, begin the lowest set from the lower one within it, small at first.

        The turning points may have refuted it from a start that had lost its way.
        """
        names = min(self.fits, key=lambda item: self.fits[item].cost)
        within = [self.fits[part] for part in combinations(names, max(len(names) - 1, 0)) if part in self.fits]
        if len(names) < 2 or not within or self.fits[names].cost < NEAR_BY * self.count or not self.batch.has_records:
            return
        layout, parent = self.layout(names), min(within, key=lambda item: item.cost)
        new = next(name for name in names if name not in self._names(parent))
        promised = starts.by_score(layout, new, parent, self.batch)
        for state in [*(item.small for item in promised), *(item.moved for item in promised)]:
            self.progress("sets that have lost their way", 0.5)
            self._keep_lower(names, self.descent.from_near(layout, [state], rival=self.fits[names].cost))
            if self.explains(self.fits[names]):
                return

    def _look_in_other_valley(self) -> None:
        """Fit the likeliest sets with a displacement that lags from the linear step from each smaller one.

        One that saturates early and one that does so late leave nearly the same, and a fit finds no way from one valley
        to the other: each start goes to its end.
        """
        lagging = [names for names in self.ranked() if self.layout(names).lags and self.explains(self.fits[names])]
        for names in lagging[:_LAGGING]:
            for name in names:
                parent = self.fits.get(tuple(other for other in names if other != name))
                for promised in [] if parent is None else starts.by_score(self.layout(names), name, parent, self.batch):
                    self._keep_lower(names, self.descent.from_near(self.layout(names), [promised.moved]))

    def _settle(self) -> None:
        """Carry the fit of the best set on if it did not come to rest; and others near it, or where nothing explains.

        Those that were noted with one step may have more to gain than it promised.
        """
        best = self.best()
        if not (self.is_refuted(best) or self.fits[best].is_converged):
            self._carry_on(best)
        if self._is_explained():
            near = [names for names, item in self.fits.items() if item.cost < self.fits[best].cost + CLOSE]
            for names in [names for names in near if not self.fits[names].is_converged]:
                if not (self._is_spent and self._is_costly(names)):
                    self._carry_on(names)
            return
        open_sets = (names for names in self.ranked() if not self.is_refuted(names))
        restless = [names for names in open_sets if not self.fits[names].is_converged]
        for names in restless[:_SETTLED]:
            if self._is_spent:
                self.is_cut = True
                break
            self._carry_on(names)

    def _carry_on(self, names: Set) -> None:
        """Go on with the fit of a set from where it ended."""
        known = self.fits[names]
        self._keep_lower(names, self.descent.from_near(known.layout, [known.state]))


__all__ = ["CLOSE", "RevisitedSets"]
