"""How much an effect's parameters differ between specimens: inferred with a bounded prior, and marginalised."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

SCATTER = 0.1
"""Scatter of an effect's parameters between specimens, relative to their value, that a fit is made with."""
NARROWEST, WIDEST = 0.01, 0.5
"""Bounds of the log-uniform prior of the scatter."""
_GRID = np.geomspace(NARROWEST, WIDEST, 18)
_TAIL = 0.05


class Scatter(NamedTuple):
    """What is known of the scatter of the effects of a fit.

    Attributes
    ----------
    value, low, high : float
        Relative standard deviation over specimens: median, 5 % and 95 % of the posterior. NaN where there is none.
    log_evidence : float
        What the freedom of the scatter adds to the logarithm of the evidence at a scatter of `SCATTER`.
    """

    value: float
    low: float
    high: float
    log_evidence: float


NO_SCATTER = Scatter(float("nan"), float("nan"), float("nan"), 0.0)
"""Of fits without effects, or of one specimen."""


def infer_scatter(log_likelihood: Callable[[float], float]) -> Scatter:
    """Return the posterior of the scatter, and the evidence with it integrated out.

    Parameters
    ----------
    log_likelihood : callable
        Logarithm of the likelihood of a scatter, everything else integrated out.
    """
    each = np.array([log_likelihood(float(width)) for width in _GRID])
    reference = log_likelihood(SCATTER)
    each = np.where(np.isfinite(each), each, -np.inf)
    if not np.isfinite(reference) or not np.isfinite(each).any():
        return NO_SCATTER
    # the trapezoidal rule over the logarithm, in which the prior is uniform
    weight = np.ones(each.size)
    weight[[0, -1]] = 0.5
    share = np.exp(each - each.max()) * weight
    below = (np.cumsum(share) - 0.5 * share) / share.sum()
    low, middle, high = np.exp(np.interp([_TAIL, 0.5, 1.0 - _TAIL], below, np.log(_GRID)))
    evidence = float(logsumexp(each, b=weight / weight.sum())) - reference
    return Scatter(float(middle), float(low), float(high), evidence)


__all__ = ["NARROWEST", "NO_SCATTER", "SCATTER", "WIDEST", "Scatter", "infer_scatter"]
