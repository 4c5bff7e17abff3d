"""Figures of what was measured: records, backbones, densities, and measured against simulated backbones.

Every function returns a `matplotlib.figure.Figure` and shows nothing: save it with ``figure.savefig``, or let a
notebook display it. Amplitudes are drawn on the horizontal axis, the observable on the vertical one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._common.checks import FloatArray, InputError
from ..likelihood.density import Density
from .style import (
    FEW,
    MEASURED,
    SIMULATED,
    amplitude_axis,
    counted,
    drawable,
    engineering,
    evenly,
    label_axes,
    layout,
    legend_below,
    observable_label,
    panels,
    sequence,
    smooth,
    span,
)

MOST_PANELS = 24
_DRAWN = 10_000  # stretches of a record; a panel has fewer points


def plot_records(records: Sequence[Any], *, most: int = MOST_PANELS) -> Figure:
    """Draw each record in a panel of its own, all on the same axes.

    Parameters
    ----------
    records : sequence of Record
        With ``specimen``, ``time`` [s], ``values``, ``quantity`` and ``unit``.
    most : int, optional
        Largest number of panels; of more records, evenly spaced ones are drawn and the title says so.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there is no record.

    See Also
    --------
    read_records : reads them.
    plots.plot_backbones : what comes of them.
    """
    if not len(records):
        raise InputError("`records` must hold at least one record, got none.")
    chosen = [records[i] for i in evenly(len(records), most)]
    columns = min(4, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(2.7 * columns + 0.8, 1.25 * rows + 1.1), layout=layout())
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    scale, prefix = engineering(max(float(np.nanmax(np.abs(record.values))) for record in chosen), chosen[0].unit)
    for axis, record in zip(axes.flat, chosen, strict=False):
        time, values = _drawn_samples(np.asarray(record.time), np.asarray(record.values))
        axis.plot(time, values * scale, color=MEASURED, linewidth=0.6)
        if chosen[0].quantity == "envelope":
            axis.set_yscale("log")  # where the decay of a damper is straight
        axis.set_title(drawable(record.specimen), fontsize=8, pad=2)
        axis.tick_params(labelsize=8)
    for axis in axes.flat[len(chosen) :]:
        axis.set_visible(False)
    count = (
        f"{len(chosen)} of {len(records)} records" if len(chosen) < len(records) else counted(len(records), "record")
    )
    figure.suptitle(f"{count}: {chosen[0].quantity}", fontsize=11)
    figure.supxlabel("Time [s]", fontsize=10)
    unit = f" [{prefix}{chosen[0].unit}]" if chosen[0].unit != "1" else ", relative"
    figure.supylabel(f"{chosen[0].quantity.capitalize()}{unit}", fontsize=10)
    return figure


def _drawn_samples(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what is drawn of a record: of more samples than a panel has points, lowest and highest of each stretch."""
    stride = values.size // _DRAWN
    if stride < 2:
        return time, values
    whole = values[: values.size // stride * stride].reshape(-1, stride)
    ends = np.sort(np.stack([whole.argmin(axis=1), whole.argmax(axis=1)], axis=1), axis=1)
    chosen = (ends + stride * np.arange(len(whole))[:, None]).ravel()
    chosen = np.append(chosen, np.arange(whole.size, values.size))
    return time[chosen], values[chosen]


def plot_backbones(backbones: xr.Dataset) -> Figure:
    """Draw the measured backbones: a line for each specimen, with error bars of one standard error at the levels.

    Parameters
    ----------
    backbones : xarray.Dataset
        As `backbones_at_levels` returns it: ``value`` and ``standard_error`` over specimen, observable and level.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each observable.

    See Also
    --------
    backbones_at_levels : makes what is drawn.
    plots.plot_predictive : with what the posterior predicts.
    """
    levels, scale, amplitude_label = amplitude_axis(backbones)
    names = [str(name) for name in backbones["observable"].values]
    figure, axes = panels(1, len(names), width=4.6, height=3.9)
    specimens = backbones.sizes["specimen"]
    colours = sequence(specimens)
    for axis, name in zip(axes[0], names, strict=True):
        value = np.asarray(backbones["value"].sel(observable=name))
        error = np.asarray(backbones["standard_error"].sel(observable=name))
        for i in range(specimens):
            axis.errorbar(
                levels * scale,
                value[i],
                yerr=error[i],
                color=colours[i],
                linewidth=0.9,
                marker="o",
                markersize=2.5,
                elinewidth=0.8,
                capsize=1.5,
                alpha=0.9,
            )
        label_axes(axis, amplitude_label, name)
    figure.suptitle(f"Backbones of {counted(specimens, 'specimen')}, with one standard error", fontsize=11)
    return figure


def plot_predictive(measured: xr.Dataset, simulated: xr.Dataset, *, probability: float = 0.95) -> Figure:
    """Draw measured backbones over the band that the posterior predicts.

    Parameters
    ----------
    measured : xarray.Dataset
        Measured backbones, with standard errors.
    simulated : xarray.Dataset
        Backbones simulated from posterior draws, at the same levels; a draw takes the place of a specimen.
    probability : float, optional
        Mass of the band, between equal tails; 0.95 by default.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each observable: above, the backbones; below, the spread at the lowest, middle and highest level.
        Error bars span 95 %.

    Raises
    ------
    InputError
        If ``simulated`` is at other levels.

    See Also
    --------
    simulate_population : simulates the draws.
    plots.plot_backbones : the measured ones alone.
    """
    levels, scale, amplitude_label = amplitude_axis(measured)
    names = [str(name) for name in measured["observable"].values]
    if not np.allclose(levels, np.asarray(simulated["level"])):
        raise InputError("`simulated` must be at the levels of `measured`; simulate it at measured['level'].")
    three = sorted({0, levels.size // 2, levels.size - 1})
    figure, axes = panels(2, len(names), width=4.6, height=3.4)
    tails = [50.0 * (1.0 - probability), 50.0, 50.0 * (1.0 + probability)]
    for column, name in enumerate(names):
        value = np.asarray(measured["value"].sel(observable=name))
        error = np.asarray(measured["standard_error"].sel(observable=name))
        drawn = np.asarray(simulated["value"].sel(observable=name))
        low, middle, high = np.nanpercentile(drawn, tails, axis=0)
        axis = axes[0, column]
        axis.fill_between(levels * scale, low, high, color=SIMULATED, alpha=0.22, linewidth=0)
        axis.plot(levels * scale, middle, color=SIMULATED, linewidth=1.6)
        if len(value) > FEW:
            axis.plot(levels * scale, value.T, color=MEASURED, linewidth=0.6, alpha=0.55)
        else:
            for one, spread in zip(value, error, strict=True):
                axis.errorbar(
                    levels * scale, one, yerr=1.96 * spread, color=MEASURED, fmt="o-", markersize=2.5, linewidth=0.7
                )
        label_axes(axis, amplitude_label, name)

        axis = axes[1, column]
        for row, k in enumerate(three):
            axis.bar(row, high[k] - low[k], width=0.5, bottom=low[k], color=SIMULATED, alpha=0.22)
            axis.plot([row - 0.25, row + 0.25], [middle[k], middle[k]], color=SIMULATED, linewidth=1.6)
            here = np.flatnonzero(np.isfinite(value[:, k]))
            shift = np.linspace(-0.16, 0.16, here.size) if here.size > 1 else np.zeros(here.size)
            axis.errorbar(
                row + shift,
                value[here, k],
                yerr=1.96 * error[here, k],
                color=MEASURED,
                fmt="o",
                markersize=2.5,
                linewidth=0.7,
                zorder=2,
            )
        axis.set_xticks(range(len(three)), [f"{levels[k] * scale:.3g}" for k in three])
        axis.set_xlim(-0.5, len(three) - 0.5)
        label_axes(axis, amplitude_label, name)
    axes[0, 0].plot([], [], color=MEASURED, linewidth=1.0, label="measured")
    axes[0, 0].plot([], [], color=SIMULATED, linewidth=6, alpha=0.4, label=f"posterior predictive, {probability:.0%}")
    legend_below(axes[0, 0], 2)
    figure.suptitle("Measured against simulated backbones", fontsize=11)
    return figure


def plot_densities(
    backbones: xr.Dataset,
    density: Density | None = None,
    *,
    simulated: xr.Dataset | None = None,
    most: int = 6,
) -> Figure:
    """Draw, for each observable and level, the measured values and the density fitted to them.

    Parameters
    ----------
    backbones : xarray.Dataset
        Measured backbones.
    density : Density, optional
        What `fit_density` fitted to them; its marginals are drawn.
    simulated : xarray.Dataset, optional
        Backbones simulated from posterior draws at the same levels: drawn as a second histogram.
    most : int, optional
        Largest number of levels drawn; of more, evenly spaced ones, with the lowest and the highest.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each observable, a column for each level.

    See Also
    --------
    fit_density : makes the density.
    plots.plot_backbones : the values over amplitude.
    """
    levels, scale, amplitude_label = amplitude_axis(backbones)
    unit = amplitude_label.partition("[")[2].rstrip("]")
    names = [str(name) for name in backbones["observable"].values]
    chosen = evenly(levels.size, most)
    figure, axes = panels(len(names), len(chosen), width=2.3, height=2.3)
    for row, name in enumerate(names):
        for column, k in enumerate(chosen):
            axis = axes[row, column]
            value = np.asarray(backbones["value"].sel(observable=name))[:, k]
            value = value[np.isfinite(value)]
            drawn = np.zeros(0)
            if simulated is not None:
                drawn = np.asarray(simulated["value"].sel(observable=name))[:, k]
                drawn = drawn[np.isfinite(drawn)]
            if value.size > 1:
                bins = int(np.clip(np.sqrt(value.size) * 1.5, 4, 25))
                axis.hist(value, bins=bins, density=True, color=MEASURED, alpha=0.35, label="measured")
            if drawn.size > 1:
                axis.plot(*smooth(drawn), color=SIMULATED, linewidth=1.4, label="posterior predictive")
            if density is not None and name in density.observables:
                x = np.linspace(*span(np.concatenate([value, drawn])), 400)
                axis.plot(x, density.marginal(name, k)(x), color="black", linewidth=1.2, label="fitted density")
            axis.plot(value, np.zeros_like(value), "|", color=MEASURED, markersize=9, clip_on=False)
            axis.set_yticks([])
            axis.xaxis.set_major_locator(MaxNLocator(3, min_n_ticks=2))
            axis.tick_params(labelsize=8)
            axis.spines[["left", "top", "right"]].set_visible(False)
            axis.set_xlabel(observable_label(name, short=True), fontsize=8)
            if row == 0:
                axis.set_title(f"at {levels[k] * scale:.3g} {unit}", fontsize=9)
    legend_below(axes[0, 0], 3)
    figure.suptitle("Distribution over the specimens at amplitude levels", fontsize=11)
    return figure
