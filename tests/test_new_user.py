"""The path of a new user in docs/semicolon_csv.md: the files are made, read as the page says, and end in a report."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "semicolon_csv.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(?:text)?\n(.*?)```", PAGE, flags=re.DOTALL)
SCRIPT, HEAD, COMMAND, TEXT = BLOCKS


def run(*words: str, cwd: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, *words], cwd=cwd, capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("user")
    _, script, name = SCRIPT.split()
    run(str(ROOT / script), name, cwd=place)
    return place


def reading(text: str) -> str:
    return text[text.index("Reading the records:") :].split("\n\n")[0]


def test_files_begin_as_the_page_shows(folder):
    text = (folder / "ring_downs" / "beam_1.csv").read_bytes().decode("cp1252")
    assert text.replace("\r\n", "\n").startswith(HEAD)


def test_everything_assumed_is_said_as_the_page_shows(folder):
    text = run("-m", "pymc_backbone", "extract", "ring_downs", "--out", "backbones", cwd=folder)
    assert reading(text) == reading(TEXT)
    for words in (
        "acceleration [m/s^2]",
        "2 lines above",
        "semicolons",
        "decimal commas",
        "from ms to s",
        "from g to m/s^2",
    ):
        assert words in reading(TEXT)


@pytest.mark.slow
def test_the_command_ends_in_the_report_that_the_page_shows(folder):
    words = COMMAND.split()
    assert words[0] == "pymc-backbone"
    text = run("-m", "pymc_backbone", *words[1:], cwd=folder)
    assert reading(text) == reading(TEXT)

    def verdict(page: str) -> list[str]:
        """The verdict's word, and the sets of the table that are best or possible."""
        word = re.search(r"^[A-Z]+(?=: )", page, flags=re.MULTILINE)[0]
        return [word, *sorted(re.findall(r"^  (\w[\w +]*?)  +best", page, flags=re.MULTILINE))]

    assert verdict(text) == verdict(TEXT) == ["FOUND", "cubic stiffness"]
    page = (folder / "diagnosis" / "report.html").read_text(encoding="utf-8")
    assert "converted from g to m/s^2" in page and "decimal commas" in page
