"""Compiled free decays: one cycle per level, the whole decay, the displacement at given instants.

Column 0 of a derivative is the one with respect to the release amplitude, the parameters follow.
"""

from __future__ import annotations

import math
from collections import namedtuple

import numpy as np

from .._common.compiled import cached
from .curves import carry_jacobian, compiled, curve_at, cycle_quantities, cycle_slope, cycles_of_decay, hermite
from .forces import KIND, OWN_EQUATION
from .halfcycle import (
    COMPLETED,
    HALF_CYCLE,
    LOAD_STATES,
    NO_RETURN,
    OUT_OF_REACH,
    RUNAWAY,
    STUCK,
    half_cycle,
    load_states,
)
from .memory import (
    AMPLITUDE,
    COLUMNS,
    CURSOR,
    DAMPING,
    HAS_REGIME,
    LARGEST_STEP,
    MASS,
    MODE,
    N_EFFECTS,
    N_PARAMETERS,
    N_SAMPLES,
    N_STATES,
    OWN_STATES,
    SAMPLE_SLOPES,
    SENSITIVITY,
    STEP,
    STIFFNESS,
    TABLE,
    TIME,
    TOLERANCE,
    USER,
    VALUE,
    memory_of,
)
from .pointers import address

_ON_LEVEL = 3e-5  # a cycle this close to its level is carried there along its slope (error: its square)
_DERIVATIVES = 2e-6  # the same for derivatives, times the square of the spacing of the levels (in the logarithm)
_ALONE = 3e-7  # the same for derivatives where they are not carried at all: few levels, or kinks
_NEAR_LEVEL = 1e-3  # one this close by the cubic through it and the cycle before it, slopes included
_CYCLES_PER_LEVEL = 14
_LARGEST_STEP = 1.5  # radians; between larger steps the error estimate is not to be trusted ...
_LARGEST_SAMPLED_STEP = 0.5  # ... and here the septic between steps is good to 4e-10 of the amplitude
_COARSE, _LARGEST_COARSE_STEP = 1e-8, 1.0  # where less is asked for, it is good to 1e-7
_RELEASE_GROWTH = 1.25
_CHECK_PROGRESS = 400  # after so many turning points, and then each time so many

Run = namedtuple("Run", ["numbers", "memory", "p", "y", "slopes", "dt", "columns", "n_states"])
Run.__doc__ = "A simulation: its description, its memory, and views of what lies in that memory."


def define() -> None:
    """Make the integrator known in this process; needed before any function of this module is called."""
    HALF_CYCLE.define()
    LOAD_STATES.define()


@compiled
def prepare(user, table, stiffness, damping, n_states, mass, has_regime, p, sensitivities, tolerance, largest_step):
    """Return a run with room for all that it needs."""
    mode = SENSITIVITY if sensitivities else VALUE
    for i in range(table.shape[0]):
        if table[i, KIND] == OWN_EQUATION:
            mode = OWN_STATES
    columns = p.size + 1 if sensitivities else (0 if mode == OWN_STATES else 1)
    numbers = np.zeros(TABLE + table.size, np.int64)
    numbers[USER] = user
    numbers[N_EFFECTS] = table.shape[0]
    numbers[STIFFNESS] = stiffness
    numbers[DAMPING] = damping
    numbers[N_STATES] = n_states
    numbers[N_PARAMETERS] = p.size
    numbers[HAS_REGIME] = 1 if has_regime else 0
    numbers[MODE] = mode
    numbers[COLUMNS] = columns
    for i in range(table.shape[0]):
        for j in range(table.shape[1]):
            numbers[TABLE + i * table.shape[1] + j] = table[i, j]
    place = memory_of(p.size, n_states, columns, mode)
    memory = np.zeros(place.size)
    memory[MASS] = mass
    memory[TOLERANCE] = tolerance
    memory[LARGEST_STEP] = largest_step
    y = memory[place.now : place.next]
    rows = 2 + n_states
    slopes = memory[place.now + rows : place.now + rows + columns]
    return Run(numbers, memory, p, y, slopes, memory[place.dt : place.dt + columns], columns, n_states)


