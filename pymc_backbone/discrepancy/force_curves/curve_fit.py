"""Both curves fitted to all specimens together with what is named, their smoothness inferred.

How wide the priors of the bends are follows from the evidence (Wood and Fasiolo's update); a part that the records do
not ask for goes to nothing. The sum of squares is minimised by Levenberg-Marquardt in one dense system.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..._common.checks import FloatArray
from ..._common.unit_diagonal import unit_diagonal
from ..fitting.data_term import DataTerm
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import NUISANCES, State
from ..weighing.evidence import effective_size
from .curve_known import Known, known_of
from .curve_system import At, Frame, evaluated, frame_of, objective, place_of, weight_of
from .tabulated import DAMPING, STIFFNESS, Tabulated

_FIRST = 1e2  # precision of a bend at first: second derivatives of a tenth of the scale over the range
_ROUGHEST, _SMOOTHEST = 1e-4, 1e9
_FASTEST = 30.0  # factor by which a precision changes between two steps
_NAMED = 1e-4  # of what is named, in units of its prior
_LONGEST = 3.0  # factor by which a step may change stiffness and release
_AT_REST = 0.05  # fall of the sum of squares from which on steps are small
_SETTLED = 0.1  # relative change of a precision that matters no more
_FAR, _HARDLY = 0.1, 0.002  # weight of what is far from noise, and the share below which its gains are none


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
    frame = frame_of(tabulated, len(terms), nuisances)
    levels = np.full(4, _FIRST) if precisions is None else np.array(precisions, dtype=np.float64)
    at = evaluated(tabulated, terms, state, frame)
    if at is None:
        return None
    count = float(sum(term.size for term in terms))
    damping, is_settled, quiet, idle = 1e-3, False, 0, 0
    sizes: FloatArray | None = None
    for _ in range(iterations):
        weight = weight_of(at, count, sizes)
        hessian, slope, cost = objective(at, frame, levels, weight, tabulated)
        stepped = _stepped(tabulated, terms, at, frame, hessian, slope, damping)
        new_cost = np.inf if stepped is None else objective(stepped, frame, levels, weight, tabulated)[2]
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
            hessian, _, _ = objective(at, frame, levels, weight_of(at, count, sizes), tabulated)
            levels = _learnt(hessian, at, frame, levels, tabulated)
            moved = np.abs(np.log(levels / before))
            changed = float(np.where(levels < 0.9 * _SMOOTHEST, moved, 0.0).max())
        if float(at.system.chi_square.sum()) < goal:
            break
        idle = idle + 1 if weight < _FAR and gain < _HARDLY * cost else 0
        if idle >= 2:
            break  # what no curve follows is no better known by what comes after
        is_small = gain < _AT_REST + 1e-5 * cost and changed < _SETTLED
        quiet = quiet + 1 if is_small else 0
        if is_small and sizes is None:
            sizes = _sizes(tabulated, terms, at)
        elif quiet >= 2:
            is_settled = True
            break
    return _finished(tabulated, terms, at, frame, levels, is_settled)


def _stepped(
    tabulated: Tabulated,
    terms: Sequence[DataTerm],
    at: At,
    frame: Frame,
    hessian: FloatArray,
    slope: FloatArray,
    damping: float,
) -> At | None:
    """Return where a step leads; None where nothing can be simulated, or too far."""
    try:
        step = unit_diagonal(hessian, damping).solve(slope)
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
    return evaluated(tabulated, terms, State(eta, own), frame)


def _sizes(tabulated: Tabulated, terms: Sequence[DataTerm], at: At) -> FloatArray:
    """Return the number of independent pieces in the residuals of each specimen."""
    found = _as_fit(tabulated, at, np.zeros((0, 0)), at.system.chi_square.size)
    return np.array([effective_size(term, found, r) for r, term in enumerate(terms)])


def _learnt(hessian: FloatArray, at: At, frame: Frame, levels: FloatArray, tabulated: Tabulated) -> FloatArray:
    """Return the precisions at which the evidence is larger, by the update of Wood and Fasiolo [1]_.

    References
    ----------
    .. [1] Wood S. N., Fasiolo M. (2017) A generalized Fellner-Schall method for smoothing parameter optimization.
       Biometrics 73(4), 1071-1081. doi:10.1111/biom.12666
    """
    known = unit_diagonal(hessian)
    covariance = known.scaled(np.linalg.pinv(known.matrix, hermitian=True))
    new = levels.copy()
    for k, part in enumerate(tabulated.parts):
        node_forces = at.state.eta[part.places] / tabulated.scale
        bend = float(node_forces @ part.roughness @ node_forces)
        told = part.rank - levels[k] * float((covariance * frame.parts[k]).sum())
        ratio = max(told, 1e-6 * part.rank) / max(levels[k] * bend, 1e-300)
        new[k] = np.clip(levels[k] * np.clip(ratio, 1.0 / _FASTEST, _FASTEST), _ROUGHEST, _SMOOTHEST)
    return new


def _as_fit(tabulated: Tabulated, at: At, covariance: FloatArray, count: int) -> Fit:
    width = at.state.own.shape[1]
    active = np.zeros(width, dtype=bool)
    active[:5] = True
    active[NUISANCES:] = count > 1
    return Fit(
        tabulated.layout, at.state, at.system.chi_square, 0.0, covariance,
        np.full((at.state.own.shape[0], NUISANCES), np.nan), True, at.system, active,
    )  # fmt: skip


def _finished(
    tabulated: Tabulated, terms: Sequence[DataTerm], at: At, frame: Frame, levels: FloatArray, is_settled: bool
) -> CurveFit:
    """Return the minimum with the covariance of the mean specimen."""
    sizes = _sizes(tabulated, terms, at)
    weight = weight_of(at, float(sizes.sum()), None)
    hessian, downhill, cost = objective(at, frame, levels, weight, tabulated)
    known = unit_diagonal(hessian)
    covariance = known.scaled(np.linalg.pinv(known.matrix, hermitian=True))
    curves = max(columns.stop for columns in frame.own_columns.values())
    prior = frame.prior(levels)
    log_evidence = 0.5 * float(np.linalg.slogdet(prior[:curves, :curves])[1] - known.log_determinant() - cost)
    q, (count, width) = tabulated.layout.free.size, at.state.own.shape
    mean = np.zeros((2 + q, frame.directions.shape[0]))
    for n in (0, 1):
        mean[n, q + n + width * np.arange(count)] = 1.0 / count
    mean[2:, :q] = np.eye(q)
    along = mean @ frame.directions
    whole = along @ covariance @ along.T
    told = {
        effect: known_of(tabulated, at, frame, (hessian, downhill), prior, along, effect)
        for effect in (STIFFNESS, DAMPING)
    }
    found = replace(_as_fit(tabulated, at, whole[2:, 2:], count), is_converged=is_settled)
    penalty = float((place_of(at, frame) ** 2 * frame.scatter).sum())
    return CurveFit(
        tabulated, replace(found, penalty=penalty), levels, 1.0 / weight, whole, told, log_evidence, is_settled
    )
