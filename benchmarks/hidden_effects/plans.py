"""Whether the test that is advised decides: batches that leave several sets, the advice carried out; prints Markdown.

    python benchmarks/hidden_effects/plans.py --batches 20 --seed 314159 [--tiers close_pairs few_data] [--workers 2]
    python benchmarks/hidden_effects/plans.py --batches 100 --among DIR [--workers 2]
    python benchmarks/hidden_effects/plans.py --of ROWS [ROWS ...]

Batches are drawn until so many leave several sets possible with the truth among them; with ``--among`` they are those
of a folder that `diagnose.py` left open. For each the first advice and, for comparison, the present test are carried
out with the same structures and fresh noise, by the generator's own integrator; the records at hand and the new ones
are then diagnosed together. A test decides where a law is named. *Promised* is the probability that the plan gave.
Each row is printed as a line of JSON; ``--of`` prints the table of files of such lines, also of a run that was ended
early.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import islice, pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from batches import Batch, make_batch
from motion import simulate
from outcomes import read_outcomes, wilson_interval
from systems import pack

from pymc_backbone import Design, InputError, Oscillator, Record, find_missing_effect, plan_tests
from pymc_backbone.discrepancy.results.study import Study

AMBIGUOUS_TIERS = ("close_pairs", "few_data", "noisy_and_coarse")
LONGEST = 12000  # samples
PROMISES = (0.0, 0.1, 0.4, 0.75, 1.0)  # between which tests are counted together


def records_of(batch: Batch) -> list[Record]:
    """Return the records of a batch as a user has them."""
    return [
        Record(f"specimen_{k}", item.time, item.measured, "displacement", "m")
        for k, item in enumerate(batch.records, start=1)
    ]


def carried_out(batch: Batch, design: Design, rng: np.random.Generator, name: str) -> list[Record]:
    """Return the records of a test of the same structures, one after the other, with fresh noise."""
    made = []
    for k in range(design.records):
        parameters = {**batch.truth["parameters"][k % len(batch.records)]}
        parameters.pop("specimen")
        parameters["mass"] = batch.truth["mass"] + design.added_mass
        count = min(int(design.duration * design.sampling_rate), LONGEST)
        time = np.arange(count) / design.sampling_rate
        exact = simulate(pack(parameters), design.release, time).displacement
        values = exact + design.noise * rng.standard_normal(time.size)
        made.append(Record(f"{name}_{k + 1}", time, values, "displacement", "m"))
    return made


def diagnosed(batch: Batch, records: list[Record]) -> Study:
    """Return the verdict on some records of a batch."""
    oscillator = Oscillator(batch.truth["mass"], batch.truth["base"])
    return find_missing_effect(oscillator, records, quick=True, tolerance=0, held_out=0, random_seed=1)


def outcome(batch: Batch, study: Study) -> str:
    """Return what a verdict is worth."""
    hidden = tuple(batch.truth["hidden"])
    if study.named_level == "mechanism":
        return "mechanism"
    if study.verdict == "found":
        return "right" if tuple(sorted(study.missing_effects)) == hidden else "wrong"
    if study.verdict == "adequate":
        return "wrong" if hidden else "right"
    return str(study.verdict)


def judge(task: tuple[int, int, str | None]) -> dict[str, Any] | None:
    """Return what became of one batch; None where it is not ambiguous, or the truth is not listed."""
    seed, index, tier = task
    batch = make_batch(seed, index, tier)
    hidden = tuple(batch.truth["hidden"])
    try:
        study = diagnosed(batch, records_of(batch))
        listed = {tuple(sorted(item.effects)) for item in study.contenders}
        if len(study.contenders) < 2 or hidden not in listed or study.present is None:
            return None
        begin = time.perf_counter()
        base = Oscillator(batch.truth["mass"], batch.truth["base"])
        plan = plan_tests(base, study.contenders, study.present, random_seed=index)
        seconds = time.perf_counter() - begin
        if not plan.best:
            return {"index": index, "tier": batch.truth["tier"], "hidden": hidden, "promised": None, "seconds": seconds}
        rng = np.random.default_rng([seed, index, 7])
        # what is listed speaks of the median release; a repetition has the releases of the batch
        advised = carried_out(batch, plan.best[0].design, rng, "next")
        repeat = carried_out(batch, replace(study.present), rng, "again")
        after = diagnosed(batch, records_of(batch) + advised)
        again = diagnosed(batch, records_of(batch) + repeat)
    except InputError as error:
        return {"index": index, "tier": batch.truth["tier"], "hidden": hidden, "error": str(error)}
    return {
        "index": index,
        "tier": batch.truth["tier"],
        "hidden": hidden,
        "promised": plan.best[0].probability,
        "promised_again": plan.repeat.probability,
        "after": outcome(batch, after),
        "again": outcome(batch, again),
        "seconds": seconds,
    }


def left_open(folder: Path) -> Iterator[tuple[int, int, str | None]]:
    """Yield the batches of a folder, drawn without a tier, of which a recorded verdict lists the truth among others."""
    for item in read_outcomes(folder):
        if item.is_listed and item.hidden and item.outcome in ("listed", "mechanism"):
            truth = json.loads((folder / item.folder / "truth.json").read_text(encoding="utf-8"))
            if truth["quantity"] == "displacement" and not truth["band"]:
                yield truth["seed"], truth["index"], None


def drawn(seed: int, tiers: list[str]) -> Iterator[tuple[int, int, str]]:
    """Yield batches to look at, one tier after the other."""
    index = 0
    while True:
        yield seed, index, tiers[index % len(tiers)]
        index += 1


def table(rows: list[dict[str, Any]]) -> str:
    """Return what the rows say together."""
    done = [row for row in rows if row.get("after")]
    if not done:
        return f"None of {len(rows)} ambiguous batches was asked again."
    lines = [
        "| test | promised | decided | 95 % interval | of these wrong | Brier score |",
        "|---|---|---|---|---|---|",
    ]
    by_promise = ["| test | promised | tests | promised, mean | decided |", "|---|---|---|---|---|"]
    for name, promise, key in (("advised", "promised", "after"), ("the same again", "promised_again", "again")):
        decided = np.array([row[key] in ("right", "wrong") for row in done], float)
        promised = np.array([row[promise] for row in done], float)
        wrong = sum(row[key] == "wrong" for row in done)
        low, high = wilson_interval(int(decided.sum()), decided.size)
        lines.append(
            f"| {name} | {promised.mean():.1%} | {decided.mean():.1%} ({decided.sum():.0f} of {decided.size}) | "
            f"{low:.0%} to {high:.0%} | {wrong} | {np.mean((promised - decided) ** 2):.3f} |"
        )
        for low, high in pairwise(PROMISES):
            here = (promised >= low) & (promised <= high if high == PROMISES[-1] else promised < high)
            mean = f"{promised[here].mean():.0%}" if here.any() else ""
            between = f"{low:.0%} to {high:.0%}"
            by_promise.append(f"| {name} | {between} | {here.sum()} | {mean} | {decided[here].sum():.0f} |")
    none = sum(row.get("promised", 0) is None for row in rows)
    failed = sum("error" in row for row in rows)
    seconds = [row["seconds"] for row in rows if "seconds" in row]
    lines.append("")
    lines.append(
        f"{len(rows)} ambiguous batches; for {none} no test is better than the same again; {failed} could not be "
        f"carried out; a plan takes {np.median(seconds) if seconds else float('nan'):.0f} s (median)."
    )
    lines += ["", *by_promise]
    return "\n".join(lines)


def collected(
    judge: Callable[[Any], dict[str, Any] | None], description: str | None, batches: int
) -> tuple[list[dict[str, Any]], int]:
    """Return what came of so many drawn batches as the command line asks, and how many were looked at for them.

    Parameters
    ----------
    judge : callable
        Of a module: returns the row of a task of `drawn`, or None where the batch is none of those that are wanted.
    description : str, optional
        Of the command.
    batches : int
        That are wanted where the command line does not say.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, default=batches)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--seed", type=int)
    where.add_argument("--among", type=Path, help="folder of batches and of what was said of them")
    parser.add_argument("--tiers", nargs="+", default=list(AMBIGUOUS_TIERS))
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    looked_at = 0
    tasks = drawn(given.seed, given.tiers) if given.among is None else left_open(given.among)
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        while len(rows) < given.batches and (few := list(islice(tasks, 2 * given.workers))):
            for row in pool.map(judge, few):
                looked_at += 1
                if row is not None:
                    rows.append(row)
                    print(json.dumps(row), flush=True)
    return rows, looked_at


def recorded(paths: list[str]) -> list[dict[str, Any]]:
    """Return the rows that files of a run's output hold."""
    lines = [line for path in paths for line in Path(path).read_text(encoding="utf-8").splitlines()]
    return [json.loads(line) for line in lines if line.startswith("{")]


def main() -> None:
    """Look at batches until so many were ambiguous, or print the table of rows that are there."""
    if sys.argv[1:2] == ["--of"]:
        print(table(recorded(sys.argv[2:])))
        return
    rows, looked_at = collected(judge, __doc__, 20)
    print(f"\n{looked_at} batches were looked at.\n")
    print(table(rows))


if __name__ == "__main__":
    main()
