"""What is released: wheel and source archive are built, checked, and the wheel is installed into a clean environment.

All of this is slow; `python3 -m uv run pytest -m slow tests/test_release.py` before a release. Needs uv, which the
README's commands install, and the index that it is set up for.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = PROJECT["version"]
WHEEL = f"pymc_backbone-{VERSION}-py3-none-any.whl"
ARCHIVE = f"pymc_backbone-{VERSION}.tar.gz"
INFO = f"pymc_backbone-{VERSION}.dist-info"
pytestmark = pytest.mark.slow


def uv() -> list[str]:
    """Return the command that runs uv: `uv run` names it, else it is on the path or a module of some Python."""
    named = os.environ.get("UV") or shutil.which("uv")
    if named:
        return [named]
    if importlib.util.find_spec("uv"):
        return [sys.executable, "-m", "uv"]
    for python in ("python3", "python"):
        place = shutil.which(python)
        if place and subprocess.run([place, "-m", "uv", "--version"], capture_output=True, check=False).returncode == 0:
            return [place, "-m", "uv"]
    pytest.skip("uv is not installed")


def run(*command: str | Path, **options: object) -> str:
    """Run a command away from this tree and its settings; return what it prints."""
    ours = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "UV_PROJECT_ENVIRONMENT")
    environment = {name: value for name, value in os.environ.items() if name not in ours}
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False, env=environment, **options
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """Folder with the source archive, the wheel made from it and, in ``direct``, the wheel made from the tree."""
    folder = tmp_path_factory.mktemp("dist")
    run(*uv(), "build", ROOT, "--python", sys.executable, "--out-dir", folder, cwd=folder)
    run(*uv(), "build", "--wheel", ROOT, "--python", sys.executable, "--out-dir", folder / "direct", cwd=folder)
    return folder


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory) -> Path:
    """Folder of the programs of a new environment that holds the wheel and what it depends on, nothing else."""
    folder = tmp_path_factory.mktemp("clean")
    run(*uv(), "venv", folder / "venv", "--python", sys.executable, cwd=folder)
    programs = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    run(*uv(), "pip", "install", "--python", programs / "python", built / WHEEL, cwd=folder)
    return programs


def contents(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_wheel_holds_the_package_and_nothing_else(built):
    names = set(contents(built / WHEEL))
    source = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "pymc_backbone").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix not in (".nbi", ".nbc")
    }
    assert {name for name in names if not name.startswith(INFO)} == {*source, "pymc_backbone/data/CITATION.cff"}
    assert "pymc_backbone/py.typed" in names and "pymc_backbone/data/demo/true_parameters.json" in names
    assert f"{INFO}/licenses/LICENSE" in names
    assert sum(len(content) for content in contents(built / WHEEL).values()) < 5_000_000


def test_wheel_says_what_pyproject_says(built):
    files = contents(built / WHEEL)
    metadata = Parser().parsestr(files[f"{INFO}/METADATA"].decode())
    assert (metadata["Name"], metadata["Version"]) == ("pymc-backbone", VERSION)
    assert metadata["License-Expression"] == "MIT" and metadata["Requires-Python"] == PROJECT["requires-python"]
    needed = [line for line in metadata.get_all("Requires-Dist") if "extra ==" not in line]
    assert len(needed) == len(PROJECT["dependencies"])
    for name in ("pymc", "pytensor", "arviz"):  # their major versions change interfaces
        (line,) = (line for line in needed if re.match(rf"{name}\b(?!-)", line))
        assert ">=" in line and "<" in line
    assert "pymc-backbone = pymc_backbone.cli.main:run" in files[f"{INFO}/entry_points.txt"].decode()


def test_source_archive_builds_the_same_wheel(built):
    """The wheel of ``uv build`` is made from the archive; it is the one that the tree gives, byte by byte."""
    assert contents(built / WHEEL) == contents(built / "direct" / WHEEL)


def test_source_archive_holds_tests_and_documentation(built):
    with tarfile.open(built / ARCHIVE) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff"}
    assert wanted | {"tests/conftest.py", "docs/architecture.md", "scripts/generate_stepper.py"} <= names
    assert not [name for name in names if name.endswith((".nbi", ".nbc", ".pyc")) or "__pycache__" in name]


def test_versions_agree():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: [\"']?{re.escape(VERSION)}[\"']?$", citation, flags=re.MULTILINE)
    assert f"{VERSION}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_installed_program_answers(installed, tmp_path):
    program, python = installed / "pymc-backbone", installed / "python"
    assert run(program, "--version", cwd=tmp_path).strip() == f"pymc-backbone {VERSION}"
    for words in (run(program, "--help", cwd=tmp_path), run(python, "-m", "pymc_backbone", "--help", cwd=tmp_path)):
        assert "diagnose" in words and "update" in words
    place = run(python, "-c", "import pymc_backbone as pb; print(pb.__file__, pb.__version__)", cwd=tmp_path)
    assert str(installed.parent) in place and place.split()[-1] == VERSION
    assert "cubic_stiffness" in run(program, "effects", cwd=tmp_path)
    assert VERSION in run(python, "-c", "import pymc_backbone as pb; print(pb.citation())", cwd=tmp_path)


def test_installed_package_works(installed, tmp_path):
    """The shipped records become backbones: compiled code, NetCDF and figures, with what the wheel brings alone."""
    folder = run(
        installed / "python", "-c", "import pymc_backbone as pb; print(pb.demo_folder())", cwd=tmp_path
    ).strip()
    for name in ("specimen_01.csv", "specimen_02.csv"):
        (tmp_path / "records").mkdir(exist_ok=True)
        shutil.copy(Path(folder) / name, tmp_path / "records" / name)
    words = run(installed / "pymc-backbone", "extract", "records", "--out", "backbones", cwd=tmp_path)
    assert "2 specimens" in words
    assert {"backbones.csv", "backbones.nc", "result.json"} <= {p.name for p in (tmp_path / "backbones").iterdir()}
    code = (
        "import pymc_backbone as pb\n"
        "oscillator = pb.Oscillator(1.0, ['cubic_stiffness'])\n"
        "model = pb.build_model(oscillator, pb.read_backbones('backbones/backbones.nc'), likelihood='pooled')\n"
        "draws = pb.sample(model, draws=50, tune=50, chains=1, random_seed=1, progressbar=False)\n"
        "print(dict(draws['posterior'].sizes))"
    )
    assert "'draw': 50" in run(installed / "python", "-c", code, cwd=tmp_path)
