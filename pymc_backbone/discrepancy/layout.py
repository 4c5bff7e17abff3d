"""Which parameters of an oscillator a joint fit moves, and in which coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .._common.checks import FloatArray
from ..effects import BASE_EFFECTS
from ..oscillator import Oscillator
from ..simulation.decay import Simulator

_BOX = 4.0
_STIFFEST = 0.003  # slip displacement over amplitude
_SHARPEST = 0.004  # displacement over amplitude at which a state saturates
_SOFTEST = {True: 10.0, False: 1.5}  # of a bed of sliders, and of one, which is a plain spring beyond


@dataclass(frozen=True, eq=False)
class Layout:
    """Which parameters of an oscillator are fitted, and in which coordinates.

    Two kinds of parameters are not fitted as they stand. One whose unit holds another one as exponent (``1/m^n``) is
    fitted as its value at the amplitude of the records, or it would change by orders of magnitude with the exponent.
    A slider's stiffness is replaced by the displacement at which it slips over the amplitude, so that the stiffer
    slider and dry friction are neighbours: at zero, not at infinity.

    Attributes
    ----------
    oscillator : Oscillator
        Mass and effects.
    simulator : Simulator
        The same, ready to run.
    free : (q,) array of int
        Places in the parameter vector of the effects' fitted parameters.
    template : (p,) array
        Parameter vector with redundant parameters at their values.
    low, high : (q,) arrays
        Limits of the coordinates.
    width : (q,) array
        Standard deviation of the prior of the coordinates, from the default bounds.
    is_strength : (q,) array of bool
        Whether a coordinate is the strength of its effect: the effect is gone at zero.
    powers : tuple of (int, int)
        Coordinates in units of amplitude, and the exponents they go with.
    slips : tuple of (int, int)
        Stiffness and force of each slider: the coordinates hold the force, then the relative slip displacement.
    opposed : tuple of (int, int)
        Coordinates that are not below minus another one.
    amplitude : float
        Typical amplitude [m or rad].
    names : tuple of str
        Parameters behind the coordinates.
    """

    oscillator: Oscillator
    simulator: Simulator
    free: Any
    template: FloatArray
    low: FloatArray
    high: FloatArray
    width: FloatArray
    is_strength: Any
    powers: tuple[tuple[int, int], ...]
    slips: tuple[tuple[int, int], ...]
    opposed: tuple[tuple[int, int], ...]
    amplitude: float
    names: tuple[str, ...]

    def physical(self, eta: FloatArray, delta: FloatArray, scatter: float) -> tuple[FloatArray, FloatArray]:
        """Return effect parameters (q,) of a specimen, and their derivatives (q, q) to its own coordinates."""
        own = np.clip(eta * (1.0 + scatter * delta), self.low, self.high)
        slopes, base = np.eye(own.size), np.eye(own.size)
        for j, other in self.opposed:
            if own[j] < -own[other]:
                own[j] = -own[other]
                base[j, j], base[j, other] = 0.0, -1.0
        values = own.copy()
        for j, exponent in self.powers:
            factor = self.amplitude ** -own[exponent]
            values[j] = own[j] * factor
            slopes[j, j] = factor
            slopes[j, exponent] = -values[j] * np.log(self.amplitude)
        for stiffness, force in self.slips:
            reach = own[force] * self.amplitude
            values[stiffness], values[force] = own[stiffness] / reach, own[stiffness]
            slopes[stiffness, stiffness], slopes[stiffness, force] = 1.0 / reach, -values[stiffness] / own[force]
            slopes[force, stiffness], slopes[force, force] = 1.0, 0.0
        return values, slopes @ base

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Return the coordinates of physical values of the free parameters."""
        eta = np.array(values, dtype=np.float64)
        for j, exponent in self.powers:
            eta[j] = values[j] * self.amplitude ** values[exponent]
        for stiffness, force in self.slips:
            eta[stiffness] = values[force]
            eta[force] = values[force] / max(values[stiffness], 1e-300) / self.amplitude
        return np.clip(eta, self.low, self.high)


def make_layout(oscillator: Oscillator, amplitude: float, angular_frequency: float) -> Layout:
    """Return the layout of an oscillator for records of this amplitude and frequency."""
    bounds = oscillator.default_bounds(amplitude, angular_frequency)
    template = np.zeros(len(oscillator.parameter_names))
    free: list[int] = []
    rows: list[tuple[float, float, float, bool]] = []
    powers, slips, opposed = [], [], []
    for effect in oscillator.effects:
        start = oscillator.slices[effect.name].start
        held = dict(effect.redundant)
        for offset, parameter in enumerate(effect.parameters):
            if parameter.name in held:
                template[start + offset] = held[parameter.name]
        if effect.name in BASE_EFFECTS:
            continue
        kept = [q for q in effect.parameters if q.name not in held]
        first = len(free)
        place = {q.name: first + j for j, q in enumerate(kept)}
        for j, parameter in enumerate(kept):
            lower, upper = bounds[parameter.name]
            exponent = next((q.name for q in kept if parameter.unit.endswith(f"^{q.latex}")), None)
            if exponent is not None:  # bounds are those at an exponent of 1
                lower, upper = lower * amplitude, upper * amplitude
                powers.append((first + j, place[exponent]))
            # what has no unit is a shape with limits of its own; the rest may leave the default bounds
            grow = 0.0 if parameter.unit == "-" else _BOX * (upper - lower)
            if exponent is not None:  # what saturates may do so at a small share of the amplitude
                grow = max(grow, _SHARPEST ** -bounds[exponent][1])
            low, high = max(parameter.minimum, lower - grow), min(parameter.maximum, upper + grow)
            rows.append((low, high, (upper - lower) / np.sqrt(12.0), j == 0))
            free.append(start + list(effect.parameters).index(parameter))
        opposed += [(place[one], place[other]) for one, other in effect.opposed if {one, other} <= set(place)]
        units = [q.unit for q in kept]
        if units[:2] in (["N/m", "N"], ["N m/rad", "N m"]):
            slips.append((first, first + 1))
            rows[first] = (0.0, rows[first + 1][1], rows[first + 1][2], True)
            rows[first + 1] = (_STIFFEST, _SOFTEST[len(kept) > 2], 1.0 / np.sqrt(12.0), False)
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return Layout(
        oscillator, Simulator(oscillator), np.array(free, dtype=np.int64), template, table[:, 0].copy(),
        table[:, 1].copy(), table[:, 2].copy(), table[:, 3] > 0.0, tuple(powers), tuple(slips), tuple(opposed),
        amplitude, tuple(oscillator.parameter_names[i] for i in free),
    )  # fmt: skip
