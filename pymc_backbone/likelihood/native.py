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
from numpy.typing import NDArray

from .._common.checks import FloatArray
from .._common.compiled import DigestCache
from ..simulation import kernels
from ..simulation.decay import MAXIMUM_TURNING_POINTS, Simulator
from ..simulation.decay import TOLERANCE as TOLERANCE_OF_A_STEP
from .density_kernel import log_density

_INTEGERS = types.CPointer(types.int64)
_FLOATS = types.CPointer(types.float64)

# Entries of the integer description of a simulation; the table of effects and the wanted rows follow.
STIFFNESS, DAMPING, STATES, HAS_REGIME, VIRGIN, EFFECTS, LEVELS, MAXIMUM, ROWS, BY_DECAY = range(10)
# Entries of the float description; the levels follow.
MASS, RELEASE, TOLERANCE = range(3)
# Entries of the memory of a log-likelihood: counts, then slots of (value, when last asked for, parameters). A walk asks
# for the next point and the present one: of three slots, the one not asked for longest holds neither.
EVALUATIONS, FAILURES, SIMULATIONS, GRADIENTS, FIRST_SLOT = range(5)
SLOTS, BEFORE_PARAMETERS = 3, 2


def _backbone(user, ci_pointer, cf_pointer, p_pointer, n, values_p, jacobian_p, status_p, wanted):
    ci = numba.carray(ci_pointer, 1_000_000)
    n_effects, n_levels = ci[EFFECTS], ci[LEVELS]
    cf = numba.carray(cf_pointer, TOLERANCE + 1 + n_levels)
    table = ci[BY_DECAY + 1 : BY_DECAY + 1 + 6 * n_effects].reshape((n_effects, 6))
    levels = cf[TOLERANCE + 1 :]
    p = numba.carray(p_pointer, n)
    values = numba.carray(values_p, (3, n_levels))
    jacobian = numba.carray(jacobian_p, (3 * wanted, n_levels * wanted, n * wanted))
    status = numba.carray(status_p, n_levels)
    if ci[BY_DECAY] == 0:
        kernels.backbone_by_cycles(
            user, table, ci[STIFFNESS], ci[DAMPING], ci[STATES], cf[MASS], ci[HAS_REGIME] != 0, p, levels,
            cf[RELEASE], ci[VIRGIN] != 0, wanted != 0, cf[TOLERANCE], ci[MAXIMUM], values, jacobian, status,
        )  # fmt: skip
    else:
        kernels.backbone_by_decay(
            user, table, ci[STIFFNESS], ci[DAMPING], ci[STATES], cf[MASS], ci[HAS_REGIME] != 0, p, levels,
            cf[RELEASE], ci[VIRGIN] != 0, wanted != 0, cf[TOLERANCE], ci[MAXIMUM], values, jacobian, status,
        )  # fmt: skip


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
def judge_backbone(ci, status, values, jacobian, codes, table, memory, gradient):
    """Return the log density of a simulated backbone, -inf where a level failed, and write its gradient."""
    levels = ci[LEVELS]
    for k in range(levels):
        if status[k] != 0:
            if memory.size > FAILURES:
                memory[FAILURES] += 1.0
            for j in range(gradient.size):
                gradient[j] = 0.0
            return -np.inf
    wanted = 0
    for row in range(3):
        wanted += (ci[ROWS] >> row) & 1
    y = np.empty(wanted * levels)
    slope = np.empty(wanted * levels)
    i = 0
    for row in range(3):
        if (ci[ROWS] >> row) & 1:
            for k in range(levels):
                y[i] = values[row, k]
                i += 1
    value = log_density(codes, table, y, slope)
    for j in range(gradient.size):
        total = 0.0
        i = 0
        for row in range(3):
            if (ci[ROWS] >> row) & 1:
                for k in range(levels):
                    total += slope[i] * jacobian[row, k, j]
                    i += 1
        gradient[j] = total if np.isfinite(total) else 0.0
    return value


def _log_likelihood(user, ci_p, cf, p, n, codes_p, n_codes, table_p, n_table, memory_p, n_memory, gradient_p, wanted):  # noqa: E501
    theta = numba.carray(p, n)
    memory = numba.carray(memory_p, n_memory)
    if wanted == 0:
        found = remembered(memory, theta)
        if found >= 0:
            return memory[found]
    else:
        count_gradient(memory)
    ci = numba.carray(ci_p, 1_000_000)
    values = np.empty((3, ci[LEVELS]))
    jacobian = np.empty((3 * wanted, ci[LEVELS] * wanted, n * wanted))
    status = np.zeros(ci[LEVELS], np.int64)
    call_backbone(user, ci_p, cf, p, n, values.ctypes, jacobian.ctypes, status.ctypes, wanted)
    codes, table = numba.carray(codes_p, n_codes), numba.carray(table_p, n_table)
    gradient = numba.carray(gradient_p, n * wanted)
    value = judge_backbone(ci, status, values, jacobian, codes, table, memory, gradient)
    if wanted == 0:
        remember(memory, theta, value)
    return value


_BACKBONE_SIGNATURE = types.void(
    types.int64, _INTEGERS, _FLOATS, _FLOATS, types.int64, _FLOATS, _FLOATS, _INTEGERS, types.int64
)
_LIKELIHOOD_SIGNATURE = types.float64(
    types.int64, _INTEGERS, _FLOATS, _FLOATS, types.int64, _INTEGERS, types.int64, _FLOATS, types.int64,
    _FLOATS, types.int64, _FLOATS, types.int64,
)  # fmt: skip
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


class Description:
    """A simulation in the flat form that the native functions read.

    Parameters
    ----------
    simulator : Simulator
        The prepared oscillator.
    levels : ndarray, shape (l,)
        Amplitudes [m or rad].
    rows : tuple of int
        Which of frequency (0), damping (1), offset (2) are judged.
    release_amplitude : float
        Release [m or rad]; 0 for the default.
    virgin : bool
        Whether hysteretic states start loaded from rest.
    """

    def __init__(
        self, simulator: Simulator, levels: FloatArray, rows: tuple[int, ...], release_amplitude: float, virgin: bool
    ) -> None:
        user, table, stiffness, damping, n_states, mass, has_regime = simulator.description
        by_decay = simulator.needs_decay or release_amplitude > 0.0
        head = [stiffness, damping, n_states, has_regime, virgin, len(table), levels.size, MAXIMUM_TURNING_POINTS,
                sum(1 << row for row in rows), by_decay]  # fmt: skip
        self.user = int(user)
        self.integers: NDArray[np.int64] = np.concatenate([np.array(head, dtype=np.int64), table.ravel()])
        self.floats: FloatArray = np.concatenate([[mass, release_amplitude, TOLERANCE_OF_A_STEP], levels])
