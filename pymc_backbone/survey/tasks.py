"""Tasks on any executor: what is lost with a worker runs once more, alone; Ctrl-C ends with what is finished."""

from __future__ import annotations

import signal
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from typing import Any

from .._common.checks import InputError

POLL = 0.2  # seconds between two looks at Ctrl-C and the clock
BROKEN = (
    "the executor that was given broke when one of its processes ended; run again with `resume=True`, or leave "
    "`executor` out: processes of this package are replaced."
)


class Stopped(BaseException):
    """Ctrl-C while a task ran in this process; nothing between it and `run_tasks` may take it for a failure."""


class Here(Executor):
    """Runs each task at once, in this process."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a call and return its result as a future."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Lost:
    """What became of a task whose worker was lost twice: the reason, as the end of a sentence."""

    def __init__(self, reason: str) -> None:
        self.reason = reason


def run_tasks(
    executor: Executor,
    function: Callable[[Any], Any],
    tasks: Mapping[str, Any],
    done: Callable[[str, Any, int], None],
    tick: Callable[[], None] = lambda: None,
) -> bool:
    """Run ``function(task)`` for all tasks; return whether Ctrl-C ended it early.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Where they run.
    function : callable
        Importable; it returns failures of its task as a value, so that what it raises is the executor's failure.
    tasks : mapping of str to object
        What it is called with, by name.
    done : callable
        Called in this thread with the name, the value (or `Lost`) and the number of attempts, as tasks finish.
    tick : callable, optional
        Called several times a second.

    Notes
    -----
    A task that its executor lost runs once more when the others are finished, with nothing beside it: a task that
    kills its worker is then found out, and one that merely shared a worker's fate is done.
    """
    names = list(tasks)
    suspects: list[tuple[str, Exception]] = []
    is_here = isinstance(executor, Here)
    with interruptible(raises=is_here) as is_stopping:
        flying: dict[Future[Any], str] = {}
        most = 1 if is_here else len(names)
        try:
            for attempt in (1, 2):
                queue = iter(names)
                while True:
                    _fill(
                        flying,
                        queue,
                        most,
                        lambda name: executor.submit(call, function, tasks[name], uuid.uuid4().hex),
                        suspects,
                    )
                    if not flying:
                        break
                    finished = wait(flying, POLL, FIRST_COMPLETED).done
                    tick()
                    if is_here and is_stopping():  # the task that ran may have failed because of it
                        return True
                    for future in finished:
                        _settle(flying.pop(future), future, attempt, done, suspects)
                    if is_stopping():
                        return True
                if attempt == 2:
                    break
                names, most = [name for name, _ in suspects], 1
                suspects = []
        except Stopped:
            return True
        finally:
            for future in flying:
                future.cancel()
    for name, error in suspects:
        done(name, Lost(_reason(error)), 2)
    return False


def call(function: Callable[[Any], Any], task: Any, token: str) -> Any:
    """Call a function; the token makes each submission new to Dask, which else answers it with the former failure."""
    return function(task)


def _fill(
    flying: dict[Future[Any], str],
    queue: Iterator[str],
    most: int,
    submit: Callable[[str], Future[Any]],
    suspects: list[tuple[str, Exception]],
) -> None:
    while len(flying) < most:
        name = next(queue, None)
        if name is None:
            return
        try:
            flying[submit(name)] = name
        except Exception as error:
            suspects.append((name, error))


def _settle(
    name: str,
    future: Future[Any],
    attempt: int,
    done: Callable[[str, Any, int], None],
    suspects: list[tuple[str, Exception]],
) -> None:
    try:
        value = future.result()
    except InputError:  # the workers cannot even start
        raise
    except Exception as error:
        suspects.append((name, error))
        return
    done(name, value, attempt)


def _reason(error: Exception) -> str:
    if isinstance(error, BrokenExecutor):
        return BROKEN
    said = " ".join(str(error).split())[:300]
    name = "" if type(error).__name__ == "WorkerDied" else f"{type(error).__name__}: "
    return f"{name}{said or 'no more is known'}".rstrip(".") + ", twice; the second time nothing else ran beside it."


@contextmanager
def interruptible(*, raises: bool) -> Iterator[Callable[[], bool]]:
    """Yield what says whether Ctrl-C came; a second one does what it did before.

    With ``raises`` the first one raises `Stopped` where the main thread is.
    """
    came = threading.Event()
    if threading.current_thread() is not threading.main_thread():  # signals do not come here
        yield came.is_set
        return

    def stop(number: int, frame: Any) -> None:
        signal.signal(signal.SIGINT, previous)
        came.set()
        if raises:
            raise Stopped

    previous = signal.signal(signal.SIGINT, stop)
    try:
        yield came.is_set
    except Exception:
        if not came.is_set():  # compiled code turns any exception into another one
            raise
        raise Stopped from None
    finally:
        signal.signal(signal.SIGINT, previous)


__all__ = ["Here", "Lost", "run_tasks"]
