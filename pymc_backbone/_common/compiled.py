"""Compile once, keep on disk, and never run code from before an edit.

numba's disk cache looks at the file in which a function stands. The integrator's functions call force
functions that stand in other files, so an edited force would be ignored by a new process. `cached` adds a
digest of every source that the integrator is compiled from to the key.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
from numba import types
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc

_PACKAGE = Path(__file__).parents[1]


@functools.cache
def compiled_sources_digest() -> str:
    """Return the SHA-256 of the sources of all compiled functions: the effects and the integrator."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in [*(_PACKAGE / name for name in _COMPILED_MODULES), *sorted((_PACKAGE / "effects").glob("*.py"))]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


_COMPILED_MODULES = (
    "_common/compiled.py",
    "discrepancy/fitting/fit_kernels.py",
    "discrepancy/fitting/small_systems.py",
    "discrepancy/proposals/look_kernels.py",
    "discrepancy/proposals/refine_kernels.py",
    "discrepancy/proposals/set_kernels.py",
    "likelihood/density_kernel.py",
    "simulation/by_decay.py",
    "simulation/closing.py",
    "simulation/counts.py",
    "simulation/curves.py",
    "simulation/forces.py",
    "simulation/halfcycle.py",
    "simulation/instants.py",
    "simulation/jumps.py",
    "simulation/kernels.py",
    "simulation/kinks.py",
    "simulation/lane_cycles.py",
    "simulation/lane_levels.py",
    "simulation/lane_stages.py",
    "simulation/lanes.py",
    "simulation/memory.py",
    "simulation/pointers.py",
    "simulation/run.py",
    "simulation/states.py",
    "simulation/stepper.py",
    "simulation/symmetry.py",
    "simulation/whole.py",
    "simulation/windows.py",
)


class DigestCache(FunctionCache):
    """numba's disk cache with the digest of all compiled sources in its key."""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), compiled_sources_digest())


def cached[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` with numba and keep the machine code on disk, keyed on all compiled sources.

    It runs without the interpreter's lock, so that threads run beside each other.
    """
    dispatcher = numba.njit(function, nogil=True)
    keep(dispatcher)
    result: Callable[P, R] = dispatcher
    return result


def keep(dispatcher: Any) -> None:
    """Keep the machine code of a compiled function on disk, keyed on all compiled sources."""
    dispatcher._cache = DigestCache(dispatcher.py_func)


class NativeFunction:
    """A function compiled once, kept on disk, and called by name from other compiled code.

    What calls it is compiled without it, which is fast, and must be loaded into a process only after `define`.

    Parameters
    ----------
    name : str
        The symbol is this with the package's name in front.
    signature : numba signature
        Numbers and pointers only.
    function : callable
        A Python function, or one compiled with `numba.njit`, whose options are then kept.
    """

    def __init__(self, name: str, signature: Any, function: Any) -> None:
        self.call = types.ExternalFunction(f"pymc_backbone_{name}", signature)
        self._function = getattr(function, "py_func", function)
        self._options = {k: v for k, v in getattr(function, "targetoptions", {}).items() if k != "nopython"}
        self._compiled: Any = None

    def _uncompiled(self) -> Any:
        signature = self.call.sig
        function: Any = CFunc(self._function, (signature.args, signature.return_type), {}, self._options)
        function._cache = DigestCache(self._function)
        return function

    def define(self) -> None:
        """Make the function known in this process: from disk, or compiled; does nothing the second time."""
        if self._compiled is None:
            compiled = self._uncompiled()
            compiled.compile()
            llvmlite.binding.add_symbol(self.call.symbol, compiled.address)
            self._compiled = compiled

    @property
    def address(self) -> int:
        """Where the machine code stands in this process, once it is defined."""
        return int(self._compiled.address)

    @property
    def is_on_disk(self) -> bool:
        """Whether the machine code is on disk, as numba's index of it says: `define` then takes no time."""
        function = self._uncompiled()
        key = function._cache._index_key(function._sig, function._targetdescr.target_context.codegen())
        return key in function._cache._cache_file._load_index()

    @property
    def is_from_disk(self) -> bool:
        """Whether the machine code was read from disk, once it is defined."""
        return bool(self._compiled.cache_hits)
