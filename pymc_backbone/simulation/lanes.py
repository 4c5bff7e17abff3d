"""Backbones of many parameter vectors of one smooth oscillator: one cycle per level, side by side in lanes.

The starting peak of a cycle at a level is extrapolated from the levels above; a secant in the starting peak corrects
it, in all lanes, where too many are too far off. What then remains is interpolated: between the cycles of the levels,
or, where it is done carefully, between the last two cycles at the level.
"""

from __future__ import annotations

import math

import numpy as np

from .._common.checks import FloatArray, IntArray
from .._common.compiled import cached
from .lane_cycles import Block, begin, describe_block, load, run_cycle, take_angle, turn
from .lane_levels import DISTANCE, LEAST_DAMPING, N_ROWS, RATIO, VALUES, read_off_between, read_off_carefully
from .lane_stages import (
    AMPLITUDE,
    AMPLITUDE_BEFORE,
    ERROR,
    FAILED,
    LANES,
    PARAMETERS,
    PEAK,
    STAGES,
    START,
    START_BEFORE,
    TIME,
    TROUGH,
    WORST,
)
from .memory import MASS, N_NUMBERS
from .pointers import Floats, address, shifted
from .switches import plain

_NEAR = 7e-5  # a cycle this close to its level is carried there between the levels ...
_CAREFULLY_NEAR = 1e-6  # ... and this close, between the last two at its level
_STRAGGLERS = LANES // 16  # for so few lanes the others do not run another cycle
_MOST_CYCLES = 8
_NODES_BETWEEN = 6
_SHARE = 0.2  # the error of a cycle is at most this share of the sum of the steps' estimates, mostly a hundredth of it
_TERMS, _MOST_LOST = 14, 0.45  # of the logarithm in the damping: good to 1e-11 up to a decrement of 1.9
_LARGEST_DAMPING = 0.1  # errors of a radius go into the damping as they are, into the frequency relative to it


@plain
def _correct(level: float, w: Floats) -> None:
    """Move the starting peaks by a secant, the first time in proportion."""
    for i in range(LANES):
        start, amplitude = w[START + i], w[AMPLITUDE + i]
        by, gained = start - w[START_BEFORE + i], amplitude - w[AMPLITUDE_BEFORE + i]
        slope = amplitude / start
        if w[START_BEFORE + i] > 0.0 and abs(by) > 1e-9 * start and by * gained > 0.0:
            slope = gained / by
        to = min(max(start + (level - amplitude) / slope, 0.5 * start), 2.0 * start)
        w[START_BEFORE + i] = start
        w[AMPLITUDE_BEFORE + i] = amplitude
        w[START + i] = to if w[FAILED + i] == 0.0 else level


@plain
def _stragglers(level: float, near: float, w: Floats) -> int:
    """Return how many lanes are farther from the level than that."""
    count = 0
    for i in range(LANES):
        if w[FAILED + i] == 0.0 and abs(w[AMPLITUDE + i] - level) > near * level:
            count += 1
    return count


@plain
def _note(level: float, row: Floats, w: Floats) -> None:
    """Write the cycle of each lane into its rows, and its error beside those of the other levels.

    Logarithms are series, which work in all lanes at once; beyond their reach a lane has failed.
    """
    for i in range(LANES):
        p0, q, p1, amplitude = w[START + i], w[TROUGH + i], w[PEAK + i], w[AMPLITUDE + i]
        lost = (p0 - p1) / (4.0 * amplitude)
        square = lost * lost
        series = 0.0
        for k in range(_TERMS):
            series = series * square + 1.0 / (2 * (_TERMS - k) - 1)
        damping = 4.0 * lost * series
        if not abs(lost) < _MOST_LOST:
            w[FAILED + i] = 1.0
        off = amplitude / level - 1.0
        row[DISTANCE * LANES + i] = off * (1.0 - off * (0.5 - off * (1.0 / 3.0 - off * (0.25 - 0.2 * off))))
        row[VALUES * LANES + i] = 1.0 / w[TIME + i]
        row[(VALUES + 1) * LANES + i] = damping
        row[(VALUES + 2) * LANES + i] = 0.5 * (0.5 * (p0 + p1) + q) / amplitude
        row[RATIO * LANES + i] = p0 / amplitude
        size = min(max(abs(damping), LEAST_DAMPING), _LARGEST_DAMPING)
        w[WORST + i] = max(w[WORST + i], w[ERROR + i] / size)


@plain
def _predict(levels: FloatArray, k: int, cycles: Floats, before: Floats, w: Floats) -> None:
    """Extrapolate where the cycle of level ``k`` starts from the cycles of up to four levels above (Newton's form)."""
    size = N_ROWS * LANES
    level = levels[k]
    known = levels.size - 1 - k
    one = shifted(cycles, (k + 1) * size)
    two = shifted(cycles, (k + 2) * size) if known > 1 else shifted(before, (k + 1) * size)
    three = shifted(cycles, (k + 3) * size) if known > 2 else two
    four = shifted(cycles, (k + 4) * size) if known > 3 else three
    t1 = math.log(levels[k + 1] / level)
    t2 = math.log(levels[k + 2] / level) if known > 1 else t1
    t3 = math.log(levels[k + 3] / level) if known > 2 else 0.0
    t4 = math.log(levels[k + 4] / level) if known > 3 else 0.0
    for i in range(LANES):
        a1, a2, a3, a4 = t1 + one[i], t2 + two[i], t3 + three[i], t4 + four[i]
        y1, y2, y3 = one[RATIO * LANES + i], two[RATIO * LANES + i], three[RATIO * LANES + i]
        rise = (y2 - y1) / (a2 - a1) if abs(a2 - a1) > 1e-6 else 0.0
        ratio = y1 - a1 * rise
        if known > 2:
            further = (y3 - y2) / (a3 - a2)
            bend = (further - rise) / (a3 - a1)
            ratio += a1 * a2 * bend
            if known > 3:
                furthest = (four[RATIO * LANES + i] - y3) / (a4 - a3)
                beyond = (furthest - further) / (a4 - a2)
                ratio -= a1 * a2 * a3 * (beyond - bend) / (a4 - a1)
        start = min(max(ratio, 0.5), 4.0)
        w[START + i] = level * (start if w[FAILED + i] == 0.0 else 1.0)
        w[START_BEFORE + i] = 0.0


