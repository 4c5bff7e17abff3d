"""How much effects differ between specimens, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._common.text import in_words
from ..fitting.joint_fit import Fit
from ..fitting.scatter import NARROWEST
from ..results.entries import ScatterOfEffects

_AT_BOUND = 1.2  # times the narrowest scatter, up to which it is none that is seen


def scatter_of(found: Fit) -> ScatterOfEffects | None:
    """Return how much the effects differ between specimens; None where nothing is known of it.

    Where no law is exact the question has no answer: what the law cannot follow is taken for differences.
    """
    value, low, high, _ = found.scatter
    return ScatterOfEffects(value, low, high) if np.isfinite(value) else None


def scatter_sentence(scatter: ScatterOfEffects, effects: Sequence[str]) -> str:
    """Say how much effects differ between specimens; where records say little, what the prior allows is the answer."""
    *first, last = map(in_words, effects)
    whose = f"The parameters of {', '.join(first)} and {last} differ" if first else f"The parameters of {last} differ"
    low, middle, high = (f"{100.0 * share:.2g}" for share in (scatter.low, scatter.median, scatter.high))
    if scatter.low < _AT_BOUND * NARROWEST:  # what is smaller was not looked for
        return f"{whose} between specimens by {high} % of their value at most (standard deviation, with 95 %)."
    return f"{whose} between specimens by {middle} % of their value (standard deviation; {low} to {high} % with 90 %)."


__all__ = ["scatter_of", "scatter_sentence"]
