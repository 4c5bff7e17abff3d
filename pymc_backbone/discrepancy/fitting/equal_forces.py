"""Starts that have the force of another fit over the motion: with another law, or contacts that close elsewhere."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray
from ...effects import Effect
from .joint_fit import Fit
from .layout import Layout
from .normal_equations import State
from .starts import embedded, forces, parameters_at, positions

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""Displacements, velocities and accelerations (n,)."""

_OTHER_GAPS = (0.1, 0.25, 0.5)  # displacements over the amplitude at which a contact may close
_SIZES, _ANGLES = (0.4, 0.7, 1.0), 24  # amplitudes over the typical one, and instants of a cycle


def in_place_of(layout: Layout, known: Fit, angular_frequency: float) -> State:
    """Return a fit as a start of a model with another effect in the place of one, neither of them with states.

    Its gap is taken over; the strength, and what it changes in stiffness and damping, bring its force over the motion
    as near as they can to that of the effect which it stands for.
    """
    state, _ = embedded(layout, known)
    new, old = (
        next(effect for effect in one.oscillator.effects if effect not in other.oscillator.effects)
        for one, other in ((layout, known.layout), (known.layout, layout))
    )
    before, after = parameters_at(known.layout, known.state.eta), parameters_at(layout, state.eta)
    gaps = [before[known.layout.oscillator.index(q.name)] for q in old.parameters if q.role == "gap"]
    for q in new.parameters:
        if q.role == "gap" and gaps:
            after[layout.oscillator.index(q.name)] = gaps[0]
    motion = typical_motion(layout, angular_frequency)
    force = forces(known.layout, old, before, *motion)
    return _as_strong(layout, new, after, state, motion, force)


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
            found.append(_as_strong(layout, effect, after, known.state, motion, force))
    return found


def typical_motion(layout: Layout, angular_frequency: float) -> Motion:
    """Return displacements, velocities and accelerations (n,) of motion at some amplitudes."""
    angle = 2.0 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    size = layout.amplitude * np.repeat(_SIZES, _ANGLES)
    x, v = size * np.tile(np.cos(angle), len(_SIZES)), -angular_frequency * size * np.tile(np.sin(angle), len(_SIZES))
    return x, v, -(angular_frequency**2) * x


def _as_strong(
    layout: Layout, effect: Effect, vector: FloatArray, state: State, motion: Motion, force: FloatArray
) -> State:
    """Return a state whose effect, with spring and damper beside it, comes as near to a force as it can."""
    x, v, _ = motion
    columns = np.column_stack([forces(layout, effect, vector, *motion), x, v])
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    factor, stiffness, damping = np.linalg.lstsq(columns / scale, force, rcond=None)[0] / scale
    vector[layout.free[positions(layout, effect.name)[0]]] *= factor
    own = state.own.copy()
    own[:, 0] += stiffness
    own[:, 1] = np.maximum(own[:, 1] + damping, 0.0)
    return State(layout.within(layout.coordinates(vector[layout.free])), own)


__all__ = ["in_place_of", "typical_motion", "with_other_gaps"]
