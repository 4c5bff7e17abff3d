"""One specimen's measured backbone: ordered by amplitude, folds said, errors from its own scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from ..._common.checks import FloatArray, InputError

MINIMUM_POINTS_FOR_ERRORS = 6


@dataclass(frozen=True)
class MeasuredCurve:
    """One specimen's table: amplitude ascending, and per observable its values and standard errors."""

    specimen: str
    source: str
    unit: str
    amplitude: FloatArray
    values: dict[str, FloatArray]
    errors: dict[str, FloatArray]
    notes: tuple[str, ...]

    def fail(self, message: str) -> NoReturn:
        """Raise an error that names the source."""
        raise InputError(f"{self.source}: {message}")


def ordered(curve: MeasuredCurve) -> MeasuredCurve:
    """Return the curve by ascending amplitude, points of the same amplitude averaged, folds noted."""
    n = curve.amplitude.size
    if n < 2:
        curve.fail(f"a backbone needs at least 2 points, got {n}; measure more amplitudes.")
    notes = curve.notes
    steps = np.sign(np.diff(curve.amplitude))
    rising = bool((steps > 0.0).any())
    is_ordered = not (rising and (steps < 0.0).any())
    order = np.argsort(curve.amplitude, kind="stable")
    amplitude = curve.amplitude[order]
    group = np.concatenate([[0], np.cumsum(np.diff(amplitude) > 1e-9 * amplitude[1:])])
    fold = _fold(curve)
    if fold:
        notes += (f"{curve.source}: {fold}",)
    if not is_ordered and not fold:
        notes += (f"{curve.source}: points were sorted by amplitude",)
    count = np.bincount(group)
    if count.size < n:
        notes += (f"{curve.source}: {n - count.size} point(s) of repeated amplitude were averaged",)
    if count.size < 2:
        curve.fail("all points have the same amplitude; measure more amplitudes.")

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(group, values[order]) / count

    return replace(
        curve,
        amplitude=mean(curve.amplitude),
        values={name: mean(value) for name, value in curve.values.items()},
        errors={name: np.sqrt(np.bincount(group, error[order] ** 2)) / count for name, error in curve.errors.items()},
        notes=notes,
    )


def _fold(curve: MeasuredCurve) -> str:
    """Return a sentence when the way up and the way down give different frequencies at the same amplitude."""
    if "frequency" not in curve.values:
        return ""
    amplitude, frequency = curve.amplitude, curve.values["frequency"]
    turn = int(np.argmax(amplitude))
    if not 1 <= turn < amplitude.size - 1:
        turn = int(np.argmin(amplitude))
    up, down = slice(None, turn + 1), slice(turn, None)
    if min(amplitude[up].size, amplitude[down].size) < 2:
        return ""
    branches = []
    for part in (up, down):
        steps = np.diff(amplitude[part])
        if not ((steps >= 0.0).all() or (steps <= 0.0).all()):
            return ""
        order = np.argsort(amplitude[part])
        branches.append((amplitude[part][order], frequency[part][order]))
    (a0, f0), (a1, f1) = branches
    common = a0[(a0 >= a1[0]) & (a0 <= a1[-1])]
    if common.size == 0:
        return ""
    gap = np.abs(np.interp(common, a0, f0) - np.interp(common, a1, f1))
    error = curve.errors["frequency"]
    tolerance = 1e-3 * float(np.median(frequency)) if np.isnan(error).all() else 3.0 * float(np.nanmedian(error))
    worst = int(np.argmax(gap))
    if gap[worst] <= tolerance:
        return ""
    return (
        f"the backbone is folded: at amplitude {common[worst]:.3g} {curve.unit} the ways up and down differ by "
        f"{gap[worst]:.3g} Hz; both were used as one curve, split the file to treat them apart"
    )


def with_errors(curve: MeasuredCurve) -> MeasuredCurve:
    """Return the curve with standard errors estimated from its own scatter where none were given."""
    errors, notes = dict(curve.errors), list(curve.notes)
    n = curve.amplitude.size
    for name, error in curve.errors.items():
        if not np.isnan(error).all():
            continue
        if n < MINIMUM_POINTS_FOR_ERRORS:
            notes.append(
                f"{curve.source}: no standard errors of {name} given and too few points ({n}, at least "
                f"{MINIMUM_POINTS_FOR_ERRORS} are needed) to estimate them: they are unknown (NaN); "
                f"add a column {name}_error"
            )
            continue
        scatter = _scatter(curve.amplitude, curve.values[name])
        errors[name] = np.full(n, scatter)
        notes.append(
            f"{curve.source}: no standard errors of {name} given; {scatter:.3g} was estimated from the scatter of "
            f"{n} points about a quadratic in log amplitude"
        )
    return replace(curve, errors=errors, notes=tuple(notes))


def _scatter(amplitude: FloatArray, values: FloatArray) -> float:
    """Return the residual standard deviation about a quadratic in log amplitude."""
    log = np.log(amplitude)
    u = 2.0 * (log - log[0]) / (log[-1] - log[0]) - 1.0
    basis = np.vander(u, 3)
    residual = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(np.sqrt(residual @ residual / (values.size - 3)))
