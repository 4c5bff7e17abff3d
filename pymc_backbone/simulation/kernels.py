"""Compiled free decays: one cycle per level, the whole decay, what is measured at given instants.

Column 0 of a derivative is the one with respect to the release amplitude, the parameters follow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numba import types

from .._common.checks import FloatArray, IntArray
from .._common.compiled import NativeFunction, cached
from .by_decay import backbone_by_decay
from .counts import HALF_CYCLES
from .counts import count as note
from .curves import carry_jacobian, compiled, cycle_quantities, cycle_slope, hermite
from .forces import ROOM, ROW
from .halfcycle import COMPLETED, NO_RETURN, OUT_OF_REACH, RUNAWAY
from .instants import ACCELERATION
from .memory import (
    BY_CYCLES,
    BY_DECAY,
    HAS_REGIME,
    LARGEST_STEP,
    MODE,
    N_EFFECTS,
    N_LEVELS,
    N_NUMBERS,
    N_PARAMETERS,
    OWN_STATES,
    RELEASE,
    STEP,
    STOP,
    TABLE,
    TIME,
    TOLERANCE,
    Turns,
    Waveform,
)
from .pointers import FLOATS, INTEGERS, Floats, Integers, address
from .run import Run, prepare, release_from, swing
from .whole import LARGEST_STEP_OF_DECAY, all_finite, no_answer, run_decay

_ON_LEVEL = 3e-5  # a cycle this close to its level is carried there along its slope (error: its square)
_DERIVATIVES = 2e-6  # the same for derivatives, times the square of the spacing of the levels (in the logarithm)
_ALONE = 3e-7  # the same for derivatives where they are not carried at all: few levels, or kinks
_NEAR_LEVEL = 1e-3  # one this close by the cubic through it and the cycle before it, slopes included
_CYCLES_PER_LEVEL = 14
_LARGEST_SAMPLED_STEP = 0.5  # radians; up to here the septic between steps is good to 4e-10 of the amplitude
_COARSE, _LARGEST_COARSE_STEP = 1e-8, 1.0  # where less is asked for, it is good to 1e-7


class Cycle(NamedTuple):
    """One cycle: its starting peak, trough and peak, its quantities, and their derivatives along the starting peak.

    Quantities are amplitude, frequency, damping and offset. Derivatives along the parameters are left in the run and in
    the slopes of the trough.
    """

    start: float
    trough: float
    peak: float
    quantities: tuple[float, float, float, float]
    along: tuple[float, float, float, float]


@compiled
def _derivatives_near(levels: FloatArray, k: int, has_regime: bool) -> float:
    """Return how close to level ``k`` a cycle has to be for derivatives; their slopes come from the levels beside."""
    if has_regime or levels.size < 3:
        return _ALONE
    width = math.log(levels[k + 1] / levels[k]) if k + 1 < levels.size else math.log(levels[k] / levels[k - 1])
    return min(_ON_LEVEL, _DERIVATIVES / (width * width))


@compiled
def _run_cycle(run: Run, start: float, trough: FloatArray) -> tuple[Cycle, int]:
    """Run one cycle from a peak at ``start`` and leave its slopes there in ``trough``; return it and the status."""
    none = (0.0, 0.0, 0.0, 0.0)
    note(HALF_CYCLES, 2)
    release_from(run, start)
    code = swing(run, -1.0)
    if code != COMPLETED:
        return Cycle(start, 0.0, 0.0, none, none), code
    q = run.y[0]
    for c in range(run.columns):
        trough[c] = run.slopes[c]
    code = swing(run, 1.0)
    p1 = run.y[0]
    if code == COMPLETED and not (p1 > q and start > q):
        code = NO_RETURN
    if code != COMPLETED:
        return Cycle(start, q, p1, none, none), code
    time = run.memory[TIME]
    quantities = cycle_quantities(start, q, p1, time)
    along = cycle_slope(start, q, p1, time, 1.0, trough[0], run.slopes[0], run.dt[0], quantities[3])
    return Cycle(start, q, p1, quantities, along), code


@compiled
def _find_cycle(
    run: Run, level: float, start: float, near: float, is_predicted: bool, trough: FloatArray
) -> tuple[Cycle, int]:
    """Return a cycle within ``near`` of ``level``, by Newton's method on its starting peak, and the status.

    The derivative along the starting peak, which the integrator carries anyway, gives the next one.
    """
    good = 0.0
    cycle, code = _run_cycle(run, start, trough)
    for attempt in range(1, _CYCLES_PER_LEVEL + 1):
        if code != COMPLETED:
            # Too far a Newton step, or a prediction beyond what swings: back to where a cycle was completed.
            run.memory[STEP] = 0.0
            if good > 0.0:
                start = 0.5 * (start + good)
            elif attempt == 1 and is_predicted and abs(start - level) > 1e-6 * level:
                start = level
            else:
                return cycle, code
        else:
            error = level - cycle.quantities[0]
            if not (cycle.along[0] > 0.0 and np.isfinite(error)):
                return cycle, OUT_OF_REACH
            if abs(error) <= near * level:
                return cycle, COMPLETED
            code = OUT_OF_REACH
            good = start
            start += min(max(error / cycle.along[0], -0.5 * start), start)
        if attempt < _CYCLES_PER_LEVEL:
            cycle, code = _run_cycle(run, start, trough)
    return cycle, code


@compiled
def _predict_start(level: float, node: FloatArray, last: int, previous: int, known: int) -> float:
    """Return where a cycle of this level may start: along the curve through those found last."""
    at = math.log(level)
    start = level
    if known == 1:
        start = math.exp(node[last, 1] + node[last, 2] * (at - node[last, 0]))
    elif known > 1:
        start = math.exp(hermite(node, previous, last, 1, at))
    return min(max(start, 0.3 * level), 30.0 * level)


@compiled
def _note_cycle(cycle: Cycle, node: FloatArray, last: int) -> None:
    """Write a cycle into row ``last`` of ``node``: log amplitude; log starting peak and observables with slopes."""
    node[last, 0] = math.log(cycle.quantities[0])
    node[last, 1] = math.log(cycle.start)
    node[last, 2] = cycle.quantities[0] / (cycle.along[0] * cycle.start)
    for i in range(3):
        node[last, 3 + 2 * i] = cycle.quantities[1 + i]
        node[last, 4 + 2 * i] = cycle.along[1 + i] / cycle.along[0] * cycle.quantities[0]


@compiled
def _backbone_by_cycles(
    integers: IntArray, numbers: FloatArray, p: FloatArray, values: FloatArray, jacobian: FloatArray,
    status: IntArray,
) -> None:  # fmt: skip
    """Write the backbone at the levels from one cycle each; for oscillators without internal states.

    A cycle is sought for each level, from the highest down, and taken onto it along the curve, whose slope the
    integrator carries anyway.
    """
    levels = numbers[N_NUMBERS:]
    has_regime = integers[HAS_REGIME] != 0
    sensitivities = jacobian.size > 0
    run = prepare(integers, numbers, p, sensitivities, LARGEST_STEP_OF_DECAY)
    trough = np.zeros(run.columns)
    nodes = np.zeros(levels.size)
    # Rows: log amplitude; then value and slope, along log amplitude, of log starting peak and of each observable.
    node = np.zeros((2, 9))
    last, previous, known = 0, 1, 0
    usable = all_finite(p)
    for k in range(levels.size - 1, -1, -1):
        level = levels[k]
        near = _ON_LEVEL
        if sensitivities:
            near = _derivatives_near(levels, k, has_regime)
        elif known > 0 and not has_regime:
            near = _NEAR_LEVEL
        status[k] = RUNAWAY
        if usable:
            start = _predict_start(level, node, last, previous, known)
            cycle, status[k] = _find_cycle(run, level, start, near, known > 0, trough)
        if status[k] != COMPLETED:
            no_answer(k, values, jacobian)
            continue
        if known > 0:
            last, previous = previous, last
        known += 1
        _note_cycle(cycle, node, last)
        nodes[k] = node[last, 0]
        along = cycle.along
        for i in range(3):
            if known > 1 and not has_regime:
                values[i, k] = hermite(node, previous, last, 3 + 2 * i, math.log(level))
            else:
                values[i, k] = cycle.quantities[1 + i] + along[1 + i] / along[0] * (level - cycle.quantities[0])
        if sensitivities:
            for j in range(p.size):
                slope = cycle_slope(
                    cycle.start, cycle.trough, cycle.peak, run.memory[TIME], 0.0, trough[j + 1], run.slopes[j + 1],
                    run.dt[j + 1], cycle.quantities[3],
                )  # fmt: skip
                for i in range(3):
                    jacobian[i, k, j] = slope[1 + i] - along[1 + i] / along[0] * slope[0]
    if sensitivities and levels.size > 1:
        carry_jacobian(levels, nodes, status, jacobian)


def _backbone(
    to_integers: Integers, to_numbers: Floats, to_p: Floats, to_values: Floats, to_jacobian: Floats,
    to_status: Integers, wanted: int,
) -> None:  # fmt: skip
    head = numba.carray(to_integers, TABLE)
    n, n_levels = head[N_PARAMETERS], head[N_LEVELS]
    integers = numba.carray(to_integers, TABLE + (ROW + ROOM) * head[N_EFFECTS])
    numbers = numba.carray(to_numbers, N_NUMBERS + n_levels)
    p = numba.carray(to_p, n)
    values = numba.carray(to_values, (3, n_levels))
    jacobian = numba.carray(to_jacobian, (3 * wanted, n_levels * wanted, n * wanted))
    status = numba.carray(to_status, n_levels)
    if integers[BY_DECAY] != BY_CYCLES:
        backbone_by_decay(integers, numbers, p, values, jacobian, status)
    else:
        _backbone_by_cycles(integers, numbers, p, values, jacobian, status)


BACKBONE = NativeFunction(
    "uncounted_backbone",
    types.void(INTEGERS, FLOATS, FLOATS, FLOATS, FLOATS, INTEGERS, types.int64),
    _backbone,
    is_beside=True,
)
call_backbone = BACKBONE.call
"""``backbone(integers, numbers, p, values, jacobian, status, wanted)``: simulate, with derivatives if ``wanted``."""


@cached
def backbone(
    integers: IntArray, numbers: FloatArray, p: FloatArray, values: FloatArray, jacobian: FloatArray,
    status: IntArray,
) -> None:  # fmt: skip
    """Write the backbone that is described into ``values`` (3, l), ``jacobian`` (3, l, p or all 0), ``status`` (l,)."""
    call_backbone(
        address(integers), address(numbers), address(p), address(values), address(jacobian), address(status),
        1 if jacobian.size > 0 else 0,
    )  # fmt: skip


@cached
def decay(integers: IntArray, numbers: FloatArray, p: FloatArray, turns: Turns, waveform: Waveform) -> tuple[int, int]:
    """Run the whole decay that is described, up to as many turning points as there is room for.

    Derivatives are carried with respect to the parameters where ``turns`` has columns for them. Returns the number of
    turning points and the status.
    """
    largest = LARGEST_STEP_OF_DECAY
    if waveform.times.size > 0:
        largest = _LARGEST_SAMPLED_STEP if numbers[TOLERANCE] < _COARSE else _LARGEST_COARSE_STEP
    run = prepare(integers, numbers, p, turns.slopes.shape[1] > 1, largest)
    if waveform.quantity == ACCELERATION and run.integers[MODE] == OWN_STATES:
        run.memory[LARGEST_STEP] *= 0.5  # there the acceleration is a derivative of what lies between the steps
    release_from(run, numbers[RELEASE])
    return run_decay(run, numbers[STOP], 0, turns.values.size, turns, waveform)
