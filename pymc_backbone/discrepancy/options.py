"""How a missing effect is searched, as one value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Searching:
    """How a missing effect is searched; as in `find_missing_effect`.

    Attributes
    ----------
    candidates : sequence of str or None
        Effects that may be missing; None: all of the library.
    max_effects : int
        Largest number of missing effects.
    tolerance : mapping of str to float or None
        Relative tolerance by observable; None: that of `find_missing_effect`.
    held_out : int or None
        How many specimens are held out.
    quick : bool
        Whether to stop before sampling.
    """

    candidates: Sequence[str] | None = None
    max_effects: int = 3
    tolerance: Mapping[str, float] | None = None
    held_out: int | None = None
    quick: bool = False
