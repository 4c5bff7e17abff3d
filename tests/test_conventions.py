"""What a PyMC user expects: named dimensions, predictions, leave-one-out, Hessians, other data for a compiled model."""

from __future__ import annotations

from types import SimpleNamespace

import arviz as az
import numba
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from pymc.blocking import DictToArrayBijection, RaveledVars
from pytensor.compile.mode import Mode, predefined_modes
from scipy.stats import multivariate_normal

import pymc_backbone as pb
from pymc_backbone import InputError, Oscillator
from pymc_backbone.discrepancy.sets.question import check_vanishes, possible_effects
from pymc_backbone.inference import sampling
from pymc_backbone.inference.targets import targets_of
from pymc_backbone.likelihood.curvature import second_derivatives
from pymc_backbone.simulation.response import make_response

from .test_hierarchical import LINEAR, LINEAR_BOUNDS, linear_batch
from .test_model import BOUNDS, DUFFING, LEVELS, TRUTH, batch, noisy

NAMES = ["frequency", "damping"]
DIMS = ("specimen", "observable", "level")


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    """Functions are called a few times here: nothing is compiled."""
    monkeypatch.setitem(predefined_modes, "FAST_COMPILE", Mode(linker="py", optimizer="fast_compile"))
    with pytensor.config.change_flags(mode="FAST_COMPILE"):
        yield


def made(kind: str, data: xr.Dataset) -> pm.Model:
    """Return a model of each kind of likelihood."""
    if kind == "hierarchical":
        return pb.build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS)
    if kind == "population":
        return pb.build_model(DUFFING, pb.fit_density(data, marginal="normal"), BOUNDS)
    return pb.build_model(DUFFING, data, BOUNDS, likelihood=kind)


def draws_about(rng: np.random.Generator, centre: dict, n_specimens: int | None = None) -> xr.DataTree:
    """Return draws that stand for a posterior: 2 chains of 30, a part in a thousand wide."""
    shape = (2, 30) if n_specimens is None else (2, 30, n_specimens)
    dims = ("chain", "draw", "specimen")[: len(shape)]
    variables = {n: (dims, v * (1.0 + 1e-3 * rng.standard_normal(shape))) for n, v in centre.items()}
    coords = {"chain": [0, 1], "draw": np.arange(30)}
    if n_specimens is not None:
        coords["specimen"] = [f"s{i}" for i in range(n_specimens)]
    return xr.DataTree.from_dict({"posterior": xr.Dataset(variables, coords=coords)})


POTENTIALS = "ignore:The effect of Potentials:UserWarning"  # PyMC says so of prior draws


@pytest.mark.filterwarnings(POTENTIALS)
@pytest.mark.parametrize("kind", ["specimen", "pooled", "hierarchical"])
def test_dimensions_have_names_and_coordinates(kind, rng):
    data = linear_batch(rng, 3)[0]
    data["value"][0, :, -1] = np.nan
    data.attrs["amplitude_unit"] = "m"
    model = made(kind, data)
    assert model.named_vars_to_dims["backbone"] == DIMS
    drawn = pm.sample_prior_predictive(3, model=model, random_seed=1, var_names=["backbone"])
    for group in ("observed_data", "prior_predictive"):
        found = drawn[group]["backbone"]
        assert found.dims[-3:] == DIMS
        np.testing.assert_array_equal(found["level"], LEVELS)
        assert list(found["observable"].values) == NAMES and list(found["specimen"].values) == ["s0", "s1", "s2"]
    np.testing.assert_array_equal(drawn["observed_data"]["backbone"], data["value"])  # NaN stays NaN
    assert not any("_dim_" in str(dim) for group in drawn.children.values() for dim in group.dims)


