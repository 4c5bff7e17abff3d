"""Single wild samples: found as what neither noise nor motion makes, and bridged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._common.checks import FloatArray

WIDEST = 3
"""Samples of the widest spike."""
MOST = 5
"""Spikes of a record: more of them are physics (a part that strikes another) or a broken sensor, and are left alone."""
_BLOCK = 64
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
    """Return values with spikes bridged by cubics, and the spikes.

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
    wild = np.zeros(values.size, dtype=np.bool_)
    for stride in (1, WIDEST):
        if values.size > 4 * stride + _BLOCK:
            wild |= _wild(values, stride, step)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wild, [False]]).astype(np.int8)))
    first, count = edges[::2], edges[1::2] - edges[::2]
    inside = (count <= WIDEST) & (first >= 2) & (first + count <= values.size - 2)
    if not inside.any() or np.count_nonzero(count) > MOST:
        return values, []
    result = values.copy()
    spikes = []
    for begin, length in zip(first[inside].tolist(), count[inside].tolist(), strict=True):
        at = np.array([begin - 2, begin - 1, begin + length, begin + length + 1])
        between = np.arange(begin, begin + length)
        curve = np.polyfit(at - begin, result[at], 3)
        result[between] = np.polyval(curve, between - begin)
        spikes.append(Spike(begin, length, float(np.max(np.abs(values[between] - result[between])))))
    return result, spikes


def _wild(values: FloatArray, stride: int, step: float) -> NDArray[np.bool_]:
    """Return which samples stand out of their neighbours ``stride`` samples away."""
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
    found = np.zeros(values.size, dtype=np.bool_)
    found[2 * stride : -2 * stride] = beyond & (size > limit[place])
    return found
