"""What a record holds at multiples of its frequency: no law may show more there.

Backbones are those of the fundamental, and a band-pass leaves nothing beside it. What bends the motion, like strongly
asymmetric springs whose frequencies compensate each other, would still be seen in the samples as the sensor gave them.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from scipy.signal.windows import blackmanharris

from .._common.checks import FloatArray
from .batch import Batch
from .layout import Layout

_HARMONICS = (2, 3, 4, 5)
_CYCLES = 24  # that are looked at, less where the amplitude has fallen to half before
_FEWEST = 10  # cycles that a line needs to stand beside its neighbours
_NYQUIST = 0.8  # share of the highest frequency up to which a sensor is taken to tell
_WIDTH = 4.0  # half width of a line of the window, in bins
_NEAR = 0.3  # of the frequency: what lies so near a harmonic says how quiet the record is there
_BETWEEN = (1.35, 1.65)  # multiples of the frequency between the first two harmonics
_QUIETER = 0.1  # of what is between them: from there a filter took the harmonic away
_FLOOR = 1e-4  # least share of the fundamental that a sensor is trusted with


class HarmonicLimits:
    """How large each harmonic of one record is at most, over the fundamental.

    Parameters
    ----------
    sampling : float
        Samples per cycle.
    values : (n,) array
        Samples as the sensor gave them, from an instant of free motion on.
    order : int
        How often the displacement was differentiated.
    amplitude : float
        Of the displacement at the first sample [m or rad].

    Attributes
    ----------
    limits : (4,) array
        Of the harmonics 2 to 5; NaN where the record does not tell.
    """

    def __init__(self, sampling: float, values: FloatArray, order: int, amplitude: float) -> None:
        self.order, self.amplitude, self.size, self.sampling = order, amplitude, values.size, sampling
        self.limits = np.full(len(_HARMONICS), np.nan)
        spectrum = _spectrum(values)
        first = _fundamental(spectrum, values.size / sampling)
        if first is None:
            return
        place, height = first
        between = _level(spectrum, _BETWEEN[0] * place, _BETWEEN[1] * place)
        for k, n in enumerate(_HARMONICS):
            at = n * place
            if at + _WIDTH > _NYQUIST * spectrum.size:
                break
            beside = _level(spectrum, at - _NEAR * place, at + _NEAR * place)
            if beside > _QUIETER * between:
                self.limits[k] = max(_line(spectrum, at) / height, _FLOOR)

    @classmethod
    def of_batch(cls, batch: Batch, specimen: int) -> Self | None:
        """Return what the record of a specimen tells; None where there is none, or too little of it."""
        if not batch.has_records:
            return None
        measured, cycles = batch.records[specimen].measured, batch.cycles[specimen]
        step = float(np.median(np.diff(measured.time)))
        begin, falls = float(cycles.time[0]), cycles.amplitude < 0.5 * cycles.amplitude[0]
        count = min(int(np.argmax(falls)) if falls.any() else len(cycles), _CYCLES)
        period = 1.0 / float(np.median(cycles.frequency[: max(count, 1)]))
        inside = (measured.time >= begin) & (measured.time < begin + count * period)
        if count < _FEWEST or inside.sum() < 2 * count:
            return None
        return cls(period / step, measured.values[inside], measured.order, float(cycles.amplitude[0]))

    def log_odds(self, layout: Layout, parameters: FloatArray) -> float:
        """Return by how much less likely a law is than one without harmonics, as a natural logarithm.

        Where it shows more than the record holds, another line of unknown size would have to cancel the rest: of two
        unknown parts, with a prior that has no scale, that is as improbable as the square of what is left of both.

        Parameters
        ----------
        layout : Layout
            The model.
        parameters : (p,) array
            Of the specimen.
        """
        told = np.isfinite(self.limits)
        if not told.any():
            return 0.0
        shown = self._shown(layout, parameters)
        return 0.0 if shown is None else -float(np.log1p((shown[told] / self.limits[told]) ** 2).sum())

    def _shown(self, layout: Layout, parameters: FloatArray) -> FloatArray | None:
        """Return the harmonics (4,) of a simulated decay over its fundamental, measured alike."""
        period = 2.0 * np.pi * np.sqrt(layout.oscillator.mass / max(float(parameters[0]), 1e-300))
        simulator, release = layout.simulator, self.amplitude
        level = np.array([release])
        values, status = np.empty((3, 1)), np.zeros(1, dtype=np.int64)
        simulator.backbone(np.ascontiguousarray(parameters), level, 0.0, True, values, np.zeros((0, 0, 0)), status)
        if status[0] == 0 and values[0, 0] > 0.0:
            period = 1.0 / float(values[0, 0])
        instants = np.arange(self.size) * period / self.sampling
        motion, _, code = simulator.waveform(
            np.ascontiguousarray(parameters), release, instants, self.order, sensitivities=False
        )
        if code != 0 or not np.isfinite(motion).all():
            return None
        spectrum = _spectrum(motion)
        first = _fundamental(spectrum, self.size / self.sampling)
        if first is None:
            return None
        return np.array([_line(spectrum, n * first[0]) / first[1] for n in _HARMONICS])


def _spectrum(values: FloatArray) -> FloatArray:
    """Return the magnitudes (m,) of the windowed samples; the mean is left out, the window keeps lines apart."""
    window = blackmanharris(values.size, sym=False)
    mean = float(window @ values / window.sum())
    return np.abs(np.fft.rfft(window * (values - mean)))


def _fundamental(spectrum: FloatArray, cycles: float) -> tuple[float, float] | None:
    """Return the place of the line near so many cycles [bins], and its height; None where there is none."""
    near = slice(max(int(0.8 * cycles), 1), int(1.2 * cycles) + 2)
    if spectrum[near].size < 3:
        return None
    top = near.start + int(np.argmax(spectrum[near]))
    if top + 1 >= spectrum.size or spectrum[top] <= 0.0:
        return None
    left, middle, right = np.log(np.maximum(spectrum[top - 1 : top + 2], 1e-300))
    bend = left - 2.0 * middle + right
    return top + (0.5 * (left - right) / bend if bend < 0.0 else 0.0), float(spectrum[top])


def _line(spectrum: FloatArray, place: float) -> float:
    """Return the highest magnitude within a line's width of a place [bins]; 0 beyond the spectrum."""
    low, high = int(np.floor(place - _WIDTH / 2.0)), int(np.ceil(place + _WIDTH / 2.0)) + 1
    return float(spectrum[low:high].max()) if high <= spectrum.size else 0.0


def _level(spectrum: FloatArray, low: float, high: float) -> float:
    """Return the median magnitude between two places [bins]."""
    chosen = spectrum[int(np.floor(low)) : int(np.ceil(high)) + 1]
    return float(np.median(chosen)) if chosen.size else 0.0


__all__ = ["HarmonicLimits"]
