"""One process at a time: the lock of a folder, which ends with its process, however that ends."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import IO, Any

from ..._common.checks import InputError
from ..._common.text import printable

LOCK = "lock.json"


class FolderLock:
    """The lock of a folder, held from `acquire` to `release`.

    Parameters
    ----------
    folder : pathlib.Path
        An existing folder.
    what : str, optional
        What the folder is, for messages.

    Notes
    -----
    The operating system's lock on the file ends with the process, also after ``kill -9``. The file names the process
    and its computer beside it: for the sentence, and where a file system has no working locks. There the process
    counts as alive if it has the number and the start time of the file; a number alone may have been given away.
    """

    def __init__(self, folder: Path, what: str = "store") -> None:
        self.path = folder / LOCK
        self.what = what
        self.file: IO[str] | None = None

    def acquire(self) -> None:
        """Take the lock, or raise `InputError` that names the process that holds it."""
        try:
            self.file = open(self.path, "a+", encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"The {self.what} {self.path.parent} cannot be written ({error.strerror}); name another folder."
            ) from None
        is_free = _lock(self.file) and self._is_in_place()
        holder = self._holder()
        here = platform.node()
        if is_free and holder is not None:
            if holder.get("host") != here:
                message = (
                    f"The {self.what} {self.path.parent} was in use by process {holder.get('process')} on "
                    f"{holder.get('host')}, which cannot be seen from {here}; if that run is over, delete {self.path}."
                )
                self._close()
                raise InputError(message)
            is_free = holder.get("process") == os.getpid() or not _is_alive(holder)
        if not is_free:
            self._close()
            who = "another process" if holder is None else f"process {holder.get('process')} on {holder.get('host')}"
            raise InputError(
                f"The {self.what} {self.path.parent} is in use by {who}; wait until that run is over, or name another "
                "folder."
            )
        self._write(json.dumps({"process": os.getpid(), "host": here, "begun": _start_of(os.getpid())}))

    def release(self) -> None:
        """Give the lock back; the file stays, empty, because removing it would race with who comes next."""
        if self.file is not None:
            self._write("")
            self._close()

    def remove(self) -> None:
        """Give the lock back and remove its file; who opened it meanwhile sees that it is gone, and refuses."""
        if self.file is None:
            return
        if sys.platform == "win32":  # what is open cannot be removed there
            self._close()
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
        self._close()

    def _is_in_place(self) -> bool:
        """Whether the file that was opened is still the one in the folder."""
        assert self.file is not None
        try:
            return os.path.samestat(os.fstat(self.file.fileno()), os.stat(self.path))
        except OSError:
            return False

    def _holder(self) -> dict[str, Any] | None:
        assert self.file is not None
        try:
            self.file.seek(0)
            holder = json.loads(self.file.read())
        # empty after a clean end, half-written after a power cut, locked on Windows, or of another origin
        except (OSError, ValueError, RecursionError):
            return None
        return {key: _word(value) for key, value in holder.items()} if isinstance(holder, dict) else None

    def _write(self, text: str) -> None:
        assert self.file is not None
        try:
            self.file.seek(0)
            self.file.truncate()
            self.file.write(text)
            self.file.flush()
        except OSError as error:
            self._close()
            raise InputError(
                f"{self.path} cannot be written ({error.strerror}); free space or name another folder."
            ) from None

    def _close(self) -> None:
        if self.file is not None:
            try:
                self.file.close()
            except OSError:  # a full disk, noticed a second time
                pass
            self.file = None


def _word(value: Any) -> Any:
    """Return a number, or a text that is fit for a sentence; None for anything else."""
    if isinstance(value, str):
        return printable(value[:200])
    return value if isinstance(value, int) and abs(value) < 1 << 31 else None


def _lock(file: IO[str]) -> bool:
    """Take the operating system's lock on a file; False if another process has it, True where there are no locks."""
    if sys.platform == "win32":
        import msvcrt

        try:
            file.seek(1 << 20)  # beyond the text, which others must be able to read
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def _is_alive(holder: dict[str, Any]) -> bool:
    """Whether the process of the lock file still runs: its number, and its start time so far as it can be known."""
    process = holder.get("process")
    if not isinstance(process, int) or process <= 0 or sys.platform == "win32":
        return False  # on Windows the system's lock has spoken, and signal 0 is not harmless
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return holder.get("begun") == _start_of(process)


def _start_of(process: int) -> str | None:
    """Return when a process began, as text that no later process with the same number has; None if unknown."""
    try:
        # The name of the program, in parentheses, may hold anything; the 22nd field is the start in clock ticks.
        status = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        return f"{boot} {status.rpartition(')')[2].split()[19]}"
    except (OSError, IndexError):
        pass
    if sys.platform == "win32":
        return None
    try:
        done = subprocess.run(
            ["ps", "-o", "lstart=", "-p", str(process)], capture_output=True, text=True, check=False, timeout=10.0
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return " ".join(done.stdout.split()) or None
