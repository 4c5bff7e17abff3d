"""Which family of laws a force curve is of: each against the others, and against none of them.

What the records say of a curve is a quadratic function of its node forces: the precision of the fit less that of the
prior. A family is a shape with one number, summed over, and a size. "None of these" is the curve itself, with its prior
on bends. No line enters: that is stiffness and damping.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from .._common.checks import FloatArray
from .curve_fit import CurveFit, Known
from .curve_records import NONE, NOTHING, Proposal
from .tabulated import DAMPING, NODES, STIFFNESS

Law = Callable[[FloatArray, float], FloatArray]
_FINE = 161
_WIDTH = 3.0  # of the prior of a size, in units of what is found
_EDGE = 0.025
_INEXACT = 0.005  # of the largest node force: how far off a law may be at any node


@dataclass(frozen=True)
class _Family:
    """A family: its name, what its number is, shapes over the range, where the number lies, the sign of its size."""

    name: str
    number: str
    laws: tuple[Law, ...]
    low: float
    high: float
    sign: float = 0.0
    is_left_out: tuple[float, float] = (1.0, 1.0)


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


def _saturating(u: FloatArray, s: float) -> FloatArray:
    return np.tanh(u / s)


def _falling(u: FloatArray, s: float) -> FloatArray:
    """Friction that falls with speed: what falls first, then what stays."""
    return np.column_stack([np.sign(u) * np.exp(-np.abs(u) / s), np.sign(u)])


def _limited(u: FloatArray, s: float) -> FloatArray:
    return -u / (1.0 + (u / s) ** 2)


FAMILIES: dict[str, tuple[_Family, ...]] = {
    "conservative": (
        _Family("power law", "exponent", (_power,), 1.3, 8.0),
        _Family("power law, even", "exponent", (_even,), 1.3, 8.0),
        _Family("kink", "displacement", (_kink,), 0.05, 0.95),
        _Family("kink on one side", "displacement", (_kink_above, _kink_below), 0.0, 0.95),
        _Family("saturation", "displacement", (_saturating,), 0.02, 0.6),
    ),
    "damping": (
        _Family("power law", "exponent", (_power,), 0.0, 5.0, is_left_out=(0.85, 1.15)),
        _Family("power law on one side", "exponent", (_above, _below), 1.15, 5.0),
        _Family("saturation", "speed", (_saturating,), 0.02, 0.6, sign=1.0),
        _Family("minimum of damping", "speed", (_falling,), 0.02, 0.6, sign=1.0),
        _Family("minimum of damping", "speed", (_limited,), 0.04, 0.8, sign=1.0),
    ),
}


@dataclass(frozen=True, eq=False)
class _Curve:
    """A curve as families are compared with it: places of its odd nodes over the range, its line, what is known."""

    at: FloatArray
    line: FloatArray
    over_line: FloatArray
    known: Known

    def coordinates(self, law: FloatArray) -> FloatArray:
        """Return the free coordinates of a law that is given at (-at, at)."""
        below, above = law[: self.at.size], law[self.at.size :]
        nodes = np.concatenate([0.5 * (above - below), 0.5 * (above + below)[self.at > 0.0]])
        nodes = nodes - self.line * float(self.over_line @ nodes) / float(self.over_line @ self.line)
        free: FloatArray = self.known.frame.T @ nodes
        return free

    def log_free(self) -> float:
        """Return what the curve itself gains over no curve, its bends integrated out."""
        known = self.known
        scale = 1.0 / np.sqrt(np.maximum(np.diag(known.precision + known.prior), 1e-300))
        both = (known.precision + known.prior) * np.outer(scale, scale)
        pull = known.pull * scale
        prior = known.prior * np.outer(scale, scale)
        return 0.5 * float(
            pull @ np.linalg.solve(both, pull) + np.linalg.slogdet(prior)[1] - np.linalg.slogdet(both)[1]
        )


def proposals(found: CurveFit) -> tuple[Proposal, ...]:
    """Return the families of both curves, each curve's most probable first."""
    told: list[Proposal] = []
    for curve, effect in (("conservative", STIFFNESS), ("damping", DAMPING)):
        told += _of_curve(curve, _curve(found, effect), found, effect)
    return tuple(told)


def _curve(found: CurveFit, effect: str) -> _Curve:
    """Return one curve of a fit."""
    tabulated, nodes, places = found.tabulated, NODES[effect], found.tabulated.places(effect)
    odd = next(part.places.size for part in tabulated.parts if (part.effect, part.side) == (effect, "odd"))
    at = nodes[nodes.size - odd :]
    over = tabulated.lines()[0 if effect == STIFFNESS else 1][places]
    known = _blurred(found.known[effect])
    return _Curve(at, np.concatenate([at, np.zeros(places.size - odd)]), over, known)


