"""Simulated backbones of fitted models beside the measured ones, and how well they are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from ..._common.checks import OBSERVABLES, FloatArray
from . import normal_equations
from .batch import Batch
from .data_term import LevelTerm
from .drift_course import Linear, passage_of
from .joint_fit import Fit, fit, parameters_of
from .layout import Layout
from .normal_equations import DRIFTS, NUISANCES, RELEASE_INSTANT, ZERO, State, linearise, start_state

_NEAR = 2.0  # reduced chi-square
_GLANCE, _MOST, _LAST = 8, 20, 4  # iterations: of each start, of the best of these, and over all specimens
_MOST_HEAVY = 3  # specimens that a model which takes long is fitted to first, or held against
_OFFSET = OBSERVABLES.index("offset")
_BEYOND = 4  # amplitudes above the levels that all specimens reach
_SIDE = 1e-3  # share of the largest amplitude from which a mid-line is a model's own
NO_NUISANCES = np.zeros(5)  # levels see none of them


def on_levels(batch: Batch, found: Fit, *, free_effects: bool = False) -> Fit:
    """Return a fit brought to the backbones: each specimen's stiffness and damping, and if wanted the effects too.

    A drift in time is not in it any more.
    """
    state = State(found.state.eta, found.state.own.copy())
    state.own[:, DRIFTS] = 0.0
    if free_effects:
        solved = fit(found.layout, batch.levels, state, iterations=20, nuisances=(0, 1), tolerance=0.1)
        return found if solved is None else solved
    rows = [one_on_levels(found, batch.levels[r], state, r) for r in range(len(batch.specimens))]
    own = np.array(rows)
    return replace(found, state=State(state.eta, own))


def fit_on_levels(batch: Batch, layout: Layout, begun: Sequence[tuple[FloatArray, FloatArray]]) -> Fit | None:
    """Return the best fit to the backbones from some starts: shared coordinates (q,), and stiffness and damping (r, 2).

    The first that comes near the noise is taken; else the one that is lowest after some steps goes on. Where the model
    takes long, some specimens say where that is, and all of them the rest. None where none of them can be simulated.
    """
    chosen = spread_over(len(batch.levels), layout)
    terms = [batch.levels[r] for r in chosen]
    best: Fit | None = None
    from_own = np.empty((0, 2))
    for eta, own in begun:
        found = _of_levels(layout, terms, eta, own[chosen], _GLANCE)
        if found is not None and (best is None or found.cost < best.cost):
            best, from_own = found, own
        if best is not None and best.cost < _NEAR * sum(term.size for term in terms):
            break
    if best is None:
        return None
    if not best.is_converged:
        best = _of_levels(layout, terms, best.state.eta, best.state.own[:, :2], _MOST) or best
    if len(chosen) == len(batch.levels):
        return best
    own = from_own.copy()
    own[chosen] = best.state.own[:, :2]
    return _of_levels(layout, batch.levels, best.state.eta, own, _LAST)


def _of_levels(
    layout: Layout, terms: Sequence[LevelTerm], eta: FloatArray, own: FloatArray, iterations: int
) -> Fit | None:
    """Return the fit to backbones from shared coordinates, and stiffness and damping of each specimen."""
    start = start_state(layout, eta, np.column_stack([own, np.zeros((len(own), 3))]))
    return fit(layout, terms, start, iterations=iterations, nuisances=(0, 1), tolerance=0.1)


def spread_over(count: int, layout: Layout) -> list[int]:
    """Return which of so many specimens say enough of a model: all, or some where each simulation takes long."""
    return spread(count, _MOST_HEAVY if layout.simulator.is_costly else count)


def spread(count: int, most: int) -> list[int]:
    """Return which of so many, the first and the last among them, are spread evenly over all; all where few are."""
    return [int(r) for r in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def one_on_levels(found: Fit, term: LevelTerm, state: State, specimen: int) -> FloatArray:
    """Return a specimen's own values with stiffness and damping fitted to its backbone, the effects held."""
    vector = parameters_of(found.layout, state, specimen)
    own: FloatArray = state.own[specimen].copy()
    damping = 1e-3
    compared = term.compare(found.layout.simulator, vector, NO_NUISANCES)
    if compared is None:
        return own
    for _ in range(12):
        residuals, slopes = compared
        pair = slopes[:, :2]
        scale = 1.0 / np.maximum(np.sqrt((pair**2).sum(axis=0)), 1e-300)
        scaled = pair * scale
        step = scale * np.linalg.solve(scaled.T @ scaled + damping * np.eye(2), scaled.T @ residuals)
        trial = vector.copy()
        trial[:2] += step
        trial[1] = max(trial[1], 0.0)
        moved = term.compare(found.layout.simulator, trial, NO_NUISANCES) if trial[0] > 0.0 else None
        before = float(residuals @ residuals)
        if moved is None or float(moved[0] @ moved[0]) > before:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        vector, compared, damping = trial, moved, damping / 10.0
        if before - float(moved[0] @ moved[0]) < 1e-3:
            break
    own[:2] = vector[:2]
    return own


