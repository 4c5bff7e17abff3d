"""The module table of docs/architecture.md is the law: imports go only to a line above, and no module is missing."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pymc_backbone"
NAME = "pymc_backbone"


def module_table() -> list[list[str]]:
    """Modules of each line of the table, from the top: ``effects`` for the package, else the file's stem."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = text.split("\n## Modules", 1)[1].split("\n## ", 1)[0]
    first_cells = re.findall(r"^\|([^|]*)\|", section, flags=re.MULTILINE)
    lines = [re.findall(r"`([\w/]+?)(?:\.py|/)?`", cell) for cell in first_cells]
    return [line for line in lines if line]


def modules() -> dict[str, list[Path]]:
    """Files of each module; ``__init__`` and ``__main__`` stand above all lines and are looked at apart."""
    found: dict[str, list[Path]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts[0] not in ("__init__", "__main__"):
            found.setdefault(parts[0], []).append(path)
    return found


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def imports_of(path: Path) -> set[str]:
    """Modules of the package that a file imports, wherever the statement stands, except for type checkers only."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    here = [NAME, *parts[:-1]]
    found: set[str] = set()

    def visit(node: ast.AST) -> None:
        if is_type_checking(node):
            for child in node.orelse:  # type: ignore[attr-defined]
                visit(child)
            return
        targets: list[str] = []
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            base = [*base, *(node.module.split(".") if node.module else [])]
            # `from . import run` imports a module, `from .run import update` a name of it: look at both.
            targets = [".".join([*base, alias.name]) for alias in node.names]
        for target in targets:
            names = target.split(".")
            if names[0] == NAME:
                found.add(names[1] if len(names) > 1 and (names[1] in MODULES) else "__init__")
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return found - {parts[0]}


MODULES = modules()


@pytest.fixture(scope="module")
def order() -> dict[str, tuple[int, int]]:
    """Line of each module in the table, and place in the line."""
    return {name: (i, j) for i, line in enumerate(module_table()) for j, name in enumerate(line)}


def test_table_names_exactly_the_modules_there_are(order):
    assert sorted(set(MODULES) - set(order)) == [], "modules missing from the table of docs/architecture.md"
    assert sorted(set(order) - set(MODULES)) == [], "lines of the table without a module"
    assert sum(map(len, module_table())) == len(order), "a module stands in the table twice"


@pytest.mark.parametrize("module", sorted(MODULES))
def test_imports_go_up_only(module, order):
    """A module imports from a line above, or from the left in its own line."""
    for path in MODULES[module]:
        for target in imports_of(path):
            if target == "__init__":
                # Only the version may be asked of the package itself, by the program around it.
                assert module in ("cli", "results"), f"{path.name} imports from the package's __init__"
            elif module in order and target in order:
                assert order[target] < order[module], f"{path.name} imports {target}, which does not stand above it"


def test_no_import_cycle():
    graph = {name: set().union(*(imports_of(path) for path in paths)) & set(MODULES) for name, paths in MODULES.items()}
    while graph:
        leaves = {name for name, targets in graph.items() if not targets & set(graph)}
        assert leaves, f"these import each other: {', '.join(sorted(graph))}"
        graph = {name: targets for name, targets in graph.items() if name not in leaves}


def test_reader_of_imports_sees_lazy_and_relative_ones(tmp_path, monkeypatch):
    """Negative control: what the tests above rest on must find every form of import."""
    source = "def f():\n    from .density import Density\n    from . import plots\n    import pymc_backbone.cycles\n"
    source += "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .op import X\n"
    source += "from pymc_backbone.backbone import y\nimport numpy\n"
    (tmp_path / "model.py").write_text(source)
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path)
    monkeypatch.setattr(f"{__name__}.MODULES", dict.fromkeys(("density", "plots", "cycles", "op", "backbone", "model")))
    assert imports_of(tmp_path / "model.py") == {"density", "plots", "cycles", "backbone"}


@pytest.mark.parametrize("statement", ["import pymc_backbone", "import pymc_backbone.cli"])
def test_import_does_not_load_matplotlib(statement):
    code = f"{statement}; import sys; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "False"


def test_command_line_starts_without_the_heavy_packages():
    """Help and errors come at once: no PyMC, PyTensor, numba, ArviZ, pandas or xarray behind the parser."""
    heavy = ("pymc", "pytensor", "numba", "arviz", "arviz_stats", "pandas", "xarray", "matplotlib", "scipy")
    code = f"import pymc_backbone.cli as c, sys; c.build_parser(); print([m for m in {heavy!r} if m in sys.modules])"
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
