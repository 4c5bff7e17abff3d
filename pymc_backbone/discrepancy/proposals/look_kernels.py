"""Compiled: one cycle of any oscillator along a nearly sinusoidal motion.

A *look* is what averaging over a cycle of given amplitude makes of all forces: equivalent stiffness and damping, the
force at the turning points, and the mid-line.
"""

from __future__ import annotations

import math

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ..._common.compiled import ahead, cached
from ...simulation.curves import compiled
from ...simulation.forces import (
    KIND,
    MEMORY,
    OWN_EQUATION,
    ROW,
    Z_FIRST,
    Z_LAST,
    Model,
    added_mass,
    remembered_slopes,
    state_rates,
    sum_of_forces,
)
from ...simulation.memory import MASS, N_EFFECTS, N_STATES, TABLE, model_of, place_of
from ...simulation.pointers import Floats, address, shifted
from ...simulation.run import prepare

STIFFNESS, DAMPING, AT_TURN, MIDDLE, N_LOOK = range(5)
_STIFF_STEP = 0.5  # of a state's own time constant; beyond, a step is divided
_MOST_PARTS = 4
_LARGEST_SHARE = 0.6  # of the amplitude that the mid-line may take


@compiled
def _advance(
    model: Model, own: IntArray, amplitude: float, omega: float, angle: float, step: float, a2: float, offset: float,
    z: Floats, room: FloatArray, largest: FloatArray,
) -> None:  # fmt: skip
    """Move the states over ``step`` radians of the motion by exponential Euler steps: exact where rates are linear.

    However fast a state saturates, such a step comes to rest where the state would; of several states each is taken to
    be held back by itself only.
    """
    n = model.n_states
    rates = address(room)
    middle = angle + 0.5 * step
    side = -1.0 if middle % (2.0 * math.pi) < math.pi else 1.0
    parts, part = 1, 0
    while part < parts:
        h = step / parts
        at = angle + (part + 0.5) * h
        cosine, sine = math.cos(at), math.sin(at)
        x = offset + amplitude * cosine + a2 * (2.0 * cosine * cosine - 1.0)
        v = -omega * (amplitude * sine + 4.0 * a2 * sine * cosine)
        state_rates(model, x, v, side, z, rates)
        stiffest = 0.0
        for j in range(n):
            if own[j] == 0:
                continue
            largest[j] = max(largest[j], abs(z[j]))
            width = 1e-5 * (largest[j] if largest[j] > 0.0 else amplitude)
            kept = z[j]
            z[j] = kept + width
            state_rates(model, x, v, side, z, shifted(rates, n))
            z[j] = kept
            room[2 * n + j] = (room[n + j] - room[j]) / width
            stiffest = max(stiffest, abs(room[2 * n + j]))
        if part == 0 and parts == 1 and stiffest * step / omega > _STIFF_STEP:
            parts = 2 if stiffest * step / omega < 2.0 * _STIFF_STEP else _MOST_PARTS
            continue
        for j in range(n):
            if own[j] == 1:
                power = min(room[2 * n + j] * h / omega, 5.0)
                growth = 1.0 + 0.5 * power if abs(power) < 1e-6 else math.expm1(power) / power
                z[j] += h / omega * room[j] * growth
        part += 1


@compiled
def _turn(model: Model, x: float, side: float, z: Floats) -> None:
    """Let effects with memory take over a turning point."""
    for i in range(model.n_effects):
        row = shifted(model.table, ROW * i)
        if row[KIND] == MEMORY:
            kept = remembered_slopes(model, i, x, side, z)
            first = row[Z_FIRST]
            z[first] = x
            z[first + 1] = kept
            z[first + 2] = 1.0


