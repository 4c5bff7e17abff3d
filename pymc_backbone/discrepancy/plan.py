"""The next test, computed: which affordable ring-down tells apart what the present records leave possible."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from .._common.checks import FloatArray, InputError
from .._common.threads import with_one_thread
from ..effects import Effect
from ..oscillator import Oscillator
from .decide import NAMED
from .design import Affordable, Contender, Design, Plan, PlannedTest
from .imagined import Imagined, Miss, imagine, miss, vector_of
from .layout import Layout, make_layout

Progress = Callable[[str, float], None]

MOST_CONTENDERS = 4
"""Sets that are told apart, the likeliest; the others hold little probability."""
_DRAWS = 4000  # of the noise; fits are few, draws cost nothing
_FIRST_ROUND = 3
_REFINED = 5
_PARAMETER_DRAWS = 3
_EQUAL = 0.03  # probabilities that differ by less are decided by what the tests cost


@with_one_thread
def plan_tests(
    base: Oscillator,
    contenders: Sequence[Contender],
    present: Design,
    *,
    affordable: Affordable | None = None,
    own_effects: Mapping[str, Effect] | None = None,
    random_seed: int = 0,
    progress: Progress | None = None,
) -> Plan:
    """Return the affordable tests that most probably tell the contenders apart.

    Parameters
    ----------
    base : Oscillator
        The model that was questioned.
    contenders : sequence of Contender
        The sets that the records at hand leave possible, at least two.
    present : Design
        How these records were made.
    affordable : Affordable, optional
        What may be done next.
    own_effects : mapping of str to Effect, optional
        Those of the contenders' effects that the library does not hold.
    random_seed : int, default 0
        Of the draws.
    progress : callable, optional
        Called with what is done and the share of it.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        With fewer than two contenders, or limits that allow nothing.

    See Also
    --------
    find_missing_effect : whose ambiguous verdicts have contenders.

    Notes
    -----
    Each contender in turn is taken for true, with parameters drawn from their errors. The present test and the next
    one are simulated with it, without noise, and every other contender is fitted to both together. What the new test
    adds to the smallest chi-square, D, moves the logarithm of the odds by ``D/2`` and, as the noise falls, by a normal
    number of variance ``D``; rivals that miss in the same direction move together. A test decides where the truth then
    has the probability from which a set is named. No test tells a set from a larger one whose additional effect is
    absent: the larger one then loses by what its parameters are worth alone, which the records at hand say already.
    """
    if len(contenders) < 2:
        raise InputError("there is nothing to tell apart: a plan needs at least two sets that remain possible.")
    limits = Affordable() if affordable is None else affordable
    chosen = tuple(sorted(contenders, key=lambda item: -item.probability)[:MOST_CONTENDERS])
    designs = limits.designs(present)
    say = progress or (lambda _stage, _share: None)
    planner = _Planner(base, chosen, present, own_effects or {}, random_seed)
    # as many records as now first: what gains nothing then is not made better by more of them
    fewest = min(design.records for design in designs)
    first = [design for design in designs if design.records == fewest or design == present]
    scored = {}
    for k, design in enumerate(first):
        say("scoring tests", 0.5 * k / len(first))
        scored[design] = planner.score(design, 1)
    promising = sorted(first, key=lambda design: -scored[design].probability)[:_FIRST_ROUND]
    more = [design for design in designs if any(replace(design, records=fewest) == item for item in promising)]
    for k, design in enumerate(more):
        say("scoring tests", 0.5 + 0.2 * k / max(len(more), 1))
        scored.setdefault(design, planner.score(design, 1))
    leading = _ranked(list(scored.values()))[:_REFINED]
    refined = []
    for k, item in enumerate(leading):
        say("scoring tests", 0.7 + 0.3 * k / len(leading))
        refined.append(planner.score(item.design, _PARAMETER_DRAWS))
    repeat = next((item for item in refined if item.design == present), None)
    repeat = planner.score(present, _PARAMETER_DRAWS) if repeat is None else repeat
    best = [item for item in _ranked(refined) if item.design != present and item.probability > repeat.probability]
    return Plan(tuple(best[:3]), repeat, chosen, len(scored))


def _ranked(tests: Sequence[PlannedTest]) -> list[PlannedTest]:
    """Return tests, the best first: of those that promise about the same the cheapest."""
    left = sorted(tests, key=lambda item: -item.probability)
    ranked = []
    while left:
        equal = [item for item in left if item.probability > left[0].probability - _EQUAL]
        cheapest = min(equal, key=lambda item: (item.design.added_mass > 0.0, item.seconds, item.design.release))
        ranked.append(cheapest)
        left.remove(cheapest)
    return ranked


class _Planner:
    """What all scores share: layouts, the draws of parameters and of noise, and the misses of the present test."""

    def __init__(
        self,
        base: Oscillator,
        contenders: tuple[Contender, ...],
        present: Design,
        own_effects: Mapping[str, Effect],
        random_seed: int,
    ) -> None:
        self.contenders, self.present = contenders, present
        mean = np.average(
            [item.parameters["linear_stiffness"] for item in contenders],
            weights=[item.probability for item in contenders],
        )
        omega = float(np.sqrt(mean / base.mass))
        self.layouts = [
            make_layout(base + [own_effects.get(name, name) for name in item.effects], present.release, omega)
            for item in contenders
        ]
        total = sum(item.probability for item in contenders)
        self.weights = np.array([item.probability / total for item in contenders])
        rng = np.random.default_rng(random_seed)
        self.truths = [
            [self._drawn(k, rng if draw else None) for draw in range(_PARAMETER_DRAWS)] for k in range(len(contenders))
        ]
        self.noise = rng.standard_normal((_DRAWS, len(contenders)))
        self._known: dict[tuple[int, int, int], tuple[Imagined, Miss] | None] = {}

    def _drawn(self, k: int, rng: np.random.Generator | None) -> FloatArray:
        """Return the parameters of a contender, drawn from their errors within limits; as they are without ``rng``."""
        layout, contender = self.layouts[k], self.contenders[k]
        values = dict(contender.parameters)
        if rng is not None:
            for name, error in contender.errors.items():
                moved = values[name] + error * float(rng.standard_normal())
                values[name] = moved if moved * values[name] > 0.0 or values[name] == 0.0 else 0.1 * values[name]
        eta = layout.coordinates(np.array([values[name] for name in layout.names]))
        physical = layout.physical(eta, np.zeros(eta.size), 0.0)[0]
        return vector_of(layout, {**values, **dict(zip(layout.names, physical.tolist(), strict=True))})

    def _before(self, true: int, rival: int, draw: int) -> tuple[Imagined, Miss] | None:
        """Return the present test as it would be under a truth, and a rival's fit to it."""
        key = (true, rival, draw)
        if key not in self._known:
            test = imagine(self.layouts[true], self.truths[true][draw], self.present)
            found = None if test is None else miss(self.layouts[rival], self.contenders[rival], [test])
            self._known[key] = None if test is None or found is None else (test, found)
        return self._known[key]

    def score(self, design: Design, draws: int) -> PlannedTest:
        """Return what a test promises, averaged over so many draws of the parameters."""
        by_set = [
            float(np.mean([self._resolves(true, design, draw) for draw in range(draws)]))
            for true in range(len(self.contenders))
        ]
        return PlannedTest(design, float(self.weights @ by_set), tuple(by_set), design.seconds)

    def _resolves(self, true: int, design: Design, draw: int) -> float:
        """Return the probability that a test names a set which is true."""
        new = imagine(self.layouts[true], self.truths[true][draw], design)
        if new is None:
            return 0.0
        gains: list[float] = []
        odds: list[float] = []
        directions: list[FloatArray | None] = []
        for rival, contender in enumerate(self.contenders):
            if rival == true:
                continue
            before = self._before(true, rival, draw)
            odds.append(float(np.log(self.contenders[true].probability / contender.probability)))
            together = None if before is None else self._together(self.layouts[rival], contender, before, new)
            if before is None or together is None:  # what cannot be fitted cannot be the answer
                gains.append(np.inf)
                directions.append(None)
                continue
            gains.append(max(together.cost - before[1].cost, 0.0))
            directions.append(together.residuals)
        # what is possible beside the contenders moves as the likeliest of them does, which most of it imitates
        rest = max(1.0 - sum(item.probability for item in self.contenders), 0.0) / self.contenders[0].probability
        return _share_resolved(
            np.array(odds), np.array(gains), directions, self.noise, rest=rest, is_likeliest=true == 0
        )

    def _together(self, layout: Layout, rival: Contender, before: tuple[Imagined, Miss], new: Imagined) -> Miss | None:
        return miss(layout, rival, [before[0], new], before[1].fit)


