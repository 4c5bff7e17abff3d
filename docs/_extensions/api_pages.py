"""The reference of the Python interface and of the command line, written from the package.

Public is what `__all__` lists, in the package and in its public modules: these names are shown, as they are written in
a script, and nothing else.
"""

from __future__ import annotations

import inspect
import io
import os
import re
from contextlib import redirect_stdout
from pathlib import Path

from freshness import write_if_new

import pymc_backbone
from pymc_backbone.cli.main import build_parser

# The public names in the order of the work: a page for each group. A test says when one is missing.
GROUPS = {
    "Records": ("Record", "read_records", "write_records", "demo_folder", "demo_parameters", "condition",
                "ConditionedRecord"),
    "Backbones": (
        "extract_cycles", "envelope_cycles", "Cycles", "backbones_at_levels", "simulate_population", "read_backbones",
        "write_backbones",
    ),
    "Models": ("Oscillator", "Effect", "Parameter", "Signature", "LIBRARY", "get_effect"),
    "Simulation": (
        "simulate_backbone", "BackboneResult", "simulate_decay", "DecayResult", "simulate_waveform", "WaveformResult",
        "Status",
    ),
    "Forced response": (
        "ForcedOscillator", "frequency_response", "FrequencyResponse", "periodic_motion", "PeriodicMotion",
        "fit_frequency_response", "ResponseFit",
    ),
    "Densities": ("fit_density", "fit_data_consistent", "Density"),
    "Inference": (
        "build_model", "build_hierarchical_model", "backbone_likelihood", "backbone_deterministic",
        "BackboneLogLikelihood", "BackboneOp", "sample", "goodness_of_fit", "GoodnessOfFit", "findings",
        "summarise", "unidentified_parameters", "add_log_likelihood", "add_predictions", "set_backbones",
    ),
    "The missing effect": (
        "find_missing_effect", "Study", "write_study", "plan_tests", "Affordable", "Design", "Contender", "Plan",
        "PlannedTest",
    ),
    "Many structures": ("diagnose_many", "Structure", "Survey"),
    "Errors and citation": ("InputError", "citation"),
}  # fmt: skip


def groups() -> dict[str, tuple[str, ...]]:
    """Return all groups, the public modules last: names as they are written after ``pb.``."""
    found = dict(GROUPS)
    for module in pymc_backbone._NAMESPACES:
        names = sorted(getattr(pymc_backbone, module).__all__, key=str.lower)
        found[f"pb.{module}"] = tuple(f"{module}.{name}" for name in names)
    return found


def public_names() -> list[str]:
    """Return every public name as it is written after ``pb.``."""
    own = [name for name in pymc_backbone.__all__ if name not in pymc_backbone._NAMESPACES]
    below = [f"{module}.{name}" for module in pymc_backbone._NAMESPACES for name in _module(module).__all__]
    return own + below


def _module(name: str):
    return getattr(pymc_backbone, name)


def value_of(name: str) -> object:
    """Return what a public name stands for."""
    value: object = pymc_backbone
    for part in name.split("."):
        value = getattr(value, part)
    return value


def write(folder: Path) -> None:
    """Write the overview, a page for each public name and the page of the command line."""
    folder.mkdir(parents=True, exist_ok=True)
    written = {"index.rst": _overview(), "command_line.md": command_line()}
    written |= {f"{name}.rst": _page(name) for name in public_names()}
    for name, text in written.items():
        write_if_new(folder / name, text)
    for path in folder.iterdir():
        if path.name not in written:
            path.unlink()  # of an earlier build: a page without a way to it is a warning


def _page(name: str) -> str:
    """Return the page of one name; each has its own, because docstrings number their references from one."""
    heading = f"pb.{name}"
    lines = [heading, "=" * len(heading), ""]
    value = value_of(name)
    if not callable(value):
        return "\n".join([*lines, f".. py:data:: pymc_backbone.{name}", "", f"   {DATA[name]}", ""])
    kind = "autoclass" if inspect.isclass(value) else "autofunction"
    if inspect.isclass(value) and issubclass(value, Exception):
        kind = "autoexception"
    lines.append(f".. {kind}:: pymc_backbone.{name}")
    return "\n".join([*lines, *(["   :members:"] if kind == "autoclass" else []), ""])


# What the public names are that are neither functions nor classes.
DATA = {
    "LIBRARY": "All effects by name.",
    "paper.CASES": "The source paper's systems by name: a mapping of `Case`.",
    "paper.PAPER_BEAM": "The beam of the source paper as published: a `BeamExperiment`.",
}


def _overview() -> str:
    heading = "Python interface"
    lines = [".. _api:", "", heading, "=" * len(heading), ""]
    lines += [
        "``import pymc_backbone as pb`` gives all of these names; they load when they are first used. What is not",
        "here is not public and may change at any time.",
        "",
    ]
    for group, names in groups().items():
        lines += [group, "-" * len(group), ""]
        if group.startswith("pb."):
            lines += [str(inspect.getdoc(value_of(group.removeprefix("pb."))) or "").split("\n\n")[0], ""]
        lines += [".. list-table::", "   :widths: 32 68", ""]
        for name in names:
            lines += [f"   * - :py:obj:`pb.{name} <pymc_backbone.{name}>`", f"     - {_summary(name)}"]
        lines.append("")
    lines += [".. toctree::", "   :hidden:", "", *(f"   {name}" for names in groups().values() for name in names), ""]
    return "\n".join(lines)


def _summary(name: str) -> str:
    if name in DATA:
        return DATA[name]
    text = inspect.getdoc(value_of(name)) or ""
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
