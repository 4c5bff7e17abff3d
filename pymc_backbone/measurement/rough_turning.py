"""Rough turning points of a sampled decay, its period and its noise: where the local fits begin."""

from __future__ import annotations

import numpy as np
from numba import njit

from .._common.checks import FloatArray, IntArray

_SEGMENT = 2**18  # samples


@njit(cache=True)
def zigzag(x: FloatArray, threshold: float) -> tuple[IntArray, bool]:
    """Return indices of alternating extremes at least ``threshold`` apart, and whether the first is a maximum."""
    n = x.size
    found = np.zeros(n, np.int64)
    n_found, high, low, direction, starts_high = 0, 0, 0, 0, True
    for i in range(1, n):
        if x[i] > x[high]:
            high = i
        if x[i] < x[low]:
            low = i
        if direction >= 0 and x[high] - x[i] > threshold:
            if direction == 0:
                starts_high = True
            found[n_found] = high
            n_found += 1
            direction, low, high = -1, i, i
        elif direction <= 0 and x[i] - x[low] > threshold:
            if direction == 0:
                starts_high = False
            found[n_found] = low
            n_found += 1
            direction, low, high = 1, i, i
    return found[:n_found], starts_high


def dominant_period(x: FloatArray, step: float) -> float:
    """Return the period of the strongest line, a static offset and slow drift suppressed."""
    n = x.size
    centred = x - np.mean(x)
    spectrum = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    cycles = np.arange(spectrum.size) / 2.0
    # a decaying line loses to a static offset at the record's own length only; friction's stuck tail is such an offset
    weighted = np.where(cycles >= 1.5, spectrum * cycles, 0.0)
    return float(n * step / cycles[int(np.argmax(weighted))])


def rough_noise(x: FloatArray) -> float:
    """Return the standard deviation of white noise from the upper half of the spectrum.

    Of a long record from those of its segments: the transform of millions of samples, their number a prime perhaps,
    would need a hundred bytes for each.
    """
    segments = np.array_split(x, -(-x.size // _SEGMENT)) if x.size > 2 * _SEGMENT else [x]
    upper = np.concatenate([_upper_half(segment) for segment in segments])
    return float(np.sqrt(np.median(upper) / np.log(2.0))) if upper.size else 0.0


def _upper_half(x: FloatArray) -> FloatArray:
    """Return the upper half of the power spectrum, its mean that of one sample."""
    window = np.hanning(x.size)
    power: FloatArray = np.abs(np.fft.rfft((x - x.mean()) * window)) ** 2 / np.sum(window**2)
    return power[int(0.55 * power.size) :]


def rough_turning_points(x: FloatArray, step: float, noise: float) -> tuple[FloatArray, FloatArray, float]:
    """Return index and sign of the turning points of the smoothed record, and its dominant period.

    A Hann kernel of 0.4 periods; extremes alternate and differ by more than the smoothed noise. A last extreme after
    which the record goes on
    without another is the end of the motion (it stuck, or it drowned) and is dropped.
    """
    period = dominant_period(x, step)
    width = max(round(0.4 * period / step), 1) | 1
    kernel = np.hanning(width + 2)[1:-1]
    kernel /= kernel.sum()
    half = width // 2
    smoothed = np.convolve(np.pad(x, half, mode="edge"), kernel, mode="valid") if half else x
    threshold = max(3.5 * noise * float(np.sqrt(np.sum(kernel**2))), 1e-7 * float(np.ptp(x)))
    found, starts_high = zigzag(smoothed, threshold)
    signs = np.where(np.arange(found.size) % 2 == 0, 1.0, -1.0) * (1.0 if starts_high else -1.0)
    if found.size > 2:
        gaps = np.diff(found) * step / period
        # the first irregular interval ends the decay: below the noise, extremes come at any distance
        irregular = (gaps > 1.1) | (gaps < 0.2)
        # before that, the first interval or two may hold a release that is not one
        head = int(np.argmin(irregular[:3]))
        found, signs, irregular = found[head:], signs[head:], irregular[head:]
        bad = np.flatnonzero(irregular)
        if bad.size:
            found, signs = found[: bad[0] + 1], signs[: bad[0] + 1]
        if (x.size - 1 - found[-1]) * step > 0.8 * period:
            found, signs = found[:-1], signs[:-1]
        # a swing much smaller than the one before it leads from where friction stopped the motion to an extreme of
        # the noise
        swings = np.abs(np.diff(smoothed[found]))
        stopped = np.flatnonzero(swings[1:] < 0.3 * swings[:-1])
        if stopped.size:
            found, signs = found[: stopped[0] + 1], signs[: stopped[0] + 1]
    return found.astype(np.float64), signs, period


@njit(cache=True)
def running_line(values: FloatArray, half: int) -> FloatArray:
    """Return the running local line over 2 half + 1 neighbours, one-sided at the ends."""
    n = values.size
    result = np.empty(n)
    for k in range(n):
        lo, hi = max(0, k - half), min(n, k + half + 1)
        count = hi - lo
        mean = 0.5 * (lo + hi - 1) - k
        level, slope, spread = 0.0, 0.0, 0.0
        for i in range(lo, hi):
            u = i - k - mean
            level += values[i]
            slope += u * values[i]
            spread += u * u
        result[k] = level / count
        if count > 2:
            result[k] -= slope / spread * mean
    return result
