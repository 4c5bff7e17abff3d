"""From a measured record to the displacement of one free decay, with its noise and everything that was done said in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ._baseline import Baseline, find_baseline
from ._checks import FloatArray, InputError, check_finite_array
from ._filters import BandPass, design_band_pass, integrate, integration_response
from ._noise import NoiseSpectrum, noise_of, noise_spectrum, quantum
from ._plausibility import check_clipping, check_cycles, check_decays, check_moves, check_per_cycle
from ._release import Release, end_of_motion, find_release, leading_rest, regrowth
from ._sampling import UniformSamples, to_uniform
from ._second_mode import SecondMode, find_second_mode
from ._tables import printable
from ._tracking import Track, dominant_frequency, track
from .records import Record

_INTEGRATIONS = {"displacement": 0, "velocity": 1, "acceleration": 2}
_FLOOR = 3.0
"""Motion ends where its amplitude falls below this many standard errors of the tracked amplitude."""
_NARROWEST = 0.1


@dataclass(frozen=True, eq=False)
class ConditionedRecord:
    """The displacement of one free decay on a uniform time grid.

    Attributes
    ----------
    specimen : str
        Name of the specimen.
    time : (n,) array
        Seconds on the record's own clock, uniform; from the release to the end of motion.
    displacement : (n,) array
        Displacement from equilibrium [``unit``].
    sampling_rate : float
        Samples per second [Hz].
    noise : float
        Standard deviation [``unit``] of the white noise that disturbs turning points as much as the actual noise does.
    noise_autocovariance : (m,) array
        Autocovariance [``unit``^2] of the actual noise at lags 0, 1, ... samples, zero beyond the last; m >= 2.
    baseline, baseline_error : float
        Sensor reading at equilibrium that was subtracted, and its standard error [``unit``]; zero where a filter removed it.
    rest_offset : float
        Where the motion came to rest (dry friction) relative to equilibrium; NaN where the record does not show one.
    offset_is_measured : bool
        Whether the mid-line of the displacement is that of the structure; integration and band-pass remove it.
    frequency : float
        Mean frequency of the dominant mode [Hz].
    amplitude : float
        Amplitude of the fundamental at the first sample, extrapolated where the track begins later.
    unit : str
        ``"m"`` or ``"rad"``.
    quantity : str
        What was measured.
    band : (float, float) or None
        Band that was passed [Hz].
    lost_cycles : float
        Cycles lost at each end to the band-pass.
    second_mode_frequency, second_mode_share : float
        Highest peak of another mode [Hz] and its height over that of the dominant one; NaN where there is none.
    source : str
        File, for messages.
    notes : tuple of str
        What was assumed and done, one sentence each; warnings begin with ``warning:``.
    """

    specimen: str
    time: FloatArray
    displacement: FloatArray
    sampling_rate: float
    noise: float
    noise_autocovariance: FloatArray
    baseline: float
    baseline_error: float
    rest_offset: float
    offset_is_measured: bool
    frequency: float
    amplitude: float
    unit: str
    quantity: str
    band: tuple[float, float] | None
    lost_cycles: float
    second_mode_frequency: float
    second_mode_share: float
    source: str
    notes: tuple[str, ...] = field(default=())


def condition(
    record: Record,
    *,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    stop: float | None = None,
) -> ConditionedRecord:
    """Turn a measured record into the displacement of its free decay.

    Parameters
    ----------
    record : Record
        Displacement, velocity or acceleration.
    band : (float, float), optional
        Low and high edge [Hz] of a zero-phase band-pass around the mode, for records with more than one mode.
    start, stop : float, optional
        Part of the record to use [s, on its own clock]; ``start`` replaces the search for the release.

    Returns
    -------
    ConditionedRecord
        Displacement from the release to the end of motion, noise, and notes.

    Raises
    ------
    InputError
        When the record cannot be used: constant, clipped, no oscillation, fewer than 8 samples per
        cycle, fewer than 4 cycles, no decay, gaps, or a band that does not fit. The sentence names
        the file and the remedy.

    Notes
    -----
    *Release.* After a hold, an impact or the end of forcing the record begins a quarter of a cycle before the first
    turning point that lies at least a quarter of a cycle after the release. The held position itself is dropped:
    it is a plateau, not a turning point, and the hand or the hammer is in it.

    *Zero.* For displacement nothing is high-passed, because the mid-line is physics. The reading subtracted is the limit of the
    mid-line at vanishing amplitude, confirmed by a quiet tail where there is one. See `ConditionedRecord.rest_offset`.

    *Velocity and acceleration* are integrated over time (quintic spline) after the release, and the drift is removed without
    touching the harmonics; no cycle is lost, but the mid-line is.

    *Band.* A linear-phase filter; only samples that depend on no sample before the release are kept.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(2000) / 200.0
    >>> values = 2.0 + np.exp(-0.3 * time) * np.cos(2 * np.pi * 5.0 * time)
    >>> decay = condition(Record("beam", time, values))
    >>> round(decay.frequency, 3), round(decay.baseline, 4)
    (5.0, 2.0)
    """
    return _Conditioning(record, band, start, stop).run()


class _Conditioning:
    """The steps of `condition`, in order, with what they share."""

    def __init__(self, record: Record, band: Any, start: float | None, stop: float | None) -> None:
        self.record = record
        self.name = printable(record.source)
        self.notes: list[str] = list(record.notes)
        self.start_is_given = start is not None
        self.samples = self._sampled(start, stop)
        self.band = self._checked_band(band)

    def run(self) -> ConditionedRecord:
        """Condition the record."""
        samples, rate = self.samples, self.samples.sampling_rate
        frequency = self._dominant()
        release = self._release(frequency)
        measured = samples.values[release.index :]
        begin = samples.start + release.index / rate
        whole = check_cycles(track(measured, rate, frequency), self.name, "after the release")
        spectrum, whole = self._spectrum(measured, whole)
        band_pass = self._band_pass(whole)
        filtered, begin = (measured, begin) if band_pass is None else self._filtered(measured, begin, band_pass)
        path = (
            whole
            if band_pass is None
            else check_cycles(track(filtered, rate, whole.frequency), self.name, "left by the band-pass")
        )
        path, end = self._motion(path, spectrum, begin)
        check_decays(path, self.name)
        baseline = self._baseline(filtered, path, end, spectrum, band_pass)
        second = self._second_mode(filtered, path)
        first, last = self._cut(path, release, end, filtered.size, band_pass)
        displacement = self._displacement(filtered[first:last], path, first)
        displacement -= baseline.value
        noise = noise_of(spectrum, self._response(band_pass, path.frequency), path.frequency, rate)
        time = begin + np.arange(first, last) / rate
        time.setflags(write=False)
        displacement.setflags(write=False)
        noise.autocovariance.setflags(write=False)
        integrations = _INTEGRATIONS[self.record.quantity]
        scale = (2.0 * np.pi * path.frequency) ** -integrations
        return ConditionedRecord(
            specimen=self.record.specimen,
            time=time,
            displacement=displacement,
            sampling_rate=rate,
            noise=noise.standard_deviation,
            noise_autocovariance=noise.autocovariance,
            baseline=baseline.value,
            baseline_error=baseline.error,
            rest_offset=baseline.rest,
            offset_is_measured=integrations == 0 and band_pass is None,
            frequency=path.frequency,
            amplitude=float(path.amplitude_at(np.array([first / rate]))[0]) * scale,
            unit=self.record.unit.partition("/")[0],
            quantity=self.record.quantity,
            band=self.band,
            lost_cycles=0.0 if band_pass is None else band_pass.half * path.frequency / rate,
            second_mode_frequency=second.frequency if second else np.nan,
            second_mode_share=second.share if second else np.nan,
            source=self.record.source,
            notes=tuple(self.notes),
        )

    def _sampled(self, start: float | None, stop: float | None) -> UniformSamples:
        """Return the chosen part of the record on a uniform grid."""
        time, values = self.record.time, self.record.values
        keep = np.ones(time.size, dtype=bool)
        for label, bound, inside in (("start", start, np.greater_equal), ("stop", stop, np.less_equal)):
            if bound is not None:
                limit = float(check_finite_array(label, [bound])[0])
                keep &= inside(time, limit)
        if np.count_nonzero(keep) < 32:
            raise InputError(
                f"{self.name}: {np.count_nonzero(keep)} samples lie between `start` and `stop`, expected at least 32 of the "
                f"record from {time[0]:.6g} to {time[-1]:.6g} s; choose other limits."
            )
        check_moves(values[keep], self.name)
        samples = to_uniform(time[keep], values[keep])
        self.notes += samples.notes
        return samples

    def _checked_band(self, band: Any) -> tuple[float, float] | None:
        """Return the band as two increasing frequencies below half the sampling rate, or raise."""
        if band is None:
            return None
        try:
            low, high = (float(edge) for edge in band)
        except (TypeError, ValueError):
            raise InputError(f"`band` must be two frequencies (low, high) in Hz, got {band!r}.") from None
        limit = 0.5 * self.samples.sampling_rate
        if not 0.0 < low < high < limit:
            raise InputError(
                f"{self.name}: `band` must satisfy 0 < low < high < {limit:.4g} Hz (half the sampling rate), got "
                f"({low:g}, {high:g}); choose edges around the mode."
            )
        return low, high

    def _dominant(self) -> float:
        """Return the frequency of the dominant mode (within the band), after the checks that need it."""
        values, rate = self.samples.values, self.samples.sampling_rate
        lead = leading_rest(values)
        free = values[lead:] if values.size - lead >= 32 else values
        frequency = dominant_frequency(free, rate, self.band)
        if frequency is None and self.band is not None:
            other = dominant_frequency(free, rate)
            hint = f"the dominant motion is at {other:.4g} Hz" if other else "nothing oscillates outside it either"
            raise InputError(
                f"{self.name}: nothing oscillates between {self.band[0]:g} and {self.band[1]:g} Hz; {hint}, choose the band around a mode."
            )
        if frequency is None:
            raise InputError(f"{self.name}: no oscillation stands out of the record; check the column, or give a band.")
        check_per_cycle(rate, frequency, self.name)
        step = quantum(self.record.values)
        check_clipping(self.record.values, self.record.time, rate, frequency, step, self.name)
        return frequency

    def _release(self, frequency: float) -> Release:
        """Return where the free decay begins, and note what is dropped before."""
        if self.start_is_given:
            return Release(0, "start")
        rate = self.samples.sampling_rate
        release = find_release(self.samples.values, rate, frequency)
        seconds = release.index / rate
        if release.kind != "start":
            state = "at rest" if release.kind == "rest" else "driven"
            self.notes.append(f"the first {seconds:.4g} s, {state} before the free decay, were dropped")
        return release

    def _spectrum(self, measured: FloatArray, path: Track) -> tuple[NoiseSpectrum, Track]:
        """Return the noise spectrum and the track of a record, each found with the help of the other."""
        rate, step = self.samples.sampling_rate, quantum(self.record.values)
        spectrum = noise_spectrum(measured, rate, path, step)
        end = end_of_motion(path, _amplitude_floor(spectrum, path.frequency, rate))
        moving = path.until(end)
        if moving.cycles > 4.0 and moving.cycles < 0.9 * path.cycles:
            spectrum = noise_spectrum(measured, rate, moving, step)
        return spectrum, path

    def _band_pass(self, path: Track) -> BandPass | None:
        """Return the band-pass, or None; raise where it does not fit the mode or the record."""
        if self.band is None:
            return None
        low, high = self.band
        frequency, rate = path.frequency, self.samples.sampling_rate
        if not low < frequency < high:
            raise InputError(
                f"{self.name}: `band` ({low:g}, {high:g}) Hz must hold the mode at {frequency:.4g} Hz; move it."
            )
        near = min(frequency - low, high - frequency)
        if near < _NARROWEST * frequency:
            raise InputError(
                f"{self.name}: `band` ({low:g}, {high:g}) Hz leaves {near:.3g} Hz beside the mode at {frequency:.4g} Hz, expected at "
                f"least {_NARROWEST * frequency:.3g}; widen it, for example to ({0.75 * frequency:.4g}, {1.3 * frequency:.4g})."
            )
        return design_band_pass(low, high, frequency, rate)

    def _filtered(self, measured: FloatArray, begin: float, band_pass: BandPass) -> tuple[FloatArray, float]:
        """Return the band-passed record and the time of its first sample."""
        rate = self.samples.sampling_rate
        left = measured.size - 2 * band_pass.half
        if left < 32:
            raise InputError(
                f"{self.name}: the band-pass ({band_pass.low:g}, {band_pass.high:g}) Hz needs {band_pass.taps.size} of the "
                f"{measured.size} samples; widen the band or record longer."
            )
        return band_pass.apply(measured), begin + band_pass.half / rate

    def _motion(self, path: Track, spectrum: NoiseSpectrum, begin: float) -> tuple[Track, float]:
        """Return the track up to the end of motion, and that time (after the track's origin)."""
        rate = self.samples.sampling_rate
        floor = _amplitude_floor(spectrum, path.frequency, rate)
        end = end_of_motion(path, floor)
        path = check_cycles(path.until(end), self.name, "stand above the noise")
        grown = regrowth(path, floor / _FLOOR)
        if grown is not None:
            at, low, high = grown
            end = at
            self.notes.append(
                f"warning: the amplitude grows again from {low:.3g} to {high:.3g} after {begin + at:.5g} s (second impact or beating "
                "modes): only the part before is used; choose another part with start and stop, or a mode with band"
            )
            path = check_cycles(path.until(end), self.name, "before the amplitude grows again")
        self.samples.check_gaps(path.frequency, begin + end, self.name)
        return path, end

    def _baseline(
        self, values: FloatArray, path: Track, end: float, spectrum: NoiseSpectrum, band_pass: BandPass | None
    ) -> Baseline:
        """Return the sensor's zero; a filter has removed it already."""
        if self.record.quantity != "displacement" or band_pass is not None:
            self.notes.append("the mid-line was removed by filtering: the offset of this specimen is not measured")
            return Baseline(0.0, 0.0, np.nan)
        rate = self.samples.sampling_rate
        noise = float(np.sqrt(np.sum(spectrum.density * np.diff(spectrum.edges))))
        baseline = find_baseline(values, rate, path, end, noise)
        self.notes.append(f"baseline {baseline.value:.4g} +- {baseline.error:.2g} {self.record.unit} was subtracted")
        if np.isfinite(baseline.rest):
            self.notes.append(
                f"the motion came to rest {baseline.rest:.3g} {self.record.unit} off the mid-line of its last cycles (dry friction, "
                "or the sensor's zero drifts): the mid-line was taken as zero"
            )
        return baseline

    def _second_mode(self, values: FloatArray, path: Track) -> SecondMode | None:
        """Return a second mode, with a warning that names it."""
        second = find_second_mode(values, self.samples.sampling_rate, path)
        if second is None:
            return None
        low, high = _suggested_band(path.frequency, second.frequency)
        self.notes.append(
            f"warning: a second mode at {second.frequency:.4g} Hz has {second.share:.0%} of the spectral peak of the mode at "
            f"{path.frequency:.4g} Hz; pass one of them, for example with --band {low:.3g}:{high:.3g}"
        )
        return second

    def _cut(self, path: Track, release: Release, end: float, size: int, band_pass: BandPass | None) -> tuple[int, int]:
        """Return the range of samples from the release to the end of motion."""
        rate = self.samples.sampling_rate
        cycle = 1.0 / path.frequency
        first = 0
        if release.kind != "start" and band_pass is None:
            shift = 0.5 * np.pi if self.record.quantity == "velocity" else 0.0
            phase = float(path.phase_at(np.array([0.25 * cycle]))[0]) - shift
            turning = float(path.time_at(np.array([np.pi * np.ceil(phase / np.pi) + shift]))[0])
            first = max(0, int(np.floor((turning - 0.25 * cycle) * rate)))
        last = min(size, int(np.ceil((end + cycle) * rate)) + 1)
        if band_pass is not None:
            lost = band_pass.half / rate / cycle
            amplitude_bias, damping_bias = band_pass.bias(path)
            self.notes.append(
                f"band-passed {band_pass.low:g} to {band_pass.high:g} Hz without phase shift: {lost:.1f} cycles were "
                f"lost at each end, amplitude is biased by {amplitude_bias:+.0e} and damping by {damping_bias:+.0e} of "
                "themselves; harmonics outside the band are gone"
            )
        if size - last > cycle * rate:
            self.notes.append(f"the last {(size - last) / rate:.4g} s, after the end of motion, were dropped")
        return first, last

    def _displacement(self, values: FloatArray, path: Track, first: int) -> FloatArray:
        """Integrate as often as the measured quantity asks for."""
        rate = self.samples.sampling_rate
        result = np.array(values)
        count = _INTEGRATIONS[self.record.quantity]
        if count == 0:
            return result
        shifted = path.shifted(first / rate)
        for _ in range(count):
            result = integrate(result, rate, shifted)
        times = "once" if count == 1 else "twice"
        self.notes.append(f"{self.record.quantity} was integrated {times}; no cycle was lost")
        return result

    def _response(self, band_pass: BandPass | None, frequency: float) -> Callable[[FloatArray], FloatArray]:
        """Return the amplitude response from the measured quantity to the displacement."""
        count = _INTEGRATIONS[self.record.quantity]

        def response(grid: FloatArray) -> FloatArray:
            kept = (integration_response(grid / frequency) / (2.0 * np.pi * grid)) ** count
            return kept if band_pass is None else kept * np.abs(band_pass.gain(grid))

        return response


def _amplitude_floor(spectrum: NoiseSpectrum, frequency: float, sampling_rate: float) -> float:
    """Return the amplitude at which the track drowns in the noise."""
    density = float(spectrum.at(np.array([frequency]))[0])
    # two running means over a cycle: variance of either quadrature 2 sigma^2 * 2 / (3 n), n samples per cycle
    return _FLOOR * float(np.sqrt(density * 0.5 * sampling_rate * 4.0 * frequency / (3.0 * sampling_rate)))


def _suggested_band(frequency: float, other: float) -> tuple[float, float]:
    """Return a band around a mode that keeps another one out."""
    low, high = 0.7 * frequency, 1.35 * frequency
    if other > frequency:
        high = min(high, np.sqrt(frequency * other))
    else:
        low = max(low, np.sqrt(frequency * other))
    return float(low), float(high)
