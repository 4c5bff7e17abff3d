"""One batch: a population of specimens released from rest and measured with noise, and the truth about it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from contamination import distorted, jittered, limited
from motion import simulate
from new_strengths import draw_new
from recording import QUANTITIES, Batch, draw_release_time, measure, respond
from strengths import STIFFNESS_KINDS, draw_parameters, draw_strength, is_scattered, log_uniform
from systems import LIBRARY_NAMES_OF_OUTSIDE, NEW, pack
from tiers import Plan, draw_amplitude, draw_plan, draw_tier

LARGEST_RECORD = 12000
"""Samples."""
ATTEMPTS = 200


class RedrawError(Exception):
    """What was drawn makes no usable records."""


def make_batch(seed: int, index: int, tier: str | None = None) -> Batch:
    """Generate one batch; it depends on ``seed``, ``index`` and ``tier`` only.

    Parameters
    ----------
    seed, index : int
        Not negative.
    tier : str, optional
        A key of `tiers.TIERS`, drawn by their shares where not given, or one of `tiers.HARD_TIERS`.

    Returns
    -------
    Batch

    Raises
    ------
    RuntimeError
        If no attempt gave usable records.
    """
    rng = np.random.default_rng([seed, index])
    chosen = draw_tier(rng)
    tier = chosen if tier is None else tier
    for attempt in range(ATTEMPTS):
        # After a dozen failures the plan itself may be at fault, for example three effects that stop the motion.
        if attempt % 12 == 0:
            plan = draw_plan(tier, rng, index)
        try:
            batch = record_system(plan, _draw_system(plan, rng), rng)
        except (RedrawError, FloatingPointError):
            continue
        batch.truth = {"index": index, "seed": seed, "tier": tier, **batch.truth}
        return batch
    raise RuntimeError(f"no usable records of tier {tier} with seed {seed} and index {index}.")


class System(NamedTuple):
    """An oscillator before specimens are drawn: parameters, strengths of effects, largest release amplitude [m]."""

    nominal: dict[str, float]
    strength: dict[str, float]
    amplitude: float


def _draw_system(plan: Plan, rng: np.random.Generator) -> System:
    mass = log_uniform(rng, 0.01, 1000.0)
    frequency = log_uniform(rng, 0.2, 200.0)
    amplitude = draw_amplitude(plan, rng)
    omega = 2.0 * math.pi * frequency
    stiffness = mass * omega**2
    damping = 2.0 * log_uniform(rng, *plan.damping_ratio) * mass * omega
    nominal = {"mass": mass, "linear_stiffness": stiffness, "viscous_damping": damping}
    strength: dict[str, float] = {}
    for effect in (*plan.present, *((plan.outside,) if plan.outside else ())):
        wanted = draw_strength(effect, rng, visible=plan.visible or effect in plan.base, strong=plan.strong)
        if plan.contaminations and effect == plan.outside:
            wanted = _share(plan, strength, rng) / (1.0 if effect in STIFFNESS_KINDS else 2.0)
        system = {"mass": mass, "stiffness": stiffness, "amplitude": amplitude}
        if effect in NEW and effect != plan.outside:
            parameters, strength[effect] = draw_new(effect, wanted, rng, **system)
        else:
            parameters, strength[effect] = draw_parameters(
                effect, wanted, rng, **system, damping=damping, narrow=plan.narrow, strong=plan.strong
            )
        nominal |= parameters
    return System(nominal, strength, amplitude)


def record_system(plan: Plan, system: System, rng: np.random.Generator) -> Batch:
    """Draw specimens of a system and record their decays, as good as the plan says.

    Raises
    ------
    RedrawError
        If the motion stops too early or sinks into the noise.
    FloatingPointError
        If it cannot be integrated.
    """
    nominal, strength, amplitude = dict(system.nominal), system.strength, system.amplitude
    mass, stiffness = nominal["mass"], nominal["linear_stiffness"]
    noise_db = rng.uniform(*plan.noise_db)
    bits = int(rng.integers(plan.bits[0], plan.bits[1] + 1))
    factor = 1.0 if plan.release_factor[0] == 1.0 and rng.random() < 0.3 else rng.uniform(*plan.release_factor)
    count = int(rng.choice(plan.specimens))
    releases = _draw_releases(amplitude, factor, count, rng)
    cycles, actual_frequency = _usable_cycles(plan, nominal, releases, noise_db, rng)
    per_cycle = log_uniform(rng, *plan.samples_per_cycle)
    per_cycle = max(8.0, min(per_cycle, 0.95 * LARGEST_RECORD / (cycles + 3.0)))
    duration = cycles / actual_frequency
    drift = _draw_drift(plan, nominal, duration, rng)
    second = _draw_second_mode(plan, actual_frequency, rng)
    sizes = _contaminations(plan, strength, rng)
    if "temperature" in sizes:
        nominal["linear_stiffness_rate"] = sizes["temperature"] * stiffness / duration
    if "second_mode" in sizes:
        second = {
            "frequency": float(rng.uniform(1.9, 3.1) * actual_frequency),
            "share": sizes["second_mode"],
            "damping_ratio": log_uniform(rng, 0.003, 0.03),
        }
    offset_share = 0.0 if rng.random() < 0.5 else rng.uniform(-0.2, 0.2)
    start = str(rng.choice(("hold", "release", "fast")))
    scatter = _draw_scatter(rng)
    if plan.effect_scatter is not None:
        scatter["effects"] = plan.effect_scatter

    records, specimens = [], []
    for number, release in enumerate(releases, start=1):
        parameters = _draw_specimen(nominal, scatter, rng)
        sampling = per_cycle * actual_frequency
        held = draw_release_time(start, actual_frequency, sampling, rng)
        time = np.arange(int((duration + held) * sampling) + 1) / sampling
        taken = jittered(time, sizes["jitter"], actual_frequency, rng) if "jitter" in sizes else time
        exact, decay = respond(parameters, release, taken - held, second, plan.quantity)
        if decay.stuck and decay.turn_values.size < 8:
            raise RedrawError
        scale = (2.0 * math.pi * actual_frequency) ** QUANTITIES.index(plan.quantity)
        offset = offset_share * amplitude * scale
        if sizes:
            exact = distorted(exact, sizes, scale * release, per_cycle)
        records.append(measure(time, exact, offset, noise_db, bits, release, scale, held, rng))
        specimens.append({"specimen": f"specimen_{number}", **parameters})
    truth = {
        "mass": mass,
        "base": sorted(plan.base),
        "hidden": sorted(plan.hidden),
        "present": sorted(plan.present),
        "outside": None if plan.contaminations else plan.outside,
        **_library_names(plan),
        "drift": drift,
        "second_mode": None if plan.contaminations else second,
        "contaminations": {**sizes, **({plan.outside: strength[plan.outside]} if "outside" in sizes else {})},
        "quantity": plan.quantity,
        "band": _band(actual_frequency, second) if plan.is_banded else None,
        "strength": strength,
        "nominal": nominal,
        "parameters": specimens,
        "scatter": scatter,
        "damping_ratio": nominal["viscous_damping"] / (2.0 * math.sqrt(mass * stiffness)),
        "noise_db": noise_db,
        "bits": bits,
        "cycles": cycles,
        "samples_per_cycle": per_cycle,
        "frequency": math.sqrt(stiffness / mass) / (2.0 * math.pi),
        "actual_frequency": actual_frequency,
        "amplitude": amplitude,
        "release_amplitudes": releases,
        "offset": offset,
        "start": start,
    }
    return Batch(records, truth)


def _library_names(plan: Plan) -> dict[str, Any]:
    """Return what is hidden in the package's names, and whether something acts that has none there."""
    names, is_outside = set(plan.hidden), bool(plan.drift or plan.second_mode)
    if plan.outside and not plan.contaminations:
        name = LIBRARY_NAMES_OF_OUTSIDE.get(plan.outside)
        names |= {name} if name else set()
        is_outside = is_outside or name is None
    return {"hidden_in_library": sorted(names), "is_outside": is_outside}


