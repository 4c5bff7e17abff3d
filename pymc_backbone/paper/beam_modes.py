"""Exact bending modes of a uniform cantilever with point masses: one closed form per segment between masses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from .._common.checks import FloatArray, check_finite_array

# Wave number times length between two looks at the determinant: modes of a beam with point masses lie further apart
# unless masses a hundred times the beam's isolate its parts; the count of nodes below finds one that was missed.
_STEP = 0.02


@dataclass(frozen=True, eq=False)
class ModeShape:
    """A mode shape, segment by segment a combination of cos, sin and two decaying exponentials.

    Attributes
    ----------
    wavenumber : float
        Wave number b [1/m]; the angular frequency is b^2 sqrt(EI / mass per length).
    edges : ndarray, shape (s + 1,)
        Ends of the segments [m].
    coefficients : ndarray, shape (s, 4)
        Of cos(b y), sin(b y), exp(-b y) and exp(-b (l - y)) in each segment of length l, y from its left end.

    See Also
    --------
    paper.natural_modes : returns them.
    """

    wavenumber: float
    edges: FloatArray
    coefficients: FloatArray

    def __call__(self, position: ArrayLike, derivative: int = 0) -> FloatArray:
        """Return the shape, or a derivative of it [1/m^derivative], at positions from the clamp [m]."""
        x = check_finite_array("position", np.atleast_1d(position))
        segment = np.clip(np.searchsorted(self.edges, x, side="right") - 1, 0, len(self.edges) - 2)
        columns = _basis(
            self.wavenumber * (x - self.edges[segment]),
            self.wavenumber * np.diff(self.edges)[segment],
            derivative,
        )
        shape: FloatArray = np.einsum("ni,ni->n", columns, self.coefficients[segment])
        return self.wavenumber**derivative * shape


def exact_modes(length: float, positions: FloatArray, mass_ratios: FloatArray, count: int) -> list[ModeShape]:
    """Return the lowest modes of a uniform cantilever with point masses, each with 1 at the tip.

    Parameters
    ----------
    length : float
        Length [m].
    positions : ndarray, shape (p,)
        Of the masses, from the clamp [m]; increasing, in (0, length].
    mass_ratios : ndarray, shape (p,)
        Masses over the mass per length of the beam [m].
    count : int
        How many modes.

    Returns
    -------
    list of ModeShape
        By frequency.

    Notes
    -----
    At a mass the shear force jumps by the inertia force: [w'''] = b^4 (mass / mass per length) w. With w'' = 0 at the
    tip, w = w' = 0 at the clamp and all else continuous, this is a homogeneous system of four equations for each
    segment; its determinant vanishes at the natural frequencies, exact for an Euler-Bernoulli beam. Mode n has n - 1
    nodes inside whatever the masses (Gantmacher and Krein), which is how a missed root would be noticed.
    """
    edges = np.concatenate([[0.0], positions[positions < length], [length]])
    ratios = np.zeros(len(edges) - 1)
    ratios[: len(mass_ratios)] = mass_ratios

    def determinant(phase: float) -> float:
        return float(np.linalg.det(_system(phase / length, edges, ratios)))

    shapes: list[ModeShape] = []
    # The determinant of equations in powers of b vanishes as b goes to 0 without there being a mode.
    left, value = 0.05, determinant(0.05)
    while len(shapes) < count:
        right = left + _STEP
        next_value = determinant(right)
        if value * next_value <= 0.0:
            root = brentq(determinant, left, right, xtol=1e-14, rtol=4 * np.finfo(float).eps)
            shapes.append(_shape(root / length, edges, ratios))
            # The tip, where the shape is 1, is one of the points: a heavy mass there keeps the last node close to it.
            grid = np.linspace(0.0, length, 64 * (count + 1) + 1)
            nodes = np.count_nonzero(np.diff(np.sign(shapes[-1](grid)[grid > 0.01 * length])))
            if nodes != len(shapes) - 1:
                raise ArithmeticError(
                    f"mode {len(shapes)} of the beam has {nodes} nodes instead of {len(shapes) - 1}: two modes are too "
                    "close to be told apart. Leave out the heaviest point mass or take it for a support."
                )
        left, value = right, next_value
    return shapes


def _basis(y: FloatArray, end: FloatArray, derivative: int) -> FloatArray:
    """Columns of the basis, derivatives with respect to phase, which is wave number times position."""
    turn = derivative * np.pi / 2.0
    # cos' = -sin = cos(y + pi/2): every derivative turns the trigonometric functions by a quarter.
    return np.stack([np.cos(y + turn), np.sin(y + turn), (-1.0) ** derivative * np.exp(-y), np.exp(y - end)], axis=-1)


def _system(wavenumber: float, edges: FloatArray, ratios: FloatArray) -> FloatArray:
    """Matrix of the boundary and transition conditions, derivatives divided by powers of the wave number."""
    ends = wavenumber * np.diff(edges)
    n = len(ends)
    at_left = np.stack([_basis(np.zeros(n), ends, k) for k in range(4)])
    at_right = np.stack([_basis(ends, ends, k) for k in range(4)])
    matrix = np.zeros((4 * n, 4 * n))
    matrix[:2, :4] = at_left[:2, 0]
    for i in range(n):
        here, row = slice(4 * i, 4 * i + 4), 4 * i + 2
        inertia = wavenumber * ratios[i] * at_right[0, i]
        if i == n - 1:
            matrix[row, here] = at_right[2, i]
            matrix[row + 1, here] = at_right[3, i] + inertia
        else:
            after = slice(4 * i + 4, 4 * i + 8)
            for k in range(4):
                matrix[row + k, here] = -at_right[k, i]
                matrix[row + k, after] = at_left[k, i + 1]
            matrix[row + 3, here] -= inertia
    return matrix


def _shape(wavenumber: float, edges: FloatArray, ratios: FloatArray) -> ModeShape:
    coefficients = np.linalg.svd(_system(wavenumber, edges, ratios))[2][-1].reshape(-1, 4)
    shape = ModeShape(wavenumber, edges, coefficients)
    return ModeShape(wavenumber, edges, coefficients / shape(edges[-1])[0])


__all__ = ["ModeShape", "exact_modes"]
