"""The verdict: what the probabilities, the fit's own residuals, the tolerance and the rivals allow to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...effects import EITHER
from ..fitting.curves import level_chi_square
from ..fitting.estimates import estimates_of
from ..fitting.joint_fit import Fit
from ..proposals.harmonic_odds import odds_behind_bands
from ..results.entries import MissingMechanism
from ..results.verdict import AdequateBy, NamedLevel, Verdict
from ..sets.search import Search, Set
from ..weighing import evidence
from ..weighing.corrected_evidence import Corrected, corrections
from ..weighing.evidence import DRIFT, UNEXPLAINED, Drifting, Evidence, is_unexplained
from .as_good import odds_of_as_good
from .compensation import compensation
from .decision import AGREE, DRIFT_POSSIBLE, NAMED, Decision, as_one, listed
from .imitations import COMPENSATED, doubted, is_none_other, library_holds
from .inexact import departing, is_told_apart, leaves_the_samples
from .rivals import rivals_of
from .shares import missing_mechanisms
from .tolerance import damping_drift, is_drift_small, prune

_ASKED = 0.01  # probability of a set from which it is asked whether its effects compensate each other
_ONE_FORCE = frozenset(("spring", "asymmetry"))  # the odd and the even part of one
_FALLING, _RISING = "falling_damping", frozenset(("drag", "displacement_damping"))  # the same damper, at other places
_FAR = 2.0  # reduced chi-square that is far more than noise
_MOST_FADING = 0.04  # of the damping, that changes with time in one decay at most where a law holds beside that


def decide(search: Search, drifting: Mapping[Set, Drifting], tolerance: Mapping[str, float]) -> Decision:
    """Return the verdict on a finished search.

    ``drifting`` holds the base and other sets with a drift in time. Where that is more probable than the set without
    it, it becomes the fit of the set.
    """
    _complete(search)
    base = drifting[()].fit if () in drifting else None
    decision = _mind_backbones(search, _judged(search, _weighed(search, drifting), tolerance, base))
    if base is not None and () not in decision.drifts and _explains_nothing(search, base):
        decision = replace(decision, drift_probability=0.0)
    drifts = decision.model in decision.drifts and decision.model in search.fits
    if drifts and is_drift_small(search.fits[decision.model], tolerance):
        decision = replace(decision, has_small_drift=True)
    if decision.verdict is Verdict.AMBIGUOUS and decision.best not in decision.listed and not decision.unfinished:
        decision = replace(decision, listed=(decision.best, *decision.listed))
    if decision.verdict is Verdict.ADEQUATE or decision.mechanisms or decision.is_approximate:
        return decision
    if not np.isnan(decision.against):  # what does not hold at every amplitude names no mechanism either
        return decision
    _fit_parts(search, decision.model)  # the best with a drift may be another than that without one
    return _by_mechanism(search, decision)


def _explains_nothing(search: Search, drifting: Fit) -> bool:
    """Return whether the base with a drift leaves far more than noise of the samples, and next to all of the rest.

    Backbones may want a drift that the samples do not have; and where these hold what no set explains, as the line of
    another mode, the little that a drift takes of it passes for evidence.
    """
    return search.reduced(drifting) > _FAR and leaves_the_samples(search, drifting)


def _judged(search: Search, weighed: Decision, tolerance: Mapping[str, float], drifting: Fit | None) -> Decision:
    """Return the verdict: each question in turn, until one is answered."""
    if weighed.best == () and not is_unexplained(weighed.lack, tolerance):
        # what no noise would leave is forgiven by the tolerance alone
        by = AdequateBy.TOLERANCE if is_unexplained(weighed.lack, {}) else AdequateBy.STATISTICS
        return replace(weighed, verdict=Verdict.ADEQUATE, adequate_by=by)
    if weighed.p_missing > evidence.MISSING:
        return replace(
            weighed, best=(), probability=weighed.probabilities[()], verdict=Verdict.ADEQUATE,
            adequate_by=AdequateBy.STATISTICS,
        )  # fmt: skip
    named = _pruned(search, weighed, tolerance) if any(tolerance.values()) else weighed
    if named.verdict is Verdict.ADEQUATE:
        if drifting is None or named.drift_probability <= 0.5:
            return named
        return _with_drift(search, named, drifting, tolerance)
    if _is_of_drift(named) and drifting is not None and evidence.leaves_noise(search.batch, drifting):
        return replace(named, verdict=Verdict.UNEXPLAINED, below=())
    if named.lack.p_value < UNEXPLAINED:
        return departing(search, named)
    if named.drift_probability > NAMED:
        return replace(named, verdict=Verdict.UNEXPLAINED, below=())
    rivals = rivals_of(search, named.best, named.evidences, named.probabilities)
    if named.probability >= NAMED and named.drift_probability < DRIFT_POSSIBLE and not rivals:
        return replace(named, verdict=Verdict.FOUND, named_level=NamedLevel.LAW)
    if named.simulated is not None:
        # the set without what is below the tolerance is no explanation: what remains is told with it
        named = replace(weighed, below=named.below)
    is_one = named.best == named.above  # sets that differ by what is below the tolerance are one
    chances = as_one(
        named.below if is_one else (), {names: named.evidences[names].probability for names in named.ranked}
    )
    # what the sets do not hold of the probability is the drift's
    possible = listed(chances, 1.0 - sum(chances.values()))
    return replace(named, listed=(*possible, *(item for item in rivals if item not in possible)), rivals=rivals)


def _is_of_drift(decision: Decision) -> bool:
    """Return whether a drift is as certain as what is named, and no set beside it worth a word."""
    beside = [decision.probabilities.get(names, 0.0) for names in decision.drifts]
    alone = decision.drift_probability
    return alone > NAMED or (alone + sum(beside) > NAMED and decision.probability < 1.0 - NAMED < 0.5 < alone)


def _with_drift(search: Search, decision: Decision, drifting: Fit, tolerance: Mapping[str, float]) -> Decision:
    """Return the decision for the base with the drift that explains the records: no effect beside it is the best.

    It is adequate where what drifts is below the tolerance, as effects are that are not named.
    """
    search.fits[()] = drifting
    chances = {**decision.probabilities, (): decision.probabilities[()] + decision.drift_probability}
    evidences = {**decision.evidences, (): decision.evidences[DRIFT]}
    is_small = is_drift_small(drifting, tolerance)
    verdict, by = (Verdict.ADEQUATE, decision.adequate_by) if is_small else (Verdict.UNEXPLAINED, None)
    return replace(
        decision, verdict=verdict, adequate_by=by, below=(), best=(), simulated=None, probability=chances[()],
        probabilities=chances, evidences=evidences,
        ranked=((), *(names for names in decision.ranked if names)), drifts=(*decision.drifts, ()),
        lack=evidence.lack_of_fit(search.batch, drifting),
    )  # fmt: skip


def _weighed(search: Search, drifting: Mapping[Set, Drifting]) -> Decision:
    """Return the probabilities of all sets and of a drift with time, the verdict still open.

    A set is as probable as it is with and without a drift in time beside it; the base with a drift is a rival of its
    own. Every probability is multiplied by that of the library holding the answer. The p-value of the residuals bounds
    it: ``-e p ln p`` is the least Bayes factor for noise against whatever else may have left them [1]_.

    References
    ----------
    .. [1] Sellke T., Bayarri M. J., Berger J. O. (2001) Calibration of p values for testing precise null hypotheses.
       The American Statistician 55(1), 62-71. doi:10.1198/000313001300339950
    """
    p_missing = evidence.p_nothing_missing(search.fits, search.batch)
    fits, bonus = evidence.beside_drifts(search.fits, drifting)
    odds = odds_behind_bands(search.batch, fits)
    arguments = (fits, search.batch, len(search.candidates), bonus, search.variants, odds)
    evidences = evidence.probabilities(*arguments)
    if raised := odds_of_as_good(search.batch, fits, evidences, search.variants):
        odds = {names: odds.get(names, 0.0) + raised.get(names, 0.0) for names in {**odds, **raised}}
        arguments = (*arguments[:-1], odds)
        evidences = evidence.probabilities(*arguments)
    corrected = _corrected(search, fits, evidences, p_missing)
    if corrected.sets:
        leading = max(evidences, key=lambda names: evidences[names].log_posterior)
        evidences = evidence.probabilities(*arguments, corrected.shifts(leading))
    likelier = [
        names
        for names in drifting
        if names and evidences[(*names, *DRIFT)].log_posterior > evidences[names].log_posterior
    ]
    for names in drifting:
        if names:
            evidences[names] = _either(evidences[names], evidences[(*names, *DRIFT)])
    ranked = tuple(sorted(search.fits, key=lambda names: -evidences[names].log_posterior))
    best = ranked[0]
    # where the most probable set holds one more effect and no drift, a drift beside the smaller set imitates that
    drifts = tuple(names for names in likelier if best in likelier or not set(names) < set(best))
    # a drift without which a set leaves noise just as well makes up for nothing
    needed = {names for names in drifts if not evidence.leaves_noise(search.batch, search.fits[names])}
    search.fits.update({names: drifting[names].fit for names in drifts})
    evidences = doubted(search, evidences)
    lack = evidence.lack_of_fit(search.batch, search.fits[best])
    left, drift_probability = lack, 0.0
    if () in drifting:
        rival = evidences[DRIFT]
        drift_probability = rival.probability
        if rival.log_posterior > evidences[best].log_posterior:
            left = evidence.lack_of_fit(search.batch, drifting[()].fit)  # what explains the records best may be no set
    explained = library_holds(left.p_value)
    none_other = {
        names: is_none_other(
            search, names, names in needed,
            compensation(search, names) if len(names) > 1 and evidences[names].probability > _ASKED else 1.0,
        )
        for names in search.fits
    }  # fmt: skip
    probabilities = {names: explained * none_other[names] * evidences[names].probability for names in search.fits}
    return Decision(
        verdict=Verdict.AMBIGUOUS,
        best=best,
        probability=probabilities[best],
        p_missing=p_missing,
        lack=lack,
        probabilities=probabilities,
        evidences=evidences,
        ranked=ranked,
        drift_probability=explained * drift_probability,
        drifts=drifts,
        corrected=corrected,
        none_other=none_other,
    )


def _corrected(search: Search, fits: Mapping[Set, Fit], known: Mapping[Set, Evidence], p_missing: float) -> Corrected:
    """Return by how much Laplace's method is off, where the verdict rests on evidence at all."""
    if p_missing > evidence.MISSING:
        return Corrected(reason="evidence is Laplace's: the test of nothing being missing decides")
    best = min(fits.values(), key=lambda item: item.cost)
    if evidence.lack_of_fit(search.batch, best).p_value < UNEXPLAINED:
        return Corrected(reason="evidence is Laplace's: no set leaves noise, and the backbones decide")
    return corrections(fits, known, search.batch, search.budget)


