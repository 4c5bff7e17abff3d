"""The two sides of a force that has a corner in the middle."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return the sign of the displacement; in the middle, the side being entered."""
    if x == 0.0:
        return 1 if direction > 0.0 else -1
    return 1 if x > 0.0 else -1


__all__ = ["regime"]
