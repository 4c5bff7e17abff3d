"""The shape of a record around its turning points: one template for all, found with their times and values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._common.checks import BoolArray, FloatArray, InputError, IntArray
from . import turning
from .rough_turning import running_line

REACH = 0.75 * np.pi
"""Half width of the window of a turning point, in radians of the cycle. Wider ones reach the next turning point, where
friction changes sign: pi lowers the standard errors by 3 % and doubles the bias at 60 dB."""
OVERLAP = 2.0 * REACH / np.pi
"""How often a sample is seen: by the window of a peak and of a trough."""
POWERS = 4
"""The template's coefficients are polynomials in amplitude with this many terms, friction's constant first, ..."""
CORNERS = np.array([0.15, 0.3, 0.45, 0.6, 0.75])
"""... and corners at these shares of the largest amplitude, for gaps and slip."""
SELECTION = 10.0
"""A template term enters when it lowers chi-square by more than this (every sample is seen twice)."""
FLOOR = 8.0
"""Cycles whose amplitude is below this many standard errors are dropped."""


@dataclass
class Fit:
    """What `turning.fit_windows` returns, by name."""

    times: FloatArray
    values: FloatArray
    scales: FloatArray
    misfit: FloatArray
    first: IntArray
    count: IntArray
    influence: FloatArray
    gram: FloatArray
    projection: FloatArray
    response: FloatArray
    good: BoolArray


def _local_scales(fit_times: FloatArray, fit_values: FloatArray, signs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return smoothed periods and amplitudes at the turning points."""
    gaps = np.diff(fit_times)
    periods = np.empty(fit_times.size)
    periods[1:-1] = gaps[:-1] + gaps[1:]
    periods[0], periods[-1] = 2.0 * gaps[0], 2.0 * gaps[-1]
    if fit_times.size > 4:
        periods[0], periods[-1] = periods[1], periods[-2]
    signed = fit_values * signs
    swings = signed[:-1] + signed[1:]
    halves = np.empty(fit_times.size)
    halves[1:-1] = (swings[:-1] + swings[1:]) / 4.0
    halves[0] = swings[0] / 2.0 + 0.25 * (swings[0] - swings[1])
    halves[-1] = max(swings[-1] / 2.0 - 0.25 * (swings[-2] - swings[-1]), 0.25 * swings[-1])
    return running_line(periods, 4), np.maximum(running_line(halves, 2), 1e-3 * halves.max())


