"""What a model is compared with, specimen by specimen: level values, turning points, or the samples of the record.

Each witness turns a simulated decay into standardised residuals and their derivatives, so that one fit serves all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import xarray as xr
from scipy.linalg import solve_toeplitz, solve_triangular, toeplitz
from scipy.signal import lfilter

from .._checks import FloatArray
from .._conditioned import ConditionedRecord
from ..cycles import Cycles
from ..decay import Simulator

MOST_LAGS = 32
DRIFT = 0.05  # relative change of frequency over a record that one unit of drift stands for
TOLERANCE = 1e-7  # of one integration step: waveforms to 3e-6 of the amplitude, far below any noise here
_COLLAPSED_HARMONICS = 3
_DENSE = 24  # samples per cycle that hold all there is to know; more are averaged
_EDGE = 2
_MARGIN = 60  # turning points beyond those of the record


class Witness(Protocol):
    """One specimen's data: residuals of a model, and their derivatives.

    ``compare(simulator, parameters, nuisances)`` returns the standardised residuals (n,), measured minus simulated,
    and the derivatives of the simulated (n, p + 5) with respect to the parameters and the nuisances: release
    amplitude, release instant, offset, drift of frequency, drift of damping. None where the simulation failed.

    The drifts are changes with time, not with amplitude: the frequency changes by `DRIFT` times the nuisance over the
    record, by stretching the time; the amplitude falls by the square of the elapsed share of the record more.
    """

    @property
    def size(self) -> int:
        """Number of residuals."""
        ...

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals and derivatives."""
        ...


