"""Sets whose hysteresis came to rest where a fit has no reason to move, begun again from beyond that."""

from __future__ import annotations

import numpy as np

from ..._common.checks import BoolArray
from ...oscillator import Oscillator
from ..fitting import starts
from ..fitting.descent import IN_REACH
from ..fitting.joint_fit import Fit
from ..proposals.set_fits import Set
from ..weighing import evidence
from .fitted_sets import FittedSets

GAINED = 4.0
"""Chi-square by which a larger set may be better without having found a better way."""
NEAR_BY = 10.0
"""Reduced chi-square of a smaller set up to which a linear step from it is worth a look."""
REFUTED = 100.0
"""Chi-square above one that explains, beyond which relatives are not asked."""
ASKED_FOR = 10.0
"""Fall of chi-square, as a linear step promises it, that no set in want of it can be named against."""
_LAGS = 3.0  # standard deviations of noise
_JOLTED = 60.0  # chi-square above the lowest within which a slider is looked for in the dents beside its own
_NEAR_LOWEST = 1.5  # of what the lowest set leaves, within which a lost slider may lie lower
_SLIDING = 2  # sets with a slider that are asked where else it slips, when the effort is spent


class HystereticSets(FittedSets):
    """Fitted sets whose sliders and lagging displacements are looked for on either side of their plateaus."""

    def fit_set(self, names: Set) -> Fit | None:
        """Return the best fit of a set, from several starts; kept for the next time.

        Where it came to rest on the plateau of a bed of sliders that does not slip as a whole, or of a slider that
        holds in some specimens, it begins again from beyond the edge of that; hysteresis that is far from saturation,
        which a stiffer spring makes up for, from nearer to it. A single slider begins again from where else a linear
        step promises more, one of the model as it is too.
        """
        is_known = names in self.fits
        found = super().fit_set(names)
        if is_known or found is None or not found.is_converged or not self.batch.has_records:
            return found
        is_near = found.cost < IN_REACH * self.count
        # where its slider is lost, the model as it is may be far off
        others = self._sliding(names, found) if is_near or not names else []
        if is_near:
            others += self._slipping(found)
            others += self._saturating(found) if self._is_worth_while(found) else []
        self._keep_lower(names, *others)
        return self.fits[names]

    def _is_worth_while(self, found: Fit) -> bool:
        """Return whether a fit begun again along its valley may count: it costs as much as a whole one.

        Not where the model as it is leaves noise and is hardly worse, or another set is far better.
        """
        base = self.fits.get(())
        if base is None or not self.explains(base):
            return True
        lowest = min(item.cost for item in self.fits.values())
        return found.cost < min(base.cost - ASKED_FOR, lowest + REFUTED)

    def _slipping(self, known: Fit) -> list[Fit]:
        """Return the fit from beyond the edge of the plateau of a slider, where one came to rest on that."""
        states = starts.slipping(known.layout, known.state)
        states += starts.slipping_each(known.layout, known.state, self._lagging(known))
        beyond = self.descent.from_near(known.layout, states, rival=known.cost) if states else None
        return [] if beyond is None else [beyond]

    def _sliding(self, names: Set, known: Fit) -> list[Fit]:
        """Return the fits with a slider that slips elsewhere, where a linear step there promises more than was gained.

        One that slips near the largest displacements does so in few cycles, and one far from there in all: between them
        a fit has no way.
        """
        states = []
        asked = names or [effect.name for effect in self.base.effects]
        for name in [item for item in asked if starts.is_slider(known.layout, item)]:
            rest = tuple(other for other in names if other != name)
            without = self.fits.get(rest) if names else self._base_without(name, known)
            if without is None or (names and without.cost > NEAR_BY * self.count) or self._was_asked(names, without):
                continue
            gained = max(without.cost - known.cost, 0.0) + GAINED
            promised = starts.by_score(known.layout, name, without, self.batch)
            states += [item.moved for item in promised if item.gain > gained]
        beyond = self.descent.from_near(known.layout, states, rival=known.cost) if states else None
        return [] if beyond is None else [beyond]

    def _base_without(self, name: str, known: Fit) -> Fit | None:
        """Return the fit of the model as it is without one of its effects, from where it ended with it."""
        rest = Oscillator(self.base.mass, [effect for effect in self.base.effects if effect.name != name])
        layout = self.layout_of(rest)
        return self.descent.from_near(layout, [starts.restricted(layout, known.layout, known.state)])

    def _saturating(self, known: Fit) -> list[Fit]:
        """Return the fits of hysteresis from nearer to its saturation, where one came to rest far from that."""
        layout = known.layout
        states = [
            self.descent.released(layout, state.eta, state.own[:, :2])
            for state in starts.saturating(layout, known.state)
        ]
        begun = [self.descent.from_afar(layout, state, rival=known.cost) for state in states]
        lowest = min((item for item in begun if item is not None), key=lambda item: item.cost, default=None)
        if lowest is None or not lowest.cost < known.cost or lowest.is_converged:
            return [] if lowest is None else [lowest]
        settled = self.descent.from_near(layout, [lowest.state])
        return [lowest] if settled is None else [settled]

    def _lagging(self, found: Fit) -> BoolArray:
        """Return which specimens (r,) a fit leaves more of than noise would, by what it leaves of most of them."""
        sizes = np.array([term.size for term in self.batch.deciding])
        return np.asarray(found.chi_square - np.median(found.chi_square / sizes) * sizes > _LAGS * np.sqrt(2.0 * sizes))

    def _look_elsewhere(self) -> None:
        """Fit sets with a slider that explain the records where it slips elsewhere; few, if the effort is spent.

        The best of them also in the dents beside the one in which they came to rest.
        """
        for names in self._with_sliders()[: _SLIDING if self._is_spent else None]:
            self._keep_lower(names, *self._sliding(names, self.fits[names]))
        lowest = min(item.cost for item in self.fits.values())
        for names in self._with_sliders()[:_SLIDING]:
            known = self.fits[names]
            if known.cost > lowest + _JOLTED or self._was_asked(names, known):
                continue
            beside = self.descent.from_near(known.layout, starts.jolted(known.layout, known.state), rival=known.cost)
            if beside is not None and beside.cost < known.cost - 0.01:
                self.fits[names] = beside

    def _with_sliders(self) -> list[Set]:
        """Return the sets with a single slider that explain the records, or are near where nothing does; lowest first.

        Where none leaves noise, a slider in any of the lowest may have been lost.
        """
        lowest = min(self.fits.values(), key=lambda item: item.cost)
        most = 0.0 if evidence.leaves_noise(self.batch, lowest) else _NEAR_LOWEST * lowest.cost
        near = sorted((f.cost, names) for names, f in self.fits.items() if f.cost < most or self.explains(f))
        return [names for _, names in near if any(starts.is_slider(self.layout(names), name) for name in names)]


__all__ = ["ASKED_FOR", "GAINED", "NEAR_BY", "REFUTED", "HystereticSets"]
