"""The report of a study: one HTML file that holds everything, figures included, and needs no network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..discrepancy.study import Candidate, Detectable, Estimate, HeldOut, Study
from ..discrepancy.verdict import Verdict
from ..effects import LIBRARY
from ..oscillator import Oscillator
from .html import Raw, bullets, details, escape, image, number, page, paragraph, prose, section, table, tiles, unit
from .style import engineering
from .words import ADEQUATE_BY, STATUS_WORDS, VERDICT_MEANS, VERDICT_WORDS, added_effects, percent, set_name

FIRST_CANDIDATES = 6


def report_html(study: Study, figures: Mapping[str, Figure], *, version: str, command: str = "") -> str:
    """Return the report as one HTML page.

    Parameters
    ----------
    study : Study
        What `find_missing_effect` returned.
    figures : mapping of str to matplotlib.figure.Figure
        From `study_figures`; those that are not there are left out.
    version : str
        Of this package.
    command : str, optional
        The command line that made the study.

    Returns
    -------
    str
        HTML with its style sheet and images inside.
    """
    body = "".join(
        [
            _header(study),
            _reasons(study),
            _curves(study, figures),
            _where(study),
            _candidates(study, figures),
            _parameters(study, figures),
            _equations(study),
            _held_out(study, figures),
            _detectable(study, figures),
            _data(study, figures),
            _convergence(study, figures),
            _reproduce(study, version, command),
        ]
    )
    footer = f"<footer>pymc-backbone {escape(version)} &middot; seed {escape(study.seed)}</footer>\n"
    return page(f"{study.verdict.capitalize()}: {study.sentence}", study.verdict, body + footer)


def _header(study: Study) -> str:
    count = study.backbones.sizes["specimen"]
    kicker = f"Missing effect in {count} {'specimen' if count == 1 else 'specimens'}"
    means = VERDICT_MEANS.get(study.verdict, "")
    if study.adequate_by is not None:
        means = f"{means} {ADEQUATE_BY.get(study.adequate_by, '')}"
    parts = [
        f'<header>\n<span class="word">{escape(VERDICT_WORDS.get(study.verdict, study.verdict))}</span>'
        f'<span class="kicker">{escape(kicker)}</span>',
        f"<h1>{prose(study.sentence)}</h1>",
        paragraph(means, "soft"),
    ]
    if study.ambiguous_sets:
        parts.append("<h3>Cannot be told apart</h3>" + bullets(map(set_name, study.ambiguous_sets)))
    if study.below_tolerance:
        names = ", ".join(name.replace("_", " ") for name in study.below_tolerance)
        parts.append(paragraph(f"Detectable, but smaller than the tolerance: {names}."))
    parts.append(tiles(_key_figures(study)))
    return "\n".join(parts) + "\n</header>\n"


def _key_figures(study: Study) -> list[tuple[object, object]]:
    levels = np.asarray(study.backbones["level"], dtype=float)
    best = study.candidates[0].effects if study.candidates else ()
    figures: list[tuple[object, object]] = []
    if np.isfinite(study.probability):
        figures.append(
            (
                percent(study.probability),
                f"probability of {set_name(best)}" if best else "probability that nothing is missing",
            )
        )
    if np.isfinite(study.shrink):
        words = Raw(f"less gap on held-out data (95&nbsp;%: {_interval(study)})")
        figures.append((Raw(f"{number(study.shrink, 3)} &times;"), words))
    for held_out, what in ((study.held_out_specimens, "specimens"), (study.held_out_levels, "levels")):
        if held_out is None:
            continue
        value = number(held_out.before, 3)
        if np.isfinite(held_out.after):
            value = Raw(f"{value} &rarr; {number(held_out.after, 3)}")
        figures.append((value, Raw(f"reduced &chi;&sup2; on held-out {what} (1 is noise)")))
    chance = study.missing_p_value
    shown = f"p = {number(chance, 2)}" if chance > 1e-99 else "p < 10<sup>−99</sup>"
    figures.append((Raw(shown), "chance of such a gap if nothing were missing"))
    low, high, name = _amplitudes(study, levels[0], levels[-1])
    figures.append((Raw(f"{low} to {high} {escape(name)}"), f"amplitude, {levels.size} levels"))
    return figures


def _interval(study: Study) -> str:
    return f"{number(study.shrink_low, 3)} to {number(study.shrink_high, 3)}"


def _reasons(study: Study) -> str:
    return section("Why", bullets(study.reasons)) + section("What to do next", bullets(study.advice))


def _curves(study: Study, figures: Mapping[str, Figure]) -> str:
    parts = []
    for name in map(str, study.backbones["observable"].values):
        pair = image(
            figures.get(f"backbones_{name}"), f"measured and simulated {name} over amplitude, before and after"
        ) + image(figures.get(f"gap_{name}"), f"gap in {name} over amplitude, before and after")
        parts.append(f'<div class="pair">{pair}</div>' if pair else "")
    words = "Measured and simulated backbones, and the gap between them" if any(parts) else ""
    tolerances = ", ".join(f"{name} {100.0 * value:g} %" for name, value in study.tolerance.items() if value > 0.0)
    note = "Bars span 95 % of measurement error, bands of the gap that of its mean over the specimens."
    if tolerances:
        note += f" Grey: the tolerance ({tolerances})."
    return section(words, *parts, paragraph(note, "soft")) if words else ""


def _where(study: Study) -> str:
    rows = []
    for item in study.where:
        low, high, name = _amplitudes(study, item.amplitude_low, item.amplitude_high)
        is_bare = item.unit == "1"
        gap = number(item.gap, 3) if is_bare else Raw(f"{number(item.gap, 3)} {unit(item.unit)}")
        rows.append(
            (
                item.observable,
                Raw(f"{low} to {high} {escape(name)}"),
                f"measurement {item.direction} the model",
                gap,
                number(item.standard_errors, 3),
            )
        )
    columns = (
        ("observable", "head"),
        ("amplitude", ""),
        ("direction", ""),
        ("largest gap", ""),
        ("in standard errors", ""),
    )
    if not rows:
        return section("Where", paragraph("Nowhere do base model and measurement differ beyond their error."))
    return section("Where base model and measurement differ", table(columns, rows))


def _candidates(study: Study, figures: Mapping[str, Figure]) -> str:
    columns = (
        ("effects added to the base", "head"),
        ("probability", "n"),
        ("reduced \N{GREEK SMALL LETTER CHI}\N{SUPERSCRIPT TWO}", "n"),
        ("of backbones", "n"),
        ("log evidence", "n"),
        ("status", ""),
        ("reason", "text"),
    )
    units = {p.name: p.unit for effect in LIBRARY.values() for p in effect.parameters}
    units.update((study.extended or study.base).units)
    rows = [_candidate_row(candidate, units) for candidate in study.candidates]
    first = table(columns, rows[:FIRST_CANDIDATES], strong=[0])
    count = len(rows) - FIRST_CANDIDATES
    rest = details(f"{count} more sets, those that failed included", table(columns, rows[FIRST_CANDIDATES:]))
    picture = image(figures.get("candidates"), "probability of the candidate sets")
    note = paragraph("Log evidence is relative to the base model; every set that was tried is listed.", "soft")
    return section("Candidates", first, rest, note, details("The same as a figure", picture)) if rows else ""


def _candidate_row(candidate: Candidate, units: Mapping[str, str]) -> tuple[object, ...]:
    reason = escape(candidate.reason)
    values = [
        f"{escape(name.replace('_', ' '))} {number(value, 3)} &plusmn; {number(error, 2)}"
        + ("" if units.get(name, "1") == "1" else f" {unit(units[name])}")
        for name, (value, error) in candidate.parameters.items()
    ]
    if values:
        reason += f"{'; ' if reason else ''}{', '.join(values)}"
    return (
        set_name(candidate.effects),
        _bar(candidate.probability),
        number(candidate.reduced_chi_square, 3),
        number(candidate.backbone_chi_square, 3),
        number(candidate.log_evidence),
        STATUS_WORDS.get(candidate.status, candidate.status),
        Raw(reason),
    )


def _bar(probability: float) -> Raw:
    share = 100.0 * probability if np.isfinite(probability) else 0.0
    return Raw(f'<span class="bar" style="--p:{share:.1f}%">{escape(percent(probability))}</span>')


def _parameters(study: Study, figures: Mapping[str, Figure]) -> str:
    added = set(added_effects(study))
    rows: list[tuple[object, ...]] = []
    strong: list[int] = []
    for effect, group in study.parameters.items():
        for name, estimate in group.items():
            if effect in added:
                strong.append(len(rows))
            digits = _digits(estimate)
            rows.append(
                (
                    name.replace("_", " "),
                    number(estimate.mean, digits),
                    number(estimate.sd, 2),
                    Raw(f"{number(estimate.hdi_low, digits)} to {number(estimate.hdi_high, digits)}"),
                    unit(estimate.unit),
                    effect.replace("_", " "),
                )
            )
    columns = (("parameter", "head"), ("mean", "n"), ("sd", "n"), ("95 % HDI", ""), ("unit", ""), ("effect", ""))
    note = "Over the batch. Added effects are stressed." if added else "Over the batch."
    if study.posterior is None:
        note += " Nothing was sampled: intervals are those of the fit."
    title = "Parameters of the extended model" if added else "Parameters of the base model"
    if study.verdict == Verdict.UNEXPLAINED and added:
        note = f"This model explains a part of the gap only. {note}"
    if study.backbones.attrs.get("amplitude_unit") == "rad":
        note += " For a rotation read N as N m, and m as rad."
    picture = image(figures.get("parameters"), "parameters with 95 % intervals")
    return section(title, table(columns, rows, strong=strong), paragraph(note, "soft"), picture) if rows else ""


def _digits(estimate: Estimate) -> int:
    """Return how many digits of a value its standard deviation leaves meaningful, two uncertain ones included."""
    largest = max(abs(estimate.hdi_low), abs(estimate.hdi_high))
    if not (estimate.sd > 0.0 and np.isfinite(largest) and largest > 0.0):
        return 4
    return int(np.clip(np.floor(np.log10(largest)) - np.floor(np.log10(estimate.sd)) + 2, 2, 9))


def _equations(study: Study) -> str:
    parts = ["<h3>Before</h3>" if study.extended else "", _equation(study.base, set())]
    if study.extended is not None:
        parts += ["<h3>After</h3>", _equation(study.extended, set(added_effects(study)))]
    return section("Equation of motion", *parts)


def _equation(model: Oscillator, added: set[str]) -> str:
    """Return the equation with the symbols of added parameters in the verdict's colour."""
    names = {parameter.name for effect in model.effects if effect.name in added for parameter in effect.parameters}
    lines = []
    for i, line in enumerate(model.equation.splitlines()):
        is_added = i > 0 and any(f": {name} [" in line for name in names)
        text = escape(line)
        lines.append(f"<b>{text}</b>" if i == 0 or is_added else text)
    return "<pre>" + "\n".join(lines) + "</pre>"


