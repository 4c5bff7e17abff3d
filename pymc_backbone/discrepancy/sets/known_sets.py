"""What a search knows of sets of effects: how they look, what was fitted, and what that explains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...effects import LIBRARY, Effect
from ...oscillator import Oscillator
from ..fitting.batch import Batch
from ..fitting.descent import Descent
from ..fitting.joint_fit import Fit
from ..fitting.layout import Layout, make_layout
from ..fitting.scatter import SCATTER
from ..proposals.proposal import Proposal
from ..proposals.propose import propose
from ..proposals.set_fits import Set
from ..weighing import evidence
from ..weighing.evidence import Drifting

Progress = Callable[[str, float], None]
BUDGET = 3e7
"""Simulated values after which the search ends; only what nothing explains takes as many."""
POSSIBLE_BACKBONE = 3.0
"""Reduced chi-square of the level values up to which a set could explain the backbones."""
_EXPLAINED = 1.1  # reduced chi-square up to which a set may be complete, whatever its residuals look like
_NOISE = 0.01  # p-value of the residuals from which they are taken for noise
_LIMIT = 4.0  # of the budget, that a fit which began before it was spent may take
_FAR_OFF = 100.0  # reduced chi-square of the lowest of the likeliest sets, from which none that follows leaves noise
POOR = 1.5  # reduced chi-square above which a fit may have lost its way


@dataclass
class KnownSets:
    """What is known of sets of effects beyond the base: their looks, layouts and fits, and what these explain.

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
    variants : tuple of str
        Effects that are looked for in the place of the candidates that they are variants of.
    reserved : tuple of str
        Effects that backbones do not show, asked where nothing else explains the samples.
    tolerance : mapping of str to float
        Relative change of frequency and damping that does not matter.
    drift_alone : Drifting, optional
        The model as it is with a drift in time, where that explains the records, and what its evidence gains: then few
        sets more are asked, and none that costs much.
    unneeded : mapping of tuple of str to Fit
        Sets with a variant that explained no more than what it varies, and are no rivals of that.
    refuted : set of tuple of str
        Sets that were not fitted to the samples, because the turning points leave no doubt.
    scatter : float
        How much the effects are taken to differ between specimens, relative to their value.
    beyond, costly_beyond : int
        Simple sets, and costly ones, that were followed although the effort was spent.
    """

    batch: Batch
    base: Oscillator
    candidates: tuple[str, ...]
    max_effects: int = 3
    progress: Progress = lambda _stage, _share: None
    fits: dict[Set, Fit] = field(default_factory=dict)
    failed: dict[Set, str] = field(default_factory=dict)
    layouts: dict[Set, Layout] = field(default_factory=dict)
    budget: float = BUDGET
    is_cut: bool = False
    beyond: int = 0
    costly_beyond: int = 0
    own: Mapping[str, Effect] = field(default_factory=dict)
    variants: tuple[str, ...] = ()
    reserved: tuple[str, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    asked: dict[tuple[Set, int], object] = field(default_factory=dict)
    varied: dict[Set, Proposal] = field(default_factory=dict)
    limited: tuple[Fit | None, float] = (None, np.inf)
    noisy: dict[int, tuple[Fit, bool]] = field(default_factory=dict)
    unneeded: dict[Set, Fit] = field(default_factory=dict)
    refuted: set[Set] = field(default_factory=set)
    scatter: float = SCATTER
    drift_alone: Drifting | None = None

    def __post_init__(self) -> None:
        self.descent = Descent(self.batch, limit=_LIMIT * self.budget)
        spans = (w.levels[-1] / w.levels[0] if w.levels.size else 0.0 for w in self.batch.levels)
        self.count, self.reference = self.batch.count, int(np.argmax(list(spans)))

    @cached_property
    def proposals(self) -> dict[Set, Proposal]:
        """How every set looks in the backbones, the likeliest first."""
        self.progress("all sets, by their backbones", 0.0)
        found = propose(self.batch, self.base, self.candidates, self.max_effects, self.own, self.variants)
        return {item.names: item for item in found}

    def _is_any_possible(self, proposals: Iterable[Proposal]) -> bool:
        """Return whether a set explains the backbones, or none was simulated exactly."""
        known = [item.chi_square for item in proposals if item.is_exact]
        return not known or min(known) <= POSSIBLE_BACKBONE * self._level_values

    @property
    def _level_values(self) -> int:
        """How many values the backbones hold."""
        return sum(term.size for term in self.batch.levels)

    @property
    def has_proposals(self) -> bool:
        """Whether the backbones were asked for proposals."""
        return "proposals" in self.__dict__

    def _is_explained(self) -> bool:
        """Return whether a set leaves hardly more than noise."""
        return self.is_any_exact(self.fits.values())

    def _is_far_off(self) -> bool:
        """Return whether no set comes anywhere near the records."""
        return min(item.cost for item in self.fits.values()) > _FAR_OFF * self.count

    def explains(self, found: Fit) -> bool:
        """Return whether a fit leaves hardly more than noise.

        The size of the noise is an estimate, and short records hold more of it by chance: what leaves somewhat more
        counts where it is no more along the harmonics of the motion than beside them.
        """
        if not _EXPLAINED * self.count <= found.cost < POOR * self.count:
            return found.cost < _EXPLAINED * self.count
        if id(found) not in self.noisy:
            self.noisy[id(found)] = (found, evidence.lack_of_fit(self.batch, found).p_value > _NOISE)
        return self.noisy[id(found)][1]

    def is_any_exact(self, fits: Iterable[Fit]) -> bool:
        """Return whether the best of these fits explains the records."""
        best = min(fits, key=lambda item: item.cost, default=None)
        return best is not None and self.explains(best)

    @property
    def _limit(self) -> float:
        """Sum of squares over the turning points above which a set is no rival of what explains the records, or will.

        None for the base: what it leaves is the gap.
        """
        best = min(self.fits.values(), key=lambda item: item.cost, default=None)
        if best is None:
            return np.inf
        if not self.explains(best):
            return self.descent.hopeless(None) if self.drift_alone is not None else self.descent.unheard_of
        if best is not self.limited[0]:
            self.limited = (best, self.descent.hopeless(best))
        return self.limited[1]

    @property
    def _is_spent(self) -> bool:
        return self.descent.effort > self.budget

    def layout(self, names: Set) -> Layout:
        """Return the layout of the base with these effects."""
        if names not in self.layouts:
            self.layouts[names] = self.layout_of(self.base + [self.own.get(name, name) for name in names])
        return self.layouts[names]

    def layout_of(self, oscillator: Oscillator) -> Layout:
        """Return the layout of an oscillator for these records."""
        return make_layout(
            oscillator, self.batch.amplitude, self.batch.angular_frequency, self.scatter,
            is_relaxed=self.batch.is_relaxed,
        )  # fmt: skip

    def mechanism_of(self, name: str) -> str:
        """Return the mechanism of an effect: where a parameter decides, by the fit that leaves least with it."""
        effect = self.own.get(name) or LIBRARY[name]
        held = [found for names, found in self.fits.items() if name in names] if effect.mechanism_below else []
        if not held:
            return effect.mechanism or "other"
        least = min(held, key=lambda found: found.cost)
        return effect.mechanism_at(least.value_of, self.batch.amplitude) or "other"

    def _was_asked(self, names: Set, other: Fit) -> bool:
        """Return whether a set was started from this fit of another before, and note that it now is."""
        asked = (names, id(other.state))
        is_known = asked in self.asked
        self.asked[asked] = other.state  # kept, so that its identity stays its own
        return is_known

    def _proposal(self, names: Set) -> Proposal | None:
        """Return how a set looks in the backbones; None where they were not asked for it or have no start."""
        found = self.varied.get(names) or self.proposals.get(names)
        return found if found is not None and found.starts else None
