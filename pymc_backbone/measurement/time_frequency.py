"""How the spectrum of a record changes over time: where its mode is, what a band keeps, whether another mode rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._common.checks import FloatArray
from .conditioning.conditioned import ConditionedRecord
from .cycle_data import Cycles

_STRETCHES = 120  # columns of a picture
_CYCLES = 12.0  # of one stretch: frequencies a twelfth apart are told
_HIGHEST = 6.5  # times the frequency of the mode
_LOWEST = -70.0  # dB below the highest


@dataclass(frozen=True, eq=False)
class TimeFrequency:
    """A record over time and frequency.

    Attributes
    ----------
    specimen : str
        Its name.
    time : (t,) array
        Middle of each stretch [s].
    frequency : (f,) array
        Hertz, even.
    level : (f, t) array
        Amplitude [dB], 0 at the highest.
    ridge_time, ridge_frequency : (n,) arrays
        Frequency of each cycle as it was measured [s, Hz].
    band : (float, float) or None
        Band that was passed [Hz].
    second_mode : float
        Frequency [Hz] of another mode; NaN where there is none.
    quantity : str
        What is shown.
    """

    specimen: str
    time: FloatArray
    frequency: FloatArray
    level: FloatArray
    ridge_time: FloatArray
    ridge_frequency: FloatArray
    band: tuple[float, float] | None
    second_mode: float
    quantity: str


def time_frequency(record: ConditionedRecord, cycles: Cycles) -> TimeFrequency:
    """Return the samples of a record, as the sensor gave them, over time and frequency.

    Parameters
    ----------
    record : ConditionedRecord
        With the samples before any band was passed.
    cycles : Cycles
        Of the same record.

    Returns
    -------
    TimeFrequency
    """
    values, time = record.measured.values, record.measured.time
    step = float(time[-1] - time[0]) / (time.size - 1)
    highest = _HIGHEST * max(record.frequency, np.nan_to_num(record.second_mode_frequency) / _HIGHEST * 1.3)
    thin = max(int(0.5 / (step * highest)), 1)  # means of so many: what they fold lies beyond the picture
    if thin > 1:
        count = values.size // thin
        values = values[: count * thin].reshape(count, thin).mean(axis=1)
        time = time[: count * thin].reshape(count, thin).mean(axis=1)
        step *= thin
    size = int(np.clip(round(_CYCLES / (record.frequency * step)), 16, max(values.size // 4, 16)))
    starts = np.unique(np.linspace(0, max(values.size - size, 0), _STRETCHES).astype(int))
    stretches = np.lib.stride_tricks.sliding_window_view(values, min(size, values.size))[starts]
    window = np.hanning(stretches.shape[1] + 2)[1:-1]
    padded = 2 * int(2 ** np.ceil(np.log2(stretches.shape[1])))
    spectrum = np.abs(np.fft.rfft((stretches - stretches.mean(axis=1, keepdims=True)) * window, padded, axis=1)).T
    frequency = np.fft.rfftfreq(padded, step)
    shown = frequency <= highest
    level = 20.0 * np.log10(np.maximum(spectrum[shown] / spectrum.max(), 10.0 ** (_LOWEST / 20.0)))
    middle = time[starts] + 0.5 * (stretches.shape[1] - 1) * step
    return TimeFrequency(
        record.specimen, middle, frequency[shown], level, cycles.time, cycles.frequency, record.band,
        float(record.second_mode_frequency), record.quantity,
    )  # fmt: skip
