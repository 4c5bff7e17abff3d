"""At which place the proposals from level values put what is hidden, and how long they take.

    python benchmarks/hidden_effects/proposals.py --batches 10 --seed 9001 [--tier NAME ...] [--out proposals.md]

Batches are generated as `generate.py` does, levels extracted as the search does, and every set of up to three effects
is ranked. What is hidden counts as *seen* in the levels where no set of fewer effects, and none of as many, comes
within `SEEN` of its chi-square: otherwise the levels alone cannot put it first, whatever ranks them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from batches import make_batch
from generate import write_batch
from tiers import HARD_TIERS, TIERS

SEEN = 9.0
"""Chi-square by which what is hidden must beat every other set of at most as many effects."""
_NOT_NAMED = ("outside_library", "drift", "second_mode")


def one(seed: int, index: int, tier: str) -> dict[str, object]:
    """Return place, chi-square and seconds of one batch."""
    from pymc_backbone import InputError, Oscillator, read_records
    from pymc_backbone.discrepancy.proposals.propose import propose
    from pymc_backbone.discrepancy.sets.question import batch_of, possible_effects
    from pymc_backbone.measurement.options import Measuring

    made = make_batch(seed, index, tier)
    with tempfile.TemporaryDirectory() as name:
        write_batch(made, Path(name))
        base = Oscillator(made.truth["mass"], made.truth["base"])
        try:
            batch, _ = batch_of(base, read_records(Path(name) / "records"), Measuring())
        except InputError as error:
            return {"refused": str(error)}
    candidates = possible_effects(base, None, batch)
    begin, used = time.perf_counter(), time.process_time()
    found = propose(batch, base, candidates, 3)
    seconds, used = time.perf_counter() - begin, time.process_time() - used
    hidden = tuple(sorted(made.truth["hidden"]))
    names = [item.names for item in found]
    place = names.index(hidden)
    others = [item.chi_square for item in found if item.names != hidden and len(item.names) <= len(hidden)]
    rival = min(others, default=np.inf)
    return {
        "hidden": hidden, "place": place + 1, "chi_square": found[place].chi_square, "seconds": seconds, "used": used,
        "is_seen": found[place].chi_square < rival - SEEN, "rival": rival, "best": names[0],
    }  # fmt: skip


def line(tier: str, rows: list[dict[str, object]]) -> str:
    """Return a row of the table."""
    places = np.array([row["place"] for row in rows])
    seen = np.array([bool(row["is_seen"]) for row in rows])
    seconds = np.array([row["seconds"] for row in rows], dtype=float)
    used = np.array([row["used"] for row in rows], dtype=float)
    shares = [f"{np.mean(places <= k):.2f}" for k in (5, 10, 20)]
    of_seen = f"{np.mean(places[seen] <= 10):.2f} of {seen.sum()}" if seen.any() else "-"
    times = [f"{np.median(seconds):.1f}", f"{np.percentile(seconds, 95):.1f}", f"{np.median(used):.1f}"]
    return f"| `{tier}` | {len(rows)} | {' | '.join(shares)} | {of_seen} | {' | '.join(times)} |"


def main() -> None:
    """Rank the sets of many batches and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, default=10, help="of each tier")
    parser.add_argument("--seed", type=int, default=9001)
    every = [tier for tier in (*TIERS, *HARD_TIERS) if tier not in _NOT_NAMED]
    parser.add_argument("--tier", nargs="*", choices=every, default=every)
    options = parser.parse_args()
    print("| tier | batches | first 5 | first 10 | first 20 | first 10, where seen | median s | 95 % s | processor s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for tier in options.tier:
        rows = []
        for index in range(options.batches):
            row = one(options.seed, index, tier)
            if "refused" in row:
                print(f"{tier} {index}: {row['refused']}", file=sys.stderr)
                continue
            rows.append(row)
            if int(row["place"]) > 10:  # type: ignore[call-overload]
                print(f"{tier} {index}: {row}", file=sys.stderr)
        if rows:
            print(line(tier, rows), flush=True)


if __name__ == "__main__":
    main()
