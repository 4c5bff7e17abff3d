"""Displacement and sensitivities between the steps of the integrator, at instants asked for. Arguments are pointers."""

from __future__ import annotations

from typing import NamedTuple

from .forces import Model, force_gradient, plain
from .pointers import Floats, shifted


class Samples(NamedTuple):
    """Instants [s], room for displacement and derivatives, whether these are wanted, how many instants."""

    time: Floats
    displacement: Floats
    slopes: Floats
    sensitivities: bool
    size: int


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
    smooth: bool, cursor: int, until: float, direction: float, dt: Floats, room: Floats, samples: Samples,
) -> int:  # fmt: skip
    """Write displacement and sensitivities at the instants up to ``until`` in a step from ``y`` to ``y1``.

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
        samples.displacement[cursor] = (
            hermite_position(y[0], y[1], a0, y1[0], y1[1], a1, h, theta)
            + bump * bump * bump * (left * rest - right * theta) / 6.0
        )
        if columns > 0:
            velocity = hermite_position(y[1], a0, jerk0, y1[1], a1, jerk1, h, theta)
        for c in range(columns):
            since_turning = hermite_position(
                S[c], S[columns + c], slope0[c], S1[c], S1[columns + c], slope1[c], h, theta
            )
            samples.slopes[cursor * columns + c] = since_turning - velocity * dt[c]
        cursor += 1
    return cursor
