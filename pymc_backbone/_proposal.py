"""Joint Metropolis proposals shaped by the curvature of the log-density.

Backbones determine combinations of parameters: stiffness at one amplitude, damping at another. One variable at a
time, a random walk crawls along such ridges; a joint proposal with the posterior's own shape does not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pymc as pm

from ._checks import FloatArray
from ._starts import StartFinder


class JointMetropolis(pm.Metropolis):
    """PyMC's Metropolis with one joint proposal a draw.

    PyMC's own updates a vector one entry at a time, each entry with two evaluations, whatever covariance it is given.

    Parameters
    ----------
    covariance : ndarray, shape (d, d)
        Of the proposal, over all unconstrained variables.
    **kwargs
        As of `pymc.Metropolis`.
    """

    name = "joint_metropolis"
    default_blocked = True

    def __init__(self, covariance: FloatArray, **kwargs: Any) -> None:
        # The best scale of a joint random walk is 2.38 / sqrt(d): Roberts, Gelman, Gilks, Ann. Appl. Probab. 7 (1997).
        super().__init__(S=covariance, scaling=2.38 / np.sqrt(len(covariance)), blocked=True, **kwargs)
        self.elemwise_update = False
        self.accepted_sum = np.zeros(1, dtype=int)
        self.accept_rate_iter = np.zeros(1)
        self.accepted_iter = np.zeros(1, dtype=bool)


def make_metropolis(model: pm.Model, finder: StartFinder) -> pm.Metropolis:
    """Return a Metropolis step for ``model``: joint where the finder knows the posterior's shape, else PyMC's own."""
    with model:
        return pm.Metropolis() if finder.shape is None else JointMetropolis(finder.shape)
