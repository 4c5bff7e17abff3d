"""From measured backbones to an output folder, with the sampler replaced by draws whose distribution is known."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from pymc_backbone._common.checks import InputError
from pymc_backbone._common.options import names_of, pick
from pymc_backbone.inference import goodness  # noqa: F401  it needs the model that the fixture replaces
from pymc_backbone.inference.measured import likelihood_of  # before the fixture takes the place of its module
from pymc_backbone.inference.options import Comparing, Keeping, Modelling, Sampling
from pymc_backbone.inference.store import run_folder  # noqa: F401  it needs the model that the fixture replaces
from pymc_backbone.likelihood.density_fit import fit_density
from pymc_backbone.measurement.options import Measuring
from pymc_backbone.measurement.reading.options import Reading
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.reporting.backbone_files import backbone_table
from pymc_backbone.reporting.output_folder import RESULT_KEYS, read_result
from pymc_backbone.reporting.terminal import _row, compare, damping_ratio_words, describe_measured
from pymc_backbone.simulation.backbones import simulate_population
from pymc_backbone.workflows import demo, infer
from pymc_backbone.workflows import update as run
from pymc_backbone.workflows.measure import Measured

MEANS = {"linear_stiffness": (7000.0, 140.0), "viscous_damping": (1.7, 0.1), "cubic_stiffness": (6e6, 3.6e5)}
LEVELS = np.geomspace(0.002, 0.018, 4)
OSCILLATOR = Oscillator(1.0, "cubic_stiffness")


def make_backbones(rng: np.random.Generator, specimens: int) -> xr.Dataset:
    parameters = np.column_stack([rng.normal(mean, sd, specimens) for mean, sd in MEANS.values()])
    dataset = simulate_population(OSCILLATOR, parameters, LEVELS).assign_coords(
        specimen=[f"beam_{i + 1}" for i in range(specimens)]
    )
    error = np.broadcast_to(np.array([0.002, 0.0002])[:, None], dataset["value"].shape)
    dataset["standard_error"] = (dataset["value"].dims, error)
    dataset["covariance"] = (dataset["covariance"].dims, error[..., None] ** 2 * np.eye(LEVELS.size))
    dataset.attrs["notes"] = ["m was assumed"]
    return dataset


@pytest.fixture
def sampler(monkeypatch, rng) -> dict:
    """Replace model and sampler; keep what they were called with."""
    kept: dict = {}

    def build_model(oscillator, data, **settings):
        kept["model"] = {"oscillator": oscillator, "data": data, **settings}
        return "model"

    def sample(model, **settings):
        kept["sample"] = {"model": model, **settings}
        shape = (settings["chains"], settings["draws"])
        dims: tuple[str, ...] = ("chain", "draw")
        names = [name for name in MEANS if name in kept["model"]["bounds"]]
        draws = {name: (dims, rng.normal(*MEANS[name], shape)) for name in names}
        tree = xr.DataTree.from_dict({"posterior": xr.Dataset(draws)})
        tree.attrs.update(kept.get("attrs", {}))
        return tree

    def targets_of(model):
        called = kept["model"]
        density = None
        if called["likelihood"] == "population":
            density = fit_density(called["data"], kind=called["density"], marginal=called["marginal"])
        return [SimpleNamespace(density=density)]

    replaced = {"model": (build_model, likelihood_of), "targets": (targets_of,), "sampling": (sample,)}
    for name, functions in replaced.items():
        module = ModuleType(f"pymc_backbone.inference.{name}")
        for function in functions:
            setattr(module, function.__name__, function)
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return kept


def update(monkeypatch, backbones: xr.Dataset, **settings) -> tuple[dict, str]:
    monkeypatch.setattr(run, "measure", lambda *_, **__: Measured(backbones, 90.0))
    lines: list[str] = []
    chosen = {"mass": 1.0, "effects": ["cubic_stiffness"], "draws": 300, **settings}
    return call_update(**chosen, say=lines.append), "\n".join(lines)


def call_update(**settings) -> dict:
    """Call `update` with settings by name, as the command line gives them."""
    kinds = {"comparing": Comparing, "sampling": Sampling, "keeping": Keeping}
    grouped = {name for kind in (Modelling, *kinds.values()) for name in names_of(kind)}
    return run.update(
        "records",
        pick(Modelling, settings),
        **{name: pick(kind, settings) for name, kind in kinds.items()},
        **{name: value for name, value in settings.items() if name not in grouped},
    )


def test_update_writes_what_it_returns(monkeypatch, sampler, rng, tmp_path):
    result, text = update(monkeypatch, make_backbones(rng, 12), output=tmp_path / "out", random_seed=3)
    written = read_result(tmp_path / "out")
    assert set(written) == set(RESULT_KEYS)
    assert written["parameters"] == json.loads(json.dumps(result["parameters"]))
    entry = result["parameters"]["viscous_damping"]
    assert entry["unit"] == "N s/m" and entry["prior_low"] == 0.0
    # Four standard errors of 1200 draws.
    assert entry["mean"] == pytest.approx(1.7, abs=4 * 0.1 / np.sqrt(1200))
    assert result["notes"] == ["m was assumed"] and result["levels"] == pytest.approx(LEVELS)
    assert str(tmp_path / "out") in text and "viscous_damping" in text
    figures = {Path(name).stem for name in written["files"] if name.endswith(".png")}
    assert figures == {"backbones", "densities", "predictive", "prior_posterior", "trace", "rank", "pair"}


def test_update_says_first_that_a_model_does_not_fit(monkeypatch, sampler, rng, tmp_path):
    """Backbones of a cubic spring, a linear model: the sampler's draws are perfect, the model is not."""
    backbones = make_backbones(rng, 12)
    right, _ = update(monkeypatch, backbones, output=tmp_path / "right", random_seed=3)
    assert right["fit"]["passes"] and not any("does not fit" in sentence for sentence in right["findings"])
    wrong, text = update(monkeypatch, backbones, effects=["coulomb_friction"], fixed={"friction_force": 0.01},
                         output=tmp_path / "wrong", random_seed=3)  # fmt: skip
    first = wrong["findings"][0]
    assert first.startswith("The model does not fit: ") and "frequency at 0.018 m is" in first
    assert "run `pymc-backbone diagnose --base coulomb_friction` with the same records" in first
    assert "Nothing wrong" not in text and first in text
    fit = read_result(tmp_path / "wrong")["fit"]
    assert fit["p_value"] < 1e-6 and not fit["passes"]
    assert f"{fit['worst']['observable']} at {fit['worst']['level']:.4g} m is" in first.split(":")[1]
    assert len(fit["specimens"]) == 12 and len(fit["entries"]) == 2 * LEVELS.size
    assert "fit" in text and str(tmp_path / "wrong" / "report.html") in text


