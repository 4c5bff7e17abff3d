"""How well a motion is told from displacement, velocity, acceleration and behind a band-pass; prints Markdown.

    python benchmarks/hidden_effects/generate.py --batches 13 --seed 41 --tier acceleration --out DIR/acceleration
    python benchmarks/hidden_effects/quantities.py DIR [--tiers acceleration velocity] [--rank] [--diagnose]

DIR holds a folder for each of the tiers `displacement`, `velocity`, `acceleration`, `band_passed` and
`band_passed_acceleration`, whose batches hide the same motions. For each batch the hidden effect is fitted from its
true parameters: the reduced chi-square says whether data and model are compared without an error of the comparison.
With ``--rank`` every other single effect is fitted as well, as the search would, and the evidence ranks them. With
``--diagnose`` the whole search runs on records alone, as a user would run it.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from tiers import QUANTITY_TIERS

from pymc_backbone import InputError, Oscillator, read_records
from pymc_backbone.discrepancy.fitting.batch import Batch, batch_of_records
from pymc_backbone.discrepancy.fitting.joint_fit import Fit, fit
from pymc_backbone.discrepancy.fitting.layout import Layout
from pymc_backbone.discrepancy.fitting.normal_equations import State, start_state
from pymc_backbone.discrepancy.sets.question import possible_effects
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.discrepancy.workflow import find_missing_effect
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.levels import backbones_at_levels, default_levels


def batch_of(folder: Path, truth: dict[str, Any]) -> Batch:
    """Return the batch of a folder as the search sees it."""
    band = tuple(truth["band"]) if truth["band"] else None
    records = [condition(record, band=band) for record in read_records(folder / "records")]
    cycles = [extract_cycles(record) for record in records]
    observables = ["frequency", "damping"]
    if all(record.offset_is_measured for record in records):
        observables.append("offset")
    backbones = backbones_at_levels(cycles, default_levels(cycles), observables, amplitude_unit=records[0].unit)
    return batch_of_records(truth["mass"], backbones, records, cycles)


def fit_from_truth(layout: Layout, batch: Batch, truth: dict[str, Any]) -> Fit | None:
    """Return the fit of the hidden set that starts at its true parameters."""
    rows = {row["specimen"]: row for row in truth["parameters"]}
    eta = layout.coordinates(np.array([truth["nominal"][name] for name in layout.names]))
    state = start_state(layout, eta, batch.own)
    own = state.own.copy()
    for r, name in enumerate(batch.specimens):
        own[r, 0], own[r, 1] = rows[name]["linear_stiffness"], rows[name]["viscous_damping"]
        mine = layout.coordinates(np.array([rows[name][key] for key in layout.names]))
        own[r, 7:] = np.where(eta != 0.0, mine / np.where(eta != 0.0, eta, 1.0) - 1.0, 0.0) / layout.scatter
    best = None
    near = fit(layout, batch.turning, State(state.eta, own), iterations=20, nuisances=batch.nuisances, tolerance=1.0)
    for start in (State(state.eta, own), near.state if near else None):
        if start is None:
            continue
        found = fit(layout, batch.waveform, start, iterations=60, nuisances=batch.nuisances)
        if found is not None and (best is None or found.cost < best.cost):
            best = found
    return best


def judge(task: tuple[Path, bool, bool]) -> dict[str, Any]:
    """Return what can be said of one batch."""
    folder, is_ranked, is_diagnosed = task
    truth = json.loads((folder / "truth.json").read_text())
    hidden = tuple(sorted(truth["hidden"]))
    begin = time.perf_counter()
    said: dict[str, Any] = {"hidden": hidden, "batch": folder.name}
    try:
        batch = batch_of(folder, truth)
        oscillator = Oscillator(truth["mass"], truth["base"])
        candidates = possible_effects(oscillator, None, batch)
        search = Search(batch, oscillator, candidates)
        layout = search.layout(hidden)
        true = fit_from_truth(layout, batch, truth)
        if true is None:
            return said | {"error": "the truth cannot be simulated"}
        sizes = [item.size - len(batch.nuisances) for item in batch.waveform]
        said["chi_square"] = float(true.chi_square.sum() / (sum(sizes) - layout.free.size))
        said["each"] = [float(value / size) for value, size in zip(true.chi_square, sizes, strict=True)]
        lack = evidence.lack_of_fit(batch, true)
        said |= {"p_value": lack.p_value, "ratio": lack.ratio}
        if is_ranked:
            search.fit_set(())
            search.fits[hidden] = true
            for name in candidates:
                if (name,) != hidden:
                    search.fit_set((name,))
            own = evidence.probabilities({**search.fits, hidden: true}, batch, len(candidates))
            ranked = sorted(own, key=lambda names: -own[names].probability)
            said |= {"first": ranked[0], "probability": own[hidden].probability, "second": ranked[1]}
        said["seconds"] = time.perf_counter() - begin
    except InputError as error:
        return said | {"error": str(error)}
    if is_diagnosed:
        begin = time.perf_counter()
        band = tuple(truth["band"]) if truth["band"] else None
        study = find_missing_effect(
            oscillator, read_records(folder / "records"), quick=True, tolerance=0.0, band=band, random_seed=1
        )
        named = tuple(sorted(study.missing_effects))
        listed = {tuple(sorted(names)) for names in study.ambiguous_sets}
        is_right = (study.verdict == "found" and named == hidden) or (study.verdict == "adequate" and not hidden)
        outcome = "right" if is_right else study.verdict
        if study.verdict == "found" and not is_right:
            outcome = "wrong"
        if study.verdict == "adequate" and hidden:
            outcome = "missed"
        if study.named_level == "mechanism":
            outcome = "mechanism"
        if hidden in listed:
            outcome = "listed"
        said |= {"outcome": outcome, "named": named, "diagnosis": time.perf_counter() - begin}
    return said


def _row(said: dict[str, Any]) -> str:
    name = " + ".join(said["hidden"]) or "nothing"
    if "error" in said:
        return f"| {name} | {said['error']} | | | | |"
    each = said["each"]
    first, probability = "-", "-"
    if "first" in said:
        first = "yes" if said["first"] == said["hidden"] else f"no: {' + '.join(said['first']) or 'nothing'}"
        probability = f"{said['probability']:.3f}"
    return (
        f"| {name} | {said['chi_square']:.3f} | {min(each):.2f} to {max(each):.2f} | {said['p_value']:.2g} | "
        f"{first} | {probability} | {said.get('outcome', '-')} |"
    )


def main() -> None:
    """Judge every batch and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tiers", nargs="+", choices=list(QUANTITY_TIERS), default=list(QUANTITY_TIERS))
    parser.add_argument("--rank", action="store_true", help="fit the other single effects as well")
    parser.add_argument("--diagnose", action="store_true", help="run the whole search as well")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # one core for each worker, which starts afresh
    head = "| hidden | chi-square of the truth | of each record | lack of fit, p | first | its probability | search |"
    for tier in options.tiers:
        folders = sorted((options.folder / tier).glob("batch_*"))
        tasks = [(folder, options.rank, options.diagnose) for folder in folders]
        rows = []
        print(f"\n## {tier}\n\n{head}\n|---|---|---|---|---|---|---|", flush=True)
        with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
            for said in pool.map(judge, tasks):
                rows.append(said)
                print(_row(said), flush=True)
                print(f"{tier} {said}", file=sys.stderr, flush=True)
        values = [said["chi_square"] for said in rows if "chi_square" in said]
        first = sum(said.get("first") == said["hidden"] for said in rows)
        print(f"\nMedian chi-square {statistics.median(values):.3f}, {min(values):.3f} to {max(values):.3f}.")
        if options.rank:
            first = sum(said.get("first") == said["hidden"] for said in rows)
            print(f"The truth ranks first in {first} of {len(rows)}.")
        if options.diagnose:
            outcomes = [said.get("outcome", "failed") for said in rows]
            counts = ", ".join(f"{outcomes.count(name)} {name}" for name in sorted(set(outcomes)))
            print(f"The search: {counts}.")


if __name__ == "__main__":
    main()
