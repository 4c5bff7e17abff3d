"""Measurement noise of a decay: its spectrum between and above the harmonics, and the autocovariance that follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft, rfftfreq

from ._checks import FloatArray
from ._tracking import Track

_SEGMENT_CYCLES = 6.0
_MAXIMUM_SEGMENTS = 24
_MAXIMUM_HARMONICS = 8
_FINE_BINS = 12
_USABLE = 0.4
_GRID = 4096
_MAXIMUM_LAG_CYCLES = 3.0


@dataclass(frozen=True)
class NoiseSpectrum:
    """One-sided power spectral density of the noise, constant within bins.

    Attributes
    ----------
    edges : (m + 1,) array
        Bin edges [Hz] from 0 to half the sampling rate.
    density : (m,) array
        Power spectral density [unit^2/Hz].
    """

    edges: FloatArray
    density: FloatArray

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the density at given frequencies, interpolated between bin centres."""
        centres = 0.5 * (self.edges[1:] + self.edges[:-1])
        return np.interp(frequency, centres, self.density)


def quantum(values: FloatArray) -> float:
    """Return the step of a quantised record: the smallest distance between distinct values, if most are multiples of it."""
    distinct = np.unique(values)
    steps = np.diff(distinct)
    steps = steps[steps > 1e-12 * max(abs(distinct[0]), abs(distinct[-1]))]
    if steps.size < 4:
        return 0.0
    # codes converted to units are multiples of the step only up to the printed digits
    step = float(np.percentile(steps, 1.0))
    ratio = steps / step
    off = np.abs(ratio - np.round(ratio))
    return step if np.median(off[ratio < 20.0]) < 0.05 else 0.0


def noise_spectrum(values: FloatArray, sampling_rate: float, track: Track) -> NoiseSpectrum:
    """Estimate the noise spectrum of a decay from what its own harmonics leave.

    In segments of six cycles the harmonics, with amplitudes that vary as the tracked amplitude times a
    low-order polynomial, are fitted and subtracted; the periodogram of what is left, divided by
    the share of white noise that the fit leaves at each frequency, is the noise. The median over segments keeps
    out glitches, the median over each bin keeps out narrow lines (a second mode, mains hum).
    """
    segments = _segments(values.size, sampling_rate, track)
    frequency = track.frequency
    nyquist = 0.5 * sampling_rate
    edges = _bin_edges(frequency, nyquist)
    estimates = np.full((len(segments), edges.size - 1), np.nan)
    degrees = np.zeros(estimates.shape)
    for row, (first, last) in enumerate(segments):
        time = np.arange(first, last) / sampling_rate
        estimates[row], degrees[row] = _segment(values[first:last], time, sampling_rate, track, edges)
    density = _pooled(estimates, degrees)
    floor = quantum(values) ** 2 / 12.0 / nyquist
    return NoiseSpectrum(edges, np.maximum(_whitened(density, degrees), floor))


