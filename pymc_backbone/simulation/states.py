"""Internal states with their own equation: their slopes, and where they stand when a specimen is released.

A state vector holds ``x, v, z...`` and behind it, row by row, the derivatives of each of these with respect to the
release amplitude and the parameters. All arguments but numbers are pointers.
"""

from __future__ import annotations

from .forces import (
    KIND,
    OWN_EQUATION,
    P_FIRST,
    P_LAST,
    ROW,
    Z_FIRST,
    Z_LAST,
    Model,
    force_gradient,
    state_rate_gradients,
    state_rates,
    total_force,
)
from .pointers import Floats, Integers, shifted
from .switches import plain

_RAMP_STEPS = 128
_MOST_RAMP_STEPS = 8192
_NEWTON_STEPS = 30


@plain
def state_slopes(model: Model, y: Floats, direction: float, out: Floats) -> None:
    """Write the time derivatives of a state vector into ``out``."""
    columns = model.columns
    x = y[0]
    v = y[1]
    z = shifted(y, 2)
    rows = 2 + model.n_states
    out[0] = v
    state_rates(model, x, v, direction, z, shifted(out, 2))
    if columns == 0:
        out[1] = -total_force(model, x, v, direction, z) / model.mass
        return
    force, fx, fv = force_gradient(model, x, v, direction, z)
    out[1] = -force / model.mass
    S = shifted(y, rows)
    slopes = shifted(out, rows)
    accelerations = shifted(slopes, columns)
    minus = -1.0 / model.mass
    for c in range(columns):
        slopes[c] = S[columns + c]
    _write_along(accelerations, S, columns, minus * fx, minus * fv)
    for j in range(model.n_states):
        _add_row(accelerations, shifted(S, (2 + j) * columns), columns, minus * model.fz[j])
    for j in range(model.n_parameters):
        accelerations[1 + j] += minus * model.fp[j]
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        n_parameters = row[P_LAST] - row[P_FIRST]
        n = row[Z_LAST] - row[Z_FIRST]
        if row[KIND] == OWN_EQUATION:
            state_rate_gradients(model, i, x, v, direction, z)
            for state in range(n):
                gradient = shifted(model.scratch, state * (2 + n_parameters + n))
                rates = shifted(slopes, (2 + row[Z_FIRST] + state) * columns)
                _write_along(rates, S, columns, gradient[0], gradient[1])
                for j in range(n):
                    by_state = gradient[2 + n_parameters + j]
                    _add_row(rates, shifted(S, (2 + row[Z_FIRST] + j) * columns), columns, by_state)
                for j in range(n_parameters):
                    rates[1 + row[P_FIRST] + j] += gradient[2 + j]
        else:
            for k in range((2 + row[Z_FIRST]) * columns, (2 + row[Z_LAST]) * columns):
                slopes[k] = 0.0


@plain
def _write_along(out: Floats, S: Floats, columns: int, by_x: float, by_v: float) -> None:
    """Write what the first two rows of sensitivities contribute to the derivatives of a slope."""
    for c in range(columns):
        out[c] = by_x * S[c] + by_v * S[columns + c]


@plain
def _add_row(out: Floats, row: Floats, columns: int, factor: float) -> None:
    """Add a multiple of one row of sensitivities."""
    for c in range(columns):
        out[c] += factor * row[c]


@plain
def _along(model: Model, row: Integers, state: int, c: int, dx: float, dv: float, Sz: Floats) -> float:
    """Return the derivative of one state's rate along column ``c``; the model's scratch holds the rate's gradient."""
    n_parameters = row[P_LAST] - row[P_FIRST]
    n = row[Z_LAST] - row[Z_FIRST]
    gradient = shifted(model.scratch, state * (2 + n_parameters + n))
    total = gradient[0] * dx + gradient[1] * dv
    if row[P_FIRST] <= c - 1 < row[P_LAST]:
        total += gradient[2 + c - 1 - row[P_FIRST]]
    for j in range(n):
        total += gradient[2 + n_parameters + j] * Sz[(row[Z_FIRST] + j) * model.columns + c]
    return total


@plain
def load_slowly(model: Model, y: Floats, side: float, room: Floats) -> None:
    """Bring states with their own equation to where slow loading from zero to the displacement ``y[0]`` takes them.

    First the part of their rates that the motion causes (Runge-Kutta 4 along the path, in more steps where states
    forget over a short way); then, if they are not at rest there, where they come to rest while the specimen is held
    (Newton). ``room`` holds 6 times the states and their derivatives.
    """
    n = model.n_states
    columns = model.columns
    size = n * (1 + columns)
    amplitude = y[0]
    z = shifted(y, 2)
    Sz = shifted(y, 2 + n + 2 * columns)
    start = shifted(room, 5 * size)
    steps = _RAMP_STEPS
    _ramp(model, amplitude, side, steps, room)
    while steps < _MOST_RAMP_STEPS and not _is_followed(model, amplitude, side, start, steps):
        steps *= 4
        _ramp(model, amplitude, side, steps, room)
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[KIND] == OWN_EQUATION:
            for j in range(row[Z_FIRST], row[Z_LAST]):
                z[j] = start[j]
                for c in range(columns):
                    Sz[j * columns + c] = start[n + j * columns + c]
            _hold(model, i, row, amplitude, z, Sz, side, room)