def _either(first: Evidence, second: Evidence) -> Evidence:
    """Return the evidence of one or the other."""
    return Evidence(
        max(first.log_evidence, second.log_evidence),
        float(np.logaddexp(first.log_posterior, second.log_posterior)),
        first.probability + second.probability,
    )


def _pruned(search: Search, weighed: Decision, tolerance: Mapping[str, float]) -> Decision:
    """Return the decision on the effects above the tolerance; ``adequate`` where there are none."""
    if search.is_refuted(weighed.best):
        return weighed  # out of phase: what its effects change is not known by it
    kept, below = prune(search, weighed.best, tolerance)
    if not kept and not is_unexplained(weighed.lack, tolerance):
        below = () if weighed.drift_probability > 0.5 else weighed.best
        return replace(weighed, verdict=Verdict.ADEQUATE, adequate_by=AdequateBy.TOLERANCE, below=below)
    if not below or kept not in search.fits:
        return replace(weighed, below=below)
    # what is below the tolerance is said, not named: sets that differ by such effects only are one
    together = [names for names in search.fits if set(kept) <= set(names) <= {*kept, *below}]
    probability = float(sum(weighed.probabilities[names] for names in together))
    leaves_noise = evidence.leaves_noise(search.batch, search.fits[kept])
    simulated = None if leaves_noise else weighed.best
    return replace(weighed, best=kept, probability=probability, below=below, simulated=simulated)


