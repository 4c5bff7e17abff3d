"""Both curves fitted to all specimens together with what is named, their smoothness inferred.

A specimen has its own stiffness, damping, release and offset, as in every joint fit; of the curves it has its own size,
a tenth more or less, so that the curves are those of the mean specimen. Each part has a Gaussian prior on its bends.
How wide these priors are follows from the evidence (Wood and Fasiolo's update); a part that the records do not ask for
goes to nothing. The sum of squares is minimised by Levenberg-Marquardt in one dense system.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..._common.checks import FloatArray
from ..fitting.data_term import DataTerm
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import DRIFTS, NUISANCES, State, System, linearise
from ..weighing.evidence import effective_size
from .tabulated import DAMPING, STIFFNESS, Tabulated

_FIRST = 1e2  # precision of a bend at first: second derivatives of a tenth of the scale over the range
_ROUGHEST, _SMOOTHEST = 1e-4, 1e9
_FASTEST = 30.0  # factor by which a precision changes between two steps
_NAMED = 1e-4  # of what is named, in units of its prior
_LONGEST = 3.0  # factor by which a step may change stiffness and release
_AT_REST = 0.05  # fall of the sum of squares from which on steps are small
_SETTLED = 0.1  # relative change of a precision that matters no more


@dataclass(frozen=True, eq=False)
class Known:
    """What the records say of one curve, everything else integrated out: a quadratic function of its free coordinates.

    Attributes
    ----------
    frame : (n, m) array
        Takes free coordinates to node forces [N], no line in them.
    precision : (m, m) array
        Of the records alone.
    prior : (m, m) array
        Of the bends.
    pull : (m,) array
        Slope of the records' logarithm of the likelihood where there is no curve.
    follows : (2 + q, m) array
        What the mean specimen's stiffness, damping and shared coordinates do where the free coordinates move.
    left : (2, 2) array
        Covariance of that stiffness and damping where the curve is known.
    """

    frame: FloatArray
    precision: FloatArray
    prior: FloatArray
    pull: FloatArray
    follows: FloatArray
    left: FloatArray

    def place(self) -> FloatArray:
        """Return the free coordinates (m,) of the curve that the prior of the bends makes most probable."""
        both = self.precision + self.prior
        scale = 1.0 / np.sqrt(np.maximum(np.diag(both), 1e-300))
        found = np.linalg.lstsq(both * np.outer(scale, scale), self.pull * scale, rcond=1e-13)[0]
        place: FloatArray = scale * found
        return place


@dataclass(frozen=True, eq=False)
class CurveFit:
    """The curves at a minimum.

    Attributes
    ----------
    tabulated : Tabulated
        The model.
    fit : Fit
        The same as a joint fit: its shared coordinates are those of the mean specimen.
    precisions : (4,) array
        Of the bends of each part.
    noise : float
        Variance of the residuals in units of the one assumed, counted in independent pieces.
    mean_covariance : (2 + q, 2 + q) array
        Of the mean specimen's stiffness and damping, and of the shared coordinates.
    known : mapping of str to Known
        What the records say of each curve.
    log_evidence : float
        Logarithm of the evidence without that of the noise, of one kind of roughness against another.
    is_settled : bool
        Whether the steps came to rest.
    beyond : mapping of str to ((n,) array, (n,) array)
        Displacements or velocities, and what a curve has there beyond the one of its nodes [N], which bends no faster
        than they allow.
    """

    tabulated: Tabulated
    fit: Fit
    precisions: FloatArray
    noise: float
    mean_covariance: FloatArray
    known: Mapping[str, Known]
    log_evidence: float
    is_settled: bool
    beyond: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Frame:
    """What is free in a fit: the directions (full, free) and the quadratic priors of these."""

    directions: FloatArray
    scatter: FloatArray
    parts: tuple[FloatArray, ...]
    loose: FloatArray
    active: Any
    own_columns: Mapping[str, slice]


def _frame(tabulated: Tabulated, count: int, nuisances: Sequence[int]) -> _Frame:
    """Return the free directions of ``count`` specimens."""
    q = tabulated.layout.free.size
    width = NUISANCES + q
    shared, own_columns = tabulated.free_basis()
    columns = [np.concatenate([direction, np.zeros(count * width)]) for direction in shared.T]
    is_scatter = [0.0] * len(columns)

    def own(values: FloatArray, place: Any) -> FloatArray:
        column = np.zeros((count, width))
        column[:, place] = values
        return np.concatenate([np.zeros(q), column.ravel()])

    for n in nuisances:
        for r in range(count):
            columns.append(own(np.eye(count)[r], n))
            is_scatter.append(float(n >= DRIFTS[0]))
    if count > 1:
        for place in tabulated.named:
            for r in range(count):
                columns.append(own(np.eye(count)[r], NUISANCES + place))
                is_scatter.append(1.0)
        # sizes that add up to nothing: the curves are those of the mean specimen
        sizes = np.linalg.svd(np.ones((1, count)))[2][1:]
        for effect in (STIFFNESS, DAMPING):
            places = tabulated.places(effect)
            for values in sizes:
                columns.append(own(values[:, None], NUISANCES + places))
                is_scatter.append(1.0)
    directions = np.array(columns).T
    parts, precision = [], _NAMED / tabulated.layout.width**2
    for part in tabulated.parts:
        precision[part.places] = tabulated.loose(part) / tabulated.scale**2
        rows = directions[part.places] / tabulated.scale
        parts.append(rows.T @ part.roughness @ rows)
    loose = (directions[:q] * precision[:, None]).T @ directions[:q]
    active = np.zeros(width, dtype=bool)
    active[list(nuisances)] = True
    active[NUISANCES:] = count > 1
    return _Frame(directions, np.array(is_scatter), tuple(parts), loose, active, own_columns)


def fit_curves(
    tabulated: Tabulated,
    terms: Sequence[DataTerm],
    state: State,
    *,
    nuisances: Sequence[int],
    precisions: FloatArray | None = None,
    is_learning: bool = True,
    iterations: int = 30,
    goal: float = 0.0,
) -> CurveFit | None:
    """Minimise from ``state``; None where it cannot be simulated.

    Parameters
    ----------
    tabulated : Tabulated
        The model.
    terms : sequence of DataTerm
        One per specimen.
    state : State
        Start.
    nuisances : sequence of int
        Which of the specimen's own values are fitted.
    precisions : (4,) array, optional
        Of the bends of each part, to begin with.
    is_learning : bool
        Whether they are inferred; else they are held.
    iterations : int
        At most.
    goal : float
        A chi-square that is low enough for what comes after.
    """
    frame = _frame(tabulated, len(terms), nuisances)
    levels = np.full(4, _FIRST) if precisions is None else np.array(precisions, dtype=np.float64)
    at = _evaluated(tabulated, terms, state, frame)
    if at is None:
        return None
    count = float(sum(term.size for term in terms))
    damping, is_settled, quiet = 1e-3, False, 0
    sizes: FloatArray | None = None
    for _ in range(iterations):
        weight = _weight(at, count, sizes)
        hessian, slope, cost = _objective(at, frame, levels, weight, tabulated)
        stepped = _stepped(tabulated, terms, at, frame, hessian, slope, damping)
        new_cost = np.inf if stepped is None else _objective(stepped, frame, levels, weight, tabulated)[2]
        if stepped is None or not new_cost <= cost + 1e-9:
            damping *= 6.0
            if damping > 1e9:
                is_settled = True
                break
            continue
        at, damping = stepped, max(damping / 8.0, 1e-9)
        gain = cost - new_cost
        changed = 0.0
        if is_learning:
            before = levels
            hessian, _, _ = _objective(at, frame, levels, _weight(at, count, sizes), tabulated)
            levels = _learnt(hessian, at, frame, levels, tabulated)
            moved = np.abs(np.log(levels / before))
            changed = float(np.where(levels < 0.9 * _SMOOTHEST, moved, 0.0).max())
        if float(at.system.chi_square.sum()) < goal:
            break
        is_small = gain < _AT_REST + 1e-5 * cost and changed < _SETTLED
        quiet = quiet + 1 if is_small else 0
        if is_small and sizes is None:
            sizes = _sizes(tabulated, terms, at)
        elif quiet >= 2:
            is_settled = True
            break
    return _finished(tabulated, terms, at, frame, levels, is_settled)


@dataclass(frozen=True, eq=False)
class _At:
    """A point with its normal equations."""

    state: State
    system: System


def _evaluated(tabulated: Tabulated, terms: Sequence[DataTerm], state: State, frame: _Frame) -> _At | None:
    scatter = tabulated.layout.scatter if len(terms) > 1 else 0.0
    system = linearise(tabulated.layout, terms, state, scatter, frame.active)
    return None if system is None else _At(state, system)


def _objective(
    at: _At, frame: _Frame, levels: FloatArray, weight: float, tabulated: Tabulated
) -> tuple[FloatArray, FloatArray, float]:
    """Return Hessian, downhill slope and value of the sum of squares with all priors."""
    system, state = at.system, at.state
    q, (count, width) = tabulated.layout.free.size, state.own.shape
    full = np.zeros((q + count * width,) * 2)
    slope = np.zeros(q + count * width)
    full[:q, :q], slope[:q] = system.shared, system.shared_gradient
    priors = np.flatnonzero(frame.active & (np.arange(width) >= DRIFTS[0]))
    for r in range(count):
        block = slice(q + r * width, q + (r + 1) * width)
        own, gradient = system.own[r].copy(), system.own_gradient[r].copy()
        own[priors, priors] -= 1.0  # what the joint fit takes for every coordinate; here a curve has one size
        gradient[priors] += state.own[r, priors]
        full[block, block], slope[block] = own, gradient
        full[:q, block], full[block, :q] = system.mixed[r], system.mixed[r].T
    directions = frame.directions
    prior = frame.loose + np.diag(frame.scatter)
    prior = prior + sum(level * part for level, part in zip(levels, frame.parts, strict=True))
    place = _place(at, frame)
    hessian = weight * (directions.T @ full @ directions) + prior
    downhill = weight * (directions.T @ slope) - prior @ place
    return hessian, downhill, weight * float(system.chi_square.sum()) + float(place @ prior @ place)


def _place(at: _At, frame: _Frame) -> FloatArray:
    """Return the free coordinates of a point; those of the specimens' own values are left at zero."""
    values = np.concatenate([at.state.eta, at.state.own.ravel()])
    place: FloatArray = np.linalg.lstsq(frame.directions, values, rcond=None)[0]
    return place


