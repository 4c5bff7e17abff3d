"""The verdict: what the probabilities, the fit's own residuals, the tolerance and the rivals allow to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from ..effects import EITHER
from . import evidence
from .corrected_evidence import Corrected, corrections
from .curves import fit_on_levels
from .estimates import estimates_of
from .evidence import DRIFT, UNEXPLAINED, Drifting, Evidence, LackOfFit, is_unexplained
from .harmonic_odds import odds_behind_bands
from .joint_fit import Fit
from .mechanisms import Weighed, weigh
from .search import Search, Set
from .shares import estimates_with, missing_mechanisms, remainder_of
from .study import MissingMechanism, Remainder
from .tolerance import prune
from .verdict import MECHANISM_NAMED, AdequateBy, NamedLevel, Verdict

NAMED = 0.88  # probability from which a set is named
LISTED = 0.95  # probability that the sets listed as possible hold together
DRIFT_POSSIBLE = 0.05  # probability of a drift with time from which nothing is named
MOST_OF_THE_GAP = 0.85  # share of the gap that named mechanisms explain together: it shrinks at least sevenfold
_MOST_LISTED = 16
_IMITATES = (0.0, 0.03, 0.06, 0.15)  # how probable it is that a set of so many effects imitates what the library lacks
_HARDLY = 200.0  # gap in standard deviations of the noise beyond which that is rarer, in proportion
_WEIGHT_OF_NOISE = 0.1  # how much rarer residuals like noise are where the library lacks what is missing


@dataclass(frozen=True)
class Decision:
    """What is said, and what it rests on.

    Attributes
    ----------
    verdict : Verdict
        What is said.
    best : tuple of str
        The set it is said of.
    probability : float
        Of that set, with those that differ from it by effects below the tolerance.
    p_missing : float
        Of the test of "nothing is missing".
    lack : LackOfFit
        What the most probable set leaves.
    probabilities, evidences : mappings
        Of every set that was fitted.
    ranked : tuple of tuple of str
        The sets, most probable first.
    listed : tuple of tuple of str
        The sets that remain possible, where several do.
    below : tuple of str
        Effects below the tolerance.
    adequate_by : AdequateBy or None
        Why nothing is missing.
    drift_probability : float
        Of the base with a drift in time.
    drifts : tuple of tuple of str
        Sets whose fit holds a drift in time beside their effects.
    has_second_mode : bool
        Whether a second mode beats in the records.
    unfinished : tuple of tuple of str
        Sets that could explain the backbones, but whose fit to the records did not come to rest.
    is_approximate : bool
        Whether no set is exact, and their probabilities are those with a departure.
    mechanisms : tuple of MissingMechanism
        What may be missing by mechanism, most probable first.
    named_level : NamedLevel or None
        What is named; None unless the verdict is ``found``.
    remainder : tuple of Remainder
        What the best set leaves, where none is exact.
    is_single_valued : bool
        Whether what no set explains goes with the amplitude, and not with the record.
    on_backbones : Fit or None
        The best set fitted to the backbones, where no fit of it keeps the phase of the records; then it is believed.
    corrected : Corrected
        By how much Laplace's method was off, for the sets between which the verdict lies.
    """

    verdict: Verdict
    best: Set
    probability: float
    p_missing: float
    lack: LackOfFit
    probabilities: Mapping[Set, float]
    evidences: Mapping[Set, Evidence]
    ranked: tuple[Set, ...] = ()
    listed: tuple[Set, ...] = ()
    below: tuple[str, ...] = ()
    adequate_by: AdequateBy | None = None
    drift_probability: float = 0.0
    drifts: tuple[Set, ...] = ()
    has_second_mode: bool = False
    unfinished: tuple[Set, ...] = ()
    is_approximate: bool = False
    mechanisms: tuple[MissingMechanism, ...] = ()
    named_level: NamedLevel | None = None
    remainder: tuple[Remainder, ...] = ()
    is_single_valued: bool = True
    on_backbones: Fit | None = None
    corrected: Corrected = field(default_factory=Corrected)


def decide(search: Search, drifting: Mapping[Set, Drifting], tolerance: Mapping[str, float]) -> Decision:
    """Return the verdict on a finished search.

    ``drifting`` holds the base and other sets with a drift in time. Where that is more probable than the set without
    it, it becomes the fit of the set.
    """
    _complete(search)
    base = drifting[()].fit if () in drifting else None
    decision = _judged(search, _weighed(search, drifting), tolerance, base)
    if decision.verdict is Verdict.AMBIGUOUS and decision.best not in decision.listed and not decision.unfinished:
        decision = replace(decision, listed=(decision.best, *decision.listed))
    if decision.verdict is Verdict.ADEQUATE or decision.mechanisms:
        return decision
    return _by_mechanism(search, decision)


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
        return named
    if named.drift_probability > 0.5 and drifting is not None and _is_exact(search, drifting):
        return replace(named, verdict=Verdict.UNEXPLAINED, below=())
    if named.lack.p_value < UNEXPLAINED:
        return _departing(search, named)
    if named.drift_probability > 0.5:
        return replace(named, verdict=Verdict.UNEXPLAINED, below=())
    if named.probability >= NAMED and named.drift_probability < DRIFT_POSSIBLE:
        return replace(named, verdict=Verdict.FOUND, named_level=NamedLevel.LAW)
    chances = {names: named.evidences[names].probability for names in named.ranked}
    # what the sets do not hold of the probability is the drift's
    return replace(named, listed=_listed(chances, 1.0 - sum(chances.values())))


def _is_exact(search: Search, found: Fit) -> bool:
    """Return whether a fit leaves noise."""
    return evidence.lack_of_fit(search.batch, found).p_value >= UNEXPLAINED


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
    fits, bonus = dict(search.fits), {}
    for names, item in drifting.items():
        fits[(*names, *DRIFT)], bonus[(*names, *DRIFT)] = item.fit, item.bonus
    odds = odds_behind_bands(search.batch, fits)
    arguments = (fits, search.batch, len(search.candidates), bonus, search.variants, odds)
    evidences = evidence.probabilities(*arguments)
    corrected = _corrected(search, fits, evidences, p_missing)
    if corrected.sets:
        leading = max(evidences, key=lambda names: evidences[names].log_posterior)
        evidences = evidence.probabilities(*arguments, corrected.shifts(leading))
    drifts = tuple(
        names
        for names in drifting
        if names and evidences[(*names, *DRIFT)].log_posterior > evidences[names].log_posterior
    )
    for names in drifting:
        if names:
            evidences[names] = _either(evidences[names], evidences[(*names, *DRIFT)])
    search.fits.update({names: drifting[names].fit for names in drifts})
    ranked = tuple(sorted(search.fits, key=lambda names: -evidences[names].log_posterior))
    best = ranked[0]
    lack = evidence.lack_of_fit(search.batch, search.fits[best])
    left, drift_probability = lack, 0.0
    if () in drifting:
        rival = evidences[DRIFT]
        drift_probability = rival.probability
        if rival.log_posterior > evidences[best].log_posterior:
            left = evidence.lack_of_fit(search.batch, drifting[()].fit)  # what explains the records best may be no set
    explained = library_holds(left.p_value)
    probabilities = {
        names: explained * is_none_other(search, names) * evidences[names].probability for names in search.fits
    }
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


def least_bayes_factor(p_value: float) -> float:
    """Return the least Bayes factor for the null hypothesis that a p-value allows: ``-e p ln p``, 1 from 1/e on."""
    p = min(max(p_value, 1e-300), float(np.exp(-1.0)))
    return float(-np.exp(1.0) * p * np.log(p))


def library_holds(p_value: float) -> float:
    """Return the probability that the library holds what is missing, by the p-value of the best set's residuals."""
    none = evidence.PRIOR_NONE * _WEIGHT_OF_NOISE / least_bayes_factor(p_value)
    return (1.0 - evidence.PRIOR_NONE) / (1.0 - evidence.PRIOR_NONE + none)


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
    return replace(weighed, best=kept, probability=probability, below=below)


