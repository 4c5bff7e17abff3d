"""Which family of laws a force curve is of: each against the others, and against none of them.

What the records say of a curve is a quadratic function of its node forces: the precision of the fit less that of the
prior. A family is a shape with one number, summed over, and a size. "None of these" is the curve itself, with its prior
on bends. No line enters: that is stiffness and damping.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from ..._common.checks import FloatArray
from ..._common.unit_diagonal import unit_diagonal
from ..results.curve_records import NONE, NOTHING, Proposal
from .curve_fit import CurveFit
from .curve_known import Known
from .tabulated import DAMPING, NODES, STIFFNESS

Law = Callable[[FloatArray, float], FloatArray]
_FINE = 161
_WIDTH = 3.0  # of the prior of a size, in units of what is found
_EDGE = 0.025
_PLACES = 121
_AT_REST = 1e-12  # of the range: where friction is that just beyond rest
_COUNTS = 1e-4  # probability from which a law counts
INEXACT = 0.005  # of the largest node force: how far off a law may be at any node


@dataclass(frozen=True)
class _Family:
    """A family: its name, what its number is, shapes over the range, where the number lies, the sign of its size.

    One that is steep has laws whose slope at rest has no bound, so that no spline is close to them there.
    """

    name: str
    number: str
    laws: tuple[Law, ...]
    low: float
    high: float
    sign: float = 0.0
    is_left_out: tuple[float, float] = (1.0, 1.0)
    is_steep: bool = False


def _power(u: FloatArray, q: float) -> FloatArray:
    return np.sign(u) * np.abs(u) ** q


def _even(u: FloatArray, q: float) -> FloatArray:
    return np.abs(u) ** q


def _above(u: FloatArray, q: float) -> FloatArray:
    return np.maximum(u, 0.0) ** q


def _below(u: FloatArray, q: float) -> FloatArray:
    return -(np.maximum(-u, 0.0) ** q)


def _kink(u: FloatArray, g: float) -> FloatArray:
    return np.sign(u) * np.maximum(np.abs(u) - g, 0.0)


def _kink_above(u: FloatArray, g: float) -> FloatArray:
    return np.maximum(u - g, 0.0)


def _kink_below(u: FloatArray, g: float) -> FloatArray:
    return -np.maximum(-u - g, 0.0)


def _pole_above(u: FloatArray, g: float) -> FloatArray:
    """Pull of a magnet or a charge beyond the range: with the square of the distance to it."""
    pull: FloatArray = (g - u) ** -2.0 - g**-2.0
    return pull


def _pole_below(u: FloatArray, g: float) -> FloatArray:
    return -_pole_above(-u, g)


def _saturating(u: FloatArray, s: float) -> FloatArray:
    return np.tanh(u / s)


def _falling(u: FloatArray, s: float) -> FloatArray:
    """Friction that falls with speed: what falls first, then what stays."""
    return np.column_stack([np.sign(u) * np.exp(-np.abs(u) / s), np.sign(u)])


def _eddy(u: FloatArray, s: float) -> FloatArray:
    """Force of eddy currents, which is largest at a speed: beyond, the field does not get into the metal."""
    return u / (1.0 + (u / s) ** 2)


def _limited(u: FloatArray, s: float) -> FloatArray:
    return -_eddy(u, s)


FAMILIES: dict[str, tuple[_Family, ...]] = {
    "conservative": (
        _Family("power law", "exponent", (_power,), 1.3, 8.0),
        _Family("power law, even", "exponent", (_even,), 1.3, 8.0),
        _Family("kink", "displacement", (_kink,), 0.05, 0.95),
        _Family("kink on one side", "displacement", (_kink_above, _kink_below), 0.0, 0.95),
        _Family("pole on one side", "displacement", (_pole_above, _pole_below), 1.02, 4.0),
        _Family("saturation", "displacement", (_saturating,), 0.02, 0.6),
    ),
    "damping": (
        _Family("power law", "exponent", (_power,), 0.0, 5.0, is_left_out=(0.85, 1.15), is_steep=True),
        _Family("power law on one side", "exponent", (_above, _below), 1.15, 5.0),
        _Family("saturation", "speed", (_saturating,), 0.02, 0.6, sign=1.0),
        _Family("minimum of damping", "speed", (_falling,), 0.02, 0.6, sign=1.0),
        _Family("minimum of damping", "speed", (_limited,), 0.04, 0.8, sign=1.0),
        _Family("kink", "speed", (_kink,), 0.05, 0.95),
        _Family("kink on one side", "speed", (_kink_above, _kink_below), 0.05, 0.95),
        _Family("largest at a speed", "speed", (_eddy,), 0.08, 0.9, sign=1.0),
    ),
}


class Shape(NamedTuple):
    """A law that a curve may follow.

    Attributes
    ----------
    probability : float
        Of the law with this number, against all others, none and nothing.
    columns : (m, n) array
        Free coordinates of the curve for sizes of one, then the change of the law from one number to the next.
    widths : (n,) array
        Standard deviations beforehand of what multiplies the columns.
    beyond : (2 n,) array
        What the law has beyond the nearest curve of nodes, at `places`, minus and plus [N].
    ambiguity : (m,) array
        Free coordinates by which the curve that stands for the law in a fit may differ from the nearest one, a
        standard deviation.
    """

    probability: float
    columns: FloatArray
    widths: FloatArray
    beyond: FloatArray
    ambiguity: FloatArray


def places() -> FloatArray:
    """Return the places over the range at which a law is compared with curves of nodes, those of a harmonic motion."""
    along: FloatArray = np.sin(np.linspace(1e-9, 0.5 * np.pi, _PLACES))
    return along


@dataclass(frozen=True, eq=False)
class _Curve:
    """A curve as families are compared with it.

    Attributes
    ----------
    odd, even : (n, m) arrays
        Forces at `places` of the nodes of either part, for node forces of one.
    line, over_line : (k,) arrays
        A line as node forces, and what is zero where no line is left.
    known : Known
        What the records say.
    """

    odd: FloatArray
    even: FloatArray
    line: FloatArray
    over_line: FloatArray
    known: Known

    @cached_property
    def to_nodes(self) -> FloatArray:
        """Matrix from a law at (-places, places) to the node forces of the curve nearest to it."""
        odd, even = 0.5 * np.linalg.pinv(self.odd), 0.5 * np.linalg.pinv(self.even)
        return np.block([[-odd, odd], [even, even]])

    def shape(self, laws: FloatArray) -> FloatArray:
        """Return the free coordinates (m, n) of one law or several that are given at (-places, places)."""
        return self._free(self.to_nodes @ laws.reshape(laws.shape[0], -1))

    def through(self, law: Law, number: float) -> FloatArray:
        """Return the free coordinates (m, n) of the curve whose nodes lie on a law."""
        count, even = self.odd.shape[1], self.even.shape[1]
        at = np.maximum(self.line[:count], _AT_REST)
        above, below = (law(each, number).reshape(count, -1) for each in (at, -at))
        return self._free(np.vstack([0.5 * (above - below), 0.5 * (above + below)[count - even :]]))

    def _free(self, nodes: FloatArray) -> FloatArray:
        """Return the free coordinates (m, n) of node forces, the line taken off."""
        nodes = nodes - np.outer(self.line, self.over_line @ nodes) / float(self.over_line @ self.line)
        free: FloatArray = self.known.frame.T @ nodes
        return free

    def beyond(self, law: FloatArray) -> FloatArray:
        """Return what a law at (-places, places) has beyond the curve nearest to it."""
        nodes = self.to_nodes @ law
        odd, even = self.odd @ nodes[: self.odd.shape[1]], self.even @ nodes[self.odd.shape[1] :]
        rest: FloatArray = law - np.concatenate([even - odd, even + odd])
        return rest

    def log_free(self) -> float:
        """Return what the curve itself gains over no curve, its bends integrated out."""
        known = self.known
        both = unit_diagonal(known.precision + known.prior)
        prior = both.scaled(known.prior)
        return 0.5 * float(
            known.pull @ both.solve(known.pull) + np.linalg.slogdet(prior)[1] - np.linalg.slogdet(both.matrix)[1]
        )


def proposals(found: CurveFit) -> tuple[Proposal, ...]:
    """Return the families of both curves, each curve's most probable first."""
    return judged(found)[0]


