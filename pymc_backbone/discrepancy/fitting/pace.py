"""Whether a fit that goes on would come to anything, by how fast its sum of squares has been falling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_RACE, _LONG_RACE, _RACE_MARGIN = 6, 25, 60.0  # steps before which none is outrun, at most run, and chi-square
_LAPS, _GAINING = 3, 0.2  # steps over which what is ahead of a rival has to lose this share
_PACE, _FASTER = 4, 2.0  # steps that tell how fast a cost falls, and how much faster it may


def is_outrun(past: Sequence[float], rival: float | None) -> bool:
    """Return whether a cost that fell through ``past`` is far above that of a ``rival`` and hardly falls."""
    if rival is None or len(past) <= _RACE:
        return False
    ahead = past[-1] - rival - _RACE_MARGIN
    is_slow = past[-1 - _LAPS] - past[-1] < _GAINING * ahead or len(past) > _LONG_RACE
    return ahead > 0.0 and is_slow


def is_too_slow(past: Sequence[float], needed: float, left: int) -> bool:
    """Return whether it does not get where it is ``needed`` twice as fast as over its last steps, with so many left."""
    if len(past) <= _PACE or not past[-1] > needed:
        return False
    rate = float(np.log(past[-1 - _PACE] / past[-1])) / _PACE
    return rate * _FASTER * left < float(np.log(past[-1] / needed))


__all__ = ["is_outrun", "is_too_slow"]
