"""Hierarchical models: densities against SciPy, gradients, recovery, what is not identified, bad input."""

from __future__ import annotations

import sys
from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.compile.mode import Mode
from scipy.stats import halfnorm, multivariate_normal, norm, truncnorm

from pymc_backbone import InputError, Oscillator, sample, simulate_backbone
from pymc_backbone.inference.hierarchical import build_hierarchical_model, unidentified_parameters
from pymc_backbone.inference.population import Coordinate, cut_moments
from pymc_backbone.inference.starts import StartFinder

from .test_model import BOUNDS, LEVELS, noisy

HIERARCHICAL = Path(__file__).resolve().parents[1] / "benchmarks"
sys.path[:0] = [str(HIERARCHICAL / "hierarchical"), str(HIERARCHICAL / "calibration")]

LINEAR = Oscillator(1.0)
AT_ONCE = Mode(linker="py", optimizer="fast_compile")  # for functions that are called a few times: nothing is compiled
LINEAR_BOUNDS = {name: BOUNDS[name] for name in LINEAR.parameter_names}


def linear_batch(rng, n, scatter=0.02):
    """Return noisy backbones of linear oscillators, and their stiffness and damping (n, 2)."""
    data = noisy(rng, n)
    truth = np.array([6500.0, 1.1]) * (1.0 + scatter * rng.standard_normal((n, 2)))
    errors = np.asarray(data["standard_error"])
    exact = np.array([simulate_backbone(LINEAR, row, LEVELS).values[:2] for row in truth])
    noise = np.einsum("sokl,sol->sok", np.linalg.cholesky(data["covariance"].values), rng.standard_normal(errors.shape))
    return data.assign(value=(data["value"].dims, exact + noise)), truth


NO_BLAS = pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS")  # asked for by PyMC's LKJCorr


def number(graph):
    """Return the value of a graph without inputs."""
    return graph.eval(mode=AT_ONCE)


OWN = {
    "normal": ["population_location", "population_spread"],
    "correlated": ["population_location", "population_spread", "correlation"],
    "uniform": [f"{name}_{edge}" for edge in ("low", "high") for name in LINEAR_BOUNDS],
}


def expected_log_density(data, population, theta, own):
    """Return likelihood x population x prior by SciPy, up to a constant."""
    total = 0.0
    for s, row in enumerate(theta):
        simulated = simulate_backbone(LINEAR, row, LEVELS).values[:2]
        for o in range(2):
            measured, covariance = np.array(data["value"])[s, o], np.array(data["covariance"])[s, o]
            total += multivariate_normal(simulated[o], covariance).logpdf(measured)
    low, high = np.array(list(LINEAR_BOUNDS.values())).T
    if population == "uniform":
        edge_low, edge_high = own.reshape(2, 2)
        assert (edge_low < theta.min(axis=0)).all() and (theta.max(axis=0) < edge_high).all()
        return total - len(theta) * np.log(edge_high - edge_low).sum()
    location, spread, r = own[:2], own[2:4], own[4] if population == "correlated" else 0.0
    covariance = np.outer(spread, spread) * np.array([[1.0, r], [r, 1.0]])
    total += multivariate_normal(location, covariance).logpdf(theta).sum()
    total -= len(theta) * norm.logcdf(location / spread).sum()  # cut at zero
    return total + halfnorm.logpdf(spread, scale=(high - low) / np.sqrt(12.0)).sum() + np.log(1.0 - r**2)


