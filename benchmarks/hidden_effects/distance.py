"""How far each batch is from its nearest wrong explanation, in standard deviations of its noise.

The noise-free waveforms are fitted with wrong explanations: one hidden effect less, or another effect of the library in
the place of one. The smallest sum of squares over the noise is the squared distance. The fits use the package's
own simulator and least squares, each also from the fit of the truth; a fit that ends in a local minimum makes a
distance too large. The fit of the truth itself is written beside it: it is near zero where simulator and generator
agree.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from pymc_backbone import InputError, Oscillator, Record, condition, extract_cycles
from pymc_backbone.discrepancy.fitting.batch import Batch, batch_of_records
from pymc_backbone.discrepancy.fitting.starts import embedded
from pymc_backbone.discrepancy.sets.question import possible_effects
from pymc_backbone.discrepancy.sets.search import Search
from pymc_backbone.measurement.batch_levels import levels_for
from pymc_backbone.measurement.levels import backbones_at_levels


def clean_batch(folder: Path) -> tuple[Batch, dict]:
    """Return the batch of the noise-free waveforms, judged by the noise that was added."""
    truth = json.loads((folder / "truth.json").read_text())
    held = np.load(folder / "clean.npz")
    unit = "rad" if "pendulum_stiffness" in truth["present"] else "m"
    records, cycles = [], []
    for k, row in enumerate(truth["parameters"]):
        name = row["specimen"]
        noise = float(held["noise_sd"][k])
        time, values = held[f"{name}_time"], held[f"{name}_displacement"]
        generator = np.random.default_rng(k)
        try:
            noisy = condition(Record(name, time, values + noise * generator.standard_normal(values.size), unit=unit))
            extracted = extract_cycles(noisy)
        except InputError:
            continue
        index = np.searchsorted(time, noisy.time - 1e-9 * time[-1])
        clean = values[np.minimum(index, time.size - 1)]
        record = _replaced(noisy, clean, noise)
        records.append(record)
        cycles.append(extracted)
    if not records:
        raise InputError("no record of this batch can be used")
    backbones = backbones_at_levels(cycles, levels_for(cycles)[0], ["frequency", "damping"], amplitude_unit=unit)
    return batch_of_records(truth["mass"], backbones, records, cycles), truth


def _replaced(record, values, noise):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    return replace(record, displacement=values, noise=noise, noise_autocovariance=np.array([noise**2, 0.0]))


def distance(folder: Path) -> dict:
    """Return distance and nearest wrong explanation of one batch."""
    batch, truth = clean_batch(folder)
    hidden = tuple(sorted(truth["hidden"]))
    oscillator = Oscillator(truth["mass"], truth["base"])
    candidates = possible_effects(oscillator, None, batch)
    if not hidden:
        return {"distance": None, "nearest": [], "truth": None}
    truly = Search(batch, oscillator, candidates)
    truly.fit_set(())
    own = truly.fit_set(hidden)
    wrong = {()}
    for out in hidden:
        rest = tuple(name for name in hidden if name != out)
        wrong |= {rest, *(tuple(sorted((*rest, name))) for name in candidates if name not in hidden)}
    # apart from the fit of the truth: a fit is given up where another is far ahead, and the nearest wrong one counts
    search = Search(batch, oscillator, candidates)
    for names in sorted(wrong, key=lambda names: (len(names), names)):  # what is fitted first is a rival to others
        search.fit_set(names)
        if own is not None:
            layout = search.layout(names)
            lowest = min((item.cost for item in search.fits.values()), default=None)
            found = search.descent.from_near(layout, [embedded(layout, own)[0]], rival=lowest)
            if found is not None and (names not in search.fits or found.cost < search.fits[names].cost):
                search.fits[names] = found
    costs = {names: found.cost for names, found in search.fits.items()}
    if not costs:
        return {"distance": None, "nearest": [], "truth": None}
    nearest = min(costs, key=lambda names: costs[names])
    least = own.cost if own is not None else 0.0
    return {
        "distance": float(np.sqrt(max(costs[nearest] - least, 0.0))),
        "nearest": list(nearest),
        "truth": float(np.sqrt(least)),
    }


def _one(folder: Path) -> str:
    target = folder / "distance.json"
    if not target.exists():
        try:
            found = distance(folder)
        except Exception as error:  # one batch that cannot be judged does not end the run
            found = {"distance": None, "nearest": [], "truth": None, "error": str(error)}
        target.write_text(json.dumps(found, indent=1) + "\n")
    return folder.name


def main() -> None:
    """Write ``distance.json`` of every batch that has a hidden effect of the library."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    folders = []
    for folder in sorted(options.folder.glob("batch_*")):
        truth = json.loads((folder / "truth.json").read_text())
        if truth["hidden"] and not truth["outside"]:
            folders.append(folder)
    with ProcessPoolExecutor(options.workers) as pool:
        for k, name in enumerate(pool.map(_one, folders)):
            print(f"{k + 1}/{len(folders)} {name}", file=sys.stderr, flush=True)
    told = [json.loads((folder / "distance.json").read_text()) for folder in folders]
    failed = [found["error"] for found in told if "error" in found]
    if failed:
        print(f"{len(failed)} of {len(folders)} batches could not be judged, the first: {failed[0]}", file=sys.stderr)


if __name__ == "__main__":
    main()