def test_report_of_an_update_says_the_verdict_first_and_escapes_what_files_say(monkeypatch, sampler, rng, tmp_path):
    hostile = '<script>alert("x")</script>'
    backbones = make_backbones(rng, 3)
    backbones = backbones.assign_coords(specimen=[hostile, "b&b", "c"])
    backbones.attrs["notes"] = [hostile]
    update(monkeypatch, backbones, effects=["coulomb_friction"], fixed={"friction_force": 0.01},
           likelihood="specimen", output=tmp_path / "out")  # fmt: skip
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script" not in page and "&lt;script&gt;" in page and "b&amp;b" in page
    order = [
        page.index(word) for word in ("<h1>", "Findings", "Measured against predicted", "Misfit of each", "Sampling")
    ]
    assert order == sorted(order) and "does not fit" in page[order[0] : order[1]].lower()
    assert page.count('<img alt="') >= 5 and "http://" not in page and "https://" not in page


def test_resumed_run_replaces_what_an_interrupted_one_wrote_and_nothing_else(monkeypatch, sampler, rng, tmp_path):
    backbones, settings = make_backbones(rng, 12), {"store": tmp_path / "run", "output": tmp_path / "out"}
    sampler["attrs"] = {"interrupted": "Stopped with Ctrl-C after 9 of 99 draws."}
    result, text = update(monkeypatch, backbones, **settings)
    assert result["interrupted"] in text and read_result(tmp_path / "out")["interrupted"] == result["interrupted"]
    assert sampler["sample"]["store"] == tmp_path / "run" and sampler["sample"]["resume"] is False
    sampler["attrs"] = {}
    result, _ = update(monkeypatch, backbones, resume=True, **settings)
    assert result["interrupted"] is None and read_result(tmp_path / "out")["interrupted"] is None
    assert sampler["sample"]["resume"] is True
    with pytest.raises(InputError, match="is not empty"):  # a whole result is not replaced unasked
        update(monkeypatch, backbones, resume=True, **settings)


