"""A low-pass between structure and record: the same filter for the simulation, where that explains what no law does.

The electronics of a sensor, or a filter against aliases, whose cut-off lies a few times above the mode passes the
fundamental nearly as it is, and turns and weakens the harmonics. No law does that: what turns a third harmonic damps,
too. A smooth law then leaves the records unexplained, or a small effect beside it, mostly a clearance, stands in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from .._common.checks import FloatArray
from . import evidence
from .batch import Batch
from .data_term import WaveformTerm
from .joint_fit import Fit, fit
from .normal_equations import derivatives
from .record_term import BETWEEN, INSIDE, orthogonal_to
from .search import Search
from .whitening import with_slow_noise

_ORDERS = (1, 2, 3, 4, 6, 8)
_CUTS = (1.6, 9.0)  # cut-offs that are looked at, over the frequency of the mode
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
_ITERATIONS = 12


@dataclass(frozen=True)
class LowPass:
    """A Butterworth low-pass in front of all records.

    Attributes
    ----------
    order : int
        Number of its poles.
    cut : float
        Frequency [Hz] at which it passes half of the power.
    """

    order: int
    cut: float

    @property
    def poles(self) -> Any:
        """The poles (order,) over the angular frequency of the cut-off, complex."""
        k = np.arange(1, self.order + 1)
        return np.exp(0.5j * np.pi * (2 * k + self.order - 1) / self.order)

    def response(self, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return gain (n,) and phase (n,) [rad], which falls steadily, at frequencies (n,) [Hz]."""
        factors = 1.0 / (1.0 - 1j * np.asarray(frequency)[:, None] / self.cut / self.poles)
        return np.abs(factors).prod(axis=1), np.angle(factors).sum(axis=1)

    def passed(self, batch: Batch) -> Batch:
        """Return a batch whose simulations go through the filter before they are compared."""
        terms = [
            _passed(term, self, record.frequency) for term, record in zip(batch.waveform, batch.records, strict=True)
        ]
        return replace(batch, waveform=tuple(terms))

    def sentence(self, batch: Batch) -> str:
        """Return what was found, in one sentence."""
        ratio = self.cut / float(np.median([record.frequency for record in batch.records]))
        return (
            "warning: the harmonics of the motion are turned and weakened as behind a low-pass of order "
            f"{self.order} at {self.cut:.3g} Hz, {ratio:.1f} times the frequency of the mode; the simulation was sent "
            "through the same filter. Look at the filters of sensor, amplifier and logger"
        )


