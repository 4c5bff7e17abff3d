"""A squared distance between model and values that are not independent, and how improbable it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from .._common.checks import FloatArray
from .refit import Refit


@dataclass(frozen=True)
class SquaredDistance:
    """A squared distance, with the mean, and half the variance, that it has if the model is right."""

    square: float = 0.0
    mean: float = 0.0
    half_variance: float = 0.0

    @classmethod
    def of(cls, found: Refit, size: int, noise: FloatArray | None) -> SquaredDistance:
        """Return that of a fit to ``size`` values, whose whitened noise has the covariance ``noise`` (d, d)."""
        if size <= found.fitted:
            return cls()
        if noise is None:
            return cls(found.chi_square, size - found.fitted, size - found.fitted)
        beside = np.eye(len(noise)) - found.directions @ found.directions.T
        left = beside @ noise @ beside
        return cls(found.chi_square, float(np.trace(left)), float((left**2).sum()))

    def __add__(self, other: SquaredDistance) -> SquaredDistance:
        return SquaredDistance(
            self.square + other.square, self.mean + other.mean, self.half_variance + other.half_variance
        )

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the chi-square distribution with that mean and variance, up to a factor."""
        return self.mean**2 / self.half_variance if self.half_variance > 0.0 else 0.0

    def judged(self) -> tuple[float, float, float, float]:
        """Return chi-square, degrees of freedom, their ratio and the p-value; NaN where nothing is left to judge by."""
        if not self.degrees:
            return np.nan, 0.0, np.nan, np.nan
        square = self.square * self.mean / self.half_variance
        return square, self.degrees, square / self.degrees, float(chi2.sf(square, self.degrees))


__all__ = ["SquaredDistance"]
