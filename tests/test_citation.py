"""How to cite: what `citation` says is what CITATION.cff says, read by another reader."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import pymc_backbone as pb
from pymc_backbone._common.citation import _read

ROOT = Path(__file__).resolve().parents[1]


def test_the_file_is_read_as_a_reader_of_yaml_reads_it():
    yaml = pytest.importorskip("yaml", reason="comes with pre-commit, in the group dev")
    path = ROOT / "CITATION.cff"
    expected = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    assert _read(path) == expected


def test_another_form_is_refused(tmp_path):
    """Negative control: what the small reader does not know it does not guess."""
    path = tmp_path / "CITATION.cff"
    path.write_text("title: x\n   stray: y\n", encoding="utf-8")
    with pytest.raises(ValueError, match="not in the form"):
        _read(path)


def test_text_names_version_authors_and_preprint():
    software, paper = pb.citation().splitlines()
    version = re.search(r'^version = "(.*)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert f"Version {version.group(1)}." in software and software.startswith("The pymc-backbone developers.")
    assert paper.startswith("Pandey, Haddad Khodaparast,") and paper.endswith("arXiv:2410.11902.")


def test_bibtex_is_balanced_and_has_both_works():
    text = pb.citation("bibtex")
    assert re.findall(r"^@(\w+)\{(\w+),$", text, re.MULTILINE) == [
        ("software", "pymc_backbone"),
        ("article", "pandey2024"),
    ]
    assert text.count("{") == text.count("}")
    fields = dict(re.findall(r"^  (\w+) = \{(.*)\},$", text.split("@article")[1], re.MULTILINE))
    assert fields["eprint"] == "2410.11902" and fields["year"] == "2024"
    assert fields["author"].split(" and ")[1] == "{Haddad Khodaparast}"  # braces: one family name of two words


def test_unknown_style_is_refused():
    with pytest.raises(pb.InputError, match="`style` must be one of text, bibtex"):
        pb.citation("word")
