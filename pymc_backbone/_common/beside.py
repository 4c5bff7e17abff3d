"""Compile with two processes what is not on disk yet: who waits for the first time waits less.

numba compiles one function after another, whatever the number of cores. Of what is known to be needed, a second process
compiles some while this one compiles the rest; both keep their machine code on disk, where this one then finds it.
"""

from __future__ import annotations

import ctypes
import importlib
import multiprocessing
import os
import sys
import threading

import llvmlite.binding
import numba

from .compiled import KERNELS, NATIVE
from .interpreter import Process, start
from .threads import cores

_PROGRAM = "from pymc_backbone._common.beside import serve; serve()"


def compile_all() -> None:
    """Compile all native functions, and all functions of known arguments, of the modules that are imported by now.

    What falls to a second process is left for later where none can start.
    """
    second = _second()
    try:
        for native in NATIVE:
            if not native.is_beside:
                native.define()
        for kernel in KERNELS:
            if not kernel.is_beside:
                kernel.compile()
    except BaseException:
        if second is not None:
            second.kill()
            second.communicate()
        raise
    if second is not None:
        second.wait()  # whether it came to its end or not: what is not on disk is compiled here
        second.communicate()


def _second() -> Process | None:
    """Return the second process; None with one core, in a process that is one of several, or where none can start."""
    modules = {item.module for item in NATIVE} | {kernel.dispatcher.py_func.__module__ for kernel in KERNELS}
    if cores() < 2 or multiprocessing.parent_process() is not None or numba.config.DISABLE_JIT:
        return None
    return start(_PROGRAM, *sorted(modules), is_read=False)


def serve() -> None:
    """Compile what falls to the second process; it ends at the latest when the process that started it does."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for name in sys.argv[1:]:
        importlib.import_module(name)
    nothing = ctypes.CFUNCTYPE(None)(lambda: None)
    for native in NATIVE:  # nothing is called here, but machine code is not made for names that nobody knows
        llvmlite.binding.add_symbol(native.call.symbol, ctypes.cast(nothing, ctypes.c_void_p).value)
    for native in NATIVE:
        if native.is_beside:
            native.define()
    for kernel in KERNELS:
        if kernel.is_beside:
            kernel.compile()


def _end_with_parent() -> None:
    while os.read(0, 1):  # not of `sys.stdin`, whose lock it would hold when this process ends
        pass
    os._exit(1)
