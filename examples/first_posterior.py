"""A first posterior: the demo records, a hardening spring, PyMC.

Run with ``python -m uv run examples/first_posterior.py`` in the project's folder.
"""

import argparse

import pymc as pm

import pymc_backbone as pb


def main() -> None:
    """Extract backbones, fit a density to the batch, and sample the parameters that explain it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="factor on the number of draws")
    draws = max(int(parser.parse_args().draws * 4000), 100)

    records = pb.read_records(pb.demo_folder())
    cycles = [pb.extract_cycles(pb.condition(record)) for record in records]
    density = pb.fit_density(pb.backbones_at_levels(cycles), kind="joint")
    oscillator = pb.Oscillator(mass=1.0, effects=["cubic_stiffness"])

    with pm.Model() as model:
        parameters = {
            "linear_stiffness": pm.Uniform("linear_stiffness", 5000.0, 9000.0),  # N/m
            "viscous_damping": pm.Uniform("viscous_damping", 0.0, 5.0),  # N s/m
            "cubic_stiffness": pm.Uniform("cubic_stiffness", 0.0, 2e7),  # N/m^3
        }
        pb.backbone_likelihood("backbones", oscillator, density, parameters)

    posterior = pb.sample(model, draws=draws, tune=draws // 2, chains=4, random_seed=1)
    print(pb.summarise(posterior).to_string())
    for sentence in pb.findings(posterior):
        print(sentence)


if __name__ == "__main__":
    main()
