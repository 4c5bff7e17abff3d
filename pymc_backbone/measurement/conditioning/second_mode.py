"""A second mode in a decay, told from the harmonics of a nonlinear one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft, rfftfreq

from ..._common.checks import FloatArray
from .tracking import Track

_SHARE = 0.03
_PROMINENCE = 6.0
_LOWEST_AMPLITUDE = 0.1
_MAXIMUM_SAMPLES = 60_000
_MAXIMUM_HARMONICS = 7
_LOWEST_ORDER = 0.15
_CLOSE_SHARE = 0.1
_NO_BAND = 0.25  # of the frequency, within which no band keeps one mode of two


@dataclass(frozen=True)
class SecondMode:
    """The highest spectral peak that does not belong to the dominant mode.

    Attributes
    ----------
    frequency : float
        Hertz.
    share : float
        Its height in the amplitude spectrum of the record over that of the dominant mode.
    """

    frequency: float
    share: float

    def suggested_band(self, mode: float) -> tuple[float, float]:
        """Return a band around the dominant mode that keeps this one out."""
        between = float(np.sqrt(mode * self.frequency))
        if self.frequency > mode:
            return 0.7 * mode, min(1.35 * mode, between)
        return max(0.7 * mode, between), 1.35 * mode


def find_second_mode(values: FloatArray, sampling_rate: float, path: Track) -> SecondMode | None:
    """Return the highest peak that is not phase-locked to the dominant mode, or None.

    Notes
    -----
    A harmonic of a nonlinear decay is locked to its phase: at order k it is a function of amplitude
    times cos(k phase), sin(k phase), wherever the frequency drifts. A second mode, even
    within a percent of a multiple of the first, is not: its phase winds away. So everything that is a
    smooth function of the tracked amplitude at integer orders of the tracked phase is fitted and
    subtracted, and a peak of what is left, 3 % or more of the dominant one and well above its
    surroundings, is a second mode. Peaks too close to the dominant mode to be told from its own
    change of amplitude are left out.
    """
    enough = np.flatnonzero(path.amplitude < _LOWEST_AMPLITUDE * path.amplitude[0])
    last = float(path.time[enough[0]]) if enough.size else float(path.time[-1])
    first_sample = int(np.ceil(float(path.time[0]) * sampling_rate))
    stop = min(values.size, int(last * sampling_rate) + 1, first_sample + _MAXIMUM_SAMPLES)
    time = np.arange(first_sample, stop) / sampling_rate
    cycles = (stop - first_sample) * path.frequency / sampling_rate
    if cycles < 4.0:
        return None
    x = values[first_sample:stop]
    residual = x - _phase_locked(x, time, path, cycles)
    return _highest_peak(x, residual, sampling_rate, path.until(last), cycles)


def against_beats(second: SecondMode | None, mode: float) -> str:
    """Return what can be done where an amplitude grows again too soon: another blow, or modes that beat."""
    if second is None:
        return "choose the part after a second release with `start`, or one mode of several with `band`"
    other = f"a mode at {second.frequency:.4g} Hz, {second.share:.0%} of the spectral peak"
    seen = f"{other}, beats with that at {mode:.4g} Hz"
    if abs(second.frequency - mode) < _NO_BAND * mode:
        return f"{seen}, too close for a `band`: hit or hold the structure where one of the two hardly moves"
    low, high = second.suggested_band(mode)
    return f"{seen}: keep one, for example with `band=({low:.3g}, {high:.3g})`"


def _phase_locked(values: FloatArray, time: FloatArray, path: Track, cycles: float) -> FloatArray:
    """Return the least-squares fit of the mid-line, the fundamental and its harmonics."""
    u = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    degree = int(np.clip(cycles / 5.0, 3, 15))
    phase = _smooth(u, path.phase_at(time), degree)
    amplitude = np.exp(_smooth(u, np.log(path.amplitude_at(time)), degree))
    amplitude /= amplitude.max()
    harmonics = int(np.clip(0.5 * time.size / cycles - 0.5, 1, _MAXIMUM_HARMONICS))
    powers = 4 if cycles > 8.0 else 2
    while harmonics > 1 and 2 * powers * harmonics + 2 * degree > 0.5 * time.size:
        harmonics -= 1
    columns = [amplitude**power for power in range(3)]
    polynomials = np.polynomial.chebyshev.chebvander(u, degree).T
    columns += [amplitude * p * wave for p in polynomials for wave in (np.cos(phase), np.sin(phase))]
    for order in range(2, harmonics + 1):
        shapes = [amplitude**power for power in range(powers)]
        columns += [shape * wave for shape in shapes for wave in (np.cos(order * phase), np.sin(order * phase))]
    basis = np.array(columns).T
    gram = basis.T @ basis
    scale = np.sqrt(np.diag(gram))
    solution: FloatArray = (
        np.linalg.lstsq(gram / np.outer(scale, scale), (basis.T @ values) / scale, rcond=1e-10)[0] / scale
    )
    explained: FloatArray = basis @ solution
    return explained


def _smooth(u: FloatArray, values: FloatArray, degree: int) -> FloatArray:
    """Return a polynomial through values, so smooth that beating with a close mode stays out of it."""
    step = max(1, u.size // 2000)
    curve = np.polynomial.chebyshev.chebfit(u[::step], values[::step], degree)
    return np.asarray(np.polynomial.chebyshev.chebval(u, curve), dtype=np.float64)


def _highest_peak(
    values: FloatArray, residual: FloatArray, sampling_rate: float, path: Track, cycles: float
) -> SecondMode | None:
    """Return the highest peak of a residual's spectrum that stands out, away from the mode itself."""
    n = values.size
    taper = np.cos(0.5 * np.pi * np.arange(n) / n) ** 2
    size = next_fast_len(2 * n)
    whole = np.abs(rfft((values - values.mean()) * taper, size))
    left = np.abs(rfft(residual * taper, size))
    frequency = rfftfreq(size, 1.0 / sampling_rate)
    low, high = _frequency_range(path)
    margin = max(0.06, 3.0 / cycles) * path.frequency
    main = float(whole[(frequency > low - margin) & (frequency < high + margin)].max())
    allowed = (frequency < low - margin) | (frequency > high + margin)
    allowed &= frequency > max(_LOWEST_ORDER * path.frequency, 3.0 * sampling_rate / n)
    tops = np.flatnonzero((left[1:-1] > left[:-2]) & (left[1:-1] >= left[2:])) + 1
    tops = tops[allowed[tops] & (left[tops] > _SHARE * main)]
    for peak in tops[np.argsort(left[tops])[::-1]][:20]:
        around = left[int(peak / 1.3) : int(peak * 1.3) + 2]
        # at low orders the surroundings hold too few spectral lines to compare with
        if left[peak] > _PROMINENCE * np.median(around) or left[peak] > 0.2 * main:
            return SecondMode(float(frequency[peak]), float(left[peak] / main))
    return _close_peak(frequency, whole, allowed, main, float(np.median(left)))


