"""Sets of which the records say as much as of the best one, however much rarer they are.

Where they do, a name would be what was thought before anything was measured: nonlinear inertia is met less often than a
cubic spring, but whoever has a structure with it is told a spring.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..sets.search import Search, Set
from ..weighing.evidence import Evidence

_BARE_MENTION = 3.0  # Bayes factor up to which evidence is "not worth more than a bare mention"
_POSSIBLE = 0.003  # probability from which a set is one to be told


def rivals_of(
    search: Search, best: Set, evidences: Mapping[Set, Evidence], probabilities: Mapping[Set, float]
) -> tuple[Set, ...]:
    """Return the sets that the records speak for as much as for the best one [1]_, most probable first.

    Of no more effects and no more unknowns than the best has, and without all of its effects. One with more unknowns
    that is no likelier than the best holds it at some value of these, or comes near it, and does not contradict it.

    Parameters
    ----------
    search : Search
        All sets and their fits.
    best : tuple of str
        The set that would be named.
    evidences, probabilities : mappings
        Of every set that was fitted.

    Returns
    -------
    tuple of tuple of str

    References
    ----------
    .. [1] Kass R. E., Raftery A. E. (1995) Bayes factors. Journal of the American Statistical Association 90(430),
       773-795. doi:10.1080/01621459.1995.10476572
    """
    if not best:
        return ()
    unknowns = search.layout(best).free.size
    least = evidences[best].log_evidence - np.log(_BARE_MENTION)
    found = [
        names
        for names, chance in probabilities.items()
        if names
        and not set(best) <= set(names)
        and len(names) <= len(best)
        and search.layout(names).free.size <= unknowns
        and chance >= _POSSIBLE
        and evidences[names].log_evidence > least
    ]
    return tuple(sorted(found, key=lambda names: -probabilities[names]))


__all__ = ["rivals_of"]
