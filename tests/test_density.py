"""Densities over a population: estimators, the compiled evaluation, and the spread that each kind gives back."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys

import numba
import numpy as np
import pytest
import xarray as xr
from scipy import special, stats

from pymc_backbone._common.checks import InputError
from pymc_backbone.likelihood import density_joint
from pymc_backbone.likelihood import density_kernel as kernel
from pymc_backbone.likelihood.density import Density, log_density
from pymc_backbone.likelihood.density_fit import fit_density
from pymc_backbone.likelihood.density_joint import principal_directions
from pymc_backbone.likelihood.density_marginals import fit_gev, fit_kde, fit_uniform, kernel_bandwidth

OBSERVABLES = ("frequency", "damping")


def dataset(value, levels=None, observables=OBSERVABLES, standard_error=None, covariance=None):
    """Backbones at levels as a Dataset."""
    n, o, k = value.shape
    levels = np.geomspace(0.01, 0.1, k) if levels is None else levels
    variables = {"value": (("specimen", "observable", "level"), value)}
    if standard_error is not None:
        variables["standard_error"] = (
            ("specimen", "observable", "level"),
            np.broadcast_to(standard_error, value.shape),
        )
    if covariance is not None:
        variables["covariance"] = (
            ("specimen", "observable", "level", "level_other"),
            np.broadcast_to(covariance, (n, o, k, k)),
        )
    return xr.Dataset(variables, {"observable": list(observables[:o]), "level": levels})


def one(sample, **options):
    """Density of a single observable at a single level."""
    return fit_density(dataset(np.asarray(sample)[:, None, None]), **options)


def at(density, x):
    """Log density of a one-value density on a grid."""
    return density.log_density(np.asarray(x)[:, None, None])


def duffing(parameters, levels):
    """Closed-form backbones (first-order averaging) of k1, k3, c with unit mass: frequency [Hz], damping [-]."""
    k1, k3, c = (parameters[..., i, None] for i in range(3))
    omega = np.sqrt(k1 + 0.75 * k3 * levels**2)
    return np.stack([omega / (2 * np.pi), 2 * np.pi * c / omega], axis=-2)


MEAN = np.array([6000.0, 6.0e6, 0.8])
SPREAD = 0.025 * MEAN


def linear_map(levels):
    """Derivative of `duffing` at the mean, (o, l, 3)."""
    steps = 1e-4 * np.diag(MEAN)
    return np.stack([(duffing(MEAN + s, levels) - duffing(MEAN - s, levels)) / (2 * s.sum()) for s in steps], axis=-1)


def standardised(z):
    """Sample with exactly zero mean and unit covariance (divisor n - 1): no sampling error blurs a comparison."""
    z = z - z.mean(axis=0)
    return z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / (len(z) - 1))).T


def recovered_spread(density, model, n_grid=41, width=4.5):
    """Standard deviations of the parameters under density(model(parameters)), flat prior, summed over a grid."""
    axis = np.linspace(-width, width, n_grid)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    log_weight = density.log_density(model(MEAN + SPREAD * grid))
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    return np.sqrt(weight @ (grid - weight @ grid) ** 2) * SPREAD


# --- marginals against SciPy ------------------------------------------------------------------------------------------


def test_uniform_is_the_unbiased_support(rng):
    low, high = zip(*(fit_uniform(rng.uniform(2.0, 5.0, 8)) for _ in range(4000)), strict=True)
    # Standard error of the mean end: 3 * sd(Beta(1, 8)) * 9 / 7 / sqrt(4000) = 6e-3; four of them.
    assert np.mean(low) == pytest.approx(2.0, abs=0.024)
    assert np.mean(high) == pytest.approx(5.0, abs=0.024)


def test_uniform_and_normal_match_scipy(rng):
    sample = rng.normal(12.0, 0.3, 50)
    x = np.linspace(10.0, 14.0, 201)
    density = one(sample, marginal="normal")
    np.testing.assert_allclose(
        at(density, x), stats.norm(sample.mean(), sample.std(ddof=1)).logpdf(x), rtol=1e-13, atol=1e-13
    )
    density = one(sample, marginal="uniform")
    low, high = density.table[:2]
    np.testing.assert_allclose(at(density, x), stats.uniform(low, high - low).logpdf(x), rtol=1e-13, atol=1e-13)
    assert np.isneginf(at(density, [low - 1e-9, high + 1e-9])).all()
    assert np.isfinite(at(density, [low, high])).all()


@pytest.mark.parametrize("shape", [-0.9, -0.5, -0.2, -1e-4, -1e-8, -1e-14, 0.0, 1e-14, 1e-8, 1e-4, 0.2, 0.9])
def test_gev_matches_scipy(shape):
    location, scale = 1.6, 0.08
    codes = np.array([kernel.PRODUCT, 1, kernel.GEV, 0, 4])
    table = np.array([location, scale, shape, -np.log(scale)])
    x = location + scale * np.linspace(-2.0, 4.0, 61)
    result, gradients = np.empty(61), np.empty((61, 1))
    kernel.log_density_batch(codes, table, x[:, None], result, gradients)
    expected = stats.genextreme(-shape, location, scale).logpdf(x)
    np.testing.assert_array_equal(np.isfinite(result), np.isfinite(expected))
    inside = np.isfinite(expected)
    # SciPy rounds differently near the ends of the support, where the log density runs off.
    np.testing.assert_allclose(result[inside], expected[inside], rtol=1e-10, atol=1e-10)
    assert np.all(gradients[~inside] == 0.0)


def test_gev_is_continuous_through_shape_zero():
    def value(shape):
        gradient = np.empty(1)
        table = np.array([0.0, 1.0, shape, 0.0])
        return log_density(np.array([kernel.PRODUCT, 1, kernel.GEV, 0, 4]), table, np.array([1.3]), gradient), gradient[
            0
        ]

    for shape in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 1e-30, 1e-310):
        for sign in (-1.0, 1.0):
            # |d log f / d shape| is below 1 here; 1e-15 covers rounding.
            np.testing.assert_allclose(value(sign * shape), value(0.0), rtol=0, atol=shape + 1e-15)


@pytest.mark.parametrize("shape", [-0.7, -0.25, 0.0, 0.25, 0.6])
def test_gev_recovers_known_parameters(shape, rng):
    sample = stats.genextreme(-shape, 1.6, 0.08).rvs(4000, random_state=rng)
    location, scale, fitted = fit_gev(sample)
    # Four standard errors at n = 4000 (asymptotic: sd(xi) about 0.013, location and scale about 0.02 and 0.016 scales).
    assert fitted == pytest.approx(shape, abs=0.055)
    assert location == pytest.approx(1.6, abs=0.08 * 0.08)
    assert scale == pytest.approx(0.08, rel=0.08)


@pytest.mark.parametrize("n", [8, 12, 40, 300])
def test_gev_is_at_least_as_likely_as_scipy(n, rng):
    for sample in (rng.normal(size=n), rng.uniform(size=n), rng.gamma(1.5, size=n), -rng.gamma(1.5, size=n)):
        location, scale, shape = fit_gev(sample)
        mine = stats.genextreme(-shape, location, scale).logpdf(sample).sum()
        c, other_location, other_scale = stats.genextreme.fit(sample)
        if -0.95 <= -c <= 1.0:  # SciPy may go where the likelihood has no bound
            assert mine >= stats.genextreme(c, other_location, other_scale).logpdf(sample).sum() - 1e-6
        assert np.isfinite(mine)
        assert -0.95 <= shape <= 1.0


@pytest.mark.parametrize("n", [5, 8, 30, 200])
@pytest.mark.parametrize("shape", ["normal", "uniform", "two humps", "skew", "tied"])
def test_kde_keeps_mean_and_variance(n, shape, rng):
    sample = {
        "normal": rng.normal(size=n),
        "uniform": rng.uniform(size=n),
        "two humps": rng.normal(size=n) * 0.2 + np.arange(n) % 2 * 3,
        "skew": rng.exponential(size=n),
        "tied": np.round(rng.normal(size=n)) + np.arange(n) % 2,
    }[shape]
    bandwidth, centres, _ = fit_kde(sample)
    assert centres.mean() == pytest.approx(sample.mean(), abs=1e-12)
    assert centres.var() + bandwidth**2 == pytest.approx(sample.var(ddof=1), rel=1e-12)


def test_kde_sees_two_humps_and_integrates_to_one(rng):
    sample = rng.normal(size=60) * 0.2 + np.arange(60) % 2 * 3
    pdf = one(sample, marginal="kde").marginal("frequency", 0)
    x = np.linspace(-4, 7, 4001)
    assert np.trapezoid(pdf(x), x) == pytest.approx(1.0, abs=1e-10)
    assert pdf(1.5) < 0.05 * pdf(0.0)
    # The mixture itself, term by term.
    bandwidth, centres, _ = fit_kde(sample)
    np.testing.assert_allclose(
        pdf(x), stats.norm(centres, bandwidth).pdf(x[:, None]).mean(axis=1), rtol=1e-11, atol=1e-300
    )


def test_kde_never_underflows_and_points_back(rng):
    density = one(rng.uniform(size=30), marginal="kde")
    far = np.array([-1e6, -50.0, 50.0, 1e6])
    assert np.isfinite(at(density, far)).all()
    np.testing.assert_array_equal(np.sign(density.gradient(far[:, None, None])[:, 0, 0]), [1, 1, -1, -1])


def test_kernel_bandwidth_matches_leaving_out_by_hand(rng):
    z = standardised(rng.standard_normal((12, 2)))
    bandwidth, score = kernel_bandwidth(z)
    total = 0.0
    for i in range(12):
        rest = np.delete(z, i, axis=0)
        mean, covariance = rest.mean(axis=0), np.cov(rest.T)
        centres = mean + np.sqrt((1 - bandwidth**2) * 11 / 10) * (rest - mean)
        total += np.log(np.mean([stats.multivariate_normal(c, bandwidth**2 * covariance).pdf(z[i]) for c in centres]))
    assert score == pytest.approx(total, rel=1e-12)
    assert bandwidth <= 1.0


# --- choice by information criterion ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("family", "draw"),
    [
        ("uniform", lambda rng: rng.uniform(11.0, 13.0, 60)),
        ("normal", lambda rng: rng.normal(12.0, 0.3, 60)),
        ("gev", lambda rng: stats.genextreme(-0.2, 1.6, 0.08).rvs(200, random_state=rng)),
    ],
)
def test_best_picks_the_family(family, draw, rng):
    picks = [one(draw(rng)).summary()[0]["family"] for _ in range(20)]
    # BIC's error rate here is a few per cent; 16 of 20 leaves room for bad luck and none for a wrong rule.
    assert picks.count(family) >= 16


def test_best_has_the_lowest_criterion_and_says_what_it_compared(rng):
    sample = rng.normal(12.0, 0.3, 60)
    for criterion, penalty in (("bic", np.log(60)), ("aic", 2.0)):
        row = one(sample, criterion=criterion).summary()[0]
        assert set(row["candidates"]) == {"uniform", "normal", "gev"}
        assert row["value"] == min(row["candidates"].values())
        normal = stats.norm(sample.mean(), sample.std(ddof=1)).logpdf(sample).sum()
        assert row["candidates"]["normal"] == pytest.approx(2 * penalty - 2 * normal, rel=1e-12)
    assert set(one(sample[:7]).summary()[0]["candidates"]) == {"uniform", "normal"}


# --- the compiled function --------------------------------------------------------------------------------------------


def population(rng, n=40, n_levels=4, noise=0.0):
    levels = np.geomspace(0.005, 0.05, n_levels)
    value = duffing(MEAN + 2 * SPREAD * rng.standard_normal((n, 3)), levels)
    error = noise * np.abs(value.mean(axis=0))
    return dataset(value + error * rng.standard_normal(value.shape), levels, standard_error=error), value


ALL = [
    ("product", "uniform"),
    ("product", "normal"),
    ("product", "kde"),
    ("product", "gev"),
    ("joint", "normal"),
    ("joint", "kde"),
]


@pytest.mark.parametrize(("kind", "marginal"), ALL)
def test_gradient_matches_differences(kind, marginal, rng):
    backbones, value = population(rng, noise=2e-3)
    if marginal == "kde":  # flat parameters, so that the kernels are narrower than the normal limit
        levels = backbones["level"].values
        value = duffing(MEAN + 4 * SPREAD * rng.uniform(-1, 1, (80, 3)), levels)
        backbones = dataset(value, levels)
    density = fit_density(backbones, kind, marginal)
    y = value[3]
    gradient = density.gradient(y)
    step = 1e-5 * value.std(axis=0)
    differences = np.empty(density.shape)
    for index in np.ndindex(*density.shape):
        shift = np.zeros(density.shape)
        shift[index] = step[index]
        differences[index] = (density.log_density(y + shift) - density.log_density(y - shift)) / (2 * step[index])
    # Central differences: rounding 1e-16 x |log f| / 1e-5 and curvature 1e-10, both relative to 1 / standard deviation.
    np.testing.assert_allclose(gradient * value.std(axis=0), differences * value.std(axis=0), atol=2e-7, rtol=2e-7)


@pytest.mark.parametrize(("kind", "marginal"), ALL)
def test_never_nan_and_zero_gradient_outside(kind, marginal, rng):
    backbones, value = population(rng)
    density = fit_density(backbones, kind, marginal)
    for bad in (np.nan, np.inf, -np.inf, 1e200, -1e200, 1e308, -1e308):
        for index in range(8):
            y, gradient = value[0].ravel().copy(), np.full(8, 7.0)
            y[index] = bad
            result = log_density(density.codes, density.table, y, gradient)
            assert not np.isnan(result)
            assert np.isneginf(result)
            assert not gradient.any()
    assert np.isneginf(log_density(density.codes, density.table, np.full(8, 1e308), np.empty(8)))
    # Far away, but not so far that squares overflow, nothing but a hard end of the support freezes a chain.
    if marginal in ("normal", "kde"):
        assert np.isfinite(density.log_density(value[0] * 10.0))


@numba.njit
def _calls_log_density(codes, table, y, gradient):
    return 2.0 * log_density(codes, table, y, gradient)


def test_usable_inside_compiled_code(rng):
    backbones, value = population(rng)
    for kind, marginal in ALL:
        density = fit_density(backbones, kind, marginal)
        y, gradient = value[0].ravel(), np.empty(8)
        result = _calls_log_density(density.codes, density.table, y, gradient)
        assert result == 2.0 * density.log_density(value[0])
        np.testing.assert_array_equal(gradient.reshape(2, 4), density.gradient(value[0]))
        np.testing.assert_array_equal(y, value[0].ravel())


def test_values_of_any_leading_shape(rng):
    backbones, value = population(rng)
    density = fit_density(backbones, "joint")
    stacked = value[:6].reshape(2, 3, 2, 4)
    assert density.log_density(stacked).shape == (2, 3)
    assert density.gradient(stacked).shape == (2, 3, 2, 4)
    assert density.log_density(value[:0]).shape == (0,)
    assert density.log_density(stacked)[1, 2] == density.log_density(value[5])
    with pytest.raises(InputError, match=r"\(2, 4\), got shape \(4, 2\)"):
        density.log_density(value[0].T)


# --- the joint density ------------------------------------------------------------------------------------------------


def test_joint_normal_is_the_multivariate_normal(rng):
    """Full-rank population: every direction belongs to it, and the oracle is SciPy's."""
    value = (rng.standard_normal((60, 6)) @ rng.standard_normal((6, 6)) + 12.0).reshape(60, 2, 3)
    density = fit_density(dataset(value), "joint", "normal")
    flat = value.reshape(60, 6)
    oracle = stats.multivariate_normal(flat.mean(axis=0), np.cov(flat.T))
    x = rng.standard_normal((50, 6)) * 3 + 12
    np.testing.assert_allclose(density.log_density(x.reshape(50, 2, 3)), oracle.logpdf(x), rtol=1e-9)


