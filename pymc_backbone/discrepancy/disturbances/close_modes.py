"""Two modes so close that they beat: their sum is looked for in the samples.

Beside a line as near as that no mode can be passed alone, and in a short record it does not stand beside the others.
Two linear modes decay as two damped oscillations whose frequencies are the same whatever the release; one nonlinear
mode does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..._common.checks import FloatArray
from ...measurement.reading.record import Record
from ..fitting.batch import Batch
from ..fitting.whitening import means
from .disturbance import Disturbance, nothing_beside

_POINTS = 240  # of the envelope of a record
_DENSE = 60  # samples in a cycle, of which each may be a mean: that takes less than 0.1 % of what is near the mode
_LEFT = 0.1  # of what the best set leaves of the samples, that two modes leave at most
_MOST = 0.6  # of the records in which that must be so
_LEAST_SHARE = 0.03  # of the other mode's amplitude in that of the dominant one, at the begin
_BEAT = (1.5, 3.0)  # difference of the frequencies over the faster decay rate; and where releases are alike
_AT_FIRST = 0.3  # of that, in the envelope, from which the samples are asked
_OTHER = 1.3  # ratio of the largest to the smallest motion from which releases are not alike
_ALIKE = 0.2  # of that difference, by which the frequencies of records may differ
_CLOSELY, _LONG = 0.1, 1.5  # the same of the smaller one alone, and cycles by which the two differ over a record
_SHORTEST = 8.0  # cycles
_CLOSE = 0.15  # of the frequency of the mode: what is farther off makes a line of its own, or is outside of a band ...
_BEATS, _NEAR = 8.0, 0.35  # ... where the two differ by more cycles than that over the record; else by this
_FEWEST_BEATS = 1.0  # cycles by which they differ over a record from which one of them is taken away
_BESIDE = 0.4  # of the dominant mode's amplitude, that such a one has at most where a record begins


@dataclass(frozen=True)
class CloseModes:
    """Two modes that beat.

    Attributes
    ----------
    specimen : str
        In whose record they are seen best.
    frequency, other : float
        Hertz, of the dominant one and of the other.
    share : float
        Amplitude of the other over that of the dominant one, where the record begins.
    """

    specimen: str
    frequency: float
    other: float
    share: float


def close_modes(batch: Batch, left: Sequence[FloatArray]) -> CloseModes | None:
    """Return the two modes whose sum explains most records far better than the best set does, or None.

    Parameters
    ----------
    batch : Batch
        Records as samples.
    left : sequence of (n,) arrays
        What the best set leaves of the samples of each.
    """
    sizes = [float(np.std(term.values[: rest.size])) for term, rest in zip(batch.waveform, left, strict=True)]
    # of one release, or several alike, the frequency of a single mode may change as the sum of two does
    least = _BEAT[0] if max(sizes) > _OTHER * min(sizes) else _BEAT[1]
    seen: list[tuple[float, str, _Pair]] = []
    for r, (term, rest) in enumerate(zip(batch.waveform, left, strict=True)):
        time, frequency = term.time[: rest.size], batch.records[r].frequency
        pair = _two_modes(time, term.values[: rest.size], frequency, least)
        if pair is None:
            continue
        # about the mode: harmonics and partials are neither's
        ratio = _about(time, pair.left, frequency) / max(_about(time, rest, frequency), 1e-300)
        if ratio < _LEFT:
            seen.append((ratio, batch.specimens[r], pair))
    if len(seen) < _MOST * len(left) or not _are_alike([pair for _, _, pair in seen]):
        return None
    _, specimen, pair = min(seen, key=lambda item: item[0])
    return CloseModes(specimen, pair.frequency, pair.other, pair.share)


def close_lines(batch: Batch) -> list[Disturbance] | None:
    """Return the smaller of two modes that beat, as a line in each record; None where most records hold no such pair.

    In a record that does not show it, it has no height yet, and is at its usual order of the frequency there.
    """
    return _lines(batch, [(term.time, term.values) for term in batch.waveform])


def lines_that_beat(batch: Batch, records: Sequence[Record]) -> list[Disturbance] | None:
    """Return the same from whole records, where most were cut when their amplitude grew again, and hold little else.

    None as well where what the two modes leave is not small beside the smaller one: another blow, or another law.
    """
    if not batch.has_open_records or np.mean([item.grows_again for item in batch.records]) < _MOST:
        return None
    whole = {record.specimen: record for record in records}
    if not whole.keys() >= set(batch.specimens):
        return None
    together = zip(batch.specimens, batch.waveform, batch.records, strict=True)
    samples = [_free_part(whole[specimen], float(term.time[0]), item.frequency) for specimen, term, item in together]
    return _lines(batch, samples, _LEFT)


def _free_part(record: Record, begin: float, frequency: float) -> tuple[FloatArray, FloatArray]:
    """Return time and values of a record from its release on, as means over as many samples as a cycle can spare."""
    every = max(int(1.0 / (_DENSE * frequency * float(np.median(np.diff(record.time))))), 1)
    both = means(np.column_stack([record.time, record.values])[record.time >= begin], every)
    return both[:, 0], both[:, 1]


def _lines(
    batch: Batch, samples: list[tuple[FloatArray, FloatArray]], left: float = np.inf
) -> list[Disturbance] | None:
    """Return the lines in samples of each specimen, beside which so much is left of their own energy at most."""
    found = {}
    for r, (time, values) in enumerate(samples):
        frequency = batch.records[r].frequency
        pair = _two_modes(time, values, frequency, _BEAT[0])
        if pair is None or pair.share > _BESIDE or pair.beats < _FEWEST_BEATS:
            continue
        if _about(time, pair.left, frequency) < left * _about(time, pair.line, frequency):
            found[r] = pair
    if len(found) < _MOST * len(samples) or not _hold_one_line(list(found.values())):
        return None
    order = float(np.median([pair.other / pair.frequency for pair in found.values()]))
    decay = float(np.median([pair.decay for pair in found.values()]))
    lines = []
    for r, (time, values) in enumerate(samples):
        record = batch.records[r]
        line = nothing_beside(time, values, float(record.time[0]))
        if r in found:
            pair = found[r]
            line = replace(line, frequency=pair.other, decay=pair.decay, cosine=pair.cosine, sine=pair.sine)
        else:
            line = replace(line, frequency=order * record.frequency, decay=decay)
        lines.append(line)
    return lines


class _Pair(NamedTuple):
    """Two damped oscillations in a record: Hertz, the other's share of amplitude, and how often they beat there.

    The other decays by ``decay`` [1/s], and is ``cosine`` and ``sine`` at the begin, ``line`` (n,) by the samples;
    ``left`` (n,) is neither's.
    """

    frequency: float
    other: float
    share: float
    beats: float
    decay: float
    cosine: float
    sine: float
    line: FloatArray
    left: FloatArray


def _are_alike(pairs: list[_Pair]) -> bool:
    """Return whether records hold the same two modes."""
    if not pairs:
        return False
    places = np.array([sorted((pair.frequency, pair.other)) for pair in pairs])
    apart = float(np.median(places[:, 1] - places[:, 0]))
    return bool((np.ptp(places, axis=0) < _ALIKE * apart).all())


def _hold_one_line(pairs: list[_Pair]) -> bool:
    """Return whether records hold the same two modes, or the same smaller one, whatever the larger does.

    At one frequency, or at one order of that of the larger one, from which specimens differ; and closely so, where the
    two beat long enough.
    """
    if not pairs or _are_alike(pairs):
        return bool(pairs)
    larger, smaller, beats = np.array([(pair.frequency, pair.other, pair.beats) for pair in pairs]).T
    apart = smaller - larger
    spread = min(np.ptp(smaller), np.ptp(smaller / larger) * np.median(larger))
    is_same = spread < _CLOSELY * np.median(np.abs(apart)) and (np.sign(apart) == np.sign(apart[0])).all()
    return bool(is_same and np.median(beats) > _LONG)


def _about(time: FloatArray, values: FloatArray, frequency: float) -> float:
    """Return the sum of squares of values about a frequency."""
    return float(np.sum(np.abs(envelope_about(time, values, frequency)[0]) ** 2))


def _two_modes(time: FloatArray, values: FloatArray, frequency: float, least: float) -> _Pair | None:
    """Return the two damped oscillations whose sum a record is, if they beat."""
    if frequency * (time[-1] - time[0]) < _SHORTEST:
        return None
    poles = _poles_of_envelope(time, values, frequency)
    if poles is None:
        return None
    if abs(poles[0].imag - poles[1].imag) < _AT_FIRST * least * float(np.max(-poles.real)):
        return None
    clock = time - time[0]
    scale = 1.0 / clock[-1]

    def rest(x: FloatArray) -> FloatArray:
        basis, coefficients = _fitted(clock, values, x)
        return values - basis @ coefficients

    start = np.array([poles[0].real, poles[0].imag, poles[1].real, poles[1].imag])
    result = least_squares(rest, start, x_scale=np.full(4, scale), max_nfev=20)
    basis, coefficients = _fitted(clock, values, result.x)
    size = np.hypot(coefficients[0::2][:2], coefficients[1::2][:2])
    decay, omega = result.x[0::2], result.x[1::2]
    large, small = (0, 1) if size[0] >= size[1] else (1, 0)
    share = float(size[small] / max(size[large], 1e-300))
    apart = abs(omega[0] - omega[1])
    beats = float(apart * clock[-1] / (2.0 * np.pi))
    is_beat = apart > least * float(np.max(-decay))
    off = np.abs(omega / (2.0 * np.pi * frequency) - 1.0)
    is_close = (off < (_NEAR if beats < _BEATS else _CLOSE)).all()
    if not is_beat or not is_close or (decay >= 0.0).any() or (omega <= 0.0).any() or share < _LEAST_SHARE:
        return None
    hertz = omega / (2.0 * np.pi)
    own = slice(2 * small, 2 * small + 2)
    cosine, sine = coefficients[own]
    return _Pair(
        float(hertz[large]), float(hertz[small]), share, beats, float(-decay[small]), float(cosine), float(sine),
        basis[:, own] @ coefficients[own], values - basis @ coefficients,
    )  # fmt: skip


def _fitted(clock: FloatArray, values: FloatArray, poles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two damped oscillations, each as cosine and sine, and a constant (n, 5), and their coefficients (5,)."""
    columns = []
    for decay, omega in (poles[:2], poles[2:]):
        fall = np.exp(np.minimum(decay * clock, 50.0))
        columns += [fall * np.cos(omega * clock), fall * np.sin(omega * clock)]
    basis = np.stack([*columns, np.ones_like(clock)], axis=1)
    coefficients: FloatArray = np.linalg.lstsq(basis, values, rcond=1e-12)[0]
    return basis, coefficients


