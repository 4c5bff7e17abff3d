"""What jumps from level to level ask of an oscillator: whether it is its own mirror image, what its states weigh.

Compiled once as native functions with a name, like the half cycle: both reach into the forces of all effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from numba import float64, int64

from .._common.compiled import NativeFunction
from .forces import KIND, MEMORY, OWN_EQUATION, ROW, Z_FIRST, Z_LAST, Model, force_gradient, state_rates
from .memory import model_of, place_of
from .pointers import FLOATS, INTEGERS, Floats, Integers, shifted
from .switches import plain

_PLACES = 12  # displacements that are looked at on either side, up to a little more than the amplitude
_ODD = 1e-9  # of the largest force: what rounding leaves of a sum that is zero ...
_ODD_SLOPE = 1e-6  # ... and of one slope, which may be a difference


@plain
def _set_states(model: Model, side: float, reach: float, z: Floats) -> None:
    """Write states as they may be at a turning point at ``reach`` on one side, or their mirror image."""
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        for j in range(row[Z_FIRST], row[Z_LAST]):
            z[j] = 0.3 * side * reach
        if row[KIND] == MEMORY:
            z[row[Z_FIRST]] = side * reach
            z[row[Z_FIRST] + 1] = 0.0
            z[row[Z_FIRST] + 2] = 1.0


@plain
def _is_one_past(model: Model) -> bool:
    """Return whether each effect remembers one number and goes on remembering; ``fz`` holds the force's slopes."""
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[KIND] == OWN_EQUATION and row[Z_LAST] - row[Z_FIRST] != 1:
            return False
        if row[KIND] == MEMORY and not abs(model.fz[row[Z_FIRST] + 1]) > 0.0:
            return False
    return True


@plain
def _is_symmetric(run: Integers, memory: Floats, p: Floats, amplitude: float, slopes: int) -> int:
    place = place_of(run)
    model = model_of(run, memory, p, place)
    z = shifted(memory, place.next + 2)
    kept = shifted(z, model.n_states)
    _set_states(model, 1.0, amplitude, z)
    force, _, _ = force_gradient(model, amplitude, 0.0, -1.0, z)
    largest = 0.0
    for sample in range(_PLACES):
        x = amplitude * (sample + 0.55) / (_PLACES - 0.5)
        speed = math.sqrt(abs(force) / (model.mass * amplitude)) * (1.25 * amplitude - x)
        for way in range(2):
            direction = 1.0 - 2.0 * way
            _set_states(model, -direction, amplitude, z)
            one, _, _ = force_gradient(model, x, direction * speed, direction, z)
            if not _is_one_past(model):
                return 0
            state_rates(model, x, direction * speed, direction, z, model.fz)
            for j in range(model.n_states):
                kept[j] = model.fz[j]
            for j in range(model.n_parameters if slopes != 0 else 0):
                kept[model.n_states + j] = model.fp[j]
            _set_states(model, direction, amplitude, z)
            other, _, _ = force_gradient(model, -x, -direction * speed, -direction, z)
            state_rates(model, -x, -direction * speed, -direction, z, model.fz)
            largest = max(largest, abs(one))
            if not abs(one + other) <= _ODD * largest:
                return 0
            for j in range(model.n_states):
                if not abs(kept[j] + model.fz[j]) <= _ODD * (abs(kept[j]) + speed):
                    return 0
            for j in range(model.n_parameters if slopes != 0 else 0):
                slope = kept[model.n_states + j]
                if not abs(slope + model.fp[j]) <= _ODD_SLOPE * (abs(slope) + abs(model.fp[j])):
                    return 0
    return 1


@plain
def _weigh_states(run: Integers, memory: Floats, p: Floats, out: Floats) -> int:
    place = place_of(run)
    model = model_of(run, memory, p, place)
    y = shifted(memory, place.now)
    force, _, _ = force_gradient(model, y[0], 0.0, -1.0, shifted(y, 2))
    for j in range(model.n_states):
        out[j] = abs(model.fz[j] / force)
    return 0


IS_SYMMETRIC = NativeFunction("is_symmetric", int64(INTEGERS, FLOATS, FLOATS, float64, int64), _is_symmetric)
is_symmetric: Callable[[Integers, Floats, Floats, float, int], int] = IS_SYMMETRIC.call
"""``is_symmetric(run, memory, p, amplitude, slopes) -> 0 or 1``: whether each motion up to the amplitude has a mirror
image that is one, too, and, if asked, whether that holds for other parameters as well.

Not so, for what asks, is an effect with several states that have an equation, and a slider that slips: where it locks
once the amplitude is too small decides the mid-line from then on, and only the whole decay comes to that cycle."""
WEIGH_STATES = NativeFunction("weigh_states", int64(INTEGERS, FLOATS, FLOATS, FLOATS), _weigh_states)
weigh_states: Callable[[Integers, Floats, Floats, Floats], int] = WEIGH_STATES.call
"""``weigh_states(run, memory, p, out) -> 0``: what one of each state changes, at a turning point, as a share of all
force there."""
