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

import numba
from numba.core.caching import FunctionCache

_FOLDER = Path(__file__).parent


@functools.cache
def compiled_sources_digest() -> str:
    """Return the SHA-256 of the sources of all compiled functions: the effects and the integrator."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted([*_FOLDER.glob("*.py"), *(_FOLDER / "effects").glob("*.py")]):
        if path.parent != _FOLDER or path.name in _COMPILED_MODULES:
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


_COMPILED_MODULES = frozenset(
    ("_forces.py", "_stepper.py", "_ode_stepper.py", "_halfcycle.py", "_kernels.py", "_density_kernel.py")
)


class DigestCache(FunctionCache):
    """numba's disk cache with the digest of all compiled sources in its key."""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), compiled_sources_digest())


def cached(function: Callable[..., Any]) -> Any:
    """Compile ``function`` with numba and keep the machine code on disk, keyed on all compiled sources."""
    dispatcher = numba.njit(function)
    dispatcher._cache = DigestCache(dispatcher.py_func)
    return dispatcher
