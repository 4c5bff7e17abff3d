"""Measurement noise of a decay: its spectrum between and above the harmonics, and the autocovariance that follows."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, rfft, rfftfreq

from ..._common.checks import FloatArray
from .tracking import Track, local_basis

_SEGMENT_CYCLES = 6.0
_BAND_SEGMENT_CYCLES = 20.0
_PASSED = 0.25
_QUIET_CYCLES, _QUIET_SAMPLES = 3.0, 100
_FINE_SAMPLING = 24.0
_MAXIMUM_SEGMENTS = 24
_MAXIMUM_HARMONICS = 8  # of a displacement; each differentiation gives the higher ones more weight
_FINE_BINS = 12
_USABLE = 0.4
_GRID, _GRID_PER_ORDER = 4096, 128
_MAXIMUM_LAG_CYCLES = 3.0
_NEGLIGIBLE = 0.01
_WHITE_BAND = (0.5, 4.0)
_TAPERED_CYCLES = 12.0
_FEWEST_VALUES = 40
_MEAN_BELOW_FOUR = 1.0 - 4.0 / np.expm1(4.0)  # of an exponential distribution of mean one, cut at four
_MOSTLY = 0.6
_FLAT = 1.35
_LESS_IN_BAND = 3.0
_ENOUGH, _LOUDER = 5, 8.0  # segments from which each bin tells its own median; times that, above which it is no noise


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

    @property
    def total(self) -> float:
        """Standard deviation over all frequencies."""
        return float(np.sqrt(np.sum(self.density * np.diff(self.edges))))

    def at(self, frequency: FloatArray) -> FloatArray:
        """Return the density at given frequencies, interpolated between bin centres."""
        centres = 0.5 * (self.edges[1:] + self.edges[:-1])
        return np.interp(frequency, centres, self.density)


def quantum(values: FloatArray) -> float:
    """Return the step of a quantised record, or 0 where values are not multiples of one."""
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


def noise_spectrum(
    values: FloatArray,
    sampling_rate: float,
    track: Track,
    step: float = 0.0,
    integrations: int = 0,
    gain: Callable[[FloatArray], FloatArray] | None = None,
) -> NoiseSpectrum:
    """Estimate the noise spectrum of a decay from what its own harmonics leave.

    In segments of six cycles the harmonics, with amplitudes that vary as the tracked amplitude times a
    low-order polynomial, are fitted and subtracted; the periodogram of what is left, divided by
    the share of white noise that the fit leaves at each frequency, is the noise. The mean over segments leaves out
    glitches, the median over wide bins keeps out narrow lines (a second mode, mains hum). The noise is at
    least that of rounding to the ``step`` of the converter (variance step^2 / 12). Friction makes acceleration jump:
    with ``integrations`` more harmonics are fitted, which would else be taken for noise. With ``gain`` it is the noise
    before a filter that kept as much of it at each frequency.
    """
    edges = _bin_edges(track.frequency, 0.5 * sampling_rate)
    rows = [
        _binned(edges, *_before(gain, *_periodogram(values[first:last], first, sampling_rate, track, integrations)))
        for first, last in _segments(values.size, sampling_rate, track, _SEGMENT_CYCLES)
    ]
    return _spectrum(edges, rows, step)


def quiet_spectrum(
    values: FloatArray,
    sampling_rate: float,
    frequency: float,
    step: float = 0.0,
    gain: Callable[[FloatArray], FloatArray] | None = None,
) -> NoiseSpectrum | None:
    """Return the noise spectrum of a stretch without motion, or None where it is too short to tell."""
    length = round(_SEGMENT_CYCLES * sampling_rate / frequency)
    if values.size < max(_QUIET_CYCLES * sampling_rate / frequency, _QUIET_SAMPLES):
        return None
    if step == 0.0 and np.ptp(values) == 0.0:  # a sensor that is stuck shows no noise, not that there is none
        return None
    length = min(length, values.size)
    edges = _bin_edges(frequency, 0.5 * sampling_rate)
    rows = []
    for first in range(0, values.size - length + 1, length)[:_MAXIMUM_SEGMENTS]:
        u = np.linspace(-1.0, 1.0, length)
        basis = np.linalg.qr(np.column_stack([np.ones(length), u]))[0]
        found = _beside(basis, values[first : first + length], sampling_rate, _USABLE)
        rows.append(_binned(edges, *_before(gain, *found)))
    return _spectrum(edges, rows, step)


def _before(
    gain: Callable[[FloatArray], FloatArray] | None, frequency: FloatArray, density: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and densities before a filter."""
    return frequency, density if gain is None else density / gain(frequency) ** 2


