"""The data-consistent density: known populations come back with their correlation; what is open stays the prior's."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from pymc_backbone import InputError, Oscillator, build_model, sample
from pymc_backbone.likelihood.data_consistent import fit_data_consistent
from pymc_backbone.likelihood.density import Density
from pymc_backbone.likelihood.density_fit import fit_density
from pymc_backbone.simulation.backbones import simulate_population

DUFFING = Oscillator(1.0, "cubic_stiffness")
LEVELS = np.geomspace(0.01, 0.1, 4)
BOUNDS = {"linear_stiffness": (5400.0, 7700.0), "viscous_damping": (0.1, 3.0), "cubic_stiffness": (5.2e6, 7.2e6)}


def correlated(count: int, rng: np.random.Generator, correlation: float = 0.7) -> np.ndarray:
    """Return vectors whose linear and cubic stiffness are Gaussian and correlated."""
    z = rng.standard_normal((count, 3))
    z[:, 2] = correlation * z[:, 0] + np.sqrt(1.0 - correlation**2) * z[:, 2]
    return np.array([6500.0, 1.4, 6.2e6]) + z * np.array([150.0, 0.25, 1.5e5])


def weighted_moments(density: Density, observables, rng, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of draws of the prior weighted with the density: an estimate without a sampler."""
    low, high = np.array(list(BOUNDS.values())).T
    vectors = rng.uniform(low, high, (count, 3))
    values = np.asarray(simulate_population(DUFFING, vectors, LEVELS, observables)["value"])
    logs = density.log_density(values)
    weights = np.exp(logs - logs.max())
    mean = np.average(vectors, axis=0, weights=weights)
    return mean, np.cov(vectors.T, aweights=weights)


@pytest.fixture(scope="module")
def population() -> tuple[np.ndarray, xr.Dataset]:
    vectors = correlated(150, np.random.default_rng(11))
    return vectors, simulate_population(DUFFING, vectors, LEVELS)


@pytest.fixture(scope="module")
def density(population) -> Density:
    return fit_data_consistent(DUFFING, population[1], BOUNDS)


def test_population_comes_back_through_the_sampler(population, density):
    """Mean within 0.1 sd, sd within 5 %, correlation within 0.05; some thousand effective draws are a third of that."""
    vectors = population[0]
    posterior = sample(
        build_model(DUFFING, density, BOUNDS), draws=1500, tune=600, chains=2, step="nutpie", random_seed=3
    )
    draws = np.column_stack([np.ravel(posterior["posterior"][name]) for name in DUFFING.parameter_names])
    sd = vectors.std(axis=0)
    assert np.all(np.abs(draws.mean(axis=0) - vectors.mean(axis=0)) < 0.1 * sd)
    assert draws.std(axis=0) / sd == pytest.approx(np.ones(3), abs=0.05)
    assert np.corrcoef(draws.T)[0, 2] == pytest.approx(np.corrcoef(vectors.T)[0, 2], abs=0.05)


def test_product_narrows_what_data_consistent_keeps(population, density, rng):
    """Negative control: the product of normal densities over four levels comes back much too narrow."""
    vectors, backbones = population
    narrow = weighted_moments(fit_density(backbones, marginal="normal"), ("frequency", "damping"), rng)[1]
    kept = weighted_moments(density, ("frequency", "damping"), rng)[1]
    true = vectors[:, 1].std()
    assert np.sqrt(narrow[1, 1]) < 0.75 * true
    assert np.sqrt(kept[1, 1]) == pytest.approx(true, rel=0.15)  # a few hundred effective draws


def test_diagnostics_say_what_was_found(population, density):
    found = density.diagnostics
    assert found["directions"] == 3 and found["undetermined"] == []
    assert found["mean_ratio"] == pytest.approx(1.0, abs=0.35)
    vectors = population[0]
    for j, name in enumerate(DUFFING.parameter_names):
        assert found["mean"][name] == pytest.approx(vectors[:, j].mean(), abs=0.03 * vectors[:, j].std())
        assert found["sd"][name] == pytest.approx(vectors[:, j].std(), rel=0.03)


