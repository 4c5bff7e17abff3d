"""Which mechanisms are missing: all sets weighed with a departure that none of them explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import comb

import numpy as np
from scipy.special import logsumexp

from ..._common.checks import FloatArray
from ..._common.threads import in_threads
from ..fitting import starts
from ..fitting.curves import spread
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import parameters_of
from ..fitting.normal_equations import NUISANCES, State, start_state
from ..proposals.departing import Departing, DepartingSets
from ..proposals.departing_point import Point
from ..proposals.harmonic_odds import Harmonics
from ..sets.search import Search, Set
from ..weighing import evidence
from .gaps import gaps_of, least_gap, mean_squares, with_smaller

PRIOR_OF_COUNT = (0.05, 0.6, 0.3, 0.05)
"""Prior probability that so many mechanisms are missing where no law is exact; none: the library holds none of them."""
LEAST_SPAN = 1.7
"""Ratio of amplitudes in one record from which mechanisms are weighed."""
_TWICE = 0.1  # how much rarer a second law of the same mechanism is
_MOST_SPECIMENS = 3  # a departure is alike in all: more of them say hardly more of it
_MOST_TURNS = 4000  # turning points of these together, where two specimens are enough
_MOST_STARTS = 4  # of a single effect, from its backbones
_LEADERS = 6  # sets that are fitted with the departure first
_MOST_WEIGHED = 40
_MOST_HEAVY = 24  # sets that take long, beside single effects
_LOOKED_BACK = 5  # sets whose subsets begin once more where these ended
_REACH = 20.0  # logarithm of the odds at first sight from which a set is fitted with the departure
_AMPLE = 5.0  # forces over the gap from which they are too large for it
_EXPLAINED = 0.2  # of the gap that a set leaves up to which it does not matter whose own the rest is
_DRIFTS = 0.3  # of the gap, that a drift in time leaves at most where it explains the records
_OUTDONE, _NO_CHANCE = 3.0, 0.5  # excess of chi-square over that of another set, and what is none
_NEAR = 4.0  # excess of a set that nearly explains the samples
_SEPARATE = 5.0  # logarithm of the odds from which departures are each specimen's own, and so no law of amplitude


@dataclass(frozen=True, eq=False)
class Weighed:
    """Sets with a departure.

    Attributes
    ----------
    departing : mapping of Set to Departing
        What the backbones say of each set.
    probabilities : mapping of Set to float
        Of each set; what they lack of one is the drift's.
    gaps : mapping of Set to float
        Departure that each set needs, as a share of what the base needs.
    drift_probability : float
        Of the base with a drift in time.
    is_law : bool
        Whether the departure goes with the amplitude; else it is each specimen's own, as a drift makes it.
    nodes : (j,) array
        Logarithms of the amplitudes of the departures.
    """

    departing: Mapping[Set, Departing]
    probabilities: Mapping[Set, float]
    gaps: Mapping[Set, float]
    drift_probability: float
    is_law: bool
    nodes: FloatArray

    def ranked(self) -> list[Set]:
        """Return the sets, most probable first."""
        return sorted(self.probabilities, key=lambda names: -self.probabilities[names])


def weigh(search: Search) -> Weighed | None:
    """Return the probabilities of all sets within reach if none is exact, and that of a drift with time.

    None where the base cannot be simulated at the levels, and where no record spans a factor `LEAST_SPAN` in amplitude:
    over less a departure draws whatever a law does.

    Every set is fitted to the backbones with the departure that it needs in their covariance: what it cannot follow
    exactly does not pull it away from what it can follow.
    """
    if max(term.levels[-1] / term.levels[0] for term in search.batch.levels) < LEAST_SPAN:
        return None
    chosen = _specimens(search)
    departures = DepartingSets(search.batch.subset(chosen), search.base.mass)
    departing = _departing(search, departures, chosen)
    beside = _harmonics(search, departing, chosen)
    sizes = {names: _log_size(search, names, item, departures, departing.get(())) for names, item in departing.items()}
    beside = {names: value + sizes[names] for names, value in beside.items()}
    logs = {names: item.log_evidence + _log_prior(names, search) + beside[names] for names, item in departing.items()}
    outdone = _outdone(search)
    logs = {names: value for names, value in logs.items() if np.isfinite(value) and names not in outdone}
    if () not in logs:
        return None
    gaps = gaps_of(departing, departures)
    priors = {names: _log_prior(names, search) for names in logs}
    logs = with_smaller(logs, priors, departing, departures)
    best = max(logs, key=lambda names: logs[names])
    of_drift = -np.inf
    if search.batch.has_records:
        drifting = _drifting(search, departures, departing[()], ())
        if least_gap(departing[()], drifting, departures) < _DRIFTS:
            of_drift = _log_of_drift(search, drifting, ())
        for names in _beside_drift(logs):  # what is left beside a law may go with the time
            beside_law = _log_of_drift(search, _drifting(search, departures, departing[names], names), names)
            logs[names] = float(np.logaddexp(logs[names], beside_law + beside[names]))
    total = float(logsumexp([*logs.values(), of_drift]))
    is_law = True
    if len(chosen) > 1:
        apart = departures.evidence_apart(departing[best], search.layout(best))
        is_explained = gaps[best] < _EXPLAINED
        is_law = is_explained or apart < _SEPARATE
    return Weighed(
        departing=departing,
        probabilities={names: float(np.exp(value - total)) for names, value in logs.items()},
        gaps=gaps,
        drift_probability=float(np.exp(of_drift - total)),
        is_law=is_law,
        nodes=departures.nodes,
    )


def _departing(search: Search, departures: DepartingSets, chosen: list[int]) -> dict[Set, Departing]:
    """Return what the backbones say of every set likely at first sight, of the base, and of the best's subsets."""
    search.progress("weighing sets that are not exact", 0.0)
    sets = _looked_at(search)

    def glance(names: Set) -> Point | None:
        return departures.glance(search.layout(names), _states(search, names, chosen))

    for names in sets:
        search.layout(names)
    seen = in_threads([partial(glance, names) for names in sets])
    glances = {names: item for names, item in zip(sets, seen, strict=True) if item is not None}
    glances = {names: item for names, item in glances.items() if np.isfinite(item.log_evidence)}
    departing: dict[Set, Departing] = {}

    def refine(chosen_sets: Sequence[Set]) -> None:
        wanted = [names for names in chosen_sets if names in glances and names not in departing]
        refined = in_threads([partial(departures.refined, glances[names]) for names in wanted])
        departing.update(zip(wanted, refined, strict=True))

    first = {names: item.log_evidence + _log_prior(names, search) for names, item in glances.items()}
    order = sorted(first, key=lambda names: -first[names])
    refine([(), *order[:_LEADERS]])
    if () not in departing:
        return {}
    # a first sight may be far too low, and those without memory take next to nothing
    refine([names for names in order if not search.layout(names).simulator.needs_decay])
    search.progress("weighing sets that are not exact", 0.5)
    known = {names: item.log_evidence + _log_prior(names, search) for names, item in departing.items()}
    refine([names for names in order[:_MOST_WEIGHED] if first[names] > max(known.values()) - _REACH])
    refine([(name,) for name in search.candidates])
    departing.update(_looked_back(search, departures, departing))
    logs = {names: item.log_evidence + _log_prior(names, search) for names, item in departing.items()}
    best = max(logs, key=lambda names: logs[names])
    # what the best explains is shared out among its mechanisms
    refine([names for size in range(1, len(best)) for names in combinations(best, size)])
    return departing


