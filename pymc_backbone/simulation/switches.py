"""The functions of the library's effects behind one switch each: the integrator is compiled once for all models.

An effect is reached by its code. What has room behind its parameters has a switch of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numba
from numba import float64, int64

from .._common.compiled import NativeFunction
from ..effects import BASE_EFFECTS, LIBRARY, Effect
from .pointers import FLOATS, Floats, matrix, view

ROOMY = 500_000  # codes from here on are effects of the library that have room
_plain = numba.njit(_nrt=False, error_model="numpy", fastmath={"contract"})


def plain[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of the hot path; to the type checker it stays what it was.

    None of them allocates, and without reference counting they are six times as fast. Division by zero gives inf or
    nan, which the integrator looks for, instead of an exception.
    """
    compiled: Callable[P, R] = _plain(function)
    return compiled


def _switch(
    cases: Sequence[tuple[int, Sequence[Any]]], arrays: Sequence[str], result: str, given: str, has_room: bool
) -> Any:
    """Return one compiled ``f(code, x, v, direction, z, n_z, p, n_p, ...)``, pointers and sizes, over library effects.

    It calls the functions listed for ``code`` with what is ``given`` and the ``arrays``, the last one for its value;
    ``result`` is returned for codes not listed. What has room takes its size behind ``n_p``.
    A flat switch compiles far faster than a chain of closures. The text holds indices only.
    """
    behind = " + n_room" if has_room else ""
    sizes = {"z": "n_z", "p": "n_p" + behind, "out": "2 + n_p + n_z", "rates": "n_z", "rows": "n_z, 2 + n_p + n_z"}
    pointers = ["to_z", "n_z", "to_p", "n_p", *(["n_room"] if has_room else []), *("to_" + name for name in arrays)]
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


CODES = {name: index + (ROOMY if LIBRARY[name].n_room else 0) for index, name in enumerate(LIBRARY)}
# The two of every oscillator are not called: their force is a product.
_numbered = [(code, LIBRARY[name]) for name, code in CODES.items() if name not in BASE_EFFECTS]
_incomplete = [effect.name for _, effect in _numbered if effect.gradient is None]
if _incomplete:
    raise TypeError(f"library effects need a gradient: {', '.join(_incomplete)}")


def _switches(
    functions: Callable[[Effect], Sequence[Any]],
    arrays: Sequence[str],
    result: str,
    given: str = "x, v, direction, z, p",
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return two switches over the library's functions: of effects without room, and of those with."""
    one, other = (
        [(i, chosen) for i, e in _numbered if (e.n_room > 0) == has_room and all(chosen := functions(e))]
        for has_room in (False, True)
    )
    return _switch(one, arrays, result, given, False), _switch(other, arrays, result, given, True)


library_force: Callable[..., float]
library_slopes: Callable[..., float]
library_kept: Callable[..., float]
library_regime: Callable[..., int]
library_added_mass: Callable[..., float]
library_added_slopes: Callable[..., float]
_force_with_room: Callable[..., float]
_slopes_with_room: Callable[..., float]
_kept_with_room: Callable[..., float]
_regime_with_room: Callable[..., int]
library_force, _force_with_room = _switches(lambda e: (e.force,), (), "0.0")
library_slopes, _slopes_with_room = _switches(lambda e: (e.gradient, e.force), ("out",), "0.0")
library_regime, _regime_with_room = _switches(lambda e: (e.regime,), (), "0")
# What effects with memory keep of a turning point besides its place: their force there, unless they say otherwise.
library_kept, _kept_with_room = _switches(
    lambda e: (e.has_memory and (e.remembered_gradient or e.gradient), e.remembered or e.force), ("out",), "0.0"
)
library_added_mass, _ = _switches(lambda e: (e.added_mass,), (), "0.0", given="x, p")
library_added_slopes, _ = _switches(lambda e: (e.added_mass_gradient, e.added_mass), ("out",), "0.0", given="x, p")
library_rate, _ = _switches(lambda e: (e.state_rate,), ("rates",), "None")
library_rate_gradient, _ = _switches(lambda e: (e.state_rate_gradient,), ("rows",), "None")
_with_more = [effect.name for _, effect in _numbered if effect.n_room and (effect.added_mass or effect.state_rate)]
if _with_more:
    raise TypeError(f"library effects with room can have no mass and no equation of their own: {', '.join(_with_more)}")


# What has room is worth it for being long: it is compiled once and called by name, not into all that calls an effect.
@plain
def _roomy_force(
    code: int, x: float, v: float, direction: float, z: Floats, n_z: int, p: Floats, n_p: int, n_room: int
) -> float:
    return _force_with_room(code, x, v, direction, z, n_z, p, n_p, n_room)


@plain
def _roomy_slopes(
    code: int, x: float, v: float, direction: float, z: Floats, n_z: int, p: Floats, n_p: int, n_room: int, out: Floats
) -> float:
    return _slopes_with_room(code, x, v, direction, z, n_z, p, n_p, n_room, out)


@plain
def _roomy_kept(
    code: int, x: float, v: float, direction: float, z: Floats, n_z: int, p: Floats, n_p: int, n_room: int, out: Floats
) -> float:
    return _kept_with_room(code, x, v, direction, z, n_z, p, n_p, n_room, out)


@plain
def _roomy_regime(
    code: int, x: float, v: float, direction: float, z: Floats, n_z: int, p: Floats, n_p: int, n_room: int
) -> int:
    return _regime_with_room(code, x, v, direction, z, n_z, p, n_p, n_room)


_GIVEN = (int64, float64, float64, float64, FLOATS, int64, FLOATS, int64, int64)
ROOMY_FORCE = NativeFunction("roomy_force", float64(*_GIVEN), _roomy_force)
ROOMY_SLOPES = NativeFunction("roomy_slopes", float64(*_GIVEN, FLOATS), _roomy_slopes)
ROOMY_KEPT = NativeFunction("roomy_kept", float64(*_GIVEN, FLOATS), _roomy_kept)
ROOMY_REGIME = NativeFunction("roomy_regime", int64(*_GIVEN), _roomy_regime)
roomy_force: Callable[..., float] = ROOMY_FORCE.call
roomy_slopes: Callable[..., float] = ROOMY_SLOPES.call
roomy_kept: Callable[..., float] = ROOMY_KEPT.call
roomy_regime: Callable[..., int] = ROOMY_REGIME.call


def library_effects() -> list[tuple[int, Effect]]:
    """Return the library's effects with their codes in the table, but for the two of every oscillator."""
    return list(_numbered)
