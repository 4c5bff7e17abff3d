"""Where a step of a joint fit may lead: limits of effects and of what specimens differ by, and how far is trusted."""

from __future__ import annotations

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from .layout import Layout
from .normal_equations import DRIFTS, NUISANCES, State

MOST_SCATTER = 8.0
"""Standard deviations that a specimen may differ: an effect neither vanishes nor turns around in one of them."""
_LONGEST = 3.0  # factor by which a step may change stiffness and release
_MOST_UNITS = 3.0  # factor by which a shared value may fall in a step that keeps what specimens deviate by


def is_trusted(state: State, proposal: State) -> bool:
    """Return whether no specimen's stiffness or release changes by more than a factor of three, or turns around.

    Far from the minimum the linear step knows nothing of the other side of zero; from there is no way back.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = proposal.own[:, (0, 2)] / state.own[:, (0, 2)]
    ratio[state.own[:, (0, 2)] == 0.0] = 1.0  # backbones know no release
    return bool(np.all((ratio > 1.0 / _LONGEST) & (ratio < _LONGEST)))


def reached_from(layout: Layout, state: State, linear: State, scatter: float) -> State:
    """Return where a linear step leads that the shared values may take, the limits of all others minded.

    A specimen has the shared value times one and its deviation. What the step wants of a specimen would be missed by
    the product of both changes, which over many cycles costs the phase: so deviations are counted in units of the new
    shared value.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        units = state.eta / linear.eta
    units = np.where((units > 0.0) & (units < _MOST_UNITS), units, 1.0)
    own, before = linear.own.copy(), state.own[:, NUISANCES:]
    own[:, NUISANCES:] = before + units * (linear.own[:, NUISANCES:] - before)
    own[:, 1] = np.maximum(own[:, 1], 0.0)
    reached = least_apart(layout, State(linear.eta, own), scatter)
    np.clip(reached.own[:, DRIFTS[0] :], -MOST_SCATTER, MOST_SCATTER, out=reached.own[:, DRIFTS[0] :])
    return within(layout, reached, scatter)


def least_apart(layout: Layout, state: State, scatter: float) -> State:
    """Return the same parameters of every specimen, counted from the shared values from which they deviate least.

    What all specimens deviate by belongs to the shared value. Deviations are relative, so along this way the linear
    step turns in a circle; it needs no step: the sum of squares of ``values / shared - 1`` is least at
    ``sum(values^2) / sum(values)``. Nothing is changed of an effect that is not of one sign in all specimens, of which
    one would deviate by more than the most that is allowed, or is at the limit of the effect: a fit may rest there.
    Unless one deviates by the most already: leaning on that with every specimen, a fit would find no way back.
    """
    if scatter == 0.0 or not layout.free.size:
        return state
    values = np.clip(state.eta * (1.0 + scatter * state.own[:, NUISANCES:]), layout.low, layout.high)
    is_one_sided = (values > 0.0).all(axis=0) | (values < 0.0).all(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        eta = (values**2).sum(axis=0) / values.sum(axis=0)
        deviations = (values / eta - 1.0) / scatter
    reach = np.vstack([values, state.eta])
    is_inside = ((reach > layout.low) & (reach < layout.high)).all(axis=0)
    is_leaning = (np.abs(state.own[:, NUISANCES:]) >= MOST_SCATTER).any(axis=0)
    usable = is_one_sided & (is_inside | is_leaning) & (np.abs(deviations) <= MOST_SCATTER).all(axis=0)
    usable &= layout.within(np.where(usable, eta, state.eta)) == eta
    own = state.own.copy()
    own[:, NUISANCES:] = np.where(usable, deviations, own[:, NUISANCES:])
    return State(np.where(usable, eta, state.eta), own)


def centred(layout: Layout, state: State, scatter: float) -> State:
    """Return the same parameters of every specimen with the shared values in their middle."""
    if scatter == 0.0 or not layout.free.size:
        return state
    values = np.clip(state.eta * (1.0 + scatter * state.own[:, NUISANCES:]), layout.low, layout.high)
    eta = values.mean(axis=0)
    own = state.own.copy()
    usable = eta != 0.0
    own[:, NUISANCES:] = np.where(usable, (values / np.where(usable, eta, 1.0) - 1.0) / scatter, own[:, NUISANCES:])
    return State(eta, own)


def within(layout: Layout, state: State, scatter: float) -> State:
    """Return the same with no specimen's parameter beyond its limits, where its deviation would cost and do nothing."""
    if scatter == 0.0 or not layout.free.size:
        return state
    low, high = layout.room(state.eta, scatter, MOST_SCATTER)
    own = state.own.copy()
    np.clip(own[:, NUISANCES:], low, high, out=own[:, NUISANCES:])
    return State(state.eta, own)


def leans(layout: Layout, state: State, gradient: FloatArray, scatter: float) -> BoolArray:
    """Return which of the specimens' own values (r, 7 + q) want beyond the most that they may differ.

    Or beyond where the parameter that they stand for has its limit.
    """
    low = np.full(state.own.shape[1], -MOST_SCATTER)
    high = -low
    if scatter > 0.0 and layout.free.size:
        low[NUISANCES:], high[NUISANCES:] = layout.room(state.eta, scatter, MOST_SCATTER)
    leans: BoolArray = ((state.own >= high - 1e-9) & (gradient > 0.0)) | ((state.own <= low + 1e-9) & (gradient < 0.0))
    return leans
