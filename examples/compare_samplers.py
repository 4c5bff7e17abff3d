"""Which sampler for my posterior? Effective samples a second, and whether the samplers agree.

Run with ``python -m uv run examples/compare_samplers.py`` in the project's folder; under a minute once compiled. The
whole comparison, with a reference, evidence and samplers from outside, is in ``benchmarks/samplers``.
"""

import argparse
import logging

import arviz as az
import numpy as np

import pymc_backbone as pb

# Step, and draws that take about the same number of simulations: gradients and slices take many for each draw.
STEPS = {"metropolis": 2400, "elementwise": 800, "demetropolisz": 2400, "slice": 150, "nutpie": 300}


def main() -> None:
    """Sample one posterior with several steps, and print what each effective sample costs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="factor on all numbers of draws")
    options = parser.parse_args()
    logging.disable(logging.INFO)  # the table is all that is wanted

    rng = np.random.default_rng(1)
    oscillator = pb.Oscillator(mass=1.0, effects=["cubic_stiffness"])
    centre = np.array([6500.0, 1.1, 6.25e6])  # N/m, N s/m, N/m^3
    population = centre * (1.0 + [0.04, 0.15, 0.05] * rng.standard_normal((200, 3)))
    backbones = pb.simulate_population(oscillator, population, np.geomspace(0.01, 0.1, 6))
    bounds = {
        "linear_stiffness": (4500.0, 8500.0),
        "viscous_damping": (0.1, 2.1),
        "cubic_stiffness": (4e6, 8.5e6),
    }
    model = pb.build_model(oscillator, pb.fit_density(backbones, kind="product"), bounds)

    print(f"{'step':<14}{'s':>7}{'simulated':>11}{'gradients':>11}{'ESS':>7}{'ESS/s':>8}{'R-hat':>8}   mean stiffness")
    for step, count in STEPS.items():
        draws = max(int(options.draws * count), 50)
        posterior = pb.sample(model, draws=draws, tune=draws // 2, step=step, random_seed=1, progressbar=False)
        seconds = posterior["posterior"].attrs["sampling_time"]  # compilation and the search for starts left out
        ess, rhat = az.ess(posterior), az.rhat(posterior)
        worst = min(float(ess[name]) for name in bounds)
        stiffness = posterior["posterior"]["linear_stiffness"]
        error = float(az.mcse(posterior)["linear_stiffness"])
        print(
            f"{step:<14}{seconds:>7.1f}{posterior.attrs['simulations']:>11}{posterior.attrs['gradients']:>11}"
            f"{worst:>7.0f}{worst / seconds:>8.0f}{max(float(rhat[name]) for name in bounds):>8.3f}"
            f"   {float(stiffness.mean()):.0f} +- {error:.0f} N/m"
        )


if __name__ == "__main__":
    main()
