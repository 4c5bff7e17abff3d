"""Jobs on all cores: in order, each core shared out once, and the same digits whatever their number."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
import time
from functools import partial

import numpy as np
import pytest

from pymc_backbone._common import forked, threads
from pymc_backbone._common.forked import in_two_processes
from pymc_backbone._common.late_imports import imported_beside
from pymc_backbone._common.threads import in_threads
from pymc_backbone.discrepancy.proposals.propose import propose
from pymc_backbone.oscillator import Oscillator

from .test_discrepancy_scatter import MASS, backbones, factors_of, fitted


def slowly(number: int) -> tuple[int, int]:
    time.sleep(0.02 * (3 - number % 3))
    return number, threading.get_ident()


def cores(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(threads, "cores", lambda: count)


@pytest.mark.parametrize("count", [1, 3])
def test_results_come_in_the_order_of_the_jobs(monkeypatch, count):
    cores(monkeypatch, count)
    found = in_threads([partial(slowly, k) for k in range(7)])
    assert [number for number, _ in found] == list(range(7))
    assert (len({thread for _, thread in found}) > 1) == (count > 1)


def test_jobs_of_a_job_get_the_core_of_a_neighbour_that_has_ended(monkeypatch):
    cores(monkeypatch, 2)
    running, most = 0, 0
    lock = threading.Lock()

    def inner(number: int) -> tuple[int, int]:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.02)
        with lock:
            running -= 1
        return number, threading.get_ident()

    def outer(count: int) -> list[tuple[int, int]]:
        return in_threads([partial(inner, k) for k in range(count)])

    short, long = in_threads([partial(outer, 2), partial(outer, 12)])
    assert [number for number, _ in short] == [0, 1] and [number for number, _ in long] == list(range(12))
    assert len({thread for _, thread in long}) == 2 and most == 2


@pytest.mark.parametrize("count", [2, 4])
def test_jobs_of_jobs_of_jobs_are_all_done_by_whoever_is_free(monkeypatch, count):
    """Who waits takes jobs of others: none is returned without what another still works on."""
    cores(monkeypatch, count)

    def paths(depth: int, path: tuple[int, ...]) -> list[tuple[int, ...]]:
        if depth == 0:
            time.sleep(1e-4 * (sum(path) % 3))
            return [path]
        below = in_threads([partial(paths, depth - 1, (*path, k)) for k in range(3)])
        return [one for part in below for one in part]

    expected = list(itertools.product(range(3), repeat=4))
    for _ in range(15):
        assert paths(4, ()) == expected


def test_what_fails_in_a_job_is_raised(monkeypatch):
    cores(monkeypatch, 2)
    with pytest.raises(ZeroDivisionError):
        in_threads([lambda: 1.0, lambda: 1 / 0, lambda: 2.0])


def test_jobs_behind_one_that_fails_are_not_begun(monkeypatch):
    cores(monkeypatch, 2)
    begun: list[int] = []

    def job(number: int) -> None:
        begun.append(number)
        if number == 0:
            raise ValueError(number)
        time.sleep(0.05)

    with pytest.raises(ValueError, match="0"):
        in_threads([partial(job, k) for k in range(40)])
    assert 0 in begun and len(begun) < 5
    assert [number for number, _ in in_threads([partial(slowly, k) for k in range(4)])] == [0, 1, 2, 3]


def test_one_core_where_linear_algebra_was_told_so(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert threads.cores() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "")
    assert threads.cores() >= 1


def test_a_fit_and_proposals_have_the_same_digits_on_one_core_and_on_many(monkeypatch):
    batch = backbones(factors_of(0.05, 4))
    seen = []
    for count in (1, 4):
        cores(monkeypatch, count)
        found = fitted(batch)
        proposed = propose(batch, Oscillator(MASS), ("cubic_stiffness", "quintic_stiffness", "quadratic_damping"), 2)
        seen.append(
            (found.state.eta.tobytes(), found.state.own.tobytes(), found.chi_square.tobytes(),
             [(item.names, item.chi_square, item.eta.tobytes(), item.own.tobytes()) for item in proposed])
        )  # fmt: skip
    assert seen[0] == seen[1]
    assert np.frombuffer(seen[0][0])[0] != 0.0


def bytes_of(number: int) -> bytes:
    return f"{number} {os.getpid()}".encode() * (1 + 100_000 * (number == 1))


def makers(found: list[bytes]) -> list[bytes]:
    return [data.split()[1][: len(str(os.getpid()))] for data in found]


@pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux only")
def test_every_second_job_is_done_in_a_fork_where_all_threads_are_known(monkeypatch):
    cores(monkeypatch, 2)
    monkeypatch.setattr(forked, "_is_safe", lambda: True)  # threads of a test runner stand idle
    found = in_two_processes([partial(bytes_of, k) for k in range(5)])
    assert [data.split()[0] for data in found] == [b"0", b"1", b"2", b"3", b"4"]
    here = str(os.getpid()).encode()
    assert [maker == here for maker in makers(found)] == [True, False, True, False, True]


@pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux only")
def test_what_a_fork_cannot_deliver_is_made_or_raised_here(monkeypatch):
    monkeypatch.setattr(forked, "_is_safe", lambda: True)
    own = os.getpid()

    def only_here() -> bytes:
        if os.getpid() != own:
            os._exit(1)
        return b"here"

    assert in_two_processes([only_here, only_here, only_here]) == [b"here"] * 3
    with pytest.raises(ZeroDivisionError):
        in_two_processes([only_here, lambda: bytes(1 // 0)])
    with pytest.raises(ZeroDivisionError):
        in_two_processes([lambda: bytes(1 // 0), only_here])


@pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux only")
def test_jobs_are_done_here_where_no_process_more_is_to_be_had(monkeypatch):
    monkeypatch.setattr(forked, "_is_safe", lambda: True)

    def refused() -> int:
        raise BlockingIOError("no process more")

    monkeypatch.setattr(os, "fork", refused)
    before = len(os.listdir("/proc/self/fd"))
    found = in_two_processes([partial(bytes_of, k) for k in range(3)])
    assert [data.split()[0] for data in found] == [b"0", b"1", b"2"]
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.skipif(sys.platform != "linux", reason="forks on Linux only")
def test_idle_threads_of_jobs_and_of_the_progress_are_known():
    script = (
        "import sys; from pymc_backbone._common import forked, progress, threads\n"
        "threads.cores = lambda: 2\n"
        "with progress.Progress(lambda line: None):\n"
        "    threads.in_threads([int, int]); print(forked._is_safe())\n"
        "    sys.modules['jax'] = sys; print(forked._is_safe())\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"], done.stderr


def test_no_fork_beside_a_thread_that_nobody_knows_or_on_one_core(monkeypatch):
    cores(monkeypatch, 2)
    over = threading.Event()
    stranger = threading.Thread(target=over.wait, name="stranger")
    stranger.start()
    try:
        assert not forked._is_safe()
    finally:
        over.set()
        stranger.join()
    cores(monkeypatch, 1)
    assert not forked._is_safe()


def test_a_module_is_there_after_what_went_on_beside_its_import():
    sys.modules.pop("this_is_no_module", None)
    with imported_beside("this_is_no_module"):
        pass
    sys.modules.pop("colorsys", None)
    with imported_beside("colorsys"):
        pass
    assert "colorsys" in sys.modules
    assert all(thread.name != "imports" for thread in threading.enumerate())


def test_short_turns_end_with_their_block():
    before = sys.getswitchinterval()
    with threads.short_turns():
        assert sys.getswitchinterval() < 1e-3
    assert sys.getswitchinterval() == before
    with pytest.raises(ValueError), threads.short_turns():
        raise ValueError
    assert sys.getswitchinterval() == before
