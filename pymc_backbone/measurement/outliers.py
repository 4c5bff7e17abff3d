"""Specimens that do not belong: another structure, another mode or another unit among those of a batch."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from .._common.checks import FloatArray
from .._common.text import printable, shorten
from .cycle_data import Cycles

FALSE_ALARMS = 0.01
"""Share of batches without an outlier in which one is named at most."""
_NORMAL = 1.4826  # median absolute deviation to standard deviation, for a normal distribution
_MEDIAN_WORTH = 0.37
"""Degrees of freedom of a median absolute deviation for each value (its efficiency)."""
_UNITS = {
    1000.0: "m for mm (or mm for um)",
    180.0 / np.pi: "radians for degrees",
    25.4: "mm for inches",
    39.37: "m for inches",
    10.0: "cm for mm",
    100.0: "m for cm",
}
_NEAR_UNIT = 2.0


@dataclass(frozen=True)
class _Quantity:
    """What is compared, and what is known of its scatter between specimens before a batch is seen.

    ``scatter`` is a standard deviation of the logarithm, believed with the weight of ``freedom`` specimens.
    """

    name: str
    scatter: float
    freedom: float
    differ: Callable[[Cycles, Cycles], tuple[float, float]]
    """Difference of logarithms of two specimens and its standard error; NaN where they cannot be compared."""


@dataclass(frozen=True)
class Finding:
    """A specimen that stands out of its batch.

    Attributes
    ----------
    specimens : tuple of str
        The one that stands out; both of a batch of two, where it cannot be told which.
    kind : {"frequency", "amplitude", "damping"}
        What stands out.
    ratio : float
        Its value over that of the others.
    probability : float
        How often chance alone brings one as far out, any quantity of any specimen of the batch.
    sentence : str
        What it looks like and what to do.
    """

    specimens: tuple[str, ...]
    kind: str
    ratio: float
    probability: float
    sentence: str


def find_outliers(cycles: Sequence[Cycles], *, false_alarms: float = FALSE_ALARMS) -> list[Finding]:
    """Find specimens that do not belong to the batch.

    Frequency and damping are compared at amplitudes that two specimens share, so that a nonlinear structure released
    from different amplitudes does not stand out against itself; the largest amplitude is compared as it is.

    Parameters
    ----------
    cycles : sequence of Cycles
        One per specimen.
    false_alarms : float, default 0.01
        Share of batches without an outlier in which one may be named.

    Returns
    -------
    list of Finding
        One per specimen at most, frequency before amplitude before damping; empty for a single specimen.

    Notes
    -----
    With x_i the median of the differences (of logarithms) of specimen i from each other one, and e_i its error,

        T_i = x_i / sqrt((1 + 1 / (n - 1)) s_i^2 + e_i^2),
        s_i^2 = (f s_0^2 + m_i s_M^2) / (f + m_i),

    is compared with Student's distribution of f + m_i degrees of freedom, at ``false_alarms`` over three quantities
    times n specimens. s_M is the median absolute deviation of the others (times 1.4826) and m_i = 0.37 (n - 2) what
    it is worth; s_0 is what specimens of one kind scatter at most: 1.5 % in frequency (3 % in stiffness), 30 % in
    damping, 50 % in the amplitude of release; f is its weight, 6, 10 and 10 specimens. Two specimens are so judged by
    s_0 alone. ``benchmarks/outliers.py`` counts false alarms and catches.
    """
    items = list(cycles)
    found: list[Finding] = []
    named: set[str] = set()
    for quantity in _QUANTITIES:
        for specimens, ratio, probability in _far_out(items, quantity, false_alarms):
            if not named & set(specimens):
                named |= set(specimens)
                sentence = _SENTENCES[quantity.name](specimens, ratio)
                found.append(Finding(specimens, quantity.name, ratio, probability, sentence))
    return found


def _far_out(
    items: list[Cycles], quantity: _Quantity, false_alarms: float
) -> list[tuple[tuple[str, ...], float, float]]:
    """Return specimens, ratio to the others and probability of those that stand out in one quantity."""
    n = len(items)
    if n < 2:
        return []
    pairs = np.zeros((n, n, 2))
    for i in range(n):
        for j in range(i):
            difference, error = quantity.differ(items[i], items[j])
            pairs[i, j], pairs[j, i] = (difference, error), (-difference, error)
    tests = n * len(_QUANTITIES)
    found = []
    for i in range(n):
        others = [k for k in range(n) if k != i and np.isfinite(pairs[i, k, 0])]
        if not others:
            continue
        away, error = float(np.median(pairs[i, others, 0])), float(np.median(pairs[i, others, 1]))
        spread, worth = 0.0, 0.0
        if len(others) > 1:
            apart = np.array([_typical(pairs[k, [j for j in others if j != k], 0]) for k in others])
            spread, worth = _NORMAL * _typical(np.abs(apart)), _MEDIAN_WORTH * (len(others) - 1)
        if not np.isfinite(spread):
            spread, worth = 0.0, 0.0
        freedom = quantity.freedom + worth
        variance = (quantity.freedom * quantity.scatter**2 + worth * spread**2) / freedom
        score = abs(away) / np.sqrt((1.0 + 1.0 / len(others)) * variance + error**2)
        probability = min(tests * 2.0 * float(stdtr(freedom, -score)), 1.0)
        if probability < false_alarms:
            found.append(((items[i].specimen,), float(np.exp(away)), probability))
    if n == 2 and found:
        first, second = (item.specimen for item in items)
        return [((second, first), 1.0 / found[0][1] if found[0][0][0] == first else found[0][1], found[0][2])]
    return sorted(found, key=lambda item: item[2])


def _typical(values: FloatArray) -> float:
    """Return the median of what can be compared, NaN where nothing can."""
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else np.nan


def _frequencies(one: Cycles, other: Cycles) -> tuple[float, float]:
    """Return the difference of log frequencies at shared amplitudes, at the nearest ones where none are shared."""
    curves = []
    for item in (one, other):
        order = np.argsort(item.smoothed_amplitude)
        count = min(5, order.size) // 2 * 2 + 1
        padded = np.pad(np.log(np.maximum(item.frequency[order], 1e-300)), count // 2, mode="edge")
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(padded, count), axis=1)
        curves.append((np.log(item.smoothed_amplitude[order]), smooth[: order.size]))
    low, high = max(curve[0][0] for curve in curves), min(curve[0][-1] for curve in curves)
    # without shared amplitudes the ends that face each other
    at = np.linspace(low, high, 9) if high > low else np.array([0.5 * (low + high)])
    values = [np.interp(at, *curve) for curve in curves]
    errors = [float(np.median(item.frequency_error / item.frequency)) for item in (one, other)]
    return float(np.median(values[0] - values[1])), math.hypot(*errors)


def _amplitudes(one: Cycles, other: Cycles) -> tuple[float, float]:
    """Return the difference of the logarithms of the largest amplitudes."""
    return float(np.log(one.smoothed_amplitude.max() / other.smoothed_amplitude.max())), 0.0


def _dampings(one: Cycles, other: Cycles) -> tuple[float, float]:
    """Return the difference of log decrements over the amplitudes that both pass."""
    low = max(float(item.smoothed_amplitude.min()) for item in (one, other))
    high = min(float(item.smoothed_amplitude.max()) for item in (one, other))
    if not high > _SHARED * low:
        return np.nan, np.nan
    counts, errors = [], []
    for item in (one, other):
        amplitude = np.minimum.accumulate(item.smoothed_amplitude)[::-1]
        index = np.arange(amplitude.size, dtype=np.float64)[::-1]
        count = float(np.interp(low, amplitude, index) - np.interp(high, amplitude, index))
        if not count > 0.0:
            return np.nan, np.nan
        counts.append(count)
        errors.append(float(np.median(item.amplitude_error / item.smoothed_amplitude)) / np.log(high / low))
    return float(np.log(counts[1] / counts[0])), math.hypot(*errors)


_SHARED = 1.3
_QUANTITIES = (
    _Quantity("frequency", 0.015, 6.0, _frequencies),
    _Quantity("amplitude", 0.5, 10.0, _amplitudes),
    _Quantity("damping", 0.3, 10.0, _dampings),
)


def _who(specimens: tuple[str, ...]) -> tuple[str, str]:
    """Return the specimen that stands out and what it is compared with, in words."""
    names = [shorten(printable(name)) for name in specimens]
    return names[0], f"that of {names[1]}" if len(names) > 1 else "the others'"


def _of_frequency(specimens: tuple[str, ...], ratio: float) -> str:
    name, others = _who(specimens)
    return (
        f"{name}: its frequency is {ratio:.3g} times {others}, more than specimens of one kind scatter: another "
        "structure or another mode; leave it out, choose the mode with a band, or treat it as a batch of its own"
    )


def _of_amplitude(specimens: tuple[str, ...], ratio: float) -> str:
    name, others = _who(specimens)
    factor = max(ratio, 1.0 / ratio)
    nearest = min(_UNITS, key=lambda unit: abs(np.log(factor / unit)))
    is_near = abs(np.log(factor / nearest)) < np.log(_NEAR_UNIT)
    guess = f", about what {_UNITS[nearest]} makes" if is_near else ""
    return f"{name}: its largest amplitude is {ratio:.3g} times {others}{guess}; check its unit, or leave it out"


def _of_damping(specimens: tuple[str, ...], ratio: float) -> str:
    name, others = _who(specimens)
    return (
        f"{name}: its damping is {ratio:.3g} times {others} at the same amplitudes, more than specimens of one kind "
        "scatter; check its support and its sensor's cable, or leave it out"
    )


_SENTENCES = {"frequency": _of_frequency, "amplitude": _of_amplitude, "damping": _of_damping}