def _stepped(
    tabulated: Tabulated,
    terms: Sequence[DataTerm],
    at: _At,
    frame: _Frame,
    hessian: FloatArray,
    slope: FloatArray,
    damping: float,
) -> _At | None:
    """Return where a step leads; None where nothing can be simulated, or too far."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    scaled = hessian * np.outer(scale, scale) + damping * np.eye(slope.size)
    try:
        step = scale * np.linalg.solve(scaled, slope * scale)
    except np.linalg.LinAlgError:
        return None
    moved = frame.directions @ step
    q = tabulated.layout.free.size
    eta, own = at.state.eta + moved[:q], at.state.own + moved[q:].reshape(at.state.own.shape)
    named = tabulated.named
    eta[named] = np.clip(eta[named], tabulated.layout.low[named], tabulated.layout.high[named])
    if not (np.isfinite(eta).all() and np.isfinite(own).all()):
        return None
    before = at.state.own[:, (0, 2)]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(before == 0.0, 1.0, own[:, (0, 2)] / before)
    if not np.all((ratio > 1.0 / _LONGEST) & (ratio < _LONGEST)):
        return None
    return _evaluated(tabulated, terms, State(eta, own), frame)


def _weight(at: _At, count: float, sizes: FloatArray | None) -> float:
    """Return the factor of chi-square: the noise is what the residuals show, counted in independent pieces."""
    left = float(at.system.chi_square.sum())
    return min((count if sizes is None else float(sizes.sum())) / max(left, 1e-300), 1.0)


def _sizes(tabulated: Tabulated, terms: Sequence[DataTerm], at: _At) -> FloatArray:
    """Return the number of independent pieces in the residuals of each specimen."""
    found = _as_fit(tabulated, at, np.zeros((0, 0)), at.system.chi_square.size)
    return np.array([effective_size(term, found, r) for r, term in enumerate(terms)])


def _learnt(hessian: FloatArray, at: _At, frame: _Frame, levels: FloatArray, tabulated: Tabulated) -> FloatArray:
    """Return the precisions at which the evidence is larger, by the update of Wood and Fasiolo [1]_.

    References
    ----------
    .. [1] Wood S. N., Fasiolo M. (2017) A generalized Fellner-Schall method for smoothing parameter optimization.
       Biometrics 73(4), 1071-1081. doi:10.1111/biom.12666
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    covariance = np.linalg.pinv(hessian * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    new = levels.copy()
    for k, part in enumerate(tabulated.parts):
        node_forces = at.state.eta[part.places] / tabulated.scale
        bend = float(node_forces @ part.roughness @ node_forces)
        known = part.rank - levels[k] * float((covariance * frame.parts[k]).sum())
        ratio = max(known, 1e-6 * part.rank) / max(levels[k] * bend, 1e-300)
        new[k] = np.clip(levels[k] * np.clip(ratio, 1.0 / _FASTEST, _FASTEST), _ROUGHEST, _SMOOTHEST)
    return new


def _as_fit(tabulated: Tabulated, at: _At, covariance: FloatArray, count: int) -> Fit:
    width = at.state.own.shape[1]
    active = np.zeros(width, dtype=bool)
    active[:5] = True
    active[NUISANCES:] = count > 1
    return Fit(
        tabulated.layout, at.state, at.system.chi_square, 0.0, np.nan, covariance,
        np.full((at.state.own.shape[0], NUISANCES), np.nan), True, at.system, active,
    )  # fmt: skip


def _finished(
    tabulated: Tabulated, terms: Sequence[DataTerm], at: _At, frame: _Frame, levels: FloatArray, is_settled: bool
) -> CurveFit:
    """Return the minimum with the covariance of the mean specimen."""
    sizes = _sizes(tabulated, terms, at)
    weight = _weight(at, float(sizes.sum()), None)
    hessian, downhill, cost = _objective(at, frame, levels, weight, tabulated)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    scaled = hessian * np.outer(scale, scale)
    covariance = np.linalg.pinv(scaled, hermitian=True) * np.outer(scale, scale)
    curves = max(columns.stop for columns in frame.own_columns.values())
    prior = frame.loose + sum(level * part for level, part in zip(levels, frame.parts, strict=True))
    log_evidence = 0.5 * float(
        np.linalg.slogdet(prior[:curves, :curves])[1]
        - np.linalg.slogdet(scaled)[1] + 2.0 * np.log(scale).sum() - cost
    )  # fmt: skip
    q, (count, width) = tabulated.layout.free.size, at.state.own.shape
    mean = np.zeros((2 + q, frame.directions.shape[0]))
    for n in (0, 1):
        mean[n, q + n + width * np.arange(count)] = 1.0 / count
    mean[2:, :q] = np.eye(q)
    along = mean @ frame.directions
    whole = along @ covariance @ along.T
    known = {
        effect: _known(tabulated, at, frame, (hessian, downhill), prior, along, effect)
        for effect in (STIFFNESS, DAMPING)
    }
    found = replace(_as_fit(tabulated, at, whole[2:, 2:], count), is_converged=is_settled)
    penalty = float((_place(at, frame) ** 2 * frame.scatter).sum())
    return CurveFit(
        tabulated, replace(found, penalty=penalty), levels, 1.0 / weight, whole, known, log_evidence, is_settled
    )


def _known(
    tabulated: Tabulated,
    at: _At,
    frame: _Frame,
    objective: tuple[FloatArray, FloatArray],
    prior: FloatArray,
    along: FloatArray,
    effect: str,
) -> Known:
    """Return what the records say of one curve: its own prior is taken off, and all else eliminated.

    ``objective`` is the Hessian and the downhill slope. A fit that has settled is at its minimum to a share of an error
    only, and the precisions of the bends have moved since. Times the precision of a part that went to nothing even that
    is more than the records say, so that the slope that is left belongs to it.
    """
    hessian, downhill = objective
    mine = np.zeros(hessian.shape[0], dtype=bool)
    mine[frame.own_columns[effect]] = True
    rest, cross = hessian[np.ix_(~mine, ~mine)], hessian[np.ix_(~mine, mine)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(rest), 1e-300))
    scaled = rest * np.outer(scale, scale)
    within = np.linalg.lstsq(scaled, cross * scale[:, None], rcond=1e-13)[0]
    own = prior[np.ix_(mine, mine)]
    precision = hessian[np.ix_(mine, mine)] - own - (cross * scale[:, None]).T @ within
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.T))
    precision = (vectors * np.maximum(values, 0.0)) @ vectors.T
    place = _place(at, frame)[mine]
    nodes = frame.directions[: tabulated.layout.free.size][np.ix_(tabulated.places(effect), mine)]
    scaled_along = along[:, ~mine] * scale
    follows = along[:, mine] - scaled_along @ within
    left = scaled_along[:2] @ np.linalg.lstsq(scaled, scaled_along[:2].T, rcond=1e-13)[0]
    pull = (precision + own) @ place + downhill[mine] - within.T @ (downhill[~mine] * scale)
    return Known(nodes, precision, own, pull, follows, left)
