"""Many structures on a real Dask cluster on this machine: several worker processes, one of them killed."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

from pymc_backbone.survey.tasks import Lost

from . import many_jobs
from .test_many_tasks import collect, posix

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client():
    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**settings) as cluster, distributed.Client(cluster) as client:
        yield client


def test_processes_of_a_cluster_give_every_result(client):
    found, is_cut = collect(client.get_executor(), many_jobs.square, {str(i): i for i in range(20)})
    assert found == {str(i): (i * i, 1) for i in range(20)} and not is_cut


@posix
def test_a_killed_worker_costs_nothing_but_its_task(client):
    """Dask runs the task again by itself; the others stay done."""
    victim = next(iter(client.run(os.getpid).values()))
    threading.Timer(1.0, lambda: os.kill(victim, signal.SIGKILL)).start()
    found, _ = collect(client.get_executor(), many_jobs.worker_after, {str(i): 0.3 for i in range(12)})
    assert {attempts for _, attempts in found.values()} == {1} and len(found) == 12
    wait_for_workers(client, victim)


@posix
def test_a_task_that_kills_its_worker_takes_no_other_with_it(client, tmp_path):
    mark = tmp_path / "mark"
    tasks = {str(i): (str(mark) if i == 2 else "", i) for i in range(6)}
    found, _ = collect(client.get_executor(), many_jobs.die, tasks)
    value, attempts = found.pop("2")
    assert isinstance(value, Lost) and attempts == 2 and "KilledWorker" in value.reason
    assert {name: value for name, (value, _) in found.items()} == {str(i): i * i for i in range(6) if i != 2}


def wait_for_workers(client, victim):
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        pids = list(client.run(os.getpid, on_error="ignore").values())
        if len(pids) == 2 and victim not in pids:
            return
        time.sleep(0.2)
    pytest.fail("the killed worker was not replaced")
