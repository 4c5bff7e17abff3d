"""Figures of a survey: each quantity over the structures, and damping against frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._common.checks import FloatArray
from ..discrepancy.results.verdict import Verdict
from ..reporting.style import FEW, MEASURED, QUIET, SIMULATED, drawable, layout, parameter_axis
from .outliers import Quantity, far
from .structure import Structure

MOST_NAMED = 5  # structures that a panel names
_WIDTH, _HEIGHT = 4.8, 3.1
_DRAWN = 0.75  # share of the panel's height within the axes
_LINE = 0.07  # height of a name, over that of the axes
_BESIDE = 0.3  # width of a name, over that of the axes
_LETTERS = 18  # of a structure's name below the axis
_ORDERED = ("frequency", "damping_ratio")
_COLOURS: dict[str, str] = {
    Verdict.ADEQUATE: "#009E73",
    Verdict.FOUND: "#0072B2",
    Verdict.AMBIGUOUS: "#E69F00",
    Verdict.UNEXPLAINED: "#B00020",
}
_MARKS: dict[str, str] = {Verdict.ADEQUATE: "o", Verdict.FOUND: "s", Verdict.AMBIGUOUS: "^", Verdict.UNEXPLAINED: "D"}


def plot_quantity(quantity: Quantity, order: Sequence[str]) -> Figure:
    """Draw one quantity over the structures, with its median; values that stand out are named.

    Parameters
    ----------
    quantity : Quantity
        What is drawn.
    order : sequence of str
        All structures of the survey: their numbers are the horizontal axis.

    Returns
    -------
    matplotlib.figure.Figure
        Bars span 95 % of each value's own uncertainty.
    """
    figure, axis = _panel()
    scale, label = _labelled(quantity)
    place = {name: i + 1 for i, name in enumerate(order)}
    x = np.array([place[name] for name in quantity.structures], dtype=float)
    y, error = scale * quantity.values, 1.96 * scale * np.nan_to_num(quantity.errors)
    scores = quantity.scores()
    is_far = np.abs(scores) > far(len(scores))
    axis.axhline(scale * quantity.median, color=QUIET, linewidth=1.0, zorder=1)
    for chosen, colour in ((~is_far, MEASURED), (is_far, SIMULATED)):
        if chosen.any():
            bars = {"markersize": 4.5, "elinewidth": 1.0, "zorder": 3}
            axis.errorbar(x[chosen], y[chosen], error[chosen], fmt="o", color=colour, **bars)
    axis.set_xlim(0.4, len(order) + 0.6)
    axis.margins(y=0.12)
    _structure_axis(axis, order)
    axis.set_ylabel(label)
    worst = np.argsort(-np.nan_to_num(np.abs(scores)))[: min(MOST_NAMED, int(is_far.sum()))]
    _name(axis, [(float(x[i]), float(y[i]), quantity.structures[i]) for i in worst], 0.5 * (len(order) + 1))
    return figure


def plot_damping_against_frequency(structures: Sequence[Structure], standing_out: Sequence[str]) -> Figure | None:
    """Draw the damping ratio of the linear part against its frequency, by verdict; None without values."""
    shown = [item for item in structures if np.isfinite(item.frequency) and np.isfinite(item.damping_ratio)]
    if not shown:
        return None
    figure, axis = _panel()
    for verdict, colour in _COLOURS.items():
        points = np.array([(item.frequency, item.damping_ratio) for item in shown if item.verdict == verdict])
        if points.size:
            axis.plot(points[:, 0], points[:, 1], _MARKS[verdict], color=colour, markersize=5.0, label=verdict)
    axis.margins(0.12)
    axis.set_xlabel("Frequency [Hz]")
    axis.set_ylabel("Damping ratio [-]")
    axis.legend(fontsize="small", frameon=False, loc="best")
    by_name = {item.name: item for item in shown}
    named = [by_name[name] for name in standing_out if name in by_name][:MOST_NAMED]
    middle = float(np.mean(axis.get_xlim()))
    _name(axis, [(item.frequency, item.damping_ratio, item.name) for item in named], middle)
    return figure


def drawn_quantities(found: Sequence[Quantity]) -> list[Quantity]:
    """Return what is drawn: quantities that at least two structures have, the most shared first."""
    shared = [item for item in found if len(item.structures) > 1]
    return sorted(shared, key=lambda item: (item.name not in _ORDERED, -len(item.structures)))


def _labelled(quantity: Quantity) -> tuple[float, str]:
    return parameter_axis(quantity.name, quantity.values, {quantity.name: quantity.unit})


def _panel() -> tuple[Figure, Any]:
    figure = Figure(figsize=(_WIDTH, _HEIGHT), layout=layout())
    axis = figure.subplots()
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5)
    axis.ticklabel_format(axis="both", useOffset=False)
    return figure, axis


def _structure_axis(axis: Axes, order: Sequence[str]) -> None:
    """Name the structures below the axis, or number them where there are too many for that."""
    if len(order) > FEW:
        axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axis.set_xlabel("Structure, in the order given")
        return
    # Of long names the end is shown: mostly that is where they differ.
    names = [
        drawable(name if len(name) <= _LETTERS else f"\N{HORIZONTAL ELLIPSIS}{name[1 - _LETTERS :]}") for name in order
    ]
    is_wide = sum(map(len, names)) > 45
    slant: dict[str, Any] = {"rotation": 90} if is_wide else {}
    axis.set_xticks(range(1, len(order) + 1), names, fontsize=8, **slant)


def _name(axis: Axes, points: Sequence[tuple[float, float, str]], middle: float | FloatArray) -> None:
    """Write names beside points, towards the middle of the panel; of points that lie together above each other."""
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    width, height = right - left, top - bottom
    written: list[tuple[float, float]] = []
    for x, y, name in points:
        is_right = x > middle
        line = 0
        while any(abs(x - a) < _BESIDE * width and abs(y + line * _LINE * height - b) < _LINE * height
                  for a, b in written):  # fmt: skip
            line += 1 if y < top - 0.3 * height else -1
        written.append((x, y + line * _LINE * height))
        axis.annotate(
            drawable(name, 24),
            (x, y),
            xytext=(-6 if is_right else 6, 3 + line * _LINE * _HEIGHT * _DRAWN * 72.0),
            textcoords="offset points",
            ha="right" if is_right else "left",
            fontsize="small",
            zorder=4,
        )


__all__ = ["drawn_quantities", "plot_damping_against_frequency", "plot_quantity"]
