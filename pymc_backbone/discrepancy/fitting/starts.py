"""Where to start a fit from: a grid over what an effect can look like, judged by the score."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from ..._common.unit_diagonal import unit_diagonal
from ...effects import BASE_EFFECTS, Effect
from . import normal_equations
from .batch import Batch
from .joint_fit import Fit
from .layout import Layout
from .normal_equations import State

_STRENGTHS = (0.02, 0.3)
_TINY = 1e-4
_UNMOVED, _FAR_SMALLER, _SMALLER = 1.0, 1e-2, 3  # rise of chi-square by what should be too small to matter
_SHAPES = (0.12, 0.35, 0.75)
_SLIPS = (0.03, 0.15, 0.5, 0.85)  # slip displacement over amplitude; at the last it slips in few cycles
_SLIPS_OF_ONE = (0.03, 0.08, 0.15, 0.3, 0.5, 0.62, 0.73, 0.85, 1.0)  # of a single slider, clear near its own alone
_MANY = 4  # parameters beyond which each shape has two values only
_KEPT = 2
_SIDES = (-0.9, -0.5, -0.2, 0.2, 0.5, 0.9)  # displacements over the amplitude
_ODD = 1e-6  # share of a force that is the same on both sides, up to which it is none
_SLIPPING = (0.9, 0.6)  # displacement at which a bed of sliders slips as a whole, over the largest of the motion
_JOLTS = (0.95, 1.05)  # slip displacement over that at which a fit came to rest
_STICKING = 1.5  # the same at which it certainly does not
_SATURATED = (0.5, 1.0)  # share of the motion that a lagging displacement loses at the amplitude of the records
_NEARER = 2.0  # times as much as where a fit ended, at least
_LINEAR = 1e-6  # the same of what a linear spring leaves


def positions(layout: Layout, effect: str) -> list[int]:
    """Return the places of an effect's parameters among the free coordinates."""
    parameters = {name for item in layout.oscillator.effects if item.name == effect for name in item.parameter_names}
    return [j for j, name in enumerate(layout.names) if name in parameters]


def grid(layout: Layout, effect: str, strengths: Sequence[float]) -> list[FloatArray]:
    """Return coordinates of one effect: each strength (a share of its prior's upper bound) with each shape."""
    where = positions(layout, effect)
    top = layout.width[where] * np.sqrt(12.0)
    is_signed = layout.low[where] < 0.0
    forces = {force for _, force in layout.slips}
    powers = {place for place, _ in layout.powers}
    axes: list[list[float]] = []
    for j, place in enumerate(where[1:], start=1):
        if place in forces:
            axes.append(list(_SLIPS_OF_ONE if is_slider(layout, effect) else _SLIPS))
        elif place in layout.ordinates:
            axes.append([0.0])
        elif is_signed[j]:
            if layout.high[place] > 0.0:
                axes.append([-0.2 * top[j], 0.25 * top[j]])
            else:
                axes.append([layout.low[place] + share * top[j] for share in (0.25, 0.75)])
        else:
            low = 0.0 if place in powers or not np.isfinite(layout.low[place]) else layout.low[place]
            shapes = _SHAPES if len(where) < _MANY else _SHAPES[::2]
            axes.append([low + fraction * top[j] for fraction in shapes])
    signs = (0.5, -0.5) if is_signed[0] else (1.0,)
    leading = [share * sign * top[0] for share in strengths for sign in signs]
    return [np.array([strength, *shape]) for strength in leading for shape in itertools.product(*axes)]


def is_slider(layout: Layout, effect: str) -> bool:
    """Return whether an effect is a single slider: a spring that slips at a force."""
    where = positions(layout, effect)
    return any(strength in where for strength, _ in layout.sliders)


class Scored(NamedTuple):
    """A start from a fit without an effect: what a linear step gains and where it leads, and where it began."""

    gain: float
    moved: State
    small: State