def _blurred(known: Known) -> Known:
    """Return what is known with an error of its own at every node: no real force is exactly a law.

    Nor is a spline a kink or a root, by about as much.
    """
    both = known.precision + known.prior
    scale = 1.0 / np.sqrt(np.maximum(np.diag(both), 1e-300))
    place = scale * np.linalg.lstsq(both * np.outer(scale, scale), known.pull * scale, rcond=1e-13)[0]
    inexact = _INEXACT * float(np.abs(known.frame @ place).max())
    values, vectors = np.linalg.eigh(known.precision)
    less = 1.0 / (1.0 + inexact**2 * np.maximum(values, 0.0))
    precision = (vectors * (np.maximum(values, 0.0) * less)) @ vectors.T
    return replace(known, precision=precision, pull=(vectors * less) @ (vectors.T @ known.pull))


def _of_curve(curve: str, known: _Curve, found: CurveFit, effect: str) -> list[Proposal]:
    """Return the families of one curve, most probable first."""
    reach = found.tabulated.ranges()[0 if effect == STIFFNESS else 1]
    told: dict[str, Proposal] = {}
    logs: dict[str, float] = {NOTHING: 0.0, NONE: known.log_free()}
    for family in FAMILIES[curve]:
        log, proposal = _weighed(curve, family, known, reach)
        if log > logs.get(family.name, -np.inf):
            logs[family.name], told[family.name] = log, proposal
    logs[NOTHING] += np.log(len(logs) - 1.0)  # as probable beforehand as all others together
    total = float(logsumexp(list(logs.values())))
    nan = float("nan")
    made = []
    for name in sorted(logs, key=lambda key: -logs[key]):
        chance = float(np.exp(logs[name] - total))
        held = told.get(name, Proposal(curve, name, chance, "", nan, nan, nan, nan))
        made.append(Proposal(curve, name, chance, held.number, held.value, held.low, held.high, held.size))
    return made


def _weighed(curve: str, family: _Family, known: _Curve, reach: float) -> tuple[float, Proposal]:
    """Return the logarithm of a family's evidence, and what it says."""
    numbers = np.linspace(family.low, family.high, _FINE)
    out = family.is_left_out
    numbers = numbers[(numbers <= out[0]) | (numbers >= out[1])] if out[0] < out[1] else numbers
    u = np.concatenate([-known.at, known.at])
    if known.at[0] == 0.0:  # friction begins just beyond rest
        u = np.where(u == 0.0, np.where(np.arange(u.size) < known.at.size, -1e-12, 1e-12), u)
    best, logs, sizes = -np.inf, np.empty(0), np.empty(0)
    for law in family.laws:
        each, size = np.full(numbers.size, -np.inf), np.zeros(numbers.size)
        for i, number in enumerate(numbers):
            each[i], size[i] = _evidence(known, law(u, float(number)).reshape(u.size, -1), family.sign)
        if each.max() > best:
            best, logs, sizes = float(each.max()), each, size
    if not np.isfinite(best):
        return -np.inf, Proposal(curve, family.name, 0.0, "", *(float("nan"),) * 4)
    log = float(logsumexp(logs)) - np.log(numbers.size) - np.log(len(family.laws))
    share = np.exp(logs - best)
    below = (np.cumsum(share) - 0.5 * share) / share.sum()
    low, high = np.interp([_EDGE, 1.0 - _EDGE], below, numbers)
    top = int(np.argmax(logs))
    unit = 1.0 if family.number == "exponent" else reach
    return log, Proposal(
        curve, family.name, 0.0, family.number, float(numbers[top]) * unit, float(low) * unit, float(high) * unit,
        float(sizes[top]),
    )  # fmt: skip


def _evidence(known: _Curve, columns: FloatArray, sign: float) -> tuple[float, float]:
    """Return the logarithm of a shape's evidence against no curve, its sizes integrated out, and the first size."""
    shape = np.column_stack([known.coordinates(column) for column in columns.T])
    weight, slope = shape.T @ known.known.precision @ shape, shape.T @ known.known.pull
    scale = 1.0 / np.sqrt(np.maximum(np.diag(weight), 1e-300))
    size = scale * np.linalg.lstsq(weight * np.outer(scale, scale), slope * scale, rcond=1e-9)[0]
    if not (np.diag(weight) > 0.0).all() or size[0] * sign < 0.0:
        return -np.inf, 0.0
    width = np.maximum(_WIDTH * np.abs(size), 1e-300)
    inner = np.eye(size.size) + weight * np.outer(width, width)
    gain = (slope * width) @ np.linalg.solve(inner, slope * width)
    return 0.5 * float(gain - np.linalg.slogdet(inner)[1]), float(size[0])
