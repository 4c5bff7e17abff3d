"""Likelihoods inside PyMC models, against SciPy and against each other; bad input in one sentence."""

from __future__ import annotations

import warnings

import arviz as az
import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy.stats import multivariate_normal

from pymc_backbone import (
    InputError,
    Oscillator,
    backbone_deterministic,
    backbone_likelihood,
    build_model,
    fit_density,
    sample,
    simulate_backbone,
    simulate_population,
)

LEVELS = np.geomspace(0.005, 0.03, 4)
DUFFING = Oscillator(1.0, ["cubic_stiffness"])
TRUTH = {"linear_stiffness": 6500.0, "viscous_damping": 1.1, "cubic_stiffness": 6.25e6}
BOUNDS = {"linear_stiffness": (5000.0, 8000.0), "viscous_damping": (0.1, 3.0), "cubic_stiffness": (4e6, 8e6)}


def batch(rng: np.random.Generator, n: int, scatter: float = 0.02) -> xr.Dataset:
    """Return noise-free backbones of ``n`` specimens scattered about the truth."""
    parameters = np.array(list(TRUTH.values())) * (1.0 + scatter * rng.standard_normal((n, 3)))
    return simulate_population(DUFFING, parameters, LEVELS)


def noisy(rng: np.random.Generator, n: int, scatter: float = 0.0, missing: bool = False) -> xr.Dataset:
    """Return backbones with correlated Gaussian level errors: 0.1 % in frequency, 2 % in damping."""
    data = batch(rng, n, scatter).copy(deep=True)
    values = np.array(data["value"])
    errors = np.stack([1e-3 * values[:, 0], 2e-2 * values[:, 1]], axis=1)
    correlation = 0.4 ** np.abs(np.subtract.outer(range(LEVELS.size), range(LEVELS.size)))
    covariance = errors[..., :, None] * errors[..., None, :] * correlation
    noise = np.einsum("sokl,sol->sok", np.linalg.cholesky(covariance), rng.standard_normal(values.shape))
    values = values + noise
    if missing:
        values[0, :, -1] = np.nan
    return xr.Dataset(
        {
            "value": (("specimen", "observable", "level"), values),
            "standard_error": (("specimen", "observable", "level"), errors),
            "covariance": (("specimen", "observable", "level", "level_other"), covariance),
        },
        coords={
            "specimen": [f"s{i}" for i in range(n)],
            "observable": ["frequency", "damping"],
            "level": LEVELS,
            "level_other": LEVELS,
        },
    )


def total(model: pm.Model, point: dict) -> float:
    """Return the log-likelihood and potentials of ``model`` at natural values, without the priors."""
    log_density = model.compile_logp(vars=[*model.observed_RVs, *model.potentials])
    start = model.initial_point()
    for variable in model.free_RVs:
        transform = model.rvs_to_transforms[variable]
        value = transform.forward(np.asarray(point[variable.name], dtype=float), *variable.owner.inputs)
        start[model.rvs_to_values[variable].name] = value.eval()
    return float(log_density(start))


def test_by_hand_equals_build_model(rng):
    density = fit_density(batch(rng, 20), marginal="normal")
    with pm.Model() as by_hand:
        variables = {name: pm.Uniform(name, *BOUNDS[name]) for name in BOUNDS}
        backbone_likelihood("backbone", DUFFING, density, variables)
    built = build_model(DUFFING, density, BOUNDS)
    blocked = build_model(DUFFING, density, BOUNDS, blocked=True)
    expected = float(density.log_density(simulate_backbone(DUFFING, TRUTH, LEVELS).values[:2]))
    # Values on a level are good to 1e-8 and the density's spread is some per cent of a value.
    assert total(by_hand, TRUTH) == pytest.approx(expected, abs=1e-4)
    assert total(built, TRUTH) == total(by_hand, TRUTH)
    assert total(blocked, {"parameters": list(TRUTH.values())}) == pytest.approx(total(built, TRUTH), abs=1e-6)


