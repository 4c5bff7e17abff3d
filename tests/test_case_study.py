"""The source paper's systems, run at reduced size: tables, files, comparisons, and what cannot be identified."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from pymc_backbone import InputError
from pymc_backbone.cli.main import main
from pymc_backbone.paper.case_comparison import compare_distributions, describe_gap, overlap
from pymc_backbone.paper.case_files import describe_case
from pymc_backbone.paper.case_study import KEYS, run_case
from pymc_backbone.paper.cases import CASES
from pymc_backbone.paper.run_cases import run_cases
from pymc_backbone.simulation.backbones import simulate_population

SMALL = {"draws": 250, "tune": 300, "chains": 2, "random_seed": 4}


@pytest.fixture(scope="module")
def first():
    return run_case("1", "joint", specimens=40, **SMALL)


def test_records_hold_the_documented_keys_and_the_numbers_they_stand_for(first):
    case = CASES["1"]
    assert [row["parameter"] for row in first.records] == list(case.prior)
    for row in first.records:
        assert tuple(row) == KEYS
        column = first.vectors[:, case.data.parameter_names.index(row["parameter"])]
        assert (row["drawn_mean"], row["drawn_sd"]) == (column.mean(), column.std())
        assert (row["prior_low"], row["prior_high"]) == case.prior_bounds[row["parameter"]]
        assert (row["published_mean"], row["published_sd"]) == case.published[row["parameter"]]
        draws = np.ravel(first.posterior["posterior"][row["parameter"]])
        assert row["mean"] == pytest.approx(draws.mean())
        assert row["mean"] == pytest.approx(row["drawn_mean"], abs=0.6 * row["drawn_sd"])
    text = describe_case(first)
    assert "| linear_stiffness | N/m | 6500 ± 289 |" in text and "Recovered over true standard deviation" in text


def test_same_seed_gives_the_same_numbers_whatever_the_likelihood(first):
    again = run_case("1", "product", specimens=40, **{**SMALL, "draws": 20})
    assert np.array_equal(again.vectors, first.vectors)
    assert again.backbones.identical(first.backbones)


def test_frequency_alone_says_that_damping_is_not_identified():
    result = run_case("2", "product", specimens=40, observables=("frequency",), **{**SMALL, "draws": 1500})
    assert {"viscous_damping", "friction_force"} <= set(result.undetermined)
    assert "linear_stiffness" not in result.undetermined
    assert "do not identify viscous_damping" in describe_case(result)


def test_folder_holds_tables_figures_and_json(tmp_path):
    said: list[str] = []
    records = run_cases(["beam"], ["joint"], output=tmp_path / "out", say=said.append, **SMALL)
    held = json.loads((tmp_path / "out" / "cases.json").read_text())
    assert held == json.loads(json.dumps(records))
    assert {row["case"] for row in held} == {"beam"} and held[0]["observables"] == ["frequency"]
    names = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert {f"case_beam_joint_{kind}.png" for kind in ("likelihood", "pairs", "trace", "comparison")} <= names
    table = (tmp_path / "out" / "cases.md").read_text()
    assert said[0] in table and "Uniform (low, high)" in table and "6.398, 8.04" in table


def test_case_5_says_what_the_model_cannot_do():
    result = run_case("5", "product", specimens=60, **SMALL)
    assert {item.place for item in result.comparisons} == {"low", "middle", "high"}
    assert "does not follow" in describe_case(result)
    assert min(item.overlap for item in result.comparisons if item.observable == "frequency") < 0.5
    assert all(row["true_mean"] is None and row["drawn_sd"] is None for row in result.records)


def test_amplitude_and_alpha_of_the_hysteretic_case_are_one_parameter(rng):
    """At exponent 1 only (1 - alpha) A enters, so backbones of different A and alpha are the same."""
    case = CASES["4"]
    vectors = case.draw(6, rng)
    a, alpha = (case.data.parameter_names.index(f"bouc_wen_{name}") for name in ("amplitude", "alpha"))
    other = vectors.copy()
    other[:, alpha] = 1.0 - 1.3 * (1.0 - vectors[:, alpha])
    other[:, a] = vectors[:, a] / 1.3
    one, same = (simulate_population(case.data, v, case.levels)["value"].values for v in (vectors, other))
    assert np.abs(same / one - 1.0).max() < 1e-6
    other[:, a] *= 1.05  # negative control: a change of the product is seen
    moved = simulate_population(case.data, other, case.levels)["value"].values
    assert np.abs(moved / one - 1.0).max() > 1e-3


def backbones_of(values: np.ndarray) -> xr.Dataset:
    """Return a dataset of frequencies (n, l)."""
    dims = ("specimen", "observable", "level")
    return xr.Dataset(
        {"value": (dims, values[:, None, :])},
        {"observable": ["frequency"], "level": np.arange(1.0, values.shape[1] + 1.0)},
    )


def test_comparison_measures_known_distances(rng):
    values = rng.normal(10.0, 0.2, (4000, 3))
    found = compare_distributions(backbones_of(values), backbones_of(values + 0.3), "gev")
    for item in found:
        assert item.wasserstein == pytest.approx(0.3, abs=1e-9)
        assert item.overlap == pytest.approx(2.0 * stats.norm.cdf(-0.75), abs=0.03)
    sentence = describe_gap(found, "frequency")
    assert "too high" in sentence and "0.3 Hz" in sentence
    assert describe_gap(
        compare_distributions(backbones_of(values), backbones_of(values), "gev"), "frequency"
    ).startswith("The simulated frequency overlaps")
    assert overlap(values[:, 0], values[:, 0]) == pytest.approx(1.0, abs=1e-6)


def test_gev_has_the_sign_of_its_tail():
    upward = stats.genextreme.rvs(-0.3, 5.0, 0.4, size=3000, random_state=1)
    item = compare_distributions(backbones_of(upward[:, None]), backbones_of(upward[:, None]), "gev")[0]
    assert item.measured_fit == pytest.approx((0.3, 0.4, 5.0), abs=0.05)
    x = np.linspace(4.0, 20.0, 4000)
    assert np.trapezoid(item.density("measured")(x), x) == pytest.approx(1.0, abs=0.02)


def test_unknown_names_end_in_one_sentence(tmp_path, capsys):
    with pytest.raises(InputError, match="likelihood"):
        run_case("1", "joined", **SMALL)
    assert main(["cases", "9", "--out", str(tmp_path / "out")]) == 2
    assert "'9'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_processes_give_the_numbers_of_one_process_and_a_refusal_stops_nothing(tmp_path):
    """The polynomial model of case 5 cannot produce the population: no posterior, a sentence, and the others run."""
    said: list[str] = []
    settings = {**SMALL, "draws": 60, "tune": 100, "specimens": 40}
    side_by_side = run_cases(
        ["5", "beam"], ["data_consistent"], output=tmp_path / "out", say=said.append, workers=2, **settings
    )
    alone = run_cases(["beam"], ["data_consistent"], say=lambda text: None, **settings)
    beam = [row for row in side_by_side if row["case"] == "beam"]
    assert [{**row, "seconds": None} for row in beam] == [{**row, "seconds": None} for row in alone]
    refused = [row for row in side_by_side if row["case"] == "5"]
    assert len(refused) == len(CASES["5"].prior) and all(tuple(row) == KEYS for row in refused)
    assert all(row["mean"] is None and row["prior_low"] is not None for row in refused)
    assert said[0].startswith("## Case 5") and "No posterior: of the draws from the priors, none" in said[0]
    assert json.loads((tmp_path / "out" / "cases.json").read_text()) == json.loads(json.dumps(side_by_side))
    with pytest.raises(InputError, match="`draws` must be"):  # nothing but refusals is an error
        run_cases(["beam"], ["product"], say=lambda text: None, **{**settings, "draws": 0})
