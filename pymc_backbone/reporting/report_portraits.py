"""Section of the report on single records: spectrum over time, force, distortion."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from ..discrepancy.results.study import Study
from .html import image, paragraph, section

_FROM_MID_LINE = (
    " Integration of the record lost its mid-line, and displacement is counted from that, in the models as well: a "
    "spring that differs between the two sides bends both pictures."
)


def portraits(study: Study, figures: Mapping[str, Figure]) -> str:
    """Show what single records tell beside their backbones, each picture with what to read from it."""
    if study.portraits is None:
        return ""
    shown = study.portraits
    forces = image(
        figures.get("force_sections"),
        f"measured force of {shown.specimen} beyond the linear spring over displacement and over speed, and the models",
        caption="Force beyond the base model's linear spring, from the measured acceleration (bars: 95 % of its "
        "error). A model whose line misses the points above lacks a spring, one that misses them below lacks damping."
        + ("" if shown.has_mid_line else _FROM_MID_LINE),
    )
    distortion = image(
        figures.get("distortion"),
        f"harmonics 2 to 5 of {shown.specimen} over the fundamental as functions of amplitude, with the models",
        caption="Harmonics over the fundamental. Points above the grey that no line meets are a force that the model "
        "lacks: even ones by one that differs between the sides, odd ones by one that does not; in the grey they are "
        "noise.",
    )
    spectra = "".join(
        image(
            figures.get(f"time_frequency_{number + 1}"),
            f"spectrum of {item.specimen} over time, with the frequency that was followed",
            caption="A single dark line with its multiples is one mode; another line that keeps its own frequency is a "
            "second mode, to be kept out with a band. The coloured line must lie on a dark one.",
        )
        for number, item in enumerate(shown.spectra)
    )
    pair = f'<div class="pair">{forces}{distortion}</div>' if forces or distortion else ""
    more = f'<div class="pair">{spectra}</div>' if spectra else ""
    if not pair and not more:
        return ""
    note = "Of one record each; the models are fitted to it, and treated as it was." if pair else ""
    return section("What single records show", pair, more, paragraph(note, "soft") if note else "")
