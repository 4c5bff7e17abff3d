"""What is measured, and its sensitivities, between the steps of the integrator at instants asked for.

Displacement, velocity or acceleration. Arguments are pointers.
"""

from __future__ import annotations

from typing import NamedTuple

from .forces import Model, force_gradient, total_force
from .pointers import Floats, shifted
from .switches import plain

DISPLACEMENT, VELOCITY, ACCELERATION = range(3)  # how often the displacement is differentiated
_SHORT = 0.01  # radians; in shorter steps what lifts a polynomial drowns in rounding, and is below it


class Samples(NamedTuple):
    """Instants [s]; room for the quantity and its derivatives; whether these are wanted, how many, which quantity.

    Derivatives are those with respect to release amplitude, parameters and time.
    """

    time: Floats
    values: Floats
    slopes: Floats
    sensitivities: bool
    size: int
    quantity: int


@plain
def hermite_position(x0: float, v0: float, a0: float, x1: float, v1: float, a1: float, h: float, theta: float) -> float:
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


@plain
def hermite_velocity(x0: float, v0: float, a0: float, x1: float, v1: float, a1: float, h: float, theta: float) -> float:
    """Return the time derivative of `hermite_position`."""
    rest = 1.0 - theta
    inner = theta * rest
    return (
        30.0 * inner * inner * (x1 - x0) / h
        + v0 * rest * rest * (1.0 + theta * (2.0 - 15.0 * theta))
        + v1 * theta * theta * (1.0 + rest * (2.0 - 15.0 * rest))
        + 0.5 * h * inner * (a0 * rest * (2.0 - 5.0 * theta) - a1 * theta * (2.0 - 5.0 * rest))
    )


@plain
def hermite_acceleration(
    x0: float, v0: float, a0: float, x1: float, v1: float, a1: float, h: float, theta: float
) -> float:
    """Return the second time derivative of `hermite_position`."""
    rest = 1.0 - theta
    return (
        60.0 * theta * rest * (rest - theta) * (x1 - x0) / (h * h)
        + 12.0 * theta * rest * (v0 * (5.0 * theta - 3.0) + v1 * (5.0 * theta - 2.0)) / h
        + a0 * rest * (1.0 + theta * (10.0 * theta - 8.0))
        + a1 * theta * (1.0 + rest * (10.0 * rest - 8.0))
    )


@plain
def _missed_jerk(
    x0: float, v0: float, a0: float, jerk0: float, x1: float, v1: float, a1: float, jerk1: float, h: float
) -> tuple[float, float]:
    """Return the jerk at both ends less that of the quintic of `hermite_position`."""
    d = 60.0 * (x1 - x0) / (h * h * h)
    left = d - (36.0 * v0 + 24.0 * v1) / (h * h) + (-9.0 * a0 + 3.0 * a1) / h
    right = d - (24.0 * v0 + 36.0 * v1) / (h * h) + (-3.0 * a0 + 9.0 * a1) / h
    return jerk0 - left, jerk1 - right


@plain
def sensitivity_slopes(model: Model, y: Floats, direction: float, out: Floats) -> None:
    """Write the acceleration's total derivatives, one per column of the sensitivities behind ``y``, into ``out``."""
    columns = model.columns
    _, fx, fv = force_gradient(model, y[0], y[1], direction, shifted(y, 2))
    S = shifted(y, 2 + model.n_states)
    for c in range(columns):
        total = fx * S[c] + fv * S[columns + c]
        for j in range(model.n_states):
            total += model.fz[j] * S[(2 + j) * columns + c]
        if c > 0:
            total += model.fp[c - 1]
        out[c] = -total / model.mass


@plain
def write_samples(
    model: Model, y: Floats, a0: float, jerk0: float, y1: Floats, a1: float, jerk1: float, start: float, h: float,
    smooth: bool, moving: bool, cursor: int, until: float, direction: float, dt: Floats, room: Floats, samples: Samples,
) -> int:  # fmt: skip
    """Write the quantity and its sensitivities at the instants up to ``until`` in a step from ``y`` to ``y1``.

    Where the step is ``smooth``, the jerk at both ends lifts the displacement's quintic to a septic. The sensitivities
    behind the state are those at a fixed time since the last turning point; that moves by ``dt``. Returns how many
    instants are done.
    """
    if cursor >= samples.size or samples.time[cursor] > until:
        return cursor
    columns = model.columns if samples.sensitivities else 0
    slope0 = room
    slope1 = shifted(room, columns)
    if columns > 0:
        sensitivity_slopes(model, y, direction, slope0)
        sensitivity_slopes(model, y1, direction, slope1)
    left, right, velocity = 0.0, 0.0, 0.0
    if smooth:
        left, right = _missed_jerk(y[0], y[1], a0, jerk0, y1[0], y1[1], a1, jerk1, h)
    S = shifted(y, 2 + model.n_states)
    S1 = shifted(y1, 2 + model.n_states)
    while cursor < samples.size and samples.time[cursor] <= until:
        theta = (samples.time[cursor] - start) / h
        rest = 1.0 - theta
        bump = h * theta * rest
        x = (
            hermite_position(y[0], y[1], a0, y1[0], y1[1], a1, h, theta)
            + bump * bump * bump * (left * rest - right * theta) / 6.0
        )
        slopes = shifted(samples.slopes, cursor * (columns + 1))
        if samples.quantity != DISPLACEMENT:
            lifted = smooth and h * model.scales[1] > _SHORT * model.scales[0]
            samples.values[cursor] = _rate(
                model, y, a0, jerk0, y1, a1, jerk1, h, x, theta, lifted, moving, direction, dt, slope0, slope1,
                columns, samples.quantity, slopes,
            )  # fmt: skip
            cursor += 1
            continue
        samples.values[cursor] = x
        if columns > 0:
            velocity = hermite_position(y[1], a0, jerk0, y1[1], a1, jerk1, h, theta)
            slopes[columns] = velocity
        for c in range(columns):
            since_turning = hermite_position(
                S[c], S[columns + c], slope0[c], S1[c], S1[columns + c], slope1[c], h, theta
            )
            slopes[c] = since_turning - velocity * dt[c]
        cursor += 1
    return cursor