def _harmonics(search: Search, departing: Mapping[Set, Departing], chosen: list[int]) -> dict[Set, float]:
    """Return what the harmonics say of each set, in the record of the largest amplitude."""
    largest = max(range(len(chosen)), key=lambda k: search.batch.levels[chosen[k]].levels[-1])
    record = Harmonics.of_batch(search.batch, chosen[largest])
    if record is None:
        return dict.fromkeys(departing, 0.0)
    has_side = all(item.offset_is_measured for item in search.batch.records)
    return {
        names: record.log_odds(
            search.layout(names), parameters_of(search.layout(names), item.state, largest), has_side=has_side
        )
        for names, item in departing.items()
    }


def _log_size(search: Search, names: Set, item: Departing, departures: DepartingSets, base: Departing | None) -> float:
    """Return how much rarer a set is whose forces are far larger than what is missing, as a natural logarithm.

    They compensate each other, or go unseen by chance. Beforehand a force is as large as the gap, or as the errors of
    the levels where that is less, with a tail that falls with the square of its size; widths of the evidence are in
    proportion to it, so it is rarer in proportion.
    """
    if base is None or not names:
        return 0.0
    # what is missing is not smaller than what could be seen: there may be no departure at all
    seen = np.where(np.isfinite(departures.noise), departures.noise, 0.0)
    gap = float(np.sqrt(((mean_squares(base) + seen**2) / departures.per_force**2).sum()))
    layout, amplitude, omega = search.layout(names), search.batch.amplitude, search.batch.angular_frequency
    vector = parameters_of(layout, item.state, 0)
    elastic = search.base.mass * omega**2 * amplitude
    speed, turning, lost = amplitude * omega, amplitude * omega**2, 0.0
    points = ((-amplitude, 0.0, turning), (amplitude, 0.0, -turning), (0.0, -speed, 0.0), (0.0, speed, 0.0))
    for effect in layout.oscillator.effects:
        if effect.name in names:
            own = np.array([vector[layout.oscillator.index(parameter.name)] for parameter in effect.parameters])
            states = np.zeros(effect.n_states)
            force = max(abs(effect.along(x, v, a, states, own)) for x, v, a in points)
            lost += np.log(max(force / elastic / (_AMPLE * gap), 1.0))
    return -float(lost)


