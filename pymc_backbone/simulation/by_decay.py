"""The backbone of what remembers: from the decay, all of it or a few cycles at each level."""

from __future__ import annotations

import math

import numpy as np

from .._common.checks import FloatArray, IntArray
from .curves import compiled, curve_at, cycles_of_decay
from .halfcycle import COMPLETED, OUT_OF_REACH
from .instants import DISPLACEMENT
from .jumps import jump_down, walk_to
from .memory import BY_DECAY, BY_WHOLE_DECAY, MAXIMUM, N_NUMBERS, RELEASE, VIRGIN, Turns, Waveform
from .pointers import address
from .run import Run, prepare, release_from
from .symmetry import is_symmetric
from .whole import LARGEST_STEP_OF_DECAY, no_answer, run_decay

_RELEASE_GROWTH = 1.25
_LIGHT = 0.05  # decrement of the first cycle up to which jumps are tried
_CYCLES_PER_LEVEL = 8.0  # below so many on average the whole decay is as fast


@compiled
def _go_to_highest(run: Run, levels: FloatArray, release: float, turns: Turns, sensitivities: bool) -> bool:
    """Run the decay to a peak little above the highest level if it is worth it to jump from there; return whether.

    ``turns`` holds the first cycle.
    """
    first = turns.values
    decrement = 2.0 * math.log((first[0] - first[1]) / (first[2] - first[1]))
    if not 0.0 < decrement < _LIGHT or levels.size < 2:
        return False
    if not math.log(levels[-1] / levels[0]) > _CYCLES_PER_LEVEL * levels.size * decrement:
        return False
    slopes = 1 if sensitivities else 0
    if not is_symmetric(address(run.integers), address(run.memory), address(run.p), release, slopes):
        return False
    release_from(run, release)
    return walk_to(run, levels[-1], decrement, turns)


@compiled
def backbone_by_decay(
    integers: IntArray, numbers: FloatArray, p: FloatArray, values: FloatArray, jacobian: FloatArray,
    status: IntArray,
) -> None:  # fmt: skip
    """Write the backbone at the levels from the decay, by local cubics in log amplitude between its cycles.

    Where that is many cycles, those between the levels are jumped over, and what is left is run as a whole.

    Without a release (0), or where the whole decay is not asked for and the release is too low, it is raised in fixed
    steps, so that it does not slide with the parameters, until the first cycle reaches the highest level.
    """
    levels = numbers[N_NUMBERS:]
    maximum = integers[MAXIMUM]
    release = numbers[RELEASE]
    sensitivities = jacobian.size > 0
    run = prepare(integers, numbers, p, sensitivities, LARGEST_STEP_OF_DECAY)
    carried = run.columns if sensitivities else 0
    cycles = np.empty((maximum // 2 + 1, 4))
    cycle_slopes = np.empty((maximum // 2 + 1, 4, carried))
    turns = Turns(
        np.empty(maximum), np.empty(maximum), np.empty((maximum, run.columns)), np.empty((maximum, run.columns))
    )
    none = Waveform(np.empty(0), np.empty(0), np.empty((0, 0)), DISPLACEMENT)
    count, found, code = 0, 0, COMPLETED
    is_whole = integers[BY_DECAY] == BY_WHOLE_DECAY
    if not release > 0.0:
        release = _RELEASE_GROWTH * levels[-1]
    stop = 0.8 * levels[0]  # and one cycle more: the local cubic wants two below the lowest level
    for _ in range(1 if is_whole else 12):
        release_from(run, release)
        count, code = run_decay(run, stop, 0, 3, turns, none)
        first = turns.values
        if is_whole or code != COMPLETED or 0.25 * (first[0] + first[2] - 2.0 * first[1]) >= levels[-1]:
            break
        release *= _RELEASE_GROWTH
    left = levels.size
    if (
        not is_whole
        and code == COMPLETED
        and integers[VIRGIN] != 0
        and _go_to_highest(run, levels, release, turns, sensitivities)
    ):
        left = jump_down(run, levels, values, jacobian, status, turns)
        if left == 0:
            return
    if code == COMPLETED:
        if left == levels.size:
            release_from(run, release)
        count, code = run_decay(run, stop, 2, maximum, turns, none)
    if count > 2:
        found = cycles_of_decay(
            turns.values, turns.times, turns.slopes, turns.time_slopes, count, carried, cycles, cycle_slopes
        )
    weights = np.empty(4)
    tilts = np.empty(4)
    for k in range(left):
        enclosed = curve_at(cycles, cycle_slopes, found, levels[k], k, carried, values, jacobian, weights, tilts)
        status[k] = COMPLETED
        if not enclosed:
            below = found == 0 or levels[k] < cycles[found - 1, 0]
            status[k] = code if below and code != COMPLETED else OUT_OF_REACH
            no_answer(k, values, jacobian)
