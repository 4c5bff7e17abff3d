"""The documentation site: nothing public without a description, no page without a way to it, and it builds cleanly."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pymc_backbone
from pymc_backbone.effects import LIBRARY

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
WRITTEN_BY_THE_BUILD = ("reference/effects", "reference/api", "recorded", "figures", "examples", "_build", "_cache")
EXECUTED = sorted(path for path in (DOCS / "how-to").glob("*.md") if "file_format: mystnb" in path.read_text("utf-8"))


@pytest.fixture(scope="module")
def generators():
    """Import the modules that write the generated pages."""
    sys.path.insert(0, str(DOCS / "_extensions"))
    try:
        import api_pages
        import catalogue
        import recorded

        yield {"api": api_pages, "catalogue": catalogue, "recorded": recorded}
    finally:
        sys.path.remove(str(DOCS / "_extensions"))


def pages() -> list[Path]:
    """Pages that are kept in the repository."""
    found = [path for kind in ("*.md", "*.rst") for path in DOCS.rglob(kind)]
    written = tuple(str(DOCS / folder) + os.sep for folder in WRITTEN_BY_THE_BUILD)
    return sorted(path for path in found if not str(path).startswith(written) and path != DOCS / "README.md")


def toctree_entries(path: Path) -> list[str]:
    """Entries of all tables of contents of a page, with patterns spelled out, relative to the folder of the pages."""
    entries = []
    for block in re.findall(r"```\{toctree\}\n(.*?)```", path.read_text(encoding="utf-8"), flags=re.DOTALL):
        for line in block.splitlines():
            entry = line.strip()
            if not entry or entry.startswith(":"):
                continue
            place = Path(os.path.normpath(path.parent / entry)).relative_to(DOCS)
            if "*" in entry:
                entries += [found.relative_to(DOCS).with_suffix("").as_posix() for found in DOCS.glob(f"{place}.md")]
            else:
                entries.append(place.as_posix())
    return entries


def test_every_page_is_in_a_table_of_contents():
    listed = {entry for path in pages() for entry in toctree_entries(path)}
    present = {path.relative_to(DOCS).with_suffix("").as_posix() for path in pages()} - {"index"}
    assert sorted(present - listed) == [], "pages without a way to them; enter them in a toctree"
    kept = {entry for entry in listed if not entry.startswith(WRITTEN_BY_THE_BUILD)}
    assert sorted(kept - present) == [], "tables of contents name pages that are not there"


def test_every_notebook_is_in_a_table_of_contents():
    listed = {entry for path in pages() for entry in toctree_entries(path)}
    notebooks = {f"examples/{path.stem}" for path in (ROOT / "examples" / "notebooks").glob("*.ipynb")}
    assert {entry for entry in listed if entry.startswith("examples/")} == notebooks


def public_names() -> set[str]:
    """What `__all__` lists, in the package and in the modules that it lists."""
    found = set()
    for name in pymc_backbone.__all__:
        value = getattr(pymc_backbone, name)
        found |= {f"{name}.{inner}" for inner in value.__all__} if inspect.ismodule(value) else {name}
    return found


def test_the_reference_shows_the_public_names_and_no_others(generators, tmp_path):
    (tmp_path / "of_an_earlier_build.rst").write_text("old")
    generators["api"].write(tmp_path)
    overview = (tmp_path / "index.rst").read_text(encoding="utf-8")
    assert set(re.findall(r"`pb\.([\w.]+) <pymc_backbone\.\1>`", overview)) == public_names()
    text = "".join(path.read_text(encoding="utf-8") for path in tmp_path.glob("*.rst"))
    pattern = r"^\.\. (?:auto(?:class|function|exception)|py:data):: pymc_backbone\.(\S+)$"
    assert sorted(re.findall(pattern, text, flags=re.MULTILINE)) == sorted(public_names())  # each once
    assert not (tmp_path / "of_an_earlier_build.rst").exists()


def test_no_group_of_the_reference_names_what_is_not_public(generators):
    grouped = [name for names in generators["api"].groups().values() for name in names]
    assert len(set(grouped)) == len(grouped) and set(grouped) == public_names()


def test_every_command_is_in_the_reference(generators):
    from pymc_backbone.cli.main import build_parser

    text = generators["api"].command_line()
    (commands,) = (action.choices for action in build_parser()._actions if isinstance(action.choices, dict))
    assert [f"## {name}" for name in commands] == re.findall(r"^## \w+$", text, flags=re.MULTILINE)
    assert "--tolerance LIST" in text and str(Path.home()) not in text


@pytest.mark.parametrize("name", LIBRARY)
def test_catalogue_has_the_effect(name, generators):
    """Equation, signature in frequency and damping, picture, reference."""
    catalogue, effect = generators["catalogue"], LIBRARY[name]
    page = catalogue.page(effect)
    assert effect.latex.split(";")[0].strip() in page
    for parameter in effect.parameters:
        assert f"`{parameter.name}`" in page and f"${parameter.latex}$" in page
    for words in (effect.signature.frequency, effect.signature.damping, effect.signature.offset):
        assert words in page
    assert effect.references and "## References" in page
    for what in ("force", "frequency", "damping", "offset"):
        assert f"pictures/{name}_{what}.svg" in page
    overview = catalogue.overview()
    assert f":link: {name}\n" in overview and f"({name}.md)" in overview and f"{name}_both.svg" in overview


def test_catalogue_draws_what_it_shows(generators, tmp_path):
    generators["catalogue"].draw(LIBRARY["coulomb_friction"], tmp_path)
    assert len(list(tmp_path.glob("coulomb_friction_*.svg"))) == 5


def test_formulas_of_the_effects_are_understood(generators):
    pytest.importorskip("sphinx", reason="the site's tools are in the group docs")
    from offline_math import drawing

    for effect in LIBRARY.values():
        for text in (*re.split(r"(?<!\\);\s+", effect.latex), *(parameter.latex for parameter in effect.parameters)):
            assert '<path fill="currentColor" d="M' in drawing(text)
    with pytest.raises(ValueError):
        drawing(r"\notacommand{x}")


def test_pages_show_recorded_runs_that_are_made(generators):
    """What a page includes or shows from ``recorded/`` is written by `recorded.py`."""
    made = {f"{run.name}/{name}.txt" for run in generators["recorded"].RUNS for name in run.commands}
    made |= {f"{run.name}/{place}" for run in generators["recorded"].RUNS for place in run.keep}
    shown = {place for path in pages() for place in re.findall(r"\.\./recorded/([\w/.]+)", path.read_text("utf-8"))}
    assert shown and shown <= made, sorted(shown - made)


def test_first_commands_of_the_tutorial_run(generators, tmp_path):
    """The quick ones; the whole tutorial runs when the site is built."""
    run = next(run for run in generators["recorded"].RUNS if run.name == "tutorial")
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    assert "4 records in tables" in generators["recorded"].execute(run.commands["make"], tmp_path)
    assert "time [s],displacement [mm]" in generators["recorded"].execute(run.commands["head"], tmp_path)
    with pytest.raises(RuntimeError, match="ended with 2"):
        generators["recorded"].execute("pymc-backbone extract nowhere", tmp_path)


def test_links_between_pages_lead_somewhere():
    """Relative links of Markdown pages, those to what the build writes aside."""
    broken = []
    for path in pages():
        for target in re.findall(r"\]\(([^)\s#]+)(?:#[\w-]+)?\)", path.read_text(encoding="utf-8")):
            if re.match(r"[a-z]+:", target):
                continue
            place = Path(os.path.normpath(path.parent / target))
            written = place.relative_to(DOCS).as_posix().startswith(WRITTEN_BY_THE_BUILD)
            if not written and not place.exists():
                broken.append(f"{path.relative_to(DOCS)}: {target}")
    assert broken == []


@pytest.mark.slow
def test_site_builds_without_a_warning(tmp_path):
    """Runs the commands of the tutorial and the code of the how-to pages, where the cache does not hold them."""
    pytest.importorskip("myst_nb", reason="the site's tools are in the group docs: uv run --group docs pytest -m slow")
    command = [sys.executable, "-m", "sphinx", "-W", "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, timeout=1800)
    assert done.returncode == 0, done.stderr
    for page in tmp_path.rglob("*.html"):
        for address in re.findall(r'<(?:script|img|link)[^>]+(?:src|href)="(https?:[^"]+)"', page.read_text("utf-8")):
            raise AssertionError(f"{page.name} loads {address}; the site must work without a network")
