"""The total force of an oscillator, composed from its effects without recompiling anything.

Library effects are reached through one switch over their codes, so that the integrator is compiled once for
all models and kept on disk. Effects written by a user are reached through one compiled function pointer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import float64, int64
from numpy.typing import NDArray

from .._common.checks import InputError
from ..effects import BASE_EFFECTS, LIBRARY, Effect
from .pointers import Floats, Integers, function_type, matrix, shifted, view

FORCE, GRADIENT, REGIME, RATE, RATE_GRADIENT, ADDED_MASS, ADDED_MASS_GRADIENT = range(7)
NO_USER_EFFECT = 0  # the address where there are library effects only
USER = 1_000_000  # codes from here on are effects written by the user
NO_STATE, MEMORY, OWN_EQUATION = range(3)


class Model(NamedTuple):
    """What the integrator knows of an oscillator; all but the counts and the mass are pointers.

    Address of the user's effects, one row of ``table`` for each effect but linear stiffness and viscous damping, where
    these two stand among the parameters ``p``, how many sensitivities are carried (``columns``); amplitude and speed of
    the motion and sizes of the states (``scales``), room for derivatives.
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


CODE, P_FIRST, P_LAST, Z_FIRST, Z_LAST, KIND, ADDS_MASS, ROW = range(8)  # columns of the table and their number

USER_SIGNATURE = float64(
    int64, int64, float64, float64, float64, float64[::1], float64[::1], float64[::1], float64[::1]
)
function_at = function_type(USER_SIGNATURE)

_plain = numba.njit(_nrt=False, error_model="numpy", fastmath={"contract"})