def test_deterministics_have_dimensions_and_other_levels_a_name_of_their_own(rng):
    data = noisy(rng, 3)
    with pm.Model(coords={"specimen": ["a", "b", "c"]}) as model:
        k = pm.Uniform("linear_stiffness", 6000.0, 7000.0, dims="specimen")
        parameters = {**TRUTH, "linear_stiffness": k}
        pb.backbone_likelihood("backbone", DUFFING, data, parameters)
        same = pb.backbone_deterministic("same", DUFFING, LEVELS, parameters)
        pb.backbone_deterministic("curve", DUFFING, LEVELS[:2], parameters, observables=["frequency"])
        pb.backbone_deterministic("one", DUFFING, LEVELS, TRUTH)
    dims = model.named_vars_to_dims
    assert dims["backbone"] == dims["same"] == DIMS and dims["one"] == DIMS[1:]
    assert dims["curve"] == ("specimen", "curve_observable", "curve_level")
    assert model.coords["specimen"] == ("a", "b", "c") and model.coords["curve_level"] == tuple(LEVELS[:2])
    values = np.array([6100.0, 6500.0, 6900.0])
    simulated = [pb.simulate_backbone(DUFFING, {**TRUTH, "linear_stiffness": v}, LEVELS).values[:2] for v in values]
    np.testing.assert_allclose(same.eval({k: values}), simulated, rtol=1e-7)  # the integrator's own error


def test_predicted_level_values_scatter_as_the_measurement_errors_do(rng, random_seed):
    data = noisy(rng, 2, missing=True)
    with pm.Model() as model:
        pb.backbone_likelihood("backbone", DUFFING, data, TRUTH)
    count = 3000
    drawn = pm.sample_prior_predictive(count, model=model, random_seed=random_seed)["prior_predictive"]["backbone"]
    exact = pb.simulate_backbone(DUFFING, TRUTH, LEVELS).values[:2]
    for s in range(2):
        for o in range(2):
            away = np.array(drawn[0, :, s, o]) - exact[o]
            held = np.isfinite(np.array(data["value"])[s, o])
            assert (np.abs(away[:, ~held]) < 1e-9).all()  # what was not measured has no error
            expected = np.array(data["covariance"])[s, o][np.ix_(held, held)]
            size = np.sqrt(np.diag(expected))
            # Of 3000 draws a correlation is known to 0.018, a variance to 2.6 %: four of each.
            found = np.cov(away[:, held].T) / np.outer(size, size)
            np.testing.assert_allclose(found, expected / np.outer(size, size), atol=0.1)


def test_leave_one_out_compares_two_effects(rng):
    data = noisy(rng, 4)
    runs = {}
    for effect, value in (("cubic_stiffness", TRUTH["cubic_stiffness"]), ("quintic_stiffness", 1e9)):
        bounds = {**{n: BOUNDS[n] for n in LINEAR_BOUNDS}, effect: (0.0, 1e12)}
        model = pb.build_model(Oscillator(1.0, effect), data, bounds, likelihood="pooled")
        centre = {n: TRUTH[n] for n in LINEAR_BOUNDS} | {effect: value}
        runs[effect] = pb.add_log_likelihood(draws_about(rng, centre), model)
    found = runs["cubic_stiffness"]["log_likelihood"]["backbone"]
    assert found.dims == ("chain", "draw", "specimen") and list(found["specimen"].values) == ["s0", "s1", "s2", "s3"]
    posterior = runs["cubic_stiffness"]["posterior"]
    point = {name: float(posterior[name][1, 7]) for name in TRUTH}
    simulated = pb.simulate_backbone(DUFFING, point, LEVELS).values[:2]
    for s in range(4):
        expected = sum(
            multivariate_normal(simulated[o], np.array(data["covariance"])[s, o]).logpdf(np.array(data["value"])[s, o])
            for o in range(2)
        )
        assert float(found[1, 7, s]) == pytest.approx(expected, rel=1e-6)
    with pytest.warns(UserWarning, match="shape parameter"):  # of four specimens
        table = az.compare(runs)
    assert list(table.index) == ["cubic_stiffness", "quintic_stiffness"]


