"""Backbones at levels, from the cycles of measured specimens."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .._common.backbone_dataset import FREQUENCY, backbone_dataset
from .._common.checks import (
    OBSERVABLES,
    FloatArray,
    InputError,
    check_levels,
    check_observables,
)
from .cycle_data import QUANTITIES, Cycles
from .smoothed_amplitude import abscissas
from .smoothing import smooth

DEFAULT_LEVELS = 10
"""Levels chosen by default, fewer when a decay has fewer than two cycles per level."""

_USUAL = ("frequency", "damping")
UNDERSMOOTHING = {"frequency": 30.0, "damping": 4.0, "offset": 4.0}
"""Freedom to bend beyond what the likelihood asks for. Frequencies are so precise that the bias of a curve as smooth as
is likeliest shows there first; a third more standard error removes a third of it."""


def default_levels(cycles: Sequence[Cycles], n_levels: int | None = None) -> FloatArray:
    """Choose log-spaced levels inside the amplitudes that (nearly) all specimens reach.

    The range is the one all specimens share, their first cycles aside: the release disturbs them, and their
    first peak is known from one side only. When it spans less than a factor 1.25 and there are more than three
    specimens, up to half of them are left out at either end (their values at those levels are NaN). It is inset
    by 2 % of its logarithm, because standard errors are largest at the outermost cycles.

    Parameters
    ----------
    cycles : sequence of Cycles
        One per specimen.
    n_levels : int, optional
        By default 10, or half the cycles of the shortest decay inside the range if that is less, at least 3.

    Returns
    -------
    (l,) array
        Increasing amplitudes [m or rad].

    Raises
    ------
    InputError
        When the specimens have no common amplitudes.
    """
    tops = np.array([np.partition(item.smoothed_amplitude, -2)[-2] for item in cycles])
    bottoms = np.array([item.smoothed_amplitude.min() for item in cycles])
    for share in (0.0, 0.1, 0.2, 0.35, 0.5) if len(cycles) > 3 else (0.0,):
        low = float(np.quantile(bottoms, 1.0 - share))
        high = float(np.quantile(tops, share))
        # of two halves far apart both medians lie between them, where no specimen was
        is_reached = (bottoms < np.sqrt(low * high)) & (tops > np.sqrt(low * high))
        if high > 1.25 * low and is_reached.any():
            break
    else:
        raise InputError(
            f"`cycles` must share a range of amplitudes, but most begin below {high:g} or end above {low:g}; "
            "give `levels`, or analyse the specimens in groups."
        )
    if n_levels is None:
        inside = [int(np.sum((c.smoothed_amplitude >= low) & (c.smoothed_amplitude <= high))) for c in cycles]
        n_levels = int(np.clip(min(count for count in inside if count) // 2, 3, DEFAULT_LEVELS))
    inset = 0.02 * np.log(high / low)
    return np.exp(np.linspace(np.log(low) + inset, np.log(high) - inset, n_levels))


def backbones_at_levels(
    cycles: Cycles | Iterable[Cycles],
    levels: ArrayLike | None = None,
    observables: str | Iterable[str] | None = None,
    *,
    amplitude_unit: str = "m",
) -> xr.Dataset:
    """Estimate the backbone of every specimen at amplitude levels, with standard errors.

    Each observable is smoothed over the cycles by generalised least squares with the covariance of cycles that share
    samples, as a function of
    smoothed amplitude. The smoothness is averaged over, not chosen (`_smoothing.smooth`), so that the standard errors
    contain the doubt about the
    curve between and beyond its noise; so is the abscissa (logarithm of amplitude, amplitude). The error of the
    amplitude itself is added.

    Parameters
    ----------
    cycles : Cycles or iterable of Cycles
        One per specimen.
    levels : (l,) array, optional
        Increasing amplitudes [m or rad]; by default `default_levels`.
    observables : str or iterable of str, optional
        Any of ``frequency`` [Hz], ``damping`` [-], ``offset`` [-]; by default the first two, of envelopes without a
        measured frequency damping alone.
    amplitude_unit : str, default "m"
        Recorded in the attributes.

    Returns
    -------
    xarray.Dataset
        ``value`` and ``standard_error`` (specimen, observable, level), ``covariance`` and ``noise_covariance``
        (specimen, observable, level, level_other): of all that is in doubt, and what noise alone has of it, the
        smoothness of the curve taken as it was found.
        NaN at levels outside a specimen's own cycles: nothing is extrapolated. Where the frequency is no observable,
        the attribute ``frequency`` holds the typical one [Hz].

    Raises
    ------
    InputError
        For levels that no specimen reaches, unknown observables or such as were not measured, or specimen names given
        twice.

    See Also
    --------
    extract_cycles : where cycles come from.
    fit_density : the density of the population.
    simulate_population : the same of simulated specimens.
    """
    items = [cycles] if isinstance(cycles, Cycles) else list(cycles)
    if not items:
        raise InputError("`cycles` must hold at least one specimen; extract the cycles of a record first.")
    names = [item.specimen for item in items]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"`cycles` must have distinct specimen names, got {twice!r} twice; rename one.")
    held = [name for name in OBSERVABLES if all(name in item.observables for item in items)]
    chosen = check_observables([name for name in held if name in _USUAL] if observables is None else observables)
    missing = [name for name in chosen if name not in held]
    if missing:
        raise InputError(
            f"`observables` hold {missing[0]}, which these envelopes do not tell, but {' and '.join(held)}; leave "
            f"{missing[0]} out{'' if missing[0] == 'offset' else ', or give records with a column of it'}."
        )
    at = default_levels(items) if levels is None else check_levels(levels)
    shape = (len(items), len(chosen), at.size)
    value, covariance, noise = np.full(shape, np.nan), *np.full((2, *shape, at.size), np.nan)
    notes: list[str] = [note for item in items for note in item.notes]
    for i, item in enumerate(items):
        # the outermost cycles carry half a per cent of slack, so that a level chosen at an end is not lost to rounding
        amplitude = item.smoothed_amplitude
        reached = np.flatnonzero((at >= amplitude.min() * (1 - 1e-9)) & (at <= amplitude.max() * (1 + 1e-9)))
        if reached.size < at.size:
            notes.append(f"{item.specimen}: {at.size - reached.size} of {at.size} levels not reached, left empty")
        if not reached.size:
            continue
        for j, observable in enumerate(chosen):
            estimate, spread, of_noise = _level_values(item, observable, at[reached])
            value[i, j, reached] = estimate
            covariance[i, j, reached[:, None], reached] = spread
            noise[i, j, reached[:, None], reached] = of_noise
    if np.all(np.isnan(value)):
        low, high = min(c.smoothed_amplitude.min() for c in items), max(c.smoothed_amplitude.max() for c in items)
        raise InputError(
            f"`levels` must lie inside the measured amplitudes, {low:.4g} to {high:.4g} {amplitude_unit}, got "
            f"{at[0]:g} to {at[-1]:g} {amplitude_unit}."
        )
    result = backbone_dataset(names, chosen, at, value, covariance, amplitude_unit, notes, noise)
    if FREQUENCY not in chosen:
        result.attrs[FREQUENCY] = float(np.median(np.concatenate([item.frequency for item in items])))
    return result


def _level_values(item: Cycles, observable: str, levels: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the level values of one observable, their covariance, and what noise alone has of it."""
    amplitude = item.smoothed_amplitude
    step = 1e-4
    beside = np.where(levels * (1.0 + step) <= amplitude.max(), levels * (1.0 + step), levels * (1.0 - step))
    wanted = np.concatenate([levels, beside])
    curve = smooth(
        abscissas(amplitude, amplitude, is_envelope=item.is_of_envelope),
        getattr(item, observable),
        item.bands[QUANTITIES.index(observable)],
        abscissas(amplitude, wanted, is_envelope=item.is_of_envelope),
        orders=(2, 3),
        kinks=True,
        undersmoothing=UNDERSMOOTHING[observable],
    )
    n = levels.size
    slope = (curve.value[n:] - curve.value[:n]) / np.log(beside / levels)
    # the level is an amplitude, and the amplitude of the cycles is itself estimated
    order = np.argsort(amplitude)
    right = np.clip(np.searchsorted(amplitude[order], levels), 1, amplitude.size - 1)
    left = right - 1
    gap = amplitude[order][right] - amplitude[order][left]
    share = np.clip((levels - amplitude[order][left]) / np.where(gap > 0.0, gap, 1.0), 0.0, 1.0)
    weights = np.zeros((n, amplitude.size))
    weights[np.arange(n), order[left]] = 1.0 - share
    weights[np.arange(n), order[right]] += share
    blur = (slope / levels)[:, None] * (weights @ item.smoothed_amplitude_design)
    # errors shared through the template vary smoothly with amplitude: smoothing passes them on as they are
    shared = weights @ item.shared[QUANTITIES.index(observable)]
    beside_the_curve = blur @ item.smoothed_amplitude_spread @ blur.T + shared @ shared.T
    return (
        curve.value[:n],
        _definite(curve.covariance[:n, :n] + beside_the_curve),
        _definite(curve.noise_covariance[:n, :n] + beside_the_curve),
    )


def _definite(covariance: FloatArray) -> FloatArray:
    """Return a covariance without what rounding made of it: symmetric, no direction less than the rounding's size.

    Many levels of one smooth curve are nearly dependent, and of a very quiet record the smallest directions are lost in
    differences of large numbers: they come out negative. Standard errors stay as they are.
    """
    scale = np.sqrt(np.diag(covariance))
    symmetric = 0.5 * (covariance + covariance.T)
    if not (scale > 0.0).all():
        return symmetric
    values, vectors = np.linalg.eigh(symmetric / np.outer(scale, scale))
    if values[0] >= 0.0:
        return symmetric
    correlation = (vectors * np.maximum(values, -2.0 * values[0])) @ vectors.T
    size = np.sqrt(np.diag(correlation)) / scale
    return np.asarray(correlation / np.outer(size, size))
