"""What a decay shows apart from its backbone: its harmonics and its force, measured and of the models beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray, InputError
from ...measurement.harmonics import LEAST_PER_CYCLE, HarmonicDecay, harmonic_decay, peaks_of
from ...measurement.time_frequency import TimeFrequency, time_frequency
from ...simulation.decay import simulate_waveform
from ..fitting.batch import Batch
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import Fit

_PER_CYCLE = 64
_MOST_CYCLES = 400  # of a simulated decay
_RELEASES = 8  # from which a model is tried, the highest first
_HIGHER = 3.0  # cycles that a model is released before the first fit
_LOWER = 0.5  # times the lowest measured amplitude down to which models are simulated
_AT_LEAST = 3  # points with an error that leaves something to see
_SEEN = 0.3  # of the range of the force beyond the linear spring: the largest standard error that is drawn
_SECOND = 0.02  # share of a second mode from which a record is in trouble


@dataclass(frozen=True, eq=False)
class Portraits:
    """Pictures of single records, as numbers.

    Attributes
    ----------
    spectra : tuple of TimeFrequency
        Of the first record, and of one with a second mode.
    specimen : str
        Of which harmonics and forces are.
    mass, stiffness : float
        Mass [kg], and the stiffness [N/m] of the base at that specimen, which is taken from the forces.
    measured, base, named : HarmonicDecay or None
        Of the record; of the base and the named model, fitted to it. None where they are not told: fewer than 16
        samples a cycle, a band that took the harmonics or a filter that turned them, or a model that takes too long.
    has_forces : bool
        Whether the noise leaves something to see of the force beyond the linear spring.
    has_mid_line : bool
        Whether displacements are counted from equilibrium, and not from a mid-line that integration lost.
    """

    spectra: tuple[TimeFrequency, ...]
    specimen: str
    mass: float
    stiffness: float
    measured: HarmonicDecay | None
    base: HarmonicDecay | None
    named: HarmonicDecay | None
    has_forces: bool
    has_mid_line: bool = True


def portraits(batch: Batch, base: Fit, named: Fit | None, *, quick: bool = False) -> Portraits | None:
    """Return the portraits of the first record, and the spectrum of one with a second mode; None without records.

    Parameters
    ----------
    batch : Batch
        The data.
    base, named : Fit
        Models brought to the backbones; None where nothing is named.
    quick : bool
        Whether to leave out spectra that show one mode.
    """
    if not batch.has_records:
        return None
    share = [np.nan_to_num(record.second_mode_share) for record in batch.records]
    worst = int(np.argmax(share))
    shown = ([] if quick and batch.records[0].band is None else [0]) + ([worst] if share[worst] > _SECOND else [])
    spectra = tuple(time_frequency(batch.records[k], batch.cycles[k]) for k in dict.fromkeys(shown))
    record, cycles = batch.records[0], batch.cycles[0]
    measured, has_mid_line = None, record.measured.order == 0
    if record.band is None and not batch.is_behind_filter:  # which turns the harmonics
        peaks = cycles.turning_times[cycles.turning_signs > 0.0]
        measured = harmonic_decay(record.time, record.displacement, peaks, has_mid_line=has_mid_line)
    of_base = of_named = None
    if measured is not None:
        # a fit is of the cycles after a release: the models are released as much higher as they lose until then
        least = float(np.abs(measured.turning[:, :, 0]).max())
        top = 1.05 * least * float(np.exp(_HIGHER * cycles.damping[:3].mean()))
        releases = np.geomspace(top, least, _RELEASES).tolist()
        of_base = _simulated(base, measured, releases, has_mid_line)
        of_named = None if named is None else _simulated(named, measured, releases, has_mid_line)
    stiffness = float(base.parameters(0)[0])
    mass = base.layout.oscillator.mass
    return Portraits(
        spectra, record.specimen, mass, stiffness, measured, of_base, of_named,
        measured is not None and _shows_forces(measured, mass, stiffness), has_mid_line,
    )  # fmt: skip


def beyond_spring(decay: HarmonicDecay, mass: float, stiffness: float) -> tuple[FloatArray, FloatArray]:
    """Return the force beyond a linear spring over displacement where the speed is zero, and over speed where that is.

    Parameters
    ----------
    decay : HarmonicDecay
        Measured or simulated.
    mass, stiffness : float
        Kilograms, newtons per metre.

    Returns
    -------
    at_rest, in_passing : (2, 2 w) arrays
        Displacement and force, by displacement; speed and force, by speed.
    """
    sections = []
    for pairs, spring in ((decay.turning, stiffness), (decay.crossing, 0.0)):
        place, acceleration = pairs[:, :, 0].ravel(), pairs[:, :, 1].ravel()
        order = np.argsort(place)
        sections.append(np.stack([place, -mass * acceleration - spring * place])[:, order])
    return sections[0], sections[1]


def _shows_forces(decay: HarmonicDecay, mass: float, stiffness: float) -> bool:
    """Return whether enough points of either section stand above their error."""
    error = mass * float(np.median(decay.acceleration_error))
    ranges = [float(np.ptp(section[1])) for section in beyond_spring(decay, mass, stiffness)]
    return decay.amplitude.size >= _AT_LEAST and error < _SEEN * max(ranges)


def _simulated(
    found: Fit, measured: HarmonicDecay, releases: Sequence[float], has_mid_line: bool
) -> HarmonicDecay | None:
    """Return the harmonics of a model over the measured amplitudes; None where it cannot be simulated soon.

    It is released from the first of the amplitudes from which it comes back: a pendulum does not from beyond the top.
    """
    if is_heavy(found.layout):
        return None
    decays = (_decay(found, release, _LOWER * float(measured.amplitude.min())) for release in releases)
    time, values = next((decay for decay in decays if decay is not None), (None, None))
    if time is None or values is None:
        return None
    peaks = peaks_of(time, values)
    height = np.interp(peaks, time, values)
    peaks = peaks[height > _LOWER * float(measured.amplitude.min())]
    return harmonic_decay(time, values, peaks, has_mid_line=has_mid_line) if peaks.size else None


def _decay(found: Fit, release: float, bottom: float) -> tuple[FloatArray, FloatArray] | None:
    """Return instants and displacements of a decay down to an amplitude; None where it does not come back."""
    parameters, oscillator = found.parameters(0), found.layout.oscillator
    omega = float(np.sqrt(parameters[0] / oscillator.mass))
    cycles = 40
    while True:
        time = np.arange(cycles * _PER_CYCLE, dtype=np.float64) * float(2.0 * np.pi / omega / _PER_CYCLE)
        try:
            values = simulate_waveform(oscillator, parameters, time, release).values
        except InputError:
            return None
        usable = np.isfinite(values)
        if not usable[: 2 * _PER_CYCLE].all():
            return None
        last = np.abs(values[usable][-2 * _PER_CYCLE :]).max(initial=0.0)
        if last < bottom or cycles >= _MOST_CYCLES or not usable.all():
            return time[usable], values[usable]
        cycles = min(4 * cycles, _MOST_CYCLES)


__all__ = ["LEAST_PER_CYCLE", "Portraits", "beyond_spring", "portraits"]
