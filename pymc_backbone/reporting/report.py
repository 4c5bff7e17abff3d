"""The report of a study: one HTML file that holds everything, figures included, and needs no network."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .._common.text import in_words
from ..discrepancy.results.study import Study
from ..discrepancy.results.verdict import NamedLevel, Status, Verdict
from .html import Raw, bullets, details, escape, image, noted, number, page, paragraph, prose, section, table, tiles
from .report_curves import force_curves
from .report_gap import amplitudes, curves, held_out_gap, interval, where
from .report_model import candidates, convergence, detectable, equations, mechanisms, parameters
from .report_portraits import portraits
from .words import (
    VERDICT_WORDS,
    adequate_because,
    is_in_waveforms_only,
    left_of_samples,
    mechanism_name,
    next_steps,
    percent,
    remaining,
    remaining_by_mechanism,
    set_name,
    verdict_means,
)

_ALONE = 0.95  # of the probability that is told, which a set has by itself
_MOST_SETS = 6  # that are listed one by one
_MOST_LETTERS = 140  # of a sentence in letters of full size


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
            curves(study, figures),
            where(study),
            portraits(study, figures),
            mechanisms(study),
            force_curves(study, figures),
            candidates(study, figures),
            parameters(study, figures),
            equations(study),
            held_out_gap(study, figures),
            detectable(study, figures),
            _data(study, figures),
            convergence(study, figures),
            _reproduce(study, version, command),
        ]
    )
    footer = f"<footer>pymc-backbone {escape(version)} &middot; seed {escape(study.seed)}</footer>\n"
    return page(f"{study.verdict.capitalize()}: {study.sentence}", study.verdict, body + footer)


def _header(study: Study) -> str:
    count = study.backbones.sizes["specimen"]
    kicker = f"The search for a missing effect in {count} {'specimen' if count == 1 else 'specimens'}"
    means = f"{verdict_means(study)} {adequate_because(study)}".rstrip()
    parts = [
        f'<header>\n<span class="word">{escape(VERDICT_WORDS.get(study.verdict, study.verdict))}</span>'
        f'<span class="kicker">{escape(kicker)}</span>',
        f"<h1{' class=long' if len(study.sentence) > _MOST_LETTERS else ''}>{prose(study.sentence)}</h1>",
        paragraph(means, "soft"),
    ]
    if study.ambiguous_sets:
        parts.append("<h3>What remains possible</h3>" + _remaining(study))
    if study.below_tolerance:
        names = ", ".join(map(in_words, study.below_tolerance))
        parts.append(paragraph(f"Detectable, but smaller than the tolerance: {names}."))
    parts.append(tiles(_key_figures(study)))
    return "\n".join(parts) + "\n</header>\n"


def _remaining(study: Study) -> str:
    """Return the sets that remain possible: many of them by their mechanisms, in rows that open."""
    lines = remaining(study)
    if len(study.ambiguous_sets) <= _MOST_SETS:
        return bullets(lines)
    rows = [
        details(f"{title} ({len(sets)} sets)", bullets(sets)) if len(sets) > 1 else bullets(sets)
        for title, sets in remaining_by_mechanism(study)
    ]
    others = bullets(lines[len(study.ambiguous_sets) :])
    if len(rows) <= _MOST_SETS:
        return "".join([*rows, others])
    folded = rows[_MOST_SETS - 1 :]
    return "".join([*rows[: _MOST_SETS - 1], details(f"{len(folded)} more, less probable", *folded), others])


def _probability_of(study: Study, best: tuple[str, ...]) -> str:
    if not best:
        return "probability that nothing is missing"
    alone = next(item.probability for item in study.candidates if item.effects == best)
    is_of_several = study.below_tolerance and alone < _ALONE * study.probability
    return f"probability of {set_name(best)}{', with what is below the tolerance' if is_of_several else ''}"


def _key_figures(study: Study) -> list[tuple[object, object]]:
    levels = np.asarray(study.backbones["level"], dtype=float)
    best = next((item.effects for item in study.candidates if item.status == Status.BEST), ())
    figures: list[tuple[object, object]] = []
    if study.named_level == NamedLevel.MECHANISM:
        figures += [
            (percent(item.probability), f"probability of {mechanism_name(item.mechanism)}")
            for item in study.mechanisms
            if item.is_certain
        ]
    elif np.isfinite(study.probability) and study.verdict != Verdict.UNEXPLAINED:  # nothing known is what it is
        figures.append(
            (
                percent(study.probability),
                _probability_of(study, best),
            )
        )
    figures += _held_out_figures(study)
    chance = study.missing_p_value
    shown = f"p = {number(chance, 2)}" if chance > 1e-99 else "p < 10<sup>−99</sup>"
    figures.append((Raw(shown), "chance of such a gap if nothing were missing"))
    low, high, name = amplitudes(study, levels[0], levels[-1])
    figures.append((Raw(f"{low} to {high} {escape(name)}"), f"amplitude, {levels.size} levels"))
    return figures


def _held_out_figures(study: Study) -> list[tuple[object, object]]:
    """Return the gap on held-out backbones, before and after; that of the samples where these alone show it."""
    if is_in_waveforms_only(study):
        before, after = (number(left, 3) for left in left_of_samples(study))
        what = "reduced &chi;&sup2; of the samples (1 is noise); held-out backbones stay as they are"
        return [(Raw(f"{before} &rarr; {after}"), Raw(what))]
    figures: list[tuple[object, object]] = []
    if np.isfinite(study.shrink):
        words = Raw(f"less gap on held-out data (95&nbsp;%: {interval(study)})")
        figures.append((Raw(f"{number(study.shrink, 3)} &times;"), words))
    for held_out, what in ((study.held_out_specimens, "specimens"), (study.held_out_levels, "levels")):
        if held_out is None:
            continue
        value = number(held_out.before, 3)
        if np.isfinite(held_out.after):
            value = Raw(f"{value} &rarr; {number(held_out.after, 3)}")
        figures.append((value, Raw(f"reduced &chi;&sup2; on held-out {what} (1 is noise)")))
    return figures


def _reasons(study: Study) -> str:
    return section("What to do next", bullets(next_steps(study))) + section("Why", bullets(study.reasons))


def _data(study: Study, figures: Mapping[str, Figure]) -> str:
    rows = [(in_words(check.check), Raw(_passed(check.passed)), check.message) for check in study.checks]
    columns = (("check", "head"), ("result", ""), ("finding", "text"))
    notes = [str(note) for note in study.notes]
    named = [str(name) for name in study.backbones["specimen"].values]
    picture = image(figures.get("records"), "the measured records", is_wide=True)
    return section(
        "Data",
        table(columns, rows),
        paragraph(f"Specimens: {', '.join(named)}.", "soft"),
        noted(notes, named),
        details("The records", picture),
    )


def _passed(is_passed: bool) -> str:
    return '<span class="good">passed</span>' if is_passed else '<span class="bad">look at this</span>'


def _reproduce(study: Study, version: str, command: str) -> str:
    parts = []
    if command:
        parts.append(paragraph("The same study again:") + f"<pre>{_unbroken(command)}</pre>")
    parts.append(paragraph("The posterior again, as a script to edit:") + "<pre>python model.py</pre>")
    parts.append(
        paragraph(
            f"pymc-backbone {version}, seed {study.seed}, {study.seconds:.3g} s of computation. The folder also holds "
            "result.json (all numbers), backbones.csv and .nc, and the figures as files."
        )
    )
    return section("How to reproduce this", *parts, settings_table(study.settings))


def _unbroken(command: str) -> str:
    """Return a command whose options break at no hyphen of theirs."""
    return re.sub(r"(?<=\s)(--[\w-]+)", r'<span class="u">\1</span>', escape(command))


def settings_table(settings: Mapping[str, Any]) -> str:
    """Return all settings, folded away."""
    rows: list[tuple[object, object]] = [(name, _setting(value)) for name, value in settings.items()]
    return details("All settings", table((("setting", "head"), ("value", "")), rows))


def _setting(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key}={item}" for key, item in value.items()) or "none"
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return {None: "default", True: "yes", False: "no"}.get(value, str(value)) if _is_word(value) else str(value)


def _is_word(value: Any) -> bool:
    return value is None or isinstance(value, bool)