def _share_resolved(
    odds: FloatArray,
    gains: FloatArray,
    directions: Sequence[FloatArray | None],
    noise: FloatArray,
    *,
    rest: float = 0.0,
    is_likeliest: bool = True,
) -> float:
    """Return how often the truth is named: logarithms of the odds (r,), gains (r,), residuals, draws (n, r or more).

    ``rest`` is what is possible beside truth and rivals, as a share of the likeliest of all; that is the truth, or else
    the first of the rivals.
    """
    finite = np.isfinite(gains)
    unit = []
    for direction, gain in zip(directions, gains, strict=True):
        if direction is not None and np.isfinite(gain):
            length = float(np.linalg.norm(direction))
            unit.append(direction / length if length > 0.0 else direction)
    against = np.full(len(noise), rest if is_likeliest else 0.0)
    if unit:
        together = np.array(unit) @ np.array(unit).T
        np.fill_diagonal(together, 1.0)
        values, vectors = np.linalg.eigh(together)
        shared = noise[:, : values.size] @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        gain = gains[finite]
        logs = odds[finite] + 0.5 * gain + shared * np.sqrt(gain)
        each = np.exp(-np.clip(logs, -700.0, 700.0))
        against += each.sum(axis=1)
        if not is_likeliest and finite[0]:
            against += rest * each[:, 0]
    return float((1.0 / (1.0 + against) >= NAMED).mean())


__all__ = ["MOST_CONTENDERS", "plan_tests"]