@pytest.mark.parametrize("missing", [False, True])
def test_specimen_likelihood_is_the_multivariate_normal(rng, missing):
    data = noisy(rng, 3, missing=missing)
    model = build_model(DUFFING, data, BOUNDS, likelihood="specimen")
    points = {name: value * (1.0 + 1e-3 * rng.standard_normal(3)) for name, value in TRUTH.items()}
    expected = 0.0
    for s in range(3):
        simulated = simulate_backbone(DUFFING, {n: p[s] for n, p in points.items()}, LEVELS).values[:2]
        for o in range(2):
            held = np.isfinite(np.array(data["value"])[s, o])
            covariance = np.array(data["covariance"])[s, o][np.ix_(held, held)]
            expected += multivariate_normal(simulated[o, held], covariance).logpdf(np.array(data["value"])[s, o, held])
    # The correlation matrix is stabilised by 1e-9 of its diagonal.
    assert total(model, points) == pytest.approx(expected, rel=1e-6)


def test_pooled_equals_specimens_that_are_alike(rng):
    data = noisy(rng, 3)
    pooled = build_model(DUFFING, data, BOUNDS, likelihood="pooled")
    specimen = build_model(DUFFING, data, BOUNDS, likelihood="specimen")
    assert total(pooled, TRUTH) == pytest.approx(total(specimen, {n: [v] * 3 for n, v in TRUTH.items()}), rel=1e-9)


def test_auto_chooses_by_the_number_of_specimens(rng):
    assert build_model(DUFFING, noisy(rng, 9, scatter=0.02), BOUNDS).potentials
    few = build_model(DUFFING, noisy(rng, 3), BOUNDS)
    assert few["linear_stiffness"].eval().shape == (3,)
    assert build_model(DUFFING, noisy(rng, 1), BOUNDS)["linear_stiffness"].ndim == 0


def test_failed_simulation_in_the_specimen_likelihood_is_minus_infinity(rng):
    oscillator = Oscillator(1.0, ["coulomb_friction"])
    data = noisy(rng, 2)
    bounds = {"linear_stiffness": (5e3, 8e3), "viscous_damping": (0.1, 3.0), "friction_force": (0.0, 500.0)}
    model = build_model(oscillator, data, bounds, likelihood="pooled")
    point = {"linear_stiffness": 6500.0, "viscous_damping": 1.1, "friction_force": 0.5}
    assert np.isfinite(total(model, point))
    assert total(model, {**point, "friction_force": 400.0}) == -np.inf


def test_leave_one_specimen_out_and_predictions(rng, random_seed):
    data = noisy(rng, 4)
    model = build_model(DUFFING, data, BOUNDS, likelihood="pooled")
    posterior = sample(model, draws=400, tune=400, chains=2, random_seed=random_seed)
    with model:
        pm.compute_log_likelihood(posterior, progressbar=False)
        predictions = pm.sample_posterior_predictive(posterior, random_seed=random_seed, progressbar=False)
    assert posterior["log_likelihood"]["backbone"].shape == (2, 400, 4)
    with warnings.catch_warnings():  # of four specimens
        warnings.filterwarnings("ignore", message="Estimated shape parameter", category=UserWarning)
        result = az.loo(posterior, pointwise=True)
    assert result.n_data_points == 4
    drawn = np.array(predictions["posterior_predictive"]["backbone"]).reshape(-1, 8)
    measured = np.array(data["value"]).reshape(4, 8)
    assert np.abs((measured - drawn.mean(axis=0)) / drawn.std(axis=0)).max() < 5.0


