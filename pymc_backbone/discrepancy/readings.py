"""What readings hold beside the motion of one mode: the curve of a bent sensor, and the line of another mode.

A sensor whose reading is not in proportion distorts every cycle alike at the same amplitude, as a law does: it makes
harmonics, and the fundamental fall a little faster or slower. But no spring does that without a frequency that changes,
nor a damper with a harmonic in phase. The line of another mode lies beside the harmonics. Beside the set of effects
that holds, few coefficients explain all of it, and the records can be read as without.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from .._common.checks import FloatArray
from .._common.threads import in_threads
from . import evidence
from .batch import Batch
from .data_term import WaveformTerm
from .descent import is_heavy
from .disturbance import Disturbance, Disturbed, line_modes
from .drift_fits import drift_fit
from .fitted_sets import FittedSets
from .harmonic_lines import beside_harmonics, frequencies_of, frequencies_with, is_harmonic
from .joint_fit import Fit, fit
from .lines import lines_beside
from .normal_equations import DRIFTS, State, derivatives
from .search import Search, Set
from .telling import Telling, most_telling

_MOST = 0.1  # of the reading at the largest motion: what bends by more is no sensor
_MOST_OF_A_LINE = 0.3  # of the motion: beside more, the other mode is no disturbance
_LOOKS = 3  # times that the coefficients are found again, the set fitted to what they leave
_EARLY = 2  # likeliest sets that are asked for a line in the middle of a search
_ASKED = 3  # likeliest sets that are asked where none leaves noise, with what is in them
_NEAR = 3.0  # chi-square over the number of samples that a linear look promises, from which a set is not fitted
_CHANCE = 30.0  # chi-square by which chance may part records from what the best set leaves of them
_COST = 4.0  # that each coefficient must be worth
_LINE = 25.0  # peak of the residuals' periodogram over its median that a line has at least
_FAR = 4.0  # bins between a line and a harmonic, where it is looked for
_APART = 2.0  # bins between them, once it is found
_DECAYS = (0.0, 3.0, 10.0)  # of lines over a record, as they are looked for
_MOST_RECORDS, _AS_HIGH = 0.6, 4.0  # share of the records that hold one line, and ratio of its heights there
_RINGS = 0.3  # decay of a line over its frequency, from which it does not ring: 5 % of critical damping
_AS_BENT = 0.25  # by which the curve of one sensor comes out differently from two records, relative
_ONE_FREQUENCY, _NO_ORDER = 3e-3, 0.3  # relative range of the frequencies of a hum, and that over the one of its orders
_ALIKE = 0.03  # difference of the orders of one line in specimens that are alike


class _Left(NamedTuple):
    """What a set leaves beside disturbances, these, and whether it is noise."""

    cost: float
    items: list[Disturbance]
    is_noise: bool


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
            whole = partial(_beside, batch, start, limit, has_line=has_line, is_bent=is_bent)
            jobs.append(whole if has_line else partial(_bent_beside, part, few, whole))
            both = _CHANCE if has_line and is_bent else 0.0
            dear = search.fits[best].cost - price if is_exact and is_one else np.inf
            laws = _COST * (len(names) + start.layout.free.size)
            priced.append((names, price + both + laws, dear))
    found: list[tuple[float, Disturbed]] = []
    for (names, price, dear), beside in zip(priced, in_threads(jobs), strict=True):
        if beside is not None and beside.is_noise and (beside.cost < dear or _is_one_sensor(beside)):
            items = dict(zip(batch.specimens, beside.items, strict=True))
            found.append((beside.cost + price, Disturbed(items, names)))
    return min(found, key=lambda item: item[0])[1] if found else None


def _is_one_sensor(beside: _Left) -> bool:
    """Return whether one bent sensor may have read all records: by the same even curve, of the motion or its peak."""
    shares = np.array([item.even for item in beside.items])
    curves = shares / np.array([item.scale for item in beside.items])
    return any(np.all(np.abs(of - np.median(of)) < _AS_BENT * abs(np.median(of))) for of in (shares, curves))


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
    if not likeliest or not any(_begun_lines(batch, batch, search.fits[likeliest[0]])):
        return None
    is_common = _is_common_line(batch, search.fits[likeliest[0]])
    found: list[tuple[_Left, Set]] = []
    starts = [(names, search.fits[names], False) for names in likeliest]
    starts += [(names, search.fits[names], True) for names in dict.fromkeys(((), *likeliest[:1]))]
    for names, alone, is_drifting in starts:
        start = drift_fit(batch, alone.layout, alone.state) if is_drifting else alone
        price = 4.0 * _COST * len(batch.specimens)
        left = None if start is None else _beside(batch, start, start.cost - price, has_line=True, is_bent=False)
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
    is_there = [rings & (np.abs(at / np.median(at) - 1.0) < _ALIKE) for at in (orders, places)]
    is_high = [(size > np.median(size) / _AS_HIGH) & (size < _AS_HIGH * np.median(size)) for size in (shares, heights)]
    return any(np.count_nonzero(there & high) >= most for there in is_there for high in is_high)


def _is_common_line(batch: Batch, found: Fit) -> bool:
    """Return whether half of the records show the same line in what a set leaves of them, clear of coloured noise.

    Beside the harmonics of the motion as it was measured and as the set has it. A hum may be higher in some of them
    than the line of another mode.
    """
    orders: list[list[float]] = []
    left = _left_over(batch, found)
    for r, (term, values, modelled) in enumerate(zip(batch.waveform, left, _ranges(batch, found), strict=True)):
        record = batch.records[r]
        measured = frequencies_of(batch.levels[r], record.frequency, batch.cycles[r])
        between = min(modelled[0], measured[0]), max(modelled[1], measured[1])
        lines = lines_beside(term.compared(term.time), values, between)
        orders.append([line.frequency / record.frequency for line in lines])
    most = max((_with_line(orders, order) for own in orders for order in own), default=0)
    return 2 * most >= len(batch.records)


def _with_line(orders: list[list[float]], order: float) -> int:
    """Return in how many records there is a line at an order of the frequency."""
    return sum(any(abs(other - order) < _ALIKE for other in own) for own in orders)


def _bent_beside(part: Telling, few: float, whole: Callable[[], _Left | None]) -> _Left | None:
    """Return the ``whole`` answer where a set leaves noise of some records behind a bent sensor: it bends in all."""
    is_there = _beside(part.batch, part.found, few, has_line=False, is_bent=True)
    return whole() if is_there is not None and is_there.is_noise else None


def _beside(batch: Batch, start: Fit, limit: float, *, has_line: bool, is_bent: bool) -> _Left | None:
    """Return what a set leaves beside a disturbance, and that; None where it is not less than the limit."""
    items = [
        Disturbance(
            float(term.time[0]), float(term.time[-1]), float(record.time[0]),
            float(np.abs(term.values - term.values.mean()).max()),
        )
        for term, record in zip(batch.waveform, batch.records, strict=True)
    ]  # fmt: skip
    without, found = batch, start
    nuisances = tuple(np.flatnonzero(start.active[: start.state.own.shape[1]]).tolist())  # of a drift, where it has one
    for _ in range(_LOOKS):
        if has_line:
            items = _with_lines(batch, without, found, items)
            if not any(item.frequency for item in items):
                return None
        looked = _linear(without, found, items, is_bent=is_bent)
        if looked is None or not looked.cost < limit:
            return None
        items = looked.items
        if max(item.bent for item in items) > _MOST or max(item.line for item in items) > _MOST_OF_A_LINE:
            return None
        terms = tuple(_without(term, item) for term, item in zip(batch.waveform, items, strict=True))
        without = replace(batch, waveform=terms)
        solved = fit(found.layout, terms, looked.state, iterations=10, nuisances=nuisances)
        if solved is None:
            return None
        found = solved
    if has_line and not _are_beside(batch, found, items):
        return None
    if not found.cost < limit:
        return None
    # another mode begins with the motion, before the record that is compared; what runs nearby was there before
    begun = [
        -np.inf if item.lasts else min(item.release, float(own[3]))
        for item, own in zip(items, found.state.own, strict=True)
    ]
    items = [replace(item, release=release) for item, release in zip(items, begun, strict=True)]
    return _Left(found.cost, items, evidence.lack_of_fit(without, found).p_value >= evidence.UNEXPLAINED)


def _are_beside(batch: Batch, found: Fit, items: list[Disturbance]) -> bool:
    """Return whether lines lie beside the harmonics of the motion.

    What hums at one frequency in all records may meet a harmonic of some, but not of most.
    """
    together = zip(items, _ranges(batch, found), strict=True)
    on = np.array([is_harmonic(item.frequency, at, _APART / (item.end - item.begin)) for item, at in together])
    places = np.array([item.frequency for item in items])
    orders = places / np.array([record.frequency for record in batch.records])
    return not on.any() or (2 * int(on.sum()) < on.size and _is_hum(places, orders))


def _is_hum(places: FloatArray, orders: FloatArray) -> bool:
    """Return whether lines are at one frequency, and at different orders of that of the motion."""
    at, of = (float(np.ptp(values) / np.median(values)) for values in (places, orders))
    return places.size > 1 and at < min(_ONE_FREQUENCY, _NO_ORDER * of)


def _ranges(batch: Batch, found: Fit) -> list[tuple[float, float]]:
    """Return between which frequencies [Hz] each specimen moves, as a set has it."""
    together = enumerate(zip(batch.levels, batch.records, strict=True))
    return [frequencies_with(found, r, term, record.frequency) for r, (term, record) in together]


def _without(term: WaveformTerm, item: Disturbance) -> WaveformTerm:
    """Return a term whose values hold no disturbance."""
    return replace(term, values=item.motion(term.time, term.values, step=_step(term)))


def _step(term: WaveformTerm) -> float:
    """Return the time [s] over which each value of a term is a mean."""
    return float(np.median(np.diff(term.time))) if term.together > 1 else 0.0


def _with_lines(batch: Batch, without: Batch, found: Fit, items: list[Disturbance]) -> list[Disturbance]:
    """Return disturbances with frequency and decay of a line in what the set leaves; as they are where there is none.

    Specimens are alike: where some show it, it is looked for in the others at its order there.
    """
    frequencies = np.array([record.frequency for record in batch.records])
    if not any(item.frequency for item in items):
        lines = _begun_lines(batch, without, found)
        seen = np.array(lines) > 0.0
        if not seen.any():
            return items
        places = np.array(lines)
        orders = places / frequencies
        if _is_hum(places[seen], orders[seen]):  # of one frequency, whatever the specimen does
            expected = np.full(places.size, np.median(places[seen]))
        else:
            expected = np.median(orders[seen]) * frequencies
        usual = np.where(np.abs(places - expected) < _ALIKE * frequencies, places, expected)
        items = [replace(item, frequency=float(place)) for item, place in zip(items, usual, strict=True)]
    left = _left_over(without, found)
    return [_refined(term, values, item) for term, values, item in zip(without.waveform, left, items, strict=True)]


def _left_over(without: Batch, found: Fit) -> list[FloatArray]:
    """Return what a set leaves of each record, in its unit."""
    # not whitened: the estimate of the noise holds a line too, and whitening would take most of it away
    plain = (replace(term, whiten=lambda columns: columns) for term in without.waveform)
    return [evidence.residuals_of(term, found, r) for r, term in enumerate(plain)]


def _begun_lines(batch: Batch, without: Batch, found: Fit) -> list[float]:
    """Return the frequency [Hz] of the line that stands out most in what a set leaves of each record; 0 for none."""
    return [
        _begun_line(term.compared(term.time), values, between)
        for term, values, between in zip(
            without.waveform, _left_over(without, found), _ranges(batch, found), strict=True
        )
    ]


def _begun_line(time: FloatArray, left: FloatArray, between: tuple[float, float]) -> float:
    """Return the frequency [Hz] of the line that stands out most, of any decay, from what a set leaves; 0 for none."""
    n, length = left.size, float(time[-1] - time[0])
    step = length / (n - 1)
    grid = np.fft.rfftfreq(n, step)
    best, place = _LINE, 0.0
    for decay in _DECAYS:
        power = np.abs(np.fft.rfft(left * np.exp(-decay * (time - time[0]) / length))) ** 2
        far = (_FAR + decay / np.pi) / length
        beside = beside_harmonics(grid, between, far) & (grid * length > 2.0 + decay / np.pi)
        if np.count_nonzero(beside) < 8:
            continue
        peak = int(np.flatnonzero(beside)[np.argmax(power[beside])])
        height = float(power[peak] / np.median(power[beside]))
        if height > best and power[peak] >= power[max(peak - 3, 0) : peak + 4].max():
            best, place = height, float(grid[peak])
    return place


def _refined(term: WaveformTerm, left: FloatArray, item: Disturbance) -> Disturbance:
    """Return a disturbance with that frequency and decay of its line which explain most of what a set leaves."""
    time, step = term.compared(term.time), _step(term)
    left = left + line_modes(time, item, step) @ np.array([item.cosine, item.sine])
    length = float(time[-1] - time[0])

    def misfit(at: FloatArray) -> float:
        tried = replace(item, frequency=float(at[0]) / length, decay=float(np.exp(at[1])) / length)
        held = np.linalg.qr(line_modes(time, tried, step))[0].T @ left
        return -float(held @ held)

    starts = [[item.frequency * length, np.log(item.decay * length)]] if item.decay else []
    starts = starts or [[item.frequency * length, np.log(decay)] for decay in _DECAYS if decay > 0.0]
    first = min(starts, key=lambda at: misfit(np.array(at)))
    solved = minimize(misfit, first, method="Nelder-Mead", options={"maxiter": 80, "xatol": 1e-3, "fatol": 1e-300})
    return replace(item, frequency=float(solved.x[0]) / length, decay=float(np.exp(solved.x[1])) / length)


@dataclass(frozen=True, eq=False)
class _Look:
    """What a linear look promises: the cost, the disturbances, and where the set goes."""

    cost: float
    items: list[Disturbance]
    state: State


def _linear(without: Batch, found: Fit, items: list[Disturbance], *, is_bent: bool) -> _Look | None:
    """Return where set and coefficients go in one step together; None where the set cannot be simulated."""
    layout, state, active = found.layout, found.state, found.active
    q, count = layout.free.size, len(items)
    scatter = layout.scatter if q and active[-1] and count > 1 else 0.0
    kept = np.flatnonzero(active)
    prior = (kept >= DRIFTS[0]).astype(np.float64)
    width = kept.size + 4
    matrix, right, squares = np.zeros((q + count * width,) * 2), np.zeros(q + count * width), 0.0
    for r, term in enumerate(without.waveform):
        known = derivatives(layout, term, state.eta, state.own[r], scatter, active)
        if known is None:
            return None
        columns = np.hstack([known.shared, known.own[:, kept], _modes(term, items[r], is_bent=is_bent)])
        at = np.concatenate([np.arange(q), q + r * width + np.arange(width)])
        matrix[np.ix_(at, at)] += columns.T @ columns
        right[at] += columns.T @ known.residuals
        own = at[q : q + kept.size]
        matrix[own, own] += prior
        right[own] -= prior * state.own[r, kept]
        squares += float(known.residuals @ known.residuals) + float(prior @ state.own[r, kept] ** 2)
    unit = np.sqrt(np.where(np.diag(matrix) > 0.0, np.diag(matrix), 1.0))
    step = np.linalg.lstsq(matrix / np.outer(unit, unit), right / unit, rcond=1e-12)[0] / unit
    if not np.isfinite(step).all():
        return None
    own, each = state.own.copy(), step[q:].reshape(count, width)
    has_line = any(item.frequency for item in items)
    own[:, kept] += each[:, : kept.size]
    own[:, 1] = np.maximum(own[:, 1], 0.0)
    each[:, kept.size :][:, [not is_bent, not is_bent, not has_line, not has_line]] = 0.0
    changed = [
        replace(item, even=item.even + even, odd=item.odd + odd, cosine=item.cosine + cosine, sine=item.sine + sine)
        for item, (even, odd, cosine, sine) in zip(items, each[:, kept.size :].tolist(), strict=True)
    ]
    return _Look(squares - float(step @ right), changed, State(layout.within(state.eta + step[:q]), own))


def _modes(term: WaveformTerm, item: Disturbance, *, is_bent: bool) -> FloatArray:
    """Return what a unit of each coefficient adds to the standardised values (m, 4); zeros for what is not there."""
    around = term.values - term.values.mean()
    columns = np.zeros((around.size, 4))
    if is_bent:
        columns[:, 0], columns[:, 1] = around**2 / item.scale, around**3 / item.scale**2
    if item.frequency:
        columns[:, 2:] = line_modes(term.time, item, _step(term))
    return term.whiten(term.compared(columns))


__all__ = ["disturbed", "early_line"]