def _outdone(search: Search) -> set[Set]:
    """Return the sets that leave several times as much of the samples, beyond noise, as one with no more unknowns.

    Backbones with a departure may not tell them apart, as a slider that slips in few cycles and a damper with a dead
    band; what disturbs the records disturbs all sets alike, and few unknowns do not make up for it by chance. Sets that
    are all far off tell nothing so: their phase is lost in one way or another.
    """
    excess = {names: max(search.reduced(found) - 1.0, 0.0) for names, found in search.fits.items() if names}
    near = {names: left for names, left in excess.items() if left < _NEAR and search.fits[names].is_converged}
    sizes = {names: search.layout(names).free.size for names in excess}
    return {
        names
        for names, left in excess.items()
        if any(sizes[other] <= sizes[names] and left > _OUTDONE * less + _NO_CHANCE for other, less in near.items())
    }


def _looked_back(search: Search, departures: DepartingSets, departing: Mapping[Set, Departing]) -> dict[Set, Departing]:
    """Return the subsets of the likeliest sets that fit better from where these ended: these had found a better way."""
    logs = {names: item.log_evidence + _log_prior(names, search) for names, item in departing.items()}
    likeliest = sorted(logs, key=lambda names: -logs[names])[:_LOOKED_BACK]
    begun: dict[Set, list[State]] = {}
    for larger in likeliest:
        state, there = departing[larger].state, search.layout(larger)
        for name in larger:
            smaller = tuple(other for other in larger if other != name)
            begun.setdefault(smaller, []).append(starts.restricted(search.layout(smaller), there, state))
    sets = list(begun)
    jobs = [partial(departures.evidence, search.layout(names), begun[names]) for names in sets]
    found = {names: item for names, item in zip(sets, in_threads(jobs), strict=True) if item is not None}
    known = {names: departing[names].log_evidence if names in departing else -np.inf for names in found}
    return {names: item for names, item in found.items() if item.log_evidence > known[names]}


def _beside_drift(logs: Mapping[Set, float]) -> list[Set]:
    """Return the sets that are asked with a drift beside them: what is in the likeliest ones."""
    likeliest = sorted(logs, key=lambda names: -logs[names])[:_LOOKED_BACK]
    parts = (part for names in likeliest for size in range(1, len(names) + 1) for part in combinations(names, size))
    return [names for names in dict.fromkeys(parts) if names in logs]


def _drifting(search: Search, departures: DepartingSets, found: Departing, names: Set) -> list[Departing]:
    """Return what the backbones say of a set with a drift in time: in each record, or alike in all."""
    jobs = [
        partial(departures.evidence, search.layout(names), [found.state], drifts=kind) for kind in ("own", "common")
    ]
    return [item for item in in_threads(jobs) if item is not None]


