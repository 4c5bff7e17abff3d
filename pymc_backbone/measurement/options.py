"""How records become backbones at levels, as one value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Measuring:
    """How records become backbones at levels.

    Attributes
    ----------
    band : (float, float) or None
        Frequency band to keep [Hz].
    start : float or None
        Time of the release [s]; None: it is found.
    stop : float or None
        Time at which the part to use ends [s]; None: it is found.
    levels : int, sequence of float or None
        Number of levels, or the amplitudes [m or rad]; None: as many as the decays bear.
    observables : sequence of str or None
        What is compared; None: frequency and damping or, of tables, all they hold.
    strict : bool
        Whether one record that cannot be used ends it; else it is left out, as long as half of them remain.
    floor : float or None
        Amplitude [m or rad] at which the part to use ends; None: the noise decides.
    """

    band: tuple[float, float] | None = None
    start: float | None = None
    stop: float | None = None
    levels: int | Sequence[float] | None = None
    observables: Sequence[str] | None = None
    strict: bool = False
    floor: float | None = None
