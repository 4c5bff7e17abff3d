"""Starts that have the force of another fit over the motion: with another law, or contacts that close elsewhere."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray
from ...effects import Effect
from .joint_fit import Fit
from .layout import Layout
from .normal_equations import State
from .starts import embedded, forces, grid, parameters_at, positions

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""Displacements, velocities and accelerations (n,)."""

_OTHER_GAPS = (0.1, 0.25, 0.5)  # displacements over the amplitude at which a contact may close
_SIZES, _ANGLES = (0.4, 0.7, 1.0), 24  # amplitudes over the typical one, and instants of a cycle


def in_place_of(layout: Layout, known: Fit, angular_frequency: float) -> State:
    """Return a fit as a start of a model with another effect in the place of one or several, none of them with states.

    The gap of what it stands for is taken over, or another shape where that has more nearly its force; the strength,
    and what it changes in stiffness and damping, bring that as near as they can over the motion.
    """
    state, _ = embedded(layout, known)
    new = next(effect for effect in layout.oscillator.effects if effect not in known.layout.oscillator.effects)
    old = [effect for effect in known.layout.oscillator.effects if effect not in layout.oscillator.effects]
    before = parameters_at(known.layout, known.state.eta)
    motion = typical_motion(layout, angular_frequency)
    force = np.sum([forces(known.layout, effect, before, *motion) for effect in old], axis=0)
    gaps = [before[known.layout.oscillator.index(name)] for effect in old for name in effect.with_role("gap")]
    own_gaps = [layout.oscillator.index(name) for name in new.with_role("gap")]
    vectors = [parameters_at(layout, state.eta)]
    if gaps and own_gaps:  # on which side a positive one lies, each law says for itself
        vectors.append(vectors[0].copy())
        vectors[0][own_gaps[0]], vectors[1][own_gaps[0]] = gaps[0], -gaps[0]
    where = positions(layout, new.name)
    for point in grid(layout, new.name, (1.0,)):
        eta = state.eta.copy()
        eta[where] = point
        vectors.append(parameters_at(layout, layout.within(eta)))
    begun = [_as_strong(layout, new, vector, state, motion, force) for vector in vectors]
    return min(begun, key=lambda item: item[1])[0]


def with_other_gaps(layout: Layout, known: Fit, angular_frequency: float) -> list[State]:
    """Return starts with contacts that close at other displacements than where a fit has them, in none of any states.

    Strength, and the spring and damper beside it, bring the force over the motion as near as they can to what it was:
    a small gap between stiff stops and a larger one between soft ones have much the same backbone.
    """
    found: list[State] = []
    before, motion = parameters_at(layout, known.state.eta), typical_motion(layout, angular_frequency)
    for effect in layout.oscillator.effects:
        gaps = [layout.oscillator.index(q.name) for q in effect.parameters if q.role == "gap"]
        if effect.n_states or effect.has_memory or len(gaps) != 1 or gaps[0] not in layout.free:
            continue
        force = forces(layout, effect, before, *motion)
        for share in _OTHER_GAPS:
            after = before.copy()
            after[gaps[0]] = share * layout.amplitude * (np.sign(before[gaps[0]]) or 1.0)
            found.append(_as_strong(layout, effect, after, known.state, motion, force)[0])
    return found


def typical_motion(layout: Layout, angular_frequency: float) -> Motion:
    """Return displacements, velocities and accelerations (n,) of motion at some amplitudes."""
    angle = 2.0 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    size = layout.amplitude * np.repeat(_SIZES, _ANGLES)
    x, v = size * np.tile(np.cos(angle), len(_SIZES)), -angular_frequency * size * np.tile(np.sin(angle), len(_SIZES))
    return x, v, -(angular_frequency**2) * x


def _as_strong(
    layout: Layout, effect: Effect, vector: FloatArray, state: State, motion: Motion, force: FloatArray
) -> tuple[State, float]:
    """Return a state whose effect, with spring and damper beside it, comes as near to a force as it can.

    And how far from it that is, squared.
    """
    x, v, _ = motion
    columns = np.column_stack([forces(layout, effect, vector, *motion), x, v])
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    factor, stiffness, damping = np.linalg.lstsq(columns / scale, force, rcond=None)[0] / scale
    vector[layout.free[positions(layout, effect.name)[0]]] *= factor
    eta = layout.within(layout.coordinates(vector[layout.free]))
    own = state.own.copy()
    own[:, 0] += stiffness
    own[:, 1] = np.maximum(own[:, 1] + damping, 0.0)
    reached = forces(layout, effect, parameters_at(layout, eta), *motion) + stiffness * x + damping * v
    return State(eta, own), float(np.sum((force - reached) ** 2))


__all__ = ["in_place_of", "typical_motion", "with_other_gaps"]
