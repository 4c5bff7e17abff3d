"""One model fitted to all specimens at once: effects shared up to a scatter, stiffness, damping and release of its own.

Specimen r has parameters ``k_r, c_r``, the effects' ``eta_j (1 + tau delta_rj)``, release amplitude, release instant
and offset of the sensor. ``delta`` is standard normal, so that specimens are alike but not equal. The sum of squares is
minimised by Levenberg-Marquardt; as specimens share ``eta`` only, each step costs one small system per specimen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..._common.checks import FloatArray
from ..._common.unit_diagonal import unit_diagonal
from .data_term import DataTerm
from .layout import Layout
from .limits import MOST_SCATTER, is_trusted, leans, reached_from, within
from .normal_equations import (
    DRIFTS,
    NUISANCES,
    State,
    System,
    eliminate,
    information,
    linearise,
    parameters_at,
    prior_width,
    symmetric,
)
from .scatter import NO_SCATTER, Scatter, infer_scatter

_RIDGE = 1e-12  # on the diagonal of ones of the shared system
_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8
_UNDAMPED = 1e-2  # damping up to which a step that promises next to nothing means rest
_CONVERGED = 0.01
_RACE, _LONG_RACE, _RACE_MARGIN = 6, 25, 60.0
_AT_REST = 50.0  # fall of the cost that one more step promises, up to which it says what a fit at rest would


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum of the joint fit.

    Attributes
    ----------
    state : State
        Where.
    chi_square : (r,) array
        Sum of squared residuals per specimen.
    penalty : float
        Sum of squared deltas.
    covariance : (q, q) array
        Of the shared coordinates.
    own_covariance : (r, 7) array
        Variances of each specimen's own values, the shared ones held; NaN where not fitted.
    is_converged : bool
        Whether the fit came to rest.
    system : System
        Normal equations there.
    active : (7 + q,) array of bool
        Which of a specimen's own values were fitted.
    evaluations : int
        How often the specimens were simulated.
    """

    layout: Layout
    state: State
    chi_square: FloatArray
    penalty: float
    covariance: FloatArray
    own_covariance: FloatArray
    is_converged: bool
    system: System
    active: Any
    evaluations: int = 0

    @property
    def cost(self) -> float:
        """Return the sum of squares that was minimised."""
        return float(self.chi_square.sum() + self.penalty)

    @property
    def centre(self) -> FloatArray:
        """The shared coordinates (q,) in the middle of those of the specimens: what one more would be expected to have.

        The shared values of the fit itself are a little above it, because a scatter in proportion to them is cheaper.
        """
        if not self.active[NUISANCES:].any():
            return self.state.eta
        factors = 1.0 + self.layout.scatter * self.state.own[:, NUISANCES:]
        middle: FloatArray = np.clip(self.state.eta * factors, self.layout.low, self.layout.high).mean(axis=0)
        return middle

    @cached_property
    def scatter(self) -> Scatter:
        """What the specimens say about the scatter of the effects, by Laplace's method around this fit.

        Nothing where the fit is not at a minimum: what one step promises from there is no likelihood.
        """
        if not self.active[NUISANCES:].any():
            return NO_SCATTER
        stepped = _stepped(self, 1.0)
        if stepped is None or not self.cost - stepped.cost < _AT_REST:
            return NO_SCATTER
        assumed = self.layout.scatter
        return infer_scatter(lambda width: _log_likelihood(self, width / assumed), assumed)

    @cached_property
    def population_covariance(self) -> FloatArray:
        """Covariance (q, q) of the shared coordinates where specimens scatter as inferred, not as assumed.

        Over the posterior of the scatter, by its median and its 5 % and 95 % points. Where nothing is known of the
        scatter, the covariance of the fit.
        """
        if not np.isfinite(self.scatter.value):
            return self.covariance
        total = np.zeros_like(self.covariance)
        for weight, scatter in self.scatter.points:
            moved, _ = _with_width(self, scatter / self.layout.scatter)
            total += weight * information(self.layout, moved, self.state, self.active, 1.0)[1]
        return total if np.isfinite(total).all() else self.covariance

    def parameters(self, specimen: int) -> FloatArray:
        """Return the full parameter vector of one specimen."""
        return parameters_of(self.layout, self.state, specimen)

    def value_of(self, parameter: str) -> float:
        """Return one parameter of the first specimen."""
        names = [item.name for item in self.layout.oscillator.parameters]
        return float(self.parameters(0)[names.index(parameter)])


