"""What a run of the integrator is described by, and how its memory is divided. Arguments but numbers are pointers."""

from __future__ import annotations

from collections import namedtuple

from .forces import Model, plain
from .pointers import shifted
from .stepper import STAGES

VALUE, SENSITIVITY, OWN_STATES = range(3)  # which stepper; with OWN_STATES as many columns as wanted, or none

# The integers that describe a run (rows of the table of effects follow) ...
USER, N_EFFECTS, STIFFNESS, DAMPING, N_STATES, N_PARAMETERS, HAS_REGIME, MODE, COLUMNS = range(9)
N_SAMPLES, CURSOR, SAMPLE_SLOPES, TABLE = range(9, 13)
# ... and the numbers at the start of its memory: what lies behind them is placed by `memory_of`.
MASS, TOLERANCE, TIME, STEP, LARGEST_STEP, AMPLITUDE, N_NUMBERS = range(7)

Memory = namedtuple(
    "Memory",
    [
        "scales", "user_scales", "dt", "shift", "fp", "fz", "middle", "room", "quadrature", "scratch", "now", "next",
        "K", "size",
    ],
)  # fmt: skip
Memory.__doc__ = (
    "Where things stand in the memory of a run. `dt`: derivatives of time; `now`, `next`: x, v, states, and behind "
    "them the derivatives of each with respect to the release amplitude and the parameters."
)


@plain
def memory_of(n_parameters, n_states, columns, mode):
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
    now = scratch + (2 + n_parameters + n_states) * max(1, n_states)
    later = now + length
    K = later + length
    size = K + (max(STAGES * length, n_states * (n_states + 1)) if mode == OWN_STATES else 0)
    return Memory(scales, user_scales, dt, shift, fp, fz, middle, room, quadrature, scratch, now, later, K, size)


@plain
def model_of(run, memory, p, place):
    """Return what the integrator knows of the oscillator, as pointers into a run's memory."""
    return Model(
        run[USER], shifted(run, TABLE), run[N_EFFECTS], run[STIFFNESS], run[DAMPING], run[N_STATES],
        run[N_PARAMETERS], run[COLUMNS], memory[MASS], p, shifted(memory, place.scales),
        shifted(memory, place.user_scales), shifted(memory, place.fp), shifted(memory, place.fz),
        shifted(memory, place.scratch),
    )  # fmt: skip


@plain
def place_of(run):
    """Return the places of a run's arrays in its memory."""
    return memory_of(run[N_PARAMETERS], run[N_STATES], run[COLUMNS], run[MODE])
