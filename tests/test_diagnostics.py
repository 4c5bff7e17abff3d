"""Diagnostics against posteriors whose faults are known, each beside a sound one that must pass."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from pymc_backbone._common.checks import InputError
from pymc_backbone.inference.diagnostics import (
    TABLE_COLUMNS,
    acceptance_rate,
    distance_from_uniform,
    findings,
    leaning_share,
    summarise,
)

CHAINS, DRAWS = 4, 1000
BOUNDS = {"stiffness": (6000.0, 8000.0), "damping": (0.0, 4.0)}
UNITS = {"stiffness": "N/m", "damping": "N s/m"}


def make_tree(accepted: np.ndarray | None = None, **draws: np.ndarray) -> xr.DataTree:
    coordinates = {"chain": np.arange(CHAINS), "draw": np.arange(DRAWS)}
    posterior = xr.Dataset({name: (("chain", "draw"), values) for name, values in draws.items()}, coords=coordinates)
    groups = {"posterior": posterior}
    if accepted is not None:
        groups["sample_stats"] = xr.Dataset({"accepted": (("chain", "draw"), accepted)}, coords=coordinates)
    return xr.DataTree.from_dict(groups)


@pytest.fixture
def good(rng: np.random.Generator) -> dict[str, np.ndarray]:
    shape = (CHAINS, DRAWS)
    return {"stiffness": rng.normal(7000.0, 100.0, shape), "damping": rng.normal(1.7, 0.1, shape)}


def test_summary_has_the_known_moments(good):
    table = summarise(make_tree(**good))
    assert list(table.columns) == list(TABLE_COLUMNS)
    # Four standard errors of 4000 independent draws.
    assert table.loc["stiffness", "mean"] == pytest.approx(7000.0, abs=4 * 100 / np.sqrt(4000))
    assert table.loc["stiffness", "sd"] == pytest.approx(100.0, abs=4 * 100 / np.sqrt(8000))
    # The 95 % interval of a normal is 3.92 sd wide; an interval of draws scatters by a few percent.
    width = table.loc["damping", "hdi_high"] - table.loc["damping", "hdi_low"]
    assert width == pytest.approx(2 * stats.norm.ppf(0.975) * 0.1, rel=0.08)
    assert table.loc["damping", "mcse_mean"] == pytest.approx(0.1 / np.sqrt(4000), rel=0.15)


def test_summary_interval_is_the_highest_density_one(rng):
    """An exponential's 95 % HDI starts at zero; its equal-tailed interval does not."""
    table = summarise(make_tree(x=rng.exponential(1.0, (CHAINS, DRAWS))))
    assert table.loc["x", "hdi_low"] < 0.01
    assert table.loc["x", "hdi_high"] == pytest.approx(-np.log(0.05), rel=0.1)


def test_good_posterior_has_no_findings(good, rng):
    tree = make_tree(accepted=rng.random((CHAINS, DRAWS)) < 0.35, **good)
    assert findings(tree, BOUNDS, units=UNITS, failures=0) == []


def test_narrow_posterior_near_a_bound_of_a_wide_prior_does_not_lean(good, rng):
    """Half a percent of the prior's width from zero, but ten standard deviations away from it."""
    good["damping"] = rng.normal(0.02, 0.002, (CHAINS, DRAWS))
    assert findings(make_tree(**good), BOUNDS) == []


def test_chains_apart_raise_r_hat_and_lower_ess(good):
    good["damping"] = good["damping"] + 0.1 * np.arange(CHAINS)[:, None]
    r_hat, ess = findings(make_tree(**good), BOUNDS)
    assert r_hat.startswith("R-hat is above 1.01 for damping (") and "stiffness" not in r_hat
    assert ess.startswith("Fewer than 400 effective draws for damping (")


def test_slow_chains_have_few_effective_draws(good, rng):
    noise = rng.normal(size=(CHAINS, DRAWS))
    walk = np.empty_like(noise)
    walk[:, 0] = noise[:, 0]
    for step in range(1, DRAWS):
        walk[:, step] = 0.98 * walk[:, step - 1] + np.sqrt(1 - 0.98**2) * noise[:, step]
    found = findings(make_tree(stiffness=7000.0 + 50.0 * walk, damping=good["damping"]), BOUNDS)
    assert any("effective draws for stiffness (" in sentence for sentence in found)
    assert not any("damping" in sentence for sentence in found)


@pytest.mark.parametrize("scale", [0.005, 0.05, 0.3])
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_half_normal_at_a_bound_leans_on_it(good, rng, scale, side):
    distance = np.abs(rng.normal(0.0, scale * 4.0, (CHAINS, DRAWS)))
    distance = np.where(distance > 4.0, 2.0, distance)
    good["damping"] = distance if side == "lower" else 4.0 - distance
    (sentence,) = findings(make_tree(**good), BOUNDS, units=UNITS)
    bound = "0" if side == "lower" else "4"
    assert sentence.startswith(f"damping leans on the {side} bound {bound} N s/m of its prior")
    assert ("may be absent" in sentence) == (side == "lower")


def test_uniform_posterior_is_unidentified(good, rng):
    good["damping"] = rng.uniform(0.0, 4.0, (CHAINS, DRAWS))
    (sentence,) = findings(make_tree(**good), BOUNDS, units=UNITS)
    assert sentence.startswith("The data do not identify damping") and "from 0 to 4 N s/m" in sentence


