"""Where a step of a joint fit may lead: limits of effects and of what specimens differ by, and how far is trusted."""

from __future__ import annotations

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from .layout import Layout
from .normal_equations import NUISANCES, State

MOST_SCATTER = 8.0
"""Standard deviations that a specimen may differ: an effect neither vanishes nor turns around in one of them."""
_LONGEST = 3.0  # factor by which a step may change stiffness and release


def is_trusted(state: State, proposal: State) -> bool:
    """Return whether no specimen's stiffness or release changes by more than a factor of three, or turns around.

    Far from the minimum the linear step knows nothing of the other side of zero; from there is no way back.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = proposal.own[:, (0, 2)] / state.own[:, (0, 2)]
    ratio[state.own[:, (0, 2)] == 0.0] = 1.0  # backbones know no release
    return bool(np.all((ratio > 1.0 / _LONGEST) & (ratio < _LONGEST)))


def recentred(layout: Layout, state: State, scatter: float) -> State:
    """Return the same parameters of every specimen with the shared values in their middle, where one is at a limit.

    Where scatter has the same sign in all specimens, it belongs to the shared value. Without this a fit could lean on
    a limit with every specimen and find no way back. What a single specimen needs beyond the limit moves the shared
    value; then nothing is changed.
    """
    if not np.any(np.abs(state.own[:, NUISANCES:]) >= MOST_SCATTER):
        return state
    middle = centred(layout, state, scatter)
    return state if np.any(np.abs(middle.own[:, NUISANCES:]) > MOST_SCATTER) else middle


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
