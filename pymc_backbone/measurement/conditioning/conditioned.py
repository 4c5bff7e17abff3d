"""The record that conditioning hands to everything after it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..._common.checks import FloatArray
from .filters import BandPass
from .wander import Wander


@dataclass(frozen=True, eq=False)
class MeasuredSamples:
    """The samples of one free decay as the sensor gave them: not integrated, not filtered, its offset still in them.

    Attributes
    ----------
    time : (n,) array
        Seconds on the record's own clock, uniform.
    values : (n,) array
        What was measured, but for a constant [unit of the record].
    autocovariance : (m,) array
        Of the noise of ``values`` at lags 0, 1, ... samples [the unit squared], zero beyond the last; m >= 2. Where a
        band was passed it holds within the band.
    order : int
        How often the displacement has been differentiated: 1 for velocity, 2 for acceleration.
    band_pass : BandPass or None
        The filter to compare through, where another mode has to be kept out. Half of its length is lost at either end.
    wander : Wander or None
        Noise slower than the motion, which ``autocovariance`` does not hold; None where it was not looked for.
    """

    time: FloatArray
    values: FloatArray
    autocovariance: FloatArray
    order: int
    band_pass: BandPass | None
    wander: Wander | None = None

    @property
    def slow_noise(self) -> Wander | None:
        """The wandering zero where it is worth being counted."""
        return self.wander if self.wander is not None and self.wander.is_possible else None


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
        Autocovariance [``unit`` squared] of the actual noise at lags 0, 1, ... samples, zero beyond the last; m >= 2.
    baseline, baseline_error : float
        Sensor reading at equilibrium that was subtracted, and its standard error [``unit``]; zero where a filter
        removed it.
    rest_offset : float
        Where the motion came to rest (dry friction) relative to equilibrium; NaN where the record does not show one.
    offset_is_measured : bool
        Whether the mid-line of the displacement is that of the structure. Integration and band-pass remove it; for
        velocity it is restored where it is significant.
    mid_line_error : float
        Standard error of a mid-line that was restored, or implied by the second harmonic, over amplitude at the first
        cycle; damping has twice that, in proportion to amplitude.
    mid_line_shape_error : float
        Standard error of a restored mid-line over amplitude, at small amplitudes: what is not known of its law.
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
    end_of_motion : float
        Time [s] at which the amplitude drowns in the noise or the motion stops; the record's last time where it
        does neither.
    second_mode_frequency, second_mode_share : float
        Highest peak of another mode [Hz] and its height over that of the dominant one; NaN where there is none.
    source : str
        File, for messages.
    measured : MeasuredSamples
        The samples as they were. They all lie after the release, behind what a hand or a hammer may have disturbed, and
        cover the same motion as ``displacement``; with a band, that from which the passed samples stem.
    notes : tuple of str
        What was assumed and done, one sentence each; warnings begin with ``warning:``.
    is_cut : bool
        Whether something before the free motion was left out, and a quarter of a cycle or more of it with that.
    grows_again : bool
        Whether the amplitude grows again after what is used: another release, or modes that beat.

    See Also
    --------
    condition : makes it.
    extract_cycles : reads cycles from it.
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
    end_of_motion: float
    second_mode_frequency: float
    second_mode_share: float
    source: str
    measured: MeasuredSamples
    notes: tuple[str, ...] = field(default=())
    mid_line_error: float = 0.0
    mid_line_shape_error: float = 0.0
    is_cut: bool = False
    grows_again: bool = False