def test_joint_kde_is_the_shrunk_mixture_and_keeps_mean_and_covariance(rng):
    flat = rng.uniform(-1, 1, (150, 4)) @ rng.standard_normal((4, 4)) + 5.0
    density = fit_density(dataset(flat.reshape(150, 2, 2)), "joint", "kde")
    bandwidth, mean, whitening, centres = density._joint_parts()
    assert 0.1 < bandwidth < 0.9
    assert centres.shape == (150, 4)
    back = np.linalg.inv(whitening)
    covariance = back @ (centres.T @ centres / 150 + bandwidth**2 * np.eye(4)) @ back.T
    np.testing.assert_allclose(mean + back @ centres.mean(axis=0), flat.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(covariance, np.cov(flat.T), rtol=1e-11, atol=1e-12)
    kernels = [stats.multivariate_normal(mean + back @ c, bandwidth**2 * back @ back.T) for c in centres]
    x = rng.uniform(3, 7, (20, 4))
    expected = special.logsumexp([k.logpdf(x) for k in kernels], axis=0) - np.log(150)
    np.testing.assert_allclose(density.log_density(x.reshape(20, 2, 2)), expected, rtol=1e-9)


@pytest.mark.parametrize(("kind", "marginal"), ALL)
def test_marginals_and_samples_agree_with_the_density(kind, marginal, rng, random_seed):
    backbones, _ = population(rng, noise=2e-3)
    density = fit_density(backbones, kind, marginal)
    draws = density.sample(4000, random_seed)
    assert draws.shape == (4000, 2, 4)
    np.testing.assert_array_equal(draws, density.sample(4000, random_seed))
    assert np.isfinite(density.log_density(draws)).all()
    for observable, level in (("frequency", 0), ("damping", -1)):
        column = np.sort(draws[:, OBSERVABLES.index(observable), level])
        width = np.ptp(column)
        x = np.linspace(column[0] - width, column[-1] + width, 20001)
        pdf = density.marginal(observable, level)(x)
        cdf = np.concatenate([[0.0], np.cumsum(0.5 * (pdf[1:] + pdf[:-1]) * np.diff(x))])
        assert cdf[-1] == pytest.approx(1.0, abs=2e-3)  # a heavy tail may reach beyond the grid
        distance = np.abs(np.interp(column, x, cdf) - (np.arange(4000) + 0.5) / 4000).max()
        assert distance < 1.95 / np.sqrt(4000)  # Kolmogorov's 0.1 % limit


def linear_population(n, n_levels, rng):
    """A Gaussian population seen through the linearised Duffing map; sample moments exactly as stated."""
    levels = np.geomspace(0.005, 0.05, n_levels)
    jacobian = linear_map(levels)
    centre = duffing(MEAN, levels)

    def model(parameters):
        return centre + np.einsum("okp,...p->...ok", jacobian, parameters - MEAN)

    return dataset(model(MEAN + SPREAD * standardised(rng.standard_normal((n, 3)))), levels), model


def test_product_narrows_with_every_level_and_joint_does_not(rng):
    """The paper's product counts the parameters once per level: sd(k1) 145, 110, 79 at 2, 3, 6 levels; truth 150."""
    product, joint = [], []
    for n_levels in (2, 3, 6):
        backbones, model = linear_population(200, n_levels, rng)
        product.append(recovered_spread(fit_density(backbones, "product", "normal"), model)[0])
        joint.append(recovered_spread(fit_density(backbones, "joint"), model))
    # Closed form: inverse of the sum over values of j j' / (j' C j), with j the rows of the linear map.
    closed = []
    for n_levels in (2, 3, 6):
        rows = linear_map(np.geomspace(0.005, 0.05, n_levels)).reshape(-1, 3) * SPREAD
        precision = (rows.T / (rows**2).sum(axis=1)) @ rows
        closed.append(np.sqrt(np.linalg.inv(precision)[0, 0]) * SPREAD[0])
    np.testing.assert_allclose(product, closed, rtol=0.01)  # the grid ends at 4.5 standard deviations
    np.testing.assert_allclose(product, [145.0, 110.0, 79.0], atol=1.0)
    # The sample's moments are exact and the map is linear: nothing but the kernels' finite number is left.
    np.testing.assert_allclose(joint, np.tile(SPREAD, (3, 1)), rtol=0.005)


@pytest.mark.parametrize("n_levels", [2, 3, 6])
@pytest.mark.parametrize("variation", [0.025, 0.06])
def test_joint_keeps_the_spread_through_the_curved_map(n_levels, variation, rng):
    levels = np.geomspace(0.005, 0.05, n_levels)
    scores = standardised(rng.standard_normal((200, 3)))
    value = duffing(MEAN * (1 + variation * scores), levels)
    spread = recovered_spread(
        fit_density(dataset(value, levels), "joint"),
        lambda p: duffing(MEAN + (p - MEAN) * variation / 0.025, levels),
    )
    # Curvature costs up to 1.6 % at 2.5 % variation and 4 % at 6 % (whitened without the floor: 16 %).
    np.testing.assert_allclose(spread, SPREAD, rtol=0.025 if variation < 0.05 else 0.05)


def test_without_the_floor_curvature_narrows(rng, monkeypatch):
    """Negative control: what the floor of 0.1 is for."""
    monkeypatch.setattr(density_joint, "RELATIVE_FLOOR", 1e-3)
    levels = np.geomspace(0.005, 0.05, 6)
    value = duffing(MEAN + SPREAD * standardised(rng.standard_normal((200, 3))), levels)
    spread = recovered_spread(fit_density(dataset(value, levels), "joint"), lambda p: duffing(p, levels))
    assert spread[0] < 0.93 * SPREAD[0]


def test_joint_keeps_the_spread_of_flat_parameters(rng):
    levels = np.geomspace(0.005, 0.05, 6)
    value = duffing(MEAN + SPREAD * standardised(rng.uniform(-1, 1, (200, 3))), levels)
    density = fit_density(dataset(value, levels), "joint")
    assert density.codes[2] == 3  # kernels, not the normal limit
    np.testing.assert_allclose(recovered_spread(density, lambda p: duffing(p, levels)), SPREAD, rtol=0.025)


@pytest.mark.parametrize(("n", "tolerance"), [(10, 0.08), (30, 0.06), (200, 0.04)])
def test_joint_takes_measurement_error_out(n, tolerance, rng):
    """Mean over batches: noise as large as the population's own spread in the weaker directions."""
    levels = np.geomspace(0.005, 0.05, 6)
    ratio, kept = [], []
    for _ in range(8):
        scores = standardised(rng.standard_normal((n, 3)))
        clean = duffing(MEAN + SPREAD * scores, levels)
        error = np.array([[2e-3], [2e-2]]) * clean.mean(axis=0)
        noisy = dataset(clean + error * rng.standard_normal(clean.shape), levels, standard_error=error)
        for result, subtract in ((ratio, True), (kept, False)):
            density = fit_density(noisy, "joint", subtract_measurement=subtract)
            result.append(recovered_spread(density, lambda p: duffing(p, levels), n_grid=31) / SPREAD)
    np.testing.assert_allclose(np.mean(ratio, axis=0), 1.0, atol=tolerance)
    assert np.mean(kept, axis=0)[2] > np.mean(ratio, axis=0)[2]


def test_covariance_is_used_before_standard_errors(rng):
    backbones, value = population(rng, noise=2e-3)
    error = backbones["standard_error"].values[0]
    diagonal = error[:, :, None] ** 2 * np.eye(4)
    same = fit_density(dataset(backbones["value"].values, backbones["level"].values, covariance=diagonal), "joint")
    np.testing.assert_allclose(
        same.log_density(value[:5]), fit_density(backbones, "joint").log_density(value[:5]), rtol=1e-9
    )
    full = diagonal + 0.9 * error[:, :, None] * error[:, None, :] * (1 - np.eye(4))
    other = fit_density(dataset(backbones["value"].values, backbones["level"].values, covariance=full), "joint")
    assert other != same


def test_pure_measurement_noise_has_no_population_directions(rng):
    value = 12.0 + 0.1 * rng.standard_normal((40, 2, 5))
    assert principal_directions(value.reshape(40, 10), 0.01 * np.eye(10), True).n_population == 0
    density = fit_density(dataset(value, standard_error=np.full((2, 5), 0.1)), "joint")
    assert "0 population directions" in density.description
    assert np.isfinite(density.log_density(value)).all()


# --- invariances ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "marginal"), ALL)
def test_units_change_nothing_but_the_jacobian(kind, marginal, rng):
    backbones, value = population(rng, noise=2e-3)
    factor = np.array([2 * np.pi, 1e-3])[:, None]  # Hz to rad/s; decrement in thousands
    scaled = backbones.copy()
    for name in ("value", "standard_error"):
        scaled[name] = backbones[name] * xr.DataArray(factor[:, 0], dims="observable")
    first = fit_density(backbones, kind, marginal).log_density(value[:10])
    second = fit_density(scaled, kind, marginal).log_density(factor * value[:10])
    # The GEV search stops at 1e-9 of a standard deviation; all others are exact to rounding.
    np.testing.assert_allclose(second + 4 * np.log(factor).sum(), first, rtol=1e-6 if marginal == "gev" else 1e-9)


@pytest.mark.parametrize(("kind", "marginal"), [*ALL, ("product", "best")])
def test_order_of_specimens_changes_no_bit(kind, marginal, rng):
    backbones, _ = population(rng, n=20)
    shuffled = backbones.isel(specimen=rng.permutation(20))
    assert fit_density(shuffled, kind, marginal) == fit_density(backbones, kind, marginal)


# --- plain data -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "marginal"), [("product", "best"), ("product", "kde"), ("joint", "best")])
def test_round_trips(kind, marginal, rng):
    backbones, value = population(rng)
    density = fit_density(backbones, kind, marginal)
    for other in (pickle.loads(pickle.dumps(density)), Density.from_dict(json.loads(json.dumps(density.to_dict())))):
        assert other == density
        assert hash(other) == hash(density)
        assert other.summary() == density.summary()
        assert other.codes.dtype == np.int64
        assert other.table.dtype == np.float64
        assert other.codes.flags.c_contiguous
        assert other.table.flags.c_contiguous
        np.testing.assert_array_equal(other.log_density(value), density.log_density(value))
    assert density != fit_density(backbones, kind, marginal, observables="frequency")
    assert density != 3
    assert len(density.digest()) == 64


def test_digest_does_not_depend_on_the_process(rng):
    sample = np.round(rng.normal(12.0, 0.3, 20), 6)
    code = (
        "import numpy as np, xarray as xr; from pymc_backbone.likelihood.density_fit import fit_density;"
        f"v = np.array({sample.tolist()})[:, None, None];"
        "c = {'observable': ['frequency'], 'level': [0.01]};"
        "d = xr.Dataset({'value': (('specimen', 'observable', 'level'), v)}, c);"
        "print(fit_density(d).digest())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == one(sample).digest()


def test_broken_data_is_refused(rng):
    data = fit_density(population(rng)[0], "joint").to_dict()
    with pytest.raises(InputError, match="numbers that do not"):
        Density.from_dict({**data, "table": data["table"][:-1]})
    with pytest.raises(InputError, match="it has no table"):
        Density.from_dict({key: value for key, value in data.items() if key != "table"})


def test_observables_and_partial_levels(rng):
    backbones, _ = population(rng)
    value = backbones["value"].values.copy()
    value[:10, :, 3] = np.nan
    backbones = dataset(value, backbones["level"].values)
    density = fit_density(backbones, marginal="normal", observables=["damping"])
    assert density.observables == ("damping",)
    assert [row["n_specimens"] for row in density.summary()] == [40, 40, 40, 30]
    assert "30 to 40 specimens" in density.description
    assert density.table[0] == pytest.approx(value[:, 1, 0].mean())
    joint = fit_density(backbones, "joint")
    assert "from 30 of 40 specimens" in joint.description


# --- what a user can get wrong ----------------------------------------------------------------------------------------


def test_errors_name_the_place_and_the_remedy(rng):
    backbones, _ = population(rng, n=12)
    levels = backbones["level"].values
    with pytest.raises(InputError, match="Did you mean 'normal'"):
        fit_density(backbones, marginal="norml")
    with pytest.raises(InputError, match="`kind` must be one of product, joint"):
        fit_density(backbones, kind="mixture")
    with pytest.raises(InputError, match="`criterion`"):
        fit_density(backbones, criterion="dic")
    with pytest.raises(InputError, match="best, kde or normal"):
        fit_density(backbones, kind="joint", marginal="gev")
    with pytest.raises(InputError, match="frequency, damping; got 'offset'"):
        fit_density(backbones, observables="offset")
    with pytest.raises(InputError, match=r"xarray.Dataset.*got dict"):
        fit_density({"value": 1})
    with pytest.raises(InputError, match="must have the dims"):
        fit_density(backbones.rename(level="amplitude"))

    value = backbones["value"].values.copy()
    value[:7, 1, 2] = np.nan
    few = dataset(value, levels)
    with pytest.raises(InputError, match=rf"got 5 that reach level {levels[2]:g} in damping.*marginal='normal'"):
        fit_density(few, marginal="gev")
    fit_density(few, marginal="normal")
    value[:11, 1, 2] = np.nan
    with pytest.raises(InputError, match=rf"at least 3 .* got 1 that reach level {levels[2]:g} in damping. Drop that"):
        fit_density(dataset(value, levels))
    with pytest.raises(InputError, match=rf"got 1 of 12; fewest, 1, reach level {levels[2]:g} in damping"):
        fit_density(dataset(value, levels), "joint")

    value = backbones["value"].values.copy()
    value[:, 0, 1] = 12.5
    for kind in ("product", "joint"):
        with pytest.raises(InputError, match=rf"frequency from 12.5 to 12.5 at level {levels[1]:g}"):
            fit_density(dataset(value, levels), kind)
    value[3, 0, 1] = np.inf
    with pytest.raises(InputError, match=rf"got inf for frequency of specimen 3 at level {levels[1]:g}"):
        fit_density(dataset(value, levels))
    offset = 1e-14 * rng.standard_normal((12, 1, 4))
    with pytest.raises(InputError, match="Leave offset out"):
        fit_density(dataset(offset, levels, observables=("offset",)))
    broken = backbones.copy()
    broken["standard_error"] = broken["standard_error"] * np.nan
    with pytest.raises(InputError, match="finite standard_error"):
        fit_density(broken, "joint")

    density = fit_density(backbones, marginal="normal")
    with pytest.raises(InputError, match="`level_index`"):
        density.marginal("damping", 4)
    with pytest.raises(InputError, match="`observable`"):
        density.marginal("offset", 0)
