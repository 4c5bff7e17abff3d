"""Make easy batches: strong effects, 35 to 50 dB, five records; what the baselines are tuned on.

    python benchmarks/hidden_effects/baselines/easy_batches.py DIR [--seed 1] [--repeats 3] [--nothing 3]

One batch per effect of the library and repeat, after the ones in which nothing is missing. The folders are those of
hidden-effect batches: ``records/specimen_*.csv`` and ``truth.json``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pymc_backbone import LIBRARY, Oscillator, simulate_waveform

HIDDEN = tuple(name for name in LIBRARY if name not in ("linear_stiffness", "viscous_damping"))
N_RECORDS = 5


def strong_parameters(
    name: str, force: float, amplitude: float, angular_frequency: float, rng: np.random.Generator
) -> dict[str, float]:
    """Draw strong parameters of one effect.

    Parameters
    ----------
    name : str
        An effect of the library.
    force : float
        Stiffness times amplitude [N]: the linear restoring force at release.
    amplitude, angular_frequency : float
        Of the release [m or rad] and of the small vibration [rad/s].
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    dict
        Parameter name to value [SI].
    """

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    stiffness = force / amplitude
    speed = angular_frequency * amplitude
    sign = float(rng.choice([-1.0, 1.0]))
    match name:
        case "cubic_stiffness":
            return {name: sign * between(0.1, 0.4) * stiffness / amplitude**2}
        case "quintic_stiffness":
            return {name: sign * between(0.1, 0.4) * stiffness / amplitude**4}
        case "quadratic_stiffness":
            return {name: sign * between(0.08, 0.3) * stiffness / amplitude}
        case "bilinear_stiffness":
            return {name: sign * between(0.1, 0.5) * stiffness}
        case "pendulum_stiffness":
            return {name: between(0.8, 1.0) * stiffness}
        case "freeplay":
            return {"contact_stiffness": between(0.2, 0.8) * stiffness, "gap": rng.uniform(0.2, 0.6) * amplitude}
        case "coulomb_friction":
            return {"friction_force": between(0.002, 0.01) * force}
        case "quadratic_damping":
            return {name: between(0.02, 0.08) * force / speed**2}
        case "cubic_damping":
            return {name: between(0.02, 0.08) * force / speed**3}
        case "displacement_dependent_damping":
            return {name: between(0.04, 0.15) * force / (amplitude**2 * speed)}
        case "jenkins":
            share = between(0.1, 0.4)
            return {"slider_stiffness": share * stiffness, "slip_force": share * rng.uniform(0.1, 0.5) * force}
        case "iwan":
            share = between(0.15, 0.5)
            return {
                "joint_stiffness": share * stiffness,
                "joint_slip_force": share * rng.uniform(0.2, 0.8) * force,
                "joint_exponent": rng.uniform(-0.8, -0.2),
            }
        case "bouc_wen":
            size = rng.uniform(0.15, 0.6) * amplitude
            return {
                "bouc_wen_stiffness": between(0.2, 0.6) * stiffness,
                "bouc_wen_amplitude": 1.0,
                "bouc_wen_alpha": rng.uniform(0.1, 0.5),
                "bouc_wen_beta": 0.6 / size,
                "bouc_wen_gamma": 0.4 / size,
                "bouc_wen_exponent": 1.0,
            }
    raise KeyError(name)


def make_batch(
    folder: Path, hidden: tuple[str, ...], rng: np.random.Generator, base: tuple[str, ...] = (), tier: str = "easy"
) -> None:
    """Simulate one batch and write it.

    Parameters
    ----------
    folder : Path
        Created; receives ``records/`` and ``truth.json``.
    hidden, base : tuple of str
        Effects that are in the data: unknown to the model, known to it.
    rng : numpy.random.Generator
        Source of randomness.
    tier : str
        Recorded in ``truth.json``.
    """
    present = (*base, *hidden)
    for _ in range(20):
        batch = _draw(present, rng)
        if batch is not None:
            break
    else:
        raise RuntimeError(f"no decay with {present} completed in twenty draws")
    mass, records = batch
    (folder / "records").mkdir(parents=True, exist_ok=True)
    for i, (time, displacement) in enumerate(records):
        np.savetxt(
            folder / "records" / f"specimen_{i + 1}.csv", np.column_stack([time, displacement]), delimiter=",",
            header="time,displacement", comments="", fmt="%.9g",
        )  # fmt: skip
    truth = {"mass": mass, "base": list(base), "hidden": list(hidden), "tier": tier}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def _draw(present: tuple[str, ...], rng: np.random.Generator) -> tuple[float, list[tuple]] | None:
    mass = float(10 ** rng.uniform(-2, 3))
    frequency = float(10 ** rng.uniform(-0.7, 2.3))
    amplitude = rng.uniform(0.5, 1.2) if "pendulum_stiffness" in present else float(10 ** rng.uniform(-5, -0.5))
    omega = 2 * np.pi * frequency
    stiffness = mass * omega**2
    effects = Oscillator(mass, list(present))
    ratio = float(np.exp(rng.uniform(np.log(0.003), np.log(0.01))))
    centre = {"linear_stiffness": stiffness, "viscous_damping": 2 * ratio * mass * omega}
    for name in present:
        centre |= strong_parameters(name, stiffness * amplitude, amplitude, omega, rng)
    per_cycle, cycles = rng.integers(20, 101), rng.integers(30, 81)
    level = rng.uniform(35, 50)
    records = []
    for _ in range(N_RECORDS):
        parameters = {key: value * (1 + 0.02 * rng.standard_normal()) for key, value in centre.items()}
        if "joint_exponent" in parameters:
            parameters["joint_exponent"] = centre["joint_exponent"]
        if "bouc_wen_exponent" in parameters:
            parameters["bouc_wen_exponent"] = 1.0
        release = amplitude * rng.uniform(0.9, 1.1)
        hold = rng.uniform(0.5, 2.0) / frequency
        time = np.arange(int(per_cycle * (cycles + hold * frequency))) / (per_cycle * frequency)
        result = simulate_waveform(effects, parameters, time, release, release_time=hold)
        if not np.all(np.isfinite(result.displacement)):
            return None
        noise = amplitude / np.sqrt(2) * 10 ** (-level / 20) * rng.standard_normal(time.size)
        step = 2 * amplitude / 2**15
        offset = 0.05 * amplitude * rng.standard_normal()
        records.append((time, np.round((result.displacement + noise + offset) / step) * step))
    return mass, records


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("directory", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3, help="batches per effect")
    parser.add_argument("--nothing", type=int, default=3, help="batches in which nothing is missing")
    options = parser.parse_args()
    wanted: list[tuple[str, ...]] = [()] * options.nothing + [(name,) for name in HIDDEN] * options.repeats
    for i, hidden in enumerate(wanted):
        rng = np.random.default_rng([options.seed, i])
        tier = "easy" if hidden else "nothing"
        make_batch(options.directory / f"batch_{i:04d}", hidden, rng, tier=tier)


if __name__ == "__main__":
    main()
