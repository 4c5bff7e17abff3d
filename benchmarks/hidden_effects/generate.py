"""Generate batches of free-decay records in which a physical effect is hidden.

    python benchmarks/hidden_effects/generate.py --batches 60 --seed 101 --out DIR [--tier NAME] [--workers 2]
    python benchmarks/hidden_effects/generate.py --batches 60 --seed 101 --out DIR --ranges second

Batch i depends on the seed and i only. Nothing of the package under test is used.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from batches import Batch, make_batch
from second_ranges import make_second_batch
from tiers import HARD_TIERS, TIERS, TIMED


def write_batch(batch: Batch, folder: Path) -> None:
    """Write records, truth and what was measured without noise of a batch into ``folder``.

    Parameters
    ----------
    batch : Batch
    folder : Path
        Made where it is missing.
    """
    records = folder / "records"
    records.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, np.ndarray] = {}
    for number, record in enumerate(batch.records, start=1):
        name = f"specimen_{number}"
        table = np.column_stack((record.time, record.measured))
        quantity = batch.truth["quantity"]
        unit = "rad" if "pendulum_stiffness" in batch.truth["present"] else "m"
        unit += {"displacement": "", "velocity": "/s", "acceleration": "/s^2"}[quantity]
        np.savetxt(records / f"{name}.csv", table, "%.12g", ",", header=f"time,{quantity} [{unit}]", comments="")
        arrays[f"{name}_time"] = record.time
        arrays[f"{name}_{quantity}"] = record.exact
    for name in ("noise_sd", "offset", "release_amplitude", "release_time"):
        arrays[name] = np.array([getattr(record, name) for record in batch.records])
    np.savez(folder / "clean.npz", **arrays)
    truth = batch.truth | {name: arrays[name].tolist() for name in ("noise_sd", "release_time")}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def generate(index: int, seed: int, out: Path, tier: str | None = None, ranges: str = "first") -> tuple[int, int]:
    """Generate and write one batch; return the number of its records and samples."""
    batch = make_second_batch(seed, index) if ranges == "second" else make_batch(seed, index, tier)
    write_batch(batch, out / f"batch_{index:04d}")
    return len(batch.records), sum(record.time.size for record in batch.records)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, required=True, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first (default 0)")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder to write into")
    parser.add_argument("--tier", choices=sorted((*TIERS, *HARD_TIERS, TIMED)), help="all batches of this kind")
    parser.add_argument(
        "--ranges", choices=("first", "second"), default="first", help="which generator (default first)"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default 1)")
    given = parser.parse_args(arguments)
    if given.tier and given.ranges == "second":
        parser.error("the second generator has no tiers; leave --tier out.")
    indices = range(given.first, given.first + given.batches)
    work = partial(generate, seed=given.seed, out=given.out, tier=given.tier, ranges=given.ranges)
    start = time.perf_counter()
    if given.workers > 1:
        with ProcessPoolExecutor(given.workers) as pool:
            sizes = list(pool.map(work, indices, chunksize=4))
    else:
        sizes = [work(index) for index in indices]
    seconds = time.perf_counter() - start
    records, samples = (sum(column) for column in zip(*sizes, strict=True)) if sizes else (0, 0)
    print(f"{len(sizes)} batches, {records} records, {samples} samples in {seconds:.1f} s: {given.out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
