"""The example scripts run at few draws, the notebooks run, and what the notebooks keep is fit to be read."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.stem for path in (ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted(path.stem for path in (ROOT / "examples" / "notebooks").glob("*.ipynb"))
QUICK = ("frequency_or_damping", "beam")  # the script and the notebook of every run: together they use most of it
ABSOLUTE_PATH = re.compile(r"(?<![\w/:.])/(?:tmp|home|root|usr|opt|var|work|mnt|Users|private)/|\b[A-Z]:\\\w")

# What each script must print at any number of draws: a line that only a finished run has.
LAST_WORDS = {
    "beam": r"cubic_stiffness +\d\.\d+ +\d\.\d+",
    "compare_samplers": r"nutpie +\d.*N/m",
    "first_posterior": r"cubic_stiffness +\d",
    "frequency_or_damping": r"frequency and damping of 200 specimens\n(.*\n)+friction_force \[N\] +1\.\d+ \+- 0\.\d+",
    "three_likelihoods": r"data_consistent +\d",
}


def _marked(names: list[str], quick: str) -> list:
    return [name if name == quick else pytest.param(name, marks=pytest.mark.slow) for name in names]


def test_nothing_is_left_out():
    assert set(SCRIPTS) == set(LAST_WORDS)
    assert QUICK[0] in SCRIPTS and QUICK[1] in NOTEBOOKS


@pytest.mark.parametrize("name", _marked(SCRIPTS, QUICK[0]))
def test_script_runs_at_few_draws(name):
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py"), "--draws", "0.05"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert re.search(LAST_WORDS[name], done.stdout), done.stdout


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the notebook's client and its event loop, not ours
@pytest.mark.parametrize("name", _marked(NOTEBOOKS, QUICK[1]))
def test_notebook_runs(name):
    notebook = nbformat.read(ROOT / "examples" / "notebooks" / f"{name}.ipynb", as_version=4)
    stored = [_kinds(cell) for cell in notebook.cells]
    resources = {"metadata": {"path": str(ROOT)}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()  # raises on an error
    assert [_kinds(cell) for cell in notebook.cells] == stored, "the stored outputs are not those of these cells"
    assert not _complaints(notebook)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_stored_outputs_are_fit_to_be_read(name):
    path = ROOT / "examples" / "notebooks" / f"{name}.ipynb"
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1)), "run from top to bottom"
    assert sum("image/png" in kind for cell in code for kind in _kinds(cell)) >= 1
    assert not _complaints(notebook)
    assert path.stat().st_size < 1.5e6
    assert not any(cell.metadata for cell in code), "times of execution do not belong in the repository"


def test_what_is_not_fit_to_be_read_is_found():
    new = nbformat.v4
    error = new.new_output("error", ename="ValueError", evalue="no", traceback=[])
    warning = new.new_output("stream", name="stderr", text="x.py:1: DeprecationWarning: old")
    place = new.new_output("stream", name="stdout", text="written to /home/someone/output")
    for output in (error, warning, place):
        cell = new.new_code_cell("1", outputs=[output])
        assert len(_complaints(new.new_notebook(cells=[cell]))) == 1
    link = new.new_output("stream", name="stdout", text="see https://doi.org/tmp/1 for N/m and m/s")
    assert not _complaints(new.new_notebook(cells=[new.new_code_cell("1", outputs=[link])]))


def _kinds(cell: nbformat.NotebookNode) -> list[str]:
    """Return what a cell shows, sorted: kinds of data; text that comes in pieces counts once."""
    shown = [" ".join(sorted(output.data)) for output in cell.get("outputs", []) if "data" in output]
    return sorted(shown) + sorted({output.name for output in cell.get("outputs", []) if output.output_type == "stream"})


def _complaints(notebook: nbformat.NotebookNode) -> list[str]:
    """Return errors, warnings, widgets and absolute paths in the outputs of a notebook."""
    found = []
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            words = output.get("text", "") + data.get("text/plain", "") + data.get("text/html", "")
            bad = ABSOLUTE_PATH.search(words) or re.search(r"Warning:|Traceback", words)
            if output.output_type == "error" or bad or any("widget" in kind for kind in data):
                found.append(output.get("evalue", "") + words)
    return found