@NO_BLAS
@pytest.mark.parametrize("population", list(OWN))
def test_density_is_that_of_the_generative_model(rng, population):
    """Whatever the coordinates: with the numerical Jacobian of the whole map they must give SciPy's density."""
    n = 3
    data, _ = linear_batch(rng, n)
    model = build_hierarchical_model(
        LINEAR, data, LINEAR_BOUNDS, population="uniform" if population == "uniform" else "normal",
        correlated=population == "correlated", correlation_shape=2.0,
    )  # fmt: skip
    logp, inputs = model.logp(), model.value_vars
    natural = model.replace_rvs_by_values([model[name] for name in (*LINEAR_BOUNDS, *OWN[population])])
    function = pytensor.function(inputs, [logp, *pytensor.grad(logp, inputs), *natural], mode=AT_ONCE)
    start = [np.asarray(v, dtype=float) for v in (model.initial_point()[variable.name] for variable in inputs)]
    cuts = np.cumsum([v.size for v in start])

    def evaluate(vector):
        pieces = np.split(vector, cuts[:-1])
        out = function(*(piece.reshape(v.shape) for piece, v in zip(pieces, start, strict=True)))
        gradient = np.concatenate([np.ravel(v) for v in out[1 : 1 + len(inputs)]])
        own = [v[0, 1:] if v.ndim == 2 else np.ravel(v) for v in out[3 + len(inputs) :]]
        theta = np.stack(out[1 + len(inputs) : 3 + len(inputs)], axis=1)
        return float(out[0]), gradient, theta, np.concatenate(own)

    differences = []
    for _ in range(2):
        vector = np.concatenate([v.ravel() for v in start]) + 0.3 * rng.standard_normal(cuts[-1])
        value, gradient, theta, own = evaluate(vector)
        columns = []
        for unit in 1e-5 * np.eye(vector.size):
            up, down = evaluate(vector + unit), evaluate(vector - unit)
            columns.append(np.concatenate([(up[2] - down[2]).ravel(), up[3] - down[3]]) / 2e-5)
            # Values on a level are good to 1e-8, standard errors are 1e-3: second differences carry some 1e-4.
            assert gradient[len(columns) - 1] == pytest.approx((up[0] - down[0]) / 2e-5, rel=1e-3, abs=1e-2)
        expected = expected_log_density(data, population, theta, own) + np.linalg.slogdet(np.array(columns))[1]
        differences.append(value - expected)
    assert differences[0] == pytest.approx(differences[1], abs=1e-3)


@pytest.mark.parametrize(("lower", "upper"), [(-np.inf, np.inf), (0.0, np.inf), (-np.inf, 2.0), (0.0, 2.0)])
def test_moments_of_a_cut_normal(lower, upper):
    coordinate = Coordinate(lower, upper, 1.0)
    for mean, sd in ((1.1, 0.52), (0.1, 1.0), (1.9, 0.05)):
        found = [number(v) for v in cut_moments(coordinate, pt.constant(mean), pt.constant(sd))]
        exact = truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)
        np.testing.assert_allclose(found, [exact.mean(), exact.std()], rtol=1e-9)


@pytest.mark.parametrize(("lower", "upper"), [(-np.inf, np.inf), (0.5, np.inf), (-np.inf, 2.0), (0.0, 2.0)])
def test_coordinates_invert_and_know_their_slopes(lower, upper):
    coordinate = Coordinate(lower, upper, 0.3)
    values = np.array([0.7, 1.0, 1.9])
    eta, slope = coordinate.expand(values, np.full(3, 1e-6))
    np.testing.assert_allclose(number(coordinate.value(pt.constant(eta))), values, rtol=1e-12)
    np.testing.assert_allclose(np.exp(number(coordinate.log_slope(pt.constant(eta)))), np.abs(slope), rtol=1e-12)
    up, down = (number(coordinate.value(pt.constant(eta + step))) for step in (1e-6, -1e-6))
    np.testing.assert_allclose((up - down) / 2e-6, slope, rtol=1e-6)


def is_close_to_prior(draws, prior):
    """Return whether two samples of one parameter agree in three quantiles, within 15 % of the spread."""
    share = (0.1, 0.5, 0.9)
    return bool(np.all(np.abs(np.quantile(draws, share) - np.quantile(prior, share)) < 0.15 * prior.std()))


