"""The table of all sets that were tried: how probable each is, what became of it, and why."""

from __future__ import annotations

import numpy as np

from ..._common.text import in_words
from ..deciding.decision import Decision
from ..fitting.curves import level_chi_square, on_levels
from ..fitting.estimates import estimates_of
from ..results.entries import Candidate
from ..results.verdict import Status
from ..sets.search import Search, Set
from ..weighing import evidence

_IMPROBABLE = 1e-9  # probability below which sets are in the order of what they leave
_LISTED_LEFT = 20  # sets in the table that were compared by their backbones only
_POSSIBLE = 0.01  # probability from which a set is called possible
_NOT_CHECKED = "; its evidence is Laplace's, which importance sampling could not check"
_WITH_DRIFT = "; with a drift in time beside it"
_AS_MUCH = 1.0  # chi-square of the backbones up to which a set leaves as much as the likeliest
_BY_BACKBONES = "by its backbones, with what no law explains in them, far less probable"
_ABOUT = 0.5  # of the best set's probability, from which a set explains the records about as well


def candidates_of(search: Search, decision: Decision) -> tuple[Candidate, ...]:
    """Return the table of all sets, most probable first, each with what became of it and why."""
    rows = []
    # out of phase the sum of squares over the samples compares nothing
    best_cost = float("nan") if search.is_refuted(decision.best) else search.fits[decision.best].cost
    for names, found in search.fits.items():
        probability = decision.probabilities.get(names, 0.0)
        weighed, shift = decision.evidences.get(names), decision.corrected.sets.get(names)
        reduced = search.reduced(found)
        status = status_of(names, probability, decision, is_open=search.is_open(names))
        rows.append(
            Candidate(
                effects=names,
                probability=probability,
                log_evidence=float("nan") if weighed is None else weighed.log_evidence,
                reduced_chi_square=reduced,
                backbone_chi_square=level_chi_square(search.batch, on_levels(search.batch, found))
                if status is not Status.REJECTED or len(names) < 2
                else float("nan"),
                status=status,
                reason=_reason(names, probability, best_cost - found.cost, decision, status)
                + (_WITH_DRIFT if names in decision.drifts else "")
                + ("" if shift is None or shift.is_trusted else _NOT_CHECKED),
                parameters=estimates_of(found),
                evidence_shift=float("nan") if shift is None else shift.log_value,
                pareto_k=float("nan") if shift is None else shift.pareto_k,
                is_bridged=shift is not None and shift.is_bridged,
                has_drift=names in decision.drifts,
            )
        )
    rows.sort(key=lambda item: _place(item, decision))
    failed = [
        Candidate(names, 0.0, float("nan"), float("nan"), float("nan"), Status.FAILED, reason)
        for names, reason in search.failed.items()
    ]
    return (*rows, *failed, *_by_backbones_alone(search))


def _place(row: Candidate, decision: Decision) -> tuple[float, bool, float]:
    """Return what rows are sorted by: probability; of improbable sets the one that is told, then what they leave."""
    is_last = row.probability < _IMPROBABLE
    left = row.reduced_chi_square if np.isfinite(row.reduced_chi_square) else np.inf
    return 0.0 if is_last else -row.probability, row.effects != decision.nearest, left


def status_of(names: Set, probability: float, decision: Decision, *, is_open: bool) -> Status:
    """Return what became of a set: none is rejected that the verdict lists, however little of the probability it has.

    ``is_open`` says that the fit of the set did not come to rest.
    """
    if names == decision.best:
        return Status.BEST
    if probability > _POSSIBLE:
        return Status.POSSIBLE
    if is_open:
        return Status.NOT_CONVERGED
    return Status.POSSIBLE if names in decision.listed else Status.REJECTED


def _by_backbones_alone(search: Search) -> list[Candidate]:
    """Return the likeliest of the sets that their backbones already rejected; nothing where these were not asked."""
    if not search.has_proposals:
        return []
    proposals = search.proposals
    left = [item for names, item in proposals.items() if names not in search.fits and names not in search.failed]
    singles = [item for item in left if len(item.names) == 1]
    chosen = list(dict.fromkeys([*left[:_LISTED_LEFT], *singles]))
    values = sum(term.size for term in search.batch.levels)
    best = next(iter(proposals.values())).chi_square
    return [
        Candidate(
            effects=item.names,
            probability=0.0,
            log_evidence=float("nan"),
            reduced_chi_square=float("nan"),
            backbone_chi_square=item.chi_square / max(values - 2 * len(search.batch.levels), 1),
            status=Status.REJECTED,
            reason=_of_backbones(item.chi_square - best),
        )
        for item in chosen
    ]


def _of_backbones(excess: float) -> str:
    """Return why a set was left aside whose backbones leave so much more chi-square than those of the likeliest."""
    if excess < _AS_MUCH:
        return "its backbones leave no more chi-square, with less evidence"
    return f"its backbones leave a chi-square that is larger by {excess:.3g}"


def _of_best(decision: Decision) -> str:
    """Return why the set that the verdict is said of is the best, which need not be the most probable by itself."""
    if decision.probabilities.get(decision.best, 0.0) >= max(decision.probabilities.values(), default=0.0):
        return "the most probable set"
    if decision.below:
        return "the most probable set together with those that differ from it by what is below the tolerance only"
    if decision.best:
        return "the most probable set without what is only possible in it"
    if decision.p_missing > evidence.MISSING:
        return f"a gap as large as this is no rare chance without any missing effect (p = {decision.p_missing:.2g})"
    return "no set of effects explains enough to be told in its place"


def _reason(names: Set, probability: float, gain: float, decision: Decision, status: Status) -> str:
    """Return why a set has its status; ``gain`` is the chi-square of the best set minus that of this one.

    NaN where the best set was not followed to the samples: over so many cycles none keeps the phase.
    """
    if status is Status.BEST:
        return _of_best(decision)
    extra = set(names) - set(decision.best)
    if status is Status.NOT_CONVERGED:
        return "could explain the backbones, but its fit to the records did not come to rest"
    if status is Status.REJECTED and not np.isfinite(gain):
        return _BY_BACKBONES
    if set(decision.best) < set(names) and np.isfinite(gain) and not (decision.is_approximate and gain > 0.0):
        return f"adds {', '.join(map(in_words, sorted(extra)))}, which improves chi-square by {max(gain, 0.0):.3g} only"
    if set(names) < set(decision.best) and np.isfinite(gain):
        lost = ", ".join(map(in_words, sorted(set(decision.best) - set(names))))
        return f"without {lost} chi-square is {'larger' if gain < 0.0 else 'smaller'} by {abs(gain):.3g}"
    if status is Status.POSSIBLE:
        chance = decision.probabilities.get(decision.best, 0.0)
        if probability > _ABOUT * chance:
            return "explains the records about as well"
        odds = chance / max(probability, 1e-300)
        return (
            f"remains possible, {odds:.2g} times less probable than the best set" if odds < 1e4 else "remains possible"
        )
    if gain < 0.0:
        return f"chi-square is larger by {-gain:.3g}"
    if decision.is_approximate:
        return f"chi-square is smaller by {gain:.3g}, but {_BY_BACKBONES}"
    return f"chi-square is smaller by {gain:.3g}, less than its extra parameters are worth"