def fit_with_template(
    x: FloatArray,
    start: float,
    step: float,
    guess: FloatArray,
    signs: FloatArray,
    harmonics: int,
    noise: float,
    autocovariance: FloatArray | None = None,
) -> tuple[Fit, FloatArray, FloatArray, FloatArray]:
    """Fit all turning points and the template they share, in turns.

    The template is selected from shape functions times powers of amplitude by what is left in all windows together,
    so it costs next to no variance; four passes refresh the local period and amplitude too, the rest let template and
    turning points settle.

    Returns
    -------
    tuple
        `Fit`; signs of the turning points kept; local periods [s]; covariance factor of the template's error.
    """
    n_shape = turning.n_shape_functions(harmonics)
    if autocovariance is None:
        autocovariance = np.array([noise**2])
    values = np.interp(guess, start + step * np.arange(x.size), x)
    periods, amplitudes = _local_scales(guess, values, signs)
    template = np.zeros((guess.size, n_shape))
    coefficients = np.zeros(n_shape * (POWERS + CORNERS.size) * 2)
    inverse = np.zeros((coefficients.size, coefficients.size))
    # asymmetry moves the mid-line, so its doubt must be in the errors even where it is too weak to be selected
    asymmetry = turning.N_FIXED * 2 * (POWERS + CORNERS.size) + POWERS + CORNERS.size
    forced = asymmetry + np.array([1, 2])
    n_pass = 8
    for number in range(n_pass):
        fit = Fit(
            *turning.fit_windows(
                x, start, step, guess, periods, amplitudes, signs, template, harmonics, REACH, 3 if number else 4
            )
        )
        slack = 0.08 * periods
        if number == n_pass - 1:
            # a turning point before the record is a guess; one at its beginning is the release
            slack = step + 3.0 * noise * np.sqrt((fit.influence[:, :, 0] ** 2).sum(axis=1))
        keep = fit.good & (fit.times >= start - slack) & (np.abs(fit.times - guess) < 0.25 * periods)
        keep &= start + step * (x.size - 1) - fit.times >= 0.25 * periods
        if number == 1:
            # what drowned in noise would only disturb the template
            errors = turning.turning_covariance(fit.influence, fit.first, fit.count, autocovariance, 1)[:, 0, 1, 1]
            drowned = np.flatnonzero(running_line(amplitudes, 4) < 0.5 * FLOOR * np.sqrt(errors))
            if drowned.size:
                keep[max(int(drowned[0]), 7) :] = False
        if not keep.all():
            # only a whole run of turning points can be used: cut at the ends
            inside = np.flatnonzero(~keep)
            lo = int(inside[inside < keep.size // 4].max() + 1) if np.any(inside < keep.size // 4) else 0
            rest = inside[inside >= max(lo, keep.size // 4)]
            hi = int(rest.min()) if rest.size else keep.size
            if hi - lo < 5:
                raise InputError(
                    "the record must hold at least three clean cycles; band-pass it or cut what is not a free decay."
                )
            fit = Fit(*(value[lo:hi] for value in vars(fit).values()))
            signs, template, periods, amplitudes = signs[lo:hi], template[lo:hi], periods[lo:hi], amplitudes[lo:hi]
        if number == n_pass - 1:
            break
        guess = fit.times
        powers = _powers(amplitudes, signs)
        # a window cut to a few samples by the end of the record follows the template, it does not shape it
        weights = ((fit.count >= 0.8 * np.median(fit.count)) | (fit.count >= 8)).astype(np.float64)[:, None]
        n_power = powers.shape[1]
        size = n_shape * n_power
        pairs = ((weights * powers)[:, :, None] * powers[:, None, :]).reshape(-1, n_power**2)
        blocks = (pairs.T @ fit.gram.reshape(-1, n_shape**2)).reshape(n_power, n_power, n_shape, n_shape)
        gram = np.ascontiguousarray(blocks.transpose(2, 0, 3, 1)).reshape(size, size)
        right = (fit.projection.T @ (weights * powers)).reshape(size) + gram @ coefficients
        most = int(min(40.0, 2.0 + float((fit.count - 3.0).sum()) / 20.0))
        left = fit.misfit.sum() / np.maximum(fit.count - 3.0, 0.5).sum()
        variance = max(min(left, 4.0 * noise**2), 0.3 * left, 1e-24 * float(np.max(np.abs(x))) ** 2)
        coefficients, inverse = turning.select_terms(gram, right, variance, SELECTION, most, forced)
        template = powers @ coefficients.reshape(n_shape, -1).T
        old = periods, amplitudes
        periods, amplitudes = _local_scales(fit.times, fit.values, signs)
        if number >= 4:
            # the template belongs to the scales it was found with
            periods, amplitudes = old
    return fit, signs, periods, _template_factor(fit, _powers(amplitudes, signs), inverse)


def _template_factor(fit: Fit, powers: FloatArray, inverse: FloatArray) -> FloatArray:
    """Return F (m, 2, r): F F^T is the covariance of all (t, p) by the template's error, for unit noise variance."""
    used = np.flatnonzero(np.diag(inverse) > 0.0)
    if not used.size:
        return np.zeros((fit.times.size, 2, 0))
    term, power = np.divmod(used, powers.shape[1])
    response = fit.response[:, :, term] * powers[:, power][:, None, :]
    values, vectors = np.linalg.eigh(OVERLAP * inverse[np.ix_(used, used)])
    return response @ (vectors * np.sqrt(np.maximum(values, 0.0)))


def _powers(amplitudes: FloatArray, signs: FloatArray) -> FloatArray:
    """Return the template's regressors: powers of amplitude, and the same times the sign for asymmetric forces."""
    relative = amplitudes / amplitudes.max()
    even = np.hstack([relative[:, None] ** np.arange(POWERS), np.maximum(relative[:, None] - CORNERS, 0.0)])
    return np.hstack([even, even * signs[:, None]])
