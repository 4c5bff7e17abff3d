"""Sets of effects fitted to the records: from the sets that they extend where these are near, else from backbones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ..._common.checks import FloatArray
from ...effects import LIBRARY, Effect
from ...oscillator import Oscillator
from ..fitting import starts
from ..fitting.batch import Batch
from ..fitting.curves import is_told_apart, level_chi_square
from ..fitting.descent import IN_REACH, Descent, Way
from ..fitting.joint_fit import Fit
from ..fitting.layout import Layout, make_layout
from ..fitting.scatter import SCATTER
from ..proposals.propose import Proposal, propose
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
_POOR = 1.5  # reduced chi-square above which a fit may have lost its way
_NOT_FAR = 2.0  # reduced chi-square of a smaller set up to which the records say where a further effect begins
_UNTOLD = 1.0  # reduced chi-square of the backbones of a smaller set up to which they do not say what else is there
_MUCH_MORE = 10.0  # chi-square of the backbones above their lowest minimum, from which that is asked as well
_MINIMA, _ALIKE = 2, 6.0  # minima of a single effect of several shapes; chi-square within which its starts are alike
_APART = 1.0  # chi-square by which two fits ended in different minima
_LOST = 6.0  # reduced chi-square of the backbones, over what was promised, from which a fit ended elsewhere
_NOTED = 1.0  # chi-square above that of the smaller set up to which one step is enough to note a set
_WORTH = 5.0  # fall of chi-square by which one more effect begins to earn its place
_HINT = 1.0  # the same, from which a single effect is fitted although a linear step promises less than that


@dataclass
class FittedSets:
    """Fits of sets of effects beyond the base, each set once, and what is needed to fit one more.

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
    tolerance : mapping of str to float
        Relative change of frequency and damping that does not matter.
    is_disturbed : callable, optional
        Asked once, early: whether something in front of the records is in the way, or runs beside the motion. What it
        returns is kept in ``halted``, and the search ends there; None lets it go on.
    halted : object, optional
        What ended the search early.
    is_drifting : callable, optional
        Asked once, early, where nothing explains the records: the model as it is with a drift in time, if that does.
    drift_alone : Drifting, optional
        That fit and what its evidence gains: then few sets more are asked, and none that costs much.
    refuted : set of tuple of str
        Sets that were not fitted to the samples, because the turning points leave no doubt.
    scatter : float
        How much the effects are taken to differ between specimens, relative to their value.
    beyond : int
        Sets that were followed although the effort was spent.
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
    own: Mapping[str, Effect] = field(default_factory=dict)
    variants: tuple[str, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    asked: dict[tuple[Set, int], object] = field(default_factory=dict)
    varied: dict[Set, Proposal] = field(default_factory=dict)
    limited: tuple[Fit | None, float] = (None, np.inf)
    noisy: dict[int, tuple[Fit, bool]] = field(default_factory=dict)
    refuted: set[Set] = field(default_factory=set)
    scatter: float = SCATTER
    is_disturbed: Callable[[FittedSets], object | None] | None = None
    halted: object | None = None
    is_drifting: Callable[[FittedSets], Drifting | None] | None = None
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

    def explains(self, found: Fit) -> bool:
        """Return whether a fit leaves hardly more than noise.

        The size of the noise is an estimate, and short records hold more of it by chance: what leaves somewhat more
        counts where it is no more along the harmonics of the motion than beside them.
        """
        if not _EXPLAINED * self.count <= found.cost < _POOR * self.count:
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
            extended = self.base + [self.own.get(name, name) for name in names]
            self.layouts[names] = make_layout(
                extended, self.batch.amplitude, self.batch.angular_frequency, self.scatter,
                is_relaxed=self.batch.is_relaxed,
            )  # fmt: skip
        return self.layouts[names]

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

    def is_refuted(self, names: Set) -> bool:
        """Return whether the turning points refuted a set and nothing brought its fit near the records since."""
        return names in self.refuted and self.fits[names].cost > IN_REACH * self.count

    def note_refuted(self, names: Set, eta: FloatArray) -> Fit | None:
        """Return a set at these shared coordinates, its release that of the record, as one that is not fitted further.

        For sets that are asked after the most probable ones were refuted: over so many cycles none keeps the phase.
        """
        proposal = self._proposal(names)
        own = self.batch.own[:, :2] if proposal is None else proposal.starts[0][2]
        layout = self.layout(names)
        state = self.descent.released(layout, eta, own)
        found = self.descent.fit(layout, self.batch.deciding, state, iterations=1, nuisances=self.batch.nuisances)
        if found is not None:
            self.fits[names] = found
            self.refuted.add(names)
        return found

    def _base_fits(self) -> list[Fit]:
        """Return fits of the model as it is; effects that it holds may turn out to be absent."""
        layout = self.layout(())
        eta = starts.typical(layout)
        scales = (0.0, 0.05, 1.0, 20.0) if eta.size else (1.0,)
        states = [
            self.descent.released(layout, np.where(layout.is_strength, eta * scale, eta), self.batch.own[:, :2])
            for scale in scales
        ]
        found = self.descent.from_several(layout, states, self.is_any_exact)
        if eta.size and not self.is_any_exact(found):
            found += self._proposed((), None)
        return found

    def _set_fits(self, names: Set) -> list[Fit]:
        """Return fits of a set: from the sets it extends where these are near, else from the backbones."""
        layout = self.layout(names)
        parents = [self.fits[rest] for rest in combinations(names, len(names) - 1) if rest in self.fits]
        parents.sort(key=lambda parent: parent.cost)
        rival = min((item.cost for item in self.fits.values()), default=None)
        is_near = self.is_any_exact(parents)
        found: list[Fit] = []
        if not is_near:
            found = self._beside(names, rival)
            found += self._proposed(names, rival) if not found else self._other_side(layout, found, rival)
        if is_near or not found or self._gains_nothing(found, parents):
            for parent in parents[:2] if len(names) > 1 and (is_near or not found) else parents[:1]:
                self._was_asked(names, parent)
                found += self._extended(names, layout, parent, rival)
        return found

    def _gains_nothing(self, found: list[Fit], parents: list[Fit]) -> bool:
        """Return whether fits from the backbones end hardly lower than a smaller set that is as good a start.

        Levels end below the largest amplitudes: what acts there only, they do not show. So it is where the smaller set
        is not far from the noise, or explains the backbones and not the samples.
        """
        if not parents:
            return False
        parent, worth = parents[0], _WORTH
        if parent.cost > _NOT_FAR * self.count:
            smaller = self.proposals.get(self._names(parent))
            if smaller is None or not smaller.chi_square < _UNTOLD * self._level_values:
                return False
            worth = 0.5 * (parent.cost - self.count)
        return min(item.cost for item in found) > parent.cost - worth

    def _extended(self, names: Set, layout: Layout, parent: Fit, rival: float | None) -> list[Fit]:
        """Return the fit of a set from that of a smaller one, to which the score says what the new effect adds."""
        new = next(name for name in names if name not in self._names(parent))
        promised = starts.by_score(layout, new, parent, self.batch)
        if not promised:
            return []
        best = promised[0]
        if self.explains(parent):
            # whether anything is missing hangs on single effects, and where a shape bends the way, a step tells little
            is_single = len(names) == 1
            if best.gain < (_HINT if is_single else _WORTH):
                noted = self._noted(layout, best, parent)
                return [] if noted is None else [noted]
            promised = promised if is_single else [best]
        near = self.descent.from_near(layout, [item.moved for item in promised], rival=rival)
        if near is None or near.cost > parent.cost + _NOTED:  # the step went too far: what is there begins small
            small = self.descent.from_near(layout, [best.small], rival=rival)
            near = small if near is None or (small is not None and small.cost < near.cost) else near
        return [] if near is None else [near]

    def _noted(self, layout: Layout, promised: starts.Scored, parent: Fit) -> Fit | None:
        """Return the fit of a set that gains next to nothing: one step from where it leads, or from where it began."""
        best = None
        for state in (promised.moved, promised.small):
            near = self.descent.fit(
                layout, self.batch.deciding, state, iterations=1, nuisances=self.batch.nuisances
            )  # fmt: skip
            best = near if best is None or (near is not None and near.cost < best.cost) else best
            if best is not None and best.cost < parent.cost + _NOTED:
                break
        return best

    def _beside(self, names: Set, rival: float | None) -> list[Fit]:
        """Return the fit of a set from one that explains the records and has another effect in the place of one.

        What both hold is kept; the other effect, and what it changes in stiffness and damping, are as the backbones
        propose them. Nothing where no such set is known, or where that leads away from what the backbones promise.
        """
        proposal = self._proposal(names)
        near = {
            other: item
            for other, item in self.fits.items()
            if len(other) == len(names) and len({*other} - {*names}) == 1 and self.explains(item)
        }
        if proposal is None or not near:
            return []
        other = min(near, key=lambda key: near[key].cost)
        if self._was_asked(names, near[other]):
            return []
        layout = self.layout(names)
        promised, eta, own = proposal.starts[0]
        state, shared = starts.embedded(layout, near[other])
        is_kept = np.isin(np.arange(eta.size), [here for here, _ in shared])
        state = replace(state, eta=np.where(is_kept, state.eta, eta))
        known = self._proposal(other)
        if known is not None:
            state.own[:, :2] += own - known.starts[0][2]
        reached = self.descent.from_near(layout, [state], rival=rival)
        return [] if reached is None or self._is_lost(reached, promised) else [reached]

    def fit_beside(self, names: Set) -> None:
        """Fit a set once more where it ended far above what the backbones promise and a set beside it did not."""
        known, proposal = self.fits.get(names), self._proposal(names)
        if known is None or proposal is None or not self._is_lost(known, proposal.starts[0][0]):
            return
        self.fits[names] = min([known, *self._beside(names, None)], key=lambda item: item.cost)

    def _proposal(self, names: Set) -> Proposal | None:
        """Return how a set looks in the backbones; None where they were not asked for it or have no start."""
        found = self.varied.get(names) or self.proposals.get(names)
        return found if found is not None and found.starts else None

    def _proposed(self, names: Set, rival: float | None) -> list[Fit]:
        """Return fits from what the backbones propose for a set, until one keeps what they promise.

        A single effect of several shapes, its own or of the model as it is, has minima that the backbones cannot tell
        apart: more than one begins.
        """
        proposal = self._proposal(names)
        if proposal is None:
            return []
        layout = self.layout(names)
        self.asked[names, id(proposal)] = proposal
        found: list[Fit] = []
        ways: list[Way] = []
        limit, is_refuted = self._limit, True
        lowest = min((promised for promised, _, _ in proposal.starts), default=0.0)
        is_kept, is_alone = False, len(names) == 1 and self._has_minima(layout)
        for promised, state in self.descent.in_order(layout, proposal.starts):
            if is_kept and not (is_alone and _apart(found) < _MINIMA and promised < lowest + _ALIKE):
                break
            reached = self.descent.from_afar(layout, state, rival, ways, limit)
            if reached is None:
                continue
            found.append(reached)
            is_refuted = is_refuted and bool(ways) and ways[-1][1] > limit
            is_kept = is_kept or (promised < lowest + _MUCH_MORE and not self._is_lost(reached, promised))
        if not self.is_any_exact(found):
            absent = self._without_base(layout, proposal, rival, ways)
            is_refuted = is_refuted and (not absent or ways[-1][1] > limit)
            found += absent
            found += self._other_side(layout, found, rival)
        if found and is_refuted:
            self.refuted.add(names)
        return found

    def _has_minima(self, layout: Layout) -> bool:
        """Return whether the shapes of a single effect, or of one that the model holds, may leave several minima."""
        is_shape, has_base = ~layout.is_strength, not self.layout(()).is_strength.all()
        return int(np.count_nonzero(is_shape)) > (0 if has_base else 1)

    def _without_base(self, layout: Layout, proposal: Proposal, rival: float | None, ways: list[Way]) -> list[Fit]:
        """Return the fit of a set from where the effects of the model as it is are absent: they may imitate the set."""
        held = np.isin(layout.names, self.layout(()).names) & layout.is_strength
        if not held.any() or held.all():
            return []
        _, eta, own = proposal.starts[0]
        state = self.descent.released(layout, np.where(held, 0.0, eta), own)
        reached = self.descent.from_afar(layout, state, rival, ways, self._limit)
        return [] if reached is None else [reached]

    def _other_side(self, layout: Layout, found: list[Fit], rival: float | None) -> list[Fit]:
        """Return the fit from the mirror image of the best that is not exact, where backbones do not tell the sides."""
        if not found or not self.batch.has_records or self.is_any_exact(found):
            return []
        best = min(found, key=lambda item: item.cost)
        image = starts.mirrored(layout, best.state)
        if image is None or is_told_apart(self.batch, best, image, POSSIBLE_BACKBONE):
            return []
        reached = self.descent.from_afar(layout, image, rival, None, self._limit)
        return [] if reached is None else [reached]

    def _is_lost(self, found: Fit, promised: float) -> bool:
        """Return whether a fit ended far above what the backbones promise: then another start may do better."""
        if found.cost < _POOR * self.count:
            return False
        reduced = level_chi_square(self.batch, found)
        return not reduced < _LOST * max(promised / self._level_values, 1.0)

    def _names(self, found: Fit) -> Set:
        held = {effect.name for effect in self.base.effects}
        return tuple(effect.name for effect in found.layout.oscillator.effects if effect.name not in held)


def _apart(found: Sequence[Fit]) -> int:
    """Return in how many different minima some fits ended."""
    costs = np.sort([item.cost for item in found])
    return int(costs.size > 0) + int(np.count_nonzero(np.diff(costs) > _APART))