@pytest.mark.filterwarnings(POTENTIALS)
def test_leave_one_out_of_a_hierarchical_model(rng, random_seed):
    data, _ = linear_batch(rng, 3)
    model = made("hierarchical", data)
    drawn = pm.sample_prior_predictive(20, model=model, random_seed=random_seed)
    posterior = xr.DataTree.from_dict({"posterior": drawn["prior"].to_dataset()})
    found = pb.add_log_likelihood(posterior, model)["log_likelihood"]["backbone"]
    assert found.dims == ("chain", "draw", "specimen") and found.shape == (1, 20, 3)
    with pytest.raises(InputError, match="predict from a posterior"):
        pb.add_predictions(drawn, model)
    assert "posterior_predictive" in pb.add_predictions(posterior, model, random_seed=1).children
    draw = posterior["posterior"].isel(chain=0, draw=4)
    for s in range(3):
        point = {name: float(draw[name][s]) for name in LINEAR_BOUNDS}
        simulated = pb.simulate_backbone(LINEAR, point, LEVELS).values[:2]
        expected = sum(
            multivariate_normal(simulated[o], np.array(data["covariance"])[s, o]).logpdf(np.array(data["value"])[s, o])
            for o in range(2)
        )
        assert float(found[0, 4, s]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.filterwarnings(POTENTIALS)
def test_a_population_predicts_but_has_no_specimen_to_leave_out(rng, random_seed):
    model = made("population", batch(rng, 20))
    draws = draws_about(rng, TRUTH)
    with pytest.raises(InputError, match=r"no log-likelihood of single specimens.*build one of specimens"):
        pb.add_log_likelihood(draws, model)
    assert "log_likelihood" not in draws.children
    with pytest.raises(TypeError, match=r"^log likelihood not found"):
        az.loo(draws)
    prior = pm.sample_prior_predictive(4, model=model, random_seed=random_seed)
    for tree, group in ((draws, "posterior"), (prior, "prior")):
        found = pb.add_predictions(tree, model)[f"{group}_predictive"]["backbone"]
        assert found.dims == ("chain", "draw", "observable", "level")
        point = {name: float(tree[group][name][0, 3]) for name in TRUTH}
        np.testing.assert_allclose(found[0, 3], pb.simulate_backbone(DUFFING, point, LEVELS).values[:2], rtol=1e-7)


def test_predictions_of_specimens_are_pymcs_own(rng, random_seed):
    data = noisy(rng, 3)
    data.attrs["amplitude_unit"] = "m"
    model = made("specimen", data)
    draws = pb.add_predictions(draws_about(rng, TRUTH, 3), model, random_seed=random_seed)
    found = draws["posterior_predictive"]["backbone"]
    assert found.dims == ("chain", "draw", *DIMS) and found["level"].attrs["units"] == "m"
    away = (np.array(found) - np.array(data["value"])) / np.array(data["standard_error"])
    # Of 60 draws: measurement errors twice, and a thousandth of the parameters, half as much in frequency.
    assert 1.0 < away.std() < 2.5
    with pytest.raises(InputError, match="group 'prior' or 'posterior'"):
        pb.add_predictions(xr.DataTree(), model)
    with pm.Model() as empty:
        pm.Normal("x")
    with pytest.raises(InputError, match="no backbone likelihood"):
        pb.add_predictions(draws, empty)


def unconstrained(model: pm.Model, centre: dict) -> dict:
    """Return the point of unconstrained values that stands for these natural ones."""
    point = model.initial_point()
    for variable in model.free_RVs:
        transform = model.rvs_to_transforms[variable]
        value = np.broadcast_to(np.asarray(centre[variable.name], dtype=float), variable.shape.eval())
        point[model.rvs_to_values[variable].name] = transform.forward(value, *variable.owner.inputs).eval()
    return point


def differences(model: pm.Model, point: dict) -> np.ndarray:
    """Return the differences of the gradient of the log-density."""
    slope = model.compile_dlogp()
    flat = DictToArrayBijection.map({v.name: point[v.name] for v in model.value_vars})

    def gradient(vector: np.ndarray) -> np.ndarray:
        return np.array(slope(DictToArrayBijection.rmap(RaveledVars(vector, flat.point_map_info))))

    return np.array([(gradient(flat.data + h) - gradient(flat.data - h)) / 2e-4 for h in 1e-4 * np.eye(flat.data.size)])


def check_hessian(found: np.ndarray, expected: np.ndarray) -> None:
    size = np.sqrt(np.abs(np.diag(expected)))
    expected = expected / np.outer(size, size)
    # Differences of gradients that are good to 1e-8, over 1e-4: a part in ten thousand.
    np.testing.assert_allclose(found / np.outer(size, size), expected, atol=2e-3)
    assert np.abs(expected - np.diag(np.diag(expected))).max() > 0.05  # no diagonal matrix would do


CENTRE = {name: 1.001 * value for name, value in TRUTH.items()}


@pytest.mark.parametrize("kind", ["population", "pooled", pytest.param("specimen", marks=pytest.mark.slow)])
def test_second_derivatives_are_those_of_the_log_density(kind, rng):
    model = made(kind, batch(rng, 20) if kind == "population" else noisy(rng, 2))
    point = unconstrained(model, CENTRE)
    slope = model.dlogp()
    rows = []
    for i in range(sum(np.size(value) for value in point.values())):
        parts = pt.grad(slope[i], model.value_vars, disconnected_inputs="ignore")
        rows.append(pt.concatenate([part.ravel() for part in parts]))
    check_hessian(np.array(model.compile_fn(rows, inputs=model.value_vars)(point)), differences(model, point))


@pytest.mark.slow  # PyMC's loop takes minutes to compile; what it loops over is compared with differences above
def test_find_hessian_is_right(rng):
    model = made("pooled", noisy(rng, 2))
    point = unconstrained(model, CENTRE)
    expected = differences(model, point)
    with pytensor.config.change_flags(mode="NUMBA"):  # PyMC's Hessian is a loop, which Python alone does not run
        found = np.asarray(pm.find_hessian(point, model=model, negate_output=False))
    check_hessian(found, expected)


def test_second_derivatives_of_a_linear_oscillator_are_exact():
    k, c = 6500.0, 1.1
    damped = np.sqrt(k - 0.25 * c * c)
    curvature = second_derivatives(make_response(LINEAR, LEVELS[:2]), np.array([k, c]))
    in_k, in_c, mixed = -0.25 / damped**3, -0.25 / damped - 0.0625 * c * c / damped**3, 0.125 * c / damped**3
    expected = np.array([[in_k, mixed], [mixed, in_c]]) / (2.0 * np.pi)
    scale = np.sqrt(np.abs(np.outer(np.diag(expected), np.diag(expected))))
    for level in range(2):
        np.testing.assert_allclose(curvature[0, level] / scale, expected / scale, atol=1e-4)


def test_a_third_derivative_is_refused(rng):
    density = pb.fit_density(batch(rng, 20), marginal="normal")
    theta = pt.dvector()
    op = pb.BackboneLogLikelihood(make_response(DUFFING, LEVELS))
    slope = pt.grad(op(theta, density.codes, density.table)[0], theta)
    second = pt.grad(slope[0], theta)
    with pytest.raises(NotImplementedError, match="no third"):
        pt.grad(second[0], theta)


@pytest.mark.parametrize("kind", ["population", "pooled", "specimen"])
def test_other_data_of_the_same_shape_need_no_other_model(kind, rng):
    if kind == "population":
        one, other = batch(rng, 20), batch(rng, 15)
        replacement = pb.fit_density(other, marginal="kde")
        fresh = pb.build_model(DUFFING, replacement, BOUNDS)
    else:
        one, replacement = noisy(rng, 3), noisy(rng, 3, scatter=0.001, missing=True).assign_coords(specimen=list("xyz"))
        fresh = made(kind, replacement)
    model = made(kind, one)
    log_density = model.compile_logp()
    point = model.initial_point()
    before = float(log_density(point))
    pb.set_backbones(replacement, model=model)
    assert float(log_density(point)) == pytest.approx(float(fresh.compile_logp()(point)), rel=1e-12) != before
    [target], [expected] = targets_of(model), targets_of(fresh)
    np.testing.assert_array_equal(target.centre, expected.centre)
    np.testing.assert_array_equal(target.spread, expected.spread)
    assert target.density == expected.density
    if kind != "population":
        assert model.coords["specimen"] == ("x", "y", "z")


def test_other_data_of_another_shape_are_refused(rng):
    model, population = made("pooled", noisy(rng, 3)), made("population", batch(rng, 20))
    density = pb.fit_density(batch(rng, 20), marginal="normal")
    for data, chosen, options, message in (
        (noisy(rng, 4), model, {}, r"3 specimen\(s\), got 4"),
        (noisy(rng, 3).sel(observable=["damping"]), model, {}, "compares frequency, damping, got damping"),
        (noisy(rng, 3).assign_coords(level=2.0 * LEVELS), model, {}, "simulates 4 levels from 0.005 to 0.03, got 4"),
        (density, model, {}, "give their backbones"),
        (noisy(rng, 3), population, {}, "give a density"),
        ([1.0], population, {}, "got list"),
        (density, population, {"name": "decay"}, r"\(backbone\), got 'decay'"),
    ):
        with pytest.raises(InputError, match=message):
            pb.set_backbones(data, model=chosen, **options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"nuts_sampler": "numpyro"}, r"`step` chooses the sampler.*pymc.sample\(nuts_sampler"),
        ({"initvals": {}}, "starts are found from the data"),
        ({"random_seed": "one"}, r"`random_seed` must be.*got 'one'"),
        ({"random_seed": -1}, "got -1"),
    ],
)
def test_arguments_that_sample_sets_itself_are_refused(rng, arguments, message):
    with pytest.raises(InputError, match=message):
        pb.sample(made("pooled", noisy(rng, 2)), **arguments)


