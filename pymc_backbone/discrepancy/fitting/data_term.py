"""What a model is compared with, specimen by specimen: level values, turning points, or the samples of the record.

Each data term turns a simulated decay into standardised residuals and their derivatives, so that one fit serves all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import xarray as xr

from ..._common.checks import OBSERVABLES, BoolArray, FloatArray, IntArray
from ...simulation.decay import Simulator
from .drift_course import STEADY, Linear, Motion, course_of

TOLERANCE = 1e-7  # of one integration step: waveforms to 3e-6 of the amplitude, far below any noise here
KNOWN = 1e-3  # relative error of a frequency that is known and not measured: it settles the stiffness, no more


class DataTerm(Protocol):
    """One specimen's data: residuals of a model, and their derivatives.

    ``compare(simulator, parameters, nuisances)`` returns the standardised residuals (n,), measured minus simulated,
    and the derivatives of the simulated (n, p + 5) with respect to the parameters and the nuisances: release
    amplitude, release instant, offset, drift of frequency, drift of damping. None where the simulation failed.

    The drifts are changes with time, not with amplitude: of the linear spring, by which the motion without it is passed
    faster, and of the damping, by which the amplitude falls by the square of the elapsed share of the record more.
    Where ``drifts`` are not asked for, which have to be zero then, their derivatives are zero.
    """

    @property
    def size(self) -> int:
        """Number of residuals."""
        ...

    @property
    def cycles(self) -> float:
        """Rough number of cycles that are simulated for it."""
        ...

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray, *, drifts: bool = True
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals and derivatives."""
        ...

    def residuals(self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray) -> FloatArray | None:
        """Return the residuals alone, in less than half the time."""
        ...