@compiled
def _release(run, amplitude, virgin):
    """Put the oscillator at ``amplitude``, at rest, its states as loaded from rest (``virgin``) or relaxed."""
    for i in range(run.y.size):
        run.y[i] = 0.0
    for c in range(run.columns):
        run.dt[c] = 0.0
    run.y[0] = amplitude
    if run.columns > 0:
        run.slopes[0] = 1.0
    run.memory[TIME] = 0.0
    run.memory[AMPLITUDE] = abs(amplitude)
    if run.n_states > 0:
        load_states(address(run.numbers), address(run.memory), address(run.p), 1 if virgin else 0)


@compiled
def _swing(run, direction):
    """Run to the next turning point, without sampling."""
    memory = address(run.memory)
    return half_cycle(address(run.numbers), memory, address(run.p), direction, memory, memory, memory)


@compiled
def _all_finite(p):
    """Return whether all parameters are finite: a comparison with nan may take a force past it unnoticed."""
    for value in p:
        if not math.isfinite(value):
            return False
    return True


@compiled
def _derivatives_near(levels, k, has_regime):
    """Return how close to level ``k`` a cycle has to be for derivatives; their slopes come from the levels beside."""
    if has_regime or levels.size < 3:
        return _ALONE
    width = math.log(levels[k + 1] / levels[k]) if k + 1 < levels.size else math.log(levels[k] / levels[k - 1])
    return min(_ON_LEVEL, _DERIVATIVES / (width * width))


@compiled
def _no_answer(k, values, jacobian):
    """Mark level ``k`` as not answered; ``jacobian`` may be empty."""
    for i in range(3):
        values[i, k] = np.nan
    for i in range(jacobian.shape[0]):
        for j in range(jacobian.shape[2]):
            jacobian[i, k, j] = np.nan


@cached(nogil=True)
def backbone_by_cycles(
    user, table, stiffness, damping, n_states, mass, has_regime,
    p, levels, release, virgin, sensitivities, tolerance, maximum, values, jacobian, status,
):  # fmt: skip
    """Write the backbone at ``levels`` from one cycle each; for oscillators without internal states.

    The starting peak of a cycle is found by Newton's method on its amplitude. The derivative along the starting
    amplitude, which the integrator carries anyway, predicts the next start and takes a cycle onto its level.
    """
    run = prepare(
        user, table, stiffness, damping, n_states, mass, has_regime, p, sensitivities, tolerance, _LARGEST_STEP
    )
    memory = run.memory
    trough = np.zeros(run.columns)
    quantity = (0.0, 0.0, 0.0, 0.0)
    along = quantity
    nodes = np.zeros(levels.size)
    # Rows: log amplitude; then value and slope, along log amplitude, of log starting peak and of each observable.
    node = np.zeros((2, 9))
    last, previous, known = 0, 1, 0
    usable = _all_finite(p)
    for k in range(levels.size - 1, -1, -1):
        level = levels[k]
        at = math.log(level)
        start = level
        if known == 1:
            start = math.exp(node[last, 1] + node[last, 2] * (at - node[last, 0]))
        elif known > 1:
            start = math.exp(hermite(node, previous, last, 1, at))
        start = min(max(start, 0.3 * level), 30.0 * level)
        near = _ON_LEVEL
        if sensitivities:
            near = _derivatives_near(levels, k, has_regime)
        elif known > 0 and not has_regime:
            near = _NEAR_LEVEL
        good = 0.0
        code = OUT_OF_REACH
        error = np.inf
        q, p1 = 0.0, 0.0
        for attempt in range(_CYCLES_PER_LEVEL):
            if not usable:
                code = RUNAWAY
                break
            _release(run, start, True)
            code = _swing(run, -1.0)
            if code == COMPLETED:
                q = run.y[0]
                for c in range(run.columns):
                    trough[c] = run.slopes[c]
                code = _swing(run, 1.0)
            if code == COMPLETED:
                p1 = run.y[0]
                if not (p1 > q and start > q):
                    code = NO_RETURN
            if code != COMPLETED:
                # Too far a Newton step, or a prediction beyond what swings: back to where a cycle was completed.
                memory[STEP] = 0.0
                if good > 0.0:
                    start = 0.5 * (start + good)
                elif attempt == 0 and known > 0 and abs(start - level) > 1e-6 * level:
                    start = level
                else:
                    break
                continue
            quantity = cycle_quantities(start, q, p1, memory[TIME])
            along = cycle_slope(start, q, p1, memory[TIME], 1.0, trough[0], run.slopes[0], run.dt[0], quantity[3])
            error = level - quantity[0]
            if not (along[0] > 0.0 and np.isfinite(error)):
                code = OUT_OF_REACH
                break
            if abs(error) <= near * level:
                break
            code = OUT_OF_REACH
            good = start
            start += min(max(error / along[0], -0.5 * start), start)
        status[k] = code
        if code != COMPLETED:
            _no_answer(k, values, jacobian)
            continue
        if known > 0:
            last, previous = previous, last
        known += 1
        node[last, 0] = math.log(quantity[0])
        node[last, 1] = math.log(start)
        node[last, 2] = quantity[0] / (along[0] * start)
        nodes[k] = node[last, 0]
        for i in range(3):
            node[last, 3 + 2 * i] = quantity[1 + i]
            node[last, 4 + 2 * i] = along[1 + i] / along[0] * quantity[0]
            if known > 1 and not has_regime:
                values[i, k] = hermite(node, previous, last, 3 + 2 * i, at)
            else:
                values[i, k] = quantity[1 + i] + along[1 + i] / along[0] * error
        if sensitivities:
            for j in range(p.size):
                d1, dq = run.slopes[j + 1], trough[j + 1]
                slope = cycle_slope(start, q, p1, memory[TIME], 0.0, dq, d1, run.dt[j + 1], quantity[3])
                for i in range(3):
                    jacobian[i, k, j] = slope[1 + i] - along[1 + i] / along[0] * slope[0]
    if sensitivities and levels.size > 1:
        carry_jacobian(levels, nodes, status, jacobian)


