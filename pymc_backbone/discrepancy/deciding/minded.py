"""Decisions, minded of what is in the records beside one mode: another one, a bent sensor, what goes on moving it."""

from __future__ import annotations

from dataclasses import replace

from ..results.verdict import NamedLevel, Verdict
from ..sets.search import Search
from .decide import without_laws
from .decision import Decision

_OF_SPRINGS = frozenset(("spring", "asymmetry", "clearance"))  # mechanisms


def mind_second_mode(decision: Decision, *, is_beside_drift: bool = False) -> Decision:
    """Return what can be said of records in which a second mode beats.

    Its line is no effect of a single mode, and the estimate of the noise holds it: "nothing is missing" is not true,
    and a name rests on a misfit that the second mode may have made. So may a drift in time of the base: where the line
    is beside that, too, it is the line that is told.
    """
    if is_beside_drift:
        decision = replace(decision, drift_probability=0.0)
    if decision.verdict is Verdict.ADEQUATE:
        return replace(decision, has_second_mode=True, verdict=Verdict.UNEXPLAINED, adequate_by=None)
    if decision.verdict is Verdict.FOUND:
        return replace(
            decision,
            has_second_mode=True,
            verdict=Verdict.AMBIGUOUS,
            named_level=None,
            listed=decision.listed or (decision.best,),
        )
    return replace(decision, has_second_mode=True)


def mind_what_moves_on(decision: Decision) -> Decision:
    """Return what can be said where something goes on moving the structures: what is certain all the same.

    Where no set explains the records and no mechanism is certain, what is left is that, and no missing effect.
    """
    is_open = decision.verdict is Verdict.UNEXPLAINED or (
        decision.verdict is Verdict.AMBIGUOUS and decision.is_approximate
    )
    if not is_open or any(item.is_certain for item in decision.mechanisms) or decision.has_second_mode:
        return decision
    return replace(
        decision, verdict=Verdict.UNEXPLAINED, is_moved_on=True, best=(), below=(), simulated=None, listed=(),
        unfinished=(), nearest=None, mechanisms=(), remainder=(), on_backbones=None,
        probability=decision.probabilities.get((), 0.0),
    )  # fmt: skip


def mind_bent_sensor(search: Search, decision: Decision) -> Decision:
    """Return what can be said of a spring behind a sensor that bends: its mechanism.

    Seen through a bent sensor, a mass that changes with the displacement is one that does not, on another spring: the
    records are those of the same law of force in a coordinate of its own.
    """
    kinds = {search.mechanism_of(name) for name in decision.best}
    is_spring = decision.named_level is NamedLevel.LAW and bool(kinds & _OF_SPRINGS)
    return without_laws(decision) if is_spring else decision


__all__ = ["mind_bent_sensor", "mind_second_mode", "mind_what_moves_on"]
