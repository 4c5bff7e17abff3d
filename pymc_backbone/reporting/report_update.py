"""The report of an updated model: one HTML file, whether the model fits first of all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .._common.checks import OBSERVABLE_UNITS
from .._common.text import in_words
from ..inference.fit_verdict import P_LIMIT, GoodnessOfFit, probability
from .html import (
    Raw,
    bullets,
    details,
    escape,
    image,
    noted,
    number,
    page,
    paragraph,
    prose,
    section,
    table,
    tiles,
    unit,
)
from .report import settings_table
from .terminal import FOUND_NOTHING, POPULATION_WORDS, damping_ratio_words, meaningful_digits

MOST_ROWS = 12


def update_report_html(
    result: Mapping[str, Any], fit: GoodnessOfFit, figures: Mapping[str, Figure], *, command: str = ""
) -> str:
    """Return the report as one HTML page that needs no network.

    Parameters
    ----------
    result : mapping
        What ``result.json`` holds.
    fit : GoodnessOfFit
        From `goodness_of_fit`.
    figures : mapping of str to matplotlib.figure.Figure
        By name; those that are not there are left out.
    command : str, optional
        The command line that repeats the run.
    """
    kind, word = _verdict(result, fit)
    body = "".join(
        [
            _header(result, fit, word),
            section("Findings", bullets(result["findings"] or [f"Nothing wrong was found: {FOUND_NOTHING}."])),
            section(
                "Measured against predicted",
                image(figures.get("predictive"), "measured and predicted backbones over amplitude", is_wide=True),
            ),
            _misfit(fit, result),
            _population(result, figures),
            _parameters(result, figures),
            _sampling(result, figures),
            _data(result, figures),
            _reproduce(result, command),
        ]
    )
    footer = f"<footer>pymc-backbone {escape(result['version'])} &middot; seed {escape(result['seed'])}</footer>\n"
    return page(f"{word}: {fit.headline()}", kind, body + footer)


def _verdict(result: Mapping[str, Any], fit: GoodnessOfFit) -> tuple[str, str]:
    """Return the tone of the page and its word."""
    if fit.passes and not result["findings"]:
        return "adequate", "\N{CHECK MARK} The model fits"
    if fit.passes:
        return "ambiguous", "? Fits, with findings"
    if fit.p_value != fit.p_value:
        return "ambiguous", "? Not checked"
    if fit.excluded:
        return "unexplained", "! Prior excludes the data"
    if fit.describes_specimens:
        return "ambiguous", "? Specimens differ" if fit.pooling_p_value < P_LIMIT else "? Posterior beside the data"
    return "unexplained", "! Does not fit"


def _header(result: Mapping[str, Any], fit: GoodnessOfFit, word: str) -> str:
    count = len(result["specimens"])
    kind = "hierarchical model" if result.get("population") else f"{fit.likelihood} likelihood"
    kicker = f"Updated model of {count} {'specimen' if count == 1 else 'specimens'}, {kind}"
    pairs: list[tuple[object, object]] = [
        (probability(fit.p_value), "chance of such a misfit if the model were right"),
        (number(fit.reduced_chi_square, 3), "reduced chi-square: 1 is what measurement error explains"),
        (number(fit.degrees_of_freedom, 3), "degrees of freedom: independent level values less fitted parameters"),
    ]
    if fit.pooling_p_value == fit.pooling_p_value:
        pairs.append((probability(fit.pooling_p_value), "chance of such a scatter if the specimens were alike"))
    equation = escape(str(result["equation"]).splitlines()[0])
    return "\n".join(
        [
            f'<header>\n<span class="word">{escape(word)}</span><span class="kicker">{escape(kicker)}</span>',
            f"<h1>{prose(fit.headline())}</h1>",
            f"<pre><b>{equation}</b></pre>",
            tiles(pairs),
            "</header>\n",
        ]
    )


def _ratio(result: Mapping[str, Any]) -> str:
    """Say the measured damping as a damping ratio, too."""
    rows = [row for row in result["comparison"] if row["observable"] == "damping"]
    decrements, levels = [row["measured_mean"] for row in rows], [row["level"] for row in rows]
    return damping_ratio_words(decrements, levels, str(result["amplitude_unit"]))


def _misfit(fit: GoodnessOfFit, result: Mapping[str, Any]) -> str:
    """List how each specimen is fitted, and the level values that are furthest off."""
    rows = [
        (
            one.specimen,
            number(one.chi_square, 3),
            number(one.degrees_of_freedom, 3),
            number(one.reduced_chi_square, 3),
            probability(one.p_value).removeprefix("p ").removeprefix("= ") if one.p_value == one.p_value else "-",
        )
        for one in fit.specimens
    ]
    columns = (
        ("specimen", "head"),
        ("chi-square", "n"),
        ("degrees", "n"),
        ("reduced", "n"),
        ("p", "n"),
    )
    bad = {one.specimen for one in fit.bad_specimens}
    each = table(columns, rows[:MOST_ROWS], strong=[i for i, row in enumerate(rows) if row[0] in bad])
    rest = details(f"{len(rows) - MOST_ROWS} more specimens", table(columns, rows[MOST_ROWS:]))
    furthest = sorted((entry for entry in fit.entries if entry.z == entry.z), key=lambda entry: -abs(entry.z))
    values = table(
        (
            ("observable", "head"),
            ("specimen", ""),
            (f"level [{fit.amplitude_unit}]", "n"),
            ("measured", "n"),
            ("error", "n"),
            ("predicted", "n"),
            ("95 %", ""),
            ("difference / sd", "n"),
            ("unit", ""),
        ),
        [
            (
                entry.observable,
                entry.specimen if entry.specimen is not None else "mean of all",
                number(entry.level, 4),
                number(entry.measured, 5),
                number(entry.standard_error, 2),
                number(entry.predicted, 5),
                Raw(f"{number(entry.low, 5)} to {number(entry.high, 5)}"),
                number(entry.z, 3),
                unit(OBSERVABLE_UNITS.get(entry.observable, "1")),
            )
            for entry in furthest[:MOST_ROWS]
        ],
    )
    note = paragraph(
        "Each specimen by itself, fitted with parameters of its own inside the priors: scatter of the specimens is no "
        "misfit. Degrees are those of freedom. Stressed: not fitted even so.",
        "soft",
    )
    return section(
        "Misfit of each specimen",
        note,
        each,
        rest,
        paragraph(_ratio(result), "soft"),
        details("The level values that are furthest from the posterior predictive", values, is_open=not fit.passes),
    )


def _population(result: Mapping[str, Any], figures: Mapping[str, Figure]) -> str:
    """Say what a hierarchical model found about the population; nothing for another."""
    population = result.get("population")
    if not population:
        return ""
    units = {name.partition("[")[0]: entry["unit"] for name, entry in result["parameters"].items()}
    rows = []
    for name, of in population["parameters"].items():
        for key, what in POPULATION_WORDS.items():
            prior = f"{number(of[key]['prior_low'], 3)} to {number(of[key]['prior_high'], 3)}"
            rows.append((f"{in_words(name)}, {what}", *_numbers(of[key]), unit(units[name]), Raw(prior)))
    pairs = [(" and ".join(map(in_words, entry["between"])), *_numbers(entry)) for entry in population["correlations"]]
    count = len(result["specimens"])
    family = "Uniform, with edges that are inferred" if population["family"] == "uniform" else "Normal"
    note = (
        f"The batch that the {count} specimens were drawn from, those included that nobody has measured. Its family is "
        f"taken to be {family}. With few specimens the prior of the spread counts; the column prior holds its central "
        "95 %."
    )
    columns = (("95 % HDI", ""), ("R-hat", "n"), ("effective draws", "n"))
    return section(
        "The population",
        paragraph(note, "soft"),
        image(figures.get("population"), "specimens and the population they were drawn from", is_wide=True),
        table((("over the batch", "head"), ("mean", "n"), ("sd", "n"), *columns, ("unit", ""), ("prior", "")), rows),
        table((("correlation over the batch", "head"), ("mean", "n"), ("sd", "n"), *columns), pairs) if pairs else "",
    )


def _numbers(entry: Mapping[str, Any]) -> tuple[Raw, ...]:
    """Return mean, sd, interval, R-hat and effective draws of one number."""
    digits = meaningful_digits(entry["hdi_low"], entry["hdi_high"], entry["sd"])
    return (
        number(entry["mean"], digits),
        number(entry["sd"], 2),
        Raw(f"{number(entry['hdi_low'], digits)} to {number(entry['hdi_high'], digits)}"),
        number(entry["r_hat"], 4),
        number(np.round(entry["ess_bulk"]), 4),
    )


def _parameters(result: Mapping[str, Any], figures: Mapping[str, Figure]) -> str:
    rows = []
    is_own = not result.get("population")  # whether the parameters' priors are intervals
    for name, entry in result["parameters"].items():
        prior = Raw(f"{number(entry['prior_low'], 3)} to {number(entry['prior_high'], 3)}")
        row = (in_words(name), *_numbers(entry), unit(entry["unit"]), prior)
        rows.append(row if is_own else row[:-1])
    columns = (
        ("parameter", "head"),
        ("mean", "n"),
        ("sd", "n"),
        ("95 % HDI", ""),
        ("R-hat", "n"),
        ("effective draws", "n"),
        ("unit", ""),
        ("prior", ""),
    )
    meaning = {
        "population": "Mean and sd are those of the distribution over the batch.",
        "specimen": "Mean and sd are those of what is known of each specimen; they hold no scatter between specimens.",
        "pooled": "Mean and sd are those of what is known of the one parameter set; they hold no scatter between "
        "specimens.",
    }[result["fit"]["likelihood"]]
    fixed = ", ".join(f"{in_words(name)} = {value:.6g}" for name, value in result["fixed"].items())
    return section(
        "Parameters" if is_own else "Parameters of each specimen",
        table(columns if is_own else columns[:-1], rows[: 3 * MOST_ROWS]),
        details(f"{len(rows) - 3 * MOST_ROWS} more", table(columns if is_own else columns[:-1], rows[3 * MOST_ROWS :])),
        paragraph(f"{meaning}{f' Held fixed: {fixed}.' if fixed else ''}", "soft"),
        image(figures.get("prior_posterior"), "prior and posterior of the parameters"),
        details("Equation of motion", f"<pre>{escape(result['equation'])}</pre>"),
    )


def _sampling(result: Mapping[str, Any], figures: Mapping[str, Figure]) -> str:
    pictures = [
        image(figures.get(name), text, is_wide=True)
        for name, text in (("trace", "traces"), ("rank", "rank plots"), ("pair", "pairs of parameters"))
    ]
    entries = [*result["parameters"].values()]
    if result.get("population"):
        entries += [entry for of in result["population"]["parameters"].values() for entry in of.values()]
        entries += result["population"]["correlations"]
    pairs = [
        (number(max((entry["r_hat"] for entry in entries), default=float("nan")), 4), "largest R-hat (below 1.01)"),
        (
            number(np.round(min((entry["ess_bulk"] for entry in entries), default=float("nan"))), 4),
            "smallest number of effective draws (above 400)",
        ),
    ]
    return section("Sampling", tiles(pairs), details("Traces, ranks and pairs", *pictures))


def _data(result: Mapping[str, Any], figures: Mapping[str, Figure]) -> str:
    notes = [str(note) for note in result["notes"]]
    pictures = [
        image(figures.get(name), text, is_wide=True)
        for name, text in (
            ("records", "the measured records"),
            ("backbones", "the measured backbones"),
            ("densities", "densities over the specimens"),
        )
    ]
    return section(
        "Data",
        paragraph(f"Specimens: {', '.join(result['specimens'])}.", "soft"),
        noted(notes, [str(name) for name in result["specimens"]]),
        details("Records, backbones and densities", *pictures),
    )


def _reproduce(result: Mapping[str, Any], command: str) -> str:
    again = paragraph("The same run again:") + f"<pre>{escape(command)}</pre>" if command else ""
    note = paragraph(
        "The folder also holds result.json (all numbers), summary.csv, backbones.csv and .nc, posterior.nc (all draws) "
        "and the figures as files."
    )
    return section("How to reproduce this", again, note, settings_table(result["settings"]))