def _close_peak(
    frequency: FloatArray, whole: FloatArray, allowed: NDArray[np.bool_], main: float, floor: float
) -> SecondMode | None:
    """Return a peak of the record's own spectrum with a valley towards the dominant one, or None.

    Strong beating disturbs the tracked phase so much that nothing can be subtracted; but then the peak is plain to see.
    """
    centre = int(np.argmax(np.where(allowed, 0.0, whole)))
    tops = np.flatnonzero((whole[1:-1] > whole[:-2]) & (whole[1:-1] >= whole[2:])) + 1
    tops = tops[allowed[tops] & (whole[tops] > max(_CLOSE_SHARE * main, _PROMINENCE * floor))]
    tops = tops[np.abs(frequency[tops] / frequency[centre] - 1.0) < 0.5]
    for peak in tops[np.argsort(whole[tops])[::-1]][:20]:
        if whole[min(peak, centre) : max(peak, centre) + 1].min() < 0.5 * whole[peak]:
            return SecondMode(float(frequency[peak]), float(whole[peak] / main))
    return None


def _frequency_range(path: Track) -> tuple[float, float]:
    """Return the lowest and highest frequency of the mode over quarters of the decay, which average beating out."""
    at = np.linspace(0, path.time.size - 1, 5).astype(int)
    rates = np.diff(path.phase[at]) / np.diff(path.time[at]) / (2.0 * np.pi)
    # a steady drift continues beyond the middles of the outer quarters
    reach = 0.5 * float(np.max(np.abs(np.diff(rates))))
    return float(rates.min()) - reach, float(rates.max()) + reach
