"""Reasons to refuse a record before anything is computed from it."""

from __future__ import annotations

import numpy as np

from ..._common.checks import BoolArray, FloatArray, InputError, IntArray
from ..rough_turning import rough_noise
from .tracking import Track

MINIMUM_PER_CYCLE = 8.0
MINIMUM_CYCLES = 4.0
MINIMUM_FALL = 0.02
_CLIPPED_PEAKS = 3
_BEYOND = 0.98  # of the limit, from which a peak on the other side may be cut as well
_WITHIN, _FLAT, _FLAT_SHARE = 3.0, 20.0, 0.02
"""Noise about a flat top; by how much more the cosine falls beside it, in noise and as a share of the amplitude."""
_FINE = 1e-5
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


def check_clipping(
    values: FloatArray, reading: float, time: FloatArray, frequency: float, step: float, name: str
) -> None:
    """Raise when the tops of several peaks are cut off at the same value.

    Samples at the extreme value that follow each other are natural on a coarse converter: a cosine of
    amplitude A stays within one step of its top for a while. Clipped tops last longer than that. The sensor showed
    ``values + reading``.
    """
    sampling_rate = (time.size - 1) / float(time[-1] - time[0])
    middle, amplitude = 0.5 * float(values.max() + values.min()), 0.5 * float(np.ptp(values))
    for extreme in (float(values.max()), float(values.min())):
        at = np.abs(values - extreme) <= 1e-9 * amplitude
        first, length = _runs_of_peaks(at, (values > middle) == (extreme > middle))
        # the fall of a true cosine from the middle to the end of the run
        fall = amplitude * (1.0 - np.cos(np.minimum(np.pi * frequency * (length - 1) / sampling_rate, np.pi)))
        cut = (length >= 2) & (fall > 3.0 * step) & (fall > 1e-3 * amplitude)
        if step < _FINE * amplitude and cut.any():
            # on a fine scale no two peaks are equal by chance, as far as single samples
            cut |= length >= 1
        # a model held at rest is one long run, not a peak
        cut &= length < 0.6 * sampling_rate / frequency
        if np.count_nonzero(cut) < _CLIPPED_PEAKS:
            at, first, cut = _noisy_tops(values, extreme, middle, amplitude, sampling_rate / frequency)
        if np.count_nonzero(cut) >= _CLIPPED_PEAKS:
            # the next peak on the other side may be cut as well, and a cut peak must not be the first of what follows
            beyond = at | (np.abs(values - middle) > _BEYOND * amplitude)
            quarter = round(0.25 * sampling_rate / frequency)
            last = min(int(np.flatnonzero(beyond)[-1]) + 1 + quarter, time.size - 1)
            side = "upper" if extreme > middle else "lower"
            raise InputError(
                f"{name}: {np.count_nonzero(cut)} peaks are clipped at {extreme + reading:.6g} ({side} limit of "
                f"the sensor or converter), "
                f"first at {time[first[cut][0]]:.6g} s; widen the range, or use what follows with "
                f"`start={time[last]:.6g}`."
            )


def _noisy_tops(
    values: FloatArray, extreme: float, middle: float, amplitude: float, per_cycle: float
) -> tuple[BoolArray, IntArray, BoolArray]:
    """Return what lies at an extreme but for noise, where peaks begin to, and which of these are cut off there.

    A sensor that saturates adds its noise behind the limit. Its peaks are flat for longer than a cosine is, and as high
    as each other though the motion decays: the peaks after them say by how much it would have.
    """
    noise, side = rough_noise(values), 1.0 if extreme > middle else -1.0
    # the highest of many samples of a flat top is some three deviations above it
    at = side * (values - extreme) > -2.0 * _WITHIN * noise
    first, length = _runs_of_peaks(at, side * (values - middle) > 0.0)
    fall = amplitude * (1.0 - np.cos(np.minimum(np.pi * (length - 1) / per_cycle, np.pi)))
    cut = (fall > _FLAT * noise) & (fall > _FLAT_SHARE * amplitude) & (length < 0.6 * per_cycle)
    count = int(np.count_nonzero(cut))
    if count < _CLIPPED_PEAKS:
        return at, first, cut
    after = side * (values[int(first[-1]) + round(0.5 * per_cycle) :] - middle)
    cycles = int(after.size / per_cycle)
    if cycles < 2:
        return at, first, np.zeros_like(cut)
    tops = np.array([part.max() for part in np.array_split(after[: round(cycles * per_cycle)], cycles)])[: 2 * count]
    expected = side * (extreme - middle) * (1.0 - (tops[-1] / tops[0]) ** (count / max(tops.size - 1, 1)))
    return at, first, cut & bool(expected > _FLAT * noise)


def _runs_of_peaks(at: BoolArray, beyond: BoolArray) -> tuple[IntArray, IntArray]:
    """Return where the values stay at their extreme, and for how many samples, at most once in each peak.

    Of a peak, while the motion is ``beyond`` the middle, the longest run counts: a model that is held before release
    comes and goes with the last digit of the converter, many times, and is one.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(int)))
    first, last = edges[::2], edges[1::2]
    if not first.size:
        return first, first
    crossings = np.cumsum(np.concatenate([[0], np.diff(beyond.astype(int)) != 0]))
    _, begin = np.unique(crossings[first], return_index=True)
    return first[begin], np.maximum.reduceat(last - first, begin)


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
