"""What a fit says of the effects' parameters, and the same fit with some effects turned off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._common.checks import FloatArray
from . import starts
from .joint_fit import Fit
from .normal_equations import State


def estimates_of(found: Fit, covariance: FloatArray | None = None) -> dict[str, tuple[float, float]]:
    """Return value over the batch and standard error of the effects' parameters, specimens scattering as they do.

    With a ``covariance`` (q, q) of the shared coordinates, the errors are those.
    """
    q = found.layout.free.size
    if q == 0:
        return {}
    values, slopes = found.layout.physical(found.centre, np.zeros(q), 0.0)
    known = found.population_covariance if covariance is None else covariance
    variance = slopes @ np.nan_to_num(known) @ slopes.T
    errors = np.sqrt(np.maximum(np.diag(variance), 0.0))
    rows = zip(found.layout.names, values, errors, strict=True)
    return {name: (float(value), float(error)) for name, value, error in rows}


def without(found: Fit, names: Sequence[str]) -> Fit:
    """Return a fit with some effects turned off, everything else as it was."""
    eta = found.state.eta.copy()
    for name in names:
        where = starts.positions(found.layout, name)
        eta[where[0]] = 0.0
    return replace(found, state=State(eta, found.state.own))
