"""From a start to the minimum of the deciding data term, so that no phase is lost on the way.

The release amplitude and instant come from the record, never from another model's fit. With the model held, they are
brought to the turning points, which have no phase to lose; then everything is, over a window that grows from the first
of them to all; these hand over to the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import FloatArray
from . import starts
from .batch import Batch
from .data_term import DataTerm
from .joint_fit import Fit, fit
from .layout import Layout
from .normal_equations import NUISANCES, State, start_state

IN_REACH = 30.0
"""Reduced chi-square after one step over the samples from which these are fitted although turning points refute it."""
GLANCE = 10
"""Iterations after which only the best of several starts goes on."""
_RELEASE = (2, 3, 4)  # the specimen's own values that say how it was released and measured
_ENOUGH = 1.0  # decrease of the cost below which a fit that is not the last one ends
_TURNING, _ON_THE_WAY = 20, 6  # iterations over all turning points, and over the first of them
_NEAR_NOISE = 1.3  # of the turning points' reduced chi-square, from which the samples take over
PER_CYCLE = 40.0  # values that a cycle counts for at least: it is simulated however few samples are kept
_HOPELESS = 4.0  # sum of squares over the turning points, over that of a model that explains the records
_UNHEARD_OF = 10.0  # reduced chi-square of the turning points that no model leaves which explains the records
_SAME = 1.0  # chi-square within which two starts ended at the same place
_SAME_WAY = 0.005  # relative difference of two costs over all turning points that were reached on the same way
_SAME_PLACE = 1e-4  # the same over the first of them
_SAME_FAILURE = 0.05  # the same where the other start stayed above what can be rivalled
_FOLLOWS = 30.0  # reduced chi-square of the first turning points from which a start does not follow them
_FIRST_WINDOW = 12  # turning points
_TELLING = 100  # turning points from which a window refutes: over fewer a fit may not have come to rest
_FILTERED = 10.0  # how much more these have to leave behind a band-pass, where they are not quite those of the motion
_WINDOW_GROWTH = 3.0
_PATIENT, _SHORT = 300, 80
_ALIKE_AGAIN = 3  # times that a fit begins again with specimens that are alike, as long as that leaves less
_NEARER = 0.2  # of what is left above a rival, that a fit with specimens alike has to gain to begin once more
_NOT_FAR = 1.5  # reduced chi-square of the deciding term up to which a fit may be right but for a specimen
_EVALUATIONS, _LEAST = 2.0, 3  # of the model in an iteration, as a rule; iterations of a fit whatever was spent

Way = tuple[int, float]
"""How many turning points were looked at, and the sum of squares over them."""


@dataclass
class Descent:
    """Fits of one batch, and what they cost.

    Attributes
    ----------
    batch : Batch
        The data.
    effort : float
        Simulated values so far.
    limit : float
        Of these, beyond which a fit ends after a few iterations and is left where it is.
    """

    batch: Batch
    effort: float = 0.0
    limit: float = np.inf

    def released(self, layout: Layout, eta: FloatArray, own: FloatArray) -> State:
        """Return a start: effects and each specimen's stiffness and damping given, the release from the record.

        Parameters
        ----------
        layout : Layout
            The model.
        eta : (q,) array
            Shared coordinates.
        own : (r, 2) array
            Stiffness and damping of each specimen.
        """
        state = start_state(layout, eta, np.column_stack([own, self.batch.own[:, 2:]]))
        if not self.batch.has_records:
            return state
        held = replace(layout, low=state.eta.copy(), high=state.eta.copy())
        terms = [term.first(_TELLING) for term in self.batch.turning]  # later the phase of a rough start is lost
        found = self.fit(held, terms, state, iterations=8, tolerance=_ENOUGH, nuisances=_RELEASE, has_scatter=False)
        return state if found is None else found.state

    def first_look(self, layout: Layout, state: State) -> tuple[State, float]:
        """Return a start brought to the first turning points, and the reduced chi-square that it leaves there."""
        terms = [term.first(_FIRST_WINDOW) for term in self.batch.turning]
        count = sum(term.size for term in terms)
        found = self.fit(
            layout, terms, state, iterations=_ON_THE_WAY, tolerance=_ENOUGH, goal=_NEAR_NOISE * count
        )  # fmt: skip
        return (state, np.inf) if found is None else (found.state, found.cost / count)

    def in_order(
        self, layout: Layout, proposed: Sequence[tuple[float, FloatArray, FloatArray]]
    ) -> Iterator[tuple[float, State]]:
        """Yield the starts of a set, each with what it promises; as the backbones rank them, if the first is one.

        Backbones of the mean specimen may rank a start first that does not follow the first cycles. Then all have to,
        and that which does best begins: a whole fit costs as much as twenty such looks. The first comes next, as it was
        before it followed them, because what the record says of the release may be at fault.
        """
        released = ((promised, self.released(layout, eta, own)) for promised, eta, own in proposed)
        if not self.batch.has_records or len(proposed) < 2:
            yield from released
            return
        promised, begun = next(released)
        followed, miss = self.first_look(layout, begun)
        if miss < _FOLLOWS:
            yield promised, followed
            yield from released
            return
        looks = [(miss, 0, promised, followed)]
        for k, (promised, state) in enumerate(released, start=1):
            followed, miss = self.first_look(layout, state)
            looks.append((miss, k, promised, followed))
        ahead, *others = sorted(looks, key=lambda item: item[:2])
        others.sort(key=lambda item: item[1] > 0)
        for _, k, promised, followed in (ahead, *others):
            yield promised, begun if k == 0 and ahead[1] > 0 else followed

    def hopeless(self, best: Fit | None) -> float:
        """Return the sum of squares over the turning points from which no other model can rival one that explains.

        Or, where none does, from which none will.
        """
        if not self.batch.has_records:
            return np.inf
        reached = None if best is None else self.fit(best.layout, self.batch.turning, best.state, iterations=1)
        cost = 0.0 if reached is None else reached.cost
        return _HOPELESS * max(cost, self._turning_values)

    @property
    def unheard_of(self) -> float:
        """The sum of squares over the turning points that no model leaves which explains the records."""
        return _UNHEARD_OF * self._turning_values

    @property
    def _turning_values(self) -> float:
        return float(sum(term.size for term in self.batch.turning)) if self.batch.has_records else np.inf

    def from_afar(
        self,
        layout: Layout,
        state: State,
        rival: float | None = None,
        ways: list[Way] | None = None,
        limit: float = np.inf,
    ) -> Fit | None:
        """Return the minimum that a start from the backbones leads to.

        None where it cannot be simulated, or comes the same way as an earlier start: ``ways`` holds where these came
        by, and gets where this one does. One step over the samples is all where the sum of squares over the turning
        points stays above ``limit`` and that step does not come near the noise.
        """
        batch, is_refuted = self.batch, False
        if batch.has_records:
            reached = self._over_turning_points(layout, state, [] if ways is None else ways, limit)
            if reached is None:
                return None
            state, cost = reached
            is_refuted = cost > limit
        if is_refuted:
            step = self.fit(layout, batch.deciding, state, iterations=1, nuisances=batch.nuisances)
            if step is None or step.cost > IN_REACH * sum(term.size for term in batch.deciding):
                return step
            # a band-pass takes the harmonics along, and turning points are not those of the motion that is simulated
            state = step.state
            if ways:
                ways[-1] = (ways[-1][0], limit)
        found = self.fit(
            layout, batch.deciding, state, iterations=_SHORT, tolerance=0.03, rival=rival, nuisances=batch.nuisances
        )
        return found if found is None or not self._is_strained(found) else self.begun_alike(found, rival=rival)

    def from_several(
        self, layout: Layout, states: Sequence[State], is_enough: Callable[[Sequence[Fit]], bool]
    ) -> list[Fit]:
        """Return the minima that some starts lead to, until they are enough or the two lowest came to rest together."""
        found: list[Fit] = []
        for state in states:
            reached = self.from_afar(layout, state)
            found += [] if reached is None else [reached]
            lowest = sorted(found, key=lambda item: item.cost)[:2]
            is_same = len(lowest) > 1 and lowest[1].cost < lowest[0].cost + _SAME
            if is_enough(found) or (is_same and all(item.is_converged for item in lowest)):
                break
        return found

    def _over_turning_points(
        self, layout: Layout, state: State, ways: list[Way], limit: float
    ) -> tuple[State, float] | None:
        """Return the state after a window over the turning points that grows from the first to all of them.

        And the cost there; infinite where they cannot be simulated. The windows grow no further where that is above
        ``limit`` and stays there: more turning points only add to it. None where another start came by the same costs,
        or nearly so where that one was refuted.
        """
        most = max(term.times.size for term in self.batch.turning)
        window, cost = _FIRST_WINDOW, np.inf
        while True:
            terms = [term.first(window) for term in self.batch.turning]
            is_last = window >= most
            iterations = _TURNING if is_last else _ON_THE_WAY
            goal = _NEAR_NOISE * sum(term.size for term in terms)
            found = self.fit(layout, terms, state, iterations=iterations, tolerance=_ENOUGH, goal=goal)
            is_telling, edge = is_last or window >= _TELLING, limit if is_last else first_limit(self.batch, limit)
            if found is not None and found.cost > edge and is_telling and not (is_last or found.is_converged):
                found = self.fit(layout, terms, found.state, iterations=_TURNING, tolerance=_ENOUGH, goal=edge)
            if found is not None:
                state, cost = found.state, found.cost
            elif is_last:
                cost = np.inf
            has_failed = any(known > limit for _, known in ways)
            near = _SAME_FAILURE if has_failed else _SAME_WAY if is_last else _SAME_PLACE
            if (is_last or window > _FIRST_WINDOW) and found is not None:
                if any(place == window and abs(cost - known) < near * known for place, known in ways):
                    return None
                ways.append((window, cost))
            if is_last or (is_telling and cost > edge):
                return state, cost
            window = int(window * _WINDOW_GROWTH)

    def from_near(self, layout: Layout, states: Sequence[State], *, rival: float | None = None) -> Fit | None:
        """Return the minimum of the deciding term that the best of some starts close by leads to."""
        batch = self.batch
        begun: list[Fit] = []
        for state in states:
            first = self.fit(
                layout, batch.deciding, state, iterations=GLANCE, tolerance=0.03, rival=rival, nuisances=batch.nuisances
            )
            begun += [] if first is None else [first]
        if not begun:
            return None
        best = min(begun, key=lambda item: item.cost)
        if not (best.is_converged or best.evaluations < GLANCE):
            found = self.fit(
                layout, batch.deciding, best.state, iterations=_SHORT if rival is not None else _PATIENT,
                tolerance=0.03, rival=rival, nuisances=batch.nuisances,
            )  # fmt: skip
            best = best if found is None else found
        return self.begun_alike(best, rival=rival) if self._is_strained(best) else best

    def begun_alike(self, known: Fit, iterations: int = _SHORT, rival: float | None = None) -> Fit:
        """Return a fit, or a lower one that begins where it ended with specimens that do not differ in their effects.

        Each specimen's own values of a gap, a slip or an exponent may rest on the far side of a kink, and hold the
        shared ones there. Not again where it comes hardly nearer to the cost of a ``rival``.
        """
        for _ in range(_ALIKE_AGAIN):
            found = self.fit(
                known.layout, self.batch.deciding, starts.alike(known), iterations=iterations, tolerance=0.03,
                rival=known.cost, nuisances=self.batch.nuisances,
            )  # fmt: skip
            if found is None or not found.cost < known.cost:
                break
            if not found.is_converged:
                rest = self.fit(
                    known.layout, self.batch.deciding, found.state, iterations=_SHORT, tolerance=0.03,
                    rival=rival, nuisances=self.batch.nuisances,
                )  # fmt: skip
                found = found if rest is None else rest
            known, gain = found, known.cost - found.cost
            if gain < _SAME or (rival is not None and gain < _NEARER * (known.cost - rival)):
                break
        return known

    def _is_strained(self, found: Fit) -> bool:
        """Return whether a fit not far from the noise needs specimens that differ by more than they were taken to."""
        is_near = found.cost < _NOT_FAR * sum(term.size for term in self.batch.deciding)
        return is_near and found.penalty > found.state.own[:, NUISANCES:].size

    def fit(
        self,
        layout: Layout,
        terms: Sequence[DataTerm],
        state: State,
        *,
        iterations: int,
        tolerance: float = 0.03,
        nuisances: Sequence[int] = (0, 1, 2, 3, 4),
        has_scatter: bool = True,
        rival: float | None = None,
        goal: float = 0.0,
    ) -> Fit | None:
        """Fit as `joint_fit.fit` does, and count the effort in simulated values."""
        values = sum(max(term.size, PER_CYCLE * term.cycles) for term in terms)
        each = (1.0 + 4.0 * is_heavy(layout)) * max(values, 1.0)
        affordable = (self.limit - self.effort) / (_EVALUATIONS * each)
        if affordable < iterations:
            iterations = max(int(affordable), min(_LEAST, iterations))
        found = fit(
            layout, terms, state, iterations=iterations, tolerance=tolerance, nuisances=nuisances,
            has_scatter=has_scatter, rival=rival, goal=goal,
        )  # fmt: skip
        if found is not None:
            self.effort += found.evaluations * each
        return found


def first_limit(batch: Batch, limit: float) -> float:
    """Return what the first turning points may leave where all of them may leave ``limit``."""
    return limit * (_FILTERED if any(record.band is not None for record in batch.records) else 1.0)


def is_heavy(layout: Layout) -> bool:
    """Return whether simulating the model costs several times as much as one with sliders (`Simulator.is_costly`)."""
    return bool(layout.simulator.is_costly)
