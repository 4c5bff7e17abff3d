"""The words of a verdict, and of what became of each set: strings, so that files and comparisons hold plain text."""

from __future__ import annotations

from enum import StrEnum


class Verdict(StrEnum):
    """What a study says of the model."""

    ADEQUATE = "adequate"
    FOUND = "found"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"


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
