"""What a simulation returns: backbones at levels, the cycles of a decay, samples; and where one ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from .._common.checks import FloatArray, InputError
from .halfcycle import COMPLETED, NO_RETURN, OUT_OF_REACH, RUNAWAY, STUCK


class Status(IntEnum):
    """How the simulation of a level or of a decay ended.

    See Also
    --------
    BackboneResult : has one for each level.
    DecayResult : has one for the run.
    """

    COMPLETED = COMPLETED
    STUCK = STUCK
    NO_RETURN = NO_RETURN
    RUNAWAY = RUNAWAY
    OUT_OF_REACH = OUT_OF_REACH

    @property
    def meaning(self) -> str:
        """One line that says what happened and what to do."""
        return _MEANINGS[self]


_MEANINGS = {
    Status.COMPLETED: "completed",
    Status.STUCK: "the motion stuck before it completed a cycle; lower the friction bounds or drop the lowest levels",
    Status.NO_RETURN: "the motion did not swing back; lower the damping bounds or exclude negative stiffness",
    Status.RUNAWAY: "the motion ran away or was not finite; exclude negative stiffness at large amplitude",
    Status.OUT_OF_REACH: "no cycle of the decay has this amplitude, or the damping is too light to get there; "
    "raise the release amplitude or drop the level",
}


@dataclass(frozen=True, eq=False)
class BackboneResult:
    """A simulated backbone.

    Attributes
    ----------
    levels : ndarray, shape (l,)
        Amplitudes [m or rad].
    values : ndarray, shape (3, l)
        Rows frequency [Hz], damping (logarithmic decrement) [-], offset [-]; NaN where ``status`` is not 0.
    status : ndarray of int, shape (l,)
        A `Status` for each level.
    jacobian : ndarray, shape (3, l, p), or None
        Derivatives of ``values`` with respect to the parameters.

    See Also
    --------
    simulate_backbone : returns it.
    simulate_population : many at once, as a Dataset.
    """

    levels: FloatArray
    values: FloatArray
    status: NDArray[np.int64]
    jacobian: FloatArray | None = None

    @property
    def frequency(self) -> FloatArray:
        """Frequency [Hz], shape (l,)."""
        row: FloatArray = self.values[0]
        return row

    @property
    def damping(self) -> FloatArray:
        """Logarithmic decrement per cycle, shape (l,)."""
        row: FloatArray = self.values[1]
        return row

    @property
    def offset(self) -> FloatArray:
        """Mid-line over amplitude, shape (l,)."""
        row: FloatArray = self.values[2]
        return row


@dataclass(frozen=True, eq=False)
class DecayResult:
    """A simulated free decay, cycle by cycle (positive peak to positive peak).

    Attributes
    ----------
    time, amplitude, frequency, damping, offset : ndarray, shape (n,)
        Middle of each cycle [s], amplitude [m or rad], frequency [Hz], logarithmic decrement, mid-line over amplitude.
    turning_times, turning_values : ndarray, shape (k,)
        All turning points, the release first.
    status : Status
        Why the decay ended; `Status.COMPLETED` where it ran as long as it was asked to.

    See Also
    --------
    simulate_decay : returns it.
    Cycles : the same quantities of a measured record.
    """

    time: FloatArray
    amplitude: FloatArray
    frequency: FloatArray
    damping: FloatArray
    offset: FloatArray
    turning_times: FloatArray
    turning_values: FloatArray
    status: Status


@dataclass(frozen=True, eq=False)
class WaveformResult:
    """What is measured of a free decay at given instants.

    Attributes
    ----------
    values : ndarray, shape (n,)
        Displacement [m or rad], velocity or acceleration [the same per second, or per second squared]. Before release
        and after sticking the oscillator is held: its displacement is constant, velocity and acceleration are zero.
        NaN after a decay that could not be continued.
    jacobian : ndarray, shape (n, p), or None
        Derivatives with respect to the parameters.
    release_slope : ndarray, shape (n,), or None
        Derivative with respect to the release amplitude.
    time_slope : ndarray, shape (n,), or None
        Derivative with respect to time.
    status : Status
        Why the decay ended.
    quantity : {"displacement", "velocity", "acceleration"}
        What ``values`` are.

    See Also
    --------
    simulate_waveform : returns it.
    """

    values: FloatArray
    jacobian: FloatArray | None
    release_slope: FloatArray | None
    time_slope: FloatArray | None
    status: Status
    quantity: str = "displacement"

    @property
    def displacement(self) -> FloatArray:
        """Displacement [m or rad], shape (n,), where that was asked for."""
        if self.quantity != "displacement":
            raise InputError(
                f"`displacement` was asked of a simulated {self.quantity}; read `values`, or simulate with "
                'quantity="displacement".'
            )
        return self.values