def _departing(search: Search, decision: Decision) -> Decision:
    """Return the decision where no set is exact: sets are weighed with a departure, and mechanisms named, no law.

    What goes with the time since the release, or differs between releases at the same amplitude, is no law: then the
    records are unexplained, and so where what is most probable leaves most of the gap.
    """
    weighed = weigh(search)
    if weighed is None:
        return replace(decision, verdict=Verdict.UNEXPLAINED, below=())
    ranked = weighed.ranked()
    best = next((names for names in ranked if _is_kept(search, weighed, names)), ())
    mechanisms = _told(search, weighed, best)
    certain = certain_sets(search, mechanisms, ranked)
    simpler = next((names for names in certain if weighed.gaps[names] <= 1.0 - MOST_OF_THE_GAP), None)
    if simpler is not None and simpler != best and _is_kept(search, weighed, simpler):
        # what is only possible beside the certain takes nothing of what these explain alone
        best, mechanisms = simpler, _told(search, weighed, simpler)
    lack = evidence.lack_of_fit(search.batch, search.fits[best])
    if search.is_refuted(best):
        lack = replace(lack, share=float("nan"))  # of a motion out of phase
    known = replace(
        decision,
        best=best,
        probability=weighed.probabilities[best],
        probabilities=weighed.probabilities,
        lack=lack,
        below=(),
        drift_probability=weighed.drift_probability,
        mechanisms=mechanisms,
        remainder=remainder_of(weighed, best),
        is_approximate=True,
        is_single_valued=weighed.is_law,
        on_backbones=_on_backbones(search, best, weighed) if search.is_refuted(best) else None,
    )
    if not weighed.is_law or weighed.drift_probability > 0.5:
        return replace(known, verdict=Verdict.UNEXPLAINED)
    if weighed.gaps[best] > 1.0 - MOST_OF_THE_GAP:
        unfinished = _unfinished(search, weighed, decision.ranked)
        if unfinished:  # what was not fitted to its end is not refuted
            return replace(known, verdict=Verdict.AMBIGUOUS, listed=unfinished[:_MOST_LISTED], unfinished=unfinished)
        return replace(known, verdict=Verdict.UNEXPLAINED)
    if is_told_apart(mechanisms) and weighed.drift_probability < DRIFT_POSSIBLE:
        return replace(known, verdict=Verdict.FOUND, named_level=NamedLevel.MECHANISM)
    # the base with a departure is no explanation, and not listed as one
    sets = {names: chance for names, chance in weighed.probabilities.items() if names and names in search.fits}
    return replace(known, verdict=Verdict.AMBIGUOUS, listed=_listed(sets, 1.0 - sum(sets.values())))


