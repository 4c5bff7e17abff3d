"""Names from files are text, in a real browser: nothing in a report runs, and the names are shown as they are."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pymc_backbone import demo_folder
from pymc_backbone.cli.main import main

BROWSER = next(
    (place for name in ("chromium", "chromium-browser", "google-chrome", "chrome") if (place := shutil.which(name))),
    None,
)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")

MARK = "document.title='PWNED';document.documentElement.setAttribute('data-pwned','1')"
FILE_NAMES = [
    f"<script>{MARK}<{chr(0x2215)}script>",  # a file's name holds no slash
    f'"><img src=x onerror="{MARK}">',
    f"'-{MARK}-' javascript:{MARK}",
    f"<svg onload={MARK}> &lt;b&gt; {{{{7*7}}}} ${{7*7}}",
]
SPECIMENS = [f"</td><script>{MARK}</script>", f"<img src=x onerror={MARK}>"]
HEADER = "displacement <script>document.title='PWNED'</script><img src=x onerror=document.title='PWNED'> [mm]"


def opened(path: Path, profile: Path) -> str:
    """Return the document as it stands after the page has been loaded and its scripts, if any, have run."""
    command = [
        str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000",
        f"--user-data-dir={profile}", "--dump-dom", path.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0 and "</html>" in done.stdout, done.stderr[-2000:]
    return done.stdout


def check_that_nothing_ran(dom: str) -> None:
    assert html.unescape(re.search(r"<title>(.*?)</title>", dom, flags=re.DOTALL)[1]) != "PWNED"
    assert not re.search(r"<html[^>]*data-pwned", dom)
    tags = re.findall(r"<([a-zA-Z][\w-]*)((?:[^>\"']|\"[^\"]*\"|'[^']*')*)>", dom)
    assert not [name for name, _ in tags if name.lower() in ("script", "svg", "iframe", "object")]
    handlers = [words for _, words in tags if re.search(r"(?:^|\s)on\w+\s*=", re.sub(r"\"[^\"]*\"", '""', words))]
    assert handlers == []
    assert all(source.startswith("data:") for source in re.findall(r"<img[^>]*\ssrc=\"([^\"]{0,20})", dom))
    assert not re.search(r"(?:href|src|action)=\"\s*javascript:", dom)


def text_of(dom: str) -> str:
    """Return what a reader sees."""
    return html.unescape(re.sub(r"<[^>]*>", "", re.sub(r"<style.*?</style>", "", dom, flags=re.DOTALL)))


@needs_browser
def test_the_check_sees_a_script_that_runs(tmp_path):
    """Negative control: the same names unescaped."""
    for number, name in enumerate(
        [f"<script>{MARK}</script>", f'<img src=x onerror="{MARK}">', f'<svg onload="{MARK}">']
    ):
        page = tmp_path / f"bad_{number}.html"
        page.write_text(f"<!DOCTYPE html><html><head><title>x</title></head><body>{name}</body></html>")
        dom = opened(page, tmp_path / "profile")
        assert "<title>PWNED</title>" in dom and "data-pwned" in dom
        with pytest.raises(AssertionError):
            check_that_nothing_ran(dom)


@needs_browser
@pytest.mark.slow
@pytest.mark.skipif(shutil.os.name != "posix", reason="such names of files are for POSIX")
def test_names_of_files_and_columns_are_text_in_the_report(tmp_path, capsys):
    """`diagnose` on files, a folder and column headers with such names, as an attacker would send them."""
    folder = tmp_path / f"<script>{MARK}<x>"
    folder.mkdir()
    for number, name in enumerate(FILE_NAMES, start=1):
        text = (demo_folder() / f"specimen_{number:02d}.csv").read_text()
        head, _, rest = text.partition("\n")
        time, _ = head.split(",")
        (folder / f"{name}.csv").write_text(f"{time},{HEADER}\n" + millimetres(rest, head))
    out = tmp_path / 'out "><script>'
    words = ["diagnose", str(folder), "--mass", "1", "--quick", "--held-out", "0", "--max-effects", "1", "--seed", "1"]
    words += ["--candidates", "cubic_stiffness", "coulomb_friction", "--out", str(out)]
    assert main(words) == 0, capsys.readouterr().err
    dom = opened(out / "report.html", tmp_path / "profile")
    check_that_nothing_ran(dom)
    shown = text_of(dom)
    for name in FILE_NAMES:
        assert name in shown, name
    compile((out / "model.py").read_text(), "model.py", "exec")
    assert "PWNED" not in strings_of_code((out / "model.py").read_text())


@needs_browser
def test_names_in_a_study_are_text_in_the_report(tmp_path):
    """The same of a study that is made up, with names that no file system holds."""
    import dataclasses

    from pymc_backbone.reporting.study_files import write_study

    from .study_cases import make_study

    names = [*FILE_NAMES, *SPECIMENS]
    study = make_study("found", names=names, specimens=len(names))
    study = dataclasses.replace(
        study, sentence=SPECIMENS[0], notes=tuple(SPECIMENS), findings=tuple(names), reasons=tuple(names),
        advice=tuple(names), settings={**study.settings, "records": SPECIMENS[1]},
    )  # fmt: skip
    write_study(study, tmp_path / "out", command=f"pymc-backbone diagnose {SPECIMENS[0]}")
    dom = opened(tmp_path / "out" / "report.html", tmp_path / "profile")
    check_that_nothing_ran(dom)
    shown = text_of(dom)
    for name in names:
        assert name in shown, name
    compile((tmp_path / "out" / "model.py").read_text(), "model.py", "exec")


def millimetres(rest: str, head: str) -> str:
    """Return the lines of a demo file with displacements in mm."""
    factor = 1e3 if "[m]" in head else 1.0
    table = np.array([[float(cell) for cell in line.split(",")] for line in rest.splitlines() if line])
    return "".join(f"{t!r},{factor * x!r}\n" for t, x in table.tolist())


def strings_of_code(source: str) -> str:
    """Return everything of a script but its comments and docstrings."""
    import ast

    tree = ast.parse(source)
    return "\n".join(
        ast.unparse(node)
        for node in tree.body
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
    )
