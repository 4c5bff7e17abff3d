"""The part of a record in which a structure moves freely: even in time, without spikes, as many samples as it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..._common.checks import FloatArray, InputError, check_finite_array
from ..._common.text import printable
from ..reading.record import MINIMUM_SAMPLES, QUANTITIES, Record
from ..rough_turning import rough_noise
from .blow import is_struck
from .clipping import Clipping, find_clipping
from .decimation import Decimation, design_decimation
from .filters import check_band
from .gap_filling import filled
from .hum import without_hum
from .lift import end_of_lift
from .lost_samples import MOST, Jump, find_jump, mended, repeats
from .noise import quantum
from .plausibility import check_moves, check_per_cycle
from .release import end_of_drive, end_of_rest, leading_rest
from .second_release import earlier_decay
from .spikes import WIDEST, without_spikes
from .stuck import constant_tail, held_between, is_stuck
from .time_grid import to_uniform
from .tracking import dominant_frequency

_MOST_PLACES = 5
_MOST_HELD = 0.1  # of a record, that is left out where a value is held: of more, nothing is known
_SLOWER = 2.0  # frequency of the longest part over that of the whole record, from which missing samples make the latter
_BEYOND_CLIPPING = 8.0  # cycles that have to follow peaks that are cut off
_JUMP = 3  # widest spikes after a release within which what stands out is its jump behind a filter against aliases


class FreePart:
    """The free part of a record, in the measured quantity, found step by step as it is made.

    Attributes
    ----------
    record : Record
        What it is a part of.
    name : str
        The file, safe to print.
    integrations : int
        How often the measured quantity has to be integrated to give displacement.
    step : float
        Of the digitiser [measured quantity]; 0 where none is seen.
    reading : float
        Of the sensor, subtracted from all values [measured quantity].
    samples : UniformSamples
        The chosen part of the record, even in time.
    whole : (m,) array
        Its values without spikes and hum.
    band : (float, float) or None
        Checked edges of the band [Hz].
    frequency : float
        Of the dominant motion, in the band where one is given [Hz].
    searches : bool
        Whether the release is to be found.
    is_cut : bool
        Whether something before the release was left out.
    is_struck : bool
        Whether that was rest in equilibrium: a hammer or a hand may act on the first swing.
    decimation : Decimation or None
        What left samples out.
    values : (n,) array
        The free part.
    begin : float
        Its first instant on the record's clock [s].
    rate : float
        Its sampling rate [Hz].
    notes : list of str
        What was done, in the order of doing.
    """

    frequency: float
    rate: float
    whole: FloatArray

    def __init__(
        self, record: Record, band: tuple[float, float] | None, start: float | None, stop: float | None
    ) -> None:
        if not isinstance(record, Record):
            raise InputError(f"`record` must be a Record, got {type(record).__name__}; see `read_records`.")
        self.record = record
        self.name = printable(record.source)
        if record.is_envelope:
            raise InputError(
                f"{self.name}: is an envelope, which has no waveform to condition; give it to `envelope_cycles`."
            )
        self.integrations = QUANTITIES.index(record.quantity)
        while (clipped := self._prepare(start, stop, band)) is not None:
            start = self._beyond(clipped)
        self.whole = filled(self.whole, self.samples.missing, self.rate / self.frequency)
        self.whole, hum = without_hum(self.whole, self.rate, self.frequency)
        self.notes += [] if hum is None else [hum.note]
        self.searches = start is None and not record.starts_free
        self.decimation: Decimation | None = None
        self.is_struck = False
        self.values, self.is_cut = self._released(self.whole)
        self.values, is_lifted = self._let_go(self.values)
        self.is_cut |= is_lifted
        self._note_spikes()
        self.values = self._clocked(self._decimated(self.values))

    def _prepare(self, start: float | None, stop: float | None, band: tuple[float, float] | None) -> Clipping | None:
        """Find what is even in time between two instants, without spikes, and its frequency; return clipped peaks."""
        self.notes = list(self.record.notes)
        keep = self._chosen(start, stop)
        time, values = self.record.time[keep], self.record.values[keep]
        check_moves(values, self.name)
        self.step = quantum(values)
        # a sensor may read ten thousand times the motion: no filter stops that much
        self.reading = float(np.median(values))
        values = values - self.reading
        time, values = self._without_repeats(time, values)
        time, values = self._without_held(time, values)
        self.samples = to_uniform(time, values, self.name)
        self.notes += self.samples.notes
        self.whole, self._spikes = without_spikes(self.samples.values, self.step)
        check_moves(self.whole, self.name)
        self.begin, self.rate = self.samples.start, self.samples.sampling_rate
        self.band = None if band is None else check_band(band, self.rate, self.name)
        self.frequency = self._dominant()
        return find_clipping(values, self.reading, time, self.frequency, self.step)

    def _beyond(self, clipped: Clipping) -> float:
        """Return the instant from which no peak is clipped, or raise where few cycles follow it."""
        span = self.samples.start + self.whole.size / self.rate - clipped.free
        if span * self.frequency < _BEYOND_CLIPPING:
            raise InputError(
                f"{self.name}: {clipped}; widen the range: only {max(span * self.frequency, 0.0):.2g} cycles follow, "
                f"expected at least {_BEYOND_CLIPPING:g}."
            )
        self.record = replace(
            self.record,
            notes=(
                *self.record.notes,
                f"warning: {clipped}; the record is used from {clipped.free:.6g} s on, where none is; larger "
                "amplitudes need a wider range",
            ),
        )
        return clipped.free

    def _chosen(self, start: float | None, stop: float | None) -> NDArray[np.bool_]:
        """Return which samples lie between ``start`` and ``stop``."""
        time = self.record.time
        keep = np.ones(time.size, dtype=bool)
        # the limits may be stamps of a grid that is known to a millionth of a sample only
        slack = 1e-3 * float(np.median(np.diff(time)))
        if start is not None:
            keep &= time >= float(check_finite_array("start", start, ndim=0)) - slack
        if stop is not None:
            keep &= time <= float(check_finite_array("stop", stop, ndim=0)) + slack
        if np.count_nonzero(keep) < MINIMUM_SAMPLES:
            raise InputError(
                f"{self.name}: {np.count_nonzero(keep)} samples lie between `start` and `stop`, expected at least "
                f"{MINIMUM_SAMPLES} of the record from {time[0]:.6g} to {time[-1]:.6g} s; choose other limits."
            )
        return keep

    def _dominant(self) -> float:
        """Return the frequency of the dominant mode (within the band), after the checks that need it."""
        uniform = self.whole
        lead = leading_rest(uniform)
        free = uniform[lead:] if uniform.size - lead >= MINIMUM_SAMPLES else uniform
        frequency = dominant_frequency(free, self.rate, self.band)
        if frequency is None and self.band is not None:
            other = dominant_frequency(free, self.rate)
            hint = f"the dominant motion is at {other:.4g} Hz" if other else "nothing oscillates outside it either"
            raise InputError(
                f"{self.name}: nothing oscillates between {self.band[0]:g} and {self.band[1]:g} Hz; {hint}, "
                "choose the band around a mode."
            )
        if frequency is None:
            self._check_gaps(0.0)
            raise InputError(f"{self.name}: no oscillation stands out of the record; check the column, or give a band.")
        self._check_gaps(frequency)
        check_per_cycle(self.rate, frequency, self.name)
        return frequency

    def _check_gaps(self, found: float) -> None:
        """Raise `InputError` where samples are missing for longer than the motion allows: what fills them hides it.

        The frequency that was ``found`` is then none, or that of what fills them, far below that of the longest part.
        """
        gaps, rate = self.samples.gaps, self.rate
        if not gaps.size:
            return
        ends = np.array([*(gaps[:, 0] - self.samples.start), self.whole.size / rate])
        begins = np.array([0.0, *(gaps.sum(axis=1) - self.samples.start)])
        longest = int(np.argmax(ends - begins))
        part = self.whole[round(begins[longest] * rate) : round(ends[longest] * rate)]
        frequency = dominant_frequency(part, rate, self.band) if part.size >= MINIMUM_SAMPLES else None
        if frequency is not None and frequency > _SLOWER * found:
            self.samples.check_gaps(frequency, np.inf, self.name)

    def _released(self, values: FloatArray) -> tuple[FloatArray, bool]:
        """Return the values from the release on, and whether anything before it was cut."""
        if not self.searches:
            return values, False
        # at rest nothing moves, whatever the mode: judged by the record's own dominant motion
        lead = leading_rest(values)
        whole = dominant_frequency(values[lead:], self.rate) if values.size - lead >= MINIMUM_SAMPLES else None
        index = end_of_rest(values, self.rate, whole or self.frequency)
        if index is not None:
            self.is_struck = is_struck(self.samples.values, index, self.rate, self.frequency, self.integrations)
            return self._without(values, index, "at rest"), True
        if (
            self.band is None
            and (index := end_of_drive(values, self.rate, self.frequency, self.integrations)) is not None
        ):
            return self._without(values, index, "driven"), True
        return values, False

    def _let_go(self, values: FloatArray) -> tuple[FloatArray, bool]:
        """Return the values from where a hand let go, and whether a hand was seen."""
        if not self.searches or self.integrations or self.band is not None:
            return values, False
        index = end_of_lift(values, self.rate, self.frequency, rough_noise(values))
        return (values, False) if index is None else (self._without(values, index, "moved by hand"), True)

    def _note_spikes(self) -> None:
        """Say which spikes of the free decay were bridged.

        Where a structure is let go an acceleration jumps: what stands beside that is motion, and is left as it was.
        """
        first = round((self.begin - self.samples.start) * self.rate)
        for spike in self._spikes:
            if spike.first < first:
                continue
            if self.is_cut and spike.first < first + _JUMP * WIDEST:
                there = slice(spike.first - first, spike.first - first + spike.count)
                self.values = self.values.copy()
                self.values[there] = self.samples.values[spike.first : spike.first + spike.count]
                continue
            time = self.samples.start + spike.first / self.samples.sampling_rate
            samples = "1 sample" if spike.count == 1 else f"{spike.count} samples"
            self.notes.append(
                f"warning: a spike of {spike.height:.3g} {self.record.unit} at {time:.6g} s ({samples}) was cut "
                "out and bridged; if it is motion, look at the sensor's cable and range"
            )

    def _without(self, values: FloatArray, index: int, state: str) -> FloatArray:
        """Return the values from an index on and note what is dropped."""
        before, after = values[:index], values[index:]
        later = float(np.max(np.abs(after - np.median(after))))
        decay = earlier_decay(before - np.median(before), self.rate, self.frequency, later, rough_noise(values))
        if decay is None:
            self.notes.append(dropped(index / self.rate, state))
        else:
            begin, end = (round(self.begin + at / self.rate, 9) + 0.0 for at in (decay.first, decay.last))
            self.notes.append(
                f"warning: the record holds two releases: a free decay of {decay.cycles:.0f} cycles, from "
                f"{decay.high:.3g} to {decay.low:.3g} {self.record.unit}, comes before the release at "
                f"{self.begin + index / self.rate:.5g} s, from which on the record is used; for the first one use "
                f"`start={begin:.5g}` and `stop={end:.5g}`"
            )
        self.begin += index / self.rate
        return values[index:]

    def _without_repeats(self, time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the record without samples that were written twice; their places are interpolated later."""
        at = repeats(values, self.step, rough_noise(values))
        if not at.size or time.size - at.size < MINIMUM_SAMPLES:
            return time, values
        self.notes.append(
            f"warning: {_counted(at.size, 'sample')} {'repeats' if at.size == 1 else 'repeat'} the one before while "
            f"the motion goes on ({_places(time[at])}): what was written twice was left out; check the logger or camera"
        )
        return np.delete(time, at), np.delete(values, at)

    def _without_held(self, time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the record without values that were held while the motion went on, at its end or in between."""
        tail = constant_tail(values)
        if time.size - tail < MINIMUM_SAMPLES or not (tail or np.any(np.diff(values) == 0.0)):
            return time, values
        rate = (time.size - 1) / float(time[-1] - time[0])
        moving = values[leading_rest(values) : values.size - tail]
        frequency = dominant_frequency(moving, rate) if moving.size >= MINIMUM_SAMPLES else None
        if frequency is None:
            return time, values
        if tail and is_stuck(values, tail, rate / frequency, self.step):
            self.notes.append(
                f"warning: the last {tail} samples, from {time[-tail]:.6g} s on, hold one value although the motion "
                "had not ended: the sensor or the logger stuck there, or the file was filled up; they were left out"
            )
            time, values = time[:-tail], values[:-tail]
        held = held_between(values, rate / frequency, self.step, rough_noise(values))
        if not 0 < held.size < _MOST_HELD * time.size:
            return time, values
        self.notes.append(
            f"warning: {_counted(held.size, 'sample')} {'holds' if held.size == 1 else 'hold'} one value while the "
            f"motion goes on ({_places(time[held])}): what the sensor or the logger lost there was left out"
        )
        return np.delete(time, held), np.delete(values, held)

    def _clocked(self, values: FloatArray) -> FloatArray:
        """Return the values with samples put in, or taken out, where the motion shows that the clock jumped."""
        interval = 1.0 / self.samples.sampling_rate
        jumps: list[tuple[float, Jump]] = []
        while (jump := find_jump(values, self.rate, self.frequency, interval)) is not None:
            if len(jumps) == MOST:
                self.notes.append(
                    f"warning: the clock jumps by whole samples at more than {MOST} places: nothing that this record "
                    "says of frequency is to be believed; check the logger"
                )
                return values
            jumps.append((self.begin + jump.index / self.rate, jump))
            values = mended(values, jump, jump.count * interval * self.rate)
        for is_missing in (True, False):
            found = sorted((time, abs(jump.count)) for time, jump in jumps if (jump.count > 0) == is_missing)
            if not found:
                continue
            total = sum(count for _, count in found)
            state = "missing" if is_missing else "too many"
            self.notes.append(
                f"warning: {_counted(total, 'sample')} {'is' if total == 1 else 'are'} {state} without a trace in the "
                f"times ({_places([time for time, _ in found])}): the cycles step there by whole samples; "
                f"{'put in by interpolation' if is_missing else 'taken out'}; check the logger"
            )
        return values

    def _decimated(self, values: FloatArray) -> FloatArray:
        """Return fewer samples of a long record, as many as the motion needs."""
        # a band may reach beyond what the mode alone needs
        highest = self.frequency if self.band is None else max(self.frequency, self.band[1] / 8.0)
        decimation = design_decimation(values.size, self.rate, highest)
        if decimation is None:
            return values
        kept = decimation.apply(values)
        self.decimation = decimation
        self.begin += decimation.half / self.rate
        self.rate /= decimation.factor
        # rounding spreads its variance over all frequencies, of which fewer are left
        self.step /= np.sqrt(decimation.factor)
        self.notes.append(
            f"of {values.size} samples every {decimation.factor}th was kept after a low-pass without phase shift: "
            f"{self.rate / self.frequency:.0f} per cycle, frequencies up to {0.25 * self.rate:.4g} Hz are untouched"
        )
        return kept


def _counted(number: int, what: str) -> str:
    return f"1 {what}" if number == 1 else f"{number} {what}s"


def _places(times: Sequence[float] | FloatArray) -> str:
    """Return the first few of the times at which something is amiss, as words."""
    first = ", ".join(f"{time:.6g}" for time in times[:_MOST_PLACES])
    rest = len(times) - _MOST_PLACES
    return f"at {first}{f' and {rest} more' if rest > 0 else ''} s"


def dropped(duration: float, state: str) -> str:
    """Return the sentence on a beginning of so many seconds that is not free."""
    return f"the first {duration:.4g} s, {state} before the free decay, were dropped"
