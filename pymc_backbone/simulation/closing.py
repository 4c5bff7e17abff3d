"""How a half cycle ends: a step aimed at the turning point, a closing step onto it, and what is remembered there.

The last step may overshoot the turning point, because the frozen sign of the velocity continues the force smoothly;
what then remains is closed by one implicit step.
"""

from __future__ import annotations

import math

import numpy as np

from .forces import (
    KIND,
    MEMORY,
    P_FIRST,
    P_LAST,
    ROW,
    Z_FIRST,
    Model,
    force_gradient,
    force_slopes,
    remembered_slopes,
    smooth_branch,
    state_rates,
)
from .instants import sensitivity_slopes
from .pointers import Floats, shifted
from .switches import plain


@plain
def remember(model: Model, y: Floats, direction: float) -> None:
    """Let effects with memory take over the turning point ``y``: where it was, and what they keep of it."""
    columns = model.columns
    z = shifted(y, 2)
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[KIND] != MEMORY:
            continue
        first = row[Z_FIRST]
        kept = remembered_slopes(model, i, y[0], direction, z)
        S = shifted(y, 2 + model.n_states)
        Sz = shifted(S, (2 + first) * columns)
        by_state = shifted(model.scratch, 2 + row[P_LAST] - row[P_FIRST])
        for c in range(columns):
            total = model.scratch[0] * S[c]
            for j in range(3):
                total += by_state[j] * Sz[j * columns + c]
            if row[P_FIRST] <= c - 1 < row[P_LAST]:
                total += model.scratch[2 + c - 1 - row[P_FIRST]]
            Sz[c] = S[c]
            Sz[columns + c] = total
            Sz[2 * columns + c] = 0.0
        z[first] = y[0]
        z[first + 1] = kept
        z[first + 2] = 1.0


@plain
def third_derivative(
    model: Model, x: float, v: float, a: float, fx: float, fv: float, direction: float, z: Floats, moving: bool,
    rates: Floats,
) -> float:  # fmt: skip
    """Return the third derivative of the displacement; states that move need the force's slopes along them."""
    total = fx * v + fv * a
    if moving:
        state_rates(model, x, v, direction, z, rates)
        force_gradient(model, x, v, direction, z)
        for j in range(model.n_states):
            total += model.fz[j] * rates[j]
    return -total / model.mass


@plain
def turning_time(v: float, a: float, jerk: float) -> float:
    """Return the time left to the turning point, to second order."""
    return -v / a - 0.5 * jerk * v * v / (a * a * a)


@plain
def close(
    model: Model, y: Floats, y1: Floats, a: float, jerk: float, label: int, check_label: bool, moving: bool,
    direction: float, shift: Floats, rates: Floats, room: Floats,
) -> float:  # fmt: skip
    """Move the state to the turning point close by; return the time that takes, or nan if a kink lies between.

    One two-point Hermite step: the velocity is zero at the end, the acceleration there is that of a predicted state.
    """
    n = model.n_states
    columns = model.columns
    rows = 2 + n
    x, v = y[0], y[1]
    tau = turning_time(v, a, jerk)
    y1[0] = x + tau * (v + tau * (0.5 * a + tau * jerk / 6.0))
    y1[1] = 0.0
    for j in range(n):
        y1[2 + j] = y[2 + j] + (tau * rates[j] if moving else 0.0)
    z1 = shifted(y1, 2)
    force, fx1, fv1 = force_slopes(model, y1[0], 0.0, direction, z1)
    a1 = -force / model.mass
    if not a1 * direction < 0.0:
        return np.nan
    if moving:
        tau -= (v + 0.5 * tau * (a + a1)) / a1
        y1[0] = x + tau * (v + tau * (2.0 * a + a1) / 6.0)
    else:
        jerk1 = -fv1 * a1 / model.mass
        tau -= (v + 0.5 * tau * (a + a1) + tau * tau / 12.0 * (jerk - jerk1)) / a1
        y1[0] = x + tau * (0.5 * v + tau * (0.1 * (a - a1) + tau * (jerk + jerk1) / 120.0))
    if check_label and smooth_branch(model, y1[0], 0.0, direction, z1) != label:
        return np.nan
    if columns > 0:
        S = shifted(y, rows)
        S1 = shifted(y1, rows)
        slope1 = shifted(room, columns)
        sensitivity_slopes(model, y, direction, room)
        for c in range(columns):
            S1[c] = S[c] + tau * (S[columns + c] + 0.5 * tau * room[c])
            S1[columns + c] = S[columns + c] + tau * room[c]
        for k in range(2 * columns, rows * columns):
            S1[k] = S[k]
        sensitivity_slopes(model, y1, direction, slope1)
        for c in range(columns):
            S1[c] = S[c] + tau * (S[columns + c] + tau * (2.0 * room[c] + slope1[c]) / 6.0)
            S1[columns + c] = S[columns + c] + 0.5 * tau * (room[c] + slope1[c])
    if moving:
        state_rates(model, y1[0], 0.0, direction, z1, model.fz)
        for j in range(n):
            y1[2 + j] = y[2 + j] + 0.5 * tau * (rates[j] + model.fz[j])
    if columns > 0:
        S1 = shifted(y1, rows)
        for c in range(columns):
            # The turning point moves in time by so much; there the displacement does not change with time.
            shift[c] = -S1[columns + c] / a1
    return tau


@plain
def aim(v: float, a: float, fx: float, mass: float, h: float, direction: float) -> float:
    """Return the length of the next step: ``h``, or less to land on the turning point; negative behind it."""
    if not a * direction < 0.0:
        return h
    left = abs(v / a)
    if v * direction < 0.0:
        return -min(left, h)
    if fx > 0.0:
        local = math.sqrt(fx / mass)
        left = math.atan(local * left) / local
    if left <= 1.1 * h:
        return left
    return 0.5 * left if left < 2.0 * h else h
