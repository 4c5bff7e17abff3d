"""One simulation under way: its description, the memory it works in, and how it is released and swings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._common.checks import FloatArray, IntArray
from .curves import compiled
from .forces import KIND, OWN_EQUATION, ROW
from .halfcycle import half_cycle, load_states
from .memory import (
    AMPLITUDE,
    COLUMNS,
    LARGEST_STEP,
    MODE,
    N_EFFECTS,
    N_NUMBERS,
    N_ROOM,
    N_STATES,
    OWN_STATES,
    SENSITIVITY,
    TABLE,
    TIME,
    VALUE,
    VIRGIN,
    memory_of,
)
from .pointers import address


class Run(NamedTuple):
    """A simulation: its description, its memory, and views of what lies in that memory."""

    integers: IntArray
    memory: FloatArray
    p: FloatArray
    y: FloatArray
    slopes: FloatArray
    dt: FloatArray
    columns: int
    n_states: int


@compiled
def prepare(integers: IntArray, numbers: FloatArray, p: FloatArray, sensitivities: bool, largest_step: float) -> Run:
    """Return a run of what is described, with a copy of the description and memory of its own."""
    mode = SENSITIVITY if sensitivities else VALUE
    for i in range(integers[N_EFFECTS]):
        if integers[TABLE + ROW * i + KIND] == OWN_EQUATION:
            mode = OWN_STATES
    columns = p.size + 1 if sensitivities else (0 if mode == OWN_STATES else 1)
    n_states = integers[N_STATES]
    under_way = integers.copy()
    under_way[MODE] = mode
    under_way[COLUMNS] = columns
    place = memory_of(p.size, n_states, integers[N_ROOM], columns, mode)
    memory = np.zeros(place.size)
    for i in range(N_NUMBERS):
        memory[i] = numbers[i]
    memory[LARGEST_STEP] = largest_step
    y = memory[place.now : place.next]
    rows = 2 + n_states
    slopes = memory[place.now + rows : place.now + rows + columns]
    return Run(under_way, memory, p, y, slopes, memory[place.dt : place.dt + columns], columns, n_states)


@compiled
def release_from(run: Run, amplitude: float) -> None:
    """Put the oscillator at ``amplitude``, at rest, its states as loaded from rest (virgin) or relaxed."""
    for i in range(run.y.size):
        run.y[i] = 0.0
    for c in range(run.columns):
        run.dt[c] = 0.0
    run.y[0] = amplitude
    if run.columns > 0:
        run.slopes[0] = 1.0
    run.memory[TIME] = 0.0
    run.memory[AMPLITUDE] = abs(amplitude)
    if run.n_states > 0:
        load_states(address(run.integers), address(run.memory), address(run.p), run.integers[VIRGIN])


@compiled
def swing(run: Run, direction: float) -> int:
    """Run to the next turning point, without sampling."""
    memory = address(run.memory)
    return half_cycle(address(run.integers), memory, address(run.p), direction, memory, memory, memory)
