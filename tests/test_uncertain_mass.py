"""A mass that is known to so much only: a variable of the model, and a part of what is said of stiffness."""

from __future__ import annotations

import argparse

import numpy as np
import pytest
import xarray as xr

from pymc_backbone._common.backbone_dataset import backbone_dataset
from pymc_backbone._common.checks import InputError
from pymc_backbone.cli.options import mass
from pymc_backbone.effects import LIBRARY
from pymc_backbone.inference.model import build_model
from pymc_backbone.inference.options import Comparing, Modelling, Sampling
from pymc_backbone.measurement.reading.options import Reading
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.reporting.backbone_files import backbone_table
from pymc_backbone.simulation.decay import simulate_backbone
from pymc_backbone.workflows.diagnose import command_line, with_uncertain_mass
from pymc_backbone.workflows.update import update

from .study_cases import make_study

MASS, ERROR = 2.3, 0.05
STIFFNESS, DAMPING = 2300.0, 2.0
LEVELS = np.array([0.004, 0.007, 0.01])


def linear(error: float = 1e-4) -> xr.Dataset:
    """Return the exact backbone of a linear oscillator, three specimens with errors of their own."""
    rng = np.random.default_rng(11)
    exact = simulate_backbone(Oscillator(MASS), {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING}, LEVELS)
    value = exact.values[:2] * (1.0 + error * rng.standard_normal((3, 2, LEVELS.size)))
    spread = (error * exact.values[:2])[..., None] ** 2 * np.eye(LEVELS.size) * np.ones((3, 1, 1, 1))
    return backbone_dataset(["a", "b", "c"], ("frequency", "damping"), LEVELS, value, spread, "m", [])


@pytest.mark.parametrize(
    ("text", "pair"),
    [("2.3", (2.3, 0.0)), ("2.3±0.05", (2.3, 0.05)), ("2.3 +- 0.05", (2.3, 0.05)), ("2.3+/-5e-2", (2.3, 0.05))],
)
def test_the_option_reads_a_deviation(text: str, pair: tuple[float, float]) -> None:
    assert mass(text) == pair


@pytest.mark.parametrize("text", ["", "x", "2.3±", "±0.05", "2.3±0", "2.3±-1", "2.3±3", "2.3±0.05±0.01", "inf"])
def test_nonsense_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="expected a "):
        mass(text)


@pytest.mark.parametrize("name", [name for name in LIBRARY if name not in ("linear_stiffness", "viscous_damping")])
def test_parameters_go_with_the_mass_as_they_say(name: str) -> None:
    # the oracle is the simulator: twice the mass with the parameters scaled has the same backbone, at any level
    light = Oscillator(1.0, name)
    effect = LIBRARY[name]
    assert effect.signature is not None
    values = {"linear_stiffness": 400.0, "viscous_damping": 0.2}
    values |= dict(zip(effect.parameter_names, effect.signature.typical(1.0, 1.0, 20.0), strict=True))
    powers = light.mass_exponents
    heavy = {key: value * 2.0 ** powers[key] for key, value in values.items()}
    options = {"release_amplitude": 1.2}
    one = simulate_backbone(light, values, 100.0 * LEVELS, **options).values
    other = simulate_backbone(Oscillator(2.0, name), heavy, 100.0 * LEVELS, **options).values
    np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-9)
    assert np.isfinite(one).any()
    without = {key: value * (1.0 if key in effect.parameter_names else 2.0) for key, value in values.items()}
    assert not np.allclose(
        simulate_backbone(Oscillator(2.0, name), without, 100.0 * LEVELS, **options).values, one, rtol=1e-5
    )


def run(tmp_path, mass_error: float, fixed: dict[str, float] | None = None) -> dict:
    table = tmp_path / "backbones.csv"
    backbone_table(linear()).to_csv(table, index=False)
    return update(
        table,
        Modelling(MASS, (), fixed=fixed or {}, mass_error=mass_error),
        reading=Reading(is_table=True),
        comparing=Comparing("pooled"),
        sampling=Sampling(draws=1500, tune=1500, chains=2, random_seed=3),
        say=lambda _: None,
    )


def test_the_mass_keeps_its_prior_and_lends_its_doubt(tmp_path) -> None:
    known, uncertain = run(tmp_path, 0.0), run(tmp_path, ERROR)
    found = uncertain["parameters"]
    assert list(found) == ["mass", "linear_stiffness", "viscous_damping"]
    # of some thousand effective draws: three per cent of a standard deviation, ten for what a chain of Metropolis has
    assert found["mass"]["mean"] == pytest.approx(MASS, abs=0.15 * ERROR)
    assert found["mass"]["sd"] == pytest.approx(ERROR, rel=0.15)
    assert found["mass"]["unit"] == "kg"
    for name, true in (("linear_stiffness", STIFFNESS), ("viscous_damping", DAMPING)):
        own = known["parameters"][name]["sd"] / true
        assert own < 0.2 * ERROR / MASS  # negative control: a known mass leaves a tenth of a per cent at most
        assert found[name]["sd"] / true == pytest.approx(np.hypot(own, ERROR / MASS), rel=0.15)
        assert found[name]["mean"] == pytest.approx(true, rel=0.01)
    assert uncertain["fit"]["passes"] and uncertain["mass_error"] == ERROR and known["mass_error"] == 0.0


def test_a_known_stiffness_tells_the_mass(tmp_path) -> None:
    # a static test gave the stiffness: the frequency then weighs the structure
    static = 1.03 * STIFFNESS
    found = run(tmp_path, ERROR, {"linear_stiffness": static})
    frequency = linear()["value"].sel(observable="frequency").values.mean()
    damping = linear()["value"].sel(observable="damping").values.mean()
    ratio = damping / np.hypot(damping, 2.0 * np.pi)  # of the undamped frequency
    weighed = static * (1.0 - ratio**2) / (2.0 * np.pi * frequency) ** 2
    assert found["parameters"]["mass"]["mean"] == pytest.approx(weighed, rel=2e-4)
    assert found["parameters"]["mass"]["sd"] < 0.05 * ERROR
    assert found["fit"]["passes"]


def test_what_has_no_mass_refuses() -> None:
    def function(parameters, levels):
        return np.ones((2, levels.size))

    with pytest.raises(InputError, match="a function has none"):
        build_model(function, linear(), {"a": (0.0, 1.0)}, mass_error=0.1)
    with pytest.raises(InputError, match="`mass_error` must be positive"):
        build_model(Oscillator(MASS), linear(), mass_error=-0.1)


def test_a_study_widens_what_goes_with_the_mass() -> None:
    study = make_study("found")
    wide = with_uncertain_mass(study, 0.1 * study.base.mass)
    powers = (study.extended or study.base).mass_exponents
    for effect, group in study.parameters.items():
        for name, before in group.items():
            after = wide.parameters[effect][name]
            expected = np.hypot(before.sd, 0.1 * powers[name] * before.mean)
            assert after.mean == before.mean and after.sd == pytest.approx(expected)
            assert after.hdi_low <= before.hdi_low and after.hdi_high >= before.hdi_high
    assert any("hold its 10.00%" in note for note in wide.notes)


def test_the_command_that_repeats_a_study_has_the_deviation() -> None:
    assert "--mass 2.3+-0.05" in command_line("records", (MASS, ERROR), (), {}, "out")
    assert "--mass 2.3 " in command_line("records", MASS, (), {}, "out")
