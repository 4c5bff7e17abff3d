"""How to cite: the software and the paper whose likelihood it implements, from ``CITATION.cff``."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import Any

from .checks import check_choice

_LATEX = str.maketrans({character: "\\" + character for character in "&%$#_{}"})


def citation(style: str = "text") -> str:
    """Return how to cite this software and the paper whose likelihood it implements.

    Parameters
    ----------
    style : {"text", "bibtex"}, default "text"
        Two sentences, or two BibTeX entries.

    Returns
    -------
    str
        Made from ``CITATION.cff``, with the version that is installed.

    Raises
    ------
    InputError
        If ``style`` is none of the two.

    See Also
    --------
    InputError : what an unknown style raises.

    Examples
    --------
    >>> print(citation("bibtex").splitlines()[0])
    @software{pymc_backbone,
    """
    check_choice("style", style, ("text", "bibtex"))
    entry = _read(_file())
    works = [entry, *entry["references"]]
    return "\n".join(_sentence(work) if style == "text" else _bibtex(work) for work in works)


def _file() -> Path:
    """Return the file: the wheel carries it among the data, a source tree beside the package."""
    package = Path(str(resources.files("pymc_backbone")))
    carried = package / "data" / "CITATION.cff"
    return carried if carried.exists() else package.parent / "CITATION.cff"


def _read(path: Path) -> dict[str, Any]:
    """Read the part of YAML that the file is written in: one key or item a line, indented by what it belongs to."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    value, rest = _block(lines, 0)
    if rest or not isinstance(value, dict):
        raise ValueError(f"{path.name} is not in the form that is read here: {rest[:1]}")
    return value


def _block(lines: list[str], depth: int) -> tuple[Any, list[str]]:
    """Return what stands at one indentation, and the lines after it."""
    mapping: dict[str, Any] = {}
    items: list[Any] = []
    while lines and _indent(lines[0]) == depth:
        line = lines[0].strip()
        if line.startswith("- "):
            inner = " " * (depth + 2) + line[2:]
            if re.match(r"[\w-]+:(\s|$)", line[2:]):
                value, lines = _block([inner, *lines[1:]], depth + 2)
            else:
                value, lines = _scalar(line[2:]), lines[1:]
            items.append(value)
            continue
        key, _, text = line.partition(":")
        if text.strip():
            mapping[key], lines = _scalar(text), lines[1:]
        else:
            mapping[key], lines = _block(lines[1:], _indent(lines[1]))
    return (items or mapping), lines


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _scalar(text: str) -> str:
    return text.strip().strip("\"'")


def _authors(work: dict[str, Any]) -> list[str]:
    return [author.get("name") or author["family-names"] for author in work["authors"]]


def _preprint(work: dict[str, Any]) -> str:
    return str(work.get("notes", "")).removeprefix("arXiv:")


def _sentence(work: dict[str, Any]) -> str:
    names = _authors(work)
    who = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    if work["type"] == "software":
        return f"{who}. {work['title']}. Version {work['version']}. {work['license']} licence."
    return f"{who} ({work['year']}). {work['title']}. arXiv:{_preprint(work)}."


def _bibtex(work: dict[str, Any]) -> str:
    names = _authors(work)
    fields = {"title": "{" + work["title"].translate(_LATEX) + "}"}
    if work["type"] == "software":
        kind, key = "software", "pymc_backbone"
        fields |= {"author": "{" + names[0] + "}", "version": work["version"], "license": work["license"]}
    else:
        kind, key = "article", f"{names[0].lower()}{work['year']}"
        fields |= {"author": " and ".join("{" + name + "}" for name in names), "year": work["year"]}
        fields |= {"eprint": _preprint(work), "archivePrefix": "arXiv"}
    return "\n".join([f"@{kind}{{{key},", *(f"  {name} = {{{value}}}," for name, value in fields.items()), "}"])
