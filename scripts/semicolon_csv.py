"""Make records as many loggers export them: semicolons, decimal commas, milliseconds, acceleration in g.

    python scripts/semicolon_csv.py ring_downs
    pymc-backbone diagnose ring_downs --mass 1.2 --quick --out diagnosis

Three specimens of 1.2 kg ring down at 12 Hz. A model with a linear spring and a viscous damper does not explain them:
at 10 mm a hardening spring adds 20 % to the linear one. What is said about these files: docs/semicolon_csv.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import pymc_backbone as pb

MASS = 1.2  # kg
SAMPLING_RATE = 1000.0  # Hz
SECONDS = 3.0
GRAVITY = 9.80665  # m/s^2
TRUTH = {"linear_stiffness": 6800.0, "viscous_damping": 1.1, "cubic_stiffness": 1.4e7}


def acceleration(parameters: dict[str, float], release: float, time: np.ndarray) -> np.ndarray:
    """Return the acceleration [m/s^2] after a release from rest at time zero."""
    oscillator = pb.Oscillator(MASS, ["cubic_stiffness"])
    fine = np.linspace(0.0, time[-1], 20 * (time.size - 1) + 1)
    displacement = pb.simulate_waveform(oscillator, parameters, fine, release).displacement
    velocity = np.gradient(displacement, fine, edge_order=2)
    force = parameters["linear_stiffness"] * displacement + parameters["viscous_damping"] * velocity
    force += parameters["cubic_stiffness"] * displacement**3
    return (-force / MASS)[::20]


def text_of(time: np.ndarray, values: np.ndarray) -> str:
    """Return a file: header lines of the logger, then columns."""
    lines = ["Logger;RD-24;SN 00817", "Channel;A1;IEPE 100 mV/g", "time [ms];Acc (g)"]
    lines += [f"{1e3 * t:.3f};{a / GRAVITY:.6f}".replace(".", ",") for t, a in zip(time, values, strict=True)]
    return "\r\n".join(lines) + "\r\n"


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("ring_downs"), help="(ring_downs)")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(20)
    time = np.arange(int(SECONDS * SAMPLING_RATE)) / SAMPLING_RATE
    for number in range(1, 4):
        own = {
            **TRUTH,
            "linear_stiffness": TRUTH["linear_stiffness"] * (1.0 + 0.01 * rng.standard_normal()),
            "viscous_damping": TRUTH["viscous_damping"] * (1.0 + 0.05 * rng.standard_normal()),
        }
        values = acceleration(own, rng.uniform(0.008, 0.012), time)
        values += 0.002 * np.abs(values).max() * rng.standard_normal(time.size)
        path = folder / f"beam_{number}.csv"
        path.write_bytes(text_of(time, values).encode("cp1252"))
        print(path)


if __name__ == "__main__":
    main()
