"""A few half cycles of what remembers: how they start, turning points with mirrored states, what is seen of a past."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._common.checks import FloatArray, IntArray
from .curves import compiled
from .forces import KIND, MEMORY, OWN_EQUATION, ROW, Z_FIRST, Z_LAST
from .halfcycle import COMPLETED
from .memory import AMPLITUDE, N_EFFECTS, STEP, STEP_BEHIND_KINK, TABLE, TIME, Turns
from .run import Run, swing

HALVES = 6  # half cycles at a level
MOST_HALVES = 12  # and where they are not started from a level's own
OWN, PLACE, FORCE, BRANCH = range(4)  # what a state is: one with its own equation, or those of a slider


class Window(NamedTuple):
    """Half cycles at a level: turning points, mirrored peaks and states with derivatives, and cycles."""

    turns: Turns
    peaks: FloatArray
    states: FloatArray
    state_slopes: FloatArray
    cycles: FloatArray
    cycle_slopes: FloatArray


class Past(NamedTuple):
    """What is seen of a past at the start of a window.

    By how much it shrinks in a half cycle, and how large what showed it was; the shift of the states, with derivatives,
    and of the peak, its derivatives behind it.
    """

    seen: FloatArray
    shrink: FloatArray
    shift: FloatArray
    slopes: FloatArray
    peak: FloatArray


@compiled
def kinds_of_states(run: Run) -> IntArray:
    """Return what each state is."""
    kinds = np.zeros(run.n_states, np.int64)
    for i in range(run.integers[N_EFFECTS]):
        row = TABLE + ROW * i
        first = run.integers[row + Z_FIRST]
        if run.integers[row + KIND] == OWN_EQUATION:
            for j in range(first, run.integers[row + Z_LAST]):
                kinds[j] = OWN
        elif run.integers[row + KIND] == MEMORY:
            kinds[first] = PLACE
            kinds[first + 1] = FORCE
            kinds[first + 2] = BRANCH
    return kinds


@compiled
def make_window(run: Run, carried: int) -> Window:
    """Return room for one window."""
    n = MOST_HALVES + 1
    turns = Turns(np.empty(n), np.empty(n), np.empty((n, run.columns)), np.empty((n, run.columns)))
    states = np.empty((n, run.n_states))
    slopes = np.empty((n, run.n_states, run.columns))
    return Window(turns, np.empty((n, 1 + run.columns)), states, slopes, np.empty((n, 4)), np.empty((n, 4, carried)))


@compiled
def put_at(run: Run, start: float, kinds: IntArray, ratio: FloatArray, slopes: FloatArray) -> None:
    """Put the oscillator at the peak ``start``, at rest, its states at ``ratio`` to it (slopes: at this place)."""
    n, columns = run.n_states, run.columns
    for i in range(run.y.size):
        run.y[i] = 0.0
    run.y[0] = start
    run.memory[AMPLITUDE] = start
    for j in range(n):
        behind = 2 + n + (2 + j) * columns
        if kinds[j] == PLACE:
            run.y[2 + j] = start
        elif kinds[j] == BRANCH:
            run.y[2 + j] = 1.0
        else:
            run.y[2 + j] = ratio[j] * start
            for c in range(columns):
                run.y[behind + c] = slopes[j, c] * start


@compiled
def rest_at(run: Run, y: FloatArray) -> None:
    """Put the run to a peak that was passed before, at rest."""
    run.y[:] = y
    run.memory[TIME] = 0.0
    run.memory[STEP] = 0.0
    run.memory[STEP_BEHIND_KINK] = 0.0
    run.memory[AMPLITUDE] = y[0]
    for c in range(run.columns):
        run.dt[c] = 0.0


@compiled
def trace(run: Run, kinds: IntArray) -> None:
    """Let column 0, which a backbone at levels does not need, follow a shift of the states at this peak."""
    n, columns = run.n_states, run.columns
    if columns == 0:
        return
    for row in range(2 + n):
        run.y[2 + n + row * columns] = 0.0
    for j in range(n):
        if kinds[j] == OWN or kinds[j] == FORCE:
            run.y[2 + n + (2 + j) * columns] = run.y[0]


@compiled
def _note(run: Run, window: Window, k: int) -> None:
    """Write where the run stands into row ``k``; states as a mirror shows them in which this is a positive peak."""
    n, columns = run.n_states, run.columns
    side = 1.0 if k % 2 == 0 else -1.0
    window.turns.values[k] = run.y[0]
    window.turns.times[k] = run.memory[TIME]
    for c in range(columns):
        window.turns.slopes[k, c] = run.slopes[c]
        window.turns.time_slopes[k, c] = run.dt[c]
    window.peaks[k, 0] = side * run.y[0]
    for c in range(1, columns):
        window.peaks[k, c] = side * run.slopes[c]
    for j in range(n):
        window.states[k, j] = side * run.y[2 + j]
        for c in range(columns):
            window.state_slopes[k, j, c] = side * run.y[2 + n + (2 + j) * columns + c]


@compiled
def run_window(run: Run, level: float, most: int, window: Window) -> tuple[int, int]:
    """Run three cycles on from a positive peak, or up to ``most`` half cycles until two cycles are below the level.

    Returns how many turning points there are, and the status.
    """
    run.memory[TIME] = 0.0
    run.memory[AMPLITUDE] = run.y[0]
    for c in range(run.columns):
        run.dt[c] = 0.0
    _note(run, window, 0)
    direction = -1.0
    x = window.turns.values
    for k in range(1, most + 1):
        code = swing(run, direction)
        if code != COMPLETED:
            return k, code
        _note(run, window, k)
        direction = -direction
        if k > HALVES and k % 2 == 0 and 0.25 * (x[k - 2] + x[k - 4] - 2.0 * x[k - 3]) < level:
            return k + 1, COMPLETED
    return most + 1, COMPLETED


@compiled
def _fourth(column: FloatArray, k: int) -> float:
    """Return the fourth difference of a column from row ``k`` on."""
    result: float = column[k] - 4.0 * column[k + 1] + 6.0 * column[k + 2] - 4.0 * column[k + 3] + column[k + 4]
    return result


@compiled
def _sixth(column: FloatArray) -> float:
    """Return the sixth difference of a column's first seven rows."""
    return _fourth(column, 0) - 2.0 * _fourth(column, 1) + _fourth(column, 2)


