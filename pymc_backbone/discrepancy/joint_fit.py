"""One model fitted to all specimens at once: effects shared up to a scatter, stiffness, damping and release of its own.

Specimen r has parameters ``k_r, c_r``, the effects' ``eta_j (1 + tau delta_rj)``, release amplitude, release instant
and offset of the sensor. ``delta`` is standard normal, so that specimens are alike but not equal. The sum of squares is
minimised by Levenberg-Marquardt; as specimens share ``eta`` only, each step costs one small system per specimen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._checks import FloatArray
from ..decay import Simulator
from ..effects import BASE_EFFECTS
from ..oscillator import Oscillator
from .witness import Witness

SCATTER = 0.1
"""Scatter of an effect's parameters between specimens, relative to their value."""
NUISANCES = 7  # stiffness, damping, release amplitude, release instant, offset, drift of frequency, of damping
DRIFTS = (5, 6)
_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8
_CONVERGED = 0.01
_BOX = 4.0
_STIFFEST = 0.003  # slip displacement over amplitude
_SOFTEST = {True: 10.0, False: 1.5}  # of a bed of sliders, and of one, which is a plain spring beyond
_MOST_SCATTER = 6.0  # standard deviations: an effect neither vanishes nor turns around in one specimen
_RACE, _LONG_RACE, _RACE_MARGIN = 6, 25, 60.0


