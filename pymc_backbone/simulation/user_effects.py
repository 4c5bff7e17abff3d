"""Effects written by a user, compiled into one function pointer, with differences where they give no gradient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np

from .._common.checks import FloatArray
from ..effects import Effect
from .forces import (
    ADDED_MASS,
    ADDED_MASS_GRADIENT,
    FORCE,
    GRADIENT,
    NO_USER_EFFECT,
    RATE,
    REGIME,
    REMEMBERED,
    REMEMBERED_GRADIENT,
    USER,
    USER_SIGNATURE,
)
from .switches import plain

_STEP = 6e-6  # central differences: (machine epsilon)^(1/3)


@plain
def _no_more_effects(
    kind: int, code: int, x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray,
    out: FloatArray,
) -> float:  # fmt: skip
    return 0.0


@plain
def _step(column: int, z: FloatArray, p: FloatArray, scales: FloatArray) -> float:
    """Return the difference step of a column: x, v, then parameters by their values, then states by their sizes."""
    if column < 2:
        return _STEP * scales[column]
    size = abs(p[column - 2]) if column < 2 + p.size else scales[column - p.size]
    return _STEP * size if size > 0.0 else _STEP


def _numeric_gradient(force: Any, regime: Any) -> Any:
    """Return a compiled gradient of ``force`` by differences scaled with the motion, none of them across a kink."""

    @numba.njit
    def at(column: int, h: float, x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> Any:
        if column < 2:
            x, v = (x + h, v) if column == 0 else (x, v + h)
            return force(x, v, direction, z, p), regime(x, v, direction, z, p)
        array, j = (p, column - 2) if column < 2 + p.size else (z, column - 2 - p.size)
        value = array[j]
        array[j] = value + h
        result = force(x, v, direction, z, p), regime(x, v, direction, z, p)
        array[j] = value
        return result

    @numba.njit
    def gradient(
        x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray, out: FloatArray
    ) -> None:
        label = regime(x, v, direction, z, p)
        for column in range(2 + p.size + z.size):
            h = _step(column, z, p, scales)
            above, label_above = at(column, h, x, v, direction, z, p)
            below, label_below = at(column, -h, x, v, direction, z, p)
            if (label_above == label) == (label_below == label):
                out[column] = (above - below) / (2.0 * h)
            else:
                if label_above != label:
                    h, above = -h, below
                far, _ = at(column, 2.0 * h, x, v, direction, z, p)
                out[column] = (4.0 * above - far - 3.0 * force(x, v, direction, z, p)) / (2.0 * h)

    return gradient


def _given_gradient(given: Any) -> Any:
    @numba.njit
    def gradient(
        x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray, out: FloatArray
    ) -> None:
        given(x, v, direction, z, p, out)

    return gradient


def _numeric_rate_gradient(rate: Any, regime: Any) -> Any:
    """Return compiled derivatives of ``rate``, like those of `_numeric_gradient`, row by row into a flat array."""

    @numba.njit
    def at(
        column: int, h: float, x: float, v: float, direction: float, z: FloatArray, p: FloatArray, rates: FloatArray
    ) -> Any:
        if column < 2:
            x, v = (x + h, v) if column == 0 else (x, v + h)
            rate(x, v, direction, z, p, rates)
            return regime(x, v, direction, z, p)
        array, j = (p, column - 2) if column < 2 + p.size else (z, column - 2 - p.size)
        value = array[j]
        array[j] = value + h
        rate(x, v, direction, z, p, rates)
        label = regime(x, v, direction, z, p)
        array[j] = value
        return label

    @numba.njit
    def gradient(
        x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray, out: FloatArray
    ) -> None:
        n, width = z.size, 2 + p.size + z.size
        above, below, here = np.empty(n), np.empty(n), np.empty(n)
        rate(x, v, direction, z, p, here)
        label = regime(x, v, direction, z, p)
        for column in range(width):
            h = _step(column, z, p, scales)
            label_above = at(column, h, x, v, direction, z, p, above)
            label_below = at(column, -h, x, v, direction, z, p, below)
            if (label_above == label) == (label_below == label):
                for i in range(n):
                    out[i * width + column] = (above[i] - below[i]) / (2.0 * h)
                continue
            if label_above != label:
                h = -h
            near, far = (above, below) if h > 0.0 else (below, above)
            at(column, 2.0 * h, x, v, direction, z, p, far)
            for i in range(n):
                out[i * width + column] = (4.0 * near[i] - far[i] - 3.0 * here[i]) / (2.0 * h)

    return gradient


def _given_rate_gradient(given: Any) -> Any:
    @numba.njit
    def gradient(
        x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray, out: FloatArray
    ) -> None:
        n, width = z.size, 2 + p.size + z.size
        given(x, v, direction, z, p, out[: n * width].reshape((n, width)))

    return gradient


@plain
def _no_rate(x: float, v: float, direction: float, z: FloatArray, p: FloatArray, out: FloatArray) -> None:
    out[:] = 0.0


@plain
def _no_rate_gradient(
    x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray, out: FloatArray
) -> None:
    out[:] = 0.0


@plain
def _single_regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    return 0


@plain
def _no_added_mass(x: float, p: FloatArray) -> float:
    return 0.0


@plain
def _no_added_mass_gradient(x: float, p: FloatArray, out: FloatArray) -> None:
    out[:] = 0.0


def _link_user(index: int, effect: Effect, rest: Any) -> Any:
    force = effect.force
    regime = effect.regime or _single_regime
    gradient = _given_gradient(effect.gradient) if effect.gradient else _numeric_gradient(effect.force, regime)
    added_mass: Any = effect.added_mass or _no_added_mass
    added_mass_gradient: Any = effect.added_mass_gradient or _no_added_mass_gradient
    remembered: Any = effect.remembered or effect.force
    remembered_gradient = _given_gradient(effect.remembered_gradient) if effect.remembered_gradient else gradient
    rate: Any = effect.state_rate or _no_rate
    rate_gradient: Any = _no_rate_gradient
    if effect.state_rate is not None:
        given = effect.state_rate_gradient
        rate_gradient = _given_rate_gradient(given) if given else _numeric_rate_gradient(effect.state_rate, regime)

    @numba.njit
    def link(
        kind: int, code: int, x: float, v: float, direction: float, z: FloatArray, p: FloatArray, scales: FloatArray,
        out: FloatArray,
    ) -> float:  # fmt: skip
        if code != index:
            return rest(kind, code, x, v, direction, z, p, scales, out)
        if kind == FORCE:
            return force(x, v, direction, z, p)
        if kind == REMEMBERED:
            return remembered(x, v, direction, z, p)
        if kind == ADDED_MASS:
            return added_mass(x, p)
        if kind == GRADIENT:
            gradient(x, v, direction, z, p, scales, out)
        elif kind == REMEMBERED_GRADIENT:
            remembered_gradient(x, v, direction, z, p, scales, out)
        elif kind == REGIME:
            return float(regime(x, v, direction, z, p))
        elif kind == ADDED_MASS_GRADIENT:
            added_mass_gradient(x, p, out)
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
    key = tuple(
        (
            *map(id, (e.force, e.gradient, e.regime, e.state_rate, e.state_rate_gradient)),
            *map(id, (e.added_mass, e.added_mass_gradient, e.remembered, e.remembered_gradient)),
        )
        for e in effects
    )
    if key not in _USER_FUNCTIONS:
        chain: Any = _no_more_effects
        for index, effect in reversed(list(enumerate(effects))):
            chain = _link_user(USER + index, effect, chain)

        def call(
            kind: int, code: int, x: float, v: float, direction: float, z: FloatArray, p: FloatArray,
            scales: FloatArray, out: FloatArray,
        ) -> float:  # fmt: skip
            return chain(kind, code, x, v, direction, z, p, scales, out)

        # The effects are kept with the pointer: their ids are the key, so they must not be collected.
        _USER_FUNCTIONS[key] = (numba.cfunc(USER_SIGNATURE)(call), tuple(effects))
    return int(_USER_FUNCTIONS[key][0].address)