@dataclass(frozen=True, eq=False)
class LevelWitness:
    """The backbone of one specimen at levels, with its covariance.

    Attributes
    ----------
    levels : (l,) array
        Amplitudes that this specimen reaches.
    values : (m,) array
        Measured values, observable by observable.
    rows : (m, 2) array of int
        Observable and level of each value.
    whitening : (m, m) array
        Takes differences to independent standard normal ones.
    """

    levels: FloatArray
    values: FloatArray
    rows: Any
    whitening: FloatArray

    @property
    def size(self) -> int:
        """Number of values."""
        return int(self.values.size)

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals (m,) and derivatives (m, p + 5)."""
        n = self.levels.size
        values, status = np.empty((3, n)), np.zeros(n, dtype=np.int64)
        jacobian = np.zeros((3, n, parameters.size))
        simulator.backbone(parameters, self.levels, 0.0, True, values, jacobian, status)
        if status.any():
            return None
        pick = (self.rows[:, 0], self.rows[:, 1])
        slopes = np.zeros((self.size, parameters.size + 5))
        slopes[:, : parameters.size] = jacobian[pick]
        residuals = self.whitening @ (self.values - values[pick])
        return residuals, self.whitening @ slopes


def level_witness(backbones: xr.Dataset, specimen: int, keep: Any = None) -> LevelWitness | None:
    """Return the witness of one specimen of a Dataset of backbones, or None where it reaches none of the levels."""
    from .._checks import OBSERVABLES

    chosen = backbones.isel(specimen=specimen)
    names = [str(name) for name in chosen["observable"].values]
    value, error = np.asarray(chosen["value"]), np.asarray(chosen["standard_error"])
    held = np.isfinite(value) & np.isfinite(error) & (error > 0.0)
    if keep is not None:
        held = held & np.asarray(keep)[None, :]
    reached = np.flatnonzero(held.any(axis=0))
    if reached.size < 1:
        return None
    place = {int(k): i for i, k in enumerate(reached)}
    pairs = np.argwhere(held)
    whitening = np.zeros((len(pairs), len(pairs)))
    for o in range(len(names)):
        index = np.flatnonzero(pairs[:, 0] == o)
        if not index.size:
            continue
        at = pairs[index, 1]
        covariance = np.diag(error[o, at] ** 2)
        if "covariance" in chosen:
            given = np.asarray(chosen["covariance"])[o][np.ix_(at, at)]
            covariance = np.where(np.isfinite(given), given, covariance)
        scale = np.sqrt(np.diag(covariance))
        factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-6 * np.eye(index.size))
        whitening[np.ix_(index, index)] = np.linalg.inv(factor) / scale
    rows = np.array([(OBSERVABLES.index(names[o]), place[int(k)]) for o, k in pairs])
    return LevelWitness(np.asarray(chosen["level"])[reached], value[pairs[:, 0], pairs[:, 1]], rows, whitening)


@dataclass(frozen=True, eq=False)
class TurningWitness:
    """Times and values of the turning points of one record: no phase to lose, so fits find their way from afar.

    Attributes
    ----------
    times, values, time_errors, value_errors : (n,) arrays
        As extracted; the release is the turning point before the first.
    """

    times: FloatArray
    values: FloatArray
    time_errors: FloatArray
    value_errors: FloatArray

    @property
    def size(self) -> int:
        """Number of residuals."""
        return 2 * int(self.times.size)

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals (2 n,) and derivatives (2 n, p + 5)."""
        release, release_time, offset, drift, loss = nuisances
        maximum = self.times.size + 1
        columns = parameters.size + 1
        turns, times = np.empty(maximum), np.empty(maximum)
        slopes, time_slopes = np.empty((maximum, columns)), np.empty((maximum, columns))
        none = np.empty(0)
        count, _ = simulator.decay(
            parameters, release, True, 0.0, True, TOLERANCE, maximum, turns, slopes, time_slopes, times,
            none, none, np.empty((0, 1)),
        )  # fmt: skip
        if count < maximum:
            return None
        n = self.times.size
        length = float(self.times[-1] - self.times[0])
        share = times[1:] / length
        early = 0.5 * DRIFT * share**2 * length
        less = np.exp(-0.5 * loss * share**2)
        residuals = np.concatenate(
            [
                (self.times - release_time - times[1:] + drift * early) / self.time_errors,
                (self.values - offset - turns[1:] * less) / self.value_errors,
            ]
        )
        jacobian = np.zeros((2 * n, columns + 4))
        of_times = time_slopes[1:] * (1.0 - drift * DRIFT * share)[:, None]
        of_values = (slopes[1:] - time_slopes[1:] * (loss * share / length * turns[1:])[:, None]) * less[:, None]
        parts = ((slice(0, n), of_times, self.time_errors), (slice(n, None), of_values, self.value_errors))
        for part, slope, error in parts:
            jacobian[part, : columns - 1] = slope[:, 1:] / error[:, None]
            jacobian[part, columns - 1] = slope[:, 0] / error
        jacobian[:n, columns] = 1.0 / self.time_errors
        jacobian[n:, columns + 1] = 1.0 / self.value_errors
        jacobian[:n, columns + 2] = -early / self.time_errors
        jacobian[n:, columns + 3] = -0.5 * share**2 * turns[1:] * less / self.value_errors
        return residuals, jacobian


