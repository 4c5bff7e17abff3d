"""The second generator: other ranges, other priors over effects, other noise, another integrator.

Whatever was tuned on batches of the first generator can be tried on these. Shared are the words: what a strength means
(`strengths.py`, `new_strengths.py`), the names of parameters, and the files that are written.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from new_strengths import draw_new
from recording import QUANTITIES, Batch, Record
from second_laws import TERMS
from second_motion import decay
from strengths import STIFFNESS_KINDS, draw_parameters, is_scattered, log_uniform
from systems import LIBRARY, LIBRARY_NAMES_OF_OUTSIDE, NEW, OUTSIDE

TIER = "second"
RATES = (50, 100, 128, 200, 256, 400, 500, 512, 1000, 1024, 2048, 2560, 4096, 5000, 5120, 10000, 12800, 25600, 51200)
"""Sampling rates of data acquisition systems [Hz]."""
COUNTS = (0.25, 0.5, 0.2, 0.05)
"""Shares of batches with so many effects that act."""
_ONLY_IF_NAMED = ("dahl_friction", "maxwell_element", "structural_damping")
WEIGHTS: dict[str, float] = {
    **dict.fromkeys(LIBRARY, 1.0),
    **{name: 0.15 if name in _ONLY_IF_NAMED else 0.5 for name in NEW},
}
"""How often an effect acts, relative to others."""
_OUTSIDE = tuple(name for name in OUTSIDE if name not in LIBRARY_NAMES_OF_OUTSIDE and name in TERMS)
_OUTSIDE_SHARE = 0.08
_MOST_SAMPLES = 12000
_ATTEMPTS = 100


class _RedrawError(Exception):
    """What was drawn makes no usable records."""


def _log_normal(rng: np.random.Generator, median: float, spread: float, low: float, high: float) -> float:
    """Draw from a log-normal distribution, held between two limits."""
    return float(min(max(median * math.exp(spread * rng.standard_normal()), low), high))


def coloured(rng: np.random.Generator, size: int, power: float) -> np.ndarray:
    """Return noise of unit standard deviation whose power falls with the frequency to ``power``.

    Made over twice the length and cut, so that its ends do not meet.
    """
    spectrum = rng.standard_normal(size + 1) + 1j * rng.standard_normal(size + 1)
    spectrum[0] = 0.0
    spectrum[1:] *= np.arange(1, size + 1) ** (-0.5 * power)
    values = np.fft.irfft(spectrum, 2 * size)[:size]
    values -= values.mean()
    return values / values.std()


def make_second_batch(seed: int, index: int) -> Batch:
    """Generate one batch; it depends on ``seed`` and ``index`` only.

    Parameters
    ----------
    seed, index : int
        Not negative.

    Returns
    -------
    Batch

    Raises
    ------
    RuntimeError
        If no attempt gave usable records.
    """
    rng = np.random.default_rng([seed, index, 2])
    for _ in range(_ATTEMPTS):
        try:
            batch = _draw_batch(rng)
        except (_RedrawError, FloatingPointError):
            continue
        batch.truth = {"index": index, "seed": seed, "tier": TIER, **batch.truth}
        return batch
    raise RuntimeError(f"no usable records with seed {seed} and index {index}.")


def _draw_effects(rng: np.random.Generator) -> tuple[tuple[str, ...], tuple[str, ...], str | None]:
    """Return what acts by the package's names, what of it the base holds, and a law from outside."""
    if rng.random() < _OUTSIDE_SHARE:
        return (), (), str(rng.choice(_OUTSIDE))
    chance = np.array(list(WEIGHTS.values()))
    count = int(rng.choice(len(COUNTS), p=COUNTS))
    present = tuple(map(str, rng.choice(list(WEIGHTS), count, replace=False, p=chance / chance.sum())))
    return present, present[:1] if present and rng.random() < 0.15 else (), None


def _draw_nominal(
    rng: np.random.Generator, effects: tuple[str, ...]
) -> tuple[dict[str, float], dict[str, float], float]:
    """Return parameters, strengths and the largest release amplitude."""
    mass, frequency = log_uniform(rng, 0.05, 200.0), _log_normal(rng, 12.0, 1.2, 0.5, 300.0)
    amplitude = rng.uniform(0.1, 1.0) if "pendulum_stiffness" in effects else log_uniform(rng, 1e-5, 0.05)
    stiffness = mass * (2.0 * math.pi * frequency) ** 2
    damping = 2.0 * _log_normal(rng, 0.006, 0.7, 8e-4, 0.04) * math.sqrt(mass * stiffness)
    nominal = {"mass": mass, "linear_stiffness": stiffness, "viscous_damping": damping}
    strength: dict[str, float] = {}
    for effect in effects:
        is_spring = effect in STIFFNESS_KINDS
        wanted = _log_normal(rng, 0.06, 1.1, 3e-4, 0.7) if is_spring else _log_normal(rng, 0.004, 0.9, 3e-5, 0.05)
        if "friction" in effect:
            wanted = min(wanted, 0.009)
        system = {"mass": mass, "stiffness": stiffness, "amplitude": amplitude}
        if effect in NEW:
            parameters, strength[effect] = draw_new(effect, wanted, rng, **system)
        else:
            parameters, strength[effect] = draw_parameters(effect, wanted, rng, damping=damping, **system)
        nominal |= parameters
    return nominal, strength, amplitude