@dataclass(frozen=True, eq=False)
class Layout:
    """Which parameters of an oscillator are fitted, and in which coordinates.

    Two kinds of parameters are not fitted as they stand. One whose unit holds another one as exponent (``1/m^n``) is
    fitted as its value at the amplitude of the records, or it would change by orders of magnitude with the exponent.
    A slider's stiffness is replaced by the displacement at which it slips over the amplitude, so that the stiffer
    slider and dry friction are neighbours: at zero, not at infinity.

    Attributes
    ----------
    oscillator : Oscillator
        Mass and effects.
    simulator : Simulator
        The same, ready to run.
    free : (q,) array of int
        Places in the parameter vector of the effects' fitted parameters.
    template : (p,) array
        Parameter vector with redundant parameters at their values.
    low, high : (q,) arrays
        Limits of the coordinates.
    width : (q,) array
        Standard deviation of the prior of the coordinates, from the default bounds.
    is_strength : (q,) array of bool
        Whether a coordinate is the strength of its effect: the effect is gone at zero.
    powers : tuple of (int, int)
        Coordinates in units of amplitude, and the exponents they go with.
    slips : tuple of (int, int)
        Stiffness and force of each slider: the coordinates hold the force, then the relative slip displacement.
    opposed : tuple of (int, int)
        Coordinates that are not below minus another one.
    amplitude : float
        Typical amplitude [m or rad].
    names : tuple of str
        Parameters behind the coordinates.
    """

    oscillator: Oscillator
    simulator: Simulator
    free: Any
    template: FloatArray
    low: FloatArray
    high: FloatArray
    width: FloatArray
    is_strength: Any
    powers: tuple[tuple[int, int], ...]
    slips: tuple[tuple[int, int], ...]
    opposed: tuple[tuple[int, int], ...]
    amplitude: float
    names: tuple[str, ...]

    def physical(self, eta: FloatArray, delta: FloatArray, scatter: float) -> tuple[FloatArray, FloatArray]:
        """Return effect parameters (q,) of a specimen, and their derivatives (q, q) to its own coordinates."""
        own = np.clip(eta * (1.0 + scatter * delta), self.low, self.high)
        values, slopes = own.copy(), np.eye(own.size)
        base = np.eye(own.size)
        for j, other in self.opposed:
            if own[j] < -own[other]:
                own[j] = -own[other]
                base[j, j], base[j, other] = 0.0, -1.0
        values = own.copy()
        for j, exponent in self.powers:
            factor = self.amplitude ** -own[exponent]
            values[j] = own[j] * factor
            slopes[j, j] = factor
            slopes[j, exponent] = -values[j] * np.log(self.amplitude)
        for stiffness, force in self.slips:
            reach = own[force] * self.amplitude
            values[stiffness], values[force] = own[stiffness] / reach, own[stiffness]
            slopes[stiffness, stiffness], slopes[stiffness, force] = 1.0 / reach, -values[stiffness] / own[force]
            slopes[force, stiffness], slopes[force, force] = 1.0, 0.0
        return values, slopes @ base

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Return the coordinates of physical values of the free parameters."""
        eta = np.array(values, dtype=np.float64)
        for j, exponent in self.powers:
            eta[j] = values[j] * self.amplitude ** values[exponent]
        for stiffness, force in self.slips:
            eta[stiffness] = values[force]
            eta[force] = values[force] / max(values[stiffness], 1e-300) / self.amplitude
        return np.clip(eta, self.low, self.high)


def make_layout(oscillator: Oscillator, amplitude: float, angular_frequency: float) -> Layout:
    """Return the layout of an oscillator for records of this amplitude and frequency."""
    bounds = oscillator.default_bounds(amplitude, angular_frequency)
    template = np.zeros(len(oscillator.parameter_names))
    free: list[int] = []
    rows: list[tuple[float, float, float, bool]] = []
    powers, slips, opposed = [], [], []
    for effect in oscillator.effects:
        start = oscillator.slices[effect.name].start
        held = dict(effect.redundant)
        for offset, parameter in enumerate(effect.parameters):
            if parameter.name in held:
                template[start + offset] = held[parameter.name]
        if effect.name in BASE_EFFECTS:
            continue
        kept = [q for q in effect.parameters if q.name not in held]
        first = len(free)
        place = {q.name: first + j for j, q in enumerate(kept)}
        for j, parameter in enumerate(kept):
            lower, upper = bounds[parameter.name]
            exponent = next((q.name for q in kept if parameter.unit.endswith(f"^{q.latex}")), None)
            if exponent is not None:  # bounds are those at an exponent of 1
                lower, upper = lower * amplitude, upper * amplitude
                powers.append((first + j, place[exponent]))
            # what has no unit is a shape with limits of its own; the rest may leave the default bounds
            grow = 0.0 if parameter.unit == "-" else _BOX * (upper - lower)
            low, high = max(parameter.minimum, lower - grow), min(parameter.maximum, upper + grow)
            rows.append((low, high, (upper - lower) / np.sqrt(12.0), j == 0))
            free.append(start + list(effect.parameters).index(parameter))
        opposed += [(place[one], place[other]) for one, other in effect.opposed if {one, other} <= set(place)]
        units = [q.unit for q in kept]
        if units[:2] in (["N/m", "N"], ["N m/rad", "N m"]):
            slips.append((first, first + 1))
            rows[first] = (0.0, rows[first + 1][1], rows[first + 1][2], True)
            rows[first + 1] = (_STIFFEST, _SOFTEST[len(kept) > 2], 1.0 / np.sqrt(12.0), False)
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return Layout(
        oscillator, Simulator(oscillator), np.array(free, dtype=np.int64), template, table[:, 0].copy(),
        table[:, 1].copy(), table[:, 2].copy(), table[:, 3] > 0.0, tuple(powers), tuple(slips), tuple(opposed),
        amplitude, tuple(oscillator.parameter_names[i] for i in free),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class State:
    """A point of the joint fit.

    Attributes
    ----------
    eta : (q,) array
        Shared coordinates of the effects.
    own : (r, 7 + q) array
        Per specimen: stiffness, damping, release amplitude, release instant, offset, drifts, delta.
    """

    eta: FloatArray
    own: FloatArray


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
    log_determinant : float
        Of the information on all fitted values, the shared ones scaled with their priors.
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
    log_determinant: float
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

    def parameters(self, specimen: int) -> FloatArray:
        """Return the full parameter vector of one specimen."""
        return parameters_of(self.layout, self.state, specimen)


def parameters_of(layout: Layout, state: State, specimen: int) -> FloatArray:
    """Return the full parameter vector of one specimen at a point of the fit."""
    own = state.own[specimen]
    vector = layout.template.copy()
    vector[:2] = own[:2]
    vector[layout.free] = layout.physical(state.eta, own[NUISANCES:], SCATTER)[0]
    return vector


def fit(
    layout: Layout,
    witnesses: Sequence[Witness],
    state: State,
    *,
    iterations: int = 30,
    nuisances: Sequence[int] = (0, 1, 2, 3, 4),
    has_scatter: bool = True,
    tolerance: float = _CONVERGED,
    rival: float | None = None,
) -> Fit | None:
    """Minimise the sum of squares from ``state``; None where the start cannot be simulated.

    Parameters
    ----------
    layout : Layout
        The model.
    witnesses : sequence of Witness
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
    """
    q = layout.free.size
    scatter = SCATTER if has_scatter and len(witnesses) > 1 else 0.0
    active = np.zeros(NUISANCES + q, dtype=bool)
    active[list(nuisances)] = True
    active[NUISANCES:] = scatter > 0.0
    state = State(np.clip(state.eta, layout.low, layout.high), state.own.copy())
    system = linearise(layout, witnesses, state, scatter, active)
    if system is None:
        return None
    damping, converged, quiet = _FIRST_DAMPING, False, 0
    past, evaluations = [system.cost], 1
    for _ in range(iterations):
        step = _step(layout, system, state, active, damping)
        accepted = None
        if step is not None:
            proposal = State(np.clip(state.eta + step[0], layout.low, layout.high), state.own + step[1])
            proposal.own[:, 1] = np.maximum(proposal.own[:, 1], 0.0)
            np.clip(proposal.own[:, DRIFTS[0] :], -_MOST_SCATTER, _MOST_SCATTER, out=proposal.own[:, DRIFTS[0] :])
            if scatter > 0.0:
                proposal = _recentred(layout, proposal, scatter)
            if np.all(proposal.own[:, 0] > 0.0) and np.isfinite(proposal.own).all():
                accepted = linearise(layout, witnesses, proposal, scatter, active)
                evaluations += 1
        if accepted is not None and accepted.cost < system.cost + 1e-9:
            gain = system.cost - accepted.cost
            state, system = proposal, accepted
            damping = max(damping / 8.0, 1e-9)
            limit = tolerance + 1e-6 * system.cost
            quiet = quiet + 1 if gain < limit else 0
            if gain < 0.1 * limit or quiet >= 2:
                converged = True
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


def _recentred(layout: Layout, state: State, scatter: float) -> State:
    """Return the same parameters of every specimen with the shared values in their middle.

    Where scatter has the same sign in all specimens, it belongs to the shared value. Without this a fit could lean on
    a limit with every specimen and find no way back.
    """
    values = np.clip(state.eta * (1.0 + scatter * state.own[:, NUISANCES:]), layout.low, layout.high)
    eta = values.mean(axis=0)
    own = state.own.copy()
    usable = eta != 0.0
    own[:, NUISANCES:] = np.where(usable, (values / np.where(usable, eta, 1.0) - 1.0) / scatter, own[:, NUISANCES:])
    np.clip(own[:, NUISANCES:], -_MOST_SCATTER, _MOST_SCATTER, out=own[:, NUISANCES:])
    return State(eta, own)


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations at a point: cost, gradients and information, shared and per specimen."""

    chi_square: FloatArray
    penalty: float
    shared_gradient: FloatArray
    shared: FloatArray
    mixed: FloatArray
    own: FloatArray
    own_gradient: FloatArray

    @property
    def cost(self) -> float:
        """Return the sum of squares at the point."""
        return float(self.chi_square.sum() + self.penalty)


