"""Draw the picture of README.md from the demo: a record, the backbones with what the model predicts, a posterior.

``python scripts/readme_picture.py`` writes ``docs/_static/first_look.png``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import pymc_backbone as pb

TARGET = Path(__file__).resolve().parents[1] / "docs" / "_static" / "first_look.png"
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#8C8C8C"
BOUNDS = {"linear_stiffness": (5e3, 9e3), "viscous_damping": (0.0, 5.0), "cubic_stiffness": (0.0, 2e7)}


def draw(path: Path) -> None:
    """Infer the demo's parameters, and draw."""
    records = pb.read_records(pb.demo_folder())
    backbones = pb.backbones_at_levels([pb.extract_cycles(pb.condition(record)) for record in records])
    mass, truth = pb.demo_parameters()
    oscillator = pb.Oscillator(mass, effects=["cubic_stiffness"])
    model = pb.build_model(oscillator, pb.fit_density(backbones, kind="joint"), BOUNDS)
    posterior = pb.sample(model, random_seed=1, progressbar=False)["posterior"]
    draws = {name: np.ravel(posterior[name]) for name in oscillator.parameter_names}
    vectors = np.column_stack([values[::20] for values in draws.values()])
    levels = backbones["level"].values
    predicted = pb.simulated_backbones(oscillator, vectors, levels, ["frequency"])["value"].values[:, 0]

    figure = Figure(figsize=(10.0, 2.9), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.25, 1.0, 1.0])
    record = records[0]
    left.plot(record.time, 1e3 * record.values, color=GREY, linewidth=0.5)
    left.set(xlabel="Time [s]", ylabel="Displacement [mm]", xlim=(record.time[0], record.time[-1]))
    left.set_title(f"{len(records)} ring-downs", fontsize=11)
    low, high = np.percentile(predicted, [2.5, 97.5], axis=0)
    middle.fill_between(1e3 * levels, low, high, color=ORANGE, alpha=0.3, linewidth=0.0, label="model, 95 %")
    measured = backbones["value"].sel(observable="frequency").values
    middle.plot(1e3 * levels, measured.T, color=BLUE, linewidth=0.7, label=["measured"] + [None] * (len(measured) - 1))
    middle.set(xlabel="Amplitude [mm]", ylabel="Frequency [Hz]")
    middle.set_title("their backbones", fontsize=11)
    middle.legend(frameon=False, fontsize=9)
    name = "cubic_stiffness"
    heights, _, _ = right.hist(draws[name] / 1e6, 45, density=True, color=ORANGE, alpha=0.6, label="inferred")
    right.plot(truth[name] / 1e6, np.zeros_like(truth[name]), "k|", markersize=14, label="true, each specimen")
    right.set(
        xlabel="Cubic stiffness [MN/m$^3$]", yticks=[], ylim=(0.0, 1.4 * heights.max())
    )  # the legend stands above
    right.set_title("what explains them", fontsize=11)
    right.legend(frameon=False, fontsize=9)
    for axis in (left, middle, right):
        axis.spines[["top", "right"]].set_visible(False)
    right.spines["left"].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    """Draw into the documentation, or elsewhere."""
    parser = argparse.ArgumentParser(description="Draw the picture of README.md.")
    parser.add_argument("path", nargs="?", type=Path, default=TARGET)
    draw(parser.parse_args().path)


if __name__ == "__main__":
    main()
