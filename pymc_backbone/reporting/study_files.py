"""The output folder of a study: `write_study`.

========================  ====================================================================================
file                      what it holds
========================  ====================================================================================
``report.html``           the whole study for a reader, figures included; needs no network
``result.json``           everything in numbers and words; see `DIAGNOSIS_KEYS`
``model.py``              the extended model as a PyMC script that reads ``backbones.nc`` beside it
``model_with_curves.py``  where something is left that no law explains: the model with its force curves as a script
``backbones.csv``         measured backbones with standard errors: a row for each specimen and level
``backbones.nc``          the same with the covariance over the levels (NetCDF)
``posterior.nc``          all draws and the sampler's statistics, where something was sampled (NetCDF)
``figures/*.png``         the figures of the report as files
========================  ====================================================================================
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from .._common.text import equation_of
from ..discrepancy.results.curve_records import ForceCurves
from ..discrepancy.results.design import Contender, Plan
from ..discrepancy.results.entries import Estimate, HeldOut
from ..discrepancy.results.study import Study
from .claimed_folder import prepare_output
from .curve_script import curve_script
from .model_script import model_script
from .output_folder import CURVE_SCRIPT, REPORT, SCRIPT, package_version, write_results
from .pictures import draw_all
from .report import report_html
from .study_plots import study_figures

DIAGNOSIS_KEYS = {
    "program": "'pymc-backbone'",
    "version": "of this package",
    "command": "the command line that repeats the study",
    "verdict": "adequate | found | ambiguous | unexplained",
    "sentence": "the verdict in one sentence",
    "base_effects": "names of the effects of the model that was questioned",
    "missing_effects": "name and parameters (as under 'parameters') of each; empty unless found and the law named",
    "named_level": "law | mechanism | null: what is named where the verdict is found",
    "mechanisms": "what may be missing, in falling probability: mechanism (spring | asymmetry | clearance | "
    "hysteresis | drag | displacement_damping | falling_damping | damping_asymmetry | inertia | other, or either of "
    "two: rising_damping | changing_stiffness | changing_frequency), probability, share_of_gap (of the base's "
    "chi-square or, where no law is exact, of the departure's power), laws (effect, probability), parameters (name: "
    "value, standard_error); empty where adequate",
    "remainder": "what the most probable set leaves where no law is exact, by observable: size where it is largest, "
    "unit, standard_errors of it, share_of_gap (root mean square over that of the base), amplitude_low, "
    "amplitude_high [m or rad], and the curve: amplitude, values, errors; empty where a law is exact",
    "force_curves": "what no law explains as forces, beside the effects in 'beside' (where nothing is named or "
    "certain, beside the base); null where a law is exact, where the verdict is adequate, and without records: "
    "is_possible (whether forces of displacement and speed can be it), sentence, has_even (false where a band keeps "
    "out what measures even parts: these are zero), share_left (of the gap), p_value (of what they leave being "
    "noise), range (displacement and speed visited: low, high), curves (conservative, "
    "conservative_odd, conservative_even, beyond the linear spring, over displacement [m or rad]; damping, "
    "damping_odd, damping_even, the viscous damper included, over speed [m/s or rad/s]; each at, force [N or N m], "
    "low, high (a band that holds all of the curve with 95 %), standard_error), families (curve, family, probability, "
    "number, value, low, high, size at the end of the range), held_out (reduced chi-square of specimens left out: "
    "before, after), parameters (name: value, standard_error; node forces among them)",
    "probability": "of the most probable set, which is the missing one where the verdict is found",
    "candidates": "every set, in falling probability: effects, probability, reduced_chi_square, log_evidence (relative "
    "to the base), status (best | possible | rejected | failed), reason, backbone_chi_square, parameters "
    "(name: value, standard_error), evidence_shift (what importance sampling adds to the evidence by Laplace's method; "
    "null where not asked), pareto_k (of its weights: above 0.7 the shift is not used and the probability not trusted, "
    "unless is_bridged: a bridge between draws of both says it), has_drift (whether frequency and damping also change "
    "with time in its fit)",
    "scatter": "how much the parameters of the added effects differ between specimens, as a share of their value: "
    "median, low (5 %), high (95 %) of the relative standard deviation; null without effects, or of one specimen",
    "evidence_basis": "what the probabilities rest on: sentence (whether Laplace's method was corrected by importance "
    "sampling, and why for no more sets), sets (asked), cycles (simulated for it)",
    "ambiguous_sets": "the sets that cannot be told apart: where the verdict is ambiguous, or exact sets agree on the "
    "mechanism and on no more; else empty",
    "advice": "sentences on what measurement would tell more",
    "reasons": "sentences that give the naming in physical words",
    "below_tolerance": "effects that are detectable but smaller than the tolerance",
    "where": "ranges in which base model and measurement differ: observable, amplitude_low, amplitude_high [m or rad], "
    "gap (measured minus simulated, largest), unit, standard_errors, direction (above | below the model)",
    "missing_p_value": "of the test of nothing being missing",
    "gap": "reduced chi-square on held-out data: held_out_levels and held_out_specimens, each with before, after and, "
    "for each left out, labels, before_each, after_each; shrink with its 95 % interval shrink_low, shrink_high",
    "adequate_by": "statistics | tolerance | null",
    "tolerance": "relative engineering tolerance by observable",
    "detectable": "smallest effects that would have been seen: effect, parameter, value, unit, and the relative change "
    "of frequency and damping",
    "data_checks": "check, passed, message",
    "parameters": "of the extended model (of the base where nothing was added), by effect and name: mean, sd, hdi_low, "
    "hdi_high, unit, is_low_open, is_high_open (whether the interval ends there at a limit of the search only, and the "
    "records allow values beyond)",
    "posterior_bounds": "name: low, high of the uniform priors of the sampled model",
    "convergence": "r_hat (largest), ess_bulk (smallest), draws, chains; empty where nothing was sampled",
    "findings": "sentences on what is wrong with the posterior; empty if nothing was found",
    "equation_before": "of the base model, with the meaning and unit of each symbol",
    "equation_after": "of the extended model; null where nothing was added",
    "mass": "kg, or kg m^2 for a rotation",
    "observables": "compared with the measurement: frequency [Hz], damping [1], offset [1]",
    "levels": "amplitudes at which curves are compared, in 'amplitude_unit'",
    "amplitude_unit": "m or rad",
    "specimens": "names",
    "settings": "every setting of the run, defaults filled in",
    "notes": "what was assumed or done while reading and conditioning the records",
    "seconds": "of computation",
    "seed": "of everything random; the same seed and versions give the same study",
    "present": "the test that these records are: release [m or rad], records, duration [s], sampling_rate [Hz], noise "
    "(standard deviation in the measured quantity), quantity, added_mass; null where only backbones were given",
    "contenders": "the sets that remain possible, for `pymc-backbone plan`: effects, probability, parameters and "
    "errors by name, of the whole model, chi_square (of these records), imitation (probability that it imitates what "
    "the library lacks); empty where no sets remain, and without records",
    "plan": "tests that would tell these apart, the most promising first: best and repeat (the same test again), each "
    "with design, probability, by_set, seconds; null where none was looked for",
    "files": "written by this run, relative to the folder",
}
"""Keys of ``result.json``; what is not a number (NaN) is null."""


def write_study(
    study: Study,
    folder: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    command: str = "",
    records: Sequence[Any] = (),
) -> list[str]:
    """Write a study to a folder: report, result, figures, backbones, posterior, script.

    Parameters
    ----------
    study : Study
        What `find_missing_effect` returned.
    folder : path-like
        Output folder; made if it is not there.
    overwrite : bool, optional
        Whether the folder may hold something already.
    command : str, optional
        The command line that repeats the study, for the report.
    records : sequence of Record, optional
        The measured records, drawn if given.

    Returns
    -------
    list of str
        Names of the files, relative to the folder.

    Raises
    ------
    InputError
        If the folder cannot be used or a file cannot be written.

    See Also
    --------
    find_missing_effect : makes the study.
    plots.study_figures : its figures alone.
    """
    place = prepare_output(Path(folder), overwrite)
    version = package_version()
    figures = study_figures(study, records)
    draw_all(figures.values())
    texts = {
        REPORT: report_html(study, figures, version=version, command=command),
        SCRIPT: model_script(study, version),
    }
    if study.force_curves is not None:
        texts[CURVE_SCRIPT] = curve_script(study.force_curves, study.seed, version, study.amplitude_unit)
    return write_results(
        place,
        {"command": command, **study_entries(study, version)},
        backbones=study.backbones,
        posterior=study.posterior,
        mean_backbone=study.posterior_backbone,
        figures=figures,
        texts=texts,
        keys=DIAGNOSIS_KEYS,
    )


def study_entries(study: Study, version: str) -> dict[str, Any]:
    """Return what ``result.json`` holds of a study; keys as in `DIAGNOSIS_KEYS`."""
    unit = study.amplitude_unit
    falling = sorted(study.candidates, key=lambda item: -np.nan_to_num(item.probability, nan=-1.0))
    return {
        "version": version,
        "verdict": str(study.verdict),
        "sentence": study.sentence,
        "base_effects": [effect.name for effect in study.base.effects],
        "missing_effects": [
            {"name": name, "parameters": _estimates(study.parameters.get(name, {}))} for name in study.missing_effects
        ],
        "named_level": None if study.named_level is None else str(study.named_level),
        "mechanisms": [
            {
                "mechanism": item.mechanism,
                "probability": item.probability,
                "share_of_gap": item.share_of_gap,
                "laws": [asdict(law) for law in item.laws],
                "parameters": _values(item.parameters),
            }
            for item in study.mechanisms
        ],
        "remainder": [asdict(item) for item in study.remainder],
        "force_curves": None if study.force_curves is None else force_curve_entries(study.force_curves),
        "probability": study.probability,
        "candidates": [
            {
                "effects": list(item.effects),
                "probability": item.probability,
                "reduced_chi_square": item.reduced_chi_square,
                "log_evidence": item.log_evidence,
                "status": item.status,
                "reason": item.reason,
                "backbone_chi_square": item.backbone_chi_square,
                "parameters": _values(item.parameters),
                "evidence_shift": item.evidence_shift,
                "pareto_k": item.pareto_k,
                "is_bridged": item.is_bridged,
                "has_drift": item.has_drift,
            }
            for item in falling
        ],
        "scatter": None if study.scatter is None else asdict(study.scatter),
        "evidence_basis": None if study.evidence_basis is None else asdict(study.evidence_basis),
        "ambiguous_sets": [list(names) for names in study.ambiguous_sets],
        "advice": list(study.advice),
        "reasons": list(study.reasons),
        "below_tolerance": list(study.below_tolerance),
        "where": [asdict(item) for item in study.where],
        "missing_p_value": study.missing_p_value,
        "gap": {
            "held_out_levels": _held_out(study.held_out_levels),
            "held_out_specimens": _held_out(study.held_out_specimens),
            "shrink": study.shrink,
            "shrink_low": study.shrink_low,
            "shrink_high": study.shrink_high,
        },
        "adequate_by": study.adequate_by,
        "tolerance": dict(study.tolerance),
        "detectable": [asdict(item) for item in study.detectable],
        "data_checks": [asdict(check) for check in study.checks],
        "parameters": {effect: _estimates(group) for effect, group in study.parameters.items()},
        "posterior_bounds": {name: list(bounds) for name, bounds in study.posterior_bounds.items()},
        "convergence": dict(study.convergence),
        "findings": list(study.findings),
        "equation_before": equation_of(study.base.equation, unit),
        "equation_after": None if study.extended is None else equation_of(study.extended.equation, unit),
        "mass": study.base.mass,
        "observables": [str(name) for name in study.backbones["observable"].values],
        "levels": np.asarray(study.backbones["level"], dtype=float),
        "amplitude_unit": unit,
        "specimens": [str(name) for name in study.backbones["specimen"].values],
        "settings": dict(study.settings),
        "notes": list(study.notes),
        "seconds": study.seconds,
        "seed": study.seed,
        "present": None if study.present is None else asdict(study.present),
        "contenders": [contender_entries(item) for item in study.contenders],
        "plan": None if study.plan is None else plan_entries(study.plan),
    }


def force_curve_entries(curves: ForceCurves) -> dict[str, Any]:
    """Return force curves as a result file holds them."""
    bands = {field.name: getattr(curves.bands, field.name) for field in fields(curves.bands)}
    whole = {"displacement": curves.bands.conservative.at, "speed": curves.bands.damping.at}
    return {
        "is_possible": curves.is_possible,
        "sentence": curves.sentence,
        "beside": list(curves.beside),
        "has_even": curves.has_even,
        "share_left": curves.share_left,
        "p_value": curves.p_value,
        "range": {name: [float(at[0]), float(at[-1])] for name, at in whole.items()},
        "curves": {name: asdict(band) for name, band in bands.items()},
        "families": [asdict(item) for item in curves.proposals],
        "held_out": {"before": curves.held_out_before, "after": curves.held_out_after},
        "parameters": _values(curves.parameters),
    }


def contender_entries(item: Contender) -> dict[str, Any]:
    """Return a set that remains possible as a result file holds it."""
    return {
        "effects": list(item.effects),
        "probability": item.probability,
        "parameters": dict(item.parameters),
        "errors": dict(item.errors),
        "chi_square": item.chi_square,
        "imitation": item.imitation,
    }


def plan_entries(plan: Plan) -> dict[str, Any]:
    """Return a plan as a result file holds it."""
    return {
        "contenders": [list(item.effects) for item in plan.contenders],
        "best": [asdict(item) for item in plan.best],
        "repeat": asdict(plan.repeat),
        "looked_at": plan.looked_at,
    }


def _estimates(group: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    return {name: asdict(estimate) for name, estimate in group.items()}


def _values(parameters: Mapping[str, tuple[float, float]]) -> dict[str, dict[str, float]]:
    return {name: {"value": value, "standard_error": error} for name, (value, error) in parameters.items()}


def _held_out(held_out: HeldOut | None) -> dict[str, Any]:
    if held_out is None:
        return {"before": None, "after": None, "labels": [], "before_each": [], "after_each": []}
    return {
        "before": held_out.before,
        "after": held_out.after,
        "labels": list(held_out.labels),
        "before_each": held_out.before_each,
        "after_each": held_out.after_each,
    }
