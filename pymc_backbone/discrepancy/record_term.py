"""Turning points and samples of a record as data terms: which part of it counts, and how its noise is whitened."""

from __future__ import annotations

import itertools

import numpy as np

from .._common.checks import FloatArray
from ..measurement.conditioning.conditioned import ConditionedRecord
from ..measurement.cycles import Cycles
from .data_term import TurningTerm, WaveformTerm
from .whitening import EDGE, of_means, whitener

_COLLAPSED_HARMONICS = 3
_DENSE = 24  # samples per cycle that hold all there is to know; more are averaged


def first_turning_point(record: ConditionedRecord, cycles: Cycles) -> int:
    """Return which turning point is the first after the release: the second, where the first is the release itself.

    A record that begins at the release, or while the specimen is still held, begins near an extreme value.
    """
    start, extreme = float(record.displacement[:3].mean()), float(cycles.turning_values[0])
    return int(start * extreme > 0.0 and abs(start) > 0.5 * abs(extreme))


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
    )


def waveform_term(record: ConditionedRecord, cycles: Cycles) -> WaveformTerm:
    """Return the data term of the samples of one record, from half a cycle before its first turning point on."""
    half = float(np.median(np.diff(cycles.turning_times)))
    begin = cycles.turning_times[first_turning_point(record, cycles)]
    first = int(np.searchsorted(record.time, begin - 0.9 * half))
    last = int(np.searchsorted(record.time, cycles.turning_times[-1] + 0.9 * half))
    time, values = record.time[first:last], record.displacement[first:last]
    phase = _phase(time, cycles)
    is_reduced = not (record.quantity == "displacement" and record.band is None)
    windows = _windows(phase, 1.0 if is_reduced else 4.0)
    per_cycle = record.sampling_rate * 2.0 * half
    signal = float(np.sqrt(np.mean((values - values.mean()) ** 2)))
    if is_reduced:
        harmonics = 1 if record.band is not None else int(np.clip(0.35 * per_cycle, 1, _COLLAPSED_HARMONICS))
        first_order = 0 if record.offset_is_measured else 1
        bases = [(window, _harmonics(phase[window], harmonics, first_order, 0)) for window in windows]

        def reduce(columns: FloatArray) -> FloatArray:
            return np.concatenate([basis.T @ columns[window] for window, basis in bases]) / record.noise

        size = sum(basis.shape[1] for _, basis in bases)
        return WaveformTerm(time, values, reduce, size, [], signal)
    together = int(per_cycle / _DENSE)
    autocovariance = record.noise_autocovariance
    is_averaged = together > 1
    if is_averaged:
        count = time.size // together
        time, values = time[: count * together], values[: count * together]
        time = time.reshape(count, together).mean(axis=1)
        values = values.reshape(count, together).mean(axis=1)
        autocovariance = of_means(autocovariance, together)
        per_cycle /= together
        phase = _phase(time[EDGE:-EDGE], cycles)
        windows = _windows(phase, 4.0)
    harmonics = int(np.clip(0.5 * per_cycle - 1.5, 1, 4))
    subspace = [(window, _harmonics(phase[window], harmonics, 0, 1)) for window in windows]
    size = time.size - 2 * EDGE if is_averaged else time.size
    return WaveformTerm(time, values, whitener(autocovariance), size, subspace, signal, max(together, 1))


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
    count = max(1, round((phase[-1] - phase[0]) / length))
    edges = np.searchsorted(phase, np.linspace(phase[0], phase[-1], count + 1))
    edges[-1] = phase.size
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b - a >= 4]


def _harmonics(phase: FloatArray, harmonics: int, first_order: int, degree: int) -> FloatArray:
    """Return an orthonormal basis of harmonics with polynomials of ``degree`` for amplitudes."""
    u = np.linspace(-1.0, 1.0, phase.size)
    columns = []
    for order in range(first_order, harmonics + 1):
        angle = 2.0 * np.pi * order * phase
        for power in range(degree + 1):
            columns.append(np.cos(angle) * u**power)
            if order:
                columns.append(np.sin(angle) * u**power)
    basis = np.column_stack(columns[: max(1, int(0.6 * phase.size))])
    return np.linalg.qr(basis)[0]
