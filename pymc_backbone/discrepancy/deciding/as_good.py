"""Sets that are as good as others, because no measured structure is exactly what either says.

Long records of little noise tell a force from one that differs from it by a few parts in ten thousand. No real spring
is a cubic one to that, and no drift is linear in time to that: what closes less of a gap than a thousandth is given to
what is simpler, or less rare.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ...effects import LIBRARY
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..proposals.set_fits import Set
from ..weighing import evidence
from ..weighing.evidence import DRIFT, Evidence

EXACT = 1e-3
"""Share of the gap, in standard deviations, to which a law or a course of a drift is taken to be right at best."""


def odds_of_as_good(
    batch: Batch, fits: Mapping[Set, Fit], evidences: Mapping[Set, Evidence], variants: Collection[str]
) -> dict[Set, float]:
    """Return by how much the logarithm of the odds of some sets rises: to the evidence of what is as good as they are.

    A set is as good as one with a variant in the place of one of its laws, and, where a drift in time stands beside
    both, as one that holds it, where it leaves noise and hardly more than the other.

    Parameters
    ----------
    batch : Batch
        The data.
    fits : mapping of tuple of str to Fit
        All sets; `evidence.DRIFT` at the end of those with a drift beside them.
    evidences : mapping of tuple of str to Evidence
        The same.
    variants : collection of str
        Effects that are looked for in the place of others.

    Returns
    -------
    dict
    """
    if not batch.has_records or () not in fits:
        return {}
    lowest = min(found.cost for found in fits.values())
    small = EXACT**2 * max(fits[()].cost - lowest, 0.0)
    raised: dict[Set, float] = {}
    for simple, found in fits.items():
        more = [
            evidences[other].log_evidence
            for other in fits
            if found.cost - small < fits[other].cost < found.cost and _is_simpler(simple, other, variants)
        ]
        if more and evidence.leaves_noise(batch, found):
            raised[simple] = max(max(more) - evidences[simple].log_evidence, 0.0)
    return {names: odds for names, odds in raised.items() if odds > 0.0}


def _is_simpler(simple: Set, other: Set, variants: Collection[str]) -> bool:
    """Return whether a set is another with a law in the place of its variant, or beside a drift a part of it."""
    if (simple[-1:] == DRIFT) != (other[-1:] == DRIFT):
        return False
    less, more = {*simple} - {*other}, {*other} - {*simple}
    if not less:
        return simple[-1:] == DRIFT and bool(more)
    if len(less) != 1 or len(more) != 1:
        return False
    (law,), (variant,) = less, more
    return variant in variants and variant in LIBRARY and law in LIBRARY[variant].variant_of


__all__ = ["EXACT", "odds_of_as_good"]
