"""Hidden forces by symbolic regression beside the package's force curves, on the same records; prints Markdown.

    python benchmarks/hidden_effects/generate.py --batches 27 --seed 990201 --tier force_curves --out DIR
    python -m uv run --with pyoperon python benchmarks/hidden_effects/symbolic_regression.py DIR [--json FILE]

Operon (genetic programming whose constants are fitted by least squares) is no dependency of the project: `--with` puts
it beside the project for this one command, `pip install pyoperon` does where there is no uv. It is given what symbolic
regression is given elsewhere: displacement, velocity and restoring force of every sample (`force_points.py`), of all
specimens together, each without its own straight lines. Of both methods the force of displacement and velocity is
compared with the true one, the mean of the specimens', at the states that the largest release went through, all three
without their best line in displacement and velocity, which belongs to spring and viscous damper.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import laws
import numpy as np
from force_curves import EXPECTED
from force_points import Points, points_of, read_truth
from motion import simulate
from quantities import batch_of
from systems import pack
from threadpoolctl import threadpool_limits

from pymc_backbone import Oscillator
from pymc_backbone.discrepancy.force_curves.curve_bands import bands_of
from pymc_backbone.discrepancy.force_curves.families import FAMILIES
from pymc_backbone.discrepancy.force_curves.force_curve import fit_remainder

Force = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Force [N] of displacement and velocity, each (n,), up to a line in both."""
SYMBOLS = "add,sub,mul,div,constant,variable,abs,sqrtabs,square,exp,tanh"
MOST_POINTS = 4000
EVALUATIONS = 100_000
"""Of expressions, each with ten steps of least squares for its constants: some eight seconds."""
LONGEST = 25
"""Nodes of an expression: the laws have 5 to 15."""
_NONE = 0.15
"""Root mean square over that of the curve without its line, above which no family describes it."""


def true_force(specimens: list[np.ndarray], mass: float) -> Force:
    """Return the mean force of the specimens by the generator's own equation of motion."""
    slider, bed = np.zeros(3), np.zeros((7, 2))

    def one(x: float, v: float, p: np.ndarray) -> float:
        state = np.array([x, v, 0.0, 0.0, 0.0])
        return -mass * float(laws.acceleration(0.0, state, 1.0 if v >= 0.0 else -1.0, x, slider, bed, p))

    return lambda x, v: np.array([np.mean([one(a, b, p) for p in specimens]) for a, b in zip(x, v, strict=True)])


