"""Single wild samples: found as what neither noise nor motion makes, and bridged."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..._common.checks import FloatArray, IntArray

WIDEST = 3
"""Samples of the widest spike."""
MOST = 5
"""Spikes of a record: more of them are physics (a part that strikes another) or a broken sensor, and are left alone."""
_CUBIC = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
"""What a sample is off the cubic through the two neighbours on either side."""
_REACH = _CUBIC.size // 2
_KINK = np.array([1.0, -2.0, 1.0]) / 6.0  # what a jump of the slope leaves there; two, a jump of the values
_BEND = np.array([1.0, -1.0]) / 6.0  # and a jump of the curvature
_BLOCK, _SIDE = 64, 3
_FAR = 12.0
_NORMAL = 1.4826  # median absolute deviation to standard deviation, for a normal distribution
_STEPS = 3.0  # of the converter
_LEFT = 0.4  # of the limit, beyond which samples that are bridged leave nothing
_PRICE = 9.0  # variances of the noise that each further wild sample must explain
_RINGS = 0.1  # of what stands out most, below which its neighbours may be what rings after it
_LONGEST = 16  # places for them: more is no spike
_TOWERS = 3.0  # of what else stands out, where that is more than one thing
_MANY = 20  # places that stand out, of whatever kind


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
    """Return values with spikes bridged, and the spikes.

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
    A sample is compared with the cubic through the two neighbours on either side: what motion and noise leave there is
    known from the surrounding 64 samples (median absolute deviation), and twelve times that does not happen. What
    stands out is explained by the fewest samples, each free to take any value, that leave nothing beyond motion and
    noise; by least squares their values are those of the smoothest curve (least fourth differences). Where a jump of
    the values or of their slope explains as much, as the force of friction or an impact makes one, it is left alone.
    Where more than one thing is left alone, so is what is less than three times as high: blows of a stop look like all.
    """
    if values.size < _BLOCK + 2 * _REACH:
        return values, []
    away = np.convolve(values, _CUBIC, mode="same")
    away[:_REACH] = away[-_REACH:] = 0.0
    limit = _limits(away, max(_STEPS * step, 1e-9 * float(np.max(np.abs(values)))))
    places = np.flatnonzero(np.abs(away) > limit)
    clusters = _apart(places, 2 * _REACH)
    if len(clusters) > _MANY:
        return values, []
    looks = [_wild(away, limit, cluster, 2 * _REACH, places) for cluster in clusters]
    others = [
        float(np.max(np.abs(away[cluster])))
        for cluster, (samples, _) in zip(clusters, looks, strict=True)
        if not samples.size
    ]
    # one release, or a blow, is no law; of a structure that makes more of them a spike stands far out
    least = _TOWERS * sorted(others)[-2] if len(others) > 1 else 0.0
    result, wild = values.copy(), [np.zeros(0, dtype=np.int64)]
    for samples, heights in looks:
        if samples.size and np.max(np.abs(heights)) >= least:
            result[samples] -= heights
            wild.append(samples)
    spikes = [
        Spike(int(run[0]), run.size, float(np.max(np.abs(values[run] - result[run]))))
        for run in _apart(np.concatenate(wild), 1)
    ]
    return (result, spikes) if spikes and len(spikes) <= MOST else (values, [])


def _limits(away: FloatArray, least: float) -> FloatArray:
    """Return what each sample may be off its neighbours by."""
    size = np.abs(away)
    count = size.size // _BLOCK
    blocks = np.median(size[: count * _BLOCK].reshape(count, _BLOCK), axis=1)
    # a block at rest beside one that moves has no scale of its own
    blocks = np.pad(blocks, 1, mode="edge")
    scale = _NORMAL * np.max(np.lib.stride_tricks.sliding_window_view(blocks, 3), axis=1)
    return np.maximum(_FAR * scale[np.minimum(np.arange(size.size) // _BLOCK, count - 1)], least)


def _apart(places: IntArray, gap: int) -> list[IntArray]:
    """Return places in groups with more than a gap between them."""
    return [group for group in np.split(places, np.flatnonzero(np.diff(places) > gap) + 1) if group.size]


def _wild(
    away: FloatArray, limit: FloatArray, cluster: IntArray, gap: int, places: IntArray
) -> tuple[IntArray, FloatArray]:
    """Return the samples that explain what stands out at a cluster of places, or at parts of it with smaller gaps."""
    found = _explained(away, limit, cluster, gap, places)
    if found[0].size or gap == 1:
        return found
    size = np.abs(away[cluster])
    beyond = cluster[size > _RINGS * np.max(size)]
    parts = [_wild(away, limit, part, gap // 2, places) for part in _apart(beyond, gap // 2)]
    return np.concatenate([samples for samples, _ in parts]), np.concatenate([heights for _, heights in parts])


def _explained(
    away: FloatArray, limit: FloatArray, part: IntArray, gap: int, places: IntArray
) -> tuple[IntArray, FloatArray]:
    """Return the samples that explain what stands out at a part of places, and their heights; none where none do.

    What is beside other places is not looked at, and samples are as many as the gap to these at most.
    """
    none = np.zeros(0, dtype=np.int64), np.zeros(0)
    first, last = int(part[0]), int(part[-1])
    if first <= _SIDE + _REACH or last >= away.size - _SIDE - _REACH - 1 or last - first > _LONGEST:
        return none
    begin = int(np.max(places[places < first] + _REACH, initial=first - 1 - _REACH))
    end = int(np.min(places[places > last] - _REACH, initial=last + 1 + _REACH))
    # a sample beside them may stand out of its own neighbours too little to be seen, but move theirs
    possible = range(min(first, begin + _REACH), max(last, end - _REACH) + 1)
    if end - begin < 2 * _REACH:
        return none
    rows = np.arange(begin, end + 1)
    off, noise = away[rows], float(np.max(limit[part])) / _FAR
    # as much as a jump, a kink or a bend explains must be left to these
    rival = min(
        _left(off, np.column_stack([_signature(rows, at, shape), _signature(rows, at + 1, shape)]))
        for shape in (_KINK, _BEND)
        for at in range(begin, end + 1)
    )
    # a run of them stands out at four places more than it has samples; what rings would be two or three
    for count in range(1, min(gap, rows.size - 2 * _REACH) + 1):
        best, least = none, rival - _PRICE * (count - 1.0) * noise**2
        for samples in combinations(possible, count):
            columns = np.column_stack([_signature(rows, at, _CUBIC) for at in samples])
            heights = np.linalg.lstsq(columns, off, rcond=None)[0]
            left = off - columns @ heights
            if left @ left < least and np.max(np.abs(left)) < _LEFT * _FAR * noise:
                best, least = (np.array(samples), heights), float(left @ left)
        if best[0].size:
            return best if _widest(best[0]) <= WIDEST else none
    return none


def _signature(rows: IntArray, at: int, shape: FloatArray) -> FloatArray:
    """Return what something at a sample leaves in these rows."""
    place = rows - at + shape.size // 2
    return np.where((place >= 0) & (place < shape.size), shape[np.clip(place, 0, shape.size - 1)], 0.0)


def _left(off: FloatArray, columns: FloatArray) -> float:
    """Return the squares that columns leave of what is off, by least squares."""
    left = off - columns @ np.linalg.lstsq(columns, off, rcond=None)[0]
    return float(left @ left)


def _widest(samples: IntArray) -> int:
    """Return the length of the longest run of neighbours."""
    return max(run.size for run in _apart(samples, 1))
