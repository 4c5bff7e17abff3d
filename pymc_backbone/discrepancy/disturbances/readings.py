"""What readings hold beside the motion of one mode: the curve of a bent sensor, and the line of another mode.

A sensor whose reading is not in proportion distorts every cycle alike at the same amplitude, as a law does: it makes
harmonics, and the fundamental fall a little faster or slower. But no spring does that without a frequency that changes,
nor a damper with a harmonic in phase. The line of another mode lies beside the harmonics. Beside the set of effects
that holds, few coefficients explain all of it, and the records can be read as without.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import combinations

import numpy as np

from ..._common.threads import in_threads
from ..drift.drift_fits import drift_fit
from ..fitting.batch import Batch
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import Fit
from ..fitting.telling import Telling, most_telling
from ..sets.fitted_sets import FittedSets
from ..sets.search import Search, Set
from ..weighing import evidence
from .close_modes import close_lines
from .disturbance import Disturbance, Disturbed
from .harmonic_lines import frequencies_of
from .left_beside import LeftBeside, left_beside
from .lines import lines_beside
from .mode_lines import ALIKE, begun_lines, left_over, lines_on_harmonics, ranges_of

_EARLY = 2  # likeliest sets that are asked for a line in the middle of a search
_ASKED = 3  # likeliest sets that are asked where none leaves noise, with what is in them
_NEAR = 3.0  # chi-square over the number of samples that a linear look promises, from which a set is not fitted
_CHANCE = 30.0  # chi-square by which chance may part records from what the best set leaves of them
_COST = 4.0  # that each coefficient must be worth
_MOST_RECORDS, _AS_HIGH = 0.6, 4.0  # share of the records that hold one line, and ratio of its heights there
_RINGS = 0.3  # decay of a line over its frequency, from which it does not ring: 5 % of critical damping
_AS_BENT = 0.25  # by which the curve of one sensor comes out differently from two records, relative


def disturbed(search: Search) -> Disturbed | None:
    """Return what disturbs the readings where that explains what effects do not, or what takes one effect more.

    Looked for where the most probable set does not leave noise, beside the likeliest and what is in these; else a line
    beside it, and both beside the sets that lack one of its effects, or hold a plain law in the place of a variant,
    which then have to explain the samples better. One sensor bends alike in all records: that is two coefficients.
    None where records are compared through a band-pass: there is nothing beside the mode in them.
    """
    batch, best = search.batch, search.best()
    if not batch.has_open_records:
        return None
    is_exact = evidence.leaves_noise(batch, search.fits[best])
    likeliest = [best] if is_exact else search.ranked()[:_ASKED]
    asked = [part for names in likeliest if names for part in combinations(names, len(names) - 1)]
    asked += likeliest
    is_rare = is_exact and (len(best) > 1 or not {*best}.isdisjoint(search.variants))
    asked += [()] if is_rare else []  # a bent sensor and nothing else is likelier than several laws, or a rare one
    plain = [other for names in asked for other in search.plainer(names)] if is_exact else []
    jobs, priced = [], []
    for names in dict.fromkeys((*asked, *plain)):
        start = search.fit_set(names)
        if start is None:
            continue
        part = most_telling(batch, start)
        left = float(search.fits[best].chi_square[part.specimens].sum())
        few = left + _CHANCE if is_exact else _NEAR * part.batch.count
        # what bends beside a set that leaves noise is not in the records
        kinds = ((True, False),) if is_exact and names == best else ((True, False), (False, True), (True, True))
        for has_line, is_bent in ((False, True),) if names in plain else kinds:
            price = _COST * (4.0 * has_line + 2.0 * is_bent) * len(batch.specimens)
            more = search.fits[best].layout.free.size - start.layout.free.size
            # one sensor bends alike in all records, and a law less is worth its parameters
            is_one = is_bent and not has_line and (bool(names) or is_rare)
            least = _COST * (2.0 - more) if is_one else price
            limit = search.fits[best].cost - least if is_exact else _NEAR * search.count
            whole = partial(left_beside, batch, start, limit, has_line=has_line, is_bent=is_bent)
            jobs.append(whole if has_line else partial(_bent_beside, part, few, whole))
            both = _CHANCE if has_line and is_bent else 0.0
            # a law in the place of another that leaves noise is no gain: only one sensor is likelier than a rare law
            dear = search.fits[best].cost - price if is_exact and is_one else np.inf
            dear = -np.inf if names in plain else dear
            laws = _COST * (len(names) + start.layout.free.size)
            priced.append((names, price + both + laws, dear))
    found: list[tuple[float, Disturbed]] = []
    for (names, price, dear), beside in zip(priced, in_threads(jobs), strict=True):
        if beside is not None and beside.is_noise and (beside.cost < dear or _is_one_sensor(beside)):
            items = dict(zip(batch.specimens, beside.items, strict=True))
            found.append((beside.cost + price, Disturbed(items, names)))
    return min(found, key=lambda item: item[0])[1] if found else None


def _is_one_sensor(beside: LeftBeside) -> bool:
    """Return whether one bent sensor may have read all records: by the same curve, of the motion or of its peak."""
    curves = np.array([(item.even, item.odd) for item in beside.items])
    scales = np.array([item.scale for item in beside.items])[:, None]
    for of in (curves, curves / (scales / np.median(scales)) ** np.array([1.0, 2.0])):
        usual = np.median(of, axis=0)
        if np.all(np.hypot(*(of - usual).T) < _AS_BENT * np.hypot(*usual)):
            return True
    return False


def early_line(search: FittedSets) -> Disturbed | None:
    """Return the line of another mode, or of what runs nearby, in what the likeliest set so far leaves; None for none.

    Asked in the middle of a search: no set leaves noise beside a line, however many are fitted. Beside one of the two
    likeliest sets, or of the best of them and the model as it is with a drift, whichever leaves least without the line.
    It has to be the same in most records, and seen in half of them where none of these sets leaves noise.
    """
    batch = search.batch
    if not batch.has_open_records:
        return None
    light = [names for names, found in search.fits.items() if not is_heavy(found.layout)]
    likeliest = sorted(light, key=lambda names: search.fits[names].cost)[:_EARLY]
    if not likeliest:
        return None
    lines, is_common = None, False
    if any(begun_lines(batch, batch, search.fits[likeliest[0]])):
        is_common = _is_common_line(batch, search.fits[likeliest[0]])
    elif (lines := close_lines(batch)) is not None:
        is_common = len(lines) > 1
    elif () not in search.fits or (lines := lines_on_harmonics(batch, search.fits[()])) is None:
        return None
    beside = partial(left_beside, batch, has_line=True, is_bent=False, lines=lines)
    found: list[tuple[LeftBeside, Set]] = []
    starts = [(names, search.fits[names], False) for names in likeliest]
    starts += [(names, search.fits[names], True) for names in dict.fromkeys(((), *likeliest[:1]))]
    for names, alone, is_drifting in starts:
        start = drift_fit(batch, alone.layout, alone.state) if is_drifting else alone
        price = 4.0 * _COST * len(batch.specimens)
        left = None if start is None else beside(start, start.cost - price)
        if left is not None and _is_one_line(batch, left.items) and (left.is_noise or is_common):
            found.append((left, names))
            if left.is_noise:
                break
    if not found:
        return None
    left, names = min(found, key=lambda item: (not item[0].is_noise, item[0].cost))
    return Disturbed(dict(zip(batch.specimens, left.items, strict=True)), names)


def _is_one_line(batch: Batch, items: list[Disturbance]) -> bool:
    """Return whether most records hold the same line: as high, at one frequency or one order of that of the motion.

    What a set lacks is taken for a line, too: of another order in each record, hardly there in some, or gone at once.
    """
    places = np.array([item.frequency for item in items])
    orders = places / np.array([record.frequency for record in batch.records])
    shares = np.array([item.line for item in items])
    heights = shares * np.array([item.scale for item in items])
    most = _MOST_RECORDS * len(items)
    rings = np.array([item.decay for item in items]) < _RINGS * places
    is_there = [rings & (np.abs(at / np.median(at) - 1.0) < ALIKE) for at in (orders, places)]
    is_high = [(size > np.median(size) / _AS_HIGH) & (size < _AS_HIGH * np.median(size)) for size in (shares, heights)]
    return any(np.count_nonzero(there & high) >= most for there in is_there for high in is_high)


def _is_common_line(batch: Batch, found: Fit) -> bool:
    """Return whether half of the records show the same line in what a set leaves of them, clear of coloured noise.

    Beside the harmonics of the motion as it was measured and as the set has it. A hum may be higher in some of them
    than the line of another mode.
    """
    orders: list[list[float]] = []
    left = left_over(batch, found)
    for r, (term, values, modelled) in enumerate(zip(batch.waveform, left, ranges_of(batch, found), strict=True)):
        record = batch.records[r]
        measured = frequencies_of(batch.levels[r], record.frequency, batch.cycles[r])
        between = min(modelled[0], measured[0]), max(modelled[1], measured[1])
        lines = lines_beside(term.compared(term.time), values, between)
        orders.append([line.frequency / record.frequency for line in lines])
    most = max((_with_line(orders, order) for own in orders for order in own), default=0)
    return 2 * most >= len(batch.records)


def _with_line(orders: list[list[float]], order: float) -> int:
    """Return in how many records there is a line at an order of the frequency."""
    return sum(any(abs(other - order) < ALIKE for other in own) for own in orders)


def _bent_beside(part: Telling, few: float, whole: Callable[[], LeftBeside | None]) -> LeftBeside | None:
    """Return the ``whole`` answer where a set leaves noise of some records behind a bent sensor: it bends in all."""
    is_there = left_beside(part.batch, part.found, few, has_line=False, is_bent=True)
    return whole() if is_there is not None and is_there.is_noise else None


__all__ = ["disturbed", "early_line"]
