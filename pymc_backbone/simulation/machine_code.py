"""The machine code of the simulator: whether it is on disk, and what makes it known in a process."""

from __future__ import annotations

from .._common.beside import compile_all
from .counts import COUNTED
from .halfcycle import HALF_CYCLE, LOAD_STATES
from .kernels import BACKBONE
from .switches import ROOMY_FORCE, ROOMY_KEPT, ROOMY_REGIME, ROOMY_SLOPES
from .symmetry import IS_SYMMETRIC, WEIGH_STATES

_NATIVE = (
    *(ROOMY_FORCE, ROOMY_SLOPES, ROOMY_KEPT, ROOMY_REGIME),
    *(COUNTED, HALF_CYCLE, LOAD_STATES, IS_SYMMETRIC, WEIGH_STATES, BACKBONE),
)


def define() -> None:
    """Make the simulator known in this process; needed before anything is simulated."""
    missing = [function for function in _NATIVE if not function.is_defined]
    if not all(function.is_on_disk for function in missing):
        compile_all()
    for function in missing:
        function.define()


def is_compiled() -> bool:
    """Return whether the simulator is in this process or on disk; else `define` compiles it, for a minute or two."""
    return all(function.is_defined or function.is_on_disk for function in _NATIVE)


__all__ = ["define", "is_compiled"]
