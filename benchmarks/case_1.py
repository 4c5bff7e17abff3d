"""Case 1 of the source paper: 200 Duffing specimens, product of densities, PyMC's Metropolis.

    python benchmarks/case_1.py [--specimens 200] [--draws 5000] [--tune 1000] [--seed 1]

m x'' + c1 x' + k1 x + k2 x^3 = 0 with k1, k2, c1 uniform (mean, sd): 6500 +- 288.68 N/m, 6.25 +- 0.14 MN/m^3,
1.1 +- 0.52 N s/m; Uniform priors 6550 +- 664.56, 6.2 +- 0.46, 1.55 +- 0.85. A Uniform of mean mu and standard
deviation s spans mu +- sqrt(3) s. The paper gives no mass; 1 kg puts the system at 12.8 Hz. Levels reach 0.1 m,
where k2 x^2 exceeds k1: below, the backbones do not see k2. Reference: arXiv 2410.11902, Table 1.
"""

from __future__ import annotations

import argparse
import time

import arviz as az
import numpy as np

from pymc_backbone import Oscillator, build_model, fit_density, sample, simulate_population

NAMES = ("linear_stiffness", "viscous_damping", "cubic_stiffness")
TRUE = {"linear_stiffness": (6500.0, 288.68), "viscous_damping": (1.1, 0.52), "cubic_stiffness": (6.25e6, 0.14e6)}
PRIOR = {"linear_stiffness": (6550.0, 664.56), "viscous_damping": (1.55, 0.85), "cubic_stiffness": (6.2e6, 0.46e6)}
PUBLISHED = {"linear_stiffness": (6507.74, 245.15), "viscous_damping": (1.10, 0.5), "cubic_stiffness": (6.25e6, 0.14e6)}
LEVELS = np.geomspace(0.01, 0.1, 6)


def bounds(mean: float, sd: float) -> tuple[float, float]:
    return mean - np.sqrt(3.0) * sd, mean + np.sqrt(3.0) * sd


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=200)
    parser.add_argument("--draws", type=int, default=5000)
    parser.add_argument("--tune", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    oscillator = Oscillator(1.0, ["cubic_stiffness"])
    drawn = np.column_stack([rng.uniform(*bounds(*TRUE[name]), options.specimens) for name in NAMES])
    backbones = simulate_population(oscillator, drawn, LEVELS, observables=("frequency", "damping"))
    density = fit_density(backbones, kind="product", marginal="best")
    model = build_model(oscillator, density, {name: bounds(*PRIOR[name]) for name in NAMES})
    begin = time.perf_counter()
    posterior = sample(model, draws=options.draws, tune=options.tune, chains=4, random_seed=options.seed)
    seconds = time.perf_counter() - begin
    summary = az.summary(posterior, ci_prob=0.95, ci_kind="hdi", round_to="none")
    print(f"{'parameter':<18}{'true mean, sd':>24}{'published':>24}{'drawn':>24}{'ours':>24}  R-hat   ESS   off/sd")
    for j, name in enumerate(NAMES):
        mean, sd = float(summary.loc[name, "mean"]), float(summary.loc[name, "sd"])
        pairs = (TRUE[name], PUBLISHED[name], (drawn[:, j].mean(), drawn[:, j].std()), (mean, sd))
        text = "".join(f"{f'{a:.6g}, {b:.4g}':>24}" for a, b in pairs)
        off = (mean - TRUE[name][0]) / TRUE[name][1]
        print(f"{name:<18}{text}  {summary.loc[name, 'r_hat']:.4f} {summary.loc[name, 'ess_bulk']:6.0f} {off:+.3f}")
    accepted = (
        float(posterior["sample_stats"]["accepted"].mean()) if "accepted" in posterior["sample_stats"] else np.nan
    )
    families = sorted({row["family"] for row in density.summary()})
    print(f"acceptance {accepted:.2f} (published 0.33); densities: {', '.join(families)}; {seconds:.0f} s")


if __name__ == "__main__":
    main()