def test_informative_but_wide_posterior_is_identified(good, rng):
    """A triangular posterior over the whole prior: the data do say something."""
    good["damping"] = rng.triangular(0.0, 2.0, 4.0, (CHAINS, DRAWS))
    assert findings(make_tree(**good), BOUNDS) == []


def test_frozen_chain_is_named_and_hides_the_rest(good):
    for values in good.values():
        values[2] = values[2, 0]
    (sentence,) = findings(make_tree(**good), BOUNDS)
    assert sentence.startswith("Chain 2 never moved")


def test_all_chains_frozen_at_one_point():
    tree = make_tree(stiffness=np.full((CHAINS, DRAWS), 7000.0), damping=np.full((CHAINS, DRAWS), 2.0))
    (sentence,) = findings(tree, BOUNDS)
    assert sentence.startswith("Chains 0, 1, 2 and 3 never moved")


@pytest.mark.parametrize(("rate", "words"), [(0.02, "below 0.10"), (0.95, "above 0.75")])
def test_acceptance_outside_its_range(good, rng, rate, words):
    tree = make_tree(accepted=rng.random((CHAINS, DRAWS)) < rate, **good)
    (sentence,) = findings(tree, BOUNDS)
    assert words in sentence
    assert acceptance_rate(tree) == pytest.approx(rate, abs=0.02)


def test_nuts_acceptance_may_be_high_but_not_low(good):
    posterior = make_tree(**good)["posterior"].to_dataset()
    for rate, count in ((0.95, 0), (0.4, 1)):
        statistics = xr.Dataset({"acceptance_rate": (("chain", "draw"), np.full((CHAINS, DRAWS), rate))})
        assert len(findings(xr.DataTree.from_dict({"posterior": posterior, "sample_stats": statistics}))) == count


def test_divergences_are_counted(good):
    diverging = np.zeros((CHAINS, DRAWS), dtype=bool)
    diverging[0, :7] = True
    statistics = xr.Dataset({"diverging": (("chain", "draw"), diverging)})
    tree = xr.DataTree.from_dict({"posterior": make_tree(**good)["posterior"].to_dataset(), "sample_stats": statistics})
    (sentence,) = findings(tree)
    assert sentence.startswith("7 of 4000 transitions diverged")


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ({"failures": 37}, "37 simulations gave no backbone"),
        (
            {"failures": 37, "simulations": 9000},
            "37 of 9000 simulations gave no backbone, and those proposals were refused: harmless",
        ),
        ({"failures": 900, "simulations": 9000}, "narrow the priors"),
    ],
)
def test_failures_are_counted(good, counts, words):
    tree = make_tree(**good)
    (sentence,) = findings(tree, BOUNDS, **counts)
    assert words in sentence
    tree.attrs.update(counts, gradients=0)  # as `sample` leaves them
    assert findings(tree, BOUNDS) == [sentence]


def test_array_parameters_get_a_row_each(rng):
    values = rng.normal(size=(CHAINS, DRAWS, 2)) + np.array([3.0, 5.0])
    dataset = xr.Dataset({"k": (("chain", "draw", "specimen"), values)}, coords={"specimen": ["a", "b"]})
    tree = xr.DataTree.from_dict({"posterior": dataset})
    assert list(summarise(tree).index) == ["k[a]", "k[b]"]
    (sentence,) = findings(tree, {"k": (5.0, 20.0)})[:1]
    assert sentence.startswith("k[a] leans on the lower bound 5")


def test_results_do_not_depend_on_the_unit(good):
    small = {name: 1e-6 * values for name, values in good.items()}
    bounds = {name: (1e-6 * low, 1e-6 * high) for name, (low, high) in BOUNDS.items()}
    assert findings(make_tree(**small), bounds) == findings(make_tree(**good), BOUNDS) == []


def test_leaning_share_of_a_uniform_is_two_percent():
    draws = np.linspace(0.0, 1.0, 5001)
    for ratio, share in leaning_share(draws, 0.0, 1.0).values():
        assert ratio == pytest.approx(1.0, abs=0.02)
        assert share == pytest.approx(0.02, abs=0.001)


def test_distance_from_uniform_agrees_with_scipy(rng):
    draws = rng.beta(2.0, 3.0, size=500)
    assert distance_from_uniform(3.0 + 2.0 * draws, 3.0, 5.0) == pytest.approx(
        stats.kstest(draws, "uniform").statistic, rel=1e-12
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((xr.DataTree(),), "group 'posterior'"),
        ((42,), "got int"),
    ],
)
def test_not_a_posterior(arguments, words):
    with pytest.raises(InputError, match=words):
        summarise(*arguments)


def test_unknown_names_and_probability(good):
    tree = make_tree(**good)
    with pytest.raises(InputError, match="stiffness, damping"):
        summarise(tree, ["stifness"])
    with pytest.raises(InputError, match="between 0 and 1"):
        summarise(tree, probability=95.0)


def test_one_chain_is_not_said_to_disagree(good):
    """R-hat compares chains; of one it is not a number, and says nothing about agreement."""
    tree = make_tree(**good)
    one = xr.DataTree.from_dict({"posterior": tree["posterior"].to_dataset().isel(chain=[0])})
    said = " ".join(findings(one))
    assert "one chain only" in said and "R-hat" not in said and "nan" not in said
    assert "one chain" not in " ".join(findings(tree))
