"""Single wild samples: found as what neither noise nor motion makes, and bridged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray

WIDEST = 3
"""Samples of the widest spike."""
MOST = 5
"""Spikes of a record: more of them are physics (a part that strikes another) or a broken sensor, and are left alone."""
_BLOCK, _SIDE = 64, 3
_FAR = 12.0
_NORMAL = 1.4826  # median absolute deviation to standard deviation, for a normal distribution
_STEPS = 3.0  # of the converter


@dataclass(frozen=True)
class Spike:
    """A wild sample, or two or three.

    Attributes
    ----------
    first, count : int
        First sample and number of samples.
    height : float
        Largest distance from the curve that bridges it.
    """

    first: int
    count: int
    height: float


def without_spikes(values: FloatArray, step: float = 0.0) -> tuple[FloatArray, list[Spike]]:
    """Return values with spikes bridged by polynomials through three samples on either side, and the spikes.

    Parameters
    ----------
    values : (n,) array
        Uniform samples.
    step : float, optional
        Step of the converter.

    Returns
    -------
    (n,) array, list of Spike
        The values themselves and an empty list where there is no spike, or more than `MOST`.

    Notes
    -----
    A sample is compared with the cubic through the two neighbours on either side, one or three samples apart: what
    motion and noise leave there is known from the surrounding 64 samples (median absolute deviation), and twelve times
    that does not happen. A sample is a spike only where it lies beyond both neighbours by about as much: the corner of
    an impact, the jump of a friction force and the top of a swing do not.
    """
    result, count = values.copy(), 0
    spikes: list[Spike] = []
    left_alone = np.zeros(values.size, dtype=np.bool_)
    # the largest first: beside a wild sample the next ones stand out as well, until it is bridged
    while (wild := _all_wild(result, step) * ~left_alone).any():
        begin = end = int(np.argmax(wild))
        while begin > 0 and wild[begin - 1]:
            begin -= 1
        while end < values.size and wild[end]:
            end += 1
        length = end - begin
        count += length
        if count > MOST * WIDEST or len(spikes) == MOST:
            return values, []
        if length > WIDEST or begin < _SIDE or end > values.size - _SIDE:
            left_alone[begin:end] = True
            continue
        between = np.arange(begin, end)
        at = np.concatenate([np.arange(begin - _SIDE, begin), np.arange(end, end + _SIDE)])
        result[between] = np.polyval(np.polyfit(at - begin, result[at], 2 * _SIDE - 1), between - begin)
        left_alone[between] = True
        spikes.append(Spike(begin, length, float(np.max(np.abs(values[between] - result[between])))))
    return (result, sorted(spikes, key=lambda spike: spike.first)) if spikes else (values, [])


def _all_wild(values: FloatArray, step: float) -> FloatArray:
    """Return by how much each sample stands out of its neighbours next to it or three away; 0 where it does not."""
    size = np.zeros(values.size)
    for stride in (1, WIDEST):
        if values.size > 4 * stride + _BLOCK:
            size = np.maximum(size, _wild(values, stride, step))
    return size


def _wild(values: FloatArray, stride: int, step: float) -> FloatArray:
    """Return by how much samples stand out of their neighbours ``stride`` samples away; 0 where they do not."""
    centre = values[2 * stride : -2 * stride]
    before, after = values[stride : -3 * stride], values[3 * stride : -stride]
    away = centre - (4.0 * (before + after) - values[: -4 * stride] - values[4 * stride :]) / 6.0
    size = np.abs(away)
    count = size.size // _BLOCK
    blocks = np.median(size[: count * _BLOCK].reshape(count, _BLOCK), axis=1)
    # a block at rest beside one that moves has no scale of its own
    blocks = np.pad(blocks, 1, mode="edge")
    scale = _NORMAL * np.max(np.lib.stride_tricks.sliding_window_view(blocks, 3), axis=1)
    place = np.minimum(np.arange(size.size) // _BLOCK, count - 1)
    limit = np.maximum(_FAR * scale, max(_STEPS * step, 1e-9 * float(np.max(np.abs(values)))))
    up, down = centre - before, centre - after
    # at an extreme of the motion both differences are large beside what the cubic leaves
    beyond = (
        (up * away > 0.5 * size**2)
        & (down * away > 0.5 * size**2)
        & (np.maximum(np.abs(up), np.abs(down)) < 2.0 * size)
    )
    found = np.zeros(values.size)
    found[2 * stride : -2 * stride] = np.where(beyond & (size > limit[place]), size, 0.0)
    return found
