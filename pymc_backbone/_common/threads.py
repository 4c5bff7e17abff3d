"""Jobs beside each other on the cores of this machine: what is compiled releases the interpreter's lock."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from threadpoolctl import threadpool_limits

THREAD_PREFIX = "backbone"
"""How the names of the threads begin that wait for jobs."""
_inside = threading.local()


def in_threads[T](jobs: Sequence[Callable[[], T]]) -> list[T]:
    """Run jobs, which must not depend on each other, and return their results in the order of the jobs.

    A job that calls this runs its own jobs one after the other: cores are shared out once.
    """
    if len(jobs) < 2 or getattr(_inside, "works", False):
        return [job() for job in jobs]
    count = cores()
    return [job() for job in jobs] if count < 2 else list(_pool(os.getpid(), count).map(_run, jobs))


def with_one_thread[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that leaves the linear algebra one thread: its matrices are small, and threads only wait."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1):
            return function(*args, **kwargs)

    return limited


def _run[T](job: Callable[[], T]) -> T:
    _inside.works = True
    return job()


def cores() -> int:
    """Return how many cores this process may use; one where its linear algebra was told to keep to one."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(count, int(told))) if told.isdigit() else count


@functools.cache
def _pool(_process: int, count: int) -> ThreadPoolExecutor:
    """Return the threads of a process: a forked one has none of its parent's."""
    return ThreadPoolExecutor(count, thread_name_prefix=THREAD_PREFIX)


__all__ = ["THREAD_PREFIX", "cores", "in_threads", "with_one_thread"]
