"""Sets of effects as the backbones propose them where frequency and damping may drift with time in each record.

In one decay the amplitude is a function of time: a drift bends the backbone as a law would, and the sets that explain a
bent one are others than those which act. With the drifts as unknowns of each record, their backbones say little, but
not the wrong thing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..fitting.batch import Batch
from ..fitting.data_term import LevelTerm
from ..fitting.drift_course import DRIFT, covered
from ..fitting.normal_equations import State
from ..fitting.scatter import SCATTER, WIDE_SCATTER
from ..proposals.proposal import Proposal
from ..proposals.propose import propose
from ..sets.search import Search, Set

_LARGEST = 2  # effects of the sets that are looked at
_LIKELIEST = 3  # of these that begin
_RIDGE = 1e-9


def single_beside_drifts(search: Search, *, remembering: bool = True) -> Iterator[tuple[Set, State]]:
    """Yield every single effect and its start, by its backbones beside drifts, those that remember last or not at all.

    What looks lack is taken from the exact simulation of what leads: beside others a slider is led astray, and is asked
    alone. It slips in some records and not in others: then only wide scatter leads there, and it begins twice.
    """
    batch = beside_drifts(search.batch)
    sliders = [name for name in search.candidates if search.layout((name,)).simulator.needs_decay]
    others = tuple(name for name in search.candidates if name not in sliders)
    asked = [(others, SCATTER)] if others else []
    asked += [((name,), scatter) for name in sliders if remembering for scatter in (SCATTER, WIDE_SCATTER)]
    for names, scatter in asked:
        found = propose(batch, search.base, names, 1, search.own, scatter=scatter)
        yield from _begun(search, [item for item in found if item.names])


def sets_beside_drifts(search: Search) -> Iterator[tuple[Set, State]]:
    """Yield the likeliest sets of several effects by their backbones beside drifts, and their starts."""
    most = min(_LARGEST, search.max_effects)
    found = propose(
        beside_drifts(search.batch), search.base, search.candidates, most, search.own, scatter=search.scatter
    )
    yield from _begun(search, [item for item in found if len(item.names) > 1][:_LIKELIEST])


def _begun(search: Search, proposals: Iterable[Proposal]) -> Iterator[tuple[Set, State]]:
    for item in proposals:
        if item.starts:
            _, eta, own = item.starts[0]
            yield item.names, search.descent.released(search.layout(item.names), eta, own)


def beside_drifts(batch: Batch) -> Batch:
    """Return the batch with the drifts of each record among the errors of its level values, as wide as their priors."""
    return replace(batch, levels=tuple(_beside_drifts(batch, r) for r in range(len(batch.levels))))


def _beside_drifts(batch: Batch, r: int) -> LevelTerm:
    term, cycles = batch.levels[r], batch.cycles[r]
    length = float(np.ptp(batch.waveform[r].time))
    order = np.argsort(cycles.smoothed_amplitude)
    elapsed = (cycles.time[order] - batch.own[r, 3]) / length
    share = np.interp(term.levels, cycles.smoothed_amplitude[order], elapsed)[term.rows[:, 1]]
    is_frequency, is_damping = term.rows[:, 0] == 0, term.rows[:, 0] == 1
    faster = np.where(is_frequency, DRIFT * covered(share, batch.waveform[r].settling) * term.values, 0.0)
    less = np.where(is_damping, batch.waveform[r].fade * share / (length * batch.records[r].frequency), 0.0)
    root = np.linalg.inv(term.whitening)
    covariance = root @ root.T + np.outer(faster, faster) + np.outer(less, less)
    scale = np.sqrt(np.diag(covariance))
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + _RIDGE * np.eye(scale.size))
    return replace(term, whitening=np.linalg.inv(factor) / scale)


__all__ = ["beside_drifts", "sets_beside_drifts", "single_beside_drifts"]
