"""Kinks of a force inside a half cycle: where they are, and how a step gets over them. Arguments are pointers."""

from __future__ import annotations

import numpy as np

from .forces import Model, smooth_branch, state_rates
from .instants import hermite_position, sensitivity_slopes
from .pointers import Floats, shifted
from .states import state_slopes
from .switches import plain

HOP = 2e-7  # radians from just before a kink to just behind it (error: its square)
# The last stage of a long step is less exact than its end and would look beyond a kink close behind it: so a long step
# ends this far (in radians) before a kink, and a short one follows.
KINK_MARGIN = 0.03
KINK_WINDOW = 0.08  # radians within which a Taylor polynomial finds a kink (error: their fourth power / 24)


@plain
def fraction_before_kink(
    model: Model, y: Floats, a: float, y1: Floats, a1: float, h: float, label: int, direction: float,
    precision: float, rates: Floats, moving: bool, middle: Floats,
) -> float:  # fmt: skip
    """Return the share of a step at which the label of the smooth branch changes, by bisection.

    ``rates`` holds the states' rates at the start, where they are ``moving``; those at the end are computed.
    """
    low, high = 0.0, 1.0
    if moving:
        state_rates(model, y1[0], y1[1], direction, shifted(y1, 2), model.fz)
    while high - low > precision:
        t = 0.5 * (low + high)
        x = hermite_position(y[0], y[1], a, y1[0], y1[1], a1, h, t)
        v = y[1] + t * (y1[1] - y[1])
        for j in range(model.n_states):
            middle[j] = y[2 + j]
            if moving:
                rise = y1[2 + j] - y[2 + j]
                middle[j] += t * t * (3.0 - 2.0 * t) * rise
                middle[j] += h * t * (1.0 - t) * ((1.0 - t) * rates[j] - t * model.fz[j])
        if smooth_branch(model, x, v, direction, middle) == label:
            low = t
        else:
            high = t
    return high


@plain
def time_to_kink(
    model: Model, y: Floats, y1: Floats, a: float, jerk: float, window: float, label: int, direction: float,
    precision: float, rates: Floats, moving: bool, middle: Floats,
) -> float:  # fmt: skip
    """Return when within ``window`` the label of the smooth branch changes, by a Taylor polynomial, or inf."""
    y1[0] = y[0] + window * (y[1] + window * (0.5 * a + window * jerk / 6.0))
    y1[1] = y[1] + window * (a + 0.5 * window * jerk)
    for j in range(model.n_states):
        y1[2 + j] = y[2 + j] + (window * rates[j] if moving else 0.0)
    if smooth_branch(model, y1[0], y1[1], direction, shifted(y1, 2)) == label:
        return np.inf
    share = fraction_before_kink(
        model, y, a, y1, a + window * jerk, window, label, direction, precision / window, rates, moving, middle
    )
    return share * window


@plain
def hop_over(
    model: Model, y: Floats, y1: Floats, a: float, direction: float, step: float, moving: bool, K: Floats,
    room: Floats,
) -> None:  # fmt: skip
    """Take an Euler step, so short that what it passes over does not matter."""
    columns = model.columns
    rows = 2 + model.n_states
    if moving:
        state_slopes(model, y, direction, K)
        for k in range(rows * (1 + columns)):
            y1[k] = y[k] + step * K[k]
        return
    y1[0] = y[0] + step * y[1]
    y1[1] = y[1] + step * a
    sensitivity_slopes(model, y, direction, room)
    for c in range(columns):
        y1[rows + c] = y[rows + c] + step * y[rows + columns + c]
        y1[rows + columns + c] = y[rows + columns + c] + step * room[c]
