"""Thirty kills at random moments, and what is left: the draws of a run that nobody disturbed, or not.

For each step a run is started with a store in a process of its own, killed with SIGKILL after a random time, and
resumed, again and again; where it ends before its kills are used up, another one with the next seed begins. The process
notes every draw in a file that is mapped into memory, which outlives it, so that what was lost is known exactly. In the
end the draws and statistics of every run are compared, bit by bit, with those of a run without a store and without a
kill. The last rows write a chunk after every draw, so that most kills fall into the writing.

    python benchmarks/kill_and_resume.py --out benchmarks/kill_and_resume.md
"""

from __future__ import annotations

import argparse
import mmap
import os
import platform
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

NOTE = struct.Struct("qdd")  # draws so far, when the last one came, and when the first of this process began
RUNS = {"metropolis": (1000, 12000), "demetropolisz": (1000, 12000), "nuts": (300, 900)}
STRESS = {"metropolis": (200, 1500), "nuts": (100, 300)}
CHAINS = 2
TIMES = ("perf_counter_diff", "perf_counter_start", "process_time_diff")  # NUTS's own clock, no draw depends on it


def make_model() -> Any:
    """Return the population model of a Duffing oscillator, from 30 specimens."""
    import pymc_backbone as pb

    rng = np.random.default_rng(5)
    oscillator = pb.Oscillator(1.0, ["cubic_stiffness"])
    truth = np.array([6500.0, 1.1, 6.25e6])
    parameters = truth * (1.0 + 0.02 * rng.standard_normal((30, 3)))
    backbones = pb.simulate_population(oscillator, parameters, np.geomspace(0.005, 0.03, 6))
    bounds = {"linear_stiffness": (5000.0, 8000.0), "viscous_damping": (0.1, 3.0), "cubic_stiffness": (4e6, 8e6)}
    return pb.build_model(oscillator, pb.fit_density(backbones, kind="joint", marginal="normal"), bounds)


def work(options: argparse.Namespace) -> None:
    """Sample in this process: with a store and a note of every draw, or undisturbed."""
    from pymc_backbone import sample
    from pymc_backbone.inference.store import recorder

    if options.every_draw:
        recorder.CHUNK_DRAWS, recorder.SHORTEST_WAIT = 1, 0.0
    kept: dict[str, Any] = {}
    if options.store is not None:
        note = mmap.mmap(os.open(options.note, os.O_RDWR), NOTE.size)

        begun = time.time()

        def count(trace: Any, draw: Any) -> None:
            nonlocal begun
            now = time.time()
            draws = draw.chain * (options.tune + options.draws) + draw.draw_idx + 1
            if draws <= options.stored:  # repeated, not drawn
                begun = now
            note[:] = NOTE.pack(draws, now, begun)

        kept = {"store": options.store, "resume": True, "callback": count}
    result = sample(
        make_model(), draws=options.draws, tune=options.tune, chains=CHAINS, step=options.step,
        random_seed=options.seed, progressbar=False, **kept,
    )  # fmt: skip
    arrays = {
        f"{group}/{name}": np.asarray(values)
        for group in ("posterior", "sample_stats")
        for name, values in result[group].data_vars.items()
        if name not in TIMES
    }
    np.savez(options.result, **arrays)


@dataclass
class Outcome:
    """What the kills of one row did."""

    step: str
    every_draw: bool
    runs: int = 0
    kills: int = 0
    sampling: int = 0
    damaged: int = 0
    stored: int = 0
    differing: int = 0
    lost_draws: list[int] = field(default_factory=list)
    lost_seconds: list[float] = field(default_factory=list)


def stored_draws(store: Path, outcome: Outcome) -> tuple[int, float]:
    """Return how many draws a store holds and when the last chunk came; count what does not check."""
    from pymc_backbone.inference.store.draw_chunks import ChunkFolder
    from pymc_backbone.inference.store.run_folder import read_manifest

    manifest = read_manifest(store)
    if manifest is None:
        return 0, 0.0
    draws, last = 0, 0.0
    for chain in range(CHAINS):
        folder = ChunkFolder(store / f"chain_{chain}", f"{manifest['run']}/{chain}")
        draws += len(folder.read().points)
        outcome.damaged += len(list(folder.folder.glob("damaged-*")))
        last = max([last, *(path.stat().st_mtime for path in folder.folder.glob("*.npz"))])
    return draws, last


