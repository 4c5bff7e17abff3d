"""A set of effects linearised with a departure beside it, and how likely it is there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ..fitting.layout import Layout
from ..fitting.normal_equations import State
from .departure import Choice

_ROUNDING = 1e-9  # of information scaled to a unit diagonal, where it is singular but for it
_BORDER = 1e60  # far above what any gradient explains


@dataclass(frozen=True, eq=False)
class Point:
    """A set where it was linearised, and how likely it is there.

    Attributes
    ----------
    layout, state : Layout, State
        The set, and where.
    drifts : str
        Whether frequency and damping may drift with time: ``""``, ``"own"`` or ``"common"``.
    residuals : (n,) array
        Measured minus simulated values.
    jacobian : (n, m) array
        Derivatives of the simulated values: shared coordinates, common drifts, each specimen's own unknowns.
    own : (r, o) array of int
        Which columns are a specimen's own: stiffness, damping, zero, deviations, drifts.
    widths, pull : (m,) arrays
        Standard deviations of the priors; where the state stands in these priors.
    choice : Choice
        Sizes, noises and smoothness at which it was judged.
    log_evidence : float
        At that choice, its prior included.
    """

    layout: Layout
    state: State
    drifts: str
    residuals: FloatArray
    jacobian: FloatArray
    own: IntArray
    widths: FloatArray
    pull: FloatArray
    choice: Choice
    log_evidence: float = -np.inf

    @property
    def in_widths(self) -> FloatArray:
        """Derivatives (n, m) with respect to the unknowns in units of their priors."""
        return self.jacobian * self.widths

    def normal(self, products: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return information (..., m, m) and downhill slope (..., m) from products of these and the residuals."""
        m = self.widths.size
        return products[..., :m, :m] + np.eye(m), products[..., :m, m] - self.pull


def log_evidence_of(point: Point, products: FloatArray) -> FloatArray:
    """Return the logarithm of the evidence (g,) without determinants of the noise, from products in prior widths.

    A specimen's own unknowns are taken where they are most probable; the shared ones stay where they are. One Cholesky
    factor tells both: of the information, the own unknowns first, with their gradient as a last row.
    """
    q, m = point.layout.free.size, point.widths.size
    information, slope = point.normal(products)
    gradient = slope[:, q:]
    order = np.r_[q:m, :q]
    scale = 1.0 / np.sqrt(np.einsum("gii->gi", information)[:, order])
    bordered = np.zeros((len(products), m + 1, m + 1))
    bordered[:, :m, :m] = information[:, order[:, None], order] * (scale[:, :, None] * scale[:, None, :])
    bordered[:, m, : m - q] = gradient * scale[:, : m - q]
    bordered[:, m, m] = _BORDER
    try:
        factor = np.linalg.cholesky(bordered)
    except np.linalg.LinAlgError:
        bordered[:, range(m), range(m)] += _ROUNDING
        factor = np.linalg.cholesky(bordered)
    determinant = 2.0 * (np.log(np.einsum("gii->gi", factor)[:, :m]) - np.log(scale)).sum(axis=1)
    misfit = products[:, m, m] + float((point.pull**2).sum()) - (factor[:, m, : m - q] ** 2).sum(axis=1)
    logs: FloatArray = -0.5 * (misfit + determinant)
    return np.where(np.isfinite(logs), logs, -np.inf)


__all__ = ["Point", "log_evidence_of"]