@compiled
def see_past(window: Window, kinds: IntArray, weights: FloatArray, columns: int, past: Past) -> None:
    """Write what is seen of a past: a share that changes its sign at each turning point, and shrinks.

    By how much it shrinks is seen in what follows a shift, where that is carried, otherwise in the states themselves;
    of several runs at a level, in the one that shows most (``seen``, 0 before the first).
    """
    for j in range(kinds.size):
        past.shift[j] = 0.0
        for c in range(columns):
            past.slopes[j, c] = 0.0
        if kinds[j] == PLACE or kinds[j] == BRANCH:
            past.shrink[j] = 0.0
            continue
        column = window.state_slopes[:, j, 0] if columns > 1 else window.states[:, j]
        d0, d1, d2 = _fourth(column, 0), _fourth(column, 1), _fourth(column, 2)
        square = d0 * d0 + d1 * d1
        if square > 0.1 * past.seen[j]:
            past.seen[j] = max(square, past.seen[j])
            past.shrink[j] = min(max(-(d0 * d1 + d1 * d2) / square, 0.0), 1.0)
        weight = (1.0 + past.shrink[j]) ** -6
        past.shift[j] = weight * _sixth(window.states[:, j])
        for c in range(1, columns):
            past.slopes[j, c] = weight * _sixth(window.state_slopes[:, j, c])
    # The peak itself stands on a mid-line that is shifted: by the state that weighs most.
    most = 0
    for j in range(kinds.size):
        if weights[j] * abs(past.shift[j]) > weights[most] * abs(past.shift[most]):
            most = j
    weight = (1.0 + past.shrink[most]) ** -6
    past.peak[0] = weight * _sixth(window.peaks[:, 0])
    for c in range(1, columns):
        past.peak[c] = weight * _sixth(window.peaks[:, c])
