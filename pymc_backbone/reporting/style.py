"""What all figures share: colours, panels, readable units, labels, smoothed densities."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from .._common.checks import OBSERVABLE_UNITS, FloatArray
from .._common.text import capitalised, in_words, prefix_of

FEW = 12  # up to so many specimens, each backbone is drawn with its error bars
COLUMN = 4.8  # inches: the width of a figure of a report, two of which stand side by side
MOST_ROWS = 24  # of specimens or levels in one figure
# Okabe and Ito's colours, told apart by colour-blind readers too.
MEASURED, SIMULATED, TRUE, QUIET = "#0072B2", "#D55E00", "#009E73", "#8C8C8C"
OBSERVABLE_NAMES = {
    "frequency": "Frequency",
    "damping": "Logarithmic decrement per cycle",
    "offset": "Mid-line / amplitude",
}


def panels(rows: int, columns: int, *, width: float, height: float) -> tuple[Figure, Any]:
    """Return a figure of equal panels [inches], and its axes (rows, columns)."""
    figure = Figure(figsize=(width * columns + 0.4, height * rows + 0.7), layout=layout())
    return figure, figure.subplots(rows, columns, squeeze=False)


def layout() -> ConstrainedLayoutEngine:
    """Return the layout engine of every figure."""
    return ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.07)


def amplitude_axis(backbones: xr.Dataset) -> tuple[FloatArray, float, str]:
    """Levels, the factor to a readable unit, and the label of the amplitude axis."""
    levels = np.asarray(backbones["level"], dtype=float)
    unit = str(backbones.attrs.get("amplitude_unit", "m"))
    scale, prefix = engineering(float(levels.max()), unit)
    return levels, scale, f"Amplitude [{prefix}{unit}]"


def engineering(largest: float, unit: str) -> tuple[float, str]:
    """Factor and prefix that bring the largest value into 1 to 1000; angles and compound units stay as they are."""
    if unit != "m" or not np.isfinite(largest) or largest <= 0.0:
        return 1.0, ""
    return prefix_of(largest)


def observable_label(name: str, *, short: bool = False) -> str:
    """Name and unit of an observable."""
    unit = OBSERVABLE_UNITS.get(name, "1")
    text = name.capitalize() if short else OBSERVABLE_NAMES.get(name, name.capitalize())
    return f"{text} [{'-' if unit == '1' else unit}]"


def parameter_axis(name: str, values: FloatArray, units: Mapping[str, str] | None) -> tuple[float, str]:
    """Factor that brings a parameter's values near one to a thousand, and the label that says so."""
    unit = (units or {}).get(name, "")
    text = capitalised(in_words(name))
    largest = float(np.max(np.abs(values), initial=0.0))
    exponent = int(np.floor(np.log10(largest))) if largest > 0.0 and np.isfinite(largest) else 0
    exponent = 0 if -3 < exponent < 5 else 3 * (exponent // 3)
    unit = "-" if unit == "1" else re.sub(r"\^(-?\w+)", r"$^{\1}$", unit)
    factor = f"$10^{{{exponent}}}$" if exponent else ""
    inside = " ".join(part for part in (factor, "" if factor and unit == "-" else unit) if part)
    return 10.0**-exponent, f"{text} [{inside}]" if inside else text


def label_axes(axis: Axes, amplitude_label: str, observable: str) -> None:
    """Label and tidy a panel that shows an observable over the amplitude."""
    axis.set_xlabel(amplitude_label)
    axis.set_ylabel(observable_label(observable))
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5)
    axis.ticklabel_format(axis="y", useOffset=False)


def legend_below(axis: Axes, columns: int, **style: Any) -> None:
    """Set what ``axis`` has labels for below the whole figure."""
    handles, labels = axis.get_legend_handles_labels()
    axis.get_figure(root=True).legend(  # type: ignore[union-attr]
        handles, labels, loc="outside lower center", ncols=columns, fontsize=8, frameon=False, **style
    )


def evenly(count: int, most: int) -> list[int]:
    """Return at most so many of ``count`` indices, evenly spaced, the first and the last among them."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))]


def span(values: FloatArray) -> tuple[float, float]:
    """Range of the values with a tenth of it to either side."""
    margin = 0.1 * float(np.ptp(values))
    return float(values.min()) - margin, float(values.max()) + margin


def sequence(count: int) -> list[Any]:
    """Colours for so many specimens, dark to bright."""
    from matplotlib import colormaps

    return list(colormaps["viridis"](np.linspace(0.0, 0.9, max(count, 1))))


def smooth(draws: FloatArray, low: float = -np.inf, high: float = np.inf) -> tuple[FloatArray, FloatArray]:
    """Kernel density of draws inside hard bounds, reflected at them so that it does not fall off there."""
    spread = float(np.std(draws))
    left, right = max(low, float(draws.min()) - 0.5 * spread), min(high, float(draws.max()) + 0.5 * spread)
    if right <= left:
        return np.array([left, left]), np.zeros(2)
    edges = np.linspace(left, right, 513)
    x = 0.5 * (edges[1:] + edges[:-1])
    histogram = np.histogram(draws, bins=edges, density=True)[0]
    step = x[1] - x[0]
    bandwidth = max(0.9 * spread * draws.size ** (-0.2), step)
    reach = int(np.ceil(4.0 * bandwidth / step))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / bandwidth) ** 2)
    padded = np.pad(histogram, reach, mode="symmetric")
    return x, np.convolve(padded, kernel / kernel.sum(), mode="valid")


def drawable(text: str, most: int = 40) -> str:
    """Return text from a file as a figure can show it: one line, no formula, a question mark for a missing glyph."""
    glyphs = _glyphs()
    line = "".join(c if ord(c) in glyphs else "?" for c in " ".join(str(text).split()))
    line = line if len(line) <= most else line[: most - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return line.replace("$", r"\$")


def drawable_names(names: Sequence[str], most: int) -> list[str]:
    """Return names that stand beside each other, too long ones without as much of what they begin with alike.

    Examples
    --------
    >>> drawable_names(["free_swing_data_01", "free_swing_data_02"], 12)
    ['…ing_data_01', '…ing_data_02']
    """
    shared = next((i for i, letters in enumerate(zip(*names, strict=False)) if len(set(letters)) > 1), 0)
    cut = min(shared, max(map(len, names), default=0) - most + 1)
    return [drawable(f"\N{HORIZONTAL ELLIPSIS}{name[cut:]}" if cut > 1 else name, most) for name in names]


@cache
def _glyphs() -> frozenset[int]:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return frozenset(get_font(findfont(FontProperties())).get_charmap())


def counted(number: int, noun: str) -> str:
    """Write a number of things."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