def _held_out(study: Study, figures: Mapping[str, Figure]) -> str:
    parts = []
    sources = ((study.held_out_specimens, "specimen"), (study.held_out_levels, "level"))
    pictures = "".join(
        image(figures.get(f"held_out_{what}s"), f"reduced chi-square of each held-out {what}") for _, what in sources
    )
    rows = [_held_out_row(held_out, what) for held_out, what in sources if held_out is not None]
    columns = (("left out", "head"), ("number", "n"), ("before", "n"), ("after", "n"))
    parts.append(table(columns, rows))
    if np.isfinite(study.shrink):
        parts.append(
            paragraph(
                Raw(f"The gap shrinks by a factor of <b>{number(study.shrink, 3)}</b> (95&nbsp;%: {_interval(study)}).")
            )
        )
    note = "Reduced chi-square; 1 is what measurement noise alone gives. "
    note += "A level is predicted from the others; for a specimen only linear stiffness and viscous damping are fitted."
    parts += [f'<div class="pair">{pictures}</div>' if pictures else "", paragraph(note, "soft")]
    return section("The gap on data that the fit has not seen", *parts) if rows else ""


def _held_out_row(held_out: HeldOut, what: str) -> tuple[object, ...]:
    return f"{what}s", len(held_out.labels), number(held_out.before, 3), number(held_out.after, 3)


