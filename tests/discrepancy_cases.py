"""Small batches of simulated records with a known truth, for the tests of the search for a missing effect.

They are integrated by SciPy, half cycle by half cycle, from force laws that are written here once more: a fault of the
package's simulator would not make the records that the search is to explain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from pymc_backbone.discrepancy.fitting.batch import Batch, batch_of_records
from pymc_backbone.measurement.conditioning.condition import condition
from pymc_backbone.measurement.conditioning.conditioned import ConditionedRecord
from pymc_backbone.measurement.cycles import extract_cycles
from pymc_backbone.measurement.levels import backbones_at_levels, default_levels
from pymc_backbone.measurement.reading.record import Record

MASS, FREQUENCY, AMPLITUDE, RATIO = 1.3, 5.0, 0.01, 0.006
OMEGA = 2.0 * np.pi * FREQUENCY
STIFFNESS, DAMPING = MASS * OMEGA**2, 2.0 * RATIO * MASS * OMEGA
PER_CYCLE, CYCLES = 20, 25
BEFORE = 1.3  # cycles for which the specimen is held before it is released
TIME = np.arange(0, int((CYCLES + BEFORE) * PER_CYCLE)) / (PER_CYCLE * FREQUENCY)
RELEASE_TIME = BEFORE / FREQUENCY
AFTER_FIRST_SWING = RELEASE_TIME + 0.7 / FREQUENCY
"""From here on a record tells less of its law than from the release on: other laws come near."""

STRENGTHS: dict[str, dict[str, float]] = {
    "cubic_stiffness": {"cubic_stiffness": 0.08 * STIFFNESS / AMPLITUDE**2},
    "coulomb_friction": {"friction_force": 0.0012 * STIFFNESS * AMPLITUDE},
    "quadratic_damping": {"quadratic_damping": 0.6 * DAMPING / (OMEGA * AMPLITUDE)},
    "asymmetric_drag": {"asymmetric_drag": 0.6 * DAMPING / (OMEGA * AMPLITUDE), "drag_asymmetry": -0.2},
}

Force = Callable[[float, float, float], float]
"""``force(x, v, direction)`` [N], on the left of the equation of motion; the direction is +1 or -1."""
LAWS: dict[str, Callable[[Mapping[str, float], float, float, float], float]] = {
    "cubic_stiffness": lambda p, x, v, direction: p["cubic_stiffness"] * x**3,
    "coulomb_friction": lambda p, x, v, direction: p["friction_force"] * direction,
    "quadratic_damping": lambda p, x, v, direction: p["quadratic_damping"] * v * v * direction,
    "asymmetric_drag": lambda p, x, v, direction: p["asymmetric_drag"] * v * v * (direction + p["drag_asymmetry"]),
}


def force_of(effects: Sequence[str], values: Mapping[str, float]) -> Force:
    """The force of spring, damper and these effects."""

    def force(x: float, v: float, direction: float) -> float:
        linear = values["linear_stiffness"] * x + values["viscous_damping"] * v
        return linear + sum(LAWS[name](values, x, v, direction) for name in effects)

    return force


def free_decay(force: Force, release: float, instants: Any, mass: float = MASS) -> Any:
    """Displacement at ascending instants after the release (before, it is held), friction and all, by SciPy.

    Each half cycle is a solution of its own, from one instant of rest to the next, so that nothing is discontinuous.
    """
    instants = np.asarray(instants)
    displacement = np.full(instants.size, release)
    done, t, x = int(np.searchsorted(instants, 0.0, side="right")), 0.0, release
    while done < instants.size:
        direction = -1.0 if force(x, 0.0, -1.0) > 0.0 else 1.0
        if direction * force(x, 0.0, direction) >= 0.0:  # friction holds it
            displacement[done:] = x
            break

        def rate(_: float, state: Any, direction: float = direction) -> list[float]:
            return [state[1], -force(state[0], state[1], direction) / mass]

        def rest(_: float, state: Any) -> float:
            return float(state[1])

        rest.terminal, rest.direction = True, -direction  # type: ignore[attr-defined]
        wanted = instants[done:]
        # errors far below the noise of any record here: 1e-8 of the amplitude after thirty cycles
        solved = solve_ivp(
            rate, (t, wanted[-1]), [x, 0.0], "DOP853", wanted, events=rest, rtol=1e-9, atol=1e-12 * abs(release)
        )
        displacement[done : done + solved.t.size] = solved.y[0]
        done += solved.t.size
        if solved.status == 1:
            t, x = float(solved.t_events[0][0]), float(solved.y_events[0][0][0])
    return displacement


def truth_of(effects: Sequence[str], share: float = 1.0) -> dict[str, float]:
    """Parameters of the mean specimen that holds these effects, each at ``share`` of its usual strength."""
    truth = {"linear_stiffness": STIFFNESS, "viscous_damping": DAMPING}
    for name in effects:
        truth |= {key: share * value for key, value in STRENGTHS[name].items()}
    return truth


def make_records(
    rng: np.random.Generator,
    effects: Sequence[str] = (),
    *,
    specimens: int = 2,
    decibels: float = 45.0,
    share: float = 1.0,
    scatter: float = 0.01,
    truth: Mapping[str, float] | None = None,
    unit: str = "m",
    time: Any = TIME,
    offset: float = 0.0,
) -> list[Record]:
    """Records of specimens whose stiffness and damping scatter; the effects are the same in all."""
    records = []
    for r in range(specimens):
        values = dict(truth or truth_of(effects, share))
        values["linear_stiffness"] *= 1.0 + scatter * rng.standard_normal()
        values["viscous_damping"] *= 1.0 + scatter * rng.standard_normal()
        release = AMPLITUDE * (1.0 - 0.25 * r / max(specimens - 1, 1))
        exact = free_decay(force_of(effects, values), release, np.asarray(time) - RELEASE_TIME)
        records.append(noisy(rng, f"specimen {r + 1}", time, exact + offset, decibels, unit))
    return records


def noisy(
    rng: np.random.Generator, name: str, time: Any, exact: Any, decibels: float = 45.0, unit: str = "m"
) -> Record:
    """A record with white noise so many decibels below the release over the square root of two."""
    noise = AMPLITUDE / np.sqrt(2.0) * 10.0 ** (-decibels / 20.0)
    values = np.asarray(exact) + noise * rng.standard_normal(len(time))
    return Record(name, np.asarray(time), values, "displacement", unit, "made in a test", ())


def batch_of(records: Sequence[Record], mass: float = MASS, start: float | None = None) -> Batch:
    """The batch of some records, as the search makes it, or from a start [s] on."""
    return batch_of_conditioned([condition(record, start=start) for record in records], mass)


def batch_of_conditioned(conditioned: Sequence[ConditionedRecord], mass: float = MASS) -> Batch:
    """The batch of some records that are conditioned already."""
    cycles = [extract_cycles(record) for record in conditioned]
    observables = ("frequency", "damping", "offset")
    backbones = backbones_at_levels(cycles, default_levels(cycles), observables, amplitude_unit=conditioned[0].unit)
    return batch_of_records(mass, backbones, conditioned, cycles)


def drifting_records(
    rng: np.random.Generator,
    change: float,
    specimens: int = 2,
    cubic: float = 0.0,
    damping: tuple[float, float] = (1, 0),
    one_side: float = 0.0,
    settling: float = 0.0,
    drag: tuple[float, float] = (0.0, 2.0),
) -> list[Record]:
    """Specimens whose stiffness changes linearly with time by ``change`` over the record, by SciPy.

    ``cubic`` is the force of a cubic spring at `AMPLITUDE`, over that of the linear one; ``damping`` that at release
    over `DAMPING`, and by how much of itself it changes over the record; ``one_side`` how much stiffer it is on the
    positive side; ``drag`` the force of a damper with a power of the speed at the largest speed, over that of the
    spring at `AMPLITUDE`, and its exponent. With ``settling`` the change comes nearer to its end by a factor e so many
    times over the record.
    """
    length = TIME[-1] - RELEASE_TIME
    records = []
    for r in range(specimens):
        release = AMPLITUDE * (1.0 - 0.25 * r)

        def rate(t: float, state: Any) -> list[float]:
            share = t / length
            there = share if not settling else (1.0 - np.exp(-settling * share)) / (1.0 - np.exp(-settling))
            stiffness = STIFFNESS * (1.0 + change * there)
            harder = cubic * STIFFNESS * state[0] * (state[0] / AMPLITUDE) ** 2
            harder += one_side * STIFFNESS * max(state[0], 0.0)
            loss = DAMPING * damping[0] * (1.0 + damping[1] * t / length)
            speed = state[1] / (AMPLITUDE * OMEGA)
            dragged = drag[0] * STIFFNESS * AMPLITUDE * np.sign(speed) * abs(speed) ** drag[1]
            return [state[1], -(stiffness * state[0] + harder + loss * state[1] + dragged) / MASS]

        after = np.maximum(TIME - RELEASE_TIME, 0.0)
        held = np.unique(after)
        solved = solve_ivp(rate, (0.0, held[-1]), [release, 0.0], "DOP853", held, rtol=1e-10, atol=1e-14)
        records.append(noisy(rng, f"specimen {r + 1}", TIME, np.interp(after, held, solved.y[0])))
    return records


def decaying_sinusoid(amplitude: float, frequency: float, ratio: float = RATIO) -> Any:
    """A second mode at the instants `TIME`: exact free decay of a linear oscillator from rest."""
    t = np.maximum(TIME - RELEASE_TIME, 0.0)
    omega = 2.0 * np.pi * frequency
    damped = omega * np.sqrt(1.0 - ratio**2)
    envelope = amplitude * np.exp(-ratio * omega * t)
    return envelope * (np.cos(damped * t) + ratio * omega / damped * np.sin(damped * t))
