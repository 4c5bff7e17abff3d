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

import laws
import numpy as np
from quantities import batch_of
from systems import pack
from threadpoolctl import threadpool_limits

from pymc_backbone import Oscillator
from pymc_backbone.discrepancy.curve_bands import bands_of
from pymc_backbone.discrepancy.curve_records import Band
from pymc_backbone.discrepancy.evidence import UNEXPLAINED, lack_of_fit
from pymc_backbone.discrepancy.families import proposals
from pymc_backbone.discrepancy.force_curve import fit_remainder, held_out_curves

EXPECTED = {
    "magnetic_attraction": ("conservative", "none"),
    "impact_stop": ("conservative", "kink on one side"),
    "root_damping": ("damping", "power law"),
    "limited_negative_damping": ("damping", "minimum of damping"),
    "stribeck_friction": ("damping", "minimum of damping"),
    "one_way_drag": ("damping", "power law on one side"),
}
"""The curve in which a law shows, and its family."""
EXACT = tuple(name for name in EXPECTED if name != "impact_stop")
"""Laws that are a force of displacement plus a force of speed; a stop whose damping is that of its contact is not."""
_REST = 1e-30
_HELD_OUT = 6


def force(parameters: np.ndarray, x: float, v: float) -> float:
    """Return the force of a system [N] by the generator's own equation of motion."""
    p, direction = parameters, 1.0 if v >= 0.0 else -1.0
    state = np.array([x, v, 0.0, 0.0, 0.0])
    pull = laws.acceleration(0.0, state, direction, x, np.zeros(3), np.zeros((7, 2)), p)
    return -pull * p[laws.MASS] * (1.0 + p[laws.INERTIA] * x * x)


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
    with threadpool_limits(1):
        return _one(folder)


def _one(folder: Path) -> dict[str, Any]:
    truth = json.loads((folder / "truth.json").read_text())
    batch = batch_of(folder, truth)
    law = truth["outside"]
    row: dict[str, Any] = {"batch": folder.name, "law": law, "strength": truth["strength"][law]}
    begin = time.process_time()
    found = fit_remainder(batch, Oscillator(truth["mass"], ()))
    if found is None:
        return row | {"failed": True}
    bands = bands_of(batch, found, 1)
    told = proposals(found)
    row["held_out"] = held_out_curves(batch, found, _HELD_OUT)
    row["seconds"] = time.process_time() - begin
    lack = lack_of_fit(batch, found.fit)
    count = sum(term.size for term in batch.waveform)
    row |= {"chi_square": float(found.fit.chi_square.sum()) / count, "p": lack.p_value, "settled": found.is_settled}
    row["is_noise"] = bool(lack.p_value >= UNEXPLAINED)
    each = [
        pack({name: value for name, value in specimen.items() if name != "specimen"})
        for specimen in truth["parameters"]
    ]
    x, v = bands.conservative.at, bands.damping.at

    def spring(at: float) -> float:
        return float(np.mean([force(p, at, _REST) - force(p, 0.0, _REST) - p[laws.K] * at for p in each]))

    inner = np.linspace(0.0, found.tabulated.reach, 401)
    odd = np.array([0.5 * (spring(at) - spring(-at)) for at in inner])
    conservative = np.array([spring(at) for at in x]) - x * float(inner @ odd) / float(inner @ inner)
    damping = np.array([np.mean([force(p, 0.0, at) for p in each]) for at in v])
    viscous = float(np.mean([p[laws.C] for p in each])) * v
    elastic = found.tabulated.scale
    peak = max(float(np.abs(conservative).max()), float(np.abs(damping - viscous).max()))
    row["peak"] = peak / elastic
    if law in EXACT:
        row["conservative"] = compared(bands.conservative, conservative, peak)
        row["damping"] = compared(bands.damping, damping, peak)
    elif law == "impact_stop":
        row["conservative"] = compared(bands.conservative, conservative, peak)
    if law in EXPECTED:
        curve, family = EXPECTED[law]
        best = next(item for item in told if item.curve == curve)
        chance = next(item.probability for item in told if (item.curve, item.family) == (curve, family))
        row |= {"family": best.family, "is_right": best.family == family, "probability": chance}
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table over laws."""
    lines = [
        "| law | batches | peak over elastic force | error over peak, median (worst) | bands that hold all | "
        "noise left | held-out at most 1.5 | family right |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for law in [*dict.fromkeys(row["law"] for row in rows), "all"]:
        mine = [row for row in rows if law in (row["law"], "all") and "failed" not in row]
        curves = [row[name] for row in mine for name in ("conservative", "damping") if name in row]
        errors = [max(row[n]["error"] for n in ("conservative", "damping") if n in row) for row in mine
                  if "conservative" in row]  # fmt: skip
        judged = [row for row in mine if "is_right" in row]
        cells = [
            law, str(sum(law in (row["law"], "all") for row in rows)),
            f"{np.median([row['peak'] for row in mine]):.2g}" if law != "all" else "",
            f"{np.median(errors):.3f} ({max(errors):.3f})" if errors else "-",
            f"{sum(item['holds'] for item in curves)} of {len(curves)}" if curves else "-",
            f"{sum(row['is_noise'] for row in mine)} of {len(mine)}",
            f"{sum(row['held_out'] <= 1.5 for row in mine)} of {len(mine)}",
            f"{sum(row['is_right'] for row in judged)} of {len(judged)}" if judged else "-",
        ]  # fmt: skip
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
    within = [row for row in rows if row["law"] in EXACT and "failed" not in row]
    small = sum(max(row["conservative"]["error"], row["damping"]["error"]) <= 0.02 for row in within)
    points = [row[name]["share"] for row in within for name in ("conservative", "damping")]
    print(f"\nWithin 2 % of the peak everywhere: {small} of {len(within)}. Points that the bands hold: "
          f"{100.0 * float(np.mean(points)):.1f} %. Processor time, median (largest): "
          f"{np.median([row['seconds'] for row in rows if 'seconds' in row]):.1f} s "
          f"({max(row['seconds'] for row in rows if 'seconds' in row):.1f} s).")  # fmt: skip


if __name__ == "__main__":
    main()