def _by_mechanism(search: Search, decision: Decision) -> Decision:
    """Return the decision with the mechanisms of its sets, where these are exact; named where sets agree on no more.

    Which law of a mechanism it is may be open and the mechanism certain: then that is what is named, and the sets that
    remain possible are told beside it.
    """
    best = decision.model
    # what an exact set leaves is noise, whatever was thought of its size
    is_exact = decision.lack.p_value >= UNEXPLAINED
    noise = search.fits[best].cost if is_exact else search.count
    gaps = {names: float(np.sqrt(max(found.cost - noise, 0.0))) for names, found in search.fits.items()}
    elsewhere = max(1.0 - sum(decision.probabilities.values()) - decision.drift_probability, 0.0)
    joined = frozenset(search.mechanism_of(name) for names in (best, *decision.rivals) for name in names)
    mechanisms = missing_mechanisms(
        search, decision.probabilities, best, gaps, estimates_of(search.fits[best]), elsewhere,
        joined if decision.rivals else frozenset(),
    )  # fmt: skip
    known = replace(decision, mechanisms=mechanisms, undecided=_undecided(search, decision, mechanisms))
    if decision.named_level is NamedLevel.LAW and _is_like_another(search, decision):
        return without_laws(known)
    is_open = decision.verdict is Verdict.AMBIGUOUS and is_exact and not decision.unfinished
    is_against = best in decision.drifts and _backbones_disagree(search, best)
    is_doubtful = is_against or decision.drift_probability >= DRIFT_POSSIBLE
    if not is_open or is_doubtful or known.undecided or not is_told_apart(mechanisms):
        return known
    return replace(
        known, verdict=Verdict.FOUND, named_level=NamedLevel.MECHANISM, is_like=_is_like_another(search, known)
    )


