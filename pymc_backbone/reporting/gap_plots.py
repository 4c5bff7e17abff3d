"""Figures of the gap between model and measurement: before and after, and on held-out data.

Every figure is one column wide, so that a report can set two side by side on a desktop and stack them on a phone.
"""

from __future__ import annotations

import warnings

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, NullLocator

from .._common.checks import FloatArray
from ..discrepancy.results.entries import HeldOut
from ..discrepancy.results.locate import mean_gap
from ..discrepancy.results.study import Study
from .style import (
    COLUMN,
    FEW,
    MEASURED,
    MOST_ROWS,
    QUIET,
    SIMULATED,
    TRUE,
    amplitude_axis,
    drawable,
    drawable_names,
    engineering,
    evenly,
    label_axes,
    layout,
    legend_below,
    observable_label,
    parameter_axis,
)
from .words import added_effects, set_name

BEFORE, AFTER = SIMULATED, TRUE
MOST_LETTERS = 54  # of a title in letters of full size


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
        titles = ["Before: base model", f"After: with {drawable(set_name(added_effects(study)), 90)}"]
    figure = Figure(figsize=(COLUMN, _height(len(models))), layout=layout())
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
        axis.set_title(title, fontsize=9.0 * min(1.0, MOST_LETTERS / len(title)), loc="left", color=colour)
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
    figure = Figure(figsize=(COLUMN, _height(len(models))), layout=layout())
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


def plot_held_out(held_out: HeldOut, what: str, amplitude_unit: str = "m") -> Figure:
    """Draw the reduced chi-square of each left-out level or specimen, before and after.

    Parameters
    ----------
    held_out : HeldOut
        The gap on data that the fit has not seen.
    what : str
        ``level`` or ``specimen``: what was left out.
    amplitude_unit : str, optional
        m or rad, of levels.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each; one is what measurement noise alone gives.
    """
    told = np.flatnonzero(np.isfinite(held_out.before_each))  # not all levels are left out
    told = told if told.size else np.arange(len(held_out.labels))
    chosen = told[evenly(len(told), MOST_ROWS)]
    before, after = (np.asarray(each, dtype=float)[chosen] for each in (held_out.before_each, held_out.after_each))
    rows = np.arange(len(chosen))
    figure = Figure(figsize=(COLUMN, 0.25 * len(chosen) + 1.35), layout=layout())
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
    labels, title = [held_out.labels[i] for i in chosen], ""
    if what == "level":  # in the unit of the other figures
        levels = np.array([float(label.split()[0]) for label in labels])
        scale, prefix = engineering(float(levels.max()), amplitude_unit)
        labels, title = [f"{level * scale:.4g}" for level in levels], f"Amplitude [{prefix}{amplitude_unit}]"
    axis.set_yticks(rows, drawable_names(labels, 22), fontsize=8)
    axis.set_ylabel(title, fontsize=9)
    axis.set_ylim(len(chosen) - 0.4, -0.6)
    axis.set_xlabel(f"Reduced chi-square of the {what} left out", fontsize=9)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5, axis="x")
    axis.tick_params(axis="x", labelsize=8)
    legend_below(axis, 3)
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
