"""What a survey found: the record of every structure, and what they say together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ..discrepancy.results.verdict import Verdict
from ..reporting.terminal import aligned, short
from .outliers import majority, share_with_more, stand_out, words
from .structure import Structure

SURVEY_KEYS = {
    "program": "'pymc-backbone'",
    "kind": "'survey'",
    "version": "of this package",
    "command": "the command line that repeats the survey; empty from Python",
    "sentence": "what the structures say together",
    "counts": "number of structures by verdict, and 'failed'",
    "standing_out": "name: why, in sentences; the most conspicuous first",
    "structures": "a record for each, in the order given; its keys are the attributes of `Structure`",
    "settings": "every setting that is common to all; defaults that are not given are left out",
    "each": "settings of single structures, by name",
    "seed": "of the survey; that of a structure follows from it and the name",
    "workers": "where the structures ran, in words",
    "seconds": "from start to end",
    "interrupted": "what is missing where Ctrl-C or a kill ended the survey, a sentence; else null",
    "total": "number of structures that were asked for",
}
"""Keys of ``summary.json``; what is not a number (NaN) is null."""


@dataclass(frozen=True, eq=False)
class Survey:
    """Everything `diagnose_many` found.

    Attributes
    ----------
    structures : tuple of Structure
        A record for each structure that was finished or failed, in the order given.
    seed : int
        Of the survey; that of a structure follows from it and the name.
    version : str
        Of this package.
    settings : mapping
        Settings common to all structures.
    each : mapping of str to mapping
        Settings of single structures, by name.
    workers : str
        Where the structures ran, in words.
    seconds : float
        From start to end.
    total : int
        How many structures were asked for.
    interrupted : str or None
        What is missing where Ctrl-C ended the survey, in a sentence.
    command : str
        The command line that repeats the survey; empty from Python.
    output : str or None
        Its folder; None: nothing was written.

    See Also
    --------
    diagnose_many : makes it.
    Study : the result for one structure.
    """

    structures: tuple[Structure, ...]
    seed: int
    version: str
    settings: Mapping[str, Any]
    each: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    workers: str = ""
    seconds: float = float("nan")
    total: int = 0
    interrupted: str | None = None
    command: str = ""
    output: str | None = None

    @property
    def done(self) -> tuple[Structure, ...]:
        """The structures with a verdict."""
        return tuple(item for item in self.structures if item.is_done)

    @property
    def failed(self) -> tuple[Structure, ...]:
        """The structures that could not be diagnosed; ``error`` says why."""
        return tuple(item for item in self.structures if not item.is_done)

    @property
    def counts(self) -> dict[str, int]:
        """Number of structures by verdict, and those that failed."""
        number = Counter(item.verdict for item in self.done)
        return {**{verdict.value: number[verdict] for verdict in Verdict}, "failed": len(self.failed)}

    @cached_property
    def standing_out(self) -> dict[str, tuple[str, ...]]:
        """Why structures stand out, by name, the most conspicuous first."""
        return stand_out(self.structures)

    @property
    def ranked(self) -> tuple[Structure, ...]:
        """The structures with a verdict, those that stand out first."""
        place = {name: i for i, name in enumerate(self.standing_out)}
        return tuple(sorted(self.done, key=lambda item: place.get(item.name, len(place))))

    @property
    def sentence(self) -> str:
        """What the structures say together."""
        most = majority(self.structures)
        if most is not None:
            effects, count, decided = most
            more = share_with_more(self.structures, effects)
            beside = f", {more} of them other effects too" if more else ""
            first = f"{count + more} of {decided} decided structures lack {words(effects)}{beside}"
        else:
            named = [f"{number} {name}" for name, number in self.counts.items() if number and name != "failed"]
            first = (
                f"Of {len(self.structures)} structures: {', '.join(named)}" if named else "No structure was diagnosed"
            )
        rest = [f"{len(self.standing_out)} stand out"] if self.standing_out else []
        rest += [f"{len(self.failed)} could not be diagnosed"] if self.failed else []
        return "; ".join([first, *rest]) + "."

    def table(self) -> str:
        """Return verdict, effects, probability, linear frequency and damping of each as lines of text."""
        head = ("structure", "verdict", "missing effects", "probability", "frequency [Hz]", "damping ratio", "gap")
        rows = [head]
        for item in self.ranked:
            mark = " *" if item.name in self.standing_out else ""
            gap = f"{short(item.gap_before)} -> {short(item.gap_after)}"
            rows.append(
                (
                    f"{_plain(item.name)}{mark}",
                    str(item.verdict),
                    _plain(effects_in_words(item)),
                    short(item.probability),
                    short(item.frequency),
                    short(item.damping_ratio),
                    gap,
                )
            )
        parts = [aligned(rows)] if len(rows) > 1 else []
        if self.standing_out:
            parts.append("* stands out:")
            parts += [f"- {_plain(name)}: {'; '.join(why)}." for name, why in self.standing_out.items()]
        if self.failed:
            parts.append("Could not be diagnosed:")
            parts += [f"- {_plain(item.name)}: {_plain(str(item.error))}" for item in self.failed]
        return "\n".join(parts)

    def entries(self) -> dict[str, Any]:
        """Return everything as plain values, as in ``summary.json``; keys as in `SURVEY_KEYS`."""
        return {
            "kind": "survey",
            "version": self.version,
            "command": self.command,
            "sentence": self.sentence,
            "counts": self.counts,
            "standing_out": {name: list(why) for name, why in self.standing_out.items()},
            "structures": [item.entries() for item in self.structures],
            "settings": dict(self.settings),
            "each": {name: dict(values) for name, values in self.each.items()},
            "seed": self.seed,
            "workers": self.workers,
            "seconds": self.seconds,
            "interrupted": self.interrupted,
            "total": self.total,
        }


def effects_in_words(item: Structure) -> str:
    """Return what is missing in a structure, as far as its verdict goes, in words."""
    if item.verdict == Verdict.AMBIGUOUS:
        named = " or ".join(words(names) for names in item.ambiguous_sets or (item.effects,))
        return named if len(item.ambiguous_sets) > 1 else f"perhaps {named}"
    if item.verdict == Verdict.UNEXPLAINED:
        return "unknown"
    return words(item.named)


def _plain(text: str) -> str:
    from .._common.text import printable

    return printable(text)


__all__ = ["SURVEY_KEYS", "Survey"]
