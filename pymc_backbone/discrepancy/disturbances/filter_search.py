"""Which filter stands in front of the records: behind which a set explains what none does without, or a smaller one."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..fitting.batch import Batch
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import fit
from ..sets.fitted_sets import FittedSets
from ..sets.relaxed_release import relaxed_fit, remembers
from ..sets.search import Search
from ..weighing import evidence
from .behind_filter import ITERATIONS, PRICE, Behind, behind_it
from .free_start import left_without_start
from .high_passes import COUPLED, high_pass, high_passes
from .low_passes import low_passes
from .sensor_filter import SensorFilter
from .two_filters import two_filters

_FEWEST_CYCLES = 8  # of a record, that a look needs
_ASKED = 3  # likeliest sets that are asked where none leaves noise, and what is in them
_NEAR, _LEFT = 3.0, 0.3  # chi-square over the samples, and share of what was left, that a filter leaves at most


def sensor_filter(search: Search) -> SensorFilter | None:
    """Return the filter behind which a set of effects explains the records; None where there is none.

    Looked for where the most probable set does not leave noise, with the likeliest and what is in these; else with the
    sets that lack one of its effects, which then have to explain the samples better than it does (behind a high-pass
    those of velocities and accelerations only). None where records are compared through a band-pass, which leaves no
    harmonics.
    """
    batch, best = search.batch, search.best()
    if not _may_be_behind_one(batch):
        return None
    best_cost, is_exact = search.fits[best].cost, evidence.leaves_noise(batch, search.fits[best])
    likeliest = [best] if is_exact else search.ranked()[:_ASKED]
    asked = [] if is_exact else [names for names in likeliest if names]
    asked += [part for names in likeliest if len(names) > 1 for part in combinations(names, len(names) - 1)]
    frequency = float(np.median([record.frequency for record in batch.records]))
    starts = [start for names in dict.fromkeys(asked) if (start := search.fit_set(names)) is not None]
    found = low_passes(batch, starts, frequency)
    if not is_exact or (best and all(term.order for term in batch.waveform)):
        fast = [start for start in starts if not is_heavy(start.layout)]
        found = _but_for_starts(batch, found, high_passes(batch, search.fits[()], fast, frequency))
    if not is_exact and not any(item.is_exact for item in found):
        found += two_filters(batch, found, frequency)
    # a filter's past is fitted, too: first cycles that it left are explained
    kept = [item for item in found if item.cost < best_cost - PRICE]
    noise = float(search.count)
    nearly = min(_NEAR * noise, noise + _LEFT * (best_cost - noise))
    kept = [item for item in kept if item.is_exact or (not is_exact and item.cost < nearly)]
    return min(kept, key=lambda item: item.cost + item.price).filter if kept else None


def _but_for_starts(batch: Batch, low: list[Behind], high: list[Behind]) -> list[Behind]:
    """Return sets behind low-passes and high-passes, but for what may be a start that settles.

    Of displacements that and a high-pass look alike, where the release alone shows it; what explains the records so
    needs no low-pass.
    """
    if all(term.order for term in batch.waveform):
        return low + high
    settles = [item.cost for item in high if item.filter.shows_at_release and item.is_exact]
    least = min(settles, default=np.inf)
    return [item for item in low if item.cost < least] + [item for item in high if not item.filter.shows_at_release]


def early_high_pass(search: FittedSets) -> SensorFilter | None:
    """Return the high-pass behind which the base or the best simple set so far leaves noise; None for none.

    Asked in the middle of a search for what explains velocities or accelerations: most accelerometers have one, and
    without it no set leaves noise, however many are fitted.
    """
    batch = search.batch
    if not _may_be_behind_one(batch) or not all(term.order for term in batch.waveform):
        return None
    starts = [found for names, found in search.fits.items() if names and not is_heavy(found.layout)]
    frequency = float(np.median([record.frequency for record in batch.records]))
    best = sorted(starts, key=lambda start: start.cost)[:1]
    found = [item for item in high_passes(batch, search.fits[()], best, frequency) if item.is_exact]
    return min(found, key=lambda item: item.cost + item.price).filter if found else None


def settled(search: Search, behind: Search, chosen: SensorFilter) -> SensorFilter | None:
    """Return the filter that suits what a search behind an early high-pass found; None where that needs none.

    The high-pass was told by sets that lacked something: by the set that leaves noise behind it, it is held against no
    filter, a high-pass of two poles where it has one, and low-passes where it shows at the release alone, for these
    settle there, too. ``search`` is that of the records as they are.
    """
    batch, best = search.batch, behind.fits[behind.best()]
    found = [behind_it(batch, chosen, best)]
    start = fit(best.layout, batch.waveform, best.state, iterations=ITERATIONS, nuisances=batch.nuisances)
    if start is None:
        return chosen
    if evidence.leaves_noise(batch, start) and start.cost < found[0].cost + PRICE:
        return None
    eased = relaxed_fit(batch, start) if chosen.shows_at_release and remembers(start) else None
    if eased is not None and evidence.leaves_noise(batch, eased) and eased.cost < found[0].cost + PRICE:
        return None
    if chosen.shows_at_release:
        if left_without_start(start, batch) < found[0].cost + PRICE:
            return None  # it is something at the release
    frequency = float(np.median([record.frequency for record in batch.records]))
    if chosen.order == 1:
        filters = [SensorFilter(2, cut * frequency, "high-pass") for cut in COUPLED]
        other = high_pass(batch, start, filters)
        found += [] if other is None else [behind_it(batch, other.filter, other.found)]
    if chosen.shows_at_release:
        found += low_passes(batch, [start], frequency)
    return min(found, key=lambda item: item.cost - PRICE * (item.filter == chosen)).filter


def _may_be_behind_one(batch: Batch) -> bool:
    """Return whether a filter in front of the records can be seen: harmonics that no band-pass took, and cycles."""
    is_open = batch.has_open_records and not batch.is_behind_filter
    return is_open and min(term.cycles for term in batch.waveform) >= _FEWEST_CYCLES


__all__ = ["early_high_pass", "sensor_filter", "settled"]
