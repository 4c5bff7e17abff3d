"""How far parameters may go together: the valley of a fit, followed as far as the records allow.

The curvature at a minimum says how far a straight line may lead. Two parameters that make up for each other (stiffness
and slip force of a joint that hardly slips; a scale and a strength) do so along a bent valley, many times as long as
the curvature and the prior around the fit say. So the valley is followed: along the direction that the records
determine least one step after the other is taken, everything else is fitted again, each specimen's own values with it,
until the sum of squares has risen by what a 95 % interval allows or a parameter has come to its limit.

At each point of the way the other directions have the width that the curvature there leaves them, less what the point
itself has used up. For a Gaussian all this is what the covariance says. A bed of sliders that just slips as a whole
stands at the end of such a valley, where the curvature is that of the steep side: the way begins a little further on,
where that is not much less likely. The plateau there may leave more and still hold most of what is likely, as it is so
much wider.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from . import starts
from .batch import Batch
from .data_term import DataTerm
from .joint_fit import Fit, fit
from .layout import Layout
from .normal_equations import NUISANCES, State, linearise
from .valley_walk import RISE, SETTLED, Place, Range, Walk, own_errors

_AS_LIKELY = -3.0  # logarithm of how likely what is beyond an edge has to be, over the fit at the edge


def ranges(found: Fit, batch: Batch) -> dict[str, Range]:
    """Return 95 % intervals of the parameters of a fit with a valley, by its profile likelihood.

    Parameters
    ----------
    found : Fit
        To the deciding data.
    batch : Batch
        The data.

    Returns
    -------
    dict of str to Range
        By parameter, stiffness and damping of the mean specimen as well. Empty where no direction is loose, and the
        curvature of the fit says all.
    """
    walk = Walk(found, batch.deciding)
    edges = starts.sticking(found.layout, found.state)
    if found.layout.free.size < 2 or not (walk.directions() or edges):
        return {}
    known = linearise(found.layout, batch.deciding, found.state, walk.scatter, found.active)
    if known is None or abs(known.cost - found.cost) > SETTLED + 1e-6 * found.cost:
        return {}  # a fit to other data
    found = _scattering(found, batch.deciding)
    walk = Walk(found, batch.deciding)
    loose = walk.directions()
    names = ("linear_stiffness", "viscous_damping", *found.layout.names)
    ends: dict[str, Range] = {}
    for start in starts.sticking(found.layout, found.state):
        again = _fitted(found, found.layout, start, batch.deciding)
        beyond = None if again is None else Walk(again, batch.deciding)
        if beyond is not None and beyond.log_evidence() > walk.log_evidence() + _AS_LIKELY:
            ends = dict(zip(names, walk.around(), strict=True))
            found, walk, loose = beyond.found, beyond, beyond.directions()
    if not loose:
        return {}
    followed = [(along, *walk.follow(along)) for along in loose]
    lowest = min(place.cost for _, ways, _ in followed for way in ways for place in way)
    # the plateau beyond an edge may leave more than the edge, and still hold most of what is likely
    lowest = found.cost if ends else lowest
    for along, ways, opens in followed:
        span = walk.values(ways[0][-1]) - walk.values(ways[1][-1])
        for way, is_open, side in zip(ways, opens, (1.0, -1.0), strict=True):
            for place in _within(_at_rest(way), lowest):
                left = float(np.sqrt(max(1.0 - (place.cost - lowest) / RISE, 0.0)))
                reaches = np.concatenate([own_errors(found), walk.spread(place, along)]) * np.sqrt(RISE) * left
                towards = side * span * (is_open and place is way[-1])
                for name, value, reach, to in zip(names, walk.values(place), reaches, towards, strict=True):
                    new = Range(float(value - reach), float(value + reach), bool(to < -reach), bool(to > reach))
                    ends[name] = new if name not in ends else _joined(ends[name], new)
    return ends


def _scattering(found: Fit, terms: Sequence[DataTerm]) -> Fit:
    """Return the same fit with specimens that scatter as is inferred of them, not as the search assumed."""
    scatter = found.scatter.root_mean_square
    if not (np.isfinite(scatter) and found.active[NUISANCES:].any()):
        return found
    own = found.state.own.copy()
    own[:, NUISANCES:] *= found.layout.scatter / scatter
    again = _fitted(found, replace(found.layout, scatter=scatter), State(found.state.eta, own), terms)
    return found if again is None else again


def _fitted(found: Fit, layout: Layout, start: State, terms: Sequence[DataTerm]) -> Fit | None:
    """Return the fit of the same data from another start; None where there is none."""
    return fit(layout, terms, start, nuisances=np.flatnonzero(found.active[:NUISANCES]).tolist())


def _joined(one: Range, other: Range) -> Range:
    low, high = min(one, other, key=lambda item: item.low), max(one, other, key=lambda item: item.high)
    return Range(low.low, high.high, low.is_low_open, high.is_high_open)


def _at_rest(way: Sequence[Place]) -> list[Place]:
    """Return a way without points above both of their neighbours: those hang beside the floor of the valley."""
    costs = np.array([np.inf, *(place.cost for place in way), np.inf])
    hangs = costs[1:-1] > np.maximum(costs[:-2], costs[2:]) + SETTLED
    return [place for place, is_beside in zip(way, hangs, strict=True) if not is_beside]


def _within(way: Sequence[Place], lowest: float) -> list[Place]:
    """Return the points of a way that belong to the interval, where it ends in between included."""
    held: list[Place] = []
    for place in way:
        rise = max(place.cost - lowest, 0.0)
        if rise <= RISE:
            held.append(place)
        elif held:
            before = held[-1]
            began = np.sqrt(max(before.cost - lowest, 0.0))
            share = float((np.sqrt(RISE) - began) / (np.sqrt(rise) - began))
            own = before.state.own + share * (place.state.own - before.state.own)
            eta = before.state.eta + share * (place.state.eta - before.state.eta)
            chart = before.chart + share * (place.chart - before.chart)
            at = before.at + share * (place.at - before.at)
            held.append(Place(at, chart, State(eta, own), place.system, lowest + RISE))
            break
    return held


__all__ = ["RISE", "Range", "ranges"]
