"""Count rooms, imports between them, and the walk of one record through a diagnosis: what the folders are for.

    python scripts/count_imports.py             # this tree
    python scripts/count_imports.py TREE        # another one, for example an older one beside it
    python scripts/count_imports.py --no-walk   # without running anything

Every tree is measured by its own table in ``docs/architecture.md`` (what stands where, in the order of import):

- A *room* is a folder that holds modules; modules directly in the package stand in its hall. A tree without folders is
  one hall, and how many modules stand there is how many names somebody has to look through.
- A *row* is a row of the table. Where modules share a folder but not a row, as in a hall, they are as far apart as
  two folders for whoever reads along; so walks are counted in rows, which every tree has.
- An import is *against the table* where its target does not stand before the importing module: in a row below, to the
  right in the same folder, or beside.
- The *walk* is `find_missing_effect` on two of the shipped records with ``quick=True``, from the files on. Its steps
  are the modules in the order in which a function of theirs is first called; what runs because a module is imported
  does not count, nor does compiled code, which calls itself unseen. A step *climbs* where the next module's row stands
  above that of the one before: data runs down the table, so who reads along has to turn back. It is measured in a new
  process, after another one has left compiled code on the disk.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import json
import re
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

NAME = "pymc_backbone"
ROOT = Path(__file__).resolve().parents[1]


@dataclass
class Table:
    """The table of a tree.

    Attributes
    ----------
    inside : dict
        What stands in each folder in the order of import; "" is the package.
    beside : list of set
        Folders that do not know each other.
    rows : dict
        Number of the row of each folder, and of each module that has a row without one.
    """

    inside: dict[str, list[str]] = field(default_factory=lambda: {"": []})
    beside: list[set[str]] = field(default_factory=list)
    rows: dict[str, int] = field(default_factory=dict)

    def row(self, module: str) -> int | None:
        """Return the row that a module stands in, that of the nearest folder; None for the package's own files."""
        place = module
        while place:
            if place in self.rows:
                return self.rows[place]
            place = place.rpartition("/")[0]
        return None


def read_table(tree: Path) -> Table:
    """Read the table of folders, or the older one of modules, of a tree."""
    text = (tree / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = Table()
    if "\n## Folders" in text:
        section = text.split("\n## Folders", 1)[1].split("\n## ", 1)[0]
        found = re.findall(r"^\| (`[^|\n]*) \|([^|\n]*)\|([^|\n]*)\|$", section, flags=re.MULTILINE)
        for number, (first, _, entries) in enumerate(found):
            names = [name.removesuffix("/").removesuffix(".py") for name in re.findall(r"`([\w/.]+)`", first)]
            if len(names) > 1:
                table.beside.append(set(names))
                continue
            (name,) = names
            table.rows[name] = number
            if "/" not in name:
                table.inside[""].append(name)
            if not first.endswith(".py`"):
                table.inside[name] = [entry.removesuffix("/") for entry in re.findall(r"`([\w/.]+)`", entries)]
        return table
    section = text.split("\n## Modules", 1)[1].split("\n## ", 1)[0]
    for number, cell in enumerate(re.findall(r"^\| (`[^|\n]*)\|", section, flags=re.MULTILINE)):
        for name in re.findall(r"`([\w/]+?)(?:\.py|/)?`", cell):
            table.inside[""].append(name)
            table.rows[name] = number
    return table


def modules_of(package: Path) -> dict[str, Path]:
    """Files of the package by their place, ``measurement/reading/records``; a folder's own is its ``__init__``."""
    return {path.relative_to(package).with_suffix("").as_posix(): path for path in sorted(package.rglob("*.py"))}


def is_type_checking(node: ast.AST) -> bool:
    """Whether a statement is for type checkers only."""
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def imports_of(name: str, path: Path, known: Iterable[str]) -> set[str]:
    """Modules of the package that a file imports, wherever the statement stands, except for type checkers only."""
    here = [NAME, *name.split("/")[:-1]]
    found: set[str] = set()

    def visit(node: ast.AST) -> None:
        if is_type_checking(node):
            for child in node.orelse:  # type: ignore[attr-defined]
                visit(child)
            return
        targets: list[list[str]] = []
        if isinstance(node, ast.Import):
            targets = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            base = [*base, *(node.module.split(".") if node.module else [])]
            # `from . import run` imports a module, `from .run import update` a name of it: look at both.
            targets = [[*base, alias.name] for alias in node.names]
        for target in targets:
            if target[0] == NAME:
                places = ["/".join(target[1:k]) for k in range(len(target), 0, -1)]
                options = [option for place in places for option in (place, f"{place}/__init__".lstrip("/"))]
                found.add(next(option for option in options if option in known))
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return found - {name}


def where_they_part(one: str, other: str) -> tuple[str, str, str]:
    """Return the folder that holds both modules, and what each of them stands in there."""
    a, b = one.split("/"), other.split("/")
    k = next(k for k, (left, right) in enumerate(zip(a, b, strict=False)) if left != right)
    return "/".join(a[:k]), a[k], b[k]


def is_against(table: Table, name: str, target: str) -> bool:
    """Whether the table forbids an import; what it does not speak of it does not forbid."""
    folder, mine, its = where_they_part(name, target)
    order = table.inside.get(folder, [])
    if mine not in order or its not in order:
        return False
    return order.index(its) > order.index(mine) or {mine, its} in table.beside


def room(module: str) -> str:
    """Return the folder a module stands in, "" for the package's hall."""
    return module.rpartition("/")[0]


def count(tree: Path) -> dict[str, int]:
    """Return the counts of what stands where and imports what."""
    table, modules = read_table(tree), modules_of(tree / NAME)
    arrows = [(name, target) for name, path in modules.items() for target in imports_of(name, path, modules)]
    # The package's own files open onto everything, and a folder's __init__ is the folder: neither is looked for.
    there = [name for name in modules if name.rpartition("/")[2] not in ("__init__", "__main__")]
    sizes = [sum(room(name) == folder for name in there) for folder in sorted({room(name) for name in there})]
    return {
        "modules": len(there),
        "rooms": len(sizes),
        "modules in the hall": sum(room(name) == "" for name in there),
        "modules in the largest room": max(sizes),
        "imports between modules": len(arrows),
        "imports between rooms": sum(room(name) != room(target) for name, target in arrows),
        "imports against the table": sum(is_against(table, name, target) for name, target in arrows),
    }


def count_walk(table: Table, steps: list[str]) -> dict[str, int]:
    """Return the counts of a walk through these modules, in this order."""
    rows = [row for step in steps if (row := table.row(step)) is not None]
    pairs = list(itertools.pairwise(rows))
    rooms = [room(step) for step in steps]
    return {
        "modules entered": len(steps),
        "rooms entered": len(set(rooms)),
        "rows entered": len(set(rows)),
        "steps into another row": sum(one != other for one, other in pairs),
        "steps that climb": sum(other < one for one, other in pairs),
    }


def walk(tree: Path) -> list[str]:
    """Return the modules of the walk, in a new process; an earlier one fills the cache of compiled code."""
    command = [sys.executable, str(Path(__file__).resolve()), str(tree), "--record-walk"]
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.stderr)
    return list(json.loads(done.stdout.splitlines()[-1]))