def _detectable(study: Study, figures: Mapping[str, Figure]) -> str:
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
    name, parameter = item.effect.replace("_", " "), item.parameter.replace("_", " ")
    strength = number(item.value, 3)
    if item.unit != "1":
        strength = Raw(f"{strength} {unit(item.unit)}")
    return name, parameter, strength, *changes


def _data(study: Study, figures: Mapping[str, Figure]) -> str:
    rows = [(check.check.replace("_", " "), Raw(_passed(check.passed)), check.message) for check in study.checks]
    columns = (("check", "head"), ("result", ""), ("finding", "text"))
    notes = [str(note) for note in study.notes]
    named = [str(name) for name in study.backbones["specimen"].values]
    picture = image(figures.get("records"), "the measured records", is_wide=True)
    return section(
        "Data",
        table(columns, rows),
        paragraph(f"Specimens: {', '.join(named)}.", "soft"),
        details(f"Notes: what was assumed or done ({len(notes)})", bullets(notes), is_open=0 < len(notes) <= 5),
        details("The records", picture),
    )


def _passed(is_passed: bool) -> str:
    return '<span class="good">passed</span>' if is_passed else '<span class="bad">look at this</span>'


def _convergence(study: Study, figures: Mapping[str, Figure]) -> str:
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


def _reproduce(study: Study, version: str, command: str) -> str:
    parts = []
    if command:
        parts.append(paragraph("The same study again:") + f"<pre>{escape(command)}</pre>")
    parts.append(paragraph("The posterior again, as a script to edit:") + "<pre>python model.py</pre>")
    parts.append(
        paragraph(
            f"pymc-backbone {version}, seed {study.seed}, {study.seconds:.3g} s of computation. The folder also holds "
            "result.json (all numbers), backbones.csv and .nc, and the figures as files."
        )
    )
    rows: list[tuple[object, object]] = [(name, _setting(value)) for name, value in study.settings.items()]
    parts.append(details("All settings", table((("setting", "head"), ("value", "")), rows)))
    return section("How to reproduce this", *parts)


def _setting(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key}={item}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return {None: "default", True: "yes", False: "no"}.get(value, str(value)) if _is_word(value) else str(value)


def _is_word(value: Any) -> bool:
    return value is None or isinstance(value, bool)


def _amplitudes(study: Study, low: float, high: float) -> tuple[Raw, Raw, str]:
    """Return two amplitudes and their unit, in the prefix that suits all levels."""
    name = str(study.backbones.attrs.get("amplitude_unit", "m"))
    scale, prefix = engineering(float(np.asarray(study.backbones["level"]).max()), name)
    return number(low * scale, 3), number(high * scale, 3), f"{prefix}{name}"