def by_score(layout: Layout, effect: str, parent: Fit, batch: Batch) -> list[Scored]:
    """Return starts from a fit without the effect, with the gain a linear step promises; best first.

    The effect is put in at a strength too small to matter; the derivative to its strength, with everything else that
    is fitted eliminated, says how much the sum of squares would fall and at which strength.
    """
    where = positions(layout, effect)
    start, others = embedded(layout, parent)
    eta, own = start.eta, start.own
    scatter = layout.scatter if len(batch.specimens) > 1 else 0.0
    active = np.zeros(normal_equations.NUISANCES + layout.free.size, dtype=bool)
    active[list(batch.nuisances)] = True
    active[[normal_equations.NUISANCES + here for here, _ in others]] = scatter > 0.0
    held = np.zeros(own.shape, dtype=bool)
    held[:, 1] = own[:, 1] <= 0.0
    found = []
    for point in grid(layout, effect, (_TINY,)):
        if layout.low[where[0]] < 0.0 and point[0] < 0.0:
            continue  # the score has both signs
        trial = eta.copy()
        trial[where] = point
        system = normal_equations.linearise(layout, batch.deciding, State(trial, own), scatter, active)
        for _ in range(_SMALLER):
            if system is None or system.cost < parent.cost + _UNMOVED:
                break  # long records of little noise are moved by next to nothing
            trial[where[0]] *= _FAR_SMALLER
            system = normal_equations.linearise(layout, batch.deciding, State(trial, own), scatter, active)
        if system is None:
            continue
        eliminated = normal_equations.eliminate(system, active, 0.0, held)
        if eliminated is None:
            continue
        shared, gradient, solved = eliminated
        free = [where[0], *(here for here, _ in others)]
        information, slope = shared[np.ix_(free, free)], gradient[free]
        step = unit_diagonal(information).least_squares(slope, 1e-10)
        # what was put in costs a little, more than a step may gain by it
        gain = max(float(slope @ step) + parent.cost - system.cost, 0.0)
        strength = trial[where[0]] + step[0]
        limit = 0.5 * layout.width[where[0]]
        share = min(1.0, limit / max(abs(step[0]), 1e-300))
        if layout.low[where[0]] >= 0.0 and strength <= 0.0:
            gain, share = 0.0, 0.0
        moved = trial.copy()
        moved[free] += share * step
        along = np.zeros(eta.size)
        along[free] = step
        follow = own.copy()
        for r, (index, own_scale, reduced, _) in enumerate(solved):
            follow[r, index] += share * own_scale * (reduced[:, -1] - reduced[:, :-1] @ along)
        found.append(Scored(gain, State(moved, follow), State(trial, own.copy())))
    found.sort(key=lambda item: -item.gain)
    return found[:_KEPT]


