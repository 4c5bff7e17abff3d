"""Mechanisms in what was weighed: their probabilities, laws and shares of the gap, and what the best set leaves."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import factorial

import numpy as np

from ..._common.checks import OBSERVABLES
from ...effects import EITHER
from ..proposals.departing import Departing
from ..results.entries import LawProbability, MissingMechanism, Remainder
from ..sets.search import Search, Set
from .mechanisms import Weighed

_TOLD = 0.01  # probability from which a mechanism, or a law, is told
_KINDRED = (0.5, 0.9)  # how probable it is that what imitates something outside of the library is of its mechanism
_MOSTLY = 2.5  # times the share of the gap that a mechanism closes: so probable it is between these


def missing_mechanisms(
    search: Search,
    probabilities: Mapping[Set, float],
    best: Set,
    gaps: Mapping[Set, float],
    estimates: Mapping[str, tuple[float, float]],
    elsewhere: float = 0.0,
    joined: frozenset[str] = frozenset(),
) -> tuple[MissingMechanism, ...]:
    """Return how probable it is of each mechanism that it is missing, and of each law that it is the one.

    Parameters
    ----------
    search : Search
        All sets and their fits.
    probabilities : mapping of Set to float
        Of every set; a mechanism is as probable as the sets that hold a law of it together, and their part of
        ``elsewhere``.
    best : tuple of str
        The set whose parameters are told.
    gaps : mapping of Set to float
        What each set leaves: the root of chi-square, or the root mean square of the departure that it needs.
    estimates : mapping of str to (float, float)
        Parameters of the best set with standard errors.
    elsewhere : float, default 0
        Probability of a law that the library does not hold and these sets imitate: of the mechanism that closes most of
        the gap nine times in ten, and half of the time of one that closes little of it.
    joined : frozenset of str
        Mechanisms of which no law is exact: two of them that one law may be instead, as a contact that closes gradually
        is a spring and a clearance at once, are told as either.
    """
    whole = max(sum(probabilities.values()), 1e-300)
    kinds_of = {names: frozenset(search.mechanism_of(name) for name in names) for names in probabilities}
    shares = shares_of_gap(search, best, gaps)

    def told(mechanism: str, kinds: tuple[str, ...]) -> MissingMechanism:
        laws: dict[str, float] = {}
        for names, probability in probabilities.items():
            for name in names:
                if search.mechanism_of(name) in kinds:
                    laws[name] = laws.get(name, 0.0) + probability
        ranked = sorted(laws, key=lambda key: -laws[key])
        kept = [name for name in ranked if laws[name] >= _TOLD] or ranked[:1]
        owned = {
            parameter.name
            for effect in (search.layout(best).oscillator.effects if estimates else ())
            if effect.name in best and search.mechanism_of(effect.name) in kinds
            for parameter in effect.parameters
        }
        either = sum(probability for names, probability in probabilities.items() if kinds_of[names] & set(kinds))
        share = sum(shares.get(kind, 0.0) for kind in kinds)
        kindred = float(np.clip(_MOSTLY * share, *_KINDRED))
        return MissingMechanism(
            mechanism=mechanism,
            probability=min(float(either * (1.0 + kindred * elsewhere / whole)), 1.0),
            share_of_gap=share,
            laws=tuple(LawProbability(name, min(laws[name], 1.0)) for name in kept),
            parameters={name: value for name, value in estimates.items() if name in owned},
        )

    found = {kind: told(kind, (kind,)) for kind in sorted(frozenset().union(*kinds_of.values()))}
    told_of: set[str] = set()  # one spring is not told twice, once with each mechanism that it may be instead
    for name, pair in EITHER.items():
        if not told_of.isdisjoint(pair):
            continue
        is_open = all(kind in found and not found[kind].is_certain for kind in pair)
        is_joined = set(pair) <= joined and any(kind in found for kind in pair)
        if (is_open or is_joined) and (both := told(name, pair)).is_certain:
            found = {key: item for key, item in found.items() if key not in pair} | {name: both}
            told_of.update(pair)
    kept = [item for item in found.values() if item.probability >= _TOLD]
    return tuple(sorted(kept, key=lambda item: -item.probability))


def shares_of_gap(search: Search, best: Set, gaps: Mapping[Set, float]) -> dict[str, float]:
    """Return by what share of the base's gap each mechanism of a set lowers it, the mean over all orders.

    The shares sum to what the set explains of the gap. Empty where a subset could not be fitted.
    """
    kinds = sorted({search.mechanism_of(name) for name in best})
    subsets = {
        chosen: tuple(name for name in best if search.mechanism_of(name) in chosen)
        for size in range(len(kinds) + 1)
        for chosen in combinations(kinds, size)
    }
    if any(names not in gaps for names in subsets.values()):
        return {}
    # a set leaves no more than any in it, however its fit ended
    left = {
        names: min(gaps[part] for part in subsets.values() if set(part) <= set(names)) for names in subsets.values()
    }
    base = max(left[()], 1e-300)
    shares = {}
    for kind in kinds:
        share = 0.0
        for chosen, names in subsets.items():
            if kind in chosen:
                continue
            more = subsets[tuple(sorted((*chosen, kind)))]
            orders = factorial(len(chosen)) * factorial(len(kinds) - len(chosen) - 1) / factorial(len(kinds))
            share += orders * (left[names] - left[more]) / base
        shares[kind] = float(np.clip(share, 0.0, 1.0))
    return shares


def estimates_with(search: Search, names: Set, found: Departing) -> dict[str, tuple[float, float]]:
    """Return the parameters of a set that departs, and their standard errors with the departure in them."""
    layout = search.layout(names)
    if not layout.free.size:
        return {}
    values, slopes = layout.physical(found.state.eta, np.zeros(layout.free.size), 0.0)
    errors = np.sqrt(np.maximum(np.diag(slopes @ found.covariance @ slopes.T), 0.0))
    rows = zip(layout.names, values, errors, strict=True)
    return {name: (float(value), float(error)) for name, value, error in rows}


def remainder_of(weighed: Weighed, best: Set) -> tuple[Remainder, ...]:
    """Return what a set leaves of the gap: by observable its largest size, in errors, and as a share of the gap."""
    found, base = weighed.departing[best], weighed.departing[()]
    rows = []
    for o, unit in enumerate(("Hz", "1", "1")):
        # stiffness and damping of the model move the first two as a whole
        curve, whole = (item.curves[o] - (item.curves[o].mean() if o < 2 else 0.0) for item in (found, base))
        errors = found.errors[o]
        if not errors.any():
            continue  # not measured
        at = int(np.argmax(np.abs(curve)))
        gap, left = (float(np.sqrt((item**2).mean())) for item in (whole, curve))
        rows.append(
            Remainder(
                observable=OBSERVABLES[o],
                size=float(curve[at]),
                unit=unit,
                standard_errors=float(np.abs(curve[at]) / max(float(errors[at]), 1e-300)),
                share_of_gap=left / gap if gap > 0.0 else float("nan"),
                amplitude_low=float(np.exp(weighed.nodes[0])),
                amplitude_high=float(np.exp(weighed.nodes[-1])),
                amplitude=tuple(float(x) for x in np.exp(weighed.nodes)),
                values=tuple(float(x) for x in curve),
                errors=tuple(float(x) for x in errors),
            )
        )
    return tuple(rows)


__all__ = ["estimates_with", "missing_mechanisms", "remainder_of", "shares_of_gap"]
