"""The figure of a population: each specimen's parameters, and the distribution they were drawn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtr

from .._common.checks import FloatArray, InputError
from .._common.text import in_words
from ..oscillator import Oscillator
from .style import MEASURED, QUIET, SIMULATED, drawable_names, evenly, legend_below, panels, parameter_axis

MOST_SPECIMENS = 16
COLUMNS = 2
_DRAWS = 400  # populations that the band is made of
_REACH = 4.0  # spreads to either side that are drawn


def plot_population(
    posterior: xr.DataTree,
    oscillator: Oscillator,
    names: Sequence[str] | None = None,
    *,
    probability: float = 0.95,
    units: Mapping[str, str] | None = None,
) -> Figure:
    """Draw what a hierarchical model found: the population of every parameter, the specimens, and correlations.

    Parameters
    ----------
    posterior : xarray.DataTree
        Draws of a model from `build_hierarchical_model`.
    oscillator : Oscillator
        The model, for the units and limits of its parameters.
    names : sequence of str, optional
        Parameters drawn; by default all that were inferred.
    probability : float, optional
        Mass of bands and intervals; 0.95 by default.
    units : mapping of str to str, optional
        Of the parameters; by default those of the oscillator, which are those of a straight motion.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each parameter: above, the population's density, median and band over the posterior; below, every
        specimen with its interval. With correlated parameters one panel more.

    Raises
    ------
    InputError
        For the posterior of any other model.

    See Also
    --------
    build_hierarchical_model : the model.
    plots.plot_prior_posterior : for parameters with a prior of their own.
    """
    draws = posterior["posterior"].to_dataset()
    inferred = [name for name in oscillator.parameter_names if f"{name}_sd" in draws]
    wanted = inferred if names is None else list(names)
    if not wanted or set(wanted) - set(inferred):
        raise InputError("`posterior` must be that of a model from build_hierarchical_model, with these parameters.")
    has_correlation = "correlation" in draws
    count = len(wanted) + has_correlation
    figure, axes = panels(-(-count // COLUMNS), min(count, COLUMNS), width=4.6, height=3.0)
    for axis in axes.flat[count:]:
        axis.set_visible(False)
    for name, axis in zip(wanted, axes.flat, strict=False):
        _draw_parameter(axis, draws, oscillator, name, probability, oscillator.units if units is None else units)
    if has_correlation:
        _draw_correlations(axes.flat[len(wanted)], draws, wanted, probability)
    legend_below(axes.flat[0], 3)
    size = draws.sizes["specimen"]
    figure.suptitle(f"The population that {size} specimens were drawn from", fontsize=11)
    return figure


def _draw_parameter(
    axis: Axes, draws: xr.Dataset, oscillator: Oscillator, name: str, probability: float, units: Mapping[str, str]
) -> None:
    """Draw the population of one parameter over its specimens."""
    from arviz_stats import hdi

    own = np.asarray(draws[name].transpose("specimen", "chain", "draw"), dtype=float).reshape(
        draws.sizes["specimen"], -1
    )
    intervals = np.array([np.asarray(hdi(values, prob=probability)) for values in own])
    limits = next((p.minimum, p.maximum) for p in oscillator.parameters if p.name == name)
    x, density = _densities(draws, name, limits, intervals)
    scale, label = parameter_axis(name, x, units)
    tail = 50.0 * (1.0 - probability)
    low, middle, high = np.percentile(density, [tail, 50.0, 100.0 - tail], axis=0)
    top = float(high.max())
    axis.fill_between(x * scale, low / top, high / top, color=SIMULATED, alpha=0.22, linewidth=0,
                      label=f"population, {100.0 * probability:g} %")  # fmt: skip
    axis.plot(x * scale, middle / top, color=SIMULATED, linewidth=1.6, label="population, median of the density")
    axis.axhline(0.0, color="black", linewidth=0.6)
    shown = evenly(len(own), MOST_SPECIMENS)
    rows = -0.08 - 0.5 * np.arange(len(shown)) / max(len(shown), 8)
    labels = drawable_names([str(value) for value in draws["specimen"].values], 14)
    for row, s in zip(rows, shown, strict=True):
        text = f"specimens, {100.0 * probability:g} % HDI" if s == shown[0] else ""
        axis.plot(intervals[s] * scale, [row, row], color=MEASURED, linewidth=2.0, solid_capstyle="butt", label=text)
        axis.plot([own[s].mean() * scale], [row], "o", color=MEASURED, markersize=3.5)
        axis.annotate(labels[s], (1.0, row), xycoords=("axes fraction", "data"), fontsize=6, va="center", color=QUIET)
    axis.set_ylim(float(rows[-1]) - 0.06, 1.05)
    axis.set_yticks([])
    axis.xaxis.set_major_locator(MaxNLocator(5))
    axis.spines[["left", "top", "right"]].set_visible(False)
    axis.set_xlabel(label)


def _densities(
    draws: xr.Dataset, name: str, limits: tuple[float, float], intervals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where the population is drawn (n,), and its density there under draws of the posterior (d, n)."""
    is_uniform = f"{name}_low" in draws
    if is_uniform:
        pair = draws[f"{name}_low"], draws[f"{name}_high"]
    else:
        pair = (draws["population_location"].sel(parameter=name), draws["population_spread"].sel(parameter=name))
    first, second = (np.asarray(one, dtype=float).ravel() for one in pair)
    chosen = evenly(first.size, _DRAWS)
    first, second = first[chosen, None], second[chosen, None]
    mean, sd = (float(np.median(np.asarray(draws[f"{name}_{what}"]))) for what in ("mean", "sd"))
    left = max(min(mean - _REACH * sd, float(intervals.min())), limits[0])
    right = min(max(mean + _REACH * sd, float(intervals.max())), limits[1])
    x = np.linspace(left, right, 301)
    if is_uniform:
        return x, np.where((x >= first) & (x <= second), 1.0 / (second - first), 0.0)
    inside = ndtr((limits[1] - first) / second) - ndtr((limits[0] - first) / second)
    return x, np.exp(-0.5 * ((x - first) / second) ** 2) / (np.sqrt(2.0 * np.pi) * second * inside)


def _draw_correlations(axis: Axes, draws: xr.Dataset, names: Sequence[str], probability: float) -> None:
    """Draw the interval of each correlation."""
    from arviz_stats import hdi

    pairs: list[tuple[str, Any]] = [
        (f"{in_words(a)} and\n{in_words(b)}", draws["correlation"].sel(parameter=a, parameter_other=b))
        for a, b in combinations(names, 2)
    ]
    for row, (_, values) in enumerate(pairs):
        drawn = np.asarray(values, dtype=float).ravel()
        axis.plot(np.asarray(hdi(drawn, prob=probability)), [row, row], color=SIMULATED, linewidth=2.5)
        axis.plot([drawn.mean()], [row], "o", color=SIMULATED, markersize=5)
    axis.axvline(0.0, color="black", linewidth=0.6)
    axis.set_xlim(-1.0, 1.0)
    axis.set_ylim(len(pairs) - 0.5, -0.5)
    axis.set_yticks(range(len(pairs)), [label for label, _ in pairs], fontsize=7)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(axis="x", alpha=0.25, linewidth=0.5)
    axis.set_xlabel(f"Correlation over the population, {100.0 * probability:g} % HDI")
