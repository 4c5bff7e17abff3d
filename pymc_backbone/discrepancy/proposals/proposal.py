"""One set of effects and how well it explains the level values."""

from __future__ import annotations

from dataclasses import dataclass

from ..._common.checks import FloatArray
from ..fitting.scatter import SCATTER
from .set_fits import Set


@dataclass(frozen=True, eq=False)
class Proposal:
    """One set of effects and how well it explains the level values.

    Attributes
    ----------
    names : tuple of str
        Effects beyond the base, sorted.
    eta : (q,) array
        Shared coordinates in the set's `Layout`.
    own : (r, 2) array
        Stiffness and damping of each specimen.
    chi_square : float
        Of the level values with the model-error floor, the scatter of the effects at its best.
    is_exact : bool
        Whether the exact simulator gave ``chi_square``, or the look alone.
    log_evidence : float
        For ranking, the prior of the set's size included.
    starts : tuple of (float, (q,) array, (r, 2) array)
        Minima found: chi-square, coordinates, own values; best first.
    scatter : float
        How much the effects were taken to differ between specimens.
    """

    names: Set
    eta: FloatArray
    own: FloatArray
    chi_square: float
    is_exact: bool
    log_evidence: float
    starts: tuple[tuple[float, FloatArray, FloatArray], ...]
    scatter: float = SCATTER
