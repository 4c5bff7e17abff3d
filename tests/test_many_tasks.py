"""Tasks on executors: what a dead process costs, what is retried, what Ctrl-C leaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from pymc_backbone._common.checks import InputError
from pymc_backbone._common.processes import Processes, WorkerDied
from pymc_backbone.survey.tasks import Here, Lost, run_tasks

from . import many_jobs

ROOT = Path(__file__).resolve().parents[1]
posix = pytest.mark.skipif(os.name != "posix", reason="signals as on POSIX")


def collect(executor: Executor, function: Any, tasks: dict[str, Any], **more: Any) -> tuple[dict[str, Any], bool]:
    found: dict[str, Any] = {}
    is_cut = run_tasks(executor, function, tasks, lambda name, value, n: found.update({name: (value, n)}), **more)
    return found, is_cut


@pytest.fixture(scope="module")
def processes():
    with Processes(2) as executor:
        yield executor


@pytest.mark.parametrize("kind", ["here", "threads", "processes"])
def test_every_executor_gives_every_result(kind, processes):
    executor = {"here": Here(), "threads": ThreadPoolExecutor(2), "processes": processes}[kind]
    found, is_cut = collect(executor, many_jobs.square, {str(i): i for i in range(20)})
    assert found == {str(i): (i * i, 1) for i in range(20)} and not is_cut


def test_processes_are_used_again_and_have_one_thread_each(processes):
    found, _ = collect(processes, many_jobs.worker, {str(i): i for i in range(8)})
    pids = {value[0] for value, _ in found.values()}
    assert len(pids) == 2 and os.getpid() not in pids and pids <= set(processes.process_ids)
    assert {value[1] for value, _ in found.values()} == {os.environ.get("OMP_NUM_THREADS", "1")}


def test_a_process_that_holds_too_much_memory_is_replaced(monkeypatch):
    if not Path("/proc/self/statm").exists():
        pytest.skip("the memory of a process is read from /proc")
    monkeypatch.setattr("pymc_backbone._common.processes.MEGABYTES_PER_PROCESS", 100.0)
    with Processes(1) as executor:
        numbers = [executor.submit(many_jobs.hoard, 60).result() for _ in range(6)]
    # 60 MB after the first, 180 after the third: more than 100 beyond it
    assert numbers[0] == numbers[1] == numbers[2] != numbers[3] == numbers[4] == numbers[5]


def test_a_process_is_replaced_after_its_tasks():
    with Processes(1, tasks_per_process=2) as executor:
        pids = [executor.submit(many_jobs.worker, i).result()[0] for i in range(5)]
        assert [pids.count(pid) for pid in dict.fromkeys(pids)] == [2, 2, 1] and executor.process_ids == pids[-1:]


@posix
def test_a_killed_process_costs_its_own_task_alone(processes, tmp_path):
    tasks = {str(i): ("" if i != 3 else str(tmp_path / "mark"), i) for i in range(8)}
    found, _ = collect(processes, many_jobs.die_once, tasks)
    assert {name: value for name, (value, _) in found.items()} == {str(i): i * i for i in range(8)}
    assert [name for name, (_, attempts) in found.items() if attempts > 1] == ["3"]


@posix
def test_a_task_that_kills_its_process_is_found_out_and_takes_no_other_with_it(processes, tmp_path):
    mark = tmp_path / "mark"
    tasks = {str(i): (str(mark) if i == 2 else "", i) for i in range(6)}
    found, _ = collect(processes, many_jobs.die, tasks)
    value, attempts = found.pop("2")
    assert isinstance(value, Lost) and attempts == 2 and mark.read_text() == "xx"
    assert "SIGKILL" in value.reason and "memory" in value.reason
    assert found == {str(i): (i * i, 1) for i in range(6) if i != 2}


@posix
def test_a_pool_that_was_handed_in_and_broke_is_said_so(tmp_path):
    tasks = {str(i): (str(tmp_path / "mark") if i == 0 else "", i) for i in range(4)}
    with ProcessPoolExecutor(1) as executor:
        found, _ = collect(executor, many_jobs.die, tasks)
    assert set(found) == set(tasks) and all("resume=True" in value.reason for value, _ in found.values())


def test_what_cannot_be_sent_is_reported(processes):
    found, _ = collect(processes, many_jobs.unsendable, {"a": 1})
    assert isinstance(found["a"][0], Lost) and "local object" in found["a"][0].reason
    with pytest.raises(ValueError, match="no square of 3"):
        processes.submit(many_jobs.fail, 3).result()
    assert processes.submit(many_jobs.square, 4).result() == 16


def test_an_exception_that_cannot_be_read_back_is_no_dead_worker(processes):
    before = set(processes.process_ids)
    found, _ = collect(processes, many_jobs.fail_stubbornly, {"a": 1})
    assert isinstance(found["a"][0], Lost) and "Stubborn" in found["a"][0].reason
    assert set(processes.process_ids) == before


@posix
@pytest.mark.parametrize("is_here", [True, False])
def test_ctrl_c_keeps_what_is_finished(processes, is_here):
    executor = Here() if is_here else Processes(2)
    tasks = {"quick": 0.0, "slow": 600.0, "slower": 600.0, "never": 600.0}
    handler, found = signal.getsignal(signal.SIGINT), {}

    def done(name, value, attempts):
        found[name] = (value, attempts)
        threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()

    is_cut = run_tasks(executor, many_jobs.pause, tasks, done)
    if isinstance(executor, Processes):
        ids = executor.process_ids
        executor.kill()
        assert ids and not any(is_alive(pid) for pid in ids)
        with pytest.raises(RuntimeError):
            executor.submit(many_jobs.square, 1)
    assert is_cut and found == {"quick": (0.0, 1)}
    assert signal.getsignal(signal.SIGINT) is handler


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return not (stat.exists() and stat.read_text().rpartition(")")[2].split()[0] == "Z")


@posix
def test_processes_end_with_a_killed_parent(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import time\nfrom pymc_backbone._common.processes import Processes\nfrom tests import many_jobs\n"
        "if __name__ == '__main__':\n    executor = Processes(1)\n    future = executor.submit(many_jobs.pause, 60.0)\n"
        "    while not executor.process_ids:\n        time.sleep(0.05)\n"
        "    time.sleep(1.5)\n    print(executor.process_ids[0], flush=True)\n    time.sleep(60)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment)
    assert parent.stdout is not None
    with parent.stdout:
        pid = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    end = time.monotonic() + 10.0
    while is_alive(pid) and time.monotonic() < end:
        time.sleep(0.1)
    assert not is_alive(pid)


def test_a_script_without_a_guard_is_told_so(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from pymc_backbone._common.processes import Processes\nfrom pymc_backbone._common.checks import InputError\n"
        "from tests import many_jobs\nwith Processes(1) as executor:\n    try:\n"
        "        executor.submit(many_jobs.square, 2).result()\n    except InputError as error:\n        print(error)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, env=environment, timeout=60, check=False
    )
    assert "__main__" in done.stdout, done.stderr


def test_workers_that_cannot_start_end_the_run():
    class Failing(Executor):
        def submit(self, function, /, *args, **kwargs):
            future: Future[Any] = Future()
            future.set_exception(InputError("the worker processes cannot start."))
            return future

    with pytest.raises(InputError, match="cannot start"):
        collect(Failing(), many_jobs.square, {"a": 1})


def test_a_dead_worker_is_an_error_of_the_future(processes):
    with pytest.raises(WorkerDied):
        processes.submit(os._exit, 3).result()
    assert processes.submit(many_jobs.square, 3).result() == 9