def _undecided(search: Search, decision: Decision, mechanisms: Sequence[MissingMechanism]) -> tuple[str, ...]:
    """Return the certain mechanisms of which a rival of the best set holds no law."""
    held = [{search.mechanism_of(name) for name in names} for names in decision.rivals]
    certain = (item.mechanism for item in mechanisms if item.is_certain)
    return tuple(kind for kind in certain if any(not kinds & {*EITHER.get(kind, (kind,))} for kinds in held))


def _is_one_curve(search: Search, decision: Decision) -> bool:
    """Return whether laws of one mechanism take each other's doing back: two curves whose sum is any smooth third one.

    Then it is the sum that the records tell, and whether it is of these two laws they do not.
    """
    kinds = [search.mechanism_of(name) for name in decision.model]
    return len(set(kinds)) < len(kinds) and compensation(search, decision.model) > COMPENSATED


def _is_inexact_alone(search: Search, decision: Decision) -> bool:
    """Return whether what is named is likelier with something of its own mechanism that is below the tolerance.

    Then it is a law like that one. A spring that differs a little between the two sides is none of a symmetric law, and
    a damper that weakens and rises again at another place is none of a law that falls.
    """
    kinds = {search.mechanism_of(name) for name in decision.best}
    kinds |= _ONE_FORCE if kinds & _ONE_FORCE else set()
    kinds |= _RISING if _FALLING in kinds else set()
    alone = decision.probabilities.get(decision.best, 0.0)
    return alone < 0.5 * decision.probability and any(search.mechanism_of(name) in kinds for name in decision.below)


