"""Measured records from the literature beside their published figures.

    python benchmarks/real_records.py FOLDER

FOLDER holds `ship_roll_kvlcc2/run_21337.csv` and `run_21340.csv` (roll decay of a tanker model, angle in rad; doi
10.17632/2stvkyngj9.1) and `jointed_beam/*.csv` (hammer impacts on a bolted double beam, velocity in m/s; doi
10.1098/rsta.2021.0194). The records are not part of this package.
"""

from __future__ import annotations

import sys
from pathlib import Path

import arviz as az
import numpy as np

import pymc_backbone as pb

# A44 + added inertia [kg m^2], and per run: B1 [N m s], B2 [N m s^2], equivalent damping ratio at 5 degrees [%].
INERTIA = 135.0
PUBLISHED = {"run_21337": (0.54, 14.95, 0.488), "run_21340": (7.93, 5.10, 1.33)}


def ship(folder: Path) -> None:
    """Fit cubic stiffness and quadratic damping above 3.5 degrees and print the damping at 5 degrees."""
    oscillator = pb.Oscillator(INERTIA, ["cubic_stiffness", "quadratic_damping"])
    bounds = {"linear_stiffness": (740.0, 900.0), "viscous_damping": (0.0, 20.0), "cubic_stiffness": (-2000.0, 4000.0),
              "quadratic_damping": (0.0, 60.0)}  # fmt: skip
    for run, (b1, b2, ratio) in PUBLISHED.items():
        records = pb.read_records(folder / f"{run}.csv", unit="rad")
        cycles = [pb.extract_cycles(pb.condition(record)) for record in records]
        backbones = pb.backbones_at_levels(cycles, levels=np.radians(np.geomspace(3.6, 8.4, 8)))
        model = pb.build_model(oscillator, backbones, bounds, likelihood="pooled")
        posterior = pb.sample(model, draws=5000, tune=2000, random_seed=1)
        names = list(oscillator.parameter_names)
        draws = np.stack([posterior["posterior"][name].values.ravel() for name in names], axis=1)[::40]
        damping = np.array([pb.simulate_backbone(oscillator, row, [np.radians(5.0)]).damping[0] for row in draws])
        percent = 100.0 * damping / np.sqrt(4.0 * np.pi**2 + damping**2)
        table = az.summary(posterior, ci_prob=0.95, ci_kind="hdi", round_to="none")
        print(f"{run}: {cycles[0].amplitude.size} cycles, {backbones.sizes['level']} levels")
        print(f"  damping ratio at 5 degrees {percent.mean():.3f} +- {percent.std():.3f} % (published {ratio} %, "
              f"{100.0 * (percent.mean() / ratio - 1.0):+.1f} %)")  # fmt: skip
        for label, name, value in (("B1", "viscous_damping", b1), ("B2", "quadratic_damping", b2)):
            row = table.loc[name]
            print(f"  {label} {row['mean']:.2f}, 95 % HDI {row['hdi95_lb']:.2f} to {row['hdi95_ub']:.2f} (published "
                  f"{value}); R-hat {row['r_hat']:.4f}, {row['ess_bulk']:.0f} effective draws")  # fmt: skip


def beam(folder: Path) -> None:
    """Print the backbone that all nine band-passed records fall on, and how far apart they lie."""
    records = pb.read_records(folder)
    cycles = [pb.extract_cycles(pb.condition(record, band=(90.0, 160.0))) for record in records]
    speed = 2.0 * np.pi * 122.2
    highest = max(one.amplitude.max() for one in cycles) * speed
    levels = np.array([0.08, 0.12, 0.2, 0.3, 0.45, 0.7])
    backbones = pb.backbones_at_levels(cycles, levels=levels / speed)
    print(f"jointed beam: {len(cycles)} records, velocity amplitude of the 122 Hz mode up to {highest:.2f} m/s")
    print("  m/s    records   frequency [Hz]: mean, spread, standard error  damping ratio [%]: mean, spread, error")
    for k, level in enumerate(levels):
        value, error = backbones["value"].values[:, :, k], backbones["standard_error"].values[:, :, k]
        ratio = 100.0 / (2.0 * np.pi)
        count = int(np.isfinite(value[:, 0]).sum())
        spread = [np.nanstd(value[:, o], ddof=1) if count > 1 else np.nan for o in range(2)]
        print(f"  {level:4.2f}   {count:7d}   {np.nanmean(value[:, 0]):14.3f} {spread[0]:9.4f} "
              f"{np.nanmean(error[:, 0]):9.4f} {ratio * np.nanmean(value[:, 1]):28.4f} {ratio * spread[1]:9.4f} "
              f"{ratio * np.nanmean(error[:, 1]):9.4f}")  # fmt: skip

    frequency, ratio = (float(np.nanmean(backbones["value"].values[:, o, 0])) for o in range(2))
    last = [float(np.nanmean(backbones["value"].values[:, o, -1])) for o in range(2)]
    reach = (1.01 - levels[0]) / (levels[-1] - levels[0])
    print(f"  straight lines through lowest and highest reach {frequency + reach * (last[0] - frequency):.2f} Hz and "
          f"{100.0 / (2.0 * np.pi) * (ratio + reach * (last[1] - ratio)):.3f} % at 1.01 m/s")  # fmt: skip
    print(f"  velocity of the 122 Hz mode by a fit of both modes, largest: {max(map(largest_speed, records)):.2f} m/s")


def largest_speed(record: pb.Record) -> float:
    """Return the largest velocity amplitude of the 122 Hz mode: least squares of two growing or decaying modes."""
    found = []
    for begin in (0.0, 0.02, 0.05, 0.1):
        inside = (record.time >= begin) & (record.time < begin + 0.033)
        t = record.time[inside] - begin
        columns = [np.ones_like(t)]
        for frequency in (122.1, 243.5):
            for shape in (np.cos, np.sin):
                wave = shape(2.0 * np.pi * frequency * t)
                columns += [wave, t * wave]
        fitted = np.linalg.lstsq(np.column_stack(columns), record.values[inside], rcond=None)[0]
        found.append(float(np.hypot(fitted[1], fitted[3])))
    return max(found)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    ship(Path(sys.argv[1]) / "ship_roll_kvlcc2")
    beam(Path(sys.argv[1]) / "jointed_beam")
