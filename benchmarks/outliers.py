"""Specimens that do not belong: false alarms over batches of honest scatter, and catches of each kind.

    python benchmarks/outliers.py --batches 400

A batch is 2 to 20 specimens of one structure, simulated cycle by cycle with the noise of the cycles added: stiffness
scatters by up to 3 %, damping by up to 30 %, the strengths of the effects by up to 10 %, the amplitude of release by up
to 50 % (standard deviations, uniform between a tenth of that and that). For the catches one specimen of such a batch is
replaced.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.stats import binomtest

from pymc_backbone.measurement.cycle_data import Cycles
from pymc_backbone.measurement.outliers import find_outliers
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_decay

EFFECTS = (
    (),
    ("cubic_stiffness",),
    ("coulomb_friction",),
    ("quadratic_damping",),
    ("cubic_stiffness", "coulomb_friction"),
)
OTHERS = 0.3  # friction force over the spring's at release, cubic over linear force, and the like


def specimen(
    rng: np.random.Generator, name: str, effects: tuple[str, ...], frequency: float, damping: float, amplitude: float,
    strengths: dict[str, float], scatter: tuple[float, float, float, float],
) -> Cycles:  # fmt: skip
    """Return the cycles of one specimen, its parameters scattered about those of the structure."""
    stiffness = (2.0 * np.pi * frequency) ** 2 * max(1.0 + scatter[0] * rng.standard_normal(), 0.5)
    ratio = min(damping * np.exp(scatter[1] * rng.standard_normal()), 0.15)
    viscous = 2.0 * ratio * 2.0 * np.pi * frequency
    release = amplitude * np.exp(scatter[3] * rng.standard_normal())
    typical = {
        "cubic_stiffness": stiffness / amplitude**2,
        "friction_force": 0.05 * stiffness * amplitude,
        "quadratic_damping": 0.2 / amplitude,
    }
    oscillator = Oscillator(1.0, list(effects))
    parameters = {"linear_stiffness": stiffness, "viscous_damping": viscous}
    for parameter in oscillator.parameter_names[2:]:
        strength = strengths[parameter] * max(1.0 + scatter[2] * rng.standard_normal(), 0.0)
        parameters[parameter] = strength * typical[parameter]
    decay = simulate_decay(oscillator, parameters, release, n_cycles=120, stop_amplitude=0.03 * release)
    return cycles_of(rng, name, decay.time, decay.amplitude, decay.frequency, decay.damping)


def cycles_of(
    rng: np.random.Generator, name: str, time: np.ndarray, amplitude: np.ndarray, frequency: np.ndarray,
    damping: np.ndarray,
) -> Cycles:  # fmt: skip
    """Return cycles with noise of 60 dB below the first amplitude in their quantities."""
    n = time.size
    noise = 1e-3 * amplitude[0]
    errors = [np.full(n, 0.3 * noise), 0.1 * frequency * noise / amplitude, noise / amplitude, noise / amplitude]
    measured = [
        values + error * rng.standard_normal(n)
        for values, error in zip((amplitude, frequency, damping, np.zeros(n)), errors, strict=True)
    ]
    bands = np.array(errors)[:, None, :] ** 2
    empty = np.zeros(0)
    return Cycles(
        name, time, *measured, *errors, bands, np.zeros((4, n, 0)), np.maximum(measured[0], 0.1 * amplitude),
        np.zeros((n, 0)), np.zeros((0, 0)), empty, empty, empty, empty, empty, noise,
    )  # fmt: skip


def structure(rng: np.random.Generator) -> dict[str, object]:
    """Return a random structure: effects, frequency, damping, amplitude, and strengths of its effects."""
    return {
        "effects": EFFECTS[rng.integers(len(EFFECTS))],
        "frequency": float(np.exp(rng.uniform(np.log(0.5), np.log(200.0)))),
        "damping": float(np.exp(rng.uniform(np.log(0.002), np.log(0.03)))),
        "amplitude": float(10.0 ** rng.uniform(-5.0, 0.0)),
        "strengths": {
            name: OTHERS * rng.uniform(0.1, 1.0) for name in ("cubic_stiffness", "friction_force", "quadratic_damping")
        },
    }


def batch(
    rng: np.random.Generator, count: int, share: float
) -> tuple[dict[str, object], list[Cycles], tuple[float, ...]]:
    """Return a structure, specimens of it, and the scatter between them, ``share`` of the largest."""
    built = structure(rng)
    scatter = (0.03 * share, 0.3 * share, 0.1 * share, 0.5 * share)
    return built, [specimen(rng, f"s{i}", scatter=scatter, **built) for i in range(count)], scatter


def _scaled(item: Cycles, factor: float) -> Cycles:
    return replace(
        item, amplitude=item.amplitude * factor, amplitude_error=item.amplitude_error * factor,
        smoothed_amplitude=item.smoothed_amplitude * factor,
    )  # fmt: skip


KINDS: dict[str, Callable[[np.random.Generator, dict, Cycles, tuple], Cycles]] = {
    "another structure (frequency x 1.4 to 4)": lambda rng, built, item, scatter: specimen(
        rng, item.specimen, scatter=scatter, **{**built, "frequency": built["frequency"] * rng.uniform(1.4, 4.0)}
    ),
    "a neighbour (frequency x 1.1 to 1.3)": lambda rng, built, item, scatter: specimen(
        rng, item.specimen, scatter=scatter, **{**built, "frequency": built["frequency"] * rng.uniform(1.1, 1.3)}
    ),
    "another mode (x 2 to 7, less amplitude)": lambda rng, built, item, scatter: specimen(
        rng, item.specimen, scatter=scatter,
        **{**built, "frequency": built["frequency"] * rng.uniform(2.0, 7.0), "amplitude": 0.3 * built["amplitude"]},
    ),
    "mm for m (x 1000)": lambda rng, built, item, scatter: _scaled(item, 1000.0),
    "m for mm (x 0.001)": lambda rng, built, item, scatter: _scaled(item, 0.001),
    "degrees for radians (x 57.3)": lambda rng, built, item, scatter: _scaled(item, 180.0 / np.pi),
    "damping x 6": lambda rng, built, item, scatter: specimen(
        rng, item.specimen, scatter=scatter,
        **{**built, "damping": 6.0 * built["damping"], "strengths": {k: 6.0 * v if k != "cubic_stiffness" else v
                                                                      for k, v in built["strengths"].items()}},
    ),
}  # fmt: skip
COUNTS = ((2, 2), (3, 4), (5, 8), (9, 20))


def main() -> None:
    """Print a table of false alarms and catches."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--batches", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    alarms = {kind: 0 for kind in ("frequency", "amplitude", "damping")}
    named = 0
    for number in range(chosen.batches):
        _, items, _ = batch(rng, int(rng.integers(2, 21)), 1.0 if number % 2 else float(rng.uniform(0.1, 1.0)))
        found = find_outliers(items)
        named += bool(found)
        for kind in {finding.kind for finding in found}:
            alarms[kind] += 1
    interval = binomtest(named, chosen.batches).proportion_ci(0.95)
    print(
        f"honest batches: {chosen.batches}, an alarm in {named} ({named / chosen.batches:.2%}; 95 % {interval.low:.2%} "
        f"to {interval.high:.2%}): {alarms}",
        flush=True,
    )
    print(
        "| one specimen of | "
        + " | ".join(f"{a} to {b} specimens" if a < b else f"{a} specimens" for a, b in COUNTS)
        + " |"
    )
    print("|---|" + "---|" * len(COUNTS))
    for name, change in KINDS.items():
        cells = []
        for low, high in COUNTS:
            hits = wrong = 0
            trials = chosen.batches // 8
            for _ in range(trials):
                built, items, scatter = batch(rng, int(rng.integers(low, high + 1)), float(rng.uniform(0.1, 1.0)))
                at = int(rng.integers(len(items)))
                items[at] = change(rng, built, items[at], scatter)
                found = find_outliers(items)
                hits += any(items[at].specimen in finding.specimens for finding in found)
                wrong += any(items[at].specimen not in finding.specimens for finding in found)
            cells.append(f"{hits / trials:.0%}" + (f" (another named too: {wrong})" if wrong else ""))
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
