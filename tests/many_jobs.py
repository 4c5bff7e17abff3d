"""What the tests of many structures run in workers: importable there, and light."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any


def square(value: int) -> int:
    return value * value


def pause(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def worker(_: Any) -> tuple[int, str | None]:
    """Of the process this runs in, and how many threads linear algebra may use there."""
    time.sleep(0.1)
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


HOARD: list[bytearray] = []


def hoard(megabytes: int) -> int:
    """Keep memory; the process says which one it is."""
    HOARD.append(bytearray(b"x") * (megabytes * 10**6))
    return os.getpid()


def die_once(task: tuple[str, int]) -> int:
    """Kill the own process, unless this ran before: a file says so."""
    mark, value = task
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(value)


def die(task: tuple[str, int], wait: float = 0.0) -> int:
    """Kill the own process every time; a file counts."""
    mark, value = task
    if mark:
        time.sleep(wait)
        with Path(mark).open("a") as stream:
            stream.write("x")
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return square(value)


def fail(value: int) -> int:
    raise ValueError(f"no square of {value}")


def unsendable(_: Any) -> Any:
    return lambda: None


class Stubborn(Exception):
    """Can be pickled, and then not read back."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(one)


def fail_stubbornly(_: Any) -> None:
    raise Stubborn("one", "two")


def diagnosis(job: Any) -> dict[str, Any]:
    """Stand in for the diagnosis of a structure; what its folder is named says what happens."""
    from pymc_backbone.survey.structure import blank

    name = job.name
    if name.startswith("poison"):
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("slow"):
        time.sleep(600.0)
    found = {
        "verdict": "found", "sentence": "Dry friction is missing.", "missing_effects": ("coulomb_friction",),
        "effects": ("coulomb_friction",), "probability": 0.97, "frequency": 5.0, "damping_ratio": 0.01,
        "seconds": 0.1,
    }  # fmt: skip
    return {**blank(job), **found}


def die_later(task: tuple[str, int]) -> int:
    """Kill the own process every time, but not before Dask is done with starting it: its nanny would wait for ever."""
    return die(task, 1.5)


def pause_and_square(value: int) -> int:
    time.sleep(0.3)
    return value * value