def simulate(batch: Batch, found: Fit, levels: FloatArray | None = None) -> xr.Dataset:
    """Return the simulated backbones (specimen, observable, level) of a fit; NaN where a level cannot be simulated."""
    names = [str(name) for name in batch.backbones["observable"].values]
    chosen = np.asarray(batch.backbones["level"]) if levels is None else np.asarray(levels, dtype=np.float64)
    rows = [OBSERVABLES.index(name) for name in names]
    values = np.array(
        [curve(found, found.parameters(r), chosen, term.release)[rows] for r, term in enumerate(batch.levels)]
    )
    dims = ("specimen", "observable", "level")
    return xr.Dataset(
        {"value": (dims, values), "standard_error": (dims, np.zeros_like(values))},
        coords={"specimen": list(batch.specimens), "observable": names, "level": chosen},
        attrs={"amplitude_unit": batch.amplitude_unit},
    )


def curve(found: Fit, parameters: FloatArray, levels: FloatArray, release: float) -> FloatArray:
    """Return frequency, damping and offset (3, l) of one parameter vector; NaN where a level cannot be simulated.

    ``release`` is that of the specimen, for what remembers; 0 where any will do.
    """
    return _simulated(found.layout, parameters, levels, release)


def has_mid_line(batch: Batch, found: Fit) -> bool:
    """Return whether the mid-line of a fitted model is off the middle by more than `_SIDE` of the amplitude."""
    term = batch.levels[0]
    offset = curve(found, found.parameters(0), term.levels, term.release)[2] * term.levels
    return bool(np.nanmax(np.abs(offset), initial=0.0) > _SIDE * term.levels[-1])


def frequencies(layout: Layout, parameters: FloatArray, term: LevelTerm) -> FloatArray:
    """Return the frequencies (l,) [Hz] at the levels of a specimen; NaN where a level cannot be simulated."""
    return np.asarray(_simulated(layout, parameters, term.levels, term.release)[0])


def _simulated(layout: Layout, parameters: FloatArray, levels: FloatArray, release: float) -> FloatArray:
    values, status = np.empty((3, levels.size)), np.zeros(levels.size, dtype=np.int64)
    layout.simulator.backbone(
        np.ascontiguousarray(parameters), np.ascontiguousarray(levels), release, True, values, np.zeros((0, 0, 0)),
        status, whole=False,
    )  # fmt: skip
    values[:, status != 0] = np.nan
    return values


def relative_change(batch: Batch, larger: Fit, smaller: Fit) -> dict[str, float]:
    """Return the largest change of the backbones between two fits, over all amplitudes that specimens swung through.

    Of frequency and damping relative to their values; the offset is a share of the amplitude already. Levels are those
    that all specimens reach; what acts beyond them, in those that were released from farther, counts as well.
    """
    levels = np.asarray(batch.backbones["level"])
    first = on_levels(batch, larger)
    second = on_levels(batch, smaller, free_effects=smaller.layout.free.size > 0)
    worst = {"frequency": 0.0, "damping": 0.0, "offset": 0.0}
    for r, term in enumerate(batch.levels):
        inside = levels[(levels >= term.levels[0] * 0.999) & (levels <= term.levels[-1] * 1.001)]
        inside = np.concatenate([inside, _beyond(batch, r)])
        a, b = (curve(item, item.parameters(r), inside, term.release) for item in (first, second))
        for row, key in enumerate(worst):
            with np.errstate(invalid="ignore", divide="ignore"):
                change = np.abs(a[row] - b[row]) / (1.0 if key == "offset" else np.abs(a[row]))
            worst[key] = max(worst[key], float(np.nanmax(change)) if np.isfinite(change).any() else np.inf)
    return worst