@compiled
def _whole_decay(
    run, release, virgin, stop, more, maximum, turns, slopes, times, time_slopes, sample_times, displacement,
    sample_slopes,
):  # fmt: skip
    """Run a decay turning point by turning point until a cycle is smaller than ``stop``, then ``more`` of them.

    Writes displacement and time of each turning point (the release first) into ``turns``, ``times`` and their
    derivatives into ``slopes``, ``time_slopes``. Returns how many there are and the status that ended the decay.
    """
    _release(run, release, virgin)
    run.numbers[N_SAMPLES] = sample_times.size
    run.numbers[SAMPLE_SLOPES] = 1 if sample_slopes.shape[1] > 0 else 0
    run.numbers[CURSOR] = 0
    memory = run.memory
    memory[STEP] = 0.0
    direction = -1.0 if release > 0.0 else 1.0
    turns[0] = release
    times[0] = 0.0
    for c in range(run.columns):
        slopes[0, c] = run.slopes[c]
        time_slopes[0, c] = 0.0
    count = 1
    code = COMPLETED if _all_finite(run.p) else RUNAWAY
    while count < maximum and code == COMPLETED:
        code = half_cycle(
            address(run.numbers), address(memory), address(run.p), direction,
            address(sample_times), address(displacement), address(sample_slopes),
        )  # fmt: skip
        if code != COMPLETED:
            break
        turns[count] = run.y[0]
        times[count] = memory[TIME]
        for c in range(run.columns):
            slopes[count, c] = run.slopes[c]
            time_slopes[count, c] = run.dt[c]
        count += 1
        direction = -direction
        if sample_times.size > 0 and run.numbers[CURSOR] >= sample_times.size:
            break
        if count > 2 and 0.25 * abs(turns[count - 3] + turns[count - 1] - 2.0 * turns[count - 2]) < stop:
            maximum = min(maximum, count + more)
            stop = 0.0
        if stop > 0.0 and count % _CHECK_PROGRESS == 1:
            before = abs(turns[count - _CHECK_PROGRESS] - turns[count - _CHECK_PROGRESS + 1]) * 0.5
            # At ten times this pace of decay it would still take more turning points than there may be.
            pace = math.log(before / memory[AMPLITUDE]) / _CHECK_PROGRESS
            if not 10.0 * pace * (maximum - count) > math.log(memory[AMPLITUDE] / stop):
                break
    # What sticks stays where it is; after any other end there is no answer.
    held = code == STUCK
    for i in range(run.numbers[CURSOR], sample_times.size):
        displacement[i] = run.y[0] if held else np.nan
        for c in range(sample_slopes.shape[1]):
            sample_slopes[i, c] = run.slopes[c] if held else np.nan
    return count, code


