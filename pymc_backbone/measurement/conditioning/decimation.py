"""Fewer samples where there are more than the motion needs: a low-pass without phase shift, then every k-th sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray

KEPT = 128.0
"""Samples per cycle that are kept at least: 32 harmonics pass untouched. Turning points use five, but where dry
friction makes a corner, 64 samples per cycle shift level values by a standard error at a noise of 60 dB."""
SMALL = 40_000
"""Records of so few samples are left as they are: a second of computing is not worth a twentieth of a cycle."""
_ATTENUATION = 100.0
"""Stop-band attenuation [dB]; the pass-band ripple is then 1e-5 of the amplitude."""


@dataclass(frozen=True)
class Decimation:
    """A linear-phase low-pass that keeps every ``factor``-th sample.

    Attributes
    ----------
    taps : (2 h + 1,) array
        Impulse response, symmetric; h is a multiple of ``factor``.
    factor : int
        Samples taken for one that is kept.
    sampling_rate : float
        Samples per second before [Hz].
    """

    taps: FloatArray
    factor: int
    sampling_rate: float

    @property
    def half(self) -> int:
        """Samples (of before) lost at each end."""
        return (self.taps.size - 1) // 2

    def apply(self, values: FloatArray) -> FloatArray:
        """Return the kept samples, the first of which stands ``half`` samples after the first of ``values``."""
        from scipy.signal import upfirdn

        kept = upfirdn(self.taps, values, 1, self.factor)
        first = 2 * self.half // self.factor
        return np.asarray(kept[first : (values.size - 1) // self.factor + 1], dtype=np.float64)

    def noise_autocovariance(self) -> FloatArray:
        """Return the autocovariance of what white noise of unit variance becomes, at lags 0, 1, ... kept samples."""
        whole = np.correlate(self.taps, self.taps, mode="full")[self.taps.size - 1 :]
        return whole[:: self.factor]

    def gain(self, frequency: FloatArray) -> FloatArray:
        """Return the gain for white noise at frequencies up to half the new sampling rate, with what folds back.

        The squared gain is the spectrum of `noise_autocovariance`: 1 in the pass-band, 1/2 at half the new rate.
        """
        covariance = self.noise_autocovariance() * self.factor
        turns = np.asarray(frequency, dtype=np.float64) * self.factor / self.sampling_rate
        lags = np.arange(1, covariance.size)
        power = covariance[0] + 2.0 * np.cos(2.0 * np.pi * np.outer(turns, lags)) @ covariance[1:]
        gain: FloatArray = np.sqrt(np.maximum(power, 0.0)).reshape(np.shape(frequency))
        return gain


def design_decimation(size: int, sampling_rate: float, highest: float) -> Decimation | None:
    """Return the decimation to `KEPT` samples per cycle, or None where it is not worth it.

    Parameters
    ----------
    size : int
        Number of samples.
    sampling_rate : float
        Samples per second [Hz].
    highest : float
        Frequency of the mode [Hz], or a higher one that must be kept as well as it.

    Notes
    -----
    What lies below a quarter of the new sampling rate passes (1e-5), and nothing folds back onto it: the transition of
    the Kaiser-windowed low-pass reaches to three quarters of it. The filter is about 0.1 cycles long, so that 0.05
    cycles are lost at each end.
    """
    factor = int(sampling_rate / (KEPT * highest))
    if size <= SMALL or factor < 2:
        return None
    from scipy.signal import firwin, kaiserord

    rate = sampling_rate / factor
    count, beta = kaiserord(_ATTENUATION, 0.5 * rate / (0.5 * sampling_rate))
    half = factor * int(np.ceil(count / 2 / factor))
    taps = firwin(2 * half + 1, 0.5 * rate, window=("kaiser", beta), fs=sampling_rate)
    return Decimation(np.asarray(taps, dtype=np.float64), factor, sampling_rate)
