"""Where a contact on one side closes: the sign of its first parameter is its side, the second its gap."""

from __future__ import annotations

import numba

from .._common.checks import FloatArray


@numba.njit
def regime(x: float, v: float, direction: float, z: FloatArray, p: FloatArray) -> int:
    """Return 1 in contact and 0 apart, 2 more where preloaded, 4 more on the negative side; on a kink, what comes."""
    side = -1.0 if p[0] < 0.0 else 1.0
    approach = side * x - p[1]
    touches = approach > 0.0 or (approach == 0.0 and side * direction > 0.0)
    return (1 if touches else 0) + (2 if p[1] < 0.0 else 0) + (4 if side < 0.0 else 0)


__all__ = ["regime"]
