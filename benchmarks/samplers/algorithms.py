"""One function per sampler: a problem and a budget in, draws with what they cost out. Chains run one after another.

What is counted: simulations of a backbone for its log-density alone, and evaluations of log-density with gradient, by
the likelihood itself, tuning included, the search for starts not. ``seconds`` is the processor's time for the same,
which other work on the machine hardly changes; ``wall`` the whole on the clock, with compilation and starts.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pymc as pm

from pymc_backbone import sample
from pymc_backbone.simulation.counts import read_counts

from problems import LogDensity, Problem  # isort: skip

CHAINS = 4
SMC_CHAINS = 6  # independent populations: their scatter is the only measure of what a population is worth
ENSEMBLES = 2
TUNED = 0.25  # of all iterations
GRADIENT_TUNE = 300  # iterations that a mass matrix needs at least


@dataclass
class Run:
    """Draws (chain, draw, parameter) on the natural scale, and what they cost.

    ``groups`` says how many successive chains belong to one ensemble, whose members are not independent (1 elsewhere);
    ``is_population`` that the draws of a chain are in no order; ``log_evidence`` is per chain, where there is one.
    """

    draws: np.ndarray
    seconds: float
    wall: float
    simulations: int
    gradients: int
    acceptance: float
    groups: int = 1
    is_population: bool = False
    log_evidence: np.ndarray | None = None


def _stack(posterior, parameters: tuple[str, ...]) -> np.ndarray:
    return np.stack([np.asarray(posterior[name], dtype=np.float64) for name in parameters], axis=-1)


def _moved(draws: np.ndarray) -> float:
    return float(np.mean(np.any(np.diff(draws, axis=1) != 0.0, axis=-1)))


def run_step(problem: Problem, step: str, per_draw: float, budget: int, seed: int, blocked: bool = False) -> Run:
    """Run a step of `pymc_backbone.sample`; ``per_draw`` is what an iteration is expected to evaluate."""
    iterations = max(int(budget / (CHAINS * per_draw)), 20)
    tune = int(TUNED * iterations)
    draws = iterations - tune
    if step in ("nuts", "nutpie"):
        tune = min(GRADIENT_TUNE, max(budget // 40, 20))
        draws = max(iterations - tune, tune)
    model = problem.build(blocked)
    begin, worked = time.perf_counter(), time.process_time()
    result = sample(model, draws=draws, tune=tune, chains=CHAINS, step=step, random_seed=seed, progressbar=False)
    wall, worked = time.perf_counter() - begin, time.process_time() - worked
    values, statistics = _stack(result["posterior"], problem.parameters), result["sample_stats"]
    acceptance = _moved(values)
    for name in ("accepted", "acceptance_rate", "mean_tree_accept"):
        if name in statistics:
            acceptance = float(np.asarray(statistics[name], dtype=np.float64).mean())
            break
    return Run(
        values,
        # Sampling alone is known by the clock: the share of the processor is that of the whole call.
        float(result["posterior"].attrs["sampling_time"]) * min(worked / wall, 1.0),
        wall,
        result.attrs["simulations"],
        result.attrs["gradients"],
        np.nan if step == "slice" else acceptance,
    )


def run_smc(problem: Problem, budget: int, seed: int) -> Run:
    """Run PyMC's sequential Monte Carlo, several populations; its own number of stages and steps sets the cost."""
    compiled: list[float] = []

    class Kernel(pm.smc.IMH):
        def __init__(self, *arguments, **options) -> None:
            super().__init__(*arguments, **options)
            compiled.append(time.process_time())

    model = problem.build()
    before, begin = read_counts(), time.perf_counter()
    with model, warnings.catch_warnings():
        # PyMC says of every model with a potential that draws from its prior ignore it, which is what a prior is.
        warnings.filterwarnings("ignore", message="The effect of Potentials", category=UserWarning)
        # Particles that failed have a log-likelihood of -inf, and weight 0.
        warnings.filterwarnings("ignore", message="(invalid value|divide by zero) encountered", category=RuntimeWarning)
        result = pm.sample_smc(
            max(budget // 15, 60), kernel=Kernel, chains=SMC_CHAINS, cores=1, random_seed=seed,
            progressbar=False, compute_convergence_checks=False,
        )  # fmt: skip
    worked, wall, after = time.process_time() - compiled[0], time.perf_counter() - begin, read_counts()
    statistics = result["sample_stats"]
    evidence = [last_finite(chain) for chain in statistics["log_marginal_likelihood"].values]
    return Run(
        _stack(result["posterior"], problem.parameters),
        worked,
        wall,
        int(after["simulations"] - before["simulations"]),
        int(after["gradients"] - before["gradients"]),
        float(np.mean([last_finite(chain) for chain in statistics["accept_rate"].values])),
        is_population=True,
        log_evidence=np.array(evidence),
    )


def last_finite(values) -> float:
    """Return the last finite number: PyMC pads the evidence with NaN, stages before the last have none."""
    numbers = np.array([np.nan if value is None else float(value) for value in np.ravel(values)])
    return float(numbers[np.isfinite(numbers)][-1])


def run_emcee(problem: Problem, budget: int, seed: int) -> Run:
    """Run emcee's affine-invariant ensemble on the compiled log-density of the PyMC model."""
    import emcee

    begin = time.perf_counter()
    target = LogDensity(problem)
    size = len(problem.parameters)
    walkers = 4 * size
    iterations = max(budget // (ENSEMBLES * walkers), 20)
    tune = int(TUNED * iterations)
    starts = target.find_starts(ENSEMBLES * walkers, seed).reshape(ENSEMBLES, walkers, size)
    before, ready = target.counts(), time.process_time()
    chains, accepted = [], []
    for index, start in enumerate(starts):
        sampler = emcee.EnsembleSampler(walkers, size, target)
        sampler.random_state = np.random.RandomState([seed, index]).get_state()
        sampler.run_mcmc(start, iterations, skip_initial_state_check=True)
        chains.append(np.swapaxes(sampler.get_chain(discard=tune), 0, 1))
        accepted.append(sampler.acceptance_fraction.mean())
    worked = time.process_time() - ready
    return _outside(target, np.concatenate(chains), before, begin, worked, float(np.mean(accepted)), walkers)


def run_pints(problem: Problem, budget: int, seed: int, jacobian: bool = True) -> Run:
    """Run PINTS' Haario-Bardenet adaptive covariance Metropolis on the compiled log-density of the PyMC model."""
    import pints

    begin = time.perf_counter()
    target = LogDensity(problem, jacobian)
    size = len(problem.parameters)

    class Wrapped(pints.LogPDF):
        def __call__(self, vector) -> float:
            return target(vector)

        def n_parameters(self) -> int:
            return size

    iterations = max(budget // CHAINS, 20)
    tune = int(TUNED * iterations)
    starts = target.find_starts(CHAINS, seed)
    state = np.random.get_state()
    np.random.seed(seed)  # PINTS draws from NumPy's global generator
    before, ready = target.counts(), time.process_time()
    controller = pints.MCMCController(Wrapped(), CHAINS, list(starts), method=pints.HaarioBardenetACMC)
    controller.set_max_iterations(iterations)
    controller.set_initial_phase_iterations(min(200, tune))
    controller.set_log_to_screen(False)
    chains = np.asarray(controller.run())[:, tune:]
    worked = time.process_time() - ready
    np.random.set_state(state)
    return _outside(target, chains, before, begin, worked, _moved(chains), 1)


def _outside(
    target: LogDensity, chains: np.ndarray, before: dict, begin: float, seconds: float, acceptance: float, groups: int
) -> Run:
    after = target.counts()
    return Run(
        target.natural(chains),
        seconds,
        time.perf_counter() - begin,
        int(after["simulations"] - before["simulations"]),
        int(after["gradients"] - before["gradients"]),
        acceptance,
        groups=groups,
    )


def _step(step: str, per_draw: Callable[[int], float], blocked: bool = False) -> Callable[[Problem, int, int], Run]:
    def run(problem: Problem, budget: int, seed: int) -> Run:
        return run_step(problem, step, per_draw(len(problem.parameters)), budget, seed, blocked)

    return run


BASE, DEFAULT = "pm.Metropolis, scalars", "joint Metropolis (default)"
SAMPLERS: dict[str, Callable[[Problem, int, int], Run]] = {
    BASE: _step("elementwise", float),
    "pm.Metropolis, one vector": _step("elementwise", float, blocked=True),
    DEFAULT: _step("metropolis", float),
    "DEMetropolisZ": _step("demetropolisz", lambda size: 1.0),
    "Slice": _step("slice", lambda size: 6.0 * size),
    "SMC": run_smc,
    "NUTS (PyMC)": _step("nuts", lambda size: 20.0),
    "nutpie": _step("nutpie", lambda size: 20.0),
    "emcee": run_emcee,
    "PINTS Haario-Bardenet": run_pints,
}
CONTROL = "negative control: PINTS without the Jacobian"


def run_control(problem: Problem, budget: int, seed: int) -> Run:
    """Run a sampler on a wrong density: the one without the Jacobian of PyMC's transform."""
    return run_pints(problem, budget, seed, jacobian=False)


def quiet() -> None:
    """Silence what PyMC tells about each run."""
    for name in ("pymc", "pymc.smc", "pymc.stats.convergence"):
        logging.getLogger(name).setLevel(logging.ERROR)
