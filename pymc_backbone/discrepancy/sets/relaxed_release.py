"""Releases at which what remembers holds no force: it had relaxed there, or nothing had moved it before.

A structure that is pulled and let go loads its sliders on the way, and so it is simulated. One that was held long, or
whose joint was tightened where it was held, has none of that force. Only the first half cycle differs; an acceleration
shows it as a step, which had been taken for the decay of a high-pass.
"""

from __future__ import annotations

from dataclasses import replace

from ...simulation.decay import Simulator
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit, fit
from ..weighing import evidence
from .search import Search

SENTENCE = (
    "what remembers begins without force at the release, as where a structure was held for long before; loaded on the "
    "way to the release, as where it is pulled and let go at once, it does not explain the first half cycle"
)
_ASKED = 3  # likeliest sets that remember, which are asked
_ITERATIONS = 12
_WORTH = 25.0  # fall of chi-square of one record from which what remembers begins so


def relaxed_fit(batch: Batch, found: Fit) -> Fit | None:
    """Return a fit whose states begin without force at the release; None where it cannot be simulated."""
    simulator = Simulator(found.layout.oscillator, is_relaxed=True)
    layout = replace(found.layout, simulator=simulator)
    return fit(layout, batch.deciding, found.state, iterations=_ITERATIONS, nuisances=batch.nuisances)


def is_relaxed_at_release(search: Search) -> bool:
    """Return whether what remembers begins without force, if nothing explains the records loaded on the way there.

    None of records that are compared through a band-pass: their releases are found from the course of the decay.
    """
    batch = search.batch
    if not batch.has_open_records or batch.is_relaxed or evidence.leaves_noise(batch, search.fits[search.best()]):
        return False
    lowest = min(found.cost for found in search.fits.values())
    asked = [search.fits[names] for names in search.ranked() if remembers(search.fits[names])][:_ASKED]
    fits = [item for item in (relaxed_fit(batch, found) for found in asked) if item is not None]
    return any(
        item.cost < lowest - _WORTH * len(batch.specimens) or evidence.leaves_noise(batch, item) for item in fits
    )


def remembers(found: Fit) -> bool:
    """Return whether an effect of a fit has a memory or states of its own."""
    return any(effect.has_memory or effect.n_states for effect in found.layout.oscillator.effects)


__all__ = ["SENTENCE", "is_relaxed_at_release", "relaxed_fit", "remembers"]
