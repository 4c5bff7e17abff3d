"""What a hierarchical model recovers of large populations with correlated stiffnesses, at 2, 3 and 6 levels.

    python benchmarks/hierarchical/spread.py [--specimens 200] [--levels 2 3 6] [--exact] [--out FILE]

Linear and cubic stiffness are correlated by 0.7 over a Normal population; frequency errors are 1e-4 of the value and
damping errors 1e-3. Printed: means, standard deviations and the correlation against those of the population drawn.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parents[1])]

from populations import CASE, MEAN, NAMES, OSCILLATOR, draw_population, measure  # noqa: E402
from reuse import Reusable  # noqa: E402

from pymc_backbone import simulate_backbone  # noqa: E402
from pymc_backbone.inference.hierarchical import build_hierarchical_model  # noqa: E402


def recover(specimens: int, n_levels: int, seed: int, linearised: bool, draws: int = 250, tune: int = 150):
    rng = np.random.default_rng([seed, n_levels])
    levels = np.geomspace(CASE.levels[0], CASE.levels[-1], n_levels)
    parameters = draw_population("normal", specimens, np.random.default_rng(seed), correlation=0.7)
    error = simulate_backbone(OSCILLATOR, MEAN, levels).values[:2] * np.array([[1e-4], [1e-3]])
    data = measure(parameters, np.stack([np.diag(row**2) for row in error]), rng, levels)
    begin = time.perf_counter()
    model = build_hierarchical_model(OSCILLATOR, data, CASE.prior_bounds, correlated=True, linearised=linearised)
    wanted = [f"{name}_{what}" for what in ("mean", "sd") for name in NAMES]
    compiled = Reusable(model, [*wanted, "correlation"])
    built = time.perf_counter() - begin
    middle = compiled.ravel(model.initial_point())
    posterior, diverging, steps = compiled.draw(
        lambda g: middle + 0.2 * g.standard_normal(middle.size), draws=draws, tune=tune, chains=1, seed=seed
    )
    found = np.array([posterior[name].mean() for name in wanted]).reshape(2, 3)
    mean, sd = parameters.mean(axis=0), parameters.std(axis=0, ddof=1)
    return {
        "specimens": specimens, "levels": n_levels, "linearised": linearised, "names": list(NAMES),
        "mean_off_in_sd": ((found[0] - mean) / sd).tolist(), "sd_ratio": (found[1] / sd).tolist(),
        "correlation": float(posterior["correlation"][..., 0, 2].mean()),
        "drawn_correlation": float(np.corrcoef(parameters[:, 0], parameters[:, 2])[0, 1]),
        "diverging": diverging, "steps": steps, "seconds_to_build": built,
        "seconds": time.perf_counter() - begin - built,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=200)
    parser.add_argument("--levels", type=int, nargs="*", default=[2, 3, 6])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    for n_levels in options.levels:
        line = json.dumps(recover(options.specimens, n_levels, options.seed, not options.exact))
        print(line, flush=True)
        if options.out != "-":
            with open(options.out, "a", encoding="utf-8") as file:
                file.write(line + "\n")


if __name__ == "__main__":
    main()