def judged(found: CurveFit) -> tuple[tuple[Proposal, ...], dict[str, tuple[Shape, ...]]]:
    """Return the families of both curves, each curve's most probable first, and the laws that each curve may follow."""
    told: list[Proposal] = []
    shapes: dict[str, tuple[Shape, ...]] = {}
    for curve, effect in (("conservative", STIFFNESS), ("damping", DAMPING)):
        mine, shapes[effect] = _of_curve(curve, _curve(found, effect), found, effect)
        told += mine
    return tuple(told), shapes


def _curve(found: CurveFit, effect: str) -> _Curve:
    """Return one curve of a fit."""
    tabulated = found.tabulated
    which = 0 if effect == STIFFNESS else 1
    rows = tabulated.forces(effect, places() * tabulated.ranges()[which])
    odd, even = (part.places for part in tabulated.parts if part.effect == effect)
    at = NODES[effect][-odd.size :]
    return _Curve(
        rows[:, odd], rows[:, even], np.concatenate([at, np.zeros(even.size)]),
        tabulated.lines()[which][tabulated.places(effect)], _blurred(found.known[effect]),
    )  # fmt: skip


def inexact_by(known: Known) -> float:
    """Return how far off a law may be at any node of a curve [N]."""
    return INEXACT * float(np.abs(known.frame @ known.place()).max())


