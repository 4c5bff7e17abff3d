"""Points of a set of effects among its shared coordinates, and what level values say of a specimen's own."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ..._common.checks import FloatArray
from .looks import LevelData

_APART = 3.0  # standard deviations
_ARRAYS = ("eta", "own", "defect", "look", "tilt", "origin", "slopes", "shared")


@dataclass(eq=False)
class Point:
    """A point of a set, with what the look lacks there."""

    eta: FloatArray
    own: FloatArray
    defect: FloatArray
    look: FloatArray
    tilt: FloatArray
    origin: FloatArray
    slopes: FloatArray
    cost: float = np.inf
    log_determinant: float = 0.0
    shared: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    is_exact: bool = False

    def copy(self) -> Point:
        """Return a point that moves on its own."""
        return replace(self, **{name: getattr(self, name).copy() for name in _ARRAYS})

    def become(self, other: Point) -> None:
        """Move where another point of the set is."""
        for name in _ARRAYS:
            getattr(self, name)[...] = getattr(other, name)
        self.cost, self.log_determinant = other.cost, other.log_determinant

    def is_apart_from(self, other: Point) -> bool:
        """Return whether it lies standard deviations away from another, by the information there."""
        away = self.eta - other.eta
        return float(away @ other.shared @ away) > _APART**2


class Standing(NamedTuple):
    """Where a set of effects stood, and at which cost, before others were fitted beside it."""

    names: tuple[str, ...]
    point: Point
    cost: float


class OwnValues(NamedTuple):
    """What the level values of a specimen say of its stiffness and damping, where no effect is.

    Attributes
    ----------
    stiffness, damping : (m,) arrays
        Of which effects take their share, at levels with a frequency, and at levels with a damping.
    at_frequency, at_damping : (m,) arrays of int
        These levels.
    """

    stiffness: FloatArray
    damping: FloatArray
    at_frequency: Any
    at_damping: Any


def own_values(data: LevelData, specimen: int) -> OwnValues:
    """Return what the level values of one specimen say of its own stiffness and damping."""
    m = data.count[specimen]
    (observable, level), values = data.rows[specimen, :m].T, data.values[specimen, :m]
    omega = 2.0 * np.pi * values[observable == 0]
    at = level[observable == 1]
    damping = values[observable == 1] * data.mass * data.omegas[at] / np.pi
    return OwnValues(data.mass * omega**2, damping, level[observable == 0], at)


__all__ = ["OwnValues", "Point", "Standing", "own_values"]
