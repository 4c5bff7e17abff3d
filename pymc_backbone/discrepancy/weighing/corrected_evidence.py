"""By how much Laplace's method is off, for the sets between which the verdict lies: as sampling says it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..._common.text import in_words
from ..fitting.batch import Batch
from ..fitting.descent import PER_CYCLE, is_heavy
from ..fitting.joint_fit import Fit
from .conditional import Conditional
from .evidence import Evidence, NoiseScale, laplace, noise_scale
from .importance import LARGEST_K, MOST_ROUNDS, MOST_WALKS, WALK, Integral, integrate

SETTLED = 0.999
"""Probability by Laplace's method from which nothing is asked: rivals would have to gain 4.9 on it, as logarithms, to
bring it below the 0.90 from which a set is named; that is rare (`docs/naming.md`)."""
ASKED = 5e-3
"""Probability by Laplace's method from which a set is asked."""
SHARE_OF_EFFORT = 0.5
"""Of what the search may simulate."""
SHARE_OF_WALKS = 1.0
"""Of the same, for sets whose weights could not be summed within that."""
_MOST_ASKED = 6
_STEPS = 3.0  # simulations of a specimen for each draw, as a rule
_MOST_DRAWS, _FEWEST_DRAWS = 128, 64
_HEAVY = 5.0  # what a cycle costs where the model takes long to simulate
_KINKED = 2.5  # the same where a force has kinks, at which steps end
_SEED = 20240229  # the same for all sets, so that their differences are known better than each


@dataclass(frozen=True)
class Corrected:
    """Which evidences were corrected, and what that took.

    Attributes
    ----------
    sets : mapping of set to Integral
        Of those that were asked; the logarithm is what is to be added to that of the evidence by Laplace's method.
    reason : str
        In one sentence, what was done and why no more.
    cycles : float
        Cycles that were simulated.
    """

    sets: Mapping[tuple[str, ...], Integral] = field(default_factory=dict)
    reason: str = ""
    cycles: float = 0.0

    def shifts(self, leading: tuple[str, ...]) -> dict[tuple[str, ...], float]:
        """Return what is added to the logarithm of each evidence, relative to that of the leading set.

        Sets that were not asked are taken to be off by as much as the leading one is, so only differences are moved;
        and where that of the leading one is not to be trusted, by as much as those that are on average.
        """
        trusted = {names: item.log_value for names, item in self.sets.items() if item.is_trusted}
        if not trusted:
            return {}
        common = trusted.get(leading, sum(trusted.values()) / len(trusted))
        return {names: shift - common for names, shift in trusted.items()}


def corrections(
    fits: Mapping[tuple[str, ...], Fit],
    known: Mapping[tuple[str, ...], Evidence],
    batch: Batch,
    effort: float,
) -> Corrected:
    """Return by how much the evidences of the sets between which the verdict lies are off.

    Parameters
    ----------
    fits : mapping
        All sets.
    known : mapping
        Their evidence by Laplace's method.
    batch : Batch
        The data.
    effort : float
        Values that may be simulated, as the search counts them: what is asked does not depend on a clock.

    See Also
    --------
    evidence.probabilities : takes the shifts.
    """
    ranked = sorted(known, key=lambda names: -known[names].log_posterior)
    leading = known[ranked[0]].probability
    if leading > SETTLED:
        return Corrected(reason=f"evidence is Laplace's: the most probable set holds {leading:.2%} by it")
    near = [names for names in ranked if known[names].probability > ASKED][:_MOST_ASKED]
    if len(near) < 2:
        return Corrected(reason=f"evidence is Laplace's: no rival of the most probable set holds {ASKED:.1%} by it")
    allowed, cycles = SHARE_OF_EFFORT * effort / PER_CYCLE, 0.0
    scale = noise_scale(fits, batch)
    costs = {names: _cost(fits[names], batch) for names in near}
    chosen, draws = _affordable(near, costs, allowed)
    found: dict[tuple[str, ...], Integral] = {}
    for names in chosen:
        spare = allowed - cycles - sum(draws * costs[other] for other in chosen if other not in found)
        affordable = _rounds_and_walks(spare, draws, costs[names])
        found[names], taken = _integrated(fits[names], batch, scale, draws, affordable)
        cycles += taken
    spare = SHARE_OF_WALKS * effort / PER_CYCLE
    for names in [names for names, item in found.items() if not item.is_trusted]:
        affordable = _rounds_and_walks(spare, draws, costs[names])
        if affordable.walks:
            found[names], taken = _integrated(fits[names], batch, scale, draws, affordable)
            spare, cycles = spare - taken, cycles + taken
    return Corrected(found, _reason(found, near, draws), cycles)


