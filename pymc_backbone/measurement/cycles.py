"""Cycles of a measured free decay: turning points with their covariance, then amplitude, frequency, damping, offset.

Around each turning point the samples of about one cycle are fitted by ``p - s a (1 - cos u) + template(u)``: its
time, value and scale are free,
its shape (decay, harmonics, the corner friction leaves) is a template that all turning points share as a polynomial
in amplitude.
The template costs next to no variance because all cycles determine it, and it leaves next to no bias.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._common.checks import BoolArray, FloatArray, InputError, check_finite_array
from .._common.threads import with_one_thread
from .cycle_data import MINIMUM_CYCLES, Cycles, with_shared_errors
from .peak_noise import with_peak_noise
from .rough_turning import rough_noise, rough_turning_points, running_line
from .smoothed_amplitude import amplitude_from_damping
from .smoothing import smooth
from .template import FLOOR, Fit, fit_with_template
from .turning import cycle_covariance, turning_covariance
from .wandering_zero import mind_wandering_zero


def extract_cycles(record: Any, *, noise: float | ArrayLike | None = None) -> Cycles:
    """Extract the cycles of a conditioned record.

    Parameters
    ----------
    record : ConditionedRecord
        Anything with ``specimen``, ``time``, ``displacement`` and, where known, ``noise`` (standard deviation),
        ``noise_autocovariance`` and ``notes``.
    noise : float or (lags,) array, optional
        Overrides the record's noise: a standard deviation, or the autocovariance at lags 0, 1, ... samples.

    Returns
    -------
    Cycles
        The cycles above the noise floor.

    See Also
    --------
    condition : what makes a record ready.
    backbones_at_levels : what follows.
    """
    if noise is None:
        noise = getattr(record, "noise_autocovariance", None)
    if noise is None:
        noise = getattr(record, "noise", None)
    cycles = extract_cycles_from_arrays(
        record.time,
        record.displacement,
        noise=noise,
        specimen=str(getattr(record, "specimen", "specimen")),
        notes=tuple(getattr(record, "notes", ())),
        zero_error=float(getattr(record, "baseline_error", 0.0)),
    )
    error, shape = (float(getattr(record, name, 0.0)) for name in ("mid_line_error", "mid_line_shape_error"))
    cycles = _with_mid_line_errors(cycles, error, shape)
    measured = getattr(record, "measured", None)
    return cycles if measured is None else mind_wandering_zero(cycles, measured)


@with_one_thread
def extract_cycles_from_arrays(
    time: ArrayLike,
    displacement: ArrayLike,
    *,
    noise: float | ArrayLike | None = None,
    specimen: str = "specimen",
    notes: tuple[str, ...] = (),
    zero_error: float = 0.0,
) -> Cycles:
    """Extract the cycles of a uniformly sampled free decay.

    Parameters
    ----------
    time : (n,) array
        Seconds, uniform, beginning at or after the release.
    displacement : (n,) array
        Metres (or radians).
    noise : float or (lags,) array, optional
        Standard deviation of white noise, or autocovariance at lags 0, 1, ... samples; by default white noise
        estimated from the residuals.
    specimen : str, default "specimen"
        Name carried along.
    notes : tuple of str, optional
        Sentences carried along.
    zero_error : float, default 0
        Standard error of the zero of ``displacement`` [m or rad]: the offsets of all cycles share it, in proportion to
        one over amplitude.

    Returns
    -------
    Cycles
        The cycles above the noise floor.

    Raises
    ------
    InputError
        When time is not uniform, or fewer than four cycles stand above the noise.
    """
    t = check_finite_array("time", time, minimum_size=16)
    x = check_finite_array("displacement", displacement, minimum_size=16)
    if t.size != x.size:
        raise InputError(f"`displacement` must be as long as `time` ({t.size}), got {x.size} values for {specimen!r}.")
    step = (t[-1] - t[0]) / (t.size - 1)
    uneven = np.max(np.abs(np.diff(t) - step)) if step > 0.0 else np.inf
    if not uneven < 0.01 * step:
        raise InputError(
            f"`time` of {specimen!r} must be increasing and uniform within 1 % of a sample; resample the record first."
        )
    autocovariance = _autocovariance(noise)
    spread = float(np.std(x))
    if not spread > 0.0:
        raise InputError(f"`displacement` of {specimen!r} must move, got a constant; check the column.")
    guess_noise = rough_noise(x)
    if autocovariance is not None:
        guess_noise = max(guess_noise, float(np.sqrt(autocovariance[0])))
    cycles = _extract(t, x, step, autocovariance, guess_noise, specimen, list(notes))
    if zero_error == 0.0:
        return cycles
    return with_shared_errors(cycles, "offset", -zero_error / cycles.smoothed_amplitude[:, None])


def _with_mid_line_errors(cycles: Cycles, error: float, shape: float) -> Cycles:
    """Return the cycles with what is not known of a mid-line, over amplitude at the first cycle: its size and its law.

    Damping holds the rate of change of either. ``shape`` is zero where the mid-line is not measured, which the offsets
    are not then. Between a mid-line in proportion to the amplitude and one to its square lies what vanishes at the
    largest amplitude, and a spring that hardens bends it there.
    """
    share = cycles.smoothed_amplitude / cycles.smoothed_amplitude[0]
    if error:
        cycles = with_shared_errors(cycles, "damping", (2.0 * error * cycles.damping * share)[:, None])
    if shape:
        of_offset = np.column_stack([error * share, shape * (1.0 - share), shape * share**2])
        bent = np.column_stack([1.0 - 2.0 * share, 3.0 * share**2])
        cycles = with_shared_errors(cycles, "offset", of_offset)
        cycles = with_shared_errors(cycles, "damping", shape * cycles.damping[:, None] * bent)
    return cycles


def _autocovariance(noise: float | ArrayLike | None) -> FloatArray | None:
    if noise is None:
        return None
    array = np.atleast_1d(np.asarray(noise, dtype=np.float64))
    if array.ndim != 1 or not np.all(np.isfinite(array)) or not (array[0] >= 0.0):
        raise InputError(
            "`noise` must be a standard deviation or an autocovariance starting at lag 0, got something else."
        )
    if array[0] == 0.0:
        return None
    return array**2 if array.size == 1 else array


def _extract(
    t: FloatArray,
    x: FloatArray,
    step: float,
    autocovariance: FloatArray | None,
    guess_noise: float,
    specimen: str,
    notes: list[str],
) -> Cycles:
    places, signs, period = rough_turning_points(x, step, guess_noise)
    if places.size < 2 * MINIMUM_CYCLES + 1:
        raise InputError(
            f"the record of {specimen!r} must hold at least four cycles above its noise, got {places.size} turning "
            "points; release it from a larger amplitude, band-pass it, or record longer."
        )
    guess = t[0] + places * step
    # the highest harmonic stays well below half the sampling rate
    harmonics = int(np.clip(np.floor(0.5 * period / step - 1.9), 2, 5))
    fit, signs, periods, factor = fit_with_template(x, t[0], step, guess, signs, harmonics, guess_noise, autocovariance)
    # noise from what the fits leave
    freedom = np.maximum(fit.count - 3.0, 0.5)
    residual_variance = float(fit.misfit.sum() / freedom.sum())
    if autocovariance is None:
        autocovariance = np.array([residual_variance])
    elif residual_variance > 1.3 * autocovariance[0]:
        notes.append(
            f"{specimen}: what the local fits leave is {np.sqrt(residual_variance / autocovariance[0]):.2f} times "
            "the given noise; "
            "standard errors are widened where it happens"
        )
    inflation = _inflation(fit, autocovariance[0])
    lags = autocovariance.size
    n_bands = int(min(3 + np.ceil(lags * step / (0.5 * np.min(periods))), 13))
    influence = fit.influence * inflation[:, None, None]
    covariance = turning_covariance(influence, fit.first, fit.count, autocovariance, n_bands)
    covariance, own = with_peak_noise(fit.values, signs, covariance)
    if own is not None:
        notes.append(
            f"{specimen}: the turning points scatter by {own[0]:.2g} more than the samples say, correlated by "
            f"{own[1]:g} from one to the next: their standard errors hold it"
        )
    # the white noise that would disturb the turning values as much
    white = float(covariance[:, 0, 1, 1].sum() / (influence[:, :, 1] ** 2).sum())
    factor = factor * np.sqrt(max(white, 0.0))
    return _assemble(fit, signs, covariance, factor, float(np.sqrt(autocovariance[0])), specimen, notes)


def _inflation(fit: Fit, variance: float) -> FloatArray:
    """Return the factor on standard errors where local residuals exceed the noise (running over 15 windows)."""
    kernel = np.ones(min(15, fit.misfit.size))  # a longer one would lengthen the result
    excess = np.convolve(fit.misfit, kernel, mode="same")
    freedom = np.convolve(np.maximum(fit.count - 3.0, 0.5), kernel, mode="same")
    prior = 30.0
    ratio = (prior + excess / variance) / (prior + freedom)
    # sampling scatter of the ratio itself is no evidence
    limit = 1.0 + 2.0 * np.sqrt(2.0 / (prior + freedom))
    return np.sqrt(np.where(ratio > limit, ratio, 1.0))


def _end_of_motion(is_above: BoolArray) -> tuple[int, int]:
    """Return after how many cycles those end that stand above their errors, and how many these are.

    Errors are large at the edge of a record where a sensor settles, too: what comes later is not lost by that.
    """
    first = int(np.argmax(is_above))
    below = np.flatnonzero(~is_above[first:])
    end = first + (int(below[0]) if below.size else is_above.size - first)
    return end, end - first


def _assemble(
    fit: Fit,
    signs: FloatArray,
    turning: FloatArray,
    factor: FloatArray,
    noise: float,
    specimen: str,
    notes: list[str],
) -> Cycles:
    shift = 0 if signs[0] > 0 else 1
    n = (fit.times.size - shift - 1) // 2
    if n < MINIMUM_CYCLES:
        raise InputError(
            f"the record of {specimen!r} must hold at least four cycles above its noise, got {n}; record longer."
        )
    at = shift + 2 * np.arange(n)
    t0, t1, p0, q, p1 = fit.times[at], fit.times[at + 2], fit.values[at], fit.values[at + 1], fit.values[at + 2]
    amplitude = (p0 + p1 - 2.0 * q) / 4.0
    crossed = np.flatnonzero((p0 - q <= 0.0) | (p1 - q <= 0.0))
    if crossed.size:
        if crossed[0] < MINIMUM_CYCLES:
            raise InputError(
                f"the turning points of {specimen!r} must alternate for four cycles; band-pass the record."
            )
        n = int(crossed[0])
        t0, t1, p0, q, p1, amplitude = t0[:n], t1[:n], p0[:n], q[:n], p1[:n], amplitude[:n]
    period = t1 - t0
    damping = 2.0 * np.log((p0 - q) / (p1 - q))
    middle = ((p0 + p1) / 2.0 + q) / 2.0

    gradients = np.zeros((4, n, 3, 2))
    gradients[0, :, :, 1] = np.array([0.25, -0.5, 0.25])
    bands_of = 1 + (turning.shape[1] + 1) // 2
    amplitude_bands = cycle_covariance(gradients[:1], turning, shift, bands_of)[0]
    index = np.arange(n, dtype=np.float64)
    positive = np.maximum(amplitude, 1e-3 * amplitude.max())
    curve = smooth([index], positive, amplitude_bands, [index], orders=(2, 3), kinks=True)
    smoothed = np.maximum(curve.value, 1e-3 * amplitude.max())
    end, held = _end_of_motion(smoothed >= FLOOR * np.sqrt(amplitude_bands[0]))
    if end < n:
        notes.append(f"{specimen}: {n - end} cycle(s) below the noise floor dropped")
    if held < MINIMUM_CYCLES:
        raise InputError(
            f"the record of {specimen!r} must hold at least four cycles above its noise, got {held}; reduce the noise."
        )

    # derivatives at smoothed values: weights that follow the noise would bias the level values
    decrement = np.clip(-np.gradient(np.log(smoothed), index), -1.0, 2.0)
    r0, r1 = 2.0 * smoothed * np.exp(decrement / 4.0), 2.0 * smoothed * np.exp(-decrement / 4.0)
    f = 1.0 / np.clip(running_line(period, 4), 0.5 * np.median(period), 2.0 * np.median(period))
    gradients[1, :, 0, 0], gradients[1, :, 2, 0] = f**2, -(f**2)
    gradients[2, :, 0, 1], gradients[2, :, 1, 1], gradients[2, :, 2, 1] = 2 / r0, -2 / r0 + 2 / r1, -2 / r1
    ratio = np.clip(running_line(middle / smoothed, 4), -2.0, 2.0)
    gradients[3, :, 0, 1] = (0.25 - 0.25 * ratio) / smoothed
    gradients[3, :, 1, 1] = (0.5 + 0.5 * ratio) / smoothed
    gradients[3, :, 2, 1] = (0.25 - 0.25 * ratio) / smoothed
    bands = cycle_covariance(gradients, turning, shift, bands_of)
    # second order: E[1/T] exceeds 1/E[T]; E[ln R] falls short of ln E[R]
    frequency = (1.0 - bands[1, 0] * period**2) / period
    smoothed, design, spread = amplitude_from_damping(positive, amplitude_bands, damping, bands[2], smoothed, end)
    swing = np.zeros((2, n, 3, 2))
    swing[0, :, 0, 1], swing[0, :, 1, 1], swing[1, :, 1, 1], swing[1, :, 2, 1] = 1.0, -1.0, -1.0, 1.0
    swing_variance = cycle_covariance(swing, turning, shift, 1)[:, 0]
    damping = damping + swing_variance[0] / r0**2 - swing_variance[1] / r1**2
    bands = bands[:, :, :end].copy()
    for b in range(1, bands.shape[1]):
        bands[:, b, max(end - b, 0) :] = 0.0
    shared = np.zeros((4, end, factor.shape[2]))
    for place in range(3):
        rows = factor[shift + 2 * np.arange(end) + place]
        shared += np.einsum("qnc,ncr->qnr", gradients[:, :end, place], rows)
    errors = np.sqrt(bands[:, 0] + (shared**2).sum(axis=2))
    turning_errors = np.sqrt(np.maximum(np.diagonal(turning[:, 0], axis1=1, axis2=2), 0.0))
    return Cycles(
        specimen=specimen,
        time=((t0 + t1) / 2.0)[:end],
        amplitude=amplitude[:end],
        frequency=frequency[:end],
        damping=damping[:end],
        offset=(middle / amplitude)[:end],
        amplitude_error=errors[0],
        frequency_error=errors[1],
        damping_error=errors[2],
        offset_error=errors[3],
        bands=bands,
        shared=shared,
        smoothed_amplitude=smoothed,
        smoothed_amplitude_design=design,
        smoothed_amplitude_spread=spread,
        turning_times=fit.times,
        turning_values=fit.values,
        turning_time_errors=turning_errors[:, 0],
        turning_value_errors=turning_errors[:, 1],
        turning_signs=signs,
        noise=noise,
        notes=tuple(notes),
    )