def _draw_specimen(nominal: dict[str, float], scatter: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Return one specimen: stiffness log-normal, damping uniform, effects log-normal about the nominal ones."""
    drawn = {}
    for name, value in nominal.items():
        factor = 1.0
        if name == "linear_stiffness":
            factor = math.exp(scatter["stiffness"] * rng.standard_normal())
        elif name == "viscous_damping":
            factor = 1.0 + math.sqrt(3.0) * scatter["damping"] * rng.uniform(-1.0, 1.0)
        elif name != "mass" and is_scattered(name):
            factor = math.exp(scatter["effects"] * rng.standard_normal())
        drawn[name] = value * factor
    if "play_asymmetry" in drawn:
        drawn["play_asymmetry"] = min(max(drawn["play_asymmetry"], -0.95), 0.95)
    return drawn


def _draw_noise(rng: np.random.Generator) -> dict[str, float]:
    """Draw how loud the noise is and what share of its power is coloured, and how far the sensor drifts."""
    return {
        "db": float(rng.triangular(30.0, 50.0, 65.0)),
        "power": float(rng.choice((1.0, 1.0, 0.5, 1.5))),
        "coloured_share": 0.0 if rng.random() < 0.4 else float(rng.uniform(0.1, 0.7)),
        "sensor_drift": 0.0 if rng.random() < 0.5 else log_uniform(rng, 1e-4, 2e-3),
    }


def _draw_batch(rng: np.random.Generator) -> Batch:
    present, base, outside = _draw_effects(rng)
    effects = (*present, *((outside,) if outside else ()))
    nominal, strength, amplitude = _draw_nominal(rng, effects)
    omega = math.sqrt(nominal["linear_stiffness"] / nominal["mass"])
    noise = _draw_noise(rng)
    # Until a share of the release is left, or the noise, or for as long as somebody waits.
    least = max(float(rng.uniform(0.03, 0.4)), 10.0 ** (-noise["db"] / 20.0))
    wait = rng.uniform(15.0, 150.0) * 2.0 * math.pi / omega
    trial = decay(nominal, effects, amplitude, np.array([wait]), until=least)
    cycles = 0.5 * (trial.turn_times.size - 1)
    if cycles < 8.0 or trial.stuck:
        raise _RedrawError
    duration = float(trial.turn_times[-1])
    actual = cycles / duration
    fitting = [rate for rate in RATES if 10.0 <= rate / actual <= 160.0 and rate * duration <= 0.9 * _MOST_SAMPLES]
    if not fitting:
        raise _RedrawError
    rate = int(rng.choice(fitting))
    count = int(rng.integers(2, 9))
    releases = [float(value) for value in amplitude * rng.uniform(0.4, 1.0, count)]
    releases[0] = amplitude
    scatter = {
        "stiffness": float(rng.uniform(0.002, 0.04)),
        "damping": float(rng.uniform(0.02, 0.14)),
        "effects": float(rng.uniform(0.0, 0.10)),
    }
    quantity = str(rng.choice(QUANTITIES, p=(0.7, 0.1, 0.2)))
    bits = int(rng.choice((12, 16, 24)))
    order = QUANTITIES.index(quantity)
    scale = (2.0 * math.pi * actual) ** order
    offset = 0.03 * amplitude * scale * float(rng.standard_normal())
    is_held = rng.random() < 0.7
    records, specimens = [], []
    for number, release in enumerate(releases, start=1):
        parameters = _draw_specimen(nominal, scatter, rng)
        held = rng.uniform(0.3, 5.0) / actual if is_held else 0.0
        time = np.arange(int((duration + held) * rate) + 1) / rate
        motion = decay(parameters, effects, release, time - held)
        if motion.turn_values.size < 12 or np.isnan(motion.values).any():
            raise _RedrawError
        exact = motion.values[order]
        records.append(_measure(time, exact, offset, noise, bits, release, scale, held, rng))
        specimens.append({"specimen": f"specimen_{number}", **parameters})
    name = LIBRARY_NAMES_OF_OUTSIDE.get(outside or "")
    truth: dict[str, Any] = {
        "mass": nominal["mass"],
        "base": sorted(base),
        "hidden": sorted(set(present) - set(base)),
        "present": sorted(present),
        "outside": outside,
        "hidden_in_library": sorted((set(present) | ({name} if name else set())) - set(base)),
        "is_outside": bool(outside) and name is None,
        "drift": None,
        "second_mode": None,
        "contaminations": {},
        "quantity": quantity,
        "band": None,
        "strength": strength,
        "nominal": nominal,
        "parameters": specimens,
        "scatter": scatter,
        "noise": noise,
        "damping_ratio": nominal["viscous_damping"] / (2.0 * nominal["mass"] * omega),
        "noise_db": noise["db"],
        "bits": bits,
        "cycles": cycles,
        "samples_per_cycle": rate / actual,
        "frequency": omega / (2.0 * math.pi),
        "actual_frequency": actual,
        "amplitude": amplitude,
        "release_amplitudes": releases,
        "offset": offset,
        "start": "hold" if is_held else "release",
    }
    return Batch(records, truth)


def _measure(
    time: np.ndarray,
    exact: np.ndarray,
    offset: float,
    noise: dict[str, float],
    bits: int,
    release: float,
    scale: float,
    held: float,
    rng: np.random.Generator,
) -> Record:
    """Add offset, white and coloured noise and a random walk of the sensor, and round to the converter's steps."""
    level = scale * release / math.sqrt(2.0) * 10.0 ** (-noise["db"] / 20.0)
    white, colour = math.sqrt(1.0 - noise["coloured_share"]), math.sqrt(noise["coloured_share"])
    added = level * (white * rng.standard_normal(time.size) + colour * coloured(rng, time.size, noise["power"]))
    walk = noise["sensor_drift"] * scale * release * coloured(rng, time.size, 2.0)
    step = 2.5 * scale * release / 2.0**bits
    measured = step * np.round((exact + offset + added + walk) / step)
    total = math.hypot(level, step / math.sqrt(12.0))
    return Record(time, measured, exact, offset, total, release, held)
