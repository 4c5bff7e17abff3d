"""The table of folders in docs/architecture.md is the law: imports go only to a row above, and nothing is missing."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pymc_backbone"
NAME = "pymc_backbone"


def folder_table() -> tuple[dict[str, list[str]], list[set[str]]]:
    """Read the table: what stands in each folder in the order of import ("" is the package), and what stands beside."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = text.split("\n## Folders", 1)[1].split("\n## ", 1)[0]
    rows = re.findall(r"^\| (`[^|\n]*) \|([^|\n]*)\|([^|\n]*)\|$", section, flags=re.MULTILINE)
    inside: dict[str, list[str]] = {"": []}
    beside: list[set[str]] = []
    for first, _, entries in rows:
        names = [name.removesuffix("/").removesuffix(".py") for name in re.findall(r"`([\w/.]+)`", first)]
        if len(names) > 1:
            beside.append(set(names))
            continue
        (name,) = names
        if "/" not in name:
            inside[""].append(name)
        if not first.endswith(".py`"):
            inside[name] = [entry.removesuffix("/") for entry in re.findall(r"`([\w/.]+)`", entries)]
    return inside, beside


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def modules() -> dict[str, Path]:
    """Files of the package by their place, ``measurement/reading/records``; a folder's own is its ``__init__``."""
    return {path.relative_to(PACKAGE).with_suffix("").as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}


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


MODULES = modules()
GRAPH = {name: imports_of(name, path, MODULES) for name, path in MODULES.items()}


def where_they_part(one: str, other: str) -> tuple[str, str, str]:
    """Return the folder that holds both modules, and what each of them stands in there."""
    a, b = one.split("/"), other.split("/")
    k = next(k for k, (left, right) in enumerate(zip(a, b, strict=False)) if left != right)
    return "/".join(a[:k]), a[k], b[k]


@pytest.fixture(scope="module")
def table() -> tuple[dict[str, list[str]], list[set[str]]]:
    return folder_table()


def test_table_names_exactly_the_folders_and_modules_there_are(table):
    inside, _ = table
    folders: dict[str, set[str]] = {"": set()}
    for name in MODULES:
        *parents, stem = name.split("/")
        for depth in range(len(parents) + 1):
            entry = [*parents, stem][depth]
            folders.setdefault("/".join(parents[:depth]), set()).add(entry)
    from pymc_backbone.effects import LIBRARY

    folders["effects"] -= set(LIBRARY)
    for folder, entries in folders.items():
        entries -= {"__main__"} | ({"__init__"} if "__init__" not in inside.get(folder, ()) else set())
        named = inside.get(folder, [])
        assert len(set(named)) == len(named), f"`{folder}/` names something twice"
        assert sorted(entries ^ set(named)) == [], f"the table of docs/architecture.md is wrong about `{folder}/`"
    assert sorted(set(inside) - set(folders)) == [], "rows of the table without a folder"


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_go_up_only(name, table):
    """A module imports from a row above; inside a folder from what stands to the left."""
    inside, beside = table
    for target in GRAPH[name]:
        if target == "__init__":
            # Only the version may be asked of the package itself, by the program around it.
            assert name in ("cli/main", "reporting/output_folder"), f"{name} imports from the package's __init__"
            continue
        folder, mine, its = where_they_part(name, target)
        if name in ("__init__", "__main__") or (folder == "effects" and mine not in inside[folder]):
            continue  # the package opens onto everything; effects stand to the right of what they are made from
        order = inside[folder].index
        if mine == "__init__" and "__init__" not in inside[folder]:
            raise AssertionError(f"{name} imports {target}: the table says nothing of this __init__")
        assert order(its) < order(mine), f"{name} imports {target}, which does not stand before it"
        assert {mine, its} not in beside, f"{name} imports {target}: they stand side by side"


def test_no_import_cycle():
    graph = {name: set(targets) for name, targets in GRAPH.items()}
    while graph:
        leaves = {name for name, targets in graph.items() if not targets & set(graph)}
        assert leaves, f"these import each other: {', '.join(sorted(graph))}"
        graph = {name: targets for name, targets in graph.items() if name not in leaves}


def test_reader_of_imports_sees_lazy_and_relative_ones(tmp_path):
    """Negative control: what the tests above rest on must find every form of import."""
    source = "def f():\n    from .density import Density\n    from ..reporting import plots\n"
    source += "    import pymc_backbone.measurement.cycles\n"
    source += "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .op import X\n"
    source += (
        "from pymc_backbone.measurement.levels import y\nfrom pymc_backbone.effects import LIBRARY\nimport numpy\n"
    )
    (tmp_path / "model.py").write_text(source)
    known = ("likelihood/density", "reporting/plots", "measurement/cycles", "measurement/levels", "likelihood/op")
    found = imports_of("likelihood/model", tmp_path / "model.py", (*known, "effects/__init__"))
    assert found == {*known[:4], "effects/__init__"}


def test_table_forbids_what_it_should(table):
    """Negative control: the order that was read forbids the arrows it is there to forbid."""
    inside, beside = table
    assert {"simulation", "measurement"} in beside
    assert inside[""].index("likelihood") < inside[""].index("inference") < inside[""].index("cli")
    assert where_they_part("measurement/reading/tables", "measurement/cycles") == ("measurement", "reading", "cycles")


@pytest.mark.parametrize("statement", ["import pymc_backbone", "import pymc_backbone.cli.main"])
def test_import_does_not_load_matplotlib(statement):
    code = f"{statement}; import sys; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "False"


def test_command_line_starts_without_the_heavy_packages():
    """Help and errors come at once: no PyMC, PyTensor, numba, ArviZ, pandas or xarray behind the parser."""
    heavy = ("pymc", "pytensor", "numba", "arviz", "arviz_stats", "pandas", "xarray", "matplotlib", "scipy")
    code = (
        f"import pymc_backbone.cli.main as c, sys; c.build_parser(); print([m for m in {heavy!r} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_public_names_are_documented_and_there():
    import pymc_backbone

    names = pymc_backbone.__all__
    assert len(set(names)) == len(names)
    for name in names:
        value = getattr(pymc_backbone, name)
        if name != "__version__" and (inspect.isclass(value) or callable(value)):
            assert inspect.getdoc(value), f"{name} has no docstring"
    assert set(names) <= set(dir(pymc_backbone))


EXAMPLES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("name", ["README.md", *EXAMPLES])
def test_names_that_the_documentation_uses_are_public(name):
    import pymc_backbone

    used = set(re.findall(r"\bpb\.(\w+)", (ROOT / name).read_text(encoding="utf-8")))
    assert used and used <= set(pymc_backbone.__all__), sorted(used - set(pymc_backbone.__all__))


@pytest.mark.slow
def test_script_in_the_readme_runs():
    (script,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    scope: dict = {}
    exec(compile(script, "README.md", "exec"), scope)
    assert dict(scope["posterior"]["posterior"].sizes) == {"chain": 4, "draw": 2000}


@pytest.mark.parametrize("folder", ["benchmarks", "examples"])
def test_what_scripts_import_from_the_package_is_there(folder):
    """Scripts that no test runs break without a sound when a module moves."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not str(node.module).startswith(NAME):
                continue
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                if not hasattr(module, alias.name):
                    importlib.import_module(f"{node.module}.{alias.name}")