@pytest.mark.slow  # nearly all of it is compiling; test_update_hierarchical.py samples such a model by default
def test_short_run_recovers_the_population_and_the_specimens(rng, random_seed):
    data, truth = linear_batch(rng, 4, scatter=0.03)
    model = build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS)
    posterior = sample(model, draws=300, tune=200, chains=2, step="nutpie", random_seed=random_seed)
    group = posterior["posterior"]
    assert unidentified_parameters(model) == ()
    assert int(posterior["sample_stats"]["diverging"].sum()) <= 6  # one in a hundred
    for j, name in enumerate(LINEAR_BOUNDS):
        assert group[name].dims == ("chain", "draw", "specimen")
        assert group[f"{name}_mean"].dims == group[f"{name}_sd"].dims == ("chain", "draw")
        assert list(group[name]["specimen"].values) == ["s0", "s1", "s2", "s3"]
        mean, sd = (np.array(group[name].mean(("chain", "draw"))), np.array(group[name].std(("chain", "draw"))))
        # 4 specimens, 2 parameters, correct standard deviations: four of them are exceeded once in 2000 tests.
        assert (np.abs(mean - truth[:, j]) < 4.0 * sd).all()
        low, high = np.quantile(group[f"{name}_mean"], [0.005, 0.995])
        assert low < truth[:, j].mean() < high
    assert float(az.rhat(posterior)["specimen_offsets"].max()) < 1.05
    with model:
        pm.compute_log_likelihood(posterior, progressbar=False)
    assert posterior["log_likelihood"]["backbone"].sizes == {"chain": 2, "draw": 300, "specimen": 4}


@pytest.mark.slow
def test_what_the_data_do_not_see_keeps_its_prior(rng, random_seed):
    data, _ = linear_batch(rng, 3)
    model = build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS, observables=["frequency"])
    posterior = sample(model, draws=800, tune=300, chains=2, step="nutpie", random_seed=random_seed)["posterior"]
    low, high = LINEAR_BOUNDS["viscous_damping"]
    location = rng.uniform(low, high, 20000)
    spread = np.abs(rng.standard_normal(20000)) * (high - low) / np.sqrt(12.0)
    cut = truncnorm(-location / spread, np.inf, loc=location, scale=spread)
    for drawn, prior in (
        (posterior["viscous_damping_mean"], cut.mean()),
        (posterior["viscous_damping_sd"], cut.std()),
        (posterior["viscous_damping"], cut.rvs(random_state=rng)),
    ):
        assert is_close_to_prior(np.array(drawn).ravel(), prior)
    # Negative control: what the data do see is far from its prior.
    stiffness = rng.uniform(*LINEAR_BOUNDS["linear_stiffness"], 20000)
    assert not is_close_to_prior(np.array(posterior["linear_stiffness_mean"]).ravel(), stiffness)


def test_what_the_data_do_not_see_is_named(rng, caplog):
    data, _ = linear_batch(rng, 3)
    with caplog.at_level("WARNING", logger="pymc_backbone"):
        model = build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS, observables=["frequency"])
    assert unidentified_parameters(model) == ("viscous_damping",)
    assert "the backbones say nothing about viscous_damping" in caplog.text
    assert unidentified_parameters(build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS)) == ()


def test_linearised_likelihood_is_tangent_to_the_exact_one(rng):
    data, _ = linear_batch(rng, 3)
    values = {}
    for linearised in (False, True):
        model = build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS, linearised=linearised)
        logp = pytensor.function(model.value_vars, model.logp(), mode=AT_ONCE)
        start = [np.asarray(model.initial_point()[v.name], dtype=float) for v in model.value_vars]
        index = [v.name for v in model.value_vars].index("specimen_offsets")
        generator = np.random.default_rng(4)
        heights = []
        for width in (0.3, 0.3, 30.0):
            point = list(start)
            point[index] = width * generator.standard_normal(start[index].shape)
            heights.append(float(logp(*point)))
        values[linearised] = np.diff(heights)
    exact, tangent = values[False], values[True]
    # Errors of 0.1 % and 2 % leave 1e-4 of a squared distance of some units to the curvature of the backbone.
    assert tangent[0] == pytest.approx(exact[0], abs=0.02)
    # Negative control: a hundred times further out the two are apart.
    assert abs(tangent[1] - exact[1]) > 1.0


