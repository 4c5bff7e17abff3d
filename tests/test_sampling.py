"""Starts that can move, steps by name, failures counted, and the same draws from the same seed."""

from __future__ import annotations

import arviz as az
import numpy as np
import pymc as pm
import pytensor
import pytest

from pymc_backbone import (
    InputError,
    Oscillator,
    backbone_likelihood,
    build_model,
    fit_density,
    sample,
    simulate_backbone,
)
from pymc_backbone.inference.starts import StartFinder

from .test_model import BOUNDS, DUFFING, LEVELS, TRUTH, batch, noisy


def test_hard_edges_that_no_prior_point_reaches_end_in_one_sentence(rng):
    density = fit_density(batch(rng, 20), marginal="uniform")
    stiff = {**BOUNDS, "linear_stiffness": (9000.0, 9500.0)}
    with pytest.raises(
        InputError, match=r"no prior point reaches the measured frequency at amplitude 0\.0\d+: measured"
    ) as caught:
        sample(build_model(DUFFING, density, stiff), draws=10, tune=10)
    assert str(caught.value).count(". ") == 0
    damped = {**BOUNDS, "viscous_damping": (5.0, 6.0)}
    with pytest.raises(InputError, match="measured damping at amplitude"):
        sample(build_model(DUFFING, density, damped), draws=10, tune=10)


def test_levels_reached_one_by_one_but_not_together(rng):
    data = batch(rng, 20)
    values = np.array(data["value"])
    values[:, 0, ::2] += 0.4  # a zigzag that no Duffing backbone follows
    density = fit_density(data.assign(value=(data["value"].dims, values)), marginal="uniform")
    wide = {"linear_stiffness": (4000.0, 9000.0), "viscous_damping": (0.1, 3.0), "cubic_stiffness": (1e6, 2e7)}
    with pytest.raises(InputError, match="all levels together"):
        sample(build_model(DUFFING, density, wide), draws=10, tune=10)


def test_simulations_that_all_fail_are_named(rng):
    oscillator = Oscillator(1.0, ["coulomb_friction"])
    bounds = {"linear_stiffness": (5e3, 8e3), "viscous_damping": (0.1, 3.0), "friction_force": (400.0, 500.0)}
    with pytest.raises(InputError, match="the motion stuck"):
        sample(build_model(oscillator, fit_density(batch(rng, 20)), bounds), draws=10, tune=10)


def test_search_finds_a_narrow_target_and_no_chain_is_frozen(rng, random_seed):
    density = fit_density(batch(rng, 20, scatter=0.002), marginal="uniform")
    wide = {"linear_stiffness": (1e3, 3e4), "viscous_damping": (0.01, 20.0), "cubic_stiffness": (0.0, 1e8)}
    model = build_model(DUFFING, density, wide)
    log_density = model.compile_logp()
    draw = pm.initial_point.make_initial_point_fn(model=model, default_strategy="prior")
    assert not any(np.isfinite(log_density(draw(seed))) for seed in range(100))  # the prior alone never hits it
    starts = StartFinder(model, random_seed).find(4)
    assert len({float(start["linear_stiffness"]) for start in starts}) == 4
    posterior = sample(model, draws=300, tune=600, chains=4, random_seed=random_seed)["posterior"]
    for name in wide:
        assert all(np.unique(chain).size > 10 for chain in posterior[name].values)


@pytest.mark.parametrize("likelihood", ["specimen", "pooled", "population"])
def test_slopes_of_the_search_are_those_of_the_distances(rng, likelihood):
    """Of each unknown, by central differences of what is searched; a level that is not reached has none."""
    data = noisy(rng, 9)
    data["value"][0, :, 0] = data["standard_error"][0, :, 0] = np.nan
    if likelihood == "population":
        data = data.isel(specimen=slice(1, None))
    finder = StartFinder(build_model(DUFFING, data, BOUNDS, likelihood=likelihood), 1)
    assert finder._has_slopes
    point, unpack = finder._flatten(finder.draw_point(3))
    exact = finder._slopes_of_distances(point, unpack)
    steps = 1e-4 * np.eye(point.size)
    differences = [(finder.distances(unpack(point + h)) - finder.distances(unpack(point - h))) / 2e-4 for h in steps]
    expected = np.column_stack(differences)
    # the simulator's own rounding, 1e-10 of a frequency, over the step in standard errors
    assert exact == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())
    assert np.abs(exact).max(axis=0).min() > 0.0


def test_search_does_not_simulate_every_specimen_for_every_unknown(rng, monkeypatch):
    """24 specimens have 72 unknowns: differences of the distances would simulate the batch 72 times at each step."""
    finder = StartFinder(build_model(DUFFING, noisy(rng, 24), BOUNDS, likelihood="specimen"), 1)
    batches = []
    simulate = type(finder.targets[0].response).evaluate_many
    monkeypatch.setattr(
        type(finder.targets[0].response), "evaluate_many",
        lambda self, theta: (batches.append(len(theta)), simulate(self, theta))[1],
    )  # fmt: skip
    point = finder.draw_point(3)
    solved = finder._search(point)
    assert 1 < len(batches) <= 61 and set(batches) == {24}
    # the nearest point: half a squared standard error for each of 480 values, and what the prior costs
    assert np.mean(finder.distances(solved) ** 2) < 1.5 < np.mean(finder.distances(point) ** 2)


