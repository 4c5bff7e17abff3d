"""Looks: what each effect does to the level values at first order, over a grid of its shapes.

Per unit of strength an effect adds an equivalent stiffness and damping, a force at the turning points and a shift of
the mid-line. With these the level values of any set of effects are linear in the strengths, so that one matrix of
products serves all sets.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._common.checks import FloatArray
from ..fitting.data_term import LevelTerm
from ..fitting.layout import Layout
from ..fitting.starts import positions
from .look_kernels import AT_TURN, DAMPING, MIDDLE, STIFFNESS, averaged

POINTS, FEWER_POINTS = 64, 32
"""Instants of a cycle at which forces are looked at; fewer where states have to be integrated."""
ROUNDS = 4
"""Times that the harmonics of the motion are brought up to date."""
_SMALLEST_SLIP = 0.005  # of the amplitude
_PER_DECADE = 6
_OFTEN = 0.6  # slip displacement over the amplitude up to which most cycles of a decay tell it
_GAPS = (0.02, 0.05, 0.1, 0.17, 0.25, 0.33, 0.42, 0.5, 0.58, 0.67, 0.75, 0.83, 0.9, 0.96)
_ASYMMETRIES = (-0.4, 0.0, 0.4)
_EXPONENTS = (0.1, 0.5, 0.95)  # where these lie between their limits
_BETWEEN = (0.05, 0.3, 0.5, 0.7, 0.95)
_STRENGTHS = np.geomspace(2e-3, 1.5, 12)  # of asymmetric effects, in parts of the default bounds
_EVEN = 0.05  # force at rest over that which follows the motion, from which an effect shifts the mid-line
_CLOSE_TO_STRENGTH = 0.3  # an asymmetric atom stands for strengths so close to its own


@dataclass(frozen=True, eq=False)
class LevelData:
    """Level values of all specimens on their union of levels.

    Attributes
    ----------
    levels : (l,) array
        Amplitudes.
    omegas : (l,) array
        Mean angular frequency [rad/s].
    decrements : (l,) array
        Mean damping.
    count : (r,) array of int
        Values of each specimen.
    rows : (r, m, 2) array of int
        Observable and level of each value.
    values : (r, m) array
        Level values.
    covariance : list of (m, m) arrays
        Of the values of each specimen.
    mass : float
        Mass [kg].
    releases : (r,) array
        Release amplitudes; 0 where not known.
    """

    levels: FloatArray
    omegas: FloatArray
    decrements: FloatArray
    count: Any
    rows: Any
    values: FloatArray
    covariance: list[FloatArray]
    mass: float
    releases: FloatArray

    def whitening(self, frequency: FloatArray, damping: float, offset: float) -> FloatArray:
        """Return (r, m, m) matrices that whiten the values, with errors of a model added to those of the values.

        ``frequency`` (l,) is relative to the frequency, ``damping`` to the damping, ``offset`` absolute.
        """
        result = np.zeros((self.count.size, self.values.shape[1], self.values.shape[1]))
        for r, n in enumerate(self.count):
            observable, level = self.rows[r, :n, 0], self.rows[r, :n, 1]
            typical = np.abs(self.values[r, :n])
            typical = np.where(observable == 1, np.maximum(typical, 0.2 * self.decrements[level]), typical)
            floor = np.select(
                [observable == 0, observable == 1], [frequency[level] * typical, damping * typical], offset
            )
            covariance = self.covariance[r] + np.diag(floor**2)
            scale = np.sqrt(np.diag(covariance))
            factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-9 * np.eye(n))
            result[r, :n, :n] = np.linalg.inv(factor) / scale
        return result


def level_data(terms: Sequence[LevelTerm], mass: float) -> LevelData:
    """Return the level values of all specimens on their union of levels."""
    levels = np.unique(np.concatenate([w.levels for w in terms]))
    most = max(w.size for w in terms)
    rows = np.zeros((len(terms), most, 2), dtype=np.int64)
    values = np.zeros((len(terms), most))
    covariance = []
    table = np.full((len(terms), 2, levels.size), np.nan)
    for r, w in enumerate(terms):
        at = np.searchsorted(levels, w.levels)
        rows[r, : w.size, 0], rows[r, : w.size, 1] = w.rows[:, 0], at[w.rows[:, 1]]
        values[r, : w.size] = w.values
        root = np.linalg.inv(w.whitening)
        covariance.append(root @ root.T)
        for o in range(2):
            held = w.rows[:, 0] == o
            table[r, o, at[w.rows[held, 1]]] = w.values[held]
    mean = np.array([_filled(levels, row) for row in _row_means(table)])
    return LevelData(
        levels, 2.0 * np.pi * mean[0], np.maximum(mean[1], 1e-7),
        np.array([w.size for w in terms], dtype=np.int64), rows, values, covariance, mass,
        np.array([w.release for w in terms]),
    )  # fmt: skip


def _row_means(table: FloatArray) -> FloatArray:
    """Return means (o, l) over specimens that differ in their mean, where not all reach every level."""
    result = np.full(table.shape[1:], np.nan)
    for o in range(table.shape[1]):
        rows = table[:, o]
        held = np.isfinite(rows)
        if not held.any():
            continue
        centre = np.zeros(rows.shape[0])
        for _ in range(20):
            curve = np.where(held, rows - centre[:, None], 0.0).sum(axis=0) / np.maximum(held.sum(axis=0), 1)
            own = np.where(held, rows - curve, 0.0).sum(axis=1) / np.maximum(held.sum(axis=1), 1)
            centre = own - own.mean()
        result[o] = np.where(held.any(axis=0), curve, np.nan)
    return result


def _filled(levels: FloatArray, row: FloatArray) -> FloatArray:
    held = np.isfinite(row)
    return np.interp(levels, levels[held], row[held]) if held.any() else np.full(levels.size, 1e-3)


@dataclass(frozen=True, eq=False)
class Atoms:
    """The looks of one effect over a grid of its shapes.

    Attributes
    ----------
    points : (n, q) array
        Coordinates of the effect, the strength first.
    looks : (n, l, 4) array
        Stiffness, damping, force at the turn, mid-line over amplitude at that strength.
    places : (n, 3) array of int
        Place on the grid.
    is_positive : bool
        Whether the strength has one sign only.
    is_asymmetric : bool
        Whether each atom stands for strengths close to its own only.
    instants : int
        Of a cycle at which forces are looked at.
    """

    points: FloatArray
    looks: FloatArray
    places: Any
    is_positive: bool
    is_asymmetric: bool
    instants: int


def atoms_of(layout: Layout, effect: str, data: LevelData) -> Atoms:
    """Return the looks of ``effect``, the only one of ``layout`` beside stiffness and damping."""
    where = positions(layout, effect)
    shapes, places = shape_grid(layout, where)
    top = float(layout.width[where[0]] * np.sqrt(12.0))
    glance = _looks(layout, where, np.array([[0.1 * top, *shapes[len(shapes) // 2]]]), data, 2)
    shift = float(np.abs(glance[0, :, MIDDLE] * data.mass * data.omegas**2).max())
    follows = np.abs([glance[0, :, STIFFNESS], glance[0, :, AT_TURN], glance[0, :, DAMPING] * data.omegas])
    is_asymmetric = shift > _EVEN * float(follows.max())
    is_signed = bool(layout.low[where[0]] < 0.0)
    if not is_asymmetric:
        points = np.array([[0.1 * top, *shape] for shape in shapes])
        return Atoms(points, _looks(layout, where, points, data, 1), places, not is_signed, False, points_of(layout))
    signs = (1.0, -1.0) if is_signed else (1.0,)
    points = np.array([[s * g * top, *shape] for s in signs for g in _STRENGTHS for shape in shapes])
    more = [
        (*place, (1 if s > 0 else -1) * (3 + 2 * k))
        for s in signs
        for k in range(_STRENGTHS.size)
        for place in places[:, :2]
    ]
    return Atoms(points, _looks(layout, where, points, data, ROUNDS), np.array(more), True, True, points_of(layout))


def points_of(layout: Layout) -> int:
    """Return at how many instants of a cycle the forces of a layout are looked at."""
    return FEWER_POINTS if layout.simulator.is_costly else POINTS


def _looks(layout: Layout, where: list[int], points: FloatArray, data: LevelData, rounds: int) -> FloatArray:
    result = np.empty((len(points), data.levels.size, 4))
    eta = np.zeros(layout.free.size)
    for k, point in enumerate(points):
        eta[where] = point
        vector = layout.template.copy()
        vector[layout.free] = layout.physical(eta, np.zeros(eta.size), 0.0)[0]
        averaged(*layout.simulator.describe(), vector, data.levels, data.omegas, rounds, points_of(layout), result[k])
    return np.nan_to_num(result, posinf=0.0, neginf=0.0)


def shape_grid(layout: Layout, where: list[int]) -> tuple[FloatArray, Any]:
    """Return shapes (n, q - 1) of the effect at the places ``where``, and their places on the grid (n, 3)."""
    top = layout.width[where] * np.sqrt(12.0)
    forces = {force for _, force in layout.slips}
    powers = dict(layout.powers)
    pairs = {j: other for j, other in layout.opposed if j in where}
    axes: list[list[tuple[int, float]]] = []
    for j, place in enumerate(where[1:], start=1):
        if place in forces:
            high = min(layout.high[place], 10.0)
            number = round(_PER_DECADE * np.log10(high / _SMALLEST_SLIP)) + 1
            slips = np.geomspace(_SMALLEST_SLIP, 0.95 * high, number)
            # what slips at the largest amplitudes alone is as local in them as a gap that hardly closes
            axes.append(list(enumerate(np.unique([*slips, *(gap for gap in _GAPS if gap > _OFTEN)]))))
        elif place in layout.ordinates:
            axes.append([(0, 0.0)])
        elif place in pairs:  # asymmetry of a pair whose sum is on the other axis
            axes.append(list(enumerate(_ASYMMETRIES)))
        elif place in powers:  # displacement over amplitude at which the state saturates
            axes.append(list(enumerate(np.geomspace(_SMALLEST_SLIP, 3.0, 12))))
        elif abs(layout.high[place] - layout.low[place] - top[j]) < 1e-6 * top[j]:  # an exponent, or an asymmetry
            shares = _BETWEEN if layout.low[place] < 0.0 else _EXPONENTS
            axes.append([(3 * k, layout.low[place] + share * top[j]) for k, share in enumerate(shares)])
        elif layout.low[place] < 0.0:
            axes.append([(k, share * top[j]) for k, share in enumerate((-0.4, -0.1, 0.1, 0.4))])
        else:
            axes.append([(k, gap * top[j]) for k, gap in enumerate(_GAPS)])
    shapes, places = [], []
    for combination in itertools.product(*axes):
        eta = dict(zip(where[1:], (value for _, value in combination), strict=True))
        for place, exponent in powers.items():
            if place in eta and place not in pairs:
                eta[place] = eta[place] ** -eta[exponent]
        for place, other in pairs.items():
            total, share = eta[other], eta[place]
            eta[place], eta[other] = share * total, (1.0 - share) * total
        shapes.append([eta[place] for place in where[1:]])
        index = [k for k, _ in combination]
        places.append(([*index, 0, 0, 0])[:3])
    return np.array(shapes).reshape(len(shapes), len(where) - 1), np.array(places)


@dataclass(frozen=True, eq=False)
class Regression:
    """Products of all atoms and the data, each specimen's own stiffness, damping and scatter eliminated."""

    gram: FloatArray
    constants: FloatArray


