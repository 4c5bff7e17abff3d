"""The total force of an oscillator, composed from its effects without recompiling anything.

Library effects are reached through one switch over their codes, so that the integrator is compiled once for
all models and kept on disk. Effects written by a user are reached through one compiled function pointer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from .._common.checks import InputError
from ..effects import BASE_EFFECTS, LIBRARY, Effect
from .pointers import Floats, Integers, function_type, shifted, view
from .switches import (
    CODES,
    ROOMY,
    library_added_mass,
    library_added_slopes,
    library_force,
    library_kept,
    library_rate,
    library_rate_gradient,
    library_regime,
    library_slopes,
    plain,
    roomy_force,
    roomy_kept,
    roomy_regime,
    roomy_slopes,
)

FORCE, GRADIENT, REGIME, RATE, RATE_GRADIENT, ADDED_MASS, ADDED_MASS_GRADIENT = range(7)
REMEMBERED, REMEMBERED_GRADIENT = range(7, 9)
NO_USER_EFFECT = 0  # the address where there are library effects only
USER = 1_000_000  # codes from here on are effects written by the user
NO_STATE, MEMORY, OWN_EQUATION = range(3)


class Model(NamedTuple):
    """What the integrator knows of an oscillator; all but the counts and the mass are pointers.

    Address of the user's effects, one row of ``table`` for each effect but linear stiffness and viscous damping, where
    these two stand among the parameters ``p``, how many sensitivities are carried (``columns``); amplitude and speed of
    the motion and sizes of the states (``scales``), room for derivatives, and behind ``scratch`` that of the effects.
    Compiled calls pass all of this along, so each more of it costs.
    """

    user: int
    table: Integers
    n_effects: int
    stiffness: int
    damping: int
    n_states: int
    n_parameters: int
    columns: int
    mass: float
    p: Floats
    scales: Floats
    user_scales: Floats
    fp: Floats
    fz: Floats
    scratch: Floats


# Columns of the table, and their number; behind its rows where the room of each effect begins, and its size.
CODE, P_FIRST, P_LAST, Z_FIRST, Z_LAST, KIND, ADDS_MASS, ROW = range(8)
ROOM = 2

USER_SIGNATURE = float64(
    int64, int64, float64, float64, float64, float64[::1], float64[::1], float64[::1], float64[::1]
)
function_at = function_type(USER_SIGNATURE)


class Described(NamedTuple):
    """What is known of effects before any number is: their table, and what `Model` names alike.

    ``rooms``: where the room of each begins, and its size; ``n_room``: numbers of room that all of them need together;
    ``users``: those that are not the library's.
    """

    table: NDArray[np.int64]
    rooms: NDArray[np.int64]
    stiffness: int
    damping: int
    n_states: int
    n_room: int
    has_regime: bool
    users: tuple[Effect, ...]


def describe_effects(effects: Sequence[Effect]) -> Described:
    """Return the table of some effects, and what else the integrator is told of them."""
    rows, rooms, users = [], [], []
    place = {}
    p_first, z_first, room_first = 0, 0, 0
    for effect in effects:
        p_last, z_last = p_first + len(effect.parameters), z_first + effect.n_states
        if LIBRARY.get(effect.name) is not effect:
            users.append(effect)
            code = USER + len(users) - 1
        else:
            code = CODES[effect.name]
        if code < USER and effect.name in BASE_EFFECTS:
            place[effect.name] = p_first
        else:
            kind = MEMORY if effect.has_memory else OWN_EQUATION if effect.n_states else NO_STATE
            # behind a copy of the parameters, so that an effect sees both as one array
            n_room = len(effect.parameters) + effect.n_room if effect.n_room else 0
            rows.append((code, p_first, p_last, z_first, z_last, kind, int(effect.added_mass is not None)))
            rooms.append((room_first, effect.n_room))
            room_first += n_room
        p_first, z_first = p_last, z_last
    for name in BASE_EFFECTS:
        if name not in place:
            raise InputError(f"effect {name!r} is built in; give your own another name and fix the built-in one at 0.")
    table = np.array(rows, dtype=np.int64).reshape(-1, ROW)
    has_regime = any(effect.regime is not None for effect in effects)
    stiffness, damping = (place[name] for name in BASE_EFFECTS)
    room = np.array(rooms, dtype=np.int64).reshape(-1, ROOM)
    return Described(table, room, stiffness, damping, z_first, room_first, has_regime, tuple(users))


@plain
def _n_room(model: Model, i: int) -> int:
    """Return the size of the room of effect ``i``."""
    return shifted(model.table, ROW * model.n_effects + ROOM * i)[1]


@plain
def _own_numbers(model: Model, i: int) -> Floats:
    """Return the parameters of effect ``i``; where it has room of its own, a copy of them before that room."""
    row = shifted(model.table, ROW * i)
    p = shifted(model.p, row[P_FIRST])
    if _n_room(model, i) == 0:
        return p
    first = shifted(model.table, ROW * model.n_effects + ROOM * i)[0]
    room = shifted(model.scratch, scratch_size(model.n_parameters, model.n_states) + first)
    for j in range(row[P_LAST] - row[P_FIRST]):
        room[j] = p[j]
    return room


@plain
def scratch_size(n_parameters: int, n_states: int) -> int:
    """Return how many numbers there are to be in a model's scratch, before the room of its effects."""
    return (2 + n_parameters + n_states) * max(1, n_states)


