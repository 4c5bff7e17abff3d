"""Compiled free decays: one cycle per level, the whole decay, the displacement at given instants.

Rows of every table of observables are frequency [Hz], damping (logarithmic decrement) and offset; column 0 of a
derivative is the one with respect to the release amplitude, the parameters follow.
"""

from __future__ import annotations

import numba
import numpy as np

from ._compiled import cached
from ._forces import (
    KIND,
    MEMORY,
    OWN_EQUATION,
    P_FIRST,
    P_LAST,
    Z_FIRST,
    Z_LAST,
    Layout,
    function_at,
    state_rate_gradients,
    state_rates,
)
from ._halfcycle import (
    COMPLETED,
    NO_RETURN,
    OUT_OF_REACH,
    OWN_STATES,
    SENSITIVITY,
    STUCK,
    VALUE,
    Samples,
    half_cycle,
    make_work,
    remember_turning_point,
)

OBSERVABLE_COUNT = 3
_ON_LEVEL = 3e-5  # a cycle this close to its level is carried there along its slope (error: its square)
_NEAR_LEVEL = 1e-3  # one this close by the cubic through it and the cycle before it, slopes included
_MAXIMUM_CYCLES_PER_LEVEL = 14
_RAMP_STEPS = 200


@numba.njit
def no_samples():
    """Return an empty set of instants."""
    return Samples(np.empty(0), np.empty(0), np.empty((0, 0)), np.zeros(1, np.int64))


@numba.njit
def cycle_quantities(p0, q, p1, time, out):
    """Write amplitude, frequency, damping and offset of the cycle p0, q, p1 into ``out``."""
    amplitude = 0.25 * (p0 + p1 - 2.0 * q)
    out[0] = amplitude
    out[1] = 1.0 / time
    out[2] = 2.0 * np.log((p0 - q) / (p1 - q))
    out[3] = 0.5 * (0.5 * (p0 + p1) + q) / amplitude


@numba.njit
def cycle_slope(p0, q, p1, time, d0, dq, d1, dtime, offset, out):
    """Write the derivatives of the four cycle quantities along one column into ``out``."""
    amplitude = 0.25 * (p0 + p1 - 2.0 * q)
    slope = 0.25 * (d0 + d1 - 2.0 * dq)
    out[0] = slope
    out[1] = -dtime / (time * time)
    out[2] = 2.0 * ((d0 - dq) / (p0 - q) - (d1 - dq) / (p1 - q))
    out[3] = (0.5 * (0.5 * (d0 + d1) + dq) - offset * slope) / amplitude


@numba.njit
def _release(layout, y, S, p, amplitude, virgin, mode, work):
    """Put the oscillator at ``amplitude``, at rest, its states as loaded from rest (``virgin``) or relaxed."""
    y[:] = 0.0
    S[:, :] = 0.0
    y[0] = amplitude
    if S.shape[1] > 0:
        S[0, 0] = 1.0
    work.clock[0] = 0.0
    work.clock[3] = abs(amplitude)
    work.dt[:] = 0.0
    if y.size == 2:
        return
    side = 1.0 if amplitude > 0.0 else -1.0
    layout.scales[0] = abs(amplitude)
    layout.scales[1] = abs(amplitude)
    if virgin:
        _load_slowly(layout, y, S, p, amplitude, side, work)
        remember_turning_point(layout, y, S, p, side, mode, work)
    else:
        for i in range(layout.table.shape[0]):
            if layout.table[i, KIND] == MEMORY:
                y[2 + layout.table[i, Z_FIRST]] = amplitude
                if S.shape[1] > 0:
                    S[2 + layout.table[i, Z_FIRST], 0] = 1.0


@numba.njit
def _ramp_slopes(layout, x, z, Sz, p, amplitude, work, dz, dS):
    """Write slopes along the slow loading path x = amplitude * s, s from 0 to 1."""
    n, columns = Sz.shape
    side = 1.0 if amplitude > 0.0 else -1.0
    state_rates(layout, x, amplitude, side, z, p, dz)
    for i in range(layout.table.shape[0]):
        if layout.table[i, KIND] != OWN_EQUATION:
            for j in range(layout.table[i, Z_FIRST], layout.table[i, Z_LAST]):
                for c in range(columns):
                    dS[j, c] = 0.0
            continue
        first, last = layout.table[i, Z_FIRST], layout.table[i, Z_LAST]
        p_first, p_last = layout.table[i, P_FIRST], layout.table[i, P_LAST]
        width = 2 + p_last - p_first + last - first
        state_rate_gradients(layout, i, x, amplitude, side, z, p, work.scratch)
        for row in range(last - first):
            for c in range(columns):
                total = 0.0
                if c == 0:
                    total = work.scratch[row * width] * x / amplitude + work.scratch[row * width + 1]
                elif p_first <= c - 1 < p_last:
                    total = work.scratch[row * width + 2 + c - 1 - p_first]
                for j in range(last - first):
                    total += work.scratch[row * width + 2 + p_last - p_first + j] * Sz[first + j, c]
                dS[first + row, c] = total