@ahead("i1 f1 f1 f1 f1 i i f2")
@cached
def averaged(
    integers: IntArray, numbers: FloatArray, p: FloatArray, levels: FloatArray, omegas: FloatArray,
    rounds: int, points: int, out: FloatArray,
) -> None:  # fmt: skip
    """Write stiffness, damping, force at the turn over amplitude and mid-line over amplitude (l, 4) at each level.

    The parameters hold effects alone, and a linear spring makes up what they lack to the stiffness ``mass * omega**2``
    of the motion. Its harmonics 0 and 2 follow from those of the force in ``rounds``.
    """
    run = prepare(integers, numbers, p, False, 1.0)
    n_states, mass = integers[N_STATES], numbers[MASS]
    described, memory = address(run.integers), address(run.memory)
    place = place_of(described)
    model = model_of(described, memory, address(run.p), place)
    own = np.zeros(n_states, np.int64)
    is_moving, remembers = False, False
    for i in range(integers[N_EFFECTS]):
        row = TABLE + ROW * i
        if integers[row + KIND] == OWN_EQUATION:
            is_moving = True
            own[integers[row + Z_FIRST] : integers[row + Z_LAST]] = 1
        remembers = remembers or integers[row + KIND] == MEMORY
    room = np.zeros(3 * n_states + 1)
    largest = np.zeros(n_states)
    z = shifted(address(run.y), 2)
    step = 2.0 * math.pi / points
    cosines, sines = np.empty(points), np.empty(points)  # once: they took as long as the forces
    for i in range(points):
        cosines[i], sines[i] = math.cos((i + 0.5) * step), math.sin((i + 0.5) * step)
    cycles = 2 if n_states > 0 else 1
    for level in range(levels.size):
        amplitude, omega = levels[level], omegas[level]
        whole = mass * omega * omega
        offset, a2 = 0.0, 0.0
        for turn in range(rounds):
            top = offset + amplitude + a2
            bottom = offset - amplitude + a2
            if n_states > 0:
                run.y[:] = 0.0
                largest[:] = 0.0
            if is_moving:  # loaded from rest: the quarter of a cycle before the top
                for i in range(-points // 4, 0):
                    _advance(model, own, amplitude, omega, i * step, step, a2, offset, z, room, largest)
            f0, f1, f2, work, at_turn = 0.0, 0.0, 0.0, 0.0, 0.0
            for _ in range(cycles):
                f0, f1, f2, work = 0.0, 0.0, 0.0, 0.0
                at_turn = 0.5 * (sum_of_forces(model, top, 0.0, 1.0, z) + sum_of_forces(model, top, 0.0, -1.0, z))
                if remembers:
                    at_turn = sum_of_forces(model, top, 0.0, 1.0, z)
                    _turn(model, top, 1.0, z)
                for i in range(points):
                    if 2 * i == points:
                        if remembers:
                            at_turn -= sum_of_forces(model, bottom, 0.0, -1.0, z)
                            _turn(model, bottom, -1.0, z)
                        else:
                            at_turn -= 0.5 * (
                                sum_of_forces(model, bottom, 0.0, 1.0, z) + sum_of_forces(model, bottom, 0.0, -1.0, z)
                            )
                    angle = (i + 0.5) * step
                    if is_moving:
                        _advance(model, own, amplitude, omega, i * step, 0.5 * step, a2, offset, z, room, largest)
                    cosine, sine = cosines[i], sines[i]
                    double = 2.0 * cosine * cosine - 1.0
                    x = offset + amplitude * cosine + a2 * double
                    pace = -(amplitude * sine + 4.0 * a2 * sine * cosine)
                    side = -1.0 if 2 * i < points else 1.0
                    turning = omega * omega * (amplitude * cosine + 4.0 * a2 * double)  # minus the acceleration
                    force = sum_of_forces(model, x, omega * pace, side, z) - turning * added_mass(model, x)
                    f0 += force
                    f1 += force * cosine
                    f2 += force * double
                    work += force * pace
                    if is_moving:
                        _advance(model, own, amplitude, omega, angle, 0.5 * step, a2, offset, z, room, largest)
            f0, f1, f2 = f0 / points, 2.0 * f1 / points, 2.0 * f2 / points
            out[level, STIFFNESS] = f1 / amplitude
            out[level, DAMPING] = 2.0 * work / points / (omega * amplitude * amplitude)
            out[level, AT_TURN] = 0.5 * at_turn / amplitude
            out[level, MIDDLE] = (offset + a2) / amplitude
            if turn == rounds - 1 or not math.isfinite(f0 + f1 + f2):
                break
            lacking = whole - f1 / amplitude
            limit = _LARGEST_SHARE * amplitude
            offset = min(max(offset - (f0 + lacking * offset) / whole, -limit), limit)
            a2 += (f2 + (lacking - 4.0 * whole) * a2) / (3.0 * whole)
            a2 = min(max(a2, -0.2 * amplitude), 0.2 * amplitude)