@plain
def _call_user(
    model: Model, kind: int, i: int, x: float, v: float, direction: float, z: Floats, out: Floats, size: int
) -> float:
    """Call the user's effects, with what difference steps are measured by: amplitude, speed, size of each state."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    sizes = view(model.user_scales, 0, 2 + n_z)
    sizes[0] = model.scales[0]
    sizes[1] = model.scales[1]
    for j in range(n_z):
        sizes[2 + j] = model.scales[2 + row[Z_FIRST] + j]
    p = view(_own_numbers(model, i), 0, row[P_LAST] - row[P_FIRST] + _n_room(model, i))
    return function_at(model.user)(kind, row[CODE], x, v, direction, view(z, 0, n_z), p, sizes, view(out, 0, size))


@plain
def effect_force(model: Model, i: int, x: float, v: float, direction: float, z: Floats) -> float:
    """Return the force of effect ``i`` [N]."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < ROOMY:
        return library_force(row[CODE], x, v, direction, zi, n_z, pi, n_p)
    if row[CODE] < USER:
        return roomy_force(row[CODE], x, v, direction, zi, n_z, _own_numbers(model, i), n_p, _n_room(model, i))
    return _call_user(model, FORCE, i, x, v, direction, zi, model.scratch, 0)


@plain
def effect_slopes(model: Model, i: int, x: float, v: float, direction: float, z: Floats) -> float:
    """Return the force of effect ``i`` [N] and write dF/dx, dF/dv, dF/dp, dF/dz into the model's scratch."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < ROOMY:
        return library_slopes(row[CODE], x, v, direction, zi, n_z, pi, n_p, model.scratch)
    if row[CODE] < USER:
        room = _own_numbers(model, i)
        return roomy_slopes(row[CODE], x, v, direction, zi, n_z, room, n_p, _n_room(model, i), model.scratch)
    _call_user(model, GRADIENT, i, x, v, direction, zi, model.scratch, 2 + n_p + n_z)
    return _call_user(model, FORCE, i, x, v, direction, zi, model.scratch, 0)


@plain
def remembered_slopes(model: Model, i: int, x: float, direction: float, z: Floats) -> float:
    """Return what effect ``i`` keeps of a turning point; write its slopes, as those of a force, into the scratch."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < ROOMY:
        return library_kept(row[CODE], x, 0.0, direction, zi, n_z, pi, n_p, model.scratch)
    if row[CODE] < USER:
        room = _own_numbers(model, i)
        return roomy_kept(row[CODE], x, 0.0, direction, zi, n_z, room, n_p, _n_room(model, i), model.scratch)
    _call_user(model, REMEMBERED_GRADIENT, i, x, 0.0, direction, zi, model.scratch, 2 + n_p + n_z)
    return _call_user(model, REMEMBERED, i, x, 0.0, direction, zi, model.scratch, 0)


@plain
def _added_slopes(model: Model, i: int, x: float) -> float:
    """Return the mass that effect ``i`` adds [kg] and write dm/dx, dm/dp into the model's scratch."""
    row = shifted(model.table, ROW * i)
    n_p = row[P_LAST] - row[P_FIRST]
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < USER:
        return library_added_slopes(row[CODE], x, 0.0, 0.0, pi, 0, pi, n_p, model.scratch)
    _call_user(model, ADDED_MASS_GRADIENT, i, x, 0.0, 0.0, pi, model.scratch, 1 + n_p)
    return _call_user(model, ADDED_MASS, i, x, 0.0, 0.0, pi, model.scratch, 0)


@plain
def sum_of_forces(model: Model, x: float, v: float, direction: float, z: Floats) -> float:
    """Return the sum of all forces [N], without what added masses make of it."""
    total = model.p[model.stiffness] * x + model.p[model.damping] * v
    for i in range(model.n_effects):
        total += effect_force(model, i, x, v, direction, z)
    return total


@plain
def added_mass(model: Model, x: float) -> float:
    """Return the mass that all effects add at a displacement [kg]."""
    added = 0.0
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[ADDS_MASS] == 0:
            continue
        pi = shifted(model.p, row[P_FIRST])
        if row[CODE] < USER:
            added += library_added_mass(row[CODE], x, 0.0, 0.0, pi, 0, pi, row[P_LAST] - row[P_FIRST])
        else:
            added += _call_user(model, ADDED_MASS, i, x, 0.0, 0.0, pi, model.scratch, 0)
    return added


@plain
def _lighter(model: Model, added: float) -> float:
    """Return the mass over what moves along at a displacement; nan where nothing does."""
    whole = model.mass + added
    return model.mass / whole if whole > 0.0 else math.nan


