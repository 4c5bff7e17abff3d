"""The gap on what a fit has not seen: levels predicted from the others, specimens predicted from the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..._common.checks import OBSERVABLES, FloatArray
from ..fitting.batch import Batch
from ..fitting.curves import (
    about_zero,
    curve,
    has_mid_line,
    level_chi_square,
    measured,
    on_levels,
    one_on_levels,
    prediction_errors,
    spread_over,
)
from ..fitting.data_term import level_term
from ..fitting.descent import is_heavy
from ..fitting.joint_fit import Fit, fit, parameters_of
from ..fitting.limits import centred
from ..fitting.normal_equations import DRIFTS, NUISANCES, State
from ..results.entries import HeldOut

MOST_HELD_OUT = 6
"""Specimens that are left out in turn, by default."""
_MOST_HEAVY, _MOST_HEAVY_LEVELS = 3, 5  # of them, and of the levels, where the model takes so much longer
_RESAMPLES = 2000


@dataclass(frozen=True, eq=False)
class Verification:
    """Base and extended model on the backbones, and the gap on what a fit has not seen.

    Attributes
    ----------
    before, after : Fit
        Base and extended model brought to the backbones; None where there is no extended one.
    reduced : float
        Reduced chi-square of the backbones at the model that is believed.
    held_out_levels, held_out_specimens : HeldOut or None
        The gap on each, before and after; None where it cannot be measured.
    shrink : (float, float, float)
        By which factor it shrank, with a 95 % interval.
    """

    before: Fit
    after: Fit | None
    reduced: float
    held_out_levels: HeldOut | None
    held_out_specimens: HeldOut | None
    shrink: tuple[float, float, float]


def verify(
    batch: Batch, base: Fit, extended: Fit | None, most: int, seed: int, say: Callable[[str, float], None]
) -> Verification:
    """Return what the extended model explains of data that it was not fitted to; ``most`` specimens are left out."""
    say("verifying on held-out data", 0.0)
    seen = about_zero(batch, base if extended is None else extended)
    before = on_levels(seen, base, free_effects=base.layout.free.size > 0)
    after = None if extended is None else on_levels(seen, extended)
    by_level = by_specimen = None
    if most > 0:
        by_level = held_out_levels(seen, before, after)
        say("verifying on held-out data", 0.5)
        by_specimen = held_out_specimens(seen, before, extended, most)
    reduced = level_chi_square(batch, before if after is None else after)
    if extended is not None and extended.state.own[:, DRIFTS].any():
        reduced = min(reduced, level_chi_square(batch, extended))  # with its drift in time
    return Verification(
        before=before,
        after=after,
        reduced=reduced,
        held_out_levels=by_level,
        held_out_specimens=by_specimen,
        shrink=shrink(by_specimen, by_level, seed),
    )


def held_out_levels(batch: Batch, before: Fit, after: Fit | None) -> HeldOut | None:
    """Leave out one level at a time, predict it from the others, and compare; the lowest and highest included.

    Where the extended model takes much longer, some of them, in some specimens.
    """
    levels = np.asarray(batch.backbones["level"])
    values, errors = _measured(batch, before if after is None else after)
    if levels.size < 4:
        return None
    rows = _rows(batch)
    results = np.full((2, levels.size), np.nan)
    names = [str(name) for name in batch.backbones["specimen"].values]
    chosen = spread_over(len(batch.specimens), (before if after is None else after).layout)
    values, errors = values[chosen], errors[chosen]
    index = [names.index(batch.specimens[r]) for r in chosen]
    most = _MOST_HEAVY_LEVELS if after is not None and is_heavy(after.layout) else levels.size
    for k in np.unique(np.linspace(0, levels.size - 1, min(most, levels.size)).round().astype(int)):
        keep = np.arange(levels.size) != k
        found = [level_term(batch.backbones, i, keep) for i in index]
        terms = [
            replace(term, release=batch.levels[r].release)
            for term, r in zip(found, chosen, strict=True)
            if term is not None and term.levels.size >= 3
        ]
        if len(terms) < len(index):
            continue
        for m, model in enumerate((before, after)):
            if model is None:
                continue
            state = State(model.state.eta, model.state.own[chosen])
            solved = fit(model.layout, terms, state, iterations=12, nuisances=(0, 1), tolerance=0.1)
            if solved is None:
                continue
            own = prediction_errors(solved, terms, levels[[k]])[:, rows, 0]
            predicted = np.array(
                [
                    curve(solved, solved.parameters(r), levels[[k]], term.release)[rows, 0]
                    for r, term in enumerate(terms)
                ]
            )
            results[m, k] = _reduced(values[:, :, k] - predicted, errors[:, :, k], own)
    if not np.isfinite(results[0]).any():
        return None
    return _held_out(results, tuple(f"{level:.6g}" for level in levels))


def _refitted(model: Fit, others: Batch, state: State) -> Fit | None:
    return fit(model.layout, others.deciding, state, iterations=6, nuisances=others.nuisances, tolerance=0.3)


def held_out_specimens(
    batch: Batch,
    before: Fit,
    after: Fit | None,
    most: int,
    refit: Callable[[Fit, Batch, State], Fit | None] = _refitted,
) -> HeldOut | None:
    """Leave out one specimen at a time: only its stiffness and damping are fitted, the effects come from the others.

    ``refit`` takes a model, the others and where to start, and returns the model fitted to these.
    """
    count = len(batch.specimens)
    if count < 2:
        return None
    if after is not None and is_heavy(after.layout):
        most = min(most, _MOST_HEAVY)
    chosen = np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
    values, errors = _measured(batch, before if after is None else after)
    levels = np.asarray(batch.backbones["level"])
    rows = _rows(batch)
    results = np.full((2, chosen.size), np.nan)
    for c, r in enumerate(chosen):
        rest = [i for i in range(count) if i != r]
        others = batch.subset(rest)
        for m, model in enumerate((before, after)):
            if model is None:
                continue
            # one specimen alone has no deviation: about the middle of all, it had lost its phase
            state = centred(model.layout, State(model.state.eta, model.state.own[rest]), model.layout.scatter)
            solved = refit(model, others, state)
            if solved is None:
                continue
            alone = State(solved.centre, model.state.own[[r]].copy())
            alone.own[0, NUISANCES:] = 0.0
            own = one_on_levels(solved, batch.levels[r], alone, 0)
            predicted_state = State(alone.eta, own[None])
            vector = parameters_of(model.layout, predicted_state, 0)
            release = batch.levels[r].release
            predicted = curve(model, vector, levels, release)[rows]
            spread = _spread(solved, len(rest), own, levels, release)[rows]
            results[m, c] = _reduced(values[r] - predicted, errors[r], spread)
    if not np.isfinite(results[0]).any():
        return None
    return _held_out(results, tuple(batch.specimens[r] for r in chosen))


def _spread(solved: Fit, count: int, own: FloatArray, levels: FloatArray, release: float) -> FloatArray:
    """Return standard errors (3, l) of a specimen's curves from what the others leave open about the effects.

    What stiffness and damping can make up for is no error: they are fitted.
    """
    q = solved.layout.free.size
    spread = np.zeros((3, levels.size))
    if q == 0:
        return spread
    delta = solved.state.own[:, NUISANCES:]
    scatter = solved.layout.scatter * np.sqrt((delta**2).mean(axis=0)) if count > 1 else np.zeros(q)
    covariance = solved.covariance + np.diag((solved.state.eta * scatter) ** 2)
    values, status = np.empty((3, levels.size)), np.zeros(levels.size, dtype=np.int64)
    state = State(solved.state.eta, own[None])
    vector = parameters_of(solved.layout, state, 0)
    jacobian = np.zeros((3, levels.size, vector.size))
    solved.layout.simulator.backbone(vector, levels, release, True, values, jacobian, status, whole=False)
    _, slopes = solved.layout.physical(solved.state.eta, own[NUISANCES:], 0.0)
    effects = np.nan_to_num(jacobian[:, :, solved.layout.free] @ slopes)
    for o, column in ((0, 0), (1, 1)):
        along = np.nan_to_num(jacobian[o, :, column])
        norm = float(along @ along)
        if norm > 0.0:
            effects[o] = effects[o] - np.outer(along, along @ effects[o]) / norm
    variances = np.einsum("oli,ij,olj->ol", effects, np.nan_to_num(covariance), effects)
    errors: FloatArray = np.sqrt(np.maximum(variances, 0.0))
    return errors


def _rows(batch: Batch) -> list[int]:
    return [OBSERVABLES.index(str(name)) for name in batch.backbones["observable"].values]


def _measured(batch: Batch, model: Fit) -> tuple[FloatArray, FloatArray]:
    """Return what predictions are compared with, and its errors; NaN where that is not known.

    The damping of a cycle follows the slope of the mid-line to first order. Where the model moves the mid-line and the
    sensor does not measure it, the measured damping is off by more than its error, which knows no law.
    """
    values, errors = measured(batch)
    if batch.has_records and batch.lacks_mid_line and has_mid_line(batch, model):
        is_damping = np.array([str(name) == "damping" for name in batch.backbones["observable"].values])
        errors = np.where(is_damping[:, None], np.nan, errors)
    return values, errors


def _reduced(difference: FloatArray, errors: FloatArray, own: FloatArray) -> float:
    variance = errors**2 + own**2
    held = np.isfinite(difference) & np.isfinite(variance) & (variance > 0.0)
    return float(np.mean(difference[held] ** 2 / variance[held])) if held.any() else float("nan")


def _held_out(results: FloatArray, labels: tuple[str, ...]) -> HeldOut:
    with np.errstate(invalid="ignore"):
        mean = [float(np.nanmean(row)) if np.isfinite(row).any() else float("nan") for row in results]
    return HeldOut(mean[0], mean[1], labels, results[0].copy(), results[1].copy())


def shrink(specimens: HeldOut | None, levels: HeldOut | None, seed: int) -> tuple[float, float, float]:
    """Return by which factor the held-out gap shrank, with a 95 % interval from resampling what was left out."""
    chosen = specimens if specimens is not None and np.isfinite(specimens.after) else levels
    if chosen is None or not np.isfinite(chosen.after):
        return (float("nan"),) * 3
    held = np.isfinite(chosen.before_each) & np.isfinite(chosen.after_each)
    before, after = chosen.before_each[held], chosen.after_each[held]
    if not before.size:
        return (float("nan"),) * 3
    index = np.random.default_rng(seed).integers(0, before.size, size=(_RESAMPLES, before.size))
    ratios = before[index].sum(axis=1) / np.maximum(after[index].sum(axis=1), 1e-12)
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(before.sum() / max(after.sum(), 1e-12)), float(low), float(high)
