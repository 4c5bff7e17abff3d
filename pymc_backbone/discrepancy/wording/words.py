"""Findings in physical words with numbers: what the gap looks like, what could have been seen, what would decide."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..._common.checks import OBSERVABLES, BoolArray, FloatArray
from ..._common.text import amplitude, capitalised, in_a_sentence, in_words, per_cent, span, unit_of
from ...effects import BASE_EFFECTS
from ..deciding.decision import Decision, as_told
from ..fitting import starts
from ..fitting.batch import Batch
from ..fitting.curves import curve, measured, on_levels
from ..fitting.estimates import estimates_of, without
from ..fitting.joint_fit import Fit
from ..results.entries import ScatterOfEffects
from ..sets.question import Question
from ..sets.search import Search, Set
from .scatter_words import scatter_sentence
from .verdict_words import is_drift_possible, named

_FEWEST_LEVELS = 3  # that stand out, from which a power of the amplitude is told
_VANISHING = 0.3  # power of the amplitude below which a departure does not vanish with it
_OWN = 0.3  # of a departure, that the effect itself brings about as the model has it, from which it is told
_DAMPERS = ("drag", "displacement_damping", "falling_damping")  # mechanisms that a negative strength turns round
_NINETY_FIVE = 1.96  # standard errors
_ODD = 1e-9  # of the largest force: what rounding leaves of the sum of both sides
_SEPARATED = 5.0  # logarithm of the odds that decides
_ELSE = 0.12  # probability of what is not listed, from which advice says that a test need not rule it out


def reasons(
    batch: Batch, found: Fit, names: Set, scatter: ScatterOfEffects | None = None, asked: Question | None = None
) -> tuple[str, ...]:
    """Say for each effect how frequency and damping depart from the model without it, with the power of amplitude.

    What the library says an effect does is told where nothing stands out at single levels. Elsewhere it could
    contradict what was measured (a second effect in the set, or another amplitude), so only what the effect is is told.
    What differs between the two sides changes the damping by the mid-line alone: nothing is told of that where the
    mid-line is not measured; nor of the mid-line where both sides are alike, which a damped cycle has without any
    effect. Nor is what the effect itself does not bring about, as the model has it. Curves that change by less than
    the tolerance of what was ``asked`` are told where no other changes by more. Laws of one mechanism are told
    together: each may do what another takes back. Effects of the model as it was that the records do not hold are told
    as well.
    """
    sentences = []
    brought = on_levels(batch, found)
    summaries = {effect.name: effect.summary for effect in found.layout.oscillator.effects}
    sides = {effect.name for effect in found.layout.oscillator.effects if effect.mechanism == "asymmetry"}
    has_mid_line = all(record.offset_is_measured for record in batch.records)
    with_it = _curves(batch, brought)
    for together in _of_one_mechanism(found, names, asked):
        name = together[0]
        without_it = _curves(batch, without(brought, together))
        rows: tuple[int, ...] = (0, 2) if name in sides and not has_mid_line else (0, 1, 2)
        if all(_is_odd(batch, found, one) for one in together):
            rows = tuple(row for row in rows if OBSERVABLES[row] != "offset")
        if asked is not None:
            # a spring of two sides need not change what the backbones hold: its harmonics tell it
            by_waveforms = name in sides and batch.has_records
            rows = _that_matter(rows, with_it, without_it, asked.tolerance, or_none=by_waveforms)
        parts = [
            sentence
            for sentence in (_power_law(batch, without_it, with_it - without_it, row) for row in rows)
            if sentence
        ]
        unseen = "the waveforms show it" if batch.has_records else "all levels together show it"
        text = "; ".join(parts) if parts else f"not to be told from single levels; {unseen}"
        is_said = len(together) == 1 and not _is_against_its_name(brought, name)
        said = _said_by_the_library(summaries[name], bool(parts)) if is_said else ""
        sentences.append(f"{capitalised(' and '.join(in_words(one) for one in together))}: {text}.{said}")
    if scatter is not None and names:
        sentences.append(scatter_sentence(scatter, names))
    return (*sentences, *([] if asked is None else _unseen_in(asked, found)))


def _is_against_its_name(found: Fit, name: str) -> bool:
    """Return whether a damper takes back damping: one that acts in mid-stroke, of negative strength, acts elsewhere."""
    effect = next(item for item in found.layout.oscillator.effects if item.name == name)
    strengths = [parameter.name for parameter in effect.parameters if parameter.role == "strength"]
    if effect.mechanism not in _DAMPERS or not strengths:
        return False
    return bool(found.parameters(0)[found.layout.oscillator.index(strengths[0])] < 0.0)


def _of_one_mechanism(found: Fit, names: Set, asked: Question | None) -> list[list[str]]:
    """Return the named effects, each with what a fit adds to the model as it was that is of the same mechanism."""
    kinds = {effect.name: effect.mechanism for effect in found.layout.oscillator.effects}
    old = set(kinds) if asked is None else {effect.name for effect in asked.base.effects}
    groups: list[list[str]] = []
    for name in names:
        if any(name in group for group in groups):
            continue
        kin = [other for other, kind in kinds.items() if kind is not None and kind == kinds[name]]
        others = [other for other in kin if other != name and (other in names or other not in old)]
        groups.append([name, *others])
    return groups


def _is_odd(batch: Batch, found: Fit, name: str) -> bool:
    """Return whether an effect is the same on both sides; of those that remember all of the library are."""
    layout, omega = found.layout, batch.angular_frequency
    effect = next(item for item in layout.oscillator.effects if item.name == name)
    if effect.n_states:
        return True
    vector = found.parameters(0)
    own = np.array([vector[layout.oscillator.index(parameter)] for parameter in effect.parameter_names])

    def force(x: float, v: float) -> float:
        return effect.along(x, omega * v, -(omega**2) * x, np.zeros(0), own)

    motions = [(layout.amplitude * x, layout.amplitude * v) for x in (-0.9, -0.4, 0.1, 0.6, 1.0) for v in (-0.8, 0.5)]
    pairs = np.array([(force(x, v), force(-x, -v)) for x, v in motions])
    return bool(np.abs(pairs.sum(axis=1)).max() <= _ODD * np.abs(pairs).max())


def _that_matter(
    rows: tuple[int, ...],
    with_it: FloatArray,
    without_it: FloatArray,
    tolerance: Mapping[str, float],
    *,
    or_none: bool = False,
) -> tuple[int, ...]:
    """Return the observables that an effect changes by more than the tolerance; where that is none, all or none."""
    kept = []
    for row in rows:
        scale = 1.0 if OBSERVABLES[row] == "offset" else np.abs(with_it[:, row])
        with np.errstate(invalid="ignore", divide="ignore"):
            change = np.abs(with_it[:, row] - without_it[:, row]) / scale
        if largest(change) >= tolerance.get(OBSERVABLES[row], 0.0):
            kept.append(row)
    return tuple(kept) or (() if or_none else rows)


def _unseen_in(asked: Question, found: Fit) -> list[str]:
    """Say which effects of the model as it was are not in the records: their strengths may be zero."""
    sentences, estimates = [], estimates_of(found)
    for effect in asked.base.effects:
        if effect.name in BASE_EFFECTS or not (at := starts.positions(found.layout, effect.name)):
            continue
        strength = found.layout.names[at[0]]
        value, error = estimates[strength]
        if found.layout.is_strength[at[0]] and abs(value) < _NINETY_FIVE * error:
            known = next(parameter.unit for parameter in effect.parameters if parameter.name == strength)
            unit = unit_of(known, asked.batch.amplitude_unit)
            most = f"its {in_words(strength)} is at most {abs(value) + _NINETY_FIVE * error:.2g} {unit} (95 %)"
            sentences.append(f"The model's {in_words(effect.name)} is not seen in these records: {most}.")
    return sentences


def _said_by_the_library(summary: str, is_measured: bool) -> str:
    """Return what may follow the measured trends: what the effect is, and what it does where nothing was measured."""
    what, colon, _ = summary.partition(":")
    if not is_measured or not colon:
        return f" {summary.rstrip('.')}." if summary else ""
    return f" In other words: {in_a_sentence(what)}."


def _curves(batch: Batch, found: Fit) -> FloatArray:
    """Return the backbones of all specimens at the levels (specimen, 3, level)."""
    levels = np.asarray(batch.backbones["level"])
    each = zip(range(len(batch.specimens)), batch.levels, strict=True)
    return np.array([curve(found, found.parameters(r), levels, term.release) for r, term in each])


def _power_law(batch: Batch, without_it: FloatArray, brought: FloatArray, row: int) -> str:
    """Return how one observable exceeds the model without the effect.

    Nothing where that is not significant, or not what the effect has ``brought`` (specimen, 3, level).
    """
    observables = [str(item) for item in batch.backbones["observable"].values]
    if OBSERVABLES[row] not in observables:
        return ""
    o = observables.index(OBSERVABLES[row])
    levels = np.asarray(batch.backbones["level"])
    values, errors = measured(batch)
    gap, spread = values[:, o] - without_it[:, row], errors[:, o] ** 2
    held = np.isfinite(gap) & np.isfinite(spread) & (spread > 0.0)
    weight = np.where(held, 1.0 / np.where(held, spread, 1.0), 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(held, gap * weight, 0.0).sum(axis=0) / total
        error = 1.0 / np.sqrt(total)
        significance = mean / error
    good = np.isfinite(mean) & (np.abs(significance) > 2.0)
    if not good.any() or np.abs(significance[good]).max() < 4.0:
        return ""
    own = np.where(held & np.isfinite(brought[:, row]), brought[:, row] * weight, 0.0).sum(axis=0)[good] / total[good]
    if not float(total[good] @ (own * mean[good])) > _OWN * float(total[good] @ mean[good] ** 2):
        return ""
    at_good = held[:, good], gap[:, good], spread[:, good], brought[:, row][:, good]
    unit, length = " Hz" if row == 0 else "", batch.amplitude_unit
    units, sign = (unit, length), np.sign(np.median(mean[good]))
    if good.sum() < _FEWEST_LEVELS:  # a contact that closes at the highest amplitudes alone
        most = int(np.flatnonzero(good)[np.argmax(np.abs(significance[good]))])
        where = amplitude(float(levels[most]), length)
        return f"{OBSERVABLES[row]} {_verb(row, mean[most])} by {abs(mean[most]):.3g}{unit} at {where}"
    if (mean[good] * sign < 0.0).any():  # no power of the amplitude changes its sign
        return _change(OBSERVABLES[row], *_of_the_same(*at_good, levels[good]), units)
    x, y = np.log(levels[good]), np.log(mean[good] * sign)
    w = (mean[good] / error[good]) ** 2
    centre = np.average(x, weights=w)
    slope = float(np.average((x - centre) * y, weights=w) / np.average((x - centre) ** 2, weights=w))
    slope_error = max(float(1.0 / np.sqrt(np.sum(w * (x - centre) ** 2))), 0.01)  # two digits are told: never as 0.00
    if row < 2 and slope < _VANISHING and (row == 0 or slope > -_VANISHING):
        return _change(OBSERVABLES[row], *_of_the_same(*at_good, levels[good]), units)
    at = int(np.flatnonzero(good)[-1 if slope > 0.0 else 0])  # where it is largest but for the noise
    trend = "grows with amplitude" if slope > 0.0 else "grows as amplitude falls"
    return (
        f"{OBSERVABLES[row]} {_verb(row, sign)}: the departure {trend}, proportional to "
        f"A^({slope:.2f} +- {slope_error:.2f}), {mean[at]:+.3g}{unit} at {amplitude(float(levels[at]), length)}"
    )


def _verb(row: int, change: float) -> str:
    """Return what an observable does; a mid-line has sides, and no up and down."""
    if OBSERVABLES[row] == "offset":
        return "moves"
    return "rises" if change > 0.0 else "falls"


def _of_the_same(
    held: BoolArray, gap: FloatArray, spread: FloatArray, brought: FloatArray, levels: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return mean, error, what the effect brings, and the levels that most of the same specimens reach (of r, l).

    How specimens differ is no change with amplitude: each counts as much at one level as at the next.
    """
    patterns, which = np.unique(held, axis=1, return_inverse=True)
    most = int(np.argmax([np.count_nonzero(which == k) for k in range(patterns.shape[1])]))
    rows, at = np.flatnonzero(patterns[:, most]), np.flatnonzero(which == most)
    there = np.ix_(rows, at)
    weight = 1.0 / spread[there].mean(axis=1)
    weight /= weight.sum()
    error = np.sqrt(weight**2 @ spread[there])
    return weight @ gap[there], error, weight @ np.nan_to_num(brought[there]), levels[at]