def _is_kept(search: Search, weighed: Weighed, names: Set) -> bool:
    """Return whether a set can be simulated over the records: fitted to these unless the likeliest were refuted."""
    if names not in search.fits and search.is_refuted(search.best()):
        return search.note_refuted(names, weighed.departing[names].state.eta) is not None
    return search.fit_set(names) is not None


def _on_backbones(search: Search, best: Set, weighed: Weighed) -> Fit | None:
    """Return a set fitted to the backbones of all specimens: from its proposals, and where it departs least."""
    begun = [(weighed.departing[best].state.eta, search.fits[best].state.own[:, :2])]
    if best in search.proposals:
        begun += [(eta, own) for _, eta, own in search.proposals[best].starts]
    return fit_on_levels(search.batch, search.layout(best), begun)


def _told(search: Search, weighed: Weighed, best: Set) -> tuple[MissingMechanism, ...]:
    """Return the mechanisms with what the laws of one set explain."""
    estimates = estimates_with(search, best, weighed.departing[best])
    return missing_mechanisms(search, weighed.probabilities, best, weighed.gaps, estimates)


def certain_sets(search: Search, mechanisms: Sequence[MissingMechanism], ranked: Sequence[Set]) -> list[Set]:
    """Return the sets that hold laws of every mechanism that is certain and of no other, most probable first."""
    certain = [item.mechanism for item in mechanisms if item.probability >= MECHANISM_NAMED]
    groups = [set(EITHER.get(kind, (kind,))) for kind in certain]
    held = {names: {search.mechanism_of(name) for name in names} for names in ranked}
    return [
        names
        for names, kinds in held.items()
        if names and all(group & kinds for group in groups) and kinds <= set().union(*groups)
    ]


