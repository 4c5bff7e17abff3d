"""Hum of the mains: lines at multiples of 50 or 60 Hz that last through the record, where a structure's decay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.optimize import minimize_scalar

from ..._common.checks import FloatArray
from ..._common.text import per_cent

MAINS = (50.0, 60.0)
"""Frequencies [Hz] of the world's mains."""
_OFF = 4e-3  # of its frequency, by which the mains may be off
_MOST = 8  # multiples that are looked at
_FIRST = 3  # one of so many multiples has to be there
_HIGHEST = 0.4  # of the sampling rate
_ENOUGH = 2400.0  # samples per second [Hz] that show all of these
_APART = 5.0  # bins between a line and a harmonic of the motion
_SWEPT = 0.01  # of the frequency of a harmonic, by which the motion may be off it
_HARMONICS = 6
_NEAR, _FAR = 4, 30  # bins beside a line that tell how high nothing is,
_SPREAD, _FEWEST = 8.0, 12  # but for so many beside lines of the motion, where that leaves so many
_LOBE = 1.5  # bins beside a line in which nothing is higher; on the skirt of the motion it is, towards that
_LINE = 60.0  # power of a line over the median beside it
_ABOVE = 4.0  # and over the highest of these
_FINER = 3  # frequencies that are looked at in each bin
_LASTS = 0.75  # amplitude in one half of the record over that in the other
_FALLS = 0.5  # the same of a motion whose even harmonics do not last; the odd ones of dry friction do


@dataclass(frozen=True)
class Hum:
    """Lines of the mains in one record: frequencies [Hz], and amplitude over the largest reading."""

    frequencies: tuple[float, ...]
    share: float

    @property
    def note(self) -> str:
        """What was done, in one sentence."""
        places = [f"{frequency:.4g}" for frequency in self.frequencies]
        where = " and ".join([", ".join(places[:-1]), places[-1]] if len(places) > 1 else places)
        return (
            f"hum of the mains at {where} Hz, {per_cent(self.share)} of the largest reading, lasts through the record "
            "and was taken out"
        )


def without_hum(values: FloatArray, rate: float, frequency: float) -> tuple[FloatArray, Hum | None]:
    """Return values without the hum of the mains, and that; the values themselves and None where there is none.

    Parameters
    ----------
    values : (n,) array
        Uniform samples.
    rate : float
        Samples per second [Hz].
    frequency : float
        Of the motion [Hz], whose harmonics are left alone.

    Returns
    -------
    (n,) array, Hum or None

    Notes
    -----
    A line is hum where it is narrow, stands sixty times above what is beside it, and is as high in one half of the
    record as in the other, which no line of a decaying structure is. One of the first three multiples has to be there.
    Nothing beside it within the window's lobe is higher: the skirt of a short decay has ripples that are as narrow.
    Close to a harmonic of the motion only an even one is looked at, of a motion that falls: those of dry friction last.
    The window falls to zero at both ends, so that the motion, hundreds of bins away, does not leak into a line.
    """
    if rate * _HIGHEST < min(MAINS):
        return values, None
    together = max(int(rate / _ENOUGH), 1)  # samples that are averaged: the lines are low, records may be long
    coarse = values[: values.size // together * together].reshape(-1, together).mean(axis=1)
    coarse_rate = rate / together
    size = next_fast_len(_FINER * coarse.size, real=True)
    power = np.abs(rfft(np.hanning(coarse.size) * coarse, size)) ** 2
    found: list[tuple[float, complex]] = []
    for mains in MAINS:
        places = [k * mains for k in range(1, _MOST + 1) if k * mains < _HIGHEST * coarse_rate]
        lines = [(k, _line(coarse, coarse_rate, power, place, frequency)) for k, place in enumerate(places, start=1)]
        seen = [(k, line) for k, line in lines if line is not None]
        if seen and seen[0][0] <= _FIRST and len(seen) > len(found):
            found = [line for _, line in seen]
    if not found:
        return values, None
    left, time, total = values.copy(), np.arange(values.size) / rate, 0.0
    for place, height in found:
        angle = np.pi * place / rate
        amplitude = abs(height) * together * np.sin(angle) / np.sin(together * angle)  # the mean takes from it
        phase = float(np.angle(height)) - (together - 1) * angle  # whose first value lies between samples
        left -= amplitude * np.cos(2.0 * np.pi * place * time + phase)
        total += amplitude**2
    largest = float(np.abs(values - np.median(values)).max())
    return left, Hum(tuple(place for place, _ in found), float(np.sqrt(total)) / largest)


def _line(
    values: FloatArray, rate: float, power: FloatArray, place: float, frequency: float
) -> tuple[float, complex] | None:
    """Return frequency and complex amplitude of a line of the mains near a place; None where there is none.

    ``power`` is that of the windowed values, at several frequencies a bin.
    """
    width = rate / values.size  # of a bin
    step = 0.5 * rate / (power.size - 1)
    order, half = round(place / frequency), values.size // 2
    is_fading = float(np.std(values[half:])) < _FALLS * float(np.std(values[:half])) and order % 2 == 0
    is_close = 0 < order <= _HARMONICS and abs(place - order * frequency) < _APART * width + (_SWEPT + _OFF) * place
    if is_close and not is_fading:
        return None
    reach = max(_OFF * place, width)
    if place - reach < (_FAR + 1) * width:
        return None
    near = np.arange(int((place - reach) / step), min(int((place + reach) / step) + 2, power.size))
    at = int(near[np.argmax(power[near])])
    lobe = int(np.ceil(_LOBE * width / step))
    if power[max(at - lobe, 0) : at + lobe + 1].max() > power[at]:
        return None
    away = width * np.arange(_NEAR, _FAR + 1)
    places = at * step + np.concatenate([-away, away])
    # the motion's own lines, and what a decay spreads beside them, are not what lies beside this one
    own = frequency * np.clip(np.rint(places / frequency), 1, _HARMONICS)
    places = places[np.abs(places - own) > _SPREAD * width + _SWEPT * own]
    if places.size < _FEWEST:
        return None
    beside = power[np.clip(np.rint(places / step).astype(int), 0, power.size - 1)]
    if power[at] < _LINE * float(np.median(beside)) or power[at] < _ABOVE * float(beside.max()):
        return None
    solved = minimize_scalar(
        lambda f: -abs(_height(values, rate, f)), bounds=((at - 1) * step, (at + 1) * step), method="bounded",
        options={"xatol": 1e-4 * width},
    )  # fmt: skip
    best = float(solved.x)
    halves = [abs(_height(part, rate, best)) for part in (values[:half], values[half:])]
    if min(halves) < _LASTS * max(halves) or abs(best - place) > reach:
        return None
    return best, _height(values, rate, best)


def _height(values: FloatArray, rate: float, frequency: float) -> complex:
    """Return the complex amplitude at the first sample of a line at a frequency, through a window of Hann."""
    window = np.hanning(values.size)
    wave = np.exp(-2j * np.pi * frequency / rate * np.arange(values.size))
    return complex(2.0 * ((window * values) @ wave) / window.sum())


__all__ = ["MAINS", "Hum", "without_hum"]