def test_one_chain_that_was_ended_early_is_summarised_from_twenty_draws(monkeypatch, sampler, rng, tmp_path):
    """Chains come one after another: Ctrl-C mostly leaves one."""
    backbones = make_backbones(rng, 12)
    sampler["attrs"] = {"interrupted": "Stopped with Ctrl-C."}
    settings = {"store": tmp_path / "run", "chains": 1, "output": tmp_path / "out"}
    result, _ = update(monkeypatch, backbones, draws=infer.FEWEST_DRAWS, **settings)
    assert result["parameters"]["linear_stiffness"]["mean"] == pytest.approx(7000.0, abs=4 * 140.0 / 20**0.5)
    written = read_result(tmp_path / "out")
    assert "figures/trace.png" in written["files"] and "figures/rank.png" not in written["files"]
    with pytest.raises(KeyboardInterrupt):
        update(monkeypatch, backbones, draws=infer.FEWEST_DRAWS - 1, overwrite=True, **settings)


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"resume": True}, "name its folder with `store`"), ({"store": "a", "output": "b/../a"}, "a folder of its own")],
)
def test_store_that_cannot_be_is_refused_before_reading(monkeypatch, sampler, rng, tmp_path, settings, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "measure", lambda *_, **__: pytest.fail("the records were read"))
    with pytest.raises(InputError, match=words):
        call_update(mass=1.0, **settings)


def test_without_output_nothing_is_written(monkeypatch, sampler, rng, tmp_path):
    monkeypatch.chdir(tmp_path)
    result, text = update(monkeypatch, make_backbones(rng, 12))
    assert list(tmp_path.iterdir()) == []
    assert result["seconds"]["total"] > 0.0 and "Findings:" in text
    assert sampler["sample"]["random_seed"] == result["seed"]  # a seed that was drawn is told, to repeat the run


def test_settings_reach_model_and_sampler(monkeypatch, sampler, rng):
    result, _ = update(
        monkeypatch, make_backbones(rng, 12), priors={"cubic_stiffness": (0.0, 1e7)}, fixed={"viscous_damping": 1.7},
        chains=2, tune=50, step="slice", random_seed=5,
    )  # fmt: skip
    assert list(sampler["model"]["bounds"]) == ["linear_stiffness", "cubic_stiffness"]
    assert sampler["model"]["bounds"]["cubic_stiffness"] == (0.0, 1e7)
    assert sampler["model"]["fixed"] == {"viscous_damping": 1.7}
    wanted = {"model": "model", "draws": 300, "tune": 50, "chains": 2, "step": "slice", "random_seed": 5}
    assert sampler["sample"] == {**wanted, "progress": None}
    assert list(result["parameters"]) == ["linear_stiffness", "cubic_stiffness"] and result["fixed"] == {
        "viscous_damping": 1.7
    }


@pytest.mark.parametrize(("specimens", "kind"), [(12, "population"), (3, "specimen"), (1, "pooled")])
def test_auto_likelihood_depends_on_the_size_of_the_batch(monkeypatch, sampler, rng, specimens, kind):
    result, _ = update(monkeypatch, make_backbones(rng, specimens))
    assert sampler["model"]["likelihood"] == result["settings"]["likelihood"] == kind
    assert (result["density"] is not None) == (kind == "population")
    assert (result["density"] is None) == (kind != "population")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"priors": {"cubic": (0, 1)}}, "`priors` must be one of"),
        ({"fixed": {"viscous_dampin": 1.0}}, "Did you mean 'viscous_damping'"),
        ({"fixed": {"viscous_damping": 1.0}, "priors": {"viscous_damping": (0, 1)}}, "both a prior and a fixed value"),
        ({"fixed": dict.fromkeys(MEANS, 1.0)}, "leave at least one"),
        ({"mass": -1.0}, "`mass` must be positive"),
        ({"effects": ["cubic_stifness"]}, "Did you mean 'cubic_stiffness'"),
    ],
)
def test_settings_that_cannot_be_used(monkeypatch, rng, settings, words):
    with pytest.raises(InputError, match=words):
        update(monkeypatch, make_backbones(rng, 3), **settings)


def test_comparison_has_the_moments_of_both(rng):
    measured, simulated = make_backbones(rng, 12), make_backbones(rng, 50)
    rows = compare(measured, simulated)
    assert len(rows) == 2 * LEVELS.size
    row = rows[LEVELS.size + 1]
    assert (row["observable"], row["unit"], row["level"]) == ("damping", "1", pytest.approx(LEVELS[1]))
    values = measured["value"].sel(observable="damping").values[:, 1]
    assert row["measured_sd"] == pytest.approx(np.std(values, ddof=1))
    assert row["measured_standard_error"] == pytest.approx(0.0002)
    assert row["simulated_mean"] == pytest.approx(simulated["value"].sel(observable="damping").values[:, 1].mean())


