"""Locate, name, add, verify, decide: the search for a missing effect in one call."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .._common.checks import FloatArray, InputError, check_choice
from ..effects import BASE_EFFECTS, LIBRARY, Effect
from ..measurement.conditioning.conditioned import ConditionedRecord
from ..measurement.cycles import Cycles
from ..measurement.extraction import extract_all
from ..measurement.levels import backbones_at_levels, default_levels
from ..measurement.reading.records import Record
from ..oscillator import Oscillator
from . import rivals, words
from .batch import Batch, batch_of_backbones, batch_of_records
from .candidate_table import candidates_of
from .curves import level_chi_square, on_levels, simulate
from .decide import decide, mind_second_mode
from .extend import estimates_from_draws, estimates_from_fit, mean_specimen, sample_extended
from .layout import make_layout
from .locate import where_different
from .search import BUDGET, Search, is_heavy
from .study import Check, Study
from .verdict import Verdict
from .verify import held_out_levels, held_out_specimens, shrink

TOLERANCE: Mapping[str, float] = {"frequency": 0.001, "damping": 0.03}
"""Relative change of the backbones below which a missing effect does not matter, by default."""
WAVEFORM_SHARE = 0.1
"""Part of the tolerance on damping, as a share of the motion, that waveforms may depart by unexplained."""
_UNION_LEVELS = 8
_AGREE = 5.0
_QUICK_BUDGET = 0.5
_HEAVY_SHARE = 4  # fewer draws for models that take so much longer


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
    levels: int | ArrayLike | None = None,
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
        unit of the motion.
    max_effects : int, default 3
        Largest number of effects that may be missing together.
    tolerance : mapping of str to float, or 0, optional
        Relative change of ``frequency`` and ``damping`` below which an effect does not matter; by default 0.001 and
        0.03. With 0 statistics alone decide.
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
    band, start, levels
        As in `condition` and `backbones_at_levels`, for records.

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
    effects are shared up to a scatter of a tenth. The waveforms decide, by way of the backbones and the turning points;
    evidence is Laplace's, with the level of the noise left free. See ``docs/naming.md``.
    """
    begun = time.perf_counter()
    say = progress or (lambda stage, share: None)
    limits = _tolerances(tolerance)
    seed = int(np.random.default_rng().integers(2**31)) if random_seed is None else int(random_seed)
    say("reading backbones", 0.0)
    batch, notes = _batch(oscillator, data, band, start, levels)
    own = _own_effects(candidates)
    chosen = possible_effects(oscillator, candidates, batch)
    if not 1 <= int(max_effects) <= 3:
        raise InputError(f"`max_effects` must be 1, 2 or 3, got {max_effects}; look for more in a second study.")
    search = Search(
        batch, oscillator, chosen, int(max_effects), say, budget=BUDGET * (_QUICK_BUDGET if quick else 1.0), own=own
    )
    search.run()
    if () not in search.fits:
        raise InputError(
            "the model as it is cannot be simulated over these records; check the mass, the units and the base effects."
        )
    say("deciding", 0.0)
    drifting = rivals.drift_fit(batch, search.fits[()])
    bonus = 0.0 if drifting is None else rivals.drift_bonus(drifting)
    decision = decide(search, drifting, rivals.DRIFT_KEY, limits, bonus)
    second_mode = Check("no second mode", True, "not testable without records")
    if batch.has_records:
        second_mode = rivals.second_mode_check(batch, search.fits[decision.best])
        if not second_mode.passed:
            decision = mind_second_mode(decision)
    extended = search.fits[decision.best] if decision.best else None
    say("verifying on held-out data", 0.0)
    base_levels = on_levels(batch, search.fits[()], free_effects=search.fits[()].layout.free.size > 0)
    after_levels = None if extended is None else on_levels(batch, extended)
    most = 6 if held_out is None else int(held_out)
    level_gap = specimen_gap = None
    if most > 0:
        level_gap = held_out_levels(batch, base_levels, after_levels)
        say("verifying on held-out data", 0.5)
        specimen_gap = held_out_specimens(batch, base_levels, extended, most)
    posterior, backbone = None, None
    bounds: dict[str, tuple[float, float]] = {}
    held: dict[str, float] = {}
    findings: tuple[str, ...] = ()
    convergence: dict[str, float] = {}
    estimates = estimates_from_fit(batch, extended if extended is not None else search.fits[()])
    sampling_seed = seed
    if not quick:
        say("sampling", 0.0)
        model = extended if extended is not None else search.fits[()]
        backbone, mean = mean_specimen(batch, model)
        share = _HEAVY_SHARE if is_heavy(model.layout) else 1
        options = {
            "draws": max(draws // share, 100), "tune": max(tune // share, 100), "chains": chains, "step": step,
            "random_seed": seed,
        }  # fmt: skip
        posterior, bounds, held = sample_extended(batch, model, backbone, mean, options)
        estimates = estimates_from_draws(model, posterior, held)
        findings, convergence = _judged(posterior, options)
    reduced = level_chi_square(batch, base_levels if after_levels is None else after_levels)
    checks = (
        rivals.drift_check(drifting, decision.drift_probability, bool(decision.best)),
        second_mode,
        rivals.alike_check(batch, search.fits[decision.best]),
        rivals.data_terms_check(batch, search.fits[decision.best], reduced, _AGREE),
    )
    factor, low, high = shrink(specimen_gap, level_gap, seed)
    before = simulate(batch, base_levels)
    return Study(
        verdict=decision.verdict,
        sentence=words.with_checks(words.sentence(decision, search), decision.verdict, checks),
        base=oscillator,
        extended=None if extended is None else extended.layout.oscillator,
        missing_effects=decision.best if decision.verdict is Verdict.FOUND else (),
        probability=decision.probability,
        candidates=candidates_of(search, decision),
        ambiguous_sets=decision.listed if decision.verdict is Verdict.AMBIGUOUS else (),
        advice=words.advice(search, decision) if decision.verdict is Verdict.AMBIGUOUS else (),
        reasons=words.reasons(batch, extended, decision.best) if extended is not None else (),
        below_tolerance=decision.below,
        where=where_different(batch, before),
        missing_p_value=decision.p_missing,
        held_out_levels=level_gap,
        held_out_specimens=specimen_gap,
        shrink=factor,
        shrink_low=low,
        shrink_high=high,
        adequate_by=decision.adequate_by,
        tolerance=limits,
        detectable=words.detectable(search) if decision.verdict is Verdict.ADEQUATE else (),
        checks=checks,
        backbones=batch.backbones.sel(specimen=list(batch.specimens)),
        before=before,
        after=None if after_levels is None else simulate(batch, after_levels),
        parameters=estimates,
        posterior=posterior,
        posterior_bounds=bounds,
        posterior_backbone=backbone,
        findings=findings,
        convergence=convergence,
        settings={
            "candidates": list(chosen), "max_effects": int(max_effects), "tolerance": dict(limits),
            "held_out": most, "quick": quick, "step": step, "draws": draws, "tune": tune, "chains": chains,
            "band": band, "start": start, "levels": None if levels is None else np.asarray(levels).tolist(),
            "likelihood": "pooled", "fixed": held, "sampling_seed": sampling_seed, **(convergence and {
                "draws": convergence["draws"], "tune": convergence["tune"]}),
        },
        notes=(*notes, *batch.notes, *_search_notes(search)),
        seconds=time.perf_counter() - begun,
        seed=seed,
    )  # fmt: skip


def _tolerances(tolerance: Mapping[str, float] | float | None) -> dict[str, float]:
    """Return the tolerance by observable, and that on the waveform which follows from it."""
    given: dict[str, Any] = dict(TOLERANCE)
    if isinstance(tolerance, Mapping):
        for key in tolerance:
            check_choice("tolerance", str(key), ("frequency", "damping", "offset", "waveform"))
        given = {str(key): value for key, value in tolerance.items()}
    elif tolerance is not None:
        given = dict.fromkeys(TOLERANCE, tolerance)
    limits = {}
    for key, value in given.items():
        try:
            limits[key] = float(value)
        except (TypeError, ValueError):
            limits[key] = float("nan")
        if not (np.isfinite(limits[key]) and limits[key] >= 0.0):
            raise InputError(f"`tolerance` of {key} must be a number from 0 on, got {value!r}; 0: statistics alone.")
    limits.setdefault("waveform", WAVEFORM_SHARE * limits.get("damping", 0.0))
    return limits


def _own_effects(candidates: Sequence[str | Effect] | None) -> dict[str, Effect]:
    """Return the candidates that are not the library's, by name."""
    own: dict[str, Effect] = {}
    for effect in candidates or ():
        if isinstance(effect, Effect) and LIBRARY.get(effect.name) is not effect:
            if effect.name in LIBRARY or own.get(effect.name, effect) is not effect:
                raise InputError(f"`candidates` hold another effect named {effect.name!r}; give yours another name.")
            own[effect.name] = effect
    return own


def possible_effects(
    oscillator: Oscillator, candidates: Sequence[str | Effect] | None, batch: Batch
) -> tuple[str, ...]:
    """Return the names of the effects that may be missing, the costly ones last."""
    own = _own_effects(candidates)
    held = {effect.name for effect in oscillator.effects}
    unit = str(batch.backbones.attrs.get("amplitude_unit", "m"))
    if candidates is None:
        names = [name for name, effect in LIBRARY.items() if unit == "rad" or not effect.needs_rotation]
    else:
        every = [item.name if isinstance(item, Effect) else str(item) for item in candidates]
        names = [check_choice("candidates", name, {**LIBRARY, **own}) for name in every]
    names = [name for name in dict.fromkeys(names) if name not in held and name not in BASE_EFFECTS]
    if not names:
        raise InputError("no candidate is left: the model holds all of them; name others with `candidates`.")

    def cost(name: str) -> tuple[bool, int]:
        effect = own.get(name) or LIBRARY[name]
        layout = make_layout(oscillator + effect, batch.amplitude, batch.angular_frequency)
        return is_heavy(layout), effect.n_states

    return tuple(sorted(names, key=cost))


def _batch(
    oscillator: Oscillator,
    data: Any,
    band: tuple[float, float] | None,
    start: float | None,
    levels: int | ArrayLike | None,
) -> tuple[Batch, list[str]]:
    """Return the batch of records or backbones, and notes on it."""
    if isinstance(data, xr.Dataset):
        lacking = [name for name in ("value", "standard_error") if name not in data]
        if lacking:
            raise InputError(f"the backbones in `data` lack `{lacking[0]}`; give values with their standard errors.")
        notes = [str(note) for note in data.attrs.get("notes", [])]
        return batch_of_backbones(oscillator.mass, data), notes
    is_list = isinstance(data, Sequence) and not isinstance(data, str)
    if not is_list or not all(isinstance(item, Record | ConditionedRecord) for item in data):
        raise InputError(
            f"`data` must be a list of records or a Dataset of backbones, got {type(data).__name__}; `read_records` "
            "reads a folder."
        )
    items = list(data)
    if not items:
        raise InputError("`data` must hold at least one record; check the folder.")
    extraction = extract_all(items, band=band, start=start, is_strict=False)
    observables = ["frequency", "damping"]
    if all(record.offset_is_measured for record in extraction.records):
        observables.append("offset")
    chosen = levels_within(extraction.cycles, levels)
    backbones = backbones_at_levels(extraction.cycles, chosen, observables, amplitude_unit=extraction.unit)
    batch = batch_of_records(oscillator.mass, backbones, extraction.records, extraction.cycles)
    return batch, extraction.notes()


def levels_within(cycles: Sequence[Cycles], levels: int | ArrayLike | None) -> FloatArray:
    """Return the levels: those that all specimens reach or, where there are none, over all that any reaches."""
    if levels is not None and np.ndim(levels) > 0:
        return np.asarray(levels, dtype=np.float64)
    count = None if levels is None else int(np.asarray(levels))
    try:
        return default_levels(cycles, count)
    except InputError:
        low = min(float(item.smoothed_amplitude.min()) for item in cycles)
        high = max(float(np.partition(item.smoothed_amplitude, -2)[-2]) for item in cycles)
        return np.geomspace(1.02 * low, 0.98 * high, count or _UNION_LEVELS)


def _judged(posterior: xr.DataTree, options: Mapping[str, Any]) -> tuple[tuple[str, ...], dict[str, float]]:
    """Return what is wrong with the draws, in words, and the figures of convergence."""
    from ..inference.diagnostics import findings, summarise

    table = summarise(posterior)
    return tuple(findings(posterior)), {
        "r_hat": float(table["r_hat"].max()),
        "ess_bulk": float(table["ess_bulk"].min()),
        "draws": int(options["draws"]),
        "tune": int(options["tune"]),
        "chains": int(options["chains"]),
    }


def _search_notes(search: Search) -> list[str]:
    said = "the search ended before all sets of three were tried: nothing came near the noise"
    return [said] if search.is_cut else []


__all__ = ["TOLERANCE", "find_missing_effect"]
