"""The table of folders in docs/architecture.md is the law: imports go only to a row above, and nothing is missing."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.count_imports import (
    Table,
    count,
    count_walk,
    imports_of,
    is_against,
    modules_of,
    read_table,
    where_they_part,
)

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pymc_backbone"
NAME = "pymc_backbone"
MODULES = modules_of(PACKAGE)
GRAPH = {name: imports_of(name, path, MODULES) for name, path in MODULES.items()}


@pytest.fixture(scope="module")
def table() -> Table:
    return read_table(ROOT)


def test_table_names_exactly_the_folders_and_modules_there_are(table):
    inside = table.inside
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
    inside, beside = table.inside, table.beside
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


def test_what_a_module_lists_in_its_all_is_in_it():
    """A stale name there fails in nobody's hands but those who import all."""
    absent = [f"{name}: {entry}" for name, path in MODULES.items() for entry in sorted(_listed_but_absent(path))]
    assert absent == []


def test_a_stale_name_in_all_is_seen(tmp_path):
    module = tmp_path / "some.py"
    module.write_text('from math import pi\n\ndef there(): ...\n\n__all__ = ["there", *("pi", "gone")]\n')
    assert _listed_but_absent(module) == {"gone"}


def _listed_but_absent(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    bound: set[str] = set()
    listed: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            bound.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            bound |= {item.asname or item.name.split(".")[0] for item in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            bound.add(node.id)
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(getattr(item, "id", "") == "__all__" for item in node.targets):
            strings = (item for item in ast.walk(node.value) if isinstance(item, ast.Constant))
            listed |= {item.value for item in strings if isinstance(item.value, str)}
    is_lazy = "__getattr__" in bound  # a package that loads what is asked for
    return set() if is_lazy else listed - bound


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
    inside, beside = table.inside, table.beside
    assert {"simulation", "measurement"} in beside
    assert inside[""].index("likelihood") < inside[""].index("inference") < inside[""].index("cli")
    assert where_they_part("measurement/reading/tables", "measurement/cycles") == ("measurement", "reading", "cycles")
    assert is_against(table, "measurement/cycles", "likelihood/density")
    assert is_against(table, "measurement/cycles", "simulation/decay")
    assert not is_against(table, "likelihood/density", "measurement/cycles")


def test_counts_of_the_tree_are_those_of_its_imports():
    """`scripts/count_imports.py` speaks of the imports that the tests above look at."""
    counts = count(ROOT)
    assert counts["imports against the table"] == 0
    assert counts["imports between modules"] == sum(map(len, GRAPH.values()))
    assert counts["modules in the hall"] <= 3 and counts["rooms"] == len(table_folders())


def table_folders() -> set[str]:
    return {name.rpartition("/")[0] for name in MODULES if name.rpartition("/")[2] not in ("__init__", "__main__")}


def test_counts_of_a_small_tree(tmp_path):
    """Both forms of the table, an import against it, and a walk that turns back once."""
    package = tmp_path / NAME
    (package / "early").mkdir(parents=True)
    for name, source in {"early/one": "from ..late import two\n", "late": "from .early.one import x\n"}.items():
        (package / f"{name}.py").write_text(source)
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "architecture.md"
    page.write_text("\n## Folders\n\n| `early/` | first | `one` |\n| `late.py` | last | |\n")
    expected = {
        "modules": 2, "rooms": 2, "modules in the hall": 1, "modules in the largest room": 1,
        "imports between modules": 2, "imports between rooms": 2, "imports against the table": 1,
    }  # fmt: skip
    assert count(tmp_path) == expected
    walk = count_walk(read_table(tmp_path), ["early/one", "late", "early/one"])
    assert walk["steps that climb"] == 1 and walk["steps into another row"] == 2 and walk["rows entered"] == 2
    page.write_text("\n## Modules\n\n| module | lives there |\n|---|---|\n| `early/` | a |\n| `late.py` | b\n")
    assert count(tmp_path) == expected


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


def test_a_search_in_records_does_without_what_takes_long_to_import():
    """PyMC and what SciPy has for signals and distributions take seconds, which a quick diagnosis does not have."""
    heavy = ("pymc", "pytensor", "arviz", "scipy.signal", "scipy.stats")
    code = (
        "import pymc_backbone.discrepancy.workflow, pymc_backbone.reporting.study_files\n"
        "import pymc_backbone.measurement.extraction, pymc_backbone.workflows.diagnose, sys\n"
        f"print([m for m in {heavy!r} if m in sys.modules])"
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


@pytest.mark.slow
def test_scripts_in_the_readme_run():
    """One after the other, as a reader would: the second goes on where the first ended."""
    scripts = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(scripts) == 2
    scope: dict = {}
    means = []
    for script in scripts:
        exec(compile(script, "README.md", "exec"), scope)
        assert dict(scope["posterior"]["posterior"].sizes) == {"chain": 4, "draw": 2000}
        means.append(float(scope["posterior"]["posterior"]["cubic_stiffness"].mean()))
    assert means[1] == pytest.approx(means[0], rel=0.05)  # other priors on the other two move it little


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
