"""Jobs beside each other on the cores of this machine: what is compiled releases the interpreter's lock."""

from __future__ import annotations

import functools
import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait

from threadpoolctl import threadpool_limits

THREAD_PREFIX = "backbone"
"""How the names of the threads begin that wait for jobs."""


def in_threads[T](jobs: Sequence[Callable[[], T]]) -> list[T]:
    """Run jobs, which must not depend on each other, and return their results in the order of the jobs.

    The caller takes one after the other, and so does every thread that has nothing else to do: a job may call this
    for jobs of its own, and gets a core as soon as one of its neighbours has ended. What a job raises is raised here,
    once those that were begun beside it have ended.
    """
    count = cores()
    if len(jobs) < 2 or count < 2:
        return [job() for job in jobs]
    shared = _Shared(jobs)
    helpers = [_pool(os.getpid(), count).submit(shared.work) for _ in range(min(count, len(jobs)) - 1)]
    try:
        shared.work()
    finally:
        shared.end()
        # one that waits for a thread is not needed any more; one that runs ends with its job
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()
    return shared.results


class _Shared[T]:
    """Jobs that are taken by whoever is free, until none is left or one fails."""

    def __init__(self, jobs: Sequence[Callable[[], T]]) -> None:
        self._waiting = deque(enumerate(jobs))
        self._found: dict[int, T] = {}

    def work(self) -> None:
        """Take jobs as long as there are any."""
        while self._waiting:
            try:
                number, job = self._waiting.popleft()
            except IndexError:  # another was faster
                return
            try:
                self._found[number] = job()
            except BaseException:
                self.end()
                raise

    def end(self) -> None:
        """Leave the jobs that were not begun."""
        self._waiting.clear()

    @property
    def results(self) -> list[T]:
        """What the jobs returned, in their order."""
        return [self._found[number] for number in range(len(self._found))]


def with_one_thread[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that leaves the linear algebra one thread: its matrices are small, and threads only wait."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1):
            return function(*args, **kwargs)

    return limited


def cores() -> int:
    """Return how many cores this process may use; one where its linear algebra was told to keep to one."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(count, int(told))) if told.isdigit() else count


@functools.cache
def _pool(_process: int, count: int) -> ThreadPoolExecutor:
    """Return the threads of a process beside the one that calls: a forked one has none of its parent's."""
    return ThreadPoolExecutor(count - 1, thread_name_prefix=THREAD_PREFIX)


__all__ = ["THREAD_PREFIX", "cores", "in_threads", "with_one_thread"]
