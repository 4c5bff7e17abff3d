"""Section of the report on what no law explains, as forces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from .._common.text import in_words
from ..discrepancy.force_curves.curve_words import SHOWN, family_in_words
from ..discrepancy.results.curve_records import Proposal
from ..discrepancy.results.study import Study
from .html import Raw, image, number, paragraph, prose, section, table
from .words import percent


def force_curves(study: Study, figures: Mapping[str, Figure]) -> str:
    """Show the force curves, say what law they may be and what they do to the gap."""
    curves = study.force_curves
    if curves is None:
        return ""
    unit = study.amplitude_unit
    pictures = "".join(
        image(figures.get(f"force_{which}"), f"{which} force over what the motion visited, with its band")
        for which in ("conservative", "damping")
    )
    named = ", ".join(map(in_words, curves.beside)) or "linear stiffness and viscous damping"
    parts = [
        paragraph(Raw(prose(curves.sentence))),
        f'<div class="pair">{pictures}</div>' if pictures else "",
        paragraph(
            f"Beside {named}. The bands hold all of a curve with a probability of 95 %, over the displacements and "
            "speeds that the motion visited; beyond them nothing is said.",
            "soft",
        ),
    ]
    if curves.is_possible:
        columns = (("force", "head"), ("may be", "text"), ("probability", "n"))
        rows = [
            (item.curve, family_in_words(item, unit if item.curve == "conservative" else f"{unit}/s"),
             percent(item.probability))
            for item in curves.proposals
            if _is_shown(item)
        ]  # fmt: skip
        parts.append(table(columns, rows))
    if np.isfinite(curves.held_out_after):
        before, after = number(curves.held_out_before, 3), number(curves.held_out_after, 3)
        parts.append(
            paragraph(
                Raw(f"Reduced &chi;&sup2; on held-out specimens: {before} without the curves, {after} with them.")
            )
        )
    parts.append(paragraph("The model with the curves, as a script to run and edit:"))
    parts.append("<pre>python model_with_curves.py</pre>")
    return section("What is left, as a force", *parts)


def _is_shown(item: Proposal) -> bool:
    return item.probability >= SHOWN
