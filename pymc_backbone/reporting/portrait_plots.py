"""Figures of single records: over time and frequency, force over displacement and speed, distortion over amplitude."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from scipy.interpolate import PchipInterpolator

from .._common.checks import FloatArray, InputError
from ..discrepancy.results.portraits import Portraits, beyond_spring
from ..measurement.harmonics import ORDERS, HarmonicDecay
from ..measurement.time_frequency import TimeFrequency
from .style import COLUMN, MEASURED, QUIET, SIMULATED, TRUE, drawable, engineering, layout, legend_below, parameter_axis

_DEEPEST = -60.0  # dB
_LINE = 120  # points
_LINEAR = 8.0  # largest over smallest amplitude up to which the axis is linear


def plot_time_frequency(spectrum: TimeFrequency) -> Figure:
    """Draw a record over time and frequency, with the frequency that was followed.

    Parameters
    ----------
    spectrum : TimeFrequency
        From `Study.portraits`.

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    plots.plot_records : the records themselves.
    find_missing_effect : whose study holds it.
    """
    figure = Figure(figsize=(COLUMN, 3.3), layout=layout())
    axis = figure.subplots()
    time, frequency = spectrum.time, spectrum.frequency
    extent = (float(time[0]), float(time[-1]), float(frequency[0]), float(frequency[-1]))
    picture = axis.imshow(
        spectrum.level, origin="lower", aspect="auto", extent=extent, cmap="Greys", vmin=_DEEPEST, vmax=0.0,
        interpolation="bilinear",
    )  # fmt: skip
    axis.plot(spectrum.ridge_time, spectrum.ridge_frequency, color=SIMULATED, linewidth=1.3, label="frequency followed")
    if spectrum.band is not None:
        for number, edge in enumerate(spectrum.band):
            name = "band that was passed" if number == 0 else None
            axis.axhline(edge, color=MEASURED, linestyle="--", linewidth=1.1, label=name)
    if np.isfinite(spectrum.second_mode):
        axis.axhline(spectrum.second_mode, color=TRUE, linestyle=":", linewidth=1.4, label="second mode")
    axis.set_ylim(0.0, extent[3])
    axis.set_xlim(extent[0], extent[1])
    axis.set_xlabel("Time [s]")
    axis.set_ylabel("Frequency [Hz]")
    axis.set_title(f"{drawable(spectrum.specimen)}: {spectrum.quantity}", fontsize=9, loc="left")
    bar = figure.colorbar(picture, ax=axis, pad=0.02)
    bar.set_label("Amplitude [dB]", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    legend_below(axis, 3)
    return figure


def plot_force_sections(portraits: Portraits, amplitude_unit: str = "m") -> Figure:
    """Draw the measured force beyond the linear spring, over displacement at rest and over speed in passing zero.

    Parameters
    ----------
    portraits : Portraits
        From `Study.portraits`; with ``has_forces``.
    amplitude_unit : str
        ``"m"`` or ``"rad"``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        Where the record does not tell its forces.

    See Also
    --------
    find_missing_effect : whose study holds them.
    """
    if portraits.measured is None or not portraits.has_forces:
        raise InputError(
            "`portraits` must hold forces, which take 16 samples per cycle, no band and little noise; these do not."
        )
    figure = Figure(figsize=(COLUMN, 4.6), layout=layout())
    axes = figure.subplots(2, 1)
    shown = _models(portraits)
    measured = beyond_spring(portraits.measured, portraits.mass, portraits.stiffness)
    error = portraits.mass * np.repeat(portraits.measured.acceleration_error, 2)
    titles = ("Where the speed is zero: springs", "Where the displacement is zero: damping")
    for number, (axis, title) in enumerate(zip(axes, titles, strict=True)):
        place, force = measured[number]
        unit = "N" if amplitude_unit == "m" else "N m"
        factor, label = parameter_axis("force", np.abs(force), {"force": unit})
        scale, prefix = engineering(float(np.abs(place).max()), amplitude_unit)
        order = np.argsort(_places(portraits.measured, number))
        axis.errorbar(
            place * scale, force * factor, yerr=1.96 * error[order] * factor, fmt="o", markersize=2.6, color=MEASURED,
            elinewidth=0.6, linestyle="none", label="measured",
        )  # fmt: skip
        for name, colour, style, decay in shown:
            at, of_model = beyond_spring(decay, portraits.mass, portraits.stiffness)[number]
            inside = np.abs(at) <= 1.02 * np.abs(place).max()
            for side in (at < 0.0, at >= 0.0):
                x, y = _smooth_line(at[inside & side], of_model[inside & side])
                axis.plot(
                    x * scale,
                    y * factor,
                    color=colour,
                    linestyle=style,
                    linewidth=1.3,
                    label=name if side[-1] else None,
                )
        axis.axhline(0.0, color="black", linewidth=0.6)
        axis.set_title(title, fontsize=9, loc="left")
        what = "Displacement" if number == 0 else "Speed"
        axis.set_xlabel(f"{what} [{prefix}{amplitude_unit}{'' if number == 0 else '/s'}]")
        axis.set_ylabel(label)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5)
        axis.xaxis.set_major_locator(MaxNLocator(6))
    legend_below(axes[1], 3)
    return figure


def plot_distortion(portraits: Portraits, amplitude_unit: str = "m") -> Figure:
    """Draw the harmonics of a decay over the fundamental, with what noise makes of them, and those of the models.

    Parameters
    ----------
    portraits : Portraits
        From `Study.portraits`; with ``measured``.
    amplitude_unit : str
        ``"m"`` or ``"rad"``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        Where the record does not tell its harmonics.

    See Also
    --------
    find_missing_effect : whose study holds them.
    """
    if portraits.measured is None:
        raise InputError("`portraits` must hold harmonics, which take 16 samples per cycle and no band; these do not.")
    measured = portraits.measured
    figure = Figure(figsize=(COLUMN, 4.6), layout=layout())
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    scale, prefix = engineering(float(measured.amplitude.max()), amplitude_unit)
    is_narrow = measured.amplitude.max() < _LINEAR * measured.amplitude.min()
    lowest = max(1e-7, 0.3 * float(np.median(measured.floor)))
    for number, axis in enumerate(axes.flat):
        x = measured.amplitude * scale
        axis.fill_between(
            x, lowest, np.maximum(measured.floor[:, number], lowest), color=QUIET, alpha=0.25, linewidth=0,
            label="within noise (95 %)",
        )  # fmt: skip
        above = measured.ratios[:, number] > measured.floor[:, number]
        for held, name, face in ((above, "measured", MEASURED), (~above, None, "none")):
            axis.plot(
                x[held], np.maximum(measured.ratios[held, number], lowest), "o", markersize=2.8, color=MEASURED,
                markerfacecolor=face, markeredgewidth=0.6, label=name,
            )  # fmt: skip
        for name, colour, style, decay in _models(portraits):
            axis.plot(
                decay.amplitude * scale, np.maximum(decay.ratios[:, number], lowest), color=colour, linestyle=style,
                linewidth=1.3, label=name,
            )  # fmt: skip
        axis.set_yscale("log")
        axis.yaxis.set_minor_locator(NullLocator())
        if not is_narrow:
            axis.set_xscale("log")
            axis.xaxis.set_major_locator(LogLocator(numticks=8))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_locator(NullLocator())
        axis.set_title(f"Harmonic {ORDERS[number]}", fontsize=9, loc="left")
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5)
        axis.tick_params(labelsize=8)
    axes[0, 0].set_ylim(lowest, None)
    axes[0, 0].set_xlim(0.95 * float(measured.amplitude.min()) * scale, 1.05 * float(measured.amplitude.max()) * scale)
    for axis in axes[1]:
        axis.set_xlabel(f"Amplitude [{prefix}{amplitude_unit}]")
    for axis in axes[:, 0]:
        axis.set_ylabel("Over the fundamental [-]")
    legend_below(axes[0, 0], 2)
    return figure


def _places(decay: HarmonicDecay, number: int) -> np.ndarray:
    return np.asarray((decay.turning, decay.crossing)[number][:, :, 0].ravel())


def _smooth_line(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a monotone line through points of a model, one a cycle, that shows no corners where it has none."""
    if x.size < 4 or not (np.diff(x) > 0.0).all():
        return x, y
    fine = np.linspace(x[0], x[-1], _LINE)
    return fine, np.asarray(PchipInterpolator(x, y)(fine))


def _models(portraits: Portraits) -> list[tuple[str, str, str, HarmonicDecay]]:
    """Return name, colour, line and decay of the models there are."""
    both = (("base model", SIMULATED, "--", portraits.base), ("extended model", TRUE, "-", portraits.named))
    return [(name, colour, style, decay) for name, colour, style, decay in both if decay is not None]
