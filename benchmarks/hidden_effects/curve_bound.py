"""How well the force curves of hidden laws can be known at best, by Cramer and Rao's bound; prints Markdown.

    python benchmarks/hidden_effects/generate.py --batches 150 --seed 1660201 --tier force_curves --out DIR
    python benchmarks/hidden_effects/curve_bound.py DIR [--json FILE]

The information of the samples is that of the package's own sensitivities at the true curves, with the noise of the
records. Each specimen has its own stiffness, damping, release, offset and size of the law (known to 5 % beforehand);
what is shared is, in turn, the numbers of the law, as if its formula were known, and the forces at the nodes of the
curves, as if nothing were. Errors drawn from either covariance are the largest over what was visited, over the largest
force of the hidden law there, as in `force_curves.py`: no unbiased estimate has smaller ones.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from force_curves import EXACT
from quantities import batch_of
from systems import OUTSIDE
from threadpoolctl import threadpool_limits
from true_curves import TrueCurves

from pymc_backbone import InputError, Oscillator
from pymc_backbone.discrepancy.fitting.batch import Batch
from pymc_backbone.discrepancy.fitting.normal_equations import NUISANCES, State, System, linearise
from pymc_backbone.discrepancy.force_curves.tabulated import DAMPING, NODES, STIFFNESS, Tabulated, tabulate

_STEP = 1e-4  # relative, of differences
_DRAWS = 2000
_POINTS = 41
_OWN = 5
_AMONG, _LEAST_REACH = 3, 0.3  # as the package chooses over which displacements no line is left


def node_forces(tabulated: Tabulated, true: TrueCurves) -> np.ndarray:
    """Return the shared coordinates of the true curves, no line in them."""
    eta = np.zeros(tabulated.layout.free.size)
    ends = dict(zip((STIFFNESS, DAMPING), tabulated.ranges(), strict=True))
    for effect, law in (
        (STIFFNESS, true.conservative),
        (DAMPING, lambda v: true.damping(v) - true.viscous() * v),
    ):
        at = NODES[effect] * ends[effect]
        tiny = np.where(at == 0.0, 1e-12 * ends[effect], at)
        above, below = law(tiny), law(-tiny)
        for part in tabulated.parts:
            if part.effect == effect:
                values = 0.5 * (above - below) if part.side == "odd" else 0.5 * (above + below)
                eta[part.places] = values[-part.places.size :]
    return without_line(tabulated, eta)


def without_line(tabulated: Tabulated, eta: np.ndarray) -> np.ndarray:
    """Return shared coordinates without the lines that are the specimens' own."""
    for effect, row in zip((STIFFNESS, DAMPING), tabulated.lines(), strict=True):
        line = np.zeros(eta.size)
        odd = next(part for part in tabulated.parts if (part.effect, part.side) == (effect, "odd"))
        line[odd.places] = NODES[effect][-odd.places.size :]
        eta = eta - line * float(row @ eta) / float(row @ line)
    return eta


def directions_of_law(tabulated: Tabulated, truth: dict[str, Any], reach: float) -> np.ndarray:
    """Return what each number of the law does to the shared coordinates (q, n)."""
    columns = []
    for name in OUTSIDE[truth["outside"]]:
        two = []
        for sign in (1.0, -1.0):
            moved = [{**each, name: each[name] * (1.0 + sign * _STEP)} for each in truth["parameters"]]
            two.append(node_forces(tabulated, TrueCurves(moved, reach)))
        columns.append((two[0] - two[1]) / (2.0 * _STEP))
    return np.array(columns).T


def true_state(batch: Batch, tabulated: Tabulated, truth: dict[str, Any], true: TrueCurves) -> State:
    """Return the point at which the curves are the true ones, each specimen with a size of its own."""
    eta = node_forces(tabulated, true)
    own = np.zeros((len(batch.specimens), NUISANCES + eta.size))
    by_name = {row["specimen"]: i for i, row in enumerate(truth["parameters"])}
    for r, name in enumerate(batch.specimens):
        i = by_name[name]
        row = truth["parameters"][i]
        mine = TrueCurves([row], tabulated.reach)
        own[r, :_OWN] = (
            row["linear_stiffness"] + mine.line(), row["viscous_damping"] + damping_line(tabulated, mine),
            truth["release_amplitudes"][i], truth["release_time"][i], 0.0,  # what the sensor adds is taken out before
        )  # fmt: skip
        size = float(node_forces(tabulated, mine) @ eta) / float(eta @ eta)
        own[r, NUISANCES:] = (size - 1.0) / tabulated.layout.scatter
    return State(eta, own)


def damping_line(tabulated: Tabulated, true: TrueCurves) -> float:
    """Return the damping of the line through the odd part of the law [N s/m]."""
    part = next(part for part in tabulated.parts if (part.effect, part.side) == (DAMPING, "odd"))
    row = tabulated.lines()[1][part.places]
    at = NODES[DAMPING] * tabulated.ranges()[1]
    tiny = np.where(at == 0.0, 1e-12 * at[-1], at)
    odd = 0.5 * (true.damping(tiny) - true.damping(-tiny)) - true.viscous() * tiny
    return float(row @ odd) / float(row @ at)


