"""Band-pass and integration of decays, without phase shift and without silent end effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from ..._common.checks import FloatArray, InputError
from .convolution import convolve_inside
from .tracking import Track, local_basis

_ATTENUATION = 70.0
"""Stop-band attenuation [dB] of the band-pass; its pass-band ripple is then 3e-4."""
_TRANSITION = 0.9
_NARROWEST = 0.1
_EDGE_FIT = 5.0
_EDGE_KEPT = 3.5


@dataclass(frozen=True)
class BandPass:
    """A linear-phase band-pass.

    Attributes
    ----------
    taps : (2 h + 1,) array
        Impulse response, symmetric.
    quadrature : (2 h + 1,) array
        Impulse response that passes the same band with every frequency a quarter of a cycle later, antisymmetric.
    low, high : float
        Half-amplitude edges [Hz].
    sampling_rate : float
        Samples per second [Hz].
    """

    taps: FloatArray
    quadrature: FloatArray
    low: float
    high: float
    sampling_rate: float

    @property
    def half(self) -> int:
        """Samples lost at each end."""
        return (self.taps.size - 1) // 2

    def apply(self, values: FloatArray) -> FloatArray:
        """Return the filtered values that depend on no sample beyond the ends: ``half`` fewer at each end."""
        from scipy.signal import oaconvolve

        return oaconvolve(values, self.taps, mode="valid")

    def gain(self, frequency: FloatArray | float, decay_rate: float = 0.0) -> FloatArray:
        """Return the gain for ``exp(-decay_rate t) cos(2 pi frequency t)``, real for real frequencies."""
        lag = np.arange(self.half + 1) / self.sampling_rate
        once = np.concatenate([self.taps[self.half : self.half + 1], 2.0 * self.taps[self.half + 1 :]])  # symmetric
        omega = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency, dtype=np.float64))
        lags = np.cos(omega[:, None] * lag) if decay_rate == 0.0 else np.cosh((-decay_rate + 1j * omega)[:, None] * lag)
        gains: FloatArray = lags @ once
        return gains

    def bias(self, path: Track) -> tuple[float, float]:
        """Return the relative bias of amplitude and of logarithmic decrement that the filter gives a decay.

        An exponential decay ``exp(s t)`` leaves the filter as ``G(s) exp(s t)``: its amplitude is biased by ``|G| -
        1``, its decrement and frequency not at all. When frequency or decrement drift, so does G, and what it gains
        from the first to the last cycle is missing from the decrement.
        """
        n = max(min(2 * path.per_cycle, path.time.size // 2), 2)
        gains = []
        for part in (slice(None, n), slice(-n, None)):
            span = float(path.time[part][-1] - path.time[part][0])
            rate = float(np.log(path.amplitude[part][0] / path.amplitude[part][-1])) / span
            frequency = float(path.phase[part][-1] - path.phase[part][0]) / (2.0 * np.pi * span)
            gains.append(float(np.abs(self.gain(frequency, rate)[0])))
        fall = float(np.log(path.amplitude[0] / path.amplitude[-1]))
        return max(gains, key=lambda gain: abs(gain - 1.0)) - 1.0, float(np.log(gains[0] / gains[1])) / fall

    def note(self, path: Track) -> str:
        """Return a sentence that says what the filter did."""
        lost = self.half * path.frequency / self.sampling_rate
        amplitude_bias, damping_bias = self.bias(path)
        return (
            f"band-passed {self.low:g} to {self.high:g} Hz without phase shift: {lost:.1f} cycles were lost at each "
            f"end, amplitude is biased by {amplitude_bias:+.0e} and damping by {damping_bias:+.0e} of themselves; "
            "harmonics outside the band are gone"
        )


def check_band(band: Any, sampling_rate: float, name: str) -> tuple[float, float]:
    """Return a band as two increasing frequencies below half the sampling rate, or raise `InputError`."""
    try:
        low, high = (float(edge) for edge in band)
    except (TypeError, ValueError):
        raise InputError(f"{name}: `band` must be two frequencies (low, high) in Hz, got {band!r}.") from None
    limit = 0.5 * sampling_rate
    if not 0.0 < low < high < limit:
        raise InputError(
            f"{name}: `band` must satisfy 0 < low < high < {limit:.4g} Hz (half the sampling rate), got "
            f"({low:g}, {high:g}); choose edges around the mode."
        )
    return low, high


def design_band_pass(band: tuple[float, float], frequency: float, sampling_rate: float, name: str) -> BandPass:
    """Design the shortest Kaiser-windowed band-pass that passes ``frequency`` untouched, or raise `InputError`.

    The transition at each edge is as wide as the distance from the mode to the nearer edge allows.
    """
    from scipy.signal import firwin, get_window, kaiserord

    low, high = band
    near = min(frequency - low, high - frequency)
    if near < _NARROWEST * frequency:
        raise InputError(
            f"{name}: `band` ({low:g}, {high:g}) Hz leaves {near:.3g} Hz beside the mode at {frequency:.4g} Hz, "
            f"expected "
            f"at least {_NARROWEST * frequency:.3g}; widen it, for example to ({0.75 * frequency:.3g}, "
            f"{1.3 * frequency:.3g})."
        )
    width = min(2.0 * _TRANSITION * near, 2.0 * low)
    count, beta = kaiserord(_ATTENUATION, width / (0.5 * sampling_rate))
    count += 1 - count % 2
    taps = firwin(count, [low, high], window=("kaiser", beta), pass_zero=False, fs=sampling_rate, scale=False)
    lag = np.arange(count) - (count - 1) // 2
    edges = 2.0 * np.pi * lag / sampling_rate
    ideal = (np.cos(low * edges) - np.cos(high * edges)) / (np.pi * np.where(lag == 0, 1, lag))
    quadrature = ideal * get_window(("kaiser", beta), count, fftbins=False)
    return BandPass(np.asarray(taps, dtype=np.float64), quadrature, low, high, sampling_rate)


def integrate(values: FloatArray, sampling_rate: float, path: Track) -> FloatArray:
    """Integrate a decay once over time and remove the mid-line, which integration cannot determine.

    Notes
    -----
    The running integral of a quintic spline is exact to 2e-6 at ten samples per cycle. Sensor offset and noise make
    it drift; the drift is the mean over three running cycles at uniform phase, which contains nothing of the
    oscillation or its harmonics, and is subtracted. Within the outermost cycles at each end, where no such mean
    exists, it comes from a least-squares fit of a parabola and the harmonics to the first (last) five cycles.
    """
    time = np.arange(values.size) / sampling_rate
    running = make_interp_spline(time, values, k=5).antiderivative()(time)
    # the sensor's offset alone is a ramp, which windows at uniform phase would bend
    u = np.linspace(-1.0, 1.0, time.size)
    running -= np.polynomial.chebyshev.chebval(u, np.polynomial.chebyshev.chebfit(u, running, 1))
    return running - _drift(running, time, path)


def _drift(running: FloatArray, time: FloatArray, path: Track) -> FloatArray:
    """Return the mid-line of a decay at every sample."""
    per_cycle = path.per_cycle
    step = 2.0 * np.pi / per_cycle
    at = path.phase_at(time) / (2.0 * np.pi)
    begin, end = float(at[0]), float(at[-1])
    if end - begin < _EDGE_FIT + 2.0:
        return _parabola(running, time, path)
    grid = step * np.arange(np.ceil(2.0 * np.pi * begin / step), np.floor(2.0 * np.pi * end / step) + 1.0)
    samples = make_interp_spline(time, running, k=5)(np.clip(path.time_at(grid), time[0], time[-1]))
    box = np.ones(per_cycle + 1) / per_cycle
    box[[0, -1]] *= 0.5
    kernel = np.convolve(np.convolve(box, box), box)
    middle: FloatArray = convolve_inside(samples, kernel)
    half = (kernel.size - 1) // 2
    drift = np.interp(at, grid[half : half + middle.size] / (2.0 * np.pi), middle)
    for window, distance in ((at < begin + _EDGE_FIT, at - begin), (at > end - _EDGE_FIT, end - at)):
        edge = _parabola(running[window], time[window], path)
        weight = np.clip(_EDGE_KEPT - distance[window], 0.0, 1.0)
        drift[window] = weight * edge + (1.0 - weight) * drift[window]
    return drift


def _parabola(values: FloatArray, time: FloatArray, path: Track) -> FloatArray:
    """Return the mid-line of a few cycles as a parabola fitted together with the harmonics."""
    per_cycle = 1.0 / (path.frequency * float(time[1] - time[0]))
    harmonics = int(np.clip(0.5 * per_cycle - 0.5, 1, 7))
    while harmonics > 1 and 7 + 4 * harmonics > 0.65 * values.size:
        harmonics -= 1
    basis = local_basis(time, path, harmonics, (3, 4, 2))
    scale = np.linalg.norm(basis, axis=0)
    solution = np.linalg.lstsq(basis / scale, values, rcond=1e-10)[0] / scale
    return basis[:, :3] @ solution[:3]


def integration_response(order: FloatArray) -> FloatArray:
    """Return the share of amplitude that `integrate` keeps at a given order (frequency over that of the mode)."""
    return 1.0 - np.sinc(order) ** 3
