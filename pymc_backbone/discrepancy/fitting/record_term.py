"""Turning points and samples of a record as data terms: which part of it counts, and how its noise is whitened."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..._common.checks import FloatArray
from ...measurement.conditioning.conditioned import ConditionedRecord
from ...measurement.conditioning.filters import BandPass
from ...measurement.cycle_data import Cycles
from .data_term import TurningTerm
from .drift_course import fade_of, motion_of
from .passed import passed_values
from .waveform_term import Jumps, Subspace, WaveformTerm
from .whitening import EDGE, means, of_means, whitener, with_slow_noise

_SMEARED = (2.0, 0.1)  # samples, and at most of a half cycle, on either side of a turning point in which a jump is
_DENSE = 24  # samples per cycle that hold all there is to know; more are averaged
_PASSED_WINDOW = 8.0  # cycles; a band holds little more than the slowly varying motion itself
_JUMPING = 2  # derivative of the displacement that jumps where friction changes its direction
_FITTED = 8  # turning points whose course tells those before them
_FOUR = 4  # turning points that tell the swing before them
_MOST_LONGER, _MOST_WIDER = 1.5, 1.8  # change of a swing from one cycle to the next
_AT_RELEASE = 0.3  # of a half cycle: so close to its first sample a record begins at a turning point
_FIRST_OF_THREE = np.array([5.0, 2.0, -1.0]) / 6.0  # of a line through three values, the first
_AT_REST = 0.15  # of the first turning point's value: so near the position of rest begins what was struck
_AT_AN_EXTREME = 0.5  # ... and from there on what begins at that turning point
_AROUND = 0.25  # of a half cycle
_CLEARLY = 4.0  # standard deviations of the noise
_MOST_LOST = 400
INSIDE, BETWEEN = 0.6, 0.3
"""Largest share of the values in a window that are lines of the motion, and that lie midway between these."""


def first_turning_point(record: ConditionedRecord, cycles: Cycles) -> int:
    """Return which turning point is the first after the release: the second, where the first is the release itself.

    A record that begins at the release, or while the specimen is still held, begins near an extreme value. One that
    begins at an impact begins at the position of rest: what remembers is loaded for the first time up to the first
    turning point, as if it had been released from there. Where what came before was left out, and behind a band-pass, a
    record begins later.
    """
    if record.band is not None:
        return 0
    begins = float(_FIRST_OF_THREE @ record.displacement[:3] / cycles.turning_values[0])
    is_struck = not record.is_cut and abs(begins) < _AT_REST and cycles.turning_values.size > _FOUR
    return int(is_struck or begins > _AT_AN_EXTREME)


def release_of(record: ConditionedRecord, cycles: Cycles) -> tuple[int, float, float]:
    """Return how many turning points before the first of them the motion can be released, when, and at which value.

    Unfiltered it is the one before: a swing away, which goes on from the swings of its own direction, because those of
    an asymmetric structure take turns. Behind a band-pass the samples begin earlier: the turning points that it lost
    are added from the course of the first.
    """
    first = first_turning_point(record, cycles)
    times, values = cycles.turning_times[first:], cycles.turning_values[first:]
    half = float(np.median(np.diff(times)))
    size = min(_FITTED, times.size)
    if record.band is None:
        if times.size < _FOUR:
            return 1, float(times[0]) - half, _as_seen(record, float(times[0]) - half, half, -float(values[0]))
        begin, release = before(times, values)
        return 1, begin, _as_seen(record, begin, half, release)
    course = np.polyfit(np.arange(size), times[:size], min(2, size - 1))
    decay = np.polyfit(np.arange(size - 1), np.log(np.abs(np.diff(values[:size]))), 1)
    begin = float(record.measured.time[0]) + _AT_RELEASE * half
    back = 1
    while back < _MOST_LOST and float(np.polyval(course, -back)) > begin:
        back += 1
    fall = min(max(-float(decay[0]), 0.0), 0.6) * back
    return back, float(np.polyval(course, -back)), float(values[0]) * (-1.0) ** back * float(np.exp(fall))


def before(times: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Return time and value of the turning point before the first of four or more, as they go on."""
    lasted, swung = np.diff(times[:_FOUR]), np.diff(values[:_FOUR])
    lasted_before = lasted[1] * np.clip(lasted[0] / lasted[2], 1.0 / _MOST_LONGER, _MOST_LONGER)
    swung_before = swung[1] * np.clip(swung[0] / swung[2], 1.0, _MOST_WIDER)
    return float(times[0] - lasted_before), float(values[0] - swung_before)


