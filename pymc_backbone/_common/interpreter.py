"""Another process of this interpreter that runs a constant program of this package, and nothing that lies nearby."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_ROOT = str(Path(__file__).resolve().parents[2])
_FIND_PACKAGE = "import sys; sys.path.insert(0, sys.argv.pop(1)); "

Process = subprocess.Popen[bytes]
"""What was started: its input is a pipe, its errors go nowhere."""


def start(program: str, *words: str, is_read: bool) -> Process | None:
    """Start a program; None where no other process can be started (an interpreter inside another program).

    Parameters
    ----------
    program : str
        Python, constant; it may import this package. What lies in the working directory is not found by it.
    words : str
        Its arguments.
    is_read : bool
        Whether its output is a pipe, too; else it goes nowhere.
    """
    if not sys.executable:
        return None
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-c", _FIND_PACKAGE + program, _ROOT, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE if is_read else subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except (OSError, ValueError):
        return None


__all__ = ["Process", "start"]
