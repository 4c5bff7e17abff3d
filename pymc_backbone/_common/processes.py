"""An executor whose processes are independent: where one ends abruptly, its own task fails and no other.

`concurrent.futures.ProcessPoolExecutor` gives up every task it holds when one of its processes is killed. Here each
process has a pipe and a thread of its own, a new process takes the place of one that died, and how it died is said.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from .checks import InputError

# Two processes with as many BLAS threads as cores each would fight; a result may also depend on their number.
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
NOT_STARTED = (
    "the worker processes cannot start (see the error above); a script must be a file and call this below "
    "`if __name__ == '__main__':`, or give `workers=0` to stay in one process."
)
_CONTEXT = multiprocessing.get_context("spawn")  # a forked child could inherit locks that threads hold
_READY = "ready"
TASKS_PER_PROCESS = 50
"""Tasks after which a process is replaced, ..."""
MEGABYTES_PER_PROCESS = 400.0
"""... or what it may hold beyond its first task's memory, where the system tells it: compiled models stay."""
_PATIENCE = 5.0  # seconds for a process to end by itself


class WorkerDied(RuntimeError):
    """The process of a task ended before the task did; the text says how."""


class Processes(Executor):
    """So many processes, each started when it is first needed and used for one task after another.

    Parameters
    ----------
    workers : int
        Number of processes.
    prepare : callable, optional
        Called once in each process; importable.
    tasks_per_process : int, optional
        Number of tasks after which a process is replaced by a new one, at the latest: one that holds
        `MEGABYTES_PER_PROCESS` more than after its first task is replaced, too.

    Notes
    -----
    A task whose process dies raises `WorkerDied`; the other tasks do not notice. Ctrl-C does not reach the processes:
    this process decides, and `kill` ends them. They end too when this process does, however it ends.
    """

    def __init__(
        self, workers: int, prepare: Callable[[], None] | None = None, tasks_per_process: int = TASKS_PER_PROCESS
    ) -> None:
        self._prepare = prepare
        self._most = tasks_per_process
        self._threads = ThreadPoolExecutor(workers, thread_name_prefix="process")
        self._mine = threading.local()
        self._alive: set[_Process] = set()
        self._lock = threading.Lock()
        self._is_killed = False

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand a call to the next free process."""
        return self._threads.submit(self._call, function, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the processes end; with ``wait`` after their tasks, else in the background."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
        if wait:
            self._close()
        else:
            threading.Thread(target=self.shutdown, daemon=True).start()

    def kill(self) -> None:
        """End all processes at once, whatever they do."""
        with self._lock:
            self._is_killed = True
            alive = list(self._alive)
        for process in alive:
            process.kill()
        self.shutdown(cancel_futures=True)

    @property
    def process_ids(self) -> list[int]:
        """Of the processes that run now."""
        with self._lock:
            return [process.process.pid for process in self._alive if process.process.pid is not None]

    def _call(self, function: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        process: _Process | None = getattr(self._mine, "process", None)
        if process is None or not process.process.is_alive() or process.is_spent(self._most):
            if process is not None:
                self._drop(process)
            process = self._start()
        try:
            return process.call(function, args, kwargs)
        except WorkerDied:
            self._drop(process)
            raise

    def _start(self) -> _Process:
        with self._lock:  # also: the environment is changed while a process starts
            if self._is_killed:
                raise WorkerDied("the processes were ended")
            process = _Process(self._prepare)
            self._alive.add(process)
        self._mine.process = process
        try:
            process.wait_until_ready()
        except (WorkerDied, InputError):
            self._drop(process)
            raise
        return process

    def _drop(self, process: _Process) -> None:
        self._mine.process = None
        with self._lock:
            self._alive.discard(process)
        process.close()

    def _close(self) -> None:
        with self._lock:
            alive, self._alive = list(self._alive), set()
        for process in alive:
            process.connection.close()  # all of them end at the same time
        for process in alive:
            process.close()


class _Process:
    """A process that answers one call after another through a pipe."""

    def __init__(self, prepare: Callable[[], None] | None) -> None:
        self.calls = 0
        self.first_megabytes = self.megabytes = 0.0
        self.connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=_serve, args=(theirs, prepare), daemon=True)
        with _one_thread_each():
            self.process.start()
        theirs.close()

    def wait_until_ready(self) -> None:
        try:
            assert self._receive() == _READY
        except WorkerDied:
            if (self.process.exitcode or 0) > 0:
                raise InputError(NOT_STARTED) from None
            raise

    def call(self, function: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        self.calls += 1
        try:
            self.connection.send((function, args, kwargs))
        except OSError:
            raise self._died() from None
        is_done, value, self.megabytes = self._receive()
        self.first_megabytes = self.first_megabytes or self.megabytes
        if is_done:
            return value
        raise value

    def is_spent(self, most_calls: int) -> bool:
        """Whether another process should take its place before the next call."""
        return self.calls >= most_calls or self.megabytes > self.first_megabytes + MEGABYTES_PER_PROCESS

    def kill(self) -> None:
        self.process.kill()

    def close(self) -> None:
        """Let it end: without a pipe it does; else by force."""
        self.connection.close()
        self.process.join(_PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def _receive(self) -> Any:
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            raise self._died() from None

    def _died(self) -> WorkerDied:
        self.process.join(_PATIENCE)
        code = self.process.exitcode
        if code is not None and code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                name = f"signal {-code}"
            hint = ", as when memory runs out" if name == "SIGKILL" else ""
            return WorkerDied(f"its process was ended by {name}{hint}")
        return WorkerDied(f"its process ended abruptly (exit code {code})")


def _serve(connection: Any, prepare: Callable[[], None] | None) -> None:
    """Answer calls until the pipe is closed; the loop of each process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()
    connection.send(_READY)
    while True:
        try:
            function, args, kwargs = connection.recv()
        except (EOFError, OSError):
            return
        except Exception as error:  # a function that cannot be found here
            connection.send((False, error, _megabytes()))
            continue
        try:
            answer: tuple[bool, Any] = (True, function(*args, **kwargs))
        except Exception as error:
            answer = (False, error)
        try:
            connection.send((*answer, _megabytes()))
        except Exception as error:  # neither every value nor every exception can be sent
            connection.send((False, RuntimeError(f"{type(answer[1]).__name__}: {answer[1]} ({error})"), _megabytes()))


def _megabytes() -> float:
    """Return the resident memory of this process; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, ValueError, IndexError):
        return 0.0


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let a process that starts now use one thread for linear algebra, unless the user said otherwise."""
    added = [name for name in THREAD_VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


__all__ = ["Processes", "WorkerDied"]
