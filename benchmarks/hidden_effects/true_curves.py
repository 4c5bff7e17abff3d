"""The force curves of hidden laws, the mean of the specimens', by the generator's own equation of motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import laws
import numpy as np
from systems import pack

_REST = 1e-30
_FINE = 401  # points through which a line is drawn


def force(parameters: np.ndarray, x: float, v: float) -> float:
    """Return the force of a system [N]."""
    p, direction = parameters, 1.0 if v >= 0.0 else -1.0
    state = np.array([x, v, 0.0, 0.0, 0.0])
    pull = laws.acceleration(0.0, state, direction, x, np.zeros(3), np.zeros((7, 2)), p)
    return -pull * p[laws.MASS] * (1.0 + p[laws.INERTIA] * x * x)


@dataclass(frozen=True)
class TrueCurves:
    """The forces of some specimens, as their mean.

    Attributes
    ----------
    specimens : sequence of mapping
        The parameters of each.
    reach : float
        Displacement over which no line is left in the odd conservative part [m or rad].
    """

    specimens: Sequence[Mapping[str, Any]]
    reach: float

    @cached_property
    def vectors(self) -> list[np.ndarray]:
        """Parameters as the generator takes them."""
        return [pack({k: v for k, v in each.items() if k != "specimen"}) for each in self.specimens]

    def line(self) -> float:
        """Return the stiffness of the line through the odd part of the law [N/m]."""
        inner = np.linspace(0.0, self.reach, _FINE)
        odd = 0.5 * (self.spring(inner) - self.spring(-inner))
        return float(inner @ odd) / float(inner @ inner)

    def spring(self, at: np.ndarray) -> np.ndarray:
        """Return the law's force at displacements, that of the linear spring taken off."""
        return np.array([
            np.mean([force(p, x, _REST) - force(p, 0.0, _REST) - p[laws.K] * x for p in self.vectors]) for x in at
        ])  # fmt: skip

    def conservative(self, at: np.ndarray) -> np.ndarray:
        """Return the conservative force at displacements, no line in its odd part."""
        return self.spring(at) - self.line() * at

    def elastic(self, at: np.ndarray) -> np.ndarray:
        """Return the whole conservative force at displacements, the linear spring included."""
        return self.spring(at) + float(np.mean([p[laws.K] for p in self.vectors])) * at

    def damping(self, at: np.ndarray) -> np.ndarray:
        """Return the damping force at velocities, the viscous damper included."""
        return np.array([np.mean([force(p, 0.0, v) for p in self.vectors]) for v in at])

    def viscous(self) -> float:
        """Return the viscous damping of the mean specimen."""
        return float(np.mean([p[laws.C] for p in self.vectors]))

    def peak(self, x: np.ndarray, v: np.ndarray) -> float:
        """Return the largest force of the law at displacements and velocities."""
        law = self.damping(v) - self.viscous() * v
        return max(float(np.abs(self.conservative(x)).max()), float(np.abs(law).max()))
