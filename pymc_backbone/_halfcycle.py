"""From one turning point to the next: the step that everything simulated is made of.

Inside a half cycle the sign of the velocity is a constant, so Coulomb friction and v|v| are smooth. The last
step is aimed at the turning point, and may overshoot it, because the frozen sign continues the force smoothly;
what then remains is closed by a Taylor step. Where a force has kinks, a step is cut back until it ends where the
label of the smooth branch changes, so that no step straddles a kink.
"""

from __future__ import annotations

from collections import namedtuple

import numba
import numpy as np

from ._forces import (
    KIND,
    MEMORY,
    P_FIRST,
    P_LAST,
    Z_FIRST,
    Z_LAST,
    effect_gradient,
    force_gradient,
    force_slopes,
    plain,
    smooth_branch,
    state_rates,
    total_force,
)
from ._ode_stepper import STAGES, step_ode
from ._stepper import step_sensitivity, step_value

COMPLETED, STUCK, NO_RETURN, RUNAWAY, OUT_OF_REACH = range(5)
VALUE, SENSITIVITY, OWN_STATES = range(3)  # which stepper; OWN_STATES carries as many columns as S has
_MAXIMUM_STEPS = 600
_TAYLOR = 1e-4  # radians left to the turning point that the closing Taylor step may cover (error: its cube)
_SLIVER = 1e-6  # radians of a step that may lie beyond a kink (error: its square)

Work = namedtuple(
    "Work", ["y", "S", "fp", "fz", "qx", "qv", "scratch", "K", "KS", "z_scale", "clock", "dt", "slope0", "slope1"]
)
Work.__doc__ = (
    "Scratch arrays. `clock` holds time [s], proposed step [s], largest step [rad] and the amplitude of the motion; "
    "`dt` the derivatives of time."
)
Samples = namedtuple("Samples", ["time", "displacement", "jacobian", "cursor"])
Samples.__doc__ = "Instants at which displacement and sensitivities are wanted, and how many are done."


@numba.njit
def make_work(n_parameters, n_states, columns, mode):
    """Allocate scratch arrays for an oscillator of ``n_parameters`` and ``n_states``."""
    rows = 2 + n_states
    stages = STAGES if mode == OWN_STATES else 0
    return Work(
        np.zeros(rows),
        np.zeros((rows, columns)),
        np.zeros(n_parameters),
        np.zeros(n_states),
        np.zeros(n_parameters + 1),
        np.zeros(n_parameters + 1),
        np.zeros((2 + n_parameters + n_states) * max(1, n_states)),
        np.zeros((stages, rows)),
        np.zeros((stages, rows, columns)),
        np.zeros(n_states),
        np.zeros(4),
        np.zeros(columns),
        np.zeros(columns),
        np.zeros(columns),
    )


@plain
def _hermite_position(x0, v0, a0, x1, v1, a1, h, theta):
    """Return the quintic through position, velocity and acceleration at both ends, at ``theta`` of the step."""
    t2 = theta * theta
    t3 = t2 * theta
    t4 = t3 * theta
    t5 = t4 * theta
    return (
        x0 * (1.0 - 10.0 * t3 + 15.0 * t4 - 6.0 * t5)
        + x1 * (10.0 * t3 - 15.0 * t4 + 6.0 * t5)
        + h * v0 * (theta - 6.0 * t3 + 8.0 * t4 - 3.0 * t5)
        + h * v1 * (-4.0 * t3 + 7.0 * t4 - 3.0 * t5)
        + h * h * a0 * (0.5 * t2 - 1.5 * t3 + 1.5 * t4 - 0.5 * t5)
        + h * h * a1 * (0.5 * t3 - t4 + 0.5 * t5)
    )


@numba.njit
def _fraction_before_kink(layout, y, work, a, h, label, direction, p):
    """Return the share of the step at which the label of the smooth branch changes, by bisection."""
    z0 = y[2:]
    z1 = work.y[2:]
    z = np.empty(z0.size)
    a1 = -total_force(layout, work.y[0], work.y[1], direction, z1, p) / layout.mass
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        x = _hermite_position(y[0], y[1], a, work.y[0], work.y[1], a1, h, middle)
        v = y[1] + middle * (work.y[1] - y[1])
        for j in range(z.size):
            z[j] = z0[j] + middle * (z1[j] - z0[j])
        if smooth_branch(layout, x, v, direction, z, p) == label:
            low = middle
        else:
            high = middle
    return high


@plain
def _sensitivity_slopes(layout, y, S, p, direction, work, out):
    """Write the acceleration's total derivatives, one per column of ``S``, into ``out``."""
    _, fx, fv = force_gradient(layout, y[0], y[1], direction, y[2:], p, work.scratch, work.fp, work.fz)
    for c in range(S.shape[1]):
        total = fx * S[0, c] + fv * S[1, c]
        for j in range(work.fz.size):
            total += work.fz[j] * S[2 + j, c]
        if c > 0:
            total += work.fp[c - 1]
        out[c] = -total / layout.mass