@numba.njit
def _load_slowly(layout, y, S, p, amplitude, side, work):
    """Bring states with their own equation from zero to ``amplitude`` along a slow ramp (Runge-Kutta 4)."""
    has_own = False
    for i in range(layout.table.shape[0]):
        has_own = has_own or layout.table[i, KIND] == OWN_EQUATION
    if not has_own:
        return
    n, columns = y.size - 2, S.shape[1]
    z = np.zeros(n)
    Sz = np.zeros((n, columns))
    k = np.zeros((4, n))
    kS = np.zeros((4, n, columns))
    h = 1.0 / _RAMP_STEPS
    for step in range(_RAMP_STEPS):
        for stage in range(4):
            weight = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            before = max(stage - 1, 0)
            for j in range(n):
                z[j] = y[2 + j] + weight * h * k[before, j]
                for c in range(columns):
                    Sz[j, c] = S[2 + j, c] + weight * h * kS[before, j, c]
            _ramp_slopes(layout, amplitude * (step + weight) * h, z, Sz, p, amplitude, work, k[stage], kS[stage])
        for j in range(n):
            y[2 + j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])
            for c in range(columns):
                S[2 + j, c] += h / 6.0 * (kS[0, j, c] + 2.0 * kS[1, j, c] + 2.0 * kS[2, j, c] + kS[3, j, c])


@cached
def backbone_by_cycles(
    user, table, stiffness, damping, n_states, mass, has_regime,
    p, levels, release, virgin, sensitivities, tolerance, maximum, values, jacobian, status,
):  # fmt: skip
    """Write the backbone at ``levels`` from one cycle each; for oscillators without internal states.

    The starting peak of a cycle is found by Newton's method on its amplitude. The derivative along the starting
    amplitude, which the integrator carries anyway, predicts the next start and takes a cycle onto its level.
    """
    layout = Layout(table, stiffness, damping, n_states, mass, has_regime, np.ones(2), function_at(user))
    n = p.size
    mode = SENSITIVITY if sensitivities else VALUE
    columns = n + 1 if sensitivities else 1
    work = make_work(n, 0, columns, mode)
    work.clock[2] = 1.5
    samples = no_samples()
    y = np.zeros(2)
    S = np.zeros((2, columns))
    trough = np.zeros(columns)
    peak = np.zeros(columns)
    quantity = np.zeros(4)
    slope = np.zeros(4)
    along = np.zeros(4)
    # Rows: log amplitude; then value and slope, along log amplitude, of log starting peak and of each observable.
    node = np.zeros((2, 9))
    last, previous, known = 0, 1, 0
    for k in range(levels.size - 1, -1, -1):
        level = levels[k]
        at = np.log(level)
        start = level
        if known == 1:
            start = np.exp(node[last, 1] + node[last, 2] * (at - node[last, 0]))
        elif known > 1:
            start = np.exp(_hermite(node[previous], node[last], 1, at))
        start = min(max(start, 0.3 * level), 30.0 * level)
        near = _NEAR_LEVEL if (known > 0 and not sensitivities) else _ON_LEVEL
        code = OUT_OF_REACH
        for _ in range(_MAXIMUM_CYCLES_PER_LEVEL):
            _release(layout, y, S, p, start, True, mode, work)
            code = half_cycle(layout, y, S, p, -1.0, mode, tolerance, work, samples)
            if code != COMPLETED:
                break
            q = y[0]
            trough[:] = S[0]
            code = half_cycle(layout, y, S, p, 1.0, mode, tolerance, work, samples)
            if code != COMPLETED:
                break
            p1 = y[0]
            peak[:] = S[0]
            if not (p1 > q and start > q):
                code = NO_RETURN
                break
            cycle_quantities(start, q, p1, work.clock[0], quantity)
            cycle_slope(start, q, p1, work.clock[0], 1.0, trough[0], peak[0], work.dt[0], quantity[3], along)
            error = level - quantity[0]
            if not (along[0] > 0.0 and np.isfinite(error)):
                code = OUT_OF_REACH
                break
            if abs(error) <= near * level:
                break
            code = OUT_OF_REACH
            start += min(max(error / along[0], -0.5 * start), start)
        status[k] = code
        if code != COMPLETED:
            values[:, k] = np.nan
            if sensitivities:
                jacobian[:, k, :] = np.nan
            continue
        if known > 0:
            last, previous = previous, last
        known += 1
        node[last, 0] = np.log(quantity[0])
        node[last, 1] = np.log(start)
        node[last, 2] = quantity[0] / (along[0] * start)
        for i in range(3):
            node[last, 3 + 2 * i] = quantity[1 + i]
            node[last, 4 + 2 * i] = along[1 + i] / along[0] * quantity[0]
            if known > 1:
                values[i, k] = _hermite(node[previous], node[last], 3 + 2 * i, at)
            else:
                values[i, k] = quantity[1 + i] + along[1 + i] / along[0] * error
        if sensitivities:
            for j in range(n):
                cycle_slope(
                    start, q, p1, work.clock[0], 0.0, trough[j + 1], peak[j + 1], work.dt[j + 1], quantity[3], slope
                )
                for i in range(3):
                    jacobian[i, k, j] = slope[1 + i] - along[1 + i] / along[0] * slope[0]


