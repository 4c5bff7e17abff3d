"""Figures of what no law explains, as forces of displacement and of speed with their bands."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._common.checks import FloatArray
from ..discrepancy.results.curve_records import Band, ForceCurves
from .style import COLUMN, MEASURED, QUIET, SIMULATED, engineering, layout, legend_below, parameter_axis

_HEIGHT = 4.6
_WHOLE, _PARTS = (("whole", MEASURED),), (("odd part", MEASURED), ("even part", SIMULATED))


def plot_force(curves: ForceCurves, which: str, amplitude_unit: str = "m") -> Figure:
    """Draw a force over what the motion visited: all of it above, its odd and its even part below.

    Parameters
    ----------
    curves : ForceCurves
        Of a study.
    which : {"conservative", "damping"}
        The force of displacement, beyond the linear spring, or that of speed.
    amplitude_unit : str
        m or rad.

    Returns
    -------
    matplotlib.figure.Figure
        Bands hold all of a curve with a probability of 95 %.
    """
    bands = curves.bands
    names = (which, f"{which}_odd", f"{which}_even")
    whole, odd, even = (getattr(bands, name) for name in names)
    scale, prefix = engineering(float(np.abs(whole.at).max()), amplitude_unit)
    unit = "N" if amplitude_unit == "m" else "N m"
    figure = Figure(figsize=(COLUMN, _HEIGHT), layout=layout())
    axes = figure.subplots(2, 1)
    place = "Displacement" if which == "conservative" else "Speed"
    rate = "" if which == "conservative" else "/s"
    line = curves.parameters["viscous_damping"][0] if which == "damping" else 0.0
    beyond = replace(odd, force=odd.force - line * odd.at, low=odd.low - line * odd.at, high=odd.high - line * odd.at)
    parts = (beyond, even) if curves.has_even else (beyond,)
    panels = ((_WHOLE, (whole,)), (_PARTS[: len(parts)], parts))
    for axis, (panel, shown) in zip(axes, panels, strict=True):
        factor, label = parameter_axis("force", np.concatenate([np.abs(band.force) for band in shown]), {"force": unit})
        for (name, colour), band in zip(panel, shown, strict=True):
            _draw(axis, band, scale, factor, colour, name, is_split=which == "damping")
        axis.axhline(0.0, color="black", linewidth=0.6)
        axis.set_ylabel(label)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5)
        axis.xaxis.set_major_locator(MaxNLocator(6))
        axis.set_xlabel(f"{place} [{prefix}{amplitude_unit}{rate}]")
    if which == "damping":
        factor, _ = parameter_axis("force", np.abs(whole.force), {"force": unit})
        axes[0].plot(whole.at * scale, line * whole.at * factor, color=QUIET, linestyle="--", linewidth=1.0)
        axes[0].set_title("Damping force; dashed: the viscous damper in it", fontsize=9, loc="left")
        odd_alone = "Beyond the viscous damper; an even part is not measured"
        also = "Odd part beyond the viscous damper, and even part" if curves.has_even else odd_alone
        axes[1].set_title(also, fontsize=9, loc="left")
    else:
        axes[0].set_title("Conservative force beyond the linear spring", fontsize=9, loc="left")
        also = "Its odd and its even part" if curves.has_even else "Its odd part; an even part is not measured"
        axes[1].set_title(also, fontsize=9, loc="left")
    legend_below(axes[1], 2)
    return figure


def _draw(axis: Any, band: Band, scale: float, factor: float, colour: str, name: str, *, is_split: bool) -> None:
    """Draw one curve with its band; friction jumps at rest and is not joined across it (``is_split``)."""
    for held in _sides(band.at) if is_split else [np.ones(band.at.size, dtype=bool)]:
        x, low, high = band.at[held] * scale, band.low[held] * factor, band.high[held] * factor
        axis.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
        axis.plot(x, band.force[held] * factor, color=colour, linewidth=1.4, label=name if held[-1] else None)


def _sides(at: FloatArray) -> list[Any]:
    """Return which points lie on either side of zero; zero itself belongs to the side above."""
    sides = [at < 0.0, at >= 0.0]
    return [side for side in sides if side.any()]
