"""From one turning point to the next: the step that everything simulated is made of.

Inside a half cycle the sign of the velocity is a constant, so Coulomb friction and v|v| are smooth. The last
step is aimed at the turning point, and may overshoot it, because the frozen sign continues the force smoothly;
what then remains is closed by one implicit step. Where a force has kinks, a step is cut back until it ends where the
label of the smooth branch is about to change, and a hop takes it over: no step straddles a kink, which the state would
hardly notice but its derivatives would.

Compiled once as native functions with a name, which other compiled code calls without being compiled with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import float64, int64

from .._common.compiled import NativeFunction
from .closing import aim, close, remember, third_derivative, turning_time
from .forces import KIND, MEMORY, ROW, Z_FIRST, force_slopes, smooth_branch, state_rates, total_force
from .instants import Samples, write_samples
from .kinks import HOP, KINK_MARGIN, KINK_WINDOW, fraction_before_kink, hop_over, time_to_kink
from .memory import (
    AMPLITUDE,
    CURSOR,
    HAS_REGIME,
    LARGEST_STEP,
    MODE,
    N_SAMPLES,
    OWN_STATES,
    QUANTITY,
    SAMPLE_SLOPES,
    SENSITIVITY,
    STEP,
    STEP_BEHIND_KINK,
    TIME,
    TOLERANCE,
    VALUE,
    model_of,
    place_of,
)
from .pointers import FLOATS, INTEGERS, Floats, Integers, shifted
from .states import load_slowly
from .stepper import step_sensitivity, step_states, step_value
from .switches import plain

COMPLETED, STUCK, NO_RETURN, RUNAWAY, OUT_OF_REACH = range(5)
_MAXIMUM_STEPS = 400
_CLOSE = 0.02  # radians left to the turning point that the closing step may cover (error: their fifth power / 720)
_CLOSE_STATES = 2e-3  # the same with states that have their own equation (error: their cube / 12) ...
_CLOSE_STATE_SENSITIVITIES = 1e-6  # ... and where their sensitivities are carried (error: proportional)
_GONE = 1e-13  # of the amplitude: what is smaller and still creeps will not turn


@plain
def _growth(error: float) -> float:
    """Return by how much the next step may be longer: the eighth root of the error, from square roots for speed."""
    return min(6.0, 0.9 / math.sqrt(math.sqrt(math.sqrt(error)))) if error > 0.0 else 6.0


# One function on purpose: parts with names of their own cost 5 to 15 %, because compiled calls pass all they work with.
@plain
def _half_cycle(
    run: Integers, memory: Floats, p: Floats, direction: float, time: Floats, values: Floats, slopes: Floats
) -> int:
    place = place_of(run)
    model = model_of(run, memory, p, place)
    samples = Samples(time, values, slopes, run[SAMPLE_SLOPES] != 0, run[N_SAMPLES], run[QUANTITY])
    y = shifted(memory, place.now)
    y1 = shifted(memory, place.next)
    z = shifted(y, 2)
    z1 = shifted(y1, 2)
    dt = shifted(memory, place.dt)
    shift = shifted(memory, place.shift)
    K = shifted(memory, place.K)
    middle = shifted(memory, place.middle)
    room = shifted(memory, place.room)
    mode = run[MODE]
    moving = mode == OWN_STATES
    has_regime = run[HAS_REGIME] != 0
    columns = model.columns
    n = model.n_states
    rows = 2 + n
    # Where states stay as they are through a half cycle, so do their sensitivities.
    carried = rows if moving else 2
    mass = model.mass
    start = y[0]
    amplitude = memory[AMPLITUDE]
    tolerance = memory[TOLERANCE]
    force = total_force(model, start, 0.0, direction, z)
    a = -force / mass
    if not math.isfinite(a):
        return RUNAWAY
    if not a * direction > 0.0:
        backwards = total_force(model, start, 0.0, -direction, z) / mass * direction
        if backwards > 0.0:
            return RUNAWAY
        return STUCK if a * direction < 0.0 or backwards < 0.0 else NO_RETURN
    omega = math.sqrt(abs(a) / amplitude)
    model.scales[0] = amplitude
    model.scales[1] = amplitude * omega
    if moving:
        state_rates(model, start, amplitude * omega * direction, direction, z, model.fz)
        for j in range(n):
            model.scales[2 + j] = max(abs(z[j]), abs(model.fz[j]) / omega)
    for k in range(carried, rows):
        y1[k] = y[k]
        for c in range(columns):
            y1[rows + k * columns + c] = y[rows + k * columns + c]
    force, fx, fv = force_slopes(model, start, 0.0, direction, z)
    label = smooth_branch(model, start, 0.0, direction, z) if has_regime else 0
    radius = _CLOSE
    if moving:
        radius = _CLOSE_STATES if columns == 0 else _CLOSE_STATE_SENSITIVITIES
    h = memory[STEP] if memory[STEP] > 0.0 else 0.3 / omega
    limit = np.inf
    rejected, at_kink, hop, is_behind = False, False, False, False
    for _ in range(_MAXIMUM_STEPS):
        local = math.sqrt(fx / mass) if fx > 0.0 else 0.0
        h = min(h, memory[LARGEST_STEP] / max(local, omega if samples.size > 0 else 1e-3 * omega))
        scale = max(local, omega)
        step = min(aim(y[1], a, fx, mass, h, direction), limit)
        if hop:
            step = HOP / scale
            hop_over(model, y, y1, a, direction, step, moving, K, room)
            error = 0.0
        elif mode == VALUE:
            error = step_value(model, y, shifted(y, rows), a, fx, fv, direction, step, tolerance, y1, shifted(y1, rows))
        elif mode == SENSITIVITY:
            error = step_sensitivity(
                model, y, shifted(y, rows), a, fx, fv, direction, step, tolerance, y1, shifted(y1, rows),
                shifted(memory, place.quadrature),
            )  # fmt: skip
        else:
            error = step_states(model, y, direction, step, tolerance, y1, K)
        if not math.isfinite(error):
            error = np.inf
        new_label = label
        if has_regime and step > 0.0 and error < np.inf:
            new_label = smooth_branch(model, y1[0], y1[1], direction, z1)
            if new_label != label and not hop:
                a1 = -total_force(model, y1[0], y1[1], direction, z1) / mass
                precision = 0.1 * HOP / (scale * step)
                share = fraction_before_kink(
                    model, y, a, y1, a1, step, label, direction, precision, shifted(K, 2), moving, middle
                )
                left = share * step
                if left * scale > 2.0 * KINK_MARGIN:
                    limit = left - KINK_MARGIN / scale
                    at_kink = True
                    continue
                if step * scale > KINK_WINDOW:
                    jerk = third_derivative(model, y[0], y[1], a, fx, fv, direction, z, moving, middle)
                    left = time_to_kink(
                        model, y, y1, a, jerk, KINK_WINDOW / scale, label, direction, 0.1 * HOP / scale, middle,
                        moving, room,
                    )  # fmt: skip
                hop = left * scale < HOP
                limit = min(left - 0.5 * HOP / scale, 0.5 * step)
                at_kink = not hop
                continue
        if not error <= 1.0:
            h = abs(step) * (max(0.2, _growth(error)) if error < np.inf else 0.2)
            limit = h
            rejected, at_kink = True, False
            if not h * omega > 1e-9:
                return RUNAWAY
            continue
        force, fx1, fv1 = force_slopes(model, y1[0], y1[1], direction, z1)
        a1 = -force / mass
        if not (math.isfinite(a1) and abs(y1[0]) < 1e3 * (abs(start) + amplitude)):
            return RUNAWAY
        if samples.size > 0 and step > 0.0:
            jerk = third_derivative(model, y[0], y[1], a, fx, fv, direction, z, moving, middle)
            jerk1 = third_derivative(model, y1[0], y1[1], a1, fx1, fv1, direction, z1, moving, middle)
            until = memory[TIME] + step
            if y1[1] * direction < 0.0 and a1 * direction < 0.0:
                until += turning_time(y1[1], a1, jerk1)
            run[CURSOR] = write_samples(
                model, y, a, jerk, y1, a1, jerk1, memory[TIME], step, not hop, moving, run[CURSOR], until,
                direction, dt, room, samples,
            )  # fmt: skip
        memory[TIME] += step
        for k in range(carried):
            y[k] = y1[k]
        for k in range(rows, rows + carried * columns):
            y[k] = y1[k]
        for j in range(n if moving else 0):
            model.scales[2 + j] = max(model.scales[2 + j], abs(z[j]))
        # behind a kink what is smooth may begin with a root: the step that was right in the last half cycle is tried
        if hop:
            is_behind = True
            h = min(h, memory[STEP_BEHIND_KINK]) if memory[STEP_BEHIND_KINK] > 0.0 else h
        elif is_behind:
            is_behind = False
            memory[STEP_BEHIND_KINK] = step * _growth(error)
        if step >= 0.999 * h:
            growth = _growth(error)
            h = step * (min(growth, 1.0) if rejected else growth)
        a, fx, fv, limit, rejected = a1, fx1, fv1, np.inf, False
        hop = False
        if at_kink and new_label == label:
            jerk = third_derivative(model, y[0], y[1], a, fx, fv, direction, z, moving, middle)
            left = time_to_kink(
                model, y, y1, a, jerk, KINK_WINDOW / scale, label, direction, 0.1 * HOP / scale, middle, moving, room
            )
            hop = left * scale < HOP
            if not hop:
                limit = left - 0.5 * HOP / scale
                continue
        at_kink = False
        label = new_label
        if hop:
            continue
        if a * direction < 0.0:
            if abs(y[1]) * scale < radius * abs(a):
                jerk = third_derivative(model, y[0], y[1], a, fx, fv, direction, z, moving, middle)
                check = has_regime and radius > 1e-9
                tau = close(model, y, y1, a, jerk, label, check, moving, direction, shift, middle, room)
                if math.isfinite(tau):
                    if samples.size > 0 and tau > 0.0:
                        force, fx1, fv1 = force_slopes(model, y1[0], 0.0, direction, z1)
                        a1 = -force / mass
                        jerk1 = third_derivative(model, y1[0], 0.0, a1, fx1, fv1, direction, z1, moving, middle)
                        run[CURSOR] = write_samples(
                            model, y, a, jerk, y1, a1, jerk1, memory[TIME], tau, True, moving, run[CURSOR],
                            memory[TIME] + tau, direction, dt, room, samples,
                        )  # fmt: skip
                    for k in range(rows * (1 + columns)):
                        y[k] = y1[k]
                    if moving and columns > 0:
                        state_rates(model, y[0], 0.0, direction, z, middle)
                    for c in range(columns):
                        dt[c] += shift[c]
                        y[rows + columns + c] = 0.0
                        for j in range(n if moving else 0):
                            y[rows + (2 + j) * columns + c] += middle[j] * shift[c]
                    remember(model, y, direction)
                    memory[TIME] += tau
                    memory[STEP] = h
                    memory[AMPLITUDE] = max(0.5 * abs(y[0] - start), 1e-300)
                    return COMPLETED
                radius *= 0.1
            elif not abs(y[0]) + abs(y[1]) / omega > _GONE * amplitude:
                return NO_RETURN
    return NO_RETURN


@plain
def _load_states(run: Integers, memory: Floats, p: Floats, virgin: int) -> int:
    place = place_of(run)
    model = model_of(run, memory, p, place)
    y = shifted(memory, place.now)
    side = 1.0 if y[0] > 0.0 else -1.0
    for j in range(2 + model.n_states):
        model.scales[j] = abs(y[0])
    if virgin != 0:
        if run[MODE] == OWN_STATES:
            load_slowly(model, y, side, shifted(memory, place.K))
        remember(model, y, side)
        return 0
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[KIND] == MEMORY:
            y[2 + row[Z_FIRST]] = y[0]
            if model.columns > 0:
                y[2 + model.n_states + (2 + row[Z_FIRST]) * model.columns] = 1.0
    return 0


HALF_CYCLE = NativeFunction("half_cycle", int64(INTEGERS, FLOATS, FLOATS, float64, FLOATS, FLOATS, FLOATS), _half_cycle)
half_cycle: Callable[[Integers, Floats, Floats, float, Floats, Floats, Floats], int] = HALF_CYCLE.call
"""``half_cycle(run, memory, p, direction, time, values, slopes) -> status``: on to the next turning point.

On entry the memory's ``now`` describes a turning point, on return the next one; time and ``dt`` gain what that took.
"""
LOAD_STATES = NativeFunction("load_states", int64(INTEGERS, FLOATS, FLOATS, int64), _load_states)
load_states: Callable[[Integers, Floats, Floats, int], int] = LOAD_STATES.call
"""``load_states(run, memory, p, virgin)``: put the internal states where they are at release."""
