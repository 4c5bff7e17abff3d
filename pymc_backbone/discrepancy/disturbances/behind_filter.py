"""A set of effects behind a filter in front of the records, and what it leaves there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import State
from ..fitting.telling import Telling
from ..fitting.waveform_term import WaveformTerm
from ..weighing import evidence
from .sensor_filter import SensorFilter

PRICE = 16.0
"""Chi-square that order and cut-off must be worth."""
EACH = 4.0
"""Chi-square that each parameter of a set must be worth."""
ITERATIONS = 12
"""Of a fit behind a filter."""
MOST_FITTED = 2
"""Sets that are fitted behind a filter, those of which a look promises most."""
_PROMISING = 0.8  # share of what is left of some records, that a filter leaves at most to be asked of all


@dataclass(frozen=True)
class FittedBehind:
    """A filter and a set behind it."""

    filter: SensorFilter
    found: Fit

    def cost(self) -> float:
        """Return what the set leaves."""
        return self.found.cost


@dataclass(frozen=True)
class Behind:
    """A set behind the filter that suits it best: its cost, what its parameters must be worth, if it leaves noise.

    And the fit, whose own cost is that of the values that are compared behind the filter.
    """

    cost: float
    price: float
    is_exact: bool
    filter: SensorFilter
    found: Fit


def behind_it(batch: Batch, best: SensorFilter, found: Fit) -> Behind:
    """Return what a fit behind a filter says of both."""
    behind = best.passed(batch)
    lost = sum(term.size for term in batch.waveform) - sum(term.size for term in behind.waveform)
    past = float(sum(map(best.unknown_past, batch.waveform)))  # amounts of what a filter held before, all fitted
    price = EACH * found.layout.free.size
    return Behind(found.cost + lost + past, price, evidence.leaves_noise(behind, found), best, found)


def fitted_behind(batch: Batch, chosen: SensorFilter, known: Fit, state: State) -> FittedBehind | None:
    """Return a set behind a filter, from a state on; None where it cannot be simulated there."""
    terms = chosen.passed(batch).waveform
    solved = fit(known.layout, terms, state, iterations=ITERATIONS, nuisances=batch.nuisances)
    return None if solved is None else FittedBehind(chosen, solved)


def is_promising_part(part: Telling, best: FittedBehind) -> bool:
    """Return whether a set leaves clearly less of some records behind a filter than without one."""
    return best.cost() < _PROMISING * part.left or is_exact_behind(part.batch, best)


def is_exact_behind(batch: Batch, behind: FittedBehind) -> bool:
    """Return whether a set leaves noise behind a filter."""
    return evidence.leaves_noise(behind.filter.passed(batch), behind.found)


def left_by(start: Fit, batch: Batch, terms: Sequence[WaveformTerm]) -> float:
    """Return the cost of a set with records that may begin otherwise and go through no filter."""
    solved = fit(start.layout, tuple(terms), start.state, iterations=ITERATIONS, nuisances=batch.nuisances)
    return np.inf if solved is None else solved.cost


__all__ = [
    "EACH", "ITERATIONS", "MOST_FITTED", "PRICE", "Behind", "FittedBehind", "behind_it", "fitted_behind",
    "is_exact_behind", "is_promising_part", "left_by",
]  # fmt: skip
