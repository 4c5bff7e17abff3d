"""What the records say of one curve, with everything else integrated out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._common.checks import FloatArray
from ..._common.unit_diagonal import unit_diagonal
from .curve_system import At, Frame, place_of
from .tabulated import Tabulated


@dataclass(frozen=True, eq=False)
class Known:
    """What the records say of one curve, everything else integrated out: a quadratic function of its free coordinates.

    Attributes
    ----------
    frame : (n, m) array
        Takes free coordinates to node forces [N], no line in them.
    precision : (m, m) array
        Of the records alone.
    prior : (m, m) array
        Of the bends.
    pull : (m,) array
        Slope of the records' logarithm of the likelihood where there is no curve.
    follows : (2 + q, m) array
        What the mean specimen's stiffness, damping and shared coordinates do where the free coordinates move.
    left : (2, 2) array
        Covariance of that stiffness and damping where the curve is known.
    """

    frame: FloatArray
    precision: FloatArray
    prior: FloatArray
    pull: FloatArray
    follows: FloatArray
    left: FloatArray

    def place(self) -> FloatArray:
        """Return the free coordinates (m,) of the curve that the prior of the bends makes most probable."""
        return unit_diagonal(self.precision + self.prior).least_squares(self.pull, 1e-13)


def known_of(
    tabulated: Tabulated,
    at: At,
    frame: Frame,
    objective: tuple[FloatArray, FloatArray],
    prior: FloatArray,
    along: FloatArray,
    effect: str,
) -> Known:
    """Return what the records say of one curve: its own prior is taken off, and all else eliminated.

    ``objective`` is the Hessian and the downhill slope. A fit that has settled is at its minimum to a share of an error
    only, and the precisions of the bends have moved since. Times the precision of a part that went to nothing even that
    is more than the records say, so that the slope that is left belongs to it.
    """
    hessian, downhill = objective
    mine = np.zeros(hessian.shape[0], dtype=bool)
    mine[frame.own_columns[effect]] = True
    cross = hessian[np.ix_(~mine, mine)]
    scaled, scale = unit_diagonal(hessian[np.ix_(~mine, ~mine)])
    within = np.linalg.lstsq(scaled, cross * scale[:, None], rcond=1e-13)[0]
    own = prior[np.ix_(mine, mine)]
    precision = hessian[np.ix_(mine, mine)] - own - (cross * scale[:, None]).T @ within
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.T))
    precision = (vectors * np.maximum(values, 0.0)) @ vectors.T
    place = place_of(at, frame)[mine]
    nodes = frame.directions[: tabulated.layout.free.size][np.ix_(tabulated.places(effect), mine)]
    scaled_along = along[:, ~mine] * scale
    follows = along[:, mine] - scaled_along @ within
    left = scaled_along[:2] @ np.linalg.lstsq(scaled, scaled_along[:2].T, rcond=1e-13)[0]
    pull = (precision + own) @ place + downhill[mine] - within.T @ (downhill[~mine] * scale)
    return Known(nodes, precision, own, pull, follows, left)
