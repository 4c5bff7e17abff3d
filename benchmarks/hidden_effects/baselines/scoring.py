"""Score the sets named in batches against the truth, by tier and overall, as a Markdown table."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

METHODS = ("closed_form", "stepwise", "frols", "stlsq")
OURS = "pymc_backbone"
OUTCOMES = ("right", "wrong", "nothing named", "ambiguous", "unexplained", "adequate", "failed")

Counts = dict[tuple[str, str], Counter[str]]
"""(method, tier) to how often each outcome."""


def outcome_of_names(named: list[str] | None, hidden: list[str], explainable: bool = True) -> str:
    """Return the outcome of a method that names a set.

    Parameters
    ----------
    named : list of str or None
        The set named, None when the method failed.
    hidden : list of str
        The effects that are missing from the model.
    explainable : bool
        Whether effects of the library are all that distinguishes the data from the base model. Where they are not
        (an effect outside the library, drift, a second mode), naming nothing counts as ``nothing named``, not as right.

    Returns
    -------
    str
        One of `OUTCOMES`.
    """
    if named is None:
        return "failed"
    if sorted(named) == sorted(hidden) and (hidden or explainable):
        return "right"
    return "wrong" if named else "nothing named"


def outcome_of_result(result: dict[str, Any], hidden: list[str], explainable: bool = True) -> str:
    """Return the outcome of a ``result.json`` of the package: ``found`` is right or wrong, other verdicts are kept."""
    verdict = str(result.get("verdict", "failed"))
    if verdict != "found":
        return verdict if verdict in OUTCOMES else "failed"
    named = [effect["name"] for effect in result["missing_effects"]]
    return outcome_of_names(named, hidden, explainable)


def is_explainable(truth: dict[str, Any]) -> bool:
    """Return whether effects of the library are all that distinguishes the data from the base model."""
    return not any(truth.get(key) for key in ("outside", "drift", "second_mode"))


def count(directory: Path) -> Counts:
    """Count the outcomes of all batches of a directory that have ``baselines.json``; tier ``all`` holds them all."""
    counts: Counts = defaultdict(Counter)
    for path in sorted(directory.glob("batch_*/baselines.json")):
        truth = json.loads((path.parent / "truth.json").read_text())
        named = json.loads(path.read_text())
        hidden, explainable = truth["hidden"], is_explainable(truth)
        outcomes = {method: outcome_of_names(named[method], hidden, explainable) for method in METHODS}
        ours = path.parent / "result.json"
        if ours.is_file():
            outcomes[OURS] = outcome_of_result(json.loads(ours.read_text()), hidden, explainable)
        for method, outcome in outcomes.items():
            for tier in (truth.get("tier", "-"), "all"):
                counts[method, tier][outcome] += 1
    return counts


def markdown(counts: Counts) -> str:
    """Return the table: one row per tier and method."""
    tiers = sorted({tier for _, tier in counts} - {"all"})
    lines = ["| tier | method | batches | " + " | ".join(OUTCOMES) + " |", "|---" * (len(OUTCOMES) + 3) + "|"]
    for tier in [*tiers, "all"]:
        for method in (OURS, *METHODS):
            found = counts.get((method, tier))
            if found:
                cells = " | ".join(str(found[outcome]) for outcome in OUTCOMES)
                lines.append(f"| {tier} | {method} | {found.total()} | {cells} |")
    return "\n".join(lines)
