"""Sets with variants of their effects: each is kept where it leaves less than what it varies does in its place."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import batched, combinations

import numpy as np

from ..._common.threads import in_threads
from ...effects import LIBRARY
from ..fitting import equal_forces
from ..fitting.joint_fit import Fit
from ..proposals.propose import propose
from ..proposals.set_fits import Set
from ..weighing import evidence
from .hysteretic_sets import NEAR_BY
from .revisited_sets import CLOSE, RevisitedSets
from .side_by_side import ABREAST, fit_side_by_side

_LIKELIEST = 4  # sets whose variants are replaced by what they vary
_OVERDRAWN = 1.3  # of the budget, up to which variants are asked where that is spent
_AS_LIKELY = 4.0  # logarithm of evidence of the backbones, within which others with variants are asked ...
_AS_LIKELY_ALONE = 30.0  # ... within which a variant alone is, where the best set takes several effects ...
_MOST_PROMISED = 8  # ... and how many
_COMMON = 3  # sets without a variant, of those that leave as little of the backbones as one with a variant does
_LACKING = 3  # likeliest sets without a variant, to which one more effect may be added
_AS_MUCH = 0.5  # of what the effect that is replaced gained, that another promises at least
_MOST_REPLACED = 4  # such sets for each effect of the best one
NEEDED = 5.0
"""Chi-square by which a less simple set of the same mechanisms must leave less."""


class VariedSets(RevisitedSets):
    """Fitted sets, and those that hold variants of their effects."""

    def _vary(self) -> None:
        """Fit the best set with variants in the place of its effects, and keep no variant that explains no more.

        What explains no more than the effect that it varies is said by that one. In the place of a variant stand the
        others of what it varies: a stop on one side for a play that lies off the middle.
        """
        best = self.best()
        for name in best if not self.is_refuted(best) else ():
            for variant in self.variants:
                self._vary_one(best, name, variant)
        for few in batched(self._promised_variants(), ABREAST):
            self.progress("variants of effects", 0.5)
            fit_side_by_side(self, few)
        for few in batched(self._in_place_of_memory(), ABREAST):
            self.progress("variants of effects", 0.5)
            fit_side_by_side(self, few)
        self._ask_plain()
        self._ask_common()
        self._drop_unneeded()

    def _drop_unneeded(self) -> None:
        """Forget the sets with a variant that explains no more than what it varies does in its place."""
        for names in [names for names in self.fits if not self._is_needed(names)]:
            self.unneeded[names] = self.fits.pop(names)

    def _ask_common(self) -> None:
        """Where the best set holds variants, fit sets of none whose backbones leave hardly more, however improbable.

        A law of many parameters is charged for them by its backbones before its samples say what it is worth; a rare
        one that was asked alone has no name. And fit one more effect beside the likeliest plain sets, where a
        linear step promises most of what they leave more: a free exponent stands for two plain springs.
        """
        best = self.best()
        known = self.proposals.get(best) if self.has_proposals else None
        is_rare = not {*best}.isdisjoint(self.variants)
        if known is None or not is_rare or self.is_refuted(best) or not self.explains(self.fits[best]):
            return
        explained = [
            names
            for names in self.ranked()
            if names and {*names}.isdisjoint(self.variants) and self.explains(self.fits[names])
        ]
        common = [
            names
            for names, item in self.proposals.items()
            if item.is_exact and item.chi_square < known.chi_square + NEEDED and {*names}.isdisjoint(self.variants)
        ]
        asked = [names for names in common if not any({*smaller} <= {*names} for smaller in explained)][:_COMMON]
        for names in explained[:_LACKING]:
            lacking = self.fits[names].cost - self.fits[best].cost
            if len(names) == self.max_effects or lacking < NEEDED:
                continue
            gains = {name: self._score(names, name) for name in self.candidates if name not in names}
            most = max(gains, key=lambda name: gains[name], default=None)
            if most is not None and gains[most] > 0.5 * lacking:
                asked.append(tuple(sorted((*names, most))))
        for names in asked:
            self.progress("what rare laws may imitate", 0.5)
            self.fit_set(names)

    def _add_variants(self) -> None:
        """Where nothing leaves noise, add to what is near the variant that a linear step promises most of.

        Backbones look at variants in the place of what they vary: not at one beside effects that are there as well.
        """
        best = self.best()
        if not self.batch.has_records or self.is_refuted(best) or evidence.leaves_noise(self.batch, self.fits[best]):
            return
        by_cost = sorted((item.cost, names) for names, item in self.fits.items() if len(names) < self.max_effects)
        for cost, names in [item for item in by_cost if item[0] < NEAR_BY * self.count and item[1]][:_LACKING]:
            others = [name for name in self.variants if name not in names]
            for name in others:
                self.layout(tuple(sorted((*names, name))))
            gains = dict(zip(others, in_threads([partial(self._score, names, name) for name in others]), strict=True))
            most = max(others, key=lambda name: gains[name], default=None)
            if most is not None and gains[most] > _AS_MUCH * (cost - self.count):
                self.progress("variants of effects", 0.5)
                self.fit_set(tuple(sorted((*names, most))))

    def _ask_reserved(self) -> None:
        """Where nothing explains the records, fit what is otherwise looked for by name only, alone and in the best set.

        The backbones of one mode do not show such a law; what its force does within a cycle may be all that is left.
        It is as rare as a variant, and kept where it explains the records. Beside a set that is far off all of them it
        is not asked: one effect more brings none of these to the noise.
        """
        self._add_variants()
        best = self.best()
        if not self.batch.has_records or evidence.leaves_noise(self.batch, self.fits[best]):
            return
        for name in self.reserved:
            beside = [] if self._is_far_off() else [tuple(sorted({*best, name}))]
            for names in dict.fromkeys([(name,), *beside]):
                if len(names) > self.max_effects or names in self.fits or self._is_costly(names):
                    continue
                self.progress("what backbones do not show", 0.5)
                found = self.fit_set(names)
                if found is not None and evidence.leaves_noise(self.batch, found):
                    self.variants = tuple(dict.fromkeys((*self.variants, name)))
                else:
                    self.fits.pop(names, None)

    @property
    def _is_overdrawn(self) -> bool:
        """Return whether variants took so much beyond the budget that no more are asked beside what explains."""
        return self.descent.effort > _OVERDRAWN * self.budget

    def _promised_variants(self) -> list[Set]:
        """Return sets with variants that were not fitted and whose backbones are as likely as those of the best set.

        What they vary may be far off, and a law of many parameters come near in their place; or several simple effects
        in that of one variant, which they follow more closely where the errors of the backbones are.
        """
        best = self.best()
        if self.is_refuted(best) or not self.explains(self.fits[best]) or best not in self.proposals:
            return []
        most = self.proposals[best].log_evidence
        near = [
            names
            for names, item in self.proposals.items()
            if len(names) <= len(best)
            and item.log_evidence > most - (_AS_LIKELY_ALONE if len(names) == 1 < len(best) else _AS_LIKELY)
        ]
        new = [names for names in near if names not in self.fits and not {*names}.isdisjoint(self.variants)]
        return [names for names in new if not (self._is_costly(names) or self._is_far(names))][:_MOST_PROMISED]

    def _in_place_of_memory(self) -> list[Set]:
        """Return sets with variants that a linear step promises in the place of what remembers in the best set.

        A slider beside a gap stands in for what acts beyond the gap only, which is no variant of a slider.
        """
        best = self.best()
        if len(best) < 2 or self.is_refuted(best) or not self.explains(self.fits[best]):
            return []
        promised: list[Set] = []
        for name in best:
            rest = tuple(other for other in best if other != name)
            if (self.own.get(name) or LIBRARY[name]).n_states:
                varied = [tuple(sorted((*rest, variant))) for variant in self.variants if variant not in best]
                promised += self._promised_in_place(varied, rest)
        return promised

    def _promised_in_place(self, sets: Sequence[Set], rest: Set) -> list[Set]:
        """Return those sets that a linear step from what they share with the best one brings near, most first.

        No law is named that another one would have beaten, had there been the effort to ask.
        """
        known, best = self.fits.get(rest), self.best()
        if known is None or not known.is_converged or self.is_refuted(rest):
            return []
        new = [names for names in sets if names not in self.fits and not self._is_costly(names)]
        least = _AS_MUCH * (known.cost - self.fits[best].cost)
        for names in new:
            self.layout(names)
        beside = [next(name for name in names if name not in rest) for names in new]
        gains = in_threads([partial(self._score, rest, name) for name in beside])
        ranked = sorted(zip(gains, new, strict=True), reverse=True)
        return [names for gain, names in ranked[:_MOST_REPLACED] if gain > least]

    def _vary_one(self, varied: Set, name: str, variant: str) -> None:
        """Fit a set with a variant in the place of one of its effects, where that is new and worth its cost."""
        names = tuple(sorted({*(other for other in varied if other != name), variant}))
        is_new = variant != name and len(names) == len(varied) and names not in self.fits
        if not (is_new and is_akin(name, variant)) or (self._is_costly(names) and not self._is_costly(varied)):
            return
        is_overdrawn = self._is_overdrawn and not (name in self.variants and variant in LIBRARY[name].reduces_to)
        if self._is_spent and (self._is_costly(names) or (is_overdrawn and self._is_explained())):
            return  # the few that are soon fitted are asked all the same: beyond the budget where nothing explains yet
        self.progress("variants of effects", 0.5)
        found = self._fit_varied(names)
        if self._is_needed(names) and found is not None and self.explains(found):
            for out in varied:  # what stood beside the effect may have made up for its lack
                if out != name:
                    self._fit_varied(tuple(other for other in names if other != out))

    def _vary_two(self, varied: Set) -> None:
        """Fit sets with a variant in the place of two effects of one that explains: from where it has their force.

        A free exponent stands for two plain springs, and its backbones may have led nowhere.
        """
        known = self.fits[varied]
        for variant in self.variants if not self.is_refuted(varied) and self.explains(known) else ():
            for two in combinations([name for name in varied if is_akin(name, variant)], 2):
                names = tuple(sorted({*varied, variant}.difference(two)))
                if variant in varied or (names in self.fits and self.fits[names].cost < known.cost + NEEDED):
                    continue
                self.progress("variants of effects", 0.5)
                self._keep_lower(names, *self._of_equal_force(self.layout(names), known))

    def _plain(self, names: Set, *, is_reduced: bool = False) -> list[Set]:
        """Return the sets that hold what a variant in this one varies, or reduces to (or that alone), in its place."""
        return [
            tuple(sorted({*(other for other in names if other != variant), name}))
            for variant in sorted({*names}.intersection(self.variants))
            for name in (*(() if is_reduced else LIBRARY[variant].variant_of), *LIBRARY[variant].reduces_to)
        ]

    def plainer(self, names: Set) -> list[Set]:
        """Return the sets with a plain law in the place of a variant: something else may be what the variant is for."""
        return [
            tuple(sorted({*names, plain} - {name}))
            for name in names
            if name in self.variants
            for plain in self.candidates
            if plain not in names and is_akin(plain, name)
        ]

    def _ask_plain(self) -> None:
        """Fit what variants of the likeliest sets vary once more, from there: its own fits may have lost their way.

        Where the effort is spent, of what explains the records alone: else backbones decide, and no law is named. What
        a variant reduces to is asked whatever was spent: where it explains as much, the variant has no name.
        """
        for names in self.ranked()[:_LIKELIEST]:
            varied = self.fits[names]
            if self.is_refuted(names) or (self._is_spent and not self.explains(varied)):
                continue
            for plain in self._plain(names, is_reduced=self._is_spent and self._is_overdrawn):
                known, is_possible = self.fits.get(plain), {*plain} <= {*self.candidates, *self.variants}
                if not is_possible or (known is not None and known.cost < varied.cost + NEEDED):
                    continue
                self.progress("what variants vary", 0.5)
                layout = self.layout(plain)
                if len(plain) < len(names):
                    state = self._smaller(layout, varied)
                else:
                    state = equal_forces.in_place_of(layout, varied, self.batch.angular_frequency)
                found = self.descent.from_near(layout, [state])
                if found is not None and (known is None or found.cost < known.cost):
                    self.fits[plain] = found

    def _ask_kindred(self) -> None:
        """Fit what has another law of the same mechanism in the place of one of the best set, where that was not asked.

        A law is named among those of its mechanism, however little effort is left and whatever start its backbones
        ended at: beside the best it begins near.
        """
        best: Set | None = None
        while best != self.best():
            best = self.best()
            if not best or self.is_refuted(best) or not self.explains(self.fits[best]):
                return
            self._vary_two(best)
            is_dear = self._is_spent and self._is_costly(best)
            variants = () if is_dear else self.variants
            for out in best:
                mechanism = self.mechanism_of(out)
                kindred = [name for name in (*self.candidates, *variants) if self.mechanism_of(name) == mechanism]
                for names in [tuple(sorted({*best, name} - {out})) for name in kindred if name not in best]:
                    is_known = names in self.fits and (is_dear or self.fits[names].cost < self.fits[best].cost + NEEDED)
                    is_left = is_known or self._is_far(names) or self._is_hopeless(names)
                    if not is_left or self._has_lost_its_way(names, best):
                        self.progress("other laws of the same mechanisms", 0.5)
                        self._keep_lower(names, *self._beside(names, self.fits[best].cost))
            self._drop_unneeded()

    def _has_lost_its_way(self, names: Set, best: Set) -> bool:
        """Return whether a set was fitted far above the best, though its simulated backbones leave as little."""
        known = self.fits.get(names)
        if known is None or known.cost < self.fits[best].cost + CLOSE:
            return False
        of_best, of_set = self._proposal(best), self._proposal(names)
        if of_best is None or of_set is None or not (of_best.is_exact and of_set.is_exact):
            return False
        return of_set.chi_square < of_best.chi_square + NEEDED

    def _is_needed(self, names: Set) -> bool:
        """Return whether a fitted set leaves less than it does with what a variant in it varies in its place.

        What is of another mechanism and no simpler does not say the same: its evidence decides.
        """
        known = [
            self.fits[plain].cost for plain in self._plain(names) if plain in self.fits and self._says(plain, names)
        ]
        return names not in self.fits or not min(known, default=np.inf) < self.fits[names].cost + NEEDED

    def _says(self, plain: Set, names: Set) -> bool:
        """Return whether a set says what another says that explains no more: it is simpler, or of its mechanisms."""
        kinds = [sorted(self.mechanism_of(name) for name in some) for some in (plain, names)]
        return kinds[0] == kinds[1] or self.layout(plain).free.size < self.layout(names).free.size

    def _fit_varied(self, names: Set) -> Fit | None:
        """Return the fit of a set with a variant, begun from its look in the backbones; None where that is far off.

        What was looked at among many and not simulated may have lost its way beside the likeliest of them: it is looked
        at once more alone.
        """
        known = self._proposal(names) if self.has_proposals else None
        if names not in self.fits and (known is None or not known.is_exact):
            looks = propose(self.batch, self.base, names, len(names), self.own)
            self.varied[names] = next(item for item in looks if set(item.names) == set(names))
        return None if self._is_far(names) else self.fit_set(names)

    def _ask_parts(self) -> None:
        """Fit what is in the best set and was never fitted, from where that ended, whatever its backbones say.

        Those of a motion whose mid-line is lost, or behind a filter, may put it far off: a stop on one side had been
        named with a clearance that did nothing.
        """
        best: Set | None = None
        while best != self.best():
            best = self.best()
            is_blind = self.batch.lacks_mid_line or self.batch.is_behind_filter
            if not is_blind or len(best) < 2 or self.is_refuted(best) or not self.explains(self.fits[best]):
                return
            for part in combinations(best, len(best) - 1):
                self.progress("what is in the best set", 0.5)
                self._fit_within(part, best)


def is_akin(name: str, variant: str) -> bool:
    """Return whether a variant is one of an effect, or of what that effect is a variant of."""
    of_effect = LIBRARY[name].variant_of if name in LIBRARY else ()
    return not {name, *of_effect}.isdisjoint(LIBRARY[variant].variant_of)


__all__ = ["NEEDED", "VariedSets", "is_akin"]
