"""What sets leave of the gap: the departures of the backbones that they need, beside those that the base needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..._common.checks import FloatArray
from ..proposals.departing import Departing, DepartingSets
from ..proposals.departure import NOISES
from ..proposals.set_fits import Set
from ..results.verdict import LEAST_SHARE
from ..weighing import evidence

_STANDS_OUT = 3.0  # standard errors of a level value from which the departure of an observable counts


def gaps_of(departing: Mapping[Set, Departing], departures: DepartingSets) -> dict[Set, float]:
    """Return the root mean square of the departure that each set needs, as a share of that which the base needs.

    As a force, over the elastic one: in phase, in quadrature and steady. Of a curve that the model's own stiffness or
    damping moves as a whole, what changes with the amplitude; what does not stand out of the errors is left out.
    """
    if () not in departing:
        return {}
    forces = {names: mean_squares(item) / departures.per_force**2 for names, item in departing.items()}
    told = forces[()] > (_STANDS_OUT * departures.noise / departures.per_force) ** 2
    whole = float(forces[()][told].sum())
    if whole <= 0.0:
        return _by_evidence(departing)
    return {names: float(np.sqrt(item[told].sum() / whole)) for names, item in forces.items()}


def least_gap(base: Departing, drifting: Sequence[Departing], departures: DepartingSets) -> float:
    """Return the least departure that is needed beside a drift in time, as a share of what the base needs."""
    gaps = (gaps_of({(): base, evidence.DRIFT: item}, departures)[evidence.DRIFT] for item in drifting)
    return min(gaps, default=np.inf)


def _by_evidence(departing: Mapping[Set, Departing]) -> dict[Set, float]:
    """Return what each set leaves of the largest gain of evidence: what no departure of the base draws, like a zero."""
    base = departing[()].log_evidence
    most = max(item.log_evidence for item in departing.values()) - base
    if most <= 0.0:
        return dict.fromkeys(departing, 1.0)
    return {k: float(np.clip(1.0 - (item.log_evidence - base) / most, 0.0, 1.0)) for k, item in departing.items()}


def mean_squares(item: Departing) -> FloatArray:
    """Return the mean square (3,) of the departures of the observables."""
    return np.array([*item.curves[:2].var(axis=1), (item.curves[2] ** 2).mean()])


def _leaves_next_to_nothing(item: Departing, base: Departing, departures: DepartingSets) -> bool:
    """Return whether a set leaves of no observable more than is worth a name, or than a level's error where none is.

    A damper may be little beside a spring, and all there is of the damping.
    """
    left, whole, noise = mean_squares(item), mean_squares(base), departures.noise**2
    return bool((left <= np.where(whole > _STANDS_OUT**2 * noise, LEAST_SHARE**2 * whole, noise)).all())


def with_smaller(
    logs: Mapping[Set, float], priors: Mapping[Set, float], known: Mapping[Set, Departing], departures: DepartingSets
) -> dict[Set, float]:
    """Return the logarithms of the odds where sets that leave next to nothing of any gap are as good as larger ones.

    What no law follows exactly is closed to the last by some set with more effects, of which the further ones draw what
    a sensor or another mode adds. A mechanism that closes as little is not named, and does not speak for such a set;
    nor does a larger noise, which hides what is left.
    """
    grown = dict(logs)
    noises = {names: NOISES[list(known[names].choice.noises)] for names in logs}
    for names in logs:
        if not names or not _leaves_next_to_nothing(known[names], known[()], departures):
            continue
        larger = [other for other in logs if set(names) < set(other)]
        quiet = [other for other in larger if (noises[names] <= np.maximum(noises[other], 1.0)).all()]
        grown[names] = max([logs[names], *(logs[other] - priors[other] + priors[names] for other in quiet)])
    return grown


__all__ = ["gaps_of", "least_gap", "mean_squares", "with_smaller"]
