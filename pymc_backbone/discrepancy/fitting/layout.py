"""Which parameters of an oscillator a joint fit moves, and in which coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._common.checks import BoolArray, FloatArray, IntArray
from ...effects import BASE_EFFECTS, Role
from ...oscillator import Oscillator
from ...simulation.decay import Simulator
from .fit_kernels import to_physical
from .scatter import SCATTER

_BOX = 4.0
_STIFFEST = 0.003  # slip displacement over amplitude
_SHARPEST = 0.004  # displacement over amplitude at which a state saturates
_SOFTEST = {True: 10.0, False: 1.5}  # of a bed of sliders (with an exponent), and of one: a plain spring beyond
MOST_OPPOSED = 3.0
"""How many times another coordinate one that is opposed to it is at most."""
SHAPES: tuple[Role, ...] = ("shape", "exponent")
"""Roles of parameters that have limits of their own: they do not leave their default bounds."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Which parameters of an oscillator are fitted, and in which coordinates.

    The roles of the parameters say it; two are not fitted as they stand. A power coefficient is fitted as its value at
    the amplitude of the records, or it would change by orders of magnitude with the exponent. The stiffness of what
    has a slip force is replaced by the displacement at which it slips over the amplitude, so that the stiffer slider
    and dry friction are neighbours: at zero, not at infinity.

    Attributes
    ----------
    oscillator : Oscillator
        Mass and effects.
    simulator : Simulator
        The same, ready to run.
    free : (q,) array of int
        Places in the parameter vector of the effects' fitted parameters, effect by effect, the strength of each first.
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
        Coordinates that are not below minus another one, nor above `MOST_OPPOSED` times it.
    amplitude : float
        Typical amplitude [m or rad].
    names : tuple of str
        Parameters behind the coordinates.
    ordinates : frozenset of int
        Coordinates that are forces of a tabulated curve, beside its strength: zero where nothing is known of it.
    scatter : float
        How much the coordinates differ between specimens, relative to their value.
    """

    oscillator: Oscillator
    simulator: Simulator
    free: IntArray
    template: FloatArray
    low: FloatArray
    high: FloatArray
    width: FloatArray
    is_strength: BoolArray
    powers: tuple[tuple[int, int], ...]
    slips: tuple[tuple[int, int], ...]
    opposed: tuple[tuple[int, int], ...]
    amplitude: float
    names: tuple[str, ...]
    ordinates: frozenset[int] = frozenset()
    scatter: float = SCATTER

    @property
    def held(self) -> dict[str, float]:
        """Values of the redundant parameters."""
        names = [name for effect in self.oscillator.effects for name, _ in effect.redundant]
        return {name: float(self.template[self.oscillator.index(name)]) for name in names}

    @property
    def beds(self) -> list[tuple[int, int, int]]:
        """Coordinates of each bed of sliders: force, relative slip displacement, exponent of their strengths."""
        found = []
        for effect in self.oscillator.effects:
            place = {q.role: self.names.index(q.name) for q in effect.parameters if q.name in self.names}
            if {"slip_force", "exponent"} <= place.keys():
                found.append((place["strength"], place["slip_force"], place["exponent"]))
        return found

    @property
    def sliders(self) -> list[tuple[int, int]]:
        """Coordinates of each single slider: strength and slip."""
        beds = {strength for strength, _, _ in self.beds}
        return [pair for pair in self.slips if pair[0] not in beds]

    @property
    def lags(self) -> list[tuple[int, list[int]]]:
        """Coordinates of each displacement that lags: strength, and what it saturates by."""
        found = []
        for effect in self.oscillator.effects:
            free = [(q.role, self.names.index(q.name)) for q in effect.parameters if q.name in self.names]
            saturates = [place for role, place in free if role == "power_coefficient"]
            if effect.n_states and saturates:
                found += [(place, saturates) for role, place in free if role == "strength"]
        return found

    def room(self, eta: FloatArray, scatter: float, most: float) -> tuple[FloatArray, FloatArray]:
        """Return the least and largest deviations (q,) of a specimen: the most, or where coordinates have their limits.

        Beyond these, a deviation does nothing. The first are not above zero, the second not below.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            edges = (np.array([self.low, self.high]) / eta - 1.0) / scatter
        edges = np.where(eta != 0.0, edges, np.array([[-np.inf], [np.inf]]))
        return np.clip(edges.min(axis=0), -most, 0.0), np.clip(edges.max(axis=0), 0.0, most)

    def within(self, eta: FloatArray) -> FloatArray:
        """Return coordinates (q,) within their limits, those of one that is opposed to another included."""
        inside: FloatArray = np.clip(eta, self.low, self.high)
        for j, other in self.opposed:
            inside[j] = np.clip(inside[j], -inside[other], MOST_OPPOSED * inside[other])
        return inside

    def physical(self, eta: FloatArray, delta: FloatArray, scatter: float) -> tuple[FloatArray, FloatArray]:
        """Return effect parameters (q,) of a specimen, and their derivatives (q, q) to its own coordinates."""
        own = np.clip(eta * (1.0 + scatter * delta), self.low, self.high)
        values, slopes = np.empty(own.size), np.empty((own.size, own.size))
        powers, slips, opposed = self._pairs
        to_physical(own, self.amplitude, powers, slips, opposed, MOST_OPPOSED, values, slopes)
        return values, slopes

    @cached_property
    def _pairs(self) -> tuple[IntArray, IntArray, IntArray]:
        """Coordinates (n, 2) of powers, slips and those opposed, for compiled code."""
        powers, slips, opposed = (
            np.array(pairs, dtype=np.int64).reshape(-1, 2) for pairs in (self.powers, self.slips, self.opposed)
        )
        return powers, slips, opposed

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Return the coordinates of physical values of the free parameters."""
        eta = np.array(values, dtype=np.float64)
        for j, exponent in self.powers:
            eta[j] = values[j] * self.amplitude ** values[exponent]
        for stiffness, force in self.slips:
            eta[stiffness] = values[force]
            eta[force] = values[force] / max(values[stiffness], 1e-300) / self.amplitude
        return np.clip(eta, self.low, self.high)


def make_layout(
    oscillator: Oscillator,
    amplitude: float,
    angular_frequency: float,
    scatter: float = SCATTER,
    *,
    is_relaxed: bool = False,
) -> Layout:
    """Return the layout of an oscillator for records of this amplitude and frequency, ``scatter`` between specimens.

    With ``is_relaxed`` what remembers holds no force at the release.
    """
    bounds = oscillator.default_bounds(amplitude, angular_frequency)
    template = np.zeros(len(oscillator.parameter_names))
    free: list[int] = []
    rows: list[tuple[float, float, float]] = []
    strengths: list[int] = []
    ordinates: list[int] = []
    powers: list[tuple[int, int]] = []
    slips: list[tuple[int, int]] = []
    opposed: list[tuple[int, int]] = []
    for effect in oscillator.effects:
        held = effect.held(oscillator.mass, amplitude, angular_frequency)
        for name, value in held.items():
            template[oscillator.index(name)] = value
        if effect.name in BASE_EFFECTS:
            continue
        kept = sorted((q for q in effect.parameters if q.name not in held), key=lambda q: q.role != "strength")
        place = {q.name: len(free) + j for j, q in enumerate(kept)}
        by_role = {q.role: place[q.name] for q in kept}
        for parameter in kept:
            lower, upper = bounds[parameter.name]
            if parameter.role == "power_coefficient" and "exponent" in by_role:  # bounds are those at an exponent of 1
                lower, upper = lower * amplitude, upper * amplitude
                powers.append((place[parameter.name], by_role["exponent"]))
            grow = 0.0 if parameter.role in SHAPES else _BOX * (upper - lower)
            if parameter.role == "power_coefficient" and "exponent" in by_role:  # what saturates may do so early
                exponent = next(q.name for q in kept if q.role == "exponent")
                grow = max(grow, _SHARPEST ** -bounds[exponent][1])
            low, high = max(parameter.minimum, lower - grow), min(parameter.maximum, upper + grow)
            rows.append((low, high, (upper - lower) / np.sqrt(12.0)))
            free.append(oscillator.index(parameter.name))
        opposed += [(place[one], place[other]) for one, other in effect.opposed if {one, other} <= set(place)]
        strengths += [by_role["strength"]] if kept else []
        ordinates += [place[q.name] for q in kept if q.role == "ordinate"]
        if "slip_force" in by_role:
            stiffness, force = by_role["strength"], by_role["slip_force"]
            slips.append((stiffness, force))
            rows[stiffness] = (0.0, *rows[force][1:])
            rows[force] = (_STIFFEST, _SOFTEST["exponent" in by_role], 1.0 / np.sqrt(12.0))
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return Layout(
        oscillator=oscillator,
        simulator=Simulator(oscillator, is_relaxed=is_relaxed),
        free=np.array(free, dtype=np.int64),
        template=template,
        low=table[:, 0].copy(),
        high=table[:, 1].copy(),
        width=table[:, 2].copy(),
        is_strength=np.isin(np.arange(len(free)), strengths),
        powers=tuple(powers),
        slips=tuple(slips),
        opposed=tuple(opposed),
        amplitude=amplitude,
        names=tuple(oscillator.parameter_names[i] for i in free),
        ordinates=frozenset(ordinates),
        scatter=scatter,
    )
