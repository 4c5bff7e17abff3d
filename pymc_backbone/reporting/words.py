"""Words for what a study decided, the same in reports, figures, terminals and the page over many structures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..discrepancy.verdict import AdequateBy, NamedLevel, Status, Verdict
from ..effects import MECHANISMS

if TYPE_CHECKING:
    from ..discrepancy.study import Study

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
    Verdict.AMBIGUOUS: "Several sets of effects explain the gap equally well; these records cannot tell them apart.",
    Verdict.UNEXPLAINED: "There is a gap that no effect known to the program explains; "
    "the best set explains a part of it.",
}
NAMED_MEANS: dict[str, str] = {
    NamedLevel.LAW: "One set of effects explains the gap between base model and measurement, and the others do not.",
    NamedLevel.MECHANISM: "No law is exact, but all that explain the gap agree on its mechanism; a smooth departure of "
    "unknown size is allowed for.",
}
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


def added_effects(study: Study) -> tuple[str, ...]:
    """Return the names of the effects that the extended model has beyond the base."""
    base = {effect.name for effect in study.base.effects}
    return tuple(effect.name for effect in (study.extended or study.base).effects if effect.name not in base)


def mechanism_name(mechanism: str) -> str:
    """Return a mechanism in words."""
    return MECHANISMS.get(mechanism, mechanism.replace("_", " "))


def set_name(effects: Sequence[str], nothing: str = "nothing (base model)") -> str:
    """Return a set of effects as words; the empty set as ``nothing``."""
    return " + ".join(name.replace("_", " ") for name in effects) or nothing


def percent(probability: float) -> str:
    """Return a probability as a percentage that never rounds to certainty or to nothing."""
    if not np.isfinite(probability):
        return "-"
    if 0.999 < probability < 1.0:
        return "> 99.9 %"
    if 0.0 < probability < 0.001:
        return "< 0.1 %"
    return f"{100.0 * probability:.3g} %" if probability < 0.995 else f"{100.0 * probability:.4g} %"
