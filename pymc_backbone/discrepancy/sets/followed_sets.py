"""The sets that the backbones propose, followed to the records: the likeliest first, until one explains these."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import batched, chain, zip_longest

import numpy as np

from ..proposals.proposal import Proposal
from ..proposals.set_fits import Set
from ..weighing import evidence
from .known_sets import POSSIBLE_BACKBONE
from .revisited_sets import CLOSE
from .side_by_side import ABREAST, fit_side_by_side
from .varied_sets import VariedSets

FEW_FOLLOWED = 6
"""Sets that are followed where not even the backbones are explained."""
NOISE = 0.01
"""P-value of the residuals from which they are taken for noise."""
REACH = 12.0
"""Difference of the logarithm of evidence by the backbones within which the waveforms are asked, too."""
_NEARER, _NEARER_LARGER = 8.0, 4.0
"""The same where a simple set leaves noise: for sets of no more effects than those that explain, and of more."""
_FIRST = 3  # sets that are followed before it is asked whether something is in front of the records
_LEAST_FOLLOWED = 2  # sets that are followed although a base with a law of its own has taken all the effort
_STILL = 6  # simple sets within reach that are followed although the effort is spent
_STILL_COSTLY, _AS_LIKELY = 2, 6.0  # costly ones that are, as likely as the likeliest but for this logarithm of odds
_SIMPLER = 3  # costly sets that are asked because they hold fewer effects than what explains
_PASSED = 6  # less likely simple sets that are followed before one that costs much
_FLOOR = 1.1  # ratio of costs within which sets leave the same
_TOLD = 0.9  # probability of a drift in time beside the base, from which larger sets are not asked


@dataclass
class _Followed:
    """What following the backbones has come to: sets fitted and left, those that explain, and the reach of these.

    ``drift_leads`` says that the model as it is explains the records with a drift in time, more likely than they do.
    """

    fitted: int = 0
    drift_leads: bool = False
    reach: float = -np.inf
    likeliest: float = -np.inf
    explained: list[Set] = field(default_factory=list)
    left: list[Set] = field(default_factory=list)


class FollowedSets(VariedSets):
    """Fitted sets, and those that the backbones propose among them."""

    @property
    def is_told(self) -> bool:
        """Whether the model as it is explains the records with a drift in time."""
        return self.drift_alone is not None

    def _follow_backbones(self, most: int) -> None:
        """Fit the sets in the order of their backbones until one explains the records and no rival is within reach.

        ``most`` of them before anything explains the records, few where all are far off: then something is there that
        no set holds, or in front of the records, and more of them only cost. A set that adds to one that explains
        already is left to the stage after, which starts from there; unless another turned out to leave less. The
        likeliest goes alone, for what it explains needs no other beside it.
        """
        so_far = _Followed()
        queue = [item for item in self._queue() if item[0]]
        while queue and so_far.fitted < (min(most, FEW_FOLLOWED) if self._is_far_off() else most):
            few: list[Set] = []
            while queue and len(few) < (ABREAST if so_far.fitted else 1):
                names, proposal = queue.pop(0)
                if self._is_followed(names, proposal, so_far):
                    few.append(names)
            self.progress("sets that the backbones propose", min(so_far.fitted / most, 1.0))
            so_far.fitted += sum(names not in self.fits for names in few)
            fit_side_by_side(self, few)
            if so_far.fitted >= _FIRST and self._is_halted():
                return
            so_far.drift_leads = self._is_drift_leading(so_far.fitted)
            most = min(most, FEW_FOLLOWED) if so_far.drift_leads else most
            for names in few:
                if names not in self.fits:
                    continue
                likely = self.proposals[names].log_evidence
                so_far.likeliest = max(so_far.likeliest, likely)
                if self.explains(self.fits[names]):
                    so_far.explained.append(names)
                    so_far.reach = max(so_far.reach, likely - REACH)
        if not self._is_halted():
            self._follow_left(so_far)
            self._ask_simpler(so_far)

    def _is_halted(self) -> bool:
        """Return whether the search ends here, as it is known what is in front of the records or beside the motion."""
        if self.is_disturbed is not None and self.halted is None:
            asked, self.is_disturbed = self.is_disturbed, None
            self.halted = asked(self)
        return self.halted is not None

    def _is_drift_leading(self, fitted: int) -> bool:
        """Return whether the model as it is explains the records with a drift in time, and nothing that does rivals it.

        Of such records many laws come near. Asked where nothing explains, or once a few were ``fitted``.
        """
        return (fitted >= _FIRST or not self._is_explained()) and self._is_drift_likelier()

    def _ask_drift(self) -> None:
        """Ask, once, whether the model as it is explains the records with a drift in time."""
        if self.is_drifting is not None:
            asked, self.is_drifting = self.is_drifting, None
            self.drift_alone = asked(self)

    def _is_drift_likelier(self) -> bool:
        """Return whether a drift in time explains the records, and the sets that do are much less probable."""
        self._ask_drift()
        if self.drift_alone is None or not self._is_explained():
            return self.is_told
        fits, bonus = evidence.beside_drifts(self.fits, {(): self.drift_alone})
        weighed = evidence.probabilities(fits, self.batch, len(self.candidates), bonus, self.variants)
        return weighed[evidence.DRIFT].probability > _TOLD

    def _is_followed(self, names: Set, proposal: Proposal, so_far: _Followed) -> bool:
        """Return whether a set is fitted, after what was; one that adds to what explains is noted as left."""
        if any(set(known) < set(names) for known in so_far.explained):
            so_far.left.append(names)
            return False
        if proposal.log_evidence < so_far.reach or self._is_out_of_reach(names, proposal, so_far):
            return False
        if proposal.log_evidence < so_far.likeliest - REACH and self._is_floor():
            return False
        if so_far.drift_leads and self._is_costly(names) and (len(names) > 1 or not so_far.explained):
            return False  # where a simple law explains as well, one that costs much by itself may be what it imitates
        if so_far.fitted >= _LEAST_FOLLOWED and not self._is_affordable(names):
            return False
        if so_far.fitted >= _FIRST and self._is_costly(names) and self._is_far_off():
            return False
        explained = [self.proposals[known].log_evidence for known in so_far.explained]
        is_likeliest = proposal.log_evidence > max(explained, default=-np.inf)
        if self._is_costly(names) and not is_likeliest and self._is_settled():
            return False  # asked later, if at all: what is simple leaves noise
        return not (so_far.explained and self._is_hopeless(names))

    def _is_out_of_reach(self, names: Set, proposal: Proposal, so_far: _Followed) -> bool:
        """Return whether a set is much less likely by its backbones than a simple one that leaves noise.

        Such a set can leave no less than that: what its backbones lack it has no samples to make up for, and each
        effect more counts against it.
        """
        if not so_far.explained:
            return False
        is_larger = len(names) > min(map(len, so_far.explained))
        least = so_far.reach + REACH - (_NEARER_LARGER if is_larger else _NEARER)
        return proposal.log_evidence < least and self._is_settled()

    def _is_affordable(self, names: Set) -> bool:
        """Return whether a set is fitted after what was spent: a few simple ones do not pay for the costly ones.

        But for what is as likely as the likeliest by its simulated backbones, as long as nothing explains the records.
        """
        if not self._is_spent:
            return True
        self.is_cut = True
        if self._is_costly(names):
            likeliest = max(item.log_evidence for item in self.proposals.values())
            proposal = self.proposals[names]
            is_likely = proposal.is_exact and proposal.log_evidence > likeliest - _AS_LIKELY
            if not is_likely or self.costly_beyond >= _STILL_COSTLY or self._is_explained():
                return False
            self.costly_beyond += 1
            return True
        if self.beyond >= _STILL:
            return False
        self.beyond += 1
        return True

    def _follow_left(self, so_far: _Followed) -> None:
        """Fit the likeliest of the sets that were left for what they add to, where that leaves more than another."""
        close = min(item.cost for item in self.fits.values()) + CLOSE
        near = [names for names in so_far.explained if self.fits[names].cost < close]
        for names in so_far.left[:_PASSED]:
            is_slow = self._is_costly(names) and self._is_settled()
            is_relative = any(set(known) < set(names) for known in near)
            if self.proposals[names].log_evidence > so_far.reach and not (is_slow or is_relative or self._is_spent):
                self.fit_set(names)

    def _ask_simpler(self, so_far: _Followed) -> None:
        """Fit what remembers and may explain with fewer effects than what was found to explain, whatever was spent.

        Two simple laws imitate it, and are asked before it because they cost less.
        """
        fewer = min(map(len, so_far.explained), default=0)
        asked = [
            names
            for names, proposal in self.proposals.items()
            if len(names) < fewer and names not in self.fits and self._is_costly(names)
            if proposal.log_evidence > so_far.reach and proposal.chi_square < POSSIBLE_BACKBONE * self._level_values
        ]
        for few in batched(asked[:_SIMPLER], ABREAST):
            fit_side_by_side(self, few)

    def _queue(self) -> list[tuple[Set, Proposal]]:
        """Return the sets by their backbones, those that cost much behind the simple ones within reach.

        But behind some simple ones only that are less likely, so that the likeliest is asked whatever it costs. Single
        effects, which are few and soon fitted, have every third turn: of strong ones, or of such that differ much
        between specimens, backbones say too little. A simple one goes first: what costs much is given up early where
        it is no rival of that.
        """
        simple = [item for item in self.proposals.items() if not self._is_costly(item[0])]
        waiting = [item for item in self.proposals.items() if self._is_costly(item[0])]
        ordered: list[tuple[Set, Proposal]] = []
        less_likely = 0
        for item in simple:
            if waiting and item[1].log_evidence < waiting[0][1].log_evidence:
                less_likely += 1
            is_overdue = less_likely > _PASSED
            if waiting and ordered and (is_overdue or item[1].log_evidence < waiting[0][1].log_evidence - REACH):
                ordered.append(waiting.pop(0))
                less_likely = 0
            ordered.append(item)
        ordered += waiting
        single = [item for item in simple if len(item[0]) == 1]
        first: dict[Set, tuple[Set, Proposal]] = {}
        for item in chain.from_iterable(zip_longest(ordered[::2], ordered[1::2], single)):
            if item is not None:
                first.setdefault(item[0], item)
        return list(first.values())

    def _is_floor(self) -> bool:
        """Return whether several sets end at the same distance from the records: what is left is in none of them."""
        costs = np.sort([item.cost for item in self.fits.values()])
        return costs.size >= FEW_FOLLOWED and bool(costs[FEW_FOLLOWED - 1] < _FLOOR * costs[0])

    def _is_settled(self) -> bool:
        """Return whether the most probable set is a simple one that leaves nothing but noise."""
        best = self.best()
        return not self._is_costly(best) and evidence.lack_of_fit(self.batch, self.fits[best]).p_value > NOISE


__all__ = ["FEW_FOLLOWED", "NOISE", "REACH", "FollowedSets"]
