"""A test as it would be if a set of effects were true: noise-free data terms, and how far another set misses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr

from ..._common.checks import FloatArray
from ...oscillator import Oscillator
from ...simulation.decay import Simulator
from ..fitting.batch import Batch
from ..fitting.data_term import TOLERANCE, TurningTerm
from ..fitting.descent import Descent
from ..fitting.drift_course import fade_of
from ..fitting.joint_fit import Fit
from ..fitting.layout import Layout
from ..fitting.waveform_term import WaveformTerm
from ..results.design import DENSE, QUANTITY_OF_ORDER, Contender, Design

_MOST_TURNS = 3000
_AFTER_RELEASE = 0.1  # of a half cycle
_LOUD = 2.0  # standard deviations of the noise above which a turning point is seen
_FEWEST_TURNS = 9


@dataclass(frozen=True, eq=False)
class _Weighted(WaveformTerm):
    """Samples of a structure that may carry another mass than the model names."""

    added_mass: float = 0.0

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
        """Simulate with the mass of this test."""
        heavier = with_mass(simulator.oscillator, self.added_mass) if self.added_mass else simulator
        return super().simulate(heavier, parameters, release, release_time, time, sensitivities=sensitivities)


@dataclass(frozen=True, eq=False)
class _WeightedTurns(TurningTerm):
    """Turning points of a structure that may carry another mass than the model names."""

    added_mass: float = 0.0

    def compare(
        self, simulator: Simulator, parameters: FloatArray, nuisances: FloatArray, *, drifts: bool = True
    ) -> tuple[FloatArray, FloatArray] | None:
        """Compare with the mass of this test."""
        heavier = with_mass(simulator.oscillator, self.added_mass) if self.added_mass else simulator
        return super().compare(heavier, parameters, nuisances, drifts=drifts)

    def first(self, count: int) -> _WeightedTurns:
        """Return the term of the first ``count`` turning points."""
        kept = super().first(count)
        return _WeightedTurns(
            kept.times, kept.values, kept.time_errors, kept.value_errors, kept.skipped, kept.fade, self.added_mass
        )


@lru_cache(maxsize=64)
def with_mass(oscillator: Oscillator, added: float) -> Simulator:
    """Return the simulator of an oscillator that carries more mass."""
    return Simulator(Oscillator(oscillator.mass + added, oscillator.effects))


@dataclass(frozen=True, eq=False)
class Imagined:
    """One test under one truth, all its records in one with so much less noise.

    Attributes
    ----------
    turning, waveform : data terms
        Without noise.
    release : float
        Where the motion starts [m or rad].
    angular_frequency : float
        Typical [rad/s].
    """

    turning: TurningTerm
    waveform: WaveformTerm
    release: float
    angular_frequency: float


def vector_of(layout: Layout, values: dict[str, float]) -> FloatArray:
    """Return the parameter vector of an oscillator, ``values`` by name, the others as the layout holds them."""
    vector = layout.template.copy()
    for name, value in values.items():
        vector[layout.oscillator.index(name)] = value
    return vector


def imagine(layout: Layout, vector: FloatArray, design: Design) -> Imagined | None:
    """Return a test of a structure with these parameters; None where too few cycles stand above the noise."""
    simulator = with_mass(layout.oscillator, design.added_mass) if design.added_mass else layout.simulator
    turns = simulator.make_turns(_MOST_TURNS, False)
    count, _ = simulator.decay(vector, design.release, turns, tolerance=TOLERANCE)
    order = QUANTITY_OF_ORDER.index(design.quantity)
    values, times = np.array(turns[0][:count]), np.array(turns[1][:count])
    if count < _FEWEST_TURNS:
        return None
    omega = float(np.pi / np.median(np.diff(times)))
    loud = np.abs(values - values[-1]) * omega**order > _LOUD * design.noise
    seen = int(np.argmin(loud)) if not loud.all() else count
    seen = min(seen, int(np.searchsorted(times, design.duration)))
    if seen < _FEWEST_TURNS:
        return None
    values, times = values[:seen], times[:seen]
    half = float(np.median(np.diff(times)))
    share = np.sqrt(design.records)
    rate = min(design.sampling_rate, DENSE / (2.0 * half))
    noise = design.noise * np.sqrt(rate / design.sampling_rate) / share
    instants = np.arange(_AFTER_RELEASE * half, times[-1] + 0.5 * half, 1.0 / rate)
    samples, _, _ = simulator.waveform(
        vector, design.release, instants, order, sensitivities=False, tolerance=TOLERANCE, maximum=_MOST_TURNS
    )
    if not np.isfinite(samples).all():
        return None
    value_error = noise / omega**order
    amplitude = np.maximum(np.abs(values[1:]), value_error)
    fade = fade_of(np.abs(np.diff(values)))
    turning = _WeightedTurns(
        times[1:].copy(), values[1:].copy(), value_error / (amplitude * omega), np.full(seen - 1, value_error), 0,
        fade, design.added_mass,
    )  # fmt: skip
    waveform = _Weighted(
        instants, samples, lambda columns: columns / noise, instants.size, [], float(samples.std()), 1, order,
        float(omega**order), fade=fade, added_mass=design.added_mass,
    )  # fmt: skip
    return Imagined(turning, waveform, design.release, np.pi / half)


@dataclass(frozen=True, eq=False)
class Miss:
    """How far the best fit of a set is from imagined tests.

    Attributes
    ----------
    cost : float
        Chi-square; without noise it would be zero for the truth.
    residuals : (n,) array
        Standardised.
    fit : Fit
        Where.
    """

    cost: float
    residuals: FloatArray
    fit: Fit


def miss(layout: Layout, rival: Contender, tests: Sequence[Imagined], known: Fit | None = None) -> Miss | None:
    """Return the best fit of a set to some imagined tests together; None where it cannot be simulated.

    ``known`` is its fit to the first of them.
    """
    own = np.array([[rival.parameters["linear_stiffness"], rival.parameters["viscous_damping"]]] * len(tests))
    released = np.array([[test.release, 0.0, 0.0] for test in tests])
    batch = Batch(
        backbones=xr.Dataset(), records=(), cycles=(), levels=(),
        turning=tuple(test.turning for test in tests), waveform=tuple(test.waveform for test in tests),
        specimens=tuple(str(k) for k in range(len(tests))), own=np.hstack([own, released]),
        amplitude=tests[0].release, angular_frequency=tests[0].angular_frequency,
    )  # fmt: skip
    descent = Descent(batch)
    eta = layout.coordinates(np.array([rival.parameters[name] for name in layout.names]))
    starts = [descent.released(layout, eta, own)]
    if known is not None:
        again = np.vstack([known.state.own[:1, :2]] * len(tests))
        starts.append(descent.released(layout, known.state.eta, again))
    found = [item for item in (descent.from_afar(layout, start) for start in starts) if item is not None]
    if not found:
        return None
    best = min(found, key=lambda item: item.cost)
    residuals = []
    for k, term in enumerate(batch.waveform):
        compared = term.compare(layout.simulator, best.parameters(k), best.state.own[k, 2:7])
        if compared is None:
            return None
        residuals.append(compared[0])
    return Miss(best.cost, np.concatenate(residuals), best)


__all__ = ["Imagined", "Miss", "imagine", "miss", "vector_of"]