@plain
def _run_levels(block: Block, levels: FloatArray, carefully: bool, cycles: Floats, before: Floats) -> None:
    """Run cycles at all levels from the highest down: the last one of each level, and the one before it."""
    size = N_ROWS * LANES
    few = 0 if carefully else _STRAGGLERS
    top = levels.size - 1
    begin(block, levels[top])
    for k in range(top, -1, -1):
        if k < top:
            _predict(levels, k, cycles, before, block.w)
        # The top has levels on one side only, and beyond it lies what bends the curve most.
        near = _CAREFULLY_NEAR if carefully or k == top else _NEAR
        here, earlier = shifted(cycles, k * size), shifted(before, k * size)
        for attempt in range(_MOST_CYCLES):
            if attempt > 0:
                for i in range(size):
                    earlier[i] = here[i]
                _correct(levels[k], block.w)
            run_cycle(block)
            _note(levels[k], here, block.w)
            take_angle(block)
            if (attempt > 0 or not carefully) and _stragglers(levels[k], near, block.w) <= few:
                break
        if attempt == 0:
            for i in range(size):
                earlier[i] = here[i]


@cached
def lane_errors(
    integers: IntArray, numbers: FloatArray, parameters: FloatArray, order: IntArray, steps: int, errors: FloatArray
) -> None:
    """Write the error of cycles released at the highest and the lowest level, with so many steps a half cycle."""
    levels = numbers[N_NUMBERS:]
    angles = np.empty(2 * STAGES * steps)
    turn(angles, steps)
    w = np.zeros(PARAMETERS + parameters.shape[1] * LANES)
    room = np.zeros(N_ROWS * LANES)
    block = describe_block(integers, numbers[MASS], steps, angles, w)
    for first in range(0, order.size, LANES):
        load(block, parameters, order, first)
        for k in range(0, levels.size, max(1, levels.size - 1)):
            begin(block, levels[k])
            run_cycle(block)
            _note(levels[k], address(room), block.w)
            for i in range(min(LANES, order.size - first)):
                error = _SHARE * w[WORST + i] if w[FAILED + i] == 0.0 else np.inf
                errors[order[first + i]] = max(error, errors[order[first + i]])


@cached
def lane_backbones(
    integers: IntArray, numbers: FloatArray, parameters: FloatArray, order: IntArray, steps: IntArray,
    carefully: bool, values: FloatArray, errors: FloatArray,
) -> None:  # fmt: skip
    """Write backbones at the levels that are described, and estimates of their errors.

    Parameters
    ----------
    integers, numbers
        The description of a simulation.
    parameters : (n, p)
    order : (m,)
        Rows of the parameters, those next to each other in one block.
    steps : (m / `LANES`, rounded up)
        Steps of a half cycle, for each block.
    carefully : bool
        Whether each level takes cycles of its own until it is met, or one cycle that is corrected between the levels.
    values : (n, 3, l)
        Rows that are not in ``order`` are left alone.
    errors : (n,)
        Relative; of the damping at least relative to `LEAST_DAMPING`. Infinite where a lane failed.
    """
    levels = numbers[N_NUMBERS:]
    most = 0
    for count in steps:
        most = max(most, count)
    angles = np.empty(2 * STAGES * most)
    w = np.zeros(PARAMETERS + parameters.shape[1] * LANES)
    cycles = np.zeros((levels.size, N_ROWS, LANES))
    before = np.zeros((levels.size, N_ROWS, LANES))
    between = min(_NODES_BETWEEN, levels.size)
    chosen = np.empty(between, dtype=np.int64)
    at, y = np.empty((between, LANES)), np.empty((between, LANES))
    inverse = np.empty((between * between, LANES))
    curves = np.empty((3, levels.size, LANES))
    worst = np.empty(LANES)
    for b in range(steps.size):
        first = b * LANES
        turn(angles, steps[b])
        block = describe_block(integers, numbers[MASS], steps[b], angles, w)
        load(block, parameters, order, first)
        _run_levels(block, levels, carefully, address(cycles), address(before))
        for i in range(LANES):
            worst[i] = _SHARE * w[WORST + i] if w[FAILED + i] == 0.0 else np.inf
        if carefully:
            read_off_carefully(levels, cycles, before, curves, worst)
        else:
            read_off_between(levels, cycles, chosen, at, inverse, y, curves, worst)
        for i in range(min(LANES, order.size - first)):
            row = order[first + i]
            errors[row] = worst[i]
            for o in range(3):
                for k in range(levels.size):
                    values[row, o, k] = curves[o, k, i]
