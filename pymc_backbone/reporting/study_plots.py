"""Figures of a finished `Study`: backbones before and after, the gap, candidates, held-out data, parameters.

Every figure is one column wide, so that a report can set two side by side on a desktop and stack them on a phone.
`study_figures` draws all that apply.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, NullLocator

from .._common.checks import FloatArray
from ..discrepancy.locate import mean_gap
from ..discrepancy.study import HeldOut, Study
from ..discrepancy.verdict import Status
from .posterior_plots import plot_rank, plot_records, plot_trace
from .style import (
    FEW,
    MEASURED,
    QUIET,
    SIMULATED,
    TRUE,
    amplitude_axis,
    drawable,
    evenly,
    label_axes,
    layout,
    legend_below,
    observable_label,
    parameter_axis,
    smooth,
)
from .words import added_effects, percent, set_name

BEFORE, AFTER = SIMULATED, TRUE
STATUS_COLOURS: dict[str, str] = {
    Status.BEST: MEASURED,
    Status.POSSIBLE: "#56B4E9",
    Status.REJECTED: QUIET,
    Status.FAILED: "#C9C9C9",
}
MOST_CANDIDATES = 12
MOST_ROWS = 24  # of specimens or levels in one figure
_WIDTH = 4.8


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
        Figures by name: ``backbones_<observable>`` and ``gap_<observable>`` for each observable, ``candidates``,
        ``held_out_levels``, ``held_out_specimens``, ``parameters``, ``detectable``, ``trace``, ``rank``, ``records``.

    See Also
    --------
    find_missing_effect : makes the study.
    write_study : writes these into a report.
    """
    figures: dict[str, Figure] = {}
    for name in map(str, study.backbones["observable"].values):
        figures[f"backbones_{name}"] = plot_before_after(study, name)
        figures[f"gap_{name}"] = plot_gap(study, name)
    if study.candidates:
        figures["candidates"] = plot_candidates(study)
    if study.held_out_levels is not None:
        figures["held_out_levels"] = plot_held_out(study.held_out_levels, "level")
    if study.held_out_specimens is not None:
        figures["held_out_specimens"] = plot_held_out(study.held_out_specimens, "specimen")
    if study.parameters:
        figures["parameters"] = plot_parameters(study)
    if study.detectable:
        figures["detectable"] = plot_detectable(study)
    if study.posterior is not None:
        names = [name for name in study.posterior_bounds if name in study.posterior["posterior"]]
        units = (study.extended or study.base).units
        figures["trace"] = plot_trace(study.posterior, names, units=units)
        figures["rank"] = plot_rank(study.posterior, names, units=units)
    if len(records):
        figures["records"] = plot_records(records)
    return figures