def test_damping_is_said_as_ratio_and_quality_factor_once_and_rightly(rng):
    """Of a viscous damper the decrement is 2 pi zeta / sqrt(1 - zeta^2), and Q = 1 / (2 zeta)."""
    for zeta in (0.001, 0.02, 0.3):
        decrement = 2.0 * np.pi * zeta / np.sqrt(1.0 - zeta**2)
        text = damping_ratio_words([np.nan, decrement], [0.01, 0.02], "m")
        assert f"{100.0 * zeta:.3g} % (Q = {0.5 / zeta:.3g}) at 20 mm" in text and text.count("%") == 1
    assert damping_ratio_words([np.nan, -0.1], [0.01, 0.02], "m") == ""
    backbones = make_backbones(rng, 3)
    assert describe_measured(backbones).count("damping ratio") == 1
    alone = backbones.sel(observable=["frequency"])
    assert "damping ratio" not in describe_measured(alone)


@pytest.mark.parametrize(
    ("mean", "sd"), [(29720.4, 1.885), (0.6032, 0.025), (5.94e6, 3.3e5), (-1.23456e-7, 2.0e-12), (12.0, 4.0)]
)
def test_digits_follow_the_standard_deviation(mean, sd):
    """No interval of one number twice, and no digit behind the second uncertain one."""
    entry = {"mean": mean, "sd": sd, "hdi_low": mean - 2 * sd, "hdi_high": mean + 2 * sd, "r_hat": 1.0, "ess_bulk": 1e3}
    _, shown, spread, interval, *_ = _row(entry, "N/m")
    low, high = map(float, interval.split(" to "))
    values = {shown: mean, interval.split(" to ")[0]: mean - 2 * sd, interval.split(" to ")[1]: mean + 2 * sd}
    for text, value in values.items():
        # two digits of the standard deviation: rounded to a twentieth of its power of ten
        assert float(text) == pytest.approx(value, abs=0.0501 * 10.0 ** np.ceil(np.log10(sd)))
        digits = text.lstrip("-").partition("e")[0].replace(".", "").lstrip("0")
        assert len(digits) <= np.floor(np.log10(np.abs(mean) + 2 * sd)) - np.floor(np.log10(sd)) + 2
    assert high - low > 3.0 * sd and float(spread) == pytest.approx(sd, rel=0.05)


def test_one_specimen_has_no_scatter(rng):
    text = describe_measured(make_backbones(rng, 1))
    assert text.startswith("1 specimen, 4 levels from 0.002 to 0.018 m")
    assert text.splitlines()[3].split()[4] == "-"


def test_tables_are_read_at_as_many_levels_as_asked_for(rng, tmp_path):
    backbones = make_backbones(rng, 3)
    backbone_table(backbones).to_csv(tmp_path / "backbones.csv", index=False)
    tables = Reading(is_table=True)
    measured = run.measure(tmp_path / "backbones.csv", tables, Measuring(levels=3, observables=["damping"]))
    assert measured.backbones["level"].values == pytest.approx(np.geomspace(0.002, 0.018, 3))
    assert list(measured.backbones["observable"].values) == ["damping"]
    for options, words in (
        ({"band": (1.0, 2.0)}, "`band`"),
        ({"observables": ["offset"]}, "offset"),
        ({"levels": 10**6}, "at most 1000"),
    ):
        with pytest.raises(InputError, match=words):
            run.measure(tmp_path / "backbones.csv", tables, Measuring(**options))
    with pytest.raises(InputError, match="`unit` is for time histories"):
        run.measure(tmp_path / "backbones.csv", Reading(unit="mm", is_table=True))


def test_demo_data_are_as_documented():
    mass, truth = demo.demo_parameters()
    names = sorted(path.stem for path in demo.demo_folder().glob("*.csv"))
    data = json.loads((demo.demo_folder() / demo.TRUTH).read_text())
    assert mass == 1.0 and list(truth) == list(OSCILLATOR.parameter_names)
    assert names == [specimen["specimen"] for specimen in data["specimens"]]
    assert all(values.shape == (24,) for values in truth.values())
    assert sum(path.stat().st_size for path in demo.demo_folder().iterdir()) < 1.5e6


def test_demo_prints_truth_beside_the_result_and_replaces_only_its_own_output(monkeypatch, sampler, rng, tmp_path):
    monkeypatch.setattr(run, "measure", lambda *_, **__: Measured(make_backbones(rng, 24), 90.0))
    for _ in range(2):
        lines: list[str] = []
        result = demo.run_demo(tmp_path / "out", say=lines.append, sampling=Sampling(draws=200))
        assert result["command"] == "demo" and "true mean" in "\n".join(lines)
        assert lines[-1].strip().startswith("Where to look")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="`overwrite=True`"):
        demo.run_demo(tmp_path / "mine", say=lines.append)
