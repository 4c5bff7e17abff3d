"""Jobs beside each other on the cores of this machine: what is compiled releases the interpreter's lock."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

_inside = threading.local()


def in_threads[T](jobs: Sequence[Callable[[], T]]) -> list[T]:
    """Run jobs, which must not depend on each other, and return their results in the order of the jobs.

    A job that calls this runs its own jobs one after the other: cores are shared out once.
    """
    if len(jobs) < 2 or getattr(_inside, "works", False):
        return [job() for job in jobs]
    cores = _cores()
    return [job() for job in jobs] if cores < 2 else list(_pool(os.getpid(), cores).map(_run, jobs))


def _run[T](job: Callable[[], T]) -> T:
    _inside.works = True
    return job()


def _cores() -> int:
    """Return how many cores this process may use; one where its linear algebra was told to keep to one."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, int(told))) if told.isdigit() else cores


@functools.cache
def _pool(_process: int, cores: int) -> ThreadPoolExecutor:
    """Return the threads of a process: a forked one has none of its parent's."""
    return ThreadPoolExecutor(cores, thread_name_prefix="backbone")


__all__ = ["in_threads"]
