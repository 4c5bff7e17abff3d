"""Symmetric matrices whose entries differ by orders of magnitude: scaled to a diagonal of ones, then solved."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .checks import FloatArray


class UnitDiagonal(NamedTuple):
    """A symmetric matrix as one whose diagonal is 1, and what its rows and columns were multiplied by for that.

    Attributes
    ----------
    matrix : (n, n) array
        With rows and columns multiplied.
    scale : (n,) array
        The factors, one over the square roots of the diagonal.
    """

    matrix: FloatArray
    scale: FloatArray

    def scaled(self, other: FloatArray) -> FloatArray:
        """Return another matrix (n, n), rows and columns multiplied likewise; of an inverse, that of the original."""
        product: FloatArray = other * np.outer(self.scale, self.scale)
        return product

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution (n,) for a right-hand side (n,).

        Raises
        ------
        numpy.linalg.LinAlgError
            A singular matrix.
        """
        solution: FloatArray = self.scale * np.linalg.solve(self.matrix, right * self.scale)
        return solution

    def least_squares(self, right: FloatArray, rcond: float) -> FloatArray:
        """Return the shortest solution (n,) for a right-hand side (n,), directions below ``rcond`` left out."""
        solution: FloatArray = self.scale * np.linalg.lstsq(self.matrix, right * self.scale, rcond=rcond)[0]
        return solution

    def log_determinant(self) -> float:
        """Return the logarithm of the determinant of the original matrix."""
        return float(np.linalg.slogdet(self.matrix)[1]) - 2.0 * float(np.log(self.scale).sum())


def unit_diagonal(matrix: FloatArray, ridge: float = 0.0) -> UnitDiagonal:
    """Return a symmetric matrix (n, n) scaled to a diagonal of ones, and ``ridge`` added to these.

    What has nothing on its diagonal stays nothing.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(scale, scale)
    return UnitDiagonal(scaled + ridge * np.eye(scale.size) if ridge else scaled, scale)


__all__ = ["UnitDiagonal", "unit_diagonal"]
