"""The normal equations of both curves and all specimens together: what is free, and the priors of the bends.

A specimen has its own stiffness, damping, release and offset, as in every joint fit; of the curves it has its own size,
a tenth more or less, so that the curves are those of the mean specimen. Each part has a Gaussian prior on its bends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._common.checks import FloatArray
from ..fitting.data_term import DataTerm
from ..fitting.normal_equations import DRIFTS, NUISANCES, State, System, linearise
from .tabulated import DAMPING, STIFFNESS, Tabulated

_NAMED = 1e-4  # of what is named, in units of its prior


@dataclass(frozen=True, eq=False)
class Frame:
    """What is free in a fit.

    Attributes
    ----------
    directions : (n, m) array
        Takes free coordinates to shared coordinates and, behind these, the specimens' own.
    scatter : (m,) array
        Ones where a free coordinate is a scatter, of unit width.
    parts : tuple of (m, m) arrays
        Roughness of each part of the curves.
    loose : (m, m) array
        Precision of what the bends leave open.
    active : (w,) array of bool
        Which of a specimen's own coordinates are free.
    own_columns : mapping of str to slice
        Free coordinates of each curve.
    """

    directions: FloatArray
    scatter: FloatArray
    parts: tuple[FloatArray, ...]
    loose: FloatArray
    active: Any
    own_columns: Mapping[str, slice]

    def prior(self, levels: FloatArray) -> FloatArray:
        """Return the precision of the free coordinates beforehand, but for scatter, at precisions (4,) of the bends."""
        bends = sum(level * part for level, part in zip(levels, self.parts, strict=True))
        precision: FloatArray = self.loose + bends
        return precision


def frame_of(tabulated: Tabulated, count: int, nuisances: Sequence[int]) -> Frame:
    """Return the free directions of ``count`` specimens."""
    q = tabulated.layout.free.size
    width = NUISANCES + q
    shared, own_columns = tabulated.free_basis()
    columns = [np.concatenate([direction, np.zeros(count * width)]) for direction in shared.T]
    is_scatter = [0.0] * len(columns)

    def own(values: FloatArray, place: Any) -> FloatArray:
        column = np.zeros((count, width))
        column[:, place] = values
        return np.concatenate([np.zeros(q), column.ravel()])

    for n in nuisances:
        for r in range(count):
            columns.append(own(np.eye(count)[r], n))
            is_scatter.append(float(n >= DRIFTS[0]))
    if count > 1:
        for place in tabulated.named:
            for r in range(count):
                columns.append(own(np.eye(count)[r], NUISANCES + place))
                is_scatter.append(1.0)
        # sizes that add up to nothing: the curves are those of the mean specimen
        sizes = np.linalg.svd(np.ones((1, count)))[2][1:]
        for effect in (STIFFNESS, DAMPING):
            places = tabulated.places(effect)
            for values in sizes:
                columns.append(own(values[:, None], NUISANCES + places))
                is_scatter.append(1.0)
    directions = np.array(columns).T
    parts, precision = [], _NAMED / tabulated.layout.width**2
    for part in tabulated.parts:
        precision[part.places] = tabulated.loose(part) / tabulated.scale**2
        rows = directions[part.places] / tabulated.scale
        parts.append(rows.T @ part.roughness @ rows)
    loose = (directions[:q] * precision[:, None]).T @ directions[:q]
    active = np.zeros(width, dtype=bool)
    active[list(nuisances)] = True
    active[NUISANCES:] = count > 1
    return Frame(directions, np.array(is_scatter), tuple(parts), loose, active, own_columns)


@dataclass(frozen=True, eq=False)
class At:
    """A point with its normal equations."""

    state: State
    system: System


def evaluated(tabulated: Tabulated, terms: Sequence[DataTerm], state: State, frame: Frame) -> At | None:
    """Return a point with its normal equations; None where it cannot be simulated."""
    scatter = tabulated.layout.scatter if len(terms) > 1 else 0.0
    system = linearise(tabulated.layout, terms, state, scatter, frame.active)
    return None if system is None else At(state, system)


def objective(
    at: At, frame: Frame, levels: FloatArray, weight: float, tabulated: Tabulated
) -> tuple[FloatArray, FloatArray, float]:
    """Return Hessian, downhill slope and value of the sum of squares with all priors."""
    system, state = at.system, at.state
    q, (count, width) = tabulated.layout.free.size, state.own.shape
    full = np.zeros((q + count * width,) * 2)
    slope = np.zeros(q + count * width)
    full[:q, :q], slope[:q] = system.shared, system.shared_gradient
    priors = np.flatnonzero(frame.active & (np.arange(width) >= DRIFTS[0]))
    for r in range(count):
        block = slice(q + r * width, q + (r + 1) * width)
        own, gradient = system.own[r].copy(), system.own_gradient[r].copy()
        own[priors, priors] -= 1.0  # what the joint fit takes for every coordinate; here a curve has one size
        gradient[priors] += state.own[r, priors]
        full[block, block], slope[block] = own, gradient
        full[:q, block], full[block, :q] = system.mixed[r], system.mixed[r].T
    directions = frame.directions
    prior = frame.prior(levels) + np.diag(frame.scatter)
    place = place_of(at, frame)
    hessian = weight * (directions.T @ full @ directions) + prior
    downhill = weight * (directions.T @ slope) - prior @ place
    return hessian, downhill, weight * float(system.chi_square.sum()) + float(place @ prior @ place)


def place_of(at: At, frame: Frame) -> FloatArray:
    """Return the free coordinates of a point; those of the specimens' own values are left at zero."""
    values = np.concatenate([at.state.eta, at.state.own.ravel()])
    place: FloatArray = np.linalg.lstsq(frame.directions, values, rcond=None)[0]
    return place


def weight_of(at: At, count: float, sizes: FloatArray | None) -> float:
    """Return the factor of chi-square: the noise is what the residuals show, counted in independent pieces."""
    left = float(at.system.chi_square.sum())
    return min((count if sizes is None else float(sizes.sum())) / max(left, 1e-300), 1.0)