def _draw_releases(amplitude: float, factor: float, count: int, rng: np.random.Generator) -> list[float]:
    """Return release amplitudes between ``amplitude / factor`` and ``amplitude``, the largest among them."""
    releases = amplitude * factor ** -rng.uniform(0.0, 1.0, count)
    releases[int(rng.integers(count))] = amplitude
    return [float(value) for value in releases]


def _usable_cycles(
    plan: Plan, nominal: dict[str, float], releases: list[float], noise_db: float, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the number of cycles to record and their mean frequency [Hz].

    The record ends at the number drawn, or where the decay has sunk into the noise and a quiet tail has passed.
    """
    omega = math.sqrt(nominal["linear_stiffness"] / nominal["mass"])
    wanted = log_uniform(rng, *plan.cycles)
    tail = rng.uniform(1.0, 1.4)
    fewest = max(10.0 if rng.random() < 0.9 else 6.0, plan.fewest_cycles)
    lengths, frequency = [], 0.0
    for release in (max(releases), min(releases)):
        decay = simulate(pack(nominal), release, np.array([2.0 * math.pi * wanted / omega]))
        floor = 1.5 * release / math.sqrt(2.0) * 10.0 ** (-noise_db / 20.0)
        loud = int(np.count_nonzero(np.abs(decay.turn_values) > floor))
        turns = min(loud, decay.turn_times.size)
        if turns < 2.0 * fewest + 1.0:
            raise RedrawError
        if frequency == 0.0:
            last = turns - 1 - (turns - 1) % 2
            frequency = 0.5 * last / decay.turn_times[last]
        reached = 0.5 * (turns - 1)
        lengths.append(min(wanted, tail * reached) if turns < decay.turn_times.size or decay.stuck else wanted)
    return sum(lengths) / 2.0, float(frequency)


def _share(plan: Plan, strength: dict[str, float], rng: np.random.Generator) -> float:
    """Return 3 to 30 % of what the hidden effect does, in units of the elastic force."""
    gap = sum(
        value * (1.0 if name in STIFFNESS_KINDS else 2.0) for name, value in strength.items() if name in plan.present
    )
    return log_uniform(rng, 0.03, 0.3) * gap


def _contaminations(plan: Plan, strength: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Draw the size of each contamination; of the causal filter its cut-off over the frequency."""
    sizes: dict[str, float] = {}
    for kind in plan.contaminations:
        size = _share(plan, strength, rng)
        if kind == "filter":
            sizes[kind] = float(rng.uniform(2.5, 6.0))
        elif kind in ("outside", "temperature"):
            sizes[kind] = float(size * rng.choice((-1.0, 1.0))) if kind == "temperature" else size
        else:
            sizes[kind] = limited(kind, size)
    return sizes


def _draw_drift(
    plan: Plan, nominal: dict[str, float], duration: float, rng: np.random.Generator
) -> dict[str, float | str] | None:
    """Let stiffness or damping change linearly in time by a share over the record."""
    if plan.drift is None:
        return None
    share = log_uniform(rng, 0.003, 0.05) if plan.drift == "stiffness" else log_uniform(rng, 0.1, 0.5)
    share *= 1.0 if rng.random() < 0.5 else -1.0
    name = "linear_stiffness" if plan.drift == "stiffness" else "viscous_damping"
    nominal[f"{name}_rate"] = share * nominal[name] / duration
    return {"quantity": plan.drift, "share": share}


def _draw_second_mode(plan: Plan, frequency: float, rng: np.random.Generator) -> dict[str, float] | None:
    """Draw a second, linear mode that is released together with the first."""
    if plan.is_banded:
        # drawn from numbers of its own, so that the first mode moves as it does without the second
        own = np.random.default_rng(int(1e6 * frequency))
        return {
            "frequency": float(own.uniform(2.6, 3.4) * frequency),
            "share": log_uniform(own, 0.05, 0.2),
            "damping_ratio": log_uniform(own, 0.003, 0.03),
        }
    if not plan.second_mode:
        return None
    if rng.random() < 0.5:
        ratio = rng.uniform(0.8, 0.96) if rng.random() < 0.5 else rng.uniform(1.04, 1.3)
    else:
        ratio = rng.uniform(1.9, 3.1)
    return {
        "frequency": float(ratio * frequency),
        "share": log_uniform(rng, 0.03, 0.2),
        "damping_ratio": log_uniform(rng, 0.001, 0.03),
    }


def _band(frequency: float, second: dict[str, float] | None) -> list[float]:
    """Return a band [Hz] around the first mode that keeps the second out."""
    high = 1.4 * frequency if second is None else min(1.4 * frequency, math.sqrt(frequency * second["frequency"]))
    return [0.65 * frequency, high]


def _draw_scatter(rng: np.random.Generator) -> dict[str, float]:
    """Draw the relative standard deviations between specimens."""
    if rng.random() < 0.1:
        return {"stiffness": 0.0, "damping": 0.0, "effects": 0.0}
    return {
        "stiffness": float(rng.uniform(0.0, 0.03)),
        "damping": float(rng.uniform(0.0, 0.10)),
        "effects": float(rng.uniform(0.0, 0.05)),
    }


def _draw_specimen(nominal: dict[str, float], scatter: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Return the parameters of one specimen; the mass is that of all."""
    drawn = {}
    for name, value in nominal.items():
        if name.startswith("linear_stiffness"):
            kind = "stiffness"
        elif name.startswith("viscous_damping"):
            kind = "damping"
        else:
            kind = "effects"
        free = name != "mass" and is_scattered(name)
        drawn[name] = float(value * (1.0 + scatter[kind] * rng.standard_normal())) if free else float(value)
    return drawn