def test_parameters_that_the_backbones_do_not_see_keep_the_prior(population, rng):
    vectors, backbones = population
    frequency = fit_data_consistent(DUFFING, backbones, BOUNDS, observables=["frequency"], draws=2048)
    assert frequency.diagnostics["undetermined"] == ["viscous_damping"]
    assert frequency.diagnostics["directions"] == 2
    mean, covariance = weighted_moments(frequency, ("frequency",), rng)
    low, high = BOUNDS["viscous_damping"]
    assert np.sqrt(covariance[1, 1]) == pytest.approx((high - low) / np.sqrt(12.0), rel=0.1)
    assert mean[0] == pytest.approx(vectors[:, 0].mean(), abs=0.2 * vectors[:, 0].std())


def test_measurement_error_is_taken_out_of_the_spread(population, rng):
    """Noise as large as a third of the spread: with it subtracted the sd is the population's, kept it is 5 % more."""
    vectors, backbones = population
    value = np.asarray(backbones["value"])
    error = value.std(axis=0) * 0.5
    noisy = backbones.copy(deep=True)
    noisy["value"] = (backbones["value"].dims, value + rng.standard_normal(value.shape) * error)
    noisy["standard_error"] = (backbones["value"].dims, np.broadcast_to(error, value.shape).copy())
    eye = np.eye(LEVELS.size)
    noisy["covariance"] = (
        backbones["covariance"].dims,
        np.broadcast_to((error**2)[..., None] * eye, (*value.shape, 4)),
    )
    sd = {}
    for subtract in (True, False):
        fitted = fit_data_consistent(DUFFING, noisy, BOUNDS, subtract_measurement=subtract, draws=4096)
        sd[subtract] = fitted.diagnostics["sd"]["linear_stiffness"] / vectors[:, 0].std()
    assert sd[True] == pytest.approx(1.0, abs=0.1)
    assert sd[False] > sd[True] + 0.02


def test_gradient_is_the_slope_of_the_density(population, density):
    value = np.asarray(population[1]["value"])[:3]
    slope = density.gradient(value)
    for o, k in np.ndindex(2, LEVELS.size):
        step = np.zeros_like(value)
        step[:, o, k] = 1e-6 * value[:, o, k]
        difference = (density.log_density(value + step) - density.log_density(value - step)) / (2.0 * step[:, o, k])
        assert difference == pytest.approx(slope[:, o, k], rel=1e-4, abs=1e-4 * np.abs(slope).max())


def test_density_falls_away_from_the_population_and_survives_json(population, density):
    value = np.asarray(population[1]["value"])
    away = value.mean(axis=0) + np.linspace(0.0, 40.0, 9)[:, None, None] * value.std(axis=0)
    logs = density.log_density(away)
    assert np.all(np.diff(logs[2:]) < 0.0)
    again = Density.from_dict(density.to_dict())
    assert again == density and again.diagnostics == density.diagnostics
    assert again.log_density(value) == pytest.approx(density.log_density(value), abs=0.0)


def test_sample_and_marginal_are_those_of_the_population(population, density):
    draws = density.sample(4000, random_seed=1)
    value = np.asarray(population[1]["value"])
    assert draws.mean(axis=0) == pytest.approx(value.mean(axis=0), abs=0.1 * value.std(axis=0).max())
    x = np.linspace(value[:, 0, 0].min() - 0.5, value[:, 0, 0].max() + 0.5, 400)
    assert np.trapezoid(density.marginal("frequency", 0)(x), x) == pytest.approx(1.0, abs=1e-3)


def test_build_model_fits_it_with_its_own_priors(population):
    model = build_model(DUFFING, population[1], BOUNDS, density="data_consistent")
    assert {variable.name for variable in model.free_RVs} == set(BOUNDS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bounds": {**BOUNDS, "linear_stiffness": (1e4, 2e4)}}, "add the effect that is missing"),
        ({"bounds": dict(list(BOUNDS.items())[:2])}, "cubic_stiffness missing"),
        ({"backbones": slice(0, 5)}, "needs at least 6 specimens"),
        (
            {"bounds": {"viscous_damping": (0.1, 3.0)}, "observables": ["frequency"],
             "fixed": {"linear_stiffness": 6500.0, "cubic_stiffness": 6.2e6}},
            "determine none",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_fitted_ends_in_a_sentence(population, change, words):
    backbones = population[1].isel(specimen=change.pop("backbones", slice(None)))
    arguments = {"bounds": BOUNDS, "draws": 2048, **change}
    with pytest.raises(InputError, match=words):
        fit_data_consistent(DUFFING, backbones, **arguments)


def test_fit_density_says_where_the_kind_lives(population):
    with pytest.raises(InputError, match="fit_data_consistent"):
        fit_density(population[1], kind="data_consistent")