@cached(nogil=True)
def backbone_by_decay(
    user, table, stiffness, damping, n_states, mass, has_regime,
    p, levels, release, virgin, sensitivities, tolerance, maximum, values, jacobian, status,
):  # fmt: skip
    """Write the backbone at ``levels`` from the whole decay, by local cubics in log amplitude between its cycles.

    Without a release (0) it is raised in fixed steps, so that it does not slide with the parameters, until the first
    cycle reaches the highest level.
    """
    run = prepare(
        user, table, stiffness, damping, n_states, mass, has_regime, p, sensitivities, tolerance, _LARGEST_STEP
    )
    none = np.empty(0)
    carried = run.columns if sensitivities else 0
    cycles = np.empty((maximum // 2 + 1, 4))
    cycle_slopes = np.empty((maximum // 2 + 1, 4, carried))
    turns = np.empty(maximum)
    times = np.empty(maximum)
    slopes = np.empty((maximum, run.columns))
    time_slopes = np.empty((maximum, run.columns))
    count, found, code = 0, 0, COMPLETED
    given = release > 0.0
    if not given:
        release = _RELEASE_GROWTH * levels[-1]
    stop = 0.8 * levels[0]  # and one cycle more: the local cubic wants two below the lowest level
    for _ in range(1 if given else 12):
        count, code = _whole_decay(
            run, release, virgin, stop, 0, 3, turns, slopes, times, time_slopes, none, none, np.empty((0, 0))
        )
        if given or code != COMPLETED or 0.25 * (turns[0] + turns[2] - 2.0 * turns[1]) >= levels[-1]:
            break
        release *= _RELEASE_GROWTH
    if code == COMPLETED:
        count, code = _whole_decay(
            run, release, virgin, stop, 2, maximum, turns, slopes, times, time_slopes, none, none, np.empty((0, 0))
        )
    if count > 2:
        found = cycles_of_decay(turns, times, slopes, time_slopes, count, carried, cycles, cycle_slopes)
    weights = np.empty(4)
    tilts = np.empty(4)
    for k in range(levels.size):
        enclosed = curve_at(cycles, cycle_slopes, found, levels[k], k, carried, values, jacobian, weights, tilts)
        status[k] = COMPLETED
        if not enclosed:
            below = found == 0 or levels[k] < cycles[found - 1, 0]
            status[k] = code if below and code != COMPLETED else OUT_OF_REACH
            _no_answer(k, values, jacobian)


@cached(nogil=True)
def decay(
    user, table, stiffness, damping, n_states, mass, has_regime,
    p, release, virgin, stop, sensitivities, tolerance, maximum, turns, slopes, time_slopes, times,
    sample_times, displacement, sample_slopes,
):  # fmt: skip
    """Run a whole decay, writing displacement and sensitivities at the sample times on the way."""
    largest = _LARGEST_STEP
    if sample_times.size > 0:
        largest = _LARGEST_SAMPLED_STEP if tolerance < _COARSE else _LARGEST_COARSE_STEP
    run = prepare(user, table, stiffness, damping, n_states, mass, has_regime, p, sensitivities, tolerance, largest)
    return _whole_decay(
        run, release, virgin, stop, 0, maximum, turns, slopes, times, time_slopes, sample_times, displacement,
        sample_slopes,
    )  # fmt: skip