def parameters_of(layout: Layout, state: State, specimen: int) -> FloatArray:
    """Return the full parameter vector of one specimen at a point of the fit."""
    return parameters_at(layout, state.eta, state.own[specimen], layout.scatter)[0]


def fit(
    layout: Layout,
    terms: Sequence[DataTerm],
    state: State,
    *,
    iterations: int = 30,
    nuisances: Sequence[int] = (0, 1, 2, 3, 4),
    has_scatter: bool = True,
    tolerance: float = _CONVERGED,
    rival: float | None = None,
    goal: float = 0.0,
) -> Fit | None:
    """Minimise the sum of squares from ``state``; None where the start cannot be simulated.

    Parameters
    ----------
    layout : Layout
        The model.
    terms : sequence of DataTerm
        One per specimen.
    state : State
        Start.
    iterations : int
        At most.
    nuisances : sequence of int
        Which of the specimen's own values are fitted.
    has_scatter : bool
        Whether specimens may scatter.
    tolerance : float
        A decrease of the cost below this ends the fit.
    rival : float, optional
        A cost that another model reached: what is far above it and hardly falls is given up.
    goal : float
        A cost that is low enough for what comes after: the fit ends below it, not at rest.
    """
    q = layout.free.size
    scatter = layout.scatter if has_scatter and len(terms) > 1 else 0.0
    active = np.zeros(NUISANCES + q, dtype=bool)
    active[list(nuisances)] = True
    active[NUISANCES:] = scatter > 0.0
    state = within(layout, State(layout.within(state.eta), state.own.copy()), scatter)
    system = linearise(layout, terms, state, scatter, active)
    if system is None:
        return None
    damping, converged, quiet = _FIRST_DAMPING, False, 0
    past, evaluations = [system.cost], 1
    for _ in range(iterations if system.cost > goal else 0):
        limit = tolerance + 1e-6 * system.cost
        tried = _tried(layout, terms, state, system, active, damping, scatter, 0.1 * limit)
        evaluations += tried.evaluations
        proposal, accepted = tried.state, tried.system
        if tried.is_still:
            converged = True
            break
        if accepted is not None and accepted.cost < system.cost + 1e-9:
            gain = system.cost - accepted.cost
            state, system = proposal, accepted
            damping = max(damping / 8.0, 1e-9)
            quiet = quiet + 1 if gain < limit else 0
            if gain < 0.1 * limit or quiet >= 2:
                converged = True
                break
            if system.cost < goal:
                break
            past.append(system.cost)
            if rival is not None and len(past) > _RACE:
                ahead = system.cost - rival - _RACE_MARGIN
                is_slow = past[-4] - past[-1] < 0.2 * ahead or len(past) > _LONG_RACE
                if ahead > 0.0 and is_slow:
                    break
        else:
            damping *= 6.0
            if damping > _LARGEST_DAMPING:
                converged = True
                break
    return replace(_finish(layout, system, state, active, converged), evaluations=evaluations)


class _Tried(NamedTuple):
    """Where a step of the fit leads, the normal equations there (None where it leads nowhere), and what it cost.

    Where the linear step promises next to nothing, nothing was simulated: the fit ``is_still``.
    """

    state: State
    system: System | None
    evaluations: int
    is_still: bool = False