def test_posterior_of_a_linear_oscillator_equals_quadrature(rng, random_seed):
    linear = Oscillator(1.0, ())
    data = noisy(rng, 2)
    values = np.array(data["value"])
    exact = np.array([np.sqrt(6500.0 - 0.55**2) / (2 * np.pi), 2 * np.pi * 0.55 / np.sqrt(6500.0 - 0.55**2)])
    noise = values - batch(rng, 2, 0.0)["value"].values
    data["value"] = (data["value"].dims, exact[None, :, None] + noise)
    model = build_model(linear, data, {"linear_stiffness": (6300.0, 6700.0), "viscous_damping": (0.9, 1.3)},
                        likelihood="pooled")  # fmt: skip
    posterior = sample(model, draws=4000, tune=1000, chains=2, random_seed=random_seed)
    k, c = np.meshgrid(np.linspace(6300, 6700, 401), np.linspace(0.9, 1.3, 401), indexing="ij")
    damped = np.sqrt(k - (0.5 * c) ** 2)
    curves = np.stack([damped / (2 * np.pi), np.pi * c / damped], axis=-1)
    log_density = np.zeros_like(k)
    for s in range(2):
        for o in range(2):
            precision = np.linalg.inv(np.array(data["covariance"])[s, o])
            residual = np.array(data["value"])[s, o] - curves[..., o, None]
            log_density -= 0.5 * np.einsum("abi,ij,abj->ab", residual, precision, residual)
    weight = np.exp(log_density - log_density.max())
    weight /= weight.sum()
    for name, grid in (("linear_stiffness", k), ("viscous_damping", c)):
        mean = (weight * grid).sum()
        sd = np.sqrt((weight * (grid - mean) ** 2).sum())
        drawn = np.array(posterior["posterior"][name])
        # Some 800 effective draws: the mean is known to 0.035 sd, the sd to 2.5 %; four of each.
        assert abs(drawn.mean() - mean) < 0.14 * sd
        assert drawn.std() == pytest.approx(sd, rel=0.1)


def test_simulated_backbone_in_a_model():
    with pm.Model() as model:
        k = pm.Uniform("linear_stiffness", 6000.0, 7000.0)
        curve = backbone_deterministic(
            "curve", DUFFING, LEVELS, {**TRUTH, "linear_stiffness": k}, observables=("frequency",)
        )
    assert model["curve"] is curve
    drawn = curve.eval({k: 6500.0})
    np.testing.assert_allclose(drawn[0], simulate_backbone(DUFFING, TRUTH, LEVELS).frequency, rtol=1e-8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bounds": {"cubic_stifness": (0.0, 1.0)}}, "Did you mean 'cubic_stiffness'"),
        ({"bounds": {"viscous_damping": (1.0, 1.0)}}, "low < high"),
        ({"bounds": {"viscous_damping": (-1.0, 1.0)}}, "between 0 and inf"),
        ({"bounds": {"viscous_damping": 3.0}}, r"two numbers \(low, high\)"),
        ({"bounds": {"viscous_damping": (0.0, np.inf)}}, "finite"),
        ({"fixed": TRUTH}, "every parameter is fixed"),
        ({"fixed": {"mass": 1.0}}, "fixed"),
        ({"likelihood": "populations"}, "Did you mean 'population'"),
        ({"observables": ["offset"]}, "frequency, damping; got 'offset'"),
    ],
)
def test_bad_input_of_build_model(rng, change, message):
    with pytest.raises(InputError, match=message):
        build_model(DUFFING, noisy(rng, 3), **change)


def test_bad_input_of_the_likelihood(rng):
    density = fit_density(batch(rng, 20), marginal="normal")
    data = noisy(rng, 3)
    with pm.Model():
        with pytest.raises(InputError, match="cubic_stiffness missing"):
            backbone_likelihood("b", DUFFING, density, {"linear_stiffness": 1.0, "viscous_damping": 1.0})
        with pytest.raises(InputError, match="must be a number, got 1 dimension"):
            backbone_likelihood("b", DUFFING, density, {**TRUTH, "viscous_damping": [1.0, 2.0]})
        with pytest.raises(InputError, match=r"one entry per specimen \(3\), got 2"):
            backbone_likelihood("b", DUFFING, data, {**TRUTH, "viscous_damping": [1.0, 2.0]})
        with pytest.raises(InputError, match="Density or a Dataset"):
            backbone_likelihood("b", DUFFING, np.ones(3), TRUTH)
        with pytest.raises(InputError, match="was fitted to frequency, damping"):
            backbone_likelihood("b", DUFFING, density, TRUTH, observables=("frequency",))
    with pytest.raises(InputError, match="needs standard errors; specimen 'simulated_1'"):
        build_model(DUFFING, batch(rng, 3), BOUNDS, likelihood="specimen")
    with pytest.raises(InputError, match="likelihood of the population"):
        build_model(DUFFING, density, BOUNDS, likelihood="specimen")
