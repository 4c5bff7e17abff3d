"""From a measured record to the displacement of one free decay, with its noise and with notes on what was done."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..._common.checks import FloatArray, InputError, check_motion, check_positive
from ..._common.text import with_error
from ..._common.threads import with_one_thread
from ..reading.record import MINIMUM_SAMPLES, Record
from .asymmetry import MidLine, displacement_amplitude, find_mid_line, second_harmonic
from .baseline import Baseline, find_baseline
from .conditioned import ConditionedRecord, MeasuredSamples
from .filters import BandPass, design_band_pass, integrate, integration_response
from .free_part import FreePart, dropped
from .noise import NoiseSpectrum, amplitude_floor, noise_in_band, noise_of, noise_spectrum, quiet_spectrum
from .plausibility import MINIMUM_CYCLES, check_cycles, check_decays, check_stops_growing
from .release import end_of_drive, end_of_motion, envelope, regrowth
from .second_mode import SecondMode, against_beats, find_second_mode
from .second_release import later_motion
from .tracking import Track, track
from .wander import Wander, find_wander

__all__ = ["ConditionedRecord", "condition"]

_FEWEST_CYCLES = 8.0
"""Fewer are not given up to keep the end of forcing out of what a filter saw."""
_LET_GO, _STRUCK = 0.15, 0.55
"""Cycles from the release to the first turning point that is used; what was struck may be driven for half a cycle."""


@with_one_thread
def condition(
    record: Record,
    *,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    stop: float | None = None,
    floor: float | None = None,
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
    floor : float, optional
        Amplitude of the displacement [m or rad] at which the part to use ends. What follows still says where zero is
        and how large the noise is.

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

    See Also
    --------
    read_records : where records come from.
    extract_cycles : what follows.

    Notes
    -----
    *Release.* After a hold, an impact or the end of forcing the record begins a quarter of a cycle before the first
    turning point that lies at least 0.15 cycles after the first sample that is clearly off the hold, which is up to 0.3
    cycles late where there are few. The held position itself is dropped: it is a plateau, not a turning point, and the
    hand is in it. What was struck was at rest in its equilibrium: the turning point lies at least 0.55 cycles after the
    first motion, and a pulse of up to 0.3 cycles is dropped.

    *Zero.* For displacement nothing is high-passed, because the mid-line is physics. The reading subtracted is the
    limit of the mid-line at vanishing amplitude, confirmed by a quiet tail where there is one. See
    `ConditionedRecord.rest_offset`.

    *Velocity and acceleration* are integrated over time (quintic spline) after the release, and the drift is
    removed without touching the harmonics; no cycle is lost, but the mid-line is. For an asymmetric structure that
    matters: a mid-line proportional to the k-th power of amplitude changes the logarithmic decrement of the
    package's definition by the factor 1 + k times mid-line over amplitude. The mean of a velocity over each cycle
    is the rate of change of the mid-line: where that is significant, the mid-line is restored from it. Otherwise a
    second harmonic raises a warning: the mid-line that it implies is put in, and what that leaves open is an error of
    the damping (`ConditionedRecord.mid_line_error`).

    *Band.* A linear-phase filter; only samples that depend on no sample before the release are kept. Harmonics
    outside the band are lost, and with them their share of the turning points (0.9 % for a third harmonic of a
    Duffing oscillator with 30 % cubic stiffness).

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(2000) / 200.0
    >>> values = 2.0 + np.exp(-0.3 * time) * np.cos(2 * np.pi * 5.0 * time)
    >>> decay = condition(Record("beam", time, values))
    >>> round(decay.frequency, 3), round(decay.baseline, 4)
    (5.0, 2.0)
    """
    return _Conditioning(FreePart(record, band, start, stop), floor).run()