def _blurred(known: Known) -> Known:
    """Return what is known with an error of its own at every node: no real force is exactly a law.

    Nor is a spline a kink or a root, by about as much.
    """
    inexact = inexact_by(known)
    values, vectors = np.linalg.eigh(known.precision)
    less = 1.0 / (1.0 + inexact**2 * np.maximum(values, 0.0))
    precision = (vectors * (np.maximum(values, 0.0) * less)) @ vectors.T
    return replace(known, precision=precision, pull=(vectors * less) @ (vectors.T @ known.pull))


def spared(known: Known, ambiguity: FloatArray) -> tuple[Known, float]:
    """Return what is known of a law whose curve in the fit may differ from the nearest one, and the evidence of that.

    Where a law bends faster than a spline does, as a root at rest, the records and not the forces say which spline
    stands for it: somewhere about the one nearest to it and the one through it.
    """
    seen = known.precision @ ambiguity
    less, pull = 1.0 + float(ambiguity @ seen), float(ambiguity @ known.pull)
    gain = 0.5 * (pull**2 / less - float(np.log(less)))
    precision = known.precision - np.outer(seen, seen) / less
    return replace(known, precision=precision, pull=known.pull - seen * (pull / less)), gain


def _of_curve(curve: str, known: _Curve, found: CurveFit, effect: str) -> tuple[list[Proposal], tuple[Shape, ...]]:
    """Return the families of one curve, most probable first, and their laws."""
    reach = found.tabulated.ranges()[0 if effect == STIFFNESS else 1]
    weighed: dict[str, _Weighed] = {}
    logs: dict[str, float] = {NOTHING: 0.0, NONE: known.log_free()}
    for family in FAMILIES[curve]:
        each = _weighed(family, known)
        if each is not None and each.log > logs.get(family.name, -np.inf):
            logs[family.name], weighed[family.name] = each.log, each
    logs[NOTHING] += np.log(len(logs) - 1.0)  # as probable beforehand as all others together
    total = float(logsumexp(list(logs.values())))
    nan = float("nan")
    made: list[Proposal] = []
    shapes: list[Shape] = []
    for name in sorted(logs, key=lambda key: -logs[key]):
        chance = float(np.exp(logs[name] - total))
        if name in weighed:
            made.append(weighed[name].told(curve, chance, reach))
            shapes += weighed[name].shapes(known, chance)
        else:
            made.append(Proposal(curve, name, chance, "", nan, nan, nan, nan))
    return made, tuple(shapes)


