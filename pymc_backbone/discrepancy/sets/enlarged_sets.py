"""Sets around the best one: those that add an effect, and those that hold another in the place of one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import batched, combinations

from ..fitting.descent import is_heavy
from ..proposals.set_fits import Set
from .followed_sets import REACH, FollowedSets
from .revisited_sets import CLOSE
from .side_by_side import ABREAST, fit_side_by_side
from .varied_sets import NEEDED

_KEPT_PARENTS = 2
_MOST_EXTENDED = 4


class EnlargedSets(FollowedSets):
    """Fitted sets, and those that differ from the best by one effect."""

    def _parents(self, size: int) -> list[Set]:
        """Return the sets to extend: those that explain the records nearly as well as the best, else the best few."""
        ranked = self.ranked(size)
        close = CLOSE + min(item.cost for item in self.fits.values())
        explained = [name for name in ranked if self.fits[name].cost < close and self.explains(self.fits[name])]
        plain = [name for name in ranked if not is_heavy(self.layout(name))]
        light = plain[: _KEPT_PARENTS + 2 * (size == 1)]
        if explained:
            explained = self._one_of_a_kind(explained)
            # what many parameters explain, two simple effects may explain as well
            simple = light[:_KEPT_PARENTS] if size == 1 and is_heavy(self.layout(explained[0])) else []
            return list(dict.fromkeys([*explained[:_KEPT_PARENTS], *simple]))
        return [name for name in ranked if name in light or name in ranked[:_KEPT_PARENTS]]

    def _one_of_a_kind(self, sets: Sequence[Set]) -> list[Set]:
        """Return one of those sets that hold the same mechanisms: the simplest that fits nearly as well as any."""
        groups: dict[tuple[str, ...], list[Set]] = {}
        for names in sets:
            groups.setdefault(tuple(sorted(self.mechanism_of(name) for name in names)), []).append(names)
        chosen = set()
        for group in groups.values():
            limit = min(self.fits[names].cost for names in group) + NEEDED
            near = [names for names in group if self.fits[names].cost < limit]
            chosen.add(min(near, key=lambda names: (is_heavy(self.layout(names)), self.layout(names).free.size)))
        return [names for names in sets if names in chosen]

    def _extend(self, parents: Sequence[Set], size: int) -> None:
        sets = []
        for parent in parents:
            for name in self.candidates:
                union = tuple(sorted({*parent, name}))
                if len(union) == size and union not in sets:
                    sets.append(union)
        if not any(self.explains(self.fits[parent]) for parent in parents):
            # far from the noise the backbones tell which sets are worth a closer look; the likeliest had theirs already
            known = self.proposals
            sets = [names for names in known if names in sets and names not in self.fits][:_MOST_EXTENDED]
        sets.sort(key=self._is_costly)
        for k, few in enumerate(batched(sets, ABREAST)):
            if self._is_spent:
                self.is_cut = True
                break
            simple = [names for names in few if not self._is_costly(names)]
            is_enough = len(simple) < len(few) and self._is_settled()
            self.progress(("pairs", "sets of three")[min(size - 2, 1)], min(ABREAST * (k + 1) / len(sets), 1.0))
            fit_side_by_side(self, simple if is_enough else few)
            if is_enough:
                break

    def _replace(self) -> bool:
        """Try other effects in the place of each of the best set; return whether that found a better one."""
        best = self.best()
        if len(best) < 2 or self.is_refuted(best):
            return False
        smaller = list(combinations(best, len(best) - 1))
        for few in batched(smaller, ABREAST):
            fit_side_by_side(self, few)
        for rest in smaller:
            others = [tuple(sorted((*rest, name))) for name in self.candidates if name not in best]
            others = [names for names in others if self._is_costly(best) or not self._is_costly(names)]
            near = self._within_reach(others, best)
            for few in batched(near, ABREAST):
                if self._is_spent:
                    break
                fit_side_by_side(self, few)
                for names in few:
                    self.fit_beside(names)
            for few in batched(self._promised_in_place(near, rest) if self._is_spent else (), ABREAST):
                fit_side_by_side(self, few)
        if len(best) < self.max_effects:
            self._extend([best], len(best) + 1)
        return self.best() != best

    def _within_reach(self, sets: Sequence[Set], best: Set) -> list[Set]:
        """Return those sets whose backbones are not much less likely than those of the best, the likeliest first."""
        known = self.proposals
        if best not in known:
            return list(sets)
        least = known[best].log_evidence - REACH
        return [names for names, item in known.items() if names in sets and item.log_evidence > least]


__all__ = ["EnlargedSets"]