def _segments(n: int, sampling_rate: float, track: Track) -> list[tuple[int, int]]:
    """Return the sample ranges of the segments, at most `_MAXIMUM_SEGMENTS` spread over the track."""
    start = max(0, int(np.ceil(float(track.time[0]) * sampling_rate)))
    stop = min(n, int(float(track.time[-1]) * sampling_rate) + 1)
    length = min(int(round(_SEGMENT_CYCLES * sampling_rate / track.frequency)), stop - start)
    count = max(1, (stop - start) // length)
    firsts = start + np.linspace(0, stop - start - length, count).astype(int)
    if count > _MAXIMUM_SEGMENTS:
        firsts = firsts[np.linspace(0, count - 1, _MAXIMUM_SEGMENTS).astype(int)]
    return [(int(first), int(first) + length) for first in firsts]


def _bin_edges(frequency: float, nyquist: float) -> FloatArray:
    """Return bin edges one order wide up to order 12, then 15 % wide, ending at half the sampling rate."""
    edges = [frequency * order for order in range(_FINE_BINS + 1) if frequency * order < nyquist]
    while edges[-1] < nyquist:
        edges.append(max(edges[-1] * 1.15, edges[-1] + frequency))
    edges[-1] = nyquist
    if len(edges) > 2 and edges[-1] - edges[-2] < 0.6 * frequency:
        del edges[-2]
    return np.array(edges)


def _basis(time: FloatArray, track: Track, harmonics: int) -> FloatArray:
    """Return an orthonormal basis of what a decay may look like within one segment."""
    u = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    # the track follows the noise around the fundamental; polynomials follow only as much of it as the fit itself
    phase = _smoothed(u, track.phase_at(time))
    amplitude = np.exp(_smoothed(u, np.log(np.maximum(track.amplitude_at(time), np.finfo(float).tiny))))
    amplitude = amplitude / amplitude.max()
    columns = [np.ones(time.size), u]
    for order in range(1, harmonics + 1):
        for power in range(4 if order == 1 else 3 if order <= 3 else 2):
            shape = amplitude * u**power
            columns += [shape * np.cos(order * phase), shape * np.sin(order * phase)]
    return np.linalg.qr(np.array(columns).T)[0]


def _smoothed(u: FloatArray, values: FloatArray) -> FloatArray:
    return np.polynomial.chebyshev.chebval(u, np.polynomial.chebyshev.chebfit(u, values, min(3, u.size - 1)))


def _segment(
    values: FloatArray, time: FloatArray, sampling_rate: float, track: Track, edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the noise density per bin in one segment, and the number of spectral values behind it."""
    n = values.size
    cycles = n * track.frequency / sampling_rate
    harmonics = int(np.clip(0.5 * sampling_rate / track.frequency - 0.5, 1, _MAXIMUM_HARMONICS))
    while harmonics > 1 and 6 + 4 * harmonics + 2 * min(harmonics, 3) > 0.65 * n:
        harmonics -= 1
    basis = _basis(time, track, harmonics)
    residual = values - basis @ (basis.T @ values)
    power = np.abs(rfft(residual)) ** 2
    share = 1.0 - np.sum(np.abs(rfft(basis, axis=0)) ** 2, axis=1) / n
    frequency = rfftfreq(n, 1.0 / sampling_rate)
    good = share > (_USABLE if cycles > 3.0 else 0.2)
    good[0] = False
    bins = np.searchsorted(edges, frequency, side="right") - 1
    density = 2.0 * power / (n * sampling_rate) / np.where(good, share, 1.0)
    estimate, count = np.full(edges.size - 1, np.nan), np.zeros(edges.size - 1)
    for k in range(edges.size - 1):
        inside = density[good & (bins == k)]
        count[k] = inside.size
        if inside.size:
            estimate[k] = inside.mean() if inside.size < 8 else np.median(inside) / np.log(2.0)
    return estimate, count


def _pooled(estimates: FloatArray, degrees: FloatArray) -> FloatArray:
    """Return the typical density of each bin over the segments; bins without a value take their neighbours'."""
    filled = np.isfinite(estimates).any(axis=0)
    density = np.full(estimates.shape[1], np.nan)
    for k in np.flatnonzero(filled):
        column = estimates[np.isfinite(estimates[:, k]), k]
        if column.size < 5:
            density[k] = column.mean()
            continue
        # glitches lie far above the rest; chance alone passes eight medians once in 250
        density[k] = column[column <= 8.0 * np.median(column)].mean()
    if not filled.any():
        return np.zeros(density.size)
    where = np.arange(density.size)
    return np.interp(where, where[filled], density[filled])


def _whitened(density: FloatArray, degrees: FloatArray) -> FloatArray:
    """Return one level for all bins when the differences between them are no more than chance."""
    weight = degrees.sum(axis=0)
    used = weight > 0
    if not used.any():
        return density
    mean = float(np.average(density[used], weights=weight[used]))
    if mean <= 0.0:
        return density
    # median-based values scatter somewhat more than means
    scatter = (density[used] / mean - 1.0) * np.sqrt(weight[used]) / 1.5
    if np.all(np.abs(scatter) < 4.0) and np.mean(scatter**2) < 1.0 + 3.0 * np.sqrt(2.0 / used.sum()):
        return np.full(density.size, mean)
    return density