def _unfinished(search: Search, weighed: Weighed, ranked: Sequence[Set]) -> tuple[Set, ...]:
    """Return the sets whose fit to the records did not come to rest although they explain the backbones.

    Sets so improbable by their backbones that they were not weighed are none of these.
    """
    explaining = [names for names, gap in weighed.gaps.items() if gap <= 1.0 - MOST_OF_THE_GAP]
    return tuple(names for names in ranked if names in explaining and search.is_open(names))


def is_told_apart(mechanisms: Sequence[MissingMechanism]) -> bool:
    """Return whether mechanisms can be named: some are certain, and what they explain is most of the gap."""
    named = [item for item in mechanisms if item.is_certain]
    return bool(named) and sum(item.share_of_gap for item in named) >= MOST_OF_THE_GAP


def _by_mechanism(search: Search, decision: Decision) -> Decision:
    """Return the decision with the mechanisms of its sets, where these are exact."""
    best, count = decision.best, search.count
    gaps = {names: float(np.sqrt(max(found.cost - count, 0.0))) for names, found in search.fits.items()}
    estimates = estimates_of(search.fits[best])
    return replace(decision, mechanisms=missing_mechanisms(search, decision.probabilities, best, gaps, estimates))


def is_none_other(search: Search, names: Set) -> float:
    """Return the probability that a set which leaves noise is not the imitation of something the library lacks.

    The more effects a set has, the less probable it is beforehand, and the more it can imitate; but what explains a gap
    of thousands of standard deviations to the noise is hardly ever an imitation.
    """
    size = min(len(names), len(_IMITATES) - 1)
    gap = float(np.sqrt(max(search.fits[()].cost - search.fits[names].cost, 0.0)))
    imitates = _IMITATES[size] * min(1.0, _HARDLY / max(gap, 1.0))
    prior = evidence.PRIOR_OF_SIZE[size]
    return prior / (prior + evidence.PRIOR_NONE * imitates)


def _listed(chances: Mapping[Set, float], total: float) -> tuple[Set, ...]:
    """Return the most probable sets that together with ``total`` hold most of the probability."""
    listed: list[Set] = []
    for names in sorted(chances, key=lambda names: -chances[names]):
        listed.append(names)
        total += chances[names]
        if total > LISTED or len(listed) >= _MOST_LISTED:
            break
    return tuple(listed)


def mind_second_mode(decision: Decision) -> Decision:
    """Return what can be said of records in which a second mode beats.

    Its line is no effect of a single mode, and the estimate of the noise holds it: "nothing is missing" is not true,
    and a name rests on a misfit that the second mode may have made.
    """
    if decision.verdict is Verdict.ADEQUATE:
        return replace(decision, has_second_mode=True, verdict=Verdict.UNEXPLAINED, adequate_by=None)
    if decision.verdict is Verdict.FOUND:
        return replace(
            decision, has_second_mode=True, verdict=Verdict.AMBIGUOUS, named_level=None, listed=(decision.best,)
        )
    return replace(decision, has_second_mode=True)


def _complete(search: Search) -> None:
    """Fit every subset of the most probable set: the tolerance and the table ask what each of its effects changes."""
    best: Set | None = None
    while best != search.best():
        best = search.best()
        for size in range(0 if search.is_refuted(best) else len(best)):
            for rest in combinations(best, size):
                search.fit_set(rest)
