"""The comparison of samplers in `benchmarks/samplers`: exact counts, honest errors, and wrong densities noticed."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm
import pytest
from scipy import stats

from pymc_backbone import simulate_backbone
from pymc_backbone.simulation.counts import read_counts

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks" / "samplers"))

import algorithms
import compare
import table
from agreement import Reference, find_reference, integrate_grid, judge, weighted
from problems import BEAM, LogDensity, Problem, make_problem


@pytest.fixture(scope="module")
def beam() -> Problem:
    return make_problem("beam")


def standard_normal(size: int) -> Reference:
    zero = np.zeros(size)
    return Reference(zero, np.ones(size), zero, zero, 0.0, 0.0, np.inf)


def run_of(draws: np.ndarray, **settings) -> algorithms.Run:
    return algorithms.Run(draws, 1.0, 1.0, draws.shape[0] * draws.shape[1], 0, 1.0, **settings)


def test_quick_run_prints_a_whole_table(tmp_path: Path) -> None:
    output = tmp_path / "results.md"
    text = compare.main(["--quick", "--samplers", algorithms.DEFAULT, "SMC", "--output", str(output)])
    assert output.read_text(encoding="utf-8") == text
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ")]
    assert [cell.strip() for cell in rows[0]] == list(table.HEADER)
    assert [row[0].strip() for row in rows[1:]] == [algorithms.BASE, algorithms.DEFAULT, "SMC"]
    for row in rows[1:]:
        cells = dict(zip(table.HEADER, (cell.strip() for cell in row), strict=True))
        assert float(cells["R-hat"]) > 0.9 and float(cells["wall [s]"]) >= float(cells["s"]) >= 0.0
        assert (cells["effective samples/s, worst"] == "-") == (cells["verdict"] != "converged")
    # Six populations of a few dozen particles: the evidence of each, and all that stands beside it.
    assert text.count("SMC, seed 1: ") == 1 and "integration on a grid" in text and "importance sampling" in text


def test_counts_of_metropolis_are_exact(beam: Problem) -> None:
    calls = []

    def by_hand(parameters, levels):
        calls.append(dict(parameters))
        theta = [parameters[name] for name in beam.oscillator.parameter_names]
        return simulate_backbone(beam.oscillator, theta, levels).values[:1]

    counted = dataclasses.replace(beam, oscillator=by_hand)
    model = counted.build()
    before = read_counts()
    with model:
        point = {"linear_stiffness": 80.0, "cubic_stiffness": -3e10}
        pm.sample(
            draws=30, tune=20, chains=1, cores=1, step=pm.Metropolis(), initvals=point, random_seed=1,
            progressbar=False, compute_convergence_checks=False,
        )  # fmt: skip
    # Two scalars, fifty iterations, and where the walk begins; the function's own list is the independent counter.
    assert read_counts()["simulations"] - before["simulations"] == len(calls) == 2 * 50 + 1
    budget = 4 * 2 * 40
    runs = [algorithms.SAMPLERS[algorithms.BASE](problem, budget, 3) for problem in (beam, counted)]
    np.testing.assert_allclose(runs[0].draws, runs[1].draws, rtol=1e-6)
    # One simulation for each proposal, and one for each chain's start unless it is still remembered.
    assert runs[0].simulations == runs[1].simulations
    assert 0 <= runs[0].simulations - budget <= algorithms.CHAINS
    assert runs[0].gradients == 0


def test_reference_agrees_with_a_grid(beam: Problem) -> None:
    # The pilot only shapes the proposal: the nine specimens do.
    pilot = np.column_stack([BEAM[:, 0], -1e9 * BEAM[:, 1]])
    reference = find_reference(beam, pilot, 3000, 1)
    grid = integrate_grid(beam, 100)
    # Densities end in hard edges, so a grid of 100 is good to about one part in 100 of the prior's width.
    for ours, exact, error, width in ((reference.mean, grid.mean, reference.mean_error, grid.sd),
                                      (reference.sd, grid.sd, reference.sd_error, grid.sd)):  # fmt: skip
        assert np.all(np.abs(ours - exact) < 4.0 * error + 0.015 * width)
    assert reference.log_evidence == pytest.approx(grid.log_evidence, abs=4.0 * reference.log_evidence_error + 0.03)
    assert reference.effective > 400


def test_log_density_is_that_of_the_likelihood_and_the_prior(beam: Problem) -> None:
    right, wrong = LogDensity(beam), LogDensity(beam, jacobian=False)
    natural = np.array([[82.0, -2e10], [70.0, -4e10]])
    low, high = np.array(list(beam.bounds.values())).T
    inside = np.log((natural - low) * (high - natural) / (high - low)).sum(axis=1)
    expected = beam.log_likelihood(natural) - np.log(high - low).sum()
    for log_density, jacobian in ((right, inside), (wrong, 0.0)):
        spots = log_density.unconstrained(natural)
        np.testing.assert_allclose(log_density.natural(spots), natural, rtol=1e-12)
        # PyMC has the logarithms of the priors' widths in single precision.
        np.testing.assert_allclose([log_density(spot) for spot in spots], expected + jacobian, rtol=2e-7)
    assert right.calls == 2


def test_weighted_moments_have_the_errors_they_claim(rng: np.random.Generator) -> None:
    gaps = []
    for _ in range(200):
        points = 1.5 * rng.standard_normal((500, 2))
        log_weights = stats.norm.logpdf(points).sum(axis=1) - stats.norm.logpdf(points, scale=1.5).sum(axis=1)
        found = weighted(points, log_weights + 3.0)
        gaps.append([*(found.mean / found.mean_error), *((found.sd - 1.0) / found.sd_error),
                     (found.log_evidence - 3.0) / found.log_evidence_error])  # fmt: skip
    # The sd of 200 standardised errors is known to 5 %.
    np.testing.assert_allclose(np.std(gaps, axis=0), 1.0, atol=0.2)


def test_right_draws_pass_and_wrong_ones_are_flagged(rng: np.random.Generator) -> None:
    noise = rng.standard_normal((4, 2000, 2))
    draws = np.zeros_like(noise)
    for i in range(1, noise.shape[1]):  # 0.5 of lag one: a third of the draws are effective
        draws[:, i] = 0.5 * draws[:, i - 1] + np.sqrt(0.75) * noise[:, i]
    figures = judge(run_of(draws), standard_normal(2))
    assert figures.is_converged and not figures.is_flagged
    assert figures.effective_worst == pytest.approx(8000 / 3, rel=0.25)
    shifted, narrow = draws + np.array([0.0, 0.2]), draws * [1.0, 0.85]
    assert all(judge(run_of(wrong), standard_normal(2)).is_flagged for wrong in (shifted, narrow))
    apart = draws + np.array([0.0, 0.0, 0.0, 2.0])[:, None, None]
    assert not judge(run_of(apart), standard_normal(2)).is_converged


def test_copies_in_a_population_do_not_count(rng: np.random.Generator) -> None:
    draws = np.repeat(rng.standard_normal((40, 50, 1)), 10, axis=1)
    draws = rng.permuted(draws, axis=1)
    assert float(az.ess(draws[..., 0])) > 10_000  # what an autocorrelation makes of 2000 values
    figures = judge(run_of(draws, is_population=True), standard_normal(1))
    # From the variance of 40 means, known to 22 %.
    assert figures.effective_worst == pytest.approx(2000, rel=0.6)


def test_walkers_that_move_together_do_not_count_as_many(rng: np.random.Generator) -> None:
    shared, own = rng.standard_normal((2, 1, 1000, 1)), rng.standard_normal((2, 10, 1000, 1))
    draws = (np.sqrt(0.5) * (shared + own)).reshape(20, 1000, 1)  # (ensemble, walker, ...): walkers side by side
    together = judge(run_of(draws, groups=10), standard_normal(1)).effective_worst
    # The mean of ten walkers with a common half varies by 0.5 + 0.5 / 10, over 2 x 1000 independent iterations.
    assert together == pytest.approx(2000 / 0.55, rel=0.15)
    assert float(az.ess(draws[..., 0])) > 15_000


@pytest.mark.parametrize(("package", "sampler"), [("emcee", "emcee"), ("pints", "PINTS Haario-Bardenet")])
def test_outside_samplers_count_what_they_ask_for(beam: Problem, package: str, sampler: str, monkeypatch) -> None:
    pytest.importorskip(package)
    asked = []
    call = LogDensity.__call__
    monkeypatch.setattr(LogDensity, "__call__", lambda self, vector: (asked.append(1), call(self, vector))[1])
    run = algorithms.SAMPLERS[sampler](beam, 480, 1)
    assert run.simulations == len(asked) == pytest.approx(480, abs=16)
    low, high = np.array(list(beam.bounds.values())).T
    assert np.all((run.draws > low) & (run.draws < high))


# The wrong density piles up at a bound, where nothing is left for PINTS to take a covariance from.
@pytest.mark.filterwarnings("ignore:covariance is not symmetric:RuntimeWarning")
@pytest.mark.filterwarnings("ignore:overflow encountered in multiply:RuntimeWarning")
def test_sampler_on_the_density_without_jacobian_is_flagged(beam: Problem) -> None:
    pytest.importorskip("pints")
    grid = integrate_grid(beam, 100)
    right, wrong = algorithms.run_pints(beam, 4000, 1), algorithms.run_control(beam, 4000, 1)
    assert not judge(right, grid).is_flagged
    assert judge(wrong, grid).is_flagged


def test_evidence_is_read_past_the_padding() -> None:
    assert algorithms.last_finite([np.nan, None, -3.0, -2.5, np.nan, None]) == -2.5
