"""All figures of a finished `Study`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from .._common.text import unit_of
from ..discrepancy.results.study import Study
from .backbone_plots import plot_records
from .candidate_plots import plot_candidates, plot_detectable, plot_parameters
from .curve_plots import plot_force
from .gap_plots import plot_before_after, plot_gap, plot_held_out
from .portrait_plots import plot_distortion, plot_force_sections, plot_time_frequency
from .posterior_plots import plot_rank, plot_trace


def study_figures(study: Study, records: Sequence[Any] = ()) -> dict[str, Figure]:
    """Draw every figure that applies to a study.

    Parameters
    ----------
    study : Study
        What `find_missing_effect` returned.
    records : sequence of Record, optional
        The measured records, drawn too if given.

    Returns
    -------
    dict
        Figures by name: ``backbones_<observable>`` and ``gap_<observable>`` for each observable,
        ``force_conservative``, ``force_damping``, ``candidates``,
        ``held_out_levels``, ``held_out_specimens``, ``parameters``, ``detectable``, ``trace``, ``rank``, ``records``;
        ``time_frequency_<number>``, ``force_sections``, ``distortion`` where a record tells them.

    See Also
    --------
    find_missing_effect : makes the study.
    write_study : writes these into a report.
    """
    figures: dict[str, Figure] = {}
    for name in map(str, study.backbones["observable"].values):
        figures[f"backbones_{name}"] = plot_before_after(study, name)
        figures[f"gap_{name}"] = plot_gap(study, name)
    if study.force_curves is not None:
        for which in ("conservative", "damping"):
            unit = study.amplitude_unit
            figures[f"force_{which}"] = plot_force(study.force_curves, which, unit)
    if study.candidates:
        figures["candidates"] = plot_candidates(study)
    if study.held_out_levels is not None:
        figures["held_out_levels"] = plot_held_out(study.held_out_levels, "level", study.amplitude_unit)
    if study.held_out_specimens is not None:
        figures["held_out_specimens"] = plot_held_out(study.held_out_specimens, "specimen")
    if study.parameters:
        figures["parameters"] = plot_parameters(study)
    if study.detectable:
        figures["detectable"] = plot_detectable(study)
    if study.posterior is not None:
        names = [name for name in study.posterior_bounds if name in study.posterior["posterior"]]
        amplitude_unit = study.amplitude_unit
        units = {name: unit_of(text, amplitude_unit) for name, text in (study.extended or study.base).units.items()}
        figures["trace"] = plot_trace(study.posterior, names, units=units)
        figures["rank"] = plot_rank(study.posterior, names, units=units)
    figures |= _of_single_records(study)
    if len(records):
        figures["records"] = plot_records(records)
    return figures


def _of_single_records(study: Study) -> dict[str, Figure]:
    """Draw what single records show beside their backbones."""
    shown = study.portraits
    figures: dict[str, Figure] = {}
    if shown is None:
        return figures
    unit = study.amplitude_unit
    for number, spectrum in enumerate(shown.spectra, start=1):
        figures[f"time_frequency_{number}"] = plot_time_frequency(spectrum)
    if shown.has_forces:
        figures["force_sections"] = plot_force_sections(shown, unit)
    if shown.measured is not None:
        figures["distortion"] = plot_distortion(shown, unit)
    return figures