def typical(layout: Layout) -> FloatArray:
    """Return small strengths and middle shapes for effects of which nothing is known yet."""
    eta = np.zeros(layout.free.size)
    for effect in layout.oscillator.effects:
        if effect.name not in BASE_EFFECTS:
            where = positions(layout, effect.name)
            points = grid(layout, effect.name, (_STRENGTHS[0],))
            eta[where] = points[len(points) // 2]
    return eta


def alike(known: Fit) -> State:
    """Return where a fit ended, with specimens that do not differ in their effects: what they differ by may hold it."""
    own = known.state.own.copy()
    own[:, normal_equations.NUISANCES :] = 0.0
    return State(known.state.eta, own)


def mirrored(layout: Layout, state: State) -> State | None:
    """Return the start that moves as the mirror image of this one: its backbones are the same, its samples are not.

    None where no effect is asymmetric, or one that is has no mirror image of its own kind. A contact on one side is a
    softer spring on the other: the linear spring takes the difference.
    """
    vector = parameters_at(layout, state.eta)
    eta, own = state.eta.copy(), state.own.copy()
    for effect in layout.oscillator.effects:
        if effect.name in BASE_EFFECTS or effect.n_states or effect.has_memory:
            continue
        before = _at_rest(layout, effect, vector)
        if np.abs(before + before[::-1]).max() <= _ODD * np.abs(before).max():
            continue
        turned = _turned(layout, effect, vector, before)
        if turned is None:
            return None
        places, stiffness = turned
        eta[places] *= -1.0
        own[:, 0] += stiffness
    return None if np.array_equal(eta, state.eta) else State(eta, own)


def _turned(layout: Layout, effect: Effect, vector: FloatArray, before: FloatArray) -> tuple[list[int], float] | None:
    """Return which coordinates change their sign in the mirror image of an effect, and the stiffness that it lacks.

    Effects count sides in their own ways: a gap may be a place, or a distance on the side that the strength names. The
    signs are those that leave a linear spring; None where none do.
    """
    signed = [k for k in positions(layout, effect.name) if layout.low[k] < 0.0 < layout.high[k]]
    x = layout.amplitude * np.array(_SIDES)
    for count in range(len(signed), 0, -1):
        for places in itertools.combinations(signed, count):
            image = vector.copy()
            image[layout.free[list(places)]] *= -1.0
            left = -before[::-1] - _at_rest(layout, effect, image)
            stiffness = float(left @ x / (x @ x))
            if np.abs(left - stiffness * x).max() <= _LINEAR * np.abs(before).max():
                return list(places), stiffness
    return None


def _at_rest(layout: Layout, effect: Effect, vector: FloatArray) -> FloatArray:
    """Return the forces of an effect at some displacements to either side, at rest."""
    x, none = layout.amplitude * np.array(_SIDES), np.zeros(len(_SIDES))
    return forces(layout, effect, vector, x, none, none)


def forces(
    layout: Layout, effect: Effect, vector: FloatArray, x: FloatArray, v: FloatArray, a: FloatArray
) -> FloatArray:
    """Return the forces (n,) of an effect without states at displacements, velocities and accelerations (n,)."""
    p = vector[[layout.oscillator.index(name) for name in effect.parameter_names]]
    return np.array([effect.along(*motion, np.zeros(0), p) for motion in zip(x, v, a, strict=True)])


def slipping(layout: Layout, state: State) -> list[State]:
    """Return starts with beds of sliders that just slip as a whole, where they hardly do or do not.

    A bed that never slips as a whole has the force ``K x - C x^(2 + chi)`` on the way from a turning point, whatever
    slip force goes with its ``C``: over a plateau without an end, where a fit has no reason to move. What lies beyond
    its edge, where the largest motions make the whole bed slip, no derivative on the plateau tells. In the starts that
    force is the same in every specimen, and the spring beside it takes up what the bed has less of stiffness.
    """
    found: list[State] = []
    for (strength, slip, exponent), edge in _edges(layout, state):
        if state.eta[strength] > 0.0 and state.eta[slip] > _SLIPPING[-1] * edge:
            found += [_at_slip(layout, state, (strength, slip, exponent), share * edge) for share in _SLIPPING]
    return found


def sticking(layout: Layout, state: State) -> list[State]:
    """Return starts with beds that just slip as a whole, or hardly do not, well beyond that: see `slipping`.

    At the edge of their plateau the largest motions still tell them how far they are from it on the one side, and
    nothing on the other.
    """
    return [
        _at_slip(layout, state, bed, _STICKING * edge)
        for bed, edge in _edges(layout, state)
        if state.eta[bed[0]] > 0.0 and _SLIPPING[-1] * edge < state.eta[bed[1]] < _STICKING * edge
    ]


def _edges(layout: Layout, state: State) -> list[tuple[tuple[int, int, int], float]]:
    """Return the beds, each with the slip displacement at which it just slips as a whole."""
    released = np.abs(state.own[:, 2])
    reach = max(float(released.max()), layout.amplitude) / layout.amplitude
    return [(bed, reach * (1.0 + state.eta[bed[2]]) / (2.0 + state.eta[bed[2]])) for bed in layout.beds]


def saturating(layout: Layout, state: State) -> list[State]:
    """Return starts with hysteresis that comes nearer to saturation, where a fit has it far from that.

    A lagging displacement ``z' = x' - (beta |x'| z / |z| + gamma x') |z|^n`` that hardly lags has the force
    ``k (x - C x^(1 + n))``: a valley along which a stiffer ``k`` goes with less of ``beta`` and ``gamma``, down to
    where the spring beside it is used up and holds the fit. In the starts the product is as before, and that spring
    takes up what the hysteretic one has less of stiffness.
    """
    found: list[State] = []
    for strength, coefficients in layout.lags:
        bend = float(state.eta[coefficients].sum())
        if not (state.eta[strength] > 0.0 and 0.0 < bend < _SATURATED[0] / _NEARER):
            continue
        for goal in _SATURATED:
            eta, own = state.eta.copy(), state.own.copy()
            eta[strength] *= bend / goal
            eta[coefficients] *= goal / bend
            own[:, 0] += state.eta[strength] - eta[strength]
            found.append(State(eta, own))
    return found


def slipping_each(layout: Layout, state: State, lags: BoolArray) -> list[State]:
    """Return starts where a slider that holds in some specimens, and slips in others, just slips in these, too.

    One that holds is a spring whatever its slip force: no derivative tells that specimen of the other side.

    Parameters
    ----------
    layout : Layout
        The model.
    state : State
        Where a fit ended.
    lags : (r,) array of bool
        Specimens that are fitted worse than others.
    """
    released = np.abs(state.own[:, 2]) / layout.amplitude
    found: list[State] = []
    for strength, slip in layout.sliders:
        if not state.eta[slip] > 0.0:
            continue
        columns = [normal_equations.NUISANCES + place for place in (strength, slip)]
        reach = state.eta[slip] * (1.0 + layout.scatter * state.own[:, columns[1]])
        moved = lags & (reach >= released)
        if not moved.any() or not (reach < released).any():
            continue
        for share in _SLIPPING:
            own = state.own.copy()
            ratio = (share * released / reach)[moved, None]
            own[np.ix_(moved, columns)] = (
                (1.0 + layout.scatter * own[np.ix_(moved, columns)]) * ratio - 1.0
            ) / layout.scatter
            found.append(State(state.eta.copy(), own))
    return found


def jolted(layout: Layout, state: State) -> list[State]:
    """Return starts where single sliders slip a little earlier, or a little later, than where a fit came to rest.

    In which cycles a slider slips is a whole number: the sum of squares has a dent for each, and a fit rests in one.
    """
    found: list[State] = []
    for strength, slip in layout.sliders:
        for ratio in _JOLTS if state.eta[strength] > 0.0 else ():
            eta = state.eta.copy()
            eta[slip] *= ratio
            found.append(State(eta, state.own.copy()))
    return found


def _at_slip(layout: Layout, state: State, bed: tuple[int, int, int], slip: float) -> State:
    """Return a point with a bed that slips at another displacement, and has the same force where it does not."""
    strength, at, exponent = bed
    ratio = max(slip, layout.low[at]) / state.eta[at]
    eta, own = state.eta.copy(), state.own.copy()
    eta[at] *= ratio
    eta[strength] *= ratio ** (2.0 + eta[exponent])
    deviations = own[:, normal_equations.NUISANCES :]
    for r in range(own.shape[0]):
        before = layout.physical(state.eta, deviations[r], layout.scatter)[0]
        own_share = ratio ** (before[exponent] - eta[exponent])  # a specimen has an exponent of its own
        deviations[r, strength] = ((1.0 + layout.scatter * deviations[r, strength]) * own_share - 1.0) / layout.scatter
        after = layout.physical(eta, deviations[r], layout.scatter)[0]
        own[r, 0] += before[strength] - after[strength]
    return State(eta, own)


def parameters_at(layout: Layout, eta: FloatArray) -> FloatArray:
    """Return the parameter vector (p,) at these coordinates, stiffness and damping zero."""
    vector = layout.template.copy()
    vector[layout.free] = layout.physical(eta, np.zeros(eta.size), 0.0)[0]
    return vector


def restricted(layout: Layout, larger: Layout, state: State) -> State:
    """Return a point of a larger model without the effects that a smaller one lacks."""
    places = [larger.names.index(name) for name in layout.names]
    own = [*range(normal_equations.NUISANCES), *(normal_equations.NUISANCES + place for place in places)]
    return State(state.eta[places], state.own[:, own])


def embedded(layout: Layout, smaller: Fit) -> tuple[State, list[tuple[int, int]]]:
    """Return a fit of a smaller model as a start for a larger one, whose other effects begin small.

    And the places of the coordinates that both have, here and there.
    """
    eta = typical(layout)
    own = np.zeros((smaller.state.own.shape[0], normal_equations.NUISANCES + layout.free.size))
    own[:, : normal_equations.NUISANCES] = smaller.state.own[:, : normal_equations.NUISANCES]
    pairs = []
    for there, name in enumerate(smaller.layout.names):
        if name in layout.names:
            here = layout.names.index(name)
            eta[here] = smaller.state.eta[there]
            own[:, normal_equations.NUISANCES + here] = smaller.state.own[:, normal_equations.NUISANCES + there]
            pairs.append((here, there))
    return State(eta, own), pairs