def _beyond(batch: Batch, specimen: int) -> FloatArray:
    """Return amplitudes above the highest level of a specimen, up to that of its largest cycle."""
    highest = float(batch.levels[specimen].levels[-1])
    largest = float(np.max(batch.cycles[specimen].amplitude, initial=0.0)) if batch.cycles else 0.0
    return np.geomspace(highest, largest, _BEYOND + 1)[1:] if largest > highest else np.empty(0)


def measured(batch: Batch) -> tuple[FloatArray, FloatArray]:
    """Return measured values and standard errors (specimen, observable, level), in the order of the batch."""
    chosen = batch.backbones.sel(specimen=list(batch.specimens))
    return np.asarray(chosen["value"]), np.asarray(chosen["standard_error"])


def level_chi_square(batch: Batch, found: Fit, *, is_apart: bool = False, has_mid_line: bool = True) -> float:
    """Return the reduced chi-square of the backbones at a fit, a drift in time that it holds in them.

    Of all values together; or, where ``is_apart``, of each by its own error. The errors of one curve go together, and
    how two of its values differ is said to be known many times better than either. ``has_mid_line`` tells whether the
    mid-line counts beside frequency and damping.
    The zero of the sensor is where the samples want it: what remembers may come to rest off the middle, and the mean of
    the last samples, from which the mid-line was counted, with it.
    """
    total, count = 0.0, 0
    for r, term in enumerate(batch.levels):
        if batch.has_records and found.state.own[r, DRIFTS].any():
            left = _left_beside_drifts(batch, found, r)
        else:
            left = term.residuals(found.layout.simulator, found.parameters(r), NO_NUISANCES)
        if left is None:
            return float("inf")
        if batch.has_records and not batch.waveform[r].order:  # that of a rate is no displacement
            zero = found.state.own[r, ZERO] / term.levels[term.rows[:, 1]]
            left = left - term.whitening @ np.where(term.rows[:, 0] == _OFFSET, zero, 0.0)
        if is_apart or not has_mid_line:
            root = np.linalg.inv(term.whitening)
            held = slice(None) if has_mid_line else np.flatnonzero(term.rows[:, 0] != _OFFSET)
            left, root = (root @ left)[held], root[held]
            left = left / np.sqrt((root**2).sum(axis=1)) if is_apart else _whitened(left, root)
        total += float(left @ left)
        count += left.size
    return total / max(count - 2 * len(batch.levels), 1)


def _whitened(left: FloatArray, root: FloatArray) -> FloatArray:
    """Return some values (n,) whitened, whose covariance is a root (n, m) times its transpose."""
    whitened: FloatArray = np.linalg.solve(np.linalg.cholesky(root @ root.T), left)
    return whitened


def about_zero(batch: Batch, found: Fit) -> Batch:
    """Return a batch whose mid-lines are counted from where the samples want the zero of the sensor, by a fit to them.

    What rests off the middle has not its zero where its last samples are, and the backbones were counted from these.
    """
    data = batch.backbones
    if not batch.has_records or "offset" not in data["observable"]:
        return batch
    values, names = data["value"].copy(), [str(name) for name in data["specimen"].values]
    terms = []
    for r, term in enumerate(batch.levels):
        zero = 0.0 if batch.waveform[r].order else float(found.state.own[r, ZERO])  # of a rate it is no displacement
        values[names.index(batch.specimens[r])].loc[{"observable": "offset"}] -= zero / data["level"]
        shift = np.where(term.rows[:, 0] == _OFFSET, zero / term.levels[term.rows[:, 1]], 0.0)
        terms.append(replace(term, values=term.values - shift))
    return replace(batch, backbones=data.assign(value=values), levels=tuple(terms))


def is_told_apart(batch: Batch, found: Fit, image: State, possible: float) -> bool:
    """Return whether the backbones tell a fit from its mirror image, whose mid-line lies on the other side.

    They do not where that leaves no more than ``possible``, or than the fit does: the mid-line of a weak contact is
    lost in the noise, and that of a velocity is not known.
    """
    if not all(item.offset_is_measured for item in batch.records):
        return False
    most = max(level_chi_square(batch, found), possible)
    return not level_chi_square(batch, on_levels(batch, replace(found, state=image))) < most