@pytest.mark.slow
@NO_BLAS
def test_starts_are_finite_and_apart(rng, random_seed):
    model = build_hierarchical_model(LINEAR, linear_batch(rng, 3)[0], LINEAR_BOUNDS, correlated=True)
    starts = StartFinder(model, random_seed).find(3)
    assert len({float(start["population_spread"][0]) for start in starts}) == 3
    assert set(starts[0]) == {variable.name for variable in model.free_RVs}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"population": "gaussian"}, "`population` must be one of normal, uniform"),
        ({"population": "uniform", "correlated": True}, "`correlated` is for a Normal population"),
        ({"correlated": True, "fixed": {"viscous_damping": 1.1}}, "at least two parameters"),
        ({"correlation_shape": 0.0}, "`correlation_shape` must be positive"),
        ({"fixed": {"linear_stiffness": 6500.0, "viscous_damping": 1.1}}, "every parameter is fixed"),
        ({"bounds": {"viscous_damping": (-1.0, 1.0)}}, "between 0 and inf"),
        ({"bounds": {"viscous_dampin": (0.0, 1.0)}}, "Did you mean 'viscous_damping'"),
        ({"observables": ["offset"]}, "got 'offset'"),
    ],
)
def test_bad_input(rng, change, message):
    arguments = {"bounds": LINEAR_BOUNDS, **change}
    with pytest.raises(InputError, match=message):
        build_hierarchical_model(LINEAR, linear_batch(rng, 3)[0], **arguments)


def by_hand(parameters, levels):
    """Stand in for a function without a gradient."""
    return simulate_backbone(LINEAR, parameters, levels).values[:2]


def test_bad_models_and_data(rng):
    data = linear_batch(rng, 3)[0]
    with pytest.raises(InputError, match="needs the gradient that an Oscillator has"):
        build_hierarchical_model(by_hand, data, LINEAR_BOUNDS)
    with pytest.raises(InputError, match="at least 3 specimens, got 2"):
        build_hierarchical_model(LINEAR, data.isel(specimen=slice(2)), LINEAR_BOUNDS)
    with pytest.raises(InputError, match="Dataset of backbones"):
        build_hierarchical_model(LINEAR, np.ones(3), LINEAR_BOUNDS)
    with pytest.raises(InputError, match="needs standard errors"):
        build_hierarchical_model(LINEAR, data.assign(standard_error=0 * data["standard_error"]), LINEAR_BOUNDS)
    with pytest.raises(InputError, match="'s0' cannot be simulated"):
        build_hierarchical_model(
            LINEAR + "coulomb_friction", data, LINEAR_BOUNDS | {"friction_force": (400.0, 500.0)},
            fixed={}, population="uniform",
        )  # fmt: skip
    with pytest.raises(InputError, match="must come from build_hierarchical_model"):
        unidentified_parameters(pm.Model())


@pytest.mark.slow
def test_intervals_hold_the_population_as_often_as_they_say():
    from calibrate import calibrate

    result = calibrate("normal", "normal", 20, 9, 3, say=None)
    coverage = np.array(result["coverage"])
    # 20 draws at 95 %: 15 or fewer happens in 0.26 % of cases, in any of six intervals in 1.5 %.
    assert coverage.min() >= 0.8 and 0.88 <= coverage.mean()
    # Negative control: one vector for all specimens claims to know the mean far too well.
    pooled = calibrate("normal", "pooled", 10, 9, 3, say=None)
    assert np.mean(pooled["coverage"]) < 0.5


@pytest.mark.slow
def test_ranks_are_uniform_and_a_wrong_noise_scale_fails():
    from sbc import calibrate, judge

    right = [judge(ranks) for ranks in calibrate("1", 100, seed=5)["ranks"].values()]
    assert min(verdict["p"] for verdict in right) > 1e-3 and all(verdict["inside"] for verdict in right)
    wrong = [judge(ranks) for ranks in calibrate("1", 100, 0.5, seed=5)["ranks"].values()]
    assert min(verdict["p"] for verdict in wrong) < 1e-3 and not all(verdict["inside"] for verdict in wrong)
