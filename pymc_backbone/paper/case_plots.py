"""Figures of the source paper's systems: the likelihood over the backbones, and distributions side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from ..likelihood.density import Density
from ..reporting.style import (
    MEASURED,
    QUIET,
    SIMULATED,
    amplitude_axis,
    label_axes,
    legend_below,
    observable_label,
    panels,
    span,
)
from .case_comparison import Comparison

_MOST_LINES = 100


def plot_likelihood(backbones: xr.Dataset, density: Density) -> Figure:
    """Draw the densities at the levels on the backbones they belong to, and what they say of two levels together.

    Parameters
    ----------
    backbones : xarray.Dataset
        Measured backbones.
    density : Density
        What was fitted to them.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each observable. Left: backbones, with the marginal density standing on each level. Right: the
        lowest against the highest level, specimens over draws from the density: a product does not know that they
        belong together.

    See Also
    --------
    fit_density : makes the density.
    plots.plot_densities : the marginals at each level.
    """
    population = density.population
    levels, scale, amplitude_label = amplitude_axis(backbones)
    names = [str(name) for name in backbones["observable"].values]
    figure, axes = panels(len(names), 2, width=4.6, height=3.4)
    draws = population.sample(1500, random_seed=0)
    width = 0.8 * float(np.min(np.diff(levels))) if levels.size > 1 else 1.0
    for row, name in enumerate(names):
        value = np.asarray(backbones["value"].sel(observable=name))
        axis = axes[row, 0]
        for line in value[:: max(1, len(value) // _MOST_LINES)]:
            axis.plot(levels * scale, line, color=QUIET, linewidth=0.5, alpha=0.5)
        for k, level in enumerate(levels):
            held = value[np.isfinite(value[:, k]), k]
            y = np.linspace(*span(held), 300)
            pdf = population.marginal(name, k)(y)
            reach = width if levels.size < 3 else 0.8 * float(np.diff(levels)[min(k, levels.size - 2)])
            axis.fill_betweenx(y, level * scale, (level + reach * pdf / pdf.max()) * scale, color=MEASURED, alpha=0.45)
        label_axes(axis, amplitude_label, name)
        pair = axes[row, 1]
        o = population.observables.index(name)
        pair.plot(draws[:, o, 0], draws[:, o, -1], ".", color=SIMULATED, markersize=2.5, alpha=0.4, label="density")
        pair.plot(value[:, 0], value[:, -1], ".", color=MEASURED, markersize=4, label="specimens")
        label = observable_label(name, short=True)
        pair.set_xlabel(f"{label}, lowest level")
        pair.set_ylabel(f"{label}, highest level")
        pair.spines[["top", "right"]].set_visible(False)
    legend_below(axes[0, 1], 2)
    figure.suptitle(
        f"Likelihood ({density.kind.replace('_', '-')}): densities at the levels, and together", fontsize=11
    )
    return figure


def plot_comparison(comparisons: Sequence[Comparison]) -> Figure:
    """Draw measured and simulated distributions at low, middle and high amplitude, with the fitted densities.

    Parameters
    ----------
    comparisons : sequence of Comparison
        From `compare_distributions`.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each observable, a column for each amplitude.
    """
    names = list(dict.fromkeys(item.observable for item in comparisons))
    columns = max(sum(item.observable == name for item in comparisons) for name in names)
    figure, axes = panels(len(names), columns, width=3.3, height=2.8)
    for row, name in enumerate(names):
        chosen = [item for item in comparisons if item.observable == name]
        for axis in axes[row, len(chosen) :]:
            axis.set_visible(False)
        for axis, item in zip(axes[row], chosen, strict=False):
            x = np.linspace(*span(np.concatenate([item.measured, item.simulated])), 600)
            for side, colour in (("measured", MEASURED), ("simulated", SIMULATED)):
                values = getattr(item, side)
                bins = int(np.clip(np.sqrt(values.size) * 1.5, 4, 25))
                axis.hist(values, bins=bins, density=True, color=colour, alpha=0.3)
                label = f"{side}, {'GEV' if item.family == 'gev' else 'uniform'} fit"
                axis.plot(x, item.density(side)(x), color=colour, linewidth=1.4, label=label)
            axis.set_yticks([])
            axis.set_xlabel(observable_label(name, short=True), fontsize=8)
            axis.tick_params(labelsize=8)
            axis.spines[["left", "top", "right"]].set_visible(False)
            axis.set_title(f"{item.place} amplitude: overlap {item.overlap:.0%}", fontsize=9)
    legend_below(axes[0, 0], 2)
    figure.suptitle("Measured and simulated distributions", fontsize=11)
    return figure


__all__ = ["plot_comparison", "plot_likelihood"]