def covariance(system: System, state: State, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of what is free and the rows of the mean specimen's damping and shared coordinates."""
    count, (q, m) = len(state.own), shared.shape
    size = m + count * (_OWN + 1)
    full, mean = np.zeros((size, size)), np.zeros((1 + q, size))
    full[:m, :m] = shared.T @ system.shared @ shared
    mean[1:, :m] = shared
    for r in range(count):
        own = np.zeros((NUISANCES + q, _OWN + 1))
        own[:_OWN, :_OWN] = np.eye(_OWN)
        own[NUISANCES:, _OWN] = 1.0  # one size of all that is no line
        place = slice(m + r * (_OWN + 1), m + (r + 1) * (_OWN + 1))
        mine = system.own[r].copy()
        mine[range(5, mine.shape[0]), range(5, mine.shape[0])] -= 1.0  # of these the size alone has a prior
        full[place, place] = own.T @ mine @ own
        full[place.stop - 1, place.stop - 1] += 1.0
        full[:m, place] = shared.T @ system.mixed[r] @ own
        full[place, :m] = full[:m, place].T
        mean[0, place.start + 1] = 1.0 / count
    scale = 1.0 / np.sqrt(np.maximum(np.diag(full), 1e-300))
    values, vectors = np.linalg.eigh(full * np.outer(scale, scale))
    root = vectors * np.where(values > 1e-13 * values[-1], 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
    root = scale[:, None] * root
    return root @ root.T, mean


def bound(folder: Path) -> dict[str, Any] | None:
    """Return what the samples of one batch allow; None of a law that is no force of displacement and of speed."""
    truth = json.loads((folder / "truth.json").read_text())
    if truth["outside"] not in EXACT:
        return None
    batch = batch_of(folder, truth)
    lowest = min(float(np.abs(term.values[-_AMONG:]).max()) for term in batch.turning)
    tabulated = tabulate(Oscillator(truth["mass"], ()), batch, max(lowest, _LEAST_REACH * batch.amplitude))
    true = TrueCurves(truth["parameters"], tabulated.reach)
    state = true_state(batch, tabulated, truth, true)
    active = np.zeros(state.own.shape[1], dtype=bool)
    active[:_OWN] = active[NUISANCES:] = True
    system = linearise(tabulated.layout, batch.waveform, state, tabulated.layout.scatter, active)
    if system is None:
        return None
    ends = max(truth["release_amplitudes"])
    x = np.linspace(-ends, ends, 2 * _POINTS - 1)
    v = x * 2.0 * np.pi * truth["actual_frequency"]
    rows = np.zeros((x.size + v.size, 1 + state.eta.size))
    rows[: x.size, 1:] = tabulated.forces(STIFFNESS, x)
    rows[x.size :, 1:] = tabulated.forces(DAMPING, v)
    rows[x.size :, 0] = v
    peak, elastic = true.peak(x, v), float(np.abs(true.elastic(x)).max())
    rng = np.random.default_rng(1)
    count = sum(term.size for term in batch.waveform)
    said: dict[str, Any] = {
        "batch": folder.name, "hidden": truth["outside"], "peak": peak / elastic,
        "chi_square": float(system.chi_square.sum()) / count,
    }  # fmt: skip
    for name, shared in (
        ("law", directions_of_law(tabulated, truth, tabulated.reach)),
        ("nodes", tabulated.free_basis()[0]),
    ):
        inner, mean = covariance(system, state, shared)
        values, vectors = np.linalg.eigh(rows @ mean @ inner @ mean.T @ rows.T)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        worst = np.abs(rng.standard_normal((_DRAWS, values.size)) @ root.T).max(axis=1) / peak
        said[name] = {"median": float(np.median(worst)), "chance": float((worst <= 0.02).mean())}
    return said


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table over laws."""
    lines = [
        "| law | batches | peak over elastic force | formula known: error over peak, median | of elastic force | "
        "share within 2 % | nodes alone: error over peak, median | share within 2 % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for law in [*dict.fromkeys(row["hidden"] for row in rows), "all"]:
        mine = [row for row in rows if law in (row["hidden"], "all")]
        cells = [law, str(len(mine)), f"{np.median([row['peak'] for row in mine]):.2g}"]
        for name in ("law", "nodes"):
            cells.append(f"{np.median([row[name]['median'] for row in mine]):.3f}")
            if name == "law":
                cells.append(f"{np.median([row[name]['median'] * row['peak'] for row in mine]):.1e}")
            cells.append(f"{100.0 * np.mean([row[name]['chance'] for row in mine]):.0f} %")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Print what the samples of all batches of a folder allow."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path, help="a file for what came of each batch")
    options = parser.parse_args()
    rows = []
    with threadpool_limits(1):
        for folder in sorted(options.folder.glob("batch_*")):
            try:
                said = bound(folder)
            except InputError:  # specimens without an amplitude in common
                continue
            if said is not None:
                rows.append(said)
                print(json.dumps(said), file=sys.stderr, flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
