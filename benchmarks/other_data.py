"""What a further structure costs: a model of its own, or its data in the model that is compiled.

    python benchmarks/other_data.py [--structures 4]

Prints, for a pooled model of three specimens sampled with 4 x (200 + 200) draws, processor seconds and memory that each
further structure takes, both ways, the first left out.
"""

from __future__ import annotations

import argparse
import gc
import logging
import resource
import time

import numpy as np
import xarray as xr

import pymc_backbone as pb

LEVELS = np.geomspace(0.005, 0.03, 4)
OSCILLATOR = pb.Oscillator(1.0, "cubic_stiffness")
BOUNDS = {"linear_stiffness": (5000.0, 8000.0), "viscous_damping": (0.1, 3.0), "cubic_stiffness": (4e6, 8e6)}
DRAWS = {"draws": 200, "tune": 200, "chains": 4, "random_seed": 1, "progressbar": False}


def structure(number: int) -> xr.Dataset:
    """Return backbones of three tests of one structure."""
    generator = np.random.default_rng(number)
    truth = np.array([6500.0, 1.1, 6.25e6]) * (1.0 + 0.02 * generator.standard_normal(3))
    data = pb.simulate_population(OSCILLATOR, np.array([truth] * 3), LEVELS).drop_vars("covariance")
    values = np.array(data["value"])
    errors = values * np.array([2e-3, 3e-2])[:, None]
    dims = data["value"].dims
    noise = errors * generator.standard_normal(values.shape)
    return data.assign(value=(dims, values + noise), standard_error=(dims, errors))


def measured(sample_one, count: int) -> tuple[float, float]:
    """Return processor seconds and megabytes of each structure but the first."""
    sample_one(0)
    gc.collect()
    begin, held = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number in range(1, count):
        sample_one(number)
    gc.collect()
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held
    return (time.process_time() - begin) / (count - 1), grown / 1024.0 / (count - 1)


def main() -> None:
    """Measure both ways and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--structures", type=int, default=4)
    count = parser.parse_args().structures
    logging.disable(logging.INFO)
    model = pb.build_model(OSCILLATOR, structure(0), BOUNDS, likelihood="pooled")

    def replaced(number: int) -> None:
        pb.set_backbones(structure(number), model=model)
        pb.sample(model, **DRAWS)

    def built(number: int) -> None:
        pb.sample(pb.build_model(OSCILLATOR, structure(number), BOUNDS, likelihood="pooled"), **DRAWS)

    ways = {"other data in one model": measured(replaced, count), "a model for each": measured(built, count)}
    for name, (seconds, megabytes) in ways.items():
        print(f"{name:24s} {seconds:6.2f} s of processor time, {megabytes:6.1f} MB a structure")
    (one, _), (other, _) = ways.values()
    print(f"ratio {other / one:.2f}")


if __name__ == "__main__":
    main()
