"""Throughput and memory of many structures: one process, processes of this package, a Dask cluster on this machine.

The same simulated batches (two specimens each, dry friction in four of five) are diagnosed in every configuration, and
their results are compared bit by bit. A rate is taken over the structures after the first quarter, when every worker
has loaded its code; the time from start to end has that too.

    python benchmarks/many.py --structures 40 --memory 200
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import pymc_backbone as pb
from pymc_backbone._common.processes import Processes
from pymc_backbone.reporting.portable import plain
from pymc_backbone.survey.structure import prepare_worker

MASS, FREQUENCY, AMPLITUDE = 1.3, 5.0, 0.01
SETTINGS: dict[str, Any] = {
    "quick": True, "max_effects": 1, "held_out": 2,
    "candidates": ["coulomb_friction", "quadratic_damping", "cubic_stiffness"],
}  # fmt: skip


def write_batches(folder: Path, count: int) -> None:
    """Write so many structures, a folder of two records each."""
    omega = 2.0 * np.pi * FREQUENCY
    stiffness, damping = MASS * omega**2, 0.012 * MASS * omega
    time_axis = np.arange(520) / (20 * FREQUENCY)
    noise = AMPLITUDE / np.sqrt(2.0) * 10.0 ** (-45.0 / 20.0)
    for number in range(count):
        rng = np.random.default_rng(number)
        effects = () if number % 5 == 4 else ("coulomb_friction",)
        records = []
        for specimen, release in ((1, AMPLITUDE), (2, 0.75 * AMPLITUDE)):
            values = {
                "linear_stiffness": stiffness * (1.0 + 0.01 * rng.standard_normal()),
                "viscous_damping": damping * (1.0 + 0.01 * rng.standard_normal()),
            }
            if effects:
                values["friction_force"] = 0.0012 * stiffness * AMPLITUDE
            wave = pb.simulate_waveform(pb.Oscillator(MASS, effects), values, time_axis, release, release_time=0.26)
            measured = wave.displacement + noise * rng.standard_normal(time_axis.size)
            records.append(pb.Record(f"run_{specimen}", time_axis, measured, "displacement", "m", "simulated", ()))
        pb.write_records(records, folder / f"structure_{number:03d}")


def resident(pid: int) -> float:
    """Return the resident memory of a process [MB]; NaN where the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
        return float(text.split("VmRSS:")[1].split()[0]) / 1e3
    except (OSError, IndexError):
        return float("nan")


def run(sources: dict[str, Path], executor: Executor | None, pids: Callable[[], list[int]]) -> dict[str, Any]:
    """Diagnose the structures; return the times at which they finished, memory of the workers, and the results."""
    times: list[float] = []
    memory: dict[int, list[float]] = {}
    begun = time.perf_counter()

    def say(text: str) -> None:
        if not text.startswith("["):
            return
        times.append(time.perf_counter() - begun)
        for pid in pids():
            memory.setdefault(pid, []).append(resident(pid))
        if len(times) % 20 == 0:
            held = ", ".join(f"{values[-1]:.0f} MB" for values in memory.values())
            print(f"{len(times)} of {len(sources)} after {times[-1]:.0f} s; {held}", file=sys.stderr, flush=True)

    chosen: dict[str, Any] = {"workers": 0} if executor is None else {"executor": executor}
    survey = pb.diagnose_many(sources, mass=MASS, random_seed=1, say=say, **chosen, **SETTINGS)
    dropped = ("seconds", "attempts")
    results = [{k: v for k, v in item.entries().items() if k not in dropped} for item in survey.structures]
    text = json.dumps(plain(results))
    first = len(times) // 4
    rate = (len(times) - first) / (times[-1] - times[first - 1])
    return {"rate": rate, "total": times[-1], "memory": memory, "text": text, "failed": len(survey.failed)}


def throughput(sources: dict[str, Path]) -> list[str]:
    """Return a row for each configuration."""
    found: dict[str, dict[str, Any]] = {"one after another, no worker": run(sources, None, lambda: [os.getpid()])}
    for workers in (1, 2):
        with Processes(workers, prepare_worker) as executor:
            label = f"{workers} {'process' if workers == 1 else 'processes'}"
            found[label] = run(sources, executor, lambda executor=executor: executor.process_ids)
    with dask_client() as client:
        workers = list(client.run(os.getpid).values())
        found["Dask, 2 worker processes"] = run(sources, client.get_executor(), lambda: workers)
    first = next(iter(found.values()))
    lines = [
        "| where | structures per second, workers warm | ratio | from start to end [s] | equal to the first row |",
        "|---|---|---|---|---|",
    ]
    for label, row in found.items():
        is_same = "bit for bit" if row["text"] == first["text"] else "NO"
        ratio = row["rate"] / first["rate"]
        lines.append(f"| {label} | {row['rate']:.2f} | {ratio:.2f} | {row['total']:.1f} | {is_same} |")
    return lines


@contextmanager
def dask_client() -> Iterator[Any]:
    """Yield a client of a new cluster with two worker processes of one thread."""
    from distributed import Client, LocalCluster

    settings: dict[str, Any] = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with LocalCluster(**settings) as cluster, Client(cluster) as client:
        yield client


def memory_table(sources: dict[str, Path]) -> list[str]:
    """Return resident memory of each of two processes on the way through the structures."""
    with Processes(2, prepare_worker, tasks_per_process=10**6) as executor:  # else they would be replaced on the way
        row = run(sources, executor, lambda: executor.process_ids)
    marks = [count for count in (10, 20, 50, 100, 150, 200, 400, 800) if count <= len(sources)]
    head = " | ".join(f"after {count}" for count in marks)
    lines = [f"| worker | {head} |", "|---|" + "---|" * len(marks)]
    for number, values in enumerate(row["memory"].values(), start=1):
        late = len(sources) - len(values)  # it may have come after the first structures
        cells = [f"{values[count - late - 1]:.0f} MB" if count > late else "-" for count in marks]
        lines.append(f"| {number} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--structures", type=int, default=40, help="of the throughput table; 0: none")
    parser.add_argument("--memory", type=int, default=200, help="structures of the memory table; 0: none")
    options = parser.parse_args()
    print(f"Python {platform.python_version()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start\n")
    with tempfile.TemporaryDirectory() as name:
        write_batches(Path(name), max(options.structures, options.memory))
        folders = {path.name: path for path in sorted(Path(name).iterdir())}
        for table, count in ((throughput, options.structures), (memory_table, options.memory)):
            if count:
                print("\n".join(table(dict(list(folders.items())[:count]))), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