@plain
def _write_samples(layout, y, S, a0, jerk0, a1, jerk1, h, smooth, end, p, direction, mode, work, samples):
    """Write displacement and sensitivities at all remaining instants before ``end`` inside the last step."""
    cursor = samples.cursor[0]
    if cursor >= samples.time.size or samples.time[cursor] > end:
        return
    start = work.clock[0]
    columns = S.shape[1] if mode != VALUE else 0
    if columns > 0:
        _sensitivity_slopes(layout, y, S, p, direction, work, work.slope0)
        _sensitivity_slopes(layout, work.y, work.S, p, direction, work, work.slope1)
    while cursor < samples.time.size and samples.time[cursor] <= end:
        theta = (samples.time[cursor] - start) / h
        x = _hermite_position(y[0], y[1], a0, work.y[0], work.y[1], a1, h, theta)
        if smooth:
            # The jerk at both ends lifts the quintic to a septic: what it misses at either end, times a bump.
            t = theta
            r = 1.0 - t
            bump = (t * r) ** 3
            left = jerk0 - _quintic_jerk(y[0], y[1], a0, work.y[0], work.y[1], a1, h, 0.0)
            right = jerk1 - _quintic_jerk(y[0], y[1], a0, work.y[0], work.y[1], a1, h, 1.0)
            x += h * h * h * bump * (left * r - right * t) / 6.0
        samples.displacement[cursor] = x
        for c in range(columns):
            samples.jacobian[cursor, c] = _hermite_position(
                S[0, c], S[1, c], work.slope0[c], work.S[0, c], work.S[1, c], work.slope1[c], h, theta
            )
        cursor += 1
    samples.cursor[0] = cursor


@plain
def _quintic_jerk(x0, v0, a0, x1, v1, a1, h, theta):
    """Return the third derivative of the quintic of `_hermite_position` at an end."""
    d = (x1 - x0) / h**3
    if theta == 0.0:
        return 60.0 * d - (36.0 * v0 + 24.0 * v1) / h**2 + (-9.0 * a0 + 3.0 * a1) / h
    return 60.0 * d - (24.0 * v0 + 36.0 * v1) / h**2 + (-3.0 * a0 + 9.0 * a1) / h


@plain
def remember_turning_point(layout, y, S, p, direction, mode, work):
    """Let effects with memory take over the turning point ``y``: where it was, their own force there."""
    for i in range(layout.table.shape[0]):
        if layout.table[i, KIND] != MEMORY:
            continue
        first = layout.table[i, Z_FIRST]
        p_first, p_last = layout.table[i, P_FIRST], layout.table[i, P_LAST]
        force = effect_gradient(layout, i, y[0], 0.0, direction, y[2:], p, work.scratch)
        if mode != VALUE:
            for c in range(S.shape[1]):
                total = work.scratch[0] * S[0, c]
                for j in range(3):
                    total += work.scratch[2 + p_last - p_first + j] * S[2 + first + j, c]
                if p_first <= c - 1 < p_last:
                    total += work.scratch[2 + c - 1 - p_first]
                S[2 + first + 1, c] = total
                S[2 + first, c] = S[0, c]
                S[2 + first + 2, c] = 0.0
        y[2 + first] = y[0]
        y[2 + first + 1] = force
        y[2 + first + 2] = 1.0


@plain
def _close(layout, y, S, a, fx, fv, p, direction, mode, work):
    """Close the last thousandth of a radian by a Taylor step and land on the turning point."""
    n = y.size - 2
    rates = work.y[2:]
    jerk = -(fx * y[1] + fv * a) / layout.mass
    if n > 0:
        state_rates(layout, y[0], y[1], direction, y[2:], p, rates)
        force_gradient(layout, y[0], y[1], direction, y[2:], p, work.scratch, work.fp, work.fz)
        for j in range(n):
            jerk -= work.fz[j] * rates[j] / layout.mass
    tau = -y[1] / a - 0.5 * jerk * y[1] * y[1] / (a * a * a)
    if mode == VALUE:
        work.slope0[0] = -(fx * S[0, 0] + fv * S[1, 0]) / layout.mass
    else:
        _sensitivity_slopes(layout, y, S, p, direction, work, work.slope0)
    turn = a + jerk * tau
    y[0] += tau * (y[1] + tau * (0.5 * a + tau * jerk / 6.0))
    y[1] = 0.0
    for j in range(n):
        y[2 + j] += tau * rates[j]
    if n > 0:
        state_rates(layout, y[0], 0.0, direction, y[2:], p, rates)
    for c in range(S.shape[1]):
        S[0, c] += tau * (S[1, c] + 0.5 * tau * work.slope0[c])
        shift = -(S[1, c] + tau * work.slope0[c]) / turn
        S[1, c] = 0.0
        work.dt[c] += shift
        for j in range(n):
            S[2 + j, c] += rates[j] * shift
    work.clock[0] += tau


