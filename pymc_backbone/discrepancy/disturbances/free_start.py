"""Sets of effects fitted to records whose first cycle says nothing, however it came about."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.whitening import with_slow_noise
from .behind_filter import ITERATIONS
from .sensor_filter import first_values


@dataclass(frozen=True, eq=False)
class FreeStart:
    """A set fitted to records whose first cycle is free.

    Attributes
    ----------
    batch : Batch
        The records so.
    found : Fit
        The set.
    values : int
        How many values of the first cycles are free.
    """

    batch: Batch
    found: Fit
    values: int

    @property
    def cost(self) -> float:
        """What the set leaves, and one for each value that is free."""
        return self.found.cost + float(self.values)


def without_start(start: Fit, batch: Batch) -> FreeStart | None:
    """Return a set fitted to records whose first cycle says nothing; None where it cannot be simulated there."""
    columns = [first_values(term, whole_cycle=True) for term in batch.waveform]
    terms = tuple(
        replace(term, whiten=with_slow_noise(term.whiten, term.compared(first)))
        for term, first in zip(batch.waveform, columns, strict=True)
    )
    found = fit(start.layout, terms, start.state, iterations=ITERATIONS, nuisances=batch.nuisances)
    if found is None:
        return None
    return FreeStart(replace(batch, waveform=terms), found, sum(first.shape[1] for first in columns))


def left_without_start(start: Fit, batch: Batch) -> float:
    """Return the cost of a set with records whose first cycle says nothing, and one for each value of that."""
    free = without_start(start, batch)
    return np.inf if free is None else free.cost


__all__ = ["FreeStart", "left_without_start", "without_start"]
