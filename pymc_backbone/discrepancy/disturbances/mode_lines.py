"""Lines in what a set leaves of records: of which frequency and decay, and whether they lie beside the harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from ..._common.checks import FloatArray
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..fitting.waveform_term import WaveformTerm
from ..fitting.whitening import with_slow_noise
from ..weighing import evidence
from .disturbance import Disturbance, Disturbed, line_modes, nothing_beside
from .harmonic_lines import beside_harmonics, frequencies_with, is_harmonic
from .lines import line_near

ALIKE = 0.03
"""Difference of the orders of one line in specimens that are alike."""
_LINE = 25.0  # peak of the residuals' periodogram over its median that a line has at least
_FAR = 4.0  # bins between a line and a harmonic, where it is looked for
_APART = 2.0  # bins between them, once it is found
_DECAYS = (0.0, 3.0, 10.0)  # of lines over a record, as they are looked for
_MOST_LINES = 2.0 / 3.0  # of the lines, that are at the frequency of a hum
_FEWEST_ON = 3  # records that show it at a harmonic
_ONE_FREQUENCY, _NO_ORDER = 3e-3, 0.3  # relative range of the frequencies of a hum, and that over the one of its orders


def are_beside(batch: Batch, found: Fit, items: list[Disturbance]) -> bool:
    """Return whether lines lie beside the harmonics of the motion.

    What hums at one frequency in all records may meet a harmonic of some, but not of most.
    """
    together = zip(items, ranges_of(batch, found), strict=True)
    on = np.array([is_harmonic(item.frequency, at, _APART / (item.end - item.begin)) for item, at in together])
    places = np.array([item.frequency for item in items])
    orders = places / np.array([record.frequency for record in batch.records])
    return not on.any() or (2 * int(on.sum()) < on.size and is_hum(places, orders))


def is_hum(places: FloatArray, orders: FloatArray) -> bool:
    """Return whether lines are at one frequency, and at different orders of that of the motion."""
    at, of = (float(np.ptp(values) / np.median(values)) for values in (places, orders))
    return places.size > 1 and at < min(_ONE_FREQUENCY, _NO_ORDER * of)


def hum_of(places: FloatArray, orders: FloatArray) -> float:
    """Return the frequency [Hz] at which most of some lines are, at different orders of the motion; 0 for none.

    In a record that hardly shows a hum another bin may stand out.
    """
    middle = float(np.median(places))
    near = np.abs(places - middle) < _ONE_FREQUENCY * middle
    if _MOST_LINES * near.size > np.count_nonzero(near) or not is_hum(places[near], orders[near]):
        return 0.0
    return float(np.median(places[near]))


def ranges_of(batch: Batch, found: Fit) -> list[tuple[float, float]]:
    """Return between which frequencies [Hz] each specimen moves, as a set has it."""
    together = enumerate(zip(batch.levels, batch.records, strict=True))
    return [frequencies_with(found, r, term, record.frequency) for r, (term, record) in together]


def step_of(term: WaveformTerm) -> float:
    """Return the time [s] over which each value of a term is a mean."""
    return float(np.median(np.diff(term.time))) if term.together > 1 else 0.0


def with_lines(batch: Batch, without: Batch, found: Fit, items: list[Disturbance]) -> list[Disturbance]:
    """Return disturbances with frequency and decay of a line in what the set leaves; as they are where there is none.

    Specimens are alike: where some show it, it is looked for in the others at its order there.
    """
    frequencies = np.array([record.frequency for record in batch.records])
    if not any(item.frequency for item in items):
        lines = begun_lines(batch, without, found)
        seen = np.array(lines) > 0.0
        if not seen.any():
            return items
        places = np.array(lines)
        orders = places / frequencies
        if hum := hum_of(places[seen], orders[seen]):  # of one frequency, whatever the specimen does
            expected = np.full(places.size, hum)
        else:
            expected = np.median(orders[seen]) * frequencies
        usual = np.where(np.abs(places - expected) < ALIKE * frequencies, places, expected)
        items = [replace(item, frequency=float(place)) for item, place in zip(items, usual, strict=True)]
    left = left_over(without, found)
    return [_refined(term, values, item) for term, values, item in zip(without.waveform, left, items, strict=True)]


def left_over(without: Batch, found: Fit) -> list[FloatArray]:
    """Return what a set leaves of each record, in its unit."""
    # not whitened: the estimate of the noise holds a line too, and whitening would take most of it away
    plain = (replace(term, whiten=lambda columns: columns) for term in without.waveform)
    return [evidence.residuals_of(term, found, r) for r, term in enumerate(plain)]


def lines_on_harmonics(batch: Batch, found: Fit) -> list[Disturbance] | None:
    """Return a line of one frequency in what a set leaves, at a harmonic of motions that differ in that; or None.

    What a law lacks makes a line at a harmonic as well, which goes with the specimen.
    """
    together = zip(batch.waveform, left_over(batch, found), ranges_of(batch, found), strict=True)
    lines = [line_near(term.compared(term.time), left, between, off=-np.inf) for term, left, between in together]
    places = np.array([line.frequency for line in lines])
    orders = places / np.array([record.frequency for record in batch.records])
    seen = places > 0.0
    if np.count_nonzero(seen) < _FEWEST_ON or not (place := hum_of(places[seen], orders[seen])):
        return None
    return [
        replace(nothing_beside(term.time, term.values, float(record.time[0])), frequency=place)
        for term, record in zip(batch.waveform, batch.records, strict=True)
    ]


def begun_lines(batch: Batch, without: Batch, found: Fit) -> list[float]:
    """Return the frequency [Hz] of the line that stands out most in what a set leaves of each record; 0 for none."""
    return [
        _begun_line(term.compared(term.time), values, between)
        for term, values, between in zip(
            without.waveform, left_over(without, found), ranges_of(batch, found), strict=True
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


def whatever_is_left(batch: Batch, taken: Disturbed) -> Batch:
    """Return records from which lines were taken, that say nothing of what is left of these.

    Height, phase, frequency and decay of a line were found beside one set of effects, in whose favour they are a little
    off: so much that a line of a tenth of the motion draws a spring. Whatever they are off by is neither noise nor law.
    """
    together = zip(batch.specimens, batch.waveform, strict=True)
    lines = taken.by_specimen
    terms = tuple(_free_of(term, lines[name]) if name in lines else term for name, term in together)
    return replace(batch, waveform=terms)


def _free_of(term: WaveformTerm, line: Disturbance) -> WaveformTerm:
    """Return a term that says nothing of a line, nor of one a little beside it."""
    if not line.frequency:
        return term
    modes = line_modes(term.time, line, step_of(term))
    along = (term.time - term.time[0]) / (term.time[-1] - term.time[0])
    columns = line.line * line.scale * np.hstack([modes, along[:, None] * modes])
    return replace(term, whiten=with_slow_noise(term.whiten, term.compared(columns)))


def _refined(term: WaveformTerm, left: FloatArray, item: Disturbance) -> Disturbance:
    """Return a disturbance with that frequency and decay of its line which explain most of what a set leaves."""
    time, step = term.compared(term.time), step_of(term)
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


__all__ = [
    "ALIKE", "are_beside", "begun_lines", "hum_of", "is_hum", "left_over", "lines_on_harmonics", "ranges_of", "step_of",
    "whatever_is_left", "with_lines",
]  # fmt: skip
