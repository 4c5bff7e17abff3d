"""The figure of the fit: measured level values against the backbones that the posterior predicts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._common.checks import FloatArray
from ..inference.fit_verdict import FitEntry, GoodnessOfFit
from .style import (
    FEW,
    MEASURED,
    QUIET,
    SIMULATED,
    amplitude_axis,
    counted,
    drawable,
    evenly,
    label_axes,
    legend_below,
    observable_label,
    panels,
    sequence,
)

MOST_SPECIMENS = 6
_LINEAR = 10.0  # standard deviations up to which differences are drawn to scale


def plot_fit(backbones: xr.Dataset, fit: GoodnessOfFit, *, most: int = MOST_SPECIMENS) -> Figure:
    """Draw measured backbones, the median and the 95 % interval that the posterior predicts, and the difference.

    Parameters
    ----------
    backbones : xarray.Dataset
        Measured backbones.
    fit : GoodnessOfFit
        From `goodness_of_fit`.
    most : int, optional
        Specimens drawn, where each has parameters of its own; of more, evenly spaced ones, and the title says so. The
        differences are those of all.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each observable. Above, a row for each specimen with parameters of its own, or one for all;
        measured values with 95 % of their error. Below, the difference in units of standard error, posterior and
        scatter.

    See Also
    --------
    goodness_of_fit : the numbers behind it.
    plots.plot_predictive : the spread over the specimens against that of the posterior.
    """
    names = [str(name) for name in backbones["specimen"].values]
    observables = [str(name) for name in backbones["observable"].values]
    levels, scale, amplitude_label = amplitude_axis(backbones)
    is_own = fit.likelihood == "specimen"
    shown = evenly(len(names), most) if is_own else [0]
    figure, axes = panels(len(shown) + 1, len(observables), width=4.6, height=2.7)
    colours = sequence(len(names))
    for column, observable in enumerate(observables):
        value = np.asarray(backbones["value"].sel(observable=observable))
        error = np.asarray(backbones["standard_error"].sel(observable=observable))
        for row, s in enumerate(shown):
            axis = axes[row, column]
            _predicted(axis, levels * scale, fit.draws[s if is_own else 0][:, column])
            for i in [s] if is_own else range(len(names)):
                colour = MEASURED if is_own else colours[i]
                if is_own or len(names) <= FEW:
                    spread = np.nan_to_num(1.96 * error[i])
                    axis.errorbar(
                        levels * scale, value[i], spread, color=colour, fmt="o", markersize=3, linewidth=0.9, zorder=3
                    )
                else:
                    axis.plot(levels * scale, value[i], color=colour, linewidth=0.6, alpha=0.7)
            label_axes(axis, amplitude_label, observable)
            axis.set_ylabel(observable_label(observable, short=True))  # the long one is longer than a row is high
            if is_own:
                axis.set_title(drawable(names[s]), fontsize=9, pad=3)
        label_axes(axes[-1, column], amplitude_label, observable)  # before the axis is logarithmic
        _differences(axes[-1, column], fit, observable, scale, names, colours)
        axes[-1, column].set_ylabel("Difference / its standard deviation", fontsize=8)
    if is_own:
        style = {"color": MEASURED, "fmt": "o", "markersize": 3, "linewidth": 0.9}
        axes[0, 0].errorbar([], [], [], label="measured, 95 % error", **style)
    else:  # each specimen has a colour of its own
        mark: dict[str, Any] = {"marker": "o", "markersize": 3} if len(names) <= FEW else {}
        what = "measured, 95 % error" if len(names) <= FEW else "measured"
        axes[0, 0].plot([], [], color=colours[len(names) // 2], linewidth=0.9, label=f"{what}; a colour each", **mark)
    axes[0, 0].plot([], [], color=SIMULATED, linewidth=1.6, label="posterior predictive, median")
    axes[0, 0].fill_between([], [], [], color=SIMULATED, alpha=0.22, label="posterior predictive, 95 %")
    legend_below(axes[0, 0], 3)
    is_part = is_own and len(shown) < len(names)
    count = f"{len(shown)} of {counted(len(names), 'specimen')}" if is_part else counted(len(names), "specimen")
    verdict = "the model fits" if fit.describes_specimens else "the model does not fit"
    if not np.isfinite(fit.p_value):
        verdict = "too few values to check the fit"
    figure.suptitle(f"Measured against predicted backbones, {count}: {verdict}", fontsize=11)
    return figure


def _predicted(axis: Axes, amplitude: FloatArray, drawn: FloatArray) -> None:
    """Draw median and band of the draws (d, l), where there are any."""
    held = np.isfinite(drawn).any(axis=0)
    if held.any():
        low, middle, high = np.nanpercentile(drawn[:, held], [2.5, 50.0, 97.5], axis=0)
        axis.fill_between(amplitude[held], low, high, color=SIMULATED, alpha=0.22, linewidth=0)
        axis.plot(amplitude[held], middle, color=SIMULATED, linewidth=1.6)


def _differences(
    axis: Axes, fit: GoodnessOfFit, observable: str, scale: float, names: Sequence[str], colours: Sequence[object]
) -> None:
    """Draw the standardised differences, those of a specimen in its colour, and where most should lie."""
    axis.axhspan(-2.0, 2.0, color=QUIET, alpha=0.2, linewidth=0)
    axis.axhline(0.0, color="black", linewidth=0.6)
    here: dict[str | None, list[FitEntry]] = {}
    for entry in fit.entries:
        if entry.observable == observable:
            here.setdefault(entry.specimen, []).append(entry)
    for name, entries in here.items():
        colour = "black" if name is None else colours[names.index(name)]
        x, y = [entry.level * scale for entry in entries], [entry.z for entry in entries]
        axis.plot(x, y, "o-", color=colour, markersize=3, linewidth=0.7)
    largest = max((abs(entry.z) for entries in here.values() for entry in entries if np.isfinite(entry.z)), default=0.0)
    if largest > _LINEAR:  # a difference of a thousand standard deviations and one of three are both to be seen
        axis.set_yscale("symlog", linthresh=_LINEAR, linscale=1.5)
    else:
        axis.set_ylim(-max(3.5, 1.15 * largest), max(3.5, 1.15 * largest))
