"""A bridge between draws of a proposal and of an integrand: closed volumes, honest errors, no wrong trust."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import gammaln
from scipy.stats import norm

from pymc_backbone.discrepancy.weighing.bridge import CHAINS, STEPS, meet, walk
from pymc_backbone.discrepancy.weighing.corrected_evidence import _rounds_and_walks
from pymc_backbone.discrepancy.weighing.importance import LARGEST_K, MOST_ROUNDS, MOST_WALKS, WALK, integrate


def test_two_samples_meet_at_the_closed_volume_with_an_honest_error():
    """Volumes of a Gaussian from one two and a half times as narrow, of whose weights no variance exists."""
    exact, deviations = 1.7, []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        drawn, own = 0.4 * rng.standard_normal(128), rng.standard_normal((CHAINS, 18))

        def ratio(x):
            return exact + norm.logpdf(x) - norm.logpdf(x, scale=0.4)

        log_value, error = meet(ratio(drawn), ratio(own))
        deviations.append((log_value - exact) / error)
    assert abs(np.mean(deviations)) < 0.3
    assert 0.8 < np.std(deviations) < 1.3


def test_correlated_draws_make_the_error_larger():
    rng = np.random.default_rng(1)
    drawn, own = 0.7 * rng.standard_normal(128), rng.standard_normal((CHAINS, 18))
    stuck = np.repeat(own[:, :1], 18, axis=1) + 1e-6 * own

    def ratio(x):
        return norm.logpdf(x) - norm.logpdf(x, scale=0.7)

    assert meet(ratio(drawn), ratio(stuck))[1] > 1.5 * meet(ratio(drawn), ratio(own))[1]


def test_chains_keep_what_they_began_with_where_it_is_the_integrand():
    """Metropolis' rule leaves a distribution as it is; negative control: without the rule they spread."""
    covariance = np.array([[1.0, 0.8], [0.8, 1.0]])
    factor, precise = np.linalg.cholesky(covariance), np.linalg.inv(covariance)

    def log_density(x):
        return -0.5 * np.einsum("ni,ij,nj->n", x, precise, x)

    def spread(f):
        found = []
        for seed in range(60):
            rng = np.random.default_rng(seed)
            points = rng.standard_normal((400, 2)) @ factor.T
            walked = walk(f, points, f(points), np.zeros(400), rng)
            assert walked.points.shape == (CHAINS, STEPS - STEPS // 4, 2)
            assert walked.values == pytest.approx(f(walked.points.reshape(-1, 2)).reshape(walked.values.shape))
            found.append(walked.points.reshape(-1, 2).T @ walked.points.reshape(-1, 2) / walked.values.size)
        return np.mean(found, axis=0)

    assert spread(log_density) == pytest.approx(covariance, abs=0.1)
    assert spread(lambda x: np.zeros(len(x)))[0, 0] > 3.0


@pytest.mark.parametrize("seed", range(4))
def test_a_proposal_eight_standard_deviations_off_is_left_behind(seed):
    """A twentieth as wide as it should be and eight off, no round of mixtures comes there; chains do."""

    def gaussian(x):
        return -0.5 * (x**2).sum(axis=1)

    args = (gaussian, np.full(2, 8.0), 0.05 * np.eye(2), 128)
    lost = integrate(*args, walks=0, random_seed=seed)
    assert lost.log_value < np.log(2.0 * np.pi) - 10.0 and not lost.is_trusted
    found = integrate(*args, random_seed=seed)
    assert found.is_trusted
    assert found.log_value == pytest.approx(np.log(2.0 * np.pi), abs=0.3)
    assert found.draws > lost.draws


def test_tails_that_cannot_be_summed_are_bridged():
    """A Cauchy distribution in four dimensions: its weights have no variance, and most estimates say so."""
    scale = np.array([1.0, 0.1, 2.0, 0.5])

    def heavy(x):
        return -2.5 * np.log1p(((x / scale) ** 2).sum(axis=1))

    exact = gammaln(0.5) - gammaln(2.5) + 2.0 * np.log(np.pi) + np.log(scale).sum()
    bridged = 0
    for seed in range(8):
        alone = integrate(heavy, np.zeros(4), np.diag(0.3 * scale**2), 128, walks=0, random_seed=seed)
        found = integrate(heavy, np.zeros(4), np.diag(0.3 * scale**2), 128, random_seed=seed)
        assert found == alone or not alone.is_trusted
        assert found.log_value == pytest.approx(exact, abs=0.35)  # of tails that nothing reached a sixth is missed
        bridged += found.is_bridged and found.pareto_k > LARGEST_K
    assert bridged >= 2


def test_chains_in_modes_that_do_not_meet_are_not_believed_blindly():
    """Negative control: what trusted bridges say of two modes eight apart is within the error that weights have."""
    exact = np.log(np.sqrt(2.0 * np.pi) * (1.0 + 0.5 * np.exp(3.0)))

    def two(x):
        return np.logaddexp(-0.5 * x[:, 0] ** 2, -2.0 * (x[:, 0] - 8.0) ** 2 + 3.0)

    said = [integrate(two, np.zeros(1), np.eye(1), 64, random_seed=seed) for seed in range(16)]
    bridged = [found for found in said if found.is_bridged]
    assert len(bridged) >= 3
    assert all(abs(found.log_value - exact) < 0.5 for found in bridged)


def test_walks_are_made_of_what_rounds_leave():
    assert _rounds_and_walks(-1.0, 64, 1.0) == (0, 0)
    assert _rounds_and_walks(200.0, 64, 1.0) == (3, 0)
    assert _rounds_and_walks(MOST_ROUNDS * 64 + 2.5 * (WALK + 64), 64, 1.0) == (MOST_ROUNDS, 2)
    assert _rounds_and_walks(1e9, 64, 0.0) == (MOST_ROUNDS, MOST_WALKS)