@dataclass(frozen=True, eq=False)
class WaveformWitness:
    """The samples of one record.

    Attributes
    ----------
    time, values : (n,) arrays
        Instants [s], displacement [m or rad], from shortly after the release.
    whiten : callable
        Takes (n, c) columns to standardised independent ones (m, c).
    size : int
        m.
    subspace : list of (slice, (k, d) array)
        Windows of the standardised residuals, and an orthonormal basis of what a model error looks like in each:
        the harmonics of the motion, slowly varying. Empty where the whitening already reduces to these.
    signal : float
        Standard deviation of the displacement.
    together : int
        Number of samples that each value is the mean of, at their middle.
    """

    time: FloatArray
    values: FloatArray
    whiten: Callable[[FloatArray], FloatArray]
    size: int
    subspace: list[tuple[slice, FloatArray]]
    signal: float
    together: int = 1

    def simulate(
        self, simulator: Simulator, parameters: FloatArray, release: float, release_time: float, time: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return displacement (n,) and derivatives (n, 1 + p), the first with respect to the release amplitude."""
        instants = time - release_time
        before = int(np.searchsorted(instants, 0.0, side="left"))
        n, columns = instants.size, parameters.size + 1
        displacement = np.full(n, release)
        slopes = np.zeros((n, columns))
        slopes[:before, 0] = 1.0
        if before < n:
            maximum = self.most_turns
            turns, times = np.empty(maximum), np.empty(maximum)
            room, time_room = np.empty((maximum, columns)), np.empty((maximum, columns))
            simulator.decay(
                parameters, release, True, 0.0, True, TOLERANCE, maximum, turns, room, time_room, times,
                np.ascontiguousarray(instants[before:]), displacement[before:], slopes[before:],
            )  # fmt: skip
        if not np.isfinite(displacement[-1]):
            return None
        return displacement, slopes

    @property
    def most_turns(self) -> int:
        """Turning points after which a simulation is given up."""
        return max(200, int(self.cycles * 5.0) + _MARGIN)

    @property
    def cycles(self) -> float:
        """Rough number of cycles in the record."""
        return float(np.count_nonzero(np.diff(np.signbit(self.values - self.values.mean()))) / 2 + 1)

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals (m,) and derivatives (m, p + 5)."""
        release, release_time, offset, drift, loss = nuisances
        length = float(self.time[-1] - self.time[0])
        elapsed = np.maximum(self.time - release_time, 0.0)
        later = 0.5 * DRIFT * elapsed**2 / length
        simulated = self.simulate(simulator, parameters, release, release_time, self.time + drift * later)
        if simulated is None:
            return None
        displacement, slopes = simulated
        share = 0.5 * (elapsed / length) ** 2
        if loss != 0.0:
            less = np.exp(-loss * share)
            displacement, slopes = displacement * less, slopes * less[:, None]
        n, p = self.time.size, parameters.size
        columns = np.empty((n, p + 6))
        columns[:, :p] = slopes[:, 1:]
        columns[:, p] = slopes[:, 0]
        velocity = np.gradient(displacement, self.time)  # good enough for a direction of search
        columns[:, p + 1] = -velocity
        columns[:, p + 2] = 1.0
        columns[:, p + 3] = velocity * later
        columns[:, p + 4] = -share * displacement
        columns[:, p + 5] = offset + displacement
        if self.together > 1:
            columns = _average(columns, self.together)
            columns[:, p + 5] = self.values[_EDGE:-_EDGE] - columns[:, p + 5]
        else:
            columns[:, p + 5] = self.values - columns[:, p + 5]
        whitened = self.whiten(columns)
        return whitened[:, -1], whitened[:, :-1]


def first_turning_point(record: ConditionedRecord, cycles: Cycles) -> int:
    """Return which turning point is the first after the release: the second, where the first is the release itself.

    A record that begins at the release, or while the specimen is still held, begins near an extreme value.
    """
    start, extreme = float(record.displacement[:3].mean()), float(cycles.turning_values[0])
    return int(start * extreme > 0.0 and abs(start) > 0.5 * abs(extreme))


def turning_witness(record: ConditionedRecord, cycles: Cycles) -> TurningWitness:
    """Return the witness of the turning points of one record."""
    count = min(2 * len(cycles) + 1, cycles.turning_times.size)
    kept = slice(first_turning_point(record, cycles), count)
    times, values = cycles.turning_times[kept], cycles.turning_values[kept]
    time_errors, value_errors = cycles.turning_time_errors[kept], cycles.turning_value_errors[kept]
    return TurningWitness(
        times.copy(),
        values.copy(),
        np.maximum(time_errors, 1e-12 * np.abs(times).max() + 1e-300),
        np.maximum(value_errors, 1e-300),
    )


def waveform_witness(record: ConditionedRecord, cycles: Cycles) -> WaveformWitness:
    """Return the witness of the samples of one record, from half a cycle before its first turning point on."""
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
        return WaveformWitness(time, values, reduce, size, [], signal)
    together = int(per_cycle / _DENSE)
    autocovariance = record.noise_autocovariance
    is_averaged = together > 1
    if is_averaged:
        count = time.size // together
        time, values = time[: count * together], values[: count * together]
        time = time.reshape(count, together).mean(axis=1)
        values = values.reshape(count, together).mean(axis=1)
        autocovariance = _of_means(autocovariance, together)
        per_cycle /= together
        phase = _phase(time[_EDGE:-_EDGE], cycles)
        windows = _windows(phase, 4.0)
    harmonics = int(np.clip(0.5 * per_cycle - 1.5, 1, 4))
    subspace = [(window, _harmonics(phase[window], harmonics, 0, 1)) for window in windows]
    size = time.size - 2 * _EDGE if is_averaged else time.size
    return WaveformWitness(time, values, _whitener(autocovariance), size, subspace, signal, max(together, 1))


def _average(columns: FloatArray, together: int) -> FloatArray:
    """Return means over each step from values at the middle of the steps; two steps at either end are lost."""
    weights = _mean_weights(together)
    kept = columns.shape[0] - 2 * _EDGE
    return np.asarray(sum(weight * columns[k : kept + k] for k, weight in enumerate(weights)))


def _mean_weights(together: int) -> FloatArray:
    """Return weights (5,) on the middles of neighbouring steps that give the mean of a step's ``together`` samples.

    Exact for polynomials of degree five. A mean of few samples is not the mean over the step: for two samples of a
    sinusoid the integral would be 7e-4 off, which shows in long records.
    """
    place = (np.arange(together) - 0.5 * (together - 1)) / together
    second, fourth = float(np.mean(place**2)), float(np.mean(place**4))
    outer = (fourth - second) / 24.0
    inner = 0.5 * second - 4.0 * outer
    return np.array([outer, inner, 1.0 - 2.0 * (outer + inner), inner, outer])


def _of_means(autocovariance: FloatArray, together: int) -> FloatArray:
    """Return the autocovariance of means over so many neighbouring samples."""
    size = autocovariance.size
    lags = int(np.ceil((size - 1) / together)) + 1
    weights = together - np.abs(np.arange(-together + 1, together))
    padded = np.zeros((lags + 2) * together + size)
    padded[:size] = autocovariance
    result = np.empty(max(lags, 2))
    for lag in range(result.size):
        at = np.abs(lag * together + np.arange(-together + 1, together))
        result[lag] = float(weights @ padded[at]) / together**2
    return result


def _phase(time: FloatArray, cycles: Cycles) -> FloatArray:
    """Return the phase in cycles, from the turning points, carried on at both ends."""
    at, half = cycles.turning_times, 0.5 * np.arange(cycles.turning_times.size)
    inner = np.interp(time, at, half)
    before, after = time < at[0], time > at[-1]
    inner[before] = (time[before] - at[0]) * 0.5 / (at[1] - at[0])
    inner[after] = half[-1] + (time[after] - at[-1]) * 0.5 / (at[-1] - at[-2])
    return inner


def _windows(phase: FloatArray, length: float) -> list[slice]:
    """Return windows of about ``length`` cycles."""
    count = max(1, int(round((phase[-1] - phase[0]) / length)))
    edges = np.searchsorted(phase, np.linspace(phase[0], phase[-1], count + 1))
    edges[-1] = phase.size
    return [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True) if b - a >= 4]


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


