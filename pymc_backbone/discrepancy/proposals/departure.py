"""Departures of measured backbones from what any set of effects gives: smooth over amplitude, alike in all specimens.

No library describes a structure exactly. Each observable departs by a Gaussian process over the logarithm of the
amplitude, of one of several sizes and smoothnesses; this module holds the values and their covariances for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ..fitting.batch import Batch
from .looks import level_data

SIZES = np.array([0.0, 0.003, 0.007, 0.016, 0.037, 0.085, 0.2, 0.45, 1.0])
"""Standard deviations of a departure, in units of the force whose change with amplitude is measured."""
PRIOR_OF_SIZES = np.array([0.25, 0.12, 0.12, 0.12, 0.12, 0.12, 0.12, 0.025, 0.005])
"""Prior probability of each: none at all, any order of magnitude alike up to a fifth, and seldom more.

A departure that rivals all that is measured is as improbable as that the library holds nothing of what is missing.
"""
NOISES = np.array([0.15, 0.4, 1.0, 2.0, 4.0, 10.0, 30.0])
"""Factors of the standard errors: what scatters between levels is no law; smooth curves scatter less than is said."""
PRIOR_OF_NOISES = np.array([0.15, 0.25, 0.30, 0.15, 0.08, 0.05, 0.02])
"""Prior probability of each; that errors are smaller than is said, only specimens can show that scatter less."""
SCALES = (0.15, 0.5)
"""Decades of amplitude over which a departure is smooth."""
OWN_SHARE = 0.2
"""Departure of each specimen of its own, as a share of the common one."""
_MOST_LEVELS = 24
_LEAST_CHANGE = 1e-7
_LEAST_DAMPING = 0.2  # of the mean damping: where less is there, departures are no share of it
_NUGGET = 1e-9


@dataclass(frozen=True)
class Choice:
    """One size and one factor of the noise for each observable, and one smoothness."""

    scale: int
    sizes: tuple[int, int, int]
    noises: tuple[int, int, int]


class Departures:
    """Departures of the backbones of some specimens, of every size.

    Parameters
    ----------
    batch : Batch
        At most as many specimens as are needed.
    mass : float
        Mass [kg].
    """

    def __init__(self, batch: Batch, mass: float) -> None:
        self.batch = batch
        data = level_data(batch.levels, mass)
        thinned = np.unique(
            np.linspace(0, data.levels.size - 1, min(data.levels.size, _MOST_LEVELS)).round().astype(int)
        )
        self.levels = data.levels[thinned]
        self.nodes = np.log(self.levels)
        kept: list[tuple[IntArray, IntArray]] = []  # of each specimen: places in its values, levels
        owner, observable, level, values, blocks = [], [], [], [], []
        for r, count in enumerate(data.count):
            rows = data.rows[r, :count]
            held = np.flatnonzero(np.isin(rows[:, 1], thinned))
            kept.append((rows[held, 0], np.searchsorted(thinned, rows[held, 1])))
            owner.append(np.full(held.size, r))
            observable.append(kept[-1][0])
            level.append(kept[-1][1])
            values.append(data.values[r, held])
            blocks.append(data.covariance[r][np.ix_(held, held)])
        self.kept = kept
        self.owner, self.observable = np.concatenate(owner), np.concatenate(observable)
        self.level, self.values = np.concatenate(level), np.concatenate(values)
        covariance = np.zeros((self.owner.size, self.owner.size))
        for r, block in enumerate(blocks):
            at = np.flatnonzero(self.owner == r)
            covariance[np.ix_(at, at)] = block
        self.rows = [np.flatnonzero(self.observable == o) for o in range(3)]
        covariance += self._smooth_errors(covariance)
        frequency, damping = data.omegas[thinned] / (2.0 * np.pi), data.decrements[thinned]
        typical = np.maximum(damping, _LEAST_DAMPING * damping.mean())
        self.units = np.array([frequency, typical, np.ones(frequency.size)])
        self.changes = _changes(self.values, self.owner, self.rows, self.units)
        self.inverse: list[list[FloatArray]] = []
        self.log_determinant: list[list[FloatArray]] = []
        for scale in SCALES:
            pairs = [self._inverses(o, scale, covariance) for o in range(3)]
            self.inverse.append([item[0] for item in pairs])
            self.log_determinant.append([item[1] for item in pairs])
        self.covariance = covariance
        is_shown = np.array([len(batch.levels) > 1] * 2 + [False])  # a mid-line rests on a zero that is no curve's
        possible = np.where((NOISES < 1.0) & ~is_shown[:, None], 1e-12, PRIOR_OF_NOISES)
        self.prior_of_noises: FloatArray = possible / possible.sum(axis=1, keepdims=True)
        variance = np.diag(covariance)
        self.noise = np.array([np.sqrt(np.median(variance[rows])) if rows.size else np.inf for rows in self.rows])
        self.per_force = np.array([0.5 * float(self.units[0].mean()), np.pi, 1.0])
        self.elapsed = self._elapsed()

    def kernel(self, scale: float, here: IntArray, there: IntArray) -> FloatArray:
        """Return the Matern correlation (5/2) of two lists of levels."""
        steps = np.abs(np.log10(self.levels[here])[:, None] - np.log10(self.levels[there]))
        distance = np.sqrt(5.0) * steps / scale
        kernel: FloatArray = (1.0 + distance + distance**2 / 3.0) * np.exp(-distance)
        return kernel

    def _smooth_errors(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance of errors as large as the others, but smooth over the levels of a specimen.

        Curves that were smoothed err smoothly, too: else the error of a slope would be taken for a drift.
        """
        error = np.sqrt(np.diag(covariance))
        is_same = (self.owner[:, None] == self.owner) & (self.observable[:, None] == self.observable)
        smooth: FloatArray = np.outer(error, error) * self.kernel(SCALES[-1], self.level, self.level) * is_same
        return smooth

    def departing(self, o: int, scale: float, common: float = 1.0, own: float = OWN_SHARE) -> FloatArray:
        """Return the covariance of the values of one observable by a departure of unit size."""
        rows = self.rows[o]
        unit = self.changes[o] * self.units[o, self.level[rows]]
        is_same = self.owner[rows][:, None] == self.owner[rows]
        share = common + own**2 * is_same if len(self.kept) > 1 else 1.0
        return self.kernel(scale, self.level[rows], self.level[rows]) * np.outer(unit, unit) * share

    def _inverses(self, o: int, scale: float, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inverses (sizes, noises, n, n) of the covariance of one observable, and log determinants."""
        rows = self.rows[o]
        noise = covariance[np.ix_(rows, rows)]
        departing = self.departing(o, scale)
        whole = SIZES[:, None, None, None] ** 2 * departing + NOISES[:, None, None] ** 2 * noise
        return inverted(whole)

    def _elapsed(self) -> FloatArray:
        """Return the share of its record after which each value was passed (n,); zeros without cycles."""
        elapsed = np.zeros(self.owner.size)
        for r, cycles in enumerate(self.batch.cycles):
            order = np.argsort(cycles.smoothed_amplitude)
            share = (cycles.time - cycles.time[0]) / max(float(np.ptp(cycles.time)), 1e-300)
            at = self.owner == r
            elapsed[at] = np.interp(self.levels[self.level[at]], cycles.smoothed_amplitude[order], share[order])
        return elapsed


def _changes(values: FloatArray, owner: IntArray, rows: list[IntArray], units: FloatArray) -> FloatArray:
    """Return the departure (3,) of each observable, in its unit, that rivals what the backbones show.

    One force stands for all: the change with amplitude of the force in phase and in quadrature, as a share of the
    elastic one. What is small beside it in one observable may be a departure however much of that curve it is.
    """
    frequency, damping = units[0], units[1]
    stiff = [np.log(values[rows[0]][owner[rows[0]] == r]).std() for r in np.unique(owner[rows[0]])]
    whole = 2.0 * max(float(np.log(frequency).std()), float(np.mean(stiff)) if stiff else 0.0)
    force = max(float(np.hypot(whole, damping.std() / np.pi)), _LEAST_CHANGE)
    offset = float(np.sqrt((values[rows[2]] ** 2).mean())) if rows[2].size else 0.0
    return np.array([0.5 * force, np.pi * force / damping.mean(), max(force, offset)])


def inverted(whole: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return inverses and log determinants of covariances (..., n, n)."""
    n = whole.shape[-1]
    if n == 0:
        return whole, np.zeros(whole.shape[:-2])
    scale = np.sqrt(np.einsum("...ii->...i", whole))
    scaled = whole / (scale[..., :, None] * scale[..., None, :]) + _NUGGET * np.eye(n)
    factor = np.linalg.cholesky(scaled)
    half = np.linalg.inv(factor) / scale[..., None, :]
    determinant = 2.0 * (np.log(np.einsum("...ii->...i", factor)).sum(axis=-1) + np.log(scale).sum(axis=-1))
    return np.swapaxes(half, -1, -2) @ half, determinant
