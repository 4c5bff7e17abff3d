"""How often 95 % intervals of a population's mean and sd hold the truth, over many draws of nine noisy specimens.

    python benchmarks/hierarchical/calibrate.py POPULATION FIT [--repeats 60] [--specimens 9] [--seed 1] [--out FILE]

POPULATION is normal or uniform; FIT is normal, uniform, or pooled (one parameter vector for all: the control that has
to fail). Level values carry Gaussian errors with the covariance of one real extraction at 50 dB; ``--extract`` runs
records through the extraction instead. Appends one line of JSON to FILE.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parents[1])]

from populations import CASE, NAMES, OSCILLATOR, draw_population, extract, measure, template, true_moments  # noqa: E402
from reuse import Reusable  # noqa: E402

from pymc_backbone import build_model  # noqa: E402
from pymc_backbone.inference.hierarchical import build_hierarchical_model  # noqa: E402


def build(fit: str, data, linearised: bool):
    if fit == "pooled":
        return build_model(OSCILLATOR, data, CASE.prior_bounds, likelihood="pooled")
    return build_hierarchical_model(OSCILLATOR, data, CASE.prior_bounds, population=fit, linearised=linearised)


def calibrate(
    population, fit, repeats, specimens, seed, *, draws=300, tune=150, linearised=False, from_records=False, say=print
):
    """Return coverage of mean and sd (2, 3), their mean widths over the truth, and the share of divergences."""
    rng = np.random.default_rng(seed)
    covariance = template()
    truth = np.array(true_moments(population))
    wanted = list(NAMES) if fit == "pooled" else [f"{name}_{what}" for what in ("mean", "sd") for name in NAMES]
    compiled, held, width, divergences, steps = None, [], [], [], []
    begin = time.perf_counter()
    for repeat in range(repeats):
        parameters = draw_population(population, specimens, rng)
        data = extract(parameters, rng, CASE.levels) if from_records else measure(parameters, covariance, rng)
        model = build(fit, data, linearised)
        if compiled is None:
            compiled = Reusable(model, wanted)
        compiled.load(model)
        middle = compiled.ravel(model.initial_point())
        posterior, diverging, length = compiled.draw(
            lambda g, m=middle: m + 0.2 * g.standard_normal(m.size), draws=draws, tune=tune, chains=1, seed=repeat + 1
        )
        edges = np.array([np.quantile(posterior[name], [0.025, 0.975]) for name in wanted])
        aim = truth.ravel()[: len(wanted)]
        held.append((edges[:, 0] <= aim) & (aim <= edges[:, 1]))
        width.append((edges[:, 1] - edges[:, 0]) / np.tile(truth[1], 2)[: len(wanted)])
        divergences.append(diverging)
        steps.append(length)
        if say and (repeat + 1) % 10 == 0:
            say(f"{population} by {fit}: {repeat + 1} of {repeats}, {np.mean(held, axis=0)}", flush=True)
    return {
        "population": population, "fit": fit, "repeats": repeats, "specimens": specimens, "seed": seed,
        "linearised": linearised, "from_records": from_records, "names": wanted,
        "coverage": np.mean(held, axis=0).tolist(),
        "width_in_sd": np.mean(width, axis=0).tolist(), "diverging": float(np.mean(divergences)),
        "steps": float(np.mean(steps)), "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("population", choices=("normal", "uniform"))
    parser.add_argument("fit", choices=("normal", "uniform", "pooled"))
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--specimens", type=int, default=9)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--linearised", action="store_true")
    parser.add_argument("--extract", action="store_true")
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    result = calibrate(
        options.population, options.fit, options.repeats, options.specimens, options.seed,
        linearised=options.linearised, from_records=options.extract,
    )  # fmt: skip
    line = json.dumps(result)
    print(line)
    if options.out != "-":
        with open(options.out, "a", encoding="utf-8") as file:
            file.write(line + "\n")


if __name__ == "__main__":
    main()
