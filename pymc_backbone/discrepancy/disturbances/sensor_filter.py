"""A filter between structure and record: the same one for the simulation, where that explains what no law does.

The electronics of a sensor, or a filter against aliases, whose cut-off lies a few times above the mode passes the
fundamental nearly as it is, and turns and weakens the harmonics. A coupling to alternating current, as most
accelerometers have it, turns the fundamental away from its harmonics and makes a slow decay of the jump at the release.
No law does that: what turns a third harmonic damps, too. A smooth law then leaves the records unexplained, or a small
effect beside it, mostly a clearance, stands in.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.fft import idct, irfft, next_fast_len, rfft, rfftfreq

from ..._common.checks import FloatArray
from ..._common.text import per_cent
from ...measurement.reading.record import Record
from ..fitting.batch import Batch
from ..fitting.record_term import BETWEEN, INSIDE, beside_jumps, orthogonal_to
from ..fitting.waveform_term import WaveformTerm
from ..fitting.whitening import with_slow_noise

Kind = Literal["low-pass", "high-pass"]

_FORGOTTEN = 13.8  # time constants of the slowest pole after which a filter's past is 1e-6
_TAPER = (0.75, 1.0)  # of the highest frequency that the samples hold: beyond, the filter is closed smoothly
GIBBS = 8
"""Samples beyond the delay by which the filter looks ahead."""
_WAVES = 64  # by which a first cycle of more values is free: up to 32 periods in it
_FEWEST = 4  # values of a window
_SAME = 0.999  # of the motion: a filter that passes so much leaves it as it is
_TAKES = {False: "it takes", True: "they take"}
_PAST = 10.0  # largest values of the motion that a filter's past may come to


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
    beside : SensorFilter, optional
        Another one that the records went through as well: a coupling to alternating current stands in front of most
        filters against aliases.
    rings : bool
        Whether the first cycle says nothing, as where another filter, which is not known, rings after the release.
    """

    order: int
    cut: float
    kind: Kind = "low-pass"
    shows_at_release: bool = False
    beside: SensorFilter | None = None
    rings: bool = False

    @property
    def parts(self) -> tuple[SensorFilter, ...]:
        """The filters that the records went through, each by itself."""
        return (self,) if self.beside is None else (replace(self, beside=None), *self.beside.parts)

    @property
    def has_high_pass(self) -> bool:
        """Whether low frequencies are kept back."""
        return any(part.kind == "high-pass" for part in self.parts)

    def unknown_past(self, term: WaveformTerm) -> int:
        """Return how many values say what it may hold of the past of a record."""
        begun = first_values(term, whole_cycle=self.rings).shape[1] if self.has_high_pass else 0
        return sum(2 * part.order for part in self.parts) + begun

    @property
    def poles(self) -> Any:
        """The poles (order,) over the angular frequency of the cut-off, complex; not those of another one beside."""
        k = np.arange(1, self.order + 1)
        return np.exp(0.5j * np.pi * (2 * k + self.order - 1) / self.order)

    def response(self, frequency: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return gain (n,) and phase (n,) [rad], which falls steadily, at frequencies (n,) [Hz]."""
        factors = np.hstack([part._factors(np.asarray(frequency, dtype=np.float64)) for part in self.parts])
        return np.abs(factors).prod(axis=1), np.angle(factors).sum(axis=1)

    def _factors(self, frequency: FloatArray) -> Any:
        """Return what each pole makes (n, order) of frequencies (n,) [Hz]."""
        ratio = frequency[:, None] / self.cut
        if self.kind == "high-pass":
            return ratio / (ratio + 1j / self.poles)
        return 1.0 / (1.0 - 1j * ratio / self.poles)

    def passed(self, batch: Batch) -> Batch:
        """Return a batch whose simulations go through the filter before they are compared."""
        terms = [
            _passed(term, self, record.frequency) for term, record in zip(batch.waveform, batch.records, strict=True)
        ]
        return replace(batch, waveform=tuple(terms))

    def gains(self, batch: Batch) -> dict[str, float]:
        """Return what share of the motion of each specimen passes; all of it where the release alone tells the filter.

        The cut-off is not known well enough then.
        """
        frequencies = np.array([record.frequency for record in batch.records])
        known = [part.response(frequencies)[0] for part in self.parts if not part.shows_at_release]
        gain = np.prod([np.ones(frequencies.size), *known], axis=0)
        return dict(zip(batch.specimens, gain.tolist(), strict=True))

    def undone(self, records: Iterable[Record], batch: Batch) -> list[Record]:
        """Return records as large as the motion was: a mode near the cut-off passes in part.

        Of a simulation that goes through the filter, the fundamental stays as large as it is (`Chain`).
        """
        gains = self.gains(batch)
        return [replace(record, values=record.values / gains.get(record.specimen, 1.0)) for record in records]

    def sentences(self, batch: Batch) -> list[str]:
        """Return what was found: a sentence on what the harmonics tell, one on what the release alone does."""
        look = "Look at the filters of sensor, amplifier and logger"
        found = [
            "warning: the records begin with a slow decay beside the motion, as behind a "
            f"{part.kind} below the frequency of the mode, from a hand that lets go slowly, of a sensor that bends, or "
            f"of a filter against aliases that rings; the simulation was sent through a {part.kind}, which draws it. "
            f"{look}, and at the release"
            for part in self.parts
            if part.shows_at_release  # which says little of its order and cut-off
        ]
        shown = sorted((part for part in self.parts if not part.shows_at_release), key=lambda part: part.cut)
        if not shown:
            return found
        frequency = float(np.median([record.frequency for record in batch.records]))
        filters = [
            f"a {part.kind} of order {part.order} at {part.cut:.3g} Hz, {part.cut / frequency:.2g} times the frequency "
            "of the mode"
            for part in shown
        ]
        done = "turned and weakened" if any(part.kind == "low-pass" for part in shown) else "turned"
        same = "filter" if len(shown) == 1 else "filters"
        gain = float(np.median(list(self.gains(batch).values())))
        undone = f", and the {per_cent(1.0 - gain)} that {_TAKES[len(shown) > 1]} from the motion were added"
        return [
            f"warning: the harmonics of the motion are {done} as behind {', and '.join(filters)}; the simulation was "
            f"sent through the same {same}{undone if gain < _SAME else ''}. {look}",
            *found,
        ]


class Chain:
    """The filter on equally spaced columns: delay and gain of the fundamental, which the release holds, taken off."""

    def __init__(self, chosen: SensorFilter, frequency: float, step: float, count: int) -> None:
        slowest = min(2.0 * np.pi * part.cut * float(np.abs(part.poles.real).min()) for part in chosen.parts)
        gain, phase = chosen.response(np.array([frequency]))
        delay = -float(phase[0]) / (2.0 * np.pi * frequency)
        self.count = count
        self.before = min(int(np.ceil(_FORGOTTEN / slowest / step)), count - 1)
        self.ahead = min(max(int(np.ceil(delay / step)), 0) + GIBBS, count - 1)
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
    poles = [(part.cut, pole) for part in chosen.parts for pole in part.poles[part.poles.imag >= -1e-9]]
    for cut, pole in poles:
        past = 2.0 * np.pi * cut * elapsed
        wave = np.exp(pole * past)
        waves = (wave, past * wave)
        columns += [part.real for part in waves]
        columns += [] if abs(pole.imag) < 1e-9 else [part.imag for part in waves]
    return np.column_stack(columns)


def _passed(term: WaveformTerm, chosen: SensorFilter, frequency: float) -> WaveformTerm:
    """Return a term whose simulation goes through a filter, which begins with an unknown past."""
    step = float(np.median(np.diff(term.time)))
    chain = Chain(chosen, frequency, step, term.time.size)
    ahead = float(chosen.response(np.array([frequency]))[1][0]) / (2.0 * np.pi * frequency)
    behind = replace(with_past(beside_jumps(term, ahead), chosen), chain=chain)
    return _without_end(behind, int(np.ceil(chain.ahead * term.size / term.time.size)))


def with_past(term: WaveformTerm, chosen: SensorFilter) -> WaveformTerm:
    """Return a term that may hold what a filter still has of the past."""
    modes = _loudest(term) * _transients(chosen, term.time - term.time[0])
    if chosen.has_high_pass:  # which is ahead of the motion: its first values lie between samples not all known
        modes = np.hstack([modes, first_values(term, whole_cycle=chosen.rings)])
    return replace(term, whiten=with_slow_noise(term.whiten, term.compared(modes)))


def first_values(term: WaveformTerm, *, whole_cycle: bool) -> FloatArray:
    """Return what leaves the first values of a record free (n, m): `GIBBS` of them, or those of the first cycle.

    A filter against aliases rings that long after the jump at a release, or after a blow. Of many values those waves
    are free that it may ring at.
    """
    count = round(term.time.size / max(term.cycles, 1.0)) if whole_cycle else 0
    count = min(max(GIBBS, count), term.time.size)
    columns = np.zeros((term.time.size, min(count, _WAVES)))
    columns[:count] = idct(np.eye(count, columns.shape[1]), axis=0, norm="ortho")
    return _loudest(term) * columns


def _loudest(term: WaveformTerm) -> float:
    """Return how large what is not known of the past may be: several times the largest value.

    The past that the simulation is given is its mirror image in the first sample, which at the release is the largest
    of all: what that leaves of a filter's past is larger than most of the motion.
    """
    return _PAST * float(np.abs(term.values - term.values.mean()).max())


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


__all__ = ["GIBBS", "Chain", "SensorFilter", "first_values", "with_past"]
