"""What does not matter: effects that change the backbones, and sets that miss them, by less than the tolerance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .._common.checks import FloatArray
from .batch import Batch
from .curves import curve, on_levels, simulate
from .evidence import LackOfFit
from .joint_fit import Fit
from .locate import mean_gap
from .search import Search, Set

UNEXPLAINED = 1e-4
"""p-value of a set's residuals below which it does not explain the records."""
_LOOKED_AT = 150


def is_unexplained(lack: LackOfFit, tolerance: Mapping[str, float]) -> bool:
    """Return whether residuals are no noise, and larger than the tolerance on the waveform."""
    limit = tolerance.get("waveform", 0.0)
    return lack.p_value < UNEXPLAINED and not lack.share < limit


def within_tolerance(search: Search, ranked: Sequence[Set], tolerance: Mapping[str, float]) -> list[Set]:
    """Return the smallest sets that describe the backbones within the tolerance, or as well as the best of these.

    A set does when its curves follow the measured ones within the tolerance and twice their errors. Then so does every
    set whose curves follow those of the likeliest such set: the two cannot be told apart by what matters.
    """
    curves: dict[Set, FloatArray] = {}
    errors: dict[Set, FloatArray] = {}
    backbones = search.batch.backbones.sel(specimen=list(search.batch.specimens))
    looked_at = sorted((names for names in ranked[:_LOOKED_AT] if names), key=len)
    close: list[Set] = []
    for names in looked_at:
        found = search.fits[names]
        brought = on_levels(search.batch, found, free_effects=found.layout.free.size > 0)
        simulated = simulate(search.batch, brought)
        mean, errors[names] = mean_gap(backbones, simulated)
        curves[names] = np.nanmean(np.asarray(simulated["value"]), axis=0)
        if _is_within(search.batch, mean, errors[names], curves[names], tolerance):
            close.append(names)
    if not close:
        return []
    leader = min(close, key=ranked.index)

    def is_alike(names: Set) -> bool:
        return _is_within(search.batch, curves[names] - curves[leader], errors[leader], curves[leader], tolerance)

    alike = [names for names in looked_at if names in close or is_alike(names)]
    return [names for names in alike if not any(set(other) < set(names) for other in alike)]


def _is_within(
    batch: Batch, gap: FloatArray, error: FloatArray, value: FloatArray, tolerance: Mapping[str, float]
) -> bool:
    """Return whether a gap (observable, level) is nowhere larger than the tolerance and twice its error."""
    for o, key in enumerate(str(name) for name in batch.backbones["observable"].values):
        if key in tolerance:
            excess = np.abs(gap[o]) - 2.0 * error[o] - tolerance[key] * np.abs(value[o])
            unknown = 1.0 if np.isnan(value[o]).any() else 0.0
            if np.any(np.nan_to_num(excess, nan=unknown) > 0.0):
                return False
    return True


def prune(search: Search, best: Set, tolerance: Mapping[str, float]) -> tuple[Set, Set]:
    """Return the effects of a set that change the backbones by more than the tolerance, and those that do not."""
    kept = best
    below: list[str] = []
    while kept:
        changes = {}
        for name in kept:
            rest = tuple(other for other in kept if other != name)
            if rest not in search.fits:
                search.fit_set(rest)
            if rest in search.fits:
                changes[name] = relative_change(search.batch, search.fits[kept], search.fits[rest])
        small = [
            name
            for name, change in changes.items()
            if all(change.get(key, 0.0) < limit for key, limit in tolerance.items() if key in change)
        ]
        if not small:
            break
        weakest = min(small, key=lambda name: max(changes[name].values()))
        below.append(weakest)
        kept = tuple(other for other in kept if other != weakest)
    return kept, tuple(below)


def relative_change(batch: Batch, larger: Fit, smaller: Fit) -> dict[str, float]:
    """Return the largest relative change of frequency and damping over the levels between two fits."""
    levels = np.asarray(batch.backbones["level"])
    first = on_levels(batch, larger)
    second = on_levels(batch, smaller, free_effects=smaller.layout.free.size > 0)
    worst = {"frequency": 0.0, "damping": 0.0}
    for r, term in enumerate(batch.levels):
        inside = levels[(levels >= term.levels[0] * 0.999) & (levels <= term.levels[-1] * 1.001)]
        a, b = (curve(item, item.parameters(r), inside) for item in (first, second))
        for row, key in ((0, "frequency"), (1, "damping")):
            with np.errstate(invalid="ignore", divide="ignore"):
                change = np.abs(a[row] - b[row]) / np.abs(a[row])
            worst[key] = max(worst[key], float(np.nanmax(change)) if np.isfinite(change).any() else np.inf)
    return worst
