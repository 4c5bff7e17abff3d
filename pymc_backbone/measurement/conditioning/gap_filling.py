"""Samples that are missing in between, put in by the motion of the cycles around them.

A spline through the samples on either side follows their noise, and carries it several times larger into the gap. The
cycles around know the motion better.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_interp_spline

from ..._common.checks import BoolArray, FloatArray

_HARMONICS, _POWERS = 3, 3
"""Of the motion around a gap, each with an amplitude that is a polynomial of so many coefficients in time."""
_REACH = (1.0, 1.5, 2.0)
"""Cycles on either side of a gap that are looked at: the fewest with ``_SAMPLES`` to each unknown."""
_SAMPLES = 2.0
_PACES = np.linspace(0.8, 1.25, 10)
"""Of the dominant frequency, that of these cycles may be: that of a nonlinear structure changes."""
_SHIFTS = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)
"""Cycles from the gap to places where both ways are tried on samples that are there."""
_ORDER, _BESIDE = 5, 12
"""Order of the spline, and samples on either side that it goes through where it is tried."""


def filled(values: FloatArray, gaps: Sequence[tuple[int, int]], per_cycle: float) -> FloatArray:
    """Return uniform samples with those in gaps put in by the cycles around, where these tell them better.

    Parameters
    ----------
    values : (n,) array
        Uniform samples, those in the gaps by a spline.
    gaps : sequence of (int, int)
        First sample of each gap, and first one after it.
    per_cycle : float
        Samples in a cycle of the dominant motion.

    Notes
    -----
    Around each gap harmonics whose amplitudes are quadratic in time, about a straight mid-line, are fitted to one cycle
    or two on either side. At six places near by the samples are known: where a spline over as wide a gap is nearer to
    them (a record without noise, a corner of the motion, another mode on it), it is kept.
    """
    result = values.copy()
    missing = np.zeros(values.size, dtype=np.bool_)
    for first, end in gaps:
        missing[first:end] = True
    for first, end in gaps:
        put_in = _by_cycles(values, missing, first, end, per_cycle)
        if put_in is not None:
            result[first:end] = put_in
    return result


def _by_cycles(values: FloatArray, missing: BoolArray, first: int, end: int, per_cycle: float) -> FloatArray | None:
    """Return the samples of one gap by the cycles around it; None where a spline is better, or they are too few."""
    harmonics = int(min(_HARMONICS, 0.4 * per_cycle))
    unknowns = 2 + 2 * _POWERS * harmonics
    for reach in _REACH:
        low, high = max(first - round(reach * per_cycle), 0), min(end + round(reach * per_cycle), values.size)
        known = np.flatnonzero(~missing[low:high]) + low
        if known.size >= _SAMPLES * unknowns:
            break
    else:
        return None
    if not (known[0] < first and known[-1] >= end) or not harmonics:
        return None
    rates = 2.0 * np.pi / per_cycle * _PACES
    middle = 0.5 * (first + end - 1)

    def design(at: FloatArray, rate: float) -> FloatArray:
        u, phase = (at - middle) / (0.5 * (high - low)), rate * (at - middle)
        waves = [wave(order * phase) for order in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
        return np.column_stack([np.ones_like(u), u, *(u**power * wave for wave in waves for power in range(_POWERS))])

    def carried(kept: FloatArray, at: FloatArray, rate: float) -> FloatArray:
        """Return what the cycles say of some samples, told by others."""
        found, *_ = np.linalg.lstsq(design(kept, rate), values[kept.astype(int)], rcond=None)
        return np.asarray(design(at, rate) @ found)

    places = known.astype(np.float64)
    left = [float(np.square(values[known] - carried(places, places, rate)).sum()) for rate in rates]
    rate = float(rates[int(np.argmin(left))])
    tried: list[tuple[float, float]] = []
    for shift in _SHIFTS:
        begin = first + round(shift * per_cycle)
        gap = np.arange(begin, begin + end - first)
        beside = known[np.abs(known - gap.mean()) < _BESIDE + 0.5 * gap.size]
        beside = beside[(beside < begin) | (beside > gap[-1])]
        if not np.isin(gap, known).all() or not (beside < begin).any() or not (beside > gap[-1]).any():
            continue
        if beside.size <= _ORDER:
            continue
        kept = np.setdiff1d(known, gap).astype(np.float64)
        by_cycles = carried(kept, gap.astype(np.float64), rate) - values[gap]
        by_spline = make_interp_spline(beside, values[beside], k=_ORDER)(gap) - values[gap]
        tried.append((float(by_cycles @ by_cycles), float(by_spline @ by_spline)))
    if not tried or np.sum([item[0] for item in tried]) >= np.sum([item[1] for item in tried]):
        return None
    return carried(places, np.arange(first, end, dtype=np.float64), rate)


__all__ = ["filled"]