@plain
def total_force(model: Model, x: float, v: float, direction: float, z: Floats) -> float:
    """Return the force that accelerates the mass [N]: the sum of all forces, less where mass is added.

    Minus this over the mass is the acceleration, whatever moves along.
    """
    total = sum_of_forces(model, x, v, direction, z)
    added = added_mass(model, x)
    return total if added == 0.0 else total * _lighter(model, added)


@plain
def force_slopes(model: Model, x: float, v: float, direction: float, z: Floats) -> tuple[float, float, float]:
    """Return the total force [N], dF/dx and dF/dv."""
    fx = model.p[model.stiffness]
    fv = model.p[model.damping]
    total = fx * x + fv * v
    added, slope = 0.0, 0.0
    for i in range(model.n_effects):
        total += effect_slopes(model, i, x, v, direction, z)
        fx += model.scratch[0]
        fv += model.scratch[1]
        if shifted(model.table, ROW * i)[ADDS_MASS] != 0:
            added += _added_slopes(model, i, x)
            slope += model.scratch[0]
    if added == 0.0 and slope == 0.0:
        return total, fx, fv
    share = _lighter(model, added)
    total *= share
    return total, fx * share - total * slope / (model.mass + added), fv * share


@plain
def force_gradient(model: Model, x: float, v: float, direction: float, z: Floats) -> tuple[float, float, float]:
    """Return the total force [N], dF/dx and dF/dv, and write dF/dp and dF/dz into the model's ``fp`` and ``fz``."""
    fx = model.p[model.stiffness]
    fv = model.p[model.damping]
    total = fx * x + fv * v
    model.fp[model.stiffness] = x
    model.fp[model.damping] = v
    added, slope, adds_mass = 0.0, 0.0, False
    for i in range(model.n_effects):
        total += effect_slopes(model, i, x, v, direction, z)
        fx += model.scratch[0]
        fv += model.scratch[1]
        row = shifted(model.table, ROW * i)
        k = 2
        for j in range(row[P_FIRST], row[P_LAST]):
            model.fp[j] = model.scratch[k]
            k += 1
        for j in range(row[Z_FIRST], row[Z_LAST]):
            model.fz[j] = model.scratch[k]
            k += 1
        if row[ADDS_MASS] != 0:
            adds_mass = True
            added += _added_slopes(model, i, x)
            slope += model.scratch[0]
    if not adds_mass:
        return total, fx, fv
    share, whole = _lighter(model, added), model.mass + added
    total *= share
    for j in range(model.n_parameters):
        model.fp[j] *= share
    for j in range(model.n_states):
        model.fz[j] *= share
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[ADDS_MASS] != 0:
            _added_slopes(model, i, x)
            for j in range(row[P_FIRST], row[P_LAST]):
                model.fp[j] -= total * model.scratch[1 + j - row[P_FIRST]] / whole
    return total, fx * share - total * slope / whole, fv * share


@plain
def smooth_branch(model: Model, x: float, v: float, direction: float, z: Floats) -> int:
    """Return one integer that labels the smooth branch of all forces together."""
    label = 0
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        n_z = row[Z_LAST] - row[Z_FIRST]
        n_p = row[P_LAST] - row[P_FIRST]
        zi = shifted(z, row[Z_FIRST])
        pi = shifted(model.p, row[P_FIRST])
        if row[CODE] < ROOMY:
            label = 7 * label + library_regime(row[CODE], x, v, direction, zi, n_z, pi, n_p)
        elif row[CODE] < USER:
            room = _own_numbers(model, i)
            label = 7 * label + roomy_regime(row[CODE], x, v, direction, zi, n_z, room, n_p, _n_room(model, i))
        else:
            label = 7 * label + int(_call_user(model, REGIME, i, x, v, direction, zi, model.scratch, 0))
    return label


@plain
def state_rates(model: Model, x: float, v: float, direction: float, z: Floats, out: Floats) -> None:
    """Write dz/dt of all states into ``out``; states that remember a turning point do not move."""
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        n_z = row[Z_LAST] - row[Z_FIRST]
        n_p = row[P_LAST] - row[P_FIRST]
        zi = shifted(z, row[Z_FIRST])
        pi = shifted(model.p, row[P_FIRST])
        rates = shifted(out, row[Z_FIRST])
        if row[KIND] != OWN_EQUATION:
            for j in range(n_z):
                rates[j] = 0.0
        elif row[CODE] < USER:
            library_rate(row[CODE], x, v, direction, zi, n_z, pi, n_p, rates)
        else:
            _call_user(model, RATE, i, x, v, direction, zi, rates, n_z)


@plain
def state_rate_gradients(model: Model, i: int, x: float, v: float, direction: float, z: Floats) -> None:
    """Write the derivatives of dz/dt of effect ``i`` into the model's scratch, row by row."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < USER:
        library_rate_gradient(row[CODE], x, v, direction, zi, n_z, pi, n_p, model.scratch)
    else:
        size = n_z * (2 + n_p + n_z)
        _call_user(model, RATE_GRADIENT, i, x, v, direction, zi, model.scratch, size)