def plain[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of the hot path; to the type checker it stays what it was.

    None of them allocates, and without reference counting they are six times as fast. Division by zero gives inf or
    nan, which the integrator looks for, instead of an exception.
    """
    compiled: Callable[P, R] = _plain(function)
    return compiled


def _switch(
    cases: Sequence[tuple[int, Sequence[Any]]], arrays: Sequence[str], result: str, given: str = "x, v, direction, z, p"
) -> Any:
    """Return one compiled ``f(code, x, v, direction, z, n_z, p, n_p, ...)``, pointers and sizes, over library effects.

    It calls the functions listed for ``code`` with what is ``given`` and the ``arrays``, the last one for its value;
    ``result`` is returned for codes not listed.
    A flat switch compiles far faster than a chain of closures. The text holds indices only.
    """
    sizes = {"z": "n_z", "p": "n_p", "out": "2 + n_p + n_z", "rates": "n_z", "rows": "n_z, 2 + n_p + n_z"}
    pointers = ["to_z", "n_z", "to_p", "n_p", *("to_" + name for name in arrays)]
    lines = [f"def switch(code, x, v, direction, {', '.join(pointers)}):"]
    for name in ("z", "p", *arrays):
        made = f"matrix(to_{name}, {sizes[name]})" if name == "rows" else f"view(to_{name}, 0, {sizes[name]})"
        lines.append(f"    {name} = {made}")
    names: dict[str, Any] = {"view": view, "matrix": matrix}
    for index, functions in cases:
        lines.append(f"    if code == {index}:")
        for k, function in enumerate(functions):
            name = f"f{index}_{k}"
            names[name] = plain(function.py_func)
            last = k == len(functions) - 1
            # Where a gradient and a force are called, the latter returns its value and writes nothing.
            out = arrays if not last or result == "None" else ()
            lines.append(f"        {'return ' if last else ''}{name}({', '.join([given, *out])})")
    lines.append(f"    return {result}")
    exec("\n".join(lines), names)  # only the package's own functions, by number
    return plain(names["switch"])


_CODES = {name: index for index, name in enumerate(LIBRARY)}
# The two of every oscillator are not called: their force is a product.
_numbered = [(code, LIBRARY[name]) for name, code in _CODES.items() if name not in BASE_EFFECTS]
_stateful = [(code, effect) for code, effect in _numbered if effect.state_rate is not None]
_incomplete = [effect.name for _, effect in _numbered if effect.gradient is None]
if _incomplete:
    raise TypeError(f"library effects need a gradient: {', '.join(_incomplete)}")

_library_force: Callable[..., float] = _switch([(i, (e.force,)) for i, e in _numbered], (), "0.0")
_library_slopes: Callable[..., float] = _switch([(i, (e.gradient, e.force)) for i, e in _numbered], ("out",), "0.0")
_library_regime = _switch([(i, (e.regime,)) for i, e in _numbered if e.regime], (), "0")
_heavier = [(code, effect) for code, effect in _numbered if effect.added_mass is not None]
_library_added_mass: Callable[..., float] = _switch(
    [(i, (e.added_mass,)) for i, e in _heavier], (), "0.0", given="x, p"
)
_library_added_slopes: Callable[..., float] = _switch(
    [(i, (e.added_mass_gradient, e.added_mass)) for i, e in _heavier], ("out",), "0.0", given="x, p"
)
_library_rate = _switch([(i, (e.state_rate,)) for i, e in _stateful], ("rates",), "None")
_library_rate_gradient = _switch([(i, (e.state_rate_gradient,)) for i, e in _stateful], ("rows",), "None")


def library_effects() -> list[tuple[int, Effect]]:
    """Return the library's effects with their codes in the table, but for the two of every oscillator."""
    return list(_numbered)


def describe_effects(effects: Sequence[Effect]) -> tuple[NDArray[np.int64], int, int, int, bool, tuple[Effect, ...]]:
    """Return table, places of linear stiffness and damping, number of states, whether there are kinks, user effects."""
    rows, users = [], []
    place = {}
    p_first, z_first = 0, 0
    for effect in effects:
        p_last, z_last = p_first + len(effect.parameters), z_first + effect.n_states
        if LIBRARY.get(effect.name) is not effect:
            users.append(effect)
            code = USER + len(users) - 1
        else:
            code = _CODES[effect.name]
        if code < USER and effect.name in BASE_EFFECTS:
            place[effect.name] = p_first
        else:
            kind = MEMORY if effect.has_memory else OWN_EQUATION if effect.n_states else NO_STATE
            rows.append((code, p_first, p_last, z_first, z_last, kind, int(effect.added_mass is not None)))
        p_first, z_first = p_last, z_last
    for name in BASE_EFFECTS:
        if name not in place:
            raise InputError(f"effect {name!r} is built in; give your own another name and fix the built-in one at 0.")
    table = np.array(rows, dtype=np.int64).reshape(-1, ROW)
    has_regime = any(effect.regime is not None for effect in effects)
    stiffness, damping = (place[name] for name in BASE_EFFECTS)
    return table, stiffness, damping, z_first, has_regime, tuple(users)


@plain
def _call_user(
    model: Model, kind: int, row: Integers, x: float, v: float, direction: float, z: Floats, p: Floats, out: Floats,
    size: int,
) -> float:  # fmt: skip
    """Call the user's effects, with what difference steps are measured by: amplitude, speed, size of each state."""
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    sizes = view(model.user_scales, 0, 2 + n_z)
    sizes[0] = model.scales[0]
    sizes[1] = model.scales[1]
    for j in range(n_z):
        sizes[2 + j] = model.scales[2 + row[Z_FIRST] + j]
    return function_at(model.user)(
        kind, row[CODE], x, v, direction, view(z, 0, n_z), view(p, 0, n_p), sizes, view(out, 0, size)
    )


@plain
def effect_force(model: Model, i: int, x: float, v: float, direction: float, z: Floats) -> float:
    """Return the force of effect ``i`` [N]."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < USER:
        return _library_force(row[CODE], x, v, direction, zi, n_z, pi, n_p)
    return _call_user(model, FORCE, row, x, v, direction, zi, pi, model.scratch, 0)


@plain
def effect_slopes(model: Model, i: int, x: float, v: float, direction: float, z: Floats) -> float:
    """Return the force of effect ``i`` [N] and write dF/dx, dF/dv, dF/dp, dF/dz into the model's scratch."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < USER:
        return _library_slopes(row[CODE], x, v, direction, zi, n_z, pi, n_p, model.scratch)
    _call_user(model, GRADIENT, row, x, v, direction, zi, pi, model.scratch, 2 + n_p + n_z)
    return _call_user(model, FORCE, row, x, v, direction, zi, pi, model.scratch, 0)


@plain
def _added_slopes(model: Model, i: int, x: float) -> float:
    """Return the mass that effect ``i`` adds [kg] and write dm/dx, dm/dp into the model's scratch."""
    row = shifted(model.table, ROW * i)
    n_p = row[P_LAST] - row[P_FIRST]
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < USER:
        return _library_added_slopes(row[CODE], x, 0.0, 0.0, pi, 0, pi, n_p, model.scratch)
    _call_user(model, ADDED_MASS_GRADIENT, row, x, 0.0, 0.0, pi, pi, model.scratch, 1 + n_p)
    return _call_user(model, ADDED_MASS, row, x, 0.0, 0.0, pi, pi, model.scratch, 0)


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
            added += _library_added_mass(row[CODE], x, 0.0, 0.0, pi, 0, pi, row[P_LAST] - row[P_FIRST])
        else:
            added += _call_user(model, ADDED_MASS, row, x, 0.0, 0.0, pi, pi, model.scratch, 0)
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
        if row[CODE] < USER:
            label = 7 * label + _library_regime(row[CODE], x, v, direction, zi, n_z, pi, n_p)
        else:
            label = 7 * label + int(_call_user(model, REGIME, row, x, v, direction, zi, pi, model.scratch, 0))
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
            _library_rate(row[CODE], x, v, direction, zi, n_z, pi, n_p, rates)
        else:
            _call_user(model, RATE, row, x, v, direction, zi, pi, rates, n_z)


@plain
def state_rate_gradients(model: Model, i: int, x: float, v: float, direction: float, z: Floats) -> None:
    """Write the derivatives of dz/dt of effect ``i`` into the model's scratch, row by row."""
    row = shifted(model.table, ROW * i)
    n_z = row[Z_LAST] - row[Z_FIRST]
    n_p = row[P_LAST] - row[P_FIRST]
    zi = shifted(z, row[Z_FIRST])
    pi = shifted(model.p, row[P_FIRST])
    if row[CODE] < USER:
        _library_rate_gradient(row[CODE], x, v, direction, zi, n_z, pi, n_p, model.scratch)
    else:
        size = n_z * (2 + n_p + n_z)
        _call_user(model, RATE_GRADIENT, row, x, v, direction, zi, pi, model.scratch, size)
