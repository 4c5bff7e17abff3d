"""Locate, name, add, verify, decide: the search for a missing effect in one call."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from .._common.checks import InputError
from .._common.threads import short_turns
from ..effects import Effect
from ..inference.options import Sampling
from ..measurement.conditioning.conditioned import ConditionedRecord
from ..measurement.options import Measuring
from ..measurement.reading.record import Record
from ..oscillator import Oscillator
from ..simulation.machine_code import define, is_compiled
from .checks import rivals
from .checks.ambient import ambient_check
from .checks.second_mode import second_mode_check
from .checks.verify import MOST_HELD_OUT, Verification, verify
from .deciding.decide import decide
from .deciding.decision import Decision
from .deciding.imitations import is_none_other
from .deciding.inexact import certain_sets
from .deciding.minded import mind_bent_sensor, mind_second_mode, mind_what_moves_on
from .disturbances.undisturbed import Undisturbed, in_the_way, undisturbed, with_drifts
from .drift.drift_fits import drift_alone
from .fitting.curves import simulate
from .fitting.descent import is_heavy
from .force_curves.force_curve import force_curves
from .outcome import Outcome, checks_of
from .planning.plan import plan_tests
from .results.curve_records import ForceCurves
from .results.design import Contender, Plan, contender, present_design
from .results.entries import Check, EvidenceBasis
from .results.extend import Inference, infer
from .results.locate import where_different
from .results.portraits import portraits
from .results.study import Study
from .results.verdict import NamedLevel, Verdict
from .sets.fitted_sets import FittedSets
from .sets.known_sets import BUDGET, Progress
from .sets.question import Question, ask, is_of_records
from .sets.search import Search
from .weighing.evidence import UNEXPLAINED, Drifting, leaves_noise
from .wording import plan_words, verdict_words, words
from .wording.candidate_table import candidates_of
from .wording.detectable import detectable
from .wording.scatter_words import scatter_of

_QUICK_BUDGET = 0.5
_LEFT = 0.3  # of the gap, that force curves leave at most where they are said to explain the records


def find_missing_effect(
    oscillator: Oscillator,
    data: xr.Dataset | Sequence[Record] | Sequence[ConditionedRecord],
    *,
    candidates: Sequence[str | Effect] | None = None,
    max_effects: int = 3,
    tolerance: Mapping[str, float] | float | None = None,
    held_out: int | None = None,
    quick: bool = False,
    step: str = "metropolis",
    draws: int = 2000,
    tune: int = 1000,
    chains: int = 4,
    random_seed: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    band: tuple[float, float] | None = None,
    start: float | None = None,
    stop: float | None = None,
    levels: int | ArrayLike | None = None,
    strict: bool = False,
    floor: float | None = None,
) -> Study:
    """Find what a model lacks to explain a batch of free decays, and how probable that is.

    Parameters
    ----------
    oscillator : Oscillator
        The model that is questioned: mass and the effects it holds already.
    data : sequence of Record or ConditionedRecord, or xarray.Dataset
        Records, one per specimen; or backbones at levels with standard errors. Records tell more: their
        samples tell apart what backbones cannot.
    candidates : sequence of str or Effect, optional
        Effects that may be missing, by name or, of your own, as `Effect`; by default all of the library that fit the
        unit of the motion, but for variants (`Effect.variant_of`) and what backbones do not show
        (`Effect.only_if_named`), which are looked for where these explain less or nothing.
    max_effects : int, default 3
        Largest number of effects that may be missing together.
    tolerance : mapping of str to float, or 0, optional
        Relative change of ``frequency`` and ``damping``, and change of the ``offset`` of the mid-line as a share of the
        amplitude, below which an effect does not matter; by default 0.001, 0.03 and 0.01. With 0 statistics alone
        decide.
    held_out : int, optional
        At most so many specimens are left out in turn; 0 skips the verification. By default 6.
    quick : bool, default False
        Whether to take parameters from the curvature of the fit instead of sampling.
    step, draws, tune, chains
        As in `sample`.
    random_seed : int, optional
        Of everything random; drawn and recorded by default.
    progress : callable, optional
        Called with the stage and the share of it that is done.
    band, start, stop, levels
        As in `condition` and `backbones_at_levels`, for records.
    strict : bool, default False
        Whether one record that cannot be used ends it; else it is left out, as long as half of them remain.
    floor : float, optional
        As in `condition`.

    Returns
    -------
    Study
        Verdict, probabilities of all sets, parameters, the gap before and after.

    Raises
    ------
    InputError
        Data that cannot be used, unknown effects, a tolerance that is not a number.

    See Also
    --------
    write_study : the report.
    diagnose_many : many structures at once.

    Notes
    -----
    Every set is fitted to all specimens at once: each has its own stiffness, damping, release and sensor offset; the
    effects are shared up to a scatter, which is inferred. The waveforms decide, by way of the backbones and the turning
    points; evidence is Laplace's, with the level of the noise left free, corrected by importance sampling for the sets
    between which the verdict lies. See ``docs/naming.md``.
    """
    started = time.perf_counter()
    say = progress or (lambda _stage, _share: None)
    seed = int(np.random.default_rng().integers(2**31)) if random_seed is None else int(random_seed)
    if not is_compiled():
        say("compiling the simulator, once on this computer: a minute or two", float("nan"))
        define()
    say("reading backbones", 0.0)
    given_levels = None if levels is None else np.asarray(levels).tolist()
    measuring = Measuring(band, start, stop, given_levels, strict=strict, floor=floor)
    # The matrices are small: several threads of linear algebra would wait for each other, and round differently.
    with threadpool_limits(1), short_turns():
        question = ask(
            oscillator, data, candidates=candidates, max_effects=max_effects, tolerance=tolerance, measuring=measuring
        )
        early = (in_the_way, drift_alone) if is_of_records(data) else ()
        search = _searched(question, *early, quick=quick, say=say)
        known = Undisturbed(question, search)
        if is_of_records(data):
            say("looking for what disturbs the records", 0.0)
            known = undisturbed(
                question, search, data, measuring, partial(_searched, quick=quick, say=say), rivals.drifting_sets
            )
        say("deciding", 0.0)
        if known.drifting is None:
            known = with_drifts(known, rivals.drifting_sets)
        question = known.question
        outcome = _decided(known)
        most = MOST_HELD_OUT if held_out is None else int(held_out)
        verification = verify(outcome.judged, outcome.base, outcome.extended, most, seed, say)
        curves = _curves(question, outcome, verification, most, seed, quick, say)
        # what is sampled are backbones: of filtered records they are not those of the motion
        is_sampled = not (quick or question.batch.is_behind_filter)
        sampling = Sampling(draws, tune, chains, step, seed) if is_sampled else None
        if sampling is not None:
            say("sampling", 0.0)
        inference = infer(outcome.judged, outcome.model, sampling, progress)
    asked = {
        "candidates": list(question.candidates), "max_effects": question.max_effects,
        "tolerance": dict(question.tolerance), "held_out": most, "quick": quick, "step": step, "draws": draws,
        "tune": tune, "chains": chains, "band": band, "start": start,
        "stop": stop, "levels": given_levels, "strict": strict, "floor": floor,
    }  # fmt: skip
    plan = None if quick else _planned(question, outcome, seed, say)
    study = _study(question, outcome, verification, inference, asked, plan, seed, started)
    if curves is None:
        return study
    study = replace(study, force_curves=curves)
    if not (curves.is_possible and curves.p_value >= UNEXPLAINED and not curves.share_left > _LEFT):
        return study
    is_drift_exact = outcome.drifting is not None and leaves_noise(question.batch, outcome.drifting)
    return replace(study, sentence=verdict_words.with_forces(study.sentence, is_drift_exact=is_drift_exact))


def _curves(
    question: Question, outcome: Outcome, verification: Verification, most: int, seed: int, quick: bool, say: Progress
) -> ForceCurves | None:
    """Return as forces what is left where no law is exact: beside what is named or certain, or beside the base."""
    search, decision = outcome.search, outcome.decision
    held_out = verification.held_out_specimens
    is_open = decision.verdict is Verdict.AMBIGUOUS and decision.is_approximate
    is_named = decision.named_level is NamedLevel.MECHANISM and decision.is_approximate
    if is_open:  # a set that holds laws of what is certain and of nothing else stands for that
        is_named = bool(certain_sets(search, decision.mechanisms, (decision.model,)))
    if is_named:
        start, gap = outcome.model, float("nan") if held_out is None else held_out.after
    elif is_open or (
        decision.verdict is Verdict.UNEXPLAINED and not (decision.has_second_mode or decision.is_moved_on)
    ):
        start, gap = outcome.base, float("nan") if held_out is None else held_out.before
    else:
        return None
    if quick and is_heavy(start.layout):
        return None  # minutes where each simulation takes a second
    say("looking for force curves", 0.0)
    remembering = [
        found for found in search.fits.values() if any(effect.n_states for effect in found.layout.oscillator.effects)
    ]
    return force_curves(question.batch, start, remembering, outcome.drifting, gap, most, seed)


def _searched(
    question: Question,
    is_disturbed: Callable[[FittedSets], object | None] | None = None,
    is_drifting: Callable[[FittedSets], Drifting | None] | None = None,
    *,
    quick: bool,
    say: Progress,
) -> Search:
    """Return the search over sets of effects: finished, or halted by what disturbs the records."""
    search = Search(
        question.batch, question.base, question.candidates, question.max_effects, say,
        budget=BUDGET * (_QUICK_BUDGET if quick else 1.0), own=question.own,
        variants=question.variants, reserved=question.reserved, tolerance=question.tolerance,
        is_disturbed=is_disturbed, is_drifting=is_drifting,
    )  # fmt: skip
    search.run()
    if () not in search.fits:
        raise InputError(
            "the model as it is cannot be simulated over these records; check the mass, the units and the base effects."
        )
    return search


def _decided(known: Undisturbed) -> Outcome:
    """Return the verdict on a finished search, its rivals minded: a drift with time, a second mode."""
    question, search = known.question, known.search
    drifting = known.drifting or {}
    decision = decide(search, drifting, question.tolerance)
    base_drifting = drifting[()].fit if () in drifting else None
    ambient = ambient_check(question.batch, search.fits[decision.model], is_explained=not _is_left(decision))
    second_mode = Check("no second mode", True, "not testable without records")
    if question.batch.has_records:
        is_bare = decision.verdict is Verdict.ADEQUATE
        is_bare |= decision.verdict is Verdict.UNEXPLAINED and not decision.model
        check = partial(second_mode_check, question.batch, is_moved=not ambient.passed)
        second_mode = check(search.fits[decision.model], is_bare=is_bare)
        if not second_mode.passed:
            is_beside = base_drifting is not None and not check(base_drifting).passed
            decision = mind_second_mode(decision, is_beside_drift=is_beside)
    if not ambient.passed:
        decision = mind_what_moves_on(decision)
    if known.is_bent:
        decision = mind_bent_sensor(search, decision)
    return Outcome(search, decision, base_drifting, second_mode, ambient)


def _is_left(decision: Decision) -> bool:
    """Return whether what is said of the records leaves more than noise."""
    return decision.is_approximate or decision.verdict is Verdict.UNEXPLAINED


def _study(
    question: Question,
    outcome: Outcome,
    verification: Verification,
    inference: Inference,
    asked: Mapping[str, object],
    plan: Plan | None,
    seed: int,
    started: float,
) -> Study:
    """Return everything that was found as one record."""
    batch, search, decision, extended = question.batch, outcome.search, outcome.decision, outcome.extended
    checks, is_found = checks_of(question, outcome, verification), decision.verdict is Verdict.FOUND
    before = simulate(batch, verification.before)
    scatter = None if extended is None or decision.is_approximate else scatter_of(extended)
    shown = extended if np.isnan(decision.against) else None  # what the backbones speak against, they do not show
    # what a run took is told as it was: fewer draws where the model is heavy
    drawn = {key: inference.convergence[key] for key in ("draws", "tune") if key in inference.convergence}
    return Study(
        verdict=decision.verdict,
        sentence=verdict_words.with_checks(verdict_words.sentence(decision), decision.verdict, checks),
        base=question.base,
        extended=None if extended is None else extended.layout.oscillator,
        missing_effects=decision.best if decision.named_level is NamedLevel.LAW else (),
        probability=decision.probability,
        candidates=candidates_of(search, decision),
        ambiguous_sets=decision.listed,
        advice=_advice(question, outcome, plan) if decision.listed else (),
        reasons=() if shown is None else words.reasons(batch, shown, decision.above, scatter, question),
        below_tolerance=decision.below,
        where=where_different(batch, before),
        missing_p_value=decision.p_missing,
        held_out_levels=verification.held_out_levels,
        held_out_specimens=verification.held_out_specimens,
        shrink=verification.shrink[0],
        shrink_low=verification.shrink[1],
        shrink_high=verification.shrink[2],
        adequate_by=decision.adequate_by,
        tolerance=question.tolerance,
        detectable=detectable(search) if decision.verdict is Verdict.ADEQUATE else (),
        checks=checks,
        backbones=batch.backbones.sel(specimen=list(batch.specimens)),
        before=before,
        after=None if verification.after is None else simulate(batch, verification.after),
        parameters=inference.estimates,
        posterior=inference.posterior,
        posterior_bounds=inference.bounds,
        posterior_backbone=inference.backbone,
        findings=inference.findings,
        convergence=inference.convergence,
        settings={**asked, "likelihood": "pooled", "fixed": inference.held, "sampling_seed": seed, **drawn},
        notes=(
            *question.notes,
            *_search_notes(search, quick=bool(asked["quick"]), is_found=is_found),
        ),
        seconds=time.perf_counter() - started,
        seed=seed,
        present=present_design(batch),
        contenders=_contenders(outcome),
        plan=plan,
        mechanisms=decision.mechanisms,
        named_level=decision.named_level,
        remainder=decision.remainder,
        scatter=scatter,
        evidence_basis=EvidenceBasis(
            decision.corrected.reason, len(decision.corrected.sets), decision.corrected.cycles
        ),
        portraits=portraits(batch, verification.before, verification.after, quick=bool(asked["quick"])),
    )


def _contenders(outcome: Outcome) -> tuple[Contender, ...]:
    """Return the sets that a verdict on records leaves possible."""
    search, decision = outcome.search, outcome.decision
    if not search.batch.has_records:
        return ()
    return tuple(
        contender(
            names,
            decision.probabilities[names],
            search.fits[names],
            1.0 - decision.none_other.get(names, is_none_other(search, names, names in decision.drifts)),
        )
        for names in decision.listed
        if decision.probabilities[names] > 0.0
    )


def _planned(question: Question, outcome: Outcome, seed: int, say: Progress) -> Plan | None:
    """Return which test would tell apart what remains possible; None where that is not a matter of sets."""
    present, remaining = present_design(question.batch), _contenders(outcome)
    if present is None or len(remaining) < 2:
        return None
    return plan_tests(question.base, remaining, present, own_effects=question.own, random_seed=seed, progress=say)


def _advice(question: Question, outcome: Outcome, plan: Plan | None) -> tuple[str, ...]:
    """Return what measurement would tell more: computed where there is a plan, else from the backbones."""
    said = words.advice(outcome.search, outcome.decision)
    present = present_design(question.batch)
    if plan is None or present is None:
        return said
    unit = question.batch.amplitude_unit
    drift = said[:1] if verdict_words.is_drift_possible(outcome.decision) else ()
    return (*drift, *plan_words.sentences(plan, present, unit))


def _search_notes(search: Search, *, quick: bool, is_found: bool) -> list[str]:
    said = []
    if search.is_cut and not is_found and not search.explains(search.fits[search.best()]):
        said.append(
            "the search ended before all sets that the backbones propose were tried: nothing came near the noise"
        )
    if search.batch.is_behind_filter and not quick:
        said.append("nothing was sampled: backbones of filtered records are off, parameters are those of the samples")
    return said


__all__ = ["find_missing_effect"]