@dataclass(frozen=True, eq=False)
class LevelTerm:
    """The backbone of one specimen at levels, with its covariance.

    Attributes
    ----------
    levels : (l,) array
        Amplitudes that this specimen reaches.
    values : (m,) array
        Measured values, observable by observable.
    rows : (m, 2) array of int
        Observable and level of each value.
    whitening : (m, m) array
        Takes differences to independent standard normal ones.
    release : float
        Amplitude from which the specimen is released [m or rad]: what remembers has not forgotten it at the highest
        levels. 0 lets the simulation choose.
    """

    levels: FloatArray
    values: FloatArray
    rows: IntArray
    whitening: FloatArray
    release: float = 0.0

    @property
    def size(self) -> int:
        """Number of values."""
        return int(self.values.size)

    @property
    def cycles(self) -> float:
        """Rough number of cycles that are simulated: one a level."""
        return float(self.levels.size)

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray, *, drifts: bool = True
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals (m,) and derivatives (m, p + 5)."""
        jacobian = np.zeros((3, self.levels.size, parameters.size))
        residuals = self._simulated(simulator, parameters, jacobian)
        if residuals is None:
            return None
        slopes = np.zeros((self.size, parameters.size + 5))
        slopes[:, : parameters.size] = jacobian[self.rows[:, 0], self.rows[:, 1]]
        return residuals, self.whitening @ slopes

    def residuals(self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray) -> FloatArray | None:
        """Return residuals (m,)."""
        return self._simulated(simulator, parameters, np.zeros((3, self.levels.size, 0)))

    def _simulated(self, simulator: Simulator, parameters: FloatArray, jacobian: FloatArray) -> FloatArray | None:
        """Return residuals (m,), and write the derivatives of the simulated values, where there is room for them."""
        n = self.levels.size
        values, status = np.empty((3, n)), np.zeros(n, dtype=np.int64)
        simulator.backbone(parameters, self.levels, self.release, True, values, jacobian, status, whole=False)
        return None if status.any() else self.whitening @ (self.values - values[self.rows[:, 0], self.rows[:, 1]])


def level_term(backbones: xr.Dataset, specimen: int, keep: BoolArray | None = None) -> LevelTerm | None:
    """Return the data term of one specimen of a Dataset of backbones, or None where it reaches none of the levels."""
    chosen = backbones.isel(specimen=specimen)
    names = [str(name) for name in chosen["observable"].values]
    value, error = np.asarray(chosen["value"]), np.asarray(chosen["standard_error"])
    held = np.isfinite(value) & np.isfinite(error) & (error > 0.0)
    if keep is not None:
        held = held & np.asarray(keep)[None, :]
    reached = np.flatnonzero(held.any(axis=0))
    if reached.size < 1:
        return None
    place = {int(k): i for i, k in enumerate(reached)}
    pairs = np.argwhere(held)
    whitening = np.zeros((len(pairs), len(pairs)))
    for o in range(len(names)):
        index = np.flatnonzero(pairs[:, 0] == o)
        if not index.size:
            continue
        at = pairs[index, 1]
        covariance = np.diag(error[o, at] ** 2)
        if "covariance" in chosen:
            given = np.asarray(chosen["covariance"])[o][np.ix_(at, at)]
            covariance = np.where(np.isfinite(given), given, covariance)
        scale = np.sqrt(np.diag(covariance))
        factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-6 * np.eye(index.size))
        whitening[np.ix_(index, index)] = np.linalg.inv(factor) / scale
    rows = np.array([(OBSERVABLES.index(names[o]), place[int(k)]) for o, k in pairs])
    return LevelTerm(np.asarray(chosen["level"])[reached], value[pairs[:, 0], pairs[:, 1]], rows, whitening)


def with_frequency(term: LevelTerm, frequency: float) -> LevelTerm:
    """Return a term of damping alone with a frequency [Hz] that is known, at the middle one of its levels.

    It determines the stiffness, which damping per cycle does not, and says nothing of how the frequency changes.
    """
    n = term.size
    whitening = np.zeros((n + 1, n + 1))
    whitening[0, 0] = 1.0 / (KNOWN * frequency)
    whitening[1:, 1:] = term.whitening
    first = np.array([[OBSERVABLES.index("frequency"), term.levels.size // 2]])
    values, rows = np.concatenate([[frequency], term.values]), np.concatenate([first, term.rows])
    return replace(term, values=values, rows=rows, whitening=whitening)


@dataclass(frozen=True, eq=False)
class TurningTerm:
    """Times and values of the turning points of one record: no phase to lose, so fits find their way from afar.

    Attributes
    ----------
    times, values, time_errors, value_errors : (n,) arrays
        As extracted; the release is the turning point before the first.
    skipped : int
        Turning points between the release and the first: a band-pass loses the beginning of the record.
    fade : float
        What one unit of the drift of damping adds to the decrement, summed over the record.
    settling : float
        How many times over the record a drift of frequency comes nearer to its end by a factor e; 0 for a steady one.
    motion : Motion or None
        How the measured motion passes at these turning points; None for that of a linear structure.
    """

    times: FloatArray
    values: FloatArray
    time_errors: FloatArray
    value_errors: FloatArray
    skipped: int = 0
    fade: float = 1.0
    settling: float = 0.0
    motion: Motion | None = None

    def first(self, count: int) -> TurningTerm:
        """Return the term of the first ``count`` turning points."""
        names = ("times", "values", "time_errors", "value_errors")
        motion = None if self.motion is None else self.motion.first(count)
        return replace(self, motion=motion, **{name: getattr(self, name)[:count] for name in names})

    @property
    def size(self) -> int:
        """Number of residuals."""
        return 2 * int(self.times.size)

    @property
    def cycles(self) -> float:
        """Number of cycles."""
        return 0.5 * self.times.size

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray, *, drifts: bool = True
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals (2 n,) and derivatives (2 n, p + 5)."""
        release, release_time, offset = nuisances[:3]
        first = self.skipped + 1
        maximum = self.times.size + first
        columns = parameters.size + 1
        turning = simulator.make_turns(maximum, True)
        count, _ = simulator.decay(parameters, release, turning, tolerance=TOLERANCE)
        if count < maximum:
            return None
        turns, times, slopes, time_slopes = (part[first:] for part in turning)
        n, stiffness = self.times.size, float(parameters[0])
        course = STEADY
        if drifts:
            linear = Linear.of(parameters, simulator.oscillator.mass)
            course = course_of(self.times, nuisances, 0, self.fade, self.settling, self.motion, linear, at_turns=True)
        later = 0.0 if course.later is None else course.later
        less = np.ones(n) if course.factor is None else course.factor
        values = turns * less
        residuals = np.concatenate(
            [
                (self.times - release_time - times + later) / self.time_errors,
                (self.values - offset - values) / self.value_errors,
            ]
        )
        jacobian = np.zeros((2 * n, columns + 4))
        parts = (
            (slice(0, n), time_slopes, self.time_errors),
            (slice(n, None), slopes * less[:, None], self.value_errors),
        )
        for part, slope, error in parts:
            jacobian[part, : columns - 1] = slope[:, 1:] / error[:, None]
            jacobian[part, columns - 1] = slope[:, 0] / error
        if course.by_stiffness is not None:
            jacobian[:n, 0] -= course.by_stiffness / (stiffness or 1.0) / self.time_errors
        jacobian[:n, columns] = course.pace / self.time_errors
        jacobian[n:, columns + 1] = 1.0 / self.value_errors
        jacobian[:n, columns + 2] = -course.by_drift / self.time_errors
        jacobian[n:, columns + 2] = course.hastened * values / self.value_errors
        jacobian[:n, columns + 3] = -course.by_loss / self.time_errors
        jacobian[n:, columns + 3] = -course.share * values / self.value_errors
        return residuals, jacobian

    def residuals(self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray) -> FloatArray | None:
        """Return residuals (2 n,)."""
        compared = self.compare(simulator, parameters, nuisances)
        return None if compared is None else compared[0]
