"""What a record holds at multiples of its frequency, against what a law shows there.

Backbones are those of the fundamental, and a band-pass leaves nothing beside it. The samples as the sensor gave them
still tell how the motion is bent: two asymmetric springs whose frequencies compensate each other are seen there, and
so is whether a spring that softens does so on both sides.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from scipy.special import i0

from ..._common.checks import FloatArray
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..fitting.layout import Layout

_HARMONICS = np.array([2, 3, 4, 5])
_CYCLES = 24  # that are looked at, less where the amplitude has fallen to half before
_FEWEST = 10  # cycles that a line needs to stand beside its neighbours
_NYQUIST = 0.8  # share of the highest frequency up to which a sensor is taken to tell
_WIDTHS = (3.0, 5.5)  # least and largest half width of a line, in bins: the wider, the less it reaches beyond
_LINES = 4.5  # half widths between one harmonic and the next
_BESIDE = (1.0, 4.0)  # bins beyond a line: what is there says how quiet the record is
_QUIETER = 0.1  # of what is beside the fundamental: a filter took the harmonic away
_FLOOR = 1e-4  # least share of the fundamental that a sensor is trusted with
_MODEL = 0.05  # of a simulated harmonic, that its parameters leave open


class Harmonics:
    """The harmonics of one record over the fundamental.

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
    ratios : (4,) complex array
        Harmonics 2 to 5 over the fundamental, their phases relative to its own; NaN where the record does not tell.
    errors : (4,) array
        What noise does to each of the two parts.
    """

    def __init__(self, sampling: float, values: FloatArray, order: int, amplitude: float) -> None:
        self.order, self.amplitude, self.size, self.sampling = order, amplitude, values.size, sampling
        self.ratios = np.full(_HARMONICS.size, np.nan, dtype=complex)
        self.errors = np.full(_HARMONICS.size, np.nan)
        found = _lines(values, sampling)
        if found is None:
            return
        place, height, ratios = found
        width = _width(values.size / sampling)
        spectrum = np.abs(np.fft.rfft(_windowed(values, width)))
        reference = _beside(spectrum, place, width)
        for k, n in enumerate(_HARMONICS):
            if n * place + width > _NYQUIST * spectrum.size:
                break
            beside = _beside(spectrum, n * place, width)
            if beside > _QUIETER * reference:
                self.ratios[k], self.errors[k] = ratios[k], max(beside / height, _FLOOR)

    @classmethod
    def of_batch(cls, batch: Batch, specimen: int) -> Self | None:
        """Return the harmonics in the record of a specimen; None where there is none, or too little of it."""
        if not batch.has_records:
            return None
        measured, cycles = batch.records[specimen].measured, batch.cycles[specimen]
        step = float(np.median(np.diff(measured.time)))
        falls = cycles.amplitude < 0.5 * cycles.amplitude[0]
        count = min(int(np.argmax(falls)) if falls.any() else len(cycles), _CYCLES)
        if count < _FEWEST:
            return None
        period = 1.0 / float(np.median(cycles.frequency[:count]))
        begin = float(cycles.time[0])
        inside = (measured.time >= begin) & (measured.time < begin + count * period)
        if inside.sum() < 2 * count:
            return None
        return cls(period / step, measured.values[inside], measured.order, float(cycles.amplitude[0]))

    def log_odds(self, layout: Layout, parameters: FloatArray, *, has_side: bool = True) -> float:
        """Return by how much likelier the record makes a law than one without harmonics, as a natural logarithm.

        What a law leaves of a harmonic would have to come from elsewhere: another mode, a sensor that bends. The size
        of that is unknown; without a scale its density falls with the square of what is left.

        Parameters
        ----------
        layout : Layout
            The model.
        parameters : (p,) array
            Of the specimen.
        has_side : bool
            Whether the parameters tell one side from the other; else the law may as well be its own mirror image.
        """
        told = np.isfinite(self.errors)
        shown = self._shown(layout, parameters) if told.any() else None
        if shown is None:
            return 0.0
        measured, shown, errors = self.ratios[told], shown[told], self.errors[told]
        mirrored = shown * (-1.0) ** (_HARMONICS[told] + 1)
        odds = []
        for image in (shown, mirrored):
            left = errors**2 + (_MODEL * np.abs(image)) ** 2 + np.abs(measured - image) ** 2
            odds.append(float(np.log((errors**2 + np.abs(measured) ** 2) / left).sum()))
        return odds[0] if has_side else float(np.logaddexp(odds[0], odds[1]) - np.log(2.0))

    def _shown(self, layout: Layout, parameters: FloatArray) -> np.ndarray | None:
        """Return the harmonics (4,) of a simulated decay over its fundamental, measured alike; None where none is."""
        vector, simulator = np.ascontiguousarray(parameters), layout.simulator
        values, status = np.empty((3, 1)), np.zeros(1, dtype=np.int64)
        simulator.backbone(vector, np.array([self.amplitude]), 0.0, True, values, np.zeros((0, 0, 0)), status)
        if status[0] != 0:
            return None
        instants = np.arange(self.size) / (self.sampling * float(values[0, 0]))
        motion, _, code = simulator.waveform(vector, self.amplitude, instants, self.order, sensitivities=False)
        found = _lines(motion, self.sampling) if code == 0 and np.isfinite(motion).all() else None
        return None if found is None else found[2]


def odds_behind_bands(batch: Batch, fits: Mapping[tuple[str, ...], Fit]) -> dict[tuple[str, ...], float]:
    """Return what harmonics that a band-pass keeps from the fits say of each set; without one the fits hold them."""
    if not any(record.measured.band_pass is not None for record in batch.records):
        return {}
    loudest = int(np.argmax([term.levels[-1] for term in batch.levels]))
    record = Harmonics.of_batch(batch, loudest)
    if record is None:
        return {}
    return {
        names: record.log_odds(found.layout, found.parameters(loudest), has_side=False) for names, found in fits.items()
    }


def _width(cycles: float) -> float:
    """Return half the width of a line [bins] for so many cycles, so that lines do not reach each other."""
    return float(np.clip(cycles / _LINES, *_WIDTHS))


def _windowed(values: FloatArray, width: float) -> FloatArray:
    """Return the samples less their mean, in the window whose lines have this half width."""
    shape = np.pi * np.sqrt(width**2 - 1.0)  # of a Kaiser window that goes on behind its end
    middle = 0.5 * values.size
    window = i0(shape * np.sqrt(1.0 - ((np.arange(values.size) - middle) / middle) ** 2)) / i0(shape)
    windowed: FloatArray = window * (values - float(window @ values / window.sum()))
    return windowed


def _lines(values: FloatArray, sampling: float) -> tuple[float, float, np.ndarray] | None:
    """Return place [bins] and height of the line at the frequency, and the harmonics (4,) over it.

    None where no line is near so many samples per cycle. Phases are relative to that of the fundamental, which a shift
    of time does not change.
    """
    cycles = values.size / sampling
    windowed = _windowed(values, _width(cycles))
    spectrum = np.abs(np.fft.rfft(windowed))
    low, high = max(int(0.8 * cycles), 1), int(1.2 * cycles) + 2
    if high + 1 >= spectrum.size or spectrum[low:high].max() <= 0.0:
        return None
    top = low + int(np.argmax(spectrum[low:high]))
    left, middle, right = np.log(np.maximum(spectrum[top - 1 : top + 2], 1e-300))
    bend = left - 2.0 * middle + right
    place = top + (0.5 * (left - right) / bend if bend < 0.0 else 0.0)
    angle = 2.0 * np.pi * place * (np.arange(values.size) - 0.5 * values.size) / values.size
    first = complex(windowed @ np.exp(-1j * angle))
    turn = first / abs(first)
    ratios = np.array([windowed @ np.exp(-1j * n * angle) / (abs(first) * turn**n) for n in _HARMONICS])
    return place, abs(first), ratios


def _beside(spectrum: FloatArray, place: float, width: float) -> float:
    """Return the root mean square of the magnitudes beside a line [bins], on the quieter side."""
    near, far = width + _BESIDE[0], width + _BESIDE[1]
    sides = [
        spectrum[max(round(place + low), 0) : round(place + high) + 1] for low, high in ((-far, -near), (near, far))
    ]
    return min((float(np.sqrt((side**2).mean())) for side in sides if side.size), default=0.0)


__all__ = ["Harmonics", "odds_behind_bands"]
