"""Words for what a study decided, the same in reports, figures, terminals and the page over many structures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._common.text import capitalised, in_words
from ..discrepancy.deciding.decision import as_told
from ..discrepancy.results.verdict import AdequateBy, NamedLevel, Status, Verdict
from ..discrepancy.weighing.evidence import MISSING
from ..effects import LIBRARY, MECHANISMS

if TYPE_CHECKING:
    from ..discrepancy.results.entries import Candidate, Estimate
    from ..discrepancy.results.study import Study

VERDICT_WORDS: dict[str, str] = {
    Verdict.ADEQUATE: "\N{CHECK MARK} Adequate",
    Verdict.FOUND: "\N{BLACK CIRCLE} Found",
    Verdict.AMBIGUOUS: "? Ambiguous",
    Verdict.UNEXPLAINED: "! Unexplained",
}
VERDICT_MEANS: dict[str, str] = {
    Verdict.ADEQUATE: "The base model describes these records; no effect needs to be added.",
    Verdict.FOUND: "One set of effects, or one mechanism, explains the gap between base model and measurement, and the "
    "others do not.",
    Verdict.AMBIGUOUS: "Several explanations of the gap remain possible; these records do not decide between them.",
    Verdict.UNEXPLAINED: "There is a gap that no effect known to the program explains; "
    "the best set explains a part of it.",
}
NAMED_MEANS: dict[str, str] = {
    NamedLevel.LAW: "One set of effects explains the gap between base model and measurement, and the others do not.",
    NamedLevel.MECHANISM: "All that explain the gap agree on its mechanism. Its law is not certain: one that the "
    "library lacks, or what bends the sensor's readings, would look much the same.",
}
NONE_IS_EXACT = (
    "All that explain the gap agree on its mechanism. Its law is not certain: none is exact, and a smooth departure of "
    "unknown size is allowed for."
)
ADEQUATE_BY: dict[str, str] = {
    AdequateBy.STATISTICS: "Model and measurement agree within measurement error.",
    AdequateBy.TOLERANCE: "There is a difference beyond measurement error, "
    "and it is smaller than the tolerance that was set.",
}
STATUS_WORDS: dict[str, str] = {
    Status.BEST: "best",
    Status.POSSIBLE: "possible",
    Status.REJECTED: "rejected",
    Status.NOT_CONVERGED: "not converged",
    Status.FAILED: "could not be fitted",
}


WARNING = "warning: "
"""How a note begins that speaks against the data; of one record the record's name stands before it."""
_AS_BEFORE = 1.1  # factor by which the gap shrinks, or grows, up to which it is as before
LEAST_TOLD = 0.01
"""Probability from which it is told what the sets that are listed do not hold of it."""


def verdict_means(study: Study) -> str:
    """Return what the verdict means, in a sentence; empty for one that is not known."""
    if study.verdict == Verdict.UNEXPLAINED and any(
        item.status == Status.BEST and item.has_drift and not item.effects for item in study.candidates
    ):
        return "There is a gap, and the base model explains it with a frequency or a damping that changes with time."
    if study.verdict == Verdict.UNEXPLAINED and study.extended is None:
        return "The base model leaves something of the records that no effect known to the program explains."
    if study.verdict != Verdict.FOUND:
        return VERDICT_MEANS.get(study.verdict, "")
    if study.named_level == NamedLevel.MECHANISM and study.ambiguous_sets:
        return (
            "All that explain the gap agree on its mechanism, and leave no more than noise; these records do not tell "
            "which law it is, or whether a smaller effect stands beside it."
        )
    if study.named_level == NamedLevel.MECHANISM and study.remainder:
        return NONE_IS_EXACT
    return NAMED_MEANS[study.named_level or NamedLevel.LAW]


def added_effects(study: Study) -> tuple[str, ...]:
    """Return the names of the effects that the extended model has beyond the base."""
    base = {effect.name for effect in study.base.effects}
    return tuple(effect.name for effect in (study.extended or study.base).effects if effect.name not in base)


def adequate_because(study: Study) -> str:
    """Return why the base is adequate, in a sentence; empty where it is not."""
    if study.adequate_by is None:
        return ""
    if study.adequate_by == AdequateBy.STATISTICS and study.missing_p_value <= MISSING:
        return (
            "Such a gap is rare where nothing is missing, and yet no set of known effects is more probable than none."
        )
    return ADEQUATE_BY.get(study.adequate_by, "")