def _tried(
    layout: Layout, terms: Sequence[DataTerm], state: State, system: System, active: Any, damping: float,
    scatter: float, least: float,
) -> _Tried:  # fmt: skip
    """Return where the step with this damping leads, limits and valleys minded; not where it promises too little."""
    step = _step(layout, system, state, active, damping, scatter)
    if step is None:
        return _Tried(state, None, 0)
    linear = State(layout.within(state.eta + step[0]), state.own + step[1])
    proposal = reached_from(layout, state, linear, scatter)
    if not np.isfinite(proposal.own).all() or not is_trusted(state, proposal):
        return _Tried(state, None, 0)
    # at a limit derivatives hold on one side only
    is_free = bool(step[0][layout.low < layout.high].all() and step[1][:, active].all())
    if is_free and damping < _UNDAMPED and 0.0 <= _promised(system, state, linear) < least:
        return _Tried(state, None, 0, is_still=True)
    reached = linearise(layout, terms, proposal, scatter, active)
    if reached is None or reached.cost < system.cost or not layout.free.size:
        return _Tried(proposal, reached, 1)
    followed = _followed(proposal, reached, active)
    if followed is None or not is_trusted(state, followed):
        return _Tried(proposal, reached, 1)
    again = linearise(layout, terms, followed, scatter, active)
    if again is None or again.cost >= reached.cost:
        return _Tried(proposal, reached, 2)
    return _Tried(followed, again, 2)


def _promised(system: System, state: State, proposal: State) -> float:
    """Return by how much the cost falls from one point to another, if residuals are linear."""
    shared, own = proposal.eta - state.eta, proposal.own - state.own
    slope = float(system.shared_gradient @ shared + (system.own_gradient * own).sum())
    across = float(np.einsum("j,rji,ri->", shared, system.mixed, own))
    bend = float(shared @ system.shared @ shared + np.einsum("ri,rij,rj->", own, system.own, own)) + 2.0 * across
    return 2.0 * slope - bend


def _followed(state: State, system: System, active: Any) -> State | None:
    """Return a point with each specimen's stiffness, damping and release brought after the effects.

    Valleys are bent: a step that goes along one in the effects leaves it in the phase, and comes back by these alone.
    """
    index = np.flatnonzero(active[:NUISANCES])
    own = state.own.copy()
    for r in range(own.shape[0]):
        block, slope = system.own[r][np.ix_(index, index)], system.own_gradient[r, index]
        try:
            own[r, index] += unit_diagonal(block).solve(slope)
        except np.linalg.LinAlgError:
            return None
    own[:, 1] = np.maximum(own[:, 1], 0.0)
    return State(state.eta, own) if np.isfinite(own).all() else None


def _step(layout: Layout, system: System, state: State, active: Any, damping: float, scatter: float) -> Any:
    """Return the step of the shared and the own values, limits minded."""
    q = layout.free.size
    held = np.zeros((state.own.shape[0], NUISANCES + q), dtype=bool)
    held[:, 1] = (state.own[:, 1] <= 0.0) & (system.own_gradient[:, 1] < 0.0)
    held[:, DRIFTS[0] :] = leans(layout, state, system.own_gradient, scatter)[:, DRIFTS[0] :]
    eliminated = eliminate(system, active, damping, held)
    if eliminated is None:
        return None
    shared, gradient, solved = eliminated
    at_low = (state.eta <= layout.low) & (gradient < 0.0)
    at_high = (state.eta >= layout.high) & (gradient > 0.0)
    free = np.flatnonzero(~(at_low | at_high))
    step = np.zeros(q)
    if free.size:
        block = shared[np.ix_(free, free)]
        try:
            step[free] = unit_diagonal(block, _RIDGE).solve(gradient[free])
        except np.linalg.LinAlgError:
            return None
    own = np.zeros_like(state.own)
    for r, (index, scale, reduced, _) in enumerate(solved):
        own[r, index] = scale * (reduced[:, -1] - reduced[:, :-1] @ step)
    if not (np.isfinite(step).all() and np.isfinite(own).all()):
        return None
    return step, own


