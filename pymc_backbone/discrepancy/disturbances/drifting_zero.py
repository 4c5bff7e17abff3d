"""A sensor's zero that drifts: a mid-line that no set explains, and without which one does.

In one decay a drift is as smooth a function of the amplitude as the mid-line of a structure, and where all records
drift alike, of several, too. But what shifts the mid-line of a structure makes harmonics as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...measurement.conditioning.conditioned import ConditionedRecord
from ...measurement.options import Measuring
from ..fitting.joint_fit import fit
from ..sets.question import Question
from ..sets.search import Search
from ..weighing import evidence

SENTENCE = (
    "warning: the mid-line moves as no known effect moves it, as where the zero of the sensor drifts; without it the "
    "records are explained, and it was counted as noise, not as the structure's. Let the sensor warm up, or look at "
    "its electronics; where these are steady, it is the structure's after all, by an effect that is not known"
)


def drifting_zero(question: Question, search: Search, measuring: Measuring) -> Question | None:
    """Return the question of records whose mid-line is all noise, where their best set or the base explains them so.

    None where it does not, and where no mid-line stands out of the noise.
    """
    batch = search.batch
    if not batch.has_open_records:
        return None
    records = _of_noise(batch.records)
    if all(one is other for one, other in zip(records, batch.records, strict=True)):
        return None
    other = question.of_records(records, measuring).saying(SENTENCE)
    if other.batch.specimens != batch.specimens:
        return None
    for names in dict.fromkeys((search.best(), ())):
        begun = search.fits[names]
        found = fit(begun.layout, other.batch.deciding, begun.state, nuisances=other.batch.nuisances)
        if found is not None and evidence.leaves_noise(other.batch, found):
            return other
    return None


def _of_noise(records: Sequence[ConditionedRecord]) -> list[ConditionedRecord]:
    """Return the records, those whose mid-line stands out of the noise with all of it as noise."""
    changed = []
    for record in records:
        wander = record.measured.wander
        of_all = None if wander is None else wander.of_all
        if of_all is not None and of_all.is_sure:
            record = replace(record, measured=replace(record.measured, wander=of_all))
        changed.append(record)
    return changed


__all__ = ["SENTENCE", "drifting_zero"]