@numba.njit
def _hermite(far, near, column, at):
    """Return the cubic through two nodes (value in ``column``, slope behind it), expanded about ``near``."""
    width = far[0] - near[0]
    secant = (far[column] - near[column]) / width
    second = (3.0 * secant - 2.0 * near[column + 1] - far[column + 1]) / width
    third = (near[column + 1] + far[column + 1] - 2.0 * secant) / (width * width)
    e = at - near[0]
    return near[column] + e * (near[column + 1] + e * (second + e * third))


@numba.njit(inline="always")
def whole_decay(layout, p, release, virgin, stop, maximum, mode, tolerance, turns, slopes, time_slopes, times, samples):
    """Run a decay turning point by turning point until its amplitude falls below ``stop``.

    Writes displacement and time of each turning point (the release first) into ``turns``, ``times`` and their
    derivatives into ``slopes``, ``time_slopes``. Returns how many there are and the status that ended the decay.
    """
    n_states = layout.n_states
    columns = slopes.shape[1]
    work = make_work(p.size, n_states, columns, mode)
    work.clock[2] = 1.5
    if samples.time.size > 0:
        work.clock[2] = 0.35 if (mode == OWN_STATES or layout.has_regime) else 0.5
    y = np.zeros(2 + n_states)
    S = np.zeros((2 + n_states, columns))
    _release(layout, y, S, p, release, virgin, mode, work)
    direction = -1.0 if release > 0.0 else 1.0
    turns[0] = y[0]
    times[0] = 0.0
    slopes[0, :] = S[0]
    time_slopes[0, :] = 0.0
    count = 1
    while count < maximum:
        code = half_cycle(layout, y, S, p, direction, mode, tolerance, work, samples)
        if code != COMPLETED:
            _hold(y, S, code, samples)
            return count, code
        turns[count] = y[0]
        times[count] = work.clock[0]
        slopes[count, :] = S[0]
        time_slopes[count, :] = work.dt
        count += 1
        direction = -direction
        if 0.5 * abs(turns[count - 1] - turns[count - 2]) < stop:
            return count, COMPLETED
        if samples.time.size > 0 and samples.cursor[0] >= samples.time.size:
            return count, COMPLETED
    return count, COMPLETED


@numba.njit
def _hold(y, S, code, samples):
    """Fill the instants after the end of a decay: where it stuck, it stays; otherwise there is no answer."""
    for i in range(samples.cursor[0], samples.time.size):
        samples.displacement[i] = y[0] if code == STUCK else np.nan
        for c in range(samples.jacobian.shape[1]):
            samples.jacobian[i, c] = S[0, c] if code == STUCK else np.nan
    samples.cursor[0] = samples.time.size


@numba.njit
def _own_states(layout):
    """Return whether any state has its own equation."""
    for i in range(layout.table.shape[0]):
        if layout.table[i, KIND] == OWN_EQUATION:
            return True
    return False


@numba.njit
def cycles_of_decay(turns, times, slopes, time_slopes, count, columns, values, jacobian):
    """Write amplitude, frequency, damping, offset per peak-to-peak cycle and their derivatives; return how many."""
    first = 0 if turns[0] > turns[1] else 1
    cycles = 0
    i = first
    while i + 2 < count:
        p0, q, p1 = turns[i], turns[i + 1], turns[i + 2]
        time = times[i + 2] - times[i]
        if not (p0 > q and p1 > q):
            break
        cycle_quantities(p0, q, p1, time, values[cycles])
        for c in range(columns):
            cycle_slope(
                p0,
                q,
                p1,
                time,
                slopes[i, c],
                slopes[i + 1, c],
                slopes[i + 2, c],
                time_slopes[i + 2, c] - time_slopes[i, c],
                values[cycles, 3],
                jacobian[cycles, :, c],
            )
        cycles += 1
        i += 2
    return cycles


