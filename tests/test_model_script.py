"""The script that a study leaves behind: it runs, repeats the posterior, and holds no code from names."""

from __future__ import annotations

import ast
import dataclasses
import subprocess
import sys

import numba
import numpy as np
import pytest
import xarray as xr

from pymc_backbone import Effect, InputError, Oscillator, Parameter, read_backbones
from pymc_backbone.reporting.claimed_folder import prepare_output
from pymc_backbone.reporting.model_script import model_script
from pymc_backbone.reporting.output_folder import write_results

from .study_cases import make_study


def write(study, folder):
    prepare_output(folder)
    texts = {"model.py": model_script(study, "0.1.0")}
    write_results(folder, {}, backbones=study.backbones, texts=texts)
    return folder / "model.py"


def run(path, *, cwd):
    command = [sys.executable, str(path)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=300, check=False)


def literals(text):
    """Arguments of Oscillator and of each prior, as written in the script."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    (oscillator,) = [call for call in calls if ast.unparse(call.func) == "Oscillator"]
    priors = [call for call in calls if ast.unparse(call.func) == "pm.Uniform"]
    return [ast.literal_eval(argument) for argument in oscillator.args], {
        ast.literal_eval(call.args[0]): tuple(map(ast.literal_eval, call.args[1:])) for call in priors
    }


@pytest.mark.parametrize(
    ("likelihood", "step"),
    [
        ("pooled", "metropolis"),
        pytest.param("specimen", "metropolis", marks=pytest.mark.slow),
        pytest.param("population", "demetropolisz", marks=pytest.mark.slow),
    ],
)
def test_script_repeats_the_posterior(tmp_path, likelihood, step):
    specimens = 8 if likelihood == "population" else 2
    study = make_study("found", specimens=specimens, likelihood=likelihood, draws=30, step=step)
    if likelihood == "population":
        assert np.isnan(study.backbones["value"]).any()
    done = run(write(study, tmp_path / "out"), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "friction_force" in done.stdout and "hdi95_lb" in done.stdout
    with xr.open_datatree(tmp_path / "out" / "posterior_again.nc", engine="h5netcdf") as tree:
        for name, draws in study.posterior["posterior"].data_vars.items():
            np.testing.assert_array_equal(tree["posterior"][name], draws)  # same seed, same draws: same means


def test_numbers_in_the_script_are_those_of_the_study():
    study = make_study("found")
    (mass, effects), priors = literals(model_script(study, "0.1.0"))
    assert mass == study.extended.mass
    assert effects == [effect.name for effect in study.extended.effects]
    assert priors == {name: tuple(map(float, bounds)) for name, bounds in study.posterior_bounds.items()}
    assert len(model_script(study, "0.1.0").splitlines()) < 50


def test_script_without_a_posterior_has_default_priors():
    study = dataclasses.replace(make_study("adequate"), posterior_bounds={})
    _, priors = literals(model_script(study, "0.1.0"))
    assert set(priors) == set(study.base.parameter_names)
    assert all(np.isfinite(bounds).all() and bounds[0] < bounds[1] for bounds in priors.values())


def test_held_parameters_are_numbers():
    study = make_study("found")
    study = dataclasses.replace(study, settings={**study.settings, "fixed": {"viscous_damping": 0.75}})
    text = model_script(study, "0.1.0")
    assert '"viscous_damping": 0.75,' in text and "viscous_damping" not in literals(text)[1]


@pytest.mark.parametrize(
    "text", ['"""\nimport os\n', "x\rimport os", "x\x0cimport os", "x\N{LINE SEPARATOR}import os", "\\"]
)
def test_text_from_files_cannot_become_code(text):
    names = [text, "b", "c"]
    study = make_study("found", specimens=3, names=names)
    settings = {**study.settings, "records": text, "likelihood": text, "step": text, "density": text}
    hostile = dataclasses.replace(study, sentence=text, settings=settings, notes=(text,))
    script = model_script(hostile, "0.1.0")
    tree = ast.parse(script)
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert imported == {"arviz", "pymc"}
    assert {type(node) for node in tree.body} <= {ast.Expr, ast.Import, ast.ImportFrom, ast.Assign, ast.With, ast.If}


@numba.njit
def own_force(x, v, direction, z, p):
    return p[0] * x * x * x


def test_an_effect_of_the_users_own_is_asked_for(tmp_path):
    own = Effect(
        name="my_spring",
        summary="A spring of my own.",
        text="my_stiffness x^3",
        latex="k_m x^3",
        parameters=(Parameter("my_stiffness", "N/m^3", "k_m", "stiffness", lambda m, a, w: (0.0, m * w**2 / a**2)),),
        force=own_force,
    )
    study = make_study("found")
    study = dataclasses.replace(study, extended=Oscillator(1.2, own), posterior_bounds={})
    path = write(study, tmp_path / "out")
    assert "import yours" in path.read_text(encoding="utf-8")
    done = run(path, cwd=tmp_path)
    assert done.returncode == 1 and "import your effect my_spring" in done.stderr and "Traceback" not in done.stderr


def test_backbones_read_back_as_they_were_written(tmp_path):
    study = make_study("found", observables=("frequency", "damping", "offset"))
    write_results(prepare_output(tmp_path / "out"), {}, backbones=study.backbones)
    path = tmp_path / "out" / "backbones.nc"
    back = read_backbones(path)
    for name in ("value", "standard_error", "covariance"):
        np.testing.assert_array_equal(back[name], study.backbones[name])
    assert back.attrs["amplitude_unit"] == "m" and back.attrs["notes"] == study.backbones.attrs["notes"]
    some = read_backbones(path, levels=np.asarray(back["level"])[[1, 4]])
    assert some.sizes["level"] == some.sizes["level_other"] == 2
    with pytest.raises(InputError, match="fixed levels"):
        read_backbones(path, levels=[0.0021])


@pytest.mark.parametrize("kind", ["missing", "text", "other", "posterior"])
def test_other_netcdf_files_are_one_sentence(tmp_path, kind):
    path = tmp_path / "backbones.nc"
    if kind == "text":
        path.write_text("amplitude,frequency\n1,2\n")
    elif kind == "other":
        xr.Dataset({"value": ("x", [1.0])}).to_netcdf(path, engine="h5netcdf")
    elif kind == "posterior":
        xr.DataTree.from_dict({"posterior": xr.Dataset({"k": ("draw", [1.0])})}).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match=r"backbones\.nc:? .*\.$"):
        read_backbones(path)
