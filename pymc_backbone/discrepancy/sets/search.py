"""The search over sets of effects: backbones propose, all sets at once; waveforms decide, the likeliest first."""

from __future__ import annotations

from functools import partial
from itertools import batched

import numpy as np

from ..._common.threads import in_threads
from ..fitting.curves import relative_change
from ..fitting.joint_fit import Fit
from ..fitting.scatter import SCATTER, WIDE_SCATTER
from ..proposals.propose import propose
from ..proposals.set_fits import Set
from ..weighing import evidence
from .enlarged_sets import EnlargedSets
from .followed_sets import FEW_FOLLOWED, REACH
from .known_sets import POSSIBLE_BACKBONE
from .side_by_side import ABREAST, fit_side_by_side

_ROUNDS = 2
_MOST_FOLLOWED = 24  # sets that are followed from the backbones to the waveforms before anything explains these
_CLEARLY = 5.0  # logarithm of evidence by which wider scatter must be likelier
_COSTLY_SETTLED, _COSTLY_REACH = 4, 3.0  # costly sets that are asked although what is simple leaves noise, their reach
_COSTLY_SIMPLER = 2  # costly sets of fewer effects than the best has, that are asked whatever was spent
_PROMISING = 3  # simple sets that are asked at a time what they lack
_WORTH_MORE = 10.0  # reduced chi-square up to which they are
_MOST = 0.5  # of what such a set leaves beyond the noise, that one more effect has to promise
_SURELY = 0.5  # share of the tolerance within which further effects would not change the answer
_OF_TWO_SIDES, _OF_CONTACT = "asymmetry", "clearance"  # mechanisms
_WITH_SIDES = 3  # single effects that are asked beside one of these where no mid-line is measured
_RESERVE = 2.0  # of the budget, that is kept for what the best set may lack and for other laws in it
_NEAR = 1.5  # reduced chi-square of a fit to the samples from which its backbones were judged wrongly