def without_line(x: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return a force without its best line in displacement and velocity, and its mean."""
    basis = np.column_stack((x / np.abs(x).max(), v / np.abs(v).max(), np.ones(x.size)))
    return force - basis @ np.linalg.lstsq(basis, force, rcond=None)[0]


def errors(found: Force, true: Force, x: np.ndarray, v: np.ndarray) -> dict[str, float]:
    """Return how far a force is off at the states visited.

    ``rms``: root mean square over that of the truth, 1 where nothing was found. ``within``: of 95 % of the states, over
    the peak of the truth; next to a jump of friction the rest may be off by all of it.
    """
    truth = without_line(x, v, true(x, v))
    off = np.abs(without_line(x, v, found(x, v)) - truth)
    return {
        "rms": float(np.sqrt(np.mean(off**2) / np.mean(truth**2))),
        "within": float(np.quantile(off, 0.95) / np.abs(truth).max()),
    }


def family_of(curve: str, at: np.ndarray, force: np.ndarray) -> str:
    """Return the family of the package's that is nearest to a curve beyond a line, or that none is near."""
    u = at / np.abs(at).max()
    line = np.column_stack((u, np.ones(u.size)))

    def left(columns: np.ndarray) -> float:
        rest = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
        return float(np.sqrt(np.mean(rest**2)))

    bend = left(line)
    best, name = _NONE * bend, "none"
    for family in FAMILIES[curve]:
        for law in family.laws:
            for number in np.linspace(family.low, family.high, 80):
                if family.is_left_out[0] < number < family.is_left_out[1]:
                    continue
                size = left(np.column_stack((line, law(u, float(number)))))
                if size < best:
                    best, name = size, family.name
    return name


def package_force(folder: Path, truth: dict[str, Any]) -> Force | None:
    """Return the sum of the package's two curves, beside a linear base."""
    batch = batch_of(folder, truth)
    found = fit_remainder(batch, Oscillator(truth["mass"], ()))
    if found is None:
        return None
    bands = bands_of(batch, found, 1)
    spring, damper = bands.conservative, bands.damping
    return lambda x, v: np.interp(x, spring.at, spring.force) + on_either_side(v, damper.at, damper.force)


def on_either_side(v: np.ndarray, at: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return a damping force between its points, straight on to rest from either side: friction jumps there."""
    result = np.empty(v.size)
    for side in (1.0, -1.0):
        own, mine = side * at > 0.0, (v >= 0.0) == (side > 0.0)
        order = np.argsort(np.abs(at[own]))
        known, values = np.abs(at[own])[order], force[own][order]
        first = values[0] - known[0] * (values[1] - values[0]) / (known[1] - known[0])
        result[mine] = np.interp(np.abs(v[mine]), np.append(0.0, known), np.append(first, values))
    return result


def symbolic_force(points: list[Points], evaluations: int, seed: int) -> tuple[Force, str]:
    """Return what symbolic regression makes of the points, and the expression.

    Parameters
    ----------
    points : list of Points
        Of each specimen.
    evaluations : int
        Of expressions, after which the search ends.
    seed : int

    Returns
    -------
    force : callable
    expression : str
        Of displacement ``x`` and velocity ``v``, each over its largest value.
    """
    from pyoperon.sklearn import SymbolicRegressor

    rests = [without_line(*one) for one in points]
    x, v, rest = (np.concatenate(columns) for columns in ([p.x for p in points], [p.v for p in points], rests))
    scales = np.abs(x).max(), np.abs(v).max(), rest.std()
    chosen = np.random.default_rng(seed).permutation(x.size)[:MOST_POINTS]
    inputs, target = np.column_stack((x / scales[0], v / scales[1]))[chosen], (rest / scales[2])[chosen]
    regressor = SymbolicRegressor(
        allowed_symbols=SYMBOLS,
        max_length=LONGEST,
        optimizer_iterations=10,
        population_size=500,
        generations=10000,
        max_evaluations=evaluations,
        n_threads=1,
        random_state=seed,
    )
    regressor.fit(inputs, target)

    def force(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        told = regressor.predict(np.column_stack((x / scales[0], v / scales[1])))
        return scales[2] * np.broadcast_to(np.ravel(told), x.shape)

    return force, str(regressor.get_model_string(regressor.model_, 3, ["x", "v"]))


def one(folder: Path, evaluations: int) -> dict[str, Any]:
    """Return what both methods make of one batch, on one core."""
    truth = read_truth(folder)
    law = truth["outside"]
    each = [pack({k: v for k, v in row.items() if k != "specimen"}) for row in truth["parameters"]]
    true = true_force(each, truth["mass"])
    largest = int(np.argmax(truth["release_amplitudes"]))
    duration = truth["cycles"] / truth["actual_frequency"]
    motion = simulate(each[largest], truth["release_amplitudes"][largest], np.linspace(0.0, duration, 1500)[1:])
    x, v = motion.displacement, motion.rates[0]
    row: dict[str, Any] = {"batch": folder.name, "law": law, "strength": truth["strength"][law]}
    row["peak"] = float(np.abs(without_line(x, v, true(x, v))).max()) / (truth["amplitude"] * each[0][laws.K])
    found: dict[str, Force | None] = {}
    with threadpool_limits(1):
        begin = time.process_time()
        found["package"] = package_force(folder, truth)
        middle = time.process_time()
        found["symbolic"], row["expression"] = symbolic_force(points_of(folder, truth), evaluations, truth["index"])
        row["seconds"] = {"package": middle - begin, "symbolic": time.process_time() - middle}
    axis = np.linspace(-1.0, 1.0, 160)  # none at zero, where friction jumps
    reach = {"conservative": np.abs(x).max(), "damping": np.abs(v).max()}
    for name, force in found.items():
        if force is None:
            continue
        row[name] = errors(force, true, x, v)
        if law in EXPECTED:
            curve = EXPECTED[law][0]
            at = axis * reach[curve]
            still = np.full(at.size, 1e-30)

            def cut(force: Force, at: np.ndarray = at, still: np.ndarray = still, curve: str = curve) -> np.ndarray:
                return force(at, still) if curve == "conservative" else force(still, at)

            row["family"] = family_of(curve, at, cut(true))
            row[name]["family"] = family_of(curve, at, cut(force))
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table over laws."""
    lines = [
        "| law | batches | peak over elastic force | package: error, rms over rms | 95 % within, of the peak | "
        "family as the truth | symbolic: error, rms over rms | 95 % within, of the peak | family as the truth |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for law in [*dict.fromkeys(row["law"] for row in rows), "all"]:
        mine = [row for row in rows if law in (row["law"], "all")]
        cells = [law, str(len(mine)), f"{np.median([row['peak'] for row in mine]):.2g}" if law != "all" else ""]
        for name in ("package", "symbolic"):
            told = [row for row in mine if name in row]
            judged = [row for row in told if "family" in row]
            right = sum(row[name]["family"] == row["family"] for row in judged)
            values = [[row[name][kind] for row in told] for kind in ("rms", "within")]
            cells += [f"{100.0 * np.median(each):.1f} %" if each else "-" for each in values]
            cells.append(f"{right} of {len(judged)}" if judged else "-")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> int:
    """Run both methods on all batches of a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help=f"of expressions (default {EVALUATIONS})")
    parser.add_argument("--json", type=Path, help="a file for what came of each batch")
    options = parser.parse_args()
    if find_spec("pyoperon") is None:
        print("Skipped: pyoperon is not installed; run this with `python -m uv run --with pyoperon python ...`.")
        return 0
    rows = []
    for folder in sorted(options.folder.glob("batch_*")):
        rows.append(one(folder, options.evaluations))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(table(rows))
    spent = {name: np.median([row["seconds"][name] for row in rows]) for name in ("package", "symbolic")}
    print(f"\nProcessor time of a batch, median: package {spent['package']:.1f} s, symbolic {spent['symbolic']:.1f} s.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
