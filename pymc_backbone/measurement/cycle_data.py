"""What was extracted from one free decay: its cycles and turning points, with their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .._common.checks import FloatArray

QUANTITIES: tuple[str, ...] = ("amplitude", "frequency", "damping", "offset")
MINIMUM_CYCLES = 4
"""Cycles that a smooth curve with a standard error needs."""


@dataclass(frozen=True, eq=False)
class Cycles:
    """The cycles of one free decay, in time order, with standard errors.

    Attributes
    ----------
    specimen : str
        Name of the specimen.
    time : (n,) array
        Middle of each cycle [s].
    amplitude, frequency, damping, offset : (n,) arrays
        The cycle quantities by the package's one definition [m or rad, Hz, 1, 1].
    amplitude_error, frequency_error, damping_error, offset_error : (n,) arrays
        Their standard errors.
    bands : (4, b, n) array
        Covariance of each quantity (rows as in `QUANTITIES`) between cycle i and cycle i + b: neighbours share peaks
        and samples.
    shared : (4, n, r) array
        Errors all cycles share, through the template and the zero: their covariance is ``shared @ shared.T``, beside
        the bands.
    smoothed_amplitude : (n,) array
        Amplitude smoothed over cycles: the regressor of the backbone.
    smoothed_amplitude_design, smoothed_amplitude_spread : (n, r) and (r, r) arrays
        Its covariance is ``design @ spread @ design.T``.
    turning_times, turning_values, turning_time_errors, turning_value_errors, turning_signs : (m,) arrays
        Turning points; sign +1.0 for a peak.
    noise : float
        Standard deviation of the noise used [m or rad].
    notes : tuple of str
        What was assumed, dropped or corrected.
    observables : tuple of str
        Those that were measured. Of an envelope the others hold no measurement: the frequency where it is known only,
        and an offset of zero.

    See Also
    --------
    extract_cycles : makes it.
    backbones_at_levels : brings many to common amplitudes.
    """

    specimen: str
    time: FloatArray
    amplitude: FloatArray
    frequency: FloatArray
    damping: FloatArray
    offset: FloatArray
    amplitude_error: FloatArray
    frequency_error: FloatArray
    damping_error: FloatArray
    offset_error: FloatArray
    bands: FloatArray
    shared: FloatArray
    smoothed_amplitude: FloatArray
    smoothed_amplitude_design: FloatArray
    smoothed_amplitude_spread: FloatArray
    turning_times: FloatArray
    turning_values: FloatArray
    turning_time_errors: FloatArray
    turning_value_errors: FloatArray
    turning_signs: FloatArray
    noise: float
    notes: tuple[str, ...] = ()
    observables: tuple[str, ...] = QUANTITIES[1:]

    @property
    def is_of_envelope(self) -> bool:
        """Whether only amplitudes over time were measured, no turning points."""
        return self.turning_times.size == 0

    def __len__(self) -> int:
        """Return the number of cycles."""
        return int(self.time.size)


def with_shared_errors(cycles: Cycles, quantity: str, errors: FloatArray) -> Cycles:
    """Return the cycles with errors that they share in one quantity: columns (n, k), each of one independent error."""
    row, name = QUANTITIES.index(quantity), f"{quantity}_error"
    shared = np.concatenate([cycles.shared, np.zeros((*cycles.shared.shape[:2], errors.shape[1]))], axis=2)
    shared[row, :, cycles.shared.shape[2] :] = errors
    whole = np.sqrt(getattr(cycles, name) ** 2 + (errors**2).sum(axis=1))
    return replace(cycles, shared=shared, **{name: whole})


__all__ = ["MINIMUM_CYCLES", "QUANTITIES", "Cycles", "with_shared_errors"]
