"""A short run of the fuzzing tool, and checks that it would see what it looks for."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import random
import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
TOOL = ROOT / "benchmarks" / "fuzz" / "fuzz.py"
pytestmark = pytest.mark.skipif(
    not TOOL.exists() or sys.platform != "linux", reason="needs benchmarks/ and the limits that Linux sets"
)


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz", TOOL)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fuzz"] = module
    spec.loader.exec_module(module)
    return module


def test_damaged_files_are_read_or_refused(fuzz: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readers only: compiling the command line's part takes longer than these inputs."""
    monkeypatch.setattr(fuzz, "command", lambda arguments: "refused")
    tally = fuzz.Tally()
    fuzz.damaged_files(tmp_path, 400, random.Random(11), tally, None)
    assert tally.faults == []
    assert sum(tally.outcomes.values()) == 400
    for outcome in ("read", "refused"):  # damage that leaves nothing readable, or everything, would test little
        assert sum(n for (_, o), n in tally.outcomes.items() if o == outcome) > 20


def test_valid_files_are_all_read(fuzz: ModuleType, tmp_path: Path) -> None:
    for name, content in fuzz.seeds(tmp_path).items():
        path = tmp_path / "valid" / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        assert fuzz.read(path) == "read"


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (lambda: int("x") and "read", "ValueError"),
        (lambda: sys.exit(1), "SystemExit"),
        (lambda: str(np.float64(1e300) * np.float64(1e300)), "RuntimeWarning"),
        (lambda: "exit code 1: Traceback", "exit code 1"),
        (lambda: (time.sleep(5.0), "read")[1], "longer than"),
    ],
)
def test_the_tool_sees_faults(fuzz: ModuleType, monkeypatch: pytest.MonkeyPatch, action, words: str) -> None:
    """Negative controls."""
    monkeypatch.setattr(fuzz, "SECONDS", 0.3)
    tally = fuzz.Tally()
    assert not fuzz.judge("control", action, tally, "")
    assert words in tally.faults[0][1] and tally.outcomes["control", "FAULT"] == 1


def test_the_tool_sees_words_that_are_no_sentence(fuzz: ModuleType) -> None:
    tally = fuzz.Tally()

    def refuse() -> str:
        raise fuzz.InputError("bad\nfile")

    assert not fuzz.judge("control", refuse, tally, "") and "no sentence" in tally.faults[0][1]


def _too_much(pipe, module: ModuleType) -> None:
    module.batch = lambda number, start, keep: np.ones(int(4e9) // 8).size
    try:
        module._child(1, 1, None, pipe)
    except MemoryError:
        pipe.send("MemoryError")


def _crash(number: int, start: int, keep: Path | None) -> None:
    os._exit(3)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_the_tool_bounds_memory_and_survives_a_crash(fuzz: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_too_much, args=(sender, fuzz))
    child.start()
    assert receiver.poll(20.0) and receiver.recv() == "MemoryError"
    child.join()
    monkeypatch.setattr(fuzz, "batch", _crash)
    monkeypatch.setattr(fuzz, "warm_up", lambda: None)
    tally = fuzz.run_batches(10, 1, None, lambda tally, done: None)
    assert tally.outcomes["batch", "FAULT"] == 1
