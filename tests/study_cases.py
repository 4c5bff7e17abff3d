"""Hand-made studies, one for each verdict, for the tests of what is made from them: files, figures, report, script."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from pymc_backbone._common.text import unit_of
from pymc_backbone.discrepancy.results.entries import (
    Candidate,
    Check,
    Detectable,
    Estimate,
    EvidenceBasis,
    GapRange,
    HeldOut,
    LawProbability,
    MissingMechanism,
    ScatterOfEffects,
)
from pymc_backbone.discrepancy.results.study import Study
from pymc_backbone.discrepancy.results.verdict import NamedLevel
from pymc_backbone.effects import LIBRARY
from pymc_backbone.inference.diagnostics import findings, summarise
from pymc_backbone.inference.model import build_model
from pymc_backbone.inference.sampling import sample
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.backbones import simulate_population

SENTENCES = {
    "adequate": "Nothing is missing: base model and measurement agree within measurement error at every amplitude.",
    "found": "Coulomb friction is missing from the model, with a probability of 97 %.",
    "ambiguous": "Something is missing, but these records do not tell apart: Coulomb friction; Jenkins.",
    "unexplained": "Something is missing, and no effect of the library or set of up to three explains it.",
}


def make_study(
    verdict: str,
    *,
    specimens: int = 5,
    amplitude: float = 0.012,
    frequency: float = 13.0,
    unit: str = "m",
    observables: Sequence[str] = ("frequency", "damping"),
    names: Sequence[str] | None = None,
    likelihood: str = "specimen",
    draws: int = 0,
    step: str = "metropolis",
    seed: int = 3,
) -> Study:
    """Return a study that looks like a real one; with ``draws`` its posterior is really sampled."""
    rng = np.random.default_rng(seed)
    mass, base = 1.2, Oscillator(1.2)
    is_found = verdict in ("found", "ambiguous")
    extended = None if verdict == "adequate" else base + "coulomb_friction"
    stiffness = mass * (2.0 * np.pi * frequency) ** 2
    scatter = 1.0 + 0.01 * rng.standard_normal((specimens, 1))
    k, c = stiffness * scatter, 0.012 * np.sqrt(stiffness * mass) * scatter
    friction = (0.0015 if is_found else 0.0) * stiffness * amplitude * np.ones((specimens, 1))
    levels = np.geomspace(0.12 * amplitude, amplitude, 9)
    truth = np.hstack([k, c, friction])
    exact = simulate_population(base + "coulomb_friction", truth, levels, observables, amplitude_unit=unit)
    value = np.asarray(exact["value"]).copy()
    if verdict == "unexplained":
        bump = np.exp(-0.5 * ((np.log(levels / levels[4])) / 0.3) ** 2)
        value[:, 0] *= 1.0 - 0.004 * bump
        value[:, 1] *= 1.0 + 0.5 * bump
    error = value * np.array([0.0001, 0.01, 1.0])[: len(observables), None] * np.linspace(2.0, 1.0, 9)
    if "offset" in observables:
        error[:, observables.index("offset")] = 0.001
    covariance = error[..., None] * error[..., None, :] * 0.5 ** np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    noise = np.einsum("...ij,...j->...i", np.linalg.cholesky(covariance), rng.standard_normal(value.shape))
    value = value + noise
    if specimens > 2:
        value[1, :, -2:] = np.nan
        covariance[1, :, -2:, :] = np.nan
        covariance[1, :, :, -2:] = np.nan
    labels = list(names) if names is not None else [f"run_{i + 1}" for i in range(specimens)]
    measured = exact.copy(deep=True)
    measured["value"] = (exact["value"].dims, value)
    measured["covariance"] = (exact["covariance"].dims, covariance)
    measured["standard_error"] = (
        exact["value"].dims,
        np.sqrt(np.diagonal(covariance, axis1=2, axis2=3)),
    )
    measured = measured.assign_coords(specimen=labels).assign_attrs(
        amplitude_unit=unit, notes=[f"{labels[0]}: the release was found at 0.31 s"]
    )
    f, d = np.nanmean(value[:, 0], axis=1), np.nanmean(value[:, 1], axis=1)
    fitted = np.column_stack([mass * (2.0 * np.pi * f) ** 2, 2.0 * mass * f * d])
    before = simulate_population(base, fitted, levels, observables, amplitude_unit=unit)
    after = None if extended is None else simulate_population(extended, truth, levels, observables, amplitude_unit=unit)
    model, best = extended or base, truth[0]
    bounds = {
        "linear_stiffness": (0.8 * stiffness, 1.25 * stiffness),
        "viscous_damping": (0.0, 4.0 * float(c.max())),
        "friction_force": (0.0, 0.01 * stiffness * amplitude),
    }
    bounds = {name: bounds[name] for name in model.parameter_names}
    settings: dict[str, Any] = {
        "likelihood": likelihood if specimens > 1 else "pooled",
        "draws": draws or 2000,
        "tune": max(draws, 1) if draws else 1000,
        "chains": 2 if draws else 4,
        "step": step,
        "max_effects": 3,
        "quick": not draws,
    }
    posterior = None
    if draws:
        built = build_model(model, measured, bounds=bounds, likelihood=settings["likelihood"])
        posterior = sample(
            built,
            draws=draws,
            tune=settings["tune"],
            chains=2,
            step=step,
            random_seed=seed,
            progressbar=False,
        )
    estimates = {}
    for effect in model.effects:
        estimates[effect.name] = {
            parameter.name: _estimate(
                posterior, parameter.name, best[model.index(parameter.name)], unit_of(parameter.unit, unit)
            )
            for parameter in effect.parameters
        }
    return Study(
        verdict=verdict,
        sentence=SENTENCES[verdict],
        base=base,
        extended=extended,
        missing_effects=("coulomb_friction",) if verdict == "found" else (),
        named_level=NamedLevel.LAW if verdict == "found" else None,
        mechanisms=(
            MissingMechanism(
                "hysteresis",
                0.98,
                0.94,
                (LawProbability("coulomb_friction", 0.6), LawProbability("jenkins", 0.38)),
                {"friction_force": (0.1, 0.01)},
            ),
        )
        if is_found
        else (),
        probability={"adequate": 0.98, "found": 0.97, "ambiguous": 0.55, "unexplained": 0.6}[verdict],
        candidates=_candidates(verdict),
        ambiguous_sets=(("coulomb_friction",), ("jenkins",)) if verdict == "ambiguous" else (),
        advice=("Four more records of the same kind, or amplitudes down to a third of the lowest level.",)
        if verdict in ("ambiguous", "unexplained")
        else (),
        reasons=("Damping rises as amplitude falls, excess proportional to A^(-1.02 ± 0.05): dry friction.",)
        if is_found
        else (),
        below_tolerance=("cubic_stiffness",) if verdict == "adequate" else (),
        where=()
        if verdict == "adequate"
        else (
            GapRange("damping", levels[0], levels[3], 0.021, "1", 34.2, "above"),
            GapRange("damping", levels[6], levels[8], -0.009, "1", 17.0, "below"),
            GapRange("frequency", levels[2], levels[5], -0.0041 * frequency / 13.0, "Hz", 5.1, "below"),
        ),
        missing_p_value=0.41 if verdict == "adequate" else 2e-17,
        held_out_levels=_held_out(verdict, [f"{level:.3g} {unit}" for level in levels], rng),
        held_out_specimens=_held_out(verdict, labels, rng) if specimens > 1 else None,
        shrink=np.nan if extended is None else 41.3,
        shrink_low=np.nan if extended is None else 30.1,
        shrink_high=np.nan if extended is None else 55.0,
        adequate_by="statistics" if verdict == "adequate" else None,
        tolerance={"frequency": 0.001, "damping": 0.03},
        detectable=tuple(
            Detectable(
                name,
                effect.parameters[0].name,
                float(effect.parameters[0].bounds(mass, amplitude, 2 * np.pi * frequency)[1]) * 0.003 * (i + 1),
                unit_of(effect.parameters[0].unit, unit),
                np.nan if i % 3 == 0 else 2e-5 * (i + 1),
                0.004 * (i + 1),
            )
            for i, (name, effect) in enumerate(LIBRARY.items())
            if name not in ("linear_stiffness", "viscous_damping")
        )
        if verdict == "adequate"
        else (),
        checks=(
            Check(
                "drift", True, "The same amplitude gives the same frequency at all times, within 0.8 standard errors."
            ),
            Check(
                "second mode",
                verdict != "unexplained",
                "No second mode beats in the records."
                if verdict != "unexplained"
                else "A second mode at 14.1 Hz beats in 3 of 5 records; give --band.",
            ),
        ),
        backbones=measured,
        before=before,
        after=after,
        parameters=estimates,
        posterior=posterior,
        posterior_bounds=bounds,
        findings=tuple(findings(posterior, bounds, units=model.units)) if posterior is not None else (),
        convergence=_convergence(posterior),
        settings=settings,
        notes=(f"{labels[0]}: the release was found at 0.31 s",),
        seconds=12.3,
        seed=seed,
        scatter=ScatterOfEffects(0.062, 0.021, 0.17) if is_found and specimens > 1 else None,
        evidence_basis=EvidenceBasis("the evidence of the 2 leading sets is corrected by importance sampling", 2, 61e3),
    )


def _estimate(posterior: xr.DataTree | None, name: str, value: float, unit: str) -> Estimate:
    if posterior is None:
        return Estimate(value, 0.02 * value, 0.96 * value, 1.04 * value, unit)
    draws = np.asarray(posterior["posterior"][name])
    draws = draws.mean(axis=-1).ravel() if draws.ndim == 3 else draws.ravel()
    low, high = np.quantile(draws, [0.025, 0.975])
    return Estimate(float(draws.mean()), float(draws.std()), float(low), float(high), unit)


def _convergence(posterior: xr.DataTree | None) -> dict[str, float]:
    if posterior is None:
        return {}
    table = summarise(posterior)
    sizes = posterior["posterior"].sizes
    return {
        "r_hat": float(table["r_hat"].max()),
        "ess_bulk": float(table["ess_bulk"].min()),
        "draws": sizes["draw"],
        "chains": sizes["chain"],
    }


def _held_out(verdict: str, labels: Sequence[str], rng: np.random.Generator) -> HeldOut:
    n = len(labels)
    if verdict == "adequate":
        each = rng.chisquare(8, n) / 8
        return HeldOut(float(each.mean()), np.nan, tuple(labels), each, np.full(n, np.nan))
    before = 40.0 * rng.lognormal(0.0, 0.8, n)
    after = rng.chisquare(8, n) / 8 if verdict != "unexplained" else 8.0 * rng.lognormal(0.0, 0.5, n)
    return HeldOut(float(before.mean()), float(after.mean()), tuple(labels), before, after)


def _candidates(verdict: str) -> tuple[Candidate, ...]:
    others = [name for name in LIBRARY if name not in ("linear_stiffness", "viscous_damping", "coulomb_friction")]
    shares = {"adequate": (0.98, 0.01), "found": (0.02, 0.97), "ambiguous": (1e-9, 0.55), "unexplained": (1e-9, 0.6)}
    nothing, friction = shares[verdict]
    of_friction = "possible" if verdict == "adequate" else "best"
    rows = [
        Candidate(
            (), nothing, 0.0, *((1.02, 1.1, "best") if verdict == "adequate" else (41.0, 1.1, "rejected")), "base"
        ),
        Candidate(
            ("coulomb_friction",),
            friction,
            812.4,
            1.01,
            0.97,
            of_friction,
            "fits",
            {"friction_force": (0.12, 0.003)},
            evidence_shift=-0.47,
            pareto_k=0.31,
        ),
    ]
    if verdict == "ambiguous":
        rows.append(Candidate(("jenkins",), 0.44, 812.2, 1.02, 0.98, "possible", "fits as well"))
    for i, name in enumerate(others):
        if any(row.effects == (name,) for row in rows):
            continue
        is_failed = i == len(others) - 1
        rows.append(
            Candidate(
                (name,),
                0.0 if is_failed else 0.004 * 0.3**i,
                np.nan if is_failed else 40.0 - 3 * i,
                np.nan if is_failed else 12.0 + i,
                np.nan if is_failed else 14.0 + i,
                "failed" if is_failed else "rejected",
                "no start gave a finite backbone"
                if is_failed
                else "leaves damping below the measurement at low amplitudes",
            )
        )
    reason = "no better than Coulomb friction"
    rows += [Candidate(("coulomb_friction", name), 0.003, 809.0, 1.0, 0.96, "rejected", reason) for name in others[:6]]
    rows.sort(key=lambda row: -row.probability)
    rows[0] = replace(rows[0], status="best")
    return tuple(rows)
