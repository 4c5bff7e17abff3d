"""HDF5 files are tried in a process apart: files on which the library hangs or crashes are refused."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pymc_backbone import read_records
from pymc_backbone.measurement.reading.formats import isolation

from . import format_files as files
from .test_formats import refuses

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def own_process() -> Iterator[None]:
    isolation._end()
    yield
    isolation._end()


def endless(path: Path) -> Path:
    """Write a file whose heap of texts ends with an object of size zero, over which HDF5 2.0 goes for ever."""
    content = bytearray(files.WRITERS["a.nc"](path).read_bytes())
    place = content.index(b"GCOL") + 16
    while int.from_bytes(content[place : place + 2], "little"):
        size = int.from_bytes(content[place + 8 : place + 16], "little")
        place += 16 + -(-size // 8) * 8
    content[place + 8 : place + 16] = bytes(8)
    path.write_bytes(content)
    return path


def test_a_file_on_which_the_library_hangs_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = files.WRITERS["a.nc"](tmp_path / "good.nc")
    assert len(read_records(good)) == 1
    process = isolation._state["process"]
    monkeypatch.setattr(isolation, "SECONDS", 2.0)
    begin = time.perf_counter()
    refuses(endless(tmp_path / "bad.nc"), "bad.nc", "did not come to an end", "damaged")
    assert time.perf_counter() - begin < 60.0  # 2 s of computation, on a machine that may be busy
    assert process.poll() is not None
    # The next file has a process of its own, and both formats of HDF5 share it.
    assert len(read_records(good)) == 1
    second = isolation._state["process"]
    assert len(read_records(files.WRITERS["v73.mat"](tmp_path / "a.mat"))) == 1
    assert isolation._state["process"] is second and second.pid != process.pid


def test_a_file_on_which_the_library_crashes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = "import os, sys; print('ready', flush=True); sys.stdin.readline(); os.abort()"
    monkeypatch.setattr(isolation, "_PROGRAM", program)
    refuses(files.WRITERS["a.nc"](tmp_path / "a.nc"), "a.nc", "crashed on it")


@pytest.mark.parametrize("program", ["raise SystemExit", None])
def test_without_a_second_process_files_are_read_all_the_same(
    program: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if program is None:
        monkeypatch.setattr(isolation.sys, "executable", str(tmp_path / "none"))
    else:
        monkeypatch.setattr(isolation, "_PROGRAM", program)
    assert len(read_records(files.WRITERS["a.nc"](tmp_path / "a.nc"))) == 1


def test_other_formats_start_no_process(tmp_path: Path) -> None:
    for name in set(files.WRITERS) - {"a.nc", "v73.mat"}:
        read_records(files.WRITERS[name](tmp_path / name))
    assert isolation._state["process"] is None


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_the_process_ends_with_the_program(tmp_path: Path) -> None:
    files.WRITERS["a.nc"](tmp_path / "a.nc")
    code = (
        "import pymc_backbone as pb\nfrom pymc_backbone.measurement.reading.formats import isolation\n"
        f"pb.read_records({str(tmp_path / 'a.nc')!r})\nprint(isolation._state['process'].pid)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert not os.path.exists(f"/proc/{int(done.stdout)}")


def test_an_interrupt_leaves_no_answer_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer that comes after Ctrl-C must not be taken for that of the next file."""
    good = files.WRITERS["a.nc"](tmp_path / "good.nc")
    read_records(good)
    process, line = isolation._state["process"], isolation._line

    def interrupted(*_: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(isolation, "_line", interrupted)
    with pytest.raises(KeyboardInterrupt):
        read_records(good)
    assert process.poll() is not None and isolation._state["process"] is None
    monkeypatch.setattr(isolation, "_line", line)
    assert len(read_records(good)) == 1
