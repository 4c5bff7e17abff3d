"""What sampling costs, as ratios within one run: PyMC against a bare compiled walk, and steps against each other.

    python benchmarks/sampling.py [--draws 3000] [--repeats 5]

The density is smooth: a normal at each of ten levels, frequency and damping, of a Duffing population. A bare random
walk in compiled code with the same density and the same proposals is the floor for any Metropolis: three proposals a
draw, one parameter each, against `pymc.Metropolis` on three scalars and on one vector (which it moves entry by entry);
three joint proposals a draw against this package's joint Metropolis.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import textwrap
import time

import arviz as az
import numba
import numpy as np
import pymc as pm

from pymc_backbone import Oscillator, build_model, fit_density, sample, simulate_population
from pymc_backbone.likelihood.native import call_log_likelihood, define_symbols
from pymc_backbone.likelihood.op import describe
from pymc_backbone.simulation.response import make_response

OSCILLATOR = Oscillator(1.0, ["cubic_stiffness"])
LEVELS = np.geomspace(0.003, 0.03, 10)
CENTRE = np.array([6500.0, 1.1, 6.25e6])
SPREAD = np.array([300.0, 0.15, 3e5])
BOUNDS = {"linear_stiffness": (4500.0, 8500.0), "viscous_damping": (0.1, 2.1), "cubic_stiffness": (4e6, 8.5e6)}


def make_density():
    rng = np.random.default_rng(1)
    parameters = CENTRE + SPREAD * rng.standard_normal((200, 3))
    return fit_density(simulate_population(OSCILLATOR, parameters, LEVELS), marginal="normal")


def make_walk(density):
    define_symbols()
    integers, numbers = describe(make_response(OSCILLATOR, LEVELS))
    codes, table = density.codes, density.table
    low = np.array([interval[0] for interval in BOUNDS.values()])
    high = np.array([interval[1] for interval in BOUNDS.values()])
    nothing = np.empty(0)

    @numba.njit
    def log_density(theta):
        for j in range(3):
            if not low[j] < theta[j] < high[j]:
                return -np.inf
        return call_log_likelihood(
            integers.ctypes, numbers.ctypes, theta.ctypes, codes.ctypes, codes.size, table.ctypes, table.size,
            nothing.ctypes, 0,
        )  # fmt: skip

    @numba.njit
    def walk(start, scale, draws, blocked, seed):
        np.random.seed(seed)
        theta = start.copy()
        value = log_density(theta)
        trace = np.empty((draws, 3))
        for i in range(draws):
            for j in range(3):
                proposal = theta.copy()
                if blocked:
                    for k in range(3):
                        proposal[k] += scale[k] * np.random.standard_normal()
                else:
                    proposal[j] += scale[j] * np.random.standard_normal()
                other = log_density(proposal)
                if np.log(np.random.random()) < other - value:
                    theta, value = proposal, other
            trace[i] = theta
        return trace

    return walk


def run(model, step, draws, tune, seed):
    """Return seconds per draw of sampling alone, and the smallest bulk effective sample size per second."""
    result = sample(model, draws=draws, tune=tune, chains=2, step=step, random_seed=seed, progressbar=False)
    posterior = result["posterior"]
    seconds = float(posterior.attrs.get("sampling_time", result.attrs["seconds"]))
    ess = az.ess(result)
    smallest = min(float(ess[name]) for name in BOUNDS)
    return seconds / (2 * (draws + tune)), smallest / seconds


def second_process() -> float:
    """Return seconds from an imported package to a compiled log-likelihood in a process that finds all on disk."""
    script = textwrap.dedent(
        """
        import time, numpy as np, pytensor, pytensor.tensor as pt
        from pymc_backbone import Oscillator, BackboneLogLikelihood
        from pymc_backbone.simulation.response import make_response
        import pymc
        begin = time.perf_counter()
        op = BackboneLogLikelihood(make_response(Oscillator(1.0, ["cubic_stiffness"]), np.geomspace(0.003, 0.03, 10)))
        theta = pt.dvector()
        codes = np.array([0, 20] + [v for i in range(20) for v in (1, 3 * i, 3)])
        table = np.tile([10.0, 1.0, 0.0], 20)
        function = pytensor.function([theta], op(theta, codes, table)[0])
        function(np.array([6500.0, 1.1, 6.25e6]))
        print(time.perf_counter() - begin)
        """
    )
    return float(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=3000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    density = make_density()
    walk = make_walk(density)
    for blocked in (False, True):
        walk(CENTRE, 0.3 * SPREAD, 10, blocked, 1)
    # The walk's scale is tuned as PyMC tunes its own; it changes the acceptance, hardly the cost.
    scales = {False: 0.6 * SPREAD, True: 0.35 * SPREAD}
    plain, block = build_model(OSCILLATOR, density, BOUNDS), build_model(OSCILLATOR, density, BOUNDS, blocked=True)
    # label: (model, step, whether the bare walk proposes jointly, draws)
    runs = {
        "elementwise, three scalars": (plain, "elementwise", False, options.draws),
        "elementwise, one vector": (block, "elementwise", False, options.draws),
        "joint (the default)": (plain, "metropolis", True, options.draws),
        "demetropolisz": (plain, "demetropolisz", None, options.draws),
        "slice": (plain, "slice", None, options.draws // 5),
        "nuts": (plain, "nuts", None, options.draws // 3),
        "nutpie": (plain, "nutpie", None, options.draws // 3),
    }
    ratios: dict[str, list[float]] = {label: [] for label in runs}
    speed: dict[str, list[float]] = {label: [] for label in runs}
    for repeat in range(options.repeats):
        for label, (model, step, jointly, draws) in runs.items():
            per_draw, per_second = run(model, step, draws, 1000 if draws == options.draws else 400, repeat)
            speed[label].append(per_second)
            if jointly is not None:
                begin = time.perf_counter()
                walk(CENTRE, scales[jointly], 2 * options.draws, jointly, repeat)
                ratios[label].append(per_draw * 2 * options.draws / (time.perf_counter() - begin))
    print(f"pymc {pm.__version__}, {options.repeats} repeats: median (smallest to largest)")
    for label, values in ratios.items():
        if values:
            print(
                f"{label:>27}: {np.median(values):5.2f} ({min(values):.2f} to {max(values):.2f}) x the bare walk a draw"
            )
    first = np.array(speed["elementwise, three scalars"])
    for label, values in speed.items():
        paired = np.array(values) / first
        print(
            f"{label:>27}: {np.median(paired):5.1f} ({paired.min():.1f} to {paired.max():.1f}) x pymc.Metropolis in "
            f"effective samples per second; {np.median(values):.0f}/s"
        )
    print(f"second process, imports done, to a compiled and evaluated log-likelihood: {second_process():.2f} s")


if __name__ == "__main__":
    main()
