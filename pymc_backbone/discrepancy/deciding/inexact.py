"""The verdict where no set is exact: sets are weighed with a departure, and mechanisms named instead of laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from ..._common.threads import in_threads
from ...effects import EITHER
from ..checks.data_checks import are_far_off
from ..fitting.curves import about_zero, fit_on_levels, has_mid_line, level_chi_square, on_levels, spread
from ..fitting.joint_fit import Fit
from ..results.entries import MissingMechanism
from ..results.verdict import MECHANISM_NAMED, NamedLevel, Verdict
from ..sets.search import Search, Set
from ..sets.varied_sets import NEEDED
from ..weighing import evidence
from .compensation import compensation
from .decision import AGREE, DRIFT_POSSIBLE, MOST_LISTED, Decision, listed
from .mechanisms import Weighed, weigh
from .shares import estimates_with, missing_mechanisms, remainder_of

_LITTLE = 0.01  # probability of a set from which its effects are doubted; and of one over the likeliest to tell it
_NEAR = 3.0  # reduced chi-square up to which the samples say so
_ALL_BUT_NOTHING = 0.9  # of what the base leaves of the samples, that what explains none of them leaves
_NOTHING = 0.7  # of the gap, that a set leaves which explains next to nothing
_MOST_UNFINISHED = 5  # sets that did not come to rest, listed although others are more probable
_SOME = 3  # specimens that say so
_UNDONE = 5.0  # times as much as a set does, that an effect in it does, beyond which it is no explanation
_MUCH_LESS = 0.3  # of what the base leaves of the samples, over which a set comes nowhere near them
_LESS, _NEEDED = 0.5, 3.0  # times what the best set leaves, and of which a set leaves more without an effect it needs
MOST_OF_THE_GAP = 0.85
"""Share of the gap that named mechanisms explain together: it shrinks at least sevenfold."""


def departing(search: Search, decision: Decision) -> Decision:
    """Return the decision where no set is exact: sets are weighed with a departure, and mechanisms named, no law.

    What goes with the time since the release, or differs between releases at the same amplitude, is no law: then the
    records are unexplained, and so where what is most probable leaves most of the gap, or would be named and leaves the
    backbones far off.
    """
    weighed = weigh(search)
    if weighed is None:
        return replace(decision, verdict=Verdict.UNEXPLAINED, below=())
    weighed = _without_idle(search, weighed)
    ranked = weighed.ranked()
    best = next((names for names in ranked if _is_kept(search, weighed, names)), ())
    mechanisms = _told(search, weighed, best)
    certain = certain_sets(search, mechanisms, ranked)
    least = _LITTLE * max((weighed.probabilities[names] for names in certain), default=0.0)
    probable = [names for names in certain if weighed.probabilities[names] >= least]
    simpler = next((names for names in probable if weighed.gaps[names] <= 1.0 - MOST_OF_THE_GAP), None)
    simpler = None if simpler is None else _without_what_idles(search, weighed, simpler)
    if simpler is not None and simpler != best and _is_kept(search, weighed, simpler):
        # what is only possible beside the certain takes nothing of what these explain alone
        best, mechanisms = simpler, _told(search, weighed, simpler)
    is_lost = search.is_refuted(best) or best not in search.fits
    is_nothing = weighed.gaps[best] > _NOTHING or (not is_lost and leaves_the_samples(search, search.fits[best]))
    if is_nothing and not any(item.is_certain for item in mechanisms):
        # what explains next to nothing is no explanation, nor the best of any
        best, mechanisms, weighed = (), (), _without_those_that_explain_nothing(weighed)
    nearest = None if best else _nearest(search)
    is_named = is_told_apart(mechanisms) and weighed.drift_probability < DRIFT_POSSIBLE
    chances = weighed.probabilities
    if best and is_named and not is_lost and _leaves_the_backbones(search, best):
        nearest, best, mechanisms = best, (), ()
        chances = {**chances, nearest: 0.0}  # it is that of none known
    search.mend(best)
    lack = evidence.lack_of_fit(search.batch, search.fits[best])
    if search.is_refuted(best):
        lack = replace(lack, share=float("nan"))  # of a motion out of phase
    known = replace(
        decision,
        best=best,
        probability=chances[best],
        probabilities=chances,
        lack=lack,
        nearest=nearest,
        below=(),
        simulated=None,
        drift_probability=weighed.drift_probability,
        mechanisms=mechanisms,
        remainder=remainder_of(weighed, best),
        is_approximate=True,
        is_single_valued=weighed.is_law,
        on_backbones=_on_backbones(search, best, weighed) if search.is_refuted(best) else None,
    )
    if not weighed.is_law or weighed.drift_probability > 0.5:
        return replace(known, verdict=Verdict.UNEXPLAINED)
    if weighed.gaps[best] > 1.0 - MOST_OF_THE_GAP:
        unfinished = _unfinished(search, weighed, decision.ranked)
        if unfinished:  # what was not fitted to its end is not refuted
            possible = _with_unfinished(_remaining(search, weighed), unfinished, weighed)
            return replace(known, verdict=Verdict.AMBIGUOUS, listed=possible, unfinished=unfinished)
        return replace(known, verdict=Verdict.UNEXPLAINED)
    if is_named:
        return replace(known, verdict=Verdict.FOUND, named_level=NamedLevel.MECHANISM)
    return replace(known, verdict=Verdict.AMBIGUOUS, listed=_remaining(search, weighed))


def _remaining(search: Search, weighed: Weighed) -> tuple[Set, ...]:
    """Return the sets that remain possible: the base with a departure is no explanation, and not listed as one."""
    sets = {names: chance for names, chance in weighed.probabilities.items() if names and names in search.fits}
    return listed(sets, 1.0 - sum(sets.values()))


def _with_unfinished(remaining: tuple[Set, ...], unfinished: tuple[Set, ...], weighed: Weighed) -> tuple[Set, ...]:
    """Return the sets that remain possible with some whose fit did not come to rest, most probable first."""
    beside = [names for names in unfinished if names not in remaining][:_MOST_UNFINISHED]
    return tuple(names for names in weighed.ranked() if names in (*remaining[: MOST_LISTED - len(beside)], *beside))


def _nearest(search: Search) -> Set | None:
    """Return the set that leaves least of the samples, if that is much less than the base does."""
    names = min(search.fits, key=lambda item: search.fits[item].cost)
    leaves, base = (search.fits[item].cost - search.count for item in (names, ()))
    return names if names and leaves < _MUCH_LESS**2 * base else None


def leaves_the_samples(search: Search, found: Fit) -> bool:
    """Return whether a fit leaves next to all of what the base, in phase with the samples, leaves of them.

    A base whose backbones are near those of the records leaves little of these to explain: whatever explains that is no
    explanation of the rest.
    """
    if () not in search.fits or search.is_refuted(()):
        return False
    base, left = (item.cost - search.count for item in (search.fits[()], found))
    return bool(left > _ALL_BUT_NOTHING**2 * base > 0.0)


def _leaves_the_backbones(search: Search, names: Set) -> bool:
    """Return whether a set leaves the backbones far off, brought to them as it is: it explains no amplitude then.

    A second mode at twice the frequency passes for a spring of two sides, but falls as it likes.
    """
    batch, found = search.batch, search.fits[names]
    lacks_mid_line = has_mid_line(batch, found) and any(term.order for term in batch.waveform)
    if not batch.has_records or batch.is_behind_filter or lacks_mid_line:
        return False
    seen = about_zero(batch, found)
    brought, before = (level_chi_square(batch, on_levels(seen, item)) for item in (found, search.fits[()]))
    left = min(brought, level_chi_square(batch, found))  # with its drift in time
    return are_far_off(left, AGREE, before, is_exact=False)


def _without_those_that_explain_nothing(weighed: Weighed) -> Weighed:
    """Return the sets without the probability of those that leave next to all of the gap: it is that of none known."""
    chances = {names: 0.0 if weighed.gaps[names] > _NOTHING else p for names, p in weighed.probabilities.items()}
    return replace(weighed, probabilities=chances)


def _without_idle(search: Search, weighed: Weighed) -> Weighed:
    """Return the sets without what does nothing for the samples: its probability goes to the set without that effect.

    Backbones are made of the samples. What brings them nearer and these not follows an error of the backbones.
    """
    chances = dict(weighed.probabilities)
    for names in sorted(chances, key=len, reverse=True):
        for parent in combinations(names, max(len(names) - 1, 0)):
            if chances[names] < _LITTLE or parent not in chances or not _is_idle(search, names, parent):
                continue
            chances[parent] += chances[names]
            chances[names] = 0.0
            break
    return replace(weighed, probabilities=chances)


def _without_what_idles(search: Search, weighed: Weighed, names: Set) -> Set:
    """Return a set without effects that do nothing for the samples; what these rule out was not weighed."""
    for parent in combinations(names, max(len(names) - 1, 0)):
        if parent in weighed.probabilities and _is_idle(search, names, parent):
            return _without_what_idles(search, weighed, parent)
    return names


def _is_idle(search: Search, names: Set, parent: Set) -> bool:
    """Return whether a set leaves as much of the samples as the set without one of its effects, both near the noise."""
    smaller = search.fits.get(parent)
    if not parent or smaller is None or smaller.cost > _NEAR * search.count or search.is_refuted(parent):
        return False
    if search.fit_set(names) is None or search.is_refuted(names):
        return False
    search.mend(names)
    return search.fits[names].cost > smaller.cost - NEEDED


def _is_kept(search: Search, weighed: Weighed, names: Set) -> bool:
    """Return whether a set can be simulated over the records: fitted to these unless the likeliest were refuted."""
    if names not in search.fits and search.is_refuted(search.best()):
        return search.note_refuted(names, weighed.departing[names].state.eta) is not None
    return search.fit_set(names) is not None


def _on_backbones(search: Search, best: Set, weighed: Weighed) -> Fit | None:
    """Return a set fitted to the backbones: from its proposals, and where it departs least."""
    begun = [(weighed.departing[best].state.eta, search.fits[best].state.own[:, :2])]
    if best in search.proposals:
        begun += [(eta, own) for _, eta, own in search.proposals[best].starts]
    return fit_on_levels(search.batch, search.layout(best), begun)


def _told(search: Search, weighed: Weighed, best: Set) -> tuple[MissingMechanism, ...]:
    """Return the mechanisms with what the laws of one set explain."""
    estimates = estimates_with(search, best, weighed.departing[best])
    return missing_mechanisms(
        search, weighed.probabilities, best, weighed.gaps, estimates, joined=_joined(search, best)
    )


def _joined(search: Search, best: Set) -> frozenset[str]:
    """Return the mechanisms of the best set, and what a set adds that leaves far less of the samples.

    Backbones with a departure are content with less; but what the samples want as well is not told to be absent: what
    a larger set adds, or, where the best is far from the noise, what another set needs to leave less than it.
    """
    kinds = {search.mechanism_of(name) for name in best}
    # what is out of phase leaves more than anything that follows the samples
    is_lost = best not in search.fits or search.is_refuted(best)
    left = np.inf if is_lost else search.fits[best].cost - search.count
    for names, found in search.fits.items():
        is_larger = set(best) < set(names) and not search.is_refuted(names)
        if is_larger and found.cost - search.count < min(_MUCH_LESS**2 * left, (_NEAR - 1.0) * search.count):
            kinds |= {search.mechanism_of(name) for name in names}
    if (_NEAR - 1.0) * search.count < left < np.inf:
        kinds |= _needed_instead(search, best, _LESS * left)
    return frozenset(kinds)


def _needed_instead(search: Search, best: Set, most: float) -> set[str]:
    """Return the mechanisms that sets which hold not all of the best, and leave less than that, do not do without."""
    leaves = {names: found.cost - search.count for names, found in search.fits.items()}
    kinds = set()
    for names, left in leaves.items():
        if set(best) <= set(names) or left >= most or search.is_refuted(names):
            continue
        for name in names:
            rest = tuple(item for item in names if item != name)
            if leaves.get(rest, 0.0) > _NEEDED * left:
                kinds.add(search.mechanism_of(name))
    return kinds


def certain_sets(search: Search, mechanisms: Sequence[MissingMechanism], ranked: Sequence[Set]) -> list[Set]:
    """Return the sets that hold laws of every mechanism that is certain and of no other, most probable first."""
    certain = [item.mechanism for item in mechanisms if item.probability >= MECHANISM_NAMED]
    groups = [set(EITHER.get(kind, (kind,))) for kind in certain]
    held = {names: {search.mechanism_of(name) for name in names} for names in ranked}
    return [
        names
        for names, kinds in held.items()
        if names and all(group & kinds for group in groups) and kinds <= set().union(*groups)
    ]


def _unfinished(search: Search, weighed: Weighed, ranked: Sequence[Set]) -> tuple[Set, ...]:
    """Return the sets that explain the backbones and whose fit to the records did not come to rest, likeliest first.

    Sets so improbable by their backbones that they were not weighed are none of these, nor those whose effects undo
    each other there: such a set draws any curve, and is no explanation.
    """
    explaining = {names for names in ranked if weighed.gaps.get(names, 1.0) <= 1.0 - MOST_OF_THE_GAP}
    found = [names for names in weighed.ranked() if names in explaining and search.is_open(names)]
    undone = in_threads([partial(_undo_each_other, search, weighed, names) for names in found])
    return tuple(names for names, is_none in zip(found, undone, strict=True) if not is_none)


def _undo_each_other(search: Search, weighed: Weighed, names: Set) -> bool:
    """Return whether effects of a set take back of each other, on the backbones, what no two of one structure do.

    What they do in all specimens they do in some, which are spread over the batch; and where it departs least, which is
    near what is lowest.
    """
    if len(names) < 2:
        return False
    chosen = spread(len(search.batch.levels), _SOME)
    begun = weighed.departing[names].state.eta, search.fits[names].state.own[chosen, :2]
    batch = search.batch.subset(chosen)
    found = fit_on_levels(batch, search.layout(names), [begun])
    return found is not None and compensation(search, names, found, batch) > _UNDONE


def is_told_apart(mechanisms: Sequence[MissingMechanism]) -> bool:
    """Return whether mechanisms can be named: some are certain, and what they explain is most of the gap."""
    named = [item for item in mechanisms if item.is_certain]
    return bool(named) and sum(item.share_of_gap for item in named) >= MOST_OF_THE_GAP