def plot_before_after(study: Study, observable: str) -> Figure:
    """Draw the measured backbones over those simulated with the base model, and with the extended one below.

    Parameters
    ----------
    study : Study
        With ``backbones``, ``before`` and perhaps ``after``.
    observable : str
        One of those it holds.

    Returns
    -------
    matplotlib.figure.Figure
        Error bars span 95 %; up to 12 specimens have them, more are drawn as lines.
    """
    levels, scale, amplitude_label = amplitude_axis(study.backbones)
    value, error = _of(study.backbones, observable)
    models = [("base model", study.before, BEFORE)]
    titles = ["Base model"]
    if study.after is not None:
        models.append(("extended model", study.after, AFTER))
        titles = ["Before: base model", f"After: with {drawable(set_name(added_effects(study)), 48)}"]
    figure = Figure(figsize=(_WIDTH, _height(len(models))), layout=layout())
    axes = figure.subplots(len(models), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    shade = 1.0 if len(value) <= 3 else 0.75
    for axis, title, (_, simulated, colour) in zip(axes, titles, models, strict=True):
        model, _ = _of(simulated, observable)
        axis.plot(
            levels * scale, np.where(np.isfinite(value), model, np.nan).T, color=colour, linewidth=1.2, alpha=shade
        )
        if len(value) > FEW:
            axis.plot(levels * scale, value.T, color=MEASURED, linewidth=0.6, alpha=0.6)
        for one, spread in zip(value, 1.96 * error, strict=True):
            if len(value) <= FEW:
                here = np.isfinite(one)
                axis.errorbar(
                    levels[here] * scale,
                    one[here],
                    yerr=np.nan_to_num(spread[here]),
                    color=MEASURED,
                    fmt="o",
                    markersize=3.0,
                    elinewidth=0.9,
                    alpha=0.9,
                    zorder=3,
                )
        label_axes(axis, amplitude_label, observable)
        axis.yaxis.set_major_locator(MaxNLocator(5))
        axis.tick_params(labelsize=9)
        axis.set_ylabel("")
        axis.set_title(title, fontsize=9, loc="left", color=colour)
        axis.label_outer()
    figure.supylabel(observable_label(observable), fontsize=10)
    axes[-1].plot([], [], color=MEASURED, marker="o", markersize=3.0, linewidth=0.9, label="measured, 95 %")
    for label, _, colour in models:
        axes[-1].plot([], [], color=colour, linewidth=1.4, label=label)
    legend_below(axes[-1], 3, columnspacing=1.2)
    return figure


def plot_gap(study: Study, observable: str) -> Figure:
    """Draw measured minus simulated, mean over the specimens, before and after, with what is tolerated.

    Parameters
    ----------
    study : Study
        With ``backbones``, ``before``, perhaps ``after``, and ``tolerance``.
    observable : str
        One of those it holds.

    Returns
    -------
    matplotlib.figure.Figure
        Bands are 95 % of the mean's error, from measurement or from the scatter of the specimens; the tolerance is a
        grey band.
    """
    levels, scale, amplitude_label = amplitude_axis(study.backbones)
    value, _ = _of(study.backbones, observable)
    models = [("before" if study.after is not None else "base model", study.before, BEFORE)]
    if study.after is not None:
        models.append(("after", study.after, AFTER))
    row = [str(name) for name in study.backbones["observable"].values].index(observable)
    curves = []
    for label, simulated, colour in models:
        mean, spread = mean_gap(study.backbones, simulated)
        curves.append((label, colour, mean[row], spread[row]))
    tolerated = _tolerated(study, observable, value)
    largest = np.concatenate([np.abs(mean) + 1.96 * np.nan_to_num(spread) for _, _, mean, spread in curves])
    unit, label = parameter_axis(f"gap in {observable}", largest[np.isfinite(largest)], _gap_units(observable))
    figure = Figure(figsize=(_WIDTH, _height(len(models))), layout=layout())
    axis = figure.subplots()
    if tolerated is not None:
        axis.fill_between(
            levels * scale, -tolerated * unit, tolerated * unit, color=QUIET, alpha=0.18, linewidth=0, label="tolerated"
        )
    axis.axhline(0.0, color="black", linewidth=0.7)
    for name, colour, mean, spread in curves:
        here = np.isfinite(mean)
        x, y, band = levels[here] * scale, mean[here] * unit, 1.96 * np.nan_to_num(spread[here]) * unit
        axis.fill_between(x, y - band, y + band, color=colour, alpha=0.25, linewidth=0)
        axis.plot(x, y, color=colour, marker="o", markersize=3.0, linewidth=1.4, label=name, zorder=3)
    axis.margins(y=0.08)
    label_axes(axis, amplitude_label, observable)
    axis.set_ylabel(label)
    if tolerated is not None:  # a wide tolerance must not flatten the gap
        finite = largest[np.isfinite(largest)] * unit
        most = 1.15 * max(float(finite.max(initial=0.0)), 1e-300)
        axis.set_ylim(-most, most)
    legend_below(axis, 3)
    mean_of = f", mean of {len(value)} specimens" if len(value) > 1 else ""
    axis.set_title(f"Measured minus simulated{mean_of}", fontsize=9, loc="left")
    return figure


def plot_candidates(study: Study, *, most: int = MOST_CANDIDATES) -> Figure:
    """Draw the probability of the most probable sets as bars.

    Parameters
    ----------
    study : Study
        With ``candidates``.
    most : int, optional
        Largest number of bars; 12 by default.

    Returns
    -------
    matplotlib.figure.Figure
        The colour says what became of each set.
    """
    shown = study.candidates[:most]
    figure = Figure(figsize=(_WIDTH, 0.42 * len(shown) + 1.15), layout=layout())
    axis = figure.subplots()
    for row, candidate in enumerate(shown):
        colour = STATUS_COLOURS.get(candidate.status, QUIET)
        share = candidate.probability if np.isfinite(candidate.probability) else 0.0
        axis.barh(row, share, height=0.34, color=colour)
        axis.barh(row, 1.0, height=0.34, color=QUIET, alpha=0.10, zorder=0)
        weight = "bold" if candidate.status == Status.BEST else "normal"
        axis.text(0.0, row - 0.24, set_name(candidate.effects), fontsize=8, va="bottom", weight=weight)
        axis.text(1.0, row - 0.24, percent(candidate.probability), fontsize=8, va="bottom", ha="right", weight=weight)
    axis.set_ylim(len(shown) - 0.6, -0.85)
    axis.set_xlim(0.0, 1.0)
    axis.set_yticks([])
    axis.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"], fontsize=8)
    axis.set_xlabel("Probability", fontsize=9)
    axis.spines[["left", "top", "right"]].set_visible(False)
    for status in dict.fromkeys(candidate.status for candidate in shown):
        axis.barh(np.nan, np.nan, color=STATUS_COLOURS.get(status, QUIET), label=status)
    legend_below(axis, 4)
    rest = len(study.candidates) - len(shown)
    if rest > 0:
        axis.set_title(f"The {len(shown)} most probable of {len(study.candidates)} sets", fontsize=9, loc="left")
    return figure


def plot_held_out(held_out: HeldOut, what: str) -> Figure:
    """Draw the reduced chi-square of each left-out level or specimen, before and after.

    Parameters
    ----------
    held_out : HeldOut
        The gap on data that the fit has not seen.
    what : str
        ``level`` or ``specimen``: what was left out.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each; one is what measurement noise alone gives.
    """
    chosen = evenly(len(held_out.labels), MOST_ROWS)
    before, after = (np.asarray(each, dtype=float)[chosen] for each in (held_out.before_each, held_out.after_each))
    rows = np.arange(len(chosen))
    figure = Figure(figsize=(_WIDTH, 0.25 * len(chosen) + 1.35), layout=layout())
    axis = figure.subplots()
    positive = np.concatenate([before, after])
    positive = positive[np.isfinite(positive) & (positive > 0.0)]
    least = float(positive.min()) if positive.size else 1.0
    before, after = (np.where(each > 0.0, each, np.where(np.isfinite(each), least, np.nan)) for each in (before, after))
    axis.axvline(1.0, color="black", linewidth=0.8, linestyle="--", label="noise alone")
    axis.hlines(rows, np.fmin(before, after), np.fmax(before, after), color=QUIET, linewidth=1.2, alpha=0.6)
    has_after = bool(np.isfinite(after).any())
    axis.plot(before, rows, "o", color=BEFORE, markersize=5.0, label="before" if has_after else "base model")
    if has_after:
        axis.plot(after, rows, "o", color=AFTER, markersize=5.0, label="after")
    axis.set_xscale("log")
    low, high = min(0.5, 0.7 * least), max(2.0, 1.4 * float(positive.max(initial=1.0)))
    axis.set_xlim(low, high)
    if high / low < 100.0:
        ticks = [tick for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if low <= tick <= high]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_yticks(rows, [drawable(held_out.labels[i], 22) for i in chosen], fontsize=8)
    axis.set_ylim(len(chosen) - 0.4, -0.6)
    axis.set_xlabel(f"Reduced chi-square of the {what} left out", fontsize=9)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5, axis="x")
    axis.tick_params(axis="x", labelsize=8)
    legend_below(axis, 3)
    return figure


