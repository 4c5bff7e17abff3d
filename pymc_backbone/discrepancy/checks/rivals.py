"""An explanation that is no missing effect: drift with time, alone or beside effects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import batched, combinations

import numpy as np

from ..._common.text import per_cent
from ..._common.threads import in_threads
from ..drift.drift_fits import Settled, drift_fit, likeliest, settled, weighed
from ..drift.drift_proposals import sets_beside_drifts, single_beside_drifts
from ..fitting import equal_forces, starts
from ..fitting.descent import is_heavy
from ..fitting.drift_course import changes_of, stand_out
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import DRIFTS, State
from ..results.entries import Check
from ..sets.search import Search, Set
from ..sets.side_by_side import ABREAST, fit_side_by_side
from ..sets.varied_sets import NEEDED, is_akin
from ..weighing import evidence
from ..weighing.evidence import Drifting

_ASKED = 3  # sets that are asked with a drift beside them where none leaves noise, and with other laws
_HELPED = 20.0  # fall of chi-square by a drift from which other laws of the same mechanisms are asked
_NEAR = 2.0  # reduced chi-square with a drift up to which they are
_AGREED = 0.8  # of what all records drift, that is one way where they agree
_AT_MOST = 2.0  # of the variances, that are added to what does not stand out of them
_WORTH_SETTLING = 15.0  # chi-square above what leaves least, up to which a steady drift will do
_BENT = 0.5  # of what the base leaves, that a drift leaves at most which bends the backbones as much as a law does


def drifting_sets(search: Search) -> dict[Set, Drifting]:
    """Return the base with a drift in time, and the sets beside which a drift may be what a further effect imitates.

    These are what is in the most probable set, where that is not a single effect that leaves noise, and the other laws
    of its mechanism and what it varies where that effect is a variant; where no set leaves noise, what is in the next
    ones, too. Where a drift helps one of them, the same is asked of the other laws of its mechanisms and of what its
    variants vary, and where none leaves noise even so of variants in the place of its effects. Sets with an equation of
    their own are asked where they lack one effect only, or nothing simpler is left; where turning points refuted the
    most probable set, no set that remembers is. Where a drift alone explains half of what is missing, the backbones are
    asked beside drifts: for every effect where nothing leaves noise even so, and where something does, for those that
    are soon simulated. A law of several parameters, such as a contact, had stood for a drift beside a plain one.
    """
    best = search.best()
    is_exact = evidence.leaves_noise(search.batch, search.fits[best])
    asked: list[Set] = [()]
    if is_exact and len(best) == 1 and best[0] in search.variants:
        # its exponent may make up for a drift beside a simpler law
        asked += _akin(search, best)
    if len(best) > 1 or not is_exact:
        for names in [best] if is_exact else search.ranked()[:_ASKED]:
            within = [part for size in range(1, len(names) + 1) for part in combinations(names, size)]
            simple = [part for part in within if _is_simple(search, part, names)]
            asked += simple or within[:1]
    found: dict[Set, Drifting] = {}
    limit = search.descent.hopeless(search.fits[best] if is_exact else None)
    _ask(search, asked, found, limit)
    _ask_other_gaps(search, found, limit)
    helped = [
        names
        for names in found
        if names and found[names].fit.cost < min(search.fits[names].cost - _HELPED, _NEAR * search.count)
    ]
    helped.sort(key=lambda names: found[names].fit.cost)
    _ask(search, [other for names in helped[:_ASKED] for other in _akin(search, names)], found, limit)
    if search.batch.has_open_records and (best or not is_exact) and _is_bent(search, found):
        if is_exact:
            _ask_plain(search, found, limit)
        elif not _is_explained(search, found):
            _ask_backbones(search, found)
    if not is_exact and not _is_explained(search, found):
        _ask_variants(search, found, limit)
    _ask_parts(search, found, limit)
    return _settled(search, found)


def _settled(search: Search, found: dict[Set, Drifting]) -> dict[Set, Drifting]:
    """Return the same with drifts that settle, where one beside a set leaves noise, and a steady one more.

    Where a set leaves noise, or does so with a steady drift beside it, one that lacks an effect of the best, or holds a
    plain law in the place of a variant, has to be likelier with a drift that settles than all these. In any case
    releases have to say that it is no law of the amplitude, of which a decay makes the same curve.
    """
    batch, best = search.batch, search.best()
    known = [search.fits[best], *(item.fit for item in found.values())]
    is_exact = any(evidence.leaves_noise(batch, item) for item in known)
    lowest = min(item.cost for item in known)
    if is_exact:  # what lacks one effect, which the drift may be, or an exponent of its own
        asked = [*combinations(best, max(len(best) - 1, 0)), *_plainest(search, found)]
    else:
        asked = sorted(found, key=lambda names: found[names].fit.cost)[:_ASKED]
    for names in dict.fromkeys([(), *asked]):
        alone = None if is_heavy(search.layout(names)) else search.fit_set(names)
        if alone is None:
            continue
        steady = found[names].fit if names in found else drift_fit(batch, alone.layout, alone.state)
        if steady is None or (evidence.leaves_noise(batch, steady) and steady.cost < lowest + _WORTH_SETTLING):
            continue
        with_time = settled(batch, alone, steady)
        if with_time is None:
            continue
        if with_time.is_of_time and (not is_exact or _is_likeliest(search, found, names, with_time)):
            search.batch = with_time.batch
            return drifting_sets(search)
    return found


def _plainest(search: Search, found: dict[Set, Drifting]) -> list[Set]:
    """Return the set nearest the noise that holds a plain law in the place of a variant of the simplest exact set.

    Beside a steady drift, which is asked here: without one, the plain law is as far off as the records drift.
    """
    exact = {names: item.fit.cost for names, item in found.items() if evidence.leaves_noise(search.batch, item.fit)}
    best = search.best()
    if evidence.leaves_noise(search.batch, search.fits[best]):
        exact.setdefault(best, search.fits[best].cost)
    simplest = min(exact, key=lambda names: (len(names), exact[names]))
    varied = [name for name in simplest if name in search.variants]
    plain = [names for names in _of_the_same_kind(search, simplest) if not set(varied) <= set(names)]
    known = [names for names in plain if varied and search.fit_set(names) is not None]
    known.sort(key=lambda names: search.fits[names].cost)
    _ask(search, known[:_ASKED], found, np.inf)
    return sorted(set(known) & set(found), key=lambda names: found[names].fit.cost)[:1]


def _is_likeliest(search: Search, found: dict[Set, Drifting], names: Set, with_time: Settled) -> bool:
    """Return whether a set with a drift that settles is the most probable, with steady drifts or without."""
    beside = {**found, names: with_time.drifting(search.fits[names])}
    fits = [*search.fits.values(), *(item.fit for item in beside.values())]
    # the residuals of what leaves least say how much the samples tell
    batch = with_time.batch if beside[names].fit.cost <= min(item.cost for item in fits) else search.batch
    return likeliest(search, beside, batch) == (*names, *evidence.DRIFT)


def _ask_plain(search: Search, found: dict[Set, Drifting], limit: float) -> None:
    """Add the fits of single effects that are soon simulated, as their backbones propose them beside drifts.

    One that leaves clearly more than the best set is no rival of it, and one that the drift does not help stands
    without: neither is added.
    """
    best = search.best()
    worst = search.fits[best].cost + _HELPED
    begun = single_beside_drifts(search, remembering=False)
    asked = {names: state for names, state in begun if names not in found and names != best}
    for names, drifting in _drifting(search, asked.items(), limit):
        if drifting is None or drifting.cost > worst or (alone := search.fit_set(names)) is None:
            continue
        if drifting.cost < alone.cost - _HELPED:
            found[names] = weighed(search.batch, drifting, alone)


def _ask_other_gaps(search: Search, found: dict[Set, Drifting], limit: float) -> None:
    """Begin sets with a contact from other gaps, too: alone it had closed where that followed the drift best."""
    asked = [
        (names, state)
        for names in found
        if not is_heavy(search.layout(names))
        for state in equal_forces.with_other_gaps(
            search.layout(names), search.fits[names], search.batch.angular_frequency
        )
    ]
    for names, drifting in _drifting(search, asked, limit):
        if drifting is not None and drifting.cost < found[names].fit.cost - NEEDED:
            found[names] = weighed(search.batch, drifting, search.fits[names])


def _ask_parts(search: Search, found: dict[Set, Drifting], limit: float) -> None:
    """Add what is in the sets that a drift brought to leave noise, from where these ended, one effect less at a time.

    Alone such a part had followed the drift, and beside one it begins where it ended then: a contact of which the
    frequency rises with the temperature never found its gap, and a spring that is not there had to help.
    """
    exact = [
        names
        for names, item in found.items()
        if names and item.fit.cost < search.fits[names].cost - _HELPED and evidence.leaves_noise(search.batch, item.fit)
    ]
    while exact:
        names = max(exact, key=len)
        exact.remove(names)
        larger = found[names].fit
        known = {
            part: found[part].fit.cost if part in found else np.inf for part in combinations(names, len(names) - 1)
        }
        asked = [
            (part, starts.restricted(search.layout(part), larger.layout, larger.state))
            for part, cost in known.items()
            if not (is_heavy(search.layout(part)) or cost < larger.cost + NEEDED or search.fit_set(part) is None)
        ]
        for part, drifting in _drifting(search, asked, limit):
            if drifting is None or drifting.cost > known[part] - NEEDED:
                continue
            found[part] = weighed(search.batch, drifting, search.fits[part])
            if part and evidence.leaves_noise(search.batch, drifting):
                exact.append(part)


def _drifting(search: Search, asked: Iterable[tuple[Set, State]], limit: float) -> Iterator[tuple[Set, Fit | None]]:
    """Return the fits of sets with a drift beside them, each from its start, on all cores."""
    known = list(asked)
    jobs = [partial(drift_fit, search.batch, search.layout(names), state, limit) for names, state in known]
    return zip([names for names, _ in known], in_threads(jobs), strict=True)


def _is_explained(search: Search, found: dict[Set, Drifting]) -> bool:
    """Return whether a set leaves noise with a drift beside it."""
    return any(evidence.leaves_noise(search.batch, item.fit) for item in found.values())


def _ask_variants(search: Search, found: dict[Set, Drifting], limit: float) -> None:
    """Add the sets that a drift brings nearest the noise with variants in the place of effects, where these leave less.

    Begun from their fits, their drift with them: a drag with an exponent of its own had lost its way beside a drift,
    for alone it had followed the drift.
    """
    near = [item for item in found if item and found[item].fit.cost < _NEAR * search.count]
    near.sort(key=lambda item: (len(item), found[item].fit.cost))
    for names, name in [(item, name) for item in near[:_ASKED] for name in item]:
        if any(len(item) < len(names) and evidence.leaves_noise(search.batch, found[item].fit) for item in found):
            return  # nothing more is needed
        plain = found[names].fit
        for variant in search.variants:
            varied = tuple(sorted({*names, variant} - {name}))
            if variant in names or not is_akin(name, variant) or is_heavy(search.layout(varied)):
                continue
            layout = search.layout(varied)
            begun = equal_forces.in_place_of(layout, plain, search.batch.angular_frequency)
            drifting = drift_fit(search.batch, layout, begun, limit)
            known = found[varied].fit.cost if varied in found else np.inf
            if drifting is None or drifting.cost > min(plain.cost - NEEDED, known):
                continue
            if (alone := search.fit_set(varied)) is not None:
                found[varied] = weighed(search.batch, drifting, alone)


def _is_bent(search: Search, found: dict[Set, Drifting]) -> bool:
    """Return whether a drift may bend the backbones as much as a law: by itself it explains half of what is missing."""
    noise = min(search.fits[search.best()].cost, search.count)
    return () in found and found[()].fit.cost - noise < _BENT * (search.fits[()].cost - noise)


def _ask_backbones(search: Search, found: dict[Set, Drifting]) -> None:
    """Add the fits of what the backbones propose beside drifts: single effects, and sets where none of these explains.

    A drift that bends the backbones as much as a law does has led to other sets than those that act. What takes
    long to simulate is left out where something simpler explains, or the effort is spent.
    """
    is_exact = False
    for begun in (single_beside_drifts, sets_beside_drifts):
        for names, state in begun(search):
            if is_heavy(search.layout(names)) and (is_exact or search.is_cut):
                continue
            if names in found and evidence.leaves_noise(search.batch, found[names].fit):
                continue
            drifting = drift_fit(search.batch, search.layout(names), state, search.descent.unheard_of)
            is_lower = names not in found or (drifting is not None and drifting.cost < found[names].fit.cost)
            if drifting is None or not is_lower or drifting.cost > _NEAR * search.count:
                continue
            if (alone := search.fit_set(names)) is not None:
                found[names] = weighed(search.batch, drifting, alone)
                is_exact = is_exact or evidence.leaves_noise(search.batch, drifting)
        if is_exact:
            return


def _is_simple(search: Search, part: Set, names: Set) -> bool:
    """Return whether what is in a set is asked with a drift: what is soon simulated, or lacks one effect only.

    Where turning points refuted the most probable set, evidence with a departure decides, which has a drift of its own:
    then what remembers is not followed through the records for the drift's sake. Nor is it where the model as it is
    explains these with a drift, for little is left that a further effect could take.
    """
    if search.is_refuted(search.best()) or search.is_told:
        return not search.layout(part).simulator.needs_decay
    return len(part) == len(names) - 1 or not is_heavy(search.layout(part))


def _ask(search: Search, sets: Iterable[Set], found: dict[Set, Drifting], limit: float) -> None:
    """Add the fits of sets with a drift beside them; that of the base however far it is."""
    best = search.best()
    asked = [
        names
        for names in dict.fromkeys(sets)
        if names not in found and (not search.is_cut or names in search.fits or set(names) < set(best))
    ]
    for few in batched(asked, ABREAST):
        fit_side_by_side(search, few)
    starts = {names: search.fits[names] for names in asked if names in search.fits}
    jobs = [
        partial(drift_fit, search.batch, start.layout, start.state, limit if names else np.inf)
        for names, start in starts.items()
    ]
    for names, drifting in zip(starts, in_threads(jobs), strict=True):
        if drifting is not None:
            found[names] = weighed(search.batch, drifting, starts[names])


def _akin(search: Search, names: Set) -> list[Set]:
    """Return the sets with another law of the same mechanism in the place of one effect, or with what it varies."""
    return [*_of_the_same_kind(search, names), *search.plainer(names)]


def _of_the_same_kind(search: Search, names: Set) -> list[Set]:
    """Return the sets with another law of the same mechanism in the place of one effect, those with few states."""
    sets = []
    for name in names:
        kind = search.mechanism_of(name)
        for other in search.candidates:
            changed = tuple(sorted({*names, other} - {name}))
            is_new = other not in names and search.mechanism_of(other) == kind
            if is_new and (is_heavy(search.layout(names)) or not is_heavy(search.layout(changed))):
                sets.append(changed)
    return sets


def drift_check(
    drifting: Fit | None,
    probability: float,
    found: bool,
    named: Fit | None = None,
    *,
    is_small: bool = False,
    settling: float = np.inf,
) -> Check:
    """Say whether a change with time explains the records as well as a change with amplitude.

    ``named`` is the fit of the named set where it holds a drift beside its effects, ``is_small`` whether that is below
    the tolerance, ``settling`` the time constant [s] of a drift that settles.
    """
    name = "amplitude, not time"
    if drifting is None:
        return Check(name, True, "not testable without records: backbones do not say when an amplitude was passed")
    if named is not None and found:
        said = f"beside the effect {_drift(named, settling)}, or a second effect"
        if is_small:
            return Check(name, True, f"{said} imitates that, which is below the tolerance")
        return Check(
            name,
            False,
            f"{said} imitates that: keep the temperature constant, and release from other amplitudes to tell the two "
            "apart",
        )
    if named is not None:
        said = f"{_drift(named, settling)}, which explains"
        if is_small:
            return Check(name, True, f"{said} the records alone, and is below the tolerance")
        return Check(name, False, f"{said} the records alone; keep the temperature constant")
    if probability > 0.02 and found:
        return Check(
            name,
            False,
            f"it may be that {_drift(drifting, settling)}, in the place of an effect of amplitude, with a probability "
            f"of {per_cent(probability)}; release from other amplitudes to tell the two apart",
        )
    if len(drifting.state.own) == 1:
        said = "a change with time explains this decay no better, but one decay passes each amplitude once only"
        return Check(name, True, f"{said}; a second release from another amplitude would show it")
    return Check(name, True, "the same amplitude has the same frequency and damping whenever it is passed")


def _drift(drifting: Fit, settling: float) -> str:
    """Say what changes over a record, and by how much: mean sizes relative, signed where records agree.

    Of what does not stand out of its errors, what it is at most.
    """
    places = list(DRIFTS)
    values, variances = drifting.state.own[:, places], np.nan_to_num(drifting.own_covariance[:, places])
    changes = changes_of(values, variances)
    most = changes_of(values, -_AT_MOST * variances)
    signs = np.where(np.abs(values.sum(axis=0)) > _AGREED * np.abs(values).sum(axis=0), np.sign(values.sum(axis=0)), 0)
    is_seen = dict(zip(changes, stand_out(values, variances), strict=True))
    by = {
        name: f"{'-' if sign * changes[name] < 0.0 else '+' if sign * changes[name] > 0.0 else ''}"
        f"{per_cent(changes[name])}"
        if is_seen[name]
        else f"at most {per_cent(most[name])}"
        for sign, name in zip(signs, changes, strict=True)
    }
    how = f", settling with a time constant of {settling:.3g} s" if np.isfinite(settling) else ""
    first, second = by
    if is_seen[first] == is_seen[second]:
        return f"{first} and {second} drift with time (by {by[first]} and {by[second]} over a record{how})"
    seen, other = (first, second) if is_seen[first] else (second, first)
    return f"{seen} drifts with time (by {by[seen]} over a record{how}; {other} by {by[other]})"


__all__ = ["drift_check", "drifting_sets"]
