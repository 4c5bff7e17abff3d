"""One step of the Dormand-Prince 8(5,3) pair for oscillators whose states have their own equation.

The state is ``y = (x, v, z...)``; its derivatives ``S`` (one column per starting amplitude and parameter) are
carried along in plain array loops: slower than the written-out stages of ``_stepper``, but for any number of
states.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.integrate._ivp import dop853_coefficients as _table

from ._forces import (
    KIND,
    MEMORY,
    OWN_EQUATION,
    P_FIRST,
    P_LAST,
    Z_FIRST,
    Z_LAST,
    force_gradient,
    state_rate_gradients,
    state_rates,
)

STAGES = 12
_A = np.ascontiguousarray(_table.A[:STAGES, :STAGES])
_B = np.ascontiguousarray(_table.B)
_E3 = np.ascontiguousarray(_table.E3[:STAGES])
_E5 = np.ascontiguousarray(_table.E5[:STAGES])


@numba.njit
def ode_slopes(layout, y, S, p, direction, work, dy, dS):
    """Write the time derivatives of ``y`` and of its sensitivities ``S`` into ``dy`` and ``dS``."""
    x, v, z = y[0], y[1], y[2:]
    columns = S.shape[1]
    dy[0] = v
    state_rates(layout, x, v, direction, z, p, dy[2:])
    force, fx, fv = force_gradient(layout, x, v, direction, z, p, work.scratch, work.fp, work.fz)
    dy[1] = -force / layout.mass
    for c in range(columns):
        total = fx * S[0, c] + fv * S[1, c]
        for j in range(z.size):
            total += work.fz[j] * S[2 + j, c]
        if c > 0:
            total += work.fp[c - 1]
        dS[0, c] = S[1, c]
        dS[1, c] = -total / layout.mass
    for i in range(layout.table.shape[0]):
        first, last = layout.table[i, Z_FIRST], layout.table[i, Z_LAST]
        if layout.table[i, KIND] != OWN_EQUATION:
            if layout.table[i, KIND] == MEMORY:
                dS[2 + first : 2 + last, :] = 0.0
            continue
        p_first, p_last = layout.table[i, P_FIRST], layout.table[i, P_LAST]
        width = 2 + p_last - p_first + last - first
        state_rate_gradients(layout, i, x, v, direction, z, p, work.scratch)
        for row in range(last - first):
            g = work.scratch[row * width : (row + 1) * width]
            for c in range(columns):
                total = g[0] * S[0, c] + g[1] * S[1, c]
                for j in range(last - first):
                    total += g[2 + p_last - p_first + j] * S[2 + first + j, c]
                if p_first <= c - 1 < p_last:
                    total += g[2 + c - 1 - p_first]
                dS[2 + first + row, c] = total


@numba.njit
def _combine(work, y, S, h, coefficients, stages):
    """Write ``y + h * sum(coefficient * slope)`` and the same for ``S`` into ``work.y``, ``work.S``."""
    rows, columns = S.shape
    for i in range(rows):
        work.y[i] = y[i]
        for c in range(columns):
            work.S[i, c] = S[i, c]
    for j in range(stages):
        a = coefficients[j]
        if a == 0.0:
            continue
        a *= h
        for i in range(rows):
            work.y[i] += a * work.K[j, i]
            for c in range(columns):
                work.S[i, c] += a * work.KS[j, i, c]


@numba.njit
def step_ode(layout, y, S, p, direction, h, tolerance, work):
    """Advance the state and its sensitivities by ``h`` into ``work.y``, ``work.S``; return the scaled error."""
    for stage in range(STAGES):
        _combine(work, y, S, h, _A[stage], stage)
        ode_slopes(layout, work.y, work.S, p, direction, work, work.K[stage], work.KS[stage])
    _combine(work, y, S, h, _B, STAGES)
    size = y.size
    square5 = 0.0
    square3 = 0.0
    for i in range(size):
        scale = layout.scales[i] if i < 2 else work.z_scale[i - 2]
        e5 = 0.0
        e3 = 0.0
        for j in range(STAGES):
            e5 += _E5[j] * work.K[j, i]
            e3 += _E3[j] * work.K[j, i]
        if scale > 0.0:
            square5 += (e5 / scale) ** 2
            square3 += (e3 / scale) ** 2
    denominator = square5 + 0.01 * square3
    if denominator <= 0.0:
        return 0.0
    return abs(h) * square5 / (size * denominator) ** 0.5 / tolerance
