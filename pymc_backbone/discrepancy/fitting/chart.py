"""Relative coordinates of the effects' parameters, in which valleys of forces that follow power laws are straight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import BoolArray, FloatArray
from .layout import MOST_OPPOSED, Layout


@dataclass(frozen=True, eq=False)
class Chart:
    """Relative coordinates: logarithms of what is positive, ratios to what is opposed, units of prior or value.

    Valleys of forces that follow power laws are straight in these.
    """

    layout: Layout
    is_log: BoolArray
    unit: FloatArray

    @classmethod
    def around(cls, layout: Layout, eta: FloatArray) -> Chart:
        """Return the coordinates around a point."""
        opposed = np.isin(np.arange(eta.size), [j for j, _ in layout.opposed])
        is_log = (layout.low >= 0.0) & (eta > 0.0) & ~opposed
        unit = np.where(layout.is_strength & (eta != 0.0), np.abs(eta), layout.width)
        unit[opposed] = 1.0
        return cls(layout, is_log, unit)

    def to(self, eta: FloatArray) -> FloatArray:
        """Return the relative coordinates (q,) of those of the fit."""
        place = np.where(self.is_log, np.log(np.where(self.is_log, eta, 1.0)), eta / self.unit)
        for j, other in self.layout.opposed:
            place[j] = eta[j] / eta[other]
        return place

    def back(self, place: FloatArray) -> FloatArray:
        """Return the coordinates (q,) of the fit."""
        eta = np.where(self.is_log, np.exp(np.where(self.is_log, place, 0.0)), place * self.unit)
        for j, other in self.layout.opposed:
            eta[j] = np.clip(place[j], -1.0, MOST_OPPOSED) * eta[other]
        return eta

    def slopes(self, eta: FloatArray) -> FloatArray:
        """Return the derivatives (q, q) of the coordinates of the fit to these."""
        slopes = np.diag(np.where(self.is_log, eta, self.unit))
        for j, other in self.layout.opposed:
            slopes[j, j] = eta[other]
            slopes[j] += eta[j] / max(eta[other], 1e-300) * slopes[other]
        return slopes


__all__ = ["Chart"]
