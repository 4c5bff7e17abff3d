"""Jobs beside each other on the cores of this machine: what is compiled releases the interpreter's lock."""

from __future__ import annotations

import functools
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from threadpoolctl import threadpool_limits

_TURN = 2e-4  # seconds
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
    _open[id(shared)] = shared
    helpers = [_pool(os.getpid(), count).submit(shared.work) for _ in range(min(count, len(jobs)) - 1)]
    shared.work()
    del _open[id(shared)]
    for helper in helpers:
        helper.cancel()  # one that waits for a thread is not needed any more
    _help_until_ended(shared)
    return shared.results()


class _Shared[T]:
    """Jobs that are taken by whoever is free, until none is left or one fails."""

    def __init__(self, jobs: Sequence[Callable[[], T]]) -> None:
        self.ended = threading.Event()
        self._lock = threading.Lock()
        self._count = self._left = len(jobs)
        self._waiting = deque(enumerate(jobs))
        self._found: dict[int, T] = {}
        self._failed: list[BaseException] = []

    def work(self) -> None:
        """Take jobs as long as there are any."""
        while self.take():
            pass

    def take(self) -> bool:
        """Do one job; return whether there was any. Whoever asked for the jobs is told what it raises."""
        with self._lock:
            if not self._waiting:
                return False
            number, job = self._waiting.popleft()
        try:
            self._found[number] = job()
        except BaseException as error:  # raised where the jobs come from
            self._failed.append(error)
        with self._lock:
            if self._failed:
                self._left -= len(self._waiting)
                self._waiting.clear()
            self._left -= 1
            if self._left == 0:
                self.ended.set()
        return True

    def results(self) -> list[T]:
        """Return what the jobs returned, in their order, or raise what the first that failed did."""
        if self._failed:
            raise self._failed[0]
        return [self._found[number] for number in range(self._count)]


_open: dict[int, _Shared[Any]] = {}  # of which jobs may be left
_SOON, _LATE = 1e-4, 5e-3  # seconds after which one who waits looks for jobs of others, at first and at most


def _help_until_ended(shared: _Shared[Any]) -> None:
    """Do what jobs of others are left until those that were begun have ended: who waits keeps no core from them."""
    pause = _SOON
    while not shared.ended.wait(pause):
        is_busy = any(other.take() for other in [*_open.values()])
        pause = _SOON if is_busy else min(2.0 * pause, _LATE)


def with_one_thread[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that leaves the linear algebra one thread: its matrices are small, and threads only wait."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1):
            return function(*args, **kwargs)

    return limited


@contextmanager
def short_turns() -> Iterator[None]:
    """Let threads that return from compiled code get the interpreter soon, in the time of one block of the main thread.

    They would wait for five milliseconds, and a simulation takes one.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _TURN))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def cores() -> int:
    """Return how many cores this process may use; one where its linear algebra was told to keep to one."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(count, int(told))) if told.isdigit() else count


@functools.cache
def _pool(_process: int, count: int) -> ThreadPoolExecutor:
    """Return the threads of a process beside the one that calls: a forked one has none of its parent's."""
    return ThreadPoolExecutor(count - 1, thread_name_prefix=THREAD_PREFIX)


__all__ = ["THREAD_PREFIX", "cores", "in_threads", "short_turns", "with_one_thread"]
