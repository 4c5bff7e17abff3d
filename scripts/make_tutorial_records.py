"""Make the records of the tutorial: ring-downs of four tables on leaf springs, each with numbers of its own.

Each specimen obeys ``mass x'' + linear_stiffness x + viscous_damping x' + friction_force sign(x') = 0``: a linear
table whose guide rubs. It is held at a displacement, released, and its displacement is recorded in millimetres: some
samples before the release, an offset of the sensor, Gaussian noise, a 16-bit converter.

With ``--second-mode`` an accelerometer measures them, in g, at 1000 Hz, and with the table its frame rings, at 47 Hz.

Only NumPy is used, nothing of the package: between two turning points the motion is that of a linear oscillator about
a shifted middle, which is written down exactly.

Run ``python scripts/make_tutorial_records.py tables`` to write the folder that the tutorial begins with.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

SEED = 7
SPECIMENS = 4
MASS = 1.2  # kg
SAMPLING_RATE = 400.0  # Hz, fifty samples in a cycle
DURATION = 6.0  # s
NOISE = 0.02e-3  # m, standard deviation
STANDARD_GRAVITY = 9.80665  # m/s^2
STEP = 2.0 * 12e-3 / 2**16  # m, of a 16-bit converter for 12 mm to either side

# Mean and relative standard deviation; 3030 N/m on 1.2 kg is 8.0 Hz, 0.48 N s/m is 0.4 % of critical.
DISTRIBUTIONS = {
    "linear_stiffness": (3030.0, 0.010),  # N/m
    "viscous_damping": (0.48, 0.030),  # N s/m
    "friction_force": (0.075, 0.030),  # N
}


def free_decay(parameters: dict[str, float], release_amplitude: float, time: np.ndarray) -> np.ndarray:
    """Displacement [m] at ``time`` [s] after release from rest; held before zero, at rest where friction holds it."""
    stiffness, damping, friction = (parameters[name] for name in DISTRIBUTIONS)
    rate = damping / (2.0 * MASS)
    pulsation = math.sqrt(stiffness / MASS - rate**2)
    half_cycle = math.pi / pulsation
    displacement = np.full(time.size, release_amplitude)
    turning_point, begin = release_amplitude, 0.0
    while abs(turning_point) * stiffness > friction:
        # moving towards the other side: friction shifts the middle about which the spring pulls
        middle = math.copysign(friction / stiffness, turning_point)
        inside = (time >= begin) & (time < begin + half_cycle)
        since = time[inside] - begin
        wave = np.cos(pulsation * since) + rate / pulsation * np.sin(pulsation * since)
        displacement[inside] = middle + (turning_point - middle) * np.exp(-rate * since) * wave
        turning_point = middle - (turning_point - middle) * math.exp(-rate * half_cycle)
        begin += half_cycle
    displacement[time >= begin] = turning_point
    return displacement


def acceleration_of(parameters: dict[str, float], x: np.ndarray, time: np.ndarray, release_time: float) -> np.ndarray:
    """Acceleration [m/s^2] of a free decay: the force over the mass; none before the release."""
    stiffness, damping, friction = (parameters[name] for name in DISTRIBUTIONS)
    speed = np.gradient(x, time)
    moving = (time >= release_time) & (np.abs(speed) > 1e-9)
    return -(stiffness * x + damping * speed + friction * np.sign(speed)) / MASS * moving


def write(path: Path, time: np.ndarray, name: str, values: np.ndarray) -> None:
    """Write one record."""
    lines = [f"time [s],{name}", *(f"{t:.4f},{value:.5f}" for t, value in zip(time, values, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Write one CSV per specimen."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder to write to")
    parser.add_argument("--second-mode", action="store_true", help="measure acceleration, with a second mode at 47 Hz")
    options = parser.parse_args()
    folder, sampling_rate = options.folder, 1000.0 if options.second_mode else SAMPLING_RATE
    folder.mkdir(parents=True, exist_ok=True)

    rng = np.random.default_rng(SEED)
    time = np.arange(round(DURATION * sampling_rate)) / sampling_rate
    for number in range(1, SPECIMENS + 1):
        parameters = {name: mean * (1.0 + sd * rng.standard_normal()) for name, (mean, sd) in DISTRIBUTIONS.items()}
        release_amplitude = rng.uniform(5e-3, 9e-3)
        release_time = rng.uniform(0.1, 0.3)
        displacement = free_decay(parameters, release_amplitude, time - release_time)
        if options.second_mode:
            acceleration = acceleration_of(parameters, displacement, time, release_time)
            ringing = 0.25 * np.abs(acceleration).max() * np.exp(-1.5 * np.maximum(time - release_time, 0.0))
            acceleration += ringing * np.sin(2.0 * math.pi * 47.0 * (time - release_time)) * (time >= release_time)
            acceleration += 0.02 * rng.standard_normal(time.size)
            write(folder / f"table_{number}.csv", time, "acceleration [g]", acceleration / STANDARD_GRAVITY)
            continue
        measured = displacement + rng.uniform(-0.1e-3, 0.1e-3) + NOISE * rng.standard_normal(time.size)
        measured = np.round(measured / STEP) * STEP
        write(folder / f"table_{number}.csv", time, "displacement [mm]", 1e3 * measured)
    print(f"{SPECIMENS} records in {folder}")


if __name__ == "__main__":
    main()
