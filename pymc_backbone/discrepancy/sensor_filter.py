"""A filter between structure and record: the same one for the simulation, where that explains what no law does.

The electronics of a sensor, or a filter against aliases, whose cut-off lies a few times above the mode passes the
fundamental nearly as it is, and turns and weakens the harmonics. A coupling to alternating current, as most
accelerometers have it, turns the fundamental away from its harmonics and makes a slow decay of the jump at the release.
No law does that: what turns a third harmonic damps, too. A smooth law then leaves the records unexplained, or a small
effect beside it, mostly a clearance, stands in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from .._common.checks import FloatArray
from . import evidence
from .batch import Batch
from .data_term import WaveformTerm
from .descent import is_heavy
from .joint_fit import Fit, fit
from .normal_equations import derivatives
from .record_term import BETWEEN, INSIDE, beside_jumps, orthogonal_to
from .search import Search
from .whitening import with_slow_noise

Kind = Literal["low-pass", "high-pass"]

_ORDERS = (1, 2, 3, 4, 6, 8)
_CUTS = (1.6, 9.0)  # cut-offs of low-passes that are looked at, over the frequency of the mode
_COUPLED = (0.02, 0.045, 0.1, 0.2, 0.4)  # those of high-passes behind which sets are fitted at first ...
_NEARER = (1.4, 1.18, 1.08, 1.03)  # ... and ratios to the best of them of those that are tried then
_LOOKS = 20
_FINER = (
    (1.25, 9),
    (1.06, 7),
    (1.015, 5),
)  # ratio and number of cut-offs around the best, once the set is fitted with it
_FORGOTTEN = 13.8  # time constants of the slowest pole after which a filter's past is 1e-6
_TAPER = (0.75, 1.0)  # of the highest frequency that the samples hold: beyond, the filter is closed smoothly
_GIBBS = 8  # samples beyond the delay by which the filter looks ahead
_FEWEST = 4  # values of a window
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
class SensorFilter:
    """A Butterworth filter in front of all records.

    Attributes
    ----------
    order : int
        Number of its poles.
    cut : float
        Frequency [Hz] at which it passes half of the power.
    kind : str
        Which frequencies pass.
    shows_at_release : bool
        Whether it is told by the slow decay after the release alone, and not by the harmonics.
    """

    order: int
    cut: float
    kind: Kind = "low-pass"
    shows_at_release: bool = False

    @property
    def poles(self) -> Any:
        """The poles (order,) over the angular frequency of the cut-off, complex."""
        k = np.arange(1, self.order + 1)
        return np.exp(0.5j * np.pi * (2 * k + self.order - 1) / self.order)

    def response(self, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return gain (n,) and phase (n,) [rad], which falls steadily, at frequencies (n,) [Hz]."""
        ratio = np.asarray(frequency, dtype=np.float64)[:, None] / self.cut
        if self.kind == "high-pass":
            factors = ratio / (ratio + 1j / self.poles)
        else:
            factors = 1.0 / (1.0 - 1j * ratio / self.poles)
        return np.abs(factors).prod(axis=1), np.angle(factors).sum(axis=1)

    def passed(self, batch: Batch) -> Batch:
        """Return a batch whose simulations go through the filter before they are compared."""
        terms = [
            _passed(term, self, record.frequency) for term, record in zip(batch.waveform, batch.records, strict=True)
        ]
        return replace(batch, waveform=tuple(terms))

    def sentence(self, batch: Batch) -> str:
        """Return what was found, in one sentence."""
        look = "Look at the filters of sensor, amplifier and logger"
        if self.shows_at_release:  # which says little of its order and cut-off
            return (
                f"warning: the records begin with a slow decay beside the motion, as behind a {self.kind} below the "
                f"frequency of the mode; the simulation was sent through one. {look}"
            )
        ratio = self.cut / float(np.median([record.frequency for record in batch.records]))
        done = "turned" if self.kind == "high-pass" else "turned and weakened"
        return (
            f"warning: the harmonics of the motion are {done} as behind a {self.kind} of order "
            f"{self.order} at {self.cut:.3g} Hz, {ratio:.2g} times the frequency of the mode; the simulation was sent "
            f"through the same filter. {look}"
        )