class _Chain:
    """The filter on equally spaced columns: delay and gain of the fundamental, which the release holds, taken off."""

    def __init__(self, low_pass: LowPass, frequency: float, step: float, count: int) -> None:
        slowest = 2.0 * np.pi * low_pass.cut * float(np.abs(low_pass.poles.real).min())
        gain, phase = low_pass.response(np.array([frequency]))
        delay = -float(phase[0]) / (2.0 * np.pi * frequency)
        self.count = count
        self.before = min(int(np.ceil(_FORGOTTEN / slowest / step)), count - 1)
        self.ahead = min(int(np.ceil(delay / step)) + _GIBBS, count - 1)
        self.size = next_fast_len(count + self.before + self.ahead, real=True)
        grid = rfftfreq(self.size, step)
        gains, phases = low_pass.response(grid)
        share = np.clip((2.0 * step * grid - _TAPER[0]) / (_TAPER[1] - _TAPER[0]), 0.0, 1.0)
        gains *= np.cos(0.5 * np.pi * share) ** 2 / gain[0]
        self._response = gains * np.exp(1j * (phases + 2.0 * np.pi * grid * delay))

    def __call__(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, c) behind the filter; beyond both ends they go on as their mirror image in the end."""
        around = np.pad(columns, ((self.before, self.ahead), (0, 0)), mode="reflect", reflect_type="odd")
        passed = irfft(rfft(around, self.size, axis=0) * self._response[:, None], self.size, axis=0)
        return np.asarray(passed[self.before : self.before + self.count])


def _transients(low_pass: LowPass, elapsed: FloatArray) -> FloatArray:
    """Return what the filter may still hold of the past (n, 2 order), from the first instant on.

    Its decays, and what they change by where the poles are a little elsewhere: no filter is exactly Butterworth's.
    """
    columns = []
    for pole in low_pass.poles[low_pass.poles.imag >= -1e-9]:
        past = 2.0 * np.pi * low_pass.cut * elapsed
        wave = np.exp(pole * past)
        waves = (wave, past * wave)
        columns += [part.real for part in waves]
        columns += [] if abs(pole.imag) < 1e-9 else [part.imag for part in waves]
    return np.column_stack(columns)


def _passed(term: WaveformTerm, low_pass: LowPass, frequency: float) -> WaveformTerm:
    """Return a term whose simulation goes through a filter, which begins with an unknown past."""
    step = float(np.median(np.diff(term.time)))
    chain = _Chain(low_pass, frequency, step, term.time.size)
    modes = term.signal * _transients(low_pass, term.time - term.time[0])
    behind = replace(term, whiten=with_slow_noise(term.whiten, term.compared(modes)), chain=chain)
    return _without_end(behind, int(np.ceil(chain.ahead * term.size / term.time.size)))


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


def low_pass(search: Search) -> LowPass | None:
    """Return the low-pass behind which a set of effects explains the records; None where there is none.

    Looked for where the most probable set does not leave noise, with the likeliest and what is in these; else with the
    sets that lack one of its effects, which then have to explain the samples better than it does. None where records
    are compared through a band-pass, which leaves no harmonics.
    """
    batch, best = search.batch, search.best()
    if not batch.has_open_records or any(term.chain is not None for term in batch.waveform):
        return None
    if min(term.cycles for term in batch.waveform) < _FEWEST_CYCLES:
        return None
    best_cost, is_exact = search.fits[best].cost, evidence.leaves_noise(batch, search.fits[best])
    likeliest = [best] if is_exact else search.ranked()[:_ASKED]
    asked = [] if is_exact else [names for names in likeliest if names]
    asked += [part for names in likeliest if len(names) > 1 for part in combinations(names, len(names) - 1)]
    frequency = float(np.median([record.frequency for record in batch.records]))
    filters = [LowPass(order, float(cut)) for order in _ORDERS for cut in np.geomspace(*_CUTS, _LOOKS) * frequency]
    promised = []
    for names in dict.fromkeys(asked):
        start = search.fit_set(names)
        looked = None if start is None else _look(batch, batch, start, filters)
        if start is not None and looked is not None and looked.gain > _PRICE:
            promised.append((looked.cost + _EACH * start.layout.free.size, start, looked.best))
    promised.sort(key=lambda item: item[0])
    found = [_behind(batch, start, first) for _, start, first in promised[:_FITTED]]
    # a filter's past is fitted, too: first cycles that it left are explained
    kept = [item for item in found if item is not None and item.cost < best_cost - _PRICE]
    noise = float(search.count)
    nearly = min(_NEAR * noise, noise + _LEFT * (best_cost - noise))
    kept = [item for item in kept if item.is_exact or (not is_exact and item.cost < nearly)]
    return min(kept, key=lambda item: item.cost + item.price).low_pass if kept else None


@dataclass(frozen=True)
class _Behind:
    """A set behind the low-pass that suits it best: its cost, what its parameters must be worth, if it leaves noise."""

    cost: float
    price: float
    is_exact: bool
    low_pass: LowPass


def _behind(batch: Batch, start: Fit, first: LowPass) -> _Behind | None:
    """Return a set behind the low-pass that suits it best, looked for from the first on; None where it does not fit."""
    best, behind, found = first, batch, start
    for ratio, count in ((1.0, 1), *_FINER):
        if count > 1:
            cuts = np.geomspace(best.cut / ratio, best.cut * ratio, count)
            looked = _look(batch, behind, found, [LowPass(best.order, float(cut)) for cut in cuts])
            if looked is None:
                return None
            best = looked.best
        behind = best.passed(batch)
        solved = fit(found.layout, behind.waveform, found.state, iterations=_ITERATIONS, nuisances=batch.nuisances)
        if solved is None:
            return None
        found = solved
    lowest, highest = (bound * float(np.median([record.frequency for record in batch.records])) for bound in _CUTS)
    if not lowest < best.cut < highest:
        return None
    lost = sum(term.size for term in batch.waveform) - sum(term.size for term in behind.waveform)
    return _Behind(found.cost + lost, _EACH * found.layout.free.size, evidence.leaves_noise(behind, found), best)


@dataclass(frozen=True)
class _Looked:
    """What the best of some filters promises where it does not begin: the cost, by how much less that is, and which."""

    cost: float
    gain: float
    best: LowPass


def _look(batch: Batch, behind: Batch, found: Fit, filters: list[LowPass]) -> _Looked | None:
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


__all__ = ["LowPass", "low_pass"]