class _Conditioning:
    """The steps of `condition` after the free part of the record is found, in order, with what they share."""

    def __init__(self, free: FreePart, floor: float | None) -> None:
        self.free = free
        self.floor = None if floor is None else check_positive("floor", floor)
        self.record, self.name, self.integrations = free.record, free.name, free.integrations
        self.frequency, self.rate, self.step = free.frequency, free.rate, free.step
        self.begin, self.notes = free.begin, free.notes
        self.cycles_after = 1.0  # kept after the end of motion; none where what follows is another motion
        self.grows_again = False

    def run(self) -> ConditionedRecord:
        """Condition the record."""
        measured, is_cut = self.free.values, self.free.is_cut
        band_pass = None
        if self.free.band is not None:
            band_pass = design_band_pass(self.free.band, self.frequency, self.rate, self.name)
            measured = self._filtered(measured, band_pass)
        what = "after the release" if band_pass is None else "left by the band-pass"
        followed = track(measured, self.rate, self.frequency)
        if followed is None or followed.cycles + 2.0 < MINIMUM_CYCLES:
            samples = self.free.samples
            check_stops_growing(
                envelope(self.free.whole, samples.sampling_rate, self.frequency, self.integrations),
                samples.sampling_rate / self.frequency,
                self.name,
            )
        path = check_cycles(followed, self.name, what)
        spectrum, path, end = self._motion(measured, path, band_pass)
        floor = amplitude_floor(spectrum, path.frequency, self.rate)
        check_decays(displacement_amplitude(path, self.integrations), self.name, path.amplitude[-1] > 3.0 * floor)
        baseline = self._baseline(measured, path, end, spectrum, band_pass)
        second = self._second_mode(measured, path)
        wander = None if band_pass is not None else find_wander(measured, self.rate, path, spectrum, self.integrations)
        if wander is not None and wander.is_sure:
            self.notes.append(wander.note(path, self.rate, spectrum, self.record.unit))
        end = self._above_floor(path, end)
        first, last = self._range(path, is_cut and band_pass is None, end, measured.size)
        before = round((self.begin - self.free.begin) * self.rate)
        displacement = self._displacement(measured[first:last], path.shifted(first / self.rate))
        mid_line = None
        time = np.arange(first, last) / self.rate
        amplitude = displacement_amplitude(path, self.integrations)
        if self.integrations or band_pass:
            lag = 0.0 if band_pass is None else band_pass.half / self.rate
            mid_line = self._mid_line(self.free.values, path.shifted(-lag), second, is_filtered=band_pass is not None)
        if mid_line is not None:
            displacement += mid_line.at(amplitude.amplitude_at(time))
        if band_pass is not None:
            self.notes.append(band_pass.note(path))
        noise = noise_of(spectrum, self._response(band_pass, path.frequency), path.frequency, self.rate)
        is_absolute = not (self.integrations or band_pass)
        largest = float(amplitude.amplitude_at(time[:1])[0])
        check_motion(largest, path.frequency, self.record.unit.partition("/")[0], self.name)
        return ConditionedRecord(
            specimen=self.record.specimen,
            time=_frozen(self.begin + time),
            displacement=_frozen(displacement - baseline.value),
            sampling_rate=self.rate,
            noise=noise.standard_deviation,
            noise_autocovariance=_frozen(noise.autocovariance),
            baseline=baseline.value + self.free.reading if is_absolute else 0.0,
            baseline_error=baseline.error,
            rest_offset=baseline.rest,
            offset_is_measured=is_absolute or (mid_line is not None and mid_line.is_measured),
            mid_line_error=0.0 if mid_line is None else mid_line.error,
            mid_line_shape_error=0.0 if mid_line is None else mid_line.shape_error,
            frequency=path.frequency,
            amplitude=largest,
            unit=self.record.unit.partition("/")[0],
            quantity=self.record.quantity,
            band=self.free.band,
            lost_cycles=0.0 if band_pass is None else band_pass.half * path.frequency / self.rate,
            end_of_motion=min(self.begin + end, self.begin + float(time[-1])),
            second_mode_frequency=second.frequency if second else np.nan,
            second_mode_share=second.share if second else np.nan,
            source=self.record.source,
            measured=self._measured(before, is_cut, (first, last), path, spectrum, band_pass, wander),
            notes=tuple(self.notes),
            is_cut=is_cut,
            grows_again=self.grows_again,
        )

    def _filtered(self, values: FloatArray, band_pass: BandPass) -> FloatArray:
        """Return the band-passed record without its ends, and without forcing at its start."""
        if values.size - 2 * band_pass.half < MINIMUM_SAMPLES:
            raise InputError(
                f"{self.name}: the band-pass ({band_pass.low:g}, {band_pass.high:g}) Hz needs {band_pass.taps.size} of "
                f"the {values.size} samples; widen the band or record longer."
            )
        result = band_pass.apply(values)
        self.begin += band_pass.half / self.rate
        index = end_of_drive(result, self.rate, self.frequency, self.integrations) if self.free.searches else None
        if index is None:
            return result
        self.notes.append(dropped(index / self.rate, "driven"))
        self.begin += index / self.rate
        return result[index:]

    def _motion(
        self, values: FloatArray, path: Track, band_pass: BandPass | None
    ) -> tuple[NoiseSpectrum, Track, float]:
        """Return the noise, the track up to the end of motion, and that time, each found with the help of the other."""
        spectrum = self._spectrum(values, path, band_pass)
        end = end_of_motion(path, amplitude_floor(spectrum, path.frequency, self.rate))
        cycle = 1.0 / path.frequency
        # not the last cycle: it may hold the stop
        moving = path.until(end - cycle)
        if moving.cycles > 3.0 and moving.cycles < 0.9 * path.cycles:
            spectrum = self._spectrum(values, moving, band_pass)
            end = end_of_motion(path, amplitude_floor(spectrum, path.frequency, self.rate))
        # a tail without motion shows the noise itself; less noise may move the end, hence again
        for _ in range(3 if band_pass is None else 0):
            tail = values[int(np.ceil((end + 2.0 * cycle) * self.rate)) :]
            quiet = quiet_spectrum(tail, self.rate, path.frequency, self.step, self._kept)
            if quiet is None or quiet.total > 0.9 * spectrum.total:
                break
            spectrum = quiet
            end = end_of_motion(path, amplitude_floor(spectrum, path.frequency, self.rate))
        path = check_cycles(path.until(end), self.name, "stand above the noise")
        grown = regrowth(path, self.integrations, amplitude_floor(spectrum, path.frequency, self.rate) / 3.0)
        if grown is not None:
            end, low, high = grown
            self.notes.append(
                f"warning: the amplitude grows again from {low:.3g} to {high:.3g} after {self.begin + end:.5g} "
                "s (a second release or impact, or beating modes): only the part before is used; choose another part "
                "with `start` and `stop`, or a mode with `band`"
            )
            remedy = against_beats(find_second_mode(values, self.rate, path), path.frequency)
            what = "before the amplitude grows again"
            path = check_cycles(path.until(end), self.name, what, remedy, MINIMUM_CYCLES + 1.0)
            self.cycles_after, self.grows_again = 0.0, True
        else:
            first = int(np.ceil(end * self.rate))
            again = later_motion(values[first:], self.rate, self.frequency, float(path.amplitude[0]), spectrum.total)
            if again is not None:
                self.grows_again = True
                self.notes.append(again.note(self.begin + first / self.rate, self.rate, self.record.unit))
        self.free.samples.check_gaps(path.frequency, self.begin + end, self.name)
        return spectrum, path, end

    def _spectrum(self, values: FloatArray, path: Track, band_pass: BandPass | None) -> NoiseSpectrum:
        """Return the spectrum of the noise of the measured quantity."""
        if band_pass is None:
            return noise_spectrum(values, self.rate, path, self.step, self.integrations, self._kept)
        return noise_in_band(
            values, self.rate, path, lambda f: np.abs(band_pass.gain(f)) * self._kept(f), self.step, self.free.values
        )

    def _kept(self, frequency: FloatArray) -> FloatArray:
        """Return the share of the amplitude of white noise that decimation keeps."""
        return np.ones_like(frequency) if self.free.decimation is None else self.free.decimation.gain(frequency)

    def _baseline(
        self, values: FloatArray, path: Track, end: float, spectrum: NoiseSpectrum, band_pass: BandPass | None
    ) -> Baseline:
        """Return the sensor's zero; integration or a filter has removed it already."""
        if self.integrations or band_pass is not None:
            return Baseline(0.0, 0.0, np.nan)
        harmonic = second_harmonic(values, self.rate, path, 0)
        baseline = find_baseline(values, self.rate, path, end, spectrum.total, harmonic)
        unit = self.record.unit
        self.notes.append(
            f"baseline {with_error(baseline.value + self.free.reading, baseline.error)} {unit} was subtracted"
        )
        if np.isfinite(baseline.rest):
            self.notes.append(
                f"the motion came to rest {baseline.rest:.3g} {unit} off the mid-line of its last cycles (dry "
                f"friction, or "
                "the sensor's zero drifts): the mid-line was taken as zero"
            )
        return baseline

    def _second_mode(self, values: FloatArray, path: Track) -> SecondMode | None:
        """Return a second mode, with a warning that names it."""
        second = find_second_mode(values, self.rate, path)
        if second is not None:
            low, high = second.suggested_band(path.frequency)
            self.notes.append(
                f"warning: a second mode at {second.frequency:.4g} Hz has {second.share:.0%} of the spectral "
                f"peak of the "
                f"mode at {path.frequency:.4g} Hz; pass one of them, for example with `band=({low:.3g}, {high:.3g})`"
            )
        return second

    def _above_floor(self, path: Track, end: float) -> float:
        """Return the end of motion, or the earlier time at which the displacement falls below the floor."""
        if self.floor is None:
            return end
        amplitude = displacement_amplitude(path, self.integrations).amplitude
        below = np.flatnonzero(amplitude < self.floor)
        if not below.size or path.time[below[0]] >= end:
            return end
        at = max(int(below[0]), 1)
        unit = self.record.unit.partition("/")[0]
        if path.until(float(path.time[at])).cycles < MINIMUM_CYCLES or not amplitude[0] > self.floor:
            raise InputError(
                f"{self.name}: fewer than {MINIMUM_CYCLES:g} cycles lie above the floor of {self.floor:.4g} {unit}, "
                f"the first amplitude is {amplitude[0]:.4g} {unit}; give a lower `floor`."
            )
        self.notes.append(f"what is below an amplitude of {self.floor:.4g} {unit} was left out")
        return float(path.time[at])

    def _range(self, path: Track, is_cut: bool, end: float, size: int) -> tuple[int, int]:
        """Return the samples from a quarter of a cycle before the first turning point to the end of motion."""
        cycle = 1.0 / path.frequency
        lost = 0 if self.free.decimation is None else self.free.decimation.half // self.free.decimation.factor
        first = max(0, self._undisturbed(path, -lost / self.rate) - lost) if is_cut else 0
        last = min(size, int(np.ceil((end + self.cycles_after * cycle) * self.rate)) + 1)
        if size - last > cycle * self.rate:
            self.notes.append(f"the last {(size - last) / self.rate:.4g} s, after the end of motion, were dropped")
        return first, last

    def _undisturbed(self, path: Track, release: float) -> int:
        """Return how many samples after a release lies a quarter of a cycle before the first turning point."""
        cycle = 1.0 / path.frequency
        shift = 0.5 * np.pi if self.record.quantity == "velocity" else 0.0
        least = _STRUCK if self.free.is_struck else _LET_GO
        phase = float(path.phase_at(np.array([release + least * cycle]))[0]) - shift
        turning = float(path.time_at(np.array([np.pi * np.ceil(phase / np.pi) + shift]))[0])
        return max(0, int(np.floor((turning - 0.25 * cycle - release) * self.rate)))

    def _measured(
        self,
        before: int,
        is_cut: bool,
        kept: tuple[int, int],
        path: Track,
        spectrum: NoiseSpectrum,
        band_pass: BandPass | None,
        wander: Wander | None,
    ) -> MeasuredSamples:
        """Return the samples as they were; ``before`` of them precede those that were passed."""
        first, last = kept
        if band_pass is not None:
            # a passed sample stems from those around it: none of them may be driven, or touched by hand or hammer
            is_driven = before > band_pass.half
            last = min(self.free.values.size, last + before + band_pass.half)
            first = self._undisturbed(path, -before / self.rate) if is_cut else 0
            rest = (last - before - 2 * band_pass.half) * path.frequency / self.rate
            if is_driven:
                first = before if rest > _FEWEST_CYCLES else before - band_pass.half
        begin = self.begin + (first - before if band_pass is not None else first) / self.rate
        noise = noise_of(spectrum, self._kept, path.frequency, self.rate)
        return MeasuredSamples(
            time=_frozen(begin + np.arange(last - first) / self.rate),
            values=_frozen(np.array(self.free.values[first:last])),
            autocovariance=_frozen(noise.autocovariance),
            order=self.integrations,
            band_pass=band_pass,
            wander=wander,
        )

    def _displacement(self, values: FloatArray, path: Track) -> FloatArray:
        """Integrate as often as the measured quantity asks for."""
        result = np.array(values)
        for _ in range(self.integrations):
            result = integrate(result, self.rate, path)
        if self.integrations:
            times = "once" if self.integrations == 1 else "twice"
            self.notes.append(f"{self.record.quantity} was integrated {times}; no cycle was lost")
        return result

    def _mid_line(
        self, values: FloatArray, path: Track, second: SecondMode | None, *, is_filtered: bool
    ) -> MidLine | None:
        """Return the mid-line where it is known, and say what was done about it."""
        if is_filtered:
            second = find_second_mode(values, self.rate, path)
        is_mode = second is not None and abs(second.frequency / path.frequency - 2.0) < 0.1
        found, note = find_mid_line(
            values, self.rate, path, self.integrations, is_filtered=is_filtered, is_mode=is_mode
        )  # fmt: skip
        self.notes.append(note)
        return found

    def _response(self, band_pass: BandPass | None, frequency: float) -> Callable[[FloatArray], FloatArray]:
        """Return the amplitude response from the measured quantity to the displacement."""

        def response(grid: FloatArray) -> FloatArray:
            kept = self._kept(grid)
            kept = kept * (integration_response(grid / frequency) / (2.0 * np.pi * grid)) ** self.integrations
            return kept if band_pass is None else kept * np.abs(band_pass.gain(grid))

        return response


def _frozen(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values
