"""A high-pass and a low-pass in front of the records: the coupling and the filter against aliases of an accelerometer.

Both turn the harmonics, the one ahead and the other back: either alone, at a cut-off that is not its own, makes up for
a part of what both do, and hides the other. So they are looked for together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..fitting.batch import Batch
from ..fitting.telling import most_telling
from .behind_filter import PRICE, Behind, FittedBehind, behind_it, fitted_behind, is_promising_part
from .high_passes import COUPLED, lowest_cut
from .low_passes import is_seen, look, low_passes_at, spectra
from .sensor_filter import SensorFilter

_LOOKS = 12  # cut-offs of a low-pass that are looked at beside each high-pass
_NEARER = (1.25, 1.25, 1.12, 1.06, 1.06)  # ratios between cut-offs that are tried around the best, with some records
_MEASURED = (1.06, 1.03)  # and with all


def two_filters(batch: Batch, found: Sequence[Behind], frequency: float) -> list[Behind]:
    """Return sets behind a high-pass and a low-pass, where one alone leaves more than noise.

    Those that are likeliest behind either alone.

    Parameters
    ----------
    batch : Batch
        The records, without a filter.
    found : sequence of Behind
        Sets behind one filter.
    frequency : float
        Of the mode [Hz].
    """
    ranked = sorted(found, key=lambda item: item.cost + item.price)
    likeliest = {item.filter.kind: item for item in reversed(ranked)}
    both: list[Behind] = []
    for known in sorted(likeliest.values(), key=lambda item: item.cost):
        pair = _pair(batch, known, frequency)
        both += [] if pair is None else [pair]
        if pair is not None and pair.is_exact:
            break
    return both


def _pair(batch: Batch, known: Behind, frequency: float) -> Behind | None:
    """Return a set behind the two filters that suit it best; None where they leave little less than the one it has."""
    part, left = most_telling(batch, known.found), spectra(batch, known.found)
    low = [item for item in low_passes_at(frequency, _LOOKS) if is_seen(item, left, frequency)]
    high = [SensorFilter(1, cut * frequency, "high-pass") for cut in COUPLED]
    looked = look(part.batch, known.filter, part.found, [replace(item, beside=other) for item in low for other in high])
    begun = None if looked is None else fitted_behind(part.batch, looked.best, part.found, part.found.state)
    near = None if begun is None else _nearer(part.batch, begun, _NEARER)
    if near is None or not is_promising_part(part, near):
        return None
    whole = fitted_behind(batch, near.filter, known.found, part.whole(near.found.state, known.found))
    if whole is None:
        return None
    best = _nearer(batch, whole, _MEASURED)
    pair = behind_it(batch, best.filter, best.found)
    return pair if pair.cost < known.cost - PRICE else None


def _nearer(batch: Batch, best: FittedBehind, ratios: Sequence[float]) -> FittedBehind:
    """Return the best pair around one: either cut-off in turn where a parabola through three costs is lowest."""
    for ratio in ratios:
        for k in range(len(best.filter.parts)):
            middle = best
            lower, upper = (
                fitted_behind(batch, _moved(middle.filter, k, by), middle.found, middle.found.state)
                for by in (1.0 / ratio, ratio)
            )
            if lower is None or upper is None:
                continue
            step = lowest_cut(1.0, ratio, (lower.cost(), middle.cost(), upper.cost()))
            lowest = fitted_behind(batch, _moved(middle.filter, k, step), middle.found, middle.found.state)
            tried = (middle, lower, upper, *(() if lowest is None else (lowest,)))
            best = min(tried, key=FittedBehind.cost)
    return best


def _moved(pair: SensorFilter, k: int, by: float) -> SensorFilter:
    """Return a pair of filters, one of them with another cut-off."""
    one, other = (replace(part, cut=part.cut * (by if place == k else 1.0)) for place, part in enumerate(pair.parts))
    return replace(one, beside=other)


__all__ = ["two_filters"]