def _poles_of_envelope(time: FloatArray, values: FloatArray, frequency: float) -> NDArray[np.complex128] | None:
    """Return the poles (2,) [1/s] of two damped oscillations in the complex envelope, by a matrix pencil [1]_.

    References
    ----------
    .. [1] Hua Y., Sarkar T. K. (1990) Matrix pencil method for estimating parameters of exponentially damped/undamped
       sinusoids in noise. IEEE Transactions on Acoustics, Speech, and Signal Processing 38(5), 814-824.
    """
    envelope, omega, step = envelope_about(time, values, frequency)
    every = max(envelope.size // _POINTS, 1)
    z = envelope[::every]
    if z.size < 12:
        return None
    columns = z.size // 3
    hankel = np.lib.stride_tricks.sliding_window_view(z, columns + 1)
    basis = np.linalg.svd(hankel, full_matrices=False)[2][:2].conj().T
    shift = np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0]
    roots = np.linalg.eigvals(shift).conj()
    if not (np.abs(roots) > 1e-6).all():
        return None
    return np.asarray(np.log(roots) / (every * step) + 1j * omega, dtype=np.complex128)


def envelope_about(
    time: FloatArray, values: FloatArray, frequency: float
) -> tuple[NDArray[np.complex128], float, float]:
    """Return the complex amplitude about a frequency, the angular frequency it is of, and the time step.

    The mean over one cycle of whole samples takes the mirror image and the harmonics away.
    """
    step = float(np.median(np.diff(time)))
    cycle = max(round(1.0 / (frequency * step)), 1)
    omega = 2.0 * np.pi / (cycle * step)
    turned = (values - values.mean()) * np.exp(-1j * omega * (time - time[0]))
    return np.convolve(turned, np.full(cycle, 1.0 / cycle), mode="valid"), omega, step


__all__ = ["CloseModes", "close_lines", "close_modes", "envelope_about", "lines_that_beat"]
