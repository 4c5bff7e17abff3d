"""The total force of an oscillator, composed from its effects without recompiling anything.

Library effects are reached through one switch over their codes, so that the integrator is compiled once for
all models and kept on disk. Effects written by a user are reached through one compiled function pointer.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numba import float64, int64, types
from numba.core import cgutils
from numba.core.typing import signature
from numba.extending import intrinsic
from numpy.typing import NDArray

from .effects import BASE_EFFECTS, LIBRARY, Effect

FORCE, GRADIENT, REGIME, RATE, RATE_GRADIENT = range(5)
NO_USER_EFFECT = 0  # the address where there are library effects only
USER = 1_000_000  # codes from here on are effects written by the user
NO_STATE, MEMORY, OWN_EQUATION = range(3)
_STEP = 6e-6  # central differences: (machine epsilon)^(1/3)

Layout = namedtuple(
    "Layout", ["table", "stiffness", "damping", "n_states", "mass", "has_regime", "scales", "user"]
)
Layout.__doc__ = (
    "What the integrator knows of an oscillator: where linear stiffness and viscous damping stand among the "
    "parameters, one row of `table` for each other effect, and `scales`, amplitude and speed of the motion."
)
CODE, P_FIRST, P_LAST, Z_FIRST, Z_LAST, KIND = range(6)  # columns of `Layout.table`

USER_SIGNATURE = float64(
    int64, int64, float64, float64, float64, float64[::1], float64[::1], float64[::1], float64[::1]
)
USER_TYPE = types.FunctionType(USER_SIGNATURE)


# No function on the hot path allocates; without reference counting it is six times as fast.
plain = numba.njit(_nrt=False)


@intrinsic
def function_at(typing_context: Any, address: Any) -> Any:
    """Return the function of the user-effect signature at ``address``: 0 where there are library effects only."""

    def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        function = cgutils.create_struct_proxy(USER_TYPE)(context, builder)
        pointer = context.get_value_type(types.voidptr)
        function.c_addr = builder.inttoptr(arguments[0], pointer)
        function.py_addr = cgutils.get_null_value(pointer)
        function.jit_addr = cgutils.get_null_value(pointer)
        return function._getvalue()

    return signature(USER_TYPE, types.int64), generate


@plain
def _no_more_effects(kind, code, x, v, direction, z, p, scales, out):
    return 0.0


def _switch(cases: Sequence[tuple[int, Any]], arguments: str, otherwise: str) -> Any:
    """Return one compiled ``f(code, arguments)`` that calls the function listed for ``code``.

    A flat switch compiles far faster than a chain of closures. The text holds indices only.
    """
    lines = [f"def switch(code, {arguments}):"]
    lines += [f"    if code == {index}:\n        return f{index}({arguments})" for index, _ in cases]
    lines.append(f"    return {otherwise}")
    names = {f"f{index}": function for index, function in cases}
    exec("\n".join(lines), names)  # only the package's own functions, by number
    return plain(names["switch"])


_CODES = {name: index for index, name in enumerate(LIBRARY)}
_STATEFUL = [(index, effect) for index, effect in enumerate(LIBRARY.values()) if effect.state_rate is not None]


def _missing(attribute: str) -> list[str]:
    return [effect.name for effect in LIBRARY.values() if getattr(effect, attribute) is None]


if _missing("gradient"):
    raise TypeError(f"library effects need a gradient: {', '.join(_missing('gradient'))}")

_numbered = list(enumerate(LIBRARY.values()))
library_force = _switch([(i, e.force) for i, e in _numbered], "x, v, direction, z, p", "0.0")
library_gradient = _switch([(i, e.gradient) for i, e in _numbered], "x, v, direction, z, p, out", "None")
library_regime = _switch([(i, e.regime) for i, e in _numbered if e.regime], "x, v, direction, z, p", "0")
library_rate = _switch([(i, e.state_rate) for i, e in _STATEFUL], "x, v, direction, z, p, out", "None")
library_rate_gradient = _switch([(i, e.state_rate_gradient) for i, e in _STATEFUL], "x, v, direction, z, p, out", "None")


def _numeric_gradient(force: Any) -> Any:
    """Return a compiled gradient of ``force`` by central differences scaled with the motion."""

    @numba.njit
    def gradient(x, v, direction, z, p, scales, out):
        h = _STEP * scales[0]
        out[0] = (force(x + h, v, direction, z, p) - force(x - h, v, direction, z, p)) / (2.0 * h)
        h = _STEP * scales[1]
        out[1] = (force(x, v + h, direction, z, p) - force(x, v - h, direction, z, p)) / (2.0 * h)
        for array, first in ((p, 2), (z, 2 + p.size)):
            for j in range(array.size):
                value = array[j]
                h = _STEP * abs(value) if value != 0.0 else _STEP
                array[j] = value + h
                above = force(x, v, direction, z, p)
                array[j] = value - h
                out[first + j] = (above - force(x, v, direction, z, p)) / (2.0 * h)
                array[j] = value

    return gradient


def _given_gradient(given: Any) -> Any:
    @numba.njit
    def gradient(x, v, direction, z, p, scales, out):
        given(x, v, direction, z, p, out)

    return gradient


def _numeric_rate_gradient(rate: Any) -> Any:
    """Return compiled derivatives of ``rate`` by central differences, written row by row into a flat array."""

    @numba.njit
    def gradient(x, v, direction, z, p, scales, out):
        n, width = z.size, 2 + p.size + z.size
        above = np.empty(n)
        below = np.empty(n)
        for column in range(width):
            if column < 2:
                h = _STEP * scales[column]
                dx, dv = (h, 0.0) if column == 0 else (0.0, h)
                rate(x + dx, v + dv, direction, z, p, above)
                rate(x - dx, v - dv, direction, z, p, below)
            else:
                array, j = (p, column - 2) if column < 2 + p.size else (z, column - 2 - p.size)
                value = array[j]
                h = _STEP * abs(value) if value != 0.0 else _STEP
                array[j] = value + h
                rate(x, v, direction, z, p, above)
                array[j] = value - h
                rate(x, v, direction, z, p, below)
                array[j] = value
            for i in range(n):
                out[i * width + column] = (above[i] - below[i]) / (2.0 * h)

    return gradient


def _given_rate_gradient(given: Any) -> Any:
    @numba.njit
    def gradient(x, v, direction, z, p, scales, out):
        n, width = z.size, 2 + p.size + z.size
        given(x, v, direction, z, p, out[: n * width].reshape((n, width)))

    return gradient


@plain
def _no_rate(x, v, direction, z, p, out):
    out[:] = 0.0


@plain
def _no_rate_gradient(x, v, direction, z, p, scales, out):
    out[:] = 0.0


@plain
def _single_regime(x, v, direction, z, p):
    return 0


def _link_user(index: int, effect: Effect, rest: Any) -> Any:
    force = effect.force
    regime = effect.regime or _single_regime
    gradient = _given_gradient(effect.gradient) if effect.gradient else _numeric_gradient(effect.force)
    rate: Any = effect.state_rate or _no_rate
    rate_gradient: Any = _no_rate_gradient
    if effect.state_rate is not None:
        given = effect.state_rate_gradient
        rate_gradient = _given_rate_gradient(given) if given else _numeric_rate_gradient(effect.state_rate)

    @numba.njit
    def link(kind, code, x, v, direction, z, p, scales, out):
        if code != index:
            return rest(kind, code, x, v, direction, z, p, scales, out)
        if kind == FORCE:
            return force(x, v, direction, z, p)
        if kind == GRADIENT:
            gradient(x, v, direction, z, p, scales, out)
        elif kind == REGIME:
            return float(regime(x, v, direction, z, p))
        elif kind == RATE:
            rate(x, v, direction, z, p, out)
        else:
            rate_gradient(x, v, direction, z, p, scales, out)
        return 0.0

    return link


_USER_FUNCTIONS: dict[tuple[Any, ...], Any] = {}


def compose_user_effects(effects: Sequence[Effect]) -> int:
    """Return the address of one compiled function that reaches all ``effects``; compiled once per process."""
    if not effects:
        return NO_USER_EFFECT
    key = tuple((id(e.force), id(e.gradient), id(e.regime), id(e.state_rate), id(e.state_rate_gradient)) for e in effects)
    if key not in _USER_FUNCTIONS:
        chain: Any = _no_more_effects
        for index, effect in reversed(list(enumerate(effects))):
            chain = _link_user(USER + index, effect, chain)

        def call(kind, code, x, v, direction, z, p, scales, out):  # type: ignore[no-untyped-def]
            return chain(kind, code, x, v, direction, z, p, scales, out)

        # The effects are kept with the pointer: their ids are the key, so they must not be collected.
        _USER_FUNCTIONS[key] = (numba.cfunc(USER_SIGNATURE)(call), tuple(effects))
    return int(_USER_FUNCTIONS[key][0].address)


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
            rows.append((code, p_first, p_last, z_first, z_last, kind))
        p_first, z_first = p_last, z_last
    table = np.array(rows, dtype=np.int64).reshape(-1, 6)
    has_regime = any(effect.regime is not None for effect in effects)
    return table, *(place[name] for name in BASE_EFFECTS), z_first, has_regime, tuple(users)  # type: ignore[return-value]


@plain
def effect_force(layout, i, x, v, direction, z, p):
    """Return the force of effect ``i`` [N]."""
    code = layout.table[i, CODE]
    pi = p[layout.table[i, P_FIRST] : layout.table[i, P_LAST]]
    zi = z[layout.table[i, Z_FIRST] : layout.table[i, Z_LAST]]
    if code < USER:
        return library_force(code, x, v, direction, zi, pi)
    return layout.user(FORCE, code, x, v, direction, zi, pi, layout.scales, pi)


@plain
def effect_gradient(layout, i, x, v, direction, z, p, out):
    """Return the force of effect ``i`` [N] and write dF/dx, dF/dv, dF/dp, dF/dz into ``out``."""
    code = layout.table[i, CODE]
    pi = p[layout.table[i, P_FIRST] : layout.table[i, P_LAST]]
    zi = z[layout.table[i, Z_FIRST] : layout.table[i, Z_LAST]]
    if code < USER:
        library_gradient(code, x, v, direction, zi, pi, out)
        return library_force(code, x, v, direction, zi, pi)
    layout.user(GRADIENT, code, x, v, direction, zi, pi, layout.scales, out)
    return layout.user(FORCE, code, x, v, direction, zi, pi, layout.scales, pi)


@plain
def total_force(layout, x, v, direction, z, p):
    """Return the sum of all forces [N]."""
    total = p[layout.stiffness] * x + p[layout.damping] * v
    for i in range(layout.table.shape[0]):
        total += effect_force(layout, i, x, v, direction, z, p)
    return total


@plain
def force_slopes(layout, x, v, direction, z, p, out):
    """Return the total force [N], dF/dx and dF/dv; ``out`` is scratch."""
    fx = p[layout.stiffness]
    fv = p[layout.damping]
    total = fx * x + fv * v
    for i in range(layout.table.shape[0]):
        total += effect_gradient(layout, i, x, v, direction, z, p, out)
        fx += out[0]
        fv += out[1]
    return total, fx, fv


@plain
def force_gradient(layout, x, v, direction, z, p, out, fp, fz):
    """Return the total force [N], dF/dx and dF/dv and write dF/dp and dF/dz; ``out`` is scratch."""
    fx = p[layout.stiffness]
    fv = p[layout.damping]
    total = fx * x + fv * v
    fp[layout.stiffness] = x
    fp[layout.damping] = v
    for i in range(layout.table.shape[0]):
        total += effect_gradient(layout, i, x, v, direction, z, p, out)
        fx += out[0]
        fv += out[1]
        k = 2
        for j in range(layout.table[i, P_FIRST], layout.table[i, P_LAST]):
            fp[j] = out[k]
            k += 1
        for j in range(layout.table[i, Z_FIRST], layout.table[i, Z_LAST]):
            fz[j] = out[k]
            k += 1
    return total, fx, fv


@plain
def smooth_branch(layout, x, v, direction, z, p):
    """Return one integer that labels the smooth branch of all forces together."""
    label = 0
    for i in range(layout.table.shape[0]):
        code = layout.table[i, CODE]
        pi = p[layout.table[i, P_FIRST] : layout.table[i, P_LAST]]
        zi = z[layout.table[i, Z_FIRST] : layout.table[i, Z_LAST]]
        if code < USER:
            label = 7 * label + library_regime(code, x, v, direction, zi, pi)
        else:
            label = 7 * label + int(layout.user(REGIME, code, x, v, direction, zi, pi, layout.scales, pi))
    return label


@plain
def state_rates(layout, x, v, direction, z, p, out):
    """Write dz/dt of all states into ``out``; states that remember a turning point do not move."""
    for i in range(layout.table.shape[0]):
        code = layout.table[i, CODE]
        first, last = layout.table[i, Z_FIRST], layout.table[i, Z_LAST]
        if layout.table[i, KIND] != OWN_EQUATION:
            for j in range(first, last):
                out[j] = 0.0
            continue
        pi = p[layout.table[i, P_FIRST] : layout.table[i, P_LAST]]
        if code < USER:
            library_rate(code, x, v, direction, z[first:last], pi, out[first:last])
        else:
            layout.user(RATE, code, x, v, direction, z[first:last], pi, layout.scales, out[first:last])


@plain
def state_rate_gradients(layout, i, x, v, direction, z, p, out):
    """Write the derivatives of dz/dt of effect ``i`` into the flat array ``out``, row by row."""
    code = layout.table[i, CODE]
    first, last = layout.table[i, Z_FIRST], layout.table[i, Z_LAST]
    pi = p[layout.table[i, P_FIRST] : layout.table[i, P_LAST]]
    if code < USER:
        n, width = last - first, 2 + pi.size + last - first
        library_rate_gradient(code, x, v, direction, z[first:last], pi, out[: n * width].reshape((n, width)))
    else:
        layout.user(RATE_GRADIENT, code, x, v, direction, z[first:last], pi, layout.scales, out)
