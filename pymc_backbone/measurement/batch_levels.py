"""At which amplitudes the backbones of a batch are compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .._common.checks import FloatArray, InputError, check_levels
from .cycle_data import Cycles
from .levels import DEFAULT_LEVELS, default_levels

_NARROW = 1.5  # the widest range of a specimen over that which all share, from which the search takes the whole range
_FEWEST_LEVELS, _MOST_LEVELS = 8, 20


def levels_for(
    cycles: Sequence[Cycles], levels: int | ArrayLike | None = None, *, whole_range: bool = False
) -> tuple[FloatArray, list[str]]:
    """Choose the levels of a batch.

    Parameters
    ----------
    cycles : sequence of Cycles
        One per specimen.
    levels : int or array_like, optional
        Their number, or the amplitudes [m or rad]; by default as many as `default_levels` takes.
    whole_range : bool, optional
        Whether the levels go from the lowest to the highest amplitude of any specimen where the range that all share is
        much narrower than that of one of them, or one reaches less than half of them; each has values at those it
        reaches then.

    Returns
    -------
    levels : (l,) array
        Those that (nearly) all specimens reach, as `default_levels` chooses them; where they share no range, from the
        lowest to the highest amplitude of any.
    notes : list of str
        A sentence where not all specimens reach them.

    Raises
    ------
    InputError
        If a specimen reaches more levels than it has cycles: their values would depend on each other exactly.
    """
    if levels is not None and np.ndim(levels) > 0:
        at = check_levels(levels)
        _check_number(cycles, at)
        return at, []
    count = None if levels is None else int(np.asarray(levels))
    if count is not None and count < 1:
        raise InputError(f"`levels` must be at least 1, or a list of amplitudes, got {count}.")
    widest = max(float(np.log(item.smoothed_amplitude.max() / item.smoothed_amplitude.min())) for item in cycles)
    notes: list[str] = []
    try:
        at = default_levels(cycles, count)
    except InputError:
        at = np.empty(0)
    if not at.size or (whole_range and any(2 * _reached(item, at) < at.size for item in cycles)):
        at = _levels_of_any(cycles, count, widest)
        notes = [f"the specimens share no range of amplitudes: {_of_any(at)}"]
    elif whole_range and widest > _NARROW * np.log(at[-1] / at[0]):
        shared = f"{at[0]:.4g} to {at[-1]:.4g}"
        at = _levels_of_any(cycles, count, widest)
        notes = [f"the range of amplitudes that all specimens share, {shared}, is narrow: {_of_any(at)}"]
    _check_number(cycles, at)
    return at, notes


def _of_any(levels: FloatArray) -> str:
    return (
        f"the levels go from the lowest to the highest, {levels[0]:.4g} to {levels[-1]:.4g}, and each specimen has "
        "values at those it reaches"
    )


def _levels_of_any(cycles: Sequence[Cycles], count: int | None, widest: float) -> FloatArray:
    """Return levels from the lowest to the highest amplitude of any specimen, as dense as each of them bears."""
    low = min(float(item.smoothed_amplitude.min()) for item in cycles)
    high = max(float(np.partition(item.smoothed_amplitude, -2)[-2]) for item in cycles)
    fewest = min(_FEWEST_LEVELS, *(item.smoothed_amplitude.size for item in cycles))
    most = count or int(np.clip(DEFAULT_LEVELS * np.log(high / low) / widest, DEFAULT_LEVELS, _MOST_LEVELS))
    while True:
        at = np.geomspace(1.02 * low, 0.98 * high, most)
        # two cycles for each level, as where all specimens share their levels
        crowded = any(2 * _reached(item, at) > item.smoothed_amplitude.size for item in cycles)
        if count is not None or not crowded or most <= fewest:
            return at
        most -= 1


def _check_number(cycles: Sequence[Cycles], levels: FloatArray) -> None:
    """Raise if a specimen reaches more levels than it has cycles."""
    for item in cycles:
        reached, held = _reached(item, levels), item.smoothed_amplitude.size
        if reached > held:
            raise InputError(
                f"`levels` put {reached} amplitudes where {item.specimen} has {held} cycles; ask for fewer: "
                "a decay tells at most one value a cycle."
            )


def _reached(cycles: Cycles, levels: FloatArray) -> int:
    """Return how many of the levels a specimen reaches."""
    amplitude = cycles.smoothed_amplitude
    return int(np.count_nonzero((levels >= amplitude.min()) & (levels <= amplitude.max())))


__all__ = ["levels_for"]