@pytest.mark.parametrize("step", ["metropolis", "elementwise", "demetropolisz", "slice", "nuts", "nutpie"])
def test_every_step_samples_the_same_posterior(step):
    density = fit_density(batch(np.random.default_rng(5), 30), kind="joint", marginal="normal")
    draws = 3000 if step in ("elementwise", "demetropolisz") else 700
    posterior = sample(build_model(DUFFING, density, BOUNDS), draws=draws, tune=700, chains=2, step=step, random_seed=3)
    assert posterior.attrs["step"] == step
    for name, truth in TRUTH.items():
        drawn = np.array(posterior["posterior"][name])
        # The population's mean is within 0.4 % of the truth (2 % over the root of 30); a shared sd of 2 %.
        assert drawn.mean() == pytest.approx(truth, rel=0.02)
        assert 0.012 < drawn.std() / truth < 0.032


def test_joint_proposals_follow_a_ridge(rng, random_seed):
    # Two dampings from three levels: their sum is known far better than each. One at a time crawls along the ridge.
    oscillator = Oscillator(1.0, ["quadratic_damping"])
    data = noisy(rng, 1).isel(level=slice(1, 4), level_other=slice(1, 4))
    values = simulate_backbone(oscillator, [6500.0, 1.0, 3.0], data["level"].values).values[:2]
    data = data.assign(value=(data["value"].dims, values[None]))
    bounds = {"linear_stiffness": (6e3, 7e3), "viscous_damping": (0.0, 5.0), "quadratic_damping": (0.0, 20.0)}
    effective = {}
    for step in ("metropolis", "elementwise"):
        model = build_model(oscillator, data, bounds)
        effective[step] = az.ess(sample(model, draws=1500, tune=500, chains=2, step=step, random_seed=random_seed))
    for name in ("viscous_damping", "quadratic_damping"):
        assert float(effective["metropolis"][name]) > 1.5 * float(effective["elementwise"][name])


def test_slice_never_visits_a_failed_simulation(rng, random_seed):
    oscillator = Oscillator(1.0, ["coulomb_friction"])
    bounds = {"linear_stiffness": (6e3, 7e3), "viscous_damping": (0.1, 3.0), "friction_force": (0.0, 60.0)}
    data = noisy(rng, 2).isel(observable=[0])
    data = data.assign(
        value=data["value"] * 0 + np.sqrt(6500.0) / (2 * np.pi), standard_error=0.2 + 0 * data["standard_error"]
    )
    model = build_model(oscillator, data.drop_vars("covariance"), bounds, likelihood="pooled")
    posterior = sample(model, draws=300, tune=300, chains=2, step="slice", random_seed=random_seed)["posterior"]
    friction = np.array(posterior["friction_force"]).ravel()
    for force, k, c in zip(friction[::40], posterior["linear_stiffness"].values.ravel()[::40],
                           posterior["viscous_damping"].values.ravel()[::40], strict=True):  # fmt: skip
        assert not simulate_backbone(oscillator, [k, c, force], LEVELS).status.any()
    # Friction above about k * level / 1 sticks at the lowest level: most of the prior is a failed region.
    assert friction.max() < 45.0


def test_same_seed_same_draws_and_failures_are_counted(rng):
    oscillator = Oscillator(1.0, ["coulomb_friction"])
    bounds = {"linear_stiffness": (6e3, 7e3), "viscous_damping": (0.1, 3.0), "friction_force": (0.0, 60.0)}
    density = fit_density(batch(rng, 20, scatter=0.2).sel(observable=["frequency"]), marginal="normal")
    runs = [
        sample(build_model(oscillator, density, bounds), draws=100, tune=100, chains=2, random_seed=7) for _ in range(2)
    ]
    for name in bounds:
        np.testing.assert_array_equal(runs[0]["posterior"][name], runs[1]["posterior"][name])
    assert runs[0].attrs["failures"] == runs[1].attrs["failures"] > 0
    assert runs[0].attrs["evaluations"] == 2 * 2 * 200 * 3  # two points a proposal, two chains, a sweep of three


def by_hand(parameters, levels):
    """Stand in for a finite-element code."""
    return simulate_backbone(DUFFING, parameters, levels).values[:2]


def test_a_function_is_sampled_like_an_oscillator(rng, random_seed):
    density = fit_density(batch(rng, 20), marginal="normal")
    model = build_model(by_hand, density, BOUNDS)
    reference = build_model(DUFFING, density, BOUNDS)
    posteriors = [
        sample(m, draws=60, tune=60, chains=2, random_seed=random_seed)["posterior"] for m in (model, reference)
    ]
    for name in BOUNDS:
        np.testing.assert_allclose(posteriors[0][name], posteriors[1][name], rtol=1e-6)
    for step in ("nuts", "nutpie"):
        with pytest.raises(InputError, match="needs a gradient"):
            sample(model, step=step)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": "metropolish"}, "Did you mean 'metropolis'"),
        ({"draws": 0}, "`draws` must be a whole number of at least 1"),
        ({"chains": 1.5}, "`chains`"),
    ],
)
def test_bad_input_of_sample(rng, arguments, message):
    model = build_model(DUFFING, fit_density(batch(rng, 20), marginal="normal"), BOUNDS)
    with pytest.raises(InputError, match=message):
        sample(model, **arguments)


