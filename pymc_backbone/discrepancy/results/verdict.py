"""The words of a verdict, and of what became of each set: strings, so that files and comparisons hold plain text."""

from __future__ import annotations

from enum import StrEnum


class Verdict(StrEnum):
    """What a study says of the model."""

    ADEQUATE = "adequate"
    FOUND = "found"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"


class NamedLevel(StrEnum):
    """On what level something is named: one law, or the mechanism that several laws have in common."""

    LAW = "law"
    MECHANISM = "mechanism"


MECHANISM_NAMED = 0.95
"""Probability from which a mechanism is named."""
LEAST_SHARE = 0.05
"""Share of the gap from which a mechanism is named: what explains less may follow what is no law."""


class Status(StrEnum):
    """What became of a candidate set."""

    BEST = "best"
    POSSIBLE = "possible"
    REJECTED = "rejected"
    NOT_CONVERGED = "not converged"
    FAILED = "failed"


class AdequateBy(StrEnum):
    """Why a model is adequate."""

    STATISTICS = "statistics"
    TOLERANCE = "tolerance"
