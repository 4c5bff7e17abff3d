"""Three likelihoods of one population, and which of them gives back its spread and its correlation.

200 Duffing oscillators whose linear and cubic stiffness vary together. ``product`` multiplies a density per amplitude
(the source paper's), ``joint`` is one density across the amplitudes, ``data_consistent`` divides that by what the
priors alone predict.

Run with ``python -m uv run examples/three_likelihoods.py`` in the project's folder; a minute once compiled.
"""

import argparse
import logging

import arviz as az
import numpy as np

import pymc_backbone as pb

BOUNDS = {
    "linear_stiffness": (4500.0, 8500.0),  # N/m
    "viscous_damping": (0.1, 2.1),  # N s/m
    "cubic_stiffness": (3.5e6, 9e6),  # N/m^3
}
MEAN = np.array([6500.0, 1.1, 6.25e6])
SPREAD = np.array([290.0, 0.2, 0.4e6])
CORRELATION = np.array([[1.0, 0.0, 0.8], [0.0, 1.0, 0.0], [0.8, 0.0, 1.0]])


def main() -> None:
    """Fit each likelihood to the same backbones, and print the recovered population beside the true one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="factor on the number of draws")
    options = parser.parse_args()
    logging.disable(logging.INFO)  # the table is all that is wanted

    rng = np.random.default_rng(3)
    oscillator = pb.Oscillator(mass=1.0, effects=["cubic_stiffness"])
    population = rng.multivariate_normal(MEAN, CORRELATION * np.outer(SPREAD, SPREAD), 200)
    backbones = pb.simulate_population(oscillator, population, np.geomspace(0.01, 0.1, 6))
    densities = {
        "product": pb.fit_density(backbones, kind="product", marginal="normal"),
        "joint": pb.fit_density(backbones, kind="joint"),
        "data_consistent": pb.fit_data_consistent(oscillator, backbones, BOUNDS, random_seed=1),
    }

    true = population.std(axis=0)
    print(f"{'':<16}{'sd k1 [N/m]':>16}{'sd c [N s/m]':>16}{'sd k3 [N/m^3]':>18}{'corr(k1, k3)':>14}{'R-hat':>8}")
    row = f"{true[0]:>16.0f}{true[1]:>16.3f}{true[2]:>18.3g}{np.corrcoef(population.T)[0, 2]:>14.2f}"
    print(f"{'population':<16}{row}")
    draws = max(int(options.draws * 1000), 100)
    for kind, density in densities.items():
        model = pb.build_model(oscillator, density, BOUNDS)
        posterior = pb.sample(model, draws=draws, tune=draws, step="nutpie", random_seed=1, progressbar=False)
        drawn = np.array([np.ravel(posterior["posterior"][name]) for name in BOUNDS])
        k1, c, k3 = (f"{sd:.3g} ({sd / of:.2f} x)" for sd, of in zip(drawn.std(axis=1), true, strict=True))
        rhat = max(float(value) for value in az.rhat(posterior).values())
        print(f"{kind:<16}{k1:>16}{c:>16}{k3:>18}{np.corrcoef(drawn)[0, 2]:>14.2f}{rhat:>8.3f}")


if __name__ == "__main__":
    main()
