"""Low-passes in front of the records: those that turn and weaken the harmonics as the records show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import FloatArray
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..fitting.normal_equations import derivatives
from ..fitting.telling import most_telling
from ..fitting.waveform_term import WaveformTerm
from ..weighing import evidence
from .behind_filter import EACH, ITERATIONS, MOST_FITTED, PRICE, Behind, FittedBehind, behind_it, is_promising_part
from .sensor_filter import Chain, SensorFilter

Spectrum = tuple[FloatArray, FloatArray]

_ORDERS = (1, 2, 3, 4, 6, 8)
_CUTS = (1.6, 9.0)  # cut-offs that are looked at, over the frequency of the mode
_LOOKS = 20
_ERASED = 0.1  # of a third harmonic, what a low-pass passes at most that takes it away, by what it does to the first
_FALLEN = 0.1  # of the noise below the cut-off, what there is beyond it at most where the noise went through, too
_FINER = ((1.25, 9), (1.06, 7), (1.015, 5))  # ratio and number of cut-offs around the best, with the set fitted to it
_BELOW, _BEYOND = (0.1, 0.9), (1.5, 4.0)  # frequencies over the cut-off at which the noise is held against itself
_MASKED = (3.0, 0.5)  # cycles at the beginning and the end that a look leaves out ...
_DECAYED, _MOST_MASKED = 4.0, 0.5  # ... and time constants of another filter, up to that share of a record


def low_passes(batch: Batch, starts: Sequence[Fit], frequency: float) -> list[Behind]:
    """Return sets behind the low-passes that suit them, those of which a look promises most."""
    filters = low_passes_at(frequency, _LOOKS)
    promised = []
    for start in starts:
        part = most_telling(batch, start)
        left = spectra(batch, start)
        seen = [item for item in filters if is_seen(item, left, frequency)]
        looked = look(part.batch, None, part.found, seen) if seen else None
        if looked is not None and looked.gain > PRICE:
            price = EACH * start.layout.free.size
            promised.append((looked.cost * batch.count / part.batch.count + price, start, looked.best))
    promised.sort(key=lambda item: item[0])
    found = [_behind(batch, start, first) for _, start, first in promised[:MOST_FITTED]]
    return [item for item in found if item is not None]


def _behind(batch: Batch, start: Fit, first: SensorFilter) -> Behind | None:
    """Return a set behind the filter that suits it best, looked for from the first on; None where it does not fit.

    Looked for with the records that the set leaves most of, and measured with all.
    """
    part = most_telling(batch, start)
    best = _looked_for(part.batch, FittedBehind(first, part.found))
    if best is None or not is_promising_part(part, best):
        return None
    behind = best.filter.passed(batch)
    begun = part.whole(best.found.state, start)
    found = fit(start.layout, behind.waveform, begun, iterations=ITERATIONS, nuisances=batch.nuisances)
    if found is None:
        return None
    best = FittedBehind(best.filter, found)
    if len(part.specimens) < len(batch.specimens):
        measured = _nearer(batch, best, *_FINER[-1])
        best = best if measured is None or measured.cost() > best.cost() else measured
    frequency = float(np.median([record.frequency for record in batch.records]))
    is_inside = _CUTS[0] < best.filter.cut / frequency < _CUTS[1]
    if not (is_inside and is_seen(best.filter, spectra(batch, start), frequency)):
        return None
    return behind_it(batch, best.filter, best.found)


def low_passes_at(frequency: float, count: int) -> list[SensorFilter]:
    """Return low-passes of all orders, and so many cut-offs of each, for a mode at this frequency [Hz]."""
    cuts = [float(cut) for cut in np.geomspace(*_CUTS, count) * frequency]
    return [SensorFilter(order, cut) for order in _ORDERS for cut in cuts]


def is_seen(low_pass: SensorFilter, left: Sequence[Spectrum], frequency: float) -> bool:
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


def spectra(batch: Batch, found: Fit) -> list[Spectrum]:
    """Return frequencies (n,) [Hz] and the power (n,) of what a set leaves of each record."""
    spectra = []
    for r, term in enumerate(batch.waveform):
        left = evidence.residuals_as_measured(term, found, r)
        power = np.abs(np.fft.rfft(left * np.hanning(left.size))) ** 2
        spectra.append((np.fft.rfftfreq(left.size, float(np.median(np.diff(term.time)))), power))
    return spectra


def _looked_for(batch: Batch, begun: FittedBehind) -> FittedBehind | None:
    """Return the low-pass that suits a set best, and the set behind it, from one and the set without."""
    terms, known = begun.filter.passed(batch).waveform, begun.found
    found = fit(known.layout, terms, known.state, iterations=ITERATIONS, nuisances=batch.nuisances)
    best = None if found is None else FittedBehind(begun.filter, found)
    for ratio, count in _FINER:
        best = None if best is None else _nearer(batch, best, ratio, count)
    return best


def _nearer(batch: Batch, known: FittedBehind, ratio: float, count: int) -> FittedBehind | None:
    """Return the best of so many cut-offs within a ratio of the known one as a look has it, and the set behind it."""
    cuts = np.geomspace(known.filter.cut / ratio, known.filter.cut * ratio, count)
    looked = look(batch, known.filter, known.found, [replace(known.filter, cut=float(cut)) for cut in cuts])
    if looked is None:
        return None
    terms = looked.best.passed(batch).waveform
    found = fit(known.found.layout, terms, known.found.state, iterations=ITERATIONS, nuisances=batch.nuisances)
    return None if found is None else FittedBehind(looked.best, found)


@dataclass(frozen=True)
class Looked:
    """What the best of some filters promises where it does not begin: the cost, by how much less that is, and which."""

    cost: float
    gain: float
    best: SensorFilter


def look(batch: Batch, known: SensorFilter | None, found: Fit, filters: Sequence[SensorFilter]) -> Looked | None:
    """Return what the best of some filters and one step of the set's values promise; None where that fails.

    ``known`` is the filter behind which the set was fitted, if any, and ``batch`` the records without one.
    """
    kept = np.flatnonzero(found.active)
    scatter = found.layout.scatter if found.active[-1] and len(batch.specimens) > 1 else 0.0
    shared: list[FloatArray] = []
    left: list[FloatArray] = []
    behind = batch if known is None else known.passed(batch)
    for r, (term, reached, record) in enumerate(zip(batch.waveform, behind.waveform, batch.records, strict=True)):
        slopes = derivatives(found.layout, reached, found.state.eta, found.state.own[r], scatter, found.active)
        if slopes is None:
            return None
        rows = _rows(term, reached, record.frequency, filters)
        own = np.linalg.qr(slopes.own[rows][:, kept])[0]
        bare = replace(term, whiten=lambda columns: columns)
        seen = bare.compared(term.values)
        simulated = seen - evidence.residuals_of(bare, found, r)
        step = float(np.median(np.diff(term.time)))
        chains = [Chain(item, record.frequency, step, seen.size)(simulated[:, None])[:, 0] for item in filters]
        residuals = term.whiten(seen[:, None] - np.column_stack([simulated, *chains]))[rows]
        for items, wanted in ((shared, slopes.shared[rows]), (left, residuals)):
            items.append(wanted - own @ (own.T @ wanted))
    effects, residuals = np.vstack(shared), np.vstack(left)
    if effects.shape[1]:
        basis = np.linalg.qr(effects)[0]
        residuals = residuals - basis @ (basis.T @ residuals)
    costs = (residuals**2).sum(axis=0)
    best = int(np.argmin(costs[1:]))
    return Looked(float(costs[1 + best]), float(costs[0] - costs[1 + best]), filters[best])


def _rows(term: WaveformTerm, reached: WaveformTerm, frequency: float, filters: Sequence[SensorFilter]) -> slice:
    """Return the standardised values that a look compares: those that the past of the filters does not reach.

    ``reached`` is the term behind a filter, which ends earlier.
    """
    each = term.size / term.cycles
    high = [part.cut for item in filters for part in item.parts if part.kind == "high-pass"]
    slow = _DECAYED * frequency / (2.0 * np.pi * min(high)) if high else 0.0
    begun = min(max(_MASKED[0], slow), _MOST_MASKED * term.cycles)
    return slice(round(begun * each), min(term.size - round(_MASKED[1] * each), reached.size))


__all__ = ["is_seen", "look", "low_passes", "low_passes_at", "spectra"]
