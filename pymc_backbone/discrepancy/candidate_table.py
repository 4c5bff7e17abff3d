"""The table of all sets that were tried: how probable each is, what became of it, and why."""

from __future__ import annotations

from .curves import level_chi_square, on_levels
from .decide import Decision
from .estimates import estimates_of
from .joint_fit import Fit
from .search import Search, Set
from .study import Candidate
from .verdict import Status

_LISTED_LEFT = 20  # sets in the table that were compared by their backbones only
_POSSIBLE = 0.01  # probability from which a set is called possible


def candidates_of(search: Search, decision: Decision) -> tuple[Candidate, ...]:
    """Return the table of all sets, most probable first, each with what became of it and why."""
    rows = []
    count = sum(w.size for w in search.batch.deciding)
    best_cost = search.fits[decision.best].cost
    for names, found in search.fits.items():
        probability = decision.probabilities.get(names, 0.0)
        weighed = decision.evidences.get(names)
        reduced = float(found.chi_square.sum() / count)
        status = Status.POSSIBLE if probability > _POSSIBLE else Status.REJECTED
        status = Status.NOT_CONVERGED if status is Status.REJECTED and search.is_open(names) else status
        status = Status.BEST if names == decision.best else status
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
                reason=_reason(names, found, decision, best_cost, status),
                parameters=estimates_of(found),
            )
        )
    rows.sort(key=lambda item: -item.probability)
    failed = [
        Candidate(names, 0.0, float("nan"), float("nan"), float("nan"), Status.FAILED, reason)
        for names, reason in search.failed.items()
    ]
    return (*rows, *failed, *_by_backbones_alone(search))


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
            reason=f"its backbones leave a chi-square that is larger by {max(item.chi_square - best, 0.0):.3g}",
        )
        for item in chosen
    ]


def _reason(names: Set, found: Fit, decision: Decision, best_cost: float, status: Status) -> str:
    if status is Status.BEST:
        return "the most probable set"
    extra = set(names) - set(decision.best)
    gain = best_cost - found.cost
    if status is Status.NOT_CONVERGED:
        return "could explain the backbones, but its fit to the records did not come to rest"
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
