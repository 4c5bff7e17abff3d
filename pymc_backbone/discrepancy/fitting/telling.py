"""The specimens that say most of what a set leaves: what does not help them helps none, and it is soon asked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .batch import Batch
from .joint_fit import Fit
from .normal_equations import State

_ASKED = 2  # specimens


@dataclass(frozen=True, eq=False)
class Telling:
    """A part of a batch, and a set as it was fitted to all of it.

    Attributes
    ----------
    specimens : list of int
        Which they are.
    batch : Batch
        Of these alone.
    found : Fit
        Shared values and their own ones, as of all; its system and what follows from that are of all.
    left : float
        Sum of squares that the set leaves of them.
    """

    specimens: list[int]
    batch: Batch
    found: Fit
    left: float

    def whole(self, state: State, found: Fit) -> State:
        """Return where a fit of all specimens begins: these as a fit of them alone has them, the others as before."""
        own = found.state.own.copy()
        own[self.specimens] = state.own
        return State(state.eta, own)


def most_telling(batch: Batch, found: Fit) -> Telling:
    """Return the specimens of which a set leaves most, two of them, or all where there are no more."""
    few = sorted(np.argsort(-found.chi_square, kind="stable")[:_ASKED].tolist())
    part = replace(
        found,
        state=State(found.state.eta, found.state.own[few]),
        chi_square=found.chi_square[few],
        own_covariance=found.own_covariance[few],
    )
    return Telling(few, batch.subset(few), part, float(found.chi_square[few].sum()))


__all__ = ["Telling", "most_telling"]
