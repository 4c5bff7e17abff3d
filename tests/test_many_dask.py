"""Many structures on a real Dask cluster on this machine: several worker processes, one of them killed."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from pymc_backbone.survey.tasks import Lost

from . import many_jobs
from .test_many_tasks import collect, posix

distributed = pytest.importorskip("distributed")
TOLERATED = "distributed.scheduler.allowed-failures"


@contextmanager
def cluster(workers: int = 2) -> Iterator[Any]:
    settings = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as local, distributed.Client(local) as client:
        yield client


def test_processes_of_a_cluster_give_every_result():
    with cluster() as client:
        found, is_cut = collect(client.get_executor(), many_jobs.square, {str(i): i for i in range(20)})
    assert found == {str(i): (i * i, 1) for i in range(20)} and not is_cut


@posix
@pytest.mark.slow
def test_a_killed_worker_costs_its_own_task_alone():
    """Dask runs it again by itself; the other results stay."""
    with cluster() as client:
        victim = next(iter(client.run(os.getpid).values()))
        threading.Timer(1.0, lambda: os.kill(victim, signal.SIGKILL)).start()
        found, is_cut = collect(client.get_executor(), many_jobs.pause_and_square, {str(i): i for i in range(12)})
    assert found == {str(i): (i * i, 1) for i in range(12)} and not is_cut


@posix
@pytest.mark.slow
def test_a_task_that_kills_its_worker_takes_no_other_with_it(tmp_path):
    """What waits in the killed worker's queue is suspicious to Dask too: it runs again alone, and is done."""
    import dask

    mark = tmp_path / "mark"
    tasks = {str(i): (str(mark) if i == 2 else "", i) for i in range(6)}
    with dask.config.set({TOLERATED: 0}), cluster() as client:
        found, _ = collect(client.get_executor(), many_jobs.die_later, tasks)
    value, attempts = found.pop("2")
    assert isinstance(value, Lost) and attempts == 2 and "KilledWorker" in value.reason
    assert mark.read_text() == "xx"
    assert {name: value for name, (value, _) in found.items()} == {str(i): i * i for i in range(6) if i != 2}