def command(step: str, seed: int, sizes: tuple[int, int], result: Path, *more: str) -> list[str]:
    """Return the command of a worker."""
    tune, draws = map(str, sizes)
    here = [sys.executable, str(Path(__file__).resolve()), "--worker", "--step", step, "--seed", str(seed)]
    return [*here, "--tune", tune, "--draws", draws, "--result", str(result), *more]


def torture(step: str, kills: int, every_draw: bool, rng: np.random.Generator, folder: Path) -> Outcome:
    """Kill and resume until the kills are used up, then let the last run end; compare every run."""
    outcome = Outcome(step, every_draw)
    sizes = (STRESS if every_draw else RUNS)[step]
    seed = 100
    while outcome.kills < kills:
        seed += 1
        outcome.runs += 1
        store, note, result = folder / f"store_{seed}", folder / "note", folder / "result.npz"
        result.unlink(missing_ok=True)
        outcome.stored = 0
        whole = folder / "whole.npz"
        begin = time.monotonic()
        subprocess.run(command(step, seed, sizes, whole), check=True)
        undisturbed = time.monotonic() - begin
        more = ["--store", str(store), "--note", str(note)] + ["--every-draw"] * every_draw
        while not result.exists():
            note.write_bytes(NOTE.pack(0, 0.0, 0.0))
            known = ["--stored", str(outcome.stored)]
            process = subprocess.Popen(command(step, seed, sizes, result, *more, *known))
            if outcome.kills == kills:
                _check_end(process, process.wait())
            elif _is_killed(process, note, undisturbed, rng):
                _account(outcome, note, store)
        if not _same(whole, result):
            outcome.differing += 1
        shutil.rmtree(store)
    return outcome


def _is_killed(process: subprocess.Popen[bytes], note: Path, undisturbed: float, rng: np.random.Generator) -> bool:
    """Kill a worker at a random moment; return whether it had not ended by then.

    One in five at any moment of an undisturbed run, most of which is importing and compiling; the others up to three
    seconds after the first draw.
    """
    patience = rng.uniform(0.0, undisturbed)
    if rng.uniform() > 0.2:
        patience = rng.uniform(0.0, 3.0)
        while process.poll() is None and NOTE.unpack(note.read_bytes())[0] == 0:
            time.sleep(0.01)
    try:
        _check_end(process, process.wait(patience))
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()
        return True
    return False


def _check_end(process: subprocess.Popen[bytes], code: int) -> None:
    if code != 0:
        raise SystemExit(f"the worker ended with {code}: {process.args}")


def _account(outcome: Outcome, note: Path, store: Path) -> None:
    outcome.kills += 1
    drawn, when, begun = NOTE.unpack(note.read_bytes())
    stored, last = stored_draws(store, outcome)
    if stored < outcome.stored:
        raise SystemExit(f"{outcome.step}: {outcome.stored} draws were stored, and {stored} are left")
    outcome.stored = stored
    if drawn == 0:
        return  # it was importing, compiling or looking for starts
    outcome.sampling += 1
    # Killed while it repeated stored draws, or between the writing and the note, it lost none.
    lost = max(0, drawn - stored)
    outcome.lost_draws.append(lost)
    outcome.lost_seconds.append(when - max(last, begun) if lost else 0.0)
    print(f"{outcome.step}: kill {outcome.kills} after {drawn} draws, {stored} stored", flush=True)


def _same(first: Path, second: Path) -> bool:
    with np.load(first) as a, np.load(second) as b:
        return set(a.files) == set(b.files) and all(
            a[name].dtype == b[name].dtype and a[name].tobytes() == b[name].tobytes() for name in a.files
        )


