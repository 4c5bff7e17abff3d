"""The output folder: what is written reads back, and nothing else is touched."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

from pymc_backbone import Oscillator
from pymc_backbone._common.checks import InputError
from pymc_backbone.measurement.reading.measured_backbones import read_backbones
from pymc_backbone.reporting.backbone_files import write_backbones
from pymc_backbone.reporting.claimed_folder import prepare_output
from pymc_backbone.reporting.output_folder import RESULT_KEYS, read_result, write_results
from pymc_backbone.workflows.updated import Updated


@pytest.fixture
def backbones(rng: np.random.Generator) -> xr.Dataset:
    value = 1.0 + 0.1 * rng.random((3, 2, 4))
    value[2, :, 3] = np.nan
    dims = ("specimen", "observable", "level")
    level = [0.001, 0.002, 0.004, 0.008]
    return xr.Dataset(
        {
            "value": (dims, value),
            "standard_error": (dims, 0.01 * value),
            "covariance": ((*dims, "level_other"), 1e-4 * value[..., None] * np.eye(4)),
        },
        coords={
            "specimen": ["b", "a", "c"],
            "observable": ["frequency", "damping"],
            "level": level,
            "level_other": level,
        },
        attrs={"amplitude_unit": "m", "notes": ["one note", "another"]},
    )


@pytest.fixture
def posterior(rng: np.random.Generator) -> xr.DataTree:
    draws = xr.Dataset(
        {"k": (("chain", "draw"), rng.normal(size=(2, 10)))},
        attrs={"tuned": True, "settings": {"a": None}, "sample_dims": ["chain", "draw"]},
    )
    statistics = xr.Dataset(
        {
            "accepted": (("chain", "draw"), rng.random((2, 10)) < 0.5),
            "divergence_message": (("chain", "draw"), np.full((2, 10), None, dtype=object)),
        }
    )
    return xr.DataTree.from_dict({"posterior": draws, "sample_stats": statistics})


def write(folder: Path, backbones: xr.Dataset, posterior: xr.DataTree, **extra: object) -> list[str]:
    table = pd.DataFrame({"mean": [1.0]}, index=pd.Index(["k"], name="parameter"))
    figure = Figure()
    figure.subplots().plot([0, 1])
    result = {"command": "update", "levels": np.array([0.001, np.nan]), "settings": {"path": Path("x")}, **extra}
    return write_results(
        folder, result, backbones=backbones, summary=table, posterior=posterior, figures={"backbones": figure}
    )


def test_everything_written_reads_back(tmp_path, backbones, posterior):
    folder = prepare_output(tmp_path / "new" / "out")
    files = write(folder, backbones, posterior)
    written = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert sorted(files) == written  # and no temporary file beside them
    result = read_result(folder)
    assert result["levels"] == [0.001, None] and result["settings"] == {"path": "x"} and result["files"] == files
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        np.testing.assert_array_equal(tree["posterior"]["k"], posterior["posterior"]["k"])
        assert list(tree["posterior"].attrs["sample_dims"]) == ["chain", "draw"]
        assert tree["sample_stats"]["accepted"].sum() == posterior["sample_stats"]["accepted"].sum()
    with xr.open_dataset(folder / "backbones.nc", engine="h5netcdf") as dataset:
        xr.testing.assert_equal(dataset, backbones)
        assert list(dataset.attrs["notes"]) == backbones.attrs["notes"]
    assert (folder / "figures" / "backbones.png").read_bytes().startswith(b"\x89PNG")


def test_backbone_table_is_what_read_backbones_reads(tmp_path, backbones, posterior):
    folder = prepare_output(tmp_path / "out")
    write(folder, backbones, posterior)
    again = read_backbones(folder / "backbones.csv", levels=[0.001, 0.002, 0.004])
    ordered = backbones.sel(specimen=["a", "b", "c"]).isel(level=slice(0, 3))
    for name in ("value", "standard_error"):
        assert again[name].sel(observable=["frequency", "damping"]).values == pytest.approx(
            ordered[name].values, rel=1e-8
        )


def test_unknown_key_is_refused(tmp_path, backbones, posterior):
    with pytest.raises(KeyError, match="colour"):
        write(prepare_output(tmp_path / "out"), backbones, posterior, colour="red")
    assert "parameters" in RESULT_KEYS


def test_folder_in_use_needs_overwrite(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="`overwrite=True`"):
        prepare_output(tmp_path)
    assert prepare_output(tmp_path, overwrite=True) == tmp_path
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_overwriting_removes_only_what_an_earlier_run_wrote(tmp_path, backbones, posterior):
    folder = prepare_output(tmp_path / "out")
    write(folder, backbones, posterior)
    (folder / "figures" / "mine.png").write_text("mine")
    (folder / "notes.txt").write_text("mine")
    # A result.json that lists files of others must not get them removed.
    data = json.loads((folder / "result.json").read_text())
    data["files"] += ["notes.txt", "figures/mine.png", "../thesis.tex"]
    (folder / "result.json").write_text(json.dumps(data))
    (tmp_path / "thesis.tex").write_text("years of work")
    prepare_output(folder, overwrite=True)
    assert (folder / "posterior.nc").exists()  # until the new run has something to put there
    write_results(folder, {"command": "extract"}, backbones=backbones)
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert left == ["backbones.csv", "backbones.nc", "figures/mine.png", "notes.txt", "result.json"]
    assert (tmp_path / "thesis.tex").exists()


def test_a_failed_write_leaves_the_earlier_file(tmp_path, backbones, posterior, monkeypatch):
    folder = prepare_output(tmp_path / "out")
    write(folder, backbones, posterior)
    before = (folder / "backbones.nc").read_bytes()

    def full(self: object, store: object, **_: object) -> None:
        assert list(folder.glob(".writing-*"))  # the new file is there, with nothing in it
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "dump_to_store", full)
    with pytest.raises(InputError, match="No space left on device"):
        write_results(folder, {"command": "extract"}, backbones=backbones)
    assert (folder / "backbones.nc").read_bytes() == before
    assert not list(folder.glob(".writing-*"))


def test_output_that_is_a_file(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match="is a file"):
        prepare_output(tmp_path / "out")


def test_output_that_cannot_be_written(tmp_path, monkeypatch):
    if os.geteuid() == 0:  # permissions do not stop root: let the system call refuse instead
        monkeypatch.setattr(
            Path, "mkdir", lambda *_, **__: (_ for _ in ()).throw(PermissionError(13, "Permission denied"))
        )
    else:
        tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be written"):
        prepare_output(tmp_path / "out")


def test_not_a_result(tmp_path):
    (tmp_path / "result.json").write_text("[1, 2]")
    with pytest.raises(InputError, match="not a result"):
        read_result(tmp_path)


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_backbones_that_are_written_read_back(tmp_path, suffix):
    error = np.full((2, 1, 3), 0.01)
    dims = ("specimen", "observable", "level")
    value = np.array([[[10.0, 10.5, 11.0]], [[9.0, 9.5, 10.5]]])
    levels = [0.001, 0.002, 0.004]
    covariance = 1e-4 * np.broadcast_to(np.eye(3), (2, 1, 3, 3))
    data = xr.Dataset(
        {"value": (dims, value), "standard_error": (dims, error), "covariance": ((*dims, "level_other"), covariance)},
        coords={"specimen": ["a", "b"], "observable": ["frequency"], "level": levels, "level_other": levels},
        attrs={"amplitude_unit": "rad", "notes": ["the first note"]},
    )
    path = write_backbones(data, tmp_path / f"backbones{suffix}")
    again = read_backbones(path, levels=levels)
    np.testing.assert_allclose(again["value"], value, rtol=1e-9)
    np.testing.assert_allclose(again["standard_error"], error, rtol=1e-9)
    assert again.attrs["amplitude_unit"] == "rad"
    with pytest.raises(InputError, match="exists already"):
        write_backbones(data, path)
    write_backbones(data.isel(specimen=[0]), path, overwrite=True)
    assert read_backbones(path).sizes["specimen"] == 1
    with pytest.raises(InputError, match=r"\.nc or \.csv"):
        write_backbones(data, tmp_path / "backbones.mat")
    with pytest.raises(InputError, match="cannot be written"):
        write_backbones(data, path / f"below{suffix}")


def test_levels_of_a_table_that_no_specimen_reaches_are_refused_with_unit(tmp_path, backbones):
    path = write_backbones(backbones.isel(specimen=[0, 1]), tmp_path / "table.csv")
    with pytest.raises(InputError, match=r"inside the measured amplitudes, 0.001 to 0.008 m, got 0.5 to 1 m"):
        read_backbones(path, levels=[0.5, 1.0])
    kept = read_backbones(path, levels=[0.002, 0.004, 1.0])  # as for records, what is not reached is left empty
    assert np.isfinite(kept["value"].values[..., :2]).all() and np.isnan(kept["value"].values[..., 2]).all()


@pytest.mark.parametrize(("moved_in", "stiffness", "damping"), [("m", "N/m", "N s/m"), ("rad", "N m/rad", "N m s/rad")])
def test_parameters_of_an_updated_model_have_the_units_of_its_motion(moved_in, stiffness, damping):
    updated = SimpleNamespace(measured=SimpleNamespace(amplitude_unit=moved_in), oscillator=Oscillator(1.0))
    assert Updated.units.fget(updated) == {"linear_stiffness": stiffness, "viscous_damping": damping}