def _whitener(autocovariance: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the filter that makes noise with this autocovariance white, of unit variance."""
    significant = np.abs(autocovariance[1:]) > 0.03 * autocovariance[0]
    if not significant.any():
        scale = 1.0 / np.sqrt(autocovariance[0])
        return lambda columns: columns * scale
    order = min(int(np.flatnonzero(significant)[-1]) + 1, MOST_LAGS)
    row = np.zeros(order + 1)
    row[: min(order + 1, autocovariance.size)] = autocovariance[: order + 1]
    row[0] *= 1.0 + 1e-3
    prediction = solve_toeplitz(row[:-1], row[1:])
    variance = float(row[0] - prediction @ row[1:])
    taps = np.concatenate([[1.0], -prediction]) / np.sqrt(max(variance, 1e-6 * row[0]))
    try:
        start = np.linalg.cholesky(toeplitz(row[:-1]))
    except np.linalg.LinAlgError:  # what was estimated is no autocovariance
        return lambda columns: lfilter(taps, 1.0, columns, axis=0)  # type: ignore[call-overload]

    def whiten(columns: FloatArray) -> FloatArray:
        filtered = np.asarray(lfilter(taps, 1.0, columns, axis=0))  # type: ignore[call-overload]
        first = min(order, columns.shape[0])  # samples whose past is not in the record
        filtered[:first] = solve_triangular(start[:first, :first], columns[:first], lower=True)
        return filtered

    return whiten
