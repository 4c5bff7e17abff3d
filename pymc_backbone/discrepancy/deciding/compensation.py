"""Sets whose effects take each other's doing back: what two laws have in common by chance is rarely that."""

from __future__ import annotations

import numpy as np

from ..._common.checks import FloatArray
from ...effects import LIBRARY
from ..fitting.batch import Batch
from ..fitting.curves import curve, spread_over
from ..fitting.joint_fit import Fit
from ..sets.search import Search, Set

_OBSERVABLES = 2  # frequency and damping
_LEAST_LEVELS = 4


def compensation(search: Search, names: Set, found: Fit | None = None, batch: Batch | None = None) -> float:
    """Return how many times what an effect of a set does to the backbones exceeds what the set does; 1 at least.

    Of frequency and damping, the changes over amplitude count: their means are each specimen's own stiffness and
    damper. What a set does is no less than the levels' errors. Effects of structures that hold several of them do not
    know of each other, and seldom take back most of what another does: more than twice as much as is left in 7 of 106
    sets of two and three that were drawn independently, more than five times in none. What is no effect of the library,
    and is imitated by several, has no such bound. ``found`` is another fit of the set than that to the records, and
    ``batch`` that of some specimens, of which it is one.
    """
    found, batch = found or search.fits[names], batch or search.batch
    return max(_of_specimen(search, found, names, batch, r) for r in spread_over(len(batch.levels), found.layout))


def _of_specimen(search: Search, found: Fit, names: Set, batch: Batch, specimen: int) -> float:
    """Return the compensation in the backbones of one specimen."""
    term = batch.levels[specimen]
    if term.levels.size < _LEAST_LEVELS:
        return 1.0
    parameters = found.parameters(specimen)

    def curves(absent: Set) -> FloatArray:
        """Return frequency and damping (2, l) without some effects; NaN where a level cannot be simulated."""
        vector = parameters.copy()
        for name in absent:
            effect = search.own.get(name) or LIBRARY[name]
            for parameter in effect.parameters:
                if parameter.role == "strength":
                    vector[found.layout.oscillator.index(parameter.name)] = 0.0
        return curve(found, vector, term.levels, term.release)[:_OBSERVABLES].copy()

    asked: list[Set] = [(), names, *((name,) for name in names)]
    simulated = np.array([curves(absent) for absent in asked])
    held = np.isfinite(simulated).all(axis=(0, 1))
    if np.count_nonzero(held) < _LEAST_LEVELS:
        return 1.0
    bends = simulated[:, :, held]
    bends[:, 0] /= bends[:, 0].mean(axis=-1, keepdims=True)
    changes = (bends[0] - bends[1:]).std(axis=-1)  # without all of them, and without each
    together, each = changes[0], changes[1:].max(axis=0)
    root = np.linalg.inv(term.whitening)
    errors = np.sqrt((root**2).sum(axis=1))
    for k in range(_OBSERVABLES):
        rows = term.rows[:, 0] == k
        if rows.any():
            size = np.sqrt((errors[rows] ** 2).mean() / rows.sum())
            together[k] = np.hypot(together[k], size / (np.abs(term.values[rows]).mean() if k == 0 else 1.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = each / together
    return float(max(1.0, *np.nan_to_num(share, nan=1.0, posinf=1.0)))


__all__ = ["compensation"]
