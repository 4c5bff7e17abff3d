"""Which filter stands in front of the records: behind which a set explains what none does without, or a smaller one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from .._common.checks import FloatArray
from .._common.threads import in_threads
from ..effects import BASE_EFFECTS
from . import evidence
from .batch import Batch
from .data_term import WaveformTerm
from .descent import is_heavy
from .fitted_sets import FittedSets
from .joint_fit import Fit, fit
from .normal_equations import State, derivatives
from .relaxed_release import relaxed_fit, remembers
from .search import Search
from .sensor_filter import GIBBS, Chain, SensorFilter, first_values, with_past
from .telling import Telling, most_telling
from .whitening import with_slow_noise

Spectrum = tuple[FloatArray, FloatArray]

_ORDERS = (1, 2, 3, 4, 6, 8)
_CUTS = (1.6, 9.0)  # cut-offs of low-passes that are looked at, over the frequency of the mode
_COUPLED = (0.02, 0.045, 0.1, 0.2, 0.4)  # those of high-passes behind which sets are fitted at first ...
_NEARER = (1.4, 1.18)  # ... and ratios to the best of them of those that are tried then
_MEASURED = 1.08  # that of those between which the cut-off is measured
_PROMISING = 0.8  # share of what is left of some records, that a filter leaves at most to be asked of all
_LOOKS = 20
_ERASED = 0.1  # of a third harmonic, what a low-pass passes at most that takes it away, by what it does to the first
_FALLEN = 0.1  # of the noise below the cut-off, what there is beyond it at most where the noise went through, too
_FINER = (
    (1.25, 9),
    (1.06, 7),
    (1.015, 5),
)  # ratio and number of cut-offs around the best, once the set is fitted with it
_BELOW, _BEYOND = (0.1, 0.9), (1.5, 4.0)  # frequencies over the cut-off at which the noise is held against itself
_FEWEST_CYCLES = 8  # of a record, that a look needs
_MASKED = (3.0, 0.5)  # cycles at the beginning and the end that a look leaves out
_PRICE = 16.0  # chi-square that order and cut-off must be worth
_ASKED = 3  # likeliest sets that are asked where none leaves noise, and what is in them
_EACH = 4.0  # chi-square that each parameter of a set must be worth
_FITTED = 2  # sets that are fitted behind a filter, those of which a look promises most
_NEAR, _LEFT = (
    3.0,
    0.3,
)  # chi-square over the number of samples, and share of what was left, that a filter leaves at most
_BY_HARMONICS = 0.3  # of what a high-pass explains, that its past alone leaves at least where harmonics show it
_LESS = 0.7  # of what is left where records only begin as behind a high-pass, that is left behind it at most
_ITERATIONS = 12


@dataclass(frozen=True)
class _Fitted:
    """A filter and a set behind it."""

    filter: SensorFilter
    found: Fit

    def cost(self) -> float:
        """Return what the set leaves."""
        return self.found.cost


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
    found = _low_passes(batch, starts, frequency)
    if not is_exact or (best and all(term.order for term in batch.waveform)):
        fast = [start for start in starts if not is_heavy(start.layout)]
        found += _high_passes(batch, search.fits[()], fast, frequency)
    # a filter's past is fitted, too: first cycles that it left are explained
    kept = [item for item in found if item.cost < best_cost - _PRICE]
    noise = float(search.count)
    nearly = min(_NEAR * noise, noise + _LEFT * (best_cost - noise))
    kept = [item for item in kept if item.is_exact or (not is_exact and item.cost < nearly)]
    return min(kept, key=lambda item: item.cost + item.price).filter if kept else None


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
    found = [item for item in _high_passes(batch, search.fits[()], best, frequency) if item.is_exact]
    return min(found, key=lambda item: item.cost + item.price).filter if found else None


def settled(search: Search, behind: Search, chosen: SensorFilter) -> SensorFilter | None:
    """Return the filter that suits what a search behind an early high-pass found; None where that needs none.

    The high-pass was told by sets that lacked something: by the set that leaves noise behind it, it is held against no
    filter, a high-pass of two poles where it has one, and low-passes where it shows at the release alone, for these
    settle there, too. ``search`` is that of the records as they are.
    """
    batch, best = search.batch, behind.fits[behind.best()]
    found = [_behind_it(batch, chosen, best)]
    start = fit(best.layout, batch.waveform, best.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
    if start is None:
        return chosen
    if evidence.leaves_noise(batch, start) and start.cost < found[0].cost + _PRICE:
        return None
    eased = relaxed_fit(batch, start) if chosen.shows_at_release and remembers(start) else None
    if eased is not None and evidence.leaves_noise(batch, eased) and eased.cost < found[0].cost + _PRICE:
        return None
    if chosen.shows_at_release:
        free = sum(first_values(term).shape[1] for term in batch.waveform)
        if _left_by(start, batch, _free_at_first(batch)) + free < found[0].cost + _PRICE:
            return None  # it is something at the release
    frequency = float(np.median([record.frequency for record in batch.records]))
    if chosen.order == 1:
        filters = [SensorFilter(2, cut * frequency, "high-pass") for cut in _COUPLED]
        other = _high_pass(batch, start, filters)
        found += [] if other is None else [_behind_it(batch, other.filter, other.found)]
    if chosen.shows_at_release:
        found += _low_passes(batch, [start], frequency)
    return min(found, key=lambda item: item.cost - _PRICE * (item.filter == chosen)).filter


def _may_be_behind_one(batch: Batch) -> bool:
    """Return whether a filter in front of the records can be seen: harmonics that no band-pass took, and cycles."""
    is_open = batch.has_open_records and not batch.is_behind_filter
    return is_open and min(term.cycles for term in batch.waveform) >= _FEWEST_CYCLES


def _low_passes(batch: Batch, starts: Sequence[Fit], frequency: float) -> list[_Behind]:
    """Return sets behind the low-passes that suit them, those of which a look promises most."""
    filters = [SensorFilter(order, float(cut)) for order in _ORDERS for cut in np.geomspace(*_CUTS, _LOOKS) * frequency]
    promised = []
    for start in starts:
        part = most_telling(batch, start)
        left = _spectra(batch, start)
        seen = [item for item in filters if _is_seen(item, left, frequency)]
        looked = _look(part.batch, part.batch, part.found, seen) if seen else None
        if looked is not None and looked.gain > _PRICE:
            price = _EACH * start.layout.free.size
            promised.append((looked.cost * batch.count / part.batch.count + price, start, looked.best))
    promised.sort(key=lambda item: item[0])
    found = [_behind(batch, start, first) for _, start, first in promised[:_FITTED]]
    return [item for item in found if item is not None]


def _high_passes(batch: Batch, base: Fit, starts: Sequence[Fit], frequency: float) -> list[_Behind]:
    """Return sets behind the high-passes that suit them, of one pole where that leaves noise, else of two.

    What tells one is mostly the slow decay after the jump at the release, and no look from fits without it: so the base
    and the sets that leave least are fitted behind some, each begun where the one before ended, and further where less
    is left. Decays of one pole and of two are much alike: where the release alone shows a filter, both are tried.
    """
    begun = [base, *sorted(starts, key=lambda start: start.cost)[:_FITTED]]
    found: list[_Behind] = []
    for order in (1, 2):
        filters = [SensorFilter(order, cut * frequency, "high-pass") for cut in _COUPLED]
        kept = []
        for few in ([start for start in begun if start is base], [start for start in begun if start is not base]):
            passed = in_threads([partial(_high_pass, batch, start, filters) for start in few])
            for start, best in zip(few, passed, strict=True):
                if best is not None:
                    kept.append(start)
                    found.append(_behind_it(batch, best.filter, best.found))
            if kept == [base] and found[-1].is_exact:
                break  # nothing else is needed
        begun = kept
        if any(item.is_exact and not item.filter.shows_at_release for item in found):
            break
    return found


def _high_pass(batch: Batch, start: Fit, filters: Sequence[SensorFilter]) -> _Fitted | None:
    """Return the high-pass that suits a set best, and the set behind it; None where it leaves little less.

    Looked for with the records that the set leaves most of, and measured with all. A motion without harmonics shows it
    at the release alone, where records begin with what it has of the past: it then has to leave noise where the set
    without it does not, nor free first values do.
    """

    def fitted(on: Batch, chosen: SensorFilter, state: State) -> list[_Fitted]:
        terms = chosen.passed(on).waveform
        solved = fit(start.layout, terms, state, iterations=_ITERATIONS, nuisances=on.nuisances)
        return [] if solved is None else [_Fitted(chosen, solved)]

    part = most_telling(batch, start)
    tried: list[_Fitted] = []
    for chosen in filters:
        tried += fitted(part.batch, chosen, (tried[-1].found if tried else part.found).state)
    best = min(tried, key=_Fitted.cost, default=None)
    if best is None or not _is_promising(part, best):
        return None
    for ratio in _NEARER:
        near, reached = best.filter, best.found.state
        sides = [
            item
            for by in (1.0 / ratio, ratio)
            for item in fitted(part.batch, replace(near, cut=by * near.cut), reached)
        ]
        best = min([best, *sides], key=_Fitted.cost)
    whole = fitted(batch, best.filter, part.whole(best.found.state, start))
    whole += [
        again for item in whole if not item.found.is_converged for again in fitted(batch, item.filter, item.found.state)
    ]
    if not whole:
        return None
    best = whole[-1]
    past = _left_by(start, batch, [with_past(term, best.filter) for term in batch.waveform])
    is_exact = best.cost() < start.cost - _PRICE and _is_exact(batch, best)
    if not is_exact and not best.cost() < _LESS * past - _PRICE:
        return None
    is_linear = all(effect.name in BASE_EFFECTS for effect in start.layout.oscillator.effects)  # without harmonics
    shows_at_release = is_linear or past - best.cost() < _BY_HARMONICS * (start.cost - best.cost())
    if shows_at_release and not all(term.order for term in batch.waveform):
        return None  # of a displacement, a start that settles looks alike
    if shows_at_release and not best.cost() < _left_by(start, batch, _free_at_first(batch)) - _PRICE:
        return None
    at, known = best.filter, best.found
    lower, upper = (fitted(batch, replace(at, cut=by * at.cut), known.state) for by in (1.0 / _MEASURED, _MEASURED))
    best = min([best, *lower, *upper], key=_Fitted.cost)
    if lower and upper:
        cut = _lowest(at.cut, _MEASURED, (lower[0].cost(), known.cost, upper[0].cost()))
        best = min([best, *fitted(batch, replace(at, cut=cut), best.found.state)], key=_Fitted.cost)
    return replace(best, filter=replace(best.filter, shows_at_release=shows_at_release))


def _is_promising(part: Telling, best: _Fitted) -> bool:
    """Return whether a set leaves clearly less of some records behind a filter than without one."""
    return best.cost() < _PROMISING * part.left or _is_exact(part.batch, best)


def _lowest(cut: float, ratio: float, costs: tuple[float, float, float]) -> float:
    """Return where the parabola through the costs at ``cut / ratio``, ``cut`` and ``cut * ratio`` is lowest.

    One of the outer two where it is nowhere between them.
    """
    low, middle, high = costs
    bend = low - 2.0 * middle + high
    step = 0.5 * (low - high) / bend if bend > 0.0 else float(np.sign(low - high))
    return float(cut * ratio ** np.clip(step, -1.0, 1.0))


def _is_exact(batch: Batch, behind: _Fitted) -> bool:
    """Return whether a set leaves noise behind a filter."""
    return evidence.leaves_noise(behind.filter.passed(batch), behind.found)


def _left_by(start: Fit, batch: Batch, terms: Sequence[WaveformTerm]) -> float:
    """Return the cost of a set with records that may begin otherwise and go through no filter."""
    solved = fit(start.layout, tuple(terms), start.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
    return np.inf if solved is None else solved.cost


def _free_at_first(batch: Batch) -> list[WaveformTerm]:
    """Return the terms of records whose first values say nothing."""
    return [
        replace(term, whiten=with_slow_noise(term.whiten, term.compared(first_values(term)))) for term in batch.waveform
    ]


@dataclass(frozen=True)
class _Behind:
    """A set behind the filter that suits it best: its cost, what its parameters must be worth, if it leaves noise."""

    cost: float
    price: float
    is_exact: bool
    filter: SensorFilter


def _behind(batch: Batch, start: Fit, first: SensorFilter) -> _Behind | None:
    """Return a set behind the filter that suits it best, looked for from the first on; None where it does not fit.

    Looked for with the records that the set leaves most of, and measured with all.
    """
    part = most_telling(batch, start)
    best = _looked_for(part.batch, _Fitted(first, part.found))
    if best is None or not _is_promising(part, best):
        return None
    behind = best.filter.passed(batch)
    begun = part.whole(best.found.state, start)
    found = fit(start.layout, behind.waveform, begun, iterations=_ITERATIONS, nuisances=batch.nuisances)
    if found is None:
        return None
    best = _Fitted(best.filter, found)
    if len(part.specimens) < len(batch.specimens):
        measured = _nearer(batch, behind, best, *_FINER[-1])
        best = best if measured is None or measured.cost() > best.cost() else measured
    frequency = float(np.median([record.frequency for record in batch.records]))
    is_inside = _CUTS[0] < best.filter.cut / frequency < _CUTS[1]
    if not (is_inside and _is_seen(best.filter, _spectra(batch, start), frequency)):
        return None
    return _behind_it(batch, best.filter, best.found)


def _is_seen(low_pass: SensorFilter, left: Sequence[Spectrum], frequency: float) -> bool:
    """Return whether a low-pass shows in the records: in harmonics that it turns and weakens, or in their noise.

    One that takes all harmonics away makes up for any law whose harmonics are wrong. It is one of the records only
    where the noise of most of them went through it as well. ``left`` are the spectra of what a set leaves.
    """
    first, third = low_pass.response(np.array([1.0, 3.0]) * frequency)[0]
    return bool(third > _ERASED * first or np.mean([_falls(low_pass.cut, *item) for item in left]) > 0.5)


def _falls(cut: float, at: FloatArray, power: FloatArray) -> bool:
    """Return whether there is much less noise beyond a frequency [Hz] than below."""
    ratio = at / cut
    below, beyond = (power[(ratio > low) & (ratio < high)] for low, high in (_BELOW, _BEYOND))
    return bool(below.size and beyond.size and np.median(beyond) < _FALLEN * np.median(below))


def _spectra(batch: Batch, found: Fit) -> list[Spectrum]:
    """Return frequencies (n,) [Hz] and the power (n,) of what a set leaves of each record."""
    spectra = []
    for r, term in enumerate(batch.waveform):
        left = evidence.residuals_as_measured(term, found, r)
        power = np.abs(np.fft.rfft(left * np.hanning(left.size))) ** 2
        spectra.append((np.fft.rfftfreq(left.size, float(np.median(np.diff(term.time)))), power))
    return spectra


def _looked_for(batch: Batch, begun: _Fitted) -> _Fitted | None:
    """Return the low-pass that suits a set best, and the set behind it, from one and the set without."""
    terms, known = begun.filter.passed(batch).waveform, begun.found
    found = fit(known.layout, terms, known.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
    best = None if found is None else _Fitted(begun.filter, found)
    for ratio, count in _FINER:
        best = None if best is None else _nearer(batch, best.filter.passed(batch), best, ratio, count)
    return best


def _nearer(batch: Batch, behind: Batch, known: _Fitted, ratio: float, count: int) -> _Fitted | None:
    """Return the best of so many cut-offs within a ratio of the known one as a look has it, and the set behind it."""
    cuts = np.geomspace(known.filter.cut / ratio, known.filter.cut * ratio, count)
    looked = _look(batch, behind, known.found, [replace(known.filter, cut=float(cut)) for cut in cuts])
    if looked is None:
        return None
    terms = looked.best.passed(batch).waveform
    found = fit(known.found.layout, terms, known.found.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
    return None if found is None else _Fitted(looked.best, found)


def _behind_it(batch: Batch, best: SensorFilter, found: Fit) -> _Behind:
    """Return what a fit behind a filter says of both."""
    behind = best.passed(batch)
    lost = sum(term.size for term in batch.waveform) - sum(term.size for term in behind.waveform)
    each = 2.0 * best.order + GIBBS * (best.kind == "high-pass")  # amounts of what a filter held before, all fitted
    past = each * len(batch.specimens)
    price = _EACH * found.layout.free.size
    return _Behind(found.cost + lost + past, price, evidence.leaves_noise(behind, found), best)


@dataclass(frozen=True)
class _Looked:
    """What the best of some filters promises where it does not begin: the cost, by how much less that is, and which."""

    cost: float
    gain: float
    best: SensorFilter


def _look(batch: Batch, behind: Batch, found: Fit, filters: list[SensorFilter]) -> _Looked | None:
    """Return what the best of some filters and one step of the set's values promise; None where that fails.

    ``behind`` is the batch whose terms the set was fitted to, ``batch`` the same without a filter.
    """
    kept = np.flatnonzero(found.active)
    scatter = found.layout.scatter if found.active[-1] and len(batch.specimens) > 1 else 0.0
    shared: list[FloatArray] = []
    left: list[FloatArray] = []
    for r, (term, known, record) in enumerate(zip(batch.waveform, behind.waveform, batch.records, strict=True)):
        slopes = derivatives(found.layout, known, found.state.eta, found.state.own[r], scatter, found.active)
        if slopes is None:
            return None
        rows = _rows(term, known)
        own = np.linalg.qr(slopes.own[rows][:, kept])[0]
        bare = replace(term, whiten=lambda columns: columns)
        seen = bare.compared(term.values)
        simulated = seen - evidence.residuals_of(bare, found, r)
        step = float(np.median(np.diff(term.time)))
        columns = [simulated]
        columns += [Chain(item, record.frequency, step, seen.size)(simulated[:, None])[:, 0] for item in filters]
        residuals = term.whiten(seen[:, None] - np.column_stack(columns))[rows]
        for items, wanted in ((shared, slopes.shared[rows]), (left, residuals)):
            items.append(wanted - own @ (own.T @ wanted))
    effects, residuals = np.vstack(shared), np.vstack(left)
    if effects.shape[1]:
        basis = np.linalg.qr(effects)[0]
        residuals = residuals - basis @ (basis.T @ residuals)
    costs = (residuals**2).sum(axis=0)
    best = int(np.argmin(costs[1:]))
    return _Looked(float(costs[1 + best]), float(costs[0] - costs[1 + best]), filters[best])


def _rows(term: WaveformTerm, known: WaveformTerm) -> slice:
    """Return the standardised values that a look compares: those that the past of the filter does not reach.

    ``known`` is the term behind a filter, which ends earlier.
    """
    each = term.size / term.cycles
    return slice(round(_MASKED[0] * each), min(term.size - round(_MASKED[1] * each), known.size))


__all__ = ["early_high_pass", "sensor_filter", "settled"]
