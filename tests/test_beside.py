"""Compiling with two processes: the second keeps its part on disk, and ends when the first does."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import pymc_backbone as pb
from pymc_backbone._common import beside
from pymc_backbone._common.compiled import KERNELS
from pymc_backbone.discrepancy.proposals.set_kernels import best_atoms

from .discrepancy_cases import MASS, make_records


def test_functions_are_compiled_for_the_types_that_they_are_called_with():
    """Else who runs a first diagnosis waits for them twice."""
    records = make_records(np.random.default_rng(5), ("cubic_stiffness",))
    asked = {"candidates": ("cubic_stiffness", "coulomb_friction"), "max_effects": 2, "quick": True, "random_seed": 1}
    pb.find_missing_effect(pb.Oscillator(MASS), records, **asked)
    for kernel in KERNELS:
        called = len(kernel.dispatcher.signatures)
        kernel.compile()
        assert called == 1 and len(kernel.dispatcher.signatures) == 1, kernel.dispatcher


def test_the_second_process_keeps_what_it_compiles_on_disk(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # of processes that begin now
    monkeypatch.setattr(beside, "cores", lambda: 2)
    monkeypatch.setattr(beside, "NATIVE", [])
    monkeypatch.setattr(beside, "KERNELS", [kernel for kernel in KERNELS if kernel.dispatcher is best_atoms])
    beside.compile_all()
    assert [path.name.split("-")[0] for path in tmp_path.rglob("*.nbc")] == ["set_kernels.best_atoms"]


def test_with_one_core_there_is_no_second_process(monkeypatch):
    monkeypatch.setattr(beside, "cores", lambda: 1)
    assert beside._second() is None


def test_what_interrupts_the_first_process_ends_the_second(monkeypatch):
    def interrupted() -> None:
        raise KeyboardInterrupt

    second = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], stdin=subprocess.PIPE)
    native = SimpleNamespace(is_beside=False, define=interrupted)
    monkeypatch.setattr(beside, "_second", lambda: second)
    monkeypatch.setattr(beside, "NATIVE", [native])
    with pytest.raises(KeyboardInterrupt):
        beside.compile_all()
    assert second.returncode not in (None, 0)


def test_the_second_process_ends_with_the_first(monkeypatch, tmp_path):
    (tmp_path / "takes_long.py").write_text("import time; time.sleep(60)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    second = beside.start(beside._PROGRAM, "takes_long", is_read=False)
    second.stdin.close()  # as the system does where the first process ends, however it ends
    assert second.wait(timeout=50) == 1


def test_another_process_runs_nothing_that_lies_in_the_working_directory(monkeypatch, tmp_path):
    (tmp_path / "json.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    second = beside.start("import json; sys.exit(0 if json.dumps else 1)", is_read=False)
    assert second.wait(timeout=50) == 0
    second.stdin.close()
