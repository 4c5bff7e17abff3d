"""Run the search for the missing effect on every batch of a folder; each gets a ``result.json``.

    python benchmarks/hidden_effects/diagnose.py DIR --workers 2 [--search]

The tool is given the records, the mass and the base effects; of a band-passed tier the band as well. ``--tolerance 0``
(the default here) lets statistics alone decide, because the strengths of the batches run down to what no record can
show. ``--search`` also fits what is hidden from its true parameters, and writes ``search.json`` beside the result:
whether the search came as low (`search_success.py --of DIR` prints the table).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # one core for each worker


def _one(task: tuple[Path, float | None, str, bool]) -> str:
    folder, tolerance, name, is_compared = task
    target = folder / name
    if target.exists():
        return folder.name
    from pymc_backbone import InputError, Oscillator, read_records
    from pymc_backbone.discrepancy import workflow
    from pymc_backbone.reporting.portable import plain
    from pymc_backbone.reporting.study_files import study_entries

    truth = json.loads((folder / "truth.json").read_text())
    begin = time.perf_counter()
    ended: list[workflow.Outcome] = []
    decided = workflow._decided

    def kept(known: object) -> workflow.Outcome:
        ended.append(decided(known))
        return ended[-1]

    workflow._decided = kept
    try:
        study = workflow.find_missing_effect(
            Oscillator(truth["mass"], truth["base"]),
            read_records(folder / "records"),
            quick=True,
            tolerance=tolerance,
            random_seed=truth["seed"] + truth["index"],
            band=tuple(truth["band"]) if truth.get("band") else None,
        )
        result = study_entries(study, "")
    except InputError as error:
        result = {"verdict": "refused", "sentence": str(error), "seconds": time.perf_counter() - begin}
    except Exception as error:  # a fault of the tool counts against it and does not end the run
        result = {"verdict": "failed", "sentence": repr(error), "seconds": time.perf_counter() - begin}
    finally:
        workflow._decided = decided
    text = json.dumps(plain(result), indent=1)
    target.with_suffix(".tmp").write_text(text + "\n")
    target.with_suffix(".tmp").replace(target)
    if is_compared and ended:
        from search_success import compared

        said = {"tier": truth["tier"], "seconds": result["seconds"], "used": result["seconds"]}
        said |= compared(ended[-1].search, truth)
        (folder / "search.json").write_text(json.dumps(plain(said), indent=1) + "\n")
    return f"{folder.name} {result['verdict']}"


def main() -> None:
    """Diagnose all batches that have no result yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--tolerance", type=float, default=0.0, help="0, or -1 for the default of the tool")
    parser.add_argument("--name", default="result.json")
    parser.add_argument(
        "--search", action="store_true", help="also fit what is hidden from the truth, where no result is yet"
    )
    options = parser.parse_args()
    tolerance = None if options.tolerance < 0.0 else options.tolerance
    folders = sorted(options.folder.glob("batch_*"))
    with ProcessPoolExecutor(options.workers) as pool:
        for k, line in enumerate(
            pool.map(_one, [(folder, tolerance, options.name, options.search) for folder in folders])
        ):
            print(f"{k + 1}/{len(folders)} {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
