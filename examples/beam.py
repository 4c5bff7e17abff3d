"""The beam of the source paper: where its forced response folds, its posterior, and what that owes to the prior.

A cantilever between electromagnets, reduced to m x'' + c x' + k x - k_n x^3 = 0. Nine settings of the magnets give nine
pairs (k, k_n). Run with ``python -m uv run examples/beam.py`` in the project's folder; half a minute once compiled.
"""

import argparse
import logging

import arviz as az
import numpy as np
import pymc as pm
import xarray as xr

import pymc_backbone as pb

BEAM = pb.paper.PAPER_BEAM
FORCE = 5e-5  # N; the paper gives none


def main() -> None:
    """Print the folds, the posterior, and what it owes to the prior."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="factor on the number of draws")
    options = parser.parse_args()
    logging.disable(logging.INFO)  # the tables are all that is wanted
    draws = max(int(options.draws * 4000), 100)
    settings = {"draws": draws, "tune": draws // 2, "random_seed": 1}

    print(f"Forced response at {1e6 * FORCE:.0f} uN")
    for number, (stiffness, softening) in enumerate(zip(BEAM.stiffness, BEAM.softening, strict=True), 1):
        forced = pb.ForcedOscillator(BEAM.mass, BEAM.damping, stiffness, softening, force=FORCE)
        folds = pb.frequency_response(forced, np.linspace(4.0, 9.0, 200)).fold_frequencies
        words = " and ".join(f"{fold:.2f}" for fold in folds) + " Hz" if folds.size else "none"
        print(f"  setting {number}: {stiffness:.2f} N/m, {softening / 1e9:5.2f} GN/m^3, folds: {words}")

    result = pb.paper.run_case("beam", "joint", **settings)
    print(f"\nPosterior from the {len(result.vectors)} settings, joint likelihood")
    print(result.table[["mean", "sd", "hdi_low", "hdi_high", "r_hat"]].to_string(float_format="{:.4g}".format))
    print(f"posterior is prior: {', '.join(result.undetermined) or 'for no parameter'}")

    print("\nThe same with priors shifted by a quarter of their width")
    bounds = result.case.prior_bounds
    for moved, (low, high) in bounds.items():
        shift = 0.25 * (high - low) * (1.0 if moved == "linear_stiffness" else -1.0)  # k_n stays positive
        shifted = bounds | {moved: (low + shift, high + shift)}
        model = pb.build_model(result.case.model, result.density, shifted, fixed=result.case.model_fixed)
        table = pb.summarise(pb.sample(model, **settings, progressbar=False), list(bounds))
        change = (table["mean"] - result.table["mean"]) / result.table["sd"]
        print(f"  {moved}: " + ", ".join(f"mean of {name} by {value:+.2f} sd" for name, value in change.items()))

    # A Uniform prior to any power is the same Uniform, so power-scaling needs priors with a shape. Standard normal
    # variables keep the sampler's scales near one, where the parameters are eight decades apart.
    with pm.Model():
        parameters = {
            name: pm.Deterministic(name, mean + sd * pm.Normal(f"{name}_standardised"))
            for name, (mean, sd) in result.case.prior.items()
        }
        likelihood = pb.backbone_likelihood(
            "backbones", result.case.model, result.density, parameters | result.case.model_fixed
        )
        pm.Deterministic("log_density", likelihood)
        posterior = pb.sample(**settings, progressbar=False)
        pm.stats.compute_log_prior(posterior, progressbar=False)
    # The density is a potential of the model, so PyMC does not count it as log-likelihood by itself.
    posterior["log_likelihood"] = xr.DataTree(posterior["posterior"].to_dataset()[["log_density"]])
    print("\nPower-scaling sensitivity with Normal priors of the same mean and standard deviation")
    print(az.psense_summary(posterior, var_names=list(bounds)).to_string())


if __name__ == "__main__":
    main()
