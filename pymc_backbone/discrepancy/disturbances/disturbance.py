"""What one record holds beside the motion of one mode, and records without it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import FloatArray
from ...measurement.reading.record import Record
from ..proposals.set_fits import Set

_LASTING = 0.3  # decay of a line over a record, in the logarithm, up to which it lasts
_SELDOM = 0.02  # of the reading, by which a calibrated sensor is seldom bent
_SAME = 1.05  # ratio of the frequencies of one line in specimens that are alike
_MAINS, _OF_MAINS, _MOST_HARMONICS = (50.0, 60.0), 0.003, 6  # Hz, how closely, and how many harmonics of these
_ROUNDS = 30  # of the solution for the motion at a reading


@dataclass(frozen=True)
class Disturbance:
    """What one record holds beside the motion: ``reading = zero + q + even q^2 / s + odd q^3 / s^2``, q with a line.

    Attributes
    ----------
    begin, end : float
        Time [s] over which the mean of the reading is its zero.
    release : float
        Time [s] from which the line is known to be there.
    scale : float
        Largest motion s [unit of the record].
    even, odd : float
        Share of the reading that a bent sensor adds there.
    frequency, decay : float
        Of the line [Hz, 1/s]; 0 where there is none.
    cosine, sine : float
        Of the line at ``begin`` [unit of the record].
    """

    begin: float
    end: float
    release: float
    scale: float
    even: float = 0.0
    odd: float = 0.0
    frequency: float = 0.0
    decay: float = 0.0
    cosine: float = 0.0
    sine: float = 0.0

    @property
    def bent(self) -> float:
        """Reading that the sensor adds at the largest motion, as a share of it."""
        return float(np.hypot(self.even, self.odd))

    @property
    def line(self) -> float:
        """Amplitude of the line as a share of the largest motion."""
        return float(np.hypot(self.cosine, self.sine)) / self.scale

    @property
    def lasts(self) -> bool:
        """Whether the line is at the end of the record what it was at its begin, as no structure's is."""
        return self.decay * (self.end - self.begin) < _LASTING

    def motion(self, time: FloatArray, readings: FloatArray, *, step: float = 0.0) -> FloatArray:
        """Return readings (n,) as a straight sensor would have given them without the line.

        ``step`` is that over which each reading is a mean [s].
        """
        zero = float(readings[(time >= self.begin) & (time <= self.end)].mean())
        around = readings - zero
        if self.frequency:
            around = around - line_modes(time, self, step) @ np.array([self.cosine, self.sine])
        motion = around
        for _ in range(_ROUNDS if self.even or self.odd else 0):
            share = motion / self.scale
            motion = around / (1.0 + self.even * share + self.odd * share**2)
        return zero + motion


def nothing_beside(time: FloatArray, values: FloatArray, release: float) -> Disturbance:
    """Return of a record that nothing disturbs yet what there is to know: from when to when, and its largest motion."""
    return Disturbance(float(time[0]), float(time[-1]), release, float(np.abs(values - values.mean()).max()))


def line_modes(time: FloatArray, line: Disturbance, step: float = 0.0) -> FloatArray:
    """Return the line's cosine and sine (n, 2) from the release on, of unit height at ``begin``."""
    elapsed = np.maximum(time, line.release) - line.begin
    height = np.where(time >= line.release, np.exp(-line.decay * elapsed), 0.0)
    angle = 2.0 * np.pi * line.frequency * elapsed
    return np.column_stack([np.cos(angle), np.sin(angle)]) * (height * np.sinc(line.frequency * step))[:, None]


@dataclass(frozen=True, eq=False)
class Disturbed:
    """The disturbance of each record, and the set of effects that leaves noise beside it."""

    by_specimen: dict[str, Disturbance]
    beside: Set

    @property
    def is_bent(self) -> bool:
        """Whether the sensor bends."""
        return any(item.bent for item in self.by_specimen.values())

    def undisturbed(self, records: Iterable[Record]) -> list[Record]:
        """Return the records without what disturbs them, and without what came before another mode's line began."""
        found = []
        for record in records:
            item = self.by_specimen.get(record.specimen)
            if item is None:
                found.append(record)
                continue
            is_kept = record.time >= item.release if item.frequency else np.ones(record.time.size, dtype=bool)
            values = item.motion(record.time, record.values)
            found.append(replace(record, time=record.time[is_kept], values=values[is_kept]))
        return found


def sentences(found: Sequence[Disturbed]) -> list[str]:
    """Return what was found in so many passes, one sentence for each kind: lines first, as they are looked for."""
    said = []
    lines = [one for item in found for one in item.by_specimen.values() if one.frequency]
    if lines:
        groups = _alike(sorted(lines, key=lambda one: one.frequency))
        parts = [_line_words(group) for group in groups]
        several = len(groups) > 1
        said.append(
            f"warning: the records hold {'lines that are' if several else 'a line that is'} no harmonic of the mode, "
            f"{'; '.join(parts)}; {'they were' if several else 'it was'} taken away"
        )
    if any(item.is_bent for item in found):
        names = list(found[0].by_specimen)
        even = np.array([[item.by_specimen[name].even for name in names] for item in found]).sum(axis=0)
        odd = np.array([[item.by_specimen[name].odd for name in names] for item in found]).sum(axis=0)
        sizes = np.hypot(even, odd)
        force = "the inertia changes with the displacement, or the damping differs between the two sides"
        why = f"Look at the sensor's calibration; where that is straight, {force}, which reads the same"
        if np.median(sizes) > _SELDOM:
            why = (
                f"Sensors are seldom off by so much: it may rather be that {force}, which reads the same; look at both"
            )
        said.append(
            "warning: the sensor's reading is not in proportion to the motion: at the largest motion of each record it "
            f"is {_range(sizes.tolist())} off a straight line, which no effect of the library explains, and the "
            f"records were straightened. {why}"
        )
    return said


def _alike(lines: Sequence[Disturbance]) -> list[list[Disturbance]]:
    """Return lines of rising frequency in groups that may be one line in specimens that are alike."""
    groups = [[lines[0]]]
    for one in lines[1:]:
        if one.frequency < _SAME * groups[-1][-1].frequency:
            groups[-1].append(one)
        else:
            groups.append([one])
    return groups


def _line_words(lines: Sequence[Disturbance]) -> str:
    """Return where a line is, how large, and what leaves such a one."""
    low, high = f"{lines[0].frequency:.4g}", f"{lines[-1].frequency:.4g}"
    is_mains = any(
        all(abs(one.frequency / (order * hertz) - 1.0) < _OF_MAINS for one in lines)
        for hertz in _MAINS
        for order in range(1, _MOST_HARMONICS + 1)
    )
    cause = "what runs nearby" if all(one.lasts for one in lines) else "another mode"
    if is_mains:
        cause = f"the mains or {cause}"
    where = low if low == high else f"{low} to {high}"
    return f"at {where} Hz, {_range([one.line for one in lines])} of the motion, as {cause} leaves"


def _range(shares: list[float]) -> str:
    """Return the least and the largest of some shares in words."""
    low, high = min(shares), max(shares)
    return f"{high:.2%}" if high < 1.05 * low else f"{low:.2%} to {high:.2%}"


__all__ = ["Disturbance", "Disturbed", "line_modes", "nothing_beside", "sentences"]
