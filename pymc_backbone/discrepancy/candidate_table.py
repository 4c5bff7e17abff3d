"""The table of all sets that were tried: how probable each is, what became of it, and why."""

from __future__ import annotations

from .curves import level_chi_square, on_levels
from .decide import Decision
from .estimates import estimates_of
from .joint_fit import Fit
from .search import Search, Set
from .study import Candidate
from .verdict import Status

_POSSIBLE = 0.01  # probability from which a set is called possible


def candidates_of(search: Search, decision: Decision) -> tuple[Candidate, ...]:
    """Return the table of all sets, most probable first, each with what became of it and why."""
    rows = []
    count = sum(w.size for w in search.batch.deciding)
    best_cost = search.fits[decision.best].cost
    for names, found in search.fits.items():
        probability = decision.probabilities[names]
        reduced = float(found.chi_square.sum() / count)
        status = Status.POSSIBLE if probability > _POSSIBLE else Status.REJECTED
        status = Status.BEST if names == decision.best else status
        rows.append(
            Candidate(
                effects=names,
                probability=probability,
                log_evidence=decision.evidences[names].log_evidence,
                reduced_chi_square=reduced,
                backbone_chi_square=level_chi_square(search.batch, on_levels(search.batch, found))
                if status is not Status.REJECTED or len(names) < 2
                else float("nan"),
                status=status,
                reason=_reason(names, found, decision, best_cost, status),
                parameters=estimates_of(found),
            )
        )
    rows.sort(key=lambda item: -item.probability)
    failed = [
        Candidate(names, 0.0, float("nan"), float("nan"), float("nan"), Status.FAILED, reason)
        for names, reason in search.failed.items()
    ]
    return (*rows, *failed)


def _reason(names: Set, found: Fit, decision: Decision, best_cost: float, status: Status) -> str:
    if status is Status.BEST:
        return "the most probable set"
    extra = set(names) - set(decision.best)
    gain = best_cost - found.cost
    if set(decision.best) < set(names):
        return f"adds {', '.join(sorted(extra))}, which improves chi-square by {max(gain, 0.0):.3g} only"
    if set(names) < set(decision.best):
        lost = ", ".join(sorted(set(decision.best) - set(names)))
        return f"without {lost} chi-square is larger by {-gain:.3g}"
    if status is Status.POSSIBLE:
        return "explains the records about as well"
    if gain < 0.0:
        return f"chi-square is larger by {-gain:.3g}"
    return f"chi-square is smaller by {gain:.3g}, less than its extra parameters are worth"
