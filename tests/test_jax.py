"""Backbone likelihoods in JAX: the same numbers and gradients, and samplers that run there; skipped without JAX."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys

import numpy as np
import pymc as pm
import pytest

from pymc_backbone import InputError, build_model, fit_density, sample
from pymc_backbone._common.late_imports import after_import

from .test_model import BOUNDS, DUFFING, TRUTH, batch, noisy


def test_what_waits_for_an_import_is_done_once_behind_it(tmp_path, monkeypatch):
    (tmp_path / "imported_late_by_a_test.py").write_text("loaded = True\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    finders = list(sys.meta_path)
    seen = []
    after_import("imported_late_by_a_test", lambda: seen.append(sys.modules["imported_late_by_a_test"].loaded))
    assert seen == [] and len(sys.meta_path) == len(finders) + 1
    module = importlib.import_module("imported_late_by_a_test")
    importlib.import_module("imported_late_by_a_test")
    assert seen == [True] and sys.meta_path == finders
    assert module.__spec__ is not None and module.__file__ == str(tmp_path / "imported_late_by_a_test.py")
    after_import("imported_late_by_a_test", lambda: seen.append(2))
    assert seen == [True, 2]
    monkeypatch.delitem(sys.modules, "imported_late_by_a_test")
    after_import("imported_nowhere_by_a_test", lambda: seen.append(3))
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("imported_nowhere_by_a_test")
    assert seen == [True, 2] and sys.meta_path == finders


@pytest.fixture
def jax():
    return pytest.importorskip("jax", reason="JAX is not installed: an optional sampler's library")


@pytest.mark.filterwarnings("ignore")  # JAX's own, of whatever version is there
@pytest.mark.parametrize("kind", ["population", "pooled", pytest.param("specimen", marks=pytest.mark.slow)])
def test_values_and_gradients_in_jax_are_those_of_the_compiled_model(jax, kind, rng):
    from pymc.sampling.jax import get_jaxified_logp

    if kind == "population":
        model = build_model(DUFFING, fit_density(batch(rng, 20), marginal="normal"), BOUNDS)
    else:
        model = build_model(DUFFING, noisy(rng, 2), BOUNDS, likelihood=kind)
    log_density = get_jaxified_logp(model)  # of the unconstrained values
    start = model.initial_point()
    point = [np.asarray(start[v.name]) + 0.05 for v in model.value_vars]
    named = {v.name: value for v, value in zip(model.value_vars, point, strict=True)}
    value, slopes = jax.jit(jax.value_and_grad(log_density))(point)
    # Values simulated with and without derivatives agree to 1e-8; errors are 1e-3, and residuals up to 50 of them.
    assert float(value) == pytest.approx(float(model.compile_logp()(named)), abs=1e-3)
    expected = model.compile_dlogp()(named)
    found = np.concatenate([np.ravel(slope) for slope in slopes])
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
    assert np.abs(expected).min() > 0.0
    # Several chains at once are mapped over the callback.
    many = jax.vmap(log_density)([np.stack([one, one + 0.01]) for one in point])
    assert float(many[0]) == pytest.approx(float(value), abs=1e-3) != float(many[1])


@pytest.mark.filterwarnings("ignore")  # JAX's own, and the samplers'
@pytest.mark.parametrize("library", ["numpyro", "blackjax"])
def test_a_sampler_of_jax_finds_the_same_posterior(jax, library, rng, random_seed):
    installed = pytest.importorskip(library, reason=f"{library} is not installed: an optional sampler")
    if library == "blackjax" and "progress_bar" not in inspect.signature(installed.window_adaptation).parameters:
        pytest.skip("this BlackJAX takes no `progress_bar`, which PyMC gives it: it needs BlackJAX before 1.4")
    model = build_model(DUFFING, noisy(rng, 2), BOUNDS, likelihood="pooled")
    with model:
        drawn = pm.sample(
            draws=400, tune=400, chains=2, nuts_sampler=library, random_seed=random_seed, progressbar=False,
            initvals={name: value for name, value in TRUTH.items()},
        )  # fmt: skip
    expected = sample(model, draws=2000, tune=500, chains=2, random_seed=random_seed, progressbar=False)
    for name in TRUTH:
        one, other = np.asarray(drawn["posterior"][name]), np.asarray(expected["posterior"][name])
        # Some 300 effective draws each: means differ by 0.08 standard deviations, which are known to 6 %; four of each.
        assert abs(one.mean() - other.mean()) < 0.35 * other.std()
        assert one.std() == pytest.approx(other.std(), rel=0.25)


@pytest.mark.filterwarnings("ignore")
def test_a_function_has_no_gradient_in_jax_either(jax, rng):
    from pymc.sampling.jax import get_jaxified_logp

    def by_hand(parameters, levels):
        return np.full((2, levels.size), parameters["linear_stiffness"] / 400.0)

    bounds = {"linear_stiffness": BOUNDS["linear_stiffness"]}
    model = build_model(by_hand, noisy(rng, 2), bounds, likelihood="pooled")
    log_density = get_jaxified_logp(model)
    point = [np.asarray(v) for v in model.initial_point().values()]
    assert float(log_density(point)) == pytest.approx(float(model.compile_logp()(model.initial_point())), rel=1e-9)
    with pytest.raises(NotImplementedError, match="no gradient"):
        jax.grad(log_density)(point)


@pytest.mark.skipif(importlib.util.find_spec("jax") is not None, reason="JAX is installed")
@pytest.mark.parametrize("library", ["numpyro", "blackjax"])
def test_without_jax_pymc_says_that_it_is_missing(library, rng):
    with (
        build_model(DUFFING, noisy(rng, 2), BOUNDS, likelihood="pooled"),
        pytest.raises(ModuleNotFoundError, match=r"^No module named 'jax'$"),
    ):
        pm.sample(draws=10, tune=10, chains=1, nuts_sampler=library, progressbar=False)


def test_sample_says_how_to_reach_the_samplers_of_jax(rng):
    model = build_model(DUFFING, noisy(rng, 2), BOUNDS, likelihood="pooled")
    with pytest.raises(InputError, match=r"'blackjax' up to 1.3, install it with JAX and call pymc.sample\(nuts"):
        sample(model, nuts_sampler="blackjax")
