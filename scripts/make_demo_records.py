"""Make the demo batch: ring-down records of 24 nominally equal specimens, with what a real measurement adds.

Each specimen obeys ``mass x'' + linear_stiffness x + viscous_damping x' + cubic_stiffness x^3 = 0`` with its own
parameters, drawn from normal distributions. It is held at a displacement, released, and its displacement is measured:
a few samples before the release, an offset of the sensor, Gaussian noise, a 14-bit converter, unequal lengths.

Only NumPy and SciPy are used, nothing of the package: the batch is an independent check of it.

Run ``python scripts/make_demo_records.py`` to write the files that ship in ``pymc_backbone/data/demo``.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

SEED = 20241016
SPECIMENS = 24
MASS = 1.0  # kg
SAMPLING_RATE = 500.0  # Hz, about 35 samples in a cycle
RELEASE_AMPLITUDE = 0.020  # m: there the cubic force is a third of the linear one
FULL_SCALE = 0.025  # m, of the 14-bit converter
BITS = 14
NOISE_BELOW_RELEASE = 48.0  # dB, standard deviation of the noise below the release amplitude

# Mean and relative standard deviation over the batch; 7000 N/m on 1 kg is 13.3 Hz, 1.7 N s/m is 1.0 % of critical.
DISTRIBUTIONS = {
    "linear_stiffness": (7000.0, 0.020),
    "viscous_damping": (1.7, 0.060),
    "cubic_stiffness": (6.0e6, 0.060),
}
UNITS = {"linear_stiffness": "N/m", "viscous_damping": "N s/m", "cubic_stiffness": "N/m^3"}


def free_decay(parameters: dict[str, float], release_amplitude: float, time: np.ndarray) -> np.ndarray:
    """Displacement [m] at ``time`` [s] after release from rest; held at the release amplitude before zero."""
    stiffness, damping, cubic = (parameters[name] for name in DISTRIBUTIONS)

    def rate(_: float, state: np.ndarray) -> list[float]:
        x, v = state
        return [v, -(stiffness * x + damping * v + cubic * x**3) / MASS]

    solution = solve_ivp(
        rate,
        (0.0, float(time[-1])),
        [release_amplitude, 0.0],
        method="DOP853",
        rtol=1e-11,
        atol=1e-13,
        t_eval=time[time >= 0.0],
    )
    if not solution.success:
        raise RuntimeError(solution.message)
    return np.concatenate([np.full(int(np.sum(time < 0.0)), release_amplitude), solution.y[0]])


def main() -> None:
    """Write one CSV per specimen and the parameters behind them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(__file__).resolve().parents[1] / "pymc_backbone" / "data" / "demo"
    parser.add_argument("--out", type=Path, default=default, help="folder to write to (default: the package's own)")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)

    rng = np.random.default_rng(SEED)
    step = 2.0 * FULL_SCALE / 2**BITS
    noise = RELEASE_AMPLITUDE * 10.0 ** (-NOISE_BELOW_RELEASE / 20.0)
    specimens = []
    for number in range(1, SPECIMENS + 1):
        parameters = {name: mean * (1.0 + sd * rng.standard_normal()) for name, (mean, sd) in DISTRIBUTIONS.items()}
        release_amplitude = RELEASE_AMPLITUDE * rng.uniform(0.96, 1.02)
        release_time = rng.uniform(0.06, 0.16)
        offset = rng.uniform(-1.5e-4, 1.5e-4)
        samples = int(rng.integers(1750, 1950))
        time = np.arange(samples) / SAMPLING_RATE
        displacement = free_decay(parameters, release_amplitude, time - release_time)
        measured = displacement + offset + noise * rng.standard_normal(samples)
        measured = np.clip(np.round(measured / step) * step, -FULL_SCALE, FULL_SCALE - step)
        name = f"specimen_{number:02d}"
        lines = ["time [s],displacement [m]", *(f"{t:.3f},{x:.7f}" for t, x in zip(time, measured, strict=True))]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        specimens.append(
            {"specimen": name}
            | {key: float(f"{value:.6g}") for key, value in parameters.items()}
            | {
                "release_amplitude": float(f"{release_amplitude:.6g}"),
                "release_time": float(f"{release_time:.6g}"),
                "offset": float(f"{offset:.4g}"),
            }
        )

    mean_stiffness, mean_damping = DISTRIBUTIONS["linear_stiffness"][0], DISTRIBUTIONS["viscous_damping"][0]
    truth = {
        "equation": "mass x'' + linear_stiffness x + viscous_damping x' + cubic_stiffness x^3 = 0",
        "mass": MASS,
        "units": UNITS | {"mass": "kg", "release_amplitude": "m", "release_time": "s", "offset": "m"},
        "distributions": {
            name: {"kind": "normal", "mean": mean, "sd": round(mean * sd, 6)}
            for name, (mean, sd) in DISTRIBUTIONS.items()
        },
        "linear_frequency": round(math.sqrt(mean_stiffness / MASS) / (2.0 * math.pi), 3),
        "linear_damping_ratio": round(mean_damping / (2.0 * math.sqrt(mean_stiffness * MASS)), 5),
        "sampling_rate": SAMPLING_RATE,
        "noise_sd": float(f"{noise:.4g}"),
        "quantisation_step": float(f"{step:.4g}"),
        "seed": SEED,
        "specimens": specimens,
    }
    (folder / "true_parameters.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
