"""Does the population come back? Cases and correlated Gaussian populations, several seeds, two likelihoods.

    python benchmarks/calibration/recovery.py [--seeds 5] [--only gaussian 1 2 3 4] [--output recovery.md]

Cases 1 to 4 are those of the source paper: 200 specimens, no noise, Uniform priors. Of case 4 the parameters that data
can tell are (1 - alpha) A, beta and gamma. The Gaussian populations are of Duffing oscillators with 2, 3 and 6 levels,
linear and cubic stiffness correlated by 0.7, so that the corners of the priors hold nobody. Every posterior is sampled
by the default step; means are compared in standard deviations of the specimens drawn. Printed for each target: the
worst parameter and seed.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from pymc_backbone import Oscillator, build_model, fit_density, sample, simulate_population, summarise
from pymc_backbone.likelihood.data_consistent import fit_data_consistent
from pymc_backbone.paper.case_study import run_case

DUFFING = Oscillator(1.0, "cubic_stiffness")
CENTRE = np.array([6500.0, 1.4, 6.2e6])  # N/m, N s/m, N/m^3
SPREAD = np.array([150.0, 0.25, 1.5e5])
BOUNDS = {"linear_stiffness": (5400.0, 7700.0), "viscous_damping": (0.1, 3.0), "cubic_stiffness": (5.2e6, 7.2e6)}
CORRELATION = 0.7
DRAWS, TUNE = 5000, 2000
KINDS = ("data_consistent", "product")


def gaussian(levels: int, kind: str, seed: int):
    """Return drawn and recovered vectors, the worst R-hat and the names, of a correlated Gaussian population."""
    rng = np.random.default_rng([seed, levels])
    z = rng.standard_normal((200, 3))
    z[:, 2] = CORRELATION * z[:, 0] + np.sqrt(1.0 - CORRELATION**2) * z[:, 2]
    vectors = CENTRE + SPREAD * z
    backbones = simulate_population(DUFFING, vectors, np.geomspace(0.01, 0.1, levels))
    if kind == "product":
        density = fit_density(backbones)
    else:
        density = fit_data_consistent(DUFFING, backbones, BOUNDS, random_seed=seed)
    posterior = sample(build_model(DUFFING, density, BOUNDS), draws=DRAWS, tune=TUNE, random_seed=seed)
    names = list(DUFFING.parameter_names)
    draws = np.column_stack([np.ravel(posterior["posterior"][name]) for name in names])
    return vectors, draws, summarise(posterior, names)["r_hat"].max(), names


def case(name: str, kind: str, seed: int):
    """Return the same of one of the source paper's cases."""
    result = run_case(name, kind, draws=DRAWS, tune=TUNE, random_seed=seed)
    names = list(result.case.prior)
    columns = [result.case.data.parameter_names.index(item) for item in names]
    vectors = result.vectors[:, columns]
    draws = np.column_stack([np.ravel(result.posterior["posterior"][item]) for item in names])
    if name == "4":
        vectors, draws = (combined(names, values) for values in (vectors, draws))
        names = ["(1 - alpha) A", "bouc_wen_beta", "bouc_wen_gamma"]
    return vectors, draws, result.table["r_hat"].max(), names


def combined(names, values):
    """Return what backbones of case 4 can tell."""
    a, alpha, beta, gamma = (values[:, names.index(f"bouc_wen_{n}")] for n in ("amplitude", "alpha", "beta", "gamma"))
    return np.column_stack([(1.0 - alpha) * a, beta, gamma])


def main() -> None:
    """Run, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", nargs="+", default=["gaussian", "1", "2", "3", "4"])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    tasks = []
    for what in options.only:
        if what == "gaussian":
            tasks += [(f"Gaussian, {n} levels", lambda kind, seed, n=n: gaussian(n, kind, seed)) for n in (2, 3, 6)]
        else:
            tasks.append((f"case {what}", lambda kind, seed, what=what: case(what, kind, seed)))
    lines = [
        "| population | density | parameter | mean off, by seed [sd] | sd over drawn, by seed |",
        "|---|---|---|---|---|",
    ]
    notes = []
    for title, run in tasks:
        for kind in options.kinds:
            begin = time.perf_counter()
            off, ratio, r_hats, correlations = [], [], [], []
            for seed in range(1, options.seeds + 1):
                vectors, draws, r_hat, names = run(kind, seed)
                sd = vectors.std(axis=0)
                off.append((draws.mean(axis=0) - vectors.mean(axis=0)) / sd)
                ratio.append(draws.std(axis=0) / sd)
                correlations.append(np.corrcoef(draws.T) - np.corrcoef(vectors.T))
                r_hats.append(r_hat)
            for j, name in enumerate(names):
                cells = [f"{row[j]:+.2f}" for row in off], [f"{row[j]:.2f}" for row in ratio]
                label = (title, kind.replace("_", "-")) if j == 0 else ("", "")
                lines.append(f"| {' | '.join((*label, name, *map(', '.join, cells)))} |")
            notes.append(
                f"- {title}, {kind.replace('_', '-')}: mean off at most {np.abs(off).max():.3f} sd, sd off at most "
                f"{100 * np.abs(np.array(ratio) - 1).max():.1f} %, correlations off at most "
                f"{np.abs(correlations).max():.3f}; R-hat at most {max(r_hats):.4f}; "
                f"{(time.perf_counter() - begin) / options.seeds:.0f} s a run."
            )
            print(notes[-1], flush=True)
    text = "\n".join([*lines, "", *notes]) + "\n"
    if options.output is None:
        print(text)
    else:
        options.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
