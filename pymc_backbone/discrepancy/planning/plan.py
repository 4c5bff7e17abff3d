"""The next test, computed: which affordable ring-down tells apart what the present records leave possible."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import log_ndtr

from ..._common.checks import FloatArray, InputError
from ..._common.threads import with_one_thread
from ...effects import LIBRARY, Effect
from ...oscillator import Oscillator
from ..deciding.decision import NAMED
from ..deciding.imitations import library_holds
from ..fitting.joint_fit import Fit
from ..fitting.layout import Layout, make_layout
from ..results.design import Affordable, Contender, Design, Plan, PlannedTest
from ..sets.question import looked_for
from ..weighing.evidence import UNSEEN, log_prior
from .imagined import Imagined, Miss, imagine, miss, vector_of

Progress = Callable[[str, float], None]

MOST_CONTENDERS = 4
"""Sets that are told apart, the likeliest; the others hold little probability."""
_DRAWS = 4000  # of the noise; fits are few, draws cost nothing
_FIRST_ROUND = 3
_REFINED = 5
_PARAMETER_DRAWS = 3
_MOST_ADDED = 4  # parameters by which a larger set may be larger
_ADEQUATE = 0.5  # probability from which the model as it is is surely the most probable, and then said to be adequate
_SEEN = 3.0  # standard errors of what can just be seen, and by how much the prior is wider
_USUAL_REST = 0.1  # odds of what is possible beside the contenders where that is larger sets only
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
    has the probability from which a set is named.

    A larger set whose additional effect is absent predicts the same as the truth. What it is ahead by in the records at
    hand is noise then, and the noise of the next ones is another: both together weigh as much as each knows of
    the effect. Sets that are not among the contenders are taken to be larger ones of these: those of a rival fall with
    it, and every effect of the library that might be added to the truth fits its noise a little. That the library need
    not hold the answer, and that a set may imitate what it lacks, bounds the probability as it does in a verdict.
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


def _angular_frequency(models: Sequence[Oscillator], contenders: Sequence[Contender], release: float) -> float:
    """Return about that of the structure [rad/s]: by its linear stiffness, or else that of the likeliest contender.

    Two springs that outweigh each other leave a linear stiffness that may be negative, and no less a motion.
    """
    weights = [item.probability for item in contenders]
    mean = float(np.average([item.parameters["linear_stiffness"] for item in contenders], weights=weights))
    rough = float(np.sqrt(abs(mean) / models[0].mass))
    if mean > 0.0:
        return rough
    for model, item in zip(models, contenders, strict=True):
        layout, values, status = make_layout(model, release, rough), np.full((3, 1), np.nan), np.zeros(1, np.int64)
        vector = vector_of(layout, dict(item.parameters))
        layout.simulator.backbone(vector, np.array([release]), 0.0, True, values, np.zeros((0, 0, 0)), status)
        if not status.any() and values[0, 0] > 0.0:
            return 2.0 * np.pi * float(values[0, 0])
    return rough


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
        models = [base + [own_effects.get(name, name) for name in item.effects] for item in contenders]
        omega = _angular_frequency(models, contenders, present.release)
        self.layouts = [make_layout(model, present.release, omega) for model in models]
        total = sum(item.probability for item in contenders)
        self.weights = np.array([item.probability / total for item in contenders])
        self.rest = max(1.0 - total, 0.0) / total  # odds of what is possible beside the contenders
        rng = np.random.default_rng(random_seed)
        self.truths = [
            [self._drawn(k, rng if draw else None) for draw in range(_PARAMETER_DRAWS)] for k in range(len(contenders))
        ]
        self.noise = rng.standard_normal((_DRAWS, len(contenders)))
        self.fresh = rng.standard_normal((len(contenders), _DRAWS, _MOST_ADDED))
        # what may be added to a set; what takes long to simulate is not, where a simpler set leaves noise
        library = [LIBRARY[name] for name in looked_for("m")]
        added = [effect.parameters[0] for effect in library if not (effect.state_rate or effect.n_room)]
        self.is_positive = rng.permutation([parameter.minimum >= 0.0 for parameter in added])
        self.crowd = rng.standard_normal((_DRAWS, len(added)))
        held = np.array([library_holds(share) for share in (np.arange(_DRAWS) + 0.5) / _DRAWS])
        self.held = rng.permutation(held)  # p-values of what explains are uniform
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
        truth = self.contenders[true]
        gains: list[float] = []
        odds: list[float] = []
        directions: list[FloatArray | None] = []
        against = self._unlisted(true)
        for rival, contender in enumerate(self.contenders):
            if rival == true:
                continue
            before = self._before(true, rival, draw)
            together = None if before is None else self._together(self.layouts[rival], contender, before, new)
            is_larger = set(contender.effects) > set(truth.effects)
            ahead = self._ahead(true, rival)
            if is_larger and before is not None and together is not None and ahead is not None:
                against += self._larger(true, rival, ahead, before[1].fit, together.fit)
                continue
            odds.append(float(np.log(truth.probability / contender.probability)))
            if before is None or together is None:  # what cannot be fitted cannot be the answer
                gains.append(np.inf)
                directions.append(None)
                continue
            gains.append(max(together.cost - before[1].cost, 0.0))
            directions.append(together.residuals)
        return _share_resolved(
            np.array(odds), np.array(gains), directions, self.noise, against=against, each=1.0 + self.rest,
            certainty=self.held * (1.0 - truth.imitation), needed=NAMED if truth.effects else _ADEQUATE,
        )  # fmt: skip

    def _ahead(self, true: int, rival: int) -> float | None:
        """Return by how much less chi-square a larger set leaves in the records at hand; None where that is unknown."""
        of_truth, of_rival = self.contenders[true].chi_square, self.contenders[rival].chi_square
        return None if of_truth is None or of_rival is None else max(of_truth - of_rival, 0.0)

    def _larger(self, true: int, rival: int, ahead: float, before: Fit, together: Fit) -> FloatArray:
        """Return the odds (n,) of a set that adds what is absent to the truth, after the test."""
        layout = self.layouts[rival]
        added = layout.free.size - self.layouts[true].free.size
        new = [j for j in np.flatnonzero(layout.is_strength) if layout.names[j] not in self.layouts[true].names]
        known = [float(together.covariance[j, j] / before.covariance[j, j]) for j in new]
        old = np.sqrt(np.clip(np.mean(known), 0.0, 1.0))  # weight of what the records at hand say of the effect
        noise = np.sqrt(1.0 - old**2) * self.fresh[rival, :, : max(min(added, _MOST_ADDED), 1)]
        noise[:, 0] += old * np.sqrt(ahead)
        later = (noise**2).sum(axis=1)
        inside = log_ndtr(noise[:, 0]) if all(layout.low[j] >= 0.0 for j in new) else 0.0
        odds = self.contenders[rival].probability / self.contenders[true].probability
        # the prior is as wide as what is found, but for what could just be seen
        wider = np.maximum(np.sqrt(later), _SEEN) / max(np.sqrt(ahead), _SEEN)
        return np.asarray(odds * np.exp(0.5 * (later - ahead) + inside) / wider)

    def _unlisted(self, true: int) -> FloatArray:
        """Return the odds (n,) of what else is possible if a set is true: larger sets that fit a little of its noise.

        What is possible now beyond what these can hold, a drift with time above all, stays as possible as it is.
        """
        size = len(self.contenders[true].effects)
        listed = sum(set(item.effects) > set(self.contenders[true].effects) for item in self.contenders)
        count = self.crowd.shape[1] + 1
        prior = log_prior(size + 1, count) - log_prior(size, count) - (np.log1p(-UNSEEN) if size == 1 else 0.0)
        width = np.log1p((_SEEN * np.maximum(np.abs(self.crowd), _SEEN)) ** 2)
        inside = np.where(self.is_positive, log_ndtr(self.crowd), 0.0)
        factor = np.exp(0.5 * self.crowd**2 - 0.5 * width + inside)[:, size + listed :]
        if size == 0:  # of one effect half the probability is that it is too small to be seen
            factor = UNSEEN + (1.0 - UNSEEN) * factor
        each = np.exp(prior) * factor
        total = np.full(_DRAWS, max(self.rest - _USUAL_REST, 0.0) / self.weights[true])
        return np.asarray(total + each.sum(axis=1))

    def _together(self, layout: Layout, rival: Contender, before: tuple[Imagined, Miss], new: Imagined) -> Miss | None:
        return miss(layout, rival, [before[0], new], before[1].fit)


def _share_resolved(
    odds: FloatArray,
    gains: FloatArray,
    directions: Sequence[FloatArray | None],
    noise: FloatArray,
    *,
    against: FloatArray | float = 0.0,
    each: float = 1.0,
    certainty: FloatArray | float = 1.0,
    needed: float = NAMED,
) -> float:
    """Return how often the truth is named: logarithms of the odds (r,), gains (r,), residuals, draws (n, r or more).

    ``against`` are the odds (n,) of what does not move with the rivals, ``each`` is by how much more is possible with
    each of these than it holds itself, ``certainty`` the probability (n,) that the truth is none of what the library
    lacks, ``needed`` the probability from which it is named.
    """
    finite = np.isfinite(gains)
    unit = []
    for direction, gain in zip(directions, gains, strict=True):
        if direction is not None and np.isfinite(gain):
            length = float(np.linalg.norm(direction))
            unit.append(direction / length if length > 0.0 else direction)
    beside = np.zeros(len(noise)) + against
    if unit:
        together = np.array(unit) @ np.array(unit).T
        np.fill_diagonal(together, 1.0)
        values, vectors = np.linalg.eigh(together)
        shared = noise[:, : values.size] @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        gain = gains[finite]
        logs = odds[finite] + 0.5 * gain + shared * np.sqrt(gain)
        beside += each * np.exp(-np.clip(logs, -700.0, 700.0)).sum(axis=1)
    return float((certainty / (1.0 + beside) >= needed).mean())


__all__ = ["MOST_CONTENDERS", "plan_tests"]
