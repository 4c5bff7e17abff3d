"""The simulator and the log-likelihood as native functions with a name that any compiled code can call.

Code that PyTensor compiles for a model calls these by name instead of linking the integrator into itself: it then
compiles in a fraction of a second, and machine code kept on disk by one process runs in another. What cannot be kept
on disk, the address of a user's own force, is passed in as a number.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from .._common.checks import FloatArray, IntArray
from .._common.compiled import NativeFunction
from ..simulation.counts import FAILURES, GRADIENTS, SIMULATIONS, count
from ..simulation.kernels import call_backbone as call_uncounted
from ..simulation.machine_code import define
from ..simulation.memory import N_LEVELS, N_PARAMETERS, ROWS, TABLE
from ..simulation.pointers import FLOATS, INTEGERS, Floats, Integers
from .density_kernel import log_density


def _backbone(
    to_integers: Integers,
    to_numbers: Floats,
    to_p: Floats,
    to_values: Floats,
    to_jacobian: Floats,
    to_status: Integers,
    wanted: int,
) -> None:
    call_uncounted(to_integers, to_numbers, to_p, to_values, to_jacobian, to_status, wanted)
    count(GRADIENTS if wanted else SIMULATIONS, 1)
    for k in range(to_integers[N_LEVELS]):
        if to_status[k] != 0:
            count(FAILURES, 1)
            break


@numba.njit
def judge_backbone(
    integers: IntArray, status: IntArray, values: FloatArray, jacobian: FloatArray, codes: IntArray,
    table: FloatArray, gradient: FloatArray,
) -> float:  # fmt: skip
    """Return the log density of a simulated backbone, -inf where a level failed, and write its gradient."""
    levels = integers[N_LEVELS]
    for k in range(levels):
        if status[k] != 0:
            for j in range(gradient.size):
                gradient[j] = 0.0
            return -np.inf
    wanted = 0
    for row in range(3):
        wanted += (integers[ROWS] >> row) & 1
    y = np.empty(wanted * levels)
    slope = np.empty(wanted * levels)
    i = 0
    for row in range(3):
        if (integers[ROWS] >> row) & 1:
            for k in range(levels):
                y[i] = values[row, k]
                i += 1
    value = log_density(codes, table, y, slope)
    for j in range(gradient.size):
        total = 0.0
        i = 0
        for row in range(3):
            if (integers[ROWS] >> row) & 1:
                for k in range(levels):
                    total += slope[i] * jacobian[row, k, j]
                    i += 1
        gradient[j] = total if np.isfinite(total) else 0.0
    return value


def _log_likelihood(
    to_integers: Integers, to_numbers: Floats, to_p: Floats, to_codes: Integers, n_codes: int, to_table: Floats,
    n_table: int, to_gradient: Floats, wanted: int,
) -> float:  # fmt: skip
    integers = numba.carray(to_integers, TABLE)
    n, n_levels = integers[N_PARAMETERS], integers[N_LEVELS]
    values = np.empty((3, n_levels))
    jacobian = np.empty((3 * wanted, n_levels * wanted, n * wanted))
    status = np.zeros(n_levels, np.int64)
    call_backbone(to_integers, to_numbers, to_p, values.ctypes, jacobian.ctypes, status.ctypes, wanted)
    codes, table = numba.carray(to_codes, n_codes), numba.carray(to_table, n_table)
    gradient = numba.carray(to_gradient, n * wanted)
    value: float = judge_backbone(integers, status, values, jacobian, codes, table, gradient)
    return value


BACKBONE = NativeFunction("backbone", call_uncounted.sig, _backbone, is_beside=True)
call_backbone = BACKBONE.call
"""``backbone(integers, numbers, p, values, jacobian, status, wanted)``: simulate, with derivatives if ``wanted``."""
LOG_LIKELIHOOD = NativeFunction(
    "log_likelihood",
    types.float64(INTEGERS, FLOATS, FLOATS, INTEGERS, types.int64, FLOATS, types.int64, FLOATS, types.int64),
    _log_likelihood,
    is_beside=True,
)
call_log_likelihood = LOG_LIKELIHOOD.call
"""``log_likelihood(integers, numbers, p, codes, n_codes, table, n_table, gradient, wanted) -> log density``."""


def define_symbols() -> None:
    """Make the native functions known by name; compiled once, then read from disk.

    Must have run in a process before code that calls them is loaded there: every Op runs it when it is made.
    """
    define()
    BACKBONE.define()
    LOG_LIKELIHOOD.define()