def _binned(edges: FloatArray, frequency: FloatArray, density: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the level of each bin (NaN where it is empty) and the number of spectral values in it."""
    bins = np.searchsorted(edges, frequency, side="right") - 1
    level, count = np.full(edges.size - 1, np.nan), np.zeros(edges.size - 1)
    for k in range(edges.size - 1):
        inside = density[bins == k]
        count[k] = inside.size
        if inside.size:
            level[k] = inside.mean() if inside.size < 8 else np.median(inside) / np.log(2.0)
    return level, count


def _spectrum(edges: FloatArray, rows: list[tuple[FloatArray, FloatArray]], step: float) -> NoiseSpectrum:
    """Return the spectrum pooled over segments, not below rounding noise."""
    estimates, degrees = (np.array(part) for part in zip(*rows, strict=True))
    density = _whitened(_pooled(estimates, degrees), degrees)
    return NoiseSpectrum(edges, np.maximum(density, step**2 / 12.0 / float(edges[-1])))


def noise_in_band(
    values: FloatArray,
    sampling_rate: float,
    track: Track,
    gain: Callable[[FloatArray], FloatArray],
    step: float,
    whole: FloatArray,
) -> NoiseSpectrum:
    """Estimate the level of the noise that entered a band-pass, taken as constant over the band.

    Little of the band is not the mode's own line, and where the frequency drifts the line covers that too. So the level
    is that of the ``whole`` record before the filter where that is white, and else what came out beside the line in
    long segments.
    """
    nyquist = 0.5 * sampling_rate
    levels = []
    for first, last in _segments(values.size, sampling_rate, track, _BAND_SEGMENT_CYCLES):
        frequency, density = _periodogram(values[first:last], first, sampling_rate, track)
        passed = gain(frequency) ** 2
        inside = passed > _PASSED
        if inside.any():
            levels.append(float(np.mean(density[inside] / passed[inside])))
    column = np.array(levels) if levels else np.zeros(1)
    level = float(column[column <= 8.0 * np.median(column)].mean())
    white = white_level(whole, sampling_rate, track.frequency)
    if white is not None and white < _LESS_IN_BAND * level:
        level = white
    return NoiseSpectrum(np.array([0.0, nyquist]), np.array([max(level, step**2 / 12.0 / nyquist)]))


def white_level(values: FloatArray, sampling_rate: float, frequency: float) -> float | None:
    """Return the density of white noise below the lines of a record of many modes, or None where it is not white.

    In tapered segments most values between the lines are noise, whose periodogram is distributed exponentially: the
    mean of what lies below four means tells it, octave by octave; two at least must agree.
    """
    length = min(round(_TAPERED_CYCLES * sampling_rate / frequency), values.size)
    taper = np.hanning(length)
    firsts = range(0, values.size - length + 1, max(length // 2, 1))
    parts = np.array([values[first : first + length] for first in firsts])
    power = np.abs(rfft((parts - parts.mean(axis=1, keepdims=True)) * taper, axis=1)) ** 2
    power *= 2.0 / (sampling_rate * float(taper @ taper))
    at = rfftfreq(length, 1.0 / sampling_rate)
    octaves = 0.5 * frequency * 2.0 ** np.arange(np.ceil(np.log2(sampling_rate / frequency)) + 1)
    levels, counts = [], []
    for low, high in itertools.pairwise(octaves):
        inside = power[:, (at >= low) & (at < min(high, 0.5 * sampling_rate))].ravel()
        if inside.size < _FEWEST_VALUES:
            continue
        level = float(np.median(inside)) / np.log(2.0)
        for _ in range(50):
            kept = inside[inside < 4.0 * level]
            level = float(kept.mean()) / _MEAN_BELOW_FOUR
        if kept.size > _MOSTLY * inside.size:
            levels.append(level)
            counts.append(kept.size)
    # lines crowd the lower octaves: from the highest down as long as they agree
    agreed = 1
    while agreed < len(levels) and abs(np.log(levels[-agreed - 1] / levels[-1])) < np.log(_FLAT):
        agreed += 1
    if agreed < 2:
        return None
    return float(np.average(levels[-agreed:], weights=counts[-agreed:]))


def _segments(n: int, sampling_rate: float, track: Track, cycles: float) -> list[tuple[int, int]]:
    """Return the sample ranges of the segments, at most `_MAXIMUM_SEGMENTS` spread over the track."""
    start = max(0, int(np.ceil(float(track.time[0]) * sampling_rate)))
    stop = min(n, int(float(track.time[-1]) * sampling_rate) + 1)
    length = min(round(cycles * sampling_rate / track.frequency), stop - start)
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


def _periodogram(
    values: FloatArray, first: int, sampling_rate: float, track: Track, integrations: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and noise densities of one segment that begins at sample ``first``."""
    n = values.size
    time = np.arange(first, first + n) / sampling_rate
    cycles = n * track.frequency / sampling_rate
    harmonics = int(np.clip(0.5 * sampling_rate / track.frequency - 0.5, 1, _MAXIMUM_HARMONICS * (1 + integrations)))
    while harmonics > 1 and 6 + 4 * harmonics > 0.65 * n:
        harmonics -= 1
    is_fine = sampling_rate / track.frequency >= _FINE_SAMPLING
    powers = (3, 4, 3) if is_fine else (2, 4, 2)
    basis = np.linalg.qr(local_basis(time, track, harmonics, powers))[0]
    return _beside(basis, values, sampling_rate, _USABLE if cycles > 3.0 else 0.2)


def _beside(
    basis: FloatArray, values: FloatArray, sampling_rate: float, usable: float
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and densities of what an orthonormal basis leaves, where it leaves enough of white noise."""
    n = values.size
    residual = values - basis @ (basis.T @ values)
    power = np.abs(rfft(residual)) ** 2
    share = 1.0 - np.sum(np.abs(rfft(basis, axis=0)) ** 2, axis=1) / n
    good = share > usable
    good[0] = False
    return rfftfreq(n, 1.0 / sampling_rate)[good], 2.0 * power[good] / (n * sampling_rate) / share[good]


def _pooled(estimates: FloatArray, degrees: FloatArray) -> FloatArray:
    """Return the typical density of each bin over the segments; bins without a value take their neighbours'.

    Of few segments the one that is far louder than the others throughout holds no noise of the sensor.
    """
    if 1 < estimates.shape[0] < _ENOUGH:
        loudness = np.array([np.nanmedian(row) if np.isfinite(row).any() else np.inf for row in estimates])
        usual = float(np.median(loudness) if loudness.size > 2 else loudness.min())
        if 0.0 < usual < np.inf:  # where a sensor shows none at times, what it shows at others is its noise
            estimates = estimates[loudness <= _LOUDER * usual]
    filled = np.isfinite(estimates).any(axis=0)
    density = np.full(estimates.shape[1], np.nan)
    for k in np.flatnonzero(filled):
        column = estimates[np.isfinite(estimates[:, k]), k]
        if column.size < _ENOUGH:
            density[k] = column.mean()
            continue
        # glitches lie far above the rest; chance alone passes eight medians once in 250
        density[k] = column[column <= _LOUDER * np.median(column)].mean()
    if not filled.any():
        return np.zeros(density.size)
    where = np.arange(density.size)
    complete: FloatArray = np.interp(where, where[filled], density[filled])
    return complete


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


@dataclass(frozen=True)
class Noise:
    """Noise of a conditioned displacement.

    Attributes
    ----------
    standard_deviation : float
        Of the white noise with the same mean spectral density between half and four times the mode's frequency, where
        turning points take their information from.
    autocovariance : (m,) array
        At lags 0, 1, ... samples; at least two values, zero beyond the last.
    """

    standard_deviation: float
    autocovariance: FloatArray


def noise_of(
    spectrum: NoiseSpectrum, response: Callable[[FloatArray], FloatArray], frequency: float, sampling_rate: float
) -> Noise:
    """Return the noise after a linear operation with amplitude response ``response(frequency)``."""
    nyquist = 0.5 * sampling_rate
    # integration weighs the lowest frequencies most: they need a grid as fine, however fast the sampling
    count = max(_GRID, int(np.ceil(_GRID_PER_ORDER * nyquist / frequency)))
    grid = (np.arange(count) + 0.5) * nyquist / count
    density = spectrum.at(grid) * response(grid) ** 2
    low, high = (bound * frequency for bound in _WHITE_BAND)
    used = (grid >= low) & (grid <= min(high, nyquist))
    deviation = float(np.sqrt(density[used].mean() * nyquist))
    power = density * nyquist / count
    if np.ptp(density) <= 1e-9 * density.max():
        return Noise(deviation, np.array([power.sum(), 0.0]))
    lags = np.arange(int(np.ceil(_MAXIMUM_LAG_CYCLES * sampling_rate / frequency)) + 1)
    autocovariance = 0.5 * dct(power)[: lags.size]
    lags = lags[: autocovariance.size]
    # a smooth end keeps the sequence (nearly) positive definite
    tail = np.clip(3.0 * (1.0 - lags / lags[-1]), 0.0, 1.0)
    autocovariance *= 0.5 - 0.5 * np.cos(np.pi * tail)
    large = np.flatnonzero(np.abs(autocovariance) > _NEGLIGIBLE * autocovariance[0])
    last = int(large[-1]) if large.size else 0
    return Noise(deviation, np.append(autocovariance[: last + 1], 0.0))


def amplitude_floor(spectrum: NoiseSpectrum, frequency: float, sampling_rate: float) -> float:
    """Return the amplitude, three standard errors, below which a track drowns in the noise."""
    variance = float(spectrum.at(np.array([frequency]))[0]) * 0.5 * sampling_rate
    # two running means over a cycle of n samples: the variance of either quadrature is 4 / (3 n) times the noise's
    return 3.0 * float(np.sqrt(variance * 4.0 * frequency / (3.0 * sampling_rate)))
