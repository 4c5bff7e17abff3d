"""Sets of effects fitted beside each other on the cores of this machine, the same on one core as on many.

A single record leaves one core without work, and several leave one waiting for the other. So sets are fitted two at a
time. Each sees what was known before either was begun: which of them ends first does not matter.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from ..._common.threads import in_threads
from ..proposals.set_fits import Set
from .fitted_sets import FittedSets

ABREAST = 2
"""Sets that are fitted beside each other: a constant, because a fit depends on those that are known before."""


def fit_side_by_side(search: FittedSets, sets: Sequence[Set]) -> None:
    """Fit some sets, at most `ABREAST`, beside each other.

    Parameters
    ----------
    search : FittedSets
        Gets the fits and failures, as `FittedSets.fit_set` leaves them, and the effort of all.
    sets : sequence of tuple of str
        Those that were fitted before are left alone. One that holds another of them begins when that has ended, for it
        may begin where that one did.
    """
    new = [names for names in dict.fromkeys(sets) if names not in search.fits and names not in search.failed]
    larger = [names for names in new if any({*other} < {*names} for other in new)]
    if larger:
        fit_side_by_side(search, [names for names in new if names not in larger])
        fit_side_by_side(search, larger)
        return
    if len(new) < 2:
        for names in new:
            search.fit_set(names)
        return
    for names in new:
        search.layout(names)
    if not search.is_any_exact(search.fits.values()):
        _ = search.proposals  # asked once for all
    branches = [_branch(search) for _ in new]
    in_threads([partial(branch.fit_set, names) for branch, names in zip(branches, new, strict=True)])
    begun = search.descent.effort
    for branch in branches:
        _join(search, branch, begun)


def _branch(search: FittedSets) -> FittedSets:
    """Return a search that knows what this one does, and learns apart from it."""
    branch = copy.copy(search)
    branch.fits, branch.failed, branch.refuted = dict(search.fits), dict(search.failed), set(search.refuted)
    branch.layouts, branch.asked, branch.noisy = dict(search.layouts), dict(search.asked), dict(search.noisy)
    branch.descent = replace(search.descent)
    return branch


def _join(search: FittedSets, branch: FittedSets, begun: float) -> None:
    """Take over what a branch learned; ``begun`` is the effort when it began."""
    search.fits.update(branch.fits)
    search.failed.update(branch.failed)
    search.layouts.update(branch.layouts)
    search.asked.update(branch.asked)
    search.noisy.update(branch.noisy)
    search.refuted |= branch.refuted
    search.limited = branch.limited
    search.descent.effort += branch.descent.effort - begun
    if branch.has_proposals and not search.has_proposals:
        search.proposals = branch.proposals


__all__ = ["ABREAST", "fit_side_by_side"]
