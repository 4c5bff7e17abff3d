"""What records of one batch say of each other's slow noise and mid-line: they mostly come from one sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .conditioned import ConditionedRecord
from .wander import Wander, of_one_sensor

_WIDE = 1.3  # ratio of amplitudes that records have in common from which their mid-lines are compared
_UNLIKE = 0.7  # spread of the mid-lines over their mean, beyond which they are no structure's
_STANDS_OUT = 6.0  # standard errors that one has to be off the mean for it
_ZERO_DRIFTS = (
    "the sensor's zero drifts: the mid-lines of the records are no common function of their amplitudes; they are "
    "counted as noise, not as the structure's"
)


def records_of_one_sensor(records: Sequence[ConditionedRecord]) -> list[ConditionedRecord]:
    """Return the records, the slow noise and the mid-line of each judged with those of the others."""
    wanders = [record.measured.wander for record in records]
    said: tuple[str, ...] = ()
    if mid_lines_differ(wanders):
        said = (_ZERO_DRIFTS,)
        wanders = [item if item is None or item.of_all is None else item.of_all for item in wanders]
    together = of_one_sensor(wanders)
    return [
        replace(record, notes=(*record.notes, *said), measured=replace(record.measured, wander=wander))
        for record, wander in zip(records, together, strict=True)
    ]


def mid_lines_differ(wanders: Sequence[Wander | None]) -> bool:
    """Return whether the mid-lines of several records are no function of the amplitude that these have in common.

    Then they are no structure's, however smooth, and all of them is slow noise (`Wander.of_all`). They are compared
    over the amplitudes that all records have. Nominally equal structures differ by a third at most; hysteresis moves
    the mid-line to the side of the release, an asymmetric spring to its own.
    """
    lines = [item.mid_line for item in wanders if item is not None and item.mid_line is not None]
    if len(lines) < 2:
        return False
    low = max(float(line.amplitude[0]) for line in lines)
    high = min(float(line.amplitude[-1]) for line in lines)
    if not high > _WIDE * low:
        return False
    change = np.array([line.change(low, high) for line in lines])
    error = np.sqrt(2.0) * np.array([line.error for line in lines])
    for one in (change, change * np.array([line.side for line in lines])):
        off = np.abs(one - one.mean())
        spread = float(np.sqrt((off**2).sum() / (off.size - 1)))
        if spread < _UNLIKE * abs(one.mean()) or not np.any(off > _STANDS_OUT * error):
            return False
    return True
