"""Figures of what was searched: candidates, parameters, and what could have been seen.

Every figure is one column wide, so that a report can set two side by side on a desktop and stack them on a phone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from .._common.checks import FloatArray
from .._common.text import in_words
from ..discrepancy.results.study import Study
from ..discrepancy.results.verdict import Status
from .style import (
    COLUMN,
    MEASURED,
    MOST_ROWS,
    QUIET,
    SIMULATED,
    evenly,
    layout,
    legend_below,
    parameter_axis,
    smooth,
)
from .words import is_held, percent, set_name

STATUS_COLOURS: dict[str, str] = {
    Status.BEST: MEASURED,
    Status.POSSIBLE: "#56B4E9",
    Status.REJECTED: QUIET,
    Status.NOT_CONVERGED: "#E69F00",
    Status.FAILED: "#C9C9C9",
}
MOST_CANDIDATES = 12
MOST_LETTERS = 44  # of a set's name in letters of full size


def _in_lines(name: str) -> str:
    """Return the name of a set in one line or, where it is long, in two as even as they can be."""
    effects = name.split(" + ")
    if len(name) <= MOST_LETTERS or len(effects) == 1:
        return name
    halves = [(" + ".join(effects[:k]), "+ " + " + ".join(effects[k:])) for k in range(1, len(effects))]
    return "\n".join(min(halves, key=lambda lines: max(map(len, lines))))


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
    figure = Figure(figsize=(COLUMN, 0.42 * len(shown) + 1.15), layout=layout())
    axis = figure.subplots()
    for row, candidate in enumerate(shown):
        colour = STATUS_COLOURS.get(candidate.status, QUIET)
        share = candidate.probability if np.isfinite(candidate.probability) else 0.0
        axis.barh(row, share, height=0.34, color=colour)
        axis.barh(row, 1.0, height=0.34, color=QUIET, alpha=0.10, zorder=0)
        weight = "bold" if candidate.status == Status.BEST else "normal"
        name = _in_lines(set_name(candidate.effects))
        widest = max(len(line) for line in name.split("\n"))  # beside the percentage, whole
        size = min(7.0 if "\n" in name else 8.0, 8.0 * MOST_LETTERS / widest)
        axis.text(0.0, row - 0.24, name, fontsize=size, va="bottom", weight=weight, linespacing=1.0)
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


def plot_parameters(study: Study) -> Figure:
    """Draw each parameter: density of the draws, or an interval for each specimen, with the 95 % HDI over the batch.

    Parameters
    ----------
    study : Study
        With ``parameters``; draws are used where there are any.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each parameter that was not held.
    """
    every = {name: estimate for group in study.parameters.values() for name, estimate in group.items()}
    estimates = {name: estimate for name, estimate in every.items() if not is_held(estimate)} or every
    units = {name: estimate.unit for name, estimate in estimates.items()}
    is_sampled = study.is_sampled
    span = "95 % HDI" if is_sampled else "95 % of the fit"
    draws = study.posterior["posterior"].to_dataset() if study.posterior is not None and is_sampled else {}
    shapes = [_by_specimen(draws, name) for name in estimates]
    heights = [0.7 + (0.45 if len(shape) == 1 else 0.15 + 0.13 * min(len(shape), MOST_ROWS)) for shape in shapes]
    figure = Figure(figsize=(COLUMN, sum(heights) + 0.75), layout=layout())
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
        axis.plot(ends[1:] * scale, [base, base], color="black", linewidth=3.0, solid_capstyle="butt", label=span)
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
    figure = Figure(figsize=(COLUMN, 0.3 * len(rows) + 1.4), layout=layout())
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
    axis.set_yticks(np.arange(len(rows)), [in_words(item.effect) for item in rows], fontsize=8)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("Largest change over the levels [%]", fontsize=9)
    axis.tick_params(axis="x", labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5, axis="x")
    legend_below(axis, 2)
    return figure


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