def _change(
    observable: str,
    excess: FloatArray,
    error: FloatArray,
    own: FloatArray,
    levels: FloatArray,
    units: tuple[str, str],
) -> str:
    """Return how an observable changes with amplitude by an effect that is there however small the amplitude is.

    A slider that sticks is a spring more: the linear spring of the model without it would stand for that, so it is the
    change from the smallest amplitude on that tells; ``own`` is what the effect brings about as the model has it.
    """
    change = excess - excess[0]
    at = int(np.argmax(np.abs(change)))
    is_seen = abs(change[at]) > 2.0 * float(np.hypot(error[at], error[0]))
    if not (is_seen and (own[at] - own[0]) / change[at] > _OWN):
        if not own[0] / excess[0] > _OWN:  # what is off at the first level is not this effect's
            return ""
        return f"{observable} is {abs(excess[0]):.3g}{units[0]} {'higher' if excess[0] > 0.0 else 'lower'} throughout"
    verb = "rises" if change[at] > 0.0 else "falls"
    between = span(float(levels[0]), float(levels[at]), units[1])
    return f"{observable} {verb} by {abs(change[at]):.3g}{units[0]} from {between}"


def largest(change: FloatArray) -> float:
    """Return the largest of some changes; nan where none is known."""
    return float(np.nanmax(change)) if np.isfinite(change).any() else float("nan")


