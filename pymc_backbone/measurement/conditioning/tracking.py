"""Dominant frequency of a decay, and its amplitude, phase and mid-line as functions of time (order tracking)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.interpolate import make_interp_spline

from ..._common.checks import FloatArray
from .convolution import convolve_inside

_STEEP = 0.2
"""Decrement of a cycle from which means over cycles leave a thousandth of the fundamental."""
_EDGE_CYCLES = 3.0


@dataclass(frozen=True)
class Track:
    """Fundamental of a decay, ``x = mean + amplitude cos(phase) + harmonics``, on a grid of uniform phase.

    Attributes
    ----------
    time, phase, amplitude, mean : (n,) arrays
        Seconds; radians (a peak of the fundamental at every multiple of 2 pi); the record's unit.
    per_cycle : int
        Grid points per cycle.
    """

    time: FloatArray
    phase: FloatArray
    amplitude: FloatArray
    mean: FloatArray
    per_cycle: int

    @property
    def cycles(self) -> float:
        """Number of cycles between the first and the last grid point."""
        return float(self.phase[-1] - self.phase[0]) / (2.0 * np.pi)

    @property
    def frequency(self) -> float:
        """Mean frequency [Hz]."""
        return self.cycles / float(self.time[-1] - self.time[0])

    def until(self, time: float) -> Track:
        """Return the track up to a time; at least four points stay."""
        n = max(int(np.searchsorted(self.time, time, side="right")), 4)
        return Track(self.time[:n], self.phase[:n], self.amplitude[:n], self.mean[:n], self.per_cycle)

    def shifted(self, origin: float) -> Track:
        """Return the same track with time counted from ``origin``."""
        return Track(self.time - origin, self.phase, self.amplitude, self.mean, self.per_cycle)

    def phase_at(self, time: FloatArray) -> FloatArray:
        """Return the phase at any time, extrapolated with linearly changing frequency."""
        return _extended(time, self.time, self.phase, self._edge)

    def amplitude_at(self, time: FloatArray) -> FloatArray:
        """Return the amplitude at any time, extrapolated with linearly changing decrement."""
        floor = 1e-12 * float(np.max(self.amplitude)) + np.finfo(float).tiny
        return np.exp(_extended(time, self.time, np.log(np.maximum(self.amplitude, floor)), self._edge))

    def time_at(self, phase: FloatArray) -> FloatArray:
        """Return the time at which the phase reaches given values."""
        return _extended(phase, self.phase, self.time, self._edge)

    def without_fundamental(self, samples: FloatArray, phase: FloatArray) -> FloatArray:
        """Return samples (n,) at phases (n,) without a fundamental that fades fast.

        Means over cycles take it away where its amplitude is a straight line over two of them, as it is with dry
        friction. Where it halves from one to the next it would leave more than a per cent in a mid-line or at twice its
        frequency.
        """
        if not self._bends:
            return samples
        turning = self.amplitude_at(self.time_at(phase)) * np.exp(1j * phase)
        size = 2.0 * complex(samples @ turning.conj()) / float((np.abs(turning) ** 2).sum())
        return np.asarray(samples - (size * turning).real)

    @property
    def _bends(self) -> bool:
        """Whether the amplitude falls fast, and by shares of itself rather than along a straight line."""
        amplitude = np.maximum(self.amplitude, 1e-12 * float(self.amplitude.max()) + np.finfo(float).tiny)
        if np.log(amplitude[0] / amplitude[-1]) < _STEEP * self.cycles:
            return False
        straight, decaying = (
            np.polyval(np.polyfit(self.phase, values, 1), self.phase) for values in (amplitude, np.log(amplitude))
        )
        off = [float(((item - amplitude) ** 2).sum()) for item in (straight, np.exp(decaying))]
        return off[1] < off[0]

    @property
    def _edge(self) -> int:
        return max(2, min(int(_EDGE_CYCLES * self.per_cycle), self.time.size))


def _extended(at: FloatArray, x: FloatArray, y: FloatArray, edge: int) -> FloatArray:
    """Interpolate linearly; beyond the ends follow the parabola through the ``edge`` outermost points."""
    values = np.interp(at, x, y)
    for outside, part, anchor in ((at < x[0], slice(None, edge), 0), (at > x[-1], slice(-edge, None), -1)):
        if outside.any():
            u = (x[part] - x[anchor]) / (x[part][-1] - x[part][0])
            curve = np.polyfit(u, y[part] - y[anchor], min(2, u.size - 1))
            curve[-1] = 0.0
            values[outside] = y[anchor] + np.polyval(curve, (at[outside] - x[anchor]) / (x[part][-1] - x[part][0]))
    return values


def dominant_frequency(
    values: FloatArray, sampling_rate: float, band: tuple[float, float] | None = None
) -> float | None:
    """Return the frequency [Hz] of the highest spectral peak, or None where no peak stands out.

    A peak must stand out of its neighbourhood in the spectrum of the *derivative*: steps (a model
    held and then released) and slow drifts have no peak there. Among such peaks the highest of the
    record's own spectrum is taken. The record is tapered at its end only, for a decay lives at its start.
    """
    n = values.size
    x = values - values.mean()
    half = n // 2
    x[half:] *= 0.5 + 0.5 * np.cos(np.pi * np.arange(n - half) / (n - half))
    size = next_fast_len(2 * n)
    spectrum = np.abs(rfft(x, size))
    del x
    frequency = rfftfreq(size, 1.0 / sampling_rate)
    weighted = spectrum * frequency
    top = np.flatnonzero((weighted[1:-1] > weighted[:-2]) & (weighted[1:-1] >= weighted[2:])) + 1
    low, high = band if band is not None else (3.0 * sampling_rate / n, np.inf)
    top = top[(frequency[top] >= max(low, 2.0 * sampling_rate / n)) & (frequency[top] <= high)]
    top = top[spectrum[top] > 0.25 * spectrum[top].max(initial=0.0)]
    top = top[np.argsort(spectrum[top])[::-1]][:200]
    # a strong decay whose frequency drifts has a broad peak, of a strong spring over an octave
    for prominence, reaches in ((2.0, (1.5,)), (1.3, (1.5, 3.0))):
        for peak in top:
            around = [weighted[max(int(peak / reach), 1) : int(peak * reach) + 2] for reach in reaches]
            if weighted[peak] > prominence * min(float(np.median(item)) for item in around):
                return float(frequency[peak])
    return None


def _triangle(half: int) -> FloatArray:
    """Return two running means over one cycle in one: zero response at every harmonic, and flat there."""
    kernel = np.concatenate([np.arange(1, half + 1), np.arange(half - 1, 0, -1)]).astype(np.float64)
    return kernel / kernel.sum()


def _first_phase(values: FloatArray, sampling_rate: float, frequency: float) -> tuple[FloatArray, FloatArray]:
    """Return times and phase of the fundamental demodulated at a fixed frequency."""
    half = max(round(sampling_rate / frequency), 2)
    time = np.arange(values.size) / sampling_rate
    carrier = np.exp(-2j * np.pi * frequency * time)
    z = convolve_inside(values * carrier, _triangle(half))
    inner = time[half - 1 : half - 1 + z.size]
    return inner, 2.0 * np.pi * frequency * inner + np.unwrap(np.angle(z))


def track(values: FloatArray, sampling_rate: float, frequency: float) -> Track | None:
    """Follow the fundamental of a uniformly sampled decay; None where fewer than three cycles can be followed.

    A first demodulation at fixed frequency gives the phase. The record is then resampled at uniform phase and
    demodulated there with two running means over exactly one cycle, which let neither the mid-line nor any
    harmonic through, however much the frequency drifts. The outermost cycle at each end is lost. Following ends where
    the phase becomes erratic (noise). More passes would not help: they feed the extrapolation at the ends back.
    """
    if values.size < 3.0 * sampling_rate / frequency:
        return None
    time, phase = _monotone(*_first_phase(values, sampling_rate, frequency), frequency)
    if phase.size < 4 or phase[-1] - phase[0] < 2.0 * np.pi:
        return None
    per_cycle = int(np.clip(4 * np.ceil(0.25 * sampling_rate / frequency), 16, 128))
    end = (values.size - 1) / sampling_rate
    last = end if time[-1] > end - 2.0 / frequency else time[-1] + 1.0 / frequency
    rough = Track(time, phase, np.ones(time.size), np.zeros(time.size), max(4, int(sampling_rate / frequency)))
    step = 2.0 * np.pi / per_cycle
    bounds = rough.phase_at(np.array([0.0, last]))
    grid = step * np.arange(np.ceil(bounds[0] / step), np.floor(bounds[1] / step) + 1.0)
    if grid.size < 3 * per_cycle:
        return None
    spline = make_interp_spline(np.arange(values.size) / sampling_rate, values, k=5)
    samples = spline(np.clip(rough.time_at(grid), 0.0, end))
    kernel = _triangle(per_cycle)
    z = 2.0 * convolve_inside(samples * np.exp(-1j * grid), kernel)
    mean = convolve_inside(samples, kernel)
    inner = grid[per_cycle - 1 : per_cycle - 1 + z.size]
    time, phase = _monotone(rough.time_at(inner), inner + np.unwrap(np.angle(z)), frequency)
    n = time.size
    if n < 4 or phase[-1] - phase[0] < 2.0 * np.pi:
        return None
    found = Track(time, phase, np.abs(z[:n]), mean[:n], per_cycle)
    rest = found.without_fundamental(samples, found.phase_at(rough.time_at(grid)))
    return replace(found, mean=convolve_inside(rest, kernel)[:n])


def _monotone(time: FloatArray, phase: FloatArray, frequency: float) -> tuple[FloatArray, FloatArray]:
    """Return the longest beginning over which the phase advances at a plausible rate."""
    rate = np.diff(phase) / (2.0 * np.pi * frequency * np.diff(time))
    bad = np.flatnonzero((rate < 0.3) | (rate > 3.0))
    n = int(bad[0]) + 1 if bad.size else time.size
    return time[:n], phase[:n]


def local_basis(time: FloatArray, path: Track, harmonics: int, powers: tuple[int, int, int]) -> FloatArray:
    """Return what a decay may look like over a few cycles, as columns.

    Parameters
    ----------
    time : (n,) array
        Seconds, a few cycles.
    path : Track
        The decay.
    harmonics : int
        Highest harmonic.
    powers : (int, int, int)
        Number of polynomial terms of the mid-line, of the fundamental and of each further harmonic.

    Returns
    -------
    (n, m) array
        Mid-line polynomials first, then cosine and sine of each harmonic, whose amplitudes are the tracked
        amplitude times polynomials in time.
    """
    u = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    # the track follows the noise around the fundamental; cubics follow only as much of it as the fit itself
    phase = _cubic(u, path.phase_at(time))
    amplitude = _smooth_amplitude(u, path.amplitude_at(time))
    columns = [u**power for power in range(powers[0])]
    for order in range(1, harmonics + 1):
        for power in range(powers[1] if order == 1 else powers[2]):
            shape = amplitude * u**power
            columns += [shape * np.cos(order * phase), shape * np.sin(order * phase)]
    return np.array(columns).T


def _smooth_amplitude(u: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return amplitude as a cubic or as the exponential of one: viscous decays need the one, friction the other."""
    scale = float(amplitude.max())
    plain = _cubic(u, amplitude / scale)
    logarithmic = np.exp(_cubic(u, np.log(np.maximum(amplitude / scale, 1e-12))))
    misfits = [float(np.sum((curve - amplitude / scale) ** 2)) for curve in (plain, logarithmic)]
    return plain if misfits[0] < misfits[1] else logarithmic


def _cubic(u: FloatArray, values: FloatArray) -> FloatArray:
    curve = np.polynomial.chebyshev.chebfit(u, values, min(3, u.size - 1))
    return np.asarray(np.polynomial.chebyshev.chebval(u, curve), dtype=np.float64)