@numba.njit
def half_cycle(layout, y, S, p, direction, mode, tolerance, work, samples):
    """Run from a turning point to the next.

    On entry ``y = (x, 0, z...)`` and ``S`` (rows as ``y``; column 0 the starting amplitude, then the parameters)
    describe the turning point; on return the next one. ``work.clock[0]`` and ``work.dt`` gain the time it took and
    its derivatives. Returns a status.
    """
    mass = layout.mass
    z = y[2:]
    start = y[0]
    force, fx, fv = force_slopes(layout, y[0], 0.0, direction, z, p, work.scratch)
    a = -force / mass
    if not np.isfinite(a):
        return RUNAWAY
    if a * direction <= 0.0:
        return STUCK
    amplitude = work.clock[3]
    omega = (abs(a) / amplitude) ** 0.5
    layout.scales[0] = amplitude
    layout.scales[1] = amplitude * omega
    label = smooth_branch(layout, y[0], 0.0, direction, z, p) if layout.has_regime else 0
    h = min(work.clock[1] if work.clock[1] > 0.0 else 0.3 / omega, work.clock[2] / omega)
    limit = np.inf
    rows = y.size if mode == OWN_STATES else 2
    if mode == OWN_STATES:
        state_rates(layout, y[0], amplitude * omega * direction, direction, z, p, work.z_scale)
        for j in range(z.size):
            work.z_scale[j] = max(abs(z[j]), abs(work.z_scale[j]) / omega)
    for _ in range(_MAXIMUM_STEPS):
        step = h
        if y[1] * direction > 0.0 and a * direction < 0.0:
            if fx > 0.0:
                local = (fx / mass) ** 0.5
                left = np.arctan(local * abs(y[1] / a)) / local
            else:
                left = abs(y[1] / a)
            if left <= 1.1 * h:
                step = left
            elif left < 2.0 * h:
                step = 0.5 * left
        elif y[1] * direction < 0.0:
            step = max(-y[1] / a, -h) if a * direction < 0.0 else h
        step = min(step, limit)
        if mode == VALUE:
            error = step_value(layout, y, S, a, fx, fv, p, direction, step, tolerance, work)
        elif mode == SENSITIVITY:
            error = step_sensitivity(layout, y, S, a, fx, fv, p, direction, step, tolerance, work)
        else:
            error = step_ode(layout, y, S, p, direction, step, tolerance, work)
        new_label = label
        if layout.has_regime and step > 0.0 and np.isfinite(error):
            if rows == 2:
                work.y[2:] = z
            new_label = smooth_branch(layout, work.y[0], work.y[1], direction, work.y[2:], p)
            if new_label != label:
                share = _fraction_before_kink(layout, y, work, a, step, label, direction, p)
                if (1.0 - share) * step * omega > _SLIVER:
                    limit = max(share * step, 0.5 * _SLIVER / omega)
                    continue
        if not error <= 1.0:
            h = abs(step) * (max(0.2, 0.9 * error**-0.125) if np.isfinite(error) else 0.2)
            limit = h
            if not h * omega > 1e-9:
                return RUNAWAY
            continue
        x1, v1 = work.y[0], work.y[1]
        z1 = work.y[2:] if mode == OWN_STATES else z
        force, fx1, fv1 = force_slopes(layout, x1, v1, direction, z1, p, work.scratch)
        a1 = -force / mass
        if not (np.isfinite(a1) and abs(x1) < 1e3 * (abs(start) + amplitude)):
            return RUNAWAY
        if samples.time.size > 0 and step > 0.0:
            if rows == 2:
                work.y[2:] = z
                work.S[2:, :] = S[2:, :]
            end = work.clock[0] + step
            if v1 * direction < 0.0 and a1 != 0.0:
                end += min(0.0, -v1 / a1)
            jerk0 = -(fx * y[1] + fv * a) / mass
            jerk1 = -(fx1 * v1 + fv1 * a1) / mass
            smooth = mode != OWN_STATES and new_label == label
            _write_samples(
                layout, y, S, a, jerk0, a1, jerk1, step, smooth, end, p, direction, mode, work, samples
            )
        work.clock[0] += step
        for i in range(rows):
            y[i] = work.y[i]
            for c in range(S.shape[1]):
                S[i, c] = work.S[i, c]
        if mode == OWN_STATES:
            for j in range(z.size):
                work.z_scale[j] = max(work.z_scale[j], abs(z[j]))
        if step >= 0.999 * h:
            growth = min(6.0, 0.9 * error**-0.125) if error > 0.0 else 6.0
            h = min(step * growth, work.clock[2] / omega)
        a, fx, fv, label, limit = a1, fx1, fv1, new_label, np.inf
        if a * direction < 0.0 and abs(y[1]) * omega < _TAYLOR * abs(a):
            _close(layout, y, S, a, fx, fv, p, direction, mode, work)
            remember_turning_point(layout, y, S, p, direction, mode, work)
            work.clock[1] = h
            work.clock[3] = max(0.5 * abs(y[0] - start), 1e-300)
            return COMPLETED
    return NO_RETURN
