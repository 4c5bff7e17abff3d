"""HDF5 files are tried in a process apart before they are read here.

The HDF5 library is not made for damaged files: on some it crashes, on some it never comes to an end (a global heap with
an object of size zero, HDF5 2.0), and nothing in this process could stop it. So a second process reads each file first,
with a limit of time. It is started with the first such file, takes one file after another, and ends with this process.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ...._common.checks import InputError
from ...._common.interpreter import start
from ...._common.text import printable

SECONDS = 10.0
"""What the library may take for a small file, in seconds of computation, ..."""
BYTES_PER_SECOND = 1e7
"""... and for each of these bytes a second more."""
WAITING = 6.0
"""How much longer that may take on a machine that is busy; where computation cannot be limited, only this counts."""
START_SECONDS = 120.0
_PROGRAM = "from pymc_backbone.measurement.reading.formats import try_files; try_files()"
_READY, _DONE = b"ready\n", b"done\n"
_state: dict[str, Any] = {"process": None, "owner": None, "is_inside": False}
_of_parents: list[Any] = []  # kept, because throwing one away warns that it runs


def check_that_it_ends(path: Path, kind: str) -> None:
    """Let the other process read an HDF5 file first, and come back once it has.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        A key of what `serve` was given.

    Raises
    ------
    InputError
        When that process crashes, or does not come to an end. What is wrong with a file otherwise is found when it is
        read here.

    Notes
    -----
    Where no second process can be started (an interpreter inside another program), nothing is checked.
    """
    if _state["is_inside"]:
        return
    process = _running()
    if process is None:
        return
    limit = SECONDS + path.stat().st_size / BYTES_PER_SECOND
    request = json.dumps([os.path.abspath(path), kind, limit]).encode() + b"\n"
    try:
        process.stdin.write(request)
        process.stdin.flush()
        answer = _line(process, limit * WAITING)
        if answer == b"" and process.wait(START_SECONDS) == -getattr(signal, "SIGXCPU", 0) != 0:
            answer = None
    except OSError:
        answer = b""
    except BaseException:  # Ctrl-C: an answer that comes later would be taken for the next file's
        _end()
        raise
    if answer == _DONE:
        return
    _end()
    what = f"did not come to an end with it in {limit:.0f} s" if answer is None else "crashed on it"
    raise InputError(f"{printable(path.name)}: the HDF5 library {what}; the file is damaged, write it again.")


def serve(readers: Mapping[str, Callable[[Path], Any]]) -> None:
    """Read the files that are named on standard input, one after another, until it ends; for the other process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    _state["is_inside"] = True
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    answers.write(_READY)
    answers.flush()
    for line in sys.stdin.buffer:
        place, kind, seconds = json.loads(line)
        _limit_computation(seconds)
        try:
            readers[kind](Path(place))
        except Exception:  # the process that asks will find the same, and say so
            pass
        answers.write(_DONE)
        answers.flush()


def unasked(reader: Callable[[Path], Any], path: Path) -> None:
    """Read a file without asking another process first."""
    _state["is_inside"] = True
    reader(path)


def _limit_computation(seconds: float) -> None:
    """Let the system end this process after so many seconds of computation, whatever it is doing then."""
    try:
        import resource
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    limit = math.ceil(used.ru_utime + used.ru_stime + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def _running() -> Any:
    """Return the other process, started if need be; None where it does not start."""
    if _state["owner"] != os.getpid():  # the first file, or a fork of a process that had one
        _of_parents.append(_state["process"])
        _state.update(process=None, owner=os.getpid())
        process = start(_PROGRAM, is_read=True)
        if process is None:
            return None
        _state["process"] = process
        atexit.register(_end)
        try:
            is_ready = _line(process, START_SECONDS) == _READY
        except BaseException:
            _end()
            raise
        if not is_ready:
            _end()
            _state["owner"] = os.getpid()  # do not try again
    return _state["process"]


def _line(process: Any, seconds: float) -> bytes | None:
    """Return the next line of the process, empty where it has ended, or None if none comes in time."""
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    # Pipes cannot be waited for with a limit on every system; threads can.
    reader = threading.Thread(target=lambda: lines.put(process.stdout.readline()), daemon=True)
    _state["reader"] = reader
    reader.start()
    try:
        return lines.get(timeout=seconds)
    except queue.Empty:
        return None


def _end() -> None:
    """End the other process."""
    process, owner = _state["process"], _state["owner"]
    _state.update(process=None, owner=None)
    if process is None or owner != os.getpid():
        return
    process.kill()
    process.wait()
    _state["reader"].join()  # nothing may be closed under its hands
    process.stdin.close()
    process.stdout.close()
