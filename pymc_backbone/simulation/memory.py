"""The one layout of what a simulation is described by, and of the memory of a run. Arguments but numbers are pointers.

Who simulates writes a `Description` once: integers and numbers. Everything compiled reads these two, here and behind
the native functions; a run takes a copy of the integers and notes in it how it stands.
"""

from __future__ import annotations

from typing import NamedTuple

from .._common.checks import FloatArray, IntArray
from .forces import Model, scratch_size
from .pointers import Floats, Integers, shifted
from .stepper import STAGES
from .switches import plain

VALUE, SENSITIVITY, OWN_STATES = range(3)  # which stepper; with OWN_STATES as many columns as wanted, or none

# The integers: of the oscillator ...
USER, N_EFFECTS, STIFFNESS, DAMPING, N_STATES, N_PARAMETERS, HAS_REGIME, N_ROOM = range(8)
# ... what is asked: one cycle per level, a decay with jumps where these are possible, or the whole decay; states loaded
# from rest or relaxed, most turning points, number of levels, and of the rows frequency, damping, offset those that are
# judged, a bit each ...
BY_CYCLES, BY_JUMPS, BY_WHOLE_DECAY = range(3)
BY_DECAY, VIRGIN, MAXIMUM, N_LEVELS, ROWS = range(8, 13)
# ... and of a run under way, 0 before; the rows of the table of effects follow.
MODE, COLUMNS, N_SAMPLES, CURSOR, SAMPLE_SLOPES, QUANTITY, TABLE = range(13, 20)
# The numbers: of the oscillator and what is asked (tolerance of a step; release, 0 for the default; amplitude at which
# a decay ends), then of a run under way. Behind them follow the levels in a description, in the memory of a run what
# `memory_of` places there.
MASS, TOLERANCE, RELEASE, STOP, TIME, STEP, STEP_BEHIND_KINK, LARGEST_STEP, AMPLITUDE, N_NUMBERS = range(10)


class Description(NamedTuple):
    """A simulation in the layout above; not written to once it is made."""

    integers: IntArray
    numbers: FloatArray


class Turns(NamedTuple):
    """Turning points of a decay, the release first, one entry or row for each of the most there may be.

    Derivatives have columns for release amplitude and parameters, or for the former alone, or none at all.
    """

    values: FloatArray
    times: FloatArray
    slopes: FloatArray
    time_slopes: FloatArray


class Waveform(NamedTuple):
    """Instants [s] after release, not decreasing, and room for what is measured there.

    Derivatives, where they have columns, are with respect to release amplitude, parameters and time. ``quantity`` says
    how often the displacement is differentiated.
    """

    times: FloatArray
    values: FloatArray
    slopes: FloatArray
    quantity: int


class Memory(NamedTuple):
    """Where things stand in the memory of a run.

    ``dt``: derivatives of time; ``now``, ``next``: x, v, states, and behind them the derivatives of each with respect
    to the release amplitude and the parameters; behind ``scratch``: what effects with room of their own keep there.
    """

    scales: int
    user_scales: int
    dt: int
    shift: int
    fp: int
    fz: int
    middle: int
    room: int
    quadrature: int
    scratch: int
    now: int
    next: int
    K: int
    size: int


@plain
def memory_of(n_parameters: int, n_states: int, n_room: int, columns: int, mode: int) -> Memory:
    """Return the places of a run's arrays in its memory, and the size of all."""
    rows = 2 + n_states
    length = rows * (1 + columns)
    scales = N_NUMBERS
    user_scales = scales + rows
    dt = user_scales + rows
    shift = dt + columns
    fp = shift + columns
    fz = fp + n_parameters
    middle = fz + n_states
    room = middle + n_states
    quadrature = room + max(2 * columns, n_states)
    scratch = quadrature + 2 * columns
    now = scratch + scratch_size(n_parameters, n_states) + n_room
    later = now + length
    K = later + length
    size = K + (max(STAGES * length, n_states * (n_states + 1)) if mode == OWN_STATES else 0)
    return Memory(scales, user_scales, dt, shift, fp, fz, middle, room, quadrature, scratch, now, later, K, size)


@plain
def model_of(run: Integers, memory: Floats, p: Floats, place: Memory) -> Model:
    """Return what the integrator knows of the oscillator, as pointers into a run's memory."""
    return Model(
        run[USER], shifted(run, TABLE), run[N_EFFECTS], run[STIFFNESS], run[DAMPING], run[N_STATES],
        run[N_PARAMETERS], run[COLUMNS], memory[MASS], p, shifted(memory, place.scales),
        shifted(memory, place.user_scales), shifted(memory, place.fp), shifted(memory, place.fz),
        shifted(memory, place.scratch),
    )  # fmt: skip


@plain
def place_of(run: Integers) -> Memory:
    """Return the places of a run's arrays in its memory."""
    return memory_of(run[N_PARAMETERS], run[N_STATES], run[N_ROOM], run[COLUMNS], run[MODE])
