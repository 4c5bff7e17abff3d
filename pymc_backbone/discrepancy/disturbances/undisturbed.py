"""Records without what disturbs them: filters, edges, noise that grows, a bent sensor, another mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ...measurement.options import Measuring
from ...measurement.reading.record import Record
from ..drift.drift_fits import drift_alone, likeliest
from ..sets.fitted_sets import FittedSets
from ..sets.question import Question
from ..sets.relaxed_release import SENTENCE as RELAXED
from ..sets.relaxed_release import is_relaxed_at_release
from ..sets.search import Search
from ..weighing import evidence
from .changed import (
    LESS,
    Changed,
    Drifts,
    Known,
    Undisturbed,
    gains,
    is_better,
    is_exact,
    left,
    over_motion,
)
from .clock_steps import clock_steps
from .close_modes import lines_that_beat
from .disturbance import Disturbed
from .drifting_zero import drifting_zero
from .drop_outs import drop_outs
from .earlier_release import earlier
from .early_edges import early_edges
from .edges import Edges
from .filter_search import early_high_pass, sensor_filter, settled
from .motion_noise import motion_noise
from .readings import disturbed, early_line
from .sensor_filter import SensorFilter
from .without_edges import without_edges, without_first_cycle

_RARE = 0.05  # p-value of noise up to which a few samples are looked at
_PASSES = 2  # times that bent sensors and lines are looked for
_AS_QUIET = 1.02  # noise over the motion, with and without a filter in front of straightened records
_SEVERAL = 2  # effects in straightened records, beside which a drift is asked instead
_QUIETER = 0.8  # of the noise that a drift leaves over the motion, up to which straightened records explain more


def in_the_way(search: FittedSets) -> SensorFilter | Disturbed | Edges | None:
    """Return what runs beside the motion, or stands in front of the records, and ends a search that has just begun.

    The line first: noise that was estimated from records with a line holds it, and sets seem to leave noise behind any
    filter. First cycles that are no free motion last: a filter may explain them.
    """
    return _beside(search) or early_edges(search)


def _beside(search: FittedSets) -> SensorFilter | Disturbed | None:
    """Return what is in the way but for the edges of records, which were cut."""
    return early_line(search) or _in_front(search)


def _in_front(search: FittedSets) -> SensorFilter | None:
    """Return the high-pass in front of records of which nothing leaves noise without one."""
    lowest = min(search.fits.values(), key=lambda item: item.cost)
    return None if search.explains(lowest) else early_high_pass(search)


def undisturbed(
    question: Question,
    search: Search,
    records: Sequence[Record],
    measuring: Measuring,
    searched: Callable[..., Search],
    drifts: Drifts,
) -> Undisturbed:
    """Return the question and search of records without what disturbs them; as they were where nothing does.

    A zero that drifts is looked for where no set leaves noise: what does without the mid-line is the answer. Samples
    that are off all motion are put where the best set has them, where it explains the others and not all. A filter
    in front of the records, through which the simulation is sent, is looked for then (of velocities and accelerations
    before, as what couples these to alternating current moves the mid-line, too), and once more without the edges.
    Specimens are released earlier, or else first or last cycles left out, where a set of effects leaves noise then, or
    half of what was left at most. Where the noise grows with the motion, samples count by the noise that they have, if
    a set leaves nothing else then. A bent sensor and another mode's line are taken out where a set leaves noise then;
    what was found with the noise of disturbed records is found again without it. Where a set leaves noise with a drift
    in time beside it, which is likelier, no cycle is left out, and sensors are straightened only where clearly less
    noise is left then: an estimate of the noise that holds the disturbance hides it. Nor are they where fewer effects
    than remain of straightened records leave nothing beside a drift. Where the model as it is needs a drift in time and
    nothing else, nothing else is asked. A line that the search was halted for, or with which records beat that were cut
    for it, is taken out before all that.
    """
    measured = {id(records): (records, question)}
    given = Changed(question, measuring, searched, drifts, records, measured=measured)
    return _undisturbed(Known(given, Undisturbed(question, search)))


def _undisturbed(known: Known) -> Undisturbed:
    changed, search = known.changed, known.search
    if isinstance(search.halted, Disturbed):
        return _without_line(changed, search.halted)
    if len(changed.lines) < _PASSES and (lines := lines_that_beat(search.batch, changed.records)) is not None:
        return _without_line(changed, Disturbed(dict(zip(search.batch.specimens, lines, strict=True)), ()))
    behind, is_needed = _halted(changed, search)
    if behind is not None and is_needed:
        return behind
    found = _without_filter_at_first(known)
    return found if behind is None or is_exact(found.search) else behind


def _without_filter_at_first(known: Known) -> Undisturbed:
    """Return the question and search of records without what disturbs them, if that is no filter that is seen early."""
    changed, search = known.changed, known.search
    if (on_time := _on_time(known)) is not None:
        return _undisturbed(on_time)
    if isinstance(search.halted, Edges):
        if (late := _begun_late(known, search.halted)) is not None:
            return late
        search.resume()
    if search.is_told:
        told = with_drifts(known.found, changed.drifts)
        if told.is_drifting and likeliest(search, told.drifting or {}) == evidence.DRIFT:
            return told
        search.resume()  # where an effect beside the drift is likelier, another may explain the records without one
    if not changed.is_of_rates and (steady := _steadied(known)) is not None:
        return steady
    return _one_by_one(known)


def _begun_late(known: Known, lost: Edges) -> Undisturbed | None:
    """Return the question and search of records whose first cycles are no free motion; None where no set leaves noise.

    How what remembers was released is asked before they are left out, for they say it.
    """
    changed, search = known.changed, known.search
    ways = [changed.but(RELAXED, is_relaxed=True)] if is_relaxed_at_release(search) else []
    ways += [] if (release := earlier(search)) is None else [changed.but(release.sentence, release=release)]
    for way in ways:
        whole = way.if_promising(search, 0.0)
        if whole is not None and is_exact(whole.search):
            return whole.found
    rest = _undisturbed(changed.within(lost).asked(_beside, drift_alone))
    return rest if is_exact(rest.search) or rest.is_drifting else None


def _one_by_one(first: Known) -> Undisturbed:
    """Return the question and search of records without what disturbs them, asked one after the other."""
    drifts, now = first.changed.drifts, first
    # releases before first samples are left out, which say how what remembers was released
    for without in (_eased, _without_drop_outs):
        now = without(*now) or now
    unfiltered = now
    now = _filtered(*now) or now
    if now.changed.is_of_rates and (steady := _steadied(now)) is not None:
        return steady
    now = _released_earlier(*now) or now
    known = _with_drifts(now.found, drifts)
    is_asked = now.changed.release is None and not known.is_drifting
    cut = without_edges(*now) if is_asked else None
    if cut is not None:
        now, known = cut, cut.found if _is_better_without(cut.search, first.search) else known
        if (behind := _filtered(*now)) is not None:
            now, known = behind, behind.found
    if not known.is_drifting and (weighed := _weighed(*now)) is not None:
        now, known = weighed, weighed.found
    if (cut is not None or now.changed.release is not None) and is_exact(now.search):
        return known
    known = _with_drifts(known, drifts)
    straight = _straightened(now)
    if straight is None:
        return known
    if straight.is_bent and now.changed.sensor_filter is not None:
        straight = _as_quiet(_straightened(unfiltered), straight) or straight
    if (simpler := _simpler_beside_drift(known, straight.search, drifts)) is not None:
        return simpler
    noise = over_motion(straight.search, straight.search.fits[straight.search.best()])
    return straight if noise < _QUIETER * known.noise_beside_drift else known


def _simpler_beside_drift(known: Undisturbed, straight: Search, drifts: Drifts) -> Undisturbed | None:
    """Return the sets with a drift beside them, where the likeliest leaves nothing and has fewer effects than without.

    Asked where a sensor seemed bent although a set left noise, and several effects remain of straightened records: all
    of these may follow a drift.
    """
    search, best = known.search, straight.best()
    if known.drifting is not None or len(best) < _SEVERAL:
        return None
    beside = with_drifts(known, drifts)
    drifting = beside.drifting or {}
    *names, last = likeliest(search, drifting) or ("",)
    if (last,) != evidence.DRIFT or not len(names) < len(best):
        return None
    rest = evidence.lack_of_fit(search.batch, drifting[tuple(names)].fit)
    return beside if rest.p_value > _RARE else None


def _as_quiet(plain: Undisturbed | None, straight: Undisturbed) -> Undisturbed | None:
    """Return straightened records without a filter if no more is left of them than with it, which they do not need.

    The harmonics that a bent sensor makes are imitated by those of a law that a filter turns.
    """
    if plain is None:
        return None
    noise, other = (over_motion(item.search, item.search.fits[item.search.best()]) for item in (plain, straight))
    return plain if noise < _AS_QUIET * other else None


def _on_time(known: Known) -> Known | None:
    """Return the question of records whose clock was set right, where that is clearly better; None without steps."""
    changed, search = known.changed, known.search
    if is_exact(search) or (steps := clock_steps(search, changed.records)) is None:
        return None
    return _if_better(changed.but(steps.sentence, records=steps.undisturbed(changed.records)).asked(), search)


def _halted(changed: Changed, search: Search) -> tuple[Undisturbed | None, bool]:
    """Return the question behind the filter for which a search was halted, and whether what was found there needs it.

    None where it leaves more than noise. Unless it is needed, the search is taken to its end.
    """
    chosen = search.halted
    if not isinstance(chosen, SensorFilter):
        return None, False
    tried = _behind(changed, search, chosen)
    if not is_exact(tried.search):
        search.resume()
        return None, False
    better = settled(search, tried.search, chosen)
    if better is None:
        search.resume()
    elif better != chosen and is_exact((again := _behind(changed, search, better)).search):
        tried = again
    if better is not None and tried.search.best() and is_exact(tried.search):
        tried = without_first_cycle(tried.changed, tried.search) or tried  # what rings after the release, or a hand
    return tried.found, better is not None


def _behind(changed: Changed, search: Search, found: SensorFilter) -> Known:
    """Return the question with a filter in front of the records."""
    undone = found.undone(changed.records, search.batch)
    return changed.but(*found.sentences(search.batch), records=undone, sensor_filter=found).asked()


def _steadied(known: Known) -> Undisturbed | None:
    """Return the question of records whose zero drifts; None where a set leaves noise already, or none does so."""
    changed, found = known
    if is_exact(found.search) or (steady := drifting_zero(found.question, found.search, changed.measuring)) is None:
        return None
    tried = Undisturbed(steady, changed.searched(steady))
    return tried if is_exact(tried.search) else None


def _eased(changed: Changed, known: Undisturbed) -> Known | None:
    """Return the question of releases at which what remembers holds no force, where it is clearly better then."""
    if not is_relaxed_at_release(known.search):
        return None
    return _if_better(changed.but(RELAXED, is_relaxed=True).asked(), known.search)


def _without_drop_outs(changed: Changed, known: Undisturbed) -> Known | None:
    """Return the question without samples off all motion, where what is left is no noise."""
    if left(known.search).p_value > _RARE or (wild := drop_outs(known.search)) is None:
        return None
    return changed.but(wild.sentence, records=wild.undisturbed(changed.records)).asked()


def _filtered(changed: Changed, known: Undisturbed) -> Known | None:
    """Return the question with a filter in front of the records, where it is clearly better then.

    Where nothing leaves noise, the filter has to make the difference, and not another set behind it: harmonics that no
    set explains are imitated by those of a large set that a filter turns.
    """
    search = known.search
    if changed.sensor_filter is not None or (found := sensor_filter(search)) is None:
        return None
    tried = _if_better(_behind(changed, search, found), search)
    return tried if tried is not None and (is_exact(tried.search) or gains(tried.search, search)) else None


def _released_earlier(changed: Changed, known: Undisturbed) -> Known | None:
    """Return the question of specimens that were released before the record, where it is clearly better then.

    Where a set leaves noise already, that is where one of fewer effects does.
    """
    search = known.search
    if (release := earlier(search)) is None:
        return None
    tried = _if_better(changed.but(release.sentence, release=release).asked(), search)
    is_simpler = tried is not None and len(tried.search.best()) < len(search.best())
    return tried if is_simpler or not is_exact(search) else None


def _is_better_without(cut: Search, search: Search) -> bool:
    """Return whether a search of records without their edges explains more than one with these."""
    reduced = [item.reduced(item.fits[item.best()]) for item in (cut, search)]
    return is_better(cut, search) or reduced[0] < LESS * reduced[1]


def _weighed(changed: Changed, known: Undisturbed) -> Known | None:
    """Return the question of samples that count by the noise that they have, where a set leaves nothing else then.

    What a law lacks grows with the motion, too, and beyond the harmonics that are looked at it passes for noise.
    """
    if (noise := motion_noise(known.search)) is None:
        return None
    tried = changed.but(noise.sentence, noise=noise).if_promising(known.search, 0.0)
    return tried if tried is not None and is_exact(tried.search) else None


def _if_better(tried: Known, search: Search) -> Known | None:
    return tried if is_better(tried.search, search) else None


def _with_drifts(known: Undisturbed, drifts: Drifts) -> Undisturbed:
    """Return the search with the sets that were asked with a drift beside them, where none leaves noise without."""
    if known.drifting is not None or is_exact(known.search):
        return known
    return with_drifts(known, drifts)


def with_drifts(known: Undisturbed, drifts: Drifts) -> Undisturbed:
    """Return the search with the sets that were asked with a drift beside them; the batch knows how drifts go."""
    known = replace(known, drifting=drifts(known.search))
    batch = known.search.batch  # where drifts may settle
    return known if known.question.batch is batch else replace(known, question=replace(known.question, batch=batch))


def _straightened(known: Known) -> Undisturbed | None:
    """Return the question and search of records without bent sensors and lines; None where no set leaves noise then.

    Where a line by itself is not all, and nothing else was changed, everything is asked of the records without it: the
    noise that held the line hid what else disturbs them.
    """
    changed, again = known.changed, known.search
    found: list[Disturbed] = []
    records = changed.records
    while len(found) < _PASSES and (one := disturbed(again)) is not None:
        found.append(one)
        records = one.undisturbed(records)
        tried = changed.but(records=records, lines=(*changed.lines, *found)).asked().found
        again = tried.search
        if is_exact(again):
            return replace(tried, is_bent=any(item.is_bent for item in found))
    is_line = bool(found) and not found[0].is_bent
    if not is_line or changed.said or len(changed.lines) + 1 >= _PASSES:
        return None
    without = _without_line(changed, found[0])
    return without if is_exact(without.search) else None


def _without_line(changed: Changed, line: Disturbed) -> Undisturbed:
    """Return question and search of records from which a line was taken, without what else disturbs them."""
    lines = (*changed.lines, line)
    early = in_the_way if len(lines) < _PASSES else _in_front
    return _undisturbed(changed.but(records=line.undisturbed(changed.records), lines=lines).asked(early, drift_alone))


__all__ = ["Undisturbed", "in_the_way", "undisturbed", "with_drifts"]