def linearise(
    layout: Layout, witnesses: Sequence[Witness], state: State, scatter: float, active: Any
) -> System | None:
    """Return the normal equations at a point, or None where it cannot be simulated."""
    q, count = layout.free.size, len(witnesses)
    size = NUISANCES + q
    shared, shared_gradient = np.zeros((q, q)), np.zeros(q)
    mixed, own = np.zeros((count, q, size)), np.zeros((count, size, size))
    own_gradient, chi_square = np.zeros((count, size)), np.zeros(count)
    for r, witness in enumerate(witnesses):
        values = state.own[r]
        delta = values[NUISANCES:]
        effects, slopes = layout.physical(state.eta, delta, scatter)
        vector = layout.template.copy()
        vector[:2] = values[:2]
        vector[layout.free] = effects
        compared = witness.compare(layout.simulator, vector, values[2:NUISANCES])
        if compared is None:
            return None
        residuals, jacobian = compared
        p = vector.size
        to_effects = jacobian[:, layout.free] @ slopes
        to_shared = to_effects * (1.0 + scatter * delta)
        to_own = np.empty((residuals.size, size))
        to_own[:, :2] = jacobian[:, :2]
        to_own[:, 2:NUISANCES] = jacobian[:, p:]
        to_own[:, NUISANCES:] = to_effects * (state.eta * scatter)
        to_own[:, ~active] = 0.0
        together = np.concatenate([to_shared, to_own, residuals[:, None]], axis=1)
        gram = together.T @ together
        if not np.isfinite(gram).all():
            return None
        chi_square[r] = gram[-1, -1]
        shared += gram[:q, :q]
        shared_gradient += gram[:q, -1]
        mixed[r] = gram[:q, q:-1]
        own[r] = gram[q:-1, q:-1]
        own_gradient[r] = gram[q:-1, -1]
        index = np.flatnonzero(active & (np.arange(size) >= DRIFTS[0]))  # those with a standard normal prior
        own[r, index, index] += 1.0
        own_gradient[r, index] -= values[index]
    penalty = float((state.own[:, active & (np.arange(size) >= DRIFTS[0])] ** 2).sum())
    return System(chi_square, penalty, shared_gradient, shared, mixed, own, own_gradient)