def test_a_generator_is_a_seed(rng, monkeypatch):
    seeds = []
    monkeypatch.setattr(sampling, "_run", lambda seed, *rest: seeds.append(seed))
    model = made("pooled", noisy(rng, 2))
    for random_seed in (np.random.default_rng(5), np.random.default_rng(5), np.random.default_rng(6), 7, None):
        pb.sample(model, random_seed=random_seed)
    assert seeds[0] == seeds[1] != seeds[2] and isinstance(seeds[0], int) and seeds[3:] == [7, None]


def test_what_a_function_raises_is_said_once_and_complex_numbers_are_refused(caplog):
    def dividing(parameters, levels):
        return np.full((2, levels.size), 1.0 / parameters["a"])

    response = make_response(dividing, LEVELS, parameter_names=("a",))
    for value in (0.0, 0.0, 2.0):
        values, _, completed = response.evaluate(np.array([value]), False)
        assert completed == (value == 2.0) == np.isfinite(values).all()
    response.evaluate(np.array([0.0]), False)
    [said] = [record.getMessage() for record in caplog.records]
    assert "ZeroDivisionError (float division by zero) at a = 0" in said and "count as failures" in said
    response = make_response(lambda p, levels: np.full((2, levels.size), 1j), LEVELS, parameter_names=("a",))
    with pytest.raises(InputError, match="real numbers, got complex"):
        response.evaluate(np.array([1.0]), False)


