"""What this process simulated so far, counted where it happens: exactly, in compiled code and in threads as well."""

from __future__ import annotations

import ctypes
import functools
from typing import Any

from llvmlite import ir
from numba import int64, types
from numba.core import cgutils
from numba.core.typing import signature
from numba.extending import intrinsic

from .._common.compiled import NativeFunction, cached
from .pointers import INTEGERS

# Parameter vectors simulated for their values alone, with derivatives, in vain; and answered from a memory instead;
# and half cycles that were run through for it.
SIMULATIONS, GRADIENTS, FAILURES, REMEMBERED, HALF_CYCLES, N_COUNTS = range(6)


@intrinsic
def _own_integers(typing_context: Any) -> Any:
    """Return a pointer to integers that live as long as the machine code does, 0 at first."""

    def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        kind = ir.ArrayType(ir.IntType(64), N_COUNTS)
        place = cgutils.add_global_variable(builder.module, kind, "pymc_backbone_own_integers")
        place.initializer = ir.Constant(kind, None)
        place.linkage = "internal"
        return builder.bitcast(place, ir.IntType(64).as_pointer())

    return signature(INTEGERS), generate


@intrinsic
def _add(typing_context: Any, pointer: Any, index: Any, number: Any) -> Any:
    """Add to an integer in one go, whatever other threads do."""

    def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
        builder.atomic_rmw("add", builder.gep(arguments[0], [arguments[1]]), arguments[2], "monotonic")
        return context.get_dummy_value()

    return signature(types.void, INTEGERS, int64, int64), generate


def _counted() -> Any:
    return _own_integers()


COUNTED = NativeFunction("counted", INTEGERS(), _counted)
_counted_here = COUNTED.call


@cached
def count(index: int, number: int) -> None:
    """Add ``number`` to one of the counts."""
    _add(_counted_here(), index, number)


@functools.cache
def _place() -> ctypes.Array[ctypes.c_int64]:
    COUNTED.define()
    address = ctypes.CFUNCTYPE(ctypes.c_void_p)(COUNTED.address)()
    return (ctypes.c_int64 * N_COUNTS).from_address(int(address))


def read_counts() -> dict[str, int]:
    """Return what was simulated in this process since it began; a difference says what happened in between.

    Returns
    -------
    dict of str to int
        ``evaluations`` asked for; ``simulations`` made for values alone (fewer: what is remembered is not simulated
        again); ``gradients`` made with values; ``failures``, simulations in which a level failed.
    """
    counted = list(_place())
    return {
        "evaluations": counted[SIMULATIONS] + counted[GRADIENTS] + counted[REMEMBERED],
        "failures": counted[FAILURES],
        "simulations": counted[SIMULATIONS],
        "gradients": counted[GRADIENTS],
    }


def half_cycles_run() -> int:
    """Return how many half cycles were run through in this process: the work, whatever the machine."""
    return int(_place()[HALF_CYCLES])
