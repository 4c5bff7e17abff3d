"""The reference of the Python interface and of the command line, written from the package."""

from __future__ import annotations

import ast
import importlib
import inspect
import io
import os
import re
import textwrap
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType

from freshness import write_if_new

import pymc_backbone
from pymc_backbone.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pymc_backbone"

# The public names of the package in the order of the work. A name that is missing here is put under "Others".
GROUPS = {
    "Records": ("Record", "read_records", "write_records", "demo_folder", "condition", "ConditionedRecord"),
    "Backbones": (
        "extract_cycles", "Cycles", "backbones_at_levels", "simulated_backbones", "read_backbones", "write_backbones",
    ),
    "Models": ("Oscillator", "Effect", "Parameter", "Signature", "LIBRARY", "get_effect"),
    "Simulation": (
        "simulate_backbone", "BackboneResult", "simulate_decay", "DecayResult", "simulate_waveform", "WaveformResult",
        "Status",
    ),
    "Densities": ("fit_density", "fit_data_consistent", "Density"),
    "Inference": (
        "build_model", "build_hierarchical_model", "backbone_likelihood", "simulated_backbone",
        "BackboneLogLikelihood", "SimulatedBackbone", "sample", "findings", "summarise", "unidentified_parameters",
    ),
    "The missing effect": ("find_missing_effect", "Study", "write_study"),
    "Errors": ("InputError",),
}  # fmt: skip


def public_modules() -> list[str]:
    """Return the modules without a leading underscore, by their full names; effects by their package only."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        parts = parts[:-1] if is_package else parts
        if not parts or any(part.startswith("_") for part in parts) or (parts[0] == "effects" and not is_package):
            continue
        found.append(".".join(("pymc_backbone", *parts)))
    return sorted(found)


def public_names(module_name: str) -> list[str]:
    """Return what a module passes on in its ``__all__``, and the functions and classes that its source defines."""
    module = importlib.import_module(module_name)
    chosen = list(getattr(module, "__all__", ()))
    return chosen + [name for name in _definitions(module) if name not in chosen]


def _definitions(module: ModuleType) -> dict[str, str]:
    """Return the public functions and classes in the source of a module, decorated or not, with their docstrings."""
    nodes = ast.parse(inspect.getsource(module)).body
    kinds = (ast.FunctionDef, ast.ClassDef)
    found = [node for node in nodes if isinstance(node, kinds) and not node.name.startswith("_")]
    return {node.name: ast.get_docstring(node) or "" for node in found}


def where(name: str) -> str:
    """Return the full name under which a public name of the package is described."""
    module = f"pymc_backbone.{pymc_backbone._MODULE_OF[name]}"
    return f"pymc_backbone._common.checks.{name}" if module.endswith("._checks") else f"{module}.{name}"


def write(folder: Path) -> None:
    """Write the overview, a page for each public module and the page of the command line."""
    folder.mkdir(parents=True, exist_ok=True)
    described = [*public_modules(), "pymc_backbone._common.checks"]
    for name in described:
        write_if_new(folder / f"{name}.rst", _module_page(name))
    write_if_new(folder / "index.rst", _overview(described))
    write_if_new(folder / "command_line.md", command_line())


def _module_page(name: str) -> str:
    heading = name.removeprefix("pymc_backbone.").removeprefix("_checks") or "errors"
    lines = [heading, "=" * len(heading), "", f".. automodule:: {name}", ""]
    if name == "pymc_backbone._common.checks":
        lines[3] = f".. currentmodule:: {name}"
        return "\n".join([*lines, f".. autoexception:: {name}.InputError", ""])
    module = importlib.import_module(name)
    definitions = _definitions(module)
    for member in public_names(name):
        value = getattr(module, member)
        if member in definitions and not (inspect.isfunction(value) or inspect.isclass(value)):
            # a decorator made something else of the function
            lines += [
                f".. py:function:: {name}.{member}",
                "",
                *textwrap.indent(definitions[member], "   ").splitlines(),
                "",
            ]
            continue
        kind = "autodata" if not callable(value) else "autoclass" if inspect.isclass(value) else "autofunction"
        if inspect.isclass(value) and issubclass(value, Exception):
            kind = "autoexception"
        lines += [f".. {kind}:: {name}.{member}"]
        if kind == "autodata":
            lines.append("   :no-value:")
        if kind == "autoclass":
            lines.append("   :members:")
        lines.append("")
    return "\n".join(lines)


def _overview(described: list[str]) -> str:
    heading = "Python interface"
    lines = [".. _api:", "", heading, "=" * len(heading), ""]
    lines += [
        "``import pymc_backbone as pb`` gives the names of the first part; they load when they are first used. The",
        "second part holds every public name of every public module.",
        "",
    ]
    taken = {name for names in GROUPS.values() for name in names}
    groups = dict(GROUPS)
    rest = tuple(name for name in pymc_backbone.__all__ if name not in taken)
    if rest:
        groups["Others"] = rest
    for group, names in groups.items():
        lines += [group, "-" * len(group), "", ".. list-table::", "   :widths: 32 68", ""]
        for name in names:
            summary = _summary(getattr(pymc_backbone, name), name)
            lines += [f"   * - :py:obj:`pb.{name} <{where(name)}>`", f"     - {summary}"]
        lines.append("")
    lines += [
        "Modules",
        "-------",
        "",
        ".. toctree::",
        "   :maxdepth: 1",
        "",
        *(f"   {name}" for name in described),
        "",
    ]
    return "\n".join(lines)


def _summary(value: object, name: str) -> str:
    if name == "LIBRARY":
        return "All effects by name."
    text = inspect.getdoc(value) or ""
    return " ".join(text.split("\n\n", 1)[0].split())


def command_line() -> str:
    """Return the page with the help of every command, as the program prints it."""
    os.environ |= {"COLUMNS": "100", "NO_COLOR": "1"}
    parser = build_parser()
    lines = ["# Command line", "", "What `pymc-backbone COMMAND --help` prints.", ""]
    lines += ["```text", _help(parser), "```", ""]
    (commands,) = (choices for action in parser._actions if isinstance(choices := action.choices, dict))
    for name, command in commands.items():
        lines += [f"## {name}", "", "```text", _help(command), "```", ""]
    return "\n".join(lines)


def _help(parser) -> str:
    stream = io.StringIO()
    with redirect_stdout(stream):
        parser.print_help()
    return re.sub(r"\x1b\[[0-9;]*m", "", stream.getvalue()).rstrip()