@cached
def backbone_by_decay(
    user, table, stiffness, damping, n_states, mass, has_regime,
    p, levels, release, virgin, sensitivities, tolerance, maximum, values, jacobian, status,
):  # fmt: skip
    """Write the backbone at ``levels`` from the whole decay, by local cubics in log amplitude between its cycles."""
    layout = Layout(table, stiffness, damping, n_states, mass, has_regime, np.ones(2), function_at(user))
    n = p.size
    if release <= 0.0:
        release = 1.25 * levels[-1]
    own = _own_states(layout)
    mode = OWN_STATES if own else (SENSITIVITY if sensitivities else VALUE)
    columns = n + 1 if sensitivities else (0 if own else 1)
    carried = n + 1 if sensitivities else 0
    turns = np.empty(maximum)
    times = np.empty(maximum)
    slopes = np.empty((maximum, columns))
    time_slopes = np.empty((maximum, columns))
    cycles = np.empty((maximum // 2 + 1, 4))
    cycle_slopes = np.empty((maximum // 2 + 1, 4, carried))
    top = levels[-1]
    found = 0
    code = COMPLETED
    for _ in range(12):
        count, code = whole_decay(
            layout,
            p,
            release,
            virgin,
            0.6 * levels[0],
            maximum,
            mode,
            tolerance,
            turns,
            slopes,
            time_slopes,
            times,
            no_samples(),
        )
        found = cycles_of_decay(turns, times, slopes, time_slopes, count, carried, cycles, cycle_slopes)
        if found == 0 or cycles[0, 0] >= top:
            break
        release *= 1.1 * top / cycles[0, 0]
    for k in range(levels.size):
        status[k] = _interpolate(cycles, cycle_slopes, found, levels[k], k, carried, values, jacobian)
        if status[k] != COMPLETED:
            if code != COMPLETED:
                status[k] = code
            values[:, k] = np.nan
            if sensitivities:
                jacobian[:, k, :] = np.nan


@numba.njit
def _interpolate(cycles, cycle_slopes, found, level, k, columns, values, jacobian):
    """Write the three observables at ``level`` by the cubic through the nearest four cycles."""
    if found < 2 or level > cycles[0, 0] or level < cycles[found - 1, 0]:
        return OUT_OF_REACH
    right = 1
    while right < found - 1 and cycles[right, 0] > level:
        right += 1
    size = min(4, found)
    first = min(max(right - 2, 0), found - size)
    at = np.log(level)
    nodes = np.log(cycles[first : first + size, 0])
    for i in range(1, size):
        if not nodes[i] < nodes[i - 1]:
            return NO_RETURN
    for o in range(3):
        total = 0.0
        for i in range(size):
            total += _lagrange(nodes, i, at) * cycles[first + i, 1 + o]
        values[o, k] = total
        for c in range(columns - 1):
            slope = 0.0
            for i in range(size):
                # A node that moves along the curve changes nothing: only what it leaves the curve by counts.
                along = 0.0
                for j in range(size):
                    along += _lagrange_slope(nodes, j, i) * cycles[first + j, 1 + o]
                moved = cycle_slopes[first + i, 0, c + 1] / cycles[first + i, 0]
                slope += _lagrange(nodes, i, at) * (cycle_slopes[first + i, 1 + o, c + 1] - along * moved)
            jacobian[o, k, c] = slope
    return COMPLETED


@numba.njit
def _lagrange(nodes, i, at):
    """Return the Lagrange polynomial of node ``i`` at ``at``."""
    product = 1.0
    for j in range(nodes.size):
        if j != i:
            product *= (at - nodes[j]) / (nodes[i] - nodes[j])
    return product


@numba.njit
def _lagrange_slope(nodes, j, i):
    """Return the derivative of the Lagrange polynomial of node ``j`` at node ``i``."""
    if i == j:
        total = 0.0
        for m in range(nodes.size):
            if m != i:
                total += 1.0 / (nodes[i] - nodes[m])
        return total
    product = 1.0 / (nodes[j] - nodes[i])
    for m in range(nodes.size):
        if m != i and m != j:
            product *= (nodes[i] - nodes[m]) / (nodes[j] - nodes[m])
    return product


@cached
def decay(
    user, table, stiffness, damping, n_states, mass, has_regime,
    p, release, virgin, stop, sensitivities, tolerance, maximum, turns, slopes, time_slopes, times,
    sample_times, displacement, sample_slopes,
):  # fmt: skip
    """Run `whole_decay`, writing displacement and sensitivities at the sample times on the way."""
    layout = Layout(table, stiffness, damping, n_states, mass, has_regime, np.ones(2), function_at(user))
    mode = OWN_STATES if _own_states(layout) else (SENSITIVITY if sensitivities else VALUE)
    samples = Samples(sample_times, displacement, sample_slopes, np.zeros(1, np.int64))
    return whole_decay(
        layout, p, release, virgin, stop, maximum, mode, tolerance, turns, slopes, time_slopes, times, samples
    )
