"""What a run is worth: effective samples, convergence, and agreement with a reference that is no Markov chain.

The reference is importance sampling from a wide Student t, fitted to a pilot run, mixed with the prior: independent
draws, so its errors are known, and nothing within the prior is out of its reach. It gives the evidence as well. For
two parameters a grid checks it, with likelihoods that PyMC has no part in.
"""

from __future__ import annotations

from dataclasses import dataclass

import arviz as az
import numpy as np
from scipy import stats
from scipy.special import logsumexp

from algorithms import Run  # isort: skip
from problems import LogDensity, Problem  # isort: skip

# R-hat above which a chain's own effective sample size means little; 1.01 (Vehtari et al., Bayesian Analysis 16 (2021))
# is what a result to be published should reach, and is printed.
WORST_RHAT = 1.05
LEAST_EFFECTIVE = 100.0
# The largest of a dozen normal errors exceeds this once in a thousand runs; errors are themselves estimated.
LARGEST_GAP = 4.0
_PRIOR_SHARE = 0.1
_DEGREES, _WIDENING = 6, 1.3


@dataclass(frozen=True)
class Reference:
    """Posterior means and sds (p,), their standard errors, log evidence with its own, effective draws."""

    mean: np.ndarray
    sd: np.ndarray
    mean_error: np.ndarray
    sd_error: np.ndarray
    log_evidence: float
    log_evidence_error: float
    effective: float


@dataclass(frozen=True)
class Figures:
    """What is printed of one run; gaps are the largest over means and sds of all parameters."""

    effective_worst: float
    effective_mean: float
    rhat: float
    gap_in_sd: float
    gap_in_errors: float
    is_converged: bool
    is_flagged: bool


def find_reference(problem: Problem, pilot: np.ndarray, draws: int, seed: int) -> Reference:
    """Return the reference from independent weighted draws; ``pilot`` (n, p), natural, only shapes the proposal."""
    target = LogDensity(problem)
    rng = np.random.default_rng(seed)
    spots = target.unconstrained(pilot)
    shape = _WIDENING**2 * np.cov(spots.T)
    student = stats.multivariate_t(spots.mean(axis=0), shape, df=_DEGREES, seed=rng)
    points = np.atleast_2d(student.rvs(draws))
    from_prior = rng.random(draws) < _PRIOR_SHARE
    points[from_prior] = stats.logistic.rvs(size=(int(from_prior.sum()), points.shape[1]), random_state=rng)
    # A Uniform is a standard logistic on PyMC's unconstrained scale.
    proposed = logsumexp(
        [
            np.log1p(-_PRIOR_SHARE) + student.logpdf(points),
            np.log(_PRIOR_SHARE) + stats.logistic.logpdf(points).sum(axis=1),
        ],
        axis=0,
    )
    log_weights = np.array([target(point) for point in points]) - proposed
    return weighted(target.natural(points), log_weights)


def weighted(values: np.ndarray, log_weights: np.ndarray) -> Reference:
    """Return moments of weighted independent draws (n, p) and their errors by the delta method."""
    n = len(values)
    total = logsumexp(log_weights)
    weights = np.exp(log_weights - total)
    mean = weights @ values
    squares = (values - mean) ** 2
    variance = weights @ squares
    sd = np.sqrt(variance)
    effective = 1.0 / float(np.sum(weights**2))
    return Reference(
        mean,
        sd,
        np.sqrt(weights**2 @ squares),
        np.sqrt(weights**2 @ (squares - variance) ** 2) / (2.0 * sd),
        float(total - np.log(n)),
        float(np.sqrt(max(1.0 / effective - 1.0 / n, 0.0))),
        effective,
    )


def integrate_grid(problem: Problem, per_axis: int) -> Reference:
    """Return the moments and the evidence of two parameters by the midpoint rule over the prior; errors are zero."""
    axes = [low + (high - low) * (np.arange(per_axis) + 0.5) / per_axis for low, high in problem.bounds.values()]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    result = weighted(points, problem.log_likelihood(points))
    nothing = np.zeros(len(axes))
    return Reference(result.mean, result.sd, nothing, nothing, result.log_evidence, 0.0, float(len(points)))


def judge(run: Run, reference: Reference) -> Figures:
    """Return effective samples, R-hat and agreement of a run; ensembles and populations count as what they are."""
    draws = run.draws
    size = draws.shape[-1]
    if run.is_population:
        effective, mean_error, sd_error = _population(draws)
    else:
        effective = np.array([_bulk(draws[..., j], run.groups) for j in range(size)])
        spread = draws.reshape(-1, size).std(axis=0)
        # Of chains: errors as ArviZ has them. Of ensembles: as of so many independent draws, normal for the sd.
        if run.groups == 1:
            mean_error, sd_error = (
                np.array([float(az.mcse(draws[..., j], method=method)) for j in range(size)])
                for method in ("mean", "sd")
            )
        else:
            mean_error, sd_error = spread / np.sqrt(effective), spread / np.sqrt(effective)
    # An ensemble is one chain, its walkers side by side in time: one walker's own series is too short to tell.
    chains = draws.reshape(-1, run.groups, draws.shape[1], size).swapaxes(1, 2)
    chains = chains.reshape(len(chains), -1, size)
    rhat = max(float(az.rhat(chains[..., j])) for j in range(size))
    flat = draws.reshape(-1, size)
    gaps = np.abs(np.array([flat.mean(axis=0) - reference.mean, flat.std(axis=0, ddof=1) - reference.sd]))
    errors = np.hypot([mean_error, sd_error], [reference.mean_error, reference.sd_error])
    with np.errstate(divide="ignore", invalid="ignore"):
        in_errors = np.nan_to_num(gaps / errors, nan=np.inf)
    if run.is_population:  # errors from so few populations: as many normal standard errors as are as improbable
        in_errors = np.minimum(stats.norm.isf(stats.t.sf(in_errors, len(draws) - 1)), in_errors)
    worst = float(np.nan_to_num(effective).min())
    return Figures(
        worst,
        float(np.nan_to_num(effective).mean()),
        rhat,
        float((gaps / reference.sd).max()),
        float(in_errors.max()),
        bool(rhat <= WORST_RHAT and worst >= LEAST_EFFECTIVE),
        bool(in_errors.max() > LARGEST_GAP),
    )


def _bulk(values: np.ndarray, groups: int) -> float:
    """Return the bulk effective sample size of one parameter (chain, draw).

    Walkers of an ensemble move by each other's places, so as chains they seem more independent than they are. The mean
    over an ensemble is one series: its effective draws, times how much less it varies than a walker, are those of all.
    """
    if groups == 1:
        return float(az.ess(values, method="bulk"))
    ranks = stats.norm.ppf((stats.rankdata(values).reshape(values.shape) - 0.375) / (values.size + 0.25))
    means = ranks.reshape(-1, groups, values.shape[1]).mean(axis=1)
    return min(float(az.ess(means, method="mean")) * ranks.var() / means.var(), float(values.size))


def _population(draws: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return effective draws and errors of mean and sd from the scatter over independent populations (chain, n, p).

    Draws of a population stand in no order, so no autocorrelation tells how many are copies or cousins.
    """
    chains, n, _ = draws.shape
    means, sds = draws.mean(axis=1), draws.std(axis=1, ddof=1)
    spread = draws.reshape(chains * n, -1).var(axis=0)
    effective = np.minimum(spread * chains / means.var(axis=0, ddof=1), chains * n)
    return effective, means.std(axis=0, ddof=1) / np.sqrt(chains), sds.std(axis=0, ddof=1) / np.sqrt(chains)
