"""Copies of a model have its backbone likelihoods: the same starts, the same counts, however they were made."""

from __future__ import annotations

import copy

import cloudpickle
import numpy as np
import pymc as pm
import pytest
from pymc.model.fgraph import clone_model

from pymc_backbone import (
    InputError,
    Oscillator,
    build_hierarchical_model,
    build_model,
    fit_density,
    sample,
    simulate_backbone,
)
from pymc_backbone.inference.hierarchical import unidentified_parameters
from pymc_backbone.inference.starts import StartFinder
from pymc_backbone.inference.store.fingerprint import describe_model
from pymc_backbone.inference.targets import is_differentiable, targets_of
from pymc_backbone.inference.terms import backbone_deterministic

from .test_hierarchical import LINEAR, LINEAR_BOUNDS, linear_batch
from .test_model import BOUNDS, DUFFING, LEVELS, TRUTH, batch, noisy

FRICTION = Oscillator(1.0, ["coulomb_friction"])
FRICTION_BOUNDS = {"linear_stiffness": (6e3, 7e3), "viscous_damping": (0.1, 3.0), "friction_force": (0.0, 60.0)}
DAMPING = 1.3

WHOLE = {
    "deepcopy": copy.deepcopy,
    "cloudpickle": lambda model: cloudpickle.loads(cloudpickle.dumps(model)),
    "clone": clone_model,
}
CONDITIONED = {
    "do": lambda model: pm.do(model, {"viscous_damping": DAMPING}),
    "observe": lambda model: pm.observe(model, {"viscous_damping": DAMPING}),
}


CALLS: list[bool] = []  # whether the simulations asked for went well


def friction_by_hand(parameters, levels):
    """Stand in for a finite-element code, and count independently."""
    result = simulate_backbone(FRICTION, parameters, levels)
    CALLS.append(not result.status.any())
    return result.values[:1]


def friction_model(rng, fixed=None, source=FRICTION):
    """Return a model in whose prior friction often sticks."""
    density = fit_density(batch(rng, 20, scatter=0.2).sel(observable=["frequency"]), marginal="normal")
    bounds = {name: bounds for name, bounds in FRICTION_BOUNDS.items() if name not in (fixed or {})}
    return build_model(source, density, bounds, fixed=fixed)


def best_of(model):
    """Return the best point that the search for starts finds, and the starts."""
    finder = StartFinder(model, 3)
    starts = finder.find(3)
    assert finder.best and finder.shape is not None  # else it fell back to draws from the prior
    return finder._natural(finder.best), starts


def test_a_pickled_model_is_sampled_draw_for_draw(rng):
    model = friction_model(rng)
    made = WHOLE["cloudpickle"](model)
    assert made is not model and describe_model(made) == describe_model(model)
    expected, found = (sample(each, draws=40, tune=40, chains=2, random_seed=7) for each in (model, made))
    for name in FRICTION_BOUNDS:
        np.testing.assert_array_equal(found["posterior"][name], expected["posterior"][name])
    for name in ("evaluations", "simulations", "failures"):
        assert found.attrs[name] == expected.attrs[name] > 0


@pytest.mark.parametrize("how", [*WHOLE, *CONDITIONED])
def test_copies_start_where_the_model_does(how, rng):
    """PyMC's own copies may have their variables in another order, so draws differ: the best point does not."""
    state = rng.bit_generator.state
    model = friction_model(rng)
    made = (WHOLE | CONDITIONED)[how](model)
    if how in CONDITIONED:
        rng.bit_generator.state = state
        model = friction_model(rng, {"viscous_damping": DAMPING})
    [target], [expected] = targets_of(made), targets_of(model)
    assert target.response == expected.response and target.density == expected.density
    assert target.density.description == expected.density.description != ""
    np.testing.assert_array_equal(target.centre, expected.centre)
    (best, starts), (wanted, _) = best_of(made), best_of(model)
    assert set(best) == set(wanted) == set(starts[0])
    # Least squares stops within 1e-3; frequency alone leaves damping and friction to the prior, so not these.
    assert best["linear_stiffness"] == pytest.approx(wanted["linear_stiffness"], rel=1e-3)
    assert len({float(start["linear_stiffness"]) for start in starts}) == 3


