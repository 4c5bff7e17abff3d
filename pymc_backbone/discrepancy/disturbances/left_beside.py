"""What a set leaves beside disturbances of the readings: set and coefficients are one linear problem, solved anew."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..._common.checks import FloatArray
from ..._common.unit_diagonal import unit_diagonal
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import DRIFTS, State, derivatives
from ..fitting.waveform_term import WaveformTerm
from ..weighing import evidence
from .disturbance import Disturbance, line_modes, nothing_beside
from .mode_lines import are_beside, step_of, with_lines

_MOST = 0.1  # of the reading at the largest motion: what bends by more is no sensor
_MOST_OF_A_LINE = 0.3  # of the motion: beside more, the other mode is no disturbance
_STAYS = 0.5  # bins by which a line that beats with the motion may move
_LOOKS = 3  # times that the coefficients are found again, the set fitted to what they leave ...
_MOST_LOOKS, _SETTLED = 10, 1.0  # ... for a line that beats with the motion, until that changes so little


class LeftBeside(NamedTuple):
    """What a set leaves beside disturbances, these, and whether it is noise."""

    cost: float
    items: list[Disturbance]
    is_noise: bool


def left_beside(
    batch: Batch, start: Fit, limit: float, *, has_line: bool, is_bent: bool, lines: list[Disturbance] | None = None
) -> LeftBeside | None:
    """Return what a set leaves beside a disturbance, and that; None where it is not less than the limit.

    A line is looked for in what the set leaves, but where ``lines`` says what it is about.
    """
    items = lines or [
        nothing_beside(term.time, term.values, float(record.time[0]))
        for term, record in zip(batch.waveform, batch.records, strict=True)
    ]
    without, found = batch, start
    if lines is not None:
        motions = (term.values - term.values.mean() for term in batch.waveform)
        without, solved = _fitted(batch, found, items, motions, found.state)
        if solved is None:
            return None
        found = solved
    for _ in range(_LOOKS if lines is None else _MOST_LOOKS):
        before = found.cost
        if has_line:
            items = with_lines(batch, without, found, items)
            if not any(item.frequency for item in items):
                return None
        moved = [_moved(term, found, r) for r, term in enumerate(without.waveform)]
        looked = _linear(without, found, items, moved, is_bent=is_bent)
        if looked is None or not looked.cost < limit:
            return None
        items = looked.items
        if max(item.bent for item in items) > _MOST or max(_moves(batch, items)) > _MOST_OF_A_LINE:
            return None
        without, solved = _fitted(batch, found, items, moved, looked.state)
        if solved is None:
            return None
        found = solved
        if lines is not None and abs(found.cost - before) < _SETTLED:
            break
    if has_line and not (are_beside(batch, found, items) if lines is None else _stayed(items, lines)):
        return None
    if not found.cost < limit:
        return None
    # another mode begins with the motion, before the record that is compared; what runs nearby was there before
    begun = [
        -np.inf if item.lasts else min(item.release, float(own[3]))
        for item, own in zip(items, found.state.own, strict=True)
    ]
    items = [replace(item, release=release) for item, release in zip(items, begun, strict=True)]
    return LeftBeside(found.cost, items, evidence.lack_of_fit(without, found).p_value >= evidence.UNEXPLAINED)


def _moves(batch: Batch, items: list[Disturbance]) -> list[float]:
    """Return how much of the displacement each line is: an acceleration shows the higher mode more than it moves."""
    together = zip(items, batch.waveform, batch.records, strict=True)
    return [
        item.line * min(record.frequency / item.frequency, 1.0) ** term.order if item.frequency else 0.0
        for item, term, record in together
    ]


def _stayed(items: list[Disturbance], lines: list[Disturbance]) -> bool:
    """Return whether lines are where they were: what beats with the motion is not told from it by its distance."""
    together = zip(items, lines, strict=True)
    return all(abs(item.frequency - line.frequency) * (line.end - line.begin) < _STAYS for item, line in together)


def _fitted(
    batch: Batch, found: Fit, items: list[Disturbance], motions: Iterable[FloatArray], start: State
) -> tuple[Batch, Fit | None]:
    """Return the records without disturbances of their motions, and the set fitted to them."""
    nuisances = tuple(np.flatnonzero(found.active[: found.state.own.shape[1]]).tolist())  # of a drift, where it has one
    terms = tuple(_without(*of) for of in zip(batch.waveform, items, motions, strict=True))
    return replace(batch, waveform=terms), fit(found.layout, terms, start, iterations=10, nuisances=nuisances)


def _moved(term: WaveformTerm, found: Fit, r: int) -> FloatArray:
    """Return the motion (n,) that a set says a straight sensor would have read.

    What a bent sensor adds is found by that and not by the readings: their noise goes along with its own cube, and
    would pass for a bend.
    """
    motion = term.values - term.values.mean()
    inner, left = term.compared(motion), evidence.residuals_as_measured(term, found, r)
    if left.size == inner.size:  # not where the set cannot be simulated
        inner -= left
    return motion


def _without(term: WaveformTerm, item: Disturbance, motion: FloatArray) -> WaveformTerm:
    """Return a term whose values hold no disturbance of a motion."""
    line = np.zeros(motion.size)
    if item.frequency:
        line = line_modes(term.time, item, step_of(term)) @ np.array([item.cosine, item.sine])
    share = (motion + line) / item.scale
    return replace(term, values=term.values - line - item.scale * (item.even * share**2 + item.odd * share**3))


@dataclass(frozen=True, eq=False)
class _Look:
    """What a linear look promises: the cost, the disturbances, and where the set goes."""

    cost: float
    items: list[Disturbance]
    state: State


def _linear(
    without: Batch, found: Fit, items: list[Disturbance], moved: list[FloatArray], *, is_bent: bool
) -> _Look | None:
    """Return where set and coefficients go in one step together; None where the set cannot be simulated."""
    layout, state, active = found.layout, found.state, found.active
    q, count = layout.free.size, len(items)
    scatter = layout.scatter if q and active[-1] and count > 1 else 0.0
    kept = np.flatnonzero(active)
    prior = (kept >= DRIFTS[0]).astype(np.float64)
    width = kept.size + 4
    matrix, right, squares = np.zeros((q + count * width,) * 2), np.zeros(q + count * width), 0.0
    for r, term in enumerate(without.waveform):
        known = derivatives(layout, term, state.eta, state.own[r], scatter, active)
        if known is None:
            return None
        columns = np.hstack([known.shared, known.own[:, kept], _modes(term, items[r], moved[r], is_bent=is_bent)])
        at = np.concatenate([np.arange(q), q + r * width + np.arange(width)])
        matrix[np.ix_(at, at)] += columns.T @ columns
        right[at] += columns.T @ known.residuals
        own = at[q : q + kept.size]
        matrix[own, own] += prior
        right[own] -= prior * state.own[r, kept]
        squares += float(known.residuals @ known.residuals) + float(prior @ state.own[r, kept] ** 2)
    step = unit_diagonal(matrix).least_squares(right, 1e-12)
    if not np.isfinite(step).all():
        return None
    own, each = state.own.copy(), step[q:].reshape(count, width)
    has_line = any(item.frequency for item in items)
    own[:, kept] += each[:, : kept.size]
    own[:, 1] = np.maximum(own[:, 1], 0.0)
    each[:, kept.size :][:, [not is_bent, not is_bent, not has_line, not has_line]] = 0.0
    changed = [
        replace(item, even=item.even + even, odd=item.odd + odd, cosine=item.cosine + cosine, sine=item.sine + sine)
        for item, (even, odd, cosine, sine) in zip(items, each[:, kept.size :].tolist(), strict=True)
    ]
    return _Look(squares - float(step @ right), changed, State(layout.within(state.eta + step[:q]), own))


def _modes(term: WaveformTerm, item: Disturbance, motion: FloatArray, *, is_bent: bool) -> FloatArray:
    """Return what a unit of each coefficient adds to the standardised values (m, 4); zeros for what is not there."""
    columns = np.zeros((motion.size, 4))
    if is_bent:
        columns[:, 0], columns[:, 1] = motion**2 / item.scale, motion**3 / item.scale**2
    if item.frequency:
        columns[:, 2:] = line_modes(term.time, item, step_of(term))
    return term.whiten(term.compared(columns))


__all__ = ["LeftBeside", "left_beside"]
