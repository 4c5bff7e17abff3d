"""Another mode's line in what the best model leaves: beside the harmonics of the motion, or close to one of them.

A harmonic lies at a multiple of the frequencies that the motion had. A line that does not, though it is closer to one
than what is looked at beside the harmonics, is another mode all the same: what it makes of the mid-line and of the
decrement, a spring that differs between the sides, a clearance or a drag make as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._common.text import per_cent
from ..disturbances.close_modes import CloseModes, close_modes
from ..disturbances.harmonic_lines import frequencies_of
from ..disturbances.lines import line_below, line_beside, line_near
from ..disturbances.mode_lines import ALIKE
from ..fitting.batch import Batch
from ..fitting.joint_fit import Fit
from ..results.entries import Check
from ..weighing import evidence

_BEATING = 0.02  # of the motion, from which a line is another mode ...
_SEEN, _NO_NOISE = 0.005, 2.0  # ... and where the model leaves so many times the noise
_BELOW = 0.01  # ... and below the frequency of the mode, where nothing else is
_TOLD = 0.001  # of the motion, from which a line is told although it is too small for these
_EARLY, _FEWEST_CYCLES = (4, 10), 10.0  # parts of a record, and how many cycles they hold at least


def second_mode_check(batch: Batch, best: Fit, *, is_bare: bool = False, is_moved: bool = False) -> Check:
    """Look for a line beside the harmonics in what the best model leaves, and for one close to a harmonic.

    In the beginning of the records, too, where nothing is named (``is_bare``) or where what is leaves more than noise:
    something has to be there, and a mode of a higher frequency has mostly decayed soon. Where nothing is named all the
    same, smaller lines count. Below the frequency of the mode a smaller line counts:
    a single mode has none there, and a mass that moves along, as of a liquid, bends the backbones. Two modes so close
    that nothing lies between them are looked for where more than noise is left, behind a band-pass as well. Where
    something goes on moving the structures (``is_moved``) half of the records have to show one line: what moves them
    leaves lines that come and go.
    """
    name = "no second mode"
    if (pair := _close(batch, best)) is not None:
        return Check(
            name,
            False,
            f"{pair.specimen} is the sum of two modes at {pair.frequency:.5g} and {pair.other:.5g} Hz, the other with "
            f"{per_cent(pair.share)} of the amplitude: they beat, and no band keeps one of them; hit or hold the "
            "structure where one of the two hardly moves, or take them apart by sensors at several places",
        )
    worst: tuple[float, float, str] = (0.0, 0.0, "")
    small: tuple[float, float, str] = (0.0, 0.0, "")
    orders: list[list[float]] = []
    for r, term in enumerate(batch.waveform):
        if batch.records[r].band is not None:
            continue  # one mode has been chosen, the others are kept out
        left = evidence.residuals_as_measured(term, best, r)
        between = frequencies_of(batch.levels[r], batch.records[r].frequency, batch.cycles[r])
        is_left = best.chi_square[r] > _NO_NOISE * term.size
        least = _SEEN if is_bare and is_left else _BEATING
        orders.append([])
        for part in _parts(left.size, term.cycles if is_bare or is_left else 0.0):
            time, motion = term.time[: left.size][part], float(np.std(term.values[: left.size][part]))
            below = line_below(time, left[part], between), min(least, _SEEN if is_bare else _BELOW)
            beside = line_beside(time, left[part], between), least
            near = line_near(time, left[part], between), least
            for line, smallest in (below, beside, near):
                share = line.height / (np.sqrt(2.0) * motion)
                if share > smallest:
                    orders[-1].append(line.frequency / batch.records[r].frequency)
                    worst = max(worst, (share, line.frequency, batch.specimens[r]))
            if (share := beside[0].height / (np.sqrt(2.0) * motion)) > small[0]:
                small = (share, beside[0].frequency, batch.specimens[r])
    if worst[0] > 0.0 and is_moved and not _is_of_most(orders):
        return Check(
            name,
            True,
            f"{worst[2]} holds a line at {worst[1]:.4g} Hz, {per_cent(worst[0])} of the motion, and most records none "
            "there: what goes on moving the structure leaves such lines",
        )
    if worst[0] > 0.0:
        return Check(
            name,
            False,
            f"{worst[2]} holds a line at {worst[1]:.4g} Hz, {per_cent(worst[0])} of the motion, that no effect of a "
            "single mode makes: a second mode beats with it; keep one mode with `band`",
        )
    if small[0] > _TOLD:
        said = "be all that is there" if is_bare else "speak against what was found"
        return Check(
            name,
            True,
            f"what the model leaves of {small[2]} holds a line at {small[1]:.4g} Hz, {per_cent(small[0])} of the "
            f"motion there, as another mode leaves: too small to {said}",
        )
    times = float(np.median([best.chi_square[r] / term.size for r, term in enumerate(batch.waveform)] or [0.0]))
    if times > _NO_NOISE:
        return Check(
            name,
            True,
            f"what the model leaves, {times:.2g} times the noise (chi-square), holds no line that stands beside the "
            "harmonics of the mode: one that lies within their range, as where the frequency changes much, is not told",
        )
    return Check(name, True, "what the model leaves holds no line beside the harmonics of the mode")


def _is_of_most(orders: Sequence[Sequence[float]]) -> bool:
    """Return whether half of the records hold a line of one order of the frequency of their motion."""
    at = [order for own in orders for order in own]
    return any(2 * sum(any(abs(item - order) < ALIKE for item in own) for own in orders) >= len(orders) for order in at)


def _close(batch: Batch, best: Fit) -> CloseModes | None:
    """Return two modes that beat in the records, where the best set leaves more than noise of most of them."""
    is_left = [best.chi_square[r] > _NO_NOISE * term.size for r, term in enumerate(batch.waveform)]
    if not is_left or np.mean(is_left) < 0.5:
        return None
    return close_modes(batch, [evidence.residuals_as_measured(term, best, r) for r, term in enumerate(batch.waveform)])


def _parts(size: int, cycles: float) -> list[slice]:
    """Return the parts of a record that are looked at: all of it, and of so many cycles its beginning."""
    early = [slice(0, size // share) for share in _EARLY if cycles > _FEWEST_CYCLES * share]
    return [slice(0, size), *early]


__all__ = ["second_mode_check"]
