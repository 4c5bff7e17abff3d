"""More releases than one in a record: a free decay before the one that is used, or motion again after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..._common.checks import FloatArray
from .release import envelope

_FEWEST_CYCLES = 4.0
_ONSET_CYCLES = 3.0
"""A release or an impact is over in so many cycles of the envelope, which is two cycles blunt; forcing builds up."""
_FALL = 1.25
"""Factor by which an amplitude falls at least in a decay, and rises where motion begins again."""
_RIPPLE = 1.03
"""Factor by which the amplitude of a decay may rise meanwhile."""
_SMALLEST = 0.05
"""Smallest amplitude that is told, over that of the decay that is used."""


@dataclass(frozen=True)
class EarlierDecay:
    """A free decay before the one that is used.

    Attributes
    ----------
    first, last : int
        Its first and last sample.
    cycles : float
        Its length.
    high, low : float
        The amplitude at its begin and end.
    """

    first: int
    last: int
    cycles: float
    high: float
    low: float


def earlier_decay(
    values: FloatArray, sampling_rate: float, frequency: float, later: float, noise: float
) -> EarlierDecay | None:
    """Return the free decay in what comes before the release, or None.

    What is dropped before a release is a structure at rest, in a hand or driven. A decay is none of these: it begins at
    once, or with the record, and from there the amplitude does nothing but fall for four cycles and more.

    Parameters
    ----------
    values : (n,) array
        What comes before the release.
    sampling_rate, frequency : float
        Of the samples, and of the mode [Hz].
    later : float
        Amplitude of the decay that is used.
    noise : float
        Standard deviation of single samples.
    """
    period = sampling_rate / frequency
    if values.size < (_FEWEST_CYCLES + 2.0) * period:
        return None
    # the last two cycles of the envelope hold the release that follows
    level = envelope(values, sampling_rate, frequency)[: -round(2.0 * period)]
    first = int(np.argmax(level))
    high = float(level[first])
    if high < _SMALLEST * later or high < 8.0 * noise:
        return None
    begun = np.flatnonzero(level[: first + 1] < high / 2.0)
    if begun.size and first - int(begun[-1]) > _ONSET_CYCLES * period:
        return None
    falling = level[first:]
    lowest = np.minimum.accumulate(falling)
    rises = np.flatnonzero(falling > _RIPPLE * lowest + 3.0 * noise)
    last = first + (int(rises[0]) if rises.size else falling.size) - 1
    cycles, low = (last - first) / period, float(level[last])
    is_decay = cycles > _FEWEST_CYCLES and high > _FALL * low
    return EarlierDecay(first, last, cycles, high, low) if is_decay else None


class LaterMotion(NamedTuple):
    """Motion that begins again after the end of a decay: its first sample, and its largest amplitude."""

    first: int
    amplitude: float

    def note(self, begin: float, sampling_rate: float, unit: str) -> str:
        """Return the warning; ``begin`` is the instant [s] of the sample that is counted from."""
        return (
            f"warning: the structure moves again from about {begin + self.first / sampling_rate:.5g} s on, with an "
            f"amplitude up to {self.amplitude:.3g} {unit} (a second release or impact): only the decay before is used; "
            "choose another part with `start` and `stop`"
        )


def later_motion(
    values: FloatArray, sampling_rate: float, frequency: float, used: float, noise: float
) -> LaterMotion | None:
    """Return the motion that begins again after the end of a decay, or None.

    ``values`` are those after the end; ``used`` is the amplitude of the decay, ``noise`` the standard deviation of
    single samples.
    """
    period = sampling_rate / frequency
    if values.size < _FEWEST_CYCLES * period:
        return None
    level = envelope(values, sampling_rate, frequency)
    limit = max(_SMALLEST * used, 8.0 * noise, _FALL * float(level[0]))
    above = np.flatnonzero(level > limit)
    return LaterMotion(int(above[0]), float(level.max())) if above.size > period else None


__all__ = ["EarlierDecay", "LaterMotion", "earlier_decay", "later_motion"]