class Search(EnlargedSets):
    """The search over sets: what is fitted, in which order, and when it is enough."""

    def run(self) -> None:
        """Fit the base, the sets that the backbones propose, and what lies around the best of them."""
        self.progress("base model", 0.0)
        self.fit_set(())
        if () not in self.fits:
            return
        ends = self._ends_alone() if self._is_explained() else self._ends_following()
        if ends:
            return
        self._ask_two_sides()
        self._look_back()
        self._look_forward()  # from the base, where a larger set led it to a better place
        if self._is_answered() or (self.is_cut and self.is_refuted(self.best())):
            return
        self._ask_common()
        self._enlarge()
        self._vary()
        self._ask_reserved()
        if self.is_cut:
            self._keep_reserve()
            self._complete()
        self._keep_reserve()
        self._ask_kindred()
        self._ask_parts()
        if self._begin_otherwise() and not self._is_spent:
            self._enlarge()
        self._look_back()
        self._keep_reserve()
        self._look_in_other_valley()
        self._settle()

    def _ends_alone(self) -> bool:
        """Ask single effects, where the model as it is explains the records; return whether the search ends there."""
        self._ask_single_effects()
        self._settle()
        if self._is_halted() or self._is_answered():  # noise that was estimated from records with a line holds it
            return True
        self._look_again()
        return False

    def _ends_following(self) -> bool:
        """Follow the backbones to the records, of which the base leaves much; return whether the search ends there."""
        self._mind_scatter()
        if self._is_beyond():
            self._follow_backbones(FEW_FOLLOWED)
            if self.halted is not None or self._is_drift_likelier():
                return True
            if self.batch.lacks_mid_line:
                self._ask_plain_effects()
            if min(item.cost for item in self.fits.values()) > _NEAR * self.count:
                return self._look_around()
        self._follow_backbones(_MOST_FOLLOWED)
        if self.halted is not None or self._is_drift_likelier():
            return True
        self.drift_alone = None  # a set explains them as well: the drift is asked beside it
        self._ask_plain_effects()
        self._look_wider()
        self._begin_from_smaller()
        return self._is_far_off() and self._look_around()

    def _look_around(self) -> bool:
        """Look at what lies next to the best set, and end: none leaves noise, and backbones say what is missing."""
        self._look_back()
        self._vary()
        self._ask_reserved()
        return True

    def _keep_reserve(self) -> None:
        """Leave the last looks at the best set enough effort to end: others were asked at its cost."""
        self.descent.limit = max(self.descent.limit, self.descent.effort + _RESERVE * self.budget)

    def resume(self) -> None:
        """Go on to the end with a search that was halted, or short because a drift explains the records."""
        if self.halted is not None or self.is_told:
            self.halted, self.drift_alone = None, None
            self.run()

    def _ask_single_effects(self) -> None:
        """Fit every effect by itself, until all that is missing is within the tolerance."""
        single: list[Set] = sorted(((name,) for name in self.candidates), key=self._is_costly)
        for k, few in enumerate(batched(single, ABREAST)):
            self.progress("single effects", min(ABREAST * (k + 1) / len(single), 1.0))
            simple = [names for names in few if not self._is_costly(names)]
            is_enough = len(simple) < len(few) and self._is_tolerable()
            fit_side_by_side(self, simple if is_enough else few)
            if is_enough:
                break

    def _ask_plain_effects(self) -> None:
        """Where nothing explains the records, fit all that is soon simulated by itself, whatever its backbones.

        A structure of two sides whose mid-line is not measured has backbones that tell little, and damping that is off:
        what its samples show at once lies below sets that follow that error.
        """
        plain: list[Set] = [(name,) for name in self.candidates if (name,) not in self.fits]
        for few in batched([names for names in plain if not self._is_costly(names)], ABREAST):
            if self._is_explained():
                return
            self.progress("single effects", 0.5)
            fit_side_by_side(self, few)
        if not self.batch.lacks_mid_line or self.max_effects < 2:
            return
        # what differs between the two sides is in the samples, whatever else is missing
        sides = [name for name in self.candidates if self.mechanism_of(name) == _OF_TWO_SIDES]
        single = [names for names in self.ranked(1) if len(names) == 1]
        with_side = {tuple(sorted({*names, side})) for names in single[:_WITH_SIDES] for side in sides}
        pairs = sorted(
            names
            for names in with_side
            if len(names) == 2 and (set(single[0]) < set(names) or not self._is_costly(names))
        )
        for few in batched(pairs, ABREAST):
            fit_side_by_side(self, few)

    def _ask_two_sides(self) -> None:
        """Where no mid-line is measured, fit springs of two sides in the place of what the best set has there.

        Its backbones are far off then, and contacts imitate it: a gap on one side, off the middle, is a spring of two
        sides but for what it does near zero.
        """
        best = self.best()
        if not (self.batch.lacks_mid_line and self._is_explained()) or self.is_refuted(best):
            return
        sides = [name for name in self.candidates if self.mechanism_of(name) == _OF_TWO_SIDES and name not in best]
        replaced = [name for name in best if self.mechanism_of(name) in (_OF_TWO_SIDES, _OF_CONTACT)]
        sets = [tuple(sorted({*best, side} - {name})) for name in replaced for side in sides]
        for few in batched([names for names in sets if not self._is_hopeless(names)], ABREAST):
            self.progress("springs that differ between the two sides", 0.5)
            fit_side_by_side(self, few)

    def _ask_promised(self) -> None:
        """Add to simple sets near the records what a linear step promises most of, while none leaves noise.

        A law of many parameters may come nearer in the backbones than the simple ones of which one is still missing.
        The nearest are asked whatever was spent: no search ends one effect short of noise for want of effort.
        """
        asked: set[Set] = set()
        for _ in range(self.max_effects - 1):
            near = [
                names
                for names in sorted(self.fits, key=lambda item: self.fits[item].cost)
                if names and len(names) < self.max_effects and names not in asked and self._is_worth_more(names)
            ][:_PROMISING]
            if self._is_settled() or (self._is_spent and asked) or not near:
                return
            asked.update(near)
            self.progress("what simple sets lack", 0.5)
            wanted = [larger for larger in map(self._promised, near) if larger is not None]
            for few in batched(dict.fromkeys(wanted), ABREAST):
                fit_side_by_side(self, few)

    def _is_worth_more(self, names: Set) -> bool:
        """Return whether a set is simple, and near enough to the records for a linear step from it."""
        is_near = self.fits[names].cost < _WORTH_MORE * self.count
        return is_near and not self._is_costly(names) and not self.is_refuted(names)

    def _promised(self, names: Set) -> Set | None:
        """Return a set with the simple effect that a linear step promises most of; None where that is not most."""
        others = [name for name in self.candidates if name not in names and not self._is_costly((name,))]
        for name in others:
            self.layout(tuple(sorted((*names, name))))
        gains = dict(zip(others, in_threads([partial(self._score, names, name) for name in others]), strict=True))
        most = max(others, key=lambda item: gains[item], default=None)
        if most is None or gains[most] < _MOST * (self.fits[names].cost - self.count):
            return None
        return tuple(sorted((*names, most)))

    def _enlarge(self) -> None:
        """Fit larger sets around the best, others in the place of its effects, and at last what costs much."""
        self._ask_promised()
        for size in range(2, self.max_effects + 1):
            before = self.best(size - 1)
            parents = self._parents(size - 1)
            if not parents or (size > 2 and len(before) < size - 1 and self._is_explained()):
                break
            self._extend(parents, size)
            self._look_back()
        for _ in range(_ROUNDS if self._is_explained() else 1):
            if not self._replace():
                break
            self._look_back()
        if self._look_closer() and self._replace():
            self._look_back()
        self._look_forward()
        self._keep_reserve()
        self._look_elsewhere()
        self._look_within()
        self._look_back()
        if self._ask_costly() and self._replace():
            self._look_back()

    def _is_answered(self) -> bool:
        """Return whether the model as it is will do, whatever else larger sets may show."""
        if not self._is_explained():
            return False
        nothing = all((name,) in self.fits for name in self.candidates) and (
            evidence.p_nothing_missing(self.fits, self.batch) > evidence.MISSING
        )
        return nothing or self._is_tolerable()

    def _is_tolerable(self) -> bool:
        """Return whether the best set will do, and changes the backbones by less than half the tolerance."""
        limits = {key: limit for key, limit in self.tolerance.items() if key != "waveform"}
        best = self.best()
        if not best or not any(limits.values()) or not self._is_explained():
            return False
        if evidence.is_unexplained(evidence.lack_of_fit(self.batch, self.fits[best]), self.tolerance):
            return False
        change = relative_change(self.batch, self.fits[best], self.fits[()])
        return all(change[key] < _SURELY * limit for key, limit in limits.items())

    def _is_beyond(self) -> bool:
        """Return whether no set explains the backbones; then none explains the records, and mechanisms are asked."""
        return not self._is_any_possible(self.proposals.values())

    def _look_wider(self) -> None:
        """Where nothing explains the records, look at effects that differ more between specimens, if that is likelier.

        Sets of several effects may imitate in the backbones what wide scatter makes of a simpler one. Not where all are
        far off the records: that specimens differ costs little beside that.
        """
        if self._is_explained() or self._is_far_off() or self._is_spent:
            return
        if self.scatter != SCATTER or len(self.batch.specimens) < 2:
            return
        narrow, before = self.proposals, self._kept()
        likeliest = next(iter(narrow.values())).log_evidence
        wide = propose(
            self.batch, self.base, self.candidates, self.max_effects, self.own, self.variants, scatter=WIDE_SCATTER
        )
        if wide[0].log_evidence < likeliest + _CLEARLY or not self._is_any_possible(wide):
            return
        self.proposals = {item.names: item for item in wide}
        if self._begin_again(WIDE_SCATTER):
            self._follow_backbones(_MOST_FOLLOWED)
            if self._is_explained():
                return
        self.proposals = narrow
        self._return_to(before)

    def _ask_costly(self) -> bool:
        """Fit the costly sets that explain the backbones as well as what explains the records does.

        Where that leaves noise and costs little, only the likeliest of those that have no more effects; where the
        effort is spent, of those that have fewer: several simple effects may follow what one with a memory does. Return
        whether one of them is now the best.
        """
        if not self._is_explained() or not self.has_proposals:
            return False
        explained = [names for names, found in self.fits.items() if names and self.explains(found)]
        known = [self.proposals[names].log_evidence for names in explained if names in self.proposals]
        is_settled = self._is_settled()
        least = max(known, default=np.inf) - (_COSTLY_REACH if is_settled else REACH)
        before, fitted = self.best(), 0
        largest = len(before) if is_settled else self.max_effects
        for names, proposal in self.proposals.items():
            if proposal.log_evidence < least or (is_settled and fitted >= _COSTLY_SETTLED):
                break
            if self._is_spent and not (len(names) < len(before) and fitted < _COSTLY_SIMPLER):
                continue
            is_new = names not in self.fits and not any(set(smaller) < set(names) for smaller in explained)
            if is_new and self._is_costly(names) and len(names) <= largest:
                self.progress("sets with states of their own", 0.5)
                self.fit_set(names)
                fitted += 1
        return self.best() != before

    def is_open(self, names: Set) -> bool:
        """Return whether the fit of a set did not come to rest although the set could explain the backbones."""
        found = self.fits[names]
        if found.is_converged or self.explains(found) or not names or not self.has_proposals:
            return False
        proposal = self.proposals.get(names)
        return proposal is None or proposal.chi_square < POSSIBLE_BACKBONE * self._level_values

    def reduced(self, found: Fit) -> float:
        """Return the reduced chi-square of a fit."""
        return float(found.chi_square.sum() / self.count)


__all__ = ["Search", "Set"]
