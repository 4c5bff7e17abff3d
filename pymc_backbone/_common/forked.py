"""Bytes made in a fork of this process beside it: for work in plain Python, which threads would share one lock for.

A forked child could inherit a lock that another thread holds. So it is made only where all threads are known: those
of `threads`, which wait for jobs and hold nothing, and the one that shows the progress, whose output a child leaves
alone. Everywhere else (Windows, macOS, a notebook, one core) the work is done here.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import BinaryIO, NoReturn

from . import threads
from .progress import THREAD as PROGRESS_THREAD

_FOREIGN_THREADS = frozenset(("jax", "tensorflow", "torch"))  # modules with threads that Python does not know
_LENGTH = 8  # bytes that say how many follow


def in_two_processes(jobs: Sequence[Callable[[], bytes]]) -> list[bytes]:
    """Run jobs, every second of them in a fork of this process where that is safe; return their bytes in order.

    Parameters
    ----------
    jobs : sequence of callable
        Pure: what they change in the fork is lost. They compile nothing and use no other process or thread.

    Returns
    -------
    list of bytes
        As the jobs return them. What the fork could not deliver, this process makes, and raises what fails.
    """
    if len(jobs) < 2 or not _is_safe():
        return [job() for job in jobs]
    there = jobs[1::2]
    reading, writing = os.pipe()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads: these are known
            child = os.fork()
    except OSError:  # no memory, or no process more
        os.close(reading)
        os.close(writing)
        return [job() for job in jobs]
    if child == 0:
        _deliver(there, reading, writing)
    os.close(writing)
    try:
        with os.fdopen(reading, "rb") as pipe:  # closed early, it ends the child, which then has nobody to write to
            here = [job() for job in jobs[::2]]
            arrived = _arrived(pipe)
    finally:
        with suppress(ChildProcessError):  # reaped already, where somebody ignores the ends of children
            os.waitpid(child, 0)
    others = [*arrived, *(job() for job in there[len(arrived) :])]
    return [(others if k % 2 else here)[k // 2] for k in range(len(jobs))]


def _is_safe() -> bool:
    if sys.platform != "linux" or threads.cores() < 2 or not _FOREIGN_THREADS.isdisjoint(sys.modules):
        return False
    others = {thread.name for thread in threading.enumerate() if thread is not threading.current_thread()}
    return all(name == PROGRESS_THREAD or name.startswith(threads.THREAD_PREFIX) for name in others)


def _deliver(jobs: Sequence[Callable[[], bytes]], reading: int, writing: int) -> NoReturn:
    """Do the jobs and write what they return, as the child that ends here whatever happens."""
    try:
        os.close(reading)
        sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")
        made = [job() for job in jobs]
        with os.fdopen(writing, "wb") as pipe:
            for data in made:
                pipe.write(len(data).to_bytes(_LENGTH) + data)
    finally:
        os._exit(0)


def _arrived(pipe: BinaryIO) -> list[bytes]:
    """Return what the child wrote, whole pieces only."""
    found: list[bytes] = []
    with suppress(OSError):
        while len(head := pipe.read(_LENGTH)) == _LENGTH:
            data = pipe.read(int.from_bytes(head))
            if len(data) < int.from_bytes(head):
                break
            found.append(data)
    return found


__all__ = ["in_two_processes"]
