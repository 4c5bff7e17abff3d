"""The drawings of the pages on what a backbone is, made with the package's own simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pymc_backbone import Oscillator, simulate_backbone, simulate_decay, simulate_waveform

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8C8C8C"
LINEAR = {"linear_stiffness": 3950.0, "viscous_damping": 0.8}  # 10 Hz on 1 kg, 0.6 % of critical


def write(folder: Path) -> None:
    """Draw all of them into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    one_cycle(folder / "one_cycle.svg")
    three_backbones(folder / "three_backbones.svg")


def one_cycle(path: Path) -> None:
    """Draw the first cycles of a decay, with the quantities of one cycle."""
    oscillator, parameters = Oscillator(1.0), {"linear_stiffness": 3950.0, "viscous_damping": 8.0}
    time = np.linspace(0.0, 0.36, 2000)
    x = 10.0 * simulate_waveform(oscillator, parameters, time, 1.0).displacement + 0.8
    decay = simulate_decay(oscillator, parameters, 1.0, n_cycles=3)
    times, values = decay.turning_times, 10.0 * decay.turning_values + 0.8
    figure = Figure(figsize=(7.2, 3.3), layout="constrained")
    axis = figure.subplots()
    axis.axhline(0.0, color=GREY, linewidth=0.6)
    axis.plot(time, x, color=GREY, linewidth=1.2)
    inside = (time >= times[2]) & (time <= times[4])
    axis.plot(time[inside], x[inside], color=BLUE, linewidth=2.2)
    axis.plot(times[2:5], values[2:5], "o", color=ORANGE, markersize=6, zorder=3)
    for k, name, up in ((2, "$p_0$", 1), (3, "$q$", -1), (4, "$p_1$", 1)):
        axis.annotate(name, (times[k], values[k]), (0, 9 * up), textcoords="offset points", ha="center",
                      va="bottom" if up > 0 else "top", fontsize=13, color=ORANGE)  # fmt: skip
    low = values[3] - 5.4
    for k, name, side in ((2, "$t_0$", "right"), (4, "$t_1$", "left")):
        axis.plot([times[k]] * 2, [low, values[k]], color=ORANGE, linewidth=0.8, linestyle=":")
        shift = -5 if side == "right" else 5
        axis.annotate(name, (times[k], low), (shift, 2), textcoords="offset points", ha=side, color=ORANGE, fontsize=12)
    axis.annotate("", (times[4], low + 0.6), (times[2], low + 0.6), arrowprops={"arrowstyle": "<->", "color": GREY})
    axis.text(times[3], low + 0.9, "1 / frequency", ha="center", va="bottom", fontsize=10, color="#444444")
    axis.set(xlabel="Time [s]", ylabel="Displacement [mm]", ylim=(low - 0.8, 12.8), xlim=(0.0, 0.36))
    _tidy(figure)
    figure.savefig(path, metadata={"Date": None})


def three_backbones(path: Path) -> None:
    """Draw ring-downs of a linear, a hardening and a rubbing oscillator, and their backbones."""
    release = 0.010
    cases = (
        ("linear", BLUE, Oscillator(1.0), LINEAR),
        ("cubic spring", ORANGE, Oscillator(1.0, "cubic_stiffness"), LINEAR | {"cubic_stiffness": 1.2e7}),
        ("dry friction", GREEN, Oscillator(1.0, "coulomb_friction"), LINEAR | {"friction_force": 0.12}),
    )
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    grid = figure.add_gridspec(3, 3, width_ratios=(1.25, 1.0, 1.0))
    frequency, damping = figure.add_subplot(grid[:, 1]), figure.add_subplot(grid[:, 2])
    time = np.linspace(0.0, 3.2, 6000)
    levels = release * np.linspace(0.06, 1.0, 80)
    for row, (name, colour, oscillator, parameters) in enumerate(cases):
        axis = figure.add_subplot(grid[row, 0])
        decay = simulate_waveform(oscillator, parameters, time, release, release_time=0.15)
        axis.plot(time, 1e3 * decay.displacement, color=colour, linewidth=0.6)
        axis.set(xlim=(0.0, 3.2), ylim=(-11.5, 11.5), yticks=(-10, 0, 10))
        axis.text(3.15, 7.0, name, ha="right", fontsize=10, color=colour)
        axis.tick_params(labelbottom=row == 2)
        if row == 1:
            axis.set_ylabel("Displacement [mm]")
        if row == 2:
            axis.set_xlabel("Time [s]")
        curve = simulate_backbone(oscillator, parameters, levels)
        frequency.plot(1e3 * levels, curve.frequency, color=colour, linewidth=2.2, linestyle="--" if row == 2 else "-")
        damping.plot(1e3 * levels, curve.damping, color=colour, linewidth=2.2)
    frequency.set(xlabel="Amplitude [mm]", ylabel="Frequency [Hz]", xlim=(0.0, 10.0))
    damping.set(xlabel="Amplitude [mm]", ylabel="Damping (decrement per cycle)", xlim=(0.0, 10.0), ylim=(0.0, None))
    _tidy(figure)
    figure.savefig(path, metadata={"Date": None})


def _tidy(figure: Figure) -> None:
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=9)
