"""Closed-form first-order fits of the backbones, with BIC and a floor for the error of the model.

The backbones of frequency and damping, and the offset, are extracted with the package; to first order each is a linear
combination of what the effects contribute (`first_order`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.polynomial import polynomial
from scipy.linalg import cholesky, solve_triangular
from scipy.special import gamma

from pymc_backbone import Cycles, InputError, Record, backbones_at_levels, extract_cycles

from .columns import Columns
from .first_order import Contribution, contributions
from .search import Table, make_table, search
from .signals import Array, conditioned_records

OBSERVABLES = ("frequency", "damping", "offset")
PENALTY = 2.0
"""How many times the BIC penalty a parameter has to pay."""
FREQUENCY_FLOOR = 0.02
"""Model error of the squared frequency, in ranges of its backbone."""
FREQUENCY_CURVATURE = 0.1
"""Model error of the squared frequency, in squared relative changes: the second order."""
DAMPING_FLOOR = 0.03
"""Model error of the loss, in ranges of its backbone."""
DAMPING_COUPLING = 0.4
"""Model error of the loss, in products of loss and relative change of stiffness: the second order."""
OFFSET_FLOOR = 0.05
"""Model error of the offset, in its largest value."""
OFFSET_ERROR = 3e-4
"""Smallest model error of the offset."""
RATE_FLOOR = 0.3
"""Model error of the squared frequency and of the offset, in what damping changes of them to second order."""


def name_effects(records: Sequence[Record], mass: float, base: Sequence[str]) -> list[str] | None:
    """Name the effects that are missing from a base model.

    Parameters
    ----------
    records : sequence of Record
        Free decays.
    mass : float
        Mass [kg]; not needed, because every stiffness is divided by it.
    base : sequence of str
        Effects the model holds already.

    Returns
    -------
    list of str or None
        The effects named, none if nothing is missing; None when no backbone could be extracted.

    Notes
    -----
    The criterion is the sum over records of ``chi-square + PENALTY k ln n`` with n the level values and k the
    coefficients and shape parameters of that record; the covariance is that of the extracted backbones plus the
    square of the model error on its diagonal.
    """
    cycles = extracted_cycles(tuple(records))
    if not cycles:
        return None
    amplitude = float(np.median([item.smoothed_amplitude.max() for item in cycles]))
    tables = []
    for item in cycles:
        try:
            backbones = backbones_at_levels(item, _levels(item), OBSERVABLES)
            tables.append(_table(backbones, amplitude))
        except (InputError, np.linalg.LinAlgError):
            continue
    return search(tables, base, _criterion, lambda without, present: True) if tables else None


@lru_cache(maxsize=2)
def extracted_cycles(records: tuple[Record, ...]) -> tuple[Cycles, ...]:
    """Extract the cycles of the records that have some."""
    kept = []
    for record in conditioned_records(records):
        try:
            kept.append(extract_cycles(record))
        except InputError:
            continue
    return tuple(kept)


def _levels(item: Cycles) -> Array:
    """Return up to ten levels over the amplitudes of a record, its first cycle aside."""
    amplitude = np.sort(item.smoothed_amplitude)
    low, high = np.log(amplitude[0]), np.log(amplitude[-2])
    inset = 0.02 * (high - low)
    return np.exp(np.linspace(low + inset, high - inset, int(np.clip(amplitude.size // 2, 3, 10))))


def _criterion(table: Table, left: float, size: int) -> float:
    return left + PENALTY * size * np.log(table.rows)


def _table(backbones: xr.Dataset, amplitude: float) -> Table:
    """Return the whitened least-squares problem of one record."""
    level = backbones["level"].values / amplitude
    frequency, damping, offset = backbones["value"].values[0]
    covariance = backbones["covariance"].values[0]
    reference = float(np.median(frequency))
    speed = frequency / reference
    rate = damping / (2.0 * np.pi)
    # damping lowers the frequency and lifts the mid-line of a decaying cycle, to second order
    storage = speed**2 * (1.0 + rate**2)
    offset = offset - damping**2 / 16.0
    slope, quadratic = _mid_line(level, offset, covariance[2])
    # a decrement is a loss of energy over amplitude times force at the turning point, and of peaks, not of amplitudes
    loss = damping * turning_point_stiffness(level, storage) / (1.0 + slope) / np.pi
    change = np.abs(storage - storage[0])
    floors = (
        FREQUENCY_FLOOR * np.ptp(storage) + FREQUENCY_CURVATURE * change**2 + RATE_FLOOR * rate**2,
        DAMPING_FLOOR * np.ptp(loss) + DAMPING_COUPLING * np.abs(loss) * change,
        OFFSET_ERROR + OFFSET_FLOOR * np.max(np.abs(offset)) + RATE_FLOOR * damping**2 / 16.0,
    )
    scales = (2.0 * speed / reference, loss / damping, np.ones_like(offset))
    whiteners = [
        cholesky(scale[:, None] * block * scale + np.diag(floor**2 + 1e-24), lower=True)
        for scale, block, floor in zip(scales, covariance, floors, strict=True)
    ]

    def whiten(item: Contribution) -> Array:
        parts = zip(whiteners, (item.storage, item.loss, item.offset), strict=True)
        return np.concatenate([solve_triangular(factor, part, lower=True) for factor, part in parts])

    effects = contributions(level, speed, amplitude, quadratic, rate)
    columns: Columns = {name: [whiten(item) for item in items] for name, items in effects.items()}
    linear = [*columns.pop("linear_stiffness"), *columns.pop("viscous_damping")]
    # an error of the baseline
    linear.append(whiten(Contribution(np.zeros_like(level), np.zeros_like(level), 1.0 / level)))
    target = whiten(Contribution(storage, loss, offset))
    return make_table(linear, columns, target, float(target.size))


def turning_point_stiffness(level: Array, storage: Array) -> Array:
    """Return force over amplitude at the turning points, from the describing function of the force.

    A force ``x |x|^n`` has the describing function ``C_n |a|^n``; the storage is fitted by a polynomial of which each
    power is divided by its ``C_n``.
    """
    power = np.arange(min(5, level.size - 1))
    factor = 2.0 * gamma((power + 3) / 2) / (np.sqrt(np.pi) * gamma((power + 4) / 2))
    coefficients = polynomial.polyfit(level, storage, power[-1])
    turning = polynomial.polyval(level, coefficients / factor)
    # a polynomial that runs away, as at a kink, is worse than the describing function itself
    return np.clip(turning, storage - np.ptp(storage), storage + np.ptp(storage))


def _mid_line(level: Array, offset: Array, covariance: Array) -> tuple[Array, float]:
    """Fit the mid-line ``b1 a + b2 a^2``; return its slope and the quadratic spring that ``b2`` stands for."""
    factor = cholesky(covariance + 1e-12 * np.eye(level.size), lower=True)
    basis = solve_triangular(factor, np.column_stack([np.ones_like(level), level]), lower=True)
    first, second = np.linalg.lstsq(basis, solve_triangular(factor, offset, lower=True), rcond=None)[0]
    alone = basis[:, 1] @ solve_triangular(factor, offset, lower=True) / (basis[:, 1] @ basis[:, 1])
    return first + 2.0 * second * level, float(-3.0 * alone)