def record_walk(tree: Path) -> list[str]:
    """Diagnose two shipped records with the package of a tree, and return its modules as they are first called."""
    sys.path.insert(0, str(tree))
    import pymc_backbone as pb

    package = Path(pb.__file__).resolve().parent
    if package != tree / NAME:
        raise SystemExit(f"imported {package}, not that of {tree}")
    modules = {str(path): name for name, path in modules_of(package).items()}
    steps: dict[str, None] = {}

    def is_function(frame: FrameType) -> bool:
        return bool(frame.f_code.co_flags & 1)  # CO_OPTIMIZED: bodies of modules and classes are not

    def look(frame: FrameType, event: str, _: Any) -> None:
        if event != "call" or not is_function(frame):
            return
        module = modules.get(frame.f_code.co_filename)
        if module is None or module in steps or module == "__init__":
            return
        caller = frame.f_back
        while caller is not None:
            if caller.f_code.co_name == "<module>" and caller.f_code.co_filename in modules:
                return  # called because something is imported
            caller = caller.f_back
        steps[module] = None

    find, read, oscillator, folder = pb.find_missing_effect, pb.read_records, pb.Oscillator, pb.demo_folder()
    files = sorted(folder.glob("*.csv"))[:2]
    sys.setprofile(look)
    try:
        records = [record for file in files for record in read(file)]
        candidates = ["cubic_stiffness", "coulomb_friction"]
        find(oscillator(1.0), records, candidates=candidates, max_effects=1, quick=True, random_seed=1)
    finally:
        sys.setprofile(None)
    return list(steps)


def main() -> None:
    """Print the counts of a tree."""
    parser = argparse.ArgumentParser(description="Count rooms, imports between them, and the walk of one record.")
    parser.add_argument("tree", nargs="?", type=Path, default=ROOT, help="a checkout; by default this one")
    parser.add_argument("--no-walk", action="store_true", help="count imports only")
    parser.add_argument("--steps", action="store_true", help="print the walk, module by module")
    parser.add_argument("--record-walk", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    tree = options.tree.resolve()
    if options.record_walk:
        print(json.dumps(record_walk(tree)))
        return
    counts = count(tree)
    if not options.no_walk:
        table, steps = read_table(tree), walk(tree)
        counts |= count_walk(table, steps)
        if options.steps:
            for step in steps:
                print(f"row {table.row(step)}: {step}")
    for what, number in counts.items():
        print(f"{number:>5}  {what}")


if __name__ == "__main__":
    main()
