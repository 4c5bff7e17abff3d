"""Sections of the report on the model: candidates, parameters, equations, what could have been seen, the chains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple

import numpy as np
from matplotlib.figure import Figure

from .._common.text import capitalised, equation_of, in_words, span, unit_of
from ..discrepancy.results.entries import Candidate, Detectable, Estimate
from ..discrepancy.results.study import Study
from ..discrepancy.results.verdict import Verdict
from ..effects import LIBRARY
from ..oscillator import Oscillator
from .html import Raw, bullets, details, escape, image, number, paragraph, prose, section, table, tiles, unit
from .terminal import meaningful_digits
from .words import STATUS_WORDS, added_effects, candidate_name, is_held, mechanism_name, percent, set_name

FIRST_CANDIDATES = 6
MOST_SETS = 12


def candidates(study: Study, figures: Mapping[str, Figure]) -> str:
    """List the sets of effects that were tried."""
    columns = (
        ("effects added to the base", "head"),
        ("probability", "n"),
        ("reduced \N{GREEK SMALL LETTER CHI}\N{SUPERSCRIPT TWO}", "n"),
        ("of backbones", "n"),
        ("log evidence", "n"),
        ("corrected by", "n"),
        ("status", ""),
        ("reason", "text"),
    )
    known = {p.name: p.unit for effect in LIBRARY.values() for p in effect.parameters}
    known.update((study.extended or study.base).units)
    units = {name: unit_of(text, study.amplitude_unit) for name, text in known.items()}
    rows = [_candidate_row(candidate, units) for candidate in study.candidates]
    first = table(columns, rows[:FIRST_CANDIDATES], strong=[0])
    count = len(rows) - FIRST_CANDIDATES
    rest = details(f"{count} more sets, those that failed included", table(columns, rows[FIRST_CANDIDATES:]))
    picture = image(figures.get("candidates"), "probability of the candidate sets")
    note = paragraph(
        "Log evidence is relative to the base model; every set that was tried is listed. After "
        "\N{PLUS-MINUS SIGN} stands the standard error of the fit to all specimens, between which an effect is taken "
        "to differ by a tenth, or by a third where only so a set explains the backbones. Corrected by: what "
        "importance sampling adds to the evidence by Laplace's method, with the Pareto k of its weights; above 0.7 it "
        "is not used, but for that of a bridge between draws of both.",
        "soft",
    )
    if study.evidence_basis is not None:
        note += paragraph(f"{capitalised(study.evidence_basis.sentence)}.", "soft")
    return section("Candidates", first, rest, note, details("The same as a figure", picture)) if rows else ""


def mechanisms(study: Study) -> str:
    """List what may be missing by mechanism, and inside each the laws and the sets of effects that it may be."""
    held: dict[str, str] = {name: effect.mechanism or "other" for name, effect in LIBRARY.items()}
    held.update({e.name: e.mechanism or "other" for e in (study.extended or study.base).effects})
    held.update({law.effect: item.mechanism for item in study.mechanisms for law in item.laws})
    columns = (("mechanism", "head"), ("probability", "n"), ("share of the gap", "n"), ("laws and sets", "text"))
    rows = []
    for item in study.mechanisms:
        laws = ", ".join(f"{in_words(law.effect)} {percent(law.probability)}" for law in item.laws)
        sets = [
            f"{set_name(found.effects)}: {percent(found.probability)}"
            for found in study.candidates
            if found.probability > 0.0 and item.mechanism in {held.get(name, "other") for name in found.effects}
        ]
        inside = details(prose(laws), bullets(sets[:MOST_SETS])) if sets else prose(laws)
        share = Raw(f"{number(100.0 * item.share_of_gap, 3)} %")
        rows.append((mechanism_name(item.mechanism), _bar(item.probability), share, Raw(inside)))
    note = "A mechanism is as probable as all sets together that hold a law of it"
    note += "." if study.remainder else ", and half of the probability that no known effect does it."
    if study.remainder:
        note += " None of these laws is exact: a smooth departure of unknown size is allowed for."
    if not rows:
        return ""
    return section("Mechanisms", table(columns, rows, strong=[0]), paragraph(note, "soft"), _remainder(study))


def _remainder(study: Study) -> str:
    """List what the most probable set leaves, by observable."""
    if not study.remainder:
        return ""
    columns = (("what is left of", "head"), ("largest", "n"), ("in standard errors", "n"),
               ("over the base's gap", "n"))  # fmt: skip
    rows = []
    for item in study.remainder:
        size = Raw(f"{number(item.size, 2)} {item.unit}") if item.unit != "1" else number(item.size, 2)
        share = Raw(f"{number(100.0 * item.share_of_gap, 2)} %") if np.isfinite(item.share_of_gap) else "-"
        rows.append((item.observable, size, number(item.standard_errors, 2), share))
    first = study.remainder[0]
    between = span(first.amplitude_low, first.amplitude_high, study.amplitude_unit)
    note = (
        f"What the most probable set leaves from {between}, beyond its own frequency and damping; over the base's gap "
        "as root mean squares. Here a smooth departure is fitted beside it; the figures above show the set as the "
        "samples alone place it, which may leave more."
    )
    return table(columns, rows) + paragraph(note, "soft")


def _candidate_row(candidate: Candidate, units: Mapping[str, str]) -> tuple[object, ...]:
    reason = escape(candidate.reason)
    values = [
        f"{escape(in_words(name))} {number(value, 3)} &plusmn; {number(error, 2)}"
        + ("" if units.get(name, "1") in ("1", "-") else f" {unit(units[name])}")
        for name, (value, error) in candidate.parameters.items()
    ]
    if values:
        reason += f"{'; ' if reason else ''}{', '.join(values)}"
    return (
        candidate_name(candidate),
        _bar(candidate.probability),
        number(candidate.reduced_chi_square, 3),
        number(candidate.backbone_chi_square, 3),
        Raw(f"{candidate.log_evidence:.1f}".replace("-", "&minus;")) if np.isfinite(candidate.log_evidence) else "-",
        _shift(candidate),
        STATUS_WORDS.get(candidate.status, candidate.status),
        Raw(reason),
    )


def _shift(candidate: Candidate) -> str:
    """Return what importance sampling adds to an evidence, and the Pareto k of its weights where draws were made."""
    if not np.isfinite(candidate.evidence_shift):
        return "-"
    said = f"{candidate.evidence_shift:+.2f}"
    if candidate.is_bridged:
        return f"{said} (bridge)"
    return said if np.isnan(candidate.pareto_k) else f"{said} (k {candidate.pareto_k:.1f})"


def _bar(probability: float) -> Raw:
    share = 100.0 * probability if np.isfinite(probability) else 0.0
    return Raw(f'<span class="bar" style="--p:{share:.1f}%">{escape(percent(probability))}</span>')


def _interval(estimate: Estimate, digits: int) -> Raw:
    """Return the interval of an estimate, with the ends only that the records give it."""
    low, high = number(estimate.hdi_low, digits), number(estimate.hdi_high, digits)
    if estimate.is_low_open and estimate.is_high_open:
        return Raw("not bounded by the records")
    if estimate.is_high_open:
        return Raw(f"at least {low}")
    return Raw(f"at most {high}" if estimate.is_low_open else f"{low} to {high}")


def parameters(study: Study, figures: Mapping[str, Figure]) -> str:
    """List the parameters of the extended model, or of the base model where there is none."""
    added = set(added_effects(study))
    rows: list[tuple[object, ...]] = []
    strong: list[int] = []
    is_sampled = study.is_sampled
    fitted = next((item.parameters for item in study.candidates if set(item.effects) == added), {})
    for effect, group in study.parameters.items():
        for name, estimate in group.items():
            if effect in added:
                strong.append(len(rows))
            digits = meaningful_digits(estimate.hdi_low, estimate.hdi_high, estimate.sd)
            rows.append(
                (
                    in_words(name),
                    number(estimate.mean, digits),
                    number(np.nan if is_held(estimate) else estimate.sd, 2),
                    *([number(fitted.get(name, (np.nan, np.nan))[1], 2)] if is_sampled else []),
                    "held" if is_held(estimate) else _interval(estimate, digits),
                    unit(estimate.unit),
                    in_words(effect),
                )
            )
    sds = (("sd, posterior", "n"), ("sd, fit", "n")) if is_sampled else (("sd, fit", "n"),)
    span = "95 % HDI" if is_sampled else "95 % of the fit"  # only what was sampled has a highest density
    columns = (("parameter", "head"), ("mean", "n"), *sds, (span, ""), ("unit", ""), ("effect", ""))
    note = "Over the batch. Added effects are stressed." if added else "Over the batch."
    if is_sampled:
        note += (
            " The posterior is that of the mean specimen, given its backbone; the fit to all specimens lets effects "
            "differ between them, and its sd holds that scatter."
        )
    else:
        why = "Nothing was sampled" if study.posterior is None else "The draws did not mix"
        note += f" {why}: intervals are those of the fit."
        if any(item.is_low_open or item.is_high_open for group in study.parameters.values() for item in group.values()):
            note += (
                " Where parameters make up for each other, these are the values that the records allow together: "
                "'at least' and 'at most' stand where only the limits of the search end them at the other side."
            )
    if study.scatter is not None:
        middle, low, high = (f"{100.0 * share:.2g}" for share in astuple(study.scatter))
        note += (
            f" Between specimens the effects differ by {middle} % (standard deviation; {low} to {high} % with 90 %)."
        )
    title = "Parameters of the extended model" if added else "Parameters of the base model"
    if study.verdict == Verdict.UNEXPLAINED and added:
        note = f"This model explains a part of the gap only. {note}"
    picture = image(figures.get("parameters"), "parameters with 95 % intervals")
    return section(title, table(columns, rows, strong=strong), paragraph(note, "soft"), picture) if rows else ""


def equations(study: Study) -> str:
    """Write the equation of motion before and after."""
    of = study.amplitude_unit
    parts = ["<h3>Before</h3>" if study.extended else "", _equation(study.base, set(), of)]
    if study.extended is not None:
        parts += ["<h3>After</h3>", _equation(study.extended, set(added_effects(study)), of)]
    return section("Equation of motion", *parts)


def _equation(model: Oscillator, added: set[str], amplitude_unit: str) -> str:
    """Return the equation with the symbols of added parameters in the verdict's colour."""
    names = {parameter.name for effect in model.effects if effect.name in added for parameter in effect.parameters}
    lines = []
    for i, line in enumerate(equation_of(model.equation, amplitude_unit).splitlines()):
        is_added = i > 0 and any(f": {name} [" in line for name in names)
        text = escape(line)
        lines.append(f"<b>{text}</b>" if i == 0 or is_added else text)
    return "<pre>" + "\n".join(lines) + "</pre>"


