"""The simulator and the log-likelihood as native functions with a name that any compiled code can call.

Code that PyTensor compiles for a model calls these by name instead of linking the integrator into itself: it then
compiles in a fraction of a second, and machine code kept on disk by one process runs in another. What cannot be kept
on disk, the address of a user's own force, is passed in as a number.
"""

from __future__ import annotations

import functools
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numba.core.ccallback import CFunc

from .._common.compiled import DigestCache
from ..simulation import kernels
from ..simulation.forces import ROW
from ..simulation.memory import N_EFFECTS, N_LEVELS, N_NUMBERS, N_PARAMETERS, ROWS, TABLE
from ..simulation.pointers import FLOATS, INTEGERS
from .density_kernel import log_density

# Entries of the memory of a log-likelihood: counts, then slots of (value, when last asked for, parameters). A walk asks
# for the next point and the present one: of three slots, the one not asked for longest holds neither.
EVALUATIONS, FAILURES, SIMULATIONS, GRADIENTS, FIRST_SLOT = range(5)
SLOTS, BEFORE_PARAMETERS = 3, 2


def _backbone(to_integers, to_numbers, to_p, to_values, to_jacobian, to_status, wanted):
    head = numba.carray(to_integers, TABLE)
    n, n_levels = head[N_PARAMETERS], head[N_LEVELS]
    integers = numba.carray(to_integers, TABLE + ROW * head[N_EFFECTS])
    numbers = numba.carray(to_numbers, N_NUMBERS + n_levels)
    p = numba.carray(to_p, n)
    values = numba.carray(to_values, (3, n_levels))
    jacobian = numba.carray(to_jacobian, (3 * wanted, n_levels * wanted, n * wanted))
    status = numba.carray(to_status, n_levels)
    kernels.backbone(integers, numbers, p, values, jacobian, status)


@numba.njit
def remembered(memory, theta):
    """Return where in ``memory`` the value for ``theta`` stands, or -1; count the evaluation."""
    n = theta.size
    width = n + BEFORE_PARAMETERS
    if memory.size < FIRST_SLOT + SLOTS * width:
        return -1
    memory[EVALUATIONS] += 1.0
    for slot in range(SLOTS):
        first = FIRST_SLOT + slot * width
        same = True
        for j in range(n):
            same = same and memory[first + BEFORE_PARAMETERS + j] == theta[j]
        if same:
            memory[first + 1] = memory[EVALUATIONS]
            return first
    return -1


@numba.njit
def remember(memory, theta, value):
    """Put the value for ``theta`` where the one stands that was not asked for longest; count the simulation."""
    n = theta.size
    width = n + BEFORE_PARAMETERS
    if memory.size < FIRST_SLOT + SLOTS * width:
        return
    memory[SIMULATIONS] += 1.0
    oldest = FIRST_SLOT
    for slot in range(1, SLOTS):
        first = FIRST_SLOT + slot * width
        if memory[first + 1] < memory[oldest + 1]:
            oldest = first
    memory[oldest] = value
    memory[oldest + 1] = memory[EVALUATIONS]
    for j in range(n):
        memory[oldest + BEFORE_PARAMETERS + j] = theta[j]


@numba.njit
def count_gradient(memory):
    """Count an evaluation of value and gradient; several threads may lose one now and then."""
    if memory.size > GRADIENTS:
        memory[EVALUATIONS] += 1.0
        memory[GRADIENTS] += 1.0


@numba.njit
def judge_backbone(integers, status, values, jacobian, codes, table, memory, gradient):
    """Return the log density of a simulated backbone, -inf where a level failed, and write its gradient."""
    levels = integers[N_LEVELS]
    for k in range(levels):
        if status[k] != 0:
            if memory.size > FAILURES:
                memory[FAILURES] += 1.0
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
    to_integers, to_numbers, to_p, to_codes, n_codes, to_table, n_table, to_memory, n_memory, to_gradient, wanted
):
    integers = numba.carray(to_integers, TABLE)
    n, n_levels = integers[N_PARAMETERS], integers[N_LEVELS]
    theta = numba.carray(to_p, n)
    memory = numba.carray(to_memory, n_memory)
    if wanted == 0:
        found = remembered(memory, theta)
        if found >= 0:
            return memory[found]
    else:
        count_gradient(memory)
    values = np.empty((3, n_levels))
    jacobian = np.empty((3 * wanted, n_levels * wanted, n * wanted))
    status = np.zeros(n_levels, np.int64)
    call_backbone(to_integers, to_numbers, to_p, values.ctypes, jacobian.ctypes, status.ctypes, wanted)
    codes, table = numba.carray(to_codes, n_codes), numba.carray(to_table, n_table)
    gradient = numba.carray(to_gradient, n * wanted)
    value = judge_backbone(integers, status, values, jacobian, codes, table, memory, gradient)
    if wanted == 0:
        remember(memory, theta, value)
    return value


_BACKBONE_SIGNATURE = types.void(INTEGERS, FLOATS, FLOATS, FLOATS, FLOATS, INTEGERS, types.int64)
_LIKELIHOOD_SIGNATURE = types.float64(
    INTEGERS, FLOATS, FLOATS, INTEGERS, types.int64, FLOATS, types.int64, FLOATS, types.int64, FLOATS, types.int64
)
call_backbone = types.ExternalFunction("pymc_backbone_backbone", _BACKBONE_SIGNATURE)
call_log_likelihood = types.ExternalFunction("pymc_backbone_log_likelihood", _LIKELIHOOD_SIGNATURE)


@functools.cache
def define_symbols() -> None:
    """Make the native functions known by name; compiled once, then read from disk.

    Must have run in a process before code that calls them is loaded there: every Op runs it when it is made.
    """
    kernels.define()
    for external, function in ((call_backbone, _backbone), (call_log_likelihood, _log_likelihood)):
        compiled: Any = CFunc(function, (external.sig.args, external.sig.return_type), locals={}, options={})
        compiled._cache = DigestCache(function)
        compiled.compile()
        llvmlite.binding.add_symbol(external.symbol, compiled.address)
        _KEPT.append(compiled)


_KEPT: list[Any] = []  # compiled code lives as long as its CFunc