@pytest.mark.parametrize("how", [*WHOLE, *CONDITIONED])
def test_failures_of_a_copy_are_counted(how, rng):
    made = (WHOLE | CONDITIONED)[how](friction_model(rng, source=friction_by_hand))
    CALLS.clear()
    counts = sample(made, draws=30, tune=30, chains=2, step="elementwise", random_seed=7).attrs
    walked = CALLS[-counts["simulations"] :]
    assert counts["failures"] == walked.count(False) > 0
    # Two points a proposal, 60 draws in each of two chains, one proposal for each variable that is left.
    assert counts["evaluations"] == 2 * 2 * 60 * (3 if how in WHOLE else 2) > 1.5 * counts["simulations"]


@pytest.mark.parametrize("how", [*WHOLE, *CONDITIONED])
@pytest.mark.parametrize("likelihood", ["specimen", "pooled"])
def test_likelihoods_of_specimens_are_found_in_copies(how, likelihood, rng):
    data = noisy(rng, 3, missing=True)
    model = build_model(DUFFING, data, BOUNDS, likelihood=likelihood)
    value = np.full(3, DAMPING) if likelihood == "specimen" else DAMPING
    conditioned = {"do": pm.do, "observe": pm.observe}
    made = WHOLE[how](model) if how in WHOLE else conditioned[how](model, {"viscous_damping": value})
    [target] = targets_of(made)
    assert target.name == "backbone" and target.density is None and is_differentiable(made)
    np.testing.assert_array_equal(target.centre, data["value"])
    held = np.isfinite(data["value"].values)
    np.testing.assert_array_equal(target.spread[held], data["standard_error"].values[held])
    assert np.isnan(target.spread[~held]).all() and not held.all()
    assert target.vectors == (3 if likelihood == "specimen" else 1)
    start = StartFinder(made, 3).find(1)[0]
    assert ("viscous_damping" in start) == (how in WHOLE)
    # Least squares brings it near; a draw from the prior is off by a quarter on average.
    assert np.all(np.abs(np.asarray(start["linear_stiffness"]) / TRUTH["linear_stiffness"] - 1.0) < 0.05)


@pytest.mark.parametrize("how", WHOLE)
def test_hierarchical_models_keep_their_starts_and_what_is_unidentified(how, rng):
    data, _ = linear_batch(rng, 4)
    data = data.sel(observable=["frequency"])
    model = build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS)
    made = WHOLE[how](model)
    assert unidentified_parameters(made) == unidentified_parameters(model) == ("viscous_damping",)
    starts, expected = StartFinder(made, 5).find(40), StartFinder(model, 5).find(40)
    for name in ("specimen_offsets", "population_location", "population_spread"):
        found, wanted = (np.array([start[name] for start in each]) for each in (starts, expected))
        if how == "cloudpickle":
            np.testing.assert_array_equal(found, wanted)
        # PyMC's own copies may have their variables in another order: the same distribution, other draws.
        error = np.sqrt((found.var(axis=0) + wanted.var(axis=0)) / 40)
        assert np.all(np.abs(found.mean(axis=0) - wanted.mean(axis=0)) < 4.5 * error)


def test_a_hint_costs_nothing_once_compiled(rng):
    data, _ = linear_batch(rng, 3)
    model = build_hierarchical_model(LINEAR, data, LINEAR_BOUNDS, linearised=True)
    nodes = model.compile_logp().f.maker.fgraph.apply_nodes
    assert nodes and not any("Hint" in type(node.op).__name__ for node in nodes)


def test_models_without_backbones_have_no_targets():
    with pm.Model() as model:
        x = pm.Normal("x")
        pm.Potential("p", -(x**2))
        pm.Normal("y", x, 1.0, observed=np.zeros(3))
        pm.CustomDist("z", x, dist=lambda mu, size: pm.Normal.dist(mu, 1.0, size=size), observed=0.5)
        # What is predicted is compared with nothing.
        backbone_deterministic("curve", DUFFING, LEVELS, {**TRUTH, "viscous_damping": pm.math.exp(x)})
    assert targets_of(model) == []
    with pytest.raises(InputError, match="build_hierarchical_model"):
        unidentified_parameters(copy.deepcopy(model))
