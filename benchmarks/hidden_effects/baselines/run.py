"""Run the baseline methods on batches of hidden-effect data and print how often each is right.

    python benchmarks/hidden_effects/baselines/run.py DIR [--workers 1] [--redo]

Writes ``DIR/batch_xxxx/baselines.json``, skipping batches that have one, and prints a table beside the package's own
``result.json`` where there is one. Needs ``pysindy``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from baselines import closed_form, sindy, stepwise  # noqa: E402
from baselines.scoring import METHODS, count, markdown  # noqa: E402
from pymc_backbone import read_records  # noqa: E402

NAME_EFFECTS = {
    "closed_form": closed_form.name_effects,
    "stepwise": stepwise.name_effects,
    "frols": sindy.name_effects_frols,
    "stlsq": sindy.name_effects_stlsq,
}


def run_batch(folder: Path) -> dict[str, object]:
    """Run all methods on one batch and write ``baselines.json``.

    Parameters
    ----------
    folder : Path
        Holds ``records/`` and ``truth.json``, of which only ``mass`` and ``base`` are used.

    Returns
    -------
    dict
        Method to the set named (None where it failed), and ``seconds`` by method; what methods share is counted with
        the first that needs it.
    """
    truth = json.loads((folder / "truth.json").read_text())
    mass, base = truth["mass"], truth["base"]
    records = read_records(folder / "records")
    result: dict[str, object] = {}
    seconds = {}
    for method in METHODS:
        start = time.perf_counter()
        try:
            result[method] = NAME_EFFECTS[method](records, mass, base)
        except Exception:
            # one failure must not end a run of hundreds of batches; it is counted as such
            print(f"{folder.name}: {method} failed", traceback.format_exc(), sep="\n", file=sys.stderr)
            result[method] = None
        seconds[method] = round(time.perf_counter() - start, 3)
    result["seconds"] = seconds
    partial = folder / "baselines.json.partial"
    partial.write_text(json.dumps(result, indent=1) + "\n")
    partial.replace(folder / "baselines.json")
    return result


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("directory", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--redo", action="store_true", help="run batches again that have been done")
    options = parser.parse_args(arguments)
    folders = sorted(path.parent for path in options.directory.glob("batch_*/truth.json"))
    todo = [folder for folder in folders if options.redo or not (folder / "baselines.json").exists()]
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
            for done in as_completed([pool.submit(run_batch, folder) for folder in todo]):
                done.result()
    else:
        for i, folder in enumerate(todo):
            run_batch(folder)
            print(f"\r{i + 1} of {len(todo)}", end="", file=sys.stderr)
        print(file=sys.stderr)
    print(markdown(count(options.directory)))


if __name__ == "__main__":
    main()