def test_what_was_counted_is_what_was_simulated(rng):
    density = fit_density(batch(rng, 20), marginal="normal")
    simulated = []

    def counted(parameters, levels):
        simulated.append(tuple(parameters.values()))
        return by_hand(parameters, levels)

    model = build_model(counted, density, BOUNDS)
    # Drawing the starts simulates too: the walks' own simulations are the last ones.
    for step in ("metropolis", "elementwise"):
        simulated.clear()
        counts = sample(model, draws=20, tune=20, chains=2, step=step, random_seed=7).attrs
        walked = len({point for point in simulated[-counts["simulations"] :]})
        # One simulation for each proposal, and one for each chain's start unless it is still remembered.
        assert 0 <= counts["simulations"] - 2 * 40 * 3 <= 2
        assert walked == counts["simulations"] and counts["gradients"] == 0
    exact = build_model(DUFFING, density, BOUNDS)
    # nutpie counts in a copy. Every step of every trajectory kept asks for one gradient, those while tuning on top.
    result = sample(exact, draws=20, tune=30, chains=1, step="nutpie", random_seed=7)
    assert result.attrs["gradients"] > int(result["sample_stats"]["n_steps"].sum()) > 20
    assert result.attrs["simulations"] == 0


def test_priors_without_bounds_are_walked_in_their_own_unit(rng, random_seed):
    """Normal priors of a hundred and of a million: the first proposals must reach as far as Uniform ones do."""
    density = fit_density(batch(rng, 30), kind="joint")
    with pm.Model() as model:
        parameters = {
            name: pm.Normal(name, 0.5 * (low + high), 0.25 * (high - low)) for name, (low, high) in BOUNDS.items()
        }
        backbone_likelihood("backbone", DUFFING, density, parameters)
    found = StartFinder(model, random_seed)
    found.find(2)
    bounded = StartFinder(build_model(DUFFING, density, BOUNDS), random_seed)
    bounded.find(2)
    low, high = np.array([BOUNDS[name] for name in DUFFING.parameter_names]).T
    # the derivative of the Uniform's scale, (high - low) u (1 - u), takes its spread into the parameter's unit
    centre = np.array([float(bounded._natural(bounded.best)[name]) for name in DUFFING.parameter_names])
    slope = (centre - low) * (high - centre) / (high - low)
    ratio = np.sqrt(np.diag(found.shape)) / (np.sqrt(np.diag(bounded.shape)) * slope)
    assert np.all((0.3 < ratio) & (ratio < 3.0))


def test_sampling_is_compiled_without_fast_mathematics_and_leaves_the_setting_alone(rng):
    """Sums in any order differ between code compiled in a process and code read from disk."""
    seen = []
    before = pytensor.config.numba__fastmath
    with pytensor.config.change_flags(numba__fastmath=True):
        model = build_model(DUFFING, fit_density(batch(rng, 20)), BOUNDS)
        sample(model, draws=2, tune=1, chains=1, callback=lambda **_: seen.append(pytensor.config.numba__fastmath))
        assert pytensor.config.numba__fastmath is True
    assert seen == [False] * 3 and pytensor.config.numba__fastmath is before


@pytest.mark.parametrize(("columns", "expected"), [(80, "split"), (200, True)])
def test_in_few_columns_the_bar_keeps_its_times(monkeypatch, rng, columns, expected):
    """PyMC's bar cuts elapsed and remaining time off for the step's statistics."""
    from pymc_backbone.inference import sampling

    seen = []
    whole = pm.sample
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr(sampling.pm, "sample", lambda **given: seen.append(given["progressbar"]) or whole(**given))
    model = build_model(DUFFING, fit_density(batch(rng, 20)), BOUNDS)
    settings = {"draws": 10, "tune": 10, "chains": 1, "random_seed": 1}
    sample(model, progressbar=True, **settings)
    sample(model, progressbar="combined", **settings)
    sample(model, progressbar=False, **settings)
    assert seen == [expected, "combined", False]


def test_arguments_of_nuts_reach_it(monkeypatch, rng):
    from pymc_backbone.inference import sampling

    seen = []
    whole = pm.NUTS
    monkeypatch.setattr(sampling.pm, "NUTS", lambda **given: seen.append(given) or whole(**given))
    model = build_model(DUFFING, noisy(rng, 1), BOUNDS, likelihood="pooled")
    settings = {"draws": 5, "tune": 5, "chains": 1, "random_seed": 1, "step": "nuts"}
    kept = sample(model, target_accept=0.95, max_treedepth=3, **settings)
    assert seen == [{"model": model, "target_accept": 0.95, "max_treedepth": 3}]
    assert int(kept["sample_stats"]["tree_depth"].max()) <= 3