class _Affordable(NamedTuple):
    """Rounds of draws after the first, and walks after these."""

    rounds: int
    walks: int


def _integrated(
    found: Fit, batch: Batch, scale: NoiseScale, draws: int, affordable: _Affordable
) -> tuple[Integral, float]:
    """Return by how much Laplace's method is off for one set, and the cycles that it took to say so."""
    conditional = Conditional(found, batch.deciding, scale.sizes, scale.floor)
    middle, covariance = conditional.proposal
    integral = integrate(
        conditional.log_densities, middle, covariance, draws, low=found.layout.low, high=found.layout.high,
        rounds=affordable.rounds, walks=affordable.walks, random_seed=_SEED,
    )  # fmt: skip
    shift = integral.log_value - laplace(found, scale)
    return integral._replace(log_value=float(shift)), conditional.simulated * _weight(found)


def _weight(found: Fit) -> float:
    if is_heavy(found.layout):
        return _HEAVY
    return _KINKED if any(effect.regime is not None for effect in found.layout.oscillator.effects) else 1.0


def _cost(found: Fit, batch: Batch) -> float:
    """Return the cycles that one draw of a set takes; none where there is nothing to be drawn."""
    if not found.layout.free.size:
        return 0.0
    return _STEPS * _weight(found) * float(sum(term.cycles for term in batch.deciding))


def _affordable(
    near: list[tuple[str, ...]], costs: Mapping[tuple[str, ...], float], allowed: float
) -> tuple[list[tuple[str, ...]], int]:
    """Return the sets that can be asked, the leading one and as many rivals as may be, and with how many draws each.

    Nothing where the leading one cannot, or none beside it: what all have in common moves nothing.
    """
    draws = _MOST_DRAWS
    while draws > _FEWEST_DRAWS and draws * sum(costs[names] for names in near) > allowed:
        draws //= 2
    chosen: list[tuple[str, ...]] = []
    for names in near:
        if draws * (sum(costs[other] for other in chosen) + costs[names]) <= allowed:
            chosen.append(names)
        elif not chosen:
            break
    return (chosen, draws) if len(chosen) > 1 else ([], draws)


def _rounds_and_walks(spare: float, draws: int, cost: float) -> _Affordable:
    """Return how many rounds, and walks after these, what is spared suffices for."""
    cost = max(cost, 1.0)
    rounds = int(np.clip(spare // (draws * cost), 0, MOST_ROUNDS))
    left = spare - rounds * draws * cost
    return _Affordable(rounds, int(np.clip(left // ((WALK + draws) * cost), 0, MOST_WALKS)))


def _reason(found: Mapping[tuple[str, ...], Integral], near: list[tuple[str, ...]], draws: int) -> str:
    """Return in one sentence what was done."""
    if not found:
        return "evidence is Laplace's: importance sampling of the leading sets would cost more than it may"
    said = f"the evidence of the {len(found)} leading sets is corrected by importance sampling"
    if len(found) < len(near):
        said += f", that of {len(near) - len(found)} more is not, because that would cost more than it may"
    if draws < _MOST_DRAWS:
        said += f"; with {draws} draws for each instead of {_MOST_DRAWS}, for what they cost"
    bridged = sum(item.is_bridged for item in found.values())
    if bridged:
        said += f"; a bridge says that of {bridged} where weights cannot be summed (Pareto k above {LARGEST_K:g})"
    lost = [names for names, item in found.items() if not item.is_trusted]
    if lost:
        sets = "; ".join(" + ".join(map(in_words, names)) or "the model as it is" for names in lost)
        said += (
            f"; it fails for {sets} (Pareto k above {LARGEST_K:g}), whose evidence stays Laplace's, which nothing else "
            "checks"
        )
    return said


__all__ = ["Corrected", "corrections"]