def _finish(layout: Layout, system: System, state: State, active: Any, converged: bool) -> Fit:
    """Return the fit with its information."""
    covariance = information(layout, system, state, active, 1.0)[1]
    own_covariance = np.full((state.own.shape[0], NUISANCES), np.nan)
    index = np.flatnonzero(active)
    for r in range(state.own.shape[0]):
        block = unit_diagonal(system.own[r][np.ix_(index, index)])
        inverse = block.scaled(np.linalg.pinv(block.matrix))
        for place, column in enumerate(index):
            if column < NUISANCES:
                own_covariance[r, column] = inverse[place, place]
    return Fit(
        layout, state, system.chi_square, system.penalty, covariance, own_covariance, converged,
        system=system, active=active,
    )  # fmt: skip


def _with_width(found: Fit, width: float) -> tuple[System, Any]:
    """Return the normal equations with a scatter ``width`` times that of the fit, and which own values scatter."""
    system, active = found.system, found.active
    free = active & (np.arange(active.size) >= NUISANCES)
    precision = width**-2.0 - 1.0  # more than the fit had
    delta = np.where(free, found.state.own, 0.0)
    moved = replace(
        system, own=system.own + precision * np.diag(free.astype(np.float64)),
        own_gradient=system.own_gradient - precision * delta,
        penalty=system.penalty + precision * float((delta**2).sum()),
    )  # fmt: skip
    return moved, free


class _Stepped(NamedTuple):
    """Sum of squares after a Newton step, and the logarithm of the determinant of the information there."""

    cost: float
    log_determinant: float


def _log_likelihood(found: Fit, width: float) -> float:
    """Return the logarithm of the likelihood with a scatter ``width`` times that of the fit, all else integrated out.

    The fit is not repeated: a Newton step says where it would end, and its decrease is that of the sum of squares.
    """
    stepped = _stepped(found, width)
    return -np.inf if stepped is None else -0.5 * (stepped.cost + stepped.log_determinant)


def _stepped(found: Fit, width: float) -> _Stepped | None:
    """Return what a Newton step with a scatter ``width`` times that of the fit leads to; None where there is none.

    Specimens do not go beyond the most that a fit lets them differ from the shared values: what lies there is unknown.
    """
    system, state, layout, active = found.system, found.state, found.layout, found.active
    moved, free = _with_width(found, width)
    held = np.zeros(state.own.shape, dtype=bool)
    held[:, 1] = state.own[:, 1] <= 0.0
    held[:, DRIFTS[0] :] = leans(layout, state, system.own_gradient, layout.scatter)[:, DRIFTS[0] :]
    eliminated = eliminate(moved, active, 0.0, held)
    if eliminated is None:
        return None
    shared, gradient, solved = eliminated
    inside = (state.eta > layout.low) & (state.eta < layout.high)
    widths = prior_width(layout, state.eta, np.sqrt(np.maximum(np.diag(found.covariance), 0.0)))[inside]
    scaled = np.eye(widths.size) + symmetric(shared[np.ix_(inside, inside)]) * np.outer(widths, widths)
    pull = gradient[inside] * widths
    try:
        cost = moved.cost - float(pull @ np.linalg.solve(scaled, pull))
    except np.linalg.LinAlgError:
        return None
    for r, (index, scale, reduced, _) in enumerate(solved):
        cost -= float((moved.own_gradient[r, index] * scale) @ reduced[:, -1])
    determinant = sum(item[3] for item in solved) + np.linalg.slogdet(scaled)[1]
    # at a parameter's limit lies half of any prior; elsewhere its density falls with the width
    at_limit = held[:, free] & (np.abs(state.own[:, free]) < MOST_SCATTER - 1e-9)
    determinant += 2.0 * np.count_nonzero(~at_limit) * np.log(width)
    return _Stepped(float(cost), float(determinant))