def remaining(study: Study) -> list[str]:
    """Return the sets that a verdict leaves possible, each with its probability, and what they do not hold of it."""
    chances = _chances(study)
    known = [chances.get(names, float("nan")) for names in study.ambiguous_sets]
    lines = [f"{set_name(names)}: {percent(p)}" for names, p in zip(study.ambiguous_sets, known, strict=True)]
    rest = 1.0 - sum(known)
    return [*lines, f"any other explanation: {percent(rest)}"] if lines and rest > LEAST_TOLD else lines


def _chances(study: Study) -> dict[tuple[str, ...], float]:
    """Return the probabilities of sets as they are told."""
    chances = {candidate.effects: candidate.probability for candidate in study.candidates}
    return as_told(study.ambiguous_sets, study.below_tolerance, chances)


def remaining_by_mechanism(study: Study) -> list[tuple[str, list[str]]]:
    """Return the sets that a verdict leaves possible, those of the same mechanisms together, likeliest first.

    Returns
    -------
    list of (str, list of str)
        The mechanisms with their probability, and the sets with theirs, as `remaining` writes them.
    """
    chances = _chances(study)
    groups: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for names in study.ambiguous_sets:
        found = sorted({(LIBRARY[name].mechanism if name in LIBRARY else None) or "other" for name in names})
        groups.setdefault(tuple(found), []).append(names)
    rows = []
    for kinds, sets in groups.items():
        total = sum(chances.get(names, 0.0) for names in sets)
        lines = [f"{set_name(names)}: {percent(chances.get(names, float('nan')))}" for names in sets]
        title = " + ".join(map(mechanism_name, kinds)) or "nothing more than the model holds"
        rows.append((total, f"{title}: {percent(total)}", lines))
    return [(title, lines) for _, title, lines in sorted(rows, key=lambda row: -row[0])]


def is_in_waveforms_only(study: Study) -> bool:
    """Return whether the samples show what was added, and the backbones that were held out stay as they are."""
    before, after = left_of_samples(study)
    is_as_before = bool(1.0 / _AS_BEFORE < study.shrink < _AS_BEFORE)
    return is_as_before and study.present is not None and after < before


def left_of_samples(study: Study) -> tuple[float, float]:
    """Return the reduced chi-square of the samples, of the base model and of the set that the verdict is said of."""
    left = {item.status if item.effects else "base": item.reduced_chi_square for item in study.candidates}
    return left.get("base", float("nan")), left.get(Status.BEST, float("nan"))


def next_steps(study: Study) -> list[str]:
    """Return what to do next: what speaks against the data first, then what to measure, else what to look at."""
    steps = [check.message for check in study.checks if not check.passed]
    steps += [note.removeprefix(WARNING) for note in study.notes if note.startswith(WARNING)]
    steps += study.advice
    if not steps and study.verdict == Verdict.UNEXPLAINED:
        steps.append(
            "look at what single records show, below: points that no line meets are the force that the model lacks. An "
            "effect of your own can be a candidate: `pb.Effect`"
        )
    if not study.advice and study.verdict == Verdict.FOUND:
        steps.append("the extended model is in model.py, a PyMC script to run and to edit")
    named = {str(name) for name in study.backbones["specimen"].values}
    sentences = [step if step.split()[0] in named else capitalised(step) for step in steps]
    return [f"{step.rstrip('.')}." for step in sentences]


def is_held(estimate: Estimate) -> bool:
    """Return whether a parameter was held at its value, where forces tell no more than the others do."""
    return estimate.hdi_low == estimate.mean == estimate.hdi_high


def mechanism_name(mechanism: str) -> str:
    """Return a mechanism in words."""
    return MECHANISMS.get(mechanism, in_words(mechanism))


def set_name(effects: Sequence[str], nothing: str = "nothing (base model)") -> str:
    """Return a set of effects as words; the empty set as ``nothing``."""
    return " + ".join(map(in_words, effects)) or nothing


def candidate_name(candidate: Candidate) -> str:
    """Return a row of the table of sets as words: its effects, and that its fit drifts with time."""
    return set_name(candidate.effects) + (", with a drift in time" if candidate.has_drift else "")


def percent(probability: float) -> str:
    """Return a probability as a percentage that never rounds to certainty or to nothing."""
    if not np.isfinite(probability):
        return "-"
    if probability > 0.999:
        return "> 99.9 %"
    if 0.0 < probability < 0.001:
        return "< 0.1 %"
    return f"{100.0 * probability:.3g} %" if probability < 0.995 else f"{100.0 * probability:.4g} %"