def overhead(step: str, repeats: int, folder: Path) -> tuple[int, float, float]:
    """Return chunks, milliseconds for each, and sampling with the writing to sampling without it, in the same runs.

    The same runs, because a busy machine makes two runs differ by far more than what the writing costs.
    """
    from pymc_backbone import sample
    from pymc_backbone.inference.store import recorder

    tune, draws = RUNS[step]
    write = recorder.Recorder._write
    spent: list[float] = []
    ratios, means = [], []

    def timed(recorder: Any) -> None:
        begin = time.perf_counter()
        write(recorder)
        spent.append(time.perf_counter() - begin)

    recorder.Recorder._write = timed  # type: ignore[method-assign]
    try:
        for repeat in range(repeats):
            spent.clear()
            store = folder / f"overhead_{step}_{repeat}"
            result = sample(
                make_model(), draws=draws, tune=tune, chains=CHAINS, step=step, random_seed=1, progressbar=False,
                store=store,
            )  # fmt: skip
            seconds = float(result["posterior"].attrs["sampling_time"])
            ratios.append(seconds / (seconds - sum(spent)))
            means.append(1e3 * float(np.mean(spent)))
            shutil.rmtree(store)
    finally:
        recorder.Recorder._write = write  # type: ignore[method-assign]
    return len(spent), float(np.median(means)), float(np.median(ratios))


def main() -> None:
    """Run the kills and the clock; write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=None, help="write the tables here as Markdown")
    parser.add_argument("--kills", type=int, default=10, help="for each step (10)")
    parser.add_argument("--stress-kills", type=int, default=5, help="for each row with a chunk after every draw (5)")
    parser.add_argument("--repeats", type=int, default=3, help="of the runs whose time is measured (3)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    for name in ("--step", "--store", "--note", "--result"):
        parser.add_argument(name, default=None, help=argparse.SUPPRESS)
    parser.add_argument("--tune", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--draws", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--stored", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--every-draw", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(options)
        return
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        outcomes = [torture(step, options.kills, False, rng, folder) for step in RUNS]
        outcomes += [torture(step, options.stress_kills, True, rng, folder) for step in STRESS]
        clocks = {step: overhead(step, options.repeats, folder) for step in RUNS}
    text = _tables(outcomes, clocks, options)
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


def _tables(outcomes: list[Outcome], clocks: dict[str, tuple[int, float, float]], options: argparse.Namespace) -> str:
    lines = [
        "# Kill and resume",
        "",
        f"`python benchmarks/kill_and_resume.py --kills {options.kills} --stress-kills {options.stress_kills} "
        f"--repeats {options.repeats} --seed {options.seed}`; Python {platform.python_version()}, "
        f"{os.cpu_count()} cores, shared with other work. {CHAINS} chains.",
        "",
        "SIGKILL at a random moment, then `resume`, again and again: one in five at any moment between the start of "
        "the process and the end of an undisturbed run, the others up to three seconds after the first draw. *In the "
        "sampling*: kills after the first draw; the others came while importing, compiling or looking for starts. "
        "*Differing*: runs whose draws or statistics differ in any bit from a run without a store and without a kill. "
        "*Lost*: drawn by the killed process, but not in the store; the largest over the kills.",
        "",
        "| step | tune + draws | chunk | runs | kills | in the sampling | damaged chunks | differing runs | lost draws "
        "| lost seconds |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in outcomes:
        tune, draws = (STRESS if row.every_draw else RUNS)[row.step]
        lines.append(
            f"| {row.step} | {tune} + {draws} | {'every draw' if row.every_draw else 'as shipped'} | {row.runs} "
            f"| {row.kills} | {row.sampling} | {row.damaged} | {row.differing} | {max(row.lost_draws, default=0)} "
            f"| {max(row.lost_seconds, default=0.0):.2f} |"
        )
    lines += [
        "",
        "As shipped, a chunk is written after 100 draws but not more than once a second, and after 10 seconds in any "
        "case: a slow model loses at most 100 draws or 10 seconds, a fast one at most about a second of draws.",
        "",
        "What the store costs: sampling with the writing to sampling without it, in the same run.",
        "",
        "| step | chunks | a chunk [ms] | ratio |",
        "|---|---|---|---|",
        *(f"| {step} | {chunks} | {mean:.1f} | {ratio:.3f} |" for step, (chunks, mean, ratio) in clocks.items()),
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
