"""Generate batches whose hidden sets are drawn from the package's own prior, for `sbc.py`.

    python benchmarks/hidden_effects/prior_batches.py --batches 100 --seed 5 --out DIR [--first 0]
    python benchmarks/hidden_effects/diagnose.py DIR --workers 1
    python benchmarks/hidden_effects/sbc.py DIR

Sets, bounds and scatter are the package's; the motion is the generator's. A set has the prior probability of its size,
shared evenly, and 0.03 of that for each variant in the place of what it varies; in one of twenty a law acts that the
library does not hold. Shapes are uniform within
their default bounds. The package's prior of a strength is as wide as what is found, which is the density of one that
is log-uniform over three to four decades: it is drawn so over four, up to the default bound, of either sign where both
are allowed. What cannot be recorded (a motion that stops, a spring that gives way) is drawn again with the same set.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from batches import RedrawError, System, record_system
from generate import write_batch
from recording import Batch
from strengths import draw_parameters, draw_strength, log_uniform
from systems import LIBRARY_NAMES_OF_OUTSIDE, OUTSIDE
from tiers import Plan

from pymc_backbone.discrepancy.fitting.scatter import NARROWEST
from pymc_backbone.discrepancy.sets.question import looked_for
from pymc_backbone.discrepancy.weighing.evidence import PRIOR_NONE, PRIOR_OF_SIZE, VARIANT
from pymc_backbone.effects import LIBRARY, Parameter

TIER = "prior"
DECADES = 4.0
"""Of the strength, below its default bound."""
SLIPS = (0.02, 1.5)
"""Displacement over the amplitude at which a slider slips; the package fits this instead of its stiffness."""
_WIDEST = 0.3
"""Largest relative scatter of effects; the package's prior goes to 0.5, where a Gaussian may turn strengths around."""
_OTHERS = tuple(name for name in OUTSIDE if name not in LIBRARY_NAMES_OF_OUTSIDE)
_ATTEMPTS = 400


def sets_and_weights() -> dict[tuple[str, ...], float]:
    """Return every set that the search may name in a motion measured in metres, with its prior probability."""
    families: dict[str, list[tuple[str, float]]] = {name: [(name, 1.0)] for name in looked_for("m")}
    for name, effect in LIBRARY.items():
        for original in effect.variant_of[:1]:  # in a set it stands once, in the place of whichever
            if original in families:
                families[original].append((name, VARIANT))
    weights: dict[tuple[str, ...], float] = {}
    for size, share in enumerate(PRIOR_OF_SIZE):
        each = share / math.comb(len(families), size)
        for chosen in itertools.combinations(families.values(), size):
            for members in itertools.product(*chosen):
                names = tuple(sorted(name for name, _ in members))
                weights[names] = each * math.prod(weight for _, weight in members)
    total = sum(weights.values())
    return {names: weight / total for names, weight in weights.items()}


def draw_values(effect: str, rng: np.random.Generator, amplitude: float, system: dict[str, float], size: float) -> dict:
    """Draw the parameters of an effect from its default bounds.

    Parameters
    ----------
    effect : str
    rng : numpy.random.Generator
    amplitude : float
        Largest release [m].
    system : dict
        Mass and angular frequency.
    size : float
        Strength over its default bound.

    Returns
    -------
    dict of str to float
    """
    found = LIBRARY[effect]
    mass, omega = system["mass"], system["omega"]
    held = found.held(mass, amplitude, omega)
    values: dict[str, float] = dict(held)
    free: list[Parameter] = [item for item in found.parameters if item.name not in held]
    strengths = {item.role: item for item in free}
    for item in free:
        low, high = item.bounds(mass, amplitude, omega)
        if item.role == "strength":
            negative = low < 0.0 and rng.random() < 0.5
            values[item.name] = size * (low if negative else high)
        elif item.role == "power_coefficient":  # its bounds are those at an exponent of one
            exponent = next(other for other in free if other.role == "exponent")
            values.setdefault(exponent.name, float(rng.uniform(*exponent.bounds(mass, amplitude, omega))))
            scaled = float(rng.uniform(low, high)) * amplitude
            values[item.name] = scaled * amplitude ** -values[exponent.name]
        elif item.name not in values:
            values[item.name] = float(rng.uniform(low, high))
    if "slip_force" in strengths:  # fitted as the force and the displacement at which it slips
        force, stiffness = strengths["slip_force"], strengths["strength"]
        values[force.name] = size * force.bounds(mass, amplitude, omega)[1]
        values[stiffness.name] = values[force.name] / (float(rng.uniform(*SLIPS)) * amplitude)
    return values


def _draw_batch(present: tuple[str, ...], outside: str | None, plan: Plan, rng: np.random.Generator) -> Batch:
    mass, frequency = log_uniform(rng, 0.05, 50.0), log_uniform(rng, 1.0, 100.0)
    amplitude, omega = log_uniform(rng, 1e-5, 0.05), 2.0 * math.pi * frequency
    stiffness = mass * omega**2
    damping = 2.0 * log_uniform(rng, *plan.damping_ratio) * mass * omega
    nominal = {"mass": mass, "linear_stiffness": stiffness, "viscous_damping": damping}
    strength: dict[str, float] = {}
    for effect in present:
        strength[effect] = 10.0 ** -(DECADES * rng.random())
        nominal |= draw_values(effect, rng, amplitude, {"mass": mass, "omega": omega}, strength[effect])
    if outside:
        wanted = draw_strength(outside, rng)
        system: dict[str, Any] = {"mass": mass, "stiffness": stiffness, "amplitude": amplitude, "damping": damping}
        parameters, strength[outside] = draw_parameters(outside, wanted, rng, **system)
        nominal |= parameters
    plan.effect_scatter = log_uniform(rng, NARROWEST, _WIDEST)
    batch = record_system(plan, System(nominal, strength, amplitude), rng)
    if any(abs(specimen.get("play_asymmetry", 0.0)) > 1.0 for specimen in batch.truth["parameters"]):
        raise RedrawError
    return batch


def make_prior_batch(seed: int, index: int) -> Batch:
    """Generate one batch; it depends on ``seed``, ``index`` and the package's prior only.

    Raises
    ------
    RuntimeError
        If no attempt gave usable records.
    """
    rng = np.random.default_rng([seed, index, 3])
    weights = sets_and_weights()
    outside = str(rng.choice(_OTHERS)) if rng.random() < PRIOR_NONE else None
    chosen = int(rng.choice(len(weights), p=list(weights.values())))
    present = () if outside else tuple(weights)[chosen]
    for _ in range(_ATTEMPTS):
        plan = Plan(present=present, outside=outside, damping_ratio=(0.002, 0.015), cycles=(30, 80))
        plan.samples_per_cycle, plan.noise_db, plan.bits = (16.0, 50.0), (40.0, 55.0), (16, 24)
        plan.specimens, plan.release_factor, plan.fewest_cycles = (3, 4, 5), (1.3, 3.0), 10.0
        try:
            batch = _draw_batch(present, outside, plan, rng)
        except (RedrawError, FloatingPointError, ZeroDivisionError):
            continue
        batch.truth = {"index": index, "seed": seed, "tier": TIER, **batch.truth}
        return batch
    raise RuntimeError(f"no usable records of {present or outside} with seed {seed} and index {index}.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, required=True, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first (default 0)")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder to write into")
    given = parser.parse_args(arguments)
    for index in range(given.first, given.first + given.batches):
        write_batch(make_prior_batch(given.seed, index), given.out / f"batch_{index:04d}")
    print(f"{given.batches} batches: {given.out}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
