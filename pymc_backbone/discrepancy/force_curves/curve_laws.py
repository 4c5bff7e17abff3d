"""Force curves as the laws have them that they may follow.

A curve of nodes is known to what smoothness says, worst at its ends and close to rest. Where the records say that it
follows a law of a family, the law says the rest: the curve becomes the mean over all laws, each as probable as it is,
and over the curve of nodes, as far as it is none of these. What is more probably no curve at all than any law goes to
zero, but keeps its errors. A curve of laws that leaves the band of the nodes contradicts what was fitted without them,
however probable a law seems: the nodes stand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ..fitting.normal_equations import State
from ..results.curve_records import NOTHING, Band, Bands, Proposal
from .curve_bands import mean_values, rows_of
from .curve_fit import CurveFit
from .families import Shape, inexact_by, places, spared
from .tabulated import DAMPING, STIFFNESS

_LEAST = 0.01  # probability of all laws and of no curve together from which they change something
_ROUNDING = 1e-9  # of the widest place of a band


def with_laws(
    found: CurveFit, told: Sequence[Proposal], shapes: Mapping[str, Sequence[Shape]], nodes: Bands
) -> CurveFit:
    """Return the curves as a mean over the laws that they may follow.

    Parameters
    ----------
    found : CurveFit
        The curves of nodes.
    told : sequence of Proposal
        Probabilities of the families.
    shapes : mapping of str to sequence of Shape
        The laws that each curve may follow.
    nodes : Bands
        The curves of nodes with their bands.
    """
    values, covariance = mean_values(found), found.mean_covariance.copy()
    beyond = {}
    for curve, effect, own, band in (
        ("conservative", STIFFNESS, 0, nodes.conservative), ("damping", DAMPING, 1, nodes.damping)
    ):  # fmt: skip
        chance = next((item.probability for item in told if (item.curve, item.family) == (curve, NOTHING)), 0.0)
        laws = shapes[effect] if sum(shape.probability for shape in shapes[effect]) > chance else ()
        if chance + sum(shape.probability for shape in laws) < _LEAST:
            continue
        mine = np.append(2 + found.tabulated.places(effect), own)
        move, spread = _mean(found, effect, laws, chance, mine)
        other = found.tabulated.places(DAMPING if effect == STIFFNESS else STIFFNESS)
        moved = found.known[effect].follows @ move
        moved[2 + other] = moved[1 - own] = 0.0  # that one has laws and a line of its own
        if not _is_within(band, rows_of(found, effect, band.at) @ moved):
            continue
        values = values + moved
        covariance[mine], covariance[:, mine] = 0.0, 0.0
        covariance[np.ix_(mine, mine)] = spread
        at = places() * found.tabulated.ranges()[own]
        rest = np.zeros(2 * at.size) + sum(shape.probability * shape.beyond for shape in laws)
        below, above = rest[: at.size], rest[at.size :]
        if not found.tabulated.has_even:
            below, above = 0.5 * (below - above), 0.5 * (above - below)
        beyond[effect] = np.concatenate([-at[::-1], at]), np.concatenate([below[::-1], above])
    state, before = found.fit.state, mean_values(found)
    each = state.own.copy()
    each[:, :2] += values[:2] - before[:2]
    fit = replace(found.fit, state=State(values[2:], each), covariance=covariance[2:, 2:])
    return replace(found, fit=fit, mean_covariance=covariance, beyond=beyond)


def _is_within(band: Band, moves: FloatArray) -> bool:
    """Return whether a curve that moves by these forces from that of the nodes stays in its band everywhere.

    What no curve of nodes can hold of a law is not among these forces: the band says nothing of it.
    """
    least = _ROUNDING * float(np.abs(band.high - band.low).max())
    after = band.force + moves
    return bool(np.all((after >= band.low - least) & (after <= band.high + least)))


def _mean(
    found: CurveFit, effect: str, shapes: Sequence[Shape], nothing: float, mine: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return by how much a curve moves in its free coordinates, and the covariance of the mean specimen's values."""
    known, own = found.known[effect], int(effect == DAMPING)
    here = known.frame.T @ found.fit.state.eta[found.tabulated.places(effect)]
    total = sum(shape.probability for shape in shapes)
    free = found.mean_covariance[np.ix_(mine, mine)]
    # weights, places in free coordinates, covariances: of the curve of nodes, of none, of each law
    weights = [max(1.0 - total - nothing, 0.0), nothing, *(shape.probability for shape in shapes)]
    at, spreads = [here, np.zeros(here.size)], [free, free]
    follows = known.follows[mine]
    for shape in shapes:
        less, _ = spared(known, shape.ambiguity)
        place, spread = _posterior(less.precision, less.pull, shape, inexact_by(known))
        at.append(place)
        spread = follows @ spread @ follows.T
        spread[-1, -1] += known.left[own, own]
        spreads.append(spread)
    mean = np.average(at, axis=0, weights=weights)
    apart = (np.array(at) - mean) @ follows.T
    covariance = np.einsum("i,ijk->jk", weights, np.array(spreads)) + (apart.T * weights) @ apart
    return mean - here, covariance


def _posterior(precision: FloatArray, pull: FloatArray, shape: Shape, inexact: float) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of a curve that follows a law, but for a little at each node, in free coordinates."""
    columns = shape.columns * (shape.widths / inexact)
    prior = np.eye(pull.size) + columns @ columns.T
    spread = inexact**2 * np.linalg.solve(np.eye(pull.size) + inexact**2 * prior @ precision, prior)
    spread = 0.5 * (spread + spread.T)
    return spread @ pull, spread
