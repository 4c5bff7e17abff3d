"""Hammer tests: the hits in the channel of the force, and the free decays between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray, InputError, IntArray
from .columns import names_force
from .sensitivity import FORCE_UNITS
from .tables import Column

_SHARE_OF_PEAK, _FAR = 0.05, 8.0
_NORMAL = 1.4826  # median absolute deviation to standard deviation, for a normal distribution
_ACTS = 0.2
"""Share of the time above which a force is no hammer's: a hammer is in contact for milliseconds."""
_BOUNCE_CONTACTS, _BOUNCE_SHARE = 20.0, 0.1
_AFTER = 0.25
"""What follows the contact is left out for as much of its length: filters of the force let it end too early."""


@dataclass(frozen=True)
class Hit:
    """One hit of a hammer.

    Attributes
    ----------
    begin, end : int
        First sample of contact, and first sample after the last contact.
    peak : float
        Largest force, in the channel's unit.
    contacts : int
        How often the hammer touched: more than once is a double hit.
    """

    begin: int
    end: int
    peak: float
    contacts: int = 1


def is_force(column: Column) -> bool:
    """Return whether a column is a force, by its unit or its name.

    Examples
    --------
    >>> is_force(Column(1, "hammer [N]", "hammer", "N")), is_force(Column(1, "acc [g]", "acc", "g"))
    (True, False)
    """
    if column.unit is not None:
        return column.unit.strip() in FORCE_UNITS
    return names_force(column) and column.quantity is None


def find_hits(force: FloatArray) -> list[Hit]:
    """Find the hits in a force.

    Parameters
    ----------
    force : (n,) array
        Samples in any unit, of either sign.

    Returns
    -------
    list of Hit
        In order of time; empty where nothing stands out, or where the force acts for much of the time (a shaker's).

    Notes
    -----
    Contact is where the force is away from its median by a twentieth of the largest force and by eight standard
    deviations of its noise. Contacts that follow each other within twenty times their length, or within a tenth of the
    longest pause between contacts, are one hit: the hammer bounced.
    """
    away = np.abs(force - np.median(force))
    largest = float(away.max(initial=0.0))
    limit = max(_SHARE_OF_PEAK * largest, _FAR * _NORMAL * float(np.median(away)))
    touches = away > limit
    if not 0.0 < float(touches.mean()) < _ACTS:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touches, [False]]).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2]
    pauses = np.append(begins[1:], force.size) - ends
    longest = int(pauses.max())
    groups: list[list[int]] = []
    for k in range(begins.size):
        if groups:
            last = groups[-1][-1]
            within = max(_BOUNCE_CONTACTS * float(ends[k] - begins[k]), _BOUNCE_SHARE * longest)
            if begins[k] - ends[last] < within:
                groups[-1].append(k)
                continue
        groups.append([k])
    return [_hit(begins[group], ends[group], away) for group in groups]


def _hit(begins: IntArray, ends: IntArray, away: FloatArray) -> Hit:
    """Return the hit that a group of contacts is."""
    lengths = ends - begins
    # the ringing of a filter right after the contact is no second one
    contacts = 1 + int(np.sum(begins[1:] - ends[:-1] > 2 * lengths[:-1].clip(1)))
    after = int(np.ceil(_AFTER * int(lengths[-1])))
    peak = float(away[begins[0] : ends[-1]].max())
    return Hit(int(begins[0]), min(int(ends[-1]) + after, away.size), peak, contacts)


@dataclass(frozen=True)
class Decay:
    """The samples between a hit and the next one.

    Attributes
    ----------
    number : int
        Number of the hit, from 1; 0 where the record is whole.
    part : slice
        Samples from the end of contact to the next hit.
    notes : tuple of str
        Which hits there are and which was taken.
    """

    number: int
    part: slice
    notes: tuple[str, ...]


def decays_of(time: FloatArray, force: FloatArray, label: str, unit: str, minimum: int, name: str) -> list[Decay]:
    """Cut a record at the hits of a hammer.

    Parameters
    ----------
    time, force : (n,) arrays
        Seconds; force.
    label, unit : str
        Name and unit of the channel of force.
    minimum : int
        Samples of the shortest decay.
    name : str
        For messages.

    Returns
    -------
    list of Decay
        One for each single hit; of double hits only where there is no other. The whole record where there is no hit.

    Raises
    ------
    InputError
        When no hit is followed by enough samples.
    """
    hits = find_hits(force)
    if not hits:
        said = f"the force of channel {label!r} shows no hit of a hammer and was not used"
        return [Decay(0, slice(0, time.size), (said,))]
    # contact begins before it stands out of the noise
    stops = [hit.begin - max(2, (hit.end - hit.begin) // 4) for hit in hits[1:]] + [time.size]
    long = [k for k, stop in enumerate(stops) if stop - hits[k].end >= minimum]
    single = [k for k in long if hits[k].contacts == 1]
    taken = single or long
    if not taken:
        raise InputError(
            f"{name}: none of {len(hits)} hits in channel {label!r} is followed by {minimum} samples; record longer."
        )
    double = [f"{time[hits[k].begin]:.5g} s" for k in long if hits[k].contacts > 1]
    short = [f"{time[hits[k].begin]:.5g} s" for k in range(len(hits)) if k not in long]
    count = "1 hit" if len(hits) == 1 else f"{len(hits)} hits, {len(taken)} of which are records"
    said = f"channel {label!r} shows {count}"
    if double:
        what = "left out" if single else "taken after their last contact, for want of others"
        said += f"; double hits at {_listed(double)} were {what}"
    if short:
        said += f"; hits at {_listed(short)} with too few samples after them were left out"
    return [
        Decay(
            k + 1 if len(hits) > 1 else 0,
            slice(hits[k].end, stops[k]),
            (
                f"{said}; this is the hit at {time[hits[k].begin]:.5g} s ({hits[k].peak:.3g} {unit}), from the end of "
                f"contact at {time[hits[k].end]:.6g} s",
            ),
        )
        for k in taken
    ]


def _listed(places: list[str]) -> str:
    return ", ".join(places[:6]) + (f" and {len(places) - 6} more" if len(places) > 6 else "")
