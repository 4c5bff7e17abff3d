"""The verdict: what the probabilities, the fit's own residuals, the tolerance and the rivals allow to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from .._common.checks import FloatArray
from . import evidence, starts
from .batch import Batch
from .curves import curve, level_chi_square, on_levels, simulate
from .evidence import Evidence, LackOfFit
from .joint_fit import Fit, State
from .locate import mean_gap
from .search import Search, Set
from .study import Candidate

MISSING = 0.01  # p-value of "nothing is missing" below which something is
NAMED = 0.88  # probability from which a set is named
LISTED = 0.95  # probability that the sets listed as possible hold together
DRIFT_POSSIBLE = 0.05  # probability of a drift with time from which nothing is named
UNEXPLAINED = 1e-4  # p-value of the best set's residuals below which no set explains the records
_MOST_LISTED = 16
_LOOKED_AT = 150
_PRIOR_NONE = 0.05  # prior probability that the library does not hold what is missing
_IMITATES = (0.0, 0.01, 0.05, 0.3)  # how probable it is that a set of so many effects imitates what the library lacks
_WEIGHT_OF_NOISE = 0.1  # how much rarer residuals like noise are where the library lacks what is missing
_INDEPENDENT = 8.0  # the effects of the library count as so many independent attempts


@dataclass
class Decision:
    """What is said, and what it rests on."""

    verdict: str
    best: Set
    probability: float
    p_missing: float
    lack: LackOfFit
    probabilities: dict[Set, float]
    evidences: dict[Set, Evidence]
    listed: tuple[Set, ...] = ()
    below: tuple[str, ...] = ()
    adequate_by: str | None = None
    drift_probability: float = 0.0
    has_second_mode: bool = False
    is_approximate: bool = False
    left_by_best: float = 0.0


def p_nothing_missing(search: Search) -> float:
    """Return the p-value of the base model: by what its residuals hold, and by what any one effect would gain."""
    from scipy.stats import chi2

    base = search.fits[()]
    count = sum(w.size for w in search.batch.deciding)
    lowest = min(item.cost for item in search.fits.values())
    # where the noise was taken for too small, gains count in its true size; where for too large, too
    scale = lowest / count if search.batch.has_records else max(lowest / count, 1.0)
    p_gain = 1.0
    for names, found in search.fits.items():
        if len(names) == 1:
            gain = max(base.cost - found.cost, 0.0) / scale
            degrees = found.layout.free.size - base.layout.free.size
            p_gain = min(p_gain, float(chi2.sf(gain, degrees)))
    p_gain = min(1.0, _INDEPENDENT * p_gain)
    return min(1.0, 2.0 * min(p_gain, evidence.lack_of_fit(search.batch, base).p_value))


def decide(
    search: Search, drifting: Fit | None, drift_key: Set, tolerance: Mapping[str, float], bonus: float = 0.0
) -> Decision:
    """Return the verdict on a finished search."""
    _complete(search)
    fits = dict(search.fits)
    if drifting is not None:
        fits[drift_key] = drifting
    count = len(search.candidates)
    evidences = evidence.probabilities(fits, search.batch, count, {drift_key: bonus})
    ranked = [names for names in search.ranked() if names in evidences]
    best = ranked[0]
    lack = evidence.lack_of_fit(search.batch, search.fits[best])
    left = lack
    if drifting is not None and evidences[drift_key].log_posterior > evidences[best].log_posterior:
        left = evidence.lack_of_fit(search.batch, drifting)  # what explains the records best may be no set
    p = min(max(left.p_value, 1e-300), float(np.exp(-1.0)))
    none = _PRIOR_NONE * _WEIGHT_OF_NOISE / (-np.exp(1.0) * p * np.log(p))
    explained = (1.0 - _PRIOR_NONE) / (1.0 - _PRIOR_NONE + none)
    probabilities = {names: explained * _is_none_other(names) * evidences[names].probability for names in search.fits}
    drift_probability = explained * evidences[drift_key].probability if drifting is not None else 0.0
    p_missing = p_nothing_missing(search)
    decision = Decision(
        "ambiguous", best, probabilities[best], p_missing, lack, probabilities, evidences,
        drift_probability=drift_probability,
    )  # fmt: skip
    if best == () and not _is_unexplained(lack, tolerance):
        decision.verdict, decision.adequate_by = "adequate", "statistics"
        return decision
    if p_missing > MISSING:
        decision.best, decision.probability = (), probabilities[()]
        decision.verdict, decision.adequate_by = "adequate", "statistics"
        return decision
    if any(tolerance.values()):
        kept, below = prune(search, best, tolerance)
        if not kept and not _is_unexplained(evidence.lack_of_fit(search.batch, search.fits[best]), tolerance):
            decision.verdict, decision.adequate_by = "adequate", "tolerance"
            decision.below = () if drift_probability > 0.5 else best
            return decision
        decision.below = below
        if below and kept in search.fits:
            # what is below the tolerance is said, not named: sets that differ by such effects only are one
            decision.best = kept
            together = [names for names in search.fits if set(kept) <= set(names) <= {*kept, *below}]
            decision.probability = float(sum(probabilities[names] for names in together))
    if drift_probability > 0.5:
        decision.verdict, decision.below = "unexplained", ()
        return decision
    if lack.p_value < UNEXPLAINED:
        # no set is exact: sets that follow the backbones within the tolerance cannot be told apart by what matters
        close = within_tolerance(search, ranked, tolerance) if any(tolerance.values()) else []
        if not close:
            decision.verdict = "unexplained"
            return decision
        chances = by_model_error(search, close)
        decision.best = max(chances, key=lambda names: chances[names])
        decision.probability, decision.below = chances[decision.best], ()
        decision.probabilities = {names: chances.get(names, 0.0) for names in search.fits}
        left = evidence.lack_of_fit(search.batch, search.fits[decision.best])
        decision.is_approximate, decision.left_by_best = True, left.share
        decision.listed = _listed(chances, drift_probability)
        return decision
    if decision.probability >= NAMED and drift_probability < DRIFT_POSSIBLE:
        decision.verdict = "found"
        return decision
    total = evidences[drift_key].probability if drifting is not None else 0.0
    decision.listed = _listed({names: evidences[names].probability for names in ranked}, total)
    return decision


def _is_none_other(names: Set) -> float:
    """Return the probability that a set which leaves noise is not the imitation of something the library lacks.

    The more effects a set has, the less probable it is beforehand, and the more it can imitate.
    """
    size = min(len(names), len(_IMITATES) - 1)
    prior = evidence.PRIOR_OF_SIZE[size]
    return prior / (prior + _PRIOR_NONE * _IMITATES[size])


def _listed(chances: Mapping[Set, float], total: float) -> tuple[Set, ...]:
    """Return the most probable sets that together with ``total`` hold most of the probability."""
    listed: list[Set] = []
    for names in sorted(chances, key=lambda names: -chances[names]):
        listed.append(names)
        total += chances[names]
        if total > LISTED or len(listed) >= _MOST_LISTED:
            break
    return tuple(listed)


def by_model_error(search: Search, close: Sequence[Set]) -> dict[Set, float]:
    """Return the probability of each of some sets, none of which is exact, that it is the best description.

    What a set leaves is taken for a model error of unknown size that is alike in all specimens and smooth over
    amplitude: it has as many independent pieces as there are levels, however many samples show it. The logarithm of
    the evidence is ``-n/2 log chi^2`` with Schwarz' price for each parameter.
    """
    pieces = float(np.asarray(search.batch.backbones["level"]).size)
    logs = []
    for names in close:
        found = search.fits[names]
        price = 0.5 * found.layout.free.size * np.log(pieces)
        prior = evidence.log_prior(len(names), len(search.candidates))
        logs.append(prior - price - 0.5 * pieces * float(np.log(found.cost)))
    weights = np.exp(np.array(logs) - max(logs))
    return dict(zip(close, (weights / weights.sum()).tolist(), strict=True))


def mind_second_mode(decision: Decision) -> None:
    """Take back what cannot be said of records in which a second mode beats.

    Its line is no effect of a single mode, and the estimate of the noise holds it: "nothing is missing" is not true,
    and a name rests on a misfit that the second mode may have made.
    """
    decision.has_second_mode = True
    if decision.verdict == "adequate":
        decision.verdict, decision.adequate_by = "unexplained", None
    elif decision.verdict == "found":
        decision.verdict, decision.listed = "ambiguous", (decision.best,)


def _complete(search: Search) -> None:
    """Fit the most probable set without each of its effects, because the tolerance asks what each of them changes."""
    best: Set | None = None
    while best != search.best():
        best = search.best()
        for rest in combinations(best, max(len(best) - 1, 0)):
            search.fit_set(rest)


def _is_unexplained(lack: LackOfFit, tolerance: Mapping[str, float]) -> bool:
    """Return whether residuals are no noise, and larger than the tolerance on the waveform."""
    limit = tolerance.get("waveform", 0.0)
    return lack.p_value < UNEXPLAINED and not lack.share < limit


def within_tolerance(search: Search, ranked: Sequence[Set], tolerance: Mapping[str, float]) -> list[Set]:
    """Return the smallest sets that describe the backbones within the tolerance, or as well as the best of these.

    A set does when its curves follow the measured ones within the tolerance and twice their errors. Then so does every
    set whose curves follow those of the likeliest such set: the two cannot be told apart by what matters.
    """
    curves: dict[Set, FloatArray] = {}
    errors: dict[Set, FloatArray] = {}
    backbones = search.batch.backbones.sel(specimen=list(search.batch.specimens))
    looked_at = sorted((names for names in ranked[:_LOOKED_AT] if names), key=len)
    close: list[Set] = []
    for names in looked_at:
        found = search.fits[names]
        brought = on_levels(search.batch, found, free_effects=found.layout.free.size > 0)
        simulated = simulate(search.batch, brought)
        mean, errors[names] = mean_gap(backbones, simulated)
        curves[names] = np.nanmean(np.asarray(simulated["value"]), axis=0)
        if _is_within(search.batch, mean, errors[names], curves[names], tolerance):
            close.append(names)
    if not close:
        return []
    leader = min(close, key=ranked.index)

    def is_alike(names: Set) -> bool:
        return _is_within(search.batch, curves[names] - curves[leader], errors[leader], curves[leader], tolerance)

    alike = [names for names in looked_at if names in close or is_alike(names)]
    return [names for names in alike if not any(set(other) < set(names) for other in alike)]


def _is_within(
    batch: Batch, gap: FloatArray, error: FloatArray, value: FloatArray, tolerance: Mapping[str, float]
) -> bool:
    """Return whether a gap (observable, level) is nowhere larger than the tolerance and twice its error."""
    for o, key in enumerate(str(name) for name in batch.backbones["observable"].values):
        if key in tolerance:
            excess = np.abs(gap[o]) - 2.0 * error[o] - tolerance[key] * np.abs(value[o])
            unknown = 1.0 if np.isnan(value[o]).any() else 0.0
            if np.any(np.nan_to_num(excess, nan=unknown) > 0.0):
                return False
    return True


def prune(search: Search, best: Set, tolerance: Mapping[str, float]) -> tuple[Set, Set]:
    """Return the effects of a set that change the backbones by more than the tolerance, and those that do not."""
    kept = best
    below: list[str] = []
    while kept:
        changes = {}
        for name in kept:
            rest = tuple(other for other in kept if other != name)
            if rest not in search.fits:
                search.fit_set(rest)
            if rest in search.fits:
                changes[name] = relative_change(search.batch, search.fits[kept], search.fits[rest])
        small = [
            name
            for name, change in changes.items()
            if all(change.get(key, 0.0) < limit for key, limit in tolerance.items() if key in change)
        ]
        if not small:
            break
        weakest = min(small, key=lambda name: max(changes[name].values()))
        below.append(weakest)
        kept = tuple(other for other in kept if other != weakest)
    return kept, tuple(below)


def relative_change(batch: Batch, larger: Fit, smaller: Fit) -> dict[str, float]:
    """Return the largest relative change of frequency and damping over the levels between two fits."""
    levels = np.asarray(batch.backbones["level"])
    first = on_levels(batch, larger)
    second = on_levels(batch, smaller, free_effects=smaller.layout.free.size > 0)
    worst = {"frequency": 0.0, "damping": 0.0}
    for r, term in enumerate(batch.levels):
        inside = levels[(levels >= term.levels[0] * 0.999) & (levels <= term.levels[-1] * 1.001)]
        a, b = (curve(item, item.parameters(r), inside) for item in (first, second))
        for row, key in ((0, "frequency"), (1, "damping")):
            with np.errstate(invalid="ignore", divide="ignore"):
                change = np.abs(a[row] - b[row]) / np.abs(a[row])
            worst[key] = max(worst[key], float(np.nanmax(change)) if np.isfinite(change).any() else np.inf)
    return worst


def candidates_of(search: Search, decision: Decision) -> tuple[Candidate, ...]:
    """Return the table of all sets, most probable first, each with what became of it and why."""
    rows = []
    count = sum(w.size for w in search.batch.deciding)
    best_cost = search.fits[decision.best].cost
    for names, found in search.fits.items():
        probability = decision.probabilities[names]
        reduced = float(found.chi_square.sum() / count)
        status = "best" if names == decision.best else "possible" if probability > 0.01 else "rejected"
        rows.append(
            Candidate(
                effects=names,
                probability=probability,
                log_evidence=decision.evidences[names].log_evidence,
                reduced_chi_square=reduced,
                backbone_chi_square=level_chi_square(search.batch, on_levels(search.batch, found))
                if status != "rejected" or len(names) < 2
                else float("nan"),
                status=status,
                reason=_reason(names, found, decision, search, best_cost, status),
                parameters=estimates_of(found),
            )
        )
    rows.sort(key=lambda item: -item.probability)
    failed = [
        Candidate(names, 0.0, float("nan"), float("nan"), float("nan"), "failed", reason)
        for names, reason in search.failed.items()
    ]
    return (*rows, *failed)


def _reason(names: Set, found: Fit, decision: Decision, search: Search, best_cost: float, status: str) -> str:
    if status == "best":
        return "the most probable set"
    extra = set(names) - set(decision.best)
    gain = best_cost - found.cost
    if set(decision.best) < set(names):
        return f"adds {', '.join(sorted(extra))}, which improves chi-square by {max(gain, 0.0):.3g} only"
    if set(names) < set(decision.best):
        lost = ", ".join(sorted(set(decision.best) - set(names)))
        return f"without {lost} chi-square is larger by {-gain:.3g}"
    if status == "possible":
        return "explains the records about as well"
    if gain < 0.0:
        return f"chi-square is larger by {-gain:.3g}"
    return f"chi-square is smaller by {gain:.3g}, less than its extra parameters are worth"


def estimates_of(found: Fit) -> dict[str, tuple[float, float]]:
    """Return value over the batch and standard error of the effects' parameters."""
    q = found.layout.free.size
    if q == 0:
        return {}
    values, slopes = found.layout.physical(found.state.eta, np.zeros(q), 0.0)
    variance = slopes @ np.nan_to_num(found.covariance) @ slopes.T
    errors = np.sqrt(np.maximum(np.diag(variance), 0.0))
    rows = zip(found.layout.names, values, errors, strict=True)
    return {name: (float(value), float(error)) for name, value, error in rows}


def without(found: Fit, names: Sequence[str]) -> Fit:
    """Return a fit with some effects turned off, everything else as it was."""
    eta = found.state.eta.copy()
    for name in names:
        where = starts.positions(found.layout, name)
        eta[where[0]] = 0.0
    return replace(found, state=State(eta, found.state.own))
