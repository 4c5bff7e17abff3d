"""The samples of a record as what a model is compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ...simulation.decay import Simulator
from .data_term import TOLERANCE
from .drift_course import STEADY, Course, Linear, Motion, course_of
from .whitening import EDGE, average, means

_MARGIN = 60  # turning points beyond those of the record

Subspace = list[tuple[slice, FloatArray]]
"""Windows of residuals, and an orthonormal basis (k, d) in each."""


@dataclass(frozen=True, eq=False)
class Jumps:
    """Where an acceleration may jump, and the standardised values before those next to it are left out.

    Attributes
    ----------
    turning : (t,) array
        Turning points [s].
    reach : float
        Time [s] around one from which no value is taken.
    instants, phase : (m,) arrays
        Middle [s] of each value, and phase of the motion there in cycles.
    per_cycle : float
        Number of values in a cycle.
    whiten : callable
        Takes (n, c) columns to all standardised values (m, c).
    """

    turning: FloatArray
    reach: float
    instants: FloatArray
    phase: FloatArray
    per_cycle: float
    whiten: Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class WaveformTerm:
    """The samples of one record, in the quantity that was measured.

    Attributes
    ----------
    time, values : (n,) arrays
        Instants [s], displacement, velocity or acceleration, from shortly after the release.
    whiten : callable
        Takes (n, c) columns to standardised independent ones (m, c).
    size : int
        m.
    subspace : list of (slice, (k, d) array)
        Windows of the standardised residuals, and an orthonormal basis of what a model error looks like in each:
        the harmonics of the motion, slowly varying.
    signal : float
        Standard deviation of the motion.
    together : int
        Number of samples that each value is the mean of, at their middle.
    order : int
        How often the displacement is differentiated in ``values``.
    offset_scale : float
        What one unit of the nuisance ``offset`` [m or rad] adds to ``values``: the angular frequency to the power of
        ``order``; nothing where a filter removes it.
    beside : list of (slice, (k, d) array)
        The same midway between the harmonics, orthogonal to ``subspace``: what noise holds there, no model error does.
        Empty behind a band-pass.
    fade : float
        What one unit of the drift of damping adds to the decrement, summed over the record.
    chain : callable, optional
        Takes (n, c) simulated columns through what the measuring chain does to the motion (`sensor_filter`).
    averaged : int
        Number of samples of a rate or an acceleration that each standardised value is the mean of.
    shown : (m,) array or None
        Which of these values stay, where some are left out.
    jumps : Jumps or None
        Why: where the quantity may jump.
    settling, motion
        As in `TurningTerm`, at these instants.
    """

    time: FloatArray
    values: FloatArray
    whiten: Callable[[FloatArray], FloatArray]
    size: int
    subspace: Subspace
    signal: float
    together: int = 1
    order: int = 0
    offset_scale: float = 1.0
    beside: Subspace = field(default_factory=list)
    fade: float = 1.0
    chain: Callable[[FloatArray], FloatArray] | None = None
    averaged: int = 1
    shown: IntArray | None = None
    jumps: Jumps | None = None
    settling: float = 0.0
    motion: Motion | None = None

    def simulate(
        self,
        simulator: Simulator,
        parameters: FloatArray,
        release: float,
        release_time: float,
        time: FloatArray,
        *,
        sensitivities: bool = True,
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the quantity (n,) and derivatives (n, 2 + p): with respect to release amplitude, parameters, time."""
        values, slopes, _ = simulator.waveform(
            parameters, release, time - release_time, self.order, sensitivities=sensitivities, tolerance=TOLERANCE,
            maximum=self.most_turns,
        )  # fmt: skip
        return (values, slopes) if np.isfinite(values[-1]) else None

    def compared(self, rows: FloatArray) -> FloatArray:
        """Return of rows at the instants those that are compared with a simulation."""
        return rows[EDGE:-EDGE] if self.together > 1 else rows

    def standardised(self, rows: FloatArray) -> FloatArray:
        """Return of rows (n,) at the instants the means (m,) over the samples of each standardised value."""
        return self.standing(self.means_of(rows))

    def means_of(self, rows: FloatArray) -> FloatArray:
        """Return the means over the samples of each value before those that do not count are left out."""
        kept = self.compared(rows)
        return kept if self.averaged == 1 else means(kept[:, None], self.averaged)[:, 0]

    def standing(self, kept: FloatArray) -> FloatArray:
        """Return of such means those that are standardised values."""
        return kept[: self.size] if self.shown is None else kept[self.shown[: self.size]]

    @cached_property
    def most_turns(self) -> int:
        """Turning points after which a simulation is given up."""
        return max(200, int(self.cycles * 5.0) + _MARGIN)

    @cached_property
    def cycles(self) -> float:
        """Rough number of cycles in the record."""
        return float(np.count_nonzero(np.diff(np.signbit(self.values - self.values.mean()))) / 2 + 1)

    @cached_property
    def _kept_values(self) -> FloatArray:
        """The values that are compared."""
        return self.compared(self.values)

    @cached_property
    def _of_zero(self) -> FloatArray:
        """What one unit of the zero of what is read, which stands behind all filters, adds to what is compared (m,)."""
        return self.whiten(np.full((self._kept_values.size, 1), self.offset_scale))[:, 0]

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray, *, drifts: bool = True
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return residuals (m,) and derivatives (m, p + 5)."""
        release, release_time, offset = nuisances[:3]
        course = self._course(simulator, parameters, nuisances) if drifts else STEADY
        simulated = self.simulate(simulator, parameters, release, release_time, self._at(course))
        if simulated is None:
            return None
        values, slopes = simulated
        if course.factor is not None:
            values, slopes = values * course.factor, slopes * course.factor[:, None]
        p, of_drifts = parameters.size, 2 if drifts else 0
        columns = np.empty((self.time.size, p + 3 + of_drifts))  # parameters, release, its instant, drifts, values
        columns[:, :p] = slopes[:, 1:-1]
        columns[:, p] = slopes[:, 0]
        columns[:, p + 1] = -slopes[:, -1] * course.pace
        if course.by_stiffness is not None:
            columns[:, 0] += slopes[:, -1] * course.by_stiffness / (float(parameters[0]) or 1.0)
        if drifts:
            columns[:, p + 2] = slopes[:, -1] * course.by_drift + values * course.hastened
            columns[:, p + 3] = slopes[:, -1] * course.by_loss - values * course.share
        columns[:, -1] = values
        if not np.isfinite(columns).all():
            return None  # drifts far from any motion
        if self.chain is not None:
            columns = self.chain(columns)
        columns[:, -1] += offset * self.offset_scale
        if self.together > 1:
            columns = average(columns, self.together)
        columns[:, -1] = self._kept_values - columns[:, -1]
        whitened = self.whiten(columns)
        jacobian = np.zeros((whitened.shape[0], p + 5))
        jacobian[:, : p + 2] = whitened[:, : p + 2]
        jacobian[:, p + 2] = self._of_zero
        jacobian[:, p + 3 : p + 3 + of_drifts] = whitened[:, p + 2 : -1]
        return whitened[:, -1], jacobian

    def residuals(self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray) -> FloatArray | None:
        """Return residuals (m,)."""
        release, release_time, offset = nuisances[:3]
        course = self._course(simulator, parameters, nuisances)
        simulated = self.simulate(simulator, parameters, release, release_time, self._at(course), sensitivities=False)
        if simulated is None:
            return None
        values = simulated[0]
        if course.factor is not None:
            values = values * course.factor
        column = values[:, None]
        if self.chain is not None and np.isfinite(column).all():
            column = self.chain(column)
        column = column + offset * self.offset_scale
        if self.together > 1:
            column = average(column, self.together)
        left = self._kept_values[:, None] - column
        return self.whiten(left)[:, 0] if np.isfinite(left).all() else None

    def _course(self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray) -> Course:
        linear = Linear.of(parameters, simulator.oscillator.mass)
        return course_of(self.time, nuisances, self.order, self.fade, self.settling, self.motion, linear)

    def _at(self, course: Course) -> FloatArray:
        """Return the instants at which the motion without a drift is looked at."""
        return self.time if course.later is None else self.time + course.later
