"""Many backbones in lanes against one after the other, in one run: speed and errors.

    python benchmarks/lanes.py --markdown benchmarks/lanes.md

Ten levels over a factor of ten of the amplitude, for each smooth effect of the library and for three at once.
Parameters are drawn over a share of the default priors, springs with both signs, viscous damping from 0.1 to 3 %. Both
ways use all cores and take turns; the fastest of several rounds counts, since others may be at work on the machine.
Errors are those of what `simulate_many` returns, and of single ones, against the integrator at a hundredth of its usual
tolerance, level by level: of the frequency relative, of the damping relative (to at least 0.003), of the offset as they
are. What lanes leave to the simulator of single ones is counted, and has the latter's errors.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pymc_backbone import Oscillator
from pymc_backbone.effects import BASE_EFFECTS, LIBRARY
from pymc_backbone.simulation import kernels
from pymc_backbone.simulation.decay import Simulator
from pymc_backbone.simulation.lane_cycles import is_smooth
from pymc_backbone.simulation.many import simulate_many

MASS, OMEGA, AMPLITUDE = 1.0, 2.0 * math.pi * 12.0, 0.03
SMOOTH = [name for name, effect in LIBRARY.items() if is_smooth(effect) and name not in BASE_EFFECTS]
MODELS = [[], *([name] for name in SMOOTH), ["cubic_stiffness", "quadratic_damping", "coulomb_friction"]]
SINGLES = 4096  # of them are simulated one after the other, the others only in lanes
CHECKED = 1024


def draw(oscillator: Oscillator, amplitude: float, count: int, strength: float, seed: int) -> np.ndarray:
    """Return parameter vectors (n, p)."""
    rng = np.random.default_rng(seed)
    bounds = oscillator.default_bounds(amplitude, OMEGA)
    columns = []
    for name in oscillator.parameter_names:
        if name == "linear_stiffness":
            columns.append(MASS * OMEGA**2 * rng.uniform(0.9, 1.1, count))
        elif name == "viscous_damping":
            columns.append(2.0 * MASS * OMEGA * 10.0 ** rng.uniform(-3.0, -1.5, count))
        else:
            columns.append(strength * rng.uniform(*bounds[name], count))
    return np.column_stack(columns)


def fastest(call: Callable[[], object], rounds: int) -> float:
    """Return the least seconds of a call."""
    taken = []
    for _ in range(rounds):
        begin = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begin)
    return min(taken)


def reference(simulator: Simulator, parameters: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return exact values (n, 3, l)."""
    values = np.empty((len(parameters), 3, levels.size))
    here, status = np.empty((3, 1)), np.zeros(1, dtype=np.int64)
    for k in range(levels.size):
        description = simulator.describe(levels[k : k + 1], tolerance=2e-11)
        for row, one in enumerate(parameters):
            kernels.backbone(*description, one, here, np.empty((0, 0, 0)), status)
            values[row, :, k] = here[:, 0]
    return values


def errors(values: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return the largest errors (3,), of frequency, damping and offset."""
    size = np.ones_like(exact)
    size[:, 0], size[:, 1] = exact[:, 0], np.clip(np.abs(exact[:, 1]), 0.003, 1.0)
    return np.nanmax(np.abs(values - exact) / size, axis=(0, 2))


def row(names: list[str], strength: float, count: int, rounds: int) -> str:
    """Return a row of the table."""
    oscillator = Oscillator(MASS, names)
    amplitude = 1.0 if "pendulum_stiffness" in names else AMPLITUDE
    levels = np.geomspace(0.1 * amplitude, amplitude, 10)
    parameters = draw(oscillator, amplitude, count, strength, 11)
    simulator = Simulator(oscillator)
    lanes = fastest(lambda: simulate_many(simulator, parameters, levels), rounds) / count
    some = parameters[:SINGLES]
    singles = fastest(lambda: simulate_many(simulator, some, levels, least=count + 1), rounds) / len(some)
    few = parameters[:CHECKED]
    exact = reference(simulator, few, levels)
    in_lanes = simulate_many(simulator, few, levels)[0]
    one_by_one = simulate_many(simulator, few, levels, least=count + 1)[0]
    is_left = np.all((in_lanes == one_by_one) | np.isnan(in_lanes), axis=(1, 2))
    e, own = errors(in_lanes[~is_left], exact[~is_left]), errors(one_by_one, exact).max()
    return (
        f"| {', '.join(names) or 'none'} | {1e-3 / lanes:.0f} | {1e-3 / singles:.0f} | {singles / lanes:.1f} "
        f"| {is_left.mean():.1%} | {e[0]:.0e} | {e[1]:.0e} | {e[2]:.0e} | {own:.0e} |"
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=32768, help="parameter vectors (default 32768)")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--strengths", type=float, nargs="+", default=[0.03, 0.1, 1.0], help="shares of the priors")
    parser.add_argument("--markdown", type=Path, help="the tables into this file too")
    given = parser.parse_args()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    lines = [f"{cores} cores, {platform.machine()}; {given.count} vectors, ten levels; thousand backbones a second."]
    for strength in given.strengths:
        count = given.count if strength < 1.0 else given.count // 4
        lines += ["", f"Effects up to {strength:g} of their default priors:", ""]
        lines += [
            "| effects | many | singles | ratio | left to singles | error in lanes: frequency | damping | offset "
            "| error of singles |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for names in MODELS:
            lines.append(row(names, strength, count, given.rounds))
            print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    if given.markdown is not None:
        given.markdown.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