def eliminate(system: System, active: Any, damping: float, held: Any) -> Any:
    """Return what remains for the shared values once each specimen's own are eliminated."""
    shared = system.shared + damping * np.diag(np.diag(system.shared))
    gradient = system.shared_gradient.copy()
    solved = []
    for r in range(system.own.shape[0]):
        index = np.flatnonzero(active & ~held[r])
        block = system.own[r][np.ix_(index, index)]
        diagonal = np.maximum(np.diag(block), 1e-300)
        scale = 1.0 / np.sqrt(diagonal)
        block = block * np.outer(scale, scale) + (damping + 1e-12) * np.eye(index.size)
        mixed = system.mixed[r][:, index] * scale
        right = np.concatenate([mixed, (system.own_gradient[r, index] * scale)[None]]).T
        try:
            factor = np.linalg.cholesky(block)
        except np.linalg.LinAlgError:
            return None
        reduced = np.linalg.solve(block, right)
        shared -= mixed @ reduced[:, :-1]
        gradient -= mixed @ reduced[:, -1]
        log_determinant = 2.0 * np.log(np.diag(factor)).sum() - 2.0 * np.log(scale).sum()
        solved.append((index, scale, reduced, log_determinant))
    return shared, gradient, solved


def _step(layout: Layout, system: System, state: State, active: Any, damping: float) -> Any:
    """Return the step of the shared and the own values, limits minded."""
    q = layout.free.size
    held = np.zeros((state.own.shape[0], NUISANCES + q), dtype=bool)
    held[:, 1] = (state.own[:, 1] <= 0.0) & (system.own_gradient[:, 1] < 0.0)
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
        scale = 1.0 / np.sqrt(np.maximum(np.diag(block), 1e-300))
        scaled = block * np.outer(scale, scale) + 1e-12 * np.eye(free.size)
        try:
            step[free] = scale * np.linalg.solve(scaled, gradient[free] * scale)
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
    log_determinant, covariance = information(layout, system, state, active, 1.0)
    own_covariance = np.full((state.own.shape[0], NUISANCES), np.nan)
    index = np.flatnonzero(active)
    for r in range(state.own.shape[0]):
        block = system.own[r][np.ix_(index, index)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(block), 1e-300))
        inverse = np.linalg.pinv(block * np.outer(scale, scale)) * np.outer(scale, scale)
        for place, column in enumerate(index):
            if column < NUISANCES:
                own_covariance[r, column] = inverse[place, place]
    return Fit(
        layout, state, system.chi_square, system.penalty, log_determinant, covariance, own_covariance, converged,
        system=system, active=active,
    )  # fmt: skip


def information(
    layout: Layout, system: System, state: State, active: Any, noise: float
) -> tuple[float, FloatArray]:
    """Return the logarithm of the determinant of the information, and the covariance (q, q) of the shared values.

    ``noise`` is the variance of the residuals in units of the one assumed. The shared values are scaled with the width
    of their priors; the covariance holds their default priors.
    """
    q, size = layout.free.size, state.own.shape[1]
    prior = np.diag((active & (np.arange(size) >= DRIFTS[0])).astype(np.float64))
    scaled_system = replace(
        system, shared=system.shared / noise, mixed=system.mixed / noise, own=(system.own - prior) / noise + prior
    )
    eliminated = eliminate(scaled_system, active, 0.0, np.zeros(state.own.shape, dtype=bool))
    if eliminated is None:
        return np.inf, np.full((q, q), np.nan)
    shared, _, solved = eliminated
    own = float(sum(item[3] for item in solved))
    if q == 0:
        return own, np.empty((0, 0))
    widths = layout.width
    covariance = np.outer(widths, widths) * np.linalg.inv(np.eye(q) + _symmetric(shared) * np.outer(widths, widths))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    chosen = prior_width(layout, state.eta, spread)
    eigenvalues = np.linalg.eigvalsh(_symmetric(shared) * np.outer(chosen, chosen))
    return own + float(np.log1p(np.maximum(eigenvalues, 0.0)).sum()), covariance


def _symmetric(matrix: FloatArray) -> FloatArray:
    return 0.5 * (matrix + matrix.T)


def prior_width(layout: Layout, eta: FloatArray, spread: FloatArray) -> FloatArray:
    """Return the standard deviation of the prior of each shared coordinate.

    The size of an effect is not known beforehand, not even its order of magnitude: the prior of a strength is as wide
    as three times what is found, or what could just be seen. A shape has that of its default bounds.
    """
    own = np.minimum(3.0 * np.maximum(np.abs(eta), 3.0 * spread), 10.0 * layout.width)
    return np.where(layout.is_strength, own, layout.width)


def start_state(layout: Layout, eta: FloatArray, own: FloatArray) -> State:
    """Return a start with these shared coordinates and own nuisances (r, 5 or 7)."""
    full = np.zeros((own.shape[0], NUISANCES + layout.free.size))
    count = min(own.shape[1], NUISANCES)
    full[:, :count] = own[:, :count]
    return State(np.asarray(eta, dtype=np.float64), full)
