"""Tests that were or could be made, sets that remain possible, and what tests promise: the values of a plan."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..._common.checks import InputError, check_finite_array, check_positive
from ..fitting.batch import Batch
from ..fitting.estimates import estimates_of
from ..fitting.joint_fit import Fit

QUANTITY_OF_ORDER = ("displacement", "velocity", "acceleration")
DENSE = 24.0
"""Samples per cycle that hold all there is to know; more are as good as less noise."""


@dataclass(frozen=True)
class Design:
    """A ring-down test: so many records, made alike.

    Attributes
    ----------
    release : float
        Displacement from which the structure is released, from rest [m or rad].
    records : int
        How many ring-downs.
    duration : float
        Of each [s].
    sampling_rate : float
        Of each [Hz].
    noise : float
        Standard deviation of white noise in the measured quantity.
    quantity : str
        ``displacement``, ``velocity`` or ``acceleration``.
    added_mass : float
        Fixed to the structure for this test [kg, or kg m^2 for a rotation].

    See Also
    --------
    plan_tests : scores tests.
    """

    release: float
    records: int
    duration: float
    sampling_rate: float
    noise: float
    quantity: str = "displacement"
    added_mass: float = 0.0

    @property
    def seconds(self) -> float:
        """Seconds of recording in all."""
        return self.records * self.duration


@dataclass(frozen=True)
class Contender:
    """A set of effects that the records at hand leave possible.

    Attributes
    ----------
    effects : tuple of str
        Beyond the base.
    probability : float
        As the study says.
    parameters, errors : mapping of str to float
        Value over the batch of all parameters of the extended model, base included, and standard errors.
    chi_square : float or None
        Of the records at hand; None where unknown. It says what of its probability a larger set owes to noise.
    imitation : float
        Probability that it imitates something the library lacks.

    See Also
    --------
    Study : holds those that remain possible.
    """

    effects: tuple[str, ...]
    probability: float
    parameters: Mapping[str, float]
    errors: Mapping[str, float] = field(default_factory=dict)
    chi_square: float | None = None
    imitation: float = 0.0


@dataclass(frozen=True)
class Affordable:
    """What the next test may cost.

    Attributes
    ----------
    smallest, largest : float
        Release [m or rad]; by default a quarter of the present one, and one and a half times it: more may be more
        than the structure bears.
    records : int
        At most; by default ten.
    duration : float
        Of a record at most [s]; by default twice the present one.
    noise : float
        Standard deviation that a better sensor has, in the measured quantity; by default there is none.
    added_masses : tuple of float
        That can be fixed to the structure [kg or kg m^2]; by default none.

    See Also
    --------
    plan_tests : looks at tests within these limits.
    """

    smallest: float | None = None
    largest: float | None = None
    records: int = 10
    duration: float | None = None
    noise: float | None = None
    added_masses: tuple[float, ...] = ()

    def designs(self, present: Design) -> list[Design]:
        """Return the tests that are looked at, the repetition of the present one first.

        Raises
        ------
        InputError
            Where a limit is no positive number, or the least is above the most.
        """
        for name in ("smallest", "largest", "duration", "noise"):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name))
        if self.records < 1:
            raise InputError(f"`records` must be at least 1, got {self.records}.")
        masses = [float(check_finite_array("added_masses", mass, ndim=0)) for mass in self.added_masses]
        if any(mass <= 0.0 for mass in masses):
            raise InputError(f"`added_masses` must be above zero, got {min(masses):g}.")
        low = 0.25 * present.release if self.smallest is None else float(self.smallest)
        high = 1.5 * present.release if self.largest is None else float(self.largest)
        if low > high:
            raise InputError(
                f"`smallest` ({low:g}) is above `largest` ({high:g}); give the release the other way round."
            )
        longest = 2.0 * present.duration if self.duration is None else float(self.duration)
        releases = _within((*(present.release * f for f in (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)), low, high), low, high)
        durations = [present.duration] + [longest] * (longest > 1.05 * present.duration)
        if longest < present.duration:
            durations = [longest]
        noises = [present.noise]
        if self.noise is not None and self.noise < present.noise:
            noises.append(self.noise)
        fewest = min(present.records, self.records)
        counts = sorted({fewest, min(2 * fewest, self.records), self.records})
        found = [
            replace(present, release=release, duration=duration, noise=noise, records=count, added_mass=mass)
            for mass in (present.added_mass, *masses)
            for release in releases
            for duration in durations
            for noise in noises
            for count in counts
        ]
        return [present, *(design for design in found if design != present)]


def _within(values: Iterable[float], low: float, high: float) -> list[float]:
    """Return the different values between two limits, rising."""
    kept: list[float] = []
    for value in sorted(values):
        if low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9) and not (kept and value < 1.02 * kept[-1]):
            kept.append(float(value))
    return kept


@dataclass(frozen=True)
class PlannedTest:
    """A test and what it promises.

    Attributes
    ----------
    design : Design
        What to do.
    probability : float
        That one set is named after it, the records at hand and the new ones taken together: the mean over the sets
        that are possible now, each as probable as it is.
    by_set : tuple of float
        The same if each of the contenders is true.
    seconds : float
        Of recording.

    See Also
    --------
    plan_tests : makes them.
    """

    design: Design
    probability: float
    by_set: tuple[float, ...]
    seconds: float


@dataclass(frozen=True)
class Plan:
    """The best tests, and the repetition of the present one beside them.

    Attributes
    ----------
    best : tuple of PlannedTest
        At most three, the most promising first.
    repeat : PlannedTest
        The test that was made, once more.
    contenders : tuple of Contender
        Between which they decide.
    looked_at : int
        Tests that were scored.

    See Also
    --------
    plan_tests : makes it.
    """

    best: tuple[PlannedTest, ...]
    repeat: PlannedTest
    contenders: tuple[Contender, ...]
    looked_at: int


def present_design(batch: Batch) -> Design | None:
    """Return the test that a batch of records is; None where only backbones are known."""
    if not batch.has_records:
        return None
    measured = [record.measured for record in batch.records]
    durations = [float(item.time[-1] - item.time[0]) for item in measured]
    rates = [float((item.time.size - 1) / length) for item, length in zip(measured, durations, strict=True)]
    noises = [float(np.sqrt(item.autocovariance[0])) for item in measured]
    return Design(
        release=float(np.median(np.abs(batch.own[:, 2]))),
        records=len(batch.specimens),
        duration=float(np.median(durations)),
        sampling_rate=float(np.median(rates)),
        noise=float(np.median(noises)),
        quantity=QUANTITY_OF_ORDER[measured[0].order],
    )


def contender(effects: tuple[str, ...], probability: float, found: Fit, imitation: float = 0.0) -> Contender:
    """Return a set and its fit as plain values."""
    own = np.median(found.state.own[:, :2], axis=0)
    shared = estimates_of(found)
    names = ("linear_stiffness", "viscous_damping")
    oscillator = found.layout.oscillator
    values = dict(zip(oscillator.parameter_names, found.layout.template.tolist(), strict=True))
    values |= {name: float(value) for name, value in zip(names, own, strict=True)}
    values |= {name: value for name, (value, _) in shared.items()}
    errors = {name: error for name, (_, error) in shared.items()}
    return Contender(effects, float(probability), values, errors, found.cost, imitation)


def contenders_from(entries: Sequence[Mapping[str, Any]]) -> tuple[Contender, ...]:
    """Return the sets that a result file lists."""
    return tuple(
        Contender(
            tuple(str(name) for name in item["effects"]),
            float(item["probability"]),
            {str(name): float(value) for name, value in item["parameters"].items()},
            {str(name): float(value) for name, value in item["errors"].items()},
            None if item.get("chi_square") is None else float(item["chi_square"]),
            float(item.get("imitation", 0.0)),
        )
        for item in entries
    )


__all__ = ["Affordable", "Contender", "Design", "Plan", "PlannedTest", "contender", "contenders_from", "present_design"]
