"""The page over all structures: one HTML file with its figures, and links to the report of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._common.text import in_words
from ..reporting.html import (
    Raw,
    bullets,
    details,
    escape,
    image,
    link,
    number,
    page,
    paragraph,
    prose,
    section,
    table,
    tiles,
    unit,
)
from ..reporting.words import VERDICT_MEANS, VERDICT_WORDS, percent
from .figures import drawn_quantities, plot_damping_against_frequency, plot_quantity
from .outliers import LEAST, Quantity, far, quantities
from .structure import Structure
from .survey import Survey, effects_in_words

FIRST_FIGURES = 6
MOST_OPEN = 80  # rows of the table before it is folded


def survey_html(survey: Survey) -> str:
    """Return the page over all structures of a survey; links are relative to its folder."""
    found = quantities(survey.structures)
    body = "".join(
        [
            _header(survey, found),
            _standing_out(survey),
            _failed(survey),
            _structures(survey),
            _figures(survey, found),
            _quantities(found),
            _reproduce(survey),
        ]
    )
    footer = f"<footer>pymc-backbone {escape(survey.version)} &middot; seed {escape(survey.seed)}</footer>\n"
    return page(f"Survey: {survey.sentence}", "survey", body + footer)


def _header(survey: Survey, found: Sequence[Quantity]) -> str:
    count = len(survey.structures)
    parts = [
        '<header>\n<span class="word">Survey</span>'
        f'<span class="kicker">{count} {"structure" if count == 1 else "structures"}</span>',
        f"<h1>{prose(survey.sentence)}</h1>",
        paragraph(survey.interrupted) if survey.interrupted else "",
    ]
    figures: list[tuple[object, object]] = [
        (number, verdict) for verdict, number in survey.counts.items() if number and verdict != "failed"
    ]
    if survey.failed:
        figures.append((len(survey.failed), "could not be diagnosed"))
    for quantity in found:
        if quantity.name in ("frequency", "damping_ratio") and len(quantity.structures) > 1:
            unit_name = "" if quantity.unit == "1" else f" {quantity.unit}"
            low, high = number(float(np.min(quantity.values))), number(float(np.max(quantity.values)))
            words = f"median {in_words(quantity.name)}; {low} to {high}{unit_name} over the structures"
            figures.append((Raw(f"{number(quantity.median)}{unit_name}"), words))
    return "\n".join(part for part in [*parts, tiles(figures)] if part) + "\n</header>\n"


def _standing_out(survey: Survey) -> str:
    by_name = {item.name: item for item in survey.structures}
    rows = [(_linked(by_name[name]), Raw("<br>".join(map(prose, why)))) for name, why in survey.standing_out.items()]
    note = (
        "A structure stands out where no effect explains it, where it lacks another set of effects than more than half "
        f"of the others, or where a value lies far from the median of at least {LEAST} structures: more than "
        f"{far(max(len(survey.done), LEAST)):.1f} robust standard deviations (of so many structures; the value's own "
        "uncertainty is included)."
    )
    parts = [table((("structure", "head"), ("why", "text")), rows)] if rows else [paragraph("None does.")]
    return section("What stands out", *parts, paragraph(note, "soft")) if survey.done else ""


def _failed(survey: Survey) -> str:
    rows = [(item.name, str(item.error)) for item in survey.failed]
    faults = [
        details(f"Where in the program: {item.name}", f"<pre>{escape(item.traceback)}</pre>")
        for item in survey.failed
        if item.traceback
    ]
    return section("Could not be diagnosed", table((("structure", "head"), ("reason", "text")), rows), *faults)


def _structures(survey: Survey) -> str:
    columns = (
        ("structure", "head"),
        ("verdict", ""),
        ("missing effects", ""),
        ("probability", "n"),
        ("look at", "n"),
        ("frequency", ""),
        ("damping ratio", ""),
        ("gap", ""),
    )
    rows = [_row(item) for item in survey.ranked]
    strong = [i for i, item in enumerate(survey.ranked) if item.name in survey.standing_out]
    note = (
        "Those that stand out come first. Probability: of the most probable set. Frequency and damping ratio: of the "
        "linear part. Gap: reduced \N{GREEK SMALL LETTER CHI}\N{SUPERSCRIPT TWO} on held-out data, with the base model "
        "and with the extended one; 1 is noise. Look at: failed checks and findings, explained in the report."
    )
    first, rest = rows[:MOST_OPEN], rows[MOST_OPEN:]
    more = details(f"{len(rest)} more structures", table(columns, rest))
    means = bullets(
        Raw(f"{_pill(name)} {escape(VERDICT_MEANS[name])}") for name in VERDICT_MEANS if survey.counts[name]
    )
    parts = [
        table(columns, first, strong=strong),
        more,
        paragraph(note, "soft"),
        details("What the verdicts mean", means),
    ]
    return section("Structures", *parts) if rows else ""


def _row(item: Structure) -> tuple[object, ...]:
    return (
        _linked(item),
        _pill(str(item.verdict)),
        effects_in_words(item),
        percent(item.probability),
        len(item.warnings) or Raw("&ndash;"),
        Raw(f'<span class="u">{number(item.frequency)} Hz</span>'),
        Raw(f'<span class="u">{number(100.0 * item.damping_ratio, 3)} %</span>'),
        Raw(f"{number(item.gap_before, 3)} &rarr; {number(item.gap_after, 3)}"),
    )


def _figures(survey: Survey, found: Sequence[Quantity]) -> str:
    order = [item.name for item in survey.structures]
    pictures = [
        image(plot_quantity(quantity, order), f"{in_words(quantity.name)} of each structure")
        for quantity in drawn_quantities(found)
    ]
    if len(survey.done) > 1:
        drawn = plot_damping_against_frequency(survey.done, list(survey.standing_out))
        pictures.insert(min(2, len(pictures)), image(drawn, "damping ratio against frequency of each structure"))
    first, rest = pictures[:FIRST_FIGURES], pictures[FIRST_FIGURES:]
    note = "Bars span 95 % of each value's own uncertainty; the grey line is the median; orange stands out."
    more = details(f"{len(rest)} more quantities", _grid(rest))
    return section("Parameters over the structures", _grid(first), more, paragraph(note, "soft")) if pictures else ""


def _grid(pictures: Sequence[str]) -> str:
    pairs = [pictures[i : i + 2] for i in range(0, len(pictures), 2)]
    return "\n".join(f'<div class="pair">{"".join(pair)}</div>' for pair in pairs)


def _quantities(found: Sequence[Quantity]) -> str:
    columns = (("quantity", "head"), ("structures", "n"), ("median", "n"), ("spread", "n"), ("smallest", "n"))
    rows = [
        (
            in_words(item.name),
            len(item.structures),
            number(item.median),
            number(item.spread if len(item.structures) >= LEAST else float("nan"), 2),
            number(float(np.min(item.values))),
            number(float(np.max(item.values))),
            unit(item.unit),
        )
        for item in found
    ]
    note = (
        "Spread: 1.4826 times the median absolute deviation, a standard deviation that outliers do not move; of "
        f"{LEAST} structures at least, because that of fewer says little."
    )
    return section(
        "Quantities", table((*columns, ("largest", "n"), ("unit", "")), rows), paragraph(note, "soft") if rows else ""
    )


def _reproduce(survey: Survey) -> str:
    parts = []
    if survey.command:
        parts.append(paragraph("The same survey again:") + f"<pre>{escape(survey.command)}</pre>")
    ran = sum(item.seconds for item in survey.structures if np.isfinite(item.seconds))
    words = f"{survey.workers}; {survey.seconds:.3g} s from start to end, {ran:.3g} s of computation"
    again = sum(item.attempts > 1 for item in survey.structures)
    words += f"; {again} run twice because a worker was lost" if again else ""
    parts.append(
        paragraph(
            f"pymc-backbone {survey.version}, seed {survey.seed}: {words}. summary.json holds all numbers, "
            "summary.csv a row for each structure."
        )
    )
    rows = [(in_words(name), _words(value)) for name, value in survey.settings.items()]
    rows += [
        (f"{name}: {in_words(key)}", _words(value))
        for name, values in survey.each.items()
        for key, value in values.items()
    ]
    parts.append(details("Settings", table((("setting", "head"), ("value", "")), rows)))
    return section("How to reproduce this", *parts)


def _words(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _linked(item: Structure) -> Raw | str:
    return item.name if item.report is None else link(item.name, item.report)


def _pill(verdict: str) -> Raw:
    return Raw(f'<span class="word small {escape(verdict)}">{escape(VERDICT_WORDS.get(verdict, verdict))}</span>')


__all__ = ["survey_html"]