class _Chain:
    """The filter on equally spaced columns: delay and gain of the fundamental, which the release holds, taken off."""

    def __init__(self, chosen: SensorFilter, frequency: float, step: float, count: int) -> None:
        slowest = 2.0 * np.pi * chosen.cut * float(np.abs(chosen.poles.real).min())
        gain, phase = chosen.response(np.array([frequency]))
        delay = -float(phase[0]) / (2.0 * np.pi * frequency)
        self.count = count
        self.before = min(int(np.ceil(_FORGOTTEN / slowest / step)), count - 1)
        self.ahead = min(max(int(np.ceil(delay / step)), 0) + _GIBBS, count - 1)
        self.size = next_fast_len(count + self.before + self.ahead, real=True)
        grid = rfftfreq(self.size, step)
        gains, phases = chosen.response(grid)
        share = np.clip((2.0 * step * grid - _TAPER[0]) / (_TAPER[1] - _TAPER[0]), 0.0, 1.0)
        gains *= np.cos(0.5 * np.pi * share) ** 2 / gain[0]
        self._response = gains * np.exp(1j * (phases + 2.0 * np.pi * grid * delay))

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, c) behind the filter; beyond both ends they go on as their mirror image in the end."""
        around = np.pad(columns, ((self.before, self.ahead), (0, 0)), mode="reflect", reflect_type="odd")
        passed = irfft(rfft(around, self.size, axis=0) * self._response[:, None], self.size, axis=0)
        return np.asarray(passed[self.before : self.before + self.count])


def _transients(chosen: SensorFilter, elapsed: FloatArray) -> FloatArray:
    """Return what the filter may still hold of the past (n, 2 order), from the first instant on.

    Its decays, and what they change by where the poles are a little elsewhere: no filter is exactly Butterworth's.
    """
    columns = []
    for pole in chosen.poles[chosen.poles.imag >= -1e-9]:
        past = 2.0 * np.pi * chosen.cut * elapsed
        wave = np.exp(pole * past)
        waves = (wave, past * wave)
        columns += [part.real for part in waves]
        columns += [] if abs(pole.imag) < 1e-9 else [part.imag for part in waves]
    return np.column_stack(columns)


def _passed(term: WaveformTerm, chosen: SensorFilter, frequency: float) -> WaveformTerm:
    """Return a term whose simulation goes through a filter, which begins with an unknown past."""
    step = float(np.median(np.diff(term.time)))
    chain = _Chain(chosen, frequency, step, term.time.size)
    ahead = float(chosen.response(np.array([frequency]))[1][0]) / (2.0 * np.pi * frequency)
    behind = replace(_with_past(beside_jumps(term, ahead), chosen), chain=chain)
    return _without_end(behind, int(np.ceil(chain.ahead * term.size / term.time.size)))


def _with_past(term: WaveformTerm, chosen: SensorFilter) -> WaveformTerm:
    """Return a term that may hold what a filter still has of the past."""
    modes = term.signal * _transients(chosen, term.time - term.time[0])
    if chosen.kind == "high-pass":  # which is ahead of the motion: its first values lie between samples not all known
        modes = np.hstack([modes, _first_values(term)])
    return replace(term, whiten=with_slow_noise(term.whiten, term.compared(modes)))


def _first_values(term: WaveformTerm) -> FloatArray:
    """Return what leaves the first values of a record free (n, `_GIBBS`)."""
    return term.signal * np.eye(term.time.size, min(_GIBBS, term.time.size))


def _without_end(term: WaveformTerm, lost: int) -> WaveformTerm:
    """Return a term without its last standardised values, for which the motion after the record would be needed."""
    size, whiten = term.size - lost, term.whiten
    subspace, beside = [], []
    for index, (window, basis) in enumerate(term.subspace):
        kept = slice(window.start, min(window.stop, size))
        rows = kept.stop - kept.start
        if rows < _FEWEST:
            continue
        whole = rows == basis.shape[0]
        inside = basis if whole else np.linalg.qr(basis[:rows, : int(INSIDE * rows)])[0]
        subspace.append((kept, inside))
        if term.beside:
            between = term.beside[index][1]
            if not whole:
                between = orthogonal_to(inside, between[:rows, : int(BETWEEN * rows)])
            beside.append((kept, between))

    def shorter(columns: FloatArray) -> FloatArray:
        return whiten(columns)[:size]

    return replace(term, whiten=shorter, size=size, subspace=subspace, beside=beside)


def sensor_filter(search: Search) -> SensorFilter | None:
    """Return the filter behind which a set of effects explains the records; None where there is none.

    Looked for where the most probable set does not leave noise, with the likeliest and what is in these; else with the
    sets that lack one of its effects, which then have to explain the samples better than it does (behind a high-pass
    those of velocities and accelerations only). None where records are compared through a band-pass, which leaves no
    harmonics.
    """
    batch, best = search.batch, search.best()
    if not batch.has_open_records or batch.is_behind_filter:
        return None
    if min(term.cycles for term in batch.waveform) < _FEWEST_CYCLES:
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


def _low_passes(batch: Batch, starts: Sequence[Fit], frequency: float) -> list[_Behind]:
    """Return sets behind the low-passes that suit them, those of which a look promises most."""
    filters = [SensorFilter(order, float(cut)) for order in _ORDERS for cut in np.geomspace(*_CUTS, _LOOKS) * frequency]
    promised = []
    for start in starts:
        looked = _look(batch, batch, start, filters)
        if looked is not None and looked.gain > _PRICE:
            promised.append((looked.cost + _EACH * start.layout.free.size, start, looked.best))
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
        for start in list(begun):
            best = _high_pass(batch, start, [SensorFilter(order, cut * frequency, "high-pass") for cut in _COUPLED])
            if best is None:
                begun.remove(start)
                continue
            found.append(_behind_it(batch, *best))
            if found[-1].is_exact and start is base:
                begun = [base]  # nothing else is needed
                break
        if any(item.is_exact and not item.filter.shows_at_release for item in found):
            break
    return found


def _high_pass(batch: Batch, start: Fit, filters: Sequence[SensorFilter]) -> tuple[SensorFilter, Fit] | None:
    """Return the high-pass that suits a set best, and the set behind it; None where it leaves little less.

    A motion without harmonics shows it at the release alone, where records begin with what it has of the past: it then
    has to leave noise where the set without it does not, nor free first values do.
    """

    def fitted(chosen: SensorFilter, known: Fit) -> list[tuple[SensorFilter, Fit]]:
        terms = chosen.passed(batch).waveform
        solved = fit(known.layout, terms, known.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
        return [] if solved is None else [(chosen, solved)]

    def cost(item: tuple[SensorFilter, Fit]) -> float:
        return item[1].cost

    tried = [(filters[0], start)]
    for chosen in filters:
        tried += fitted(chosen, tried[-1][1])
    best = min(tried[1:], key=cost, default=None)
    if best is None:
        return None
    past = _left_by(start, batch, [_with_past(term, best[0]) for term in batch.waveform])
    is_exact = best[1].cost < start.cost - _PRICE and _is_exact(batch, best)
    if not is_exact and not best[1].cost < _LESS * past - _PRICE:
        return None
    shows_at_release = past - best[1].cost < _BY_HARMONICS * (start.cost - best[1].cost)
    if shows_at_release and not best[1].cost < _left_by(start, batch, _free_at_first(batch)) - _PRICE:
        return None
    for ratio in _NEARER:
        at, found = best
        best = min(
            [best, *(item for by in (ratio, 1.0 / ratio) for item in fitted(replace(at, cut=by * at.cut), found))],
            key=cost,
        )
    return replace(best[0], shows_at_release=shows_at_release), best[1]


def _is_exact(batch: Batch, behind: tuple[SensorFilter, Fit]) -> bool:
    """Return whether a set leaves noise behind a filter."""
    chosen, found = behind
    return evidence.leaves_noise(chosen.passed(batch), found)


def _left_by(start: Fit, batch: Batch, terms: Sequence[WaveformTerm]) -> float:
    """Return the cost of a set with records that may begin otherwise and go through no filter."""
    solved = fit(start.layout, tuple(terms), start.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
    return np.inf if solved is None else solved.cost


def _free_at_first(batch: Batch) -> list[WaveformTerm]:
    """Return the terms of records whose first values say nothing."""
    return [
        replace(term, whiten=with_slow_noise(term.whiten, term.compared(_first_values(term))))
        for term in batch.waveform
    ]


@dataclass(frozen=True)
class _Behind:
    """A set behind the filter that suits it best: its cost, what its parameters must be worth, if it leaves noise."""

    cost: float
    price: float
    is_exact: bool
    filter: SensorFilter


def _behind(batch: Batch, start: Fit, first: SensorFilter) -> _Behind | None:
    """Return a set behind the filter that suits it best, looked for from the first on; None where it does not fit."""
    best, behind, found = first, batch, start
    for ratio, count in ((1.0, 1), *_FINER):
        if count > 1:
            cuts = np.geomspace(best.cut / ratio, best.cut * ratio, count)
            looked = _look(batch, behind, found, [replace(best, cut=float(cut)) for cut in cuts])
            if looked is None:
                return None
            best = looked.best
        behind = best.passed(batch)
        solved = fit(found.layout, behind.waveform, found.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
        if solved is None:
            return None
        found = solved
    lowest, highest = (bound * float(np.median([record.frequency for record in batch.records])) for bound in _CUTS)
    return _behind_it(batch, best, found) if lowest < best.cut < highest else None


def _behind_it(batch: Batch, best: SensorFilter, found: Fit) -> _Behind:
    """Return what a fit behind a filter says of both."""
    behind = best.passed(batch)
    lost = sum(term.size for term in batch.waveform) - sum(term.size for term in behind.waveform)
    each = 2.0 * best.order + _GIBBS * (best.kind == "high-pass")  # amounts of what a filter held before, all fitted
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
        columns += [_Chain(item, record.frequency, step, seen.size)(simulated[:, None])[:, 0] for item in filters]
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


__all__ = ["SensorFilter", "sensor_filter"]
