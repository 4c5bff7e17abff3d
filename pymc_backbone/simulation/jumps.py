"""Backbones of what remembers, from a few cycles at each level instead of all in between.

What a symmetric oscillator remembers at a turning point, beside where that is, follows a smooth curve over amplitude,
if each turning point is looked at in a mirror that makes it a positive peak. What is left of another past is a shift to
one side, so it changes its sign from one turning point to the next. One need not wait until it is forgotten, which
takes hundreds of cycles where little slips: the sixth difference of seven turning points hardly sees a smooth curve,
and sees the shift up to 64-fold. It is taken off the start, and the three cycles are run again, until what is left does
not matter. Where that does not come about, the decay goes on cycle by cycle to the level.

What the whole decay has not forgotten of its release is not taken off: it goes along to the next level, as much
smaller as the shift at both levels is seen to shrink. All this holds for derivatives as well, column by column.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._common.checks import FloatArray, IntArray
from .curves import compiled, curve_at, cycles_of_decay
from .halfcycle import COMPLETED
from .instants import DISPLACEMENT
from .memory import STEP, Turns, Waveform
from .pointers import address
from .run import Run, swing
from .symmetry import weigh_states
from .whole import run_decay
from .windows import (
    HALVES,
    MOST_HALVES,
    Past,
    Window,
    kinds_of_states,
    make_window,
    put_at,
    rest_at,
    run_window,
    see_past,
    trace,
)

_ATTEMPTS = 6
_HEAVIEST = 0.04  # decrement above which three cycles are too far apart for a parabola, and six differences
_LIGHTEST = 2e-5  # and below which the turning points are not exact enough for a decrement
_CYCLES_PER_LEVEL = 7.0  # which jumps mostly take; the decay goes on where all levels left are no more cycles away
_NEAR = 12.0  # cycles to the next level, which are walked instead
_FORGETS = 0.1  # a past that shrinks by more in a half cycle is left to itself for one cycle
_DAMPING = 2e-5  # relative error of the damping from what is left of a past
_SHIFT = 1e-6  # the same of the offset
_SLOPE = 1e-4  # the same of the derivatives of the damping, of their largest
_REMEMBERED = 1e-9  # what is less is no past
_NODES = 3  # levels from which the start at the next one is extrapolated


class Known(NamedTuple):
    """Windows so far, the last in row 0: log starting peak, log of the decrement, ratio of states to it, its slopes."""

    at: FloatArray
    decrement: FloatArray
    ratio: FloatArray
    slopes: FloatArray


class Search(NamedTuple):
    """What is known on the way down.

    The ratio of the states to the starting peak, and its derivatives; the past there should be, that of the window
    before, and how fast it is forgotten; what states weigh; the largest derivatives of the damping so far; where the
    last window began.
    """

    kinds: IntArray
    window: Window
    past: Past
    known: Known
    ratio: FloatArray
    slopes: FloatArray
    target: FloatArray
    target_slopes: FloatArray
    old: FloatArray
    old_slopes: FloatArray
    pace: FloatArray
    weights: FloatArray
    largest: FloatArray
    stand: FloatArray
    carried: int


@compiled
def _pace(past: Past, j: int, decrement: float) -> float:
    """Return how fast a past is forgotten, per logarithm of the amplitude."""
    return -2.0 * math.log(max(past.shrink[j], 1e-8)) / decrement


@compiled
def _between(one: float, other: float) -> float:
    """Return the logarithmic mean of two paces."""
    if not (one > 0.0 and other > 0.0):
        return 0.0
    ratio = math.log(one / other)
    return 0.5 * (one + other) if abs(ratio) < 1e-3 else (one - other) / ratio


@compiled
def _extrapolate(known: Known, count: int, at: float, ratio: FloatArray, slopes: FloatArray) -> float:
    """Write ratios of states, and slopes, where the curve through the last windows leads; return the decrement."""
    decrement = 0.0
    for j in range(ratio.size):
        ratio[j] = 0.0
        for c in range(slopes.shape[1]):
            slopes[j, c] = 0.0
    for a in range(count):
        weight = 1.0
        for b in range(count):
            if b != a:
                weight *= (at - known.at[b]) / (known.at[a] - known.at[b])
        for j in range(ratio.size):
            ratio[j] += weight * known.ratio[a, j]
            for c in range(slopes.shape[1]):
                slopes[j, c] += weight * known.slopes[a, j, c]
        if a < 2:
            line = 1.0
            if count > 1:
                line = (at - known.at[1 - a]) / (known.at[a] - known.at[1 - a])
            decrement += line * known.decrement[a]
    return math.exp(decrement)


@compiled
def _without_past(window: Window, past: Past, further: float, ratio: FloatArray, slopes: FloatArray) -> None:
    """Write what the ratios of the states would be without their past, ``further`` down the logarithm of the peak.

    Slopes are those at a given peak: one that moves along the curve changes nothing.
    """
    x = window.turns.values
    peak = x[0] - past.peak[0]
    for j in range(ratio.size):
        state = window.states[0, j] - past.shift[j]
        later = window.states[6, j] - past.shift[j] * past.shrink[j] ** 6
        along = (later - state) / (x[6] - peak)
        ratio[j] = state / peak
        ratio[j] += (along - ratio[j]) * further
        for c in range(1, slopes.shape[1]):
            moved = window.turns.slopes[0, c] - past.peak[c]
            slopes[j, c] = (window.state_slopes[0, j, c] - past.slopes[j, c] - along * moved) / peak


@compiled
def _note_window(window: Window, past: Past, decrement: float, known: Known, pace: FloatArray) -> None:
    """Move the windows known so far one row on and write this one, without its past, into row 0."""
    for a in range(_NODES - 1, 0, -1):
        known.at[a] = known.at[a - 1]
        known.decrement[a] = known.decrement[a - 1]
        known.ratio[a] = known.ratio[a - 1]
        known.slopes[a] = known.slopes[a - 1]
    known.at[0] = math.log(window.turns.values[0])
    known.decrement[0] = math.log(decrement)
    for j in range(pace.size):
        pace[j] = _pace(past, j, decrement)
    _without_past(window, past, 0.0, known.ratio[0], known.slopes[0])


@compiled
def _excess(
    past: Past, target: FloatArray, target_slopes: FloatArray, weights: FloatArray, decrement: float,
    largest: FloatArray,
) -> float:  # fmt: skip
    """Return by how much what is seen of a past differs from the past there should be, in units of what may be.

    Its share of the force shifts the mid-line, and the decrement by as much of that as is forgotten in a cycle.
    """
    shift, change = 0.0, 0.0
    for j in range(weights.size):
        left = weights[j] * abs(past.shift[j] - target[j])
        shift += left
        change += 2.0 * left * (1.0 - past.shrink[j])
    result = max(shift / _SHIFT, change / (_DAMPING * decrement))
    for c in range(1, past.slopes.shape[1]):
        change = 0.0
        for j in range(weights.size):
            change += 2.0 * weights[j] * abs(past.slopes[j, c] - target_slopes[j, c]) * (1.0 - past.shrink[j])
        if change > 0.0:
            result = max(result, change / (_SLOPE * largest[c - 1]))
    return result


@compiled
def walk_to(run: Run, level: float, decrement: float, turns: Turns) -> bool:
    """Run on, cycle by cycle, to a positive peak two cycles above a level; return whether that is where the run is."""
    none = Waveform(np.empty(0), np.empty(0), np.empty((0, 0)), DISPLACEMENT)
    count, code = run_decay(run, level * math.exp(3.5 * decrement), 0, turns.values.size, turns, none)
    if code == COMPLETED and count % 2 == 0:
        code = swing(run, 1.0)
    return code == COMPLETED and run.y[0] > level


@compiled
def _set_target(search: Search, decrement: float, further: float) -> None:
    """Write what is left of the past of the window before, ``further`` down the logarithm of the peak.

    ``decrement`` is that of the window here, 0 where none was run.
    """
    for j in range(search.target.size):
        here = _pace(search.past, j, decrement) if decrement > 0.0 else search.pace[j]
        share = math.exp(_between(search.pace[j], here) * further)
        search.target[j] = share * search.old[j]
        for c in range(1, search.target_slopes.shape[1]):
            search.target_slopes[j, c] = share * search.old_slopes[j, c]


@compiled
def _search(run: Run, carried: int) -> Search:
    """Return room for what is known on the way down."""
    n, columns = run.n_states, run.columns
    past = Past(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, columns)), np.zeros(1 + columns))
    known = Known(np.zeros(_NODES), np.zeros(_NODES), np.zeros((_NODES, n)), np.zeros((_NODES, n, columns)))
    return Search(
        kinds_of_states(run), make_window(run, carried), past, known, np.zeros(n), np.zeros((n, columns)),
        np.zeros(n), np.zeros((n, columns)), np.zeros(n), np.zeros((n, columns)), np.zeros(n), np.zeros(n),
        np.zeros(run.p.size), run.y.copy(), carried,
    )  # fmt: skip


@compiled
def _look(
    run: Run, search: Search, level: float, k: int, most: int, values: FloatArray, jacobian: FloatArray
) -> tuple[float, bool]:
    """Run a window from where the run stands and see what is there.

    Returns the decrement, 0 where this cannot be used, and whether the cycles enclose the level, which is then written.
    """
    window, carried = search.window, search.carried
    run.memory[STEP] = 0.0
    trace(run, search.kinds)
    search.stand[:] = run.y
    weigh_states(address(run.integers), address(run.memory), address(run.p), address(search.weights))
    turned, code = run_window(run, level, most, window)
    x = window.turns.values
    decrement = math.log(x[0] / x[6]) / 3.0 if code == COMPLETED and x[6] > 0.0 else 0.0
    if not _LIGHTEST < decrement < _HEAVIEST:
        return 0.0, False
    found = cycles_of_decay(
        x, window.turns.times, window.turns.slopes, window.turns.time_slopes, turned, carried, window.cycles,
        window.cycle_slopes,
    )  # fmt: skip
    room = np.empty(8)
    enclosed = curve_at(
        window.cycles, window.cycle_slopes, found, level, k, carried, values, jacobian, room[:4], room[4:]
    )
    for c in range(1, carried):
        if enclosed:
            search.largest[c - 1] = max(search.largest[c - 1], abs(jacobian[1, k, c - 1]))
    see_past(window, search.kinds, search.weights, run.columns, search.past)
    return decrement, enclosed


@compiled
def _set_out(run: Run, search: Search, start: float, forgets: bool) -> bool:
    """Start at a peak with the past there should be; return whether a cycle more, if wanted, was completed."""
    for j in range(run.n_states):
        search.ratio[j] += search.target[j] / start
        for c in range(1, run.columns):
            search.slopes[j, c] += search.target_slopes[j, c] / start
    put_at(run, start, search.kinds, search.ratio, search.slopes)
    return not forgets or (swing(run, -1.0) == COMPLETED and swing(run, 1.0) == COMPLETED)


@compiled
def _jump(
    run: Run, search: Search, level: float, k: int, count: int, values: FloatArray, jacobian: FloatArray
) -> float:
    """Write the backbone at a level from a start extrapolated from ``count`` windows; return its decrement, or 0."""
    known, past = search.known, search.past
    decrement = min(_extrapolate(known, count, math.log(level), search.ratio, search.slopes), _HEAVIEST)
    forgets = bool(past.shrink.max() < _FORGETS)
    start = level * math.exp((2.5 if forgets else 1.5) * decrement)
    _extrapolate(known, count, math.log(start), search.ratio, search.slopes)
    _set_target(search, 0.0, math.log(start) - known.at[0])
    past.seen[:] = 0.0
    before = np.inf
    for attempt in range(_ATTEMPTS):
        if not _set_out(run, search, start, forgets and attempt == 0):
            return 0.0
        start = run.y[0]
        decrement, enclosed = _look(run, search, level, k, HALVES, values, jacobian)
        if decrement == 0.0:
            return 0.0
        _set_target(search, decrement, math.log(start) - known.at[0])
        further = 0.0
        if enclosed:
            excess = _excess(past, search.target, search.target_slopes, search.weights, decrement, search.largest)
            if excess <= 1.0:
                return decrement
            if attempt > 1 and not excess < 0.5 * before:
                return 0.0
            before = excess
        else:
            further = math.log(level / search.window.cycles[1, 0])
            start *= level / search.window.cycles[1, 0]
        _without_past(search.window, past, further, search.ratio, search.slopes)
    return 0.0


@compiled
def jump_down(
    run: Run, levels: FloatArray, values: FloatArray, jacobian: FloatArray, status: IntArray, turns: Turns
) -> int:
    """Write the backbone at the levels, from the highest on, as far down as jumps are worth it and right.

    The run stands at a positive peak of its decay two cycles above the highest level; ``turns`` is room for more. Where
    a jump fails or is not worth it, the decay goes on from the level before. Returns how many levels are left; the run
    is put to a peak a little above the lowest level that is answered.
    """
    search = _search(run, run.columns if jacobian.size > 0 else 0)
    known, past = search.known, search.past
    resumed = run.y.copy()
    top = levels.size - 1
    left = levels.size
    for k in range(top, -1, -1):
        level = levels[k]
        found = 0.0
        if k < top:
            last = math.exp(known.decrement[0])
            if math.log(levels[k + 1] / levels[0]) < _CYCLES_PER_LEVEL * (k + 1) * last:
                break
            if math.log(levels[k + 1] / level) > _NEAR * last:
                found = _jump(run, search, level, k, min(top - k, _NODES), values, jacobian)
            if found == 0.0:
                rest_at(run, resumed)
                if not walk_to(run, level, last, turns):
                    break
        if found == 0.0:
            past.seen[:] = 0.0
            found, enclosed = _look(run, search, level, k, MOST_HALVES, values, jacobian)
            if not enclosed:
                break
        status[k] = COMPLETED
        left = k
        _note_window(search.window, past, found, known, search.pace)
        for j in range(run.n_states):
            counts = search.weights[j] * abs(past.shift[j]) > _REMEMBERED
            search.old[j] = past.shift[j] if counts else 0.0
            for c in range(1, run.columns):
                search.old_slopes[j, c] = past.slopes[j, c]
        resumed[:] = search.stand
    rest_at(run, resumed)
    return left
