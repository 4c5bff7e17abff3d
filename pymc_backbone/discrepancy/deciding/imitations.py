"""Whether sets imitate what the library lacks: how probable it is that it holds what is missing, and what stands in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..sets.search import Search, Set
from ..weighing import evidence
from ..weighing.evidence import Evidence

COMPENSATED = 2.0
"""Times as much as is left, beyond which an imitation is more probable, with the square."""
_IMITATES = (0.0, 0.03, 0.06, 0.15)  # how probable it is that a set of so many effects imitates what the library lacks
_HARDLY = 200.0  # gap in standard deviations of the noise beyond which that is rarer, in proportion
_STANDS_IN = 0.2  # how probable it is that the weakest of several effects stands in for what the library lacks
_SMALL = 12.0  # gap that it closes, in standard deviations of the noise, beyond which that is rarer
_LARGE = 0.01  # share of the motion that this gap is, beyond which that is rarer, too
_WEIGHT_OF_NOISE = 0.1  # how much rarer residuals like noise are where the library lacks what is missing


def least_bayes_factor(p_value: float) -> float:
    """Return the least Bayes factor for the null hypothesis that a p-value allows: ``-e p ln p``, 1 from 1/e on."""
    p = min(max(p_value, 1e-300), float(np.exp(-1.0)))
    return float(-np.exp(1.0) * p * np.log(p))


def library_holds(p_value: float) -> float:
    """Return the probability that the library holds what is missing, by the p-value of the best set's residuals."""
    none = evidence.PRIOR_NONE * _WEIGHT_OF_NOISE / least_bayes_factor(p_value)
    return (1.0 - evidence.PRIOR_NONE) / (1.0 - evidence.PRIOR_NONE + none)


def is_none_other(search: Search, names: Set, has_drift: bool = False, compensated: float = 1.0) -> float:
    """Return the probability that a set which leaves noise is not the imitation of something the library lacks.

    The more effects a set has, the less probable it is beforehand, and the more it can imitate; but what explains a gap
    of thousands of standard deviations to the noise is hardly ever an imitation. A drift beside it counts as one more.
    Effects that are ``compensated`` by each other (`compensation`) imitate more often.
    """
    size = min(len(names) + has_drift, len(_IMITATES) - 1)
    gap = float(np.sqrt(max(search.fits[()].cost - search.fits[names].cost, 0.0)))
    imitates = _IMITATES[size] * min(1.0, _HARDLY / max(gap, 1.0))
    imitates = min(imitates * max(compensated / COMPENSATED, 1.0) ** 2, 1.0)
    prior = evidence.PRIOR_OF_SIZE[size]
    return prior / (prior + evidence.PRIOR_NONE * imitates)


def doubted(search: Search, evidences: Mapping[Set, Evidence]) -> dict[Set, Evidence]:
    """Return the evidences where the weakest of several effects may stand in for something small of another kind.

    Beside what dominates, every structure holds things that no library describes, and of some twenty effects one often
    makes up for a small one down to the noise. So much of the probability of a set goes to the set without its weakest
    effect, by the gap that this one closes in standard deviations of the noise, and as a share of the motion.
    """
    known = dict(evidences)
    motion = evidence.size_of_motion(search.batch)
    for names, found in sorted(search.fits.items(), key=lambda item: -len(item[0])):
        parents = [parent for parent in combinations(names, max(len(names) - 1, 0)) if parent in search.fits]
        if len(names) < 2 or not parents:
            continue
        parent = min(parents, key=lambda item: search.fits[item].cost)
        gap = float(np.sqrt(max(search.fits[parent].cost - found.cost, 0.0)))
        stands_in = _STANDS_IN * min(1.0, _SMALL / max(gap, 1.0)) ** 1.5 * min(1.0, _LARGE * motion / max(gap, 1.0))
        moved = known[names].probability * stands_in / (1.0 + stands_in)
        for item, change in ((names, -moved), (parent, moved)):
            known[item] = replace(known[item], probability=known[item].probability + change)
    return known


__all__ = ["COMPENSATED", "doubted", "is_none_other", "least_bayes_factor", "library_holds"]
