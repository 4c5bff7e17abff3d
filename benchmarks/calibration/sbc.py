"""Simulation-based calibration of the likelihood of specimens, case by case.

    python benchmarks/calibration/sbc.py [CASES ...] [--simulations 200] [--wrong 0.5 2] [--out results.json]

The factors after ``--wrong`` are of the first case's standard errors: they have to fail.

Parameters are drawn from the Uniform priors, backbones simulated from them, level errors added, and the posterior is
sampled: over many repetitions the rank of the drawn value among the posterior's draws is uniform if, and only if, the
posterior is that of the model (Talts, Betancourt, Simpson, Vehtari, Gelman, arXiv 1804.06788). Tested per parameter by
chi-square over eight bins and by the simultaneous band of the empirical distribution (Saeilynoja, Buerkner, Vehtari,
Stat. Comput. 32 (2022), doi 10.1007/s11222-022-10090-6). A standard error that is wrong by a factor has to fail.

Case 4's posterior is a thin bent ridge, along which the default step has some ten effective draws in a thousand: ranks
among so few are not uniform however right the posterior is. There the chain begins at the drawn value, which is itself
a draw from the posterior, and runs as far into the past as into the future, with a kernel that was tuned from other
starts: the rank of the beginning is uniform if the kernel leaves the posterior as it is, however slowly it mixes
(Besag, Clifford, Biometrika 76 (1989) 633-642; a sweep of one reversible proposal is reversible). The log-likelihood
is ranked there as well: parameters that the data hardly tell apart say little about a wrong scale, it says most
(Modrak et al., Bayesian Analysis 2023, doi 10.1214/23-BA1404).

Case 5's polynomial model is calibrated against data of its own. Where parameters enter in a combination only (case 4:
(1 - alpha) A with beta and gamma in proportion) the ranks must be uniform all the same: they test the posterior, not
what it can tell.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from arviz_stats.ecdf_utils import ecdf_pit
from scipy.stats import chisquare

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from reuse import Reusable  # noqa: E402

from pymc_backbone import build_model, sample, simulate_population  # noqa: E402
from pymc_backbone.inference.proposal import make_metropolis  # noqa: E402
from pymc_backbone.inference.starts import StartFinder  # noqa: E402
from pymc_backbone.paper.cases import CASES, get_case  # noqa: E402

RANKS = 31  # draws that a value is ranked among: 32 possible ranks, four to a bin
BINS = 8
SPECIMENS = 2
ERRORS = {"frequency": 0.003, "damping": 0.1}  # of the value: a posterior that the priors' edges shape, too
CORRELATION = 0.5  # of neighbouring levels
LEVELS = {"4": 3}
SIMULATIONS = {"4": 100}
WALKED = {"4": (400, 20)}  # tuning draws of the default step, and draws between two that are ranked
MAXIMUM_TRIES = 200


def draw_data(case, levels, rng):
    """Return parameters from the prior, and backbones of specimens that have them, with level errors."""
    names = case.model.parameter_names
    for _ in range(MAXIMUM_TRIES):
        truth = {**case.model_fixed, **{name: rng.uniform(*pair) for name, pair in case.prior_bounds.items()}}
        data = simulate_population(case.model, [[truth[name] for name in names]] * SPECIMENS, levels)
        value = np.asarray(data["value"])
        if np.isfinite(value).all():
            break
    # The same for all draws: standard errors that depended on the parameters would tell about them.
    centre = {**case.model_fixed, **{name: pair[0] for name, pair in case.prior.items()}}
    nominal = np.asarray(simulate_population(case.model, [centre[name] for name in names], levels)["value"])
    share = np.array([ERRORS[str(o)] for o in data["observable"].values])[:, None]
    error = np.broadcast_to(np.abs(nominal) * share, value.shape)
    steps = np.abs(np.subtract.outer(np.arange(levels.size), np.arange(levels.size)))
    covariance = error[..., :, None] * error[..., None, :] * CORRELATION**steps
    noise = np.einsum("sokl,sol->sok", np.linalg.cholesky(covariance), rng.standard_normal(value.shape))
    return truth, data.assign(value=(data["value"].dims, value + noise)), error, covariance


def calibrate(name: str, simulations: int, factor: float = 1.0, seed: int = 1, say=None):
    """Return the probability integral transforms (simulation,) of each parameter, and how the sampling went.

    ``factor`` multiplies the standard errors that the likelihood is given.
    """
    case = get_case(name)
    levels = np.geomspace(case.levels[0], case.levels[-1], LEVELS.get(name, 4))
    wanted = list(case.prior_bounds)
    rng = np.random.default_rng([seed, sum(map(ord, name))])
    ranks = {quantity: [] for quantity in (*wanted, *(["log_likelihood"] if name in WALKED else []))}
    compiled, steps, diverging, effective = None, [], [], []
    begin = time.perf_counter()
    for simulation in range(simulations):
        truth, data, error, covariance = draw_data(case, levels, rng)
        dims = data["value"].dims
        data = data.assign(
            standard_error=(dims, factor * error), covariance=((*dims, "level_other"), factor**2 * covariance)
        )
        model = build_model(case.model, data, case.prior_bounds, fixed=case.model_fixed, likelihood="pooled")
        # Unconstrained values: the rank is the same.
        drawn = {
            model.rvs_to_values[model[p]].name: np.log((truth[p] - low) / (high - truth[p]))
            for p, (low, high) in case.prior_bounds.items()
        }
        if name in WALKED:
            path, begin_at = walk_both_ways(model, drawn, *WALKED[name], seed=simulation + 1, rng=rng)
            draws, ranked = path, path[:: WALKED[name][1]]
            likelihood = model.compile_logp(vars=model.observed_RVs)
            values = [[likelihood(dict(zip(drawn, point, strict=True)))] for point in ranked]
            ranked = np.hstack([ranked, values])
            value, thinned = ranked[begin_at], np.delete(ranked, begin_at, axis=0)
            part, length = 0.0, float(len(wanted))
        else:
            if compiled is None:
                compiled = Reusable(model, wanted)
            compiled.load(model)
            start = compiled.ravel(drawn)  # saves the way there; tuning forgets it
            posterior, part, length = compiled.draw(
                lambda g, s=start: s, draws=6 * RANKS, tune=150, chains=1, seed=simulation + 1, adaptation="low_rank"
            )
            draws = np.stack([posterior[parameter][0] for parameter in wanted], axis=1)
            thinned = draws[np.linspace(0, len(draws) - 1, RANKS).astype(int)]
            value = np.array([truth[parameter] for parameter in wanted])
        effective.append(min(_effective(draws[:, j]) for j in range(draws.shape[1])))
        for j, quantity in enumerate(ranks):
            ranks[quantity].append(int((thinned[:, j] < value[j]).sum()))
        steps.append(length)
        diverging.append(part)
        if say and (simulation + 1) % 10 == 0:
            say(f"case {name}, errors x {factor:g}: {simulation + 1} of {simulations}", flush=True)
    return {
        "case": name, "factor": factor, "simulations": simulations, "ranks": ranks, "steps": float(np.mean(steps)),
        "diverging": float(np.mean(diverging)), "effective": float(np.median(effective)),
        "least_effective": float(np.quantile(effective, 0.05)), "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def walk_both_ways(model, drawn, tune, thin, *, seed, rng):
    """Return a stationary path of unconstrained values, and at which of its every ``thin`` points it began."""
    finder = StartFinder(model, seed)
    finder.find(1)  # which gives the proposals their shape
    step = make_metropolis(model, finder)
    sample(model, draws=1, tune=tune, chains=1, step=step, random_seed=seed, progressbar=False)
    step.rng = np.random.default_rng([seed, 1])
    after = int(rng.integers(RANKS + 1))
    halves = []
    for length in (RANKS - after, after):
        point, half = dict(drawn), []
        for _ in range(thin * length):
            point, _ = step.step(point)
            half.append([float(point[name]) for name in drawn])
        halves.append(half)
    past, future = halves
    return np.array([*past[::-1], list(drawn.values()), *future]), RANKS - after


def _effective(draws: np.ndarray) -> float:
    """Return the effective number of draws, by Geyer's initial positive sequence."""
    centred = draws - draws.mean()
    size = draws.size
    spectrum = np.abs(np.fft.rfft(centred, 2 * size)) ** 2
    covariance = np.fft.irfft(spectrum)[:size]
    correlation = covariance / covariance[0]
    pairs = correlation[: 2 * (size // 2)].reshape(-1, 2).sum(axis=1)
    stop = int(np.argmax(pairs < 0.0)) if (pairs < 0.0).any() else pairs.size
    return float(size / max(2.0 * pairs[:stop].sum() - 1.0, 1.0 / size))


def judge(ranks, seed: int = 0) -> dict[str, float | bool]:
    """Return the chi-square p-value of ranks, and whether their empirical distribution stays in its 99 % band."""
    ranks = np.asarray(ranks)
    counts = np.bincount(ranks * BINS // (RANKS + 1), minlength=BINS)
    # A rank is spread over its own cell, which makes the transform continuous.
    transform = (ranks + np.random.default_rng(seed).random(ranks.size)) / (RANKS + 1)
    _, ecdf, low, high = ecdf_pit(transform, 0.99, 1000, rng=np.random.default_rng(seed))
    return {
        "p": float(chisquare(counts).pvalue),
        "inside": bool(np.all((low <= ecdf) & (ecdf <= high))),
        "mean": float(transform.mean()),
        "spread": float(transform.std() * np.sqrt(12.0)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", default=[name for name in CASES if name.isdigit()])
    parser.add_argument("--simulations", type=int, default=200)
    parser.add_argument("--wrong", type=float, nargs="*", default=[0.5, 2.0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default="-")
    options = parser.parse_args()
    for name in options.cases:
        simulations = min(options.simulations, SIMULATIONS.get(name, options.simulations))
        for factor in (1.0, *(options.wrong if name == options.cases[0] else [])):
            result = calibrate(name, simulations, factor, options.seed, say=print)
            result["verdict"] = {parameter: judge(ranks) for parameter, ranks in result["ranks"].items()}
            words = (
                f"case {name}, errors x {factor:g}, {simulations} simulations, {result['seconds']:.0f} s",
                f"{result['steps']:.1f} steps a draw", f"effective draws {result['effective']:.0f}",
                f"one in twenty below {result['least_effective']:.0f}", f"diverging {result['diverging']:.4f}",
            )  # fmt: skip
            print(", ".join(words))
            for parameter, verdict in result["verdict"].items():
                print(f"  {parameter:<22} p {verdict['p']:.3f}  in band {verdict['inside']}  mean rank "
                      f"{verdict['mean']:.3f}  spread x {verdict['spread']:.3f}", flush=True)  # fmt: skip
            if options.out != "-":
                with open(options.out, "a", encoding="utf-8") as file:
                    file.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