def detectable(study: Study, figures: Mapping[str, Figure]) -> str:
    """List the smallest effects that these data could have shown."""
    columns = (
        ("effect", "head"),
        ("parameter", ""),
        ("seen from", ""),
        ("frequency changes by", ""),
        ("damping changes by", ""),
    )
    rows = [_detectable_row(item) for item in study.detectable]
    note = paragraph("The strength from which each effect would have been seen in 9 of 10 such studies.", "soft")
    picture = image(figures.get("detectable"), "smallest detectable changes of frequency and damping")
    title = "The smallest effects these data could have shown"
    return section(title, note, table(columns, rows), picture) if rows else ""


def _detectable_row(item: Detectable) -> tuple[object, ...]:
    changes = [
        Raw(f"{number(100.0 * abs(change), 2)} %") if np.isfinite(change) else number(change)
        for change in (item.frequency, item.damping)
    ]
    name, parameter = in_words(item.effect), in_words(item.parameter)
    strength = number(item.value, 3)
    if item.unit not in ("1", "-"):
        strength = Raw(f"{strength} {unit(item.unit)}")
    return name, parameter, strength, *changes


def convergence(study: Study, figures: Mapping[str, Figure]) -> str:
    """Say whether the chains agree."""
    if study.posterior is None and not study.convergence:
        return section("Sampling", paragraph("No posterior was sampled in this run."))
    names = {
        "r_hat": "largest R-hat (agreement of chains: below 1.01)",
        "ess_bulk": "smallest number of effective draws (above 400)",
        "draws": "draws in each chain",
        "chains": "chains",
    }
    pairs: list[tuple[object, object]] = [
        (number(study.convergence[key], 4 if key == "r_hat" else 6 if key == "draws" else 3), words)
        for key, words in names.items()
        if key in study.convergence
    ]
    found = study.findings or ("Nothing wrong was found: the chains agree, and no parameter leans on its prior.",)
    pictures = [
        image(figures.get(name), text, is_wide=True) for name, text in (("trace", "traces"), ("rank", "rank plots"))
    ]
    return section(
        "Sampling", tiles(pairs) if pairs else "", bullets(found), details("Traces and ranks of the chains", *pictures)
    )