def _left_beside_drifts(batch: Batch, found: Fit, r: int) -> FloatArray | None:
    """Return the residuals (m,) of the backbones of a specimen whose frequency and damping drift with time.

    As in the waveform, the motion without a drift is passed faster, and falls by more: at a level it had another
    amplitude, and passed it with another frequency and decrement.
    """
    term, cycles = batch.levels[r], batch.cycles[r]
    drift, loss = found.state.own[r, DRIFTS] * (1.0, batch.waveform[r].fade)
    length = float(np.ptp(batch.waveform[r].time))
    order = np.argsort(cycles.smoothed_amplitude)
    elapsed = (cycles.time[order] - found.state.own[r, RELEASE_INSTANT]) / length
    share = np.interp(term.levels, cycles.smoothed_amplitude[order], elapsed)
    softness = _softness(batch, found, r, share)
    linear = Linear.of(found.parameters(r), found.layout.oscillator.mass)
    passage = passage_of(share, drift, loss, length, batch.waveform[r].settling, softness, linear)
    levels = passage.levels_before(term.levels)
    if not np.all(np.diff(levels) > 0.0):
        return None
    values, status = np.empty((3, levels.size)), np.zeros(levels.size, dtype=np.int64)
    none = np.zeros((3, levels.size, 0))
    found.layout.simulator.backbone(found.parameters(r), levels, term.release, True, values, none, status, whole=False)
    if status.any():
        return None
    values[:2] = passage.drifted(values[0], values[1])
    left: FloatArray = term.whitening @ (term.values - values[term.rows[:, 0], term.rows[:, 1]])
    return left


def _softness(batch: Batch, found: Fit, r: int, share: FloatArray) -> FloatArray:
    """Return the linear spring over the mass and the square of the angular frequency, at shares of a record."""
    term = batch.waveform[r]
    square = float(found.parameters(r)[0]) / found.layout.oscillator.mass
    if term.motion is None:
        return np.ones_like(share)
    at = found.state.own[r, RELEASE_INSTANT] + share * float(np.ptp(term.time))
    softness: FloatArray = square / np.interp(at, term.time, term.motion.angular_frequency) ** 2
    return softness


def prediction_errors(found: Fit, terms: list[LevelTerm], levels: FloatArray) -> FloatArray:
    """Return standard errors (specimen, 3, l) of what a fit to ``terms`` predicts at ``levels``."""
    q = found.layout.free.size
    scatter = found.layout.scatter if len(terms) > 1 else 0.0
    active = np.zeros(NUISANCES + q, dtype=bool)
    active[:2] = True
    active[NUISANCES:] = scatter > 0.0
    errors = np.zeros((len(terms), 3, levels.size))
    system = linearise(found.layout, terms, found.state, scatter, active)
    if system is None:
        return errors
    held = np.zeros(found.state.own.shape, dtype=bool)
    eliminated = normal_equations.eliminate(system, active, 1e-9, held)
    if eliminated is None:
        return errors
    shared, _, solved = eliminated
    prior = np.diag(1.0 / found.layout.width**2) if q else np.zeros((0, 0))
    covariance = np.linalg.pinv(shared + prior) if q else np.zeros((0, 0))
    for r, (index, scale, reduced, _) in enumerate(solved):
        values, status = np.empty((3, levels.size)), np.zeros(levels.size, dtype=np.int64)
        vector = found.parameters(r)
        jacobian = np.zeros((3, levels.size, vector.size))
        release = terms[r].release
        found.layout.simulator.backbone(vector, levels, release, True, values, jacobian, status, whole=False)
        own = found.state.own[r]
        _, slopes = found.layout.physical(found.state.eta, own[NUISANCES:], scatter)
        effects = jacobian[:, :, found.layout.free] @ slopes
        full = np.zeros((3, levels.size, NUISANCES + q))
        full[:, :, :2] = jacobian[:, :, :2]
        full[:, :, NUISANCES:] = effects * (found.state.eta * scatter)
        local = full[:, :, index] * scale
        block = system.own[r][np.ix_(index, index)] * np.outer(scale, scale)
        inverse = np.linalg.pinv(block)
        along = effects * (1.0 + scatter * own[NUISANCES:]) - local @ reduced[:, :-1]
        variance = np.einsum("oli,ij,olj->ol", local, inverse, local)
        if q:
            variance = variance + np.einsum("oli,ij,olj->ol", along, covariance, along)
        errors[r] = np.sqrt(np.maximum(np.nan_to_num(variance), 0.0))
    return errors
