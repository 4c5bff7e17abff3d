"""The check of the clock: false alarms over honest records of every effect, and catches of lost and doubled samples.

    python benchmarks/lost_samples.py --records 400

A record is a decay of 20 to 60 cycles from a damped spring with none, one or two effects of the library at 0.1 to 1
times their typical strength, sampled at 10 to 300 samples per cycle as displacement, velocity or acceleration; with
white noise of 1e-4 to 0.03 of the first amplitude; a third of the records is rounded by a converter of 10 to 14 bits, a
third has a second mode of up to 5 %. For the catches one to three samples are lost, or one is doubled, at a random
place in the first half; the table is by the size of the step over the noise of the samples: what the motion covers in
the interval that is missing, over their standard deviation.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pymc_backbone._common.checks import InputError
from pymc_backbone.effects import LIBRARY
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.reading.record import QUANTITIES, Record
from pymc_backbone.oscillator import Oscillator
from pymc_backbone.simulation.decay import simulate_waveform

FREQUENCY = 10.0
BINS = (0.0, 0.3, 1.0, 3.0, 10.0, np.inf)
TRUE = ("are missing without", "is missing without", "too many without", "repeats the one", "repeat the one")


@dataclass(frozen=True)
class Case:
    """One simulated record, its noise, and what it is, in words."""

    record: Record
    noise: float
    words: str


def simulate(rng: np.random.Generator) -> Case:
    """Return one honest record."""
    others = [name for name in LIBRARY if name not in ("linear_stiffness", "viscous_damping")]
    effects = tuple(rng.choice(others, size=int(rng.integers(0, 3)), replace=False).tolist())
    omega = 2.0 * np.pi * FREQUENCY
    oscillator = Oscillator(1.0, list(effects))
    parameters = {"linear_stiffness": omega**2, "viscous_damping": 2.0 * float(rng.uniform(0.001, 0.02)) * omega}
    for effect in oscillator.effects:
        if effect.name in effects and effect.signature is not None:
            typical = effect.signature.typical(1.0, 1.0, omega)
            strength = float(10.0 ** rng.uniform(-1.0, 0.0))
            for number, (parameter, value) in enumerate(zip(effect.parameters, typical, strict=True)):
                parameters[parameter.name] = value * strength if number == 0 else value
    per_cycle = float(10.0 ** rng.uniform(1.0, 2.48))
    time = np.arange(int(rng.uniform(20.0, 60.0) * per_cycle)) / (per_cycle * FREQUENCY)
    quantity = str(rng.choice(QUANTITIES))
    values = simulate_waveform(oscillator, parameters, time, 1.0, quantity=quantity).values
    size = float(np.max(np.abs(values)))
    if rng.random() < 1.0 / 3.0:
        ratio = float(rng.uniform(1.6, 6.0))
        decay = np.exp(-float(rng.uniform(0.002, 0.02)) * ratio * omega * time)
        values = values + size * float(rng.uniform(0.0, 0.05)) * decay * np.cos(
            ratio * omega * time + rng.uniform(0, 6)
        )
    noise = size * float(10.0 ** rng.uniform(-4.0, -1.5))
    values = values + noise * rng.standard_normal(values.size)
    if rng.random() < 1.0 / 3.0:
        step = size / 2.0 ** int(rng.integers(9, 14))
        values = step * np.round(values / step)
        noise = float(np.hypot(noise, step / np.sqrt(12.0)))
    words = f"{'+'.join(effects) or 'linear'}, {quantity}, {per_cycle:.0f} per cycle, noise {noise / size:.1e}"
    return Case(Record("simulated", time, values, quantity), noise, words)


def damaged(rng: np.random.Generator, case: Case) -> tuple[Record, float, int]:
    """Return the record with a jump in it, the step over the noise, and the number of samples lost."""
    values = case.record.values
    lost = int(rng.choice([1, 1, 2, 3, -1]))
    per_cycle = 1.0 / (FREQUENCY * float(case.record.time[1]))
    at = int(rng.uniform(min(5.0 * per_cycle, 0.3 * values.size), 0.5 * values.size))
    local = values[max(at - int(per_cycle), 0) : at + int(per_cycle)]
    step = float(np.sqrt(2.0) * np.std(local) * 2.0 * np.pi / per_cycle * abs(lost))
    values = np.delete(values, np.arange(at, at + lost)) if lost > 0 else np.insert(values, at, values[at - 1])
    time = np.arange(values.size) * float(case.record.time[1])
    return Record("simulated", time, values, case.record.quantity), step / case.noise, lost


def alarms(record: Record) -> list[str] | None:
    """Return the notes of the check of the clock, or None where the record cannot be used for another reason."""
    try:
        notes = condition(record).notes
    except InputError:
        return None
    return [note for note in notes if any(word in note for word in TRUE)]


def main() -> None:
    """Print false alarms and catches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--honest", action="store_true", help="false alarms only")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    used = false = 0
    caught = np.zeros((len(BINS) - 1, 3), dtype=int)
    for _ in range(given.records):
        case = simulate(rng)
        said = alarms(case.record)
        if said is None:
            continue
        used += 1
        if said:
            false += 1
            print(f"false alarm: {case.words}: {said}", flush=True)
        if given.honest:
            continue
        record, size, lost = damaged(rng, case)
        said = alarms(record)
        if said is None:
            continue
        row = int(np.searchsorted(BINS, size, side="right")) - 1
        count = f"{abs(lost)} sample"
        is_right = len(said) == 1 and (count in said[0] if lost > 0 else "too many" in said[0] or "repeat" in said[0])
        caught[row] += (1, bool(said), is_right)
    print(f"\n{used} honest records, {false} false alarms\n")
    print("| step over noise | records | noticed | with the right number |\n|---|---|---|---|")
    for row, (low, high) in enumerate(pairwise(BINS)):
        print(f"| {low:g} to {high:g} | {caught[row, 0]} | {caught[row, 1]} | {caught[row, 2]} |")


if __name__ == "__main__":
    main()
