"""Sections of the report on the gap: the curves, where they differ, and held-out data."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from ..discrepancy.results.entries import HeldOut
from ..discrepancy.results.study import Study
from ..discrepancy.results.verdict import Status, Verdict
from .html import Raw, escape, image, number, paragraph, section, table, unit
from .style import engineering
from .terminal import measured_damping_words
from .words import is_in_waveforms_only, left_of_samples

_MUCH = 2.0  # reduced chi-square of held-out specimens, from which it is told


def curves(study: Study, figures: Mapping[str, Figure]) -> str:
    """Show measured and simulated backbones, and the gap between them."""
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
    note += f" {measured_damping_words(study.backbones)}"
    return section(words, *parts, paragraph(note.rstrip(), "soft")) if words else ""


def where(study: Study) -> str:
    """Say at which amplitudes base model and measurement differ."""
    rows = []
    for item in study.where:
        low, high, name = amplitudes(study, item.amplitude_low, item.amplitude_high)
        is_bare = item.unit == "1"
        gap = number(item.gap, 3) if is_bare else Raw(f"{number(item.gap, 3)} {unit(item.unit)}")
        rows.append(
            (
                item.observable,
                Raw(f"{low if low == high else f'{low} to {high}'} {escape(name)}"),
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
        said = "At no level do the backbones of base model and measurement differ beyond their error"
        waveforms = "" if study.verdict == Verdict.ADEQUATE else "; what is left shows in the waveforms"
        return section("Where", paragraph(f"{said}{waveforms}."))
    return section("Where base model and measurement differ", table(columns, rows))


def held_out_gap(study: Study, figures: Mapping[str, Figure]) -> str:
    """Show the gap on data that the fit has not seen."""
    parts = []
    sources = ((study.held_out_specimens, "specimen"), (study.held_out_levels, "level"))
    pictures = "".join(
        image(figures.get(f"held_out_{what}s"), f"reduced chi-square of each held-out {what}") for _, what in sources
    )
    rows = [_held_out_row(held_out, what) for held_out, what in sources if held_out is not None]
    columns = (("left out", "head"), ("number", "n"), ("before", "n"), ("after", "n"))
    parts.append(table(columns, rows))
    if is_in_waveforms_only(study):
        before, after = (number(left, 3) for left in left_of_samples(study))
        parts.append(
            paragraph(
                Raw(
                    "The backbones on held-out data stay as they are: what was added shows in the waveforms, whose "
                    f"reduced chi-square falls from <b>{before}</b> to <b>{after}</b>."
                )
            )
        )
    elif np.isfinite(study.shrink):
        parts.append(
            paragraph(
                Raw(f"The gap shrinks by a factor of <b>{number(study.shrink, 3)}</b> (95&nbsp;%: {interval(study)}).")
            )
        )
    held_out = study.held_out_specimens
    if study.verdict == Verdict.FOUND and held_out is not None and held_out.after > _MUCH:
        parts.append(
            paragraph(
                Raw(
                    f"What is left on held-out specimens is {number(held_out.after, 2)} times what "
                    "noise gives: they differ by more than stiffness, damping and the scatter of the effects, or a "
                    "small part is not named."
                )
            )
        )
    note = "Reduced chi-square; 1 is what measurement noise alone gives. "
    note += "A level is predicted from the others; for a specimen only linear stiffness and viscous damping are fitted."
    if any(item.status == Status.BEST and item.has_drift for item in study.candidates):
        note += " The drift with time is in none of these."
    parts += [f'<div class="pair">{pictures}</div>' if pictures else "", paragraph(note, "soft")]
    return section("The gap on data that the fit has not seen", *parts) if rows else ""


def _held_out_row(held_out: HeldOut, what: str) -> tuple[object, ...]:
    return (
        f"{what}s",
        int(np.isfinite(held_out.before_each).sum()),
        number(held_out.before, 3),
        number(held_out.after, 3),
    )


def interval(study: Study) -> str:
    """Return the interval of the factor by which the gap shrinks."""
    return f"{number(study.shrink_low, 3)} to {number(study.shrink_high, 3)}"


def amplitudes(study: Study, low: float, high: float) -> tuple[Raw, Raw, str]:
    """Return two amplitudes and their unit, in the prefix that suits all levels."""
    name = study.amplitude_unit
    scale, prefix = engineering(float(np.asarray(study.backbones["level"]).max()), name)
    return number(low * scale, 3), number(high * scale, 3), f"{prefix}{name}"
