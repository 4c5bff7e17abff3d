"""Backbones of many parameter vectors of one oscillator: in lanes where that can be done, else one after the other.

Lanes are taken for effects that declare no kinks, no memory, no states of their own and no parameter but a strength,
and where there are enough vectors that code for lanes is worth loading. A lane whose own estimate of its error is too
large is run again with more steps and more care; what is left goes through the simulator of single ones, as do motions
that do not complete a cycle, so that the reasons are the same.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .._common.checks import FloatArray, IntArray
from .._common.threads import in_threads
from . import kernels
from .decay import Simulator
from .lane_cycles import is_smooth
from .lane_stages import LANES
from .lanes import lane_backbones, lane_errors
from .memory import Description

LEAST = 512
"""So many parameter vectors go into lanes; fewer are simulated before the code for lanes is read from disk."""
ACCURACY = 2e-7
"""Largest error that a lane may estimate for itself: relative, of the damping relative to at least 0.003.

The estimate is no bound: of 160 000 lanes with up to three strong effects that it let pass, the worst was off by 5e-7.
"""
_PILOT_STEPS = 4
_STEPS = np.array([4, 6, 8, 10, 12, 14, 16, 20, 24, 28])
_ORDER = 7  # of the estimate: it falls so with the number of steps
_MARGIN = 8.0  # other levels may be harder than the highest and the lowest
_AGAIN = 1.4  # so many times the steps the second time at least
_FEWEST_BETWEEN = 5  # levels between which can be interpolated ...
_WIDEST = 2.0  # ... none more than so many times the next
_BLOCKS_PER_JOB = 8
_SINGLES_PER_JOB = 64


def simulate_many(
    simulator: Simulator,
    parameters: FloatArray,
    levels: FloatArray,
    release: float = 0.0,
    virgin: bool = True,
    *,
    least: int = LEAST,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the backbones of many parameter vectors, on all cores.

    Parameters
    ----------
    simulator : Simulator
        The oscillator.
    parameters : (n, p) array
        In the order of the oscillator's parameters.
    levels : (l,) array
        Increasing amplitudes [m or rad].
    release : float, default 0.0
        Release of the whole decay [m or rad]; 0 lets the simulator choose.
    virgin : bool, default True
        Whether hysteretic states start loaded from rest.
    least : int
        Fewest parameter vectors that go into lanes.

    Returns
    -------
    values : (n, 3, l) array
        Frequency [Hz], damping, offset; NaN where ``status`` is not 0. In lanes within 1e-6 of the exact ones.
    status : (n, l) array
        As `BackboneResult.status`.
    """
    table = np.ascontiguousarray(parameters, dtype=np.float64)
    description = simulator.describe(levels, release, virgin)
    values = np.full((len(table), 3, levels.size), np.nan)
    status = np.zeros((len(table), levels.size), dtype=np.int64)
    rest = np.arange(len(table))
    if release == 0.0 and len(table) >= least and can_take_lanes(simulator):
        errors = _in_lanes(description, table, levels, values)
        rest = np.flatnonzero(~(errors <= ACCURACY))
    in_threads([_singles(description, table, part, values, status) for part in _parts(rest, _SINGLES_PER_JOB)])
    return values, status


def can_take_lanes(simulator: Simulator) -> bool:
    """Return whether all effects are compiled into lanes: smooth ones of the library, one of which may add mass."""
    effects = simulator.oscillator.effects
    heavier = sum(effect.added_mass is not None for effect in effects)
    return simulator.user == 0 and heavier <= 1 and all(is_smooth(effect) for effect in effects)


def _in_lanes(description: Description, table: FloatArray, levels: FloatArray, values: FloatArray) -> FloatArray:
    """Write the backbones of those parameter vectors whose errors (n,), which are returned, are below `ACCURACY`."""
    need = _steps_needed(description, table)
    errors = np.full(len(table), np.inf)
    wide = levels.size < _FEWEST_BETWEEN or bool(np.any(levels[1:] > _WIDEST * levels[:-1]))
    for carefully in (True,) if wide else (False, True):
        left = np.flatnonzero(~(errors <= ACCURACY) & (need <= _STEPS[-1]))
        order = left[np.argsort(need[left], kind="stable")]
        # each block takes the steps that its last lane needs
        last = np.minimum(np.arange(LANES, order.size + LANES, LANES), order.size) - 1
        steps = _STEPS[np.searchsorted(_STEPS, need[order[last]])]
        jobs: list[Callable[[], None]] = []
        for part in _parts(np.arange(steps.size), _BLOCKS_PER_JOB):
            lanes = order[part[0] * LANES : (part[-1] + 1) * LANES]
            jobs.append(_lanes(description, table, lanes, steps[part], carefully, values, errors))
        in_threads(jobs)
        taken = np.repeat(steps, LANES)[: order.size]
        need[order] = taken * np.clip(_MARGIN * errors[order] / ACCURACY, _AGAIN**_ORDER, 1e3) ** (1.0 / _ORDER)
    return errors


def _steps_needed(description: Description, table: FloatArray) -> FloatArray:
    """Return the steps of a half cycle (n,) that parameter vectors need, from cycles with few steps."""
    errors = np.zeros(len(table))

    def job(part: IntArray) -> Callable[[], None]:
        return lambda: lane_errors(*description, table, part, _PILOT_STEPS, errors)

    in_threads([job(part) for part in _parts(np.arange(len(table)), LANES * _BLOCKS_PER_JOB)])
    return _PILOT_STEPS * np.maximum(_MARGIN * errors / ACCURACY, 1.0) ** (1.0 / _ORDER)


def _parts(rows: IntArray, size: int) -> list[IntArray]:
    return [rows[first : first + size] for first in range(0, rows.size, size)]


def _lanes(
    description: Description, table: FloatArray, order: IntArray, steps: IntArray, carefully: bool, values: FloatArray,
    errors: FloatArray,
) -> Callable[[], None]:  # fmt: skip
    return lambda: lane_backbones(*description, table, order, steps, carefully, values, errors)


def _singles(
    description: Description, table: FloatArray, rows: IntArray, values: FloatArray, status: IntArray
) -> Callable[[], None]:
    """Return a job that simulates some rows one after the other."""

    def run() -> None:
        for row in rows:
            kernels.backbone(*description, table[row], values[row], _NO_JACOBIAN, status[row])

    return run


_NO_JACOBIAN = np.empty((0, 0, 0))

__all__ = ["ACCURACY", "LEAST", "can_take_lanes", "simulate_many"]
