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
from typing import Any, NamedTuple

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
    "simulation/switches.py",
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


def ahead[**P, R](arguments: str, *, is_beside: bool = False) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator of a compiled function that says with which types it is called, so that none has to wait.

    Parameters
    ----------
    arguments : str
        Types of the arguments, each a letter (float64, int64, bool) and, of an array in C's order, its number of
        dimensions: ``"f2 f1 i"``. A call with others compiles it again.
    is_beside : bool, default False
        Whether a second process compiles it, where nothing is on disk yet (`beside.compile_all`).
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        KERNELS.append(Kernel(function, arguments, is_beside))
        return function

    return decorate


class Kernel(NamedTuple):
    """A function that is compiled before it is called: with which arguments, and whether in the second process."""

    dispatcher: Any
    arguments: str
    is_beside: bool

    def compile(self) -> None:
        """Compile it, or read it from disk."""
        types_of = [_NUMBERS[word[0]] for word in self.arguments.split()]
        sizes = [int(word[1:] or 0) for word in self.arguments.split()]
        self.dispatcher.compile(
            tuple(types.Array(kind, n, "C") if n else kind for kind, n in zip(types_of, sizes, strict=True))
        )


_NUMBERS = {"f": types.float64, "i": types.int64, "b": types.boolean}
KERNELS: list[Kernel] = []
"""Those of the modules that are imported by now, in the order of import."""
NATIVE: list[NativeFunction] = []
"""Native functions of the modules that are imported by now."""


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
    is_beside : bool, default False
        Whether a second process compiles it, where nothing is on disk yet (`beside.compile_all`).
    """

    def __init__(self, name: str, signature: Any, function: Any, *, is_beside: bool = False) -> None:
        self.call = types.ExternalFunction(f"pymc_backbone_{name}", signature)
        self._function = getattr(function, "py_func", function)
        self._options = {k: v for k, v in getattr(function, "targetoptions", {}).items() if k != "nopython"}
        self._compiled: Any = None
        self.is_beside = is_beside
        NATIVE.append(self)

    @property
    def module(self) -> str:
        """The module that it stands in."""
        return str(self._function.__module__)

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
    def is_defined(self) -> bool:
        """Whether the function is known in this process."""
        return self._compiled is not None

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
