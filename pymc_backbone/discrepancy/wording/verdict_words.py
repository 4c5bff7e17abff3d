"""The verdict in words: what is missing, what remains possible, and with what probability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._common.text import capitalised, in_words, per_cent
from ...effects import MECHANISMS
from ..deciding.decision import DRIFT_POSSIBLE, NAMED, Decision
from ..results.entries import Check, MissingMechanism
from ..results.verdict import MECHANISM_NAMED, AdequateBy, NamedLevel, Verdict
from ..sets.search import Set
from ..weighing.evidence import MISSING

_SPOKEN = 5  # sets or laws that the sentence holds
_HEADED = 3  # sets in the headline, where a list of them follows
_REST = 0.1  # probability of no known set from which the sentence speaks of it
_LIKELY = 0.5  # of a further mechanism, from which the sentence speaks of it although no set is exact
_CLEARLY = 2.0  # standard errors
_UNLIKELY = 0.02  # probability of a law below which the sentence does not hold it
_RARER = 3.0  # times less probable: by more than the records say where these speak as much for it
_JOINT = 1.02  # sum of the probabilities of laws over that of their mechanism, beyond which sets hold several
DRIFTS = "a drift with time explains the records better than any effect of amplitude"
_OR_FORCES = (
    "a drift with time explains the records, and so does a force that depends on displacement and speed alone but is "
    "no known effect's; releases of the same specimens from other amplitudes tell the two apart"
)
_FORCES = (
    "a force that depends on displacement and speed alone but is no known effect's explains the records, and a drift "
    "with time does not"
)


def with_forces(sentence: str, *, is_drift_exact: bool) -> str:
    """Return a sentence that tells a drift with time, where force curves explain the records to the noise as well."""
    return sentence.replace(DRIFTS, _OR_FORCES if is_drift_exact else _FORCES)


def is_drift_possible(decision: Decision) -> bool:
    """Return whether a change with time explains the records too well for an effect to be named."""
    return decision.drift_probability >= DRIFT_POSSIBLE


def named(names: Set) -> str:
    """Return a set of effects in words."""
    return " + ".join(map(in_words, names)) if names else "no missing effect"


def _below(decision: Decision) -> str:
    """Return the effects below the tolerance as the subject of a sentence, with its verb."""
    *first, last = map(in_words, decision.below)
    return f"{', '.join(first)} and {last} are" if first else f"{last} is"


def _chance(probability: float) -> str:
    """Return a probability in per cent, never rounded to certainty."""
    if probability > 0.999:
        return "more than 99.9 %"
    return f"{100.0 * probability:.3g} %" if probability > 0.99 else f"{100.0 * probability:.0f} %"


def _of_mechanism(item: MissingMechanism, is_like: bool, rivals: frozenset[str]) -> str:
    """Return the sentence that names a mechanism, with the laws that it may be, or may be like.

    ``rivals`` are laws for which the records speak as much as for the likeliest, however improbable they are.
    """
    laws = [law for law in item.laws if law.probability > _UNLIKELY or law.effect in rivals]
    together = [in_words(law.effect) for law in laws if law.probability >= MECHANISM_NAMED * item.probability]
    if len(together) > 1:  # not one or the other: every set that explains holds them all
        like = ", or ones like them, not exactly" if is_like else ""
        which = f"its laws are {', '.join(together[:-1])} and {together[-1]} together{like}"
    elif len(laws) > 1 and (not together or any(law.effect in rivals for law in laws[1:])):
        told = ", ".join(f"{in_words(law.effect)} {100.0 * law.probability:.0f} %" for law in laws[:_SPOKEN])
        is_joint = sum(law.probability for law in laws) > _JOINT * item.probability
        which = f"which law these records do not tell: {told}{', some of them together' if is_joint else ''}"
    else:
        known = " or one like it, not exactly" if is_like else f" ({_chance(laws[0].probability)})"
        is_told = is_like or laws[0].probability >= NAMED * item.probability
        which = f"its law is {'' if is_told else 'perhaps '}{in_words(laws[0].effect)}{known}"
        beside = [f"{in_words(law.effect)} ({_chance(law.probability)})" for law in laws[1:] if law.probability > _REST]
        which += f", beside it perhaps {', '.join(beside)}" if beside else ""
    share = f"{_chance(item.probability)}, {100.0 * item.share_of_gap:.0f} % of the gap"
    return f"{_in_full(item).capitalize()} is missing ({share}); {which}."


def _in_full(item: MissingMechanism) -> str:
    """Return a mechanism in words: of a damper whose damping falls with the speed, that it does."""
    exponent, error = item.parameters.get("power_damping_exponent", (np.inf, 0.0))
    if exponent + _CLEARLY * error < 1.0 and item.laws[0].effect == "power_damping":
        return "a damping force that rises less than in proportion to the speed"
    return MECHANISMS[item.mechanism]


def _of_mechanisms(decision: Decision) -> str:
    """Return the sentences that name mechanisms, and what else may be missing: where no set is exact, if likely."""
    # of a bent sensor no law is told, however exact it is
    is_like = decision.is_approximate or decision.is_like or not decision.listed
    rivals = frozenset(name for names in decision.rivals for name in names)
    said = " ".join(_of_mechanism(item, is_like, rivals) for item in decision.mechanisms if item.is_certain)
    if not is_like and decision.model in decision.drifts and not decision.has_small_drift:
        said += f" {capitalised(_changes_with_time(decision))}."
    others = [
        item
        for item in decision.mechanisms
        if not item.is_certain
        and item.probability > (_LIKELY if is_like else _REST)
        and item.laws[0].effect not in decision.below
    ]
    small = [item for item in others if item.probability >= MECHANISM_NAMED and not is_like]
    if small:
        kinds = ", ".join(
            f"{MECHANISMS[item.mechanism]} ({_chance(item.probability)}, {100.0 * item.share_of_gap:.0f} % of the gap)"
            for item in small
        )
        said += f" A small part beside it: {kinds}."
    open_still = [item for item in others if item not in small]
    kinds = ", ".join(f"{MECHANISMS[item.mechanism]} ({_chance(item.probability)})" for item in open_still)
    said += f" What may be missing, too: {kinds}." if kinds else ""
    return f"{said}{_of_rivals(decision)}"


def _of_rivals(decision: Decision) -> str:
    """Return the sentence on rare sets that the records speak for as much as for the likeliest; empty for none."""
    rare = [names for names in decision.rivals if _RARER * decision.probabilities[names] < decision.probability]
    if not rare:
        return ""
    *first, last = (named(names) for names in rare)
    others = f"{', '.join(first)} and {last}" if first else last
    return f" By these records alone {others} would be as likely as {named(decision.best)}, which is met more often."


def _changes_with_time(decision: Decision) -> str:
    """Return that frequency or damping change with time: with the probability where sets without that remain.

    In one decay time and amplitude go together: a law that is a little off, and a further effect, may do the same.
    """
    drifting = sum(decision.probabilities.get(names, 0.0) for names in decision.drifts)
    share = drifting / max(sum(decision.probabilities.values()), 1e-300)
    how = "also change with time" if share >= MECHANISM_NAMED else f"may also change with time ({_chance(share)})"
    return f"frequency or damping {how}, or a further effect imitates that"


def _none_of_these(decision: Decision) -> str:
    """Return the sentence on the probability that no known set has, nor a drift with time; empty where it is small."""
    if decision.is_approximate or decision.has_second_mode:
        return ""
    rest = 1.0 - sum(decision.probabilities.values()) - decision.drift_probability
    return f" With {_chance(rest)} it is something else, which no known effect does." if rest > _REST else ""


def _certain_mechanisms(decision: Decision) -> list[MissingMechanism]:
    """Return the mechanisms that are certain whatever explains the rest.

    None that a set does without which is as likely by the records alone. None at all where no set is exact and a second
    mode beats in the records: it may have made what they explain.
    """
    is_beaten = decision.has_second_mode and decision.is_approximate
    if decision.drift_probability > DRIFT_POSSIBLE or not decision.is_single_valued or is_beaten:
        return []
    return [item for item in decision.mechanisms if item.is_certain and item.mechanism not in decision.undecided]


def _certain(decision: Decision) -> str:
    """Return the sentence on what is certain all the same; empty where nothing is."""
    kinds = [
        f"{MECHANISMS[item.mechanism]} ({100.0 * item.share_of_gap:.0f} % of the gap)"
        for item in _certain_mechanisms(decision)
    ]
    return f" Certain all the same: {', '.join(kinds)}." if kinds else ""


def _of_inexact(decision: Decision, others: Sequence[str]) -> str:
    """Return the sentence where no set is exact and what is certain is not all; the sets stand in the list below it."""
    beside = f" {' and '.join(others).capitalize()} may be there, too." if others else ""
    certain = _certain_mechanisms(decision)
    is_told = len(certain) > 0 and (bool(decision.unfinished) or len(certain) < len(decision.mechanisms))
    left = [item for item in decision.mechanisms if not (is_told and item in certain)]
    kinds = ", ".join(f"{MECHANISMS[item.mechanism]} {_chance(item.probability)}" for item in left)
    if not is_told:
        what = "Something is missing, but no set is exact and these records do not tell mechanisms apart"
        return f"{what}: {kinds}.{beside}"
    known = " ".join(
        f"{_in_full(item).capitalize()} is missing ({_chance(item.probability)}, "
        f"{100.0 * item.share_of_gap:.0f} % of the gap)."
        for item in certain
    )
    if not left:
        return f"{known} No set is exact.{beside}"
    return f"{known} What else is, these records do not tell, and no set is exact: {kinds}.{beside}"


def sentence(decision: Decision) -> str:
    """Return the verdict in one sentence, or a few."""
    if decision.named_level is NamedLevel.MECHANISM:
        return _of_mechanisms(decision)
    if decision.verdict is Verdict.FOUND:
        verb = "is" if len(decision.best) == 1 else "are"
        held = "" if decision.simulated is None else ", and in the model"
        below = f" ({_below(decision)} detectable too, below the tolerance{held})" if decision.below else ""
        drifts = decision.model in decision.drifts and not decision.has_small_drift  # which its check tells
        beside = f", while {_changes_with_time(decision)}" if drifts else ""
        what = capitalised(named(decision.best))
        return f"{what} {verb} missing from the model, with a probability of {_of_best(decision)}{beside}{below}."
    if decision.verdict is Verdict.AMBIGUOUS:
        return _of_ambiguous(decision)
    if decision.verdict is Verdict.UNEXPLAINED:
        return _of_unexplained(decision)
    return _of_adequate(decision)


def _of_best(decision: Decision) -> str:
    return f"{100.0 * decision.probability:.0f} %" if decision.probability < 0.995 else "more than 99 %"


def _of_ambiguous(decision: Decision) -> str:
    """Return the sentence where several explanations remain, or one that is too uncertain for a name."""
    listed = [f"{named(names)}{_beside_drift(decision, names)}" for names in decision.listed]
    others = ["a drift with time"] if is_drift_possible(decision) else []
    if decision.has_second_mode:
        others.append("a second mode")
    if decision.is_approximate and (decision.mechanisms or not decision.unfinished):
        return f"{_of_inexact(decision, others)}{_unfinished(decision)}"
    told = [*others, *listed] if decision.drift_probability > decision.probability else [*listed, *others]
    if not np.isnan(decision.against):
        left = f"leaves the backbones at a reduced chi-square of {decision.against:.3g}"
        if np.isinf(decision.against):
            left = "leaves backbones that cannot be simulated"
        return (
            f"Something is missing; {named(decision.best)} with a drift in time beside it explains the samples, but "
            f"{left}: what does not hold at every amplitude is no name."
        )
    if len(told) == 1 and decision.best and not decision.unfinished:
        what = f"{named(decision.best)}{_beside_drift(decision, decision.best)}"
        return (
            f"Something is missing; of the known effects {what} is the only explanation that remains, but with a "
            f"probability of {_of_best(decision)} it is too uncertain for a name.{_small(decision)}"
            f"{_none_of_these(decision)}"
        )
    if decision.unfinished:
        beats = "a second mode beats in the records, and " if decision.has_second_mode else ""
        return f"Something is missing; {beats}no fit explains the records.{_unfinished(decision)}"
    # as the list below writes them, which holds the others
    rest = f"; and {len(told) - _HEADED} more" if len(told) > _HEADED else ""
    sets = "; ".join(told[:_HEADED])
    told_apart = f"Something is missing, but these records do not tell apart: {sets}{rest}."
    return f"{told_apart}{_of_rivals(decision)}{_small(decision)}{_none_of_these(decision)}{_certain(decision)}"


def _beside_drift(decision: Decision, names: Set) -> str:
    """Return what follows a set that explains the records beside a drift only; empty where it does so by itself."""
    return " with a drift in time" if names in decision.drifts else ""


def _small(decision: Decision) -> str:
    """Return a sentence on what the records need and the tolerance would forgive; empty where there is nothing."""
    if not decision.below or not set(decision.below) <= set(decision.best):
        return ""
    changed = "changes" if len(decision.below) == 1 else "change"
    what = _below(decision).rpartition(" ")[0]
    return f" Of these {what} {changed} the backbones by less than the tolerance, and the samples need it."


def _unfinished(decision: Decision) -> str:
    """Return a sentence on the sets whose fits did not come to rest; empty where there are none."""
    if not decision.unfinished:
        return ""
    more = len(decision.unfinished) - _HEADED
    sets = "; ".join(named(names) for names in decision.unfinished[:_HEADED])
    rest = f"; and {more} more" if more > 0 else ""
    return f" Fits of sets that could explain the backbones did not come to rest: {sets}{rest}."


def _of_unexplained(decision: Decision) -> str:
    """Return the sentence where no set of known effects is the explanation."""
    if decision.has_second_mode and decision.drift_probability <= 0.5:
        partial = f"; beside it the best explanation is {named(decision.best)}" if decision.best else ""
        return f"Something is in the records that the model does not have: a second mode beats with it{partial}."
    if decision.is_moved_on:
        return (
            "Something is in the records that the model does not have: the structure is moved on after its release, as "
            "much at the end as at the begin; nothing stands out of that."
        )
    if not decision.is_single_valued:
        return (
            "Something is missing, but what no set of known effects explains differs between records at the same "
            "amplitude: it goes with the time or the record, and no law of amplitude is named."
        )
    share = f" ({per_cent(decision.lack.share)} of the motion)" if decision.lack.share > 0.0 else ""
    left = f"what the best set ({named(decision.best)}) leaves is not noise{share}"
    if not decision.best and decision.is_approximate:
        left = f"none comes near what the records show{share}"
        if decision.nearest is not None:
            near = named(decision.nearest)
            left = f"none holds at all amplitudes; nearest to the samples is {near}, but its backbones are far off"
    if decision.drift_probability > 0.5:
        return f"No known effect is named: {DRIFTS}.{_certain(decision)}"
    return f"Something is missing, and no set of known effects explains it: {left}.{_certain(decision)}"


def _of_adequate(decision: Decision) -> str:
    """Return the sentence where nothing needs to be added; what speaks against it is said too."""
    if decision.adequate_by is AdequateBy.TOLERANCE and not decision.best and decision.drift_probability <= 0.5:
        share = f"{per_cent(decision.lack.share)} of the motion"
        return (
            f"The model is adequate: what it leaves, {share}, is more than measurement error (p = "
            f"{decision.lack.p_value:.2g}), but less than the tolerance."
        )
    if decision.adequate_by is AdequateBy.TOLERANCE:
        what = _below(decision) if decision.below else "a drift with time is"
        verb = "change" if len(decision.below) > 1 else "changes"
        chance = sum(p for names, p in decision.probabilities.items() if {*decision.below} <= {*names})
        if decision.below and chance < NAMED:
            likeliest = " and ".join(map(in_words, decision.below))
            what, verb = f"something is detectable, most probably {likeliest} ({_chance(chance)})", "changes"
            return f"The model is adequate: {what}, but {verb} the backbones by less than the tolerance."
        return f"The model is adequate: {what} detectable, but {verb} the backbones by less than the tolerance."
    if decision.p_missing > MISSING:
        return f"Nothing is missing: model and records agree within measurement error (p = {decision.p_missing:.2g})."
    size = f" to {per_cent(decision.lack.share)} of the motion" if decision.lack.share > 0.0 else ""
    return (
        f"The model is adequate{size}: no set of known effects is more probable than none. Chance alone rarely leaves "
        f"as much (p = {decision.p_missing:.2g}): a little is there that no known effect explains."
    )


def with_checks(text: str, verdict: Verdict, checks: Sequence[Check]) -> str:
    """Return the sentence of the verdict, with a warning where a check on the data speaks against it."""
    failed = [check.check for check in checks if not check.passed]
    if not failed or verdict not in (Verdict.ADEQUATE, Verdict.FOUND):
        return text
    return f"{text} But a check on the data failed ({', '.join(failed)}): look at it first."
