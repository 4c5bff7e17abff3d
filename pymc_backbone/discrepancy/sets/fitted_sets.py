"""Sets of effects fitted to the records: from the sets that they extend where these are near, else from backbones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..._common.checks import FloatArray
from ..fitting import equal_forces, starts
from ..fitting.curves import is_told_apart, level_chi_square
from ..fitting.descent import IN_REACH, Way, is_heavy
from ..fitting.joint_fit import Fit
from ..fitting.layout import Layout
from ..proposals.proposal import Proposal
from ..proposals.set_fits import Set
from ..weighing.evidence import Drifting
from .known_sets import POOR, POSSIBLE_BACKBONE, KnownSets

_NOT_FAR = 2.0  # reduced chi-square of a smaller set up to which the records say where a further effect begins
_UNTOLD = 1.0  # reduced chi-square of the backbones of a smaller set up to which they do not say what else is there
_MUCH_MORE = 10.0  # chi-square of the backbones above their lowest minimum, from which that is asked as well
_MINIMA, _ALIKE = 2, 6.0  # minima of a single effect of several shapes; chi-square within which its starts are alike
_APART = 1.0  # chi-square by which two fits ended in different minima
_LOST = 6.0  # reduced chi-square of the backbones, over what was promised, from which a fit ended elsewhere
_NOTED = 1.0  # chi-square above that of the smaller set up to which one step is enough to note a set
_WORTH = 5.0  # fall of chi-square by which one more effect begins to earn its place
_PROMISED = 3.0  # the same, as a linear step promises it, from which a set is fitted and not noted with one step
_AS_PROMISING = 0.8  # of what the best start promises, up to which another one is asked beside it
_HINT = 1.0  # the same, from which a single effect is fitted although a linear step promises less than that
_BASE_STRENGTHS = (0.02, 0.3)  # of an effect of the model as it is, over their bound, where it begins again ...
_THINNED = 2  # ... at every second of its shapes


@dataclass
class FittedSets(KnownSets):
    """Fits of sets of effects beyond the base, each set once, and what is needed to fit one more.

    Attributes
    ----------
    is_disturbed : callable, optional
        Asked once, early: whether something in front of the records is in the way, or runs beside the motion. What it
        returns is kept in ``halted``, and the search ends there; None lets it go on.
    halted : object, optional
        What ended the search early.
    is_drifting : callable, optional
        Asked once, early, where nothing explains the records: the model as it is with a drift in time, if that does.
    """

    is_disturbed: Callable[[FittedSets], object | None] | None = None
    halted: object | None = None
    is_drifting: Callable[[FittedSets], Drifting | None] | None = None

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

    def _keep_lower(self, names: Set, *found: Fit | None) -> None:
        """Keep the lowest of some fits of a set, where none that is known is lower."""
        for item in found:
            if item is not None and (names not in self.fits or item.cost < self.fits[names].cost):
                self.fits[names] = item

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
        if not self.is_any_exact(found) and not is_heavy(layout):
            found += self._base_shapes(layout)
        return found

    def _base_shapes(self, layout: Layout) -> list[Fit]:
        """Return fits of the model as it is from other shapes of its effects.

        What acts in the first cycles only shows in no level, and a fit that began elsewhere has lost it. All of them
        are asked: one that leaves noise of most records may be far from the lowest.
        """
        found: list[Fit] = []
        ways: list[Way] = []
        for effect in self.base.effects:
            where = starts.positions(layout, effect.name)
            points = starts.grid(layout, effect.name, _BASE_STRENGTHS)[::_THINNED] if len(where) > 1 else []
            for point in points:
                eta = starts.typical(layout)
                eta[where] = point
                state = self.descent.released(layout, eta, self.batch.own[:, :2])
                reached = self.descent.from_afar(layout, state, ways=ways)
                found += [] if reached is None else [reached]
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
            if best.gain < (_HINT if is_single else _PROMISED):
                noted = self._noted(layout, best, parent)
                return [] if noted is None else [noted]
            if not is_single:
                promised = [item for item in promised if item.gain > _AS_PROMISING * best.gain]
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
        found = [] if reached is None or self._is_lost(reached, promised) else [reached]
        if not found or found[0].cost > near[other].cost + _WORTH:
            found += self._of_equal_force(layout, near[other])
        return sorted(found, key=lambda item: item.cost)[:1]

    def _of_equal_force(self, layout: Layout, other: Fit) -> list[Fit]:
        """Return the fit of a set from where its force over the motion is that of another, with none of any states.

        The start that its backbones propose may lie on the wrong side of the motion, or at another kink.
        """
        differing = {*layout.oscillator.effects} ^ {*other.layout.oscillator.effects}
        if any(effect.n_states or effect.has_memory for effect in differing):
            return []
        state = equal_forces.in_place_of(layout, other, self.batch.angular_frequency)
        reached = self.descent.from_afar(layout, state, other.cost, None, self._limit)
        if reached is not None and not reached.is_converged and reached.cost < IN_REACH * self.count:
            reached = self.descent.from_near(layout, [reached.state], rival=other.cost) or reached
        return [] if reached is None else [reached]

    def fit_beside(self, names: Set) -> None:
        """Fit a set once more where it ended far above what the backbones promise and a set beside it did not."""
        known, proposal = self.fits.get(names), self._proposal(names)
        if known is None or proposal is None or not self._is_lost(known, proposal.starts[0][0]):
            return
        self._keep_lower(names, *self._beside(names, None))

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
        if found.cost < POOR * self.count:
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
