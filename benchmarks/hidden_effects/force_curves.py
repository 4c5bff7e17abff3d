"""How well force curves are those of laws that no effect of the library holds; prints Markdown.

    python benchmarks/hidden_effects/generate.py --batches 27 --seed 990201 --tier force_curves --out DIR
    python benchmarks/hidden_effects/force_curves.py DIR [--workers 2] [--json FILE]

The model is linear, nothing is named, and the true laws are those of `laws.py`, the mean of the specimens'. The
conservative force is compared beyond its own line over the range over which the curve has none, the damping force as a
whole; errors are the largest over what was visited, over the largest force of the hidden law there. Laws that are no
force of displacement plus a force of speed have no true curve: of them held-out specimens are counted alone.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from quantities import batch_of
from threadpoolctl import threadpool_limits
from true_curves import TrueCurves

from pymc_backbone import InputError, Oscillator
from pymc_backbone.discrepancy.force_curves.curve_bands import bands_of
from pymc_backbone.discrepancy.force_curves.curve_laws import with_laws
from pymc_backbone.discrepancy.force_curves.families import judged
from pymc_backbone.discrepancy.force_curves.force_curve import fit_remainder, held_out_curves
from pymc_backbone.discrepancy.results.curve_records import Band
from pymc_backbone.discrepancy.weighing.evidence import UNEXPLAINED, lack_of_fit

EXPECTED = {
    "magnetic_attraction": ("conservative", "pole on one side"),
    "impact_stop": ("conservative", "kink on one side"),
    "root_damping": ("damping", "power law"),
    "limited_negative_damping": ("damping", "minimum of damping"),
    "stribeck_friction": ("damping", "minimum of damping"),
    "one_way_drag": ("damping", "power law on one side"),
}
"""The curve in which a law shows, and its family."""
STOP = "impact_stop"
EXACT = tuple(name for name in EXPECTED if name != STOP)
"""Laws that are a force of displacement plus a force of speed; a stop whose damping is that of its contact is not."""
_HELD_OUT = 6


def compared(band: Band, truth: np.ndarray, peak: float) -> dict[str, Any]:
    """Return the largest error over a peak, whether the band holds all of the truth, and the share that it holds."""
    rounding = 1e-9 * float(np.abs(truth).max() + np.abs(band.force).max())
    inside = (truth >= band.low - rounding) & (truth <= band.high + rounding)
    return {
        "error": float(np.abs(band.force - truth).max()) / peak,
        "holds": bool(inside.all()),
        "share": float(inside.mean()),
    }


def one(folder: Path) -> dict[str, Any]:
    """Return what came of one batch, on one core."""
    truth = json.loads((folder / "truth.json").read_text())
    with threadpool_limits(1):
        try:
            return _one(folder, truth)
        except InputError as error:  # specimens without an amplitude in common
            return {"batch": folder.name, "law": truth["outside"], "failed": str(error)}


def _one(folder: Path, truth: dict[str, Any]) -> dict[str, Any]:
    batch = batch_of(folder, truth)
    law = truth["outside"]
    row: dict[str, Any] = {"batch": folder.name, "law": law, "strength": truth["strength"][law]}
    begin = time.process_time()
    found = fit_remainder(batch, Oscillator(truth["mass"], ()))
    if found is None:
        return row | {"failed": "cannot be simulated"}
    told, shapes = judged(found)
    lack = lack_of_fit(batch, found.fit)
    row |= {"p": lack.p_value, "is_noise": bool(lack.p_value >= UNEXPLAINED), "settled": found.is_settled}
    both = [bands_of(batch, found, 1)] * 2
    if row["is_noise"]:
        both[1] = bands_of(batch, with_laws(found, told, shapes, both[0]), 1)
    row["held_out"] = held_out_curves(batch, found, _HELD_OUT)
    row["seconds"] = time.process_time() - begin
    count = sum(term.size for term in batch.waveform)
    row["chi_square"] = float(found.fit.chi_square.sum()) / count
    true = TrueCurves(truth["parameters"], found.tabulated.reach)
    for bands, key in zip(both, ("nodes", "laws"), strict=True):
        x, v = bands.conservative.at, bands.damping.at
        peak, elastic = true.peak(x, v), float(np.abs(true.elastic(x)).max())
        row["peak"] = peak / elastic
        curves = {}
        if law in EXACT or law == STOP:
            curves["conservative"] = compared(bands.conservative, true.conservative(x), peak)
        if law in EXACT:
            curves["damping"] = compared(bands.damping, true.damping(v), peak)
        row[key] = curves
    if law in EXPECTED:
        curve, family = EXPECTED[law]
        best = next(item for item in told if item.curve == curve)
        chance = next(item.probability for item in told if (item.curve, item.family) == (curve, family))
        row |= {"family": best.family, "is_right": best.family == family, "probability": chance}
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table over laws."""
    lines = [
        "| law | batches | peak over elastic force | error over peak, median (worst) | of elastic force, median | "
        "within 2 % of the peak | bands that hold all | nodes alone: error, median (worst) | bands | noise left | "
        "held-out at most 1.5 | family right |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for law in [*dict.fromkeys(row["law"] for row in rows), "all"]:
        mine = [row for row in rows if law in (row["law"], "all") and "failed" not in row]
        judged_ones = [row for row in mine if "is_right" in row]
        cells = [
            law, str(sum(law in (row["law"], "all") for row in rows)),
            f"{np.median([row['peak'] for row in mine]):.2g}" if law != "all" else "",
        ]  # fmt: skip
        for key in ("laws", "nodes"):
            curves = [curve for row in mine for curve in row[key].values()]
            worst = [(max(curve["error"] for curve in row[key].values()), row) for row in mine if row[key]]
            errors = [error for error, _ in worst]
            cells.append(f"{np.median(errors):.3f} ({max(errors):.3f})" if errors else "-")
            if key == "laws":
                of_elastic = [error * row["peak"] for error, row in worst]
                cells.append(f"{np.median(of_elastic):.1e}" if errors else "-")
                cells.append(f"{sum(error <= 0.02 for error in errors)} of {len(errors)}" if errors else "-")
            cells.append(f"{sum(item['holds'] for item in curves)} of {len(curves)}" if curves else "-")
        cells += [
            f"{sum(row['is_noise'] for row in mine)} of {len(mine)}",
            f"{sum(row['held_out'] <= 1.5 for row in mine)} of {len(mine)}",
            f"{sum(row['is_right'] for row in judged_ones)} of {len(judged_ones)}" if judged_ones else "-",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Fit the curves of all batches of a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path, help="a file for what came of each batch")
    options = parser.parse_args()
    folders = sorted(options.folder.glob("batch_*"))
    rows = []
    with ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(one, folders):
            rows.append(row)
            print(json.dumps(row), file=sys.stderr, flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    print(table(rows))
    exact = [row for row in rows if row["law"] in EXACT and "failed" not in row]
    for key, words in (("laws", "the curves"), ("nodes", "nodes alone")):
        errors = [max(curve["error"] for curve in row[key].values()) for row in exact]
        whole = [error * row["peak"] for error, row in zip(errors, exact, strict=True)]
        curves = [curve for row in exact for curve in row[key].values()]
        print(f"\nWithout stops, {words}: within 2 % of the law's peak everywhere {sum(e <= 0.02 for e in errors)} of "
              f"{len(errors)}, of the peak of the whole conservative force {sum(e <= 0.02 for e in whole)}; bands that "
              f"hold all {sum(c['holds'] for c in curves)} of {len(curves)}, points that they hold "
              f"{100.0 * float(np.mean([c['share'] for c in curves])):.1f} %.")  # fmt: skip
    seconds = [row["seconds"] for row in rows if "seconds" in row]
    print(f"\nProcessor time, median (largest): {np.median(seconds):.1f} s ({max(seconds):.1f} s).")


if __name__ == "__main__":
    main()