@dataclass(frozen=True, eq=False)
class _Weighed:
    """A family with its evidence: the better one of its laws, over all numbers."""

    family: _Family
    law: Law
    u: FloatArray
    numbers: FloatArray
    logs: FloatArray
    sizes: list[FloatArray]
    ambiguities: list[FloatArray]
    log: float

    @property
    def share(self) -> FloatArray:
        """Probability of each number, in units of the largest."""
        share: FloatArray = np.exp(self.logs - self.logs.max())
        return share

    def told(self, curve: str, chance: float, reach: float) -> Proposal:
        """Return what the family says."""
        share = self.share
        below = (np.cumsum(share) - 0.5 * share) / share.sum()
        top = int(np.argmax(self.logs))
        likeliest = self.numbers[top]  # where it lies at an end, the interval goes there
        low, high = np.interp([_EDGE, 1.0 - _EDGE], below, self.numbers)
        low, high = min(low, likeliest), max(high, likeliest)
        unit = 1.0 if self.family.number == "exponent" else reach
        return Proposal(
            curve, self.family.name, chance, self.family.number, float(likeliest) * unit, float(low) * unit,
            float(high) * unit, float(self.sizes[top][0]),
        )  # fmt: skip

    def shapes(self, known: _Curve, chance: float) -> list[Shape]:
        """Return the laws that count."""
        made = []
        chances = chance * self.share / self.share.sum()
        step = (self.family.high - self.family.low) / (_FINE - 1)
        for i in np.flatnonzero(chances > _COUNTS):
            number, size = float(self.numbers[i]), self.sizes[i]
            ends = np.clip([number - step, number + step], self.family.low, self.family.high)
            law = self.law(self.u, number).reshape(self.u.size, -1)
            before, here, after = (known.shape(self.law(self.u, float(at))) for at in (ends[0], number, ends[1]))
            change = (after - before) @ size * (step / (ends[1] - ends[0]))
            # within a step of the grid a number is as probable anywhere
            made.append(Shape(
                float(chances[i]), np.column_stack([here, change]),
                np.append(_WIDTH * np.abs(size), np.sqrt(1.0 / 12.0)), known.beyond(law @ size), self.ambiguities[i],
            ))  # fmt: skip
        return made


def _weighed(family: _Family, known: _Curve) -> _Weighed | None:
    """Return a family with its evidence; None where no number of it has a size of the right sign."""
    numbers = np.linspace(family.low, family.high, _FINE)
    out = family.is_left_out
    numbers = numbers[(numbers <= out[0]) | (numbers >= out[1])] if out[0] < out[1] else numbers
    u = np.concatenate([-places(), places()])
    best: _Weighed | None = None
    for law in family.laws:
        logs, sizes, ambiguities = np.full(numbers.size, -np.inf), [], []
        for i, number in enumerate(numbers):
            shape = known.shape(law(u, float(number)))
            logs[i], size = _evidence(known.known, shape, family.sign)
            ambiguities.append(np.zeros(shape.shape[0]))
            if family.is_steep:
                ambiguities[i] = (known.through(law, float(number)) - shape) @ size
                less, gain = spared(known.known, ambiguities[i])
                logs[i], size = _evidence(less, shape, family.sign)
                logs[i] += gain
            sizes.append(size)
        if np.isfinite(logs.max()) and (best is None or logs.max() > best.logs.max()):
            log = float(logsumexp(logs)) - np.log(numbers.size) - np.log(len(family.laws))
            best = _Weighed(family, law, u, numbers, logs, sizes, ambiguities, log)
    return best


def _evidence(known: Known, shape: FloatArray, sign: float) -> tuple[float, FloatArray]:
    """Return the logarithm of a shape's evidence against no curve, its sizes integrated out, and the sizes."""
    weight, slope = shape.T @ known.precision @ shape, shape.T @ known.pull
    size = unit_diagonal(weight).least_squares(slope, 1e-9)
    if not (np.diag(weight) > 0.0).all() or size[0] * sign < 0.0:
        return -np.inf, size
    width = np.maximum(_WIDTH * np.abs(size), 1e-300)
    inner = np.eye(size.size) + weight * np.outer(width, width)
    gain = (slope * width) @ np.linalg.solve(inner, slope * width)
    return 0.5 * float(gain - np.linalg.slogdet(inner)[1]), size