def _as_seen(record: ConditionedRecord, begin: float, half: float, release: float) -> float:
    """Return the release, or what the samples around it say where they are clearly beyond.

    What is loaded for the first time loses more in its first swing than the later ones tell.
    """
    around = np.abs(record.time - begin) < _AROUND * half
    seen = float((np.sign(release) * record.displacement[around]).max(initial=0.0))
    return float(np.sign(release)) * seen if seen > abs(release) + _CLEARLY * record.noise else release


def turning_term(record: ConditionedRecord, cycles: Cycles) -> TurningTerm:
    """Return the data term of the turning points of one record."""
    count = min(2 * len(cycles) + 1, cycles.turning_times.size)
    kept = slice(first_turning_point(record, cycles), count)
    times, values = cycles.turning_times[kept], cycles.turning_values[kept]
    time_errors, value_errors = cycles.turning_time_errors[kept], cycles.turning_value_errors[kept]
    return TurningTerm(
        times.copy(),
        values.copy(),
        np.maximum(time_errors, 1e-12 * np.abs(times).max() + 1e-300),
        np.maximum(value_errors, 1e-300),
        release_of(record, cycles)[0] - 1,
        fade_of(cycles.smoothed_amplitude),
        motion=motion_of(cycles, times),
    )


def waveform_term(record: ConditionedRecord, cycles: Cycles) -> WaveformTerm:
    """Return the data term of the samples of one record, from shortly after the turning point before its first.

    That is as far back as this swing lasts, not the median one: of a hard spring the first is the shortest, and before
    its release a structure is held.
    """
    band_pass = record.measured.band_pass
    term = _unfiltered(record, cycles) if band_pass is None else _behind_band_pass(record, band_pass, cycles)
    return replace(term, fade=fade_of(cycles.smoothed_amplitude), motion=motion_of(cycles, term.time))


def _unfiltered(record: ConditionedRecord, cycles: Cycles) -> WaveformTerm:
    """Return the data term of a record that is compared as it was measured."""
    measured, order = record.measured, record.measured.order
    samples, autocovariance = measured.values, measured.autocovariance
    if order == 0:  # less the baseline
        samples, autocovariance = record.displacement, record.noise_autocovariance
    half = float(np.median(np.diff(cycles.turning_times)))
    begin = cycles.turning_times[first_turning_point(record, cycles)]
    first = int(np.searchsorted(record.time, begin - 0.9 * (begin - release_of(record, cycles)[1])))
    last = int(np.searchsorted(record.time, cycles.turning_times[-1] + 0.9 * half))
    time, values = record.time[first:last], samples[first:last]
    per_cycle = record.sampling_rate * 2.0 * half
    signal = float(np.sqrt(np.mean((values - values.mean()) ** 2)))
    together = max(int(per_cycle / _DENSE), 1)
    scale = (2.0 * np.pi * record.frequency) ** order
    per_cycle /= together
    shown = means(time[:, None], together)[:, 0]
    if together > 1:
        autocovariance = of_means(autocovariance, together)
    inner = shown[EDGE:-EDGE] if together > 1 and order == 0 else shown
    white = whitener(autocovariance)
    if measured.slow_noise is not None:
        white = with_slow_noise(white, measured.slow_noise.modes(inner, float(autocovariance[0])))
    if together > 1 and order == 0:
        # smooth enough to be simulated at the middle of each mean only
        count = shown.size
        values = values[: count * together].reshape(count, together).mean(axis=1)
        subspace, beside = _subspaces(_phase(inner, cycles), per_cycle)
        return WaveformTerm(shown, values, white, inner.size, subspace, signal, together, beside=beside)

    def standardised(columns: FloatArray) -> FloatArray:
        # friction makes acceleration jump and velocity bend: every sample is simulated
        return white(means(columns, together))

    whiten = standardised if together > 1 else white
    phase = _phase(shown, cycles)
    subspace, beside = _subspaces(phase, per_cycle)
    term = WaveformTerm(time, values, whiten, shown.size, subspace, signal, 1, order, scale, beside, averaged=together)
    if order < _JUMPING:
        return term
    step = float(np.median(np.diff(time)))
    most, share = _SMEARED
    reach = min(most * step, share * half) + 0.5 * (together - 1) * step
    jumps = Jumps(cycles.turning_times, reach, shown, phase, per_cycle, whiten)
    return beside_jumps(replace(term, jumps=jumps))


def beside_jumps(term: WaveformTerm, later: float = 0.0) -> WaveformTerm:
    """Return a term without the values of an acceleration that hold samples next to a turning point.

    Friction makes it jump there. Between structure and samples is a filter against aliases, which smears a jump over
    the next ones. Compared with a jump as it is, these refute friction, and a law that is smooth at rest takes its
    place. ``later`` is by how much [s] a jump comes after what the record shows as its turning point.
    """
    jumps = term.jumps
    if jumps is None:
        return term
    turning = jumps.turning + later
    after = np.searchsorted(turning, jumps.instants)
    before, next_one = (np.abs(jumps.instants - turning[np.clip(after + k, 0, turning.size - 1)]) for k in (-1, 0))
    kept = np.flatnonzero(np.minimum(before, next_one) > jumps.reach)

    def whiten(columns: FloatArray) -> FloatArray:
        return jumps.whiten(columns)[kept]

    subspace, beside = _subspaces(jumps.phase[kept], jumps.per_cycle * kept.size / jumps.phase.size)
    return replace(term, whiten=whiten, size=kept.size, subspace=subspace, beside=beside, shown=kept)