def regression(
    data: LevelData, atoms: Sequence[Atoms], whitening: FloatArray, defect: FloatArray, scatter: FloatArray
) -> Regression:
    """Return the products of all atoms and the data.

    Parameters
    ----------
    data : LevelData
        Level values.
    atoms : sequence of Atoms
        Of all effects.
    whitening : (r, m, m) array
        As of `LevelData.whitening`.
    defect : (r, 3, l) array
        What the looks lack: taken from the data.
    scatter : (k, l, 4) array
        Looks of what specimens differ by, one standard deviation.
    """
    looks = np.concatenate([item.looks for item in atoms])
    n, own = len(looks), 3 + len(scatter)
    everything = np.concatenate([looks, scatter]).transpose(1, 2, 0)  # (l, 4, n + k)
    told, taken = [], []  # rows of the products of all specimens, and of what their own values take of these
    for r, m in enumerate(data.count):
        o, level = data.rows[r, :m, 0], data.rows[r, :m, 1]
        given = data.values[r, :m] - defect[r, o, level]
        frequency = np.full(data.levels.size, np.nan)
        frequency[level[o == 0]] = given[o == 0]
        omega = 2.0 * np.pi * np.where(np.isfinite(frequency), frequency, data.omegas / (2.0 * np.pi))[level]
        decrement = data.decrements.copy()
        decrement[level[o == 1]] = given[o == 1]
        over_omega = decrement[level] / (np.pi * omega)
        whole = data.mass * omega**2 * (1.0 + (decrement[level] / (2.0 * np.pi)) ** 2)
        is_f, is_d = (o == 0)[:, None], (o == 1)[:, None]
        here = everything[level]
        columns = np.zeros((m, n + own + 1))
        turned = here[:, DAMPING] - over_omega[:, None] * (here[:, AT_TURN] - here[:, STIFFNESS])
        values = np.where(is_f, here[:, STIFFNESS], np.where(is_d, turned, here[:, MIDDLE]))
        columns[:, :n], columns[:, n + 3 : n + own] = values[:, :n], values[:, n:]
        columns[:, n], columns[:, n + 1] = o == 0, o == 1
        columns[:, n + 2] = np.where(o == 2, data.levels[0] / data.levels[level], 0.0)  # the sensor's zero
        columns[:, -1] = np.where(o == 0, whole, np.where(o == 1, over_omega * whole, given))
        scale = np.where(is_f[:, 0], omega / (4.0 * np.pi * whole), np.where(is_d[:, 0], np.pi * omega / whole, 1.0))
        white = whitening[r, :m, :m] @ (scale[:, None] * columns)
        local = white[:, n : n + own]
        size = np.maximum(np.sqrt((local**2).sum(axis=0)), 1e-100)
        block = (local / size).T @ (local / size) + 1e-12 * np.eye(own)
        block[np.arange(3, own), np.arange(3, own)] += 1.0 / size[3:] ** 2
        rest = np.delete(white, np.arange(n, n + own), axis=1)
        told.append(rest)
        taken.append(np.linalg.solve(np.linalg.cholesky(block), (local / size).T @ rest))
    rows, own_rows = np.concatenate(told), np.concatenate(taken)
    gram = rows.T @ rows
    gram -= own_rows.T @ own_rows
    constants = np.zeros(n)
    first = 0
    for item in atoms:
        if item.is_asymmetric:
            held = slice(first, first + len(item.points))
            weight = _CLOSE_TO_STRENGTH**-2
            constants[held] = weight
            index = np.arange(held.start, held.stop)
            gram[index, index] += weight
            gram[index, n] += weight
            gram[n, index] += weight
        first += len(item.points)
    return Regression(gram, constants)
