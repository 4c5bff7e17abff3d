"""Stepwise least squares on the restoring-force surface, with a strict BIC.

The equation of motion is low-passed: ``h * x'' + sum of c_i (h * f_i(x, x')) = 0`` with one kernel h for all columns.
Coefficients are fitted record by record, and shape parameters (a gap, a slip displacement) are chosen record by
record from a grid; which effects are there is decided for the batch. Effects with memory have columns too, which are
computed along the displacement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pymc_backbone import Record

from .columns import common_amplitude, hysteretic_columns, memoryless_columns
from .search import Table, make_table, search
from .signals import Signal, signals_of

PENALTY = 2.0
"""How many times the BIC penalty a parameter has to pay."""
SHARE_REMOVED = 0.01
"""Share of the residual sum of squares that an effect has to remove."""


def name_effects(records: Sequence[Record], mass: float, base: Sequence[str]) -> list[str] | None:
    """Name the effects that are missing from a base model.

    Parameters
    ----------
    records : sequence of Record
        Free decays.
    mass : float
        Mass [kg]; not needed, because coefficients are divided by it.
    base : sequence of str
        Effects the model holds already.

    Returns
    -------
    list of str or None
        The effects named, none if nothing is missing; None when no record could be used.

    Notes
    -----
    The criterion is the sum over records of ``n ln(residual sum of squares) + PENALTY k ln n`` with n the number of
    independent rows and k the coefficients and shape parameters of that record. Each effect of a set must also
    remove `SHARE_REMOVED` of what the set leaves without it.
    """
    signals = signals_of(records)
    if not signals:
        return None
    amplitude = common_amplitude(signals)
    return search([_table(signal, amplitude) for signal in signals], base, _criterion, _enough)


def _criterion(table: Table, left: float, size: int) -> float:
    return table.rows * np.log(max(left, 1e-30)) + PENALTY * size * np.log(table.rows)


def _enough(without: Sequence[float], present: Sequence[float]) -> bool:
    change = np.log(np.maximum(present, 1e-30)) - np.log(np.maximum(without, 1e-30))
    return bool(np.mean(change) < np.log(1.0 - SHARE_REMOVED))


def _table(signal: Signal, amplitude: float) -> Table:
    columns = memoryless_columns(signal, amplitude) | hysteretic_columns(signal, amplitude)
    filtered = {name: [signal.low_pass(column) for column in values] for name, values in columns.items()}
    linear = [signal.low_pass(np.ones_like(signal.displacement))]
    linear += [*filtered.pop("linear_stiffness"), *filtered.pop("viscous_damping")]
    target = -signal.acceleration() / (amplitude * signal.angular_frequency**2)
    return make_table(linear, filtered, target, target.size * signal.independent_share())