def _log_of_drift(search: Search, drifting: Sequence[Departing], names: Set) -> float:
    """Return the logarithm of evidence and prior of a set with a drift in time."""
    if not drifting:
        return -np.inf
    # a drift stands for an effect more; the base with one is no model with a departure
    prior = (
        _log_prior(names, search) + np.log(evidence.DRIFTING)
        if names
        else evidence.log_prior(1, len(search.candidates))
    )
    return float(logsumexp([item.log_evidence for item in drifting]) - np.log(2.0) + prior)


def _specimens(search: Search) -> list[int]:
    """Return specimens that tell enough: of several release amplitudes, not more turning points than it takes."""
    batch = search.batch
    order = np.argsort([-term.levels[-1] for term in batch.levels])
    chosen: list[int] = []
    for k in spread(order.size, _MOST_SPECIMENS):
        size = sum(batch.turning[r].times.size for r in (*chosen, order[k])) if batch.turning else 0
        if len(chosen) < 2 or size <= _MOST_TURNS:
            chosen.append(int(order[k]))
    return sorted(chosen)


def _log_prior(names: Set, search: Search) -> float:
    """Return the logarithm of the prior of a set where the model as it is lacks something and no law is exact.

    Mechanisms come first: so many of them are missing with the probabilities `PRIOR_OF_COUNT`, each choice of them
    alike, and within each its laws; how many unknowns these have is charged by the evidence. Two laws of one mechanism
    are hardly ever needed. The base with a departure is what the library does not hold.
    """
    laws: dict[str, dict[str, float]] = {}
    for name in (*search.candidates, *search.variants):
        laws.setdefault(search.mechanism_of(name), {})[name] = evidence.VARIANT if name in search.variants else 1.0
    held: dict[str, list[str]] = {}
    for name in names:
        held.setdefault(search.mechanism_of(name), []).append(name)
    share = PRIOR_OF_COUNT[min(len(held), len(PRIOR_OF_COUNT) - 1)] / comb(len(laws), len(held))
    for mechanism, chosen in held.items():
        weights = laws[mechanism]
        together = {
            k: float(np.prod([weights[name] for name in k])) for k in combinations(sorted(weights), len(chosen))
        }
        share *= _TWICE ** (len(chosen) - 1) * together[tuple(sorted(chosen))] / sum(together.values())
    return float(np.log(share))


def _looked_at(search: Search) -> list[Set]:
    """Return the sets that are fitted with a departure: all that are simulated fast, and of the others the likeliest.

    The likeliest are those that were fitted to the records, single effects, and what the backbones propose.
    """
    sizes = range(search.max_effects + 1)
    every = [tuple(sorted(names)) for size in sizes for names in combinations(search.candidates, size)]
    light = [names for names in every if not is_heavy(search.layout(names))]
    heavy = [names for names in search.proposals if is_heavy(search.layout(names))]
    fitted = sorted(search.fits, key=len)
    return list(dict.fromkeys([*fitted, *every[: 1 + len(search.candidates)], *light, *heavy[:_MOST_HEAVY]]))


def _states(search: Search, names: Set, chosen: list[int]) -> list[State]:
    """Return starts of a set: its fit to the records, what its backbones propose, a larger set without the rest."""
    layout = search.layout(names)
    begun: list[State] = []
    own = search.batch.own[chosen]
    base = search.fits[()].state.own[chosen]
    known = search.fits.get(names)
    if known is not None:
        begun.append(State(known.state.eta, known.state.own[chosen]))
    if names in search.proposals:
        for _, eta, stiffness in search.proposals[names].starts[: _MOST_STARTS if len(names) < 2 else 1]:
            values = own.copy()
            values[:, :2] = stiffness[chosen]
            begun.append(start_state(layout, eta, values))
    if not begun:
        larger = [other for other in search.fits if set(names) < set(other)]
        if larger:
            near = search.fits[min(larger, key=len)]
            alone = starts.restricted(layout, near.layout, near.state)
            begun.append(start_state(layout, alone.eta, alone.own[chosen][:, :NUISANCES]))
        else:
            begun.append(start_state(layout, np.zeros(layout.free.size), base[:, :NUISANCES]))
    return begun


__all__ = ["Weighed", "weigh"]