@plain
def _is_followed(model: Model, amplitude: float, side: float, z: Floats, steps: int) -> bool:
    """Return whether the steps of a ramp are short enough for what states forget over one, at its steep end."""
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[KIND] != OWN_EQUATION:
            continue
        n = row[Z_LAST] - row[Z_FIRST]
        width = 2 + row[P_LAST] - row[P_FIRST] + n
        for j in range(n):
            own = j * width + width - n + j
            state_rate_gradients(model, i, amplitude, amplitude, side, z)
            moving = model.scratch[own]
            state_rate_gradients(model, i, amplitude, 0.0, side, z)
            # Runge-Kutta 4 is stable to 2.8; the path runs at three times the displacement there.
            if not 3.0 * abs(moving - model.scratch[own]) <= 2.0 * steps:
                return False
    return True


@plain
def _ramp(model: Model, amplitude: float, side: float, steps: int, room: Floats) -> None:
    """Follow the states along the loading path, from zero, into the last part of ``room``."""
    n = model.n_states
    size = n * (1 + model.columns)
    here = shifted(room, 4 * size)
    start = shifted(room, 5 * size)
    for j in range(size):
        room[j] = 0.0
        here[j] = 0.0
        start[j] = 0.0
    h = 1.0 / steps
    for step in range(steps):
        for stage in range(4):
            weight = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            before = shifted(room, max(stage - 1, 0) * size)
            for j in range(size):
                here[j] = start[j] + weight * h * before[j]
            _ramp_slopes(model, amplitude, (step + weight) * h, here, side, shifted(room, stage * size))
        for j in range(size):
            start[j] += h / 6.0 * (room[j] + 2.0 * room[size + j] + 2.0 * room[2 * size + j] + room[3 * size + j])


@plain
def _ramp_slopes(model: Model, amplitude: float, u: float, zS: Floats, side: float, out: Floats) -> None:
    """Write slopes along the loading path ``x = amplitude * u**3``: the rates with the motion less those without.

    The cube takes small steps at first, where states grow from zero and their rates may have no second derivative.
    """
    share = u * u * u
    pace = 3.0 * u * u
    n = model.n_states
    columns = model.columns
    x = amplitude * share
    rest = model.fz
    state_rates(model, x, 0.0, side, zS, rest)
    state_rates(model, x, amplitude, side, zS, out)
    for j in range(n):
        out[j] = pace * (out[j] - rest[j])
    Sz = shifted(zS, n)
    slopes = shifted(out, n)
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        for j in range(row[Z_FIRST], row[Z_LAST]):
            for c in range(columns):
                slopes[j * columns + c] = 0.0
        if row[KIND] != OWN_EQUATION or columns == 0:
            continue
        for moving in range(2):
            state_rate_gradients(model, i, x, amplitude * moving, side, zS)
            for state in range(row[Z_LAST] - row[Z_FIRST]):
                for c in range(columns):
                    dx = share if c == 0 else 0.0
                    dv = float(moving) if c == 0 else 0.0
                    rate = _along(model, row, state, c, dx, dv, Sz)
                    slopes[(row[Z_FIRST] + state) * columns + c] += pace * (rate if moving == 1 else -rate)


@plain
def _hold(
    model: Model, i: int, row: Integers, amplitude: float, z: Floats, Sz: Floats, side: float, room: Floats
) -> None:
    """Let the states of effect ``i`` come to rest at a held displacement, if they are not at rest already."""
    n = row[Z_LAST] - row[Z_FIRST]
    width = 2 + row[P_LAST] - row[P_FIRST] + n
    first = row[Z_FIRST]
    columns = model.columns
    matrix = room
    right = shifted(room, n * n)
    for attempt in range(_NEWTON_STEPS):
        state_rates(model, amplitude, 0.0, side, z, model.fz)
        size = 0.0
        for j in range(n):
            size += abs(model.fz[first + j])
        if not size > 0.0:
            if attempt == 0:
                return
            break
        state_rate_gradients(model, i, amplitude, 0.0, side, z)
        for j in range(n):
            right[j] = -model.fz[first + j]
            for k in range(n):
                matrix[j * n + k] = model.scratch[j * width + width - n + k]
        if not _solve(matrix, right, n):
            return
        change = 0.0
        largest = 0.0
        for j in range(n):
            z[first + j] += right[j]
            change += abs(right[j])
            largest += abs(z[first + j])
        if not change > 1e-14 * largest:
            break
    state_rate_gradients(model, i, amplitude, 0.0, side, z)
    for c in range(columns):
        for j in range(n):
            for k in range(n):
                matrix[j * n + k] = model.scratch[j * width + width - n + k]
            total = model.scratch[j * width] if c == 0 else 0.0
            if row[P_FIRST] <= c - 1 < row[P_LAST]:
                total += model.scratch[j * width + 2 + c - 1 - row[P_FIRST]]
            right[j] = -total
        if not _solve(matrix, right, n):
            return
        for j in range(n):
            Sz[(first + j) * columns + c] = right[j]


@plain
def _solve(matrix: Floats, right: Floats, n: int) -> bool:
    """Solve a small linear system in place by elimination with pivoting; return whether it could be solved."""
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i * n + k]) > abs(matrix[pivot * n + k]):
                pivot = i
        if not abs(matrix[pivot * n + k]) > 0.0:
            return False
        if pivot != k:
            for j in range(n):
                matrix[k * n + j], matrix[pivot * n + j] = matrix[pivot * n + j], matrix[k * n + j]
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, n):
            factor = matrix[i * n + k] / matrix[k * n + k]
            for j in range(k, n):
                matrix[i * n + j] -= factor * matrix[k * n + j]
            right[i] -= factor * right[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= matrix[k * n + j] * right[j]
        right[k] /= matrix[k * n + k]
    return True