@plain
def _rate(
    model: Model, y: Floats, a0: float, jerk0: float, y1: Floats, a1: float, jerk1: float, h: float, x: float,
    theta: float, lifted: bool, moving: bool, direction: float, dt: Floats, slope0: Floats, slope1: Floats,
    columns: int, quantity: int, slopes: Floats,
) -> float:  # fmt: skip
    """Return velocity or acceleration at ``theta`` of a step, and write its derivatives into ``slopes``.

    The velocity is the quintic through velocity, acceleration and jerk at both ends, ``lifted`` to have the
    displacement's rise for its integral. The acceleration follows from the equation of motion, where no state moves;
    where one does, from the derivative of the velocity, which is smoother than states between the steps.
    """
    inner = theta * (1.0 - theta)
    tilt = 1.0 - 2.0 * theta
    lift = 0.0
    if lifted:
        rise = 0.5 * (y[1] + y1[1]) + h * (0.1 * (a0 - a1) + h * (jerk0 + jerk1) / 120.0)
        lift = 140.0 * ((y1[0] - y[0]) / h - rise)
    v = hermite_position(y[1], a0, jerk0, y1[1], a1, jerk1, h, theta) + lift * inner * inner * inner
    if quantity == ACCELERATION and not moving:
        return _by_equation(model, y, y1, h, x, v, theta, direction, dt, slope0, slope1, columns, slopes)
    a = hermite_velocity(y[1], a0, jerk0, y1[1], a1, jerk1, h, theta) + 3.0 * lift * inner * inner * tilt / h
    if quantity == VELOCITY:
        _velocity_slopes(model, y, y1, h, a, theta, dt, slope0, slope1, columns, slopes)
        return v
    jerk = jerk0 + theta * (jerk1 - jerk0)
    if lifted:
        jerk = hermite_acceleration(y[1], a0, jerk0, y1[1], a1, jerk1, h, theta)
        jerk += 6.0 * lift * inner * (tilt * tilt - inner) / (h * h)
    _acceleration_slopes(model, y, y1, h, jerk, theta, lifted, dt, slope0, slope1, columns, slopes)
    return a


@plain
def _by_equation(
    model: Model, y: Floats, y1: Floats, h: float, x: float, v: float, theta: float, direction: float, dt: Floats,
    slope0: Floats, slope1: Floats, columns: int, slopes: Floats,
) -> float:  # fmt: skip
    """Return the acceleration that the equation of motion gives, and write its derivatives."""
    z = shifted(y, 2)
    if columns == 0:
        return -total_force(model, x, v, direction, z) / model.mass
    S = shifted(y, 2 + model.n_states)
    S1 = shifted(y1, 2 + model.n_states)
    force, fx, fv = force_gradient(model, x, v, direction, z)
    a = -force / model.mass
    jerk = -(fx * v + fv * a) / model.mass
    slopes[columns] = jerk
    for c in range(columns):
        total = fx * hermite_position(S[c], S[columns + c], slope0[c], S1[c], S1[columns + c], slope1[c], h, theta)
        total += fv * hermite_velocity(S[c], S[columns + c], slope0[c], S1[c], S1[columns + c], slope1[c], h, theta)
        for j in range(model.n_states):
            total += model.fz[j] * S[(2 + j) * columns + c]
        if c > 0:
            total += model.fp[c - 1]
        slopes[c] = -total / model.mass - jerk * dt[c]
    return a


@plain
def _velocity_slopes(
    model: Model, y: Floats, y1: Floats, h: float, a: float, theta: float, dt: Floats, slope0: Floats,
    slope1: Floats, columns: int, slopes: Floats,
) -> None:  # fmt: skip
    """Write the derivatives of the velocity at a fixed time; the last is the acceleration ``a``."""
    S = shifted(y, 2 + model.n_states)
    S1 = shifted(y1, 2 + model.n_states)
    if columns > 0:
        slopes[columns] = a
    for c in range(columns):
        since_turning = hermite_velocity(S[c], S[columns + c], slope0[c], S1[c], S1[columns + c], slope1[c], h, theta)
        slopes[c] = since_turning - a * dt[c]


@plain
def _acceleration_slopes(
    model: Model, y: Floats, y1: Floats, h: float, jerk: float, theta: float, lifted: bool, dt: Floats,
    slope0: Floats, slope1: Floats, columns: int, slopes: Floats,
) -> None:  # fmt: skip
    """Write the derivatives of an acceleration that is a derivative itself; the last is the ``jerk``."""
    S = shifted(y, 2 + model.n_states)
    S1 = shifted(y1, 2 + model.n_states)
    if columns > 0:
        slopes[columns] = jerk
    for c in range(columns):
        since_turning = slope0[c] + theta * (slope1[c] - slope0[c])
        if lifted:
            since_turning = hermite_acceleration(
                S[c], S[columns + c], slope0[c], S1[c], S1[columns + c], slope1[c], h, theta
            )
        slopes[c] = since_turning - jerk * dt[c]
