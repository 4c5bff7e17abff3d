"""Commands of the tutorial and the how-to pages, run when the site is built; their output is what the pages show.

A run is kept in ``docs/_cache`` under a digest of the package, the scripts and the commands, and done again when one of
these changes. A page takes the words of a run with ``literalinclude`` and its pictures as images, so that nothing on a
page can differ from what the program does. What the text around them says is checked here: see `CHECKS`.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from freshness import digest, newest_or

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Run:
    """Commands that are run in one folder.

    Parameters
    ----------
    name : str
        Folder of the run.
    commands : dict of str to str
        What is typed, by the name of the file that takes its output.
    keep : tuple of str
        Files to keep beside the output.
    expect : dict of str to str
        What ``result.json`` of a folder must say as its verdict, because the page says so.
    """

    name: str
    commands: dict[str, str]
    keep: tuple[str, ...] = ()
    expect: dict[str, tuple[str, list[str]]] = field(default_factory=dict)


RUNS = (
    Run(
        "tutorial",
        {
            "make": "python scripts/make_tutorial_records.py tables",
            "head": "head -4 tables/table_1.csv",
            "extract": "pymc-backbone extract tables --out backbones",
            "diagnose": "pymc-backbone diagnose tables --mass 1.2 --seed 1 --out diagnosis",
            "again": "pymc-backbone diagnose tables --mass 1.2 --base coulomb_friction --quick --seed 1 --out again",
        },
        keep=(
            "backbones/figures/records.png",
            "backbones/figures/backbones.png",
            "diagnosis/figures/gap_damping.png",
            "diagnosis/figures/gap_frequency.png",
            "diagnosis/figures/candidates.png",
            "diagnosis/figures/held_out_specimens.png",
            "diagnosis/figures/parameters.png",
            "diagnosis/result.json",
            "again/result.json",
        ),
        expect={"diagnosis": ("found", ["coulomb_friction"]), "again": ("adequate", [])},
    ),
    Run(
        "second_mode",
        {
            "make": "python scripts/make_tutorial_records.py accelerations --second-mode",
            "head": "head -4 accelerations/table_1.csv",
            "without": "pymc-backbone extract accelerations --out without_band",
            "with": "pymc-backbone extract accelerations --band 5.6:10.8 --out with_band",
        },
        keep=("without_band/figures/backbones.png", "with_band/figures/backbones.png"),
    ),
)


def record(folder: Path, cache: Path) -> None:
    """Run what has to be run, and put output and pictures into ``folder``."""
    sources = [path for path in (ROOT / "pymc_backbone").rglob("*") if path.suffix in (".py", ".csv")]
    sources += sorted((ROOT / "scripts").glob("make_tutorial_records.py"))
    for run in RUNS:
        key = digest(sources, ROOT, json.dumps(run.commands), *run.keep)
        kept = newest_or(cache, run.name, key)
        if not kept.is_dir():
            earlier = [path for path in cache.glob(f"{run.name}-*") if path != kept]
            _run(run, kept)
            for path in earlier:
                shutil.rmtree(path)
        target = folder / run.name
        for path in kept.rglob("*"):
            copy = target / path.relative_to(kept)
            if path.is_file() and (not copy.exists() or copy.read_bytes() != path.read_bytes()):
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copy)


def _run(run: Run, kept: Path) -> None:
    work = kept.with_name(f"{kept.name}.part")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    (work / "scripts").symlink_to(ROOT / "scripts")
    outputs = {}
    for name, command in run.commands.items():
        print(f"[{run.name}] {command}", flush=True)
        outputs[name] = execute(command, work)
    for folder, (verdict, effects) in run.expect.items():
        result = json.loads((work / folder / "result.json").read_text(encoding="utf-8"))
        said = result["verdict"], [entry["name"] for entry in result["missing_effects"]]
        if said != (verdict, effects):
            raise RuntimeError(f"the pages on {run.name} say {verdict} {effects}, the program says {said}; mend one.")
    final = kept.with_name(f"{kept.name}.whole")
    shutil.rmtree(final, ignore_errors=True)
    final.mkdir(parents=True)
    for name, text in outputs.items():
        (final / f"{name}.txt").write_text(text, encoding="utf-8")
    for place in run.keep:
        copy = final / place
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(work / place, copy)
    shutil.rmtree(work)
    final.rename(kept)


def execute(command: str, folder: Path) -> str:
    """Run one line in ``folder`` and return it with what it prints, as a terminal would show it; raise if it fails."""
    words = command.split()
    if words[0] == "pymc-backbone":
        words = [sys.executable, "-m", "pymc_backbone", *words[1:]]
    elif words[0] == "python":
        words[0] = sys.executable
    environment = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "120", "NO_COLOR": "1"}
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command!r} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return f"$ {command}\n{done.stdout.rstrip()}\n"
