"""How much an effect's parameters differ between specimens: inferred with a bounded prior, and marginalised."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import logsumexp

SCATTER = 0.1
"""Scatter of an effect's parameters between specimens, relative to their value, that fits are made with."""
WIDE_SCATTER = 0.33
"""The same where that leaves the level values unexplained and this does not."""
NARROWEST, WIDEST = 0.01, 0.5
"""Bounds of the log-uniform prior of the scatter."""
_GRID = np.geomspace(NARROWEST, WIDEST, 18)
_FINE, _FEWEST = 400, 4
_TAIL = 0.05


class Scatter(NamedTuple):
    """What is known of the scatter of the effects of a fit.

    Attributes
    ----------
    value, low, high : float
        Relative standard deviation over specimens: median, 5 % and 95 % of the posterior. NaN where there is none.
    log_evidence : float
        What the freedom of the scatter adds to the logarithm of the evidence at the scatter that the fit was made with.
    """

    value: float
    low: float
    high: float
    log_evidence: float

    @property
    def points(self) -> tuple[tuple[float, float], ...]:
        """Weights and scatters that stand for the posterior [1]_.

        References
        ----------
        .. [1] Keefer D. L., Bodily S. E. (1983) Three-point approximations for continuous random variables. Management
           Science 29(5), 595-609. doi:10.1287/mnsc.29.5.595
        """
        return (0.185, self.low), (0.63, self.value), (0.185, self.high)

    @property
    def root_mean_square(self) -> float:
        """The one scatter that gives a mean of specimens the variance it has over the posterior."""
        return float(np.sqrt(sum(weight * scatter**2 for weight, scatter in self.points)))


NO_SCATTER = Scatter(float("nan"), float("nan"), float("nan"), 0.0)
"""Of fits without effects, or of one specimen."""


def infer_scatter(log_likelihood: Callable[[float], float], assumed: float = SCATTER) -> Scatter:
    """Return the posterior of the scatter, and the evidence with it integrated out.

    Parameters
    ----------
    log_likelihood : callable
        Logarithm of the likelihood of a scatter, everything else integrated out.
    assumed : float
        The scatter that the fit was made with.
    """
    each = np.array([log_likelihood(float(width)) for width in _GRID])
    reference = log_likelihood(assumed)
    held = np.isfinite(each)
    if not np.isfinite(reference) or held.sum() < _FEWEST:
        return NO_SCATTER
    # smooth between the points; the prior is uniform in the logarithm
    fine = np.linspace(np.log(NARROWEST), np.log(WIDEST), _FINE)
    smooth = np.maximum(PchipInterpolator(np.log(_GRID[held]), each[held])(fine), each[held].min())
    share = np.exp(smooth - smooth.max())
    below = (np.cumsum(share) - 0.5 * share) / share.sum()
    low, middle, high = np.exp(np.interp([_TAIL, 0.5, 1.0 - _TAIL], below, fine))
    evidence = float(logsumexp(smooth)) - np.log(_FINE) - reference
    return Scatter(float(middle), float(low), float(high), float(evidence))


__all__ = ["NARROWEST", "NO_SCATTER", "SCATTER", "WIDEST", "WIDE_SCATTER", "Scatter", "infer_scatter"]
