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
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

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
_FEWEST = 4  # values of a window
_SAME = 0.999  # of the motion: a filter that passes so much leaves it as it is
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

    def gains(self, batch: Batch) -> dict[str, float]:
        """Return what share of the motion of each specimen passes; all of it where the release alone tells the filter.

        The cut-off is not known well enough then.
        """
        frequencies = np.array([record.frequency for record in batch.records])
        gain = np.ones(frequencies.size) if self.shows_at_release else self.response(frequencies)[0]
        return dict(zip(batch.specimens, gain.tolist(), strict=True))

    def undone(self, records: Iterable[Record], batch: Batch) -> list[Record]:
        """Return records as large as the motion was: a mode near the cut-off passes in part.

        Of a simulation that goes through the filter, the fundamental stays as large as it is (`Chain`).
        """
        gains = self.gains(batch)
        return [replace(record, values=record.values / gains.get(record.specimen, 1.0)) for record in records]

    def sentence(self, batch: Batch) -> str:
        """Return what was found, in one sentence."""
        look = "Look at the filters of sensor, amplifier and logger"
        if self.shows_at_release:  # which says little of its order and cut-off
            return (
                f"warning: the records begin with a slow decay beside the motion, as behind a {self.kind} below the "
                "frequency of the mode, from a hand that lets go slowly, or of a sensor that bends; the simulation was "
                f"sent through a {self.kind}, which draws it. {look}, and at the release"
            )
        ratio = self.cut / float(np.median([record.frequency for record in batch.records]))
        done = "turned" if self.kind == "high-pass" else "turned and weakened"
        gain = float(np.median(list(self.gains(batch).values())))
        undone = f", and the {per_cent(1.0 - gain)} that it takes from the motion were added" if gain < _SAME else ""
        return (
            f"warning: the harmonics of the motion are {done} as behind a {self.kind} of order "
            f"{self.order} at {self.cut:.3g} Hz, {ratio:.2g} times the frequency of the mode; the simulation was sent "
            f"through the same filter{undone}. {look}"
        )


class Chain:
    """The filter on equally spaced columns: delay and gain of the fundamental, which the release holds, taken off."""

    def __init__(self, chosen: SensorFilter, frequency: float, step: float, count: int) -> None:
        slowest = 2.0 * np.pi * chosen.cut * float(np.abs(chosen.poles.real).min())
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
    chain = Chain(chosen, frequency, step, term.time.size)
    ahead = float(chosen.response(np.array([frequency]))[1][0]) / (2.0 * np.pi * frequency)
    behind = replace(with_past(beside_jumps(term, ahead), chosen), chain=chain)
    return _without_end(behind, int(np.ceil(chain.ahead * term.size / term.time.size)))


def with_past(term: WaveformTerm, chosen: SensorFilter) -> WaveformTerm:
    """Return a term that may hold what a filter still has of the past."""
    modes = _loudest(term) * _transients(chosen, term.time - term.time[0])
    if chosen.kind == "high-pass":  # which is ahead of the motion: its first values lie between samples not all known
        modes = np.hstack([modes, first_values(term)])
    return replace(term, whiten=with_slow_noise(term.whiten, term.compared(modes)))


def first_values(term: WaveformTerm) -> FloatArray:
    """Return what leaves the first values of a record free (n, `GIBBS`)."""
    return _loudest(term) * np.eye(term.time.size, min(GIBBS, term.time.size))


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