def _behind_band_pass(record: ConditionedRecord, band_pass: BandPass, cycles: Cycles) -> WaveformTerm:
    """Return the data term of a record that is compared through a band-pass.

    The simulation runs from the release over the samples as they were; the filter takes simulated and measured ones.
    """
    measured = record.measured
    half = float(np.median(np.diff(cycles.turning_times)))
    _, release_time, _ = release_of(record, cycles)
    edge = band_pass.half / band_pass.sampling_rate
    first = int(np.searchsorted(measured.time, release_time + 0.1 * half))
    last = int(np.searchsorted(measured.time, cycles.turning_times[-1] + 0.9 * half + edge))
    time, values = measured.time[first:last], measured.values[first:last]
    reduce, size, step = passed_values(band_pass, measured.autocovariance, time.size)
    inner = slice(band_pass.half, time.size - band_pass.half)
    signal = float(band_pass.apply(values).std())
    phase = _phase(time, cycles)
    orders = [k for k in range(1, 9) if band_pass.low < k * record.frequency < band_pass.high]
    motion = [wave(2.0 * np.pi * k * phase) for k in orders for wave in (np.cos, np.sin)]
    shapes = reduce(np.column_stack(motion))
    at = np.repeat(phase[inner][::step], 2)[:size]
    subspace = []
    for window in _windows(at, _PASSED_WINDOW):
        u = np.linspace(-1.0, 1.0, window.stop - window.start)[:, None]
        columns = np.hstack([shapes[window], u * shapes[window]])[:, : max(1, int(INSIDE * u.size))]
        subspace.append((window, np.linalg.qr(columns)[0]))
    return WaveformTerm(time, values, reduce, size, subspace, signal, 1, measured.order, 0.0)


def _subspaces(phase: FloatArray, per_cycle: float) -> tuple[Subspace, Subspace]:
    """Return windows of the values at these phases with what a model error looks like in each, and midway beside it."""
    harmonics = int(np.clip(0.5 * per_cycle - 1.5, 1, 4))
    windows = _windows(phase, 4.0)
    inside = [(window, _harmonics(phase[window], range(harmonics + 1))) for window in windows]
    beside = []
    for window, basis in inside:
        between = _harmonics(phase[window], [k + 0.5 for k in range(harmonics)])[:, : int(BETWEEN * basis.shape[0])]
        beside.append((window, orthogonal_to(basis, between)))
    return inside, beside


def orthogonal_to(basis: FloatArray, lines: FloatArray) -> FloatArray:
    """Return an orthonormal basis (n, k) of what lines (n, k) hold beside an orthonormal basis (n, d)."""
    return np.linalg.qr(lines - basis @ (basis.T @ lines))[0]


def _phase(time: FloatArray, cycles: Cycles) -> FloatArray:
    """Return the phase in cycles, from the turning points, carried on at both ends."""
    at, half = cycles.turning_times, 0.5 * np.arange(cycles.turning_times.size)
    inner: FloatArray = np.interp(time, at, half)
    before, after = time < at[0], time > at[-1]
    inner[before] = (time[before] - at[0]) * 0.5 / (at[1] - at[0])
    inner[after] = half[-1] + (time[after] - at[-1]) * 0.5 / (at[-1] - at[-2])
    return inner


def _windows(phase: FloatArray, length: float) -> list[slice]:
    """Return windows of about ``length`` cycles."""
    count = max(1, round(float(phase[-1] - phase[0]) / length))
    edges = np.searchsorted(phase, np.linspace(phase[0], phase[-1], count + 1))
    edges[-1] = phase.size
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if b - a >= 4]


def _harmonics(phase: FloatArray, orders: Iterable[float]) -> FloatArray:
    """Return an orthonormal basis of lines at these orders of the motion, whose amplitudes change linearly."""
    u = np.linspace(-1.0, 1.0, phase.size)
    columns = []
    for order in orders:
        angle = 2.0 * np.pi * order * phase
        for amplitude in (np.ones_like(u), u):
            columns.append(np.cos(angle) * amplitude)
            if order:
                columns.append(np.sin(angle) * amplitude)
    basis = np.column_stack(columns[: max(1, int(INSIDE * phase.size))])
    return np.linalg.qr(basis)[0]
