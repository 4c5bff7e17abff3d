"""Whether the search finds the minimum of what is hidden: its cost against that of a fit that starts at the truth.

    python benchmarks/hidden_effects/search_success.py --batches 20 --seed 31 [--tier NAME ...] [--workers 2]
    python benchmarks/hidden_effects/search_success.py --of DIR [MORE ...]

Batches are generated as `generate.py` does and searched as `find_missing_effect` does with ``quick``, up to the
decision. A search succeeds where its cost of the hidden set is at most `WITHIN` above that of the fit from the truth.
A set that the search left aside, because it had explained the records already or not, is fitted by it afterwards, and
counted as *left aside*; one with a variant that it fitted, and left for what it varies, which explained as much, counts
as it was fitted. Prints a table in Markdown; each batch goes to the standard error, failures with what happened.
``--of`` reads what ``diagnose.py --search`` wrote into folders of batches instead.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from batches import make_batch
from generate import write_batch
from tiers import HARD_TIERS, QUANTITY_TIERS, TIERS

WITHIN = 1.0
"""Cost above that of the fit from the truth up to which the search found the minimum."""
_NOT_NAMED = ("outside_library", "drift", "second_mode", "nothing_missing", "base_absent")
_EVERY = tuple(tier for tier in (*TIERS, *HARD_TIERS) if tier not in _NOT_NAMED)
_USUAL = (*HARD_TIERS, *QUANTITY_TIERS, "one_effect", "two_effects", "three_effects")


def judge(task: tuple[str, int, int]) -> dict[str, Any]:
    """Return what the search made of one batch."""
    from pymc_backbone import InputError, Oscillator, read_records
    from pymc_backbone.discrepancy.sets.known_sets import BUDGET
    from pymc_backbone.discrepancy.sets.question import batch_of, possible_effects
    from pymc_backbone.discrepancy.sets.search import Search
    from pymc_backbone.measurement.options import Measuring

    tier, seed, index = task
    made = make_batch(seed, index, tier)
    hidden = tuple(sorted(made.truth["hidden"]))
    said: dict[str, Any] = {"tier": tier, "seed": seed, "index": index, "hidden": hidden}
    if not hidden:
        return said | {"skipped": "nothing is hidden"}
    base = Oscillator(made.truth["mass"], made.truth["base"])
    band = tuple(made.truth["band"]) if made.truth["band"] else None
    with tempfile.TemporaryDirectory() as name:
        write_batch(made, Path(name))
        try:
            batch, _ = batch_of(base, read_records(Path(name) / "records"), Measuring(band))
        except InputError as error:
            return said | {"skipped": str(error)}
    said["kept"] = f"{len(batch.specimens)} of {len(made.records)}"
    begin, used = time.perf_counter(), time.process_time()
    search = Search(batch, base, possible_effects(base, None, batch), 3, budget=0.5 * BUDGET)
    search.run()
    said |= {"seconds": time.perf_counter() - begin, "used": time.process_time() - used}
    return said | compared(search, made.truth)


def compared(search: Any, truth: dict[str, Any]) -> dict[str, Any]:
    """Return how a finished search fits what is hidden, beside a fit that starts at the truth.

    Parameters
    ----------
    search : Search
        Of the package; a set that it left aside is fitted now.
    truth : dict
        As ``truth.json`` holds it.

    Returns
    -------
    dict
        ``cost``, ``true``, ``excess``, ``is_found`` and more; ``skipped`` with the reason where nothing is compared.
    """
    from quantities import fit_from_truth

    hidden = tuple(sorted(truth["hidden"]))
    if not hidden or truth.get("outside") or truth.get("drift") or truth.get("second_mode"):
        return {"hidden": hidden, "skipped": "nothing is hidden that the library holds, or something else acts as well"}
    batch = search.batch
    known = {**search.unneeded, **search.fits}  # a variant may have explained no more than a plain law, and left
    said: dict[str, Any] = {"hidden": hidden, "is_tried": hidden in known, "n_fits": len(search.fits)}
    said["best"] = search.best() if search.fits else None
    found = known[hidden] if hidden in known else search.fit_set(hidden)
    true = fit_from_truth(search.layout(hidden), batch, truth)
    if true is None:
        return said | {"skipped": "the truth cannot be simulated over the records"}
    cost = np.inf if found is None else found.cost
    return said | {
        "cost": cost, "true": true.cost, "excess": cost - true.cost, "size": sum(term.size for term in batch.deciding),
        "is_converged": found is not None and found.is_converged, "is_found": bool(cost <= true.cost + WITHIN),
        "lowest": min((fit.cost for fit in search.fits.values()), default=np.inf),
        "place": list(search.proposals).index(hidden) + 1
        if search.has_proposals and hidden in search.proposals else None,
    }  # fmt: skip


def read(folders: list[Path]) -> dict[str, list[dict[str, Any]]]:
    """Return by tier what ``diagnose.py --search`` wrote into folders of batches."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(item for folder in folders for item in folder.glob("batch_*/search.json")):
        said = json.loads(path.read_text())
        said |= {name: tuple(said[name] or ()) for name in ("hidden", "best") if name in said}
        rows.setdefault(said["tier"], []).append(said)
    return rows


def line(tier: str, rows: list[dict[str, Any]]) -> str:
    """Return a row of the table."""
    judged = [row for row in rows if "excess" in row]
    found = sum(row["is_found"] for row in judged)
    left = sum(not row["is_tried"] for row in judged)
    first = sum(row["best"] == row["hidden"] for row in judged)
    used = [row["used"] for row in judged] or [np.nan]
    return (
        f"| `{tier}` | {len(judged)} | {found} ({found / max(len(judged), 1):.1%}) | {left} | {first} | "
        f"{len(rows) - len(judged)} | {np.median(used):.1f} | {np.percentile(used, 95):.1f} |"
    )


def main() -> None:
    """Search many batches and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, default=20, help="of each tier")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--tier", nargs="*", choices=_EVERY, default=_USUAL)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--of", nargs="+", type=Path, help="folders that were diagnosed with --search")
    options = parser.parse_args()
    if options.of is None and options.seed is None:
        parser.error("give --seed for new batches, or --of with folders that were diagnosed")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    print("| tier | batches | found | left aside | most probable | skipped | processor s | 95 % |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    if options.of is not None:
        tiers = read(options.of)
        for tier, rows in tiers.items():
            print(line(tier, rows))
        print(line("all", [row for rows in tiers.values() for row in rows]))
        return
    every: list[dict[str, Any]] = []
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for tier in options.tier:
            tasks = [(tier, options.seed, options.first + k) for k in range(options.batches)]
            rows = []
            for said in pool.map(judge, tasks):
                rows.append(said)
                word = "skipped" if "excess" not in said else "found" if said["is_found"] else "MISSED"
                print(word, said, file=sys.stderr, flush=True)
            print(line(tier, rows), flush=True)
            every += rows
    print(line("all", every))


if __name__ == "__main__":
    main()