@pytest.mark.parametrize("options", [{"density": "joint"}, {"marginal": "kde"}])
def test_what_a_likelihood_of_specimens_would_ignore_is_refused(options, rng):
    with pytest.raises(InputError, match=r"those of a population, and the likelihood is 'specimen'"):
        pb.build_model(DUFFING, noisy(rng, 3), BOUNDS, **options)


@pytest.mark.parametrize("name", sorted(pb.LIBRARY))
def test_every_effect_of_the_library_vanishes_at_zero_strength(name):
    check_vanishes(pb.LIBRARY[name], (1.2, 0.01, 80.0))


@numba.njit
def with_preload(x, v, direction, z, p):
    return p[0] * x**3 + 2.0


@numba.njit
def known(x, v, direction, z, p):
    return 9.81 + 0.0 * x


@numba.njit
def stiff_beyond(x, v, direction, z, p):
    return p[0] * max(abs(x) - p[1], 0.0) * (1.0 if x > 0.0 else -1.0)


@pytest.mark.parametrize(
    ("force", "parameters", "message"),
    [
        (with_preload, ("own_stiffness",), r"force of 2 where its strength `own_stiffness` is zero; multiply"),
        (known, (), "whatever its parameters are"),
        (stiff_beyond, ("own_stiffness", "own_gap"), None),
    ],
)
def test_a_candidate_of_ones_own_vanishes_at_zero_strength(force, parameters, message):
    given = tuple(pb.Parameter(q, "1", q, q, bounds=lambda m, a, w: (0.0, 0.5 * a)) for q in parameters)
    effect = pb.Effect("own", "own", "own", "own", given, force)
    if message is None:
        check_vanishes(effect, (1.0, 0.01, 80.0))
        return
    with pytest.raises(InputError, match=message):
        check_vanishes(effect, (1.0, 0.01, 80.0))
    batch = SimpleNamespace(amplitude=0.01, angular_frequency=80.0, backbones=xr.Dataset())
    with pytest.raises(InputError, match=message):
        possible_effects(LINEAR, [effect], batch)
