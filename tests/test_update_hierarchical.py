"""`update` with the hierarchical likelihood: the population in words, numbers and pictures, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from pymc_backbone import Oscillator, plots, simulate_backbone
from pymc_backbone._common.backbone_dataset import backbone_dataset
from pymc_backbone._common.checks import InputError
from pymc_backbone.inference.options import Comparing, Modelling, Sampling
from pymc_backbone.inference.population_summary import population_of
from pymc_backbone.measurement.reading.options import Reading
from pymc_backbone.reporting.backbone_files import backbone_table
from pymc_backbone.reporting.output_folder import RESULT_KEYS, read_result
from pymc_backbone.workflows.update import update

# Asked for by PyMC's LKJCorr; the command line keeps it from the user.
pytestmark = pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS")

LEVELS = np.array([0.004, 0.007, 0.01])
STIFFNESS, DAMPING = 6500.0, 1.1
SCATTER, CORRELATION = 0.03, 0.97
SPECIMENS = 6
NUTS = Sampling(draws=150, tune=200, chains=2, step="nuts", random_seed=3)


def batch(truth: np.ndarray, error: float = 1e-3) -> xr.Dataset:
    """Return backbones of linear oscillators with these stiffnesses and dampings (n, 2), and small errors."""
    rng = np.random.default_rng(8)
    exact = np.array([simulate_backbone(Oscillator(1.0), row, LEVELS).values[:2] for row in truth])
    spread = (error * exact)[..., None] ** 2 * np.eye(LEVELS.size)
    names = [f"s{i + 1}" for i in range(len(truth))]
    value = exact * (1.0 + error * rng.standard_normal(exact.shape))
    return backbone_dataset(names, ("frequency", "damping"), LEVELS, value, spread, "m", [])


def population(n: int = SPECIMENS) -> np.ndarray:
    """Return parameters (n, 2) whose mean, spread and correlation are exactly those asked for."""
    raw = np.random.default_rng(5).standard_normal((n, 2))
    raw = (raw - raw.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(raw.T))).T
    mixed = raw @ np.linalg.cholesky([[1.0, CORRELATION], [CORRELATION, 1.0]]).T
    return np.array([STIFFNESS, DAMPING]) * (1.0 + SCATTER * mixed)


def run(folder, data: xr.Dataset, *, comparing=None, modelling=None, sampling=NUTS, output=None) -> tuple[dict, str]:
    table = folder / "backbones.csv"
    backbone_table(data).to_csv(table, index=False)
    lines: list[str] = []
    result = update(
        table,
        modelling or Modelling(1.0),
        reading=Reading(is_table=True),
        comparing=comparing or Comparing("hierarchical"),
        sampling=sampling,
        output=output,
        say=lines.append,
    )
    return result, "\n".join(lines)


def test_a_population_comes_out_in_words_numbers_and_pictures(tmp_path):
    """One test of one run: of several, each process that tests would compile the model."""
    result, text = run(tmp_path, batch(population()), output=tmp_path / "out")
    mean_spread_and_correlation_are_those_of_the_population(result["population"])
    specimens_are_told_apart_and_the_fit_is_checked(result, text)
    the_folder_holds_the_population(result, tmp_path / "out")
    the_figure_has_a_panel_for_each_parameter_and_refuses_other_posteriors(tmp_path / "out")


def mean_spread_and_correlation_are_those_of_the_population(found):
    assert found["family"] == "normal" and found["unidentified"] == [] and found["prior_spreads"] == []
    for name, truth in (("linear_stiffness", STIFFNESS), ("viscous_damping", DAMPING)):
        mean, spread = found["parameters"][name]["mean"], found["parameters"][name]["sd"]
        # n specimens give the mean to spread / root n; the posterior of their spread is skew, above the sample's
        assert mean["mean"] == pytest.approx(truth, abs=0.5 * SCATTER * truth / np.sqrt(SPECIMENS))
        assert mean["hdi_low"] < truth < mean["hdi_high"]
        assert mean["sd"] == pytest.approx(SCATTER * truth / np.sqrt(SPECIMENS), rel=0.6)
        assert spread["hdi_low"] < SCATTER * truth < spread["hdi_high"] and 0.0 <= spread["prior_low"]
        assert SCATTER * truth < spread["mean"] < 2.0 * SCATTER * truth
    [pair] = found["correlations"]
    assert pair["between"] == ["linear_stiffness", "viscous_damping"]
    # six specimens refute independence, and hardly tell more: by Fisher's z the interval alone is 0.74 to 0.997
    assert 0.0 < pair["hdi_low"] < CORRELATION < pair["hdi_high"] <= 1.0


def specimens_are_told_apart_and_the_fit_is_checked(result, text):
    truth = population()
    for s in range(SPECIMENS):
        entry = result["parameters"][f"linear_stiffness[s{s + 1}]"]
        assert entry["mean"] == pytest.approx(truth[s, 0], abs=4.0 * entry["sd"])
        assert entry["sd"] < 0.1 * SCATTER * STIFFNESS and np.isnan(entry["prior_low"])
    assert result["fit"]["likelihood"] == "specimen" and result["fit"]["passes"]
    assert result["settings"]["likelihood"] == "hierarchical" and result["settings"]["population"] == "correlated"
    assert "linear_stiffness, mean over the batch" in text and "The specimens:" in text
    assert "correlation of linear_stiffness and viscous_damping" in text


def the_folder_holds_the_population(result, folder):
    written = read_result(folder)
    assert set(written) == set(RESULT_KEYS)
    assert written["population"] == json.loads(json.dumps(result["population"]))
    assert written["parameters"]["linear_stiffness[s1]"]["prior_low"] is None
    figures = {name for name in written["files"] if name.endswith(".png")}
    assert "figures/population.png" in figures and "figures/prior_posterior.png" not in figures
    page = (folder / "report.html").read_text()
    assert "The population" in page and "linear stiffness and viscous damping" in page and "hierarchical model" in page
    rows = (folder / "summary.csv").read_text().splitlines()
    assert rows[1].startswith("linear_stiffness_mean,") and any(row.startswith("viscous_damping[s6]") for row in rows)
    assert sum(row.startswith("linear_stiffness_") for row in rows) == 2


def the_figure_has_a_panel_for_each_parameter_and_refuses_other_posteriors(folder):
    posterior = xr.open_datatree(folder / "posterior.nc", engine="h5netcdf").load()
    figure = plots.plot_population(posterior, Oscillator(1.0))
    labels = [axis.get_xlabel() for axis in figure.axes if axis.get_visible()]
    assert labels[0] == "Linear stiffness [N/m]" and labels[1] == "Viscous damping [N s/m]"
    assert labels[2].startswith("Correlation over the population")
    renamed = posterior["posterior"].to_dataset().assign_coords(specimen=[f"free_swing_data_{k}" for k in range(6)])
    named = plots.plot_population(xr.DataTree.from_dict({"posterior": renamed}), Oscillator(1.0))
    beside = [text.get_text() for text in named.axes[0].texts]
    assert beside == [f"\N{HORIZONTAL ELLIPSIS}_swing_data_{k}" for k in range(6)]
    with pytest.raises(InputError, match="from build_hierarchical_model"):
        plots.plot_population(xr.DataTree.from_dict({"posterior": xr.Dataset()}), Oscillator(1.0))


def test_a_uniform_population_and_one_that_the_specimens_say_nothing_of(rng):
    """From draws made here: edges have triangular priors, a spread of its prior is said to be one."""
    shape = (2, 2000)
    low, high = 0.0, 12.0
    spread = np.abs(rng.normal(0.0, (high - low) / np.sqrt(12.0), (*shape, 1)))
    dims = ("chain", "draw")
    common = {"k_mean": (dims, rng.normal(6.0, 1.0, shape)), "k_sd": (dims, spread[..., 0])}
    normal = xr.Dataset({**common, "population_spread": ((*dims, "parameter"), spread)}, coords={"parameter": ["k"]})
    found = population_of(xr.DataTree.from_dict({"posterior": normal}), {"k": (low, high)})
    assert found.prior_spreads == ("k",) and "3 specimens say nothing of it" in found.sentences(3)[0]
    narrow = normal.assign(population_spread=0.1 * normal["population_spread"])
    assert population_of(xr.DataTree.from_dict({"posterior": narrow}), {"k": (low, high)}).prior_spreads == ()
    uniform = xr.Dataset({**common, "k_low": (dims, rng.random(shape)), "k_high": (dims, 5.0 + rng.random(shape))})
    found = population_of(xr.DataTree.from_dict({"posterior": uniform}), {"k": (low, high)})
    pairs = np.sort(rng.uniform(low, high, (200_000, 2)), axis=1)  # the prior, drawn
    expected = np.quantile(pairs.mean(axis=1), [0.025, 0.975]), np.quantile(np.ptp(pairs, axis=1), [0.025, 0.975])
    entry = found.parameters["k"]
    assert found.family == "uniform" and found.prior_spreads == ()
    assert [entry["mean"]["prior_low"], entry["mean"]["prior_high"]] == pytest.approx(expected[0], abs=0.05)
    got = [entry["sd"]["prior_low"], entry["sd"]["prior_high"]]
    assert got == pytest.approx(expected[1] / np.sqrt(12.0), abs=0.02)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"sampling": Sampling(step="metropolis")},
            "too many for the random walk of step 'metropolis'; use `step=nuts`",
        ),
        ({"modelling": Modelling(1.0, mass_error=0.1)}, "an uncertain mass is not for a hierarchical model"),
        ({"comparing": Comparing("hierarchical", "joint")}, "`density` and `marginal` are those of the likelihood"),
        ({"comparing": Comparing("specimen", population="uniform")}, "`population` is the family of a hierarchical"),
        ({"comparing": Comparing("hierarchical", population="gamma")}, "`population` must be one of"),
        ({"comparing": Comparing("hierarchy")}, "`likelihood` must be one of"),
    ],
)
def test_what_does_not_go_together_is_refused_before_anything_is_read(tmp_path, changed, words):
    settings = {"modelling": Modelling(1.0), "comparing": Comparing("hierarchical"), "sampling": NUTS, **changed}
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        update(tmp_path / "not_there", settings.pop("modelling"), **settings, say=lambda _: None)


def test_two_specimens_are_too_few(tmp_path):
    with pytest.raises(InputError, match="at least 3 specimens, got 2"):
        run(tmp_path, batch(population()[:2]))
