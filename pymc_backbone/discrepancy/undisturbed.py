"""Records without what disturbs them: filters, first cycles, noise that grows, a bent sensor, another mode."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..measurement.options import Measuring
from ..measurement.reading.record import Record
from . import evidence
from .disturbance import Disturbed, sentences
from .drift_fits import drift_alone
from .drifting_zero import drifting_zero
from .drop_outs import drop_outs
from .earlier_release import Earlier, earlier
from .evidence import Drifting
from .filter_search import early_high_pass, sensor_filter, settled
from .first_cycles import begun
from .fitted_sets import FittedSets
from .joint_fit import Fit
from .motion_noise import MotionNoise, motion_noise
from .promising import is_promising
from .question import Question
from .readings import disturbed, early_line
from .relaxed_release import SENTENCE as RELAXED
from .relaxed_release import is_relaxed_at_release
from .search import Search, Set
from .sensor_filter import SensorFilter

_RARE = 0.05  # p-value of noise up to which a few samples are looked at
_PASSES = 2  # times that bent sensors and lines are looked for
_LESS = 0.5  # of what the best set left, where first cycles are left out or the release is another
_QUIETER = 0.8  # of the noise that a drift leaves over the motion, up to which straightened records explain more


@dataclass(frozen=True, eq=False)
class Undisturbed:
    """Question and search of records without what disturbs them, and whether that is a bent sensor.

    ``drifting`` holds the sets that were asked with a drift in time beside them; None where none were.
    """

    question: Question
    search: Search
    is_bent: bool = False
    drifting: Mapping[Set, Drifting] | None = None

    @property
    def is_drifting(self) -> bool:
        """Whether a set leaves noise with a drift in time beside it."""
        return self.noise_beside_drift < np.inf

    @property
    def noise_beside_drift(self) -> float:
        """The least that a set leaves over the motion which leaves noise with a drift beside it; infinite for none."""
        fits = [item.fit for item in (self.drifting or {}).values()]
        exact = [found for found in fits if evidence.leaves_noise(self.search.batch, found)]
        return min((_over_motion(self.search, found) for found in exact), default=np.inf)


@dataclass(eq=False)
class _Asked:
    """The question of changed records: how they are measured and searched, what is known of them already."""

    question: Question
    measuring: Measuring
    searched: Callable[..., Search]
    lines: tuple[Disturbed, ...] = ()
    release: Earlier | None = None
    is_relaxed: bool = False
    sensor_filter: SensorFilter | None = None
    noise: MotionNoise | None = None

    def of(self, records: Sequence[Record], said: Sequence[str]) -> Undisturbed:
        """Return the question of these records and its search; ``said`` is what is different in them."""
        other = self.question_of(records, said)
        return Undisturbed(other, self.searched(other))

    def if_promising(
        self, search: Search, records: Sequence[Record], said: Sequence[str], less: float
    ) -> Undisturbed | None:
        """Return the same where a set of an earlier search leaves noise then, or that share of what the best left."""
        other = self.question_of(records, said)
        return Undisturbed(other, self.searched(other)) if is_promising(search, other.batch, less) else None

    def question_of(self, records: Sequence[Record], said: Sequence[str]) -> Question:
        """Return the question of these records."""
        other = self.question.of_records(records, self.measuring, (*sentences(self.lines), *said))
        if self.is_relaxed:
            other = replace(other, batch=replace(other.batch, is_relaxed=True))
        if self.release is not None:
            other = replace(other, batch=self.release.released(other.batch))
        if self.sensor_filter is not None:
            other = replace(other, batch=self.sensor_filter.passed(other.batch))
        if self.noise is not None:
            other = replace(other, batch=self.noise.weighed(other.batch))
        return other


def in_the_way(search: FittedSets) -> SensorFilter | Disturbed | None:
    """Return what runs beside the motion, or stands in front of the records, and ends a search that has just begun.

    The line first: noise that was estimated from records with a line holds it, and sets seem to leave noise behind any
    filter.
    """
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
    drifting: Callable[[Search], Mapping[Set, Drifting]],
    lines: tuple[Disturbed, ...] = (),
) -> Undisturbed:
    """Return the question and search of records without what disturbs them; as they were where nothing does.

    A zero that drifts is looked for where no set leaves noise: what does without the mid-line is the answer. Samples
    that are off all motion are put where the best set has them, where it explains the others and not all. A filter
    in front of the records, through which the simulation is sent, is looked for then (of velocities and accelerations
    before, as what couples these to alternating current moves the mid-line, too), and once more without first cycles.
    Specimens are released earlier, or else first cycles left out, where a set of effects leaves noise then, or half of
    what was left at most. Where the noise grows with the motion, samples count by the noise that they have, if a set
    leaves nothing else then. A bent sensor and another mode's line are taken out where a set leaves noise then; what
    was found with the noise of disturbed records is found again without it. Where a set leaves noise with a drift in
    time beside it, which is likelier, no cycle is left out, and sensors are straightened only where clearly less noise
    is left then: an estimate of the noise that holds the disturbance hides it. Where the model as it is needs a drift
    in time and nothing else, nothing else is asked. A line that the search was halted for is taken out before all that
    (``lines`` are those that were).
    """
    if isinstance(search.halted, Disturbed):
        without = search.halted.undisturbed(records)
        return _without_lines(question, without, measuring, searched, drifting, (*lines, search.halted))
    asked = _Asked(question, measuring, searched, lines)
    behind, is_needed = _halted(asked, search, records)
    if behind is not None and is_needed:
        return behind
    found = _without_filter_at_first(asked, search, records, drifting)
    return found if behind is None or _is_exact(found.search) else behind


def _without_filter_at_first(
    asked: _Asked, search: Search, records: Sequence[Record], drifting: Callable[[Search], Mapping[Set, Drifting]]
) -> Undisturbed:
    """Return the question and search of records without what disturbs them, if that is no filter that is seen early."""
    question, measuring, searched = asked.question, asked.measuring, asked.searched
    if search.is_told:
        told = with_drifts(Undisturbed(question, search), drifting)
        if told.is_drifting:
            return told
        search.resume()
    is_of_rates = bool(records) and all(record.quantity != "displacement" for record in records)
    if not is_of_rates and (steady := _steadied(Undisturbed(question, search), measuring, searched)) is not None:
        return steady
    return _one_by_one(asked, search, records, drifting, is_of_rates=is_of_rates)


def _one_by_one(
    asked: _Asked,
    search: Search,
    records: Sequence[Record],
    drifting: Callable[[Search], Mapping[Set, Drifting]],
    *,
    is_of_rates: bool,
) -> Undisturbed:
    """Return the question and search of records without what disturbs them, asked one after the other."""
    # before first samples are left out, which say how what remembers was released
    eased = _eased(asked, search, records)
    known = Undisturbed(asked.question, search) if eased is None else eased.found
    known, records, said = _without_drop_outs(asked, known, records)
    said, again = (said if eased is None else (eased.said, *said)), known.search
    if (behind := _filtered(asked, again, records, said)) is not None:
        said, known, again, records = (*said, behind.said), behind.found, behind.found.search, behind.records
    if is_of_rates and (steady := _steadied(known, asked.measuring, asked.searched)) is not None:
        return steady
    if (release := earlier(again)) is not None:
        asked.release = release
        tried = asked.of(records, (*said, release.sentence))
        if _is_better(tried.search, again):
            said, known, again = (*said, release.sentence), tried, tried.search
        else:
            asked.release = None
    known = _with_drifts(known, drifting)
    is_asked = asked.release is None and not known.is_drifting
    cut = _without_first_cycles(asked, again, records, said) if is_asked else None
    if cut is not None:
        records, said, again = cut.records, (*said, cut.said), cut.found.search
        if _is_better(again, search):
            known = cut.found
        if (behind := _filtered(asked, again, records, said)) is not None:
            said, known, again, records = (*said, behind.said), behind.found, behind.found.search, behind.records
    if not known.is_drifting and (weighed := _weighed(asked, again, records, said)) is not None:
        said, known, again = (*said, weighed.said), weighed.found, weighed.found.search
    if (cut is not None or asked.release is not None) and _is_exact(again):
        return known
    known = _with_drifts(known, drifting)
    straight = _straightened(asked, again, records, said, drifting)
    if straight is None:
        return known
    left = _over_motion(straight.search, straight.search.fits[straight.search.best()])
    return straight if left < _QUIETER * known.noise_beside_drift else known


def _halted(asked: _Asked, search: Search, records: Sequence[Record]) -> tuple[Undisturbed | None, bool]:
    """Return the question behind the filter for which a search was halted, and whether what was found there needs it.

    None where it leaves more than noise. Unless it is needed, the search is taken to its end.
    """
    chosen = search.halted
    if not isinstance(chosen, SensorFilter):
        return None, False
    asked.sensor_filter = chosen
    tried = asked.of(chosen.undone(records, search.batch), (chosen.sentence(search.batch),))
    is_exact = _is_exact(tried.search)
    better = settled(search, tried.search, chosen) if is_exact else None
    if better is not None and better != chosen:
        asked.sensor_filter = better
        again = asked.of(better.undone(records, search.batch), (better.sentence(search.batch),))
        tried = again if _is_exact(again.search) else tried
    if better is None:
        asked.sensor_filter = None
        search.resume()
    return tried if is_exact else None, better is not None


def _without_drop_outs(
    asked: _Asked, known: Undisturbed, records: Sequence[Record]
) -> tuple[Undisturbed, Sequence[Record], tuple[str, ...]]:
    """Return question, records and what is said: without samples off all motion, where what is left is no noise."""
    if _left(known.search).p_value > _RARE or (wild := drop_outs(known.search)) is None:
        return known, records, ()
    records, said = wild.undisturbed(records), (wild.sentence,)
    return asked.of(records, said), records, said


def _steadied(known: Undisturbed, measuring: Measuring, searched: Callable[[Question], Search]) -> Undisturbed | None:
    """Return the question of records whose zero drifts; None where a set leaves noise already, or none does so."""
    if _is_exact(known.search) or (steady := drifting_zero(known.question, known.search, measuring)) is None:
        return None
    tried = Undisturbed(steady, searched(steady))
    return tried if _is_exact(tried.search) else None


class _Found(NamedTuple):
    """What is said of a disturbance, and the question without it."""

    said: str
    found: Undisturbed


class _Changed(NamedTuple):
    """What is said of changed records, the question of these, and they themselves."""

    said: str
    found: Undisturbed
    records: Sequence[Record]


def _filtered(asked: _Asked, again: Search, records: Sequence[Record], said: Sequence[str]) -> _Changed | None:
    """Return the question with a filter in front of the records, where it is clearly better then.

    Where nothing leaves noise, the filter has to make the difference, and not another set behind it: harmonics that no
    set explains are imitated by those of a large set that a filter turns.
    """
    if asked.sensor_filter is not None or (found := sensor_filter(again)) is None:
        return None
    asked.sensor_filter = found
    sentence, undone = found.sentence(again.batch), found.undone(records, again.batch)
    tried = asked.of(undone, (*said, sentence))
    if _is_better(tried.search, again) and (_is_exact(tried.search) or _gains(tried.search, again)):
        return _Changed(sentence, tried, undone)
    asked.sensor_filter = None
    return None


def _without_first_cycles(
    asked: _Asked, again: Search, records: Sequence[Record], said: Sequence[str]
) -> _Changed | None:
    """Return the question of records without their first cycles, where these alone are off and sets gain by that."""
    if (first := begun(again)) is None:
        return None
    cut = first.undisturbed(records)
    tried = asked.if_promising(again, cut, (*said, first.sentence), _LESS)
    return None if tried is None else _Changed(first.sentence, tried, cut)


def _eased(asked: _Asked, search: Search, records: Sequence[Record]) -> _Found | None:
    """Return the question of releases at which what remembers holds no force, where it is clearly better then."""
    if not is_relaxed_at_release(search):
        return None
    asked.is_relaxed = True
    tried = asked.of(records, (RELAXED,))
    if _is_better(tried.search, search):
        return _Found(RELAXED, tried)
    asked.is_relaxed = False
    return None


def _weighed(asked: _Asked, again: Search, records: Sequence[Record], said: Sequence[str]) -> _Found | None:
    """Return the question of samples that count by the noise that they have, where a set leaves nothing else then.

    What a law lacks grows with the motion, too, and beyond the harmonics that are looked at it passes for noise.
    """
    if (found := motion_noise(again)) is None:
        return None
    asked.noise = found
    tried = asked.if_promising(again, records, (*said, found.sentence), 0.0)
    if tried is not None and _is_exact(tried.search):
        return _Found(found.sentence, tried)
    asked.noise = None
    return None


def _with_drifts(known: Undisturbed, drifting: Callable[[Search], Mapping[Set, Drifting]]) -> Undisturbed:
    """Return the search with the sets that were asked with a drift beside them, where none leaves noise without."""
    if known.drifting is not None or _is_exact(known.search):
        return known
    return with_drifts(known, drifting)


def with_drifts(known: Undisturbed, drifting: Callable[[Search], Mapping[Set, Drifting]]) -> Undisturbed:
    """Return the search with the sets that were asked with a drift beside them; the batch knows how drifts go."""
    known = replace(known, drifting=drifting(known.search))
    batch = known.search.batch  # where drifts may settle
    return known if known.question.batch is batch else replace(known, question=replace(known.question, batch=batch))


def _straightened(
    asked: _Asked,
    again: Search,
    records: Sequence[Record],
    said: Sequence[str],
    drifting: Callable[[Search], Mapping[Set, Drifting]],
) -> Undisturbed | None:
    """Return the question and search of records without bent sensors and lines; None where no set leaves noise then.

    Where a line by itself is not all, and nothing else was changed, everything is asked of the records without it: the
    noise that held the line hid what else disturbs them.
    """
    found: list[Disturbed] = []
    straight = records
    while len(found) < _PASSES and (one := disturbed(again)) is not None:
        found.append(one)
        straight = one.undisturbed(straight)
        tried = asked.of(straight, (*said, *sentences(found)))
        again = tried.search
        if _is_exact(again):
            return replace(tried, is_bent=any(item.is_bent for item in found))
    is_line = bool(found) and not found[0].is_bent
    if not is_line or said or len(asked.lines) + 1 >= _PASSES:
        return None
    without = found[0].undisturbed(records)
    anew = _without_lines(asked.question, without, asked.measuring, asked.searched, drifting, (*asked.lines, found[0]))
    return anew if _is_exact(anew.search) else None


def _without_lines(
    question: Question,
    records: Sequence[Record],
    measuring: Measuring,
    searched: Callable[..., Search],
    drifting: Callable[[Search], Mapping[Set, Drifting]],
    lines: tuple[Disturbed, ...],
) -> Undisturbed:
    """Return question and search of records from which lines were taken, without what else disturbs them."""
    other = question.of_records(records, measuring, sentences(lines))
    early = in_the_way if len(lines) < _PASSES else _in_front
    again = searched(other, early, drift_alone)
    return undisturbed(other, again, records, measuring, searched, drifting, lines)


def _over_motion(search: Search, found: Fit) -> float:
    """Return what a fit leaves as a share of the motion."""
    return float(np.sqrt(found.chi_square.sum())) / evidence.size_of_motion(search.batch)


def _left(search: Search) -> evidence.LackOfFit:
    """Return what the most probable set leaves."""
    return evidence.lack_of_fit(search.batch, search.fits[search.best()])


def _is_better(tried: Search, search: Search) -> bool:
    """Return whether one search leaves noise, or half of what another left at most."""
    return _is_exact(tried) or _left(tried).share < _LESS * _left(search).share


def _gains(tried: Search, search: Search) -> bool:
    """Return whether the most probable set of one search leaves half of what it leaves in another at most.

    Not so of a set as large as they are looked for: with a disturbance beside it, it comes near anything.
    """
    if len(tried.best()) >= tried.max_effects:
        return False
    same = search.fit_set(tried.best())
    return same is None or _left(tried).share < _LESS * evidence.lack_of_fit(search.batch, same).share


def _is_exact(search: Search) -> bool:
    """Return whether the most probable set leaves noise."""
    return evidence.leaves_noise(search.batch, search.fits[search.best()])


__all__ = ["Undisturbed", "in_the_way", "undisturbed", "with_drifts"]