def _is_of_free_shape_and_drifts(search: Search, decision: Decision) -> bool:
    """Return whether a variant is named that needs a drift too small to matter: then a law like it needs none."""
    return decision.has_small_drift and not set(search.variants).isdisjoint(decision.best)


def _is_of_rare_laws(search: Search, decision: Decision) -> bool:
    """Return whether two laws are named that are rare, or a rare one beside another of its mechanism.

    One law that the library lacks is likelier than two of which each is rare: between them they have shapes for it.
    """
    kinds = [search.mechanism_of(name) for name in decision.model]
    rare = [name for name in decision.model if name in search.variants]
    return len(rare) > 1 or any(kinds.count(search.mechanism_of(name)) > 1 for name in rare)


def _is_bent_by_time(search: Search, decision: Decision) -> bool:
    """Return whether damping is to change with time by so much beside what is named that a law is at fault."""
    return decision.model in decision.drifts and damping_drift(search.fits[decision.model]) > _MOST_FADING


def _is_like_another(search: Search, decision: Decision) -> bool:
    """Return whether what is named may be a law like the best set, that the library lacks."""
    questions = _is_one_curve, _is_inexact_alone, _is_of_free_shape_and_drifts, _is_of_rare_laws, _is_bent_by_time
    return any(question(search, decision) for question in questions)


def without_laws(decision: Decision) -> Decision:
    """Return a decision that named laws with their mechanisms instead, where these are told apart."""
    if is_told_apart(decision.mechanisms):
        return replace(decision, named_level=NamedLevel.MECHANISM, is_like=True)
    return replace(decision, verdict=Verdict.AMBIGUOUS, named_level=None, listed=(decision.best,))


def _mind_backbones(search: Search, decision: Decision) -> Decision:
    """Return no law where a set explains the samples by a drift beside it, and leaves the backbones far off.

    An explanation of the samples has to hold at every amplitude; with a drift in time beside it, it may hold nowhere.
    Without one, backbones that disagree may be at fault: their errors are small and their mid-line may be lost. No set
    is exact then, and mechanisms are named where backbones with a departure tell them apart; unless a drift alone is
    what the records most probably show.
    """
    is_name = decision.named_level is NamedLevel.LAW
    is_open = decision.verdict is Verdict.AMBIGUOUS and not decision.is_approximate
    if not (is_name or is_open) or decision.ranked[0] not in decision.drifts or decision.drift_probability > 0.5:
        return decision
    if not _backbones_disagree(search, decision.ranked[0]):
        return decision
    inexact = departing(search, replace(decision, listed=()))  # what is listed of exact sets was weighed otherwise
    if inexact.verdict is Verdict.FOUND:
        return inexact
    # where nothing else remains, what is too improbable for a name is told as the explanation all the same
    if is_open and len(decision.listed) > 1:
        return decision
    left = level_chi_square(search.batch, search.fits[decision.ranked[0]], has_mid_line=False)
    return replace(decision, verdict=Verdict.AMBIGUOUS, named_level=None, listed=(decision.best,), against=left)


def _backbones_disagree(search: Search, names: Set) -> bool:
    """Return whether a set leaves the backbones far off; behind a filter they are not those of the motion.

    Of frequency and damping, which a drift beside it may have bent: none moves the mid-line.
    """
    batch = search.batch
    return not batch.is_behind_filter and level_chi_square(batch, search.fits[names], has_mid_line=False) >= AGREE


def _complete(search: Search) -> None:
    """Fit every subset of the most probable set: the tolerance and the table ask what each of its effects changes."""
    best: Set | None = None
    while best != search.best():
        best = search.best()
        _fit_parts(search, best)


def _fit_parts(search: Search, names: Set) -> None:
    """Fit every subset of a set, unless it lost the phase."""
    for size in range(0 if search.is_refuted(names) else len(names)):
        for rest in combinations(names, size):
            search.fit_set(rest)
