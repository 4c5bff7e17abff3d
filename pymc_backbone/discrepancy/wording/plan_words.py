"""What a plan says: each test in one sentence, with what it promises and what it costs."""

from __future__ import annotations

from ..._common.text import amplitude, in_words
from ..results.design import Contender, Design, Plan, PlannedTest

_HOPELESS = 0.5


def name_of(contender: Contender) -> str:
    """Return a set in words."""
    return " + ".join(map(in_words, contender.effects)) if contender.effects else "no missing effect"


def describe(design: Design, present: Design, unit: str) -> str:
    """Say what to do, and how it differs from what was done."""
    count = "1 ring-down" if design.records == 1 else f"{design.records} ring-downs"
    ratio = design.release / present.release
    release = f"from {amplitude(design.release, unit)}"
    if abs(ratio - 1.0) > 0.02:
        release += f" ({ratio:.2g} times the present release)"
    else:
        release += " (as now)"
    parts = [f"{count} {release}", f"{design.duration:.3g} s each"]
    if design.noise < 0.99 * present.noise:
        parts.append(f"with {present.noise / design.noise:.2g} times less noise")
    if design.added_mass != present.added_mass:
        parts.append(f"with {design.added_mass:.3g} {'kg' if unit == 'm' else 'kg m^2'} added")
    return ", ".join(parts)


def percent(probability: float) -> str:
    """Return a probability for people: no estimate of this kind is certain."""
    if probability > 0.985:
        return "more than 98 %"
    return "less than 2 %" if probability < 0.015 else f"{100.0 * probability:.0f} %"


def sentences(plan: Plan, present: Design, unit: str) -> tuple[str, ...]:
    """Return the advice: what to measure next, and what the same test again would bring."""
    between = " and ".join([", ".join(name_of(item) for item in plan.contenders[:-1]), name_of(plan.contenders[-1])])
    again = f"the same test again: {percent(plan.repeat.probability)}"
    if not plan.best:
        looked_at = f"none of {plan.looked_at} tests that were looked at is better: a plan needs larger releases, more "
        looked_at += "or longer records, less noise, or a mass that can be added"
        return (f"how probably one of {between} is left: {again}; {looked_at}.",)
    said = [_of(item, present, unit, first=not k) for k, item in enumerate(plan.best)]
    said[0] = f"how probably one of {between} is left after {said[0]}; after {again}."
    lost = "" if plan.best[0].probability > _HOPELESS else _hopeless(plan)
    return (*said, *([lost] if lost else []))


def _of(item: PlannedTest, present: Design, unit: str, *, first: bool) -> str:
    said = f"{describe(item.design, present, unit)}: {percent(item.probability)} ({item.seconds:.3g} s of recording)"
    return said if first else f"or after {said}."


def _hopeless(plan: Plan) -> str:
    """Say of which sets the best test tells little even if they are true."""
    worst = min(zip(plan.best[0].by_set, plan.contenders, strict=True), key=lambda pair: pair[0])
    return (
        f"should {name_of(worst[1])} be true, even the best of these tests shows it with {percent(worst[0])} only: a "
        "larger set imitates it."
    )


__all__ = ["describe", "name_of", "percent", "sentences"]
