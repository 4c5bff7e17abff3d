"""Reasons to refuse a record before anything is computed from it."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray, InputError
from .tracking import Track

MINIMUM_PER_CYCLE = 8.0
MINIMUM_CYCLES = 4.0
MINIMUM_FALL = 0.02
_SMALLEST = 1e-30
_REST_CYCLES = 4.0
_SETTLED_CYCLES, _BEGUN, _SETTLED = 15.0, 0.2, 0.01


def check_moves(values: FloatArray, name: str) -> None:
    """Raise when a record is constant, or so large or small that its unit cannot be right."""
    span, largest = float(np.ptp(values / 2.0)), float(np.max(np.abs(values)))
    if not span > 1e-12 * largest:
        raise InputError(f"{name}: all samples are {values[0]:.6g}, expected a decay; check the column and the sensor.")
    if not _SMALLEST < span < 1.0 / _SMALLEST:
        raise InputError(
            f"{name}: the samples span {2.0 * span:.3g}, which is no measurement in SI units; check the unit."
        )


def check_per_cycle(sampling_rate: float, frequency: float, name: str) -> None:
    """Raise when a cycle has too few samples."""
    per_cycle = sampling_rate / frequency
    if per_cycle < MINIMUM_PER_CYCLE:
        few = f"{per_cycle:.2g}"
        if float(few) >= MINIMUM_PER_CYCLE:
            few = f"{per_cycle:.4g}"
        raise InputError(
            f"{name}: {few} samples per cycle of the {frequency:.3g} Hz motion, expected at least "
            f"{MINIMUM_PER_CYCLE:g}; sample faster than {MINIMUM_PER_CYCLE * frequency:.3g} Hz, or choose a "
            f"lower mode with a band."
        )


_LONGER = "record longer, release from a larger amplitude or reduce the noise"


def check_cycles(
    path: Track | None, name: str, what: str, remedy: str = _LONGER, least: float = MINIMUM_CYCLES
) -> Track:
    """Return the track, or raise when there are too few cycles."""
    # two outer cycles of a record are beyond the track
    cycles = 0.0 if path is None else path.cycles + 2.0
    if path is None or cycles < least or not path.amplitude.max() > 0.0:
        found = f"fewer than {least:g}" if path is None or f"{cycles:.1f}" == f"{least:.1f}" else f"{cycles:.1f}"
        raise InputError(f"{name}: {found} cycles {what}, expected at least {least:g}; {remedy}.")
    return path


def check_stops_growing(level: FloatArray, period: float, name: str) -> None:
    """Raise when the envelope ``level`` grows until the record ends; ``period`` is in samples."""
    top = int(np.argmax(level))
    lowest = float(level[: top + 1].min())
    begin = int(np.argmin(level[: top + 1]))
    if level.size - top < _REST_CYCLES * period and top - begin > _REST_CYCLES * period and level[top] > 1.5 * lowest:
        raise InputError(
            f"{name}: the amplitude grows from {lowest:.3g} to {level[top]:.3g} over the last "
            f"{(top - begin) / period:.0f} cycles of the record, expected a decay: the structure is driven or excites "
            "itself; record what follows when that ends."
        )


def check_decays(path: Track, name: str, is_clear: bool = True) -> None:
    """Raise when the amplitude does not fall, or settles above the noise (``is_clear``) after it fell."""
    n = min(path.per_cycle, path.time.size // 2)
    first, last = float(np.median(path.amplitude[:n])), float(np.median(path.amplitude[-n:]))
    if last > (1.0 - MINIMUM_FALL) * first:
        how = "grows" if last > (1.0 + MINIMUM_FALL) * first else "stays level"
        raise InputError(
            f"{name}: the amplitude {how}, from {first:.3g} to {last:.3g} over {path.cycles:.0f} cycles, expected a "
            "decay (a structure that is driven, or that excites itself to a limit cycle, has none); record the free "
            "decay after the release, longer if it is lightly damped."
        )
    third = path.time.size // 3
    settled = np.log(path.amplitude[-third:])
    # a polynomial has no place where the noise of single cycles matters
    fall = -float(np.polyfit(np.linspace(0.0, 1.0, third), settled, 1)[0]) if third > 1 else np.inf
    begun = float(np.log(first / path.amplitude[third]))
    if is_clear and path.cycles > _SETTLED_CYCLES and begun > _BEGUN and abs(fall) < _SETTLED:
        raise InputError(
            f"{name}: the amplitude falls from {first:.3g} and settles at {last:.3g}, level over the last "
            f"{path.cycles / 3.0:.0f} cycles, expected a decay to rest: a limit cycle or steady forcing remains; take "
            "away what drives it, or use the part before with stop."
        )
