"""Figures of what was inferred: priors and posteriors, traces, ranks and pairs.

Every function returns a `matplotlib.figure.Figure` and shows nothing: save it with ``figure.savefig``, or let a
notebook display it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._common.checks import FloatArray
from .style import (
    MEASURED,
    QUIET,
    TRUE,
    drawable,
    layout,
    legend_below,
    panels,
    parameter_axis,
    smooth,
)

if TYPE_CHECKING:  # what is behind it takes long to import
    from ..inference.diagnostics import Bounds

MOST_PARAMETERS = 12
_ROWS = 0.4  # of the height of the densities: for the intervals of specimens below them
_FEWEST_TO_THIN = 100.0  # effective draws


def plot_prior_posterior(
    posterior: xr.DataTree,
    bounds: Bounds,
    *,
    units: Mapping[str, str] | None = None,
    true_values: Mapping[str, FloatArray] | None = None,
    probability: float = 0.95,
) -> Figure:
    """Draw each parameter's posterior over its Uniform prior.

    Parameters
    ----------
    posterior : xarray.DataTree
        What `sample` returned.
    bounds : mapping of str to (float, float)
        Bounds of the Uniform priors; the parameters drawn, in this order.
    units : mapping of str to str, optional
        Units of the parameters.
    true_values : mapping of str to array of float, optional
        Known values, one for each specimen, drawn as a rug.
    probability : float, optional
        Mass of the highest-density interval drawn; 0.95 by default.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels for each parameter: the whole prior, and the posterior close up. Where each specimen has its own
        value, each has a density of its own.

    See Also
    --------
    plots.plot_pair : two parameters at a time.
    findings : the same in words.
    """
    from arviz_stats import hdi

    dataset = posterior["posterior"].to_dataset()
    names = [name for name in bounds if name in dataset]
    figure, axes = panels(len(names), 2, width=4.0, height=2.2)
    for row, name in enumerate(names):
        draws = _by_element(dataset[name])
        scale, axis_label = parameter_axis(name, draws, units)
        draws, low, high = draws * scale, bounds[name][0] * scale, bounds[name][1] * scale
        intervals = [np.asarray(hdi(own, prob=probability)) for own in draws]
        curves = [smooth(own, low, high) for own in draws]
        top = max(float(density.max()) for _, density in curves)
        of_each = " of each specimen" if len(draws) > 1 else ""
        for column, axis in enumerate(axes[row]):
            for own, (x, density) in enumerate(curves):
                axis.fill_between(x, density, color=MEASURED, alpha=0.3, linewidth=0)
                label = "" if own else f"posterior{of_each}"
                axis.plot(x, density, color=MEASURED, linewidth=1.3, label=label)
            axis.axhline(0.0, color="black", linewidth=0.6)
            axis.plot(
                [low, low, high, high], [0, 1 / (high - low), 1 / (high - low), 0], color=QUIET, label="prior", zorder=3
            )
            # Intervals and true values stand below the densities, where nothing covers them; those of specimens, which
            # may lie anywhere, in a row each.
            rows = -0.05 - _ROWS * np.arange(len(intervals)) / max(len(intervals), 8) * (len(intervals) > 1)
            for own, (row_of_own, interval) in enumerate(zip(rows, intervals, strict=True)):
                label = "" if own else f"{probability * 100.0:g} % HDI{of_each}"
                axis.plot(
                    interval, [row_of_own * top] * 2, color="black", linewidth=3.0 if len(intervals) == 1 else 1.8,
                    solid_capstyle="butt", label=label,
                )  # fmt: skip
            lowest = float(rows[-1])
            if true_values is not None and name in true_values:
                rug = np.asarray(true_values[name]) * scale
                below = np.full_like(rug, (lowest - 0.07) * top)
                axis.plot(rug, below, "|", color=TRUE, markersize=8, label="true values of the specimens")
            axis.set_yticks([])
            axis.set_ylim((lowest - 0.13) * top, 1.05 * top)
            axis.xaxis.set_major_locator(MaxNLocator(5))
            axis.ticklabel_format(axis="x", useOffset=False)
            axis.tick_params(labelsize=8)
            axis.spines[["left", "top", "right"]].set_visible(False)
            axis.set_xlabel(axis_label, fontsize=9)
            if column == 1:
                ends = [x[[0, -1]] for x, _ in curves]
                left, right = float(np.min(ends)), float(np.max(ends))
                axis.set_xlim(left - 0.15 * (right - left), right + 0.15 * (right - left))
    axes[0, 0].set_title("over the whole prior", fontsize=9)
    axes[0, 1].set_title("close up", fontsize=9)
    legend_below(axes[0, 0], 4)
    figure.suptitle("Prior and posterior", fontsize=11)
    return figure


def plot_trace(
    posterior: xr.DataTree, names: Sequence[str] | None = None, *, units: Mapping[str, str] | None = None
) -> Figure:
    """Draw each parameter's density and trace, chain by chain (ArviZ's ``plot_trace_dist``).

    Parameters
    ----------
    posterior : xarray.DataTree
        What `sample` returned.
    names : sequence of str, optional
        Parameters drawn; by default all that are scalars, up to twelve.
    units : mapping of str to str, optional
        Units of the parameters.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each parameter.

    See Also
    --------
    plots.plot_rank : ranks by chain, which show more.
    findings : whether chains agree, in words.
    """
    import arviz as az

    draws, arguments = _for_arviz(posterior, names, units)
    collection = az.plot_trace_dist(
        draws,
        compact=False,
        figure_kwargs={"figsize": (9.0, 1.9 * _scalars(draws) + 0.8), "layout": layout()},
        visuals={"trace": {"width": 0.4, "alpha": 0.7}, "dist": {"width": 1.0}},
        **arguments,
    )
    figure = _finished(collection, f"Densities and traces of the chains{_left_out(posterior, names)}")
    _stand_on_zero((axis for axis in figure.axes if axis.get_xlabel() != "Draw"), 5)
    for axis in figure.axes:  # the label of a specimen's parameter has two lines, longer than a row is high
        axis.yaxis.label.set_fontsize(7)
        axis.ticklabel_format(useOffset=False)
    return figure


def plot_rank(
    posterior: xr.DataTree, names: Sequence[str] | None = None, *, units: Mapping[str, str] | None = None
) -> Figure:
    """Draw rank plots (ArviZ's ``plot_rank``): p below alpha marks chains that disagree.

    The draws are thinned to independent ones first: the test takes correlated draws of one chain for disagreement.
    Where they are worth fewer than 100 independent ones, thinning would leave nothing to see: they stay as they are.

    Parameters
    ----------
    posterior : xarray.DataTree
        What `sample` returned.
    names : sequence of str, optional
        Parameters drawn; by default all that are scalars, up to twelve.
    units : mapping of str to str, optional
        Units of the parameters.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each parameter.

    See Also
    --------
    plots.plot_trace : the chains themselves.
    findings : whether they agree, in words.
    """
    import arviz as az

    draws, arguments = _for_arviz(posterior, names, units)
    count = _scalars(draws)
    effective = min(float(values.min()) for values in az.ess(draws).data_vars.values())
    is_thinned = effective >= _FEWEST_TO_THIN
    size = (3.6 * min(count, 4) + 0.5, 2.6 * -(-count // 4) + 0.8)
    collection = az.plot_rank(draws, figure_kwargs={"figsize": size, "layout": layout()}, thin=is_thinned, **arguments)
    meaning = "p below \N{GREEK SMALL LETTER ALPHA}: they disagree"
    if not is_thinned:
        meaning = f"all draws, of which only {effective:.0f} are effective: too few to tell"
    cut = _left_out(posterior, names)
    return _finished(collection, f"Ranks of the draws by chain{cut} (difference from uniform); {meaning}")


def plot_pair(
    posterior: xr.DataTree, names: Sequence[str] | None = None, *, units: Mapping[str, str] | None = None
) -> Figure:
    """Draw every pair of parameters against each other, thinned to 2000 draws (ArviZ's ``plot_pair``).

    Parameters
    ----------
    posterior : xarray.DataTree
        What `sample` returned.
    names : sequence of str, optional
        Parameters drawn; by default all that are scalars, up to twelve.
    units : mapping of str to str, optional
        Units of the parameters.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each pair, densities on the diagonal.

    See Also
    --------
    plots.plot_prior_posterior : each parameter alone.
    sample : where the draws come from.
    """
    import arviz as az

    draws, arguments = _for_arviz(posterior, names, units, most=2000)
    count = _scalars(draws)
    collection = az.plot_pair(
        draws,
        figure_kwargs={"figsize": (2.4 * count + 0.6, 2.3 * count + 0.6), "layout": layout()},
        visuals={"scatter": {"alpha": 0.25, "size": 8, "width": 0}},
        **arguments,
    )
    figure = _finished(collection, f"Pairs of parameters{_left_out(posterior, names)}")
    _stand_on_zero((axis for axis in figure.axes if not axis.collections), 3)
    for axis in figure.axes:
        axis.xaxis.set_major_locator(MaxNLocator(3))
        axis.ticklabel_format(useOffset=False)
    return figure


def _stand_on_zero(densities: Iterable[Axes], ticks: int) -> None:
    """Let densities begin at zero, or waves of a flat one fill the panel; and keep numbers from running together."""
    for axis in densities:
        axis.set_ylim(0.0, None)
        axis.xaxis.set_major_locator(MaxNLocator(ticks))


def _for_arviz(
    posterior: xr.DataTree, names: Sequence[str] | None, units: Mapping[str, str] | None, most: int | None = None
) -> tuple[xr.DataTree, dict[str, Any]]:
    """Draws of the chosen parameters in readable units, and the arguments that all ArviZ plots share."""
    from arviz_base.labels import MapLabeller

    dataset = posterior["posterior"].to_dataset()
    dataset = _first_scalars(dataset if names is None else dataset[list(names)])
    if most is not None:
        dataset = dataset.isel(draw=slice(None, None, max(1, dataset.sizes["chain"] * dataset.sizes["draw"] // most)))
    for name, coordinate in dataset.coords.items():
        if coordinate.dtype.kind in "OUT":  # names from files, which end up in titles
            dataset = dataset.assign_coords({name: (coordinate.dims, [drawable(value) for value in coordinate.values])})
    labels: dict[Hashable, Hashable] = {}
    for name, variable in dataset.data_vars.items():
        scale, labels[name] = parameter_axis(str(name), np.asarray(variable), units)
        dataset[name] = variable * scale
    arguments = {"labeller": MapLabeller(var_name_map=labels), "backend": "matplotlib"}
    return xr.DataTree.from_dict({"posterior": dataset}), arguments


def _by_element(variable: xr.DataArray) -> FloatArray:
    """Return the draws (n, draws) of each of the elements of a variable; one of a scalar."""
    values = np.asarray(variable.transpose("chain", "draw", ...), dtype=float)
    return np.ascontiguousarray(values.reshape(values.shape[0] * values.shape[1], -1).T)


def _left_out(posterior: xr.DataTree, names: Sequence[str] | None) -> str:
    """Say which elements of the variables are drawn where not all are; empty where all are."""
    dataset = posterior["posterior"].to_dataset()
    dataset = dataset if names is None else dataset[list(names)]
    drawn = _first_scalars(dataset)
    cut = [
        f"the first {drawn.sizes[dim]} of {size} {dim}s"
        for dim, size in dataset.sizes.items()
        if drawn.sizes[dim] < size and dim not in ("chain", "draw")
    ]
    return f" ({', '.join(cut)})" if cut else ""


def _first_scalars(dataset: xr.Dataset) -> xr.Dataset:
    """Keep at most `MOST_PARAMETERS` scalars: of parameters over many specimens, those of the first specimens."""
    per_variable = max(1, MOST_PARAMETERS // max(1, len(dataset.data_vars)))
    other = [dim for dim in dataset.dims if dim not in ("chain", "draw")]
    return dataset.isel({dim: slice(0, per_variable) for dim in other})


def _scalars(draws: xr.DataTree) -> int:
    dataset = draws["posterior"].to_dataset()
    return int(sum(v.size for v in dataset.data_vars.values())) // (dataset.sizes["chain"] * dataset.sizes["draw"])


def _finished(collection: Any, title: str) -> Figure:
    """Take the figure out of an ArviZ PlotCollection, and off pyplot's list of open figures."""
    from matplotlib import pyplot

    figure: Figure = collection.viz["figure"].item()
    pyplot.close(figure)
    figure.suptitle(title, fontsize=11)
    return figure
