"""High-passes in front of the records: those of accelerometers and of what is coupled for alternating current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..._common.threads import in_threads
from ...effects import BASE_EFFECTS
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..fitting.normal_equations import State
from ..fitting.telling import most_telling
from .behind_filter import (  # fmt: skip
    MOST_FITTED,
    PRICE,
    Behind,
    FittedBehind,
    behind_it,
    fitted_behind,
    is_exact_behind,
    is_promising_part,
    left_by,
)
from .free_start import left_without_start
from .sensor_filter import SensorFilter, with_past

COUPLED = (0.02, 0.045, 0.1, 0.2, 0.4)
"""Cut-offs over the frequency of the mode behind which sets are fitted at first ..."""
_NEARER = (1.4, 1.18)  # ... and ratios to the best of them of those that are tried then
_MEASURED = (1.08,)  # that of those between which the cut-off is measured ...
_AFTER_FIRST = (1.5, 1.08)  # ... where the first cycle says nothing
# of what a high-pass explains, what its past alone leaves at least where harmonics show it: of displacements, and of
# velocities and accelerations
_BY_HARMONICS = {False: 0.1, True: 0.25}
_LESS = 0.7  # of what is left where records only begin as behind a high-pass, that is left behind it at most


def high_passes(batch: Batch, base: Fit, starts: Sequence[Fit], frequency: float) -> list[Behind]:
    """Return sets behind the high-passes that suit them, of one pole where that leaves noise, else of two.

    What tells one is mostly the slow decay after the jump at the release, and no look from fits without it: so the base
    and the sets that leave least are fitted behind some, each begun where the one before ended, and further where less
    is left. Decays of one pole and of two are much alike: where the release alone shows a filter, both are tried.
    """
    begun = [base, *sorted(starts, key=lambda start: start.cost)[:MOST_FITTED]]
    found: list[Behind] = []
    for order in (1, 2):
        filters = [SensorFilter(order, cut * frequency, "high-pass") for cut in COUPLED]
        kept = []
        for few in ([start for start in begun if start is base], [start for start in begun if start is not base]):
            passed = in_threads([partial(high_pass, batch, start, filters) for start in few])
            for start, best in zip(few, passed, strict=True):
                if best is not None:
                    kept.append(start)
                    found.append(behind_it(batch, best.filter, best.found))
            if kept == [base] and found[-1].is_exact:
                break  # nothing else is needed
        begun = kept
        if any(item.is_exact and not item.filter.shows_at_release for item in found):
            break
    return found


def high_pass(batch: Batch, start: Fit, filters: Sequence[SensorFilter]) -> FittedBehind | None:
    """Return the high-pass that suits a set best, and the set behind it; None where it leaves little less.

    Looked for with the records that the set leaves most of, and measured with all. A motion without harmonics shows it
    at the release alone, where records begin with what it has of the past: it then has to leave noise where the set
    without it does not, nor does without the first cycle; and that says nothing behind it.
    """
    part = most_telling(batch, start)
    tried: list[FittedBehind] = []
    for chosen in filters:
        tried += _fitted(part.batch, start, chosen, (tried[-1].found if tried else part.found).state)
    best = min(tried, key=FittedBehind.cost, default=None)
    if best is None or not is_promising_part(part, best):
        return None
    for ratio in _NEARER:
        near, reached = best.filter, best.found.state
        sides = [
            item
            for by in (1.0 / ratio, ratio)
            for item in _fitted(part.batch, start, replace(near, cut=by * near.cut), reached)
        ]
        best = min([best, *sides], key=FittedBehind.cost)
    whole = _fitted(batch, start, best.filter, part.whole(best.found.state, start))
    whole += [
        again
        for item in whole
        if not item.found.is_converged
        for again in _fitted(batch, start, item.filter, item.found.state)
    ]
    if not whole:
        return None
    best = whole[-1]
    if not is_exact_behind(batch, best) and all(term.order for term in batch.waveform):
        ringing = _fitted(batch, start, replace(best.filter, rings=True), best.found.state)
        best = next((item for item in ringing if is_exact_behind(batch, item)), best)
    past = left_by(start, batch, [with_past(term, best.filter) for term in batch.waveform])
    is_exact = best.cost() < start.cost - PRICE and is_exact_behind(batch, best)
    if not is_exact and not best.cost() < _LESS * past - PRICE:
        return None
    is_linear = all(effect.name in BASE_EFFECTS for effect in start.layout.oscillator.effects)  # without harmonics
    least = _BY_HARMONICS[all(term.order for term in batch.waveform)]
    shows_at_release = is_linear or past - best.cost() < least * (start.cost - best.cost())
    if shows_at_release:
        if not behind_it(batch, best.filter, best.found).cost < left_without_start(start, batch) - PRICE:
            return None
        # another filter may ring there: the cut-off is told by what follows
        best = next(iter(_fitted(batch, start, replace(best.filter, rings=True), best.found.state)), best)
    best = _measured(batch, start, best, _AFTER_FIRST if shows_at_release else _MEASURED)
    return replace(best, filter=replace(best.filter, shows_at_release=shows_at_release))


def _fitted(batch: Batch, start: Fit, chosen: SensorFilter, state: State) -> list[FittedBehind]:
    """Return a set behind a filter from a state on; none where it cannot be simulated there."""
    found = fitted_behind(batch, chosen, start, state)
    return [] if found is None else [found]


def _measured(batch: Batch, start: Fit, best: FittedBehind, ratios: Sequence[float]) -> FittedBehind:
    """Return a set behind the high-pass whose cut-off suits it best, between some to either side of the one it has."""
    for ratio in ratios:
        at, known = best.filter, best.found
        lower, upper = (_fitted(batch, start, replace(at, cut=by * at.cut), known.state) for by in (1.0 / ratio, ratio))
        best = min([best, *lower, *upper], key=FittedBehind.cost)
        if lower and upper:
            cut = lowest_cut(at.cut, ratio, (lower[0].cost(), known.cost, upper[0].cost()))
            best = min([best, *_fitted(batch, start, replace(at, cut=cut), best.found.state)], key=FittedBehind.cost)
    return best


def lowest_cut(cut: float, ratio: float, costs: tuple[float, float, float]) -> float:
    """Return where the parabola through the costs at ``cut / ratio``, ``cut`` and ``cut * ratio`` is lowest.

    One of the outer two where it is nowhere between them.
    """
    low, middle, high = costs
    bend = low - 2.0 * middle + high
    step = 0.5 * (low - high) / bend if bend > 0.0 else float(np.sign(low - high))
    return float(cut * ratio ** np.clip(step, -1.0, 1.0))


__all__ = ["COUPLED", "high_pass", "high_passes", "lowest_cut"]