def plot_parameters(study: Study) -> Figure:
    """Draw each parameter: density of the draws, or an interval for each specimen, with the 95 % HDI over the batch.

    Parameters
    ----------
    study : Study
        With ``parameters``; draws are used where there are any.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each parameter.
    """
    estimates = {name: estimate for group in study.parameters.values() for name, estimate in group.items()}
    units = {name: estimate.unit for name, estimate in estimates.items()}
    draws = {} if study.posterior is None else study.posterior["posterior"].to_dataset()
    shapes = [_by_specimen(draws, name) for name in estimates]
    heights = [0.7 + (0.45 if len(shape) == 1 else 0.15 + 0.13 * min(len(shape), MOST_ROWS)) for shape in shapes]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.75), layout=layout())
    axes = figure.subplots(len(estimates), 1, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for axis, (name, estimate), values in zip(axes, estimates.items(), shapes, strict=True):
        ends = np.array([estimate.mean, estimate.hdi_low, estimate.hdi_high])
        scale, label = parameter_axis(name, ends[np.isfinite(ends)], units)
        if len(values) > 1:
            _draw_specimens(axis, values[evenly(len(values), MOST_ROWS)] * scale)
        elif len(values) == 1 and np.ptp(values[0]) > 0.0:
            x, density = smooth(values[0] * scale)
            axis.fill_between(x, density / density.max(), color=MEASURED, alpha=0.3, linewidth=0)
            axis.plot(x, density / density.max(), color=MEASURED, linewidth=1.2)
        base = -1.4 if len(values) > 1 else -0.2
        axis.plot(ends[1:] * scale, [base, base], color="black", linewidth=3.0, solid_capstyle="butt", label="95 % HDI")
        axis.plot(ends[0] * scale, base, "o", color="white", markeredgecolor="black", markersize=5.0, label="mean")
        axis.set_ylim(bottom=base - (1.0 if len(values) > 1 else 0.25))
        if len(values) == 0:
            axis.set_ylim(-0.5, 0.1)
        axis.set_yticks([])
        axis.set_xlabel(label, fontsize=9)
        axis.xaxis.set_major_locator(MaxNLocator(5))
        axis.ticklabel_format(axis="x", useOffset=False)
        axis.tick_params(labelsize=8)
        axis.spines[["left", "top", "right"]].set_visible(False)
    if any(len(values) > 1 for values in shapes):
        axes[0].plot([], [], color=MEASURED, linewidth=1.4, label="specimens, 95 %")
    elif any(len(values) == 1 for values in shapes):
        axes[0].fill_between([], [], color=MEASURED, alpha=0.3, label="posterior")
    legend_below(axes[0], 3)
    return figure


def plot_detectable(study: Study) -> Figure:
    """Draw the smallest effects that these data would have shown, as relative changes of frequency and damping.

    Parameters
    ----------
    study : Study
        With ``detectable``.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each effect; ticks mark the tolerance.
    """
    rows = [item for item in study.detectable if np.isfinite(item.frequency) or np.isfinite(item.damping)]
    rows = rows or list(study.detectable)
    figure = Figure(figsize=(_WIDTH, 0.3 * len(rows) + 1.4), layout=layout())
    axis = figure.subplots()
    drawn: list[float] = []
    for name, colour, marker in (("frequency", MEASURED, "o"), ("damping", SIMULATED, "s")):
        change = 100.0 * np.abs(np.array([getattr(item, name) for item in rows], dtype=float))
        change[change == 0.0] = np.nan
        drawn += list(change[np.isfinite(change)])
        axis.plot(change, np.arange(len(rows)), marker, color=colour, markersize=5.0, label=name)
        tolerance = 100.0 * float(study.tolerance.get(name, 0.0))
        if tolerance > 0.0:
            drawn.append(tolerance)
            axis.axvline(tolerance, color=colour, linewidth=0.9, linestyle=":", label=f"tolerance, {name}")
    axis.set_xscale("log")
    if drawn:
        axis.set_xlim(0.4 * min(drawn), 2.5 * max(drawn))
    axis.xaxis.set_major_formatter(lambda tick, _: f"{tick:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_yticks(np.arange(len(rows)), [item.effect.replace("_", " ") for item in rows], fontsize=8)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("Largest change over the levels [%]", fontsize=9)
    axis.tick_params(axis="x", labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5, axis="x")
    legend_below(axis, 2)
    return figure


def _height(panels: int) -> float:
    """Return the height [inches] of the two figures that stand side by side for an observable."""
    return 1.75 * panels + 1.35


def _of(backbones: xr.Dataset, observable: str) -> tuple[FloatArray, FloatArray]:
    """Values and standard errors (specimen, level) of one observable."""
    picked = backbones.sel(observable=observable)
    return np.asarray(picked["value"], dtype=float), np.asarray(picked["standard_error"], dtype=float)


def _gap_units(observable: str) -> dict[str, str]:
    unit = observable_label(observable).partition("[")[2].rstrip("]")
    return {f"gap in {observable}": "1" if unit == "-" else unit}


def _tolerated(study: Study, observable: str, value: FloatArray) -> FloatArray | None:
    """Return what the tolerance allows at each level, in the observable's unit; the offset's is not relative."""
    tolerance = float(study.tolerance.get(observable, 0.0))
    if not tolerance > 0.0:
        return None
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Mean of empty slice", category=RuntimeWarning)
        mean = np.abs(np.nanmean(value, axis=0))
    return tolerance * (np.ones_like(mean) if observable == "offset" else mean)


def _by_specimen(draws: Any, name: str) -> FloatArray:
    """Draws of a parameter: a row for each specimen, one row where all share it, none where nothing was sampled."""
    if name not in draws:
        return np.zeros((0, 0))
    variable = draws[name]
    other = [dim for dim in variable.dims if dim not in ("chain", "draw")]
    values = np.asarray(variable.transpose(*other, "chain", "draw"), dtype=float)
    return values.reshape(-1, variable.sizes["chain"] * variable.sizes["draw"])


def _draw_specimens(axis: Axes, values: FloatArray) -> None:
    from arviz_stats import hdi

    for row, one in enumerate(values):
        low, high = np.asarray(hdi(one, prob=0.95))
        axis.plot([low, high], [row, row], color=MEASURED, linewidth=1.4, solid_capstyle="butt")
        axis.plot(one.mean(), row, "o", color=MEASURED, markersize=3.0)