def advice(search: Search, decision: Decision) -> tuple[str, ...]:
    """Say what measurement would tell the most probable set from the next that is not just a larger or smaller one."""
    listed = [names for names in decision.listed if names != decision.best and names in search.fits]
    sentences = []
    if is_drift_possible(decision) or not np.isnan(decision.against):
        sentences.append(
            "release from other amplitudes: a drift goes with the time since the release, an effect with the amplitude."
        )
    if not listed:
        return tuple(sentences)
    rival = listed[0]
    ours, theirs = search.fits[decision.best], search.fits[rival]
    levels = np.asarray(search.batch.backbones["level"])
    unit = search.batch.amplitude_unit
    _, errors = measured(search.batch)
    pair = f"{named(decision.best)} and {named(rival)}"
    reached = None
    for factor in (1.5, 2.0, 3.0, 5.0, 1 / 1.5, 0.5, 1 / 3.0, 0.2):
        wide = np.sort(levels * factor)
        # from where no record was released yet
        outside = wide[(wide > max(levels[-1], search.batch.amplitude)) | (wide < levels[0])]
        if not outside.size:
            continue
        distance = _distance(search, ours, theirs, outside, errors)
        if distance > 9.0 * 2.0:
            reached = (factor, outside)
            break
    if reached is not None:
        factor, outside = reached
        edge = outside[-1] if factor > 1.0 else outside[0]
        direction = "up to" if factor > 1.0 else "down to"
        sentences.append(
            f"{pair} predict different backbones {direction} {amplitude(edge, unit)}: measure there{_how_far(factor)}, "
            "with the present noise."
        )
    else:
        sentences.append(f"no amplitude within a factor of five would tell {pair} apart with the present noise.")
    gap = abs(ours.cost - theirs.cost) / 2.0
    if gap > 0.1:
        more = _SEPARATED / gap
        if more > 1.0:
            sentences.append(
                f"at the present amplitudes it takes about {more:.1f} times as many records, or {np.sqrt(more):.1f} "
                f"times less noise, to tell {pair} apart."
            )
    told = as_told(decision.listed, decision.below, decision.probabilities)
    other = 1.0 - sum(told.get(names, 0.0) for names in decision.listed)
    if other > _ELSE:
        sentences.append(
            f"with {per_cent(other)} it is none of these sets, but another, a drift or nothing known, and such a test "
            "need not tell what then: `pymc-backbone plan` says how probable it is that a test decides."
        )
    return tuple(sentences)


def _how_far(factor: float) -> str:
    """Return how many times the largest amplitude of the records one is that lies above them; empty below."""
    return f" ({factor:g} times the largest amplitude so far, if the structure bears it)" if factor > 1.0 else ""


def _distance(search: Search, ours: Fit, theirs: Fit, outside: FloatArray, errors: FloatArray) -> float:
    """Return the squared distance between two predictions beyond the measured levels, in standard errors."""
    total = 0.0
    with np.errstate(all="ignore"):
        typical = np.nanmedian(errors, axis=(0, 2))
    for r in range(len(search.batch.specimens)):
        a, b = (curve(item, item.parameters(r), outside, 0.0) for item in (ours, theirs))
        for o, name in enumerate(search.batch.backbones["observable"].values):
            row = OBSERVABLES.index(str(name))
            difference = (a[row] - b[row]) / max(float(typical[o]), 1e-300)
            total += float(np.nansum(difference**2))
    return total
