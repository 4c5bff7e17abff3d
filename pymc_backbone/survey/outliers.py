"""Which structures stand out: another verdict than most, or a value far from the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._common.checks import FloatArray
from .._common.text import in_words
from ..discrepancy.results.verdict import Verdict
from ..reporting.words import set_name
from .structure import Structure

_FEWEST_DECIDED = 3  # structures from which a majority is told
LEAST = 6
"""Structures that must share a quantity before one of them can stand out."""
_NORMAL = 1.4826  # median absolute deviation to standard deviation, for a normal distribution
_LEAST_SPREAD = 1e-9  # of the median; below it values differ by rounding alone
_OF_LINEAR_PART = ("linear_stiffness", "viscous_damping")


def far(count: int) -> float:
    """Return the robust z-score from which a value of so many stands out: 4.2 + 30 / count.

    Of quantities that are normally distributed with nothing standing out, one or two in a hundred reach it; the median
    absolute deviation of few values is too small now and then, so that few need a larger distance.

    Examples
    --------
    >>> far(10), far(60)
    (7.2, 4.7)
    """
    return 4.2 + 30.0 / count


@dataclass(frozen=True)
class Quantity:
    """One number of several structures.

    Attributes
    ----------
    name, unit : str
        What it is.
    structures : tuple of str
        Those that have it.
    values, errors : (n,) arrays
        Value and standard deviation [``unit``].
    """

    name: str
    unit: str
    structures: tuple[str, ...]
    values: FloatArray
    errors: FloatArray

    @property
    def median(self) -> float:
        """Median over the structures [``unit``]."""
        return float(np.median(self.values))

    @property
    def spread(self) -> float:
        """Robust standard deviation: 1.4826 times the median absolute deviation [``unit``]."""
        return float(_NORMAL * np.median(np.abs(self.values - self.median)))

    def scores(self) -> FloatArray:
        """Return the robust z-score of each structure; NaN for fewer than `LEAST` structures.

        z = (x - median) / sqrt(s^2 + e^2), with s the robust standard deviation over the structures and e the value's
        own: a value that is badly known does not stand out. Positive quantities are compared by their logarithms.
        """
        if len(self.structures) < LEAST:
            return np.full(len(self.structures), np.nan)
        values, errors = self.values, self.errors
        if np.all(values > 0.0):
            values, errors = np.log(values), errors / values
        away = values - np.median(values)
        spread = max(_NORMAL * float(np.median(np.abs(away))), _LEAST_SPREAD * float(np.max(np.abs(values), initial=1)))
        return away / np.hypot(spread, np.nan_to_num(errors))


def quantities(structures: Sequence[Structure]) -> list[Quantity]:
    """Return frequency and damping ratio of the linear part, then the coefficients of all effects."""
    rows: dict[tuple[str, str], list[tuple[str, float, float]]] = {}
    for item in structures:
        if not item.is_done:
            continue
        shares = [_relative_error(item, name) for name in _OF_LINEAR_PART]
        of_linear = (
            ("frequency", "Hz", item.frequency, 0.5 * item.frequency * shares[0]),
            (
                "damping_ratio",
                "1",
                item.damping_ratio,
                item.damping_ratio * float(np.hypot(shares[1], 0.5 * shares[0])),
            ),
        )
        for name, unit, value, error in of_linear:
            rows.setdefault((name, unit), []).append((item.name, value, error))
        for name, estimate in item.parameters.items():
            if name not in _OF_LINEAR_PART:
                value, error = (float("nan") if estimate[key] is None else estimate[key] for key in ("mean", "sd"))
                rows.setdefault((name, estimate["unit"]), []).append((item.name, value, error))
    found = []
    for (name, unit), held in rows.items():
        finite = [row for row in held if np.isfinite(row[1])]
        if finite:
            names, values, errors = zip(*finite, strict=True)
            found.append(Quantity(name, unit, names, np.array(values, float), np.array(errors, float)))
    return found


def majority(structures: Sequence[Structure]) -> tuple[tuple[str, ...], int, int] | None:
    """Return the set of missing effects (empty: nothing) of more than half of the decided structures, with the counts.

    Counts are those that share it and those that are decided: ``adequate`` or ``found``, with no other set possible.
    Where fewer than three laws are, mechanisms count whose law is open. None: there is no such set, or fewer than three
    are decided even so.
    """
    known = _decided(structures)
    decided = [frozenset(item.named) for item in known]
    if len(decided) < _FEWEST_DECIDED:
        return None
    chosen, count = Counter(decided).most_common(1)[0]
    return (tuple(sorted(chosen)), count, len(decided)) if 2 * count > len(decided) else None


def _decided(structures: Sequence[Structure]) -> list[Structure]:
    """Return the structures whose verdict leaves no other set; where these are few, also those whose law is open."""
    answered = [item for item in structures if item.verdict in (Verdict.ADEQUATE, Verdict.FOUND)]
    closed = [item for item in answered if not item.ambiguous_sets]
    return closed if len(closed) >= _FEWEST_DECIDED else answered


def share_with_more(structures: Sequence[Structure], usual: Sequence[str]) -> int:
    """Return how many of the decided structures lack all of a set of effects, and others beside it."""
    decided = [set(item.named) for item in _decided(structures)]
    return sum(set(usual) < named for named in decided) if usual else 0


def stand_out(structures: Sequence[Structure]) -> dict[str, tuple[str, ...]]:
    """Return why structures stand out, in sentences without a full stop; the most conspicuous first.

    Parameters
    ----------
    structures : sequence of Structure
        Of one survey.

    Returns
    -------
    dict
        Reasons by name: nothing explains it, another set of effects than most, or a robust z-score beyond `far`.
    """
    most = majority(structures)
    reasons: dict[str, list[str]] = {}
    rank: dict[str, list[float]] = {item.name: [0.0, 0.0, 0.0] for item in structures}
    for item in structures:
        said = _verdict_reason(item, most)
        if said:
            reasons.setdefault(item.name, []).append(said)
            rank[item.name][0 if item.verdict == Verdict.UNEXPLAINED else 1] = 1.0
    for quantity in quantities(structures):
        for name, value, score in zip(quantity.structures, quantity.values, quantity.scores(), strict=True):
            if abs(score) > far(len(quantity.structures)):
                reasons.setdefault(name, []).append(_value_reason(quantity, float(value), float(score)))
                rank[name][2] = max(rank[name][2], abs(float(score)))
    order = sorted(reasons, key=lambda name: [-part for part in rank[name]])
    return {name: tuple(reasons[name]) for name in order}


def words(effects: Sequence[str]) -> str:
    """Return a set of effects as words, nothing for the empty one."""
    return set_name(effects, "nothing")


def _verdict_reason(item: Structure, most: tuple[tuple[str, ...], int, int] | None) -> str:
    if item.verdict == Verdict.UNEXPLAINED:
        return "no effect of the library explains it"
    if most is None or not item.is_done:
        return ""
    usual, count, decided = most
    alone = " alone" if set(usual) & set(item.named) else ""
    said = f"{count} of {decided} lack {words(usual)}{alone}"
    if item.ambiguous_sets or item.verdict == Verdict.AMBIGUOUS:
        sets = [frozenset(item.named), *map(frozenset, item.ambiguous_sets)]
        return "" if frozenset(usual) in sets else f"none of its possible sets is the usual one ({said})"
    return "" if frozenset(item.named) == frozenset(usual) else f"lacks {words(item.named)}; {said}"


def _value_reason(quantity: Quantity, value: float, score: float) -> str:
    name, median = in_words(quantity.name), quantity.median
    unit = "" if quantity.unit in ("1", "-") else f" {quantity.unit}"
    if value * median > 0.0:
        ratio = value / median
        how = f"{ratio:.3g} times" if abs(ratio - 1.0) >= 0.1 else f"{100.0 * (ratio - 1.0):+.2g} % off"
        return f"{name} is {how} the median ({value:.4g} against {median:.4g}{unit}, robust z {score:+.1f})"
    return f"{name} is {value:.4g}{unit}, the median {median:.4g}{unit} (robust z {score:+.1f})"


def _relative_error(item: Structure, name: str) -> float:
    estimate = item.parameters.get(name, {})
    mean, sd = estimate.get("mean"), estimate.get("sd")
    return abs(sd / mean) if mean and sd is not None else 0.0


__all__ = ["LEAST", "Quantity", "far", "majority", "quantities", "share_with_more", "stand_out"]
